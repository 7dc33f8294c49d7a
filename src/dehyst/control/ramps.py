"""A voltage in small steps that a host can time: a homing within a slew rate, one put after the other."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from dehyst.control.homing import Homing
from dehyst.control.limits import VoltageLimits


def ramp_step(wish: float, present: float, limits: VoltageLimits, period: float) -> float:
    """The voltage [V] of the next step, a `period` [s] long, on the way from the present one to a wish."""
    end, most = limits.nearest(wish), _most(limits, period)
    return end if abs(end - present) <= most else present + math.copysign(most, end - present)


def homing_steps(homing: Homing, limits: VoltageLimits, period: float) -> Iterator[tuple[float, float]]:
    """Voltages [V] of a homing, each with the seconds to stay there, `period` at least; the present one is left out."""
    most = _most(limits, period)
    for (start, _), (end, seconds) in pairwise(_places(homing, period)):
        count = max(1, math.ceil(abs(end - start) / most * (1 - 1e-12)))
        for voltage in np.linspace(start, end, count + 1)[1:]:
            yield limits.nearest(float(voltage)), max(seconds / count, period)


def _most(limits: VoltageLimits, period: float) -> float:
    """The largest step [V]."""
    return (limits.slew_rate or math.inf) * period


def _places(homing: Homing, period: float) -> list[tuple[float, float]]:
    """Voltages [V] to go to in straight lines, the present one first, and seconds for each; 0 where that is free."""
    if homing.played is None:
        return [(voltage, 0.0) for voltage in homing.turns]
    voltage, rate = homing.played.voltage, homing.played.sample_rate
    # No more often than a host can, but always where it turns, or begins or ends to be held.
    bends = np.flatnonzero(np.diff(np.sign(np.diff(voltage)))) + 1
    kept = np.unique([0, voltage.size - 1, *bends, *range(0, voltage.size, max(1, round(period * rate)))])
    seconds = np.diff(kept, prepend=0) / rate
    return list(zip(voltage[kept].tolist(), seconds.tolist(), strict=True))
