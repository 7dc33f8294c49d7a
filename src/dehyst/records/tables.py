"""Tables of files: the columns of a record in them, proposals where these are not known, and two files joined."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._types import Array
from dehyst._units import FACTORS, in_si, quantity_of
from dehyst._views.lines import span_of
from dehyst.records.columns import RATE, Columns, Entry, Scale, text_of
from dehyst.records.formats.column import (
    GAIN,
    GUESS,
    QUANTITIES,
    Column,
    impossible,
    is_small,
    listed,
    plausible_unit,
    shortened,
)
from dehyst.records.loops import fringes

_UNNAMED = (
    "its columns have no names; save three arrays with the names time_s, voltage_V and displacement_um, write such a "
    "row above the table, not behind a # or %, or select them by their numbers, as voltage=2:V"
)
# Names of the axes of a stage: with several of them in a file, "y" is not the displacement.
_AXES = {"x", "y", "z"}
# Largest number of columns of a file that are compared with one another; times that show the usual step.
_MOST, _STEPS = 12, 10_000


class ColumnError(FileFormatError):
    """A quantity that cannot be read from its column.

    `problem`: the problem, without the name of the file and the hint. `column`: the column concerned, if any.
    """

    def __init__(self, source: str, quantity: str, problem: str, hint: str = "", column: Column | None = None) -> None:
        super().__init__(f"{source}: {problem}", hint=hint, change=("columns",))
        self.quantity, self.problem, self.column = quantity, problem, column


class ColumnsError(FileFormatError):
    """Columns of a record that are not found.

    `reason`: the message without the proposal. `proposal`: text of columns that may be right, which the user has to
    check and to complete, see `notes_on`; empty if there is none. `problems`: the error of each column.
    """

    def __init__(self, reason: str, proposal: str, problems: Sequence[ColumnError] = ()) -> None:
        advice = f" Try columns='{proposal}'. {' '.join(notes_on(proposal))}" if proposal else ""
        stop = "" if reason.endswith(".") or not advice else "."
        super().__init__(f"{reason}{stop}{advice}", change=("columns",) if proposal else ())
        self.reason, self.proposal, self.problems = reason, proposal, tuple(problems)

    def as_dict(self) -> dict[str, object]:
        """Return JSON values, with the columns to try."""
        return {**super().as_dict(), "reason": self.reason, "suggestion": self.proposal}


def notes_on(proposal: str) -> list[str]:
    """Return sentences about proposed columns: placeholders to replace, and guesses."""
    notes = {
        RATE: f"Replace {RATE} by the number of samples a second.",
        GAIN: f"Replace {GAIN} by the volts at the actuator, or the displacement, for one unit of the column; "
        "of a fringe half the wavelength, of a grating the distance of its lines; 1 for the actuator's voltage itself.",
        GUESS: f"A {GUESS} marks a guess; leave it out once you have verified the column and its unit.",
    }
    return ["Check units and scales.", *(note for mark, note in notes.items() if mark in proposal)]


class Selected(NamedTuple):
    """The column of a quantity: how it was selected, its `values` (n,) in SI units, and what is guessed.

    For a periodic signal, the values are the signal itself.
    """

    column: Column
    entry: Entry
    values: Array
    guess: str = ""


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

    @property
    def rows(self) -> int:
        """Length of the longest column."""
        return max((column.data.size for column in self.columns), default=0)

    def column(self, quantity: str, wanted: str | None = None) -> Array:
        """Return the column (n,) of a quantity in seconds, volts or metres, see `select`."""
        return self.select(quantity, wanted).values

    def with_rate(self, rate: float) -> Table:
        """Return the table with the index over a rate [Hz] as its time; raise if a time that rises contradicts it."""
        clock = Column("time", np.arange(float(self.rows)) / rate, "s")
        others = [column for column in self.columns if "time" not in column.quantities]
        left = tuple(name for name in self.names if name not in {column.name for column in others})
        steps, away = np.zeros(0), 0.0
        with suppress(FileFormatError):
            time = self.column("time")
            steps, away = np.diff(time), float(np.abs(time - time[0] - clock.data[: time.size]).max(initial=0.0))
        if steps.size and steps.min() > 0 and away > 1 / rate:
            got = f"{rate:g} Hz, but the time of {self.source} has steps of {float(np.median(steps)):.4g} s, or gaps"
            raise FileFormatError(argument="rate", got=got, need="the rate of that time, or none")
        remarks = (f"The time is computed from the rate, not read from {listed(left)}.",) if left else ()
        return replace(self, columns=(clock, *others), remarks=(*self.remarks, *remarks))

    def select(self, quantity: str, wanted: str | None = None) -> Selected:
        """Select the column of a quantity, see `Columns`; without a name the one column named like the quantity.

        Raise `ColumnError` if none or several fit, units contradict or are unknown, cells are no numbers, the scale
        does not fit, or it seems to be a monitor's voltage without a scale.
        """
        entry, fits = self._fits(quantity, wanted)
        if not entry.name and self.columns and self.columns[0].unnamed:
            raise ColumnError(self.source, quantity, _UNNAMED)
        if len(fits) != 1:
            raise self._not_one(quantity, entry.name, fits)
        (column,) = fits
        unit, name = entry.unit or column.parts[1], f"column '{shortened(column.name)}'"
        # The record refuses overflow and NaN later, and names the row.
        with np.errstate(all="ignore"):
            if fault := _fault(quantity, column, entry):
                raise ColumnError(self.source, quantity, f"{name}{fault[0]}", fault[1], column)
            if entry.scale is None:
                values: Array = in_si(column.data, unit)
            else:
                values = column.data if entry.scale.kind else entry.scale.apply(quantity, unit, column.data)
            # The first median of NumPy imports modules that cost a tenth of reading a million rows.
            steps = np.diff(values[:_STEPS]) if quantity == "time" else values[:0]
            step = float(np.sort(steps)[steps.size // 2]) if steps.size and np.isfinite(steps).all() else 0.0
        if quantity == "voltage" and entry.scale is None and column.is_plug and is_small(values):
            hint = (
                f"if an amplifier multiplies or divides it, give {quantity}={shortened(column.name)}*{GAIN} with the "
                f"gain for {GAIN}; if these are the volts of the actuator, the gain is 1"
            )
            problem = f"{name} has the name of an output or a monitor, and only {span_of(values, 'V')}"
            raise ColumnError(self.source, quantity, problem, hint, column)
        if step > 0 and (words := impossible("time", step)):
            raise FileFormatError(f"{self.source}: {name}: {words}", change=("columns",))
        # The record shares these values.
        values.flags.writeable = False
        guess = f"{name}{f' in {unit}' if unit else ''}" if entry.guess else ""
        return Selected(column, entry, values, "; ".join(part for part in (guess, column.guessed) if part))

    def fitting(self, quantity: str, wanted: str | None = None) -> int:
        """Return the number of columns that `select` would choose from."""
        return len(self._fits(quantity, wanted)[1])

    def label(self, column: Column) -> str:
        """Return the name by which a column is selected: its own, or its number if it has none of its own."""
        own = self._named(column.name)
        plain = Entry.of(column.name) == Entry(column.name) and not {*"\r\n"} & {*column.name}
        return column.name if len(own) == 1 and plain else str(self.columns.index(column) + 1)

    def _not_one(self, quantity: str, wanted: str, fits: list[Column]) -> ColumnError:
        request = f"column '{wanted}' for {quantity}" if wanted else f"{quantity} column"
        count = f"{len(fits)} columns fit: {listed(tuple(c.name for c in fits))} as " if fits else "no "
        numbers = " or ".join(str(self.columns.index(c) + 1) for c in fits) if len({c.name for c in fits}) == 1 else ""
        way = f"by its number, {quantity}={numbers}" if numbers else f"with {quantity}=NAME"
        select = f"Select one {way}"
        hint = (
            f" A name like '{quantity}_{QUANTITIES[quantity].units[0]}' is found by itself."
            if not wanted and not fits
            else ""
        )
        rate = " Without one, give rate=HZ." if quantity == "time" and not fits else ""
        known = f"the file holds {listed(self.names)}. {select}.{hint}{rate}"
        return ColumnError(self.source, quantity, f"{count}{request}", known)

    def _fits(self, quantity: str, wanted: str | None) -> tuple[Entry, list[Column]]:
        """Return how a column is selected, and the columns that fit; the name of a column is not split."""
        if wanted and (own := self._named(wanted)):
            return Entry(wanted), own
        entry = Entry.of(wanted or "")
        return entry, self._named(entry.name) if entry.name else self._candidates(quantity)

    def _candidates(self, quantity: str) -> list[Column]:
        known, units = QUANTITIES[quantity], FACTORS[quantity]
        fits = [c for c in self.columns if c.words & {*known.words.split(", ")}]
        fits = [c for c in fits if c.parts[1] in units] or fits
        if quantity == "displacement" and fits and all(c.parts[0].lower() in _AXES for c in fits):
            return [c for c in self.columns if c.parts[0].lower() in _AXES and c.parts[1] in units] or fits
        return fits or [c for c in self.columns if c.words & {*known.more.split(", ")} and c.parts[1] in units]

    def _named(self, name: str) -> list[Column]:
        """Return the columns with a name, a last part of a name, a name without unit, or a number."""
        name = name.strip().strip("/")
        exact = [c for c in self.columns if c.name == name]
        leaf = [c for c in self.columns if c.leaf == name]
        dotted = [c for c in self.columns if c.name.replace("/", ".") == name]
        found = exact or leaf or dotted or [c for c in self.columns if c.parts[0] == name]
        place = int(name) if name.isascii() and name.isdigit() else 0
        return found or [*self.columns[place - 1 : place]] if place else found


def _fault(quantity: str, column: Column, entry: Entry) -> tuple[str, str] | None:
    """Return why a column cannot be read as an entry says, and what to try; None if it can."""
    known, given, stated, named = FACTORS[quantity], entry.unit, column.parts[1], column.contradiction
    unit, name = given or stated, shortened(column.name)
    to = given if given in known else QUANTITIES[quantity].units[0]
    scaled = f"give the scale, {quantity}={name}*{GAIN} {to}/{stated or given}"
    way = f"select another column with {quantity}=NAME"
    if column.fault:
        return f": {column.fault}", ""
    if named and not given:
        has = f" has the unit '{named}' in its name, but the file states '{stated}' for it"
        return f"{has}; correct one of them, or give {quantity}={name}:UNIT", ""
    same = given.casefold() in (stated.casefold(), named.casefold()) or known.get(given, 0) == known.get(stated, -1)
    if given and stated and not same:
        has, ways = f" has the unit '{stated}' in the file, got '{given}'", way if quantity == "time" else scaled
        return has, f"leave the unit out, or {ways}"
    if entry.scale is not None:
        fault, has = entry.scale.fault(quantity, unit), f" has the unit '{shortened(unit)}', but" if unit else ":"
        return (f"{has} {fault}", "give a scale for that unit, or leave it out") if fault else None
    if unit in known:
        return None
    if unit and quantity != "time" and quantity_of(unit) in ("", "voltage"):
        way = scaled
    elif not unit:
        way = f"name it like '{quantity}_{QUANTITIES[quantity].units[0]}', or give its unit, as {quantity}={name}:UNIT"
    has = f" has the unit '{shortened(unit)}', which is no {quantity}" if unit else " has no unit"
    return has, f"known are {', '.join(known)}; {way}"


def chosen(table: Table, columns: Columns, quantities: Sequence[str]) -> dict[str, Selected]:
    """Return the columns of quantities; raise `ColumnsError` with all problems, and columns that would solve them."""
    found: dict[str, Selected] = {}
    problems: list[ColumnError] = []
    for quantity in quantities:
        try:
            found[quantity] = table.select(quantity, getattr(columns, quantity))
        except ColumnError as error:
            problems.append(error)
    if not problems:
        return found
    proposal = _proposed(table, columns, problems, {quantity: part.column for quantity, part in found.items()})
    faults = "; ".join(dict.fromkeys(error.problem for error in problems))
    hints = list(dict.fromkeys(error.hint for error in problems))
    hint = hints[0] if len(hints) == 1 else f"the file holds {listed(table.names)}"
    raise ColumnsError(f"{table.source}: {faults}{f'; {hint}' if hint else ''}", proposal, problems)


def _proposed(table: Table, columns: Columns, problems: Sequence[ColumnError], used: Mapping[str, Column]) -> str:
    """Return the text of columns that may be right in the place of those with problems; empty if there are none."""
    named = {error.quantity: error.column for error in problems if error.column and not error.column.fault}
    wanted = [error.quantity for error in problems if error.quantity not in named]
    assigned = named | _assigned(table, wanted, [*used.values(), *named.values()])
    drive = assigned.get("voltage") or used.get("voltage")
    entries = {}
    for quantity in (error.quantity for error in problems if error.quantity in assigned):
        given = Entry.of(getattr(columns, quantity) or "")
        if "*" in given.name:
            # The factor that was given is not understood.
            return ""
        column, guessed = assigned[quantity], quantity not in named or given.guess
        pair = (drive.data, column.data) if drive and quantity == "displacement" and not given.scale else ()
        with np.errstate(all="ignore"):
            periodic = pair and pair[0].size == pair[1].size and fringes(*pair)
        if periodic:
            entries[quantity] = f"{table.label(column)}{GUESS}*fringe {GAIN} nm"
        elif text := _entry(table, quantity, column, given.scale, guessed=guessed):
            entries[quantity] = text
    # A rate would count the rows with a fault as samples.
    faulty = any(error.column for error in problems if error.quantity == "time")
    if "time" in wanted and "time" not in assigned and not columns.time and not faulty:
        entries["rate"] = RATE
    complete = {error.quantity for error in problems} - {"time"} <= entries.keys()
    return text_of(columns.entries() | entries) if complete and entries else ""


def _assigned(table: Table, wanted: Sequence[str], used: Sequence[Column]) -> dict[str, Column]:
    """Return the likeliest column of each wanted quantity; all have one length, and only a time may always rise."""
    free = [c for c in table.columns if c not in used and not c.fault and np.isfinite(c.data).any()]
    sizes = Counter(column.data.size for column in used or free)
    free = [column for column in free if column.data.size == max(sizes, key=lambda size: sizes[size])][:_MOST]
    rising = [column for column in free if column.data.size > 1 and np.all(column.data[1:] > column.data[:-1])]
    clocks = [c for c in rising if not c.is_counter and c.parts[1] in ("", *FACTORS["time"])]
    ways = [(quantity, c) for quantity in wanted for c in (clocks if quantity == "time" else free)]
    ways = [(quantity, c) for quantity, c in ways if quantity == "time" or c not in rising]
    found: dict[str, Column] = {}
    for quantity, column in sorted(ways, key=lambda way: _unlikeliness(way[1], way[0])):
        if quantity not in found and column not in found.values():
            found[quantity] = column
    return found if {*wanted} - {"time"} <= found.keys() else {}


def _unlikeliness(column: Column, quantity: str) -> int:
    """Return a number that is the larger, the less the name and the unit of a column fit a quantity."""
    word, unit = column.parts
    stated, lower = quantity_of(unit), f"{word} {column.leaf}".lower()
    fits = {name for name, known in QUANTITIES.items() if any(part in lower for part in known.parts.split(", "))}
    named = quantity in fits or (len(word) == 1 and word.lower() in QUANTITIES[quantity].letters)
    sensor = quantity == "displacement" and stated == "voltage"
    # A set point is not a measured displacement.
    target = 4 if quantity == "displacement" and column.is_set_point else 0
    cost = 0 if stated == quantity else 1 if not stated or sensor else 4
    return cost - 2 * named + bool(fits - {quantity}) + target


def _entry(table: Table, quantity: str, column: Column, scale: Scale | None, *, guessed: bool) -> str:
    """Return the entry that selects a column for a quantity, with a given scale; empty where no unit is plausible."""
    unit, name, known = column.parts[1], table.label(column), QUANTITIES[quantity]
    guess, factor = GUESS if guessed else "", f"*{scale}" if scale is not None else ""
    if column.contradiction or (quantity == "time" and quantity_of(unit) not in ("", "time")):
        return ""
    if not unit and (scale is None or column.is_channel):
        # A channel of an oscilloscope holds volts: the guess of any other unit would be wrong.
        channel = column.is_channel and quantity != "time"
        monitor = quantity == "voltage" and is_small(column.data)
        unit = "V" if channel or monitor else plausible_unit(quantity, column.data)
        name, guess = f"{name}:{unit}", GUESS
        if not unit:
            return ""
    if scale is not None:
        return "" if scale.fault(quantity, unit) else f"{name}{guess}{factor}"
    if unit not in FACTORS[quantity]:
        return "" if quantity == "time" else f"{name}{guess}*{GAIN} {known.units[0]}/{unit}"
    plug = quantity == "voltage" and (guessed or column.is_plug) and is_small(column.data * FACTORS["voltage"][unit])
    return f"{name}{guess}*{GAIN}" if plug else f"{name}{guess}"


# Part of a sample by which the times of two files may differ and still count as the same; ratio of the steps of two
# files above which a remark is made.
_SAME, _WIDE = 0.01, 4.0
_DAY = 86_400


class _Timed(NamedTuple):
    """A file that has a time: its name, its other columns, and its time [s]."""

    source: str
    columns: tuple[Column, ...]
    clock: Selected

    @classmethod
    def of(cls, table: Table, columns: Columns) -> _Timed | None:
        """Return a file with its time; None if it has no time."""
        name = next((name for name in (columns.time, None) if table.fitting("time", name)), "")
        if name == "":
            return None
        clock = table.select("time", name)
        return cls(table.source, tuple(column for column in table.columns if column is not clock.column), clock)

    def aligned(self, times: Array) -> Iterator[Column]:
        """Yield the columns at other times [s]; a column of another length than its time has a fault."""
        for column in self.columns:
            if column.data.size == self.clock.values.size:
                yield replace(column, data=np.interp(times, self.clock.values, column.data))
            else:
                words = column.fault or "it is not as long as its time, which joining needs"
                yield replace(column, data=np.empty(0), fault=words)


def joined(table: Table, other: Table, columns: Columns) -> Table:
    """Return the columns of both files, joined by sample or by time; names of the other file begin with its stem.

    If times differ, the samples of the file with the displacement stay, else those of the first file: interpolation
    would remove noise. Samples outside of the other file's times are left out. Raise `FileFormatError` if lengths
    differ and a file has no times, or if the times do not rise, do not overlap, or are from different clocks.
    """
    stem = f"{other.source.rsplit('.', 1)[0]}/"
    first, second = (_Timed.of(file, columns) for file in (table, other))
    if first is None or second is None or _same_times(first, second):
        if table.rows != other.rows:
            got = f"{table.rows} rows in {table.source} and {other.rows} in {other.source}"
            hint = "give the rate of the first, or save each with its time"
            raise FileFormatError(argument="join", got=got, need="as many, or a time in both", hint=hint)
        added = second.columns if first and second else other.columns
        return replace(table, columns=(*table.columns, *_behind(stem, added)))
    if columns.rate is not None and table.rows == other.rows:
        got = (
            f"{columns.rate:g} Hz, but {other.source} has as many samples in {float(np.ptp(second.clock.values)):.6g} s"
        )
        raise FileFormatError(argument="rate", got=got, need="no rate: the time of that file holds for both")
    for file in (first, second):
        if not np.all(np.diff(file.clock.values) > 0):
            need = f"one that rises; give rate={RATE} in its place, with this file as the first one"
            raise FileFormatError(argument="join", got=f"a time of {file.source} that falls", need=need)
    late = second.clock._replace(values=second.clock.values + _offset(first, second))
    second = second._replace(columns=_behind(stem, second.columns), clock=late)
    there, here = (
        replace(table, columns=own).fitting("displacement", columns.displacement)
        for own in (table.columns, second.columns)
    )
    kept, moved = (second, first) if here and not there else (first, second)
    times, remarks = _common(kept, moved)
    unit = first.clock.entry.unit or first.clock.column.parts[1]
    clock = replace(first.clock.column, data=times / FACTORS["time"][unit], unit=unit)
    return replace(
        table, columns=(clock, *kept.aligned(times), *moved.aligned(times)), remarks=(*table.remarks, *remarks)
    )


def _behind(stem: str, columns: Sequence[Column]) -> tuple[Column, ...]:
    return tuple(replace(column, name=stem + column.name, group=stem + column.group) for column in columns)


def _same_times(first: _Timed, second: _Timed) -> bool:
    """Return whether the samples of two files have one time."""
    if first.clock.values.size != second.clock.values.size:
        return False
    step = float(np.median(np.abs(np.diff(first.clock.values)))) if first.clock.values.size > 1 else np.inf
    return bool(np.all(np.abs(first.clock.values - second.clock.values - _offset(first, second)) <= _SAME * step))


def _offset(first: _Timed, second: _Timed) -> float:
    """Return the time [s] from the zero of the first file's clock to that of the second's."""
    begin, later = first.clock.column.began, second.clock.column.began
    origins = [f"times from {moment.origin}" if moment else "seconds" for moment in (begin, later)]
    if origins[0] != origins[1]:
        raise FileFormatError(
            f"join: {first.source} has {origins[0]} and {second.source} has {origins[1]}, need one clock for both; "
            "save both with date and offset from UTC, or both in seconds from one moment"
        )
    if begin is None or later is None:
        return 0.0
    offset = (later.nanoseconds - begin.nanoseconds) / 1e9
    return offset - _DAY * round(offset / _DAY) if begin.origin.startswith("midnight") else offset


def _common(kept: _Timed, moved: _Timed) -> tuple[Array, list[str]]:
    """Return the times of a file that lie within those of the other, and a remark on wide steps of the other."""
    others = moved.clock.values
    times = kept.clock.values[(kept.clock.values >= others[0]) & (kept.clock.values <= others[-1])]
    if times.size < 2:
        got = f"times in {kept.source} and {moved.source} that do not overlap"
        need = "times in common, or rate=HZ for the first"
        raise FileFormatError(argument="join", got=got, need=need)
    steps = np.diff(others)[(others[1:] > times[0]) & (others[:-1] < times[-1])]
    widest, usual = float(steps.max(initial=0.0)), float(np.median(np.diff(times)))
    if widest <= _WIDE * usual:
        return times, []
    return times, [
        f"{moved.source} has steps of up to {widest:.4g} s, where {kept.source} has {usual:.4g} s: its columns are "
        "interpolated linearly; record both equally fast."
    ]
