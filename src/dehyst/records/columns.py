"""How a file is read: one text of columns, units and scales, for the library, --columns and the page."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from math import inf, isfinite
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._io import PathLike, path_of, reading, write_atomically
from dehyst._types import Array
from dehyst._units import FACTORS, in_si, quantity_of, symbol_of
from dehyst._validation import Numbers, axis_names, choice
from dehyst.records.formats.column import GAIN, GUESS, QUANTITIES

# Placeholder for the sample rate.
RATE = "HZ"
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_FACTOR = re.compile(rf"({_NUMBER}|{GAIN})\s*(?:([^\s/*]+)\s*/\s*([^\s/*]+))?")
_PERIODIC = re.compile(rf"(fringe|grating)\s+({_NUMBER}|{GAIN})\s*([^\W\d]*)", re.IGNORECASE)
HOLDS = ("line", "sample")
_COLUMNS = ("time", "voltage", "displacement", "temperature")
# Keys that are allowed for the file of a record, of a voltage, and of a path.
RECORD = (*_COLUMNS, "rate", "hold", "join", "decimal")
VOLTAGE = tuple(key for key in RECORD if key not in ("displacement", "hold"))
PATH = tuple(key for key in RECORD if key not in ("voltage", "hold"))
_ABOVE_0 = Numbers(positive=True, optional=True, error=FileFormatError)
# Longest file of columns [bytes].
_LONGEST = 10_000


class Scale(NamedTuple):
    """`factor` times `unit` for each `per`; a `kind`, "fringe" or "grating", repeats after `factor` times `unit`."""

    factor: float
    unit: str = ""
    per: str = ""
    kind: str = ""

    @classmethod
    def of(cls, text: str) -> Self:
        """Return the scale in a text; raise `FileFormatError` for one that cannot be used."""
        periodic, match = _PERIODIC.fullmatch(text), _FACTOR.fullmatch(text)
        number = 0.0 if GAIN in text else float(periodic[2] if periodic else match[1])  # type: ignore[index]
        if periodic and 0 < number < inf and quantity_of(periodic[3]) == "displacement":
            return cls(number, symbol_of(periodic[3]), "", periodic[1].lower())
        if match and isfinite(number) and number:
            return cls(number, match[2] or "", match[3] or "")
        need = "a number from the data sheet, not 0; for a fringe or a grating a length above 0, as *fringe 316.4 nm"
        raise FileFormatError(argument="columns", got=f"*{text}", need=need)

    def __str__(self) -> str:
        number = f"{self.factor:.12g}"
        if self.kind:
            return f"{self.kind} {number} {self.unit}"
        return f"{number} {self.unit}/{self.per}" if self.unit else number

    def fault(self, quantity: str, unit: str) -> str:
        """Return why a column of a `unit`, empty if unknown, cannot be scaled to a quantity; empty if it can."""
        if self.kind:
            return "" if quantity == "displacement" else f"a {self.kind} shows a displacement only"
        if not self.unit:
            known, own = not unit or quantity_of(unit) in (quantity, "voltage"), QUANTITIES[quantity].units[0]
            return "" if known else f"a factor for it needs units, as {self.factor:g} {own}/{unit}"
        if quantity_of(self.unit) != quantity:
            return f"the scale {self} does not give a {quantity}, need {', '.join(FACTORS[quantity])} before the slash"
        same = _plain(self.per) == _plain(unit) or (
            quantity_of(self.per) and quantity_of(self.per) == quantity_of(unit)
        )
        return "" if not unit or same else f"the scale {self} is for {self.per}"

    def apply(self, quantity: str, unit: str, data: Array) -> Array:
        """Return a column of a `unit` in SI units of the quantity."""
        if not self.unit and quantity_of(unit) == quantity:
            return np.asarray(self.factor * in_si(data, symbol_of(unit)))
        to = FACTORS[quantity][symbol_of(self.unit) or QUANTITIES[quantity].units[0]]
        per, unit = symbol_of(self.per or ("V" if quantity_of(unit) == "voltage" else "")), symbol_of(unit)
        known = FACTORS.get(quantity_of(per), {})
        return np.asarray(data * (self.factor * to * (known[unit] / known[per] if unit in known and per else 1.0)))


def _plain(unit: str) -> str:
    return symbol_of(unit) or unit.strip().strip("[]()").casefold()


def split(text: str) -> tuple[str, str, str, bool]:
    """Return the name, the unit and the scale in ``NAME:UNIT*SCALE?``, and whether it is a guess."""
    bare = text.strip()
    guess, bare = bare.endswith(GUESS), bare.removesuffix(GUESS)
    name, star, scale = bare.rpartition("*")
    if not star or not (_PERIODIC.fullmatch(scale.strip()) or _FACTOR.fullmatch(scale.strip())):
        name, scale = bare, ""
    guess, name = guess or name.endswith(GUESS), name.removesuffix(GUESS)
    name, colon, unit = name.rpartition(":")
    return (name if colon else unit).strip(), unit.strip() if colon else "", scale.strip(), guess


class Entry(NamedTuple):
    """A column that a text selects by ``NAME:UNIT*SCALE?``; an empty name stands for the usual names."""

    name: str
    unit: str = ""
    scale: Scale | None = None
    guess: bool = False

    @classmethod
    def of(cls, text: str) -> Self:
        """Return what a text selects; raise `FileFormatError` for a scale that cannot be used."""
        name, unit, scale, guess = split(text)
        return cls(name, symbol_of(unit) or unit, Scale.of(scale) if scale else None, guess)


@dataclass(frozen=True)
class Columns:
    """Columns of a file with their units and scales, and how the file is read.

    As text: entries with commas between them, ``time=Time:ms, voltage=Ch1*100, displacement=Sensor:V*10 um/V``. An
    entry that holds a comma is in double quotes; ``@FILE`` is the text in a file.

    Parameters
    ----------
    time, voltage, displacement, temperature : str, optional
        ``NAME:UNIT*SCALE?``, of which everything but the name is optional. NAME: name of the column, or its number,
        from 1 on; without it, usual names are searched. UNIT: needed if the file states none. SCALE: a factor, such as
        the gain of an amplifier for its monitor (100); a factor with the units of the quantity and of the column (10
        um/V, 25 V/A); or, for a displacement, the period of a periodic signal: "fringe 316.4 nm", "grating 3 um". "?"
        marks a guess, which the record keeps in ``meta["guesses"]``.
    rate : float, optional
        Samples per second [Hz], in place of a column of time.
    hold : str, optional
        "sample" if a converter holds the voltage until the next sample, and the displacement is read at the end of that
        time; default: as the file says, or "line"; see `Record`.
    join : path, optional
        Second file of the same measurement, aligned on time, or on the sample if one of the files has no time.
    decimal : str, optional
        "point" or "comma": the decimal sign of a file whose numbers do not show it.
    axes : mapping
        For several axes, the name of each is a key, as in ``x=vx_V:x_um``; its value is VOLTAGE:DISPLACEMENT for a
        record, DISPLACEMENT for a path.

    Raises
    ------
    FileFormatError
        If a text cannot be understood, a number is not above 0, or a name of an axis is given twice.
    """

    time: str | None = None
    voltage: str | None = None
    displacement: str | None = None
    temperature: str | None = None
    rate: float | None = None
    hold: str | None = None
    join: PathLike | None = None
    decimal: str | None = None
    axes: dict[str, str] = field(default_factory=dict)

    metavar: ClassVar[str] = "TEXT"
    about: ClassVar[str] = (
        "How files are read, as 'time=Time:ms, voltage=Ch1*100, displacement=Sensor:um', or @FILE that `show --save` "
        "wrote. Other keys: rate=HZ, temperature=NAME:C, hold=sample, join=FILE, decimal=point|comma, and of several "
        "axes x=VOLTAGE:DISPLACEMENT; default: columns are found by their names."
    )

    def __post_init__(self) -> None:
        if not isinstance(self.axes, Mapping):
            raise FileFormatError(argument="axes", got=repr(self.axes), need="columns by the names of axes")
        for key in _COLUMNS:
            value = getattr(self, key)
            if not isinstance(value, str | None) or (value is not None and not value.strip()):
                raise FileFormatError(argument=key, got=repr(value), need="the name of a column, as 'voltage_V'")
            Entry.of(value or "")
        _ABOVE_0(self.rate, "rate")
        for key, known in (("decimal", ("point", "comma")), ("hold", HOLDS)):
            if getattr(self, key) is not None:
                choice(getattr(self, key), key, known, error=FileFormatError)
        object.__setattr__(self, "join", None if self.join is None else path_of(self.join, "join"))
        object.__setattr__(self, "axes", dict(self.axes))

    @classmethod
    def of(cls, given: Columns | str | None) -> Columns:
        """Return the columns from Columns, from a text, or from None."""
        if isinstance(given, str):
            return cls.parse(given)
        if isinstance(given, Columns | None):
            return given or AS_FOUND
        need = "one text with commas, as 'time=Time:ms, voltage=Ch1*100', or Columns"
        raise FileFormatError(argument="columns", got=repr(given), need=need)

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the columns that a text declares; raise `FileFormatError` if it declares none."""
        if text.startswith("@"):
            with reading(Path(text[1:]), "text", _LONGEST) as stream:
                text = stream.read().decode("utf-8-sig").strip()
        found: dict[str, Any] = {"axes": {}}
        for key, value in entries_of(text).items():
            if key in RECORD:
                found[key] = float(value) if key == "rate" and re.fullmatch(_NUMBER, value) else value
            else:
                found["axes"][key] = value
        return cls(**found)

    def __str__(self) -> str:
        """Return the text, which `parse` reads."""
        return text_of(self.entries())

    def save(self, path: PathLike) -> None:
        """Write the text to a file, for ``@FILE``; raise `FileFormatError` if it cannot be written."""
        write_atomically(path, f"{self}\n".encode())

    def demand(self, keys: Sequence[str], words: str, *, axes: bool = False) -> None:
        """Raise an error for keys without an effect; with `axes`, each axis states its own columns."""
        known = [key for key in keys if not (axes and key in ("voltage", "displacement"))]
        for key in self.entries():
            if key not in (*known, *(self.axes if axes else ())):
                hint = f"leave it out; known are {', '.join(known)}"
                raise FileFormatError(f"{key} has no effect {words}", argument="columns", hint=hint)

    def of_axes(self) -> dict[str, Columns]:
        """Return the columns of each of two or more axes; raise `FileFormatError` if they are stated wrongly."""

        def refusal(got: str, need: str) -> FileFormatError:
            return FileFormatError(argument="axes", got=got, need=f'{need}, as "x=vx_V:x_um, y=vy_V:y_um"')

        found, used = {}, list[str]()
        for name, text in self.axes.items():
            parts = columns_of_axis(text)
            if len(parts) != 2 or not all(parts):
                need = f"a key of {', '.join(RECORD)}, or an axis with its columns of voltage and displacement"
                raise refusal(f"'{name}={text}'", need)
            used += [Entry.of(part).name for part in parts]
            found[name] = replace(self, voltage=parts[0], displacement=parts[1], axes={})
        if twice := sorted({column for column in used if used.count(column) > 1}):
            raise refusal(f"'{twice[0]}' twice", "columns of its own for each axis")
        if len(found) < 2:
            raise refusal(f"{', '.join(found) or 'none'}", f"two axes at least; no axis is called {', '.join(RECORD)}")
        axis_names(list(found), len(found), "", FileFormatError)
        return found

    def entries(self) -> dict[str, str]:
        """Return the value of each key that was given, as text."""
        given = {entry.name: getattr(self, entry.name) for entry in fields(self) if entry.name != "axes"}
        words = {key: f"{value:.12g}" if isinstance(value, float | int) else str(value) for key, value in given.items()}
        return {key: word for key, word in words.items() if given[key] != getattr(type(self), key)} | self.axes


