"""The columns of a file, found by name; their units, in the words of instruments, and scales of amplifiers."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite
from typing import NamedTuple

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._types import Array
from dehyst._units import FACTORS, in_si, quantity_of, symbol_of

TEXT = (".csv", ".tsv", ".txt", ".dat")


class ColumnWords(NamedTuple):
    """Words and units by which the columns of a quantity are found.

    `example`: a name that is found. `words`: whole names; `more`: only if the unit is stated too. `parts` and `letters`
    in names, the usual `units`, and the plausible `range` in SI units: for proposals. `scale`: an example.
    """

    example: str
    words: str
    more: str
    parts: str
    letters: str
    units: tuple[str, ...]
    range: tuple[float, float]
    scale: str = ""


# Largest voltage [V] and range of strokes [m] of piezo actuators: no hint leads outside of them.
HIGHEST_VOLTAGE, STROKES = 1500.0, (1e-9, 1e-3)
QUANTITIES = {
    "time": ColumnWords(
        example="time_s",
        words="time, t",
        more="timestamp, datetime, date, x_value, x-axis, second, seconds, sec, zeit, temps, tiempo",
        parts="time, zeit, second, temps",
        letters="t",
        units=("s", "ms"),
        range=(0.0, 1e7),
    ),
    "voltage": ColumnWords(
        example="voltage_V",
        words="voltage, v, drive",
        more="u, spannung, tension, piezo voltage, drive voltage, output voltage, control voltage",
        parts="volt, spannung, drive, ampl, monitor, command, tension, ao, output, ausgang",
        letters="uv",
        units=("V", "mV"),
        range=(0.0, HIGHEST_VOLTAGE),
        scale="100 V/V",
    ),
    "displacement": ColumnWords(
        example="displacement_um",
        words="displacement, position, y, pos",
        more="disp, deflection, elongation, extension, weg, auslenkung, verschiebung",
        parts="disp, pos, weg, auslenk, sensor, gauge, strain, stroke, capac, ai, height",
        letters="yxzdw",
        units=("um", "nm", "mm", "m"),
        range=STROKES,
        scale="10 um/V",
    ),
}
# A stroke of many piezo actuators [m].
_STROKE = 1e-5
# What a user replaces by a number, as no scale holds it; and the end of a selection that is a guess: "y:um?".
GAIN, GUESS = "GAIN", "?"
_SCALE = re.compile(r"\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*([^\W\d]+)\s*/\s*([^\W\d]+)\s*")
# A quantity and its unit: "Time / s", "Weg in µm"; the same without blanks: "Position/nm".
_WRITTEN_OUT = re.compile(r"(.+?)\s+(?:/|in)\s+(\S+)")
_BRACKETS = re.compile(r"[\[(][^\[\]()]*[\])]$")
_DIVIDED = re.compile(r"\s*([^/]*[^/\s])\s*/\s*([^/\s\[\]()]+)\s*")
# The names of outputs, monitors and channels of an oscilloscope, as whole words or in them, and the range that such
# plugs have [V]: 10 V and what a converter measures beyond.
_PLUG = re.compile(
    r"(?<![^\W\d_])(?:ai|ao|ausg|c|ch|chan|channel|cmd|ctrl|dac|ext|kanal|mon|out|setpoint|[uv]mon|[uv]out)(?![^\W\d_])|"
    r"analog|ausgang|command|control|monitor|output|regler|salida|sortie|uscita"
)
_PLUG_RANGE = 10.5
# Names of the axes of a stage: with several of them in a file, "y" is not the displacement.
_AXES = {"x", "y", "z"}
# Characters of a name that a message shows.
_SHOWN = 60


def shortened(name: str) -> str:
    """Return a name from a file for a message: only its beginning if it is long."""
    return name if len(name) <= _SHOWN else f"{name[:_SHOWN]}..."


def listed(names: tuple[str, ...]) -> str:
    """Quote names for a message, the first twenty of them."""
    more = f" and {len(names) - 20} more" if len(names) > 20 else ""
    return ", ".join(f"'{shortened(name)}'" for name in names[:20]) + more


def is_plug(name: str) -> bool:
    """Return whether a column has the name of an output, a monitor or a channel."""
    return _PLUG.search(name.lower()) is not None


def is_small(volts: Array) -> bool:
    """Return whether an amplifier's input or monitor can have these voltages [V]."""
    return bool(volts.size and 0 < np.abs(volts).max() <= _PLUG_RANGE)


