"""The loop of a compensator in the C core: how it is made, and resumed from a snapshot."""

from __future__ import annotations

from functools import partial

import numpy as np

from dehyst._errors import ModelError
from dehyst._native import CoreState, Loop, StepCoefficients, checked
from dehyst._types import Array
from dehyst.control.clamping import warn_of_sample
from dehyst.control.limits import VoltageLimits
from dehyst.control.snapshot import Snapshot
from dehyst.model import Actuator

# Of the largest change: a smaller one is not clamped.
_NEARLY = 1 - 1e-9


def step_numbers(
    actuator: Actuator, limits: VoltageLimits, period: float | None
) -> tuple[StepCoefficients, tuple[float, float, float, float, float, float, float]]:
    """Return the coefficients of a step, and the limits, the largest change [V] and the amplifier's numbers.

    Raise `ModelError` if a period is missing, too long for a resonance, or too short for the slew rate.
    """
    model, slew = actuator.model, limits.slew_rate
    if period is None and (model.needs_time or slew is not None):
        raise ModelError("creep, inertia, a lag or a slew rate need the time between steps; give period= [s]")
    seconds = 0.0 if period is None else period
    pace = model.step_coefficients(np.array([0, 1]), np.array([seconds]))
    most = float(np.finfo(np.float64).max)
    change = most if slew is None else min(slew * seconds, most)
    if change <= 0:
        raise ModelError(f"slew_rate: {slew:g} V/s allow no change in {seconds:g} s; give more, or a longer period")
    return pace, (limits.low, limits.high, change, *model.amplifier(seconds))


def make_loop(actuator: Actuator, limits: VoltageLimits, period: float | None, taps: Array, start: CoreState) -> Loop:
    """Return a loop that starts in a state and warns of clamped samples; raise `ModelError` as `step_numbers`."""
    pace, numbers = step_numbers(actuator, limits, period)
    return actuator.model.core.loop(pace, taps, np.array(numbers), partial(warn_of_sample, actuator, limits), start)


def resume(loop: Loop, actuator: Actuator, limits: VoltageLimits, key: str, snapshot: Snapshot) -> None:
    """Set a loop to a snapshot; `key` identifies the loop. After an error the loop is as before.

    Raise `ModelError` if the snapshot is of another actuator, period or preview, or damaged.
    """
    if not isinstance(snapshot, Snapshot):
        raise ModelError(f"snapshot: got {type(snapshot).__name__}, need a Snapshot; Snapshot.load reads a file")
    if snapshot.key != key:
        raise ModelError("snapshot: it is of another actuator, period or preview; make the compensator as it was")
    state = actuator.model.core_state(actuator.model.complete_state(snapshot.state))
    if snapshot.rest.size != loop.rest().size:
        raise ModelError(f"snapshot: got {snapshot.rest.size} numbers beside the state, need {loop.rest().size}")
    if not limits.low <= snapshot.rest[0] <= limits.high:
        raise ModelError(f"snapshot: its voltage, {snapshot.rest[0]:g} V, lies outside the limits {limits.words}")
    before = loop.state(), loop.rest(), loop.counts()
    checked(loop.begin, *state)
    try:
        checked(loop.go_on, snapshot.rest, *snapshot.counts)
    except ModelError:
        loop.begin(*before[0])
        loop.go_on(before[1], *before[2])
        raise


def reached_if_clamped(loop: Loop, limits: VoltageLimits, period: float | None, voltage: float) -> float | None:
    """Return the displacement w [m] that a `voltage` on offer leads to if it was clamped, else None.

    The loop has nothing on offer afterwards if the result is a number; it is as before otherwise.
    """
    change = float("inf") if limits.slew_rate is None or period is None else limits.slew_rate * period
    if limits.low < voltage < limits.high and abs(voltage - loop.sent()) < _NEARLY * change:
        return None
    before = loop.state(), loop.rest(), loop.counts()
    loop.commit(voltage)
    clamped, reached = loop.counts()[:2] != before[2][:2], float(loop.state()[0])
    loop.begin(*before[0])
    loop.go_on(before[1], *before[2])
    return reached if clamped else None
