"""What has changed since a model was identified: a small regression of measured on simulated displacements.

With s the simulated displacement, m(v) its mean line (the average of rising and falling branches) and h = s - m,

    y - s = gain (s - m(0 V)) + width h - delay s' + creep log10(t) + zero,

whose coefficients are the changes. The error of a model is no white noise: it is alike wherever the loop comes again.
Its covariance falls with the distance in voltage and in h, and its size grows with the change itself, because no loop
ages exactly as the columns say. Constants were chosen on aged stages by other mechanisms: `benchmarks/ageing.py`.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._text import digits
from dehyst._types import Array, Mask
from dehyst._views import lines
from dehyst.identification import Trace
from dehyst.records import percent, turning_points

# Least multiple of its standard error from which a change counts.
SIGMAS, TOGETHER = 3.0, 2.0
# Knots of the mean line; blocks of samples; steps of the search for a delay, of which the regression knows one order.
_KNOTS, _BLOCKS, _STEPS = 24, 400, 4
# Over which part of the voltages, and of h, the error of a model is alike, and over which part of a cycle it wanders.
_ALIKE, _ALIKE_IN_LOOP, _WANDERS, _WANDERING = 0.3, 1.0, 0.25, 0.1
# Parts of a change, and of a change of gain, that do not look like its column, and of all on the rise from a fitted
# start; the own error of a model beside its promise; slow changes that a record cannot show, of the stroke a decade.
_UNLIKE, _UNLIKE_GAIN, _AT_START, _OWN, _UNSEEN = 0.4, 0.1, 1.0, 1.3, 0.007
# Probability with which what is left over shows a variance of the model's own error.
_SHOWN_AT_LEAST = 0.95
# A loop narrower than this part of its height has no width that could change.
_NARROW = 1e-3
# Columns that depend on one another to this part count as dependent; a delay is found to this part of the stroke.
_DEPENDENT, _SMALL = 1e-6, 1e-5
# Part of a cycle from which on the time of creep is counted.
_EARLY = 0.1
# Names of the slow changes, of which a record shows one.
SLOW = ("creep", "drift")
# Names of the changes that an update learns.
LEARNT = ("gain", "width")
# Factor and unit in which each is shown.
_AND = " and "
_SHOWN = {"gain": (100.0, "%"), "width": (100.0, "%"), "lag": (1e3, "ms")}


@dataclass(frozen=True)
class Change:
    """One thing that may have changed since the identification.

    Attributes
    ----------
    name : str
        "gain" (of the displacement relative to 0 V), "width" (of the loop, in addition to the gain), "zero" (of the
        displacement at 0 V, at the beginning of the record), "lag", "creep" (logarithmic in time) or "drift" (linear
        in time). Names joined by " and ": changes that the record cannot tell apart; value and error are those of their
        common effect [m].
    value, error : float
        The change and its standard error: parts of 1 for gain and width, [m] for the zero, [s] for the lag,
        [m a decade of time] for creep, [m over the record] for a drift.
    effect : float
        The largest error [m] due to the change on a path like the record, with the sign of `value`: apart from a
        constant, as every error is, but for the zero.
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
        """Whether the change exceeds three standard errors, several together two, and its effect exceeds `least`."""
        sigmas = SIGMAS if len(self.parts) == 1 else TOGETHER
        return abs(self.value) > sigmas * self.error and abs(self.effect) > self.least

    @property
    def parts(self) -> tuple[str, ...]:
        """What may have changed: one name, or several that the record cannot tell apart."""
        return tuple(self.name.split(_AND))

    def sentence(self, stroke: float, to_record: str = "") -> str:
        """Return the change as a sentence with what to do; creep and drift relative to `stroke` [m].

        `to_record`: the command of a record that separates several changes.
        """
        if len(self.parts) > 1:
            words = _AND.join(self.parts)
            text = f"The loop has changed by {self.amount(stroke)}; this record cannot tell {words} apart."
            return f"{text} Record the loops of `{to_record}`, which separate them." if to_record else text
        direction = _WORDS[self.name][0 if self.value > 0 else 1]
        effect = lines.percent(abs(self.effect), stroke)
        return f"{direction.format(self.amount(stroke))}: up to {effect} of the stroke. {_REMEDIES[self.name]}"

    def amount(self, stroke: float) -> str:
        """Return size and standard error as text; creep and drift relative to `stroke` [m]."""
        factor, unit = _SHOWN.get(self.name, (1e9, "nm"))
        if self.name in SLOW or len(self.parts) > 1:
            factor, unit = 100.0 / stroke, "% of the stroke" + (" a decade" if self.name == "creep" else "")
        return f"{digits(abs(self.value) * factor, 3)} ± {digits(self.error * factor)} {unit}"

    def as_dict(self, stroke: float) -> dict[str, Any]:
        """Return JSON values in SI units, the effect also in % of `stroke` [m]."""
        return {**asdict(self), "effect_percent": percent(self.effect, stroke), "counts": self.counts}


