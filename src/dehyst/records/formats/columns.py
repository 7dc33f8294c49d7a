"""The columns of a file: found by name, with the units that the file states, returned in SI units."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._types import Array
from dehyst.records.formats.units import UNITS, plausible_unit, quantity_of, scale_of, symbol_of

__all__ = ["EXAMPLES", "TEXT", "UNITS", "Column", "ColumnError", "Table", "listed", "shortened"]

_WORDS = {
    "time": ("time", "t"),
    "voltage": ("voltage", "v", "drive"),
    "displacement": ("displacement", "position", "y", "pos"),
}
# Words that name a quantity only if its unit is stated too.
_MORE_WORDS = {
    "time": [
        "timestamp",
        "datetime",
        "date",
        "x_value",
        "x-axis",
        "second",
        "seconds",
        "sec",
        "zeit",
        "temps",
        "tiempo",
    ],
    "voltage": ["u", "spannung", "tension", "piezo voltage", "drive voltage", "output voltage", "control voltage"],
    "displacement": ["disp", "deflection", "elongation", "extension", "weg", "auslenkung", "verschiebung"],
}
EXAMPLES = {"time": "time_s", "voltage": "voltage_V", "displacement": "displacement_um"}
TEXT = (".csv", ".tsv", ".txt", ".dat")
# A quantity and its unit: "Time / s", "Weg in µm".
_WRITTEN_OUT = re.compile(r"(.+?)\s+(?:/|in)\s+(\S+)")
# The same without blanks: "Position/nm".
_DIVIDED = re.compile(r"\s*([^/]*[^/\s])\s*/\s*([^/\s\[\]()]+)\s*")
# Characters of a name that a message shows.
_SHOWN = 60


class ColumnError(FileFormatError):
    """A quantity that cannot be read from its column.

    `problem`: what is wrong, without the name of the file. `advice`: what to try. `quantity`: the one it concerns.
    `column`: the one it concerns if there is one. `hint`: a short advice.
    """

    def __init__(
        self, source: str, quantity: str, problem: str, advice: str, column: Column | None = None, hint: str = ""
    ) -> None:
        super().__init__(f"{source}: {problem}{advice}")
        self.quantity, self.problem, self.advice = quantity, problem, advice
        self.column, self.hint = column, hint


@dataclass(frozen=True, eq=False, slots=True)
class Column:
    """One named column of a file.

    Attributes
    ----------
    name : str
    data : (n,) array
    unit : str
        The unit if the file states it outside the name.
    fault : str
        The reason why it cannot be used, and what to try; empty if it can.
    foreign : bool
        Whether its samples lie in another file, are computed, or lie in a structure beside plain arrays: it is
        ignored if another column fits.
    unnamed : str
        If the file has no names, so that the name is a number: the reason, and what to try.
    divided : bool
        Whether the name ends with a slash and its unit, as "Position/nm": that slash ends no group.
    """

    name: str
    data: Array
    unit: str = ""
    fault: str = ""
    foreign: bool = False
    unnamed: str = ""
    divided: bool = False

    @property
    def leaf(self) -> str:
        """The name without its groups; "Time / s" has none."""
        if self.divided:
            return "/".join(self.name.rsplit("/", 2)[-2:])
        return self.name if " / " in self.name else self.name.rsplit("/", 1)[-1]

    @property
    def parts(self) -> tuple[str, str]:
        """Quantity and unit in the column's name: ('drive', 'V') for 'drive_V' or 'drive [V]'."""
        text = self.leaf.strip()
        if self.divided and (divided := _DIVIDED.fullmatch(text)):
            return divided[1], self.unit or symbol_of(divided[2])
        if len(text) <= _SHOWN and (written := _WRITTEN_OUT.fullmatch(text)) and symbol_of(written[2]):
            return written[1].strip(), symbol_of(written[2])
        start = min((at for at in (text.find("["), text.find("(")) if at >= 0), default=-1)
        if 0 <= start < len(text) - 1 and text[-1] in "])":
            word, unit = _trim(text[:start]), text[start + 1 : -1]
        else:
            word, _, unit = self.leaf.rpartition("_") if "_" in self.leaf else (self.leaf, "", "")
        if any(self.unit in known for known in UNITS.values()):
            return word.strip(), self.unit
        return word.strip(), symbol_of(unit) or symbol_of(self.unit) or unit.strip() or self.unit


