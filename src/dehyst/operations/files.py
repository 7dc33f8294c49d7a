"""Files of operations: records and tables by --columns; models; written tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._io import format_of
from dehyst._text import counted
from dehyst._types import Array
from dehyst.operations.command import Parsed, number, option
from dehyst.operations.run import MODELS
from dehyst.records import Columns, Table, write_columns
from dehyst.records.columns import AS_FOUND, PATH, RECORD, VOLTAGE
from dehyst.waveforms import positive

__all__ = ["AS_FOUND", "PATH", "RECORD", "VOLTAGE", "Columns"]
AS_COLUMNS = Parsed(Columns)
_FORM = "As 'time=Time:ms, voltage=Ch1*100, displacement=Sensor:um', or @FILE; see dehyst show --help."
COLUMNS: Any = option(_FORM, AS_COLUMNS, default=AS_FOUND)
GAIN: Any = number("Gain of the amplifier: adds its input voltage as a column.")


def columns_in(columns: Columns, table: Table, other: Table | None = None) -> Columns:
    """Return columns without the names that a table lacks; names that an `other` table lacks too stay.

    One text can thus serve two files. A rate belongs to the table without a time.
    """

    def lacks(file: Table, key: str, name: Any) -> bool:
        return bool(file.fitting("time")) if key == "rate" else file.fitting(key, name) != 1

    given = {key: getattr(columns, key) for key in ("time", "voltage", "displacement", "temperature", "rate")}
    missing = {key: name for key, name in given.items() if name is not None and lacks(table, key, name)}
    left: Any = dict.fromkeys(key for key in missing if other is None or not lacks(other, key, missing[key]))
    return replace(columns, **left)


def numbers_in(table: Table, quantity: str, values: Array) -> Array:
    """Return values (n,) of a table; raise `FileFormatError` with the first row that has none."""
    lost = np.flatnonzero(~np.isfinite(values))
    if lost.size:
        where = f"the first is row {lost[0] + 1} below the header of {table.source}"
        got = f"{counted(lost.size, 'row')} without a number, {where}"
        raise FileFormatError(argument=quantity, got=got, need="numbers", hint="fill them in")
    return values


def clock_of(table: Table, columns: Columns) -> dict[str, Array]:
    """Return the time of a table as a column; empty if it has no time."""
    if columns.time is None and not table.fitting("time"):
        return {}
    # A copy, so that the other columns of the file need not stay in memory.
    return {"time_s": np.array(table.column("time", columns.time))}


# Significant digits of a table: 0.1 nV of 100 V.
_DIGITS = 12


def is_model(path: Path, *formats: str) -> bool:
    """Return whether a file is a model, by its format alone; by default of one axis or several."""
    return path.is_file() and format_of(path) in (formats or MODELS)


def write_table(path: Path, columns: Mapping[str, Any], gain: float | None = None) -> None:
    """Write a table with rounded numbers; with a `gain`, also the inputs of an amplifier."""
    factor = 1.0 if gain is None else positive(gain, "gain")
    volts = {name: values for name, values in columns.items() if name.endswith("_V") and gain is not None}
    inputs = {f"{name.removesuffix('_V')}_input_V": np.asarray(values) / factor for name, values in volts.items()}
    write_columns(path, {**columns, **inputs}, digits=_DIGITS)
