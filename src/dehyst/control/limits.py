"""Voltage limits and slew rate, and the warnings about clamped voltages."""

from __future__ import annotations

import math
import sys
import warnings
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import DehystError, ModelError
from dehyst._types import Array, Mask
from dehyst._validation import interval, keep, number, untimely, vector
from dehyst._views.lines import ends
from dehyst.model import Actuator, Range, major_loop, voltage_error

# The hint in errors about a missing time of the samples.
TIME_NEEDED = "give the time [s] of each sample, or the period [s] between them"
# A path in another unit than metres and below this part of the reach is probably in metres.
_METRES_SHARE = 1e-6
# Parts of the recorded range by which a voltage exceeds it: above the first it is far outside, below the second noise.
_FAR_OUTSIDE, _NOISE = 0.1, 1e-3
# Bounds of the correction by a sensor, as parts of the reach: default and largest.
_DEFAULT_BOUND, _LARGEST_BOUND = 0.05, 0.25


@dataclass(frozen=True)
class VoltageLimits:
    """Limits of a voltage and of its slew rate.

    `low`, `high`: lowest and highest voltage [V]. `slew_rate`: largest abs(dv/dt) [V/s] between samples; default: not
    limited. Raise `ModelError` if they are not an interval, or the slew rate is not positive.
    """

    low: float
    high: float
    slew_rate: float | None = None

    def __post_init__(self) -> None:
        low, high = interval((self.low, self.high))
        keep(self, low=low, high=high)
        if self.slew_rate is not None:
            slew_rate = number(self.slew_rate, "slew_rate")
            if slew_rate <= 0:
                raise ModelError(argument="slew_rate", got=f"{slew_rate:g}", need="a positive number of volts a second")
            keep(self, slew_rate=slew_rate)

    @property
    def words(self) -> str:
        """The limits as text, for a sentence."""
        return ends(self.low, self.high, "V")

    def nearest(self, voltage: float) -> float:
        """Return the `voltage` [V], or the limit that it exceeds."""
        return min(max(voltage, self.low), self.high)

    def reached(self, voltage: Array) -> Mask:
        """Return which voltages (n,) [V] are at a limit."""
        return np.asarray((voltage <= self.low) | (voltage >= self.high))

    def within(self, voltage: float, what: str, *, error: type[DehystError] = ModelError) -> float:
        """Return a present `voltage` [V]; raise `error` if it lies outside the limits; `what` is its name."""
        now = number(voltage, what, error=error)
        if not self.low <= now <= self.high:
            raise error(
                f"got {now:.9g} V, but the limits are {self.low:g} to {self.high:g} V",
                argument=what,
                hint="ramp there first, or widen the limits if actuator and amplifier allow it",
            )
        return now

    def towards(self, target: float, present: float, period: float) -> float:
        """Return the voltage [V] one `period` [s] after the `present` voltage [V], on the way to a `target` [V]."""
        end, largest = self.nearest(target), self.largest_step(period)
        return end if abs(end - present) <= largest else present + math.copysign(largest, end - present)

    def largest_step(self, period: float) -> float:
        """Return the largest change [V] in a `period` [s]; infinite without a slew rate."""
        return (self.slew_rate or math.inf) * period

    def steps(self, size: int, time: ArrayLike | None, period: float | None = None) -> Array:
        """Return the largest voltage step [V] before each of `size` samples at `time` (n,) [s].

        The first sample follows the last voltage sent by `period` [s] or by the first interval of `time`, whichever is
        shorter.
        """
        if self.slew_rate is None:
            return np.broadcast_to(np.inf, size)
        if time is None:
            raise ModelError(
                "a slew rate needs the time of each sample", hint=TIME_NEEDED, change=("time", "sample_rate")
            )
        t = vector(time, "time")
        if t.size != size or np.any(np.diff(t) <= 0):
            raise ModelError(untimely(t, size))
        intervals = np.diff(t)
        first = [*intervals[:1], *([] if period is None else [period])]
        if size and not first:
            raise ModelError(
                "a slew rate needs the time since the voltage before, which a single sample does not give",
                hint="give two samples at least, or no slew rate",
                change=("slew_rate",),
            )
        return self.slew_rate * np.concatenate([[min(first, default=0.0)], intervals])[:size]

    def allowed(self, voltage: Array, before: float, steps: Array) -> Array:
        """Return a wanted `voltage` (n,) [V], clipped; the result holds up to and including the first changed sample.

        `before`: last voltage sent [V]. `steps` (n,): largest allowed step before each sample [V].
        """
        if self.slew_rate is None:
            return np.clip(voltage, self.low, self.high)
        previous = np.concatenate([[before], voltage[:-1]])
        # Limits come last: the slew rate must not push a voltage out of them.
        return np.clip(np.clip(voltage, previous - steps, previous + steps), self.low, self.high)


@dataclass(frozen=True)
class Outside:
    """Voltages outside of those of the records: their number, whether one lies far outside, and warnings."""

    count: int = 0
    far: bool = False
    warnings: tuple[str, ...] = ()