_WORDS = {
    "gain": ("The gain has risen by {}", "The gain has fallen by {}"),
    "width": ("The loop has become wider by {}", "The loop has become narrower by {}"),
    "zero": ("The displacement lies higher by {}", "The displacement lies lower by {}"),
    "lag": ("The displacement lags more, by {}", "The displacement lags less, by {}"),
    "creep": ("The displacement creeps up by {}", "The displacement creeps down by {}"),
    "drift": ("The displacement drifts up by {}", "The displacement drifts down by {}"),
}
_REMEDIES = {
    "gain": "Check the sensor's and the amplifier's gain, the load and the preload.",
    "width": "Check the temperature, the load and the range of the voltage.",
    "zero": "The errors leave it out: zero the sensor or home the actuator; no new model is needed.",
    "lag": "Check the filters, the sample clock and the speed of the record.",
    "creep": "Wait before recording; creep of the model needs loops at two speeds or holds.",
    "drift": "Let the actuator warm up, or record at a constant temperature.",
}


@dataclass(frozen=True)
class Known:
    """What is known of a record and its model before the regression.

    `zero`: shift to the model's axis [m]; `doubt`: its uncertainty that the record leaves [m]. `own`, `noise`:
    standard deviations of the model's own error on this path, and of the sensor [m]. `cycle` [s]. `slow`: whether the
    record can show creep or a drift. `stroke` [m].
    """

    zero: float
    doubt: float
    own: float
    noise: float
    cycle: float
    slow: bool
    stroke: float


def find_changes(trace: Trace, known: Known, least: float) -> tuple[Change, ...]:
    """Regress the measured minus the simulated displacement on possible changes.

    Parameters
    ----------
    trace : Trace
        Measured and simulated displacement, simulated without offset and drift.
    known : Known
    least : float
        Effect [m] from which a change counts.
    """
    loop = _SimulatedLoop.of(trace)
    fit = min((_fitted(loop, known, name) for name in (SLOW if known.slow else (None,))), key=lambda made: made.squares)
    covariance = fit.covariance(loop, known)
    found, open_ = list[Change](), list[int]()
    for place, name in enumerate(fit.names):
        value, most, error = fit.values[place], fit.most[place], float(np.sqrt(covariance[place, place]))
        if name == "zero":
            value, error = value - known.zero, float(np.hypot(error, known.doubt))
        found.append(Change(name, float(value), error, float(value * most), least))
        if not found[-1].counts and SIGMAS * error * most > least:
            open_.append(place)
    # If not with the zero, then apart from a constant, as an error is.
    shape = [place for place in open_ if fit.names[place] != "zero"]
    # One change alone comes first: an effect that it explains is not that of several.
    named = [place for place, change in enumerate(found) if change.counts]
    groups = [] if named and _explained(fit, named, known) else [open_, shape]
    joint = [_together(fit, covariance, places, known, least) for places in groups if len(places) > 1]
    return *found, *([change for change in joint if change.counts] or joint)[:1]


def _explained(fit: _ChangeFit, named: list[int], known: Known) -> bool:
    """Return whether changes that a record shows alone, and a constant, leave no more than the model's own error."""
    target = fit.left + fit.columns @ fit.values
    columns = fit.columns[:, [*{*named, fit.names.index("zero")}]]
    left = target - columns @ np.linalg.lstsq(columns, target, rcond=_DEPENDENT)[0]
    return bool(np.mean(left**2) < (_OWN * known.own) ** 2 + known.noise**2 / fit.blocks.shape[1])


