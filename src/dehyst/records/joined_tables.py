"""Two files of one measurement, for instance one of each channel, as one table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._types import Array
from dehyst.records.formats.columns import Table

# Part of a sample by which the times of two files may differ and are still the same.
_SAME = 0.01


def joined(table: Table, other: Table, time: str | None, sample_rate: float | None) -> Table:
    """Return a table with the columns of both, on the samples of the first.

    Where both have a time column and the times differ, the columns of the other are interpolated in straight lines, and
    samples before its first or after its last are left out. Otherwise sample belongs to sample. Names of the other
    follow the name of its file: other/displacement_um.

    `time`: name of the time column, by default found. `sample_rate`: given instead of a time column [Hz].

    Raises
    ------
    FileFormatError
        Without two time columns: the files differ in length. With them: the times do not rise or do not overlap.
    """
    first, second = (None if sample_rate is not None else _time(one, time) for one in (table, other))
    stem = other.source.rsplit(".", 1)[0]
    added = [replace(c, name=f"{stem}/{c.name}") for c in other.columns if second is None or c.name != second[0]]
    samples, more = (max((c.data.size for c in one.columns), default=0) for one in (table, other))
    if first is None or second is None or _alike(first[1], second[1]):
        if samples != more:
            raise FileFormatError(
                f"join: got {samples} samples in {table.source} and {more} in {other.source}, need as many, or a time "
                "column in both; cut one of them, or save it with its time"
            )
        return replace(table, columns=(*table.columns, *added))
    _refuse_unordered(table, first[1])
    _refuse_unordered(other, second[1])
    inside = (first[1] >= second[1][0]) & (first[1] <= second[1][-1])
    if np.count_nonzero(inside) < 2:
        raise FileFormatError(
            f"join: {table.source} lasts from {first[1][0]:.6g} to {first[1][-1]:.6g} s and {other.source} from "
            f"{second[1][0]:.6g} to {second[1][-1]:.6g} s, need times in common; correct one of them, or give "
            "sample_rate= for a file without its time column"
        )
    kept = [replace(c, data=c.data[inside]) if not c.fault else c for c in table.columns]
    moved = [replace(c, data=np.interp(first[1][inside], second[1], c.data)) if not c.fault else c for c in added]
    return replace(table, columns=(*kept, *moved))


def _time(table: Table, wanted: str | None) -> tuple[str, Array] | None:
    """Return the name and the seconds of the time column; None if there is none."""
    for name in (wanted, None):
        try:
            return table.find("time", name)[0].name, table.column("time", name)
        except FileFormatError:
            continue
    return None


def _alike(first: Array, second: Array) -> bool:
    if first.size != second.size or first.size < 2:
        return first.size == second.size
    step = float(np.median(np.abs(np.diff(first))))
    return bool(np.all(np.abs(first - second) <= _SAME * step))


def _refuse_unordered(table: Table, time: Array) -> None:
    if not np.all(np.diff(time) > 0):
        raise FileFormatError(f"{table.source}: the time does not rise, which joining needs; correct those rows")
