"""The records of a dataset: an index of places and keys, made without loading measurements, and a reader."""

from __future__ import annotations

import hashlib
import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dehyst._errors import DehystError, FileFormatError, library
from dehyst._io import PathLike, path_of, reading_errors
from dehyst.records import (
    LOADERS,
    Choice,
    Column,
    Record,
    Table,
    arrow_columns,
    is_readable,
    listed,
    read,
    record_of,
    vectors,
    without_groups,
)

# Name of the key where none is asked for.
RECORD = "record"
# Column of a row: the stamp of its place when the record was read.
STAMP = "stamp"
# A lone surrogate, which stands for a byte of a name that is not UTF-8, or what its escape looks like.
_SURROGATE = re.compile(r"[\ud800-\udfff]|\\ud[89a-f]")


def arrow() -> Any:
    """Return pyarrow, its Parquet module loaded."""
    library("pyarrow.parquet", "A Parquet dataset or a table of a fleet", "fleet")
    return library("pyarrow", "A table of a fleet", "fleet")


def _zarr_group(path: str) -> Any:
    return library("zarr", "A Zarr dataset", "fleet").open_group(path, mode="r")


class Place(NamedTuple):
    """Place of a record: `kind` is "parquet", "zarr" or "file"; `part` is the row group or the group."""

    kind: str
    path: str
    part: str = ""


@dataclass(frozen=True)
class Task:
    """One record of a dataset: its `position`, its `keys` by name, its `place`, and `within`, its place in the dataset.

    `within` is plain text and unique in the dataset.
    """

    position: int
    keys: Mapping[str, Any]
    place: Place
    within: str = ""

    @property
    def name(self) -> str:
        """The name of the record: its keys."""
        return "/".join(str(value) for value in self.keys.values())

    @property
    def code(self) -> str:
        """The name of the files of this record, the same in every run over its dataset."""
        return code_of(self.within)


def code_of(within: str) -> str:
    """Return the `Task.code` of a place within a dataset."""
    return hashlib.sha256(within.encode()).hexdigest()[:32]


@dataclass(frozen=True)
class Dataset:
    """The records of a dataset.

    `path`: its absolute path. `by`: the names of the keys. `tasks`: in the dataset's order. `digest`: hash of its name,
    its kind and the names of the keys. It does not depend on the records, whose contents have their own hashes.
    """

    path: Path
    by: tuple[str, ...]
    tasks: tuple[Task, ...] = field(repr=False)
    digest: str

    def __len__(self) -> int:
        return len(self.tasks)

    @property
    def remarks(self) -> tuple[str, ...]:
        """A sentence if records have the same keys."""
        names = Counter(task.name for task in self.tasks)
        if len(names) == len(self.tasks):
            return ()
        (name, count), *_ = names.most_common(1)
        total = sum(count for count in names.values() if count > 1)
        return (
            f"{total} of {len(self)} records share their keys ({', '.join(self.by)}) with another, as {name} ({count} "
            "records); add a key in which they differ",
        )


def open_dataset(path: PathLike, by: Sequence[str] = ()) -> Dataset:
    """Return the index of a Parquet file, a Zarr store or a folder of files.

    `path`: a Parquet file, in which each row group is a record; a Zarr store, in which each group with arrays is a
    record; or a folder, in which each file that `dehyst.read` opens, and each row group of its Parquet files, is a
    record.

    `by`: names of the keys. In Parquet they are columns, constant within a row group; in Zarr attributes of the group
    or the parts of its path; in a folder the sub-folders and the file's name, or parts of the name between "_".
    Default: one key, "record".

    Raise `FileFormatError` if the dataset does not exist, has no records, or lacks the keys;
    `MissingExtraError` if pyarrow or zarr is not installed.
    """
    target, wanted = path_of(path).absolute(), tuple(by)
    if len(set(wanted)) < len(wanted) or not all(wanted):
        raise FileFormatError(
            argument="by", got=repr(", ".join(by)), need="different names of keys, as 'serial,session'"
        )
    if not target.exists():
        raise FileFormatError(f"{path}: no such dataset; give a Parquet file, a Zarr store or a folder of records")
    with reading_errors(target, "dataset"):
        kind, places = _places(target, wanted)
        found = list(places)
    if not found:
        raise FileFormatError(f"{path}: holds no record; need Parquet row groups, Zarr groups or files of records")
    tasks = []
    for k, (keys, place) in enumerate(found):
        file = Path(place.path)
        relative = text_of(file.name if file == target else file.relative_to(target).as_posix())
        within = f"{relative}[{text_of(place.part)}]" if place.part else relative
        tasks.append(Task(k, {name: text_of(value) for name, value in keys.items()}, place, within))
    text = json.dumps([target.name, kind, wanted])
    return Dataset(target, wanted or (RECORD,), tuple(tasks), hashlib.sha256(text.encode()).hexdigest())


