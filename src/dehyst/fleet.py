"""Identification of many records by Dask: one table with one row per record, which a later run continues."""

from __future__ import annotations

import io
import json
import logging
import os
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any, NamedTuple

from dehyst._errors import DehystError, FileFormatError, LinkError, MissingExtraError, library
from dehyst._io import PathLike, path_of, reading, write_atomically
from dehyst._text import counted
from dehyst._threads import one_thread
from dehyst._types import Progress
from dehyst.identification import identify
from dehyst.model import Actuator, knots_of, quasistatic, step_response, turned, voltages_of
from dehyst.records import LOADERS, Record
from dehyst.records import read as read_record

__all__ = ["identify_fleet"]

# The columns of the table, in their order.
TEXTS = ("record", "reason", "model")
NUMBERS = ("promise_percent", "stroke_um", "loop_width_um", "lag_ms", "creep_percent", "noise_nm")
COLUMNS = (TEXTS[0], *NUMBERS, *TEXTS[1:])
# Seconds to wait for a scheduler with a worker; least time between two writes of the table: in seconds, and as a
# multiple of the duration of a write.
_PATIENCE, _OFTEN, _SELDOM = 30, 5.0, 20.0
# With Dask's default threshold of 64 kB a record takes 50 % more processor time. The profiler is off: nobody uses it.
_SETTINGS = {
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": 1 << 27,
    "distributed.nanny.pre-spawn-environ.MALLOC_MMAP_THRESHOLD_": 1 << 25,
    "distributed.worker.profile.enabled": False,
}
_Row = dict[str, Any]


class FleetTable(NamedTuple):
    """A written table: its `path`, and numbers of rows.

    `records`: all rows. `computed`: rows of this run; the others existed already. `refused`: rows with a reason. The
    columns: record, promise_percent [% of the stroke], stroke_um, loop_width_um (at the middle of the voltages),
    lag_ms, creep_percent (after a sudden rise, of the rise), noise_nm, reason (empty if the model may be used), model
    (JSON, for `dehyst.Actuator.from_dict`). A number that is not known is null.
    """

    path: Path
    records: int
    computed: int
    refused: int


def identify_fleet(
    records: PathLike | Sequence[PathLike],
    output: PathLike,
    *,
    scheduler: str | None = None,
    read: Callable[[Path], Record] = read_record,
    again: bool = False,
    progress: Progress | None = None,
) -> FleetTable:
    """Identify each record with all defaults of `dehyst.identify`, and write one table with one row per record.

    Records whose names are already in the table keep their rows; only the others are computed. The whole table is
    rewritten every few seconds, so that the same call continues a run that was stopped or killed.

    Parameters
    ----------
    records : path or sequence of paths
        Files, or a folder: each file in it that `dehyst.read` opens is a record. The name of a record is its path
        within the folder, or the given path.
    output : path
        The table, .parquet; `FleetTable` describes its columns.
    scheduler : str, optional
        Address of a Dask scheduler, such as "tcp://host:8786", whose workers see the same files. By default the run
        starts one process for each processor.
    read : callable, optional
        Function of a path that returns the record.
    again : bool
        Whether to compute all records and replace an existing table.
    progress : callable, optional
        Called with a line of text.

    Returns
    -------
    FleetTable

    Raises
    ------
    FileFormatError
        If there are no records, two records have the same name, or the output file is not such a table.
    MissingExtraError
        If a library of the extra `fleet` is not installed.
    RigError
        If no scheduler answers, the connection to it is lost, or a worker lacks a library that reads a file.

    Notes
    -----
    A script that calls this without a scheduler must do so below ``if __name__ == "__main__":``, because each process
    imports it.
    """
    target, report = path_of(output, "output"), progress or (lambda _: None)
    if target.suffix.lower() != ".parquet":
        raise FileFormatError(argument="output", got=f"{target}", need="a name that ends in .parquet")
    paths = _named(records, target)
    rows = {row["record"]: row for row in _rows_of(target) if not again}
    missing = {name: path for name, path in paths.items() if name not in rows}
    if missing:
        with _writing(target, rows, len(missing), report) as keep, _connected(scheduler) as client:
            for row in _computed(client, missing, read):
                keep(row)
    return FleetTable(target, len(rows), len(missing), sum(bool(row["reason"]) for row in rows.values()))


