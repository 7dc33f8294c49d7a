"""The promise: a bound of the error on a path, from what the records of an identification tested.

A promise is a bound that nine of ten paths should keep (theory section 18), for the error less its mean: no record
determines where the zero of the sensor will be later. It grows with three errors: the error on held-out parts of the
records, the disagreement of models that explain the records about as well, and the distance of the path's turning
points from those of the records. Its factors were tuned on virtual actuators whose mechanisms are not instances of the
model, and are tested on other mechanisms: `benchmarks/promise.py`.
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
from dehyst.model.temperatures import TemperatureCost
from dehyst.records import Record, turning_points

if TYPE_CHECKING:
    from dehyst.model.actuator import Actuator

# What the promised errors leave out, in words.
APART = "apart from a constant offset"
# A voltage turns where it goes back by this part of the range; legs that differ by less than a quarter are one.
_BAND = 0.02
# Legs that are kept of the records.
_MOST = 600
# Held-out legs that are on average so far from all others, as a part of the range, test any path.
_TELLING = 0.06
# Beyond the held-out legs by this part of the range, a path is as new as it can be.
_NEW = 0.15
# Speeds and holds count as tested up to this ratio, and voltages within this part of the range.
_ALIKE, _BEYOND = 1.5, 0.02
# A lag is known to this factor, and a curved loop moves faster in places than its voltage does.
_LAG_KNOWN = 1.15
# Records of which fewer legs than this part close the loop that they began, and what errors then are of those promised.
_CLOSING, _OPEN = 0.2, 1.5
# The floor of a promise is at least this part of the one where held-out errors are large.
_LEAST = 0.05
# A voltage rests where it moves at less than this part of the mean speed of its leg.
_AT_REST = 0.1
# Turning points of a path of which nothing is known but its range.
_TURNS = 60


@dataclass(frozen=True)
class Factors:
    """Factors of a promise, which is the root of a sum of squares of measured errors.

    `held_out`, `disagreement`: factors of the numbers of `Validity`. `floor`, `full`: parts of the stroke; the floor
    falls with the square of the held-out error where that is below `full`, to a twentieth at least. A floor without
    `full` does not fall: a small held-out error is no evidence where no record turned.
    """

    held_out: float
    disagreement: float
    floor: float
    full: float = 0.0

    def bound(self, validity: Validity, new: Array) -> Array:
        """Return the bound (k,) [m] of legs whose newness `new` (k,) is 0 to 1."""
        floor = self.floor * validity.stroke
        if self.full:
            floor *= np.clip((validity.rms / (self.full * validity.stroke)) ** 2, _LEAST, 1.0)
        squares = (self.held_out * validity.rms) ** 2 + floor**2
        return np.asarray(np.sqrt(squares + (self.disagreement * validity.disagreement * new) ** 2))


# Of the largest and of the RMS error: where held-out legs test any path, and where they do not.
LARGEST = Factors(4.8, 0.0, 0.0032, 5e-4), Factors(7.5, 7.8, 0.002)
RMS = Factors(1.92, 0.0, 0.0005, 5e-4), Factors(3.0, 2.5, 0.0005)


def legs(voltage: Array, span: float) -> NDArray[np.intp]:
    """Return the first and last samples (k, 2) of each rise and fall of a voltage (n,) [V]; `span`: the range [V]."""
    at = np.array([0, *turning_points(voltage, _BAND * span), len(voltage) - 1], dtype=np.intp)
    pairs = np.column_stack([at[:-1], at[1:]])
    return pairs[np.abs(np.diff(voltage[pairs], axis=1)[:, 0]) > 0.5 * _BAND * span]


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
    closing : float
        Share of legs that reach the beginning of the leg before, and so close a loop; 1 if it is not known.
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
    closing: float = 1.0
    temperatures: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        kept = np.array(self.legs, dtype=np.float64).reshape(-1, 2)
        numbers = {name: number(getattr(self, name), name) for name in ("rms", "largest", "disagreement", "stroke")}
        numbers |= {name: number(getattr(self, name), name) for name in ("hold", "lag", "closing")}
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
        span, pairs, speeds, closed, hold = limits[1] - limits[0], [], [], [], 0.0
        for time, voltage in given:
            at = legs(voltage, span)
            pairs.append(voltage[at])
            speeds.append(speeds_of(time, voltage, at))
            closed.append(_closed(voltage[at], span))
            hold = max(hold, longest_hold(time, voltage, span))
        speed = np.concatenate(speeds)
        kept = np.unique(np.round(np.concatenate(pairs) / (0.25 * _BAND * span)), axis=0) * (0.25 * _BAND * span)
        kept = kept[:: 1 + len(kept) // _MOST]
        fastest = (float(speed.min()), float(speed.max())) if speed.size else (0.0, 0.0)
        closing = float(np.concatenate(closed).mean()) if any(one.size for one in closed) else 1.0
        return cls(limits=limits, legs=kept, speeds=fastest, hold=hold, closing=closing, **numbers)

    def with_record(self, record: Record, *, rms: float, largest: float) -> Validity:
        """Return the validity after an update by one more `record`; its errors replace smaller ones.

        `rms`, `largest`: errors [m] of the updated model.
        """
        time, voltage, temperature = record.time, record.voltage, record.temperature
        warmth = self.temperatures
        if warmth is not None and temperature is not None:
            warmth = min(warmth[0], float(temperature.min())), max(warmth[1], float(temperature.max()))
        by_it = Validity.by_records([(time, voltage)], rms=rms, largest=largest, disagreement=0.0, stroke=self.stroke)
        pairs = self.speeds, by_it.speeds
        return replace(
            self,
            rms=max(self.rms, rms),
            largest=max(self.largest, largest),
            limits=(min(self.limits[0], by_it.limits[0]), max(self.limits[1], by_it.limits[1])),
            legs=np.concatenate([self.legs, by_it.legs]),
            speeds=(min(low for low, _ in pairs), max(high for _, high in pairs)),
            hold=max(self.hold, by_it.hold),
            closing=max(self.closing, by_it.closing),
            temperatures=warmth,
        )

    @property
    def span(self) -> float:
        """Range of the voltages [V]."""
        return self.limits[1] - self.limits[0]

    @property
    def telling(self) -> bool:
        """Whether held-out legs differ enough from the others to test any path, as with random turning points."""
        return min(self.new) >= _TELLING

    @cached_property
    def anywhere(self) -> Promise:
        """The promise for a path that turns anywhere within the recorded voltages, at recorded speeds."""
        turns = np.random.default_rng(1).uniform(*self.limits, _TURNS)
        return promise(self, np.concatenate([[self.limits[0], self.limits[1]], turns]))

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        lengths = {f"{name}_m": getattr(self, name) for name in ("rms", "largest", "disagreement", "stroke")}
        pairs = {"limits_V": self.limits, "new": self.new, "speeds_V_per_s": self.speeds}
        return {
            **lengths,
            **{name: list(pair) for name, pair in pairs.items()},
            "hold_s": self.hold,
            "lag_s": self.lag,
            "closing": self.closing,
            "temperatures_degC": None if self.temperatures is None else list(self.temperatures),
            "legs_V": self.legs.tolist(),
        }

    @classmethod
    def from_dict(cls, data: object) -> Validity:
        """Rebuild from the `data` of `as_dict`; raise `ModelError` if a value is impossible."""
        names = {"hold_s": "hold", "lag_s": "lag", "limits_V": "limits", "legs_V": "legs", "speeds_V_per_s": "speeds"}
        names |= {f"{name}_m": name for name in ("rms", "largest", "disagreement", "stroke")}
        names |= {"new": "new", "closing": "closing", "temperatures_degC": "temperatures"}
        if not isinstance(data, Mapping) or set(data) != set(names):
            raise ModelError(f"validity: need the entries {', '.join(sorted(names))}")
        try:
            return cls(**{names[key]: value for key, value in data.items()})
        except (TypeError, ValueError) as error:
            raise ModelError(f"validity: {error}") from error


@dataclass(frozen=True, eq=False)
class Promise:
    """Error of a path, as a bound that nine of ten paths should keep.

    Attributes
    ----------
    rms, largest : float
        RMS and largest error of the path without its mean error [m].
    half : (n,) array
        The bound along the path [m]: wider on legs that are unlike those of the records.
    untested : tuple of str
        Sentences on the parts of this path that the records do not test; the promise does not hold for these.
    if_actuator_lags : (float, float) or None
        RMS and largest error [m] if the lag in the records is the actuator's; None unless that is open.
    by_temperature : float
        What the temperature adds to `largest` [m]: outside of the tested ones, or because it is not known.
    """

    rms: float
    largest: float
    half: Array
    untested: tuple[str, ...] = ()
    if_actuator_lags: tuple[float, float] | None = None
    by_temperature: float = 0.0

    def sentence(self, stroke: float) -> str:
        """Return the promise in words, errors in percent of a `stroke` [m]."""
        rms_, largest = (100 * error / stroke for error in (self.rms, self.largest))
        expected = f"Expect an error of {largest:.2g} % at most and {rms_:.2g} % RMS, {APART}."
        return " ".join([expected, *self.untested])

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values without the bound along the path."""
        return json_values(
            self,
            "rms_m=rms largest_m=largest untested if_actuator_lags_m=if_actuator_lags by_temperature_m=by_temperature",
        )


