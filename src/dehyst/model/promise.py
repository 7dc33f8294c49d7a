"""The promise: a bound of the error on a path, from what the records of an identification tested.

A promise is a bound that nine of ten paths should keep (theory sections 18 and 29). It bounds the error without its
mean, as no record determines the later zero of the sensor. It also leaves out a constant delay, if the records do not
show whether actuator or sensor lags. The bound is proportional to a geometric mean of two lengths: the error on
held-out parts, and the distance of other models that explain the records. It grows with the distance of the path's
branches from those of the records and with their pace, and depends on the kind of the path. Its constants were found on
virtual actuators whose mechanisms are not instances of the model, and tested on others: `benchmarks/promise.py`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import Numbers
from dehyst._views.fields import json_values
from dehyst._views.lines import percent
from dehyst.model.branches import (
    ALIKE,
    BAND,
    Untested,
    branches_of,
    distances,
    hold_of,
    not_recorded,
    paces_of,
    untested_by,
)
from dehyst.model.dynamics import DisplacementCreep, Thermal
from dehyst.model.entries import Entries, entry, flag
from dehyst.model.states import stroke_of
from dehyst.model.temperatures import temperature_cost
from dehyst.records import rms

if TYPE_CHECKING:
    from dehyst.model.actuator import Actuator
    from dehyst.model.entries import Numeric

# Words for the start of a path; any other start is called by its name.
_BEGINS = {
    "": "",
    "homed": " from a homed start",
    "unknown": " from an unknown start",
    "top": " from the top after a rise",
    "bottom": " from the bottom after a fall",
}
# Largest number of branches of the records that a model keeps.
_MOST = 600
# Records turn at random if a path with random turning points is at most this new, as a part of the range.
_NEW = 0.02
# Number of turning points of a path of which only the range is known.
_TURNS = 60
# Bounds of the largest and the RMS error, as multiples of the error that the records show.
LARGEST, RMS = 6.2, 2.2
# A path closes loops if at least this part of its branches do. Factors of the promised errors: the path closes loops,
# but the records do not; the records do not show whether actuator or sensor lags.
_CLOSING, _OPEN, _LAGGING = 0.2, 1.8, 1.6
# Largest offset of a path whose sensor is zeroed at its start, as a part of its largest error; creep adds to it.
_OFFSET = 0.5
# Least error that the records can show, as a part of the stroke; least disagreement of models, as a part of the
# held-out error.
_LEAST, _AGREES = 1e-4, 0.3
# The bound grows as exp(this times newness) up to a largest newness; newness is a part of the range.
_GROWS, _NEWEST = 2.6, 0.3
# Largest error of a usable model [% of the stroke].
USELESS = 5.0
# Power of the bound over the speed ratio of path to records; the ratio of turn rates above which it counts likewise;
# part of the growth of the records' error with the pace that is added to the bound.
_FASTER, _OFTENER, _GROWTH = 0.4, 3.0, 0.6
# Ratio of largest to mean speed of a branch; of RMS to largest error from a lag; of the largest difference of a delay
# and a low-pass after a turn to the lag times the speed. Ages, in time constants, of equal parts of a low-pass's input.
_PEAK, _LATE_RMS, _AT_A_TURN, _MEMORY = 1.9, 0.5, 2 * float(np.exp(-1.0)), -np.log1p(-(np.arange(16) + 0.5) / 16)
# Powers of three ratios: range of a path / mean height of its branches; range of the path / range of the records;
# longest hold of the path / of the records, with a largest ratio. The last is the exponent per share of rest.
_PLACES, _RANGE, _HOLD, _LONGEST, _RESTING = 0.35, 0.7, 0.07, 20.0, 0.35
# Error of a path that lasts a decade longer than the records show creep, as a part of the creep per decade.
_SLOWER = 0.3
# Branches up to this quantile of the paces are slow; the search for a lag resolves this part of a sample.
_MOST_OF_THEM, _UNSEEN = 0.25, 0.1
# A path rests where its voltage moves at less than this part of its largest speed.
_RESTS = 0.02
_SIZE, _PAIR = Numbers(least=0.0, largest=1e9), Numbers(1, least=0.0, largest=1e9, divides=True)
_ANY = replace(_PAIR, least=-np.inf, divides=False)


def _pair(value: Any, where: str, numbers: Numbers = _PAIR) -> tuple[float, float] | None:
    """Return two numbers; for temperatures also None."""
    if value is None and where.endswith("temperatures"):
        return None
    if len(found := numbers(value, where).tolist()) != 2:
        raise ModelError(argument=where, got=f"{len(found)} numbers", need="two")
    return found[0], found[1]


def _branches(value: Any, where: str) -> Array:
    """Return pairs of voltages (k, 2); k may be 0."""
    if isinstance(value, list | tuple | np.ndarray) and not len(value):
        return np.zeros((0, 2))
    found = Numbers(2, largest=1e9)(value, where)
    if found.shape[1] != 2:
        raise ModelError(argument=where, got=f"{found.shape[1]} columns", need="pairs of voltages")
    return np.asarray(found)


@dataclass(frozen=True, eq=False)
class Validity(Entries):
    """The domain of validity of a model: what its records tested, and its error on held-out parts.

    Attributes
    ----------
    rms : float
        RMS error of held-out parts [m], without sensor noise.
    largest : float
        Largest error on the training records after their second turning point [m], without sensor noise.
    disagreement : float
        RMS distance of models with other structures that explain the records almost as well [m].
    stroke : float
        Range of the widest loop [m].
    limits : (float, float)
        Lowest and highest voltage of the records [V].
    branches : (k, 2) array
        First and last voltage of each branch of the records [V].
    new : (float, float)
        RMS distance of held-out rises, and of held-out falls, from the other branches, as a part of the voltage range.
    speeds : (float, float)
        Lowest and highest mean speed of a branch [V/s].
    rates : (float, float)
        Lowest and highest rate of turns: the reciprocal time of a branch without the time at rest [1/s].
    growth : float
        Increase of the RMS error [m] from slow branches to the fastest one.
    hold, lasts : float
        Longest time at one voltage, and longest record [s].
    drift : float
        Largest drift [m] that was removed from a record; the errors above do not contain it.
    lag, lag_error : float
        Estimated time [s] by which the displacement lags the voltage, and its possible error [s].
    lag_open : bool
        True if the records do not show whether actuator or sensor lags.
    creep_open : float
        Creep in a decade, as a part of a step, that the records neither show nor exclude.
    temperatures : (float, float) or None
        Lowest and highest temperature of the records [degC]; None if one of them has none.
    """

    _part = "validity"
    rms: float = entry("rms_m", _SIZE)
    largest: float = entry("largest_m", _SIZE)
    disagreement: float = entry("disagreement_m", _SIZE)
    stroke: float = entry("stroke_m", replace(_SIZE, positive=True, plausible=0.1))
    limits: tuple[float, float] = entry("limits_V", partial(_pair, numbers=_ANY))
    branches: Numeric = entry("branches_V", _branches, ())
    new: tuple[float, float] = entry("new", _pair, (0.0, 0.0))
    speeds: tuple[float, float] = entry("speeds_V_per_s", _pair, (0.0, 0.0))
    rates: tuple[float, float] = entry("rates_per_s", _pair, (0.0, 0.0))
    growth: float = entry("growth_m", _SIZE, 0.0)
    hold: float = entry("hold_s", _SIZE, 0.0)
    lasts: float = entry("lasts_s", _SIZE, 0.0)
    drift: float = entry("drift_m", _SIZE, 0.0)
    lag: float = entry("lag_s", _SIZE, 0.0)
    lag_error: float = entry("lag_error_s", _SIZE, 0.0)
    lag_open: bool = entry("lag_open", flag, False)
    creep_open: float = entry("creep_open", _SIZE, 0.0)
    temperatures: tuple[float, float] | None = entry("temperatures_degC", partial(_pair, numbers=_ANY), None)

    def _demand_together(self) -> None:
        for name in ("limits", "speeds", "rates", "temperatures"):
            low, high = getattr(self, name) or (0.0, 0.0)
            if low > high or (name == "limits" and low == high):
                raise ModelError(argument=f"validity {name}", got=f"{low:g}, {high:g}", need="the lower one first")

    @classmethod
    def by_records(cls, records: Iterable[tuple[Array, Array]], **numbers: Any) -> Validity:
        """Return the validity from time (n,) [s] and voltage (n,) [V] of `records`; `numbers`: other fields by name."""
        given = list(records)
        ends = [float(end) for _, voltage in given for end in (voltage.min(), voltage.max())]
        limits = min(ends), max(ends)
        span, pairs, paces, hold = limits[1] - limits[0], [], [], 0.0
        for time, voltage in given:
            at = branches_of(voltage, span)
            pairs.append(voltage[at])
            paces.append(paces_of(time, voltage, at))
            hold = max(hold, hold_of(time, voltage, span))
        every = np.concatenate(paces)
        kept = np.unique(np.round(np.concatenate(pairs) / (0.25 * BAND * span)), axis=0) * (0.25 * BAND * span)
        least, most = (every.min(axis=0), every.max(axis=0)) if len(every) else np.zeros((2, 2))
        # Creep is confused with a lag unless most branches are much slower than the fastest ones.
        alike = float((np.quantile(every, _MOST_OF_THEM, axis=0) / most).max()) if len(every) else 1.0
        step = min((float(np.median(np.diff(time))) for time, _ in given if time.size > 1), default=0.0)
        numbers = {"lag_error": max(numbers.get("lag", 0.0), _UNSEEN * step) * alike} | numbers
        lasts = max(float(np.ptp(time)) for time, _ in given)
        numbers |= {"speeds": (least[0], most[0]), "rates": (least[1], most[1]), "hold": hold, "lasts": lasts}
        return cls(limits=limits, branches=kept[:: 1 + len(kept) // _MOST], **numbers)

    @property
    def span(self) -> float:
        """Range of the voltages [V]."""
        return self.limits[1] - self.limits[0]

    @property
    def shown(self) -> float:
        """The error [m] that the records show: a geometric mean of held-out error and squared disagreement."""
        both = self.rms, max(self.disagreement, _AGREES * self.rms)
        held_out, apart = (float(np.hypot(error, _LEAST * self.stroke)) for error in both)
        return float((held_out * apart**2) ** (1 / 3))

    @property
    def turns_anywhere(self) -> bool:
        """Whether the records turn anywhere in their range, as with random turning points."""
        return newness(self, _anywhere(self))[2] <= _NEW

    @cached_property
    def anywhere(self) -> Promise:
        """The promise for any path like the records."""
        return promise(self)


@dataclass(frozen=True, eq=False)
class Promise:
    """Error of a path, as a bound that nine of ten paths should keep.

    Attributes
    ----------
    path : str
        The path, in words: any path like the records, or this path from its start.
    rms, largest : float
        RMS and largest error of the path [m], without its mean error, with the error of clamped voltages.
    parts : mapping of str to float
        Terms of `largest` [m]: "model"; "temperature", "creep", "lag", "start", "missed", "voltages" if they are not 0.
    half : (n,) array
        The bound along the path [m]: wider on branches that are unlike those of the records.
    stroke : float
        Reference of percentages [m].
    offset : float
        Largest mean error [m] if the sensor is zeroed at the first sample; `rms` and `largest` leave it out.
    delay : float
        Time [s] by which the path may be late, if the records do not show whether the sensor lags; else 0. The errors
        leave it out.
    untested : tuple of Untested
        Properties of the path that the records do not test; for these the promise does not hold.
    """

    path: str
    rms: float
    largest: float
    parts: Mapping[str, float]
    half: Array
    stroke: float
    offset: float
    delay: float = 0.0
    untested: tuple[Untested, ...] = ()

    def __repr__(self) -> str:
        return f"<Promise: {self.sentence}>"

    def missed_by(self, largest: float, rms: float) -> float:
        """Return the larger ratio of an error [m] to the promised error; above 1 the promise is not kept."""
        return max(largest / self.largest, rms / self.rms)

    @property
    def apart(self) -> str:
        """The parts that the errors leave out, in words."""
        late = f" and a delay of up to {1e3 * self.delay:.3g} ms" if self.delay else ""
        return f"apart from a constant offset{' of the sensor' if 'missed' in self.parts else ''}{late}"

    @property
    def unusable(self) -> str:
        """Advice if the largest error from model and lag exceeds 5 % of the stroke; else empty."""
        if self.parts["model"] + self.parts.get("lag", 0.0) <= 0.01 * USELESS * self.stroke:
            return ""
        advice = "The records test this path: identify each record alone to find the cause, or slow the path."
        if any(gap.command for gap in self.untested):
            advice = "Record what the records do not test (dehyst insight names it), and identify again."
        return f"The model is not usable for {self.path}: its own error is over {USELESS:g} % of the stroke. {advice}"

    @property
    def sentence(self) -> str:
        """The promise in words, errors in percent of the stroke."""
        return self.lines()[0]

    def lines(self, goal: float = USELESS) -> tuple[str, ...]:
        """Return the promise and each untested property, a sentence each; none looks like a `goal` [%]."""
        largest, rms_ = (percent(error, self.stroke, goal=goal) for error in (self.largest, self.rms))
        text = f"Expect {self.path} to be missed by {largest} of the stroke at most and {rms_} RMS, {self.apart}."
        if self.largest > self.stroke:
            text = f"The model is not usable for {self.path}, which may be missed by more than the stroke."
        return text, *(condition.sentence for condition in self.untested)

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values without the bound along the path."""
        keys = "path rms_m=rms largest_m=largest offset_m=offset stroke_m=stroke delay_s=delay apart sentence untested"
        percents = {"largest_percent": 100 * self.largest / self.stroke, "rms_percent": 100 * self.rms / self.stroke}
        return {**json_values(self, keys), **percents, "parts": {f"{k}_m": error for k, error in self.parts.items()}}


