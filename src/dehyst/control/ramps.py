"""Ramps: a voltage in small steps that a host can time, within a slew rate."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from dehyst.control.homing import Homing
from dehyst.control.limits import VoltageLimits


def ramp_step(target: float, present: float, limits: VoltageLimits, period: float) -> float:
    """Return the voltage [V] of the next step, a `period` [s] long, from the present voltage towards a target."""
    end, largest = limits.nearest(target), _largest_step(limits, period)
    return end if abs(end - present) <= largest else present + math.copysign(largest, end - present)


def homing_steps(homing: Homing, limits: VoltageLimits, period: float) -> Iterator[tuple[float, float]]:
    """Yield the voltages [V] of a homing without the present one, each with its duration [s], `period` at least."""
    largest = _largest_step(limits, period)
    for (start, _), (end, seconds) in pairwise(_corners(homing, period)):
        count = max(1, math.ceil(abs(end - start) / largest * (1 - 1e-12)))
        for voltage in np.linspace(start, end, count + 1)[1:]:
            yield limits.nearest(float(voltage)), max(seconds / count, period)


def _largest_step(limits: VoltageLimits, period: float) -> float:
    return (limits.slew_rate or math.inf) * period


def _corners(homing: Homing, period: float) -> list[tuple[float, float]]:
    """Return the voltages [V] that straight ramps join, the present one first, with their seconds; 0 if free."""
    if homing.played is None:
        return [(voltage, 0.0) for voltage in homing.turns]
    voltage, rate = homing.played.voltage, homing.played.sample_rate
    # No more often than a host can follow, but always at turns and at both ends of a hold.
    bends = np.flatnonzero(np.diff(np.sign(np.diff(voltage)))) + 1
    kept = np.unique([0, voltage.size - 1, *bends, *range(0, voltage.size, max(1, round(period * rate)))])
    seconds = np.diff(kept, prepend=0) / rate
    return list(zip(voltage[kept].tolist(), seconds.tolist(), strict=True))