def outside_identified(
    actuator: Actuator,
    voltage: Array,
    limits: tuple[float, float] | None = None,
    *,
    name: str = "",
    refuse: bool = True,
) -> Outside:
    """Find which voltages (n,) [V] lie outside of the records of a model, by more than a thousandth of their range.

    A voltage is far outside if it exceeds the range by more than a tenth of its width: there the model is a straight
    line without measurements. With `refuse`, raise `ModelError` if a voltage lies outside of the range and `limits` by
    more than their width. `name`: name of the voltages, before the warnings.
    """
    head = f"{name}: " if name else ""
    if actuator.limits is None or not voltage.size:
        return Outside()
    low, high = actuator.limits
    identified = Range(low, high)
    strays = identified.joined(*([] if limits is None else [limits])).far_ends(voltage) if refuse else None
    if strays is not None:
        raise ModelError(f"{head}{voltage_error(strays, identified)}")
    beyond = np.maximum(low - voltage, voltage - high)
    count = int(np.count_nonzero(beyond > _NOISE * (high - low)))
    if not count:
        return Outside()
    warning = (
        f"{head}{count} of {voltage.size} voltages lie outside those of the records, {ends(low, high, 'V')}: "
        "extrapolated"
    )
    far = float(beyond.max()) > _FAR_OUTSIDE * (high - low)
    if far:
        warning += (
            f", and far: {float(voltage[int(np.argmax(beyond))]):.5g} V lies {float(beyond.max()):.4g} V beyond, "
            f"more than {100 * _FAR_OUTSIDE:.0f} % of the range. Nothing was measured there: record these voltages and "
            "identify again"
        )
    return Outside(count, far, (warning,))


class ClampWarning(UserWarning):
    """A wanted displacement was not followed: its voltage was clamped at a limit or slewed.

    `before`: last voltage [V] sent, from which the slew rate counts; at the first sample, the voltage of the state.
    """

    def __init__(self, words: str, before: float | None = None) -> None:
        super().__init__(words)
        self.before = before


class SensorFault(IntEnum):
    """Why a sensor is not believed.

    `NONE`: it is believed. `FAR`: over a quarter of the readings lie farther from the model than the bound: another
    unit, scale or zero. `STUCK`: it hardly moves while the actuator does. `SCALED`: it moves less than half, or more
    than twice, as much. `CONTRADICTS`: it moves at other times: inverted, late by more than a sixth of a cycle or by
    whole cycles, or noise.
    """

    NONE = 0
    FAR = 1
    STUCK = 2
    SCALED = 3
    CONTRADICTS = 4


class SensorWarning(UserWarning):
    """A sensor contradicted the model for a cycle: it is not believed any more, and its correction is taken back.

    `fault`: why, a `SensorFault`.
    """

    def __init__(self, fault: SensorFault, bound: float) -> None:
        reasons = {
            SensorFault.FAR: f"over a quarter of the readings are more than {bound * 1e6:.4g} um (bound) from the "
            "model: another unit, scale or zero, or an aged actuator",
            SensorFault.STUCK: "it hardly moves while the actuator does",
            SensorFault.SCALED: "it moves less than half, or more than twice, as much as the actuator",
            SensorFault.CONTRADICTS: "it moves at other times than the actuator: inverted, late, or noise",
        }
        super().__init__(f"SENSOR NOT BELIEVED: {reasons[fault]}. Its correction is taken back; reset() begins anew")
        self.fault = fault


def warn_of_sensor(fault: SensorFault, bound: float) -> None:
    """Warn the caller that a sensor is not believed any more; `bound` [m]."""
    warnings.warn(SensorWarning(fault, bound), None, _caller())


def sensor_bound(width: float, bound: float | None) -> float:
    """Return the largest correction by a sensor: the `bound` that was given, or a twentieth of the reach's `width`."""
    if bound is None:
        return _DEFAULT_BOUND * width
    if not 0 < number(bound, "bound") <= _LARGEST_BOUND * width:
        need = f"a displacement up to a quarter of the reach, {_LARGEST_BOUND * width:g}"
        raise ModelError(argument="bound", got=bound, need=need)
    return float(bound)


class Clamps(NamedTuple):
    """Number of samples whose voltage was clamped at a limit, and number of slewed samples."""

    limited: int
    slewed: int


def warn_of_clamps(
    actuator: Actuator, limits: VoltageLimits, axis: str, words: str, displacement: Array, before: float
) -> None:
    """Warn the caller in these `words` of clamped voltages; `axis`: its name if there are several.

    `before`: the last voltage sent [V]. If the wanted displacements (n,) [m] are implausible, say why.
    """
    stray = stray_sentence(actuator, limits, displacement)
    words = f"{axis and f'{axis}: '}{words}{stray and f'. {stray}'}"
    warnings.warn(ClampWarning(words, before), None, _caller())


def stray_sentence(actuator: Actuator, limits: VoltageLimits, displacement: Array) -> str:
    """Return why displacements (n,) [m] are implausible, or "" if they are within reach of the limits."""
    sentence = actuator._implausibility(displacement)
    if not sentence or (limits.low, limits.high) == actuator.limits:
        return sentence
    try:
        return actuator._implausibility(displacement, None, major_loop(actuator, (limits.low, limits.high)))
    except ModelError:
        return sentence


def unit_hint(units: str, reach: tuple[float, float], displacement: Array) -> tuple[str, ...]:
    """Return a hint if displacements (n,) [`units`] are far too small for the reach [`units`]."""
    largest = float(np.abs(displacement).max(initial=0.0))
    if units == "m" or not 0 < largest <= _METRES_SHARE * max(map(abs, reach)):
        return ()
    return (
        f"all displacements lie within {largest:.3g} {units} of 0, less than a millionth of the reach: are they in "
        f"metres? They are taken in {units}",
    )


def _caller() -> int:
    """Return the stack level of the first frame outside of the package, relative to the calling function."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith("dehyst."):
        level, frame = level + 1, frame.f_back
    return level
