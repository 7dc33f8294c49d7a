"""What has changed since a model was identified: a small regression of measured on simulated displacements.

With s the simulated displacement, m(v) its mean line (the average of rising and falling branches) and h = s - m,

    y - s = gain (s - m(0 V)) + width h - delay s' + creep log10(t) + offset,

whose coefficients are the changes. Standard errors come from a jackknife over blocks of time, or over sections of the
loop if that gives larger ones. They include the model's own error, because an error that repeats in each cycle is no
evidence of a change.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst._views import lines
from dehyst.identification import Trace
from dehyst.records import percent

# A change counts from so many standard errors on.
SIGMAS = 3.0
# Blocks of time, sections of the voltage on each branch, and knots of the mean line.
_BLOCKS, _SECTIONS, _KNOTS = 16, 8, 24
# Samples that suffice, and steps of the search for a delay, of which the regression alone knows the first order.
_MOST, _STEPS = 100_000, 3
# A loop narrower than this part of its height has no width that could change.
_NARROW = 1e-3
# Names of the slow changes, of which a record shows one.
SLOW = ("creep", "drift")
# Names of the changes that an update learns.
LEARNT = ("gain", "width")
# What to do about them if they last: an update, or after one that did not help another identification.
UPDATE, IDENTIFY = "dehyst update", "identify the model again from new records"
# Columns whose range is their largest effect; of others it is the largest value.
_RANGING = ("gain", *SLOW)
# Factor and unit in which each is shown.
_SHOWN = {"gain": (100.0, "%"), "width": (100.0, "%"), "delay": (1e3, "ms")}


@dataclass(frozen=True)
class Change:
    """One thing that may have changed since the identification.

    Attributes
    ----------
    name : str
        "gain" (of the displacement relative to 0 V), "width" (of the loop, in addition to the gain), "offset" (of the
        displacement at 0 V, at the beginning of the record), "delay", "creep" (logarithmic in time) or "drift" (linear
        in time).
    value, error : float
        The change and its standard error: parts of 1 for gain and width, [m] for the offset, [s] for the delay,
        [m a decade of time] for creep, [m over the record] for a drift.
    effect : float
        The largest displacement [m] due to the change on a path like the record, with the sign of `value`.
    least : float
        Effect [m] from which a change counts.
    """

    name: str
    value: float
    error: float
    effect: float
    least: float

    @property
    def counts(self) -> bool:
        """Whether the change exceeds three standard errors and its effect exceeds `least`."""
        return abs(self.value) > SIGMAS * self.error and abs(self.effect) > self.least

    def sentence(self, stroke: float, *, lasting: str | None = UPDATE) -> str:
        """Return the change as a sentence with what to do; creep and drift relative to `stroke` [m].

        `lasting`: what to do about a gain or a width that stays changed; None: leave out what to do.
        """
        direction = _WORDS[self.name][0 if self.value > 0 else 1]
        effect = lines.percent(abs(self.effect), stroke)
        text = f"{direction.format(self.amount(stroke))}: up to {effect} of the stroke."
        return text if lasting is None else f"{text} {_REMEDIES[self.name].format(lasting=lasting)}"

    def amount(self, stroke: float) -> str:
        """Return size and standard error as text; creep and drift relative to `stroke` [m]."""
        factor, unit = _SHOWN.get(self.name, (1e9, "nm"))
        if self.name in SLOW:
            factor, unit = 100.0 / stroke, "% of the stroke" + (" a decade" if self.name == "creep" else "")
        return f"{lines.uncertain(abs(self.value) * factor, self.error * factor)} {unit}"

    def as_dict(self, stroke: float) -> dict[str, Any]:
        """Return JSON values in SI units, the effect also in % of `stroke` [m]."""
        return {**asdict(self), "effect_percent": percent(self.effect, stroke), "counts": self.counts}


_WORDS = {
    "gain": ("The gain has risen by {}", "The gain has fallen by {}"),
    "width": ("The loop has become wider by {}", "The loop has become narrower by {}"),
    "offset": ("The displacement lies higher by {}", "The displacement lies lower by {}"),
    "delay": ("The displacement lags more, by {}", "The displacement lags less, by {}"),
    "creep": ("The displacement creeps up by {}", "The displacement creeps down by {}"),
    "drift": ("The displacement drifts up by {}", "The displacement drifts down by {}"),
}
_REMEDIES = {
    "gain": "Check the sensor's and the amplifier's gain, the load and the preload. If it lasts: {lasting}.",
    "width": "Check the temperature, the load and the range of the voltage. If it lasts (ageing): {lasting}.",
    "offset": "Zero the sensor or home the actuator; that needs no new model.",
    "delay": "Check the filters, the sample clock and the speed of the record.",
    "creep": "Wait before recording; creep of the model needs loops at two speeds or holds.",
    "drift": "Let the actuator warm up, or record at a constant temperature.",
}


@dataclass(frozen=True, eq=False)
class Slow:
    """A slow change over time: its name, "creep" or "drift", and its values (n,)."""

    name: str
    curve: Array


@dataclass(frozen=True)
class Known:
    """What is known of a record and its model before the regression.

    Attributes
    ----------
    datum : float
        Shift to the model's axis [m].
    doubt : float
        Uncertainty of the datum that the record leaves [m].
    own : float
        Standard deviation of the model's own error [m], which differs from one kind of loop to another.
    """

    datum: float
    doubt: float
    own: float


def find_changes(trace: Trace, slow: Sequence[Slow], known: Known, least: float) -> tuple[Change, ...]:
    """Regress the measured minus the simulated displacement on possible changes.

    Parameters
    ----------
    trace : Trace
        Measured and simulated displacement, simulated without offset and drift.
    slow : sequence of Slow
        Candidate slow changes, of which the one that explains most is used; may be empty.
    known : Known
    least : float
        Effect [m] from which a change counts.
    """
    loop, step = _SimulatedLoop.of(trace), max(1, trace.time.size // _MOST)
    fits = [_fitted(loop, curve, step) for curve in slow] or [_fitted(loop, None, step)]
    found = []
    for name, value, spread, most in min(fits, key=lambda fit: fit.squares).parts():
        offset = name == "offset"
        size, doubt = (value - known.datum, known.doubt) if offset else (value, 0.0)
        error = float(np.linalg.norm([spread, doubt, known.own / most if most else math.inf]))
        found.append(Change(name, size, error, size * most, least))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _SimulatedLoop:
    """A simulated loop: time, voltage, measured and simulated displacement, mean line, and mean line at 0 V."""

    time: Array
    voltage: Array
    measured: Array
    simulated: Array
    mean: Array
    rest: float
    stroke: float

    @classmethod
    def of(cls, trace: Trace) -> _SimulatedLoop:
        """Find the mean line of a trace."""
        knots = np.linspace(trace.voltage.min(), trace.voltage.max(), _KNOTS)
        levels = _mean_line(trace.voltage, trace.simulated, knots)
        rest = float(np.interp(0.0, knots, levels))
        mean = np.interp(trace.voltage, knots, levels)
        stroke = float(np.ptp(trace.simulated))
        return cls(trace.time, trace.voltage, trace.measured, trace.simulated, mean, rest, stroke)

    def later(self, delay: float) -> _SimulatedLoop:
        """Return the loop as seen by a sensor with a `delay` [s]."""
        late = self.time - delay
        moved = (np.interp(late, self.time, values) for values in (self.voltage, self.simulated, self.mean))
        voltage, simulated, mean = moved
        return replace(self, voltage=voltage, simulated=simulated, mean=mean)


@dataclass(frozen=True, eq=False)
class _ChangeFit:
    """Coefficients (k,) of named columns, standard errors, the columns' largest values, and residual sum of squares."""

    names: list[str]
    values: Array
    errors: Array
    most: Array
    squares: float

    def parts(self) -> list[tuple[str, float, float, float]]:
        """Name, coefficient, standard error and largest value of each column."""
        columns = (self.values.tolist(), self.errors.tolist(), self.most.tolist())
        return list(zip(self.names, *columns, strict=True))


