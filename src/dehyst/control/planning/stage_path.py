"""A homing of all axes before a path: whatever the stage did before, its state is known then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._errors import RecordError
from dehyst._types import Array
from dehyst._validation import vector
from dehyst.control.compensator import Compensator
from dehyst.control.limits import VoltageLimits
from dehyst.control.planning.path import HOMING, PATH, WAY, HomedPath, plan_path, plan_voltage, start_at
from dehyst.control.planning.start import PossibleStart
from dehyst.control.stage_compensator import StageCompensator
from dehyst.model import State
from dehyst.model.stage import apply
from dehyst.model.states import state_at

# Of the time before the path: rows that are closer are one.
_ROUNDING = 1e-9


def home_stage_before(
    compensator: StageCompensator,
    displacement: ArrayLike,
    *,
    time: ArrayLike | None = None,
    states: Sequence[State] | None = None,
    present: Sequence[float] | None = None,
) -> tuple[HomedPath, ...]:
    """Compute the voltages of a path of all axes, with the shortest homing of each before it.

    Parameters
    ----------
    compensator : StageCompensator
        Its stage, limits and slew rates; its states do not count.
    displacement : (n, axes) array_like
        Wanted displacements [m].
    time : (n,) array_like, optional
        [s].
    states : sequence of State, optional
        State of each actuator at rest, if they are known: then no homing comes before the way to the path.
    present : sequence of float, optional
        Present voltage [V] of each axis, as in `plan_path`.

    Returns
    -------
    tuple of HomedPath
        One an axis, with the same rows in time: the axes are homed side by side, and one with a shorter homing waits.
        Displacements are those of the axes, with all coupling; states and errors are those of the actuators.

    Raises
    ------
    ModelError, RecordError
        As `plan_path` and `StageCompensator.trajectory`.
    """
    stage = compensator.stage
    wanted = stage.columns(displacement, "displacement", "m")
    targets = apply(stage.decoupling, wanted)
    begins: list[State | None] = [None] * len(targets.T) if states is None else list(states)
    now: list[float | None] = [None] * len(targets.T) if present is None else list(present)
    homed = [
        plan_path(
            one,
            target,
            time=time,
            start=None if begin is None else PossibleStart("given", (begin,)),
            home=True,
            present=volts,
        )
        for one, target, begin, volts in zip(compensator.compensators, targets.T, begins, now, strict=True)
    ]
    ahead, voltage, phase = _side_by_side(homed)
    ends = [one.start.state if one.homing is None else one.homing.state for one in homed]
    expected = np.zeros(voltage.shape)
    if ahead.size:
        when = None if homed[0].time is None else ahead - ahead[0]
        moved = stage.simulate(voltage, time=when, states=states, extrapolate=True)
        ends, expected = list(moved.states), moved.displacement
    # The path begins a row after the way to it.
    period = compensator.period if time is None or not ahead.size else -float(ahead[-1])
    follower = StageCompensator(
        stage, period=period, limits=compensator.limits, slew_rate=compensator.slew_rate, states=ends
    )
    before = [_resting(*each) for each in zip(compensator.compensators, begins, now, strict=True)]
    path = follower.trajectory(wanted, time=time, present=voltage[-1] if ahead.size else before)
    clock = _clock(homed[0], ahead)
    free, held = np.zeros(voltage.shape, dtype=bool), np.full(len(wanted), PATH)
    return tuple(
        replace(
            one,
            time=clock,
            phase=np.concatenate([phase, held]),
            voltage=np.concatenate([voltage[:, j], path.voltage[:, j]]),
            displacement=np.concatenate([expected[:, j], wanted[:, j]]),
            expected=np.concatenate([expected[:, j], path.displacement[:, j]]),
            state=path.states[j],
            clamped=np.concatenate([free[:, j], path.clamped[:, j]]),
            followed=path.followed,
            # What a homing leaves open is reported where this path depends on it.
            warnings=(*(() if one.homing is None or one.certified else one.homing.remarks), *path.remarks[j]),
        )
        for j, one in enumerate(homed)
    )


def plan_stage_path(
    compensator: StageCompensator,
    displacement: ArrayLike,
    *,
    time: ArrayLike | None = None,
    starts: Sequence[PossibleStart] | None = None,
    home: bool | None = None,
    present: Sequence[float] | None = None,
) -> tuple[HomedPath, ...]:
    """Compute the voltages of a path of all axes, as `plan_path` does for one.

    Parameters
    ----------
    compensator, displacement, time, present
        As in `home_stage_before`.
    starts : sequence of PossibleStart, optional
        The state of each actuator before the path; default: unknown.
    home : bool, optional
        Whether the shortest homing of all axes comes first; default: if the starts are unknown, and one leaves more
        open than the model's error.

    Returns
    -------
    tuple of HomedPath
        One an axis, as `home_stage_before` returns them.

    Raises
    ------
    ModelError, RecordError
        As `home_stage_before`.
    """
    if home:
        return home_stage_before(compensator, displacement, time=time, present=present)
    planned = _path_from(compensator, displacement, time, starts)
    if starts is None and home is None and any(one.error.matters for one in planned):
        homed = home_stage_before(compensator, displacement, time=time, present=present)
        return tuple(replace(one, unhomed=before.error) for one, before in zip(homed, planned, strict=True))
    return planned


def _path_from(
    compensator: StageCompensator,
    displacement: ArrayLike,
    time: ArrayLike | None,
    given: Sequence[PossibleStart] | None,
) -> tuple[HomedPath, ...]:
    """Return the voltages of all axes from their starts, or from the middle of the possible ones."""
    stage, limits = compensator.stage, compensator.limits
    wanted = stage.columns(displacement, "displacement", "m")
    if not len(wanted):
        raise RecordError("path: got no samples, need one at least")
    firsts = apply(stage.decoupling, wanted)[0].tolist()
    parts = list(zip(stage.actuators, firsts, limits, strict=True))
    starts = [start_at(*part) for part in parts] if given is None else list(given)
    begins = [start.within(one, allowed) for start, (one, _, allowed) in zip(starts, parts, strict=True)]
    # An actuator stands at the first sample, or is brought there slowly.
    states = [
        state_at(one, begin, first) if one.model.moves_on or given is None else begin
        for begin, (one, first, _) in zip(begins, parts, strict=True)
    ]
    follower = StageCompensator(
        stage, limits=limits, slew_rate=compensator.slew_rate, period=compensator.period, states=states
    )
    held = [_resting(*each, None) for each in zip(compensator.compensators, begins, strict=True)]
    trace = follower.trajectory(wanted, time=time, present=None if given is None else held)
    if given is not None and any(compensator.slew_rate) and trace.clamped[:1].any():
        led = home_stage_before(compensator, wanted, time=time, states=begins)
        return tuple(
            replace(
                path,
                start=start,
                error=start.error_along(one, path.voltage, allowed, time=path.time, first=path.first),
            )
            for path, start, (one, _, allowed) in zip(led, starts, parts, strict=True)
        )
    clock = None if time is None else vector(time, "time")
    return tuple(
        HomedPath(
            time=clock,
            phase=np.full(len(wanted), PATH),
            voltage=trace.voltage[:, j],
            displacement=wanted[:, j],
            expected=trace.displacement[:, j],
            state=trace.states[j],
            start=starts[j],
            homing=None,
            clamped=trace.clamped[:, j],
            followed=trace.followed,
            error=starts[j].error_along(one, trace.voltage[:, j], allowed, time=clock),
            warnings=trace.remarks[j],
        )
        for j, (one, _, allowed) in enumerate(parts)
    )


def plan_stage_voltage(
    compensator: StageCompensator,
    voltage: ArrayLike,
    *,
    time: ArrayLike | None = None,
    starts: Sequence[PossibleStart | None] | None = None,
    home: bool = False,
) -> tuple[HomedPath, ...]:
    """Return the displacements that voltages (n, axes) [V] of all axes cause, as `plan_voltage` does for one.

    Parameters
    ----------
    compensator, time
        As in `home_stage_before`, like results and errors.
    voltage : (n, axes) array_like
        [V]; played as they are.
    starts : sequence of PossibleStart, optional
        Of each actuator; default: unknown.
    home : bool, optional
        Whether the shortest homing of all axes comes first.
    """
    stage = compensator.stage
    given = stage.columns(voltage, "voltage", "V")
    begins: list[PossibleStart | None] = [None] * len(given.T) if starts is None else list(starts)
    runs = [
        plan_voltage(one, volts, time=time, start=begin, home=home)
        for one, volts, begin in zip(compensator.compensators, given.T, begins, strict=True)
    ]
    if not home:
        moved = apply(stage.coupling, np.column_stack([one.expected for one in runs]))
        return tuple(replace(one, displacement=y, expected=y) for one, y in zip(runs, moved.T, strict=True))
    ahead, before, phase = _side_by_side(runs)
    whole, clock = np.vstack([before, given]), _clock(runs[0], ahead)
    motion = stage.simulate(whole, time=clock, states=[one.start.state for one in runs], extrapolate=True)
    return tuple(
        replace(
            one,
            time=clock,
            phase=np.concatenate([phase, np.full(len(given), PATH)]),
            voltage=whole[:, j],
            displacement=motion.displacement[:, j],
            expected=motion.displacement[:, j],
            state=motion.states[j],
            clamped=np.zeros(len(whole), dtype=bool),
        )
        for j, one in enumerate(runs)
    )


def _side_by_side(homed: Sequence[HomedPath]) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return the rows of all axes before their paths, which begin at one time.

    Times (k,) [s], or rows, before the first sample of the path; voltages (k, axes) [V]; and phases (k,). An axis with
    a shorter homing waits. No row of any axis is left out.
    """
    before = []
    for one in homed:
        time = np.arange(one.voltage.size, dtype=np.float64) if one.time is None else one.time
        rows = slice(one.first + 1)
        before.append((time[rows] - time[one.first], one.voltage[rows], one.phase[rows]))
    ahead = np.unique(np.concatenate([own[:-1] for own, _, _ in before]))
    # Rows of two axes at one time may differ by rounding.
    ahead = ahead[np.diff(ahead, append=0.0) > _ROUNDING * np.abs(ahead).max(initial=0.0)]
    voltage = np.column_stack([np.interp(ahead, own, values) for own, values, _ in before])
    homes = any(one.homing is not None for one in homed)
    ends = [own[phases != HOMING][0] for own, _, phases in before]
    return ahead, voltage, np.where(homes & (ahead < max(ends)), HOMING, WAY)


def _clock(homed: HomedPath, ahead: Array) -> Array | None:
    """Return the time [s] of all rows from the first one of any axis; None if the path has none."""
    if homed.time is None:
        return None
    begin = ahead[0] if ahead.size else 0.0
    path = homed.time[homed.first :]
    return np.concatenate([ahead - begin, path - path[0] - begin])


def _resting(one: Compensator, state: State | None, present: float | None) -> float:
    """Return the present voltage [V]: the one given, that which holds a state, or the one taken before a homing."""
    if present is not None:
        return present
    return VoltageLimits(*one.limits).nearest(0.0 if state is None else one.actuator.voltage(state))
