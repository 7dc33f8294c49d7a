"""Files of PI's data recorders: a GCS array, a header of `# KEY = value` lines and rows of numbers."""

from __future__ import annotations

import re

import numpy as np

from dehyst._errors import FileFormatError
from dehyst.records.formats.columns import Column, shortened
from dehyst.records.formats.file_content import Allowance
from dehyst.records.formats.table_layout import Layout
from dehyst.records.formats.text_table import columns_below, text_of

_END = re.compile(rb"(?m)^#[ \t]*END_HEADER[ \t\r]*$")
_ENTRY = re.compile(r"#\s*([A-Z_]+\d*)\s*=\s*(.*)")
# The header of an array is shorter [bytes].
_HEAD = 50_000


def is_gcs(data: bytes) -> bool:
    """Return whether a text is a GCS array."""
    return _END.search(data, 0, _HEAD) is not None


def read_gcs(data: bytes, allowance: Allowance) -> list[Column]:
    """Read a GCS array: its columns by the names in the header, and their time by its sample time.

    The header states no units.

    Raises
    ------
    FileFormatError
        The separator is unknown, the sample time is no positive number, or the rows are no table.
    """
    text = text_of(data, allowance)
    end = _END.search(text.data)
    if end is None:
        raise FileFormatError(f"{allowance.path}: got no line # END_HEADER, need one before the rows; record again")
    lines = text.data[: end.start()].decode(text.encoding).split("\n")
    header = {match[1]: match[2].strip() for line in lines if (match := _ENTRY.fullmatch(line.strip()))}
    separator = {"9": "\t", "32": None, "44": ",", "59": ";"}.get(header.get("SEPARATOR", "32"), "")
    if separator == "":
        raise FileFormatError(
            f"{allowance.path}: got SEPARATOR = {shortened(header['SEPARATOR'])}, need 32 (space), 9, 44 or 59; record "
            "again"
        )
    start = min(end.end() + 1, len(text.data))
    row = text.data[start : start + 10_000].lstrip().split(b"\n")[0].decode(text.encoding)
    names = tuple(header.get(f"NAME{k}") or f"column {k + 1}" for k in range(len(row.split(separator))))
    columns = columns_below(text, Layout(start, len(lines), separator, names, (), row), allowance)
    return [*_clock(header, columns, allowance), *columns]


def _clock(header: dict[str, str], columns: list[Column], allowance: Allowance) -> list[Column]:
    """Return the time column; none if the header states no sample time."""
    if "SAMPLE_TIME" not in header:
        return []
    try:
        step = float(header["SAMPLE_TIME"])
    except ValueError:
        step = 0.0
    if not 0 < step < float("inf"):
        stated = shortened(header["SAMPLE_TIME"])
        raise FileFormatError(f"{allowance.path}: got SAMPLE_TIME = {stated}, need a time above 0 s; record again")
    samples = len(columns[0].data)
    allowance.take(samples, "the time of its samples")
    return [Column("time", np.arange(float(samples)) * step, "s")]