def _together(fit: _ChangeFit, covariance: Array, places: list[int], known: Known, least: float) -> Change:
    """Return the common effect of changes that the record cannot tell apart."""
    columns, names = fit.columns[:, places], [fit.names[place] for place in places]
    # Without a change of the zero, an effect that is the same everywhere does not count.
    columns = columns if "zero" in names else columns - columns.mean(axis=0)
    values = fit.values[places] - np.where([name == "zero" for name in names], known.zero, 0.0)
    row = columns[int(np.argmax(np.abs(columns @ values)))]
    error = float(np.hypot(np.sqrt(row @ covariance[np.ix_(places, places)] @ row), known.doubt * ("zero" in names)))
    size = abs(float(row @ values))
    return Change(_AND.join(names), size, error, size, least)


@dataclass(frozen=True, eq=False)
class _SimulatedLoop:
    """A simulated loop: time, voltage, measured and simulated displacement, mean line, and mean line at 0 V.

    `began`: time of the record's first sample; `start`: which samples may depend on the fitted start.
    """

    time: Array
    voltage: Array
    measured: Array
    simulated: Array
    mean: Array
    rest: float
    began: float
    start: Mask

    @classmethod
    def of(cls, trace: Trace) -> _SimulatedLoop:
        """Find the mean line of a trace."""
        knots = np.linspace(trace.voltage.min(), trace.voltage.max(), _KNOTS)
        levels = _mean_line(trace.voltage, trace.simulated, knots)
        turns = turning_points(trace.voltage, 0.02 * float(np.ptp(trace.voltage)))
        turns = turns[turns > 0]
        first = turns[1] if len(turns) > 2 else turns[0] if len(turns) else 0
        return cls(
            trace.time,
            trace.voltage,
            trace.measured,
            trace.simulated,
            np.interp(trace.voltage, knots, levels),
            float(np.interp(0.0, knots, levels)),
            min(trace.began, float(trace.time[0])),
            np.arange(trace.time.size) < first,
        )

    def later(self, delay: float) -> _SimulatedLoop:
        """Return the loop as seen by a sensor with a `delay` [s]."""
        late = self.time - delay
        moved = (np.interp(late, self.time, values) for values in (self.voltage, self.simulated, self.mean))
        voltage, simulated, mean = moved
        return replace(self, voltage=voltage, simulated=simulated, mean=mean)

    def slow(self, name: str, cycle: float) -> Array:
        """Return the curve (n,) of creep, a decade of time, or of a drift over the record; both begin at 0."""
        time = self.time - self.began
        return np.log10(1 + time / (_EARLY * cycle)) if name == "creep" else time / float(time[-1])


