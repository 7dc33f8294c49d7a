"""One record of a dataset at a time, in SI units, by the rules of columns that `dehyst.read` has."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._io.reading import reading_errors
from dehyst.fleet.dataset import Place, Task
from dehyst.fleet.needed import pyarrow_parquet, zarr
from dehyst.fleet.options import FleetOptions
from dehyst.records import Record, read
from dehyst.records.column_choice import Choice
from dehyst.records.files import record_of
from dehyst.records.formats.columns import Column, Table, without_groups
from dehyst.records.formats.containers import arrow_numbers, vectors


class Reader:
    """A reader of records that keeps the last file open: a worker reads one dataset."""

    def __init__(self) -> None:
        self._key, self._open = ("", 0), None

    def record(self, task: Task, options: FleetOptions) -> Record:
        """Return the record of a task; raise `FileFormatError` or `RecordError` if there is none."""
        place = task.place
        with reading_errors(Path(place.path), place.kind):
            if place.kind == "file":
                return replace(read(place.path, **options.columns), name=task.name)
            columns = self._row_group(place) if place.kind == "parquet" else self._group(place)
            table = Table(f"{Path(place.path).name}[{place.part}]", "", tuple(columns))
            names = {key: value for key, value in options.columns.items() if key in Choice._fields}
            return record_of(table, Choice(**names), options.sample_rate, task.name)

    def _row_group(self, place: Place) -> list[Column]:
        parquet = pyarrow_parquet()
        # A worker that outlives a run must not read a file that was replaced since.
        key = place.path, Path(place.path).stat().st_mtime_ns
        if self._key != key:
            self._key, self._open = key, parquet.ParquetFile(place.path, pre_buffer=False)
        file: Any = self._open
        wanted = [field.name for field in file.schema_arrow if str(field.type) in _NUMBERS]
        table = file.read_row_group(int(place.part), columns=wanted, use_threads=False)
        columns = [
            Column(name, np.concatenate([arrow_numbers(chunk) for chunk in values.chunks] or [np.empty(0)]))
            for name, values in zip(table.column_names, table.columns, strict=True)
        ]
        return [without_groups(column) for column in columns if column.data.size > 1]

    def _group(self, place: Place) -> list[Column]:
        if self._key != (place.path, 0):
            self._key, self._open = (place.path, 0), zarr().open_group(place.path, mode="r")
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


_NUMBERS = frozenset(
    ("float", "double", "halffloat", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)))
)


def sha256_of(record: Record) -> str:
    """Return the hash of a record's samples: time, voltage and displacement as little-endian doubles."""
    state = hashlib.sha256()
    for column in (record.time, record.voltage, record.displacement):
        state.update(np.ascontiguousarray(column, dtype="<f8").tobytes())
    return state.hexdigest()
