"""The task of a worker: read one record, identify it, and write one row, even if the record fails."""

from __future__ import annotations

import os
import platform
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dehyst._errors import DehystError, FileFormatError, IdentifyError, MissingExtraError, RecordError
from dehyst._threads import one_thread
from dehyst._validation import choice
from dehyst._version import __version__
from dehyst.fleet.dataset import STAMP, Reader, Task, sha256_of, stamp_of
from dehyst.fleet.drift import widths
from dehyst.fleet.prior import Shape, identified_with_prior
from dehyst.fleet.table import MODEL, PLACE, Shards
from dehyst.identification import Fit, identify
from dehyst.records import Choice, Record

# Arguments of `dehyst.read` that a fleet takes.
COLUMNS = (*Choice._fields, "decimal")
# A task is tried so many times; status of a worker that ends itself at the time limit.
_TRIALS, _LATE = 3, 75
# A model that misses a record by this part of its standard deviation explains nothing.
_DEAD = 0.5


@dataclass(frozen=True)
class FleetOptions:
    """How every record is identified; raise `IdentifyError` if an option is impossible.

    `structure`: "maxwell_slip", slip elements and a spring, or "auto", parts selected by cross-validation. `elements`:
    number of slip elements of "maxwell_slip". `norm`, `drift`, `delay` [s]: as in `dehyst.identify`. `columns`:
    arguments of `dehyst.read`, by names in `COLUMNS`. `prior`: the shape of an identified fleet.
    """

    structure: Literal["maxwell_slip", "auto"] = "maxwell_slip"
    elements: int | None = None
    norm: str = "l1"
    drift: bool = True
    delay: float | None = None
    columns: Mapping[str, Any] = field(default_factory=dict)
    prior: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        choice(self.structure, "structure", ("maxwell_slip", "auto"))
        if self.structure == "auto" and (self.elements is not None or self.prior is not None):
            raise IdentifyError("structure: 'auto' takes neither elements nor a prior; leave them out")
        for name in self.columns:
            choice(name, "columns", COLUMNS)

    @property
    def identification(self) -> dict[str, Any]:
        """The arguments of `dehyst.identify`."""
        names = ("structure", "norm", "drift", "delay", *(("elements",) if self.structure == "maxwell_slip" else ()))
        return {name: getattr(self, name) for name in names}


class TaskRunner:
    """The tasks of one run in one thread, with one BLAS thread.

    `head`: dataset, options, folder of the shards with its digest, and the time limit of a task [s].
    """

    def __init__(self, head: Mapping[str, Any]) -> None:
        self.head, self._options = head, FleetOptions(**head["options"])
        self._reader = Reader(self._options.columns)
        self._shards = Shards(Path(head["folder"]), head["digest"])

    def run(self, task: Task) -> dict[str, Any]:
        """Write the shard of a task, unless there is one; return its outcome.

        A "fault" is returned if dataset or shards cannot be used from here, as on a full disk. It is not due to the
        record, and ends the run.
        """
        try:
            for path in (Path(self.head["dataset"]), self._shards.marker):
                if not path.exists():
                    raise FileFormatError(
                        f"{path}: is not to be seen on {platform.node()}; workers need the same folders"
                    )
            row = self._shards.read(task)
            if row is None:
                # Each of the trials before ended with its process.
                if self._shards.trial(task) > _TRIALS:
                    return self.lose(task, "worker", f"its worker died {_TRIALS} times")
                # Before the record is read: a later change gives another stamp.
                stamp = stamp_of(task.place)
                with one_thread(), self._limited(task):
                    row = run_task(task, self._options, self._reader) | {STAMP: stamp}
                self._shards.write(task, row)
        except FileFormatError as error:
            return {"fault": str(error)}
        return {name: row.get(name) for name in ("outcome", "cpu_s", "wall_s")} | {"memory_MB": peak_memory()}

    def lose(self, task: Task, detail: str, reason: str) -> dict[str, Any]:
        """Write the row of a record whose worker died or took too long; return its outcome."""
        self._shards.write(task, bare_row(task, "lost", detail, reason))
        return {"outcome": "lost"}

    @contextmanager
    def _limited(self, task: Task) -> Iterator[None]:
        """Mark the record as lost and end this process after the time limit."""
        limit = self.head["time_limit"]
        if limit is None:
            yield
            return

        def end() -> None:
            try:
                self.lose(task, "time limit", f"no result within the time limit of {limit:g} s")
            finally:
                os._exit(_LATE)

        timer = threading.Timer(limit, end)
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()