def promise(
    validity: Validity,
    voltage: ArrayLike | None = None,
    time: ArrayLike | None = None,
    *,
    thermal: Thermal | None = None,
    creep: DisplacementCreep | None = None,
    temperature: ArrayLike | None = None,
    waits: float = 0.0,
    begins: str = "",
    opened: ArrayLike = (),
    missed: ArrayLike = (),
) -> Promise:
    """Return the promised error of a path when its voltage is played; every promised number comes from here.

    `validity` is that of the model that computed the voltage; `thermal` and `creep` are parts of it. `voltage`, `time`
    and `temperature` are as in `Actuator.promise`. `waits`: time [s] for which the voltage is held before the path, or
    before the homing that leads to it. `begins`: start of the path: "homed", "unknown", the name of a known start, or
    nothing. `opened` (n,): possible distance from the expected displacement [m] due to an unknown start, apart from a
    constant. `missed` (n,): error that the model computes [m] where the voltage was clamped.
    """
    v, clock = (None if given is None else np.asarray(given, dtype=np.float64) for given in (voltage, time))
    v = _anywhere(validity) if v is None else v
    at, beyond, whole = newness(validity, v)
    shown, late = _shown(validity, v, clock, at)
    grown = shown * float(_grown(whole))
    rms_, largest = (min(factor * grown, validity.stroke) for factor in (RMS, LARGEST))
    # A path like the records may be as fast as their fastest part, which the model misses most.
    largest = max(largest, validity.largest) if voltage is None else largest
    each = LARGEST * shown * _grown(beyond) if len(at) else np.array([largest])
    half = np.repeat(each, np.diff([0, *at[1:, 0], v.size]))
    warmth, sentence = temperature_cost(thermal, validity.temperatures, validity.stroke, temperature)
    warm = float(warmth.max(initial=0.0))
    slow = _crept(validity, creep, v, clock)
    # Half of a range bounds the standard deviation of values in it.
    rms_, half = rms_ + 0.5 * (warm + slow), half + warmth + slow
    parts = {"model": largest} | {k: e for k, e in {"temperature": warm, "creep": slow}.items() if e}
    if late:
        parts["lag"], rms_, half = late, float(np.hypot(rms_, _LATE_RMS * late)), half + late
    # Nothing is known beyond the voltages of the records: the whole displacement there counts as error.
    over = np.maximum(v - validity.limits[1], validity.limits[0] - v) / validity.span
    errors = {"start": np.asarray(opened), "missed": np.abs(missed), "voltages": validity.stroke * over * (over > BAND)}
    for name, error in errors.items():
        if np.any(error):
            rms_, half, parts[name] = float(np.hypot(rms_, rms(error))), half + error, float(error.max())
    largest = sum(parts.values())
    untested = [*(not_recorded(validity) if voltage is None else untested_by(validity, v, clock, at, waits))]
    untested += [Untested("temperature", sentence)] if sentence else []
    start = f"this path{_BEGINS.get(begins, f' from the start {begins}')}"
    start = "the whole record" if begins == "fitted" else start
    words = "any path like the records" if voltage is None else start
    offset, delay = _OFFSET * parts["model"] + slow, validity.lag if validity.lag_open else 0.0
    return Promise(words, rms_, largest, parts, half, validity.stroke, offset, delay, tuple(untested))


