"""A run over a fleet: what is left to do, who does it, and the table at the end."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from dehyst._errors import FileFormatError, IdentifyError
from dehyst._io import PathLike, named
from dehyst._text import counted
from dehyst._types import Progress
from dehyst.fleet.dataset import Dataset, Task, code_of, open_dataset
from dehyst.fleet.engine import run_tasks
from dehyst.fleet.prior import shape_of
from dehyst.fleet.reader import STAMP, FleetOptions, Reader, digest_of, is_current, stamp_of
from dehyst.fleet.shards import COLUMNS, MODEL, PLACE, Shards
from dehyst.fleet.table import Fleet, load, write_table
from dehyst.fleet.task import lost_row


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
    """Identify every record of a dataset and write one table, one row a record.

    Parameters
    ----------
    dataset : path
        See `open_dataset`.
    output : path
        The table, .parquet. While it is made, one file a record is kept in a folder beside it, of its name with
        ".parts".
    by : sequence of str
        Names of the keys.
    options : FleetOptions, optional
    prior : path, optional
        The table of an identified fleet: records with few or noisy data may take its shape.
    jobs : int, optional
        Number of processes of this machine; default: that of the processors.
    dask : str, optional
        Address of a Dask scheduler, as "tcp://host:8786", whose workers are taken instead.
    time_limit : float, optional
        Seconds a record may take; its worker is then ended and replaced.
    resume : bool
        Go on with a run that did not end, or complete its table: only records that are new or whose samples have
        changed are computed. Rows of records that are gone go.
    progress : callable, optional
        Is called with a line of words some times a second.
    remark : callable, optional
        Is called with a sentence if records share their keys, or are gone or have changed since the run that is
        resumed.

    Returns
    -------
    Fleet

    Raises
    ------
    FileFormatError
        The dataset or the output cannot be used; another run uses the output; shards are there and `resume` is not
        given; shards or table to resume are of another dataset, other options or another version.
    IdentifyError
        An option is impossible.
    MissingExtraError
        A library of the extra `fleet` is not installed.
    RigError
        The scheduler is lost.
    """
    target, report = Path(output).absolute(), progress or (lambda _: None)
    _check(dataset, target, jobs, dask, time_limit)
    report("reading the index")
    found = open_dataset(dataset, by)
    options = options or FleetOptions()
    options = options if prior is None else replace(options, prior=shape_of(load(prior)))
    _check_dataset(found, options)
    shards = Shards.beside(target, options.digest(found.digest))
    with shards.held():
        earlier = _earlier(target, shards) if resume else None
        if earlier is not None and not shards.begun and _is_complete(earlier, found):
            return earlier
        shards.prepare(len(found), options.as_dict(), resume=resume)
        gone = _adopt(earlier, found, shards)
        run = _Run(found, options, shards, report, resume)
        for sentence in (*found.remarks, *gone, *run.remarks):
            report("")
            (remark or (lambda _: None))(sentence)
        run.finish(jobs, dask, time_limit)
        run.write(target)
        report("")
        return load(target)


class _Run:
    """Tasks of a run that are done, left and lost."""

    def __init__(self, dataset: Dataset, options: FleetOptions, shards: Shards, report: Progress, resume: bool) -> None:
        self.dataset, self.shards, self._report = dataset, shards, report
        self.head = {"options": options.as_dict(), "folder": str(shards.folder), "digest": shards.digest}
        self.head["dataset"] = str(dataset.path)
        self.changed: list[Task] = []
        reader = Reader()
        self.left = [task for task in dataset.tasks if not (resume and self._is_done(task, options, reader))]
        self._began, self._done, self._lost, self._shown = time.monotonic(), 0, 0, 0.0

    def _is_done(self, task: Task, options: FleetOptions, reader: Reader) -> bool:
        """Return whether a record has its row; remove a row of other samples."""
        row = self.shards.read(task)
        if row is None:
            return False
        if row["outcome"] != "lost":
            if is_current(row, task, options, reader):
                return True
            self.changed.append(task)
        self.shards.discard(task)
        return False

    @property
    def remarks(self) -> tuple[str, ...]:
        """A sentence if records have changed since the run that is resumed."""
        if not self.changed:
            return ()
        count = counted(len(self.changed), "record")
        return (f"{count} changed since the run that is resumed, as {self.changed[0].name}: computed again",)

    def finish(self, jobs: int | None, scheduler: str | None, time_limit: float | None) -> None:
        """Do what is left."""
        if not self.left:
            return
        self._show()
        head = self.head | {"time_limit": time_limit}
        with closing(run_tasks(head, self.left, jobs=jobs, scheduler=scheduler)) as answers:
            for answer in answers:
                if answer is not None:
                    if "fault" in answer:
                        raise FileFormatError(f"{answer['fault']}; then give the same command with --resume")
                    self._done += 1
                    self._lost += answer["outcome"] == "lost"
                if time.monotonic() - self._shown > _OFTEN:
                    self._show()

    def write(self, output: Path) -> None:
        """Write the table, and remove the shards if no record is lost."""
        if not self.shards.begun:
            raise FileFormatError(f"{self.shards.folder}: was removed while this run used it; give the command again")
        tasks = self.dataset.tasks
        # What the files of all records were when they were read.
        content = _content((task, (self.shards.read(task) or {}).get(STAMP)) for task in tasks)
        about = {"digest": self.shards.digest, "content": content, "options": self.head["options"]}
        keys = {name: [task.keys[name] for task in tasks] for name in self.dataset.by}
        write_table(output, keys, self._rows(), about, self.shards.folder)
        if not self._lost:
            self.shards.remove()

    def _rows(self) -> Iterator[Mapping[str, Any]]:
        """Yield the row of each record, in the dataset's order."""
        for task in self.dataset.tasks:
            row = self.shards.read(task)
            if row is None:
                self._lost += 1
                row = dict(lost_row(task, "shard", "its shard is missing or damaged"))
            yield row

    def _show(self) -> None:
        self._shown = time.monotonic()
        total, left = len(self.dataset), len(self.left) - self._done
        words = f"{total - left} of {counted(total, 'record')}"
        if self._done:
            rate = self._done / (self._shown - self._began)
            words += f", {rate:.3g} a second, {duration(left / rate)} left"
        lost = f", {self._lost} lost" if self._lost else ""
        self._report(f"{words}{lost}")


