"""Conversion of file tables to the columns of a record: names, choice of columns, and joining of two files."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import permutations
from typing import NamedTuple

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._text import counted
from dehyst._types import Array
from dehyst._units import FACTORS, quantity_of, symbol_of
from dehyst._validation import axis_names
from dehyst.records.formats import columns as known
from dehyst.records.formats.columns import (
    GAIN,
    GUESS,
    QUANTITIES,
    Column,
    ColumnError,
    Selected,
    Table,
    listed,
    shortened,
)

# What a user replaces by the samples a second.
RATE = "HZ"
_SCALES = {"voltage": "V/V", "displacement": "um/V"}
_SCALED = re.compile(rf"(.*?)\s*\*\s*(-?[\d.]+(?:[eE][+-]?\d+)?|{GAIN})\s*([^\s/*]+\s*/\s*[^\s/*]+)?\s*", re.DOTALL)


class Choice(NamedTuple):
    """Selection of the columns of a record: names, scales, and a sample rate [Hz] instead of a time."""

    time: str | None = None
    voltage: str | None = None
    displacement: str | None = None
    voltage_scale: str | None = None
    displacement_scale: str | None = None
    sample_rate: float | None = None

    def scale(self, quantity: str) -> str | None:
        """Return the scale of a quantity."""
        return None if quantity == "time" else getattr(self, f"{quantity}_scale")


class AxisColumns(NamedTuple):
    """The `name` of an axis, the columns of its voltage and its displacement, and their scales."""

    name: str
    voltage: str
    displacement: str
    voltage_scale: str | None = None
    displacement_scale: str | None = None

    @property
    def text(self) -> str:
        """The axis as `axis_columns` reads it."""
        pairs = ((self.voltage, self.voltage_scale), (self.displacement, self.displacement_scale))
        return f"{self.name}={':'.join(with_scale(*pair) for pair in pairs)}"

    def choice(self, common: Choice) -> Choice:
        """Return the selection of its columns; a scale of `common` holds if the axis has none."""
        own = {name: value for name, value in self._asdict().items() if name != "name" and value is not None}
        return common._replace(**own)


def entries_of(text: str) -> list[str]:
    """Return the entries of a text with commas between them; one that holds a comma is in double quotes."""
    return next(csv.reader([text], skipinitialspace=True), [])


def text_of(entries: Iterable[str]) -> str:
    """Return the text of entries, see `entries_of`."""
    return ", ".join('"{}"'.format(one.replace('"', '""')) if set(one) & set(',"') else one for one in entries)


def scaled(quantity: str, text: str) -> tuple[str, str | None]:
    """Return the name and the scale in "NAME*SCALE" (None: no scale); without units a scale is in V/V or um/V."""
    match = _SCALED.fullmatch(text)
    return (text, None) if match is None else (match[1], f"{match[2]} {match[3] or _SCALES[quantity]}")


def with_scale(name: str | None, scale: str | None) -> str:
    """Return the text that `scaled` reads."""
    return (name or "") + ("" if scale is None else f"*{scale.removesuffix(' V/V')}")


def parts_of_axis(text: str) -> list[str]:
    """Return the columns of an axis, "NAME", "NAME:UNIT" or "NAME*SCALE" with colons between them.

    A unit belongs to the name before it.
    """
    found: list[str] = []
    for part in text.split(":"):
        unit = scaled("voltage", part)[0].removesuffix(GUESS)
        if found and ":" not in found[-1] and quantity_of(unit) in _SCALES:
            found[-1] += f":{part}"
        else:
            found.append(part)
    return [part.strip() for part in found]


def axis_columns(axes: str) -> tuple[AxisColumns, ...]:
    """Return the columns in `axes`, see `dehyst.read`.

    Raise `FileFormatError` if there are fewer than two axes, an entry has no two columns, or two axes or columns have
    one name.
    """

    def refusal(got: str, need: str) -> FileFormatError:
        return FileFormatError(argument="axes", got=got, need=f'{need}, as "x=vx_V:x_um, y=vy_V:y_um"')

    entries = []
    # Names may hold blanks if there are commas between the axes.
    texts = [] if not isinstance(axes, str) else entries_of(axes) if "," in axes else axes.split()
    for text in filter(None, map(str.strip, texts)):
        name, _, columns = text.rpartition("=")
        parts = parts_of_axis(columns)
        if len(parts) != 2 or not all(parts):
            need = "the columns of a voltage and a displacement (with a unit where the file states none: NAME:UNIT)"
            raise refusal(f"'{text}'", need)
        (voltage, gain), (displacement, scale) = map(scaled, _SCALES, parts)
        name = name.strip() or Column(displacement.partition(":")[0], np.empty(0)).parts[0]
        entries.append(AxisColumns(name, voltage, displacement, gain, scale))
    used = [column for one in entries for column in one[1:3]]
    if twice := sorted({column for column in used if used.count(column) > 1}):
        raise refusal(f"'{twice[0]}' twice", "columns of its own for each axis")
    if len(entries) < 2:
        raise refusal(repr(axes), "voltage and displacement of two axes at least")
    axis_names([one.name for one in entries], len(entries), "axes", FileFormatError)
    return tuple(entries)


def renamed(table: Table, columns: str) -> Table:
    """Return a table with the names and units of a text as "time:s,voltage:V,-,displacement:um".

    An entry without a unit keeps the unit in the file; "-" and an empty entry leave a column out; a "?" at the end of
    an entry marks it as a guess. A column whose entry has a unit, but is not a quantity of a record, is kept as a
    further channel. Raise `FileFormatError` if it is not text, the numbers of entries and columns differ, a unit is
    unknown, a name occurs twice, or there is no name.
    """
    if not isinstance(columns, str):
        need = "one text with commas, as 'time:s,voltage:V,displacement:um'"
        raise FileFormatError(argument="columns", got=repr(columns), need=need)

    def refusal(words: str) -> FileFormatError:
        return FileFormatError(f"{table.source}: columns: {words}")

    entries = [entry.strip() for entry in columns.split(",")]
    if len(entries) != len(table.columns):
        raise refusal(
            f"got {len(entries)} names, but the file holds {len(table.columns)} columns: {listed(table.names)}; give a "
            "name for each, and - for one that is to be left out"
        )
    named = []
    for entry, column in zip(entries, table.columns, strict=True):
        name, _, unit = (part.strip() for part in entry.removesuffix(GUESS).partition(":"))
        if unit and not symbol_of(unit) and Column(name, column.data).quantities:
            raise refusal(f"got the unit '{unit}', which is unknown; try s, V or um")
        if name in ("", "-"):
            continue
        if not unit and column.contradiction:
            raise refusal(
                f"'{name}' needs a unit: column '{shortened(column.name)}' has the unit '{column.contradiction}' in "
                f"its name, but the file states '{column.unit}' for it; give '{name}:UNIT'"
            )
        kept, unit = unit != "", symbol_of(unit) or unit or column.parts[1]
        guess = f"column '{shortened(column.name)}' in {unit or 'no unit'}" if entry.endswith(GUESS) else ""
        guess = "; ".join(part for part in (guess, column.guessed) if part)
        named.append(replace(column, name=name, unit=unit, unnamed="", divided=False, guessed=guess, kept=kept))
    names = [column.name for column in named]
    if len(set(names)) < len(names):
        raise refusal(f"got {listed(tuple(names))}; give each name once")
    if not named:
        raise refusal(f"got '{columns}', which leaves out all columns; name one at least, as time:s")
    return replace(table, columns=tuple(named))


class ColumnsError(FileFormatError):
    """Columns of a record that are not found, with the options of `read` that may select them.

    `reason`: the message without `options`, which are to be checked by the user. `change`: as in `DehystError`, in
    addition to these options. `problems`: of each column.
    """

    problems: tuple[ColumnError, ...] = ()

    def __init__(self, reason: str, options: Mapping[str, str], change: Iterable[str] = ()) -> None:
        given = [f'{name.replace("_", " ")} "{value}"' for name, value in options.items()]
        stop = "" if reason.endswith(".") else "."
        advice = f"{stop} Try {', '.join(given)}. {' '.join(notes_on(options))}"
        advice = "" if all(option in reason for option in given) else advice
        super().__init__(f"{reason}{advice}", change=list(dict.fromkeys([*options, *change])))
        self.reason, self.options = reason, dict(options)

    def as_dict(self) -> dict[str, object]:
        """Return JSON values, with the options to try."""
        return {**super().as_dict(), "reason": self.reason, "suggestion": dict(self.options)}


def notes_on(options: Mapping[str, str]) -> list[str]:
    """Return sentences about proposed options: placeholders to replace, and guesses."""
    text = " ".join(options.values())
    notes = {
        RATE: f"Replace {RATE} by the number of samples a second.",
        GAIN: f"Replace {GAIN} by what the data sheet states: volts of the actuator for one volt of the column (1 V/V "
        "if the column holds the actuator's voltage), micrometres for one volt of a sensor.",
        GUESS: f"A {GUESS} marks a guess; leave it out once you have verified the column and its unit.",
    }
    shown = {RATE: RATE in options.values(), GAIN: GAIN in text, GUESS: GUESS in text}
    return ["Check units and scales.", *(note for mark, note in notes.items() if shown[mark])]


def chosen(table: Table, choice: Choice, quantities: tuple[str, ...]) -> dict[str, Selected]:
    """Return the columns of quantities, whose `values` are known to be numbers in SI units.

    Raise `ColumnsError` if some of them cannot be read: all problems, and options that would solve them.
    """
    found: dict[str, Selected] = {}
    problems: list[ColumnError] = []
    for quantity in quantities:
        try:
            one = table.select(quantity, getattr(choice, quantity), choice.scale(quantity))
            _, found[quantity] = one.values, one
        except ColumnError as error:
            problems.append(error)
    if problems:
        refused = _columns_error(table, choice, problems, {one.column.name for one in found.values()})
        refused.problems = tuple(problems)
        raise refused
    return found


def error_of_axis(table: Table, axis: str, problems: Iterable[ColumnError], entry: str) -> FileFormatError:
    """Return the problems with the columns of an axis as one error; `entry`: what its columns are given as."""
    found = list(problems)
    untimed = any(one.quantity == "time" for one in found)
    rate = "; without a time column, give the sample rate in Hz" if untimed else ""
    faults = "; ".join(dict.fromkeys(one.problem for one in found))
    if unsolvable := [one.hint for one in found if one.unsolvable]:
        return FileFormatError(f"{table.source}: {faults}", hint=unsolvable[0])
    return FileFormatError(
        f"{table.source}: {faults}",
        hint=f'the file holds {listed(table.names)}. Give the axis {axis} as "{axis}={entry}", with a unit where the '
        f"file states none (NAME:UNIT), and a scale of a monitor or a sensor (NAME*{GAIN}, NAME*-1um/um){rate}",
        change=("time", "sample_rate") if untimed else (),
    )


def _columns_error(table: Table, choice: Choice, problems: list[ColumnError], taken: set[str]) -> ColumnsError:
    """Return all problems as one error, with options for the columns: those of problems, else the most likely ones."""
    if unsolvable := [error for error in problems if error.unsolvable]:
        faults = "; ".join(dict.fromkeys(error.problem for error in unsolvable))
        return ColumnsError(f"{table.source}: {faults}; {unsolvable[0].hint}", {}, [])
    used = {error.quantity: error.column for error in problems if error.column and not error.column.fault}
    free = [c for c in table.columns if c.name not in taken and not c.fault and c not in used.values()]
    proposal = used | _assigned(free, [error.quantity for error in problems if error.quantity not in used])
    # A quantity that no column of this file seems to be may be in a second file.
    lacking = {error.quantity for error in problems if not error.column} - proposal.keys() - {"time"}
    join = bool(lacking) and not any(column.unnamed for column in table.columns)
    joining = " If it is in a second file, join that one." if join else ""
    if len({error.problem for error in problems}) == 1:
        reason = f"{table.source}: {problems[0].problem}{'; ' * bool(problems[0].hint)}{problems[0].hint}"
        reason = f"{reason}{'' if not join or reason.endswith('.') else '.'}{joining}"
    else:
        asked = " and ".join(f"that of the {error.quantity}" for error in problems)
        names = ", ".join(f"'{QUANTITIES[error.quantity].example}'" for error in problems)
        untimed = any(error.quantity == "time" for error in problems)
        rate = " Without a time column, give the sample rate in Hz." if untimed else ""
        faults = "; ".join(error.problem for error in problems)
        reason = (
            f"{table.source}: {faults}; the file holds {listed(table.names)}. Name {asked}. Names like {names} are "
            f"found by themselves.{rate}{joining}"
        )
    change = [name for error in problems for name in error.change] + ["join"] * join
    return ColumnsError(reason, _options(table, choice, problems, proposal), change)


def _options(
    table: Table, choice: Choice, problems: list[ColumnError], proposal: Mapping[str, Column]
) -> dict[str, str]:
    """Return options that select columns of a plausible range; none if there is no column for a quantity."""
    wanted = [error.quantity for error in problems]
    if any(column.unnamed and not column.fault for column in table.columns) and len(proposal) == len(wanted):
        units = {quantity: known.plausible_unit(quantity, column.data) for quantity, column in proposal.items()}
        entries = {
            c.name: f"{quantity}:{units[quantity]}{GUESS}" for quantity, c in proposal.items() if units[quantity]
        }
        names = ",".join(entries.get(column.name, "-") for column in table.columns)
        return {"columns": names} | _gain(choice, proposal.get("voltage"), units.get("voltage", ""))
    for quantity, column in proposal.items():
        scale, stated = choice.scale(quantity), column.parts[1]
        if column.contradiction or (scale is not None and stated and known.scale_of(quantity, scale).refusal(stated)):
            # No name mends a scale that is wrong, or units that contradict one another.
            return {}
    named = {error.quantity for error in problems if error.column and not error.column.fault}
    options: dict[str, str] = {}
    for quantity in wanted:
        if quantity in proposal:
            options |= _option(quantity, proposal[quantity], choice, guessed=quantity not in named)
    untimed = "time" in wanted and "time" not in proposal and choice.time is None
    return options | ({"sample_rate": RATE} if untimed and {*wanted} - {"time"} <= options.keys() else {})


def _option(quantity: str, column: Column, choice: Choice, *, guessed: bool) -> dict[str, str]:
    """Return the options for a column; `guessed`: whether the quantity does not follow from its name."""
    name, unit, scale = column.name, column.parts[1], choice.scale(quantity)
    given = f"{name}{GUESS if guessed else ''}"
    if unit not in FACTORS[quantity] and scale is None:
        if quantity == "displacement" and quantity_of(unit) == "voltage":
            return {quantity: given, "displacement_scale": f"{GAIN} um/{unit}"}
        unit = "" if quantity_of(unit) else known.plausible_unit(quantity, column.data)
        if not unit:
            return {}
        given = f"{name}:{unit}{GUESS}"
    plug = quantity == "voltage" and (guessed or known.is_plug(name))
    return {quantity: given} | (_gain(choice, column, unit) if plug else {})


def _gain(choice: Choice, column: Column | None, unit: str) -> dict[str, str]:
    """Return the option that asks for an amplifier's gain if a column has the voltages of its input or monitor."""
    if column is None or choice.voltage_scale is not None:
        return {}
    small = known.is_small(column.data * FACTORS["voltage"].get(unit, 1))
    return {"voltage_scale": f"{GAIN} V/V"} if small else {}