def _mean_line(voltage: Array, displacement: Array, knots: Array) -> Array:
    """Return the mean line (k,) at `knots`, the average of both branches; each passage has equal weight."""
    weight = np.sqrt(np.abs(np.gradient(voltage)))
    place = np.clip(np.searchsorted(knots, voltage, side="right") - 1, 0, knots.size - 2)
    share = (voltage - knots[place]) / (knots[1] - knots[0])
    matrix, target = np.zeros((knots.size, knots.size)), np.zeros(knots.size)
    for shift, part in ((0, 1 - share), (1, share)):
        np.add.at(target, place + shift, weight**2 * part * displacement)
        for other, beside in ((0, 1 - share), (1, share)):
            np.add.at(matrix, (place + shift, place + other), weight**2 * part * beside)
    # Knots that no passage reaches take the level of their neighbours.
    bend = np.diff(np.eye(knots.size), 2, axis=0)
    matrix += 1e-6 * float(np.trace(matrix)) / knots.size * bend.T @ bend
    return np.asarray(np.linalg.solve(matrix, target))


def _fitted(loop: _SimulatedLoop, slow: Slow | None, step: int) -> _ChangeFit:
    """Fit all columns; the simulated displacement is delayed, by half the record at most, until no delay is left."""
    delay, fit = 0.0, _regression(loop, slow, step)
    longest = 0.5 * float(loop.time[-1] - loop.time[0])
    place = fit.names.index("delay")
    for _ in range(_STEPS):
        if abs(fit.values[place]) <= 1e-2 * fit.errors[place]:
            break
        delay = float(np.clip(delay + fit.values[place], -longest, longest))
        fit = _regression(loop.later(delay), slow, step)
    fit.values[place] += delay
    return fit


