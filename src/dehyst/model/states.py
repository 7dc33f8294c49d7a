"""Ranges and states of an actuator: values far outside of a range, slow motions, and the start of a motion."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._native import EMPTY
from dehyst._types import Array
from dehyst._validation import number
from dehyst._views.lines import ends
from dehyst.model.base import AbstractModel, Motion, State
from dehyst.records import Record

if TYPE_CHECKING:
    from dehyst.model.actuator import Actuator

# A displacement with more than this multiple of the largest magnitude of the range is probably in this unit.
_UNITS = ((1e2, "millimetres"), (3e4, "micrometres"), (3e7, "nanometres"))
# Voltages beyond those of the records by at most this part of their range count as recorded.
_AS_RECORDED = 0.02
ANYWAY = "or extrapolate to compute it anyway"
# Duration of a step in longest time constants of creep: the strains at its end are 1e-9 of the step.
_REST = 1e9
# Number of visits of the limits in slow loops: smooth elements forget their start slowly.
_VISITS = 60
_ROUNDING = 1e-12
# A state with a voltage beyond the limits by less than this part of their range counts as at the limit.
NEAR = 0.01


def demand_recorded(actuator: Actuator) -> None:
    """Raise `ModelError` if the limits exceed the voltages of the records by over 2 % of their range."""
    tested = actuator.identification.validity
    if actuator.limits is None or tested is None:
        return
    recorded = Range(*tested.limits)
    margin = _AS_RECORDED * tested.span
    allowed = Range(recorded.low - margin, recorded.high + margin)
    if allowed.joined(actuator.limits) != allowed:
        raise ModelError(
            argument="limits",
            got="{:.6g} to {:.6g} V".format(*actuator.limits),
            need=f"{allowed.low:.6g} to {allowed.high:.6g} V or less, as the records have {ends(*recorded, 'V')}",
            hint="give wider limits where a path is planned, or record these voltages and identify again",
        )


class Range(NamedTuple):
    """Range of displacements [m] or voltages [V] of a model, the lower end first."""

    low: float
    high: float

    def joined(self, *others: tuple[float, float]) -> Range:
        """Return the smallest range that covers this one and the others."""
        return Range(min([self.low, *(low for low, _ in others)]), max([self.high, *(high for _, high in others)]))

    def far_ends(self, values: ArrayLike) -> tuple[float, float] | None:
        """Return the least and the largest of values (n,) if one lies outside of the range by more than its width."""
        if not np.size(values):
            return None
        low, high, width = float(np.min(values)), float(np.max(values)), self.high - self.low
        return (low, high) if low < self.low - width or high > self.high + width else None


def needs_time(actuator: Actuator) -> bool:
    """Return whether the answers of an actuator depend on the time of each sample."""
    return actuator._evaluator.needs_time


def creep_times(actuator: Actuator) -> Array:
    """Return the time constants [s] of creep; empty without creep."""
    return EMPTY if actuator.displacement_creep is None else actuator.displacement_creep.time_constants


def at_rest(actuator: Actuator) -> float:
    """Return the ratio of the displacement with creep at rest to the displacement without creep."""
    return 1.0 if actuator.displacement_creep is None else actuator.displacement_creep.at_rest


def knots_of(actuator: Actuator) -> tuple[float, float]:
    """Return the displacements [m] at the first and the last knot of the spring, creep at rest."""
    first, last = actuator.spring.displacement[[0, -1]].tolist()
    return at_rest(actuator) * first, at_rest(actuator) * last


def quasistatic(actuator: Actuator) -> Actuator:
    """Return the actuator without inertia and amplifier lag, for slow motions."""
    return replace(actuator, dynamics=None, lag=0.0, state=replace(actuator.state, motion=EMPTY))


def major_loop(actuator: Actuator, limits: tuple[float, float]) -> tuple[float, float]:
    """Return the displacements [m] of slow loops at both `limits` [V], with creep at rest."""
    low, high = slow_motion(actuator, np.tile(limits, _VISITS)).displacement[-2:].tolist()
    return low, high


def at_reference(actuator: Actuator, record: Record) -> Record:
    """Return a `record` of one axis, corrected to the reference temperature of `thermal`.

    Without this part, or if the record has no temperature, the record is returned unchanged.
    """
    if actuator.thermal is None or record.temperature is None:
        return record
    return replace(record, displacement=actuator.thermal.at_reference(record.displacement, record.temperature))


def slow_motion(actuator: Actuator, voltage: Array, state: State | None = None) -> Motion:
    """Return the motion through voltages (n,) [V], with creep at rest at each, and without inertia and lag.

    `state`: state before the first voltage, without motion; default: the state of the actuator.
    """
    rest = _REST * float(creep_times(actuator).max(initial=0.0)) or 1.0
    time = np.arange(voltage.size) * rest
    return quasistatic(actuator).simulate(voltage, time=time, state=state, extrapolate=True)


def displacement_error(got: tuple[float, float], displacements: Range) -> str:
    """Return the message for displacements [m] far outside of the range of a model."""
    width = displacements.high - displacements.low
    ratio = max(map(abs, got)) / max(abs(displacements.low), abs(displacements.high), width)
    reaches = f"the model reaches {ends(1e6 * displacements.low, 1e6 * displacements.high, 'um')}"
    if ratio <= _UNITS[0][0]:
        return (
            f"displacement: got {ends(1e6 * got[0], 1e6 * got[1], 'um')}, {reaches}; both count from the sensor's zero "
            "in the records that it was identified from"
        )
    unit = [name for least, name in _UNITS if ratio > least][-1]
    return f"displacement: got {ends(*got, 'm')}, {reaches}; is this in {unit}?"


def voltage_error(got: tuple[float, float], identified: Range) -> str:
    """Return the message for voltages [V] far outside of the voltages of the records."""
    return (
        f"voltage: got {ends(*got, 'V')}, the records of the model have {ends(*identified, 'V')}; "
        "check the unit, and that the model is of this actuator"
    )


def stroke_of(actuator: Actuator) -> float:
    """Return the full stroke [m]: the range of the widest loop of the records; without records, of `reach`."""
    tested = actuator.identification.validity
    return float(np.ptp(actuator.reach)) if tested is None else tested.stroke


def voltages_of(actuator: Actuator) -> Range:
    """Return the limits [V]; without limits, the voltage range of the largest loop within the spring's knots."""
    return actuator._voltages


