"""The way to the first sample of a scan: smooth, from where the actuator stands at rest."""

from __future__ import annotations

from math import ceil, inf, sqrt

import numpy as np

from dehyst._types import Array
from dehyst.control.compensator import Compensator
from dehyst.control.trajectory import Command
from dehyst.model import State
from dehyst.waveforms import MotionLimits, ScanPath
from dehyst.waveforms.excitation import positive, refuse_long
from dehyst.waveforms.profiles import Bridge, PathPoint

_LEAST = 4
_LONGER = 2**0.25
_MOST = 2_000_000
# Of the least jerk: largest speed over height per time, largest acceleration over height per time squared.
_FASTEST, _HARDEST = 1.875, 10 / sqrt(3)


def follow(compensator: Compensator, path: ScanPath, state: State) -> Command:
    """Voltages for a path from a state, with the derivatives that the path knows."""
    return compensator.trajectory(
        path.displacement, time=path.time, velocity=path.velocity, acceleration=path.acceleration, state=state
    )


def approach_to(
    path: ScanPath, compensator: Compensator, state: State, limits: MotionLimits, seconds: float | None = None
) -> ScanPath | None:
    """From a state at rest to the first sample of a path, which is left out; None if it stands there.

    Parameters
    ----------
    path : ScanPath
    compensator : Compensator
        Whose slew rate it shall keep.
    state : State
    limits : MotionLimits
        Of speed and acceleration; those that are not given are the path's own extremes.
    seconds : float, optional
        How long it takes, to the next sample; by default as short as the limits allow, of speed and acceleration
        first, then the slew rate if any time keeps that.

    Raises
    ------
    RecordError
        If `seconds` is no positive number, or makes it too long.
    """
    now, first, rate, ends = _standing(state), path.first, path.sample_rate, _ends(path)
    if seconds is not None:
        wanted = positive(seconds, "approach")
        refuse_long(int(min(wanted * rate, 1e15)), rate)
        return _sampled(now, ends[0], max(_LEAST, ceil(wanted * rate * (1 - 1e-12))), path)
    stroke = path.range[1] - path.range[0]
    if not any(now[1:]) and not ends[0].velocity and abs(now.displacement - first.displacement) <= 1e-12 * stroke:
        return None
    kept = MotionLimits(limits.speed or _extreme(path.velocity), limits.acceleration or _extreme(path.acceleration))
    height = abs(first.displacement - now.displacement)
    least = max(_FASTEST * height / (kept.speed or 1), sqrt(_HARDEST * height / (kept.acceleration or 1)))
    slew = inf if compensator.slew_rate is None else compensator.slew_rate
    count, gentle = max(_LEAST, ceil(least * rate * (1 - 1e-9))), None
    while count <= _MOST:
        for end in ends:
            if not kept.allow(Bridge(now, end, count / rate).peaks):
                continue
            found = _sampled(now, end, count, path)
            gentle = gentle or found
            if _steepest(compensator, found.then(path.repeated(0)), state) <= slew / rate:
                return found
        count = ceil(count * _LONGER)
    refuse_long(count, rate)
    return gentle or _sampled(now, ends[-1], count, path)


def _steepest(compensator: Compensator, path: ScanPath, state: State) -> float:
    """Largest step of the voltage [V] along a path, before any limit."""
    motion = compensator.actuator.compensate(
        path.displacement,
        time=path.time,
        velocity=path.velocity,
        acceleration=path.acceleration,
        state=state,
        extrapolate=True,
    )
    return float(np.abs(np.diff(motion.voltage)).max(initial=0.0))


def _standing(state: State) -> PathPoint:
    """Displacement and velocity of a state."""
    return PathPoint(*map(float, state.motion)) if state.motion.size else PathPoint(state.displacement)


def _extreme(row: Array) -> float:
    return float(np.abs(row).max())


def _ends(path: ScanPath) -> tuple[PathPoint, ...]:
    """How the way may end: as the scan begins, or without its acceleration where that would ask for a detour."""
    y, v, _ = path.first
    # At rest, an acceleration at the end would make it go too far and come back.
    if abs(v) <= 1e-9 * _extreme(path.velocity):
        return (PathPoint(y),)
    return path.first, PathPoint(y, v)


def _sampled(now: PathPoint, end: PathPoint, count: int, path: ScanPath) -> ScanPath:
    travel = Bridge(now, end, count / path.sample_rate).at(np.arange(count) / path.sample_rate)
    return ScanPath(*travel, path.sample_rate, periodic=False)
