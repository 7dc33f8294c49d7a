"""One record of a dataset at a time, in SI units, by the rules of columns that `dehyst.read` has."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dehyst._errors import DehystError, FileFormatError, IdentifyError
from dehyst._io import reading_errors
from dehyst._version import __version__
from dehyst.fleet.dataset import Place, Task, pyarrow_parquet, zarr
from dehyst.records import Record, read
from dehyst.records.files import record_of
from dehyst.records.formats.columns import Column, Table, without_groups
from dehyst.records.formats.containers import arrow_columns, is_readable, vectors
from dehyst.records.tables import Choice

STRUCTURES = ("maxwell_slip", "auto")


@dataclass(frozen=True)
class FleetOptions:
    """How every record is identified.

    Parameters
    ----------
    structure : str
        "maxwell_slip": slip elements and a spring. "auto": parts selected by cross-validation, as `dehyst.identify`.
    elements : int, optional
        Number of slip elements of "maxwell_slip".
    norm : str
    drift : bool
    delay : float, optional
        Lag of the displacement [s]; default: estimated from each record.
    time, voltage, displacement, voltage_scale, displacement_scale : str, optional
        Columns, as in `dehyst.read`.
    sample_rate : float, optional
        [Hz], for records without a time.
    decimal : str, optional
        "," or ".": the decimal sign of text files, as in `dehyst.read`.
    prior : mapping, optional
        A shape of an identified fleet, see `dehyst.fleet.prior`.

    Raises
    ------
    IdentifyError
        If an option is impossible.
    """

    structure: Literal["maxwell_slip", "auto"] = "maxwell_slip"
    elements: int | None = None
    norm: str = "l1"
    drift: bool = True
    delay: float | None = None
    time: str | None = None
    voltage: str | None = None
    displacement: str | None = None
    voltage_scale: str | None = None
    displacement_scale: str | None = None
    sample_rate: float | None = None
    decimal: str | None = None
    prior: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        if self.structure not in STRUCTURES:
            raise IdentifyError(argument="structure", got=repr(self.structure), need="'maxwell_slip' or 'auto'")
        if self.structure == "auto" and (self.elements is not None or self.prior is not None):
            raise IdentifyError("structure: 'auto' takes neither elements nor a prior; leave them out")

    @property
    def columns(self) -> dict[str, Any]:
        """The arguments of `dehyst.read`."""
        names = ("time", "voltage", "displacement", "voltage_scale", "displacement_scale", "sample_rate", "decimal")
        return {name: getattr(self, name) for name in names if getattr(self, name) is not None}

    @property
    def identification(self) -> dict[str, Any]:
        """The arguments of `dehyst.identify`."""
        counted = self.structure == "maxwell_slip"
        given = {"structure": self.structure, "norm": self.norm, "drift": self.drift}
        return {**given, "delay": self.delay, **({"elements": self.elements} if counted else {})}

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)

    def digest(self, dataset: str) -> str:
        """Return the hash of the digest of a `dataset`, these options and the version."""
        text = json.dumps([dataset, self.as_dict(), __version__], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


class Reader:
    """A reader of records that keeps the last file open: a worker reads one dataset."""

    def __init__(self) -> None:
        self._key: tuple[str, tuple[int, ...]] = ("", ())
        self._open: Any = None

    def record(self, task: Task, options: FleetOptions) -> Record:
        """Return the record of a task; raise `FileFormatError` or `RecordError` if there is none."""
        place = task.place
        with reading_errors(Path(place.path), place.kind):
            if place.kind == "file":
                _demand_file(Path(place.path))
                return replace(read(place.path, **options.columns), name=task.name)
            columns = self._row_group(place) if place.kind == "parquet" else self._group(place)
            table = Table(f"{Path(place.path).name}[{place.part}]", "", tuple(columns))
            names = {key: value for key, value in options.columns.items() if key in Choice._fields}
            return record_of(table, Choice(**names), task.name)

    def _row_group(self, place: Place) -> list[Column]:
        parquet = pyarrow_parquet()
        # A worker that outlives a run must not read a file that was replaced since.
        state = Path(place.path).stat()
        key = place.path, (state.st_mtime_ns, state.st_ctime_ns, state.st_ino)
        if self._key != key:
            self._key, self._open = key, parquet.ParquetFile(place.path, pre_buffer=False)
        file: Any = self._open
        wanted = [field.name for field in file.schema_arrow if is_readable(field.type)]
        table = file.read_row_group(int(place.part), columns=wanted, use_threads=False)
        return [without_groups(column) for column in arrow_columns(table)]

    def _group(self, place: Place) -> list[Column]:
        if self._key != (place.path, ()):
            self._key, self._open = (place.path, ()), zarr().open_group(place.path, mode="r")
        root: Any = self._open
        group = root[place.part] if place.part else root
        columns: list[Column] = []
        for name, array in group.arrays():
            unit = str(array.attrs.get("units", array.attrs.get("unit", "")))
            if array.ndim == 1:
                columns += vectors(name, array[:], unit)
        if not columns:
            raise FileFormatError(f"{place.path}[{place.part}]: holds no array of numbers")
        return columns


def _demand_file(path: Path) -> None:
    """Refuse what cannot be read to its end, as a pipe, or at all."""
    if path.is_symlink() and not path.exists():
        raise FileFormatError(f"{path}: is a link to nowhere ({path.readlink()}); mend or remove it")
    if path.exists() and not path.is_file():
        raise FileFormatError(f"{path}: is no file of records (a pipe or a device); remove it from the dataset")


def sha256_of(record: Record) -> str:
    """Return the hash of a record's samples: time, voltage and displacement as little-endian doubles."""
    state = hashlib.sha256()
    for column in (record.time, record.voltage, record.displacement):
        state.update(np.ascontiguousarray(column, dtype="<f8").tobytes())
    return state.hexdigest()


# Column of a shard: the stamp of the place when its record was read.
STAMP = "stamp"


def stamp_of(place: Place) -> str | None:
    """Return what tells the files of a place from other or changed ones without reading them; None if not visible.

    Size and time of change are not enough: a program can set the time, as `cp -p` does. The number of the file and the
    time when its entry changed, which no program sets, cost nothing more. Where they differ, the samples are compared.
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


def digest_of(texts: Iterable[str | None]) -> str:
    """Return the hash of texts."""
    state = hashlib.sha256()
    for text in texts:
        state.update(f"{text}\n".encode(errors="surrogateescape"))
    return state.hexdigest()


def is_current(row: Mapping[str, Any], task: Task, options: FleetOptions, reader: Reader) -> bool:
    """Return whether a row is that of the record as it is now; the record is read only if its files have changed."""
    if row.get("keys") != dict(task.keys):
        return False
    stamp = stamp_of(task.place)
    if stamp is not None and stamp == row.get(STAMP):
        return True
    if not row.get("sha256"):
        return False
    try:
        return sha256_of(reader.record(task, options)) == str(row["sha256"])
    except DehystError:
        return False
