"""A run over a fleet: its remaining records, and the table at the end."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

from dehyst._errors import FileFormatError, IdentifyError
from dehyst._io import PathLike, path_of
from dehyst._text import counted
from dehyst._types import Progress
from dehyst._version import __version__
from dehyst.fleet.dataset import STAMP, Dataset, Reader, Task, code_of, digest_of, open_dataset, stamp_of
from dehyst.fleet.engine import run_tasks
from dehyst.fleet.prior import shape_of
from dehyst.fleet.table import COLUMNS, MODEL, PLACE, Fleet, Shards, load, write_table
from dehyst.fleet.task import FleetOptions, bare_row

# Seconds between two calls of the progress.
_OFTEN = 0.2


def identify_fleet(
    dataset: PathLike,
    output: PathLike,
    *,
    by: Sequence[str] = (),
    options: FleetOptions | None = None,
    prior: PathLike | None = None,
    jobs: int | None = None,
    dask: str | None = None,
    time_limit: float | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    remark: Callable[[str], None] | None = None,
) -> Fleet:
    """Identify every record of a dataset and write one table with one row for each record.

    Parameters
    ----------
    dataset, by
        As in `open_dataset`.
    output : path
        The table, .parquet. During the run, a folder next to it, with its name and ".parts", holds one file for each
        finished record.
    options : FleetOptions, optional
    prior : path, optional
        The table of an identified fleet: records with few or noisy data may take its shape.
    jobs : int, optional
        Number of local processes, by default one for each processor; not with `dask`.
    dask : str, optional
        Address of a Dask scheduler, as "tcp://host:8786", whose workers are used instead of local processes.
    time_limit : float, optional
        Largest time for one record [s]; its worker is then ended and replaced.
    resume : bool
        Continue a run that did not end, or update its table: only new records and records with changed samples are
        computed. Rows of removed records are dropped.
    progress, remark : callable, optional
        `progress` is called with a line of text several times per second. `remark` is called with a sentence if records
        share their keys, or were removed or changed since the earlier run.

    Raises
    ------
    FileFormatError
        If the dataset or the output cannot be used; another run uses the output; there are shards but `resume` is
        false; or the shards or the table to resume belong to another dataset, other options or another version.
    IdentifyError
        If an option is impossible.
    MissingExtraError, RigError
        If a library of the extra `fleet` is not installed, or the connection to the scheduler is lost.
    """
    target, report = Path(output).absolute(), progress or (lambda _: None)
    _check(dataset, target, jobs, dask, time_limit)
    report("reading the index")
    found = open_dataset(dataset, by)
    options = options or FleetOptions()
    options = options if prior is None else replace(options, prior=shape_of(load(prior)).as_dict())
    _check_dataset(found, options)
    chosen = asdict(options)
    digest = sha256(json.dumps([found.digest, chosen, __version__], sort_keys=True).encode()).hexdigest()
    shards = Shards(target.with_name(f"{target.name}.parts"), digest)
    with shards.held():
        earlier = _earlier(target, shards) if resume else None
        if earlier is not None and not shards.begun and _is_complete(earlier, found):
            return earlier
        shards.prepare(len(found), chosen, resume=resume)
        gone = _adopt(earlier, found, shards)
        left, changed = _left(found, options, shards) if resume else (list(found.tasks), ())
        for sentence in (*found.remarks, *gone, *changed):
            report("")
            (remark or (lambda _: None))(sentence)
        head: dict[str, Any] = {"dataset": str(found.path), "options": chosen, "time_limit": time_limit}
        head |= {"folder": str(shards.folder), "digest": digest}
        if left:
            _finish(head, left, len(found), report, jobs=jobs, scheduler=dask)
        _write(target, found, shards, chosen)
        report("")
        return load(target)


def _check(dataset: PathLike, output: Path, jobs: int | None, dask: str | None, time_limit: float | None) -> None:
    if jobs is not None and jobs < 1:
        raise IdentifyError(argument="jobs", got=jobs, need="1 at least")
    if jobs is not None and dask is not None:
        raise IdentifyError(argument="jobs", got=jobs, hint="leave it out: a scheduler has workers of its own")
    if time_limit is not None and not time_limit > 0:
        raise IdentifyError(argument="time_limit", got=f"{time_limit:g} s", need="seconds above 0")
    if output.suffix.lower() != ".parquet":
        raise FileFormatError(f"{output}: a table of a fleet is Parquet; give a name that ends in .parquet")
    if not output.parent.is_dir():
        raise FileFormatError(f"{output}: the folder {output.parent} does not exist; create it first")
    if path_of(dataset).resolve() == output.resolve():
        raise FileFormatError(f"{output}: is the dataset; give another name for the table")


def _check_dataset(dataset: Dataset, options: FleetOptions) -> None:
    decimal = options.columns.get("decimal")
    if decimal is not None and all(task.place.kind != "file" for task in dataset.tasks):
        raise FileFormatError(
            f"got '{decimal}', but {dataset.path} holds no text files", argument="decimal", hint="leave it out"
        )
    if reserved := [name for name in dataset.by if name in (*COLUMNS, "keys")]:
        raise FileFormatError(f"by: the name '{reserved[0]}' is that of a result; rename that column")


def refuse_inside(dataset: Path, output: Path) -> None:
    """Raise `FileFormatError` if the next index of the dataset would take the table for a record.

    Only commands check this, because they are repeated; a script may write its table into its dataset once.
    """
    if dataset.resolve() in output.resolve().parents:
        raise FileFormatError(
            f"{output}: lies in the dataset {dataset}, whose next index would take the table for a record; write it "
            "outside"
        )


def _earlier(output: Path, shards: Shards) -> Fleet | None:
    """Return the table of an earlier run with the same dataset, options and version; None if there is no table.

    Another table is an error, unless there are shards: then the run to resume was about to replace it.
    """
    if not output.exists():
        return None
    try:
        fleet = load(output)
        if fleet.about.get("digest") == shards.digest:
            return fleet
        raise FileFormatError(
            f"{output}: is a table of another dataset, other options or another version; repeat the command of that "
            "run, name another table, or leave --resume out to replace this one"
        )
    except FileFormatError:
        if not shards.begun:
            raise
    return None


def _is_complete(fleet: Fleet, dataset: Dataset) -> bool:
    """Return whether a table has a row for each record, and no file of the dataset has changed since."""
    content = _content((task, stamp_of(task.place)) for task in dataset.tasks)
    return fleet.about.get("content") == content and all(row["outcome"] != "lost" for row in fleet.rows)


def _content(stamps: Iterable[tuple[Task, str | None]]) -> str:
    """Return the hash of the places of all records, and of a stamp of each."""
    return digest_of(f"{task.within} {stamp}" for task, stamp in stamps)


def _adopt(fleet: Fleet | None, dataset: Dataset, shards: Shards) -> tuple[str, ...]:
    """Convert the rows of a table, if there is one, to shards, and remove the shards of removed records.

    Rows without samples to compare are left out. Return a sentence if records were removed.
    """
    tasks, gone = {task.code: task for task in dataset.tasks}, set()
    for path in shards.files():
        if path.stem not in tasks:
            gone.add(path.stem)
            path.unlink()
    for row, model in () if fleet is None else fleet.texts():
        code = code_of(str(row[PLACE]))
        task = tasks.get(code)
        if task is None:
            gone.add(code)
            continue
        same = all(str(row[name]) == str(value) for name, value in task.keys.items())
        if same and row["outcome"] != "lost" and row["sha256"] and not shards.path(task).exists():
            columns = {name: row[name] for name in COLUMNS if name != MODEL}
            # A row whose model is damaged is computed again.
            with suppress(ValueError):
                held = {MODEL: json.loads(model)} if model else {}
                shards.write(task, {"keys": dict(task.keys), **columns, **held})
    words = f"{counted(len(gone), 'record')} of the run that is resumed gone from the dataset: without a row now"
    return (words,) if gone else ()


def _left(dataset: Dataset, options: FleetOptions, shards: Shards) -> tuple[list[Task], tuple[str, ...]]:
    """Return the records without a row for their present samples, and a sentence if some have changed."""
    reader, left, changed = Reader(options.columns), list[Task](), list[Task]()
    for task in dataset.tasks:
        row = shards.read(task)
        lost = row is not None and row["outcome"] == "lost"
        if row is not None and not lost and reader.is_current(row, task):
            continue
        left.append(task)
        if row is not None:
            changed += [] if lost else [task]
            shards.path(task).unlink(missing_ok=True)
    if not changed:
        return left, ()
    count = counted(len(changed), "record")
    return left, (f"{count} changed since the run that is resumed, as {changed[0].name}: computed again",)


def _finish(
    head: Mapping[str, Any], left: list[Task], total: int, report: Progress, *, jobs: int | None, scheduler: str | None
) -> None:
    """Process the remaining records, and report the progress."""
    began = shown = time.monotonic()
    done = lost = 0
    with closing(run_tasks(head, left, jobs=jobs, scheduler=scheduler)) as answers:
        report(f"{total - len(left)} of {counted(total, 'record')}")
        for answer in answers:
            if answer is not None:
                if "fault" in answer:
                    raise FileFormatError(f"{answer['fault']}; then give the same command with --resume")
                done += 1
                lost += answer["outcome"] == "lost"
            now = time.monotonic()
            if now - shown > _OFTEN:
                shown, remaining = now, len(left) - done
                rate = done / (now - began)
                speed = f", {rate:.3g} a second, {_duration(remaining / rate)} left" if done else ""
                misses = f", {lost} lost" if lost else ""
                report(f"{total - remaining} of {counted(total, 'record')}{speed}{misses}")


def _duration(seconds: float) -> str:
    """Return a duration as text with at most two units."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s"


def _write(output: Path, dataset: Dataset, shards: Shards, options: Mapping[str, Any]) -> None:
    """Write the table, and remove the shards if no record is lost."""
    if not shards.begun:
        raise FileFormatError(f"{shards.folder}: was removed while this run used it; give the command again")
    lost = 0

    def rows() -> Iterator[Mapping[str, Any]]:
        nonlocal lost
        for task in dataset.tasks:
            row = shards.read(task) or bare_row(task, "lost", "shard", "its shard is missing or damaged")
            lost += row["outcome"] == "lost"
            yield row

    # What the files of all records were when they were read.
    content = _content((task, (shards.read(task) or {}).get(STAMP)) for task in dataset.tasks)
    about = {"digest": shards.digest, "content": content, "options": options}
    keys = {name: [task.keys[name] for task in dataset.tasks] for name in dataset.by}
    write_table(output, keys, rows(), about, shards.folder)
    if not lost:
        shards.remove()