def promise(
    validity: Validity,
    voltage: ArrayLike,
    time: ArrayLike | None = None,
    *,
    thermal: Thermal | None = None,
    temperature: ArrayLike | None = None,
    waits: float = 0.0,
) -> Promise:
    """Return the promised error of a path when its voltage is played.

    Parameters
    ----------
    validity : Validity
        Validity of the model that computed the voltage.
    voltage : (n,) array_like
        Voltage that follows the path [V].
    time : (n,) array_like, optional
        Time of the voltage [s]; without it, speeds and holds are assumed to be as in the records.
    thermal : Thermal, optional
        Part of the model.
    temperature : float or (n,) array_like, optional
        Temperature of the path [degC]; default: not known.
    waits : float
        Time [s] for which the voltage is held before the path, or before the homing that leads to it.
    """
    v = np.asarray(voltage, dtype=np.float64)
    clock = None if time is None else np.asarray(time, dtype=np.float64)
    at, beyond, whole = newness(validity, v)
    opens = validity.closing < _CLOSING <= float(np.mean([0.0, *_closed(v[at], validity.span)]))
    wider = _OPEN if opens else 1.0
    rms, largest = (wider * float(_bound(factors, validity, np.array([whole]))[0]) for factors in (RMS, LARGEST))
    largest, lagging = max(largest, validity.largest), None
    each = wider * _bound(LARGEST, validity, beyond) if len(at) else np.array([largest])
    half = each[np.clip(np.searchsorted(at[:, 0], np.arange(v.size), side="right") - 1, 0, each.size - 1)]
    if validity.lag:
        lagging = rms, largest
        moved, fastest = _moved_in_lag(validity, v, clock)
        rms, largest, half = float(np.hypot(rms, moved)), largest + fastest, half + fastest
    untested = [*_untested(validity, v, clock, at, beyond, waits)]
    cost = TemperatureCost(thermal, validity.temperatures, validity.stroke, temperature)
    if cost.largest:
        # Half of a range bounds the standard deviation in it.
        rms, largest, half = rms + 0.5 * cost.largest, largest + cost.largest, half + cost.along
    untested += [cost.sentence] if cost.sentence else []
    if opens:
        untested.append("Its loops close, but those of the records do not: motion after a closed loop was not tested.")
    return Promise(rms, largest, half, tuple(untested), lagging, cost.largest)