def plausible_unit(quantity: str, data: Array) -> str:
    """Return the most likely unit in which a column is plausible for a piezo actuator; empty if there is none."""
    with np.errstate(all="ignore"):
        size = float(np.abs(data).max(initial=0.0))
        if quantity == "displacement" and data.size:
            size = float(np.ptp(data))
    known = QUANTITIES[quantity]
    sizes = {unit: size * FACTORS[quantity][unit] for unit in known.units}
    plausible = [unit for unit, value in sizes.items() if known.range[0] <= value <= known.range[1]]
    if quantity != "displacement" or 0.01 * _STROKE <= sizes["um"] <= 100 * _STROKE:
        return plausible[0] if plausible else ""
    return min(plausible, key=lambda unit: abs(np.log10(sizes[unit] / _STROKE)), default="")


class Scale(NamedTuple):
    """The scale of an amplifier's monitor or of a sensor.

    `factor`: SI units of the quantity for one volt (or one `per`) at the plug. `per`: the unit of the column if the
    file states none. `words`: the given text.
    """

    factor: float
    per: str
    words: str

    def refusal(self, unit: str) -> str:
        """Return why a column of this unit cannot be scaled; empty if it can."""
        return "" if quantity_of(unit) == quantity_of(self.per) else f"the scale {self.words} is for {self.per}"

    def apply(self, unit: str) -> float:
        """Return one `unit` of the column in SI units of the quantity."""
        known = FACTORS[quantity_of(self.per)]
        return self.factor * known[symbol_of(unit)] / known[self.per]


def scale_of(quantity: str, text: str) -> Scale:
    """Parse a scale such as "100 V/V" or "10 um/V".

    Raise `FileFormatError` if the text is not a number with two units, the first unit is not of the quantity, or the
    number is 0 or not finite.
    """
    got = f"'{text}'" if isinstance(text, str) else repr(text)
    what = f"{quantity}_scale: got {got}, need a number with two units, as in '{QUANTITIES[quantity].scale}'"
    match = _SCALE.fullmatch(text) if isinstance(text, str) else None
    if match is None:
        point = "; with a decimal point" if "," in str(text) else ""
        point = f"; replace {GAIN} by the number in the data sheet" if GAIN in str(text) else point
        raise FileFormatError(f"{what}{point}")
    try:
        number, unit, per = float(match[1]), symbol_of(match[2]), symbol_of(match[3])
    except ValueError as error:
        raise FileFormatError(what) from error
    if not isfinite(number) or number == 0:
        raise FileFormatError(f"{what}; the number must be finite and not 0")
    if unit not in FACTORS[quantity]:
        raise FileFormatError(f"{what}; the first unit must be one of {', '.join(FACTORS[quantity])}")
    if not per:
        raise FileFormatError(f"{what}; the second unit must be the unit in the file, such as V or mV")
    return Scale(number * FACTORS[quantity][unit], per, f"{match[1]} {match[2]}/{match[3]}")