# Names of columns that count samples.
_COUNTS = {"index", "idx", "sample", "samples", "point", "points", "count", "no", "nr", "n", "#", "sequence"}
# Columns of a file that are compared with one another.
_MOST = 12


def _assigned(free: list[Column], wanted: list[str]) -> dict[str, Column]:
    """Return the most likely column for each quantity; the first that rises is a time, and no other quantity does."""
    used: dict[str, Column] = {}
    rising = [c for c in free if c.data.size > 1 and np.all(c.data[1:] > c.data[:-1])]
    if "time" in wanted and (clocks := [column for column in rising if not _counts(column)]):
        used["time"] = min(clocks, key=lambda column: _unlikeliness(column, "time"))
    rest = [column for column in free if column not in rising][:_MOST]
    others = [quantity for quantity in ("voltage", "displacement") if quantity in wanted]
    ways = [dict(zip(others, way, strict=True)) for way in permutations(rest, len(others))]
    best = min(ways, key=lambda way: sum(_unlikeliness(c, q) for q, c in way.items()), default={})
    return used | best


def _unlikeliness(column: Column, quantity: str) -> int:
    """Return how little the name and the unit of a column are those of a quantity."""
    word, unit = column.parts
    stated, lower = quantity_of(unit), f"{word} {column.leaf}".lower()
    fits = {name for name, one in QUANTITIES.items() if any(part in lower for part in one.parts.split(", "))}
    named = quantity in fits or (len(word) == 1 and word.lower() in QUANTITIES[quantity].letters)
    sensor = quantity == "displacement" and stated == "voltage"
    return (0 if stated == quantity else 1 if not stated or sensor else 4) - 2 * named + bool(fits - {quantity})