# Seconds between two calls of the progress.
_OFTEN = 0.2


def duration(seconds: float) -> str:
    """Write a duration in two units at most."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s"


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
    if named(dataset).resolve() == output.resolve():
        raise FileFormatError(f"{output}: is the dataset; give another name for the table")


def _check_dataset(dataset: Dataset, options: FleetOptions) -> None:
    if options.decimal is not None and all(task.place.kind != "file" for task in dataset.tasks):
        raise FileFormatError(
            f"got '{options.decimal}', but {dataset.path} holds no text files", argument="decimal", hint="leave it out"
        )
    if reserved := [name for name in dataset.by if name in (*COLUMNS, MODEL, "keys")]:
        raise FileFormatError(f"by: the name '{reserved[0]}' is that of a result; rename that column")


def refuse_inside(dataset: Path, output: Path) -> None:
    """Raise `FileFormatError` if the next index of the dataset would take the table for a record.

    For commands, which are repeated; a script may write its table into a folder of its own once.
    """
    if dataset.resolve() in output.resolve().parents:
        raise FileFormatError(
            f"{output}: lies in the dataset {dataset}, whose next index would take the table for a record; write it "
            "outside"
        )


def _earlier(output: Path, shards: Shards) -> Fleet | None:
    """Return the table of an earlier run with the same dataset, options and version; None if there is no table.

    Another table is refused, unless shards are there: the run that is resumed was about to replace it.
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
    """Return whether a table has a row of each record, and no file of the dataset has changed since."""
    content = _content((task, stamp_of(task.place)) for task in dataset.tasks)
    return fleet.about.get("content") == content and all(row["outcome"] != "lost" for row in fleet.rows)


def _content(stamps: Iterable[tuple[Task, str | None]]) -> str:
    """Return the hash of the places of all records, and of a stamp of each."""
    return digest_of(f"{task.within} {stamp}" for task, stamp in stamps)


def _adopt(fleet: Fleet | None, dataset: Dataset, shards: Shards) -> tuple[str, ...]:
    """Make shards of the rows of a table, if there is one, and remove those of records that are gone.

    Rows without samples to compare are left out. Return a sentence if records are gone.
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
            columns = {name: row[name] for name in COLUMNS}
            # A row whose model is damaged is computed again.
            with suppress(ValueError):
                held = {MODEL: json.loads(model)} if model else {}
                shards.write(task, {"keys": dict(task.keys), **columns, **held})
    if not gone:
        return ()
    return (f"{counted(len(gone), 'record')} of the run that is resumed gone from the dataset: without a row now",)
