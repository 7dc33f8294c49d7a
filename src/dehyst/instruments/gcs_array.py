"""The answer of a data recorder: a GCS array, which is a header of `# KEY = value` lines and rows of numbers."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dehyst._errors import LinkError
from dehyst._types import Array
from dehyst.instruments import gcs_syntax

_HEADER = re.compile(r"#\s*([A-Z_]+)(\d*)\s*=\s*(.*)")
_END = "# END_HEADER"


class GcsArray(NamedTuple):
    """A GCS array.

    `sample_time`: [s] from one row to the next. `names`: name of each column; empty where the header has none.
    `columns` (k, n): in the controller's units.
    """

    sample_time: float
    names: tuple[str, ...]
    columns: Array


def table(lines: Sequence[str], rows: int, columns: int) -> GcsArray:
    """Parse an answer of DRR? that has `rows` rows and `columns` columns.

    Raise `LinkError` if the header is incomplete or has other sizes, or a row is not `columns` finite numbers.
    """
    stripped = [line.strip() for line in lines]
    if _END not in stripped:
        raise LinkError(f"got {gcs_syntax.shown(lines)}, need an array with a header that ends {_END}")
    end = stripped.index(_END)
    header = _header(stripped[:end])
    for key, needed in (("TYPE", 1), ("DIM", columns), ("NDATA", rows)):
        size = gcs_syntax.integer(header.get(key, ""))
        if size != needed:
            raise LinkError(f"got an array with {key} = {size}, need {needed}")
    sample_time = gcs_syntax.real(header.get("SAMPLE_TIME", ""))
    if sample_time <= 0:
        raise LinkError(f"got an array with SAMPLE_TIME = {sample_time}, need a time above 0 s")
    separator = gcs_syntax.integer(header.get("SEPARATOR", "32"))
    if separator not in {9, 32, 44, 59}:
        raise LinkError(f"got an array with SEPARATOR = {separator}, need 32 (space), 9, 44 or 59")
    body = stripped[end + 1 :]
    if len(body) != rows:
        raise LinkError(f"got an array of {len(body)} rows, need {rows}; was the answer cut?")
    names = tuple(header.get(f"NAME{index}", "") for index in range(columns))
    return GcsArray(sample_time, names, _numbers(body, columns, chr(separator)))


def positions_and_voltages(array: GcsArray) -> tuple[Array, Array]:
    """Return positions and voltages (n, axes) of pairs of columns: by their names, else in the requested order."""
    kinds = [("position" in name.lower(), "voltage" in name.lower()) for name in array.names]
    positions, voltages = [], []
    for first in range(0, len(kinds), 2):
        turned = kinds[first : first + 2] == [(False, True), (True, False)]
        positions.append(array.columns[first + turned])
        voltages.append(array.columns[first + (not turned)])
    return np.column_stack(positions), np.column_stack(voltages)


def _header(lines: Sequence[str]) -> dict[str, str]:
    header: dict[str, str] = {}
    for line in lines:
        if not line.startswith("#"):
            raise LinkError(f"got {gcs_syntax.shown(line)} in the header of an array, need lines that begin with #")
        match = _HEADER.fullmatch(line)
        if match is None:
            continue
        key = match.group(1) + match.group(2)
        if key in header:
            raise LinkError(f"got {key} twice in the header of an array")
        header[key] = match.group(3).strip()
    return header


def _numbers(body: Sequence[str], columns: int, separator: str) -> Array:
    """Return rows of text as numbers (columns, n)."""
    numbers = np.empty((len(body), columns))
    for index, line in enumerate(body):
        words = line.split(None if separator in " \t" else separator)
        if len(words) != columns:
            raise LinkError(f"got the row {gcs_syntax.shown(line)}, need {columns} numbers")
        numbers[index] = [gcs_syntax.real(word.strip()) for word in words]
    return np.ascontiguousarray(numbers.T)
