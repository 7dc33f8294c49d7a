"""The promise: a bound of the error on a path, from what the records of an identification tested.

A promise is a bound that nine of ten paths should keep (theory sections 18 and 29), for the error less its mean, as no
record determines where the zero of the sensor will be later, and less a constant delay where the records leave open who
lags. It is proportional to one length that the records show, a geometric mean of the error on held-out parts and of the
distance of other models that explain the records. It grows with the distance of the path's branches from those of the
records, with its speed beyond theirs, and depends on the kind of the path. Its numbers were found on virtual actuators
whose mechanisms are not instances of the model, and are tested on others: `benchmarks/promise.py`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import keep, number
from dehyst._views.fields import json_values
from dehyst.model.dynamics import Thermal
from dehyst.model.states import stroke_of
from dehyst.model.temperatures import TemperatureCost
from dehyst.records import Record, rms, turning_points
from dehyst.waveforms import FASTER, STEEPEST

if TYPE_CHECKING:
    from dehyst.model.actuator import Actuator

# A voltage turns where it goes back by this part of the range; legs that differ by less than a quarter are one.
_BAND = 0.02
# Cells of the plane of turning points on each side, and how many around a passed one are tested: 5 % of the range.
CELLS, _AROUND = 40, 2
# The start of a path in words; a known start of another name has its name.
_BEGINS = {
    "": "",
    "homed": " from a homed start",
    "unknown": " from an unknown start",
    "top": " from the top, after a rise,",
    "bottom": " from the bottom, after a fall,",
    "fitted": " from its fitted start",
}
# Legs that are kept of the records.
_MOST = 600
# Records whose promise any path like them is so new for, as a part of the range, do not turn at random.
_NEW = 0.02
# Speeds and holds count as tested up to this ratio, and voltages within this part of the range.
_ALIKE, _BEYOND = 1.5, 0.02
# A voltage rests where it moves at less than this part of the mean speed of its leg.
_AT_REST = 0.1
# Turning points of a path of which nothing is known but its range.
_TURNS = 60


# The bound of the largest error, and that of the RMS error: what the records show, times these.
LARGEST, RMS = 5.5, 2.2
# Factors of the promised errors where the path closes loops and fewer legs of the records than this part do; and
# where the records leave open who lags.
_CLOSING, _OPEN, _LAGGING = 0.2, 1.8, 1.6
# The largest constant offset of a path, of its largest error, if the sensor is zeroed at its first sample.
_OFFSET = 0.4
# Neither error that they show counts as smaller than this part of the stroke; and models that miss held-out parts do
# not agree to less than this part of the held-out error.
_LEAST, _AGREES = 1e-4, 0.3
# The bound grows by this power of e with the newness of a path, a part of the range, up to a largest one.
_GROWS, _NEWEST = 2.6, 0.3
# A model with a larger error is not usable [% of the stroke].
USELESS = 5.0
# The bound grows by this power of the ratio of the path's fastest branch to that of the records, if it is faster; and
# by the other one where the records leave open who lags.
_FASTER, _LAGS_FASTER = 0.4, 1.2
# Powers of: the range of a path by the mean height of its branches; its range by that of the records; its longest
# hold by that of the records, up to a largest ratio; and e, by the part of its time in which it rests.
_PLACES, _RANGE, _HOLD, _LONGEST, _RESTING = 0.35, 0.7, 0.07, 20.0, 0.35
# A path rests where its voltage moves at less than this part of its largest speed.
_RESTS = 0.02
# Entries of a validity in a file, and their names.
_ENTRIES = (
    "rms_m=rms largest_m=largest disagreement_m=disagreement stroke_m=stroke limits_V=limits new speeds_V_per_s=speeds "
    "hold_s=hold lag_s=lag temperatures_degC=temperatures legs_V=legs"
)


def legs(voltage: Array, span: float) -> NDArray[np.intp]:
    """Return the first and last samples (k, 2) of each rise and fall of a voltage (n,) [V]; `span`: the range [V].

    A first one that begins between the ends of the voltage does not count, as the voltage before is not known.
    """
    at = np.array([0, *turning_points(voltage, _BAND * span), len(voltage) - 1], dtype=np.intp)
    pairs = np.column_stack([at[:-1], at[1:]])
    pairs = pairs[np.abs(np.diff(voltage[pairs], axis=1)[:, 0]) > 0.5 * _BAND * span]
    within = min(float(np.ptp(voltage)), 2 * _BAND * span) / 4
    inside = voltage.min() + within < voltage[0] < voltage.max() - within
    return pairs[1:] if len(pairs) and pairs[0, 0] == 0 and inside else pairs


def tested_loops(legs_: Array, edges: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the cells (n, n) of a plane that test a rise, and those that test a fall, from legs (k, 2) [V].

    `edges` (n + 1,) [V]: of the cells. A row belongs to an upper voltage, a column to a lower one. A leg tests the
    cells within two of where it begins, from there to two beyond where it ends.
    """
    n, found = len(edges) - 1, []
    for sign in (1.0, -1.0):
        wide = np.zeros((n + 2 * _AROUND,) * 2, dtype=bool)
        some = legs_[sign * (legs_[:, 1] - legs_[:, 0]) > 0]
        for begin, end in np.unique(_cells(some, edges), axis=0).tolist():
            beside = slice(begin, begin + 2 * _AROUND + 1)
            passed = slice(min(begin, end), max(begin, end) + 2 * _AROUND + 1)
            wide[(passed, beside) if sign > 0 else (beside, passed)] = True
        # Below the diagonal there is nothing.
        found.append(wide[_AROUND:-_AROUND, _AROUND:-_AROUND] & np.tri(n, dtype=bool))
    return found[0], found[1]