def without_groups(column: Column) -> Column:
    """Return a column of a flat table, where a slash before a unit ends no group: "Position/nm", but not "um/V"."""
    divided = _DIVIDED.fullmatch(column.name) if len(column.name) <= _SHOWN else None
    unit = symbol_of(divided[2]) if divided else ""
    if divided is None or not unit or symbol_of(divided[1].split()[-1]) not in ("", unit):
        return column
    return replace(column, divided=True)


@dataclass(frozen=True, eq=False, slots=True)
class Table:
    """The columns of one file, still in the file's units."""

    source: str
    sha256: str
    columns: tuple[Column, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Column names as the file has them, with their groups."""
        return tuple(column.name for column in self.columns)

    def has(self, quantity: str) -> bool:
        """Return whether exactly one column is the `quantity` by its name and unit."""
        return len(self._candidates(quantity)) == 1

    def column(self, quantity: str, wanted: str | None = None, scale: str | None = None) -> Array:
        """Return the column of a `quantity` ("time", "voltage" or "displacement") in SI units.

        `wanted`: name, unique last part of the name, or "name:unit"; by default the one column named like the quantity.
        `scale`: that of an amplifier's monitor or of a sensor, as "100 V/V" or "10 um/V".

        Returns
        -------
        (n,) float array
            Seconds, volts or metres.

        Raises
        ------
        FileFormatError
            No such column, several of them, an unknown unit, a scale that does not fit, or cells that are no numbers.
        """
        column, unit = self.find(quantity, wanted)
        if column.fault:
            raise ColumnError(self.source, quantity, f"column '{shortened(column.name)}': {column.fault}", "")
        factor = self._scaled(quantity, column, unit, scale) if scale is not None else UNITS[quantity].get(unit)
        if factor is None:
            raise self._unknown_unit(quantity, column, unit)
        # The record refuses overflow and NaN, with the row.
        with np.errstate(all="ignore"):
            # Dividing by 1e6 rounds once, multiplying by 1e-6 twice.
            return column.data * factor if scale or factor >= 1 else column.data / round(1 / factor)

    def _scaled(self, quantity: str, column: Column, unit: str, text: str) -> float:
        scale = scale_of(quantity, text)
        if refusal := scale.refusal(unit or scale.per):
            raise ColumnError(
                self.source,
                quantity,
                f"column '{shortened(column.name)}' has the unit '{shortened(unit)}', but {refusal}",
                "; give a scale for that unit, or leave it out",
            )
        return scale.apply(unit or scale.per)

    def _unknown_unit(self, quantity: str, column: Column, unit: str) -> ColumnError:
        name, example = shortened(column.name), EXAMPLES[quantity]
        stated = f"the unit '{shortened(unit)}', unknown for {quantity}" if unit else "no unit"
        advice, hint = f"; known are {', '.join(UNITS[quantity])}. ", ""
        sensor = quantity_of(unit) == "voltage" and quantity == "displacement"
        if sensor:
            hint = f", give its scale, {_option('displacement_scale', '10 um/' + unit)} for instance"
            advice += f"If it is a sensor's voltage{hint}; or select another column with {_option(quantity, 'NAME')}"
        elif quantity_of(unit):
            advice += f"Select another column with {_option(quantity, 'NAME')}, or correct the unit in the file"
        else:
            guess = "UNIT" if unit else plausible_unit(quantity, column.data) or example.rsplit("_")[-1]
            named = _option(quantity, name + ":" + guess)
            hint = f", try {named}"
            advice += f"Name it like '{example}' or '{example.replace('_', ' [')}]', or give {named}"
        usable = None if unit and not sensor else column
        return ColumnError(self.source, quantity, f"column '{name}' has {stated}", advice, usable, hint)

    def find(self, quantity: str, wanted: str | None = None) -> tuple[Column, str]:
        """Return the column that `column` uses, and its unit."""
        unit = ""
        if not isinstance(wanted, str | None):
            raise FileFormatError(f"{quantity}: got {wanted!r}, need the name of a column, as '{EXAMPLES[quantity]}'")
        if wanted is None and self.columns and self.columns[0].unnamed:
            raise ColumnError(self.source, quantity, self.columns[0].unnamed, "")
        fits = self._candidates(quantity) if wanted is None else self._named(wanted)
        if wanted is not None and not fits and ":" in wanted:
            name, unit = (part.strip() for part in wanted.rsplit(":", 1))
            fits = self._named(name)
        if len(fits) == 1:
            stated = fits[0].parts[1]
            self._refuse_relabelled(quantity, fits[0], stated, symbol_of(unit) or unit)
            return fits[0], symbol_of(unit) or unit or stated
        request = f"column '{wanted}' for {quantity}" if wanted is not None else f"{quantity} column"
        count = f"{len(fits)} columns fit: {listed(tuple(c.name for c in fits))}" if fits else f"no {request}"
        hint = f" A name like '{EXAMPLES[quantity]}' is found by itself." if wanted is None else ""
        rate = " Without one, give sample_rate= in Hz." if quantity == "time" else ""
        raise ColumnError(
            self.source,
            quantity,
            f"{count}{f' as {request}' if fits else ''}",
            f"; the file holds {listed(self.names)}. Select one with {_option(quantity, 'NAME')}.{hint}{rate}",
        )

    def _refuse_relabelled(self, quantity: str, column: Column, stated: str, given: str) -> None:
        """Refuse to take volts for micrometres, or for millivolts, because a user gives another unit than the file."""
        if given and quantity_of(stated) and quantity_of(given) == quantity and quantity_of(stated) != quantity:
            raise ColumnError(
                self.source,
                quantity,
                f"column '{shortened(column.name)}' has the unit '{stated}' in the file, got '{given}'",
                f"; give the scale from one to the other, {_option(f'{quantity}_scale', f'10 {given}/{stated}')} for "
                "instance"
                if quantity != "time"
                else "; select another column",
            )
        known = UNITS[quantity]
        if given in known and stated in known and known[given] != known[stated]:
            factor = f"{known[given] / known[stated]:g} {stated}/{stated}"
            right = f", give {_option(f'{quantity}_scale', factor)}" if quantity != "time" else ", correct it there"
            raise ColumnError(
                self.source,
                quantity,
                f"column '{shortened(column.name)}' has the unit '{stated}' in the file, got '{given}'",
                f"; if the file is wrong{right}",
            )

    def _candidates(self, quantity: str) -> list[Column]:
        fits = [c for c in self.columns if {c.leaf.lower(), c.parts[0].lower()} & set(_WORDS[quantity])]
        fits = [c for c in fits if not c.foreign] or fits
        fits = [c for c in fits if c.parts[1] in UNITS[quantity]] or fits
        more = (c for c in self.columns if {c.leaf.lower(), c.parts[0].lower()} & set(_MORE_WORDS[quantity]))
        return fits or [c for c in more if c.parts[1] in UNITS[quantity]]

    def _named(self, name: str) -> list[Column]:
        name = name.strip().strip("/")
        exact = [c for c in self.columns if c.name == name]
        leaf = [c for c in self.columns if c.leaf == name]
        dotted = [c for c in self.columns if c.name.replace("/", ".") == name]
        return exact or leaf or dotted or [c for c in self.columns if c.parts[0] == name]


def _option(quantity: str, value: str) -> str:
    return f'{quantity}="{value}"'


def listed(names: tuple[str, ...]) -> str:
    """Quote names for a message, the first twenty of them."""
    return ", ".join(f"'{shortened(name)}'" for name in names[:20]) + (
        f" and {len(names) - 20} more" if len(names) > 20 else ""
    )


def shortened(name: str) -> str:
    """Return a name from a file for a message: only its beginning if it is long."""
    return name if len(name) <= _SHOWN else f"{name[:_SHOWN]}..."


def _trim(text: str) -> str:
    """Remove blanks and underscores at the end."""
    end = len(text)
    while end and (text[end - 1].isspace() or text[end - 1] == "_"):
        end -= 1
    return text[:end]