@dataclass(frozen=True, eq=False, slots=True)
class Column:
    """One named column of a file.

    `name`: as in the file. `data` (n,): its numbers, NaN where a cell is empty. `unit`: unit that the file states
    outside of the name. `fault`: why the column cannot be used, and what to try. `foreign`: whether its samples are in
    another file, are computed, or are in a structure next to plain arrays; it is then ignored if another column fits.
    `unnamed`: if the file has no names and the name is therefore a number: the reason, and what to try. `divided`:
    whether the name ends with a slash and its unit, as "Position/nm"; this slash does not end a group. `guessed`:
    properties that the file does not state. `ends`: first and last cell in a text file. `began`: possible values of the
    first timestamp (origin, whole seconds, fraction); there are two if the order of day and month is unknown. `kept`:
    whether a record keeps it as a further channel, regardless of its name.
    """

    name: str
    data: Array
    unit: str = ""
    fault: str = ""
    foreign: bool = False
    unnamed: str = ""
    divided: bool = False
    guessed: str = ""
    ends: tuple[str, str] = ("", "")
    began: tuple[tuple[str, int, float], ...] = ()
    kept: bool = False

    @property
    def leaf(self) -> str:
        """The name without its groups; "Time / s" has none, nor has "flow [l/min]"."""
        if self.divided:
            return "/".join(self.name.rsplit("/", 2)[-2:])
        unit = match[0] if (match := _BRACKETS.search(self.name)) else ""
        word = self.name.removesuffix(unit)
        return self.name if " / " in word else word.rsplit("/", 1)[-1] + unit

    @property
    def _named(self) -> tuple[str, str]:
        """Quantity and unit in the column's name."""
        text = self.leaf.strip()
        if self.divided and (divided := _DIVIDED.fullmatch(text)):
            return divided[1], divided[2]
        if len(text) <= _SHOWN and (written := _WRITTEN_OUT.fullmatch(text)) and symbol_of(written[2]):
            return written[1].strip(), written[2]
        start = min((at for at in (text.find("["), text.find("(")) if at >= 0), default=-1)
        if 0 <= start < len(text) - 1 and text[-1] in "])":
            word, end = text[:start], start
            while end and (word[end - 1].isspace() or word[end - 1] == "_"):
                end -= 1
            return word[:end].strip(), text[start + 1 : -1].strip()
        word, _, unit = self.leaf.rpartition("_") if "_" in self.leaf else (self.leaf, "", "")
        return word.strip(), unit.strip()

    @property
    def parts(self) -> tuple[str, str]:
        """Quantity and unit of the column: ('drive', 'V') for 'drive_V' or 'drive [V]'."""
        word, unit = self._named
        if any(self.unit in known for known in FACTORS.values()):
            return word, self.unit
        return word, symbol_of(unit) or symbol_of(self.unit) or unit or self.unit

    @property
    def contradiction(self) -> str:
        """The unit in the column's name if the file states the symbol of another one, as in a row of units; or empty.

        A word is not a contradiction: LabVIEW states "Volts" for every channel.
        """
        named, known = symbol_of(self._named[1]), FACTORS.get(quantity_of(self.unit), {})
        return named if self.unit in known and known.get(named) != known[self.unit] else ""

    @property
    def words(self) -> set[str]:
        """Its name without groups, with and without the unit, in lower case."""
        return {self.leaf.lower(), self.parts[0].lower()}

    @property
    def role(self) -> str:
        """Role as a further channel of a record, by name and unit: "temperature", "load" or "other".

        A temperature has "temp" in its name, or the unit degC, °C, degF or °F; a load has "load", "force" or "kraft".
        """
        word, unit = self.parts[0].lower(), self.parts[1]
        role = quantity_of(unit)
        degrees = "degC", "°C", "degF", "°F"
        parts, units = {"temperature": (("temp",), degrees), "load": (("load", "force", "kraft"), ())}.get(
            role, ((), ())
        )
        return role if unit in units or any(part in word for part in parts) else "other"

    @property
    def quantities(self) -> set[str]:
        """The quantities whose words are the column's name; most names have none."""
        return {
            quantity
            for quantity, known in QUANTITIES.items()
            if self.words & {*known.words.split(", "), *known.more.split(", ")}
        }


def without_groups(column: Column) -> Column:
    """Return a column of a flat table, where a slash before a unit ends no group: "Position/nm", but not "um/V"."""
    divided = _DIVIDED.fullmatch(column.name) if len(column.name) <= _SHOWN else None
    unit = symbol_of(divided[2]) if divided else ""
    if divided is None or not unit or symbol_of(divided[1].split()[-1]) not in ("", unit):
        return column
    return replace(column, divided=True)


class ColumnError(FileFormatError):
    """A quantity that cannot be read from its column.

    `problem`: the problem, without the name of the file and the hint. `column`: the column concerned, if any.
    """

    def __init__(
        self,
        source: str,
        quantity: str,
        problem: str,
        hint: str = "",
        column: Column | None = None,
        change: Sequence[str] = (),
    ) -> None:
        super().__init__(f"{source}: {problem}", hint=hint, change=change)
        self.quantity, self.problem, self.column = quantity, problem, column

    @property
    def unsolvable(self) -> bool:
        """Whether no option helps: several columns have one name."""
        return self.column is None and not self.change


def _option(quantity: str, value: str) -> str:
    return f'{quantity.replace("_", " ")} "{value}"'