def _named(records: PathLike | Sequence[PathLike], output: Path) -> dict[str, Path]:
    """Return the absolute paths of the records by name."""
    if isinstance(records, str | os.PathLike) and path_of(records, "records").is_dir():
        folder = path_of(records, "records")
        found = sorted(path for path in folder.rglob("*") if path.suffix.lower() in LOADERS and not path.is_dir())
        inside = [(path.relative_to(folder), path) for path in found]
        named = [(name, path) for name, path in inside if not any(part.startswith(".") for part in name.parts)]
    else:
        files = [records] if isinstance(records, str | os.PathLike) else records
        named = [(path, path) for path in (path_of(file, "records") for file in files)]
        for path, _ in named:
            if not path.is_file():
                got = "a folder among files" if path.is_dir() else "no such file"
                raise FileFormatError(argument="records", got=f"{path}: {got}", need="one folder, or files that exist")
    # The table may lie in the folder of the records: it is not a record.
    paths = [(_text(name), path.absolute()) for name, path in named if path.absolute() != output.absolute()]
    if not paths:
        raise FileFormatError(argument="records", got=f"no record in {records}", need="a folder with files, or files")
    names = dict(paths)
    if len(names) < len(paths):
        twice = next(name for k, (name, _) in enumerate(paths) if name in dict(paths[:k]))
        raise FileFormatError(argument="records", got=f"{twice} twice", need="different files")
    return names


def _text(name: Path) -> str:
    """Return a name as text, with an escape for each byte that is not UTF-8."""
    return name.as_posix().encode(errors="backslashreplace").decode()


def _computed(client: Any, paths: Mapping[str, Path], read: Callable[[Path], Record]) -> Iterator[_Row]:
    """Yield the row of each record as soon as it is computed."""
    distributed = library("distributed", "A fleet", "fleet")
    futures = client.map(partial(row_of, read), list(paths), list(paths.values()), pure=False)
    names = dict(zip(futures, paths, strict=True))
    # Dask then frees each result after use.
    del futures
    for future in distributed.as_completed(list(names)):
        name = names.pop(future)
        if future.status == "finished":
            yield dict(future.result())
        elif future.status != "error":
            raise CancelledError
        elif isinstance(error := future.exception(), distributed.KilledWorker):
            yield _row(name, reason="its process died several times; check that there is enough memory")
        else:
            raise LinkError(
                f"a worker of Dask failed ({type(error).__name__}: {error}); check that scheduler and workers have "
                "this version of dehyst, and the libraries that read the files"
            ) from error


def row_of(read: Callable[[Path], Record], name: str, path: Path) -> _Row:
    """Return the row of a record; only a missing library raises an error."""
    known: _Row = {}
    try:
        with one_thread():
            record = read(path)
            known |= {"stroke_um": 1e6 * record.stroke, "noise_nm": 1e9 * record.noise}
            fit = identify(record)
            known |= _described(fit.actuator)
            known["promise_percent"] = fit.promise.largest_percent
            reason = "" if fit.good else fit.outcome.value if not fit.outcome.good else str(fit)
            return _row(name, **known, reason=reason)
    except MissingExtraError:
        raise
    except DehystError as error:
        return _row(name, **known, reason=str(error))
    except Exception as error:  # an error in one record must not stop the others
        return _row(name, **known, reason=f"unexpected {type(error).__name__}: {error}")


def _row(name: str, *, reason: str, **known: Any) -> _Row:
    return {**dict.fromkeys(COLUMNS), **known, "record": name, "reason": reason}


def _described(actuator: Actuator) -> _Row:
    """Return the columns of a model: its numbers and its JSON."""
    return {
        "loop_width_um": 1e6 * loop_width(actuator),
        "lag_ms": 1e3 * (actuator.delay + actuator.lag),
        "creep_percent": 100 * float(step_response(actuator)[1][-1]),
        "model": json.dumps(actuator.as_dict()),
    }


