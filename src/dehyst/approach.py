"""The way to the first sample of a scan: smooth, from where the actuator stands at rest."""

from __future__ import annotations

from math import ceil, inf, sqrt

import numpy as np

from dehyst._native import Array
from dehyst.compensator import Command, Compensator
from dehyst.edge import Bridge, Point
from dehyst.excitation import positive, refuse_long
from dehyst.model import State
from dehyst.scan import Limits, Path

_LEAST = 4
_LONGER, _TRIES = 2**0.25, 60
_MOST = 2_000_000
# Of the least jerk: largest speed over height per time, largest acceleration over height per time squared.
_FASTEST, _HARDEST = 1.875, 10 / sqrt(3)


def follow(compensator: Compensator, path: Path, state: State) -> Command:
    """Voltages for a path from a state, with the derivatives that the path knows."""
    return compensator.trajectory(path.displacement, time=path.time, velocity=path.velocity,
                                  acceleration=path.acceleration, state=state)  # fmt: skip


def approach_to(
    path: Path, compensator: Compensator, state: State, limits: Limits, seconds: float | None = None
) -> Path | None:
    """From a state at rest to the first sample of a path, which is left out; None if it stands there.

    Parameters
    ----------
    path : Path
    compensator : Compensator
        Whose slew rate it shall keep.
    state : State
    limits : Limits
        Of speed and acceleration; those that are not given are the path's own extremes.
    seconds : float, optional
        How long it takes, to the next sample; by default as short as the limits allow, of speed and acceleration
        first, then the slew rate if any time keeps that.

    Raises
    ------
    RecordError
        If `seconds` is no positive number, or makes it too long.
    """
    now, first, rate = _standing(state), path.first, path.sample_rate
    if seconds is not None:
        wanted = positive(seconds, "approach")
        refuse_long(int(min(wanted * rate, 1e15)), rate)
        return _sampled(now, first, max(_LEAST, ceil(wanted * rate * (1 - 1e-12))), path)
    stroke = path.range[1] - path.range[0]
    if not any(now[1:]) and not first.velocity and abs(now.displacement - first.displacement) <= 1e-12 * stroke:
        return None
    kept = Limits(limits.speed or _extreme(path.velocity), limits.acceleration or _extreme(path.acceleration))
    height = abs(first.displacement - now.displacement)
    least = max(_FASTEST * height / (kept.speed or 1), sqrt(_HARDEST * height / (kept.acceleration or 1)))
    slew = inf if compensator.slew_rate is None else compensator.slew_rate
    count, gentle = max(_LEAST, ceil(least * rate * (1 - 1e-9))), None
    for _ in range(_TRIES):
        if count > _MOST and gentle is not None:
            return gentle
        refuse_long(count, rate)
        found = _sampled(now, first, count, path)
        if kept.hold(_bridge(now, first, count / rate).peaks):
            gentle = gentle or found
            if _steepest(compensator, found.then(path.repeated(0)), state) <= slew / rate:
                return found
        count = ceil(count * _LONGER)
    return gentle or found


def _steepest(compensator: Compensator, path: Path, state: State) -> float:
    """Largest step of the voltage [V] along a path, before any limit."""
    motion = compensator.actuator.compensate(
        path.displacement, time=path.time, velocity=path.velocity, acceleration=path.acceleration, state=state
    )
    return float(np.abs(np.diff(motion.voltage)).max(initial=0.0))


def _standing(state: State) -> Point:
    """Displacement and velocity of a state."""
    return Point(*map(float, state.motion)) if state.motion.size else Point(state.displacement)


def _extreme(row: Array) -> float:
    return float(np.abs(row).max())


def _sampled(now: Point, first: Point, count: int, path: Path) -> Path:
    bridge = _bridge(now, first, count / path.sample_rate)
    travel = bridge.at(np.arange(count) / path.sample_rate)
    return Path(*travel, path.sample_rate, periodic=False)


def _bridge(now: Point, first: Point, seconds: float) -> Bridge:
    # At rest, an acceleration at the end would make it go too far and come back.
    end = first if first.velocity else Point(first.displacement)
    return Bridge(now, end, seconds)
