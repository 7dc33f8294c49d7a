"""A measured record: voltage sent and displacement measured over time, always in seconds, volts and metres."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import comb, isfinite, log, sqrt
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ._errors import RecordError

FloatArray: TypeAlias = NDArray[np.float64]
Span: TypeAlias = "slice[int, int, None]"

_COLUMNS = {"time": "s", "voltage": "V", "displacement": "m"}
# A sine of 50 points a cycle leaves 7e-8 of its stroke in differences of order 6, and 3e-3 in those of order 2.
_ORDER = 6


@dataclass(frozen=True, eq=False, slots=True, repr=False)
class Record:
    """One measurement of an actuator; wrong input is refused at construction.

    Parameters
    ----------
    time, voltage, displacement : (n,) array_like
        Seconds (strictly rising), volts and metres, n >= 2, all finite; kept as read-only float64 copies.
    name : str
        Used in messages.
    meta : mapping
        Where the record comes from: source file, sha256, columns.

    Raises
    ------
    RecordError
        Not one-dimensional, not numbers, different lengths, fewer than 2 samples, NaN or inf, time not rising.
    """

    time: FloatArray
    voltage: FloatArray
    displacement: FloatArray
    name: str = "record"
    meta: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for column in _COLUMNS:
            object.__setattr__(self, column, _frozen_column(getattr(self, column), column, self.name))
        object.__setattr__(self, "meta", dict(self.meta))
        sizes = {column: len(getattr(self, column)) for column in _COLUMNS}
        if len(set(sizes.values())) > 1:
            got = ", ".join(f"{column} {size}" for column, size in sizes.items())
            raise RecordError(f"record '{self.name}': columns differ in length ({got}); give one value each per sample")
        if len(self) < 2:
            raise RecordError(
                f"record '{self.name}': {len(self)} sample(s), at least 2 are needed; check the row range"
            )
        for column in _COLUMNS:
            _refuse_not_finite(getattr(self, column), column, self.name)
        bad = np.flatnonzero(np.diff(self.time) <= 0.0)
        if len(bad):
            i = int(bad[0])
            raise RecordError(
                f"record '{self.name}': time must rise strictly, but time[{i + 1}] = {self.time[i + 1]:.9g} s follows "
                f"time[{i}] = {self.time[i]:.9g} s; sort the rows, drop repeated ones, or check the time unit's digits"
            )

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        (v0, v1), (y0, y1) = self.voltage_range, self.displacement_range
        return (
            f"<Record '{self.name}': {len(self)} samples, {self.time[-1] - self.time[0]:.6g} s, "
            f"{v0:.4g} to {v1:.4g} V, {y0 * 1e6:.6g} to {y1 * 1e6:.6g} um>"
        )

    def __getitem__(self, span: Span) -> Record:
        if not isinstance(span, slice) or span.step not in (None, 1):
            raise RecordError(
                f"record '{self.name}': got [{span!r}]; a record takes slices of step 1, try record[10:200]"
            )
        return self.slice(span.start, span.stop)

    @property
    def sample_time(self) -> float:
        """Median time from one sample to the next [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def voltage_range(self) -> tuple[float, float]:
        """Lowest and highest voltage [V]."""
        return float(self.voltage.min()), float(self.voltage.max())

    @property
    def displacement_range(self) -> tuple[float, float]:
        """Lowest and highest displacement [m]."""
        return float(self.displacement.min()), float(self.displacement.max())

    @property
    def stroke(self) -> float:
        """Displacement peak to peak [m]."""
        return float(np.ptp(self.displacement))

    @property
    def noise(self) -> float:
        """Standard deviation of the sensor's white noise [m], see :func:`white_noise`."""
        return white_noise(self.displacement)

    def gaps(self) -> list[tuple[int, float]]:
        """Where samples are missing: index i and time[i + 1] - time[i] [s], if above 1.5 sample times."""
        steps = np.diff(self.time)
        return [(int(i), float(steps[i])) for i in np.flatnonzero(steps > 1.5 * np.median(steps))]

    def reversals(self, signal: str = "voltage", band: float | None = None) -> NDArray[np.intp]:
        """Find the turning points of a signal, by a hysteresis band.

        Parameters
        ----------
        signal : {"voltage", "displacement"}
        band : float, optional
            Way back [V or m] that makes a turning point of an extreme; by default the larger of 2 % of the
            signal's range and what its noise spans: 6 standard deviations, more in a long record.

        Returns
        -------
        (k,) int array
            The extremes themselves (the last sample of a plateau), minima and maxima in turn; never the record's ends.

        Raises
        ------
        RecordError
            Unknown signal; band negative or not finite.
        """
        if signal not in ("voltage", "displacement"):
            raise RecordError(f"record '{self.name}': no signal '{signal}'; try 'voltage' or 'displacement'")
        values: FloatArray = getattr(self, signal)
        if band is None:
            band = max(0.02 * float(np.ptp(values)), _noise_span(values))
        if not (isfinite(band) and band >= 0.0):
            raise RecordError(f"record '{self.name}': band is {band}; give a number >= 0 in the signal's unit")
        return _turning_points(values, band)

    def cycles(self, band: float | None = None) -> list[Span]:
        """Full cycles between successive voltage minima, or maxima if these give more.

        The record's start and end count as extremes when their leg covers 0.9 of the leg next to it, so that one
        excursion up and down is one cycle. A slice holds both its turning points: neighbours share one sample.
        """
        turns = self.reversals("voltage", band)
        if not len(turns):
            return []
        ends = [_outer_extreme(self.voltage[turns[0] :: -1]), _outer_extreme(self.voltage[turns[-1] :])]
        points = np.concatenate(([turns[0] - ends[0]], turns, [turns[-1] + ends[1]]))
        legs = np.abs(np.diff(self.voltage[points]))
        points = points[int(legs[0] < 0.9 * legs[1]) : len(points) - int(legs[-1] < 0.9 * legs[-2])]
        # An odd number has one more of the outer kind; otherwise minima are as many as maxima and are taken.
        first = int(len(points) % 2 == 0 and self.voltage[points[0]] > self.voltage[points[1]])
        best = points[first::2]
        return [slice(int(a), int(b) + 1) for a, b in pairwise(best)]

    def slice(self, start: int | None, stop: int | None) -> Record:
        """Return samples start to stop - 1, counted as Python slices are."""
        rows = slice(start, stop)
        return replace(self, time=self.time[rows], voltage=self.voltage[rows], displacement=self.displacement[rows])

    def between(self, t0: float, t1: float) -> Record:
        """Return the samples with t0 <= time <= t1 [s]."""
        return self.slice(int(np.searchsorted(self.time, t0)), int(np.searchsorted(self.time, t1, side="right")))

    def with_name(self, name: str) -> Record:
        """Return the same record under another name."""
        return replace(self, name=name)

    def resample(self, dt: float, kind: str = "linear") -> Record:
        """Put the record on a uniform grid of step dt [s] from its first sample; kind is "linear" or "pchip"."""
        span = float(self.time[-1] - self.time[0])
        if not 0.0 < dt <= span:
            raise RecordError(
                f"record '{self.name}': dt is {dt} s; give a step above 0 and at most the record's {span:.6g} s"
            )
        if kind not in ("linear", "pchip"):
            raise RecordError(f"record '{self.name}': no interpolation '{kind}'; try 'linear' or 'pchip'")
        grid = np.minimum(self.time[0] + dt * np.arange(int(span / dt + 1e-9) + 1), self.time[-1])
        v = _interpolate(self.time, self.voltage, grid, kind)
        return replace(self, time=grid, voltage=v, displacement=_interpolate(self.time, self.displacement, grid, kind))

    def delayed(self, delay: float) -> Record:
        """Replace the voltage by voltage(t - delay), delay in s, shape-preserving; constant beyond the ends."""
        if not isfinite(delay):
            raise RecordError(f"record '{self.name}': delay is {delay} s; give a finite number of seconds")
        asked = np.clip(self.time - delay, self.time[0], self.time[-1])
        return replace(self, voltage=_interpolate(self.time, self.voltage, asked, "pchip"))

    def problems(self) -> tuple[str, ...]:
        """Sentences about everything suspicious that does not forbid the record's use; empty when all is well."""
        found = []
        steps, gaps = np.diff(self.time), self.gaps()
        if gaps:
            i, length = gaps[0]
            found.append(f"{len(gaps)} gap(s) in time, the first of {length:.4g} s after sample {i}.")
        jitter = float(np.std(steps[steps <= 1.5 * self.sample_time])) / self.sample_time
        if jitter > 0.01:
            found.append(f"Sampling is uneven: the time step varies by {100 * jitter:.3g} %; try resample().")
        cycles = self.cycles()
        points = float(np.median([c.stop - c.start - 1 for c in cycles])) if cycles else np.inf
        if points < 50:
            found.append(f"Only {points:.0f} samples a cycle; 50 or more show the loop's corners.")
        for column, unit in (("voltage", "V"), ("displacement", "m")):
            step, part = _resolution(getattr(self, column))
            if part > 0.005:
                found.append(
                    f"The {column} moves in steps of {step:.3g} {unit}, {100 * part:.2g} % of its range: quantised."
                )
        if not 1e-9 <= self.stroke <= 1e-3:
            found.append(
                f"The stroke is {self.stroke:.3g} m, unusual for a piezo actuator; check the displacement's unit."
            )
        return tuple(found)

    def check_usable(self, min_samples: int = 20, min_cycles: int = 1) -> None:
        """Refuse a record from which no hysteresis loop can be learnt.

        Parameters
        ----------
        min_samples, min_cycles : int
            Least number of samples and of full voltage cycles.

        Raises
        ------
        RecordError
            Too few samples or cycles, constant voltage or displacement, inverted or clipped sensor, swapped columns.
        """
        if len(self) < min_samples:
            raise RecordError(f"record '{self.name}': {len(self)} samples, {min_samples} are needed; record for longer")
        _refuse_constant(self)
        cycles = self.cycles()
        if len(cycles) < min_cycles:
            raise RecordError(
                f"record '{self.name}': {len(cycles)} full cycle(s) of the voltage found, {min_cycles} needed; "
                "drive it up and back down, for instance with a sine over the whole range"
            )
        if np.corrcoef(self.voltage, self.displacement)[0, 1] < -0.5:
            raise RecordError(
                f"record '{self.name}': displacement falls when voltage rises: the sensor's sign is inverted; "
                "try multiplying the displacement by -1"
            )
        least = max(5, round(0.005 * len(self) / max(1, len(cycles))))
        _refuse_clipped(self, least)
        _refuse_leading(self, cycles)


def white_noise(values: FloatArray) -> float:
    """Estimate the standard deviation of white noise on a smooth, evenly sampled signal.

    The median absolute difference of order 6, so that the signal itself, its corners and outliers do not count.

    Parameters
    ----------
    values : (n,) float array
        In any unit; below 8 samples nothing can be said and 0 is returned.

    Returns
    -------
    float
        In the unit of `values`.
    """
    if len(values) < _ORDER + 2:
        return 0.0
    spread = float(np.median(np.abs(np.diff(values, _ORDER))))
    return spread / 0.6744897501960817 / sqrt(comb(2 * _ORDER, _ORDER))


def _noise_span(values: FloatArray) -> float:
    # White noise spans 2 sqrt(2 ln n) deviations: 6 of them are surpassed again and again in a long record.
    return max(6.0, 2.2 * sqrt(2.0 * log(len(values)))) * white_noise(values)


def _frozen_column(raw: object, column: str, name: str) -> FloatArray:
    try:
        values = np.array(raw, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise RecordError(f"record '{name}': {column} is no array of numbers ({error}); give (n,) floats") from error
    if values.ndim != 1:
        raise RecordError(f"record '{name}': {column} has shape {values.shape}; give one dimension, try .ravel()")
    values.flags.writeable = False
    return values


def _refuse_not_finite(values: FloatArray, column: str, name: str) -> None:
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise RecordError(
            f"record '{name}': {column} holds {len(bad)} value(s) that are not finite, the first is "
            f"{column}[{bad[0]}] = {values[bad[0]]} {_COLUMNS[column]}; cut these rows out or fill them in"
        )


def _interpolate(x: FloatArray, y: FloatArray, asked: FloatArray, kind: str) -> FloatArray:
    if kind == "linear":
        return np.interp(asked, x, y)
    from scipy.interpolate import PchipInterpolator

    return np.asarray(PchipInterpolator(x, y)(asked), dtype=np.float64)


def _turning_points(values: FloatArray, band: float) -> NDArray[np.intp]:
    # Only local extremes (and the last sample of a plateau) can be turning points or complete a way back.
    steps = np.sign(np.diff(values))
    kept = np.concatenate(([0], np.flatnonzero(steps[:-1] * steps[1:] <= 0.0) + 1, [len(values) - 1]))
    levels = values[kept].tolist()
    turns: list[int] = []
    low = high = levels[0]
    at_low = at_high = direction = 0
    for i, level in enumerate(levels):
        if level >= high and direction >= 0:
            high, at_high = level, i
        if level <= low and direction <= 0:
            low, at_low = level, i
        if direction >= 0 and high - level > band:
            if direction:
                turns.append(at_high)
            direction, low, at_low = -1, level, i
        elif direction <= 0 and level - low > band:
            if direction:
                turns.append(at_low)
            direction, high, at_high = 1, level, i
    return kept[turns]


def _outer_extreme(leg: FloatArray) -> int:
    """Offset of the sample of a leg that lies farthest from its first one, a turning point."""
    return int(np.argmax(np.abs(leg - leg[0])))


def _resolution(values: FloatArray) -> tuple[float, float]:
    """Return the smallest step between neighbours and its part of the range; zeros unless many neighbours are equal."""
    steps, span = np.abs(np.diff(values)), float(np.ptp(values))
    moving = steps[steps > 1e-12 * span]
    if not len(moving) or len(moving) > 0.8 * len(steps):
        return 0.0, 0.0
    return float(moving.min()), float(moving.min()) / span


def _refuse_constant(record: Record) -> None:
    low, high = record.voltage_range
    if high - low < max(1e-9, 1e-6 * max(abs(low), abs(high))):
        raise RecordError(
            f"record '{record.name}': the voltage is constant at {low:.6g} V; drive the actuator up and down"
        )
    if record.stroke <= max(_noise_span(record.displacement), 1e-12 * max(map(abs, record.displacement_range))):
        raise RecordError(
            f"record '{record.name}': the displacement is constant: its stroke of {record.stroke:.3g} m is no more "
            f"than the sensor's noise ({record.noise:.3g} m); check the sensor and the chosen column"
        )


def _refuse_clipped(record: Record, least: int) -> None:
    """Raise when the sensor stays at its extreme while the voltage goes on in that direction."""
    span_v = float(np.ptp(record.voltage))
    needed = (0.02 + 3.0 * _resolution(record.displacement)[1]) * span_v
    for sign, side in ((1.0, "maximum"), (-1.0, "minimum")):
        y, v = sign * record.displacement, sign * record.voltage
        at_top = np.concatenate(([False], y >= y.max() - 1e-12 * record.stroke, [False]))
        edges = np.flatnonzero(at_top[1:] != at_top[:-1])
        for a, b in zip(edges[::2], edges[1::2], strict=True):
            # A dead zone after a reversal is flat too, but there the voltage only goes back.
            if b - a >= least and v[a:b].max() - v[a] > needed:
                raise RecordError(
                    f"record '{record.name}': the sensor is clipped: the displacement sits at its {side} "
                    f"{sign * y[a]:.6g} m over samples {a} to {b - 1} while the voltage still moves; "
                    "lower the voltage range or shift the sensor's range"
                )


def _refuse_leading(record: Record, cycles: list[Span]) -> None:
    """Raise when the loops run clockwise in the (voltage, displacement) plane by more than noise can explain."""
    area = box = var_y = var_v = 0.0
    for cycle in cycles:
        v, y = record.voltage[cycle], record.displacement[cycle]
        dv, dy = np.diff(np.append(v, v[0])), np.diff(np.append(y, y[0]))
        # Rising below falling is counter-clockwise: the actuator lags, and this sum is positive.
        area -= float(np.dot(y - y.mean() + 0.5 * dy, dv))
        box += float(np.ptp(v) * np.ptp(y))
        var_y, var_v = var_y + float(dv @ dv), var_v + float(dy @ dy)
    doubt = sqrt(record.noise**2 * var_y + white_noise(record.voltage) ** 2 * var_v)
    if area < -(0.005 * box + 5.0 * doubt):
        raise RecordError(
            f"record '{record.name}': the displacement leads the voltage (loop area {100 * area / box:.2g} % of its "
            "box): the columns look swapped (or the displacement's sign is inverted); check which column is which"
        )
