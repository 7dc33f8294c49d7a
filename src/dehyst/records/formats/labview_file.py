"""LabVIEW measurement files (.lvm): two headers, one of the file and one of its segment, and rows of numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dehyst._errors import FileFormatError
from dehyst.records.formats.columns import Column
from dehyst.records.formats.file_content import Allowance
from dehyst.records.formats.table_layout import Layout
from dehyst.records.formats.text_table import Text, columns_below, text_of

_MAGIC, _END = b"LabVIEW Measurement", b"***End_of_Header***"


def is_labview(data: bytes) -> bool:
    """Return whether a text is a LabVIEW measurement file."""
    return data.lstrip(b"\xef\xbb\xbf").startswith(_MAGIC)


def read_labview(data: bytes, allowance: Allowance) -> list[Column]:
    """Read the segment of a LabVIEW measurement file: its channels with their units, and their time.

    Raises
    ------
    FileFormatError
        A header without its end, or more than one segment.
    """
    text = text_of(data, allowance)
    parts = text.data.split(_END)
    if len(parts) != 3:
        count = max(len(parts) - 2, 0)
        raise FileFormatError(
            f"{allowance.path}: got {count} segments of a LabVIEW measurement, need 1; save each in a file of its own"
        )
    comma = "\nSeparator\tComma" in parts[0].decode(text.encoding) or b"\nSeparator,Comma" in parts[0]
    sign = "," if comma else "\t"
    segment = {cells[0]: cells[1:] for cells in _lines(parts[1], text, sign)}
    body = parts[2].partition(b"\n")[2]
    head, _, rows = body.partition(b"\n")
    names = [cell.strip() for cell in head.decode(text.encoding).split(sign)]
    names = names[: names.index("Comment")] if "Comment" in names else names
    cut = sign.encode()
    rows = b"\n".join(cut.join(line.split(cut)[: len(names)]) for line in rows.split(b"\n") if line.strip())
    first = text.data[: len(text.data) - len(body)].count(b"\n") + 1
    table = Layout(0, first, sign, tuple(names), (), "")
    columns = columns_below(text._replace(data=rows), table, allowance)
    return _with_units(columns, segment)


def _lines(part: bytes, text: Text, sign: str) -> list[list[str]]:
    lines = part.decode(text.encoding).split("\n")
    return [[cell.strip() for cell in line.split(sign)] for line in lines if line.strip()]


def _with_units(columns: list[Column], segment: dict[str, list[str]]) -> list[Column]:
    """Return the channels with their units, after the time of the first; its values, if given, come from its step."""
    channels = [column for column in columns if column.name != "X_Value"]
    times = [column for column in columns if column.name == "X_Value"]
    units = [*segment.get("Y_Unit_Label", []), *[""] * len(channels)]
    channels = [replace(column, unit=unit) for column, unit in zip(channels, units, strict=False)]
    timed = segment.get("X_Dimension", ["Time"])[:1] == ["Time"]
    clock = times[0].data if times else np.empty(0)
    if times and np.isfinite(clock).all() and clock.size:
        return [Column("time", clock, "s" if timed else ""), *channels]
    try:
        start, step = (float(segment[key][0].replace(",", ".")) for key in ("X0", "Delta_X"))
    except (KeyError, IndexError, ValueError):
        return channels
    with np.errstate(all="ignore"):
        return [Column("time", start + step * np.arange(float(len(channels[0].data))), "s" if timed else ""), *channels]