def loop_width(actuator: Actuator) -> float:
    """Return falling minus rising displacement [m] at the middle of the voltages, on a major loop without creep."""
    low, high = voltages_of(actuator)
    fast = replace(quasistatic(actuator)._before_creep, state=None)  # type: ignore[arg-type]
    begin = turned(fast, knots_of(fast)[0], rising=False)
    middle = 0.5 * (low + high)
    y = fast.simulate([low, middle, high, middle], state=begin, extrapolate=True).displacement
    return float(y[3] - y[1])


def _rows_of(path: Path) -> list[_Row]:
    """Return the rows of a table; none if there is no file."""
    if not path.exists():
        return []
    with reading(path, "Parquet", float("inf")) as stream:
        table = library("pyarrow.parquet", "A fleet", "fleet").read_table(stream)
    if tuple(table.column_names) != COLUMNS:
        raise FileFormatError(f"{path}: is not a table of a fleet; give another name, or remove the file")
    return list(table.to_pylist())


@contextmanager
def _writing(path: Path, rows: dict[str, _Row], more: int, report: Progress) -> Iterator[Callable[[_Row], None]]:
    """Yield a function that keeps a row; `more` rows will come. Write the table from time to time and at the end."""
    library("pyarrow.parquet", "A fleet", "fleet")
    written, duration, total = time.monotonic(), 0.0, counted(len(rows) + more, "record")
    report(f"{len(rows)} of {total}")

    def write() -> None:
        nonlocal written, duration
        began = time.monotonic()
        _write(path, [rows[name] for name in sorted(rows)])
        written = time.monotonic()
        duration = written - began

    def keep(row: _Row) -> None:
        rows[row["record"]] = row
        report(f"{len(rows)} of {total}")
        if time.monotonic() - written > max(_OFTEN, _SELDOM * duration):
            write()

    try:
        yield keep
        report("")
    except KeyboardInterrupt as stop:
        stop.add_note("the computed rows are in the table; the same command continues it")
        raise
    finally:
        write()


def _write(path: Path, rows: list[_Row]) -> None:
    parquet, arrow = library("pyarrow.parquet", "A fleet", "fleet"), library("pyarrow", "A fleet", "fleet")
    kinds = {name: arrow.float64() if name in NUMBERS else arrow.string() for name in COLUMNS}
    content = io.BytesIO()
    parquet.write_table(arrow.Table.from_pylist(rows, schema=arrow.schema(kinds)), content, compression="zstd")
    write_atomically(path, content.getvalue())


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Block Ctrl-C for processes that start in this context, so that only the client handles it."""
    # The tracker starts before: its start would unblock all signals.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _connected(scheduler: str | None) -> Iterator[Any]:
    """Yield a client of a scheduler; by default the scheduler has local processes, which end with the client."""
    from dask import config

    distributed = library("distributed", "A fleet", "fleet")
    try:
        with config.set(_SETTINGS), ExitStack() as opened:
            log = logging.getLogger("distributed")
            opened.callback(log.setLevel, log.level)
            log.setLevel(logging.CRITICAL)
            address: Any = scheduler
            if scheduler is None:
                with _uninterrupted() if hasattr(signal, "pthread_sigmask") else nullcontext():
                    silent = {"dashboard_address": None, "silence_logs": logging.CRITICAL}
                    address = opened.enter_context(distributed.LocalCluster(threads_per_worker=1, **silent))
            try:
                client = opened.enter_context(distributed.Client(address, timeout=_PATIENCE))
                client.wait_for_workers(1, timeout=_PATIENCE)
            except (OSError, TimeoutError, ValueError) as error:
                got = f"no answer of {scheduler} ({type(error).__name__}: {error})"
                need, hint = "a Dask scheduler with a worker", "start 'dask scheduler' and 'dask worker ADDRESS' first"
                raise LinkError(argument="scheduler", got=got, need=need, hint=hint) from error
            yield client
    except DehystError:
        raise
    # Dask raises one of several errors when its scheduler ends.
    except (OSError, CancelledError) as error:
        raise LinkError("the connection to Dask is lost; the same command continues the table") from error