# Columns that are found by their names.
AS_FOUND = Columns()


def entries_of(text: str) -> dict[str, str]:
    """Return the value of each key in a text; raise `FileFormatError` without KEY=VALUE, or for a key twice."""
    found: dict[str, str] = {}
    # A line break separates words as a blank does.
    for entry in next(csv.reader([" ".join(text.splitlines())], skipinitialspace=True), []):
        key, equals, value = (part.strip() for part in entry.partition("="))
        if not equals or not key or not value:
            need = "KEY=VALUE with commas between them, as in 'time=Time:ms, voltage=Ch1*100'"
            raise FileFormatError(argument="columns", got=repr(entry), need=need)
        if key in found:
            raise FileFormatError(argument="columns", got=f"{key} twice", need="each key once")
        found[key] = value
    return found


def text_of(entries: Mapping[str, str]) -> str:
    """Return the text of entries; one that holds a comma is in double quotes."""
    words = [f"{key}={value}" for key, value in entries.items()]
    return ", ".join('"{}"'.format(word.replace('"', '""')) if set(word) & set(',"') else word for word in words)


def columns_of_axis(text: str) -> list[str]:
    """Return the columns of an axis, NAME or NAME:UNIT*SCALE with colons between them."""
    found: list[str] = []
    for part in text.split(":"):
        unit = Entry.of(part).name
        if found and ":" not in found[-1] and quantity_of(unit) in ("voltage", "displacement"):
            found[-1] += f":{part}"
        else:
            found.append(part)
    return [part.strip() for part in found]