def untested(actuator: Actuator, found: Promise | None, temperature: ArrayLike | None = None) -> tuple[str, ...]:
    """Return sentences: whether an `actuator` is usable for a path, and what its records do not test.

    Without a promise, only a sentence about the `temperature` is returned.
    """
    if found is not None:
        return *filter(None, [found.unusable]), *(condition.sentence for condition in found.untested)
    _, sentence = temperature_cost(actuator.thermal, None, stroke_of(actuator), temperature)
    return (sentence,) if sentence else ()


def _shown(validity: Validity, voltage: Array, time: Array | None, at: NDArray[np.intp]) -> tuple[float, float]:
    """Return the length [m] to which the bounds of a path are proportional, and the largest error [m] from a lag."""
    speed, rate = _paces(validity, voltage, time, at)
    shown = validity.shown * _kind(validity, voltage, time, at) * (_LAGGING if validity.lag_open else 1.0)
    shown *= max(speed, rate / _OFTENER, 1.0) ** _FASTER
    late = 0.0 if time is None else _late(validity, speed, voltage, time)
    return float(np.hypot(shown, _GROWTH * max(speed, rate) * validity.growth)), late


def _anywhere(validity: Validity) -> Array:
    """Return voltages with random turning points within the range of the records."""
    return np.append(validity.limits, np.random.default_rng(1).uniform(*validity.limits, _TURNS))