def text_of(value: Any) -> Any:
    """Return text with an escape for each lone surrogate, so that it is valid UTF-8; other values unchanged.

    Different texts stay different: backslashes are doubled in a text with escapes or with something like an escape.
    """
    if not isinstance(value, str) or not _SURROGATE.search(value):
        return value
    return value.replace("\\", "\\\\").encode(errors="backslashreplace").decode()


_Found = Iterator[tuple[dict[str, Any], Place]]


def _places(target: Path, by: tuple[str, ...]) -> tuple[str, _Found]:
    """Return the kind of a dataset, and an iterator over keys and place of each record."""
    if target.is_file():
        if target.suffix.lower() != ".parquet":
            raise FileFormatError(f"{target}: is no dataset; give a .parquet file, a Zarr store or a folder")
        return "file", _row_groups(target, by)
    if any((target / name).exists() for name in ("zarr.json", ".zgroup", ".zmetadata")):
        return "zarr", _groups(target, by)
    return "folder", _files(target, by)


def _row_groups(path: Path, by: tuple[str, ...]) -> _Found:
    """Yield the row groups of a Parquet file: keys come from the statistics, else from the key columns alone."""
    with arrow().parquet.ParquetFile(path) as file:
        names = file.schema_arrow.names
        if missing := [name for name in by if name not in names]:
            raise FileFormatError(
                f"{path}: has no column {listed(tuple(missing))} for --by; it holds {listed(tuple(names))}"
            )
        leaves = [file.metadata.schema.column(k).path for k in range(file.metadata.num_columns)]
        for group in range(file.metadata.num_row_groups):
            keys = {name: _constant(file, group, name, leaves.index(name)) for name in by}
            yield keys or {RECORD: group}, Place("parquet", str(path), str(group))


def _constant(file: Any, group: int, name: str, column: int) -> Any:
    """Return the one value of a key column in a row group, as a JSON value."""
    statistics = file.metadata.row_group(group).column(column).statistics
    if statistics is not None and statistics.has_min_max and not statistics.null_count:
        values = {statistics.min, statistics.max}
    else:
        values = set(file.read_row_group(group, columns=[name], use_threads=False).column(0).unique().to_pylist())
    if len(values) != 1 or None in values:
        shown = ", ".join(sorted(map(repr, values))[:3])
        raise FileFormatError(
            f"row group {group}: column '{name}' has the values {shown}, need one; write each record as a row group of "
            "its own"
        )
    return _json_value(values.pop())