def promised(
    actuator: Actuator,
    voltage: ArrayLike,
    time: ArrayLike | None = None,
    temperature: ArrayLike | None = None,
    waits: float = 0.0,
) -> tuple[Promise | None, tuple[str, ...]]:
    """Return the promised error of a path of an `actuator`, None without `Validity`, and what its records do not test.

    `voltage`, `time`, `temperature`, `waits`: as in `promise`.
    """
    known = actuator.identification
    if known is None or known.validity is None:
        sentence = TemperatureCost(actuator.thermal, None, float(np.ptp(actuator.reach)), temperature).sentence
        return None, (sentence,) if sentence else ()
    found = promise(known.validity, voltage, time, thermal=actuator.thermal, temperature=temperature, waits=waits)
    return found, found.untested


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


def _closed(legs_: Array, span: float) -> NDArray[np.bool_]:
    """Return for all legs (k, 2) [V] but the first whether they reach the beginning of the leg before."""
    heights = np.abs(np.diff(legs_, axis=1)[:, 0])
    return np.asarray(heights[1:] >= heights[:-1] - _BAND * span)


def _bound(factors: tuple[Factors, Factors], validity: Validity, beyond: Array) -> Array:
    """Return the bound (k,) [m] of legs with a newness `beyond` (k,), a part of the range."""
    new = np.clip(beyond / _NEW, 0.0, 1.0)
    inside, outside = (one.bound(validity, new) for one in factors)
    return outside if not validity.telling else np.sqrt((1 - new) * inside**2 + new * outside**2)


def _moved_in_lag(validity: Validity, voltage: Array, time: Array | None) -> tuple[float, float]:
    """Return the RMS and the largest displacement [m] of a path within the lag."""
    speed = np.array([validity.speeds[1]])
    if time is not None and time.size > 1:
        speed = np.abs(np.diff(voltage) / np.diff(time))
    moved = _LAG_KNOWN * speed * validity.lag * validity.stroke / validity.span
    return float(np.sqrt(np.mean(moved**2))), float(moved.max())


def _untested(
    validity: Validity, voltage: Array, time: Array | None, at: NDArray[np.intp], beyond: Array, waits: float
) -> Iterator[str]:
    """Yield a sentence for each part of a path that the records do not test."""
    over = max(validity.limits[0] - float(voltage.min()), float(voltage.max()) - validity.limits[1])
    if over > _BEYOND * validity.span:
        yield f"The path goes {over:.3g} V beyond the voltages of the records."
    outside = int(np.count_nonzero(beyond > _NEW))
    if outside:
        yield f"{outside} of {len(beyond)} rises and falls begin where no record turned."
    if time is None or time.size < 2:
        return
    speed = speeds_of(time, voltage, at)
    slowest, fastest = validity.speeds
    if speed.size and fastest and float(speed.max()) > _ALIKE * fastest:
        yield f"Its fastest leg takes {speed.max():.3g} V/s on average, the fastest of the records {fastest:.3g} V/s."
    if speed.size and float(speed.min()) * _ALIKE < slowest:
        yield f"Its slowest leg takes {speed.min():.3g} V/s on average, the slowest of the records {slowest:.3g} V/s."
    hold = longest_hold(time, voltage, validity.span)
    if hold > _ALIKE * validity.hold:
        yield f"The path holds for up to {hold:.3g} s; the records hold for {validity.hold:.3g} s at most."
    if waits > _ALIKE * validity.hold:
        yield f"It waits for the other axes for {waits:.3g} s; the records hold for {validity.hold:.3g} s at most."
