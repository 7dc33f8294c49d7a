"""A measured record: voltage sent and displacement measured over time, always in seconds, volts and metres."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import nan
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import ModelError, RecordError
from dehyst._text import counted, escaped
from dehyst._types import Array, Mask
from dehyst._units import SI, in_si, per_metre
from dehyst._validation import DEFAULT_AXES, axis_names, choice, keep, plain
from dehyst._views.lines import span_of
from dehyst._views.pictures import Plotted
from dehyst.records import events, quality, signals
from dehyst.records.columns import HOLDS
from dehyst.records.formats.column import Column, impossible

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

Span: TypeAlias = "slice[int, int, None]"

_COLUMNS = {"time": "s", "voltage": "V", "displacement": "m"}
# Fewest numbers in a displacement that is blank otherwise.
_FEWEST_NUMBERS = 20


class Channel(NamedTuple):
    """A measured quantity of a record.

    Attributes
    ----------
    name : str
        "voltage" and "displacement" for one axis; "vx" and "x" for several, by the names of the axes.
    unit : str
        Unit of `values`: "V" or "m"; "degC" for a temperature, any text for another quantity.
    role : str
        "drive" is sent to the actuator, "displacement" is its answer; others are "temperature" and "other".
    axis : str
        Name of the axis; empty if there is only one axis, or the channel belongs to no axis.
    values : (n,) array
    """

    name: str
    unit: str
    role: Literal["drive", "displacement", "temperature", "other"]
    axis: str
    values: Array

    @classmethod
    def of(cls, column: Column) -> Channel:
        """Return a further channel of a record, in degC if it is a temperature."""
        (name, unit), role, values = column.parts, column.role, column.data
        if role != "other":
            values, unit = in_si(values, unit), SI[role]
        values.flags.writeable = False
        return cls(name, unit, role, "", values)  # type: ignore[arg-type]

    @property
    def column(self) -> str:
        """The name of its column in a file, with the unit: "temperature_C" or "humidity [%]"."""
        if self.role == "temperature" and "temp" in self.name.lower():
            return f"{self.name}_C"
        return f"{self.name}_{self.unit}" if re.fullmatch(r"[^\W_]+", self.unit) else f"{self.name} [{self.unit}]"

    @property
    def fault(self) -> str:
        """Why this cannot be a further channel of a record; empty if it can."""
        if not self.name or not self.unit or set(self.column) & set(',;\t\n"') or escaped(self.column) != self.column:
            return f"got {self.column!r}, need a name with its unit, as 'temperature_C' or 'humidity [%]'"
        words = quality.fault_of(self.values, self.name, self.unit)
        if words or self.role != "temperature":
            return words
        return impossible("temperature", self.values.min()) or impossible("temperature", self.values.max())


@dataclass(frozen=True, eq=False, slots=True, repr=False)
class Record(Plotted):
    """One measurement of an actuator, or of several that move together. Wrong input is an error at construction.

    A record of one axis has one-dimensional arrays; a record of several axes has one column for each axis. The latter
    is sliced as a whole; methods for one voltage and one displacement need a record from `axis`.

    Parameters
    ----------
    time : (n,) array_like
        [s], strictly rising, n >= 2.
    voltage, displacement : (n,) or (n, axes) array_like
        Voltage [V] and displacement [m], all finite and at most 1e30; kept as read-only float64 copies (read-only
        arrays, such as another record's, are shared).
    name : str
        Used in messages.
    meta : mapping
        Origin of the record: source file, sha256, columns, scales; `guesses`: guessed properties by quantity.
    set_aside : tuple of (float, float)
        First and last time [s] of stretches that do not count in a fit or an error.
    axes : sequence of str
        Names of the axes, one for each column; default: x, y, z. Empty for a record of one axis.
    others : mapping of str to (n,) array_like
        Further measured quantities, by name with unit: ``{"temperature_C": ..., "humidity [%]": ...}``.
        Temperatures (also in K and degF) are kept in degC, others unchanged; kept as a tuple of `Channel`.
    hold : {"line", "sample"}
        What the voltage does between samples. "line": it moves in straight lines, and the displacement is read at the
        same instant. "sample": it is held until the next sample, and the displacement is read at the end of that time.
    measured : (n,) array_like of bool, optional
        Whether the displacement is known at each sample; default: at all; if most of `displacement` is NaN and at least
        20 samples are not, only at those. Elsewhere straight lines over time replace NaN as placeholders: no fit and no
        error counts them. Only a record of one axis may have it.

    Raises
    ------
    RecordError
        If arrays have a wrong shape or length, are no plain numbers, have fewer than 2 samples, or hold NaN, inf or
        numbers beyond 1e30; if the time does not rise; if the axes are not different names, one each; if one of
        `others` has no unit, has the name of another channel, or is a temperature outside of -273.15 to 1000 degC; or
        if `hold` is another word, or `measured` is not one bool per sample.
    """

    time: Array
    voltage: Array
    displacement: Array
    name: str = "record"
    meta: Mapping[str, Any] = field(default_factory=dict)
    set_aside: tuple[tuple[float, float], ...] = ()
    axes: tuple[str, ...] = ()
    others: tuple[Channel, ...] = ()
    hold: Literal["line", "sample"] = "line"
    measured: Mask | None = None

    def __post_init__(self) -> None:
        for argument, kinds in (("meta", Mapping), ("axes", Iterable), ("others", Iterable), ("set_aside", Iterable)):
            if not isinstance(getattr(self, argument), kinds):
                raise self._error(f"{argument}: got {getattr(self, argument)!r}, need {kinds.__name__.lower()}")
        for column in _COLUMNS:
            keep(self, **{column: self._frozen(getattr(self, column), column)})
        keep(self, meta=dict(self.meta), axes=self._named_axes(), others=tuple(self._further()))
        arrays = {column: getattr(self, column) for column in _COLUMNS}
        arrays |= {channel.name: channel.values for channel in self.others}
        if len({len(values) for values in arrays.values()}) > 1:
            got = ", ".join(f"{column} {len(values)}" for column, values in arrays.items())
            raise self._error(f"columns differ in length ({got}); give one value per sample in each")
        if len(self) < 2:
            raise self._error(f"{counted(len(self), 'sample')}, at least 2 are needed; check the range of samples")
        choice(self.hold, "hold", HOLDS, error=RecordError)
        keep(self, measured=self._measured())
        arrays["displacement"] = self.displacement
        for column, unit in _COLUMNS.items():
            for j, values in enumerate(np.atleast_2d(arrays[column].T)):
                name = f"{self.name} ({self.axes[j]})" if self.axes and column != "time" else self.name
                if words := quality.fault_of(values, column, unit):
                    raise RecordError(f"record '{name}': {words}")
        if words := quality.not_rising(self.time, self.voltage, self.displacement):
            raise self._error(words)
        for channel in self.others:
            if channel.fault:
                raise self._error(channel.fault)
            if channel.name in ("time", *(other.name for other in self.channels if other is not channel)):
                raise self._error(f"others: got the name '{channel.name}' twice, need different names; rename one")

    def _error(self, words: str) -> RecordError:
        return RecordError(f"record '{self.name}': {words}")

    def _frozen(self, raw: object, column: str, dimensions: int = 2) -> Array:
        """Return a column as a read-only array; raise for anything but numbers."""
        try:
            bare = plain(raw, column)
            values = bare if _is_frozen(bare) else np.array(bare, dtype=np.float64, order="C")
        except ModelError as error:
            raise self._error(str(error)) from error
        except (TypeError, ValueError) as error:
            raise self._error(f"{column} is no array of numbers ({error}); give (n,) floats") from error
        if values.ndim not in (1, 1 if column == "time" else dimensions):
            raise self._error(f"{column} has shape {values.shape}; give one dimension, try .ravel()")
        values.flags.writeable = False
        return values

    def _measured(self) -> Mask | None:
        """Return where the displacement is known, None if everywhere, and fill blank places between."""
        y = self.displacement
        known = ~np.isnan(y) if self.measured is None else np.array(self.measured)
        if self.measured is None and (self.axes or not _FEWEST_NUMBERS <= np.count_nonzero(known) < 0.5 * len(self)):
            return None
        if self.axes or known.dtype != bool or known.shape != y.shape:
            got = f"{known.dtype} of shape {known.shape}{' for several axes' if self.axes else ''}"
            raise self._error(f"measured: got {got}, need one axis, and a bool for each of {len(self)} samples")
        blank = np.isnan(y) & ~known
        if blank.any() and known.any():
            keep(self, displacement=np.where(blank, np.interp(self.time, self.time[known], y[known]), y))
        known.flags.writeable = False
        return None if known.all() else known

    def _further(self) -> Iterator[Channel]:
        """Yield the channels in `others`, given by name or as those of another record."""
        given: Any = self.others
        for entry in given.items() if isinstance(given, Mapping) else given:
            if isinstance(entry, Channel):
                yield entry._replace(values=self._frozen(entry.values, entry.name, 1))
                continue
            column = Column(str(entry[0]), np.empty(0))
            yield Channel.of(replace(column, data=self._frozen(entry[1], column.name, 1)))

    def _named_axes(self) -> tuple[str, ...]:
        """Return the names of the axes; raise if they or the shapes do not fit."""
        v, y = self.voltage.shape, self.displacement.shape
        if len(v) == len(y) == 1 and not self.axes:
            return ()
        if len(v) != 2 or v != y or v[0] != self.time.size or (v[1] == 1 and not self.axes):
            raise self._error(
                f"got {self.time.size} times, voltages {v}, displacements {y} and the axes {self.axes!r}; need one "
                "dimension, try .ravel(), or one row per sample and one column per axis in both"
            )
        return axis_names(self.axes or DEFAULT_AXES[: v[1]], v[1], f"record '{self.name}'", RecordError)

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        head = f"<Record '{escaped(self.name)}': {len(self)} samples, {self.time[-1] - self.time[0]:.6g} s"
        others = "".join(f", {channel.name}" for channel in self.others)
        others += ", voltage held" if self.hold == "sample" else ""
        if self.axes:
            return f"{head}, axes {', '.join(self.axes)}{others}>"
        events = f" at {counted(int(np.count_nonzero(self.measured)), 'event')}" if self.measured is not None else ""
        return f"{head}, {span_of(self.voltage, 'V')}, {span_of(self.displacement, 'um', 1e6)}{events}{others}>"

    def __getitem__(self, rows: slice[Any, Any, None] | Mask | NDArray[np.intp]) -> Record:
        # A slice of step 1, a bool for each sample, or increasing indices.
        if not isinstance(rows, slice | np.ndarray) or (isinstance(rows, slice) and rows.step not in (None, 1)):
            raise self._error(f"got [{rows!r}]; a record takes slices of step 1, try record[10:200], or arrays")
        others = tuple(each._replace(values=each.values[rows]) for each in self.others)
        time, voltage, displacement = (values[rows] for values in (self.time, self.voltage, self.displacement))
        known = None if self.measured is None else self.measured[rows]
        return replace(self, time=time, voltage=voltage, displacement=displacement, others=others, measured=known)

    @classmethod
    def from_arrays(
        cls,
        time: ArrayLike,
        voltage: ArrayLike,
        displacement: ArrayLike,
        *,
        units: str,
        name: str = "record",
        others: Mapping[str, ArrayLike] | None = None,
    ) -> Record:
        """Make a record from arrays whose displacement is in `units`.

        `time` and `voltage` (n,) [s] and [V], `displacement` (n,) in `units`: "m", "mm", "um", "nm" or "pm".
        `name`, `others`: as in `Record`.

        Raise `RecordError` if the unit is unknown, the arrays do not form a record, or the stroke is over 0.1 m or
        below 1 nm, which indicates another unit.
        """
        record = cls(time, voltage, displacement, name, others=others or ())  # type: ignore[arg-type]
        return record._in_unit(record.displacement, units)

    @classmethod
    def from_events(
        cls,
        time: ArrayLike,
        voltage: ArrayLike,
        event_time: ArrayLike,
        position: ArrayLike,
        *,
        units: str,
        name: str = "record",
    ) -> Record:
        """Make a record whose displacement is known at events only: at lines, fringes, or edges of an encoder.

        `time` and `voltage` (n,) [s] and [V]; `event_time` (k,) [s], rising, and `position` (k,) at these times, in
        `units`. Each event moves to the nearest sample, and its position along a parabola over time through its
        neighbours; the mean of several events at a sample counts. `measured` marks these samples.

        Raise `RecordError` if there are fewer than 4 events, their times do not rise or lie outside of the record's,
        a position is not finite, or times and positions differ in number; otherwise as `from_arrays`.
        """
        whole = cls(time, voltage, np.zeros(np.shape(time)), name)  # type: ignore[arg-type]
        displacement = events.at_samples(whole.time, whole.voltage, event_time, position)
        return whole._in_unit(displacement, units, measured=~np.isnan(displacement))

    def _in_unit(self, displacement: Array, units: str, **more: Any) -> Record:
        """Return the record with a displacement in a unit of length; raise if no actuator has such a stroke."""
        record = replace(self, displacement=displacement / per_metre(units, error=RecordError), **more)
        if words := quality.other_unit(record):
            raise record._error(words)
        return record

    @property
    def channels(self) -> tuple[Channel, ...]:
        """All measured quantities: the voltage and the displacement of each axis in turn, and the others."""
        voltage, displacement = (values.T if self.axes else [values] for values in (self.voltage, self.displacement))
        found = []
        for axis, v, y in zip(self.axes or ("",), voltage, displacement, strict=True):
            found.append(Channel(f"v{axis}" if axis else "voltage", "V", "drive", axis, v))
            found.append(Channel(axis or "displacement", "m", "displacement", axis, y))
        return (*found, *self.others)

    @property
    def temperature(self) -> Array | None:
        """The temperature (n,) [degC]; None if the record has none, or several."""
        found = [channel.values for channel in self.others if channel.role == "temperature"]
        return found[0] if len(found) == 1 else None

    def axis(self, axis: str | int) -> Record:
        """Return one axis, by its name or index, as a separate record; raise `RecordError` if there is none."""
        names: list[object] = [*self.axes] if self.axes else [""]
        j = names.index(axis) if axis in names else axis
        if not isinstance(j, int) or not 0 <= j < len(names):
            words = ", ".join(map(str, self.axes)) if self.axes else "0"
            raise self._error(f"axis: got {axis!r}, need one of {words}")
        if not self.axes:
            return self
        v, y, name = self.voltage[:, j], self.displacement[:, j], f"{self.name} ({self.axes[j]})"
        return replace(self, voltage=v, displacement=y, name=name, axes=())

    @property
    def sample_time(self) -> float:
        """Median time from one sample to the next [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def voltage_range(self) -> tuple[float, float]:
        """Lowest and highest voltage [V]."""
        return float(of_one_axis(self).voltage.min()), float(self.voltage.max())

    @property
    def stroke(self) -> float:
        """Displacement peak to peak [m]."""
        return float(np.ptp(of_one_axis(self).displacement))

    @property
    def noise(self) -> float:
        """Standard deviation of the sensor's white noise [m], or that of events, by their neighbours."""
        return signals.sensor_noise(self.time, of_one_axis(self).voltage, self.displacement, self.measured)

    def cycles(self) -> list[Span]:
        """Return the full cycles between successive voltage minima, or maxima if these give more.

        The record's start (or end) counts as an extreme if its branch covers 0.9 of the next branch, so that one
        excursion up and down is one cycle. A slice includes both its turning points: neighbours share one sample.
        """
        turns = reversals(self)
        if not len(turns):
            return []
        # The outermost sample of the first and of the last branch.
        ends = self.voltage[turns[0] :: -1], self.voltage[turns[-1] :]
        before, after = (int(np.argmax(np.abs(branch - branch[0]))) for branch in ends)
        points = np.concatenate(([turns[0] - before], turns, [turns[-1] + after]))
        branches = np.abs(np.diff(self.voltage[points]))
        points = points[int(branches[0] < 0.9 * branches[1]) : len(points) - int(branches[-1] < 0.9 * branches[-2])]
        # With an odd number, the kind at both ends counts; an even number has equally many of both, and minima count.
        first = int(len(points) % 2 == 0 and self.voltage[points[0]] > self.voltage[points[1]])
        return [slice(int(a), int(b) + 1) for a, b in pairwise(points[first::2])]

    def problems(self) -> tuple[str, ...]:
        """Return sentences about suspicious properties that do not prevent the record's use; may be empty."""
        held = "The voltage is held until the next sample, and the displacement is read at the end of that time."
        return (*quality.problems(of_one_axis(self)), *[held] * (self.hold == "sample"))

    def check_usable(self) -> None:
        """Raise `RecordError` if no hysteresis loop can be identified from the record.

        That is so with fewer than 20 samples, no full cycle, constant voltage or displacement, an echo of the voltage,
        fringes, a stroke over 5 mm, an inverted or clipped sensor, a butterfly loop, swapped, reversed or sorted
        columns, or displacements that dehyst computed.
        """
        record = of_one_axis(self)
        if fields := quality.long_stroke(record):
            raise RecordError(f"record '{self.name}'", **fields)
        computed = "its displacements are computed: play its voltages, and give a file of what the sensor reads"
        for words in (*[computed] * ("computed" in self.meta), *quality.reasons_against(record)):
            raise self._error(words)


def of_one_axis(record: Record) -> Record:
    """Return the record; raise `RecordError` if it has several axes."""
    if record.axes:
        words = f"has the axes {', '.join(record.axes)}, need a record of one; take record.axis({record.axes[0]!r})"
        raise RecordError(f"record '{record.name}': {words}")
    return record


def columns_of(record: Record, lengths: Literal["um", "m"] = "um") -> dict[str, Array]:
    """Return time and channels by their columns in a file: time_s, voltage_V, displacement_um, or vx_V, x_um.

    `lengths`: unit of displacements, which are NaN where they are not measured.
    """
    counts, known, found = per_metre(lengths, error=RecordError), record.measured, {"time_s": record.time}
    for each in record.channels:
        if each.role == "displacement":
            values = each.values * counts if counts != 1 else each.values
            found[f"{each.name}_{lengths}"] = values if known is None else np.where(known, values, nan)
        else:
            found[each.column] = each.values
    return found


def reversals(record: Record) -> NDArray[np.intp]:
    """Find the turning points of the voltage (k,): indices of its extremes, alternately minima and maxima.

    An extreme counts if the voltage then goes back by more than 2 % of its range, and by more than the range of its
    noise. It is the last sample of a plateau, and never an end of the record.
    """
    return signals.turns_of(of_one_axis(record).voltage)


def _is_frozen(raw: object) -> bool:
    """Return whether an array is read-only, like a record's: then a slice of a long record needs no copy."""
    if not isinstance(raw, np.ndarray) or raw.dtype != np.float64 or raw.flags.writeable:
        return False
    return raw.base is None or (isinstance(raw.base, np.ndarray) and not raw.base.flags.writeable)
