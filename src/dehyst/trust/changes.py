"""What has changed since a model was identified: a small regression of measured on simulated displacements.

With s the simulated displacement, m(v) its mean line (the average of rising and falling branches) and h = s - m,

    y - s = gain (s - m(0 V)) + width h - delay s' + creep log10(t) + zero,

whose coefficients are the changes. The error of a model is not white noise: it repeats with the loop. Its covariance
falls with the distance in voltage and in h, and its size grows with the change itself, because no loop ages exactly as
the columns say. Constants were chosen on aged stages by other mechanisms: `benchmarks/ageing.py`.

The result is the smallest set of changes that leaves all others insignificant. If several sets are equally small, the
changes that all of them contain are sure. The rest, and any sure change that is not significant by itself, are stated
as one change, because the record cannot separate them. An error that is left beyond the promise is a change of shape.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._text import digits
from dehyst._types import Array, Mask
from dehyst._views import lines
from dehyst.identification import Trace
from dehyst.records import percent, turning_points

# Least multiple of the standard error with which one of several changes counts, and a single change or common effect.
# Changes explain a record if the others are not significant at this probability, and their residual is at most this
# multiple of the smallest one.
_SIGMAS, _TOGETHER, _INSIGNIFICANT, _MORE = 3.0, 2.0, 0.0027, 1.2
# Numbers of knots of the mean line, of blocks of samples, and of steps of the search for a delay.
_KNOTS, _BLOCKS, _STEPS = 24, 400, 4
# Length over which a model's error is similar, as a part of the voltages and of h. Part of a change that differs from
# its column, apart from the rise after a fitted start; slow changes that a record cannot show, in strokes a decade.
_ALIKE, _ALIKE_IN_LOOP, _UNLIKE, _UNSEEN = 0.3, 1.0, 0.2, 0.007
# A loop narrower than this part of its height has no width that could change.
_NARROW = 1e-3
# Columns with a smaller independent part count as dependent; tolerance of a delay, as a part of the stroke.
_DEPENDENT, _SMALL = 1e-6, 1e-5
# Creep is counted from this part of a cycle on.
_EARLY = 0.1
# Names of the slow changes (a record shows only one of them), and of the changes that an update learns.
SLOW, LEARNT = ("creep", "drift"), ("gain", "width", "shape")
_AND = " and "
# Factor and unit of each change in messages.
_SHOWN = {"gain": (100.0, "%"), "width": (100.0, "%"), "lag": (1e3, "ms")}


@dataclass(frozen=True)
class Change:
    """One thing that may have changed since the identification.

    Attributes
    ----------
    name : str
        "gain" (of the displacement relative to 0 V), "width" (of the loop, in addition to the gain), "zero" (of the
        displacement at 0 V, at the beginning of the record), "lag", "creep" (logarithmic in time), "drift" (linear in
        time) or "shape" (the error left by the changes that count). Names joined by " and ": changes that the record
        cannot separate; value and error are those of their common effect [m].
    value, error : float
        The change and its standard error: parts of 1 for gain and width, [m] for the zero, [s] for the lag, [m a decade
        of time] for creep, [m over the record] for a drift. For the shape: the RMS error that is left, and a third of
        the promised one [m].
    effect : float
        The largest error [m] due to the change on a path like the record, with the sign of `value`; as in every error,
        a constant does not count, except for the zero.
    counts : bool
        Whether the record shows the change: it exceeds three standard errors as one of several, two if it is the only
        one or a common effect of several; and its effect exceeds the least one that counts.
    """

    name: str
    value: float
    error: float
    effect: float
    counts: bool

    @property
    def parts(self) -> tuple[str, ...]:
        """What may have changed: one name, or several that the record cannot separate."""
        return tuple(self.name.split(_AND))

    def sentence(self, stroke: float, to_record: str = "") -> str:
        """Return the change as a sentence with what to do; creep and drift relative to `stroke` [m].

        `to_record`: the command of a record that separates several changes.
        """
        if len(self.parts) > 1:
            words = _AND.join(self.parts)
            text = f"The loop has changed by {self.amount(stroke)}; this record cannot separate {words}."
            if set(self.parts) <= {"zero", *SLOW}:
                return f"{text} The errors leave these out: no new model is needed."
            return f"{text} Record the loops of `{to_record}`, which separate them." if to_record else text
        direction = _WORDS[self.name][0 if self.value > 0 else 1]
        effect = lines.percent(abs(self.effect), stroke)
        return f"{direction.format(self.amount(stroke))}: up to {effect} of the stroke. {_REMEDIES[self.name]}"

    def amount(self, stroke: float) -> str:
        """Return size and standard error as text; creep and drift relative to `stroke` [m]."""
        factor, unit = _SHOWN.get(self.name, (1e9, "nm"))
        if self.name in (*SLOW, "shape") or len(self.parts) > 1:
            factor, unit = 100.0 / stroke, "% of the stroke" + (" a decade" if self.name == "creep" else "")
        return f"{digits(abs(self.value) * factor, 3)} ± {digits(self.error * factor)} {unit}"

    def as_dict(self, stroke: float) -> dict[str, Any]:
        """Return JSON values in SI units, the effect also in % of `stroke` [m]."""
        return {**asdict(self), "effect_percent": percent(self.effect, stroke)}


_WORDS = {
    "gain": ("The gain has risen by {}", "The gain has fallen by {}"),
    "width": ("The loop has become wider by {}", "The loop has become narrower by {}"),
    "zero": ("The displacement lies higher by {}", "The displacement lies lower by {}"),
    "lag": ("The displacement lags more, by {}", "The displacement lags less, by {}"),
    "creep": ("The displacement creeps up by {}", "The displacement creeps down by {}"),
    "drift": ("The displacement drifts up by {}", "The displacement drifts down by {}"),
    "shape": 2 * ("No change of gain, width, zero, lag or creep explains an RMS error of {}",),
}
_REMEDIES = {
    "gain": "Check the sensor's and the amplifier's gain, the load and the preload.",
    "width": "Check the temperature, the load and the range of the voltage.",
    "zero": "The error above leaves it out: zero the sensor or home the actuator; no new model is needed.",
    "lag": "Check the filters, the sample clock and the speed of the record.",
    "creep": "Wait before recording; a model with creep needs loops at two speeds or holds.",
    "drift": "Let the actuator warm up, or record at a constant temperature.",
    "shape": "The loop has changed its shape, or the record has a disturbance.",
}


@dataclass(frozen=True)
class Known:
    """What is known of a record and its model before the regression.

    `zero`: shift to the model's axis [m]; `doubt`: the uncertainty of `zero` [m]. `own`, `noise`: standard deviations
    of the model's own error on this path, and of the sensor [m]. `cycle` [s]. `slow`: whether the record can show creep
    or a drift. `stroke` [m]. `least`: effect [m] from which a change counts.
    """

    zero: float
    doubt: float
    own: float
    noise: float
    cycle: float
    slow: bool
    stroke: float
    least: float


def find_changes(trace: Trace, known: Known) -> tuple[Change, ...]:
    """Regress the measured minus the simulated displacement, without offset and drift, on possible changes."""
    loop = _SimulatedLoop.of(trace)
    fits = (_fitted(loop, known, name) for name in (SLOW if known.slow else (None,)))
    every = min(fits, key=lambda fit: float(fit.left @ fit.left))
    sure, needed = every.needed()
    whole, least = every.only(needed), _SIGMAS if len(needed) > 1 else _TOGETHER
    sure = {name for name in sure if whole.change([name], least).counts}
    apart = [name for name in every.names if name in needed - sure]
    found = list[Change]()
    for name in every.names:
        change = every.only({*(sure if name in apart else needed), name}).change([name], least)
        found.append(replace(change, counts=name in sure))
    found += [whole.change(apart, _TOGETHER)] if len(apart) > 1 else []
    stated = {part for change in found if change.counts for part in change.parts}
    return *found, every.only(stated).shape()


@dataclass(frozen=True, eq=False)
class _SimulatedLoop:
    """A simulated loop: time, voltage, measured and simulated displacement, mean line, and mean line at 0 V.

    `began`: time of the first sample; `start`, `counts`: samples that may depend on the fitted start, and that count.
    """

    time: Array
    voltage: Array
    measured: Array
    simulated: Array
    mean: Array
    rest: float
    began: float
    start: Mask
    counts: Mask

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
            np.ones(trace.time.size, dtype=bool) if trace.counts is None else trace.counts,
        )

    def later(self, delay: float) -> _SimulatedLoop:
        """Return the loop as seen by a sensor with a `delay` [s]."""
        late = self.time - delay
        given = self.voltage, self.simulated, self.mean
        voltage, simulated, mean = (np.interp(late, self.time, values) for values in given)
        return replace(self, voltage=voltage, simulated=simulated, mean=mean)

    def slow(self, name: str, cycle: float) -> Array:
        """Return the curve (n,) of creep, a decade of time, or of a drift over the record; both begin at 0."""
        time = self.time - self.began
        return np.log10(1 + time / (_EARLY * cycle)) if name == "creep" else time / float(time[-1])


@dataclass(frozen=True, eq=False)
class _ChangeFit:
    """Coefficients (k,) of named columns, the columns (n, k) and the residual (n,), both as means over blocks.

    `most`: largest effect of each column. `blocks`: indices of samples of the `loop` that count.
    """

    names: list[str]
    values: Array
    most: Array
    columns: Array
    left: Array
    blocks: NDArray[np.intp]
    loop: _SimulatedLoop
    known: Known

    def only(self, names: set[str]) -> _ChangeFit:
        """Return the fit of some of the columns and of the constant."""
        places = [place for place, name in enumerate(self.names) if name in {*names, "zero"}]
        columns, target = self.columns[:, places], self.left + self.columns @ self.values
        values = _solved(columns, target)
        left, kept = target - columns @ values, [self.names[place] for place in places]
        return replace(self, names=kept, values=values, most=self.most[places], columns=columns, left=left)

    def needed(self) -> tuple[set[str], set[str]]:
        """Return the changes in all, and in any, of the smallest sets that explain the record as all changes do."""
        from scipy.special import chdtri

        error = np.sqrt(np.diag(self.covariance))
        sigmas, alike = self.values / error, self.covariance / np.outer(error, error)
        enough = list[tuple[set[str], float]]()
        for count in range(len(error), -1, -1):
            for others in combinations(range(len(error)), count):
                away, back = sigmas[[*others]], np.linalg.pinv(alike[np.ix_(others, others)], _DEPENDENT, True)
                if not count or away @ back @ away <= chdtri(count, _INSIGNIFICANT):
                    names = {name for place, name in enumerate(self.names) if place not in others}
                    enough.append((names, self.only(names).shape().value))
        most = max(_MORE * min(left for _, left in enough), self.known.own)
        smallest, sets = (
            [names for names in some if len(names) == len(some[0])]
            for some in ([names for names, _ in enough], [names for names, left in enough if left <= most])
        )
        # If either of two changes makes all others insignificant, the record cannot separate them.
        pairs = [a ^ b for a, b in combinations(smallest, 2) if len(a ^ b) == 2]
        sets += [names ^ pair for names in sets for pair in pairs if len(names & pair) == 1]
        return set.intersection(*sets), set.union(*sets)

    def change(self, parts: list[str], least: float) -> Change:
        """Return a change, or the common effect of several; it counts from `least` standard errors."""
        places, row, most = [self.names.index(part) for part in parts], np.ones(1), 1.0
        away, alone = self.values[places], len(parts) == 1
        if alone:
            most = float(self.most[places[0]])
        else:
            # Without a change of the zero, an effect that is the same everywhere does not count.
            columns = self.columns[:, places] - ("zero" not in parts) * self.columns[:, places].mean(axis=0)
            row = columns[int(np.argmax(np.abs(columns @ away)))]
        value = float(row @ away if alone else abs(row @ away))
        error = float(np.sqrt(row @ self.covariance[np.ix_(places, places)] @ row))
        counts = abs(value) > least * error and abs(value * most) > self.known.least
        return Change(_AND.join(parts), value, error, value * most, counts)

    def shape(self) -> Change:
        """Return the residual without the rise after a fitted start, as a change."""
        left = self.left[_means(self.loop.start.astype(np.float64), self.blocks) < 0.5]
        left, noise = left - left.mean(), self.known.noise / np.sqrt(self.blocks.shape[1])
        size, most = float(np.sqrt(max(np.mean(left**2) - noise**2, 0.0))), float(np.abs(left).max())
        return Change("shape", size, self.known.own / _SIGMAS, most, size > self.known.own and most > self.known.least)

    @cached_property
    def covariance(self) -> Array:
        """The covariance (k, k) of the coefficients, by the correlated error of the model."""
        loop, known = self.loop, self.known
        scale = np.linalg.norm(self.columns, axis=0)
        back = np.linalg.pinv(self.columns / scale, rcond=_DEPENDENT) / scale[:, None]
        within = loop.simulated - loop.mean
        signals = loop.voltage, within, loop.start.astype(np.float64)
        voltage, within, start = (_means(values, self.blocks) for values in signals)
        wide, high = _ALIKE * np.ptp(voltage), _ALIKE_IN_LOOP * np.abs(within).max()
        alike = np.exp(-_apart(voltage, wide) - _apart(within, high))
        own, changed = known.own**2, float(np.var(self.columns @ self.values))
        error = (own + float(np.mean(self.left**2)) + _UNLIKE**2 * changed) * alike
        error += (changed + own) * np.outer(start, start) * alike
        if not known.slow:
            for name in SLOW:
                curve = _means(loop.slow(name, known.cycle), self.blocks)
                error += (_UNSEEN * known.stroke) ** 2 * np.outer(curve, curve)
        error[np.diag_indices(len(error))] += known.noise**2 * len(error) / self.blocks.size
        doubt = np.diag([known.doubt**2 * (name == "zero") for name in self.names])
        return np.asarray(back @ error @ back.T) + doubt


def _apart(place: Array, length: float) -> Array:
    """Return distances (n, n) of places (n,), divided by a length."""
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
    kept = np.flatnonzero(np.isfinite(rate) & loop.counts)
    long = max(1, kept.size // _BLOCKS)
    blocks = kept[: kept.size // long * long].reshape(-1, long)
    whole = np.column_stack([columns[name] for name in names])
    apart = whole[kept] - np.where([name == "zero" for name in names], 0.0, whole[kept].mean(axis=0))
    most = np.abs(apart).max(axis=0)
    few, target = _means(whole, blocks), _means(loop.measured - loop.simulated - known.zero, blocks)
    values = _solved(few, target)
    return _ChangeFit(names, values, most, few, target - few @ values, blocks, loop, known)


def _solved(columns: Array, target: Array) -> Array:
    """Return the coefficients (k,) of columns (n, k) that come nearest to a target (n,)."""
    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0] = 1.0
    return np.asarray(np.linalg.lstsq(columns / scale, target, rcond=_DEPENDENT)[0] / scale)


def _rate(time: Array, values: Array) -> Array:
    """Return the derivative (n,), NaN next to gaps in time."""
    rate = np.gradient(values, time)
    steps = np.diff(time)
    gaps = np.flatnonzero(steps > 3 * np.median(steps))
    rate[gaps] = rate[gaps + 1] = np.nan
    return rate