def newness(validity: Validity, voltage: Array) -> tuple[NDArray[np.intp], Array, float]:
    """Return the branches (k, 2) of a voltage (n,) [V], and the newness of each branch (k,) and of all.

    Newness is the distance from the branches of the records, minus the distance of the held-out branches, as a part of
    the range. The newness of all branches comes from two RMS distances, of rises and of falls; the larger one counts.
    """
    at = branches_of(voltage, validity.span) if voltage.size > 1 else np.zeros((0, 2), dtype=np.intp)
    path = voltage[at]
    apart, rising = distances(path / validity.span, validity.branches / validity.span), path[:, 1] > path[:, 0]
    ways = (rising, validity.new[0]), (~rising, validity.new[1])
    means = [float(np.sqrt(np.mean(apart[way] ** 2))) - held_out for way, held_out in ways if way.any()]
    return at, apart - np.where(rising, *validity.new), max(0.0, *means, 0.0)


def _closing(branches: Array, span: float) -> float:
    """Return the share of branches (k, 2) [V] that another branch retraces from their end to their beginning."""
    (begin, end), band = branches.T, BAND * span
    back = np.sign(end - begin)[:, None] * (end - begin[:, None]) <= band
    return float(np.mean((back & (np.abs(begin - end[:, None]) <= band)).any(axis=1))) if len(branches) else 0.0