def turned(actuator: Actuator, displacement: float, *, rising: bool = True) -> State:
    """Return the state after a long motion that ends at a `displacement` [m]: every cart has slid (Assumption II).

    Every smooth element has yielded fully. Creep is at rest, as after a slow motion. `rising`: whether the motion went
    up.
    """
    side = 1 if rising else -1
    smooth = EMPTY if actuator.smooth is None else side * actuator.smooth.length
    w = number(displacement, "displacement") / at_rest(actuator)
    return State(w, w - side * actuator.slip.breakaway, smooth=smooth)


def state_within_limits(actuator: Actuator, state: State, limits: tuple[float, float]) -> State:
    """Return the complete state; if its voltage lies outside the limits [V], moved to the nearest limit and at rest.

    Raise `ModelError` if it is not a state of this actuator.
    """
    start = actuator._evaluator.complete_state(state)
    present = actuator.voltage(start)
    nearest = min(max(present, limits[0]), limits[1])
    if abs(present - nearest) <= _ROUNDING * (limits[1] - limits[0]):
        return start
    slow = quasistatic(actuator)
    reached = slow.simulate([nearest], time=np.zeros(1), state=replace(start, motion=EMPTY), extrapolate=True).state
    return actuator._evaluator.complete_state(reached)


def state_after_loops(actuator: Actuator, state: State, limits: tuple[float, float]) -> State:
    """Return a state; if its voltage lies outside the limits [V], the state after slow major loops between them.

    The loops end at the limit next to the state. In a state beyond the limits, elements have slid farther than voltages
    within the limits can move them, so the actuator cannot reach this state.
    """
    low, high = limits
    present, near = actuator.voltage(state), NEAR * (high - low)
    return state if low - near <= present <= high + near else looped(actuator, limits, rising=present > high)


def looped(actuator: Actuator, limits: tuple[float, float], *, rising: bool) -> State:
    """Return the state after slow major loops between limits [V], at the upper one if `rising`, with creep at rest."""
    reached = slow_motion(actuator, np.tile(limits if rising else limits[::-1], _VISITS)).state
    # A slow motion leaves out the mass: its motion is set to rest.
    return actuator._evaluator.complete_state(replace(reached, motion=EMPTY))


def standing(actuator: Actuator, voltage: float, limits: tuple[float, float]) -> State:
    """Return the state at rest at a voltage [V], after slow major loops between limits [V] that end at the nearer one.

    It represents an unknown state where a displacement is shown: the middle of all possible states may lie far outside
    of the displacements that the limits allow.
    """
    state = looped(actuator, limits, rising=voltage > 0.5 * sum(limits))
    return state_within_limits(actuator, state, (voltage, voltage))


def state_at(actuator: Actuator, state: State, displacement: float) -> State:
    """Return the state after a motion to a displacement [m] that is slow for mass and amplifier but fast for creep.

    Raise `ModelError` if it is not a state of this actuator.
    """
    slow, start = quasistatic(actuator), actuator._evaluator.complete_state(state)
    still = replace(start, motion=EMPTY)
    return actuator._evaluator.complete_state(
        slow.compensate([displacement], time=np.zeros(1), state=still, extrapolate=True).state
    )


def timed(model: AbstractModel, time: Array) -> dict[str, Any]:
    """Return the keywords for a record with `time` (n,) [s]: it may exceed the training range of an actuator."""
    from dehyst.model.actuator import Actuator

    return {"time": time} | ({"extrapolate": True} if isinstance(model, Actuator) else {})


def beginning(model: AbstractModel, voltage: Array) -> Any:
    """Return the initial state for a voltage (n,) [V]: the nearest end of a loop; None for another kind of model.

    A distant start would make a mass ring. An actuator with creep starts relaxed, as before the records, because its
    later motion depends on the initial strain.
    """
    from dehyst.model.actuator import Actuator

    if not isinstance(model, Actuator) or not voltage.size:
        return None
    if creep_times(model).size:
        return model.relaxed(float(voltage[0]), extrapolate=True)
    low, high = (float(end) for end in model.spring.displacement[[0, -1]])
    ends = [turned(model, high), turned(model, low, rising=False)]
    return min(ends, key=lambda state: abs(model.voltage(state) - float(voltage[0])))


def simulated(model: AbstractModel, voltage: Array, time: Array) -> Motion:
    """Return the motion of any `model` for a `voltage` (n,) [V] at `time` (n,) [s], from its `beginning`."""
    return model.simulate(voltage, state=beginning(model, voltage), **timed(model, time))