@dataclass(frozen=True, eq=False)
class Selected:
    """The column that was selected for a quantity.

    `unit`: unit of the column, from the user or the file. `scale`: scale of an amplifier's monitor or of a sensor.
    `guess`: guessed properties of the column; empty if all are known.
    """

    source: str
    quantity: str
    column: Column
    unit: str
    scale: Scale | None = None
    guess: str = ""

    @property
    def usable(self) -> bool:
        """Whether it has numbers in a known unit."""
        return self.unit in FACTORS[self.quantity] and not self.column.fault

    @cached_property
    def values(self) -> Array:
        """The column (n,) in seconds, volts or metres.

        Raise `ColumnError` if its cells are not numbers, its unit is unknown, the scale does not fit, or it seems to be
        a monitor's voltage without a scale.
        """
        column, scale = self.column, self.scale
        if column.fault:
            raise self._error(f": {column.fault}", change=("sample_rate",) * (self.quantity == "time"))
        if scale is not None:
            unit = self.unit or scale.per
            if refusal := scale.refusal(unit):
                problem = f" has the unit '{shortened(unit)}', but {refusal}"
                example = f", as {scale.words.partition('/')[0]}/{unit}" if symbol_of(unit) else ""
                advice = f"give a scale for that unit{example}, or leave it out"
                raise self._error(problem, advice, change=(f"{self.quantity}_scale",), usable=False)
        elif self.unit not in FACTORS[self.quantity]:
            raise self._unknown_unit()
        # The record refuses overflow and NaN, with the row.
        with np.errstate(all="ignore"):
            values: Array = in_si(column.data, self.unit) if scale is None else column.data * scale.apply(unit)
        if self.quantity == "voltage" and scale is None and is_plug(column.name) and is_small(values):
            given = _option("voltage_scale", f"{GAIN} V/V")
            raise self._error(
                f" has the name of an output or a monitor, and only {values.min():.4g} to {values.max():.4g} V",
                f"if an amplifier multiplies or divides it, give {given} with the gain for {GAIN}; if these are the "
                f"volts of the actuator, give {_option('voltage_scale', '1 V/V')}",
                change=("voltage_scale",),
            )
        return values

    def _error(self, problem: str, hint: str = "", *, change: Sequence[str] = (), usable: bool = True) -> ColumnError:
        problem = f"column '{shortened(self.column.name)}'{problem}"
        return ColumnError(self.source, self.quantity, problem, hint, self.column if usable else None, change)

    def _unknown_unit(self) -> ColumnError:
        quantity, unit, example = self.quantity, self.unit, QUANTITIES[self.quantity].example
        stated = f" has the unit '{shortened(unit)}', unknown for {quantity}" if unit else " has no unit"
        advice = f"known are {', '.join(FACTORS[quantity])}. "
        sensor = quantity_of(unit) == "voltage" and quantity == "displacement"
        if sensor:
            scale = _option("displacement_scale", f"{GAIN} um/{unit}")
            advice += (
                f"If it is a sensor's voltage, give its scale, {scale} with a number for {GAIN}; or select another "
            )
            advice += f"column with {_option(quantity, 'NAME')}"
        elif quantity_of(unit):
            advice += f"Select another column with {_option(quantity, 'NAME')}, or correct the unit in the file"
        else:
            guess = "" if unit else plausible_unit(quantity, self.column.data)
            named = _option(quantity, f"{shortened(self.column.name)}:{guess + GUESS if guess else 'UNIT'}")
            advice += f"Name it like '{example}' or '{example.replace('_', ' [')}]', or give {named}"
        change = ("displacement_scale", quantity) if sensor else (quantity,)
        return self._error(stated, advice, change=change, usable=sensor or not unit)

    def refuse_other_unit(self, given: str) -> None:
        """Raise ColumnError if the name of the column, the file and the user state different units.

        `given`: the unit that the user gives; without one, two units of the column contradict one another. With one,
        nobody takes volts for micrometres, or for millivolts, without a scale.
        """
        quantity, known, stated = self.quantity, FACTORS[self.quantity], self.column.parts[1]
        scale = f"{quantity}_scale" if quantity != "time" else ""
        if not given:
            if named := self.column.contradiction:
                units = [unit for unit in (named, stated) if unit in known]
                options = " or ".join(_option(quantity, f"{shortened(self.column.name)}:{unit}") for unit in units)
                problem = f" has the unit '{named}' in its name, but the file states '{stated}' for it"
                ways = f", or give {options}" if units else ""
                raise self._error(f"{problem}; correct one of them{ways}", change=(quantity,))
            return
        problem = f" has the unit '{stated}' in the file, got '{given}'"
        if quantity_of(stated) not in ("", quantity) and quantity_of(given) == quantity:
            option = _option(scale, f"{GAIN} {given}/{stated}")
            advice = f"give the scale from one to the other, {option} with a number for {GAIN}"
            advice = advice if scale else "select another column"
            raise self._error(problem, advice, change=(scale or quantity,), usable=False)
        if given in known and stated in known and known[given] != known[stated]:
            option = _option(scale, f"{known[given] / known[stated]:g} {stated}/{stated}")
            right = f", give {option}" if scale else ", correct it there"
            raise self._error(problem, f"if the file is wrong{right}", change=(scale,) if scale else (), usable=False)