def _grown(new: Array | float) -> Array:
    """Return the factor of the bound for branches with a newness (k,), which is a part of the range."""
    return np.asarray(np.exp(_GROWS * np.clip(new, 0.0, _NEWEST)))


def _kind(validity: Validity, voltage: Array, time: Array | None, at: NDArray[np.intp]) -> float:
    """Return the factor for the kind of a path: whether its branches (k, 2) close loops, their heights, its holds."""
    if not len(at):
        return 1.0
    opens = _closing(validity.branches, validity.span) < _CLOSING <= _closing(voltage[at], validity.span)
    range_, height = float(np.ptp(voltage)), float(np.abs(np.diff(voltage[at], axis=1)).mean())
    factor = (_OPEN if opens else 1.0) * (range_ / height) ** _PLACES * min(range_ / validity.span, 1.0) ** _RANGE
    if time is None or time.size < 2:
        return float(factor)
    seconds, speed = np.diff(time), np.abs(np.diff(voltage) / np.diff(time))
    resting = float(seconds[speed < _RESTS * speed.max()].sum() / seconds.sum())
    longer = hold_of(time, voltage, validity.span) / validity.hold if validity.hold else 1.0
    return float(factor * np.clip(longer, 1.0, _LONGEST) ** _HOLD * np.exp(_RESTING * resting))