def bare_row(task: Task, outcome: str = "", detail: str = "", reason: str = "") -> dict[str, Any]:
    """Return the row of a record without numbers, as of one whose worker died."""
    known = {"keys": dict(task.keys), "version": __version__, PLACE: task.within}
    return {**known, "outcome": outcome, "detail": detail, "reason": reason}


def run_task(task: Task, options: FleetOptions, reader: Reader) -> dict[str, Any]:
    """Return the row of a record, as JSON values; only a missing library or a general lack of memory is an error."""
    began, wall = time.process_time(), time.perf_counter()
    row = bare_row(task)
    try:
        row |= _identified(reader.record(task), options, row)
    except MissingExtraError:
        raise
    except DehystError as error:
        row |= _refused(type(error).__name__, str(error))
    except MemoryError:
        row |= _refused("MemoryError", "not enough memory for this record")
    except Exception as error:  # nothing in one record stops the others
        row |= _refused("error", f"unexpected {type(error).__name__}: {error}")
    seconds = {"cpu_s": time.process_time() - began, "wall_s": time.perf_counter() - wall}
    return row | seconds | {"memory_MB": peak_memory()}


def _refused(detail: str, reason: str) -> dict[str, Any]:
    """Return the fields of a row for a refusal."""
    return {"outcome": "refused", "detail": detail, "reason": reason}


def _identified(record: Record, options: FleetOptions, row: dict[str, Any]) -> dict[str, Any]:
    """Identify a record; values known before a refusal are put into the row."""
    row |= {"sha256": sha256_of(record), "samples": len(record), "stroke_um": 1e6 * record.stroke}
    row |= {"noise_nm": 1e9 * record.noise}
    if options.prior is None:
        fit, held_out = identify(record, throw=False, **options.identification), dict[str, Any]()
    else:
        fit, held_out = identified_with_prior(record, Shape.from_dict(options.prior), options.identification)
    if fit.actuator is None:
        return held_out | _refused(fit.outcome.name, f"{fit.outcome.value} {fit.status}")
    if fit.errors[0].rms > _DEAD * float(np.std(record.displacement)):
        raise RecordError(f"{record.name}: the displacement does not follow the voltage; check actuator and sensor")
    return held_out | _described(fit, record)


def _described(fit: Fit, record: Record) -> dict[str, Any]:
    """Return the numbers of a fit."""
    error, actuator, good = fit.errors[0], fit.actuator, fit.outcome.good
    seconds = float(record.time[-1] - record.time[0]) / max(len(record.cycles()), 1)
    width = widths(actuator, actuator.limits or record.voltage_range, seconds)
    slopes = np.diff(actuator.spring.voltage) / np.diff(actuator.spring.displacement)
    return {
        "outcome": "identified" if good else "inaccurate",
        "detail": fit.outcome.name,
        "reason": "" if good else fit.outcome.value,
        "largest_percent": error.largest_percent,
        "rms_percent": error.rms_percent,
        "expected_percent": None if fit.expectation is None else fit.expectation.largest_percent,
        "noise_percent": 100 * record.noise / error.stroke,
        "stroke_um": 1e6 * error.stroke,
        **{f"width{place}_um": 1e6 * value for place, value in zip((25, 50, 75), width, strict=True)},
        "drift_percent": error.drifted_percent + 0.0,
        "cycle_s": seconds,
        # Stiffnesses of the slip elements, then slopes of the spring's segments [V/m].
        "coefficients": [*np.ravel(actuator.slip.stiffness).tolist(), *slopes.tolist()],
        MODEL: actuator.as_dict(),
    }


def peak_memory() -> float | None:
    """Return the largest resident memory of this process so far [MB], where the system counts it."""
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e3)