@dataclass(frozen=True, eq=False, slots=True)
class Table:
    """The columns of one file, still in the file's units.

    `remarks`: sentences about changes to the columns, for the notes of a record.
    """

    source: str
    sha256: str
    columns: tuple[Column, ...]
    remarks: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Column names as in the file, with their groups."""
        return tuple(column.name for column in self.columns)

    def column(self, quantity: str, wanted: str | None = None, scale: str | None = None) -> Array:
        """Return the column (n,) of a quantity in seconds, volts or metres, see `select`."""
        return self.select(quantity, wanted, scale).values

    def select(self, quantity: str, wanted: str | None = None, scale: str | None = None) -> Selected:
        """Select the column of a `quantity` ("time", "voltage" or "displacement").

        `wanted`: name, unique last part of the name, or "name:unit"; by default the one column named like the quantity.
        A "?" at its end marks it as a guess. `scale`: scale of an amplifier's monitor or of a sensor, as "100 V/V" or
        "10 um/V". Raise `FileFormatError` if there are no or several such columns, units contradict, or the scale is
        invalid.
        """
        if not isinstance(wanted, str | None):
            need = f"the name of a column, as '{QUANTITIES[quantity].example}'"
            raise FileFormatError(argument=quantity, got=repr(wanted), need=need)
        if wanted is None and self.columns and self.columns[0].unnamed:
            raise ColumnError(self.source, quantity, self.columns[0].unnamed, change=("columns",))
        # A column may have a name that ends as a guess does.
        bare = wanted if wanted is None or self._named(wanted) else wanted.removesuffix(GUESS)
        fits, unit = self._fits(quantity, bare)
        if len(fits) != 1:
            raise self._not_one(quantity, wanted, fits)
        column, given = fits[0], symbol_of(unit) or unit
        unit = given or column.parts[1]
        guess = f"column '{shortened(column.name)}'{f' in {unit}' if unit else ''}" if bare != wanted else ""
        guess = "; ".join(part for part in (guess, column.guessed) if part)
        found = Selected(self.source, quantity, column, unit, guess=guess)
        if not given or given not in (column.parts[1], column.contradiction):
            found.refuse_other_unit(given)
        return found if scale is None else replace(found, scale=scale_of(quantity, scale))

    def _not_one(self, quantity: str, wanted: str | None, fits: list[Column]) -> ColumnError:
        request = f"column '{wanted}' for {quantity}" if wanted is not None else f"{quantity} column"
        count = f"{len(fits)} columns fit: {listed(tuple(c.name for c in fits))}" if fits else f"no {request}"
        if len({c.name for c in fits}) == 1:
            hint = "columns of one name cannot be told apart: give each a name of its own in the file"
            return ColumnError(self.source, quantity, f"{count} as {request}", hint)
        example = QUANTITIES[quantity].example
        # Where several columns fit, their names are found already.
        hint = f" A name like '{example}' is found by itself." if wanted is None and not fits else ""
        rate = " Without one, give the sample rate in Hz." if quantity == "time" and not fits else ""
        return ColumnError(
            self.source,
            quantity,
            f"{count}{f' as {request}' if fits else ''}",
            f"the file holds {listed(self.names)}. Select one with {_option(quantity, 'NAME')}.{hint}{rate}",
            change=(quantity, "sample_rate") if rate else (quantity,),
        )

    def fitting(self, quantity: str, wanted: str | None = None) -> int:
        """Return the number of columns that `select` would choose from."""
        return len(self._fits(quantity, wanted)[0])

    def _fits(self, quantity: str, wanted: str | None) -> tuple[list[Column], str]:
        """Return the columns of a quantity, or of a name, and the unit that the name states."""
        fits = self._candidates(quantity) if wanted is None else self._named(wanted)
        if wanted is None or fits or ":" not in wanted:
            return fits, ""
        name, unit = (part.strip() for part in wanted.rsplit(":", 1))
        return self._named(name), unit

    def _candidates(self, quantity: str) -> list[Column]:
        known, units = QUANTITIES[quantity], FACTORS[quantity]
        fits = [c for c in self.columns if c.words & {*known.words.split(", ")}]
        fits = [c for c in fits if not c.foreign] or fits
        fits = [c for c in fits if c.parts[1] in units] or fits
        if quantity == "displacement" and fits and all(c.parts[0].lower() in _AXES for c in fits):
            return [c for c in self.columns if c.parts[0].lower() in _AXES and c.parts[1] in units] or fits
        more = {*known.more.split(", ")}
        return fits or [c for c in self.columns if c.words & more and c.parts[1] in units]

    def _named(self, name: str) -> list[Column]:
        name = name.strip().strip("/")
        exact = [c for c in self.columns if c.name == name]
        leaf = [c for c in self.columns if c.leaf == name]
        dotted = [c for c in self.columns if c.name.replace("/", ".") == name]
        return exact or leaf or dotted or [c for c in self.columns if c.parts[0] == name]
