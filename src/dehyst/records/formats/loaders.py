"""The readable formats, the reading of a file within a bound of its size, and tables that are read as plain text.

The last are GCS arrays of PI and Excel sheets (.xlsx): they keep their line numbers, which messages name.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import replace
from itertools import zip_longest
from math import inf, nan
from typing import Any, BinaryIO

import numpy as np

from dehyst._errors import FileFormatError
from dehyst.records.formats import containers
from dehyst.records.formats.column import TEXT, Allowance, Column, shortened
from dehyst.records.formats.notation import is_number, number_in
from dehyst.records.formats.text_table import read_text

GCS_END = "# END_HEADER"
# The separators of a GCS array by their number; None: blanks.
GCS_SEPARATORS = {"9": "\t", "32": None, "44": ",", "59": ";"}
_END = re.compile(rb"(?m)^#[ \t]*END_HEADER[ \t\r]*\n\s*")
_ENTRY = re.compile(r"#\s*([A-Z_]+\d*)\s*=\s*(.*)")


def gcs_entries(lines: Iterable[str]) -> list[tuple[str, str]]:
    """Return keys and values of the header of a GCS array."""
    return [(match[1], match[2].strip()) for line in lines if (match := _ENTRY.fullmatch(line.strip()))]


def read_gcs(stream: BinaryIO, allowance: Allowance) -> list[Column]:
    """Read a GCS array: columns by the names in its header, and the time by its sample time; it states no units."""
    above, rows = _END.split(stream.read(), maxsplit=1)
    lines = above.decode("latin-1").split("\n")
    header = dict(gcs_entries(lines))
    separator, stated = GCS_SEPARATORS.get(header.get("SEPARATOR", "")), header.get("SAMPLE_TIME", "")
    width = len(rows.partition(b"\n")[0].decode("latin-1").split(separator))
    names = (header.get(f"NAME{k}", f"column {k + 1}").replace('"', "") for k in range(width))
    head = (separator or " ").join(f'"{name}"' for name in names)
    columns = read_text(io.BytesIO(b"\n" * (len(lines) - 1) + head.encode() + b"\n" + rows), allowance)
    samples, step = len(columns[0].data), number_in(stated) if is_number(stated) else nan
    if not 0 < step < inf:
        return columns
    allowance.take(samples, "the time of its samples")
    return [Column("time", np.arange(float(samples)) * step, "s"), *columns]


# The least memory of a cell while it is read [bytes], and the cells that an empty row counts for.
_CELL, _ROW = 32, 16


def read_xlsx(stream: BinaryIO, allowance: Allowance) -> list[Column]:
    """Read the tables of a workbook, whatever range its sheets declare; if several, names begin with the sheet."""
    import openpyxl

    with zipfile.ZipFile(stream) as archive:
        for member in archive.infolist():
            allowance.check(member.file_size, f"sheet '{member.filename}'")
    tables: dict[str, list[Column]] = {}
    with closing(openpyxl.load_workbook(stream, read_only=True, data_only=True)) as workbook:
        for sheet in workbook.worksheets:
            sheet.reset_dimensions()
            rows, cells, what = [], 0, f"the cells of sheet '{shortened(sheet.title)}'"
            for row in sheet.iter_rows(values_only=True):
                cells += max(len(row), _ROW)
                allowance.check(_CELL * cells, what)
                rows.append(row)
            allowance.check(len(rows) * max(map(len, rows), default=0), what)
            columns = [column for column in zip_longest(*rows) if any(cell is not None for cell in column)]
            lines = ["\t".join(map(_cell, row)) for row in zip(*columns, strict=True)]
            if sum(map(bool, map(str.strip, lines))) > 1:
                text = io.BytesIO("\n".join(lines).encode() + b"\n")
                tables[sheet.title] = read_text(text, allowance, ".")
    if not tables:
        raise FileFormatError("no sheet with rows found; save the measurement in a sheet")
    return [
        column if len(tables) == 1 else replace(column, name=f"{title}/{column.name}", group=f"{title}/{column.group}")
        for title, columns in tables.items()
        for column in columns
    ]


def _cell(value: Any) -> str:
    """Return the text of a cell; a number that is text has an apostrophe, because its decimal sign is not known."""
    text = "" if value is None else " ".join(str(value).split())
    return f"'{text}" if isinstance(value, str) and {*text} & {*".,"} and is_number(text) else text


# Number of bytes for recognising a text: the longest header of a GCS array.
_HEAD = 50_000


def _read_text(stream: BinaryIO, allowance: Allowance) -> list[Column]:
    """Read a text file in the format that its first bytes show."""
    mark = containers.LINE.encode()
    head = stream.read(_HEAD)
    stream.seek(0)
    if head.lstrip(b"\xef\xbb\xbf").startswith(b"LabVIEW Measurement"):
        # Its channels may have starts, steps and clocks of their own.
        raise FileFormatError("LabVIEW's measurement files are not read; save it as TDMS, or below one row of names")
    if _END.search(head):
        return read_gcs(stream, allowance)
    # Each line of a record of dehyst has a line end: a line without one was cut off while it was written.
    columns = read_text(stream, allowance, whole_lines=head.startswith(mark))
    stated = head[len(mark) : containers.LONGEST].split(b"\n")[0] if head.startswith(mark) else b""
    return containers.restored(columns, stated.decode(errors="replace"))


# By suffix, the function that returns the columns in the bytes of a file within an allowance.
LOADERS: dict[str, Callable[[BinaryIO, Allowance], list[Column]]] = {
    **dict.fromkeys(TEXT, _read_text),
    ".xlsx": read_xlsx,
    ".mat": containers.read_mat,
    ".h5": containers.read_hdf5,
    ".hdf5": containers.read_hdf5,
    ".tdms": containers.read_tdms,
    ".npy": containers.read_npy,
    ".npz": containers.read_npz,
}