def _regression(loop: _SimulatedLoop, slow: Slow | None, step: int) -> _ChangeFit:
    rate = _rate(loop.time, loop.simulated)
    width = loop.simulated - loop.mean
    columns = {"gain": loop.simulated - loop.rest, "delay": -rate, "offset": np.ones(rate.size)}
    if np.ptp(width) > _NARROW * loop.stroke:
        columns["width"] = width
    if slow is not None:
        columns[slow.name] = slow.curve
    names = [name for name in _WORDS if name in columns]
    kept = np.flatnonzero(np.isfinite(rate))[::step]
    x = np.column_stack([columns[name][kept] for name in names])
    scale = np.abs(x).max(axis=0)
    scale[scale == 0] = 1.0
    target = (loop.measured - loop.simulated)[kept]
    groups = np.arange(kept.size) * _BLOCKS // kept.size, _sections(loop.voltage[kept], rate[kept])
    fits = [_jackknife(x / scale, target, group) for group in groups]
    values, errors = fits[0][0], np.max([own for _, own in fits], axis=0)
    left = target - x / scale @ values
    most = np.where([name in _RANGING for name in names], np.ptp(x, axis=0), scale)
    return _ChangeFit(names, values / scale, errors / scale, most, float(left @ left))


def _rate(time: Array, values: Array) -> Array:
    """Return the derivative (n,), NaN next to gaps in time."""
    rate = np.gradient(values, time)
    steps = np.diff(time)
    gaps = np.flatnonzero(steps > 3 * np.median(steps))
    rate[gaps] = rate[gaps + 1] = np.nan
    return rate


def _sections(voltage: Array, rate: Array) -> NDArray[np.intp]:
    """Return the section of the loop of each sample (n,): by voltage, rising and falling numbered separately."""
    share = (voltage - voltage.min()) / max(float(np.ptp(voltage)), 1e-300)
    section = np.minimum((_SECTIONS * share).astype(np.intp), _SECTIONS - 1)
    return np.asarray(section + _SECTIONS * (rate > 0), dtype=np.intp)


def _jackknife(x: Array, y: Array, groups: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return least-squares coefficients (k,) and their jackknife standard errors, with each group left out in turn."""
    names = np.unique(groups)
    products = np.array([x[own].T @ np.column_stack([x[own], y[own]]) for own in (groups == name for name in names)])
    whole = products.sum(axis=0)
    values = _solved(whole)
    without = np.array([_solved(whole - part) for part in products])
    spread = without - without.mean(axis=0)
    return values, np.sqrt((names.size - 1) / names.size * np.sum(spread**2, axis=0))


def _solved(products: Array) -> Array:
    return np.asarray(np.linalg.lstsq(products[:, :-1], products[:, -1], rcond=1e-13)[0])