def _late(validity: Validity, speed: float, voltage: Array, time: Array) -> float:
    """Return the largest error [m] of a path from a wrong lag and from a wrong form of the lag.

    If the source of the lag is open, a wrong lag adds nothing. The form may be a delay or a low-pass with the same lag:
    their difference counts if it is larger than at a turn of the records.
    """
    lag, per_volt = validity.lag, validity.stroke / validity.span
    fastest = validity.speeds[1] * per_volt
    wrong = 0.0 if validity.lag_open else _PEAK * validity.lag_error * fastest * max(speed - 1.0, 0.0)
    passed = np.zeros(voltage.size)
    for age in _MEMORY if lag else ():
        passed += np.interp(time - lag * age, time, voltage) / _MEMORY.size
    apart = float(np.abs(np.interp(time - lag, time, voltage) - passed).max()) * per_volt if lag else 0.0
    return float(min(np.hypot(wrong, apart * (apart > ALIKE * _AT_A_TURN * fastest * lag)), validity.stroke))


def _crept(validity: Validity, creep: DisplacementCreep | None, voltage: Array, time: Array | None) -> float:
    """Return the largest error [m] from creep that is too slow for the records, or for their branches, to show."""
    lasts, slowest = validity.lasts if time is None else float(np.ptp(time)), validity.rates[0]
    rate, known = (creep.per_decade, validity.lasts) if creep else (validity.creep_open, slowest and 1 / slowest)
    decades = float(np.log10(max(lasts / known, 1.0))) if known else 0.0
    return _SLOWER * rate * decades * min(float(np.ptp(voltage)) / validity.span, 1.0) * validity.stroke


def _paces(validity: Validity, voltage: Array, time: Array | None, at: NDArray[np.intp]) -> list[float]:
    """Return the ratios of highest speed and rate of branches (k, 2) to those of the records; 1 without `time`."""
    highest = validity.speeds[1], validity.rates[1]
    if time is None or time.size < 2 or not len(at) or not all(highest):
        return [1.0, 1.0]
    return [float(most) for most in (paces_of(time, voltage, at) / highest).max(axis=0)]