def _counts(column: Column) -> bool:
    """Return whether a column counts samples: a time has a unit, or another name."""
    word, unit = column.parts
    steps = np.diff(column.data)
    return not unit and word.strip(" .").lower() in _COUNTS and bool(np.all(steps == steps[:1]) and steps[:1] % 1 == 0)


# Part of a sample by which the times of two files may differ and are still the same.
_SAME = 0.01
# A time step above this multiple of the median is a gap.
_GAP = 2.5
# Samples of one file for each of the other from which on that is remarked.
_FEW = 4.0
_DAY = 86_400


class _Timed(NamedTuple):
    """A file with a time: its table, its time column with the unit, and the seconds of its samples."""

    table: Table
    column: Column
    unit: str
    seconds: Array


def joined(table: Table, other: Table, choice: Choice) -> Table:
    """Return a table with the columns of both.

    Timestamps are aligned by date and time; times without a date count as times of one clock. Where both have a time
    column and the times differ, the table has the samples of the file with the displacement, else of the first: the
    columns of the other file are interpolated in straight lines, which would take the noise of a sensor away, and
    samples before its first or after its last are left out. Otherwise sample belongs to sample. Names of the other
    follow the name of its file: other/displacement_um.

    `choice`: names of the time and the displacement, by default found, and the sample rate. Raise `FileFormatError` if,
    without two time columns, the files differ in length; with them, if the times do not rise or do not overlap, or only
    one of the files has timestamps.
    """
    first, second = (None if choice.sample_rate is not None else _timed(one, choice.time) for one in (table, other))
    stem = other.source.rsplit(".", 1)[0]
    added = [replace(c, name=f"{stem}/{c.name}") for c in other.columns if second is None or c is not second.column]
    if first is not None and second is not None:
        second = second._replace(seconds=second.seconds + _offset(first, second))
    if first is None or second is None or _alike(first.seconds, second.seconds):
        samples, more = (max((c.data.size for c in one.columns), default=0) for one in (table, other))
        if broken := [one for one in (table, other) if all(column.fault for column in one.columns)]:
            raise FileFormatError(f"join: {broken[0].source} has no column of numbers: {broken[0].columns[0].fault}")
        if samples != more:
            got = f"{samples} samples in {table.source} and {more} in {other.source}"
            hint = "cut one of them, or save it with its time"
            raise FileFormatError(argument="join", got=got, need="as many, or a time column in both", hint=hint)
        return replace(table, columns=(*table.columns, *added))
    for one in (first, second):
        if not np.all(np.diff(one.seconds) > 0):
            raise FileFormatError(
                f"{one.table.source}: the time does not rise, which joining needs; correct those rows"
            )
    kept, moved = first, second
    own = table.fitting("displacement", choice.displacement)
    if not own and replace(other, columns=tuple(added)).fitting("displacement", choice.displacement):
        kept, moved = second, first
    inside, remarks = _common(kept, moved)
    places = kept.seconds[inside]
    columns = [
        replace(column, data=places / FACTORS["time"][first.unit])
        if column is first.column and moved is first
        else _aligned(column, timed.seconds, inside if timed is kept else places)
        for timed, columns in ((first, table.columns), (second, added))
        for column in columns
    ]
    return replace(table, columns=tuple(columns), remarks=(*table.remarks, *remarks))