def are_tested(path: Array, rising: NDArray[np.bool_], falling: NDArray[np.bool_], edges: Array) -> NDArray[np.bool_]:
    """Return for each leg (k, 2) [V] whether its cell is tested; the others are as in `tested_loops`."""
    lower, upper = _cells(np.sort(path, axis=1), edges).T
    return np.asarray(np.where(path[:, 1] > path[:, 0], rising[upper, lower], falling[upper, lower]))


def _cells(legs_: Array, edges: Array) -> NDArray[np.intp]:
    """Return the cells of the ends of legs (k, 2)."""
    return np.clip(np.searchsorted(edges, legs_, side="right") - 1, 0, len(edges) - 2)


def distances(path: Array, others: Array) -> Array:
    """Return the distance (k,) of each leg (k, 2) from the nearest of the `others` (m, 2) in the same direction.

    The distance combines, by root of squares, the distance of the first turning points and the overrun beyond the other
    leg's end. It is at most the leg's own height.
    """
    found = np.abs(path[:, 1] - path[:, 0])
    for sign in (1.0, -1.0):
        known = others[sign * (others[:, 1] - others[:, 0]) > 0]
        mine = np.flatnonzero(sign * (path[:, 1] - path[:, 0]) > 0)
        if not known.size:
            continue
        for part in np.array_split(mine, 1 + mine.size // 2000):
            beyond = np.maximum(sign * (path[part, 1][:, None] - known[:, 1]), 0.0)
            apart = np.hypot(path[part, 0][:, None] - known[:, 0], beyond).min(axis=1)
            found[part] = np.minimum(found[part], apart)
    return np.asarray(found)


@dataclass(frozen=True, eq=False)
class Validity:
    """The domain of validity of a model: what its records tested, and its error on held-out parts.

    Attributes
    ----------
    rms : float
        RMS error of held-out parts [m], without sensor noise.
    largest : float
        Largest error of the records themselves after their second turning point [m], without sensor noise.
    disagreement : float
        RMS distance of other structures that explain the records about as well [m].
    stroke : float
        Range of the widest loop [m].
    limits : (float, float)
        Lowest and highest voltage of the records [V].
    legs : (k, 2) array
        Voltages between which the records went [V].
    new : (float, float)
        RMS distance of held-out rises, and of held-out falls, from all others, as a part of the voltage range.
    speeds : (float, float)
        Lowest and highest mean speed of a leg [V/s].
    hold : float
        Longest time at one voltage [s].
    lag : float
        Time [s] by which the displacement lags the voltage, if the records leave open whether the sensor lags; else 0.
    temperatures : (float, float) or None
        Lowest and highest temperature of the records [degC]; None if one of them has none.
    """

    rms: float
    largest: float
    disagreement: float
    stroke: float
    limits: tuple[float, float]
    legs: Array = field(default_factory=lambda: np.zeros((0, 2)))
    new: tuple[float, float] = (0.0, 0.0)
    speeds: tuple[float, float] = (0.0, 0.0)
    hold: float = 0.0
    lag: float = 0.0
    temperatures: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        kept = np.array(self.legs, dtype=np.float64).reshape(-1, 2)
        names = "rms", "largest", "disagreement", "stroke", "hold", "lag"
        numbers = {name: number(getattr(self, name), name) for name in names}
        pairs = {name: tuple(number(one, name) for one in getattr(self, name)) for name in ("limits", "new", "speeds")}
        warmth = None if self.temperatures is None else tuple(number(one, "temperatures") for one in self.temperatures)
        wrong = [name for name, value in numbers.items() if not 0 <= value < np.inf]
        if warmth is not None and (len(warmth) != 2 or not -np.inf < warmth[0] <= warmth[1] < np.inf):
            raise ModelError(f"validity: temperatures: got {warmth}, need the lower one first")
        if wrong or not np.isfinite(kept).all() or not self.stroke or any(len(pair) != 2 for pair in pairs.values()):
            raise ModelError(f"validity: {', '.join(wrong) or 'legs or pairs'}: need finite numbers of 0 or more")
        if not pairs["limits"][0] < pairs["limits"][1]:
            raise ModelError(f"validity: limits: got {pairs['limits']}, need the lower one first")
        kept.setflags(write=False)
        keep(self, legs=kept, temperatures=warmth, **numbers, **pairs)

    @classmethod
    def by_records(cls, records: Iterable[tuple[Array, Array]], **numbers: Any) -> Validity:
        """Return the validity from time (n,) [s] and voltage (n,) [V] of `records`; `numbers`: the errors by name."""
        given = list(records)
        ends = [float(end) for _, voltage in given for end in (voltage.min(), voltage.max())]
        limits = min(ends), max(ends)
        span, pairs, speeds, hold = limits[1] - limits[0], [], [], 0.0
        for time, voltage in given:
            at = legs(voltage, span)
            pairs.append(voltage[at])
            speeds.append(speeds_of(time, voltage, at))
            hold = max(hold, longest_hold(time, voltage, span))
        speed = np.concatenate(speeds)
        kept = np.unique(np.round(np.concatenate(pairs) / (0.25 * _BAND * span)), axis=0) * (0.25 * _BAND * span)
        kept = kept[:: 1 + len(kept) // _MOST]
        fastest = (float(speed.min()), float(speed.max())) if speed.size else (0.0, 0.0)
        return cls(limits=limits, legs=kept, speeds=fastest, hold=hold, **numbers)

    def with_record(self, record: Record, *, rms: float, largest: float) -> Validity:
        """Return the validity after an update by one more `record`; its errors replace smaller ones.

        `rms`, `largest`: errors [m] of the updated model.
        """
        warmth, played = self.temperatures, [(record.time, record.voltage)]
        if warmth is not None and record.temperature is not None:
            warmth = min(warmth[0], float(record.temperature.min())), max(warmth[1], float(record.temperature.max()))
        by_it = Validity.by_records(played, rms=rms, largest=largest, disagreement=0.0, stroke=self.stroke)
        return replace(
            self,
            rms=max(self.rms, rms),
            largest=max(self.largest, largest),
            disagreement=max(self.disagreement, rms),
            limits=(min(*self.limits, *by_it.limits), max(*self.limits, *by_it.limits)),
            legs=np.concatenate([self.legs, by_it.legs]),
            speeds=(min(*self.speeds, *by_it.speeds), max(*self.speeds, *by_it.speeds)),
            hold=max(self.hold, by_it.hold),
            temperatures=warmth,
        )

    @property
    def span(self) -> float:
        """Range of the voltages [V]."""
        return self.limits[1] - self.limits[0]

    @property
    def shown(self) -> float:
        """The error [m] that the records show, from the held-out error and twice as much from the disagreement."""
        both = self.rms, max(self.disagreement, _AGREES * self.rms)
        held_out, apart = (float(np.hypot(one, _LEAST * self.stroke)) for one in both)
        return float((held_out * apart**2) ** (1 / 3))

    @property
    def turns_anywhere(self) -> bool:
        """Whether held-out legs differ from the others as those of any path do, as with random turning points."""
        return newness(self, _anywhere(self))[2] <= _NEW

    @cached_property
    def anywhere(self) -> Promise:
        """The promise for any path like the records."""
        return promise(self)

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return json_values(self, _ENTRIES)

    @classmethod
    def from_dict(cls, data: object) -> Validity:
        """Rebuild from the `data` of `as_dict`; raise `ModelError` if a value is impossible."""
        names = {key: name or key for key, _, name in (entry.partition("=") for entry in _ENTRIES.split())}
        if not isinstance(data, Mapping) or set(data) != set(names):
            raise ModelError(f"validity: need the entries {', '.join(sorted(names))}")
        try:
            return cls(**{names[key]: value for key, value in data.items()})
        except (TypeError, ValueError) as error:
            raise ModelError(f"validity: {error}") from error


@dataclass(frozen=True)
class Untested:
    """A property of a path that the records do not test.

    `what`: "voltages", "turns", "speed", "hold" or "temperature". `sentence`: in words. `command`: the `dehyst excite`
    command that tests it; empty for a temperature, at which the excitation of the records does.
    """

    what: str
    sentence: str
    command: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return json_values(self, "what sentence command")


@dataclass(frozen=True, eq=False)
class Promise:
    """Error of a path, as a bound that nine of ten paths should keep.

    Attributes
    ----------
    path : str
        The path, in words: any path like the records, or this path from its start.
    rms, largest : float
        RMS and largest error of the path without its mean error [m].
    parts : mapping of str to float
        What `largest` is the sum of [m]: "model"; and, where they add something, "temperature", "start" and "clamped".
    half : (n,) array
        The bound along the path [m]: wider on branches that are unlike those of the records.
    stroke : float
        Reference of percentages [m].
    offset : float
        Largest mean error [m] if the sensor is zeroed at the first sample; `rms` and `largest` leave it out.
    delay : float
        Time [s] by which the path may be late, as the records leave open whether the sensor lags; else 0. The errors
        leave it out.
    untested : tuple of Untested
        What the records do not test; for such a part the promise does not hold.
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
        largest, rms_ = (100 * error / self.stroke for error in (self.largest, self.rms))
        return f"<Promise of {self.path}: {largest:.2g} % at most, {rms_:.2g} % RMS of {self.stroke * 1e6:.4g} um>"

    @property
    def apart(self) -> str:
        """What the errors leave out, in words."""
        late = f" and a delay of up to {1e3 * self.delay:.3g} ms: the records leave open who lags" if self.delay else ""
        return f"apart from a constant offset{late}"

    @property
    def useless(self) -> bool:
        """Whether the model's part of the largest error exceeds 5 % of the stroke."""
        return self.parts["model"] > 0.01 * USELESS * self.stroke

    @property
    def sentence(self) -> str:
        """The promise in words, errors in percent of the stroke."""
        rms_, largest = (100 * error / self.stroke for error in (self.rms, self.largest))
        missed = f"{largest:.2g} % of the stroke at most and {rms_:.2g} % RMS"
        return f"Expect {self.path} to be missed by {missed}, {self.apart}."

    @property
    def lines(self) -> tuple[str, ...]:
        """The promise, and what is not tested, a sentence each."""
        return self.sentence, *(one.sentence for one in self.untested)

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values without the bound along the path."""
        keys = "path rms_m=rms largest_m=largest offset_m=offset stroke_m=stroke delay_s=delay apart sentence untested"
        percents = {"largest_percent": 100 * self.largest / self.stroke, "rms_percent": 100 * self.rms / self.stroke}
        parts = {f"{name}_m": error for name, error in self.parts.items()}
        return {**json_values(self, keys), **percents, "parts": parts}


def promise(
    validity: Validity,
    voltage: ArrayLike | None = None,
    time: ArrayLike | None = None,
    *,
    thermal: Thermal | None = None,
    temperature: ArrayLike | None = None,
    waits: float = 0.0,
    begins: str = "",
    opened: ArrayLike = (),
    missed: ArrayLike = (),
) -> Promise:
    """Return the promised error of a path when its voltage is played: the one source of such a number.

    Parameters
    ----------
    validity : Validity
        Validity of the model that computed the voltage.
    voltage : (n,) array_like, optional
        Voltage that follows the path [V]; default: any path like the records, which turns anywhere within their
        voltages, at their speeds.
    time : (n,) array_like, optional
        Time of the voltage [s]; without it, speeds and holds are assumed to be as in the records.
    thermal : Thermal, optional
        Part of the model.
    temperature : float or (n,) array_like, optional
        Temperature of the path [degC]; default: not known.
    waits : float
        Time [s] for which the voltage is held before the path, or before the homing that leads to it.
    begins : str
        Start of the path: "homed", "unknown", the name of a known start, or nothing.
    opened : (n,) array_like
        Distance from the expected displacement [m], apart from a constant, that an unknown start leaves open.
    missed : (n,) array_like
        Error of the model itself [m], where the voltage was clamped.
    """
    v = np.asarray(_anywhere(validity) if voltage is None else voltage, dtype=np.float64)
    clock = None if time is None else np.asarray(time, dtype=np.float64)
    at, beyond, whole = newness(validity, v)
    shown = validity.shown * _kind(validity, v, clock, at) * (_LAGGING if validity.lag else 1.0)
    rms_, largest = (factor * shown * float(_grown(np.array([whole]))[0]) for factor in (RMS, LARGEST))
    # Any path like the records is as fast as their fastest part, where they may be missed by more.
    largest = max(largest, validity.largest) if voltage is None else largest
    each = LARGEST * shown * _grown(beyond) if len(at) else np.array([largest])
    half = np.repeat(each, np.diff([0, *at[1:, 0], v.size]))
    cost = TemperatureCost(thermal, validity.temperatures, validity.stroke, temperature)
    # Half of a range bounds the standard deviation in it.
    added = {
        "temperature": (0.5 * cost.largest, cost.largest, cost.along),
        "start": _size(np.asarray(opened, dtype=np.float64)),
        "clamped": _size(np.abs(np.asarray(missed, dtype=np.float64))),
    }
    parts = {"model": largest}
    for name, (spread, most, along) in added.items():
        if most:
            rms_ = rms_ + spread if name == "temperature" else float(np.hypot(rms_, spread))
            parts[name], largest, half = most, largest + most, half + along
    untested = [*(_not_recorded(validity) if voltage is None else _untested(validity, v, clock, at, waits))]
    if cost.sentence:
        untested.append(Untested("temperature", cost.sentence))
    words = f"this path{_BEGINS.get(begins, f' from the start {begins}')}"
    words = "any path like the records" if voltage is None else words
    offset = _OFFSET * parts["model"]
    return Promise(words, rms_, largest, parts, half, validity.stroke, offset, validity.lag, tuple(untested))


def promised(
    actuator: Actuator, voltage: ArrayLike | None = None, time: ArrayLike | None = None, **options: Any
) -> Promise | None:
    """Return the promised error of a path of an `actuator`; None if it does not hold what its records tested.

    `options`: those of `promise`, but for the part of the model.
    """
    known = actuator.identification
    if known is None or known.validity is None:
        return None
    return promise(known.validity, voltage, time, thermal=actuator.thermal, **options)


def untested(actuator: Actuator, found: Promise | None, temperature: ArrayLike | None = None) -> tuple[str, ...]:
    """Return sentences on what the records of an `actuator` do not test of a path, and whether it is usable for it.

    Without a promise they are those on its `temperature`.
    """
    if found is not None:
        useless = unusable(actuator, found)
        return *([useless] if useless else []), *(one.sentence for one in found.untested)
    sentence = TemperatureCost(actuator.thermal, None, stroke_of(actuator), temperature).sentence
    return (sentence,) if sentence else ()


def unusable(actuator: Actuator, found: Promise | None) -> str:
    """Return a sentence if an `actuator` is not usable for a path with a promise, or for any path; else nothing."""
    useless = next((one for one in (found, promised(actuator)) if one is not None and one.useless), None)
    if useless is None:
        return ""
    share = 100 * useless.parts["model"] / useless.stroke
    return (
        f"The model is not usable: it may miss {useless.path} by {share:.2g} % of the stroke, more than {USELESS:g} %. "
        "Record the recommended excitation, and identify again."
    )


def _anywhere(validity: Validity) -> Array:
    """Return voltages that turn anywhere within those of the records."""
    turns = np.random.default_rng(1).uniform(*validity.limits, _TURNS)
    return np.concatenate([[validity.limits[0], validity.limits[1]], turns])


def _size(error: Array) -> tuple[float, float, Array]:
    """Return RMS, largest, and the error along a path; nothing of no samples."""
    return (rms(error), float(error.max()), error) if error.size else (0.0, 0.0, np.zeros(1))


def newness(validity: Validity, voltage: Array) -> tuple[NDArray[np.intp], Array, float]:
    """Return the legs (k, 2) of a voltage (n,) [V], and the newness of each leg (k,) and of all.

    Newness is the distance from the records' legs minus the distance of the held-out legs, as a part of the range. The
    newness of all legs is the larger of two root mean squares, of rises and of falls.
    """
    at = legs(voltage, validity.span) if voltage.size > 1 else np.zeros((0, 2), dtype=np.intp)
    path = voltage[at]
    apart, rising = distances(path / validity.span, validity.legs / validity.span), path[:, 1] > path[:, 0]
    ways = (rising, validity.new[0]), (~rising, validity.new[1])
    means = [float(np.sqrt(np.mean(apart[way] ** 2))) - held_out for way, held_out in ways if way.any()]
    return at, apart - np.where(rising, *validity.new), max(0.0, *means, 0.0)


def longest_hold(time: Array, voltage: Array, span: float) -> float:
    """Return the longest time [s] that a voltage stays within a fiftieth of the `span`, which includes slow motion."""
    place = np.round(voltage / (_BAND * span))
    begins = np.append(0, np.flatnonzero(np.diff(place)) + 1)
    return float(np.max(time[np.append(begins[1:] - 1, len(time) - 1)] - time[begins], initial=0.0))


def speeds_of(time: Array, voltage: Array, at: NDArray[np.intp]) -> Array:
    """Return the mean speed [V/s] of each of the `legs` (k, 2), without the time at rest."""
    if not len(at):
        return np.zeros(0)
    step, height = np.diff(time), np.abs(np.diff(voltage[at], axis=1)[:, 0])
    mean = height / np.maximum(np.diff(time[at], axis=1)[:, 0], 1e-300)
    own = np.clip(np.searchsorted(at[:, 0], np.arange(step.size), side="right") - 1, 0, len(at) - 1)
    moving = np.abs(np.diff(voltage)) > _AT_REST * mean[own] * step
    moved = np.append(0.0, np.cumsum(step * moving))
    return np.asarray(height / np.maximum(moved[at[:, 1]] - moved[at[:, 0]], 1e-300))


def _closing(legs_: Array, span: float) -> float:
    """Return the share of legs (k, 2) [V] that one from their end retraces to their beginning, or beyond."""
    (begin, end), band = legs_.T, _BAND * span
    back = np.sign(end - begin)[:, None] * (end - begin[:, None]) <= band
    return float(np.mean((back & (np.abs(begin - end[:, None]) <= band)).any(axis=1))) if len(legs_) else 0.0


def _grown(new: Array) -> Array:
    """Return how many times the bound is larger of legs with a newness (k,), a part of the range."""
    return np.asarray(np.exp(_GROWS * np.clip(new, 0.0, _NEWEST)))


def _kind(validity: Validity, voltage: Array, time: Array | None, at: NDArray[np.intp]) -> float:
    """Return the factor of the kind of a path: at how many places its branches (k, 2) are, its speed and its holds."""
    if not len(at):
        return 1.0
    opens = _closing(validity.legs, validity.span) < _CLOSING <= _closing(voltage[at], validity.span)
    range_, height = float(np.ptp(voltage)), float(np.abs(np.diff(voltage[at], axis=1)).mean())
    factor = (_OPEN if opens else 1.0) * (range_ / height) ** _PLACES * min(range_ / validity.span, 1.0) ** _RANGE
    if time is None or time.size < 2:
        return float(factor)
    seconds, speed = np.diff(time), np.abs(np.diff(voltage) / np.diff(time))
    resting = float(seconds[speed < _RESTS * speed.max()].sum() / seconds.sum())
    longer = longest_hold(time, voltage, validity.span) / validity.hold if validity.hold else 1.0
    if validity.speeds[1]:
        factor *= max(float(speeds_of(time, voltage, at).max()) / validity.speeds[1], 1.0) ** (
            _LAGS_FASTER if validity.lag else _FASTER
        )
    return float(factor * np.clip(longer, 1.0, _LONGEST) ** _HOLD * np.exp(_RESTING * resting))


def excite_command(highest: float, lowest: float, option: str = "", kind: str = "recommended") -> str:
    """Return the command that writes an excitation between two voltages [V], by default the one that tests any path."""
    top, base = (float(f"{one:.3g}") for one in (highest, lowest if abs(lowest) > 1e-3 * highest else 0.0))
    return f"dehyst excite {kind} {top:g} --base {base:g} {option}-o excitation.csv"


def _untested(
    validity: Validity, voltage: Array, time: Array | None, at: NDArray[np.intp], waits: float
) -> Iterator[Untested]:
    """Yield what the records do not test of a path."""
    low, high = validity.limits
    over = max(low - float(voltage.min()), float(voltage.max()) - high)
    if over > _BEYOND * validity.span:
        words = f"The path goes {over:.3g} V beyond the voltages of the records."
        ends = max(high, float(voltage.max())), min(low, float(voltage.min()))
        yield Untested("voltages", words, excite_command(*ends))
    path = voltage[at]
    edges = np.linspace(low, high, CELLS + 1)
    outside = int(np.count_nonzero(~are_tested(path, *tested_loops(validity.legs, edges), edges)))
    # Random turns are a test of those between them.
    if outside and not validity.turns_anywhere:
        yield Untested(
            "turns", f"{outside} of {len(path)} branches begin where no record turned.", excite_command(high, low)
        )
    if time is None or time.size < 2:
        return
    speed = speeds_of(time, voltage, at)
    slowest, fastest = validity.speeds
    new = {"fastest": (speed.max(initial=0.0), fastest), "slowest": (speed.min(initial=np.inf), slowest)}
    for which, (found, known) in new.items():
        if fastest and (found > _ALIKE * known if which == "fastest" else found * _ALIKE < known):
            words = f"Its {which} branch takes {found:.3g} V/s on average, the {which} of the records {known:.3g} V/s."
            # The fastest turns of the recommended excitation are to be as fast as the path, and not faster.
            faster = FASTER if which == "fastest" else 1.0
            option = f"--frequency {0.5 * found / faster / validity.span:.2g} --slew-rate {STEEPEST * found:.3g} "
            yield Untested("speed", words, excite_command(high, low, option))
    hold = max(waits, longest_hold(time, voltage, validity.span))
    if hold > _ALIKE * validity.hold:
        words = f"The path holds for up to {hold:.3g} s; the records hold for {validity.hold:.3g} s at most."
        yield Untested("hold", words, excite_command(high, low, f"--hold {hold:.2g} ", "staircase"))


def _not_recorded(validity: Validity) -> Iterator[Untested]:
    """Yield what paths often have and the records do not."""
    low, high = validity.limits
    if not validity.turns_anywhere:
        words = "The records do not turn at random: branches that begin elsewhere are tested little."
        yield Untested("turns", words, excite_command(high, low))
    leg = validity.span / validity.speeds[1] if validity.speeds[1] else 0.0
    if leg and validity.hold < leg:
        words = f"The records hold for {validity.hold:.3g} s at most: creep at rest is tested little."
        yield Untested("hold", words, excite_command(high, low, f"--hold {max(10.0, 2 * leg):.2g} ", "staircase"))
