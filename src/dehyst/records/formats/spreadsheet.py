"""Sheets of Excel workbooks (.xlsx), read as text tables."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from datetime import date, datetime, time
from typing import Any

from dehyst._errors import FileFormatError
from dehyst.records.formats.columns import Column
from dehyst.records.formats.containers import library
from dehyst.records.formats.file_content import Allowance
from dehyst.records.formats.text_table import read_text


def read_xlsx(data: bytes, allowance: Allowance) -> list[Column]:
    """Read the tables of a workbook; the names of several sheets are put before those of their columns.

    Raises
    ------
    FileFormatError
        No sheet with a table, or more than allowed.
    MissingExtraError
        If openpyxl is not installed.
    """
    openpyxl = library("openpyxl", "Reading .xlsx files")
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        for member in archive.infolist():
            allowance.check(member.file_size, f"sheet '{member.filename}'")
    with closing(openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)) as workbook:
        sheets = {sheet.title: _text(sheet.iter_rows(values_only=True)) for sheet in workbook.worksheets}
    sheets = {title: text for title, text in sheets.items() if text.count(b"\n") > 1}
    if not sheets:
        raise FileFormatError(f"{allowance.path}: no sheet with rows found; save the measurement in a sheet")
    if len(sheets) == 1:
        return read_text(next(iter(sheets.values())), allowance)
    columns = [(title, column) for title, text in sheets.items() for column in read_text(text, allowance)]
    return [replace(column, name=f"{title}/{column.name}") for title, column in columns]


def _text(rows: Iterator[tuple[Any, ...]]) -> bytes:
    """Return rows as text with tabs."""
    lines = ("\t".join(map(_cell, row)) for row in rows)
    return "".join(f"{line}\n" for line in lines if line.strip()).encode()


def _cell(value: Any) -> str:
    if isinstance(value, datetime | date | time):
        return value.isoformat()
    return "" if value is None else " ".join(str(value).split())