@dataclass(frozen=True, eq=False)
class _ChangeFit:
    """Coefficients (k,) of named columns, the columns (n, k) and what they leave (n,), both in means over blocks.

    `most`: largest effect of each column. `blocks`: of the loop's samples that count.
    """

    names: list[str]
    values: Array
    most: Array
    columns: Array
    left: Array
    blocks: NDArray[np.intp]

    @property
    def squares(self) -> float:
        """Residual sum of squares."""
        return float(self.left @ self.left)

    def covariance(self, loop: _SimulatedLoop, known: Known) -> Array:
        """Return the covariance (k, k) of the coefficients, by the correlated error of the model."""
        scale = np.linalg.norm(self.columns, axis=0)
        back = np.linalg.pinv(self.columns / scale, rcond=_DEPENDENT)
        effect = dict(zip(self.names, (self.columns * self.values).T, strict=True))
        slow = next((effect[name] for name in SLOW if name in effect), 0.0)
        shape = effect.get("width", 0.0) + effect["lag"]
        within = loop.simulated - loop.mean
        voltage, within, time, start = (
            _means(values, self.blocks) for values in (loop.voltage, within, loop.time, loop.start.astype(np.float64))
        )
        alike = np.exp(
            -_apart(voltage, _ALIKE * np.ptp(voltage)) - _apart(within, _ALIKE_IN_LOOP * np.abs(within).max())
        )
        correlated = alike + _WANDERING * np.exp(-_apart(time, _WANDERS * known.cycle))
        prior = (_OWN * known.own) ** 2
        shown = self._shown(correlated - self.columns / scale @ (back @ correlated))
        own = min(prior, (prior * shown) ** 0.5)
        unlike = _UNLIKE * np.std(shape), _UNLIKE * np.std(slow), _UNLIKE_GAIN * np.std(effect["gain"])
        error = (own + float(np.mean(self.left**2)) + float(np.sum(np.square(unlike)))) * correlated
        begins = _AT_START**2 * (np.var(shape + effect["gain"]) + own)
        error += begins * np.outer(start, start) * alike
        if not known.slow:
            for name in SLOW:
                curve = _means(loop.slow(name, known.cycle), self.blocks)
                error += (_UNSEEN * known.stroke) ** 2 * np.outer(curve, curve)
        error[np.diag_indices(len(error))] += known.noise**2 * len(error) / self.blocks.size
        back /= scale[:, None]
        return np.asarray(back @ error @ back.T)

    def _shown(self, remaining: Array) -> float:
        """Return the most that the variance of a correlated error can be, by what the columns leave.

        `remaining`: correlation (n, n) of the error, projected on what no column explains.
        """
        from scipy.special import chdtri

        trace = float(np.trace(remaining))
        free = trace**2 / float(np.sum(remaining * remaining.T))
        return float(self.left @ self.left) / trace * free / float(chdtri(free, _SHOWN_AT_LEAST))


def _apart(place: Array, length: float) -> Array:
    """Return distances (n, n) of places (n,) in a length."""
    return np.asarray(np.abs(place[:, None] - place) / max(length, 1e-300))


def _means(values: Array, blocks: NDArray[np.intp]) -> Array:
    """Return means (k, ...) over blocks (k, m) of samples of values (n, ...)."""
    return np.asarray(values[blocks].mean(axis=1))


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


def _fitted(loop: _SimulatedLoop, known: Known, slow: str | None) -> _ChangeFit:
    """Fit all columns; the simulated displacement is delayed, by half the record at most, until no delay is left."""
    delay, fit = 0.0, _regression(loop, known, slow)
    longest = 0.5 * float(loop.time[-1] - loop.time[0])
    place = fit.names.index("lag")
    for _ in range(_STEPS):
        if abs(fit.values[place] * fit.most[place]) <= _SMALL * known.stroke:
            break
        delay = float(np.clip(delay + fit.values[place], -longest, longest))
        fit = _regression(loop.later(delay), known, slow)
    fit.values[place] += delay
    return fit


def _regression(loop: _SimulatedLoop, known: Known, slow: str | None) -> _ChangeFit:
    rate, width = _rate(loop.time, loop.simulated), loop.simulated - loop.mean
    columns = {"gain": loop.simulated - loop.rest, "lag": -rate, "zero": np.ones(rate.size)}
    if np.ptp(width) > _NARROW * np.ptp(loop.simulated):
        columns["width"] = width
    if slow is not None:
        columns[slow] = loop.slow(slow, known.cycle)
    names = [name for name in _WORDS if name in columns]
    kept = np.flatnonzero(np.isfinite(rate))
    long = max(1, kept.size // _BLOCKS)
    blocks = kept[: kept.size // long * long].reshape(-1, long)
    whole = np.column_stack([columns[name] for name in names])
    apart = whole[kept] - np.where([name == "zero" for name in names], 0.0, whole[kept].mean(axis=0))
    most = np.abs(apart).max(axis=0)
    few, target = _means(whole, blocks), _means(loop.measured - loop.simulated, blocks)
    scale = np.linalg.norm(few, axis=0)
    scale[scale == 0] = 1.0
    values = np.linalg.lstsq(few / scale, target, rcond=_DEPENDENT)[0] / scale
    return _ChangeFit(names, values, most, few, target - few @ values, blocks)


def _rate(time: Array, values: Array) -> Array:
    """Return the derivative (n,), NaN next to gaps in time."""
    rate = np.gradient(values, time)
    steps = np.diff(time)
    gaps = np.flatnonzero(steps > 3 * np.median(steps))
    rate[gaps] = rate[gaps + 1] = np.nan
    return rate
