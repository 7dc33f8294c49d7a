"""The columns of a file: found by name, with the units that the file states, returned in SI units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._types import Array

UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9, "min": 60},
    "voltage": {"V": 1, "mV": 1e-3, "kV": 1e3},
    "displacement": {"m": 1, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "nm": 1e-9, "pm": 1e-12},
}
_WORDS = {
    "time": ("time", "t"),
    "voltage": ("voltage", "v", "drive"),
    "displacement": ("displacement", "position", "y", "pos"),
}
_EXAMPLES = {"time": "time_s", "voltage": "voltage_V", "displacement": "displacement_um"}
TEXT = (".csv", ".tsv", ".txt", ".dat")
# Characters of a name that a message shows.
_SHOWN = 60


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
        Whether its samples lie in another file, or are computed: it is ignored if another column fits.
    """

    name: str
    data: Array
    unit: str = ""
    fault: str = ""
    foreign: bool = False

    @property
    def leaf(self) -> str:
        """The name without its groups."""
        return self.name.rsplit("/", 1)[-1]

    @property
    def parts(self) -> tuple[str, str]:
        """Quantity and unit in the column's name: ('drive', 'V') for 'drive_V' or 'drive [V]'."""
        text = self.leaf.strip()
        start = min((at for at in (text.find("["), text.find("(")) if at >= 0), default=-1)
        if 0 <= start < len(text) - 1 and text[-1] in "])":
            word, unit = _trim(text[:start]), text[start + 1 : -1]
        else:
            word, _, unit = self.leaf.rpartition("_") if "_" in self.leaf else (self.leaf, "", "")
        known = any(self.unit in units for units in UNITS.values())
        return word.strip(), self.unit if known or not unit else unit.strip()


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

    def column(self, quantity: str, wanted: str | None = None) -> Array:
        """Return the column of a `quantity` ("time", "voltage" or "displacement") in SI units.

        `wanted`: name, unique last part of the name, or "name:unit"; by default the one column named like the quantity.

        Returns
        -------
        (n,) float array
            Seconds, volts or metres.

        Raises
        ------
        FileFormatError
            No such column, several of them, an unknown unit, or cells that are no numbers.
        """
        column, unit = self.find(quantity, wanted)
        if column.fault:
            raise FileFormatError(f"{self.source}: column '{shortened(column.name)}': {column.fault}")
        factor = UNITS[quantity].get(unit)
        if factor is None:
            stated = f"the unit '{shortened(unit)}', unknown for {quantity}" if unit else "no unit"
            name = shortened(column.name)
            raise FileFormatError(
                f"{self.source}: column '{name}' has {stated}; known are {', '.join(UNITS[quantity])}. Name it "
                f"like '{_EXAMPLES[quantity]}' or '{_EXAMPLES[quantity].replace('_', ' [')}]', or give "
                f"{_option(quantity, name + ':' + _EXAMPLES[quantity].rsplit('_')[-1])}"
            )
        # The record refuses overflow and NaN, with the row.
        with np.errstate(all="ignore"):
            # Dividing by 1e6 rounds once, multiplying by 1e-6 twice.
            return column.data * factor if factor >= 1 else column.data / round(1 / factor)

    def find(self, quantity: str, wanted: str | None = None) -> tuple[Column, str]:
        """Return the column that `column` uses, and its unit."""
        unit = ""
        fits = self._candidates(quantity) if wanted is None else self._named(wanted)
        if wanted is not None and not fits and ":" in wanted:
            name, unit = (part.strip() for part in wanted.rsplit(":", 1))
            fits = self._named(name)
        if len(fits) == 1:
            return fits[0], unit or fits[0].parts[1]
        request = f"column '{wanted}' for {quantity}" if wanted is not None else f"{quantity} column"
        count = f"{len(fits)} columns fit: {listed(tuple(c.name for c in fits))}" if fits else f"no {request}"
        hint = f" A name like '{_EXAMPLES[quantity]}' is found by itself." if wanted is None else ""
        rate = " Without one, give sample_rate= in Hz." if quantity == "time" else ""
        raise FileFormatError(
            f"{self.source}: {count}{f' as {request}' if fits else ''}; the file holds {listed(self.names)}. "
            f"Select one with {_option(quantity, 'NAME')}.{hint}{rate}"
        )

    def _candidates(self, quantity: str) -> list[Column]:
        fits = [c for c in self.columns if {c.leaf.lower(), c.parts[0].lower()} & set(_WORDS[quantity])]
        fits = [c for c in fits if not c.foreign] or fits
        return [c for c in fits if c.parts[1] in UNITS[quantity]] or fits

    def _named(self, name: str) -> list[Column]:
        name = name.strip().strip("/")
        exact = [c for c in self.columns if c.name == name]
        leaf = [c for c in self.columns if c.leaf == name]
        return exact or leaf or [c for c in self.columns if c.parts[0] == name]


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
