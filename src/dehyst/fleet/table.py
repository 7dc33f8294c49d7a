"""The table of a fleet: one row for each record, in separate files during a run, and in one Parquet file at its end."""

from __future__ import annotations

import json
import os
import platform
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import IO, Any

import dehyst._io as io
from dehyst._errors import DehystError, FileFormatError
from dehyst._io import PathLike, unwritten
from dehyst._text import counted
from dehyst._version import __version__
from dehyst.fleet.dataset import Task, arrow, text_of
from dehyst.model import Actuator

# Where the record lies in the dataset, and the model as JSON.
PLACE, MODEL = "place", "model"
# The columns of the table after the keys, in their order, and their kinds.
COLUMNS = {
    **dict.fromkeys(("outcome", "detail", "reason"), "text"),
    **dict.fromkeys(("largest_percent", "rms_percent", "expected_percent"), "number"),
    **dict.fromkeys(("noise_nm", "noise_percent", "stroke_um"), "number"),
    **dict.fromkeys(("width25_um", "width50_um", "width75_um", "drift_percent", "cycle_s"), "number"),
    "prior": "text",
    **dict.fromkeys(("held_out_own_percent", "held_out_prior_percent"), "number"),
    "samples": "count",
    "coefficients": "numbers",
    **dict.fromkeys(("version", "sha256"), "text"),
    **dict.fromkeys(("cpu_s", "wall_s", "memory_MB"), "number"),
    **dict.fromkeys((PLACE, MODEL), "text"),
}
# Tables of version 0.1 have no places.
_LATER = (PLACE,)
# Name of the metadata, and rows in memory at a time.
MARK, _AT_A_TIME = b"dehyst-fleet", 1000