def _timed(table: Table, wanted: str | None) -> _Timed | None:
    """Return a table with its time; None if it has no time column."""
    for name in (wanted, None):
        if table.fitting("time", name):
            one = table.select("time", name)
            return _Timed(table, one.column, one.unit, one.values)
    return None


def _offset(first: _Timed, second: _Timed) -> float:
    """Return the time [s] from the zero of the first file's clock to that of the second's.

    Where the order of day and month is unknown, the one in which the files overlap counts.
    """
    ones, twos = first.column.began, second.column.began
    if not ones and not twos:
        return 0.0
    origins = [f"times from {began[0][0]}" if began else "seconds from an unknown moment" for began in (ones, twos)]
    if origins[0] != origins[1]:
        raise FileFormatError(
            f"join: {first.table.source} has {origins[0]} and {second.table.source} has {origins[1]}, need one clock "
            "for both; save both with date and offset from UTC, or both in seconds from one moment"
        )
    offsets = list(dict.fromkeys(float(two[1] - one[1]) + (two[2] - one[2]) for one in ones for two in twos))
    if ones[0][0].startswith("midnight"):
        offsets = [offset - _DAY * round(offset / _DAY) for offset in offsets]
    (a, b), (c, d) = ((float(np.min(one.seconds)), float(np.max(one.seconds))) for one in (first, second))
    common = [offset for offset in offsets if max(a, c + offset) <= min(b, d + offset)]
    if len(common) > 1:
        raise FileFormatError(
            f"join: the dates of {first.table.source} and {second.table.source} may be month/day/year or "
            "day/month/year, and both give times in common; write the dates as 2026-03-04"
        )
    return (common or offsets)[0]


