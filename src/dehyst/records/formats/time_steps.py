"""The time of samples that the lines above a table state by its step, as oscilloscopes and loggers write it."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from dehyst._units import FACTORS, symbol_of
from dehyst.records.formats.columns import Column
from dehyst.records.formats.table_layout import number_in

# Letters of the words for the time from one sample to the next, and for samples a second.
_WORDS = {
    "step": "xinc xincr xincrement sampleinterval samplinginterval sampleperiod timestep deltat dt horizontalinterval "
    "abtastintervall abtastzeit",
    "rate": "samplerate samplingrate samplefrequency samplingfrequency abtastrate abtastfrequenz sampling",
}
_KINDS = {word: kind for kind, words in _WORDS.items() for word in words.split()}
_HERTZ = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "ghz": 1e9, "s/s": 1.0, "sa/s": 1.0, "ks/s": 1e3, "ms/s": 1e6}
# Key, unit in brackets, number, and unit of a line.
_STATED = re.compile(
    r"[#%;\s\"]*([A-Za-z][A-Za-z _]*)(?:[\[(]([^\[\]()]*)[\])])?[\s\":=;,]+"
    r"([-+]?[.,]?\d(?:[\d.,]*\d)?(?:[eE][-+]?\d+)?)[\s\";,]*([^\W\d]+(?:/[^\W\d]+)?)?(?![^\s\";,]).*"
)
# The longest line that is looked at, and the relative difference of steps that state the same.
_LONGEST_LINE, _SAME = 400, 1e-6


def with_clock(columns: list[Column], lines: Sequence[str], decimal: str) -> list[Column]:
    """Return columns with the time that the `lines` above a table state, in the place of one that counts samples.

    Nothing changes without a step and its unit, or with a column of time. Steps that contradict each other are a fault.
    """
    if not columns or any(column.parts[1] in FACTORS["time"] for column in columns):
        return columns
    place = next((k for k, column in enumerate(columns) if _counts(column)), None)
    named = place is None and any("time" in column.quantities for column in columns)
    stated = [
        step
        for line in lines
        if len(line) <= _LONGEST_LINE and (match := _STATED.fullmatch(line)) and (step := _stated(match, decimal))
    ]
    steps = [value for value, _ in stated]
    if named or not steps:
        return columns
    rest = [column for k, column in enumerate(columns) if k != place]
    if not max(steps) - min(steps) <= _SAME * max(steps):
        words = ", ".join(text for _, text in stated)
        fault = f"the header states the time step by {words}, which is not one number; correct it, or give rate=HZ"
        return [Column("time", np.empty(0), "s", fault), *rest]
    counts = np.arange(float(columns[0].data.size)) if place is None else columns[place].data
    with np.errstate(all="ignore"):
        return [Column("time", steps[0] * counts, "s"), *rest]


def _counts(column: Column) -> bool:
    """Return whether a column counts samples: whole numbers that rise by one, or by more where samples are left out."""
    steps = np.diff(column.data)
    if not steps.size or column.data[0] % 1 or np.any(steps % 1) or steps.min() != 1:
        return False
    return bool(steps.max() == 1) or not (column.quantities or symbol_of(column.parts[1]))


def _stated(match: re.Match[str], decimal: str) -> tuple[float, str] | None:
    """Return the step [s] that a line states, NaN if it can be read in two ways, and its words; or None."""
    key, unit = re.sub(r"[^a-z]", "", match[1].lower()), match[4] or match[2] or ""
    hertz, seconds = _HERTZ.get(unit.lower(), 0.0), FACTORS["time"].get(symbol_of(unit), 0.0)
    try:
        value = number_in(match[3], decimal) if not {*match[3]} & {",", "."} - {decimal} else np.nan
    except ValueError:
        value = np.nan
    if value <= 0 or not (hertz if _KINDS.get(key) == "rate" else _KINDS.get(key) and seconds):
        return None
    return 1 / (hertz * value) if _KINDS[key] == "rate" else seconds * value, f"'{key}' of '{match[3]}'"