@dataclass(frozen=True, eq=False)
class Fleet:
    """The table of a fleet.

    `path`: its file. `by`: names of the keys. `rows`: columns by name, keys among them, without the models. `about`:
    program, options and digest of the run.
    """

    path: Path
    by: tuple[str, ...]
    rows: tuple[Mapping[str, Any], ...]
    about: Mapping[str, Any]

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        good = sum(row["outcome"] == "identified" for row in self.rows)
        return f"<Fleet '{self.path.name}': {len(self)} records, {good} identified>"

    def name(self, row: Mapping[str, Any]) -> str:
        """Return the name of a `row`: its keys."""
        return "/".join(str(row[key]) for key in self.by)

    def actuators(self, where: Callable[[Mapping[str, Any]], bool] | None = None) -> list[Actuator]:
        """Return the identified actuators in the order of the rows, with `where` only for rows for which it is true."""
        return [actuator for _, actuator in self.models(where)]

    def models(
        self, where: Callable[[Mapping[str, Any]], bool] | None = None
    ) -> Iterator[tuple[Mapping[str, Any], Actuator]]:
        """Yield row and actuator of each identified record, with `where` only for rows for which it is true."""
        for k, (row, text) in enumerate(self.texts()):
            if row["outcome"] == "identified" and (where is None or where(row)):
                try:
                    actuator = Actuator.from_dict(json.loads(text or ""))
                except (DehystError, ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
                    raise FileFormatError(
                        f"{self.path}: row {k} ({self.name(row)}): the column '{MODEL}' holds no model ({error}); "
                        "identify the record again"
                    ) from error
                yield row, actuator

    def texts(self) -> Iterator[tuple[Mapping[str, Any], str | None]]:
        """Yield each row and its model as JSON, None without one."""
        with arrow().parquet.ParquetFile(self.path) as file:
            texts = (text for batch in file.iter_batches(100, columns=[MODEL]) for text in batch.column(0).to_pylist())
            yield from zip(self.rows, texts, strict=True)


def load(path: PathLike) -> Fleet:
    """Read the table that `dehyst fleet identify` wrote to `path`; models are read on request.

    Raise `FileFormatError` if the file is not such a table, `MissingExtraError` without pyarrow.
    """
    target = io.path_of(path)
    with io.reading_errors(target, "Parquet"), arrow().parquet.ParquetFile(target) as file:
        marked = (file.schema_arrow.metadata or {}).get(MARK)
        if marked is None:
            raise FileFormatError(f"{path}: is no table of a fleet; give one that dehyst fleet identify wrote")
        about = json.loads(marked)
        io.demand_version(about, f"{path}")
        _demand_columns(target, file.schema_arrow, about["by"])
        names = [name for name in file.schema_arrow.names if name != MODEL]
        rows = tuple(file.read(columns=names, use_threads=False).to_pylist())
    return Fleet(target, tuple(about["by"]), rows, about)


def _demand_columns(path: Path, schema: Any, by: Sequence[str]) -> None:
    """Raise `FileFormatError` if another program has removed a column or changed its kind."""
    if missing := [name for name in (*by, *COLUMNS) if name not in (*schema.names, *_LATER)]:
        raise FileFormatError(
            f"{path}: has no column '{missing[0]}', which dehyst fleet identify wrote; was the table edited? Keep all "
            "its columns, or identify the dataset again"
        )
    types = arrow().types
    fits = {
        "number": (types.is_floating, types.is_integer, types.is_null),
        "text": (types.is_string, types.is_large_string, types.is_null),
    }
    for name in (name for name in COLUMNS if name in schema.names):
        kind = schema.field(name).type
        if not any(check(kind) for check in fits.get(COLUMNS[name], [lambda _: True])):
            raise FileFormatError(
                f"{path}: column '{name}' is of kind {kind}, need {_arrow_kinds()[COLUMNS[name]]}; was the table "
                "edited?"
            )


def _arrow_kinds() -> dict[str, Any]:
    """Return the kinds of columns as Arrow has them."""
    kinds = arrow()
    number = kinds.float64()
    return {"text": kinds.string(), "number": number, "count": kinds.int64(), "numbers": kinds.list_(number)}


def write_table(
    path: Path,
    keys: Mapping[str, Sequence[Any]],
    rows: Iterable[Mapping[str, Any]],
    about: Mapping[str, Any],
    folder: Path,
) -> None:
    """Write rows, as shards hold them, to a table: completely or not at all.

    `keys`: values of all rows by name. `folder`: of the draft, which the next run removes if this one is killed.
    """
    library, remaining, draft = arrow(), iter(rows), io.draft_of(folder / path.name)
    kinds = {name: _kind_of_key(values) for name, values in keys.items()}
    known = _arrow_kinds()
    words = {"program": f"dehyst {__version__}", "by": list(keys), **about}
    columns = kinds | {name: known[kind] for name, kind in COLUMNS.items()}
    schema = library.schema(columns).with_metadata({MARK: json.dumps(words).encode()})
    # Keys of different kinds are text.
    mixed = [name for name, kind in kinds.items() if kind == library.string()]

    def flat(row: Mapping[str, Any]) -> dict[str, Any]:
        model = row.get(MODEL)
        texts = {name: text_of(row.get(name)) for name, kind in COLUMNS.items() if kind == "text"}
        texts |= {name: str(row["keys"][name]) for name in mixed}
        return {**row, **row["keys"], **texts, MODEL: None if model is None else json.dumps(model)}

    try:
        with library.parquet.ParquetWriter(draft, schema, compression="zstd") as writer:
            while block := list(islice(remaining, _AT_A_TIME)):
                writer.write_table(library.Table.from_pylist(list(map(flat, block)), schema=schema))
        io.settle_file(draft)
        io.demand_alike(path, b"PAR1" + MARK)
        draft.replace(path)
        io.settle_folder(path.parent)
    except OSError as error:
        raise unwritten(path, error) from error
    finally:
        draft.unlink(missing_ok=True)


def _kind_of_key(values: Sequence[Any]) -> Any:
    """Return the Arrow kind of a key: text if its values are of different kinds, or too large for 64 bits."""
    kinds, found = arrow(), set(map(type, values))
    if any(isinstance(value, int) and abs(value) >= 2**63 for value in values):
        return kinds.string()
    if found <= {bool}:
        return kinds.bool_()
    if found <= {int}:
        return kinds.int64()
    return kinds.float64() if found <= {int, float} else kinds.string()


_MARKER = ("fleet.json", "dehyst-fleet-parts")
_ROW, _LOCK = "dehyst-fleet-row", "fleet.lock"
# Suffix of the file that has a byte for each trial of a record.
_TRIED = ".tried"


class Shards:
    """The rows of a run that has not written its table: one file for each record, written completely or not at all.

    `folder`: their folder. `digest`: hash of dataset and options; shards with another hash do not belong to this run. A
    shard is named after the place of its record in the dataset, so records may be added or removed.
    """

    def __init__(self, folder: Path, digest: str) -> None:
        self.folder, self.digest, self.marker = folder, digest, folder / _MARKER[0]

    @contextmanager
    def held(self) -> Iterator[None]:
        """Lock the folder, created if necessary, for one run; at the end remove drafts, or without rows the folder.

        Raise `FileFormatError` if another run holds it, or if it holds other files.
        """
        with self._locked():
            try:
                yield
            finally:
                for path in self.folder.rglob(".*"):
                    if io.is_draft(path.name):
                        path.unlink(missing_ok=True)
                if not any(self.files()):
                    self.remove()

    def _locked(self) -> IO[bytes]:
        """Return the open lock of the folder."""
        path = self.folder / _LOCK
        while True:
            try:
                io.make_own_folder(self.folder, *_MARKER)
            except FileFormatError:
                # A run that has just begun, or was killed then, has no marker yet.
                if not path.exists():
                    raise
            try:
                stream = path.open("a+b")
            except FileNotFoundError:
                # The run that had the folder has just removed it.
                continue
            except OSError as error:
                raise unwritten(path, error) from error
            try:
                io.lock(stream.fileno())
            except BlockingIOError as error:
                stream.seek(0)
                who = stream.read(200).decode(errors="replace")
                stream.close()
                raise FileFormatError(
                    f"{self.folder}: another run uses it ({who}); wait for its end, or name another table"
                ) from error
            # It may have been removed, and made anew, before it was locked.
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(stream.fileno()), path.stat()):
                    stream.truncate(0)
                    stream.write(f"process {os.getpid()} on {platform.node()}".encode())
                    stream.flush()
                    return stream
            stream.close()

    @property
    def begun(self) -> bool:
        """Whether the folder belongs to a run that has begun."""
        return self.marker.exists()

    def prepare(self, count: int, options: Mapping[str, Any], *, resume: bool) -> None:
        """Begin, or raise `FileFormatError` if there are foreign shards, or own ones without `resume`."""
        if not self.begun:
            head = {"format": _MARKER[1], "version": 1, "digest": self.digest, "records": count, "options": options}
            io.write_json(self.marker, io.finite(head))
            return
        if not resume:
            done = sum(1 for _ in self.files())
            raise FileFormatError(
                f"{self.folder}: holds {counted(done, 'record')} of a run that did not end; go on with --resume, or "
                "remove the folder"
            )
        head = io.read_json(self.marker)
        if [head.get("format"), head.get("digest")] != [_MARKER[1], self.digest]:
            raise FileFormatError(
                f"{self.folder}: is of another dataset, other options or another version; repeat the command of that "
                "run, or remove the folder"
            )
        for path in self.folder.glob(f"*/*{_TRIED}"):
            path.unlink(missing_ok=True)

    def path(self, task: Task) -> Path:
        """Return the file of a record; a folder with very many files is slow in many file systems."""
        return self.folder / task.code[:2] / f"{task.code}.json"

    def files(self) -> Iterator[Path]:
        """Yield the files of records, named by the `Task.code` of each."""
        return self.folder.glob("*/*.json")

    def read(self, task: Task) -> dict[str, Any] | None:
        """Return the row of a record; None if there is none, or its file is incomplete or from another run."""
        path = self.path(task)
        if not path.is_file():
            return None
        with suppress(FileFormatError):
            row = io.read_json(path)
            if [row.get(name) for name in ("format", "digest", PLACE)] == [_ROW, self.digest, task.within]:
                return row
        return None

    def write(self, task: Task, row: Mapping[str, Any]) -> None:
        """Write the row of a record completely or not at all."""
        path = self._made(task)
        head = {"format": _ROW, "digest": self.digest, PLACE: task.within}
        io.write_atomically(path, json.dumps(io.finite({**head, **row}), allow_nan=False))
        path.with_suffix(_TRIED).unlink(missing_ok=True)

    def trial(self, task: Task) -> int:
        """Count a trial of a record in this run, and return its number; earlier trials ended with their process."""
        path = self._made(task).with_suffix(_TRIED)
        try:
            with path.open("ab") as stream:
                stream.write(b".")
                return stream.tell()
        except OSError as error:
            raise unwritten(path, error) from error

    def _made(self, task: Task) -> Path:
        """Return the file of a record, its folder made if necessary."""
        path = self.path(task)
        try:
            path.parent.mkdir(exist_ok=True)
        except OSError as error:
            raise unwritten(path.parent, error) from error
        return path

    def remove(self) -> None:
        """Remove the folder, once the table holds its rows."""
        for path in self.folder.glob("*/"):
            shutil.rmtree(path, ignore_errors=True)
        # Marker and lock last: a run that is killed before has left a folder to resume.
        shutil.rmtree(self.folder, ignore_errors=True)
