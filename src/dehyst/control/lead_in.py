"""The lead-in of a scan: a smooth way from the actuator's present state at rest to the first sample."""

from __future__ import annotations

from math import ceil, inf, sqrt
from typing import Any

import numpy as np

from dehyst._types import Array
from dehyst.control.compensator import Compensator
from dehyst.control.trajectory import Command
from dehyst.model import State
from dehyst.waveforms import MotionLimits, ScanPath
from dehyst.waveforms.excitation import positive, refuse_long
from dehyst.waveforms.profiles import Bridge, PathPoint

# Least and most samples of a lead-in, and the factor by which it is lengthened.
_LEAST, _MOST = 4, 2_000_000
_LONGER = 2**0.25
# Quintic of least jerk: largest speed over height per time, largest acceleration over height per time squared.
_FASTEST, _HARDEST = 1.875, 10 / sqrt(3)


def follow(compensator: Compensator, path: ScanPath, state: State) -> Command:
    """Compute the voltages for a path from a state, with the path's own derivatives."""
    return compensator.trajectory(path.displacement, **timed(path), state=state)


def timed(path: ScanPath) -> dict[str, Any]:
    """Return time and derivatives of a path, as arguments of `compensate` and `trajectory`."""
    return {"time": path.time, "velocity": path.velocity, "acceleration": path.acceleration}


def approach_to(
    path: ScanPath, compensator: Compensator, state: State, limits: MotionLimits, seconds: float | None = None
) -> ScanPath | None:
    """Return the way from a state at rest to the first sample of a path, without it; None if the state is there.

    Raise `RecordError` if `seconds` is not positive, or too long.

    Parameters
    ----------
    path : ScanPath
    compensator : Compensator
        Its slew rate limits the lead-in.
    state : State
    limits : MotionLimits
        Of speed and acceleration; those that are not given are the path's own extremes.
    seconds : float, optional
        Duration, rounded up to a sample; by default as short as the limits allow, those of speed and acceleration
        first, then the slew rate if any duration keeps it.
    """
    now, first, rate, ends = _present(state), path.first, path.sample_rate, _ends(path)
    if seconds is not None:
        duration = positive(seconds, "approach")
        refuse_long(int(min(duration * rate, 1e15)), rate)
        return _sampled(now, ends[0], max(_LEAST, ceil(duration * rate * (1 - 1e-12))), path)
    stroke = path.range[1] - path.range[0]
    if not any(now[1:]) and not ends[0].velocity and abs(now.displacement - first.displacement) <= 1e-12 * stroke:
        return None
    motion = MotionLimits(limits.speed or _extreme(path.velocity), limits.acceleration or _extreme(path.acceleration))
    height = abs(first.displacement - now.displacement)
    least = max(_FASTEST * height / (motion.speed or 1), sqrt(_HARDEST * height / (motion.acceleration or 1)))
    slew = inf if compensator.slew_rate is None else compensator.slew_rate
    count, shortest = max(_LEAST, ceil(least * rate * (1 - 1e-9))), None
    while count <= _MOST:
        for end in ends:
            if not motion.allow(Bridge(now, end, count / rate).peaks):
                continue
            way = _sampled(now, end, count, path)
            shortest = shortest or way
            if _steepest(compensator, way.then(path.repeated(0)), state) <= slew / rate:
                return way
        count = ceil(count * _LONGER)
    refuse_long(count, rate)
    return shortest or _sampled(now, ends[-1], count, path)


def _steepest(compensator: Compensator, path: ScanPath, state: State) -> float:
    """Return the largest voltage step [V] along a path, before any limit."""
    motion = compensator.actuator.compensate(path.displacement, **timed(path), state=state, extrapolate=True)
    return float(np.abs(np.diff(motion.voltage)).max(initial=0.0))


def _present(state: State) -> PathPoint:
    """Return displacement and velocity of a state."""
    return PathPoint(*map(float, state.motion)) if state.motion.size else PathPoint(state.displacement)


def _extreme(row: Array) -> float:
    return float(np.abs(row).max())


def _ends(path: ScanPath) -> tuple[PathPoint, ...]:
    """Return the ends to try: the begin of the scan, and the same without acceleration, which may need a detour."""
    y, v, _ = path.first
    # From rest, an acceleration at the end would make the way overshoot and come back.
    if abs(v) <= 1e-9 * _extreme(path.velocity):
        return (PathPoint(y),)
    return path.first, PathPoint(y, v)


def _sampled(now: PathPoint, end: PathPoint, count: int, path: ScanPath) -> ScanPath:
    travel = Bridge(now, end, count / path.sample_rate).at(np.arange(count) / path.sample_rate)
    return ScanPath(*travel, path.sample_rate, periodic=False)
