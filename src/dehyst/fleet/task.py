"""The task of a worker: read one record, identify it, return one row; whatever one record does, it is a row."""

from __future__ import annotations

import os
import platform
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from dehyst._errors import DehystError, FileFormatError, MissingExtraError, RecordError
from dehyst._threads import one_thread
from dehyst._version import __version__
from dehyst.fleet.dataset import Task
from dehyst.fleet.drift import widths
from dehyst.fleet.prior import identified_with_prior
from dehyst.fleet.reader import STAMP, FleetOptions, Reader, sha256_of, stamp_of
from dehyst.fleet.shards import CAUSE, MARKER, MODEL, PLACE, Shards
from dehyst.identification import Fit, identify
from dehyst.model import Actuator
from dehyst.records import Record

# A task is tried so many times; status of a worker that ends itself at the time limit.
_TRIALS, _LATE = 3, 75
# A model that misses a record by this part of its standard deviation explains nothing.
_DEAD = 0.5


class TaskRunner:
    """The tasks of one run in one thread, with one BLAS thread.

    `head`: dataset, options and folder of the shards with its digest, and the most seconds of a task.
    """

    def __init__(self, head: Mapping[str, Any]) -> None:
        self.head, self._dataset = head, Path(head["dataset"])
        self._options, self._reader = FleetOptions(**head["options"]), Reader()
        self._shards = Shards(Path(head["folder"]), head["digest"])

    def run(self, task: Task) -> dict[str, Any]:
        """Write the shard of a task, unless there is one; return its outcome.

        A "fault" is returned if dataset or shards cannot be used from here, as on a full disk: it is none of the
        record, and ends the run.
        """
        try:
            return self._run(task)
        except FileFormatError as error:
            return {"fault": str(error)}

    def lose(self, task: Task, detail: str, reason: str) -> dict[str, Any]:
        """Write the row of a record whose worker died or took too long; return its outcome."""
        self._shards.write(task, lost_row(task, detail, reason))
        return {"outcome": "lost"}

    def _run(self, task: Task) -> dict[str, Any]:
        for path in (self._dataset, self._shards.folder / MARKER[0]):
            if not path.exists():
                raise FileFormatError(f"{path}: is not to be seen on {platform.node()}; workers need the same folders")
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
        return {name: row.get(name) for name in ("outcome", "cpu_s", "wall_s")} | {"memory_MB": peak_memory()}

    @contextmanager
    def _limited(self, task: Task) -> Iterator[None]:
        """End this process, the record being lost, after the most seconds: nothing else ends a computation."""
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


def run_task(task: Task, options: FleetOptions, reader: Reader) -> dict[str, Any]:
    """Return the row of a record, as JSON values; only a missing library or too little memory for anything raises."""
    began, wall = time.process_time(), time.perf_counter()
    row: dict[str, Any] = {"keys": dict(task.keys), "version": __version__, PLACE: task.within}
    try:
        row |= _identified(reader.record(task, options), options, row)
    except MissingExtraError:
        raise
    except DehystError as error:
        row |= {"outcome": "refused", "detail": type(error).__name__, "reason": str(error), CAUSE: _origin(error)}
    except MemoryError:
        row |= {"outcome": "refused", "detail": "MemoryError", "reason": "not enough memory for this record"}
    except Exception as error:  # nothing in one record stops the others
        row |= {"outcome": "refused", "detail": "error", "reason": f"unexpected {type(error).__name__}: {error}"}
        row |= {CAUSE: _origin(error)}
    return row | {
        "cpu_s": time.process_time() - began,
        "wall_s": time.perf_counter() - wall,
        "memory_MB": peak_memory(),
    }


def _identified(record: Record, options: FleetOptions, row: dict[str, Any]) -> dict[str, Any]:
    """Identify a record; what is known before it is refused is put into the row."""
    row |= {"sha256": sha256_of(record), "samples": len(record), "stroke_um": 1e6 * record.stroke}
    row |= {"noise_nm": 1e9 * record.noise}
    if options.prior is None:
        held: dict[str, Any] = {}
        fit = identify(record, throw=False, **options.identification)
    else:
        fit, held = identified_with_prior(record, options)
    if fit.actuator is None:
        return {**held, "outcome": "refused", "detail": fit.outcome.name, "reason": f"{fit.outcome.value} {fit.status}"}
    if fit.errors[0].rms > _DEAD * float(np.std(record.displacement)):
        raise RecordError(f"{record.name}: the displacement does not follow the voltage; check actuator and sensor")
    return {**held, **_described(fit, record)}


def _described(fit: Fit, record: Record) -> dict[str, Any]:
    """Return the numbers of a fit."""
    error, actuator = fit.errors[0], fit.actuator
    cycles = len(record.cycles())
    seconds = float(record.time[-1] - record.time[0]) / max(cycles, 1)
    width = widths(actuator, actuator.limits or record.voltage_range, seconds)
    good = fit.outcome.good
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
        "coefficients": coefficients_of(actuator),
        MODEL: actuator.as_dict(),
    }


def _origin(error: BaseException) -> str:
    """Return where an error was raised, the same for all records that are refused for one reason: module and line."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return "" if trace is None else f"{trace.tb_frame.f_globals.get('__name__')}:{trace.tb_lineno}"


def coefficients_of(actuator: Actuator) -> list[float]:
    """Return the stiffnesses of the slip elements [V/m], then the slopes of the spring's segments [V/m]."""
    slip, spring = actuator.slip, actuator.spring
    stiffness = getattr(slip, "stiffness", ())
    slopes = np.diff(spring.voltage) / np.diff(spring.displacement)
    return [float(value) for value in (*np.ravel(stiffness), *slopes)]


def peak_memory() -> float | None:
    """Return the largest resident memory of this process so far [MB], where the system counts it."""
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e3)


def lost_row(task: Task, detail: str, reason: str) -> Mapping[str, Any]:
    """Return the row of a record whose worker died or took too long."""
    keys = {"keys": dict(task.keys), "version": __version__, PLACE: task.within}
    return {**keys, "outcome": "lost", "detail": detail, "reason": reason}