def _alike(first: Array, second: Array) -> bool:
    if first.size != second.size or first.size < 2:
        return first.size == second.size
    step = float(np.median(np.abs(np.diff(first))))
    return bool(np.all(np.abs(first - second) <= _SAME * step))


def _common(kept: _Timed, moved: _Timed) -> tuple[Array, list[str]]:
    """Return which samples of a file lie within the times of the other, and remarks on the other's."""
    times, others = kept.seconds, moved.seconds
    inside = (times >= others[0]) & (times <= others[-1])
    if np.count_nonzero(inside) < 2:
        raise FileFormatError(
            f"join: {kept.table.source} lasts from {times[0]:.6g} to {times[-1]:.6g} s and {moved.table.source} from "
            f"{others[0]:.6g} to {others[-1]:.6g} s, need times in common; correct one of them, or give a sample rate "
            "for files without their time columns",
            change=("sample_rate",),
        )
    places, remarks = times[inside], []
    near = others[(others >= places[0]) & (others <= places[-1])]
    steps = np.diff(others)
    gaps = np.flatnonzero(steps > _GAP * np.median(steps))
    gaps = gaps[(others[gaps + 1] > places[0]) & (others[gaps] < places[-1])]
    if gaps.size:
        i = int(gaps[0])
        remarks.append(
            f"{moved.table.source} has {counted(gaps.size, 'gap')} in time, the first of {steps[i]:.4g} s from "
            f"{others[i]:.6g} s on: its columns are straight lines there; leave these times out."
        )
    if places.size > _FEW * max(near.size, 1):
        remarks.append(
            f"{moved.table.source} has {counted(near.size, 'sample')} for {places.size} of {kept.table.source}: its "
            "columns are straight lines between them; record both equally fast."
        )
    return inside, remarks


def _aligned(column: Column, times: Array, places: Array) -> Column:
    """Return a column of a file at places: which of its samples, or the times [s] of others.

    One that has not a number for each of the file's `times` has a fault.
    """
    if column.fault:
        return column
    if column.data.size != times.size:
        had = f"it has {counted(column.data.size, 'sample')} where its time has {times.size}, which joining needs"
        return replace(column, data=np.empty(0), fault=f"{had}; select another column")
    data = column.data[places] if places.dtype == bool else np.interp(places, times, column.data)
    return replace(column, data=data)