def _json_value(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.decode(errors="surrogateescape")
    return value if isinstance(value, str | int | float | bool) else str(value)


def _groups(path: Path, by: tuple[str, ...]) -> _Found:
    """Yield the groups of a Zarr store that hold arrays."""
    store = _zarr_group(str(path))
    groups = sorted({name.rpartition("/")[0] for name, item in store.members(max_depth=None) if hasattr(item, "shape")})
    for name in groups:
        attributes = dict(store.attrs if not name else store[name].attrs)
        parts = tuple(part for part in name.split("/") if part)
        yield _keys_of(parts, by, name or path.stem, attributes), Place("zarr", str(path), name)


def _files(folder: Path, by: tuple[str, ...]) -> _Found:
    """Yield the files below a folder that `dehyst.read` opens, by name; hidden ones are left out.

    An entry with such a name that is not a file, such as a broken link, is a record too, which its reader refuses.
    """
    for path in sorted(folder.rglob("*")):
        relative = path.relative_to(folder)
        hidden = any(part.startswith(".") for part in relative.parts)
        if hidden or path.suffix.lower() not in LOADERS or path.is_dir():
            continue
        columns: set[str] = set()
        if path.suffix.lower() == ".parquet" and by:
            with suppress(OSError, ValueError):
                columns = set(arrow().parquet.read_schema(path).names)
        if by and columns.issuperset(by):
            yield from _row_groups(path, by)
            continue
        parts = (*relative.parent.parts, relative.stem)
        yield _keys_of(parts, by, relative.with_suffix("").as_posix(), {}), Place("file", str(path))


def _keys_of(parts: tuple[str, ...], by: tuple[str, ...], whole: str, attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of a record from its attributes, else from the parts of its path, else of its name."""
    if not by:
        return {RECORD: whole}
    pairs = dict(part.split("=", 1) for part in parts if "=" in part) | dict(attributes)
    if all(name in pairs for name in by):
        return {name: _json_value(pairs[name]) for name in by}
    pieces = parts if len(parts) == len(by) else (*parts[:-1], *parts[-1].split("_")) if parts else ()
    if len(pieces) != len(by):
        raise FileFormatError(
            f"{whole}: has {len(pieces)} parts, but --by names {len(by)} keys ({', '.join(by)}); need a sub-folder or "
            "a part of the name between '_' for each"
        )
    return dict(zip(by, pieces, strict=True))


class Reader:
    """A reader of records in SI units, by the rules of columns of `dehyst.read`; it keeps the last file open.

    `columns`: arguments of `dehyst.read`.
    """

    def __init__(self, columns: Mapping[str, Any]) -> None:
        self._columns, self._key = columns, ("", "")
        self._open: Any = None

    def record(self, task: Task) -> Record:
        """Return the record of a task; raise `FileFormatError` or `RecordError` if it cannot be read."""
        place = task.place
        path = Path(place.path)
        with reading_errors(path, place.kind):
            if place.kind == "file":
                # What cannot be read to its end, or at all.
                if path.is_symlink() and not path.exists():
                    raise FileFormatError(f"{path}: is a link to nowhere ({path.readlink()}); mend or remove it")
                if path.exists() and not path.is_file():
                    raise FileFormatError(
                        f"{path}: is no file of records (a pipe or a device); remove it from the dataset"
                    )
                return replace(read(place.path, **self._columns), name=task.name)
            columns = self._row_group(place) if place.kind == "parquet" else self._group(place)
            names = {name: value for name, value in self._columns.items() if name in Choice._fields}
            return record_of(Table(f"{path.name}[{place.part}]", "", tuple(columns)), Choice(**names), task.name)

    def is_current(self, row: Mapping[str, Any], task: Task) -> bool:
        """Return whether a row is up to date with its record, which is read only if its files have changed."""
        if row.get("keys") != dict(task.keys):
            return False
        stamp = stamp_of(task.place)
        if stamp is not None and stamp == row.get(STAMP):
            return True
        try:
            return bool(row.get("sha256")) and sha256_of(self.record(task)) == str(row["sha256"])
        except DehystError:
            return False

    def _row_group(self, place: Place) -> list[Column]:
        # A worker that outlives a run must not read a file that was replaced since.
        key = place.path, _stamp(Path(place.path))
        if self._key != key:
            self._key, self._open = key, arrow().parquet.ParquetFile(place.path, pre_buffer=False)
        wanted = [field.name for field in self._open.schema_arrow if is_readable(field.type)]
        table = self._open.read_row_group(int(place.part), columns=wanted, use_threads=False)
        return [without_groups(column) for column in arrow_columns(table)]

    def _group(self, place: Place) -> list[Column]:
        key = place.path, ""
        if self._key != key:
            self._key, self._open = key, _zarr_group(place.path)
        group = self._open[place.part] if place.part else self._open
        columns: list[Column] = []
        for name, array in group.arrays():
            unit = str(array.attrs.get("units", array.attrs.get("unit", "")))
            if array.ndim == 1:
                columns += vectors(name, array[:], unit)
        if not columns:
            raise FileFormatError(f"{place.path}[{place.part}]: holds no array of numbers")
        return columns


def sha256_of(record: Record) -> str:
    """Return the hash of a record's samples: time, voltage and displacement as little-endian doubles."""
    state = hashlib.sha256()
    for column in (record.time, record.voltage, record.displacement):
        state.update(np.ascontiguousarray(column, dtype="<f8").tobytes())
    return state.hexdigest()


def stamp_of(place: Place) -> str | None:
    """Return a stamp of the files of a place, which differs if they have changed; None if not available.

    Size and modification time are not enough, because a program can set the time, as `cp -p` does. The stamp also has
    the number of the file and the time of its last change of status, which programs cannot set. If stamps differ, the
    samples are compared.
    """
    path = Path(place.path)
    try:
        if place.kind != "zarr":
            return _stamp(path)
        root = path / place.part
        files = sorted(file for file in root.rglob("*") if file.is_file())
        return digest_of(f"{file.relative_to(root)} {_stamp(file)}" for file in files)
    except OSError:
        return None


def _stamp(path: Path) -> str:
    state = path.stat()
    return f"{state.st_size} {state.st_mtime_ns} {state.st_ino} {state.st_ctime_ns}"


def digest_of(texts: Iterable[str]) -> str:
    """Return the hash of texts."""
    state = hashlib.sha256()
    for text in texts:
        state.update(f"{text}\n".encode(errors="surrogateescape"))
    return state.hexdigest()
