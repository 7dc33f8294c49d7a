"""Voltages that follow a whole path within limits and slew rate, from a known state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._native import CoreState
from dehyst._types import Array, Mask
from dehyst._validation import vector
from dehyst.control.axis import Axis
from dehyst.control.limits import TIME_NEEDED, VoltageLimits
from dehyst.model import Actuator, PathData, State, evaluator_of, needs_time

_CHUNK = 64
_UNLIMITED = float(np.finfo(np.float64).max)
# The code of `Loop.trace` for an offer that was not clamped.
_NOT_CLAMPED = 1
_ROUNDING = 1e-12
# Largest number of runs of equal steps for which a loop is set up.
_FEW = 64


class Followed(NamedTuple):
    """Voltages (n,) [V] within limits and slew rate, and what they cause.

    `displacement` (n,) [m]: the wanted path except where the voltage was clamped; simulated for an actuator with
    dynamics or a lag. `clamped` (n,): samples whose voltage was changed. `state`: after the last sample.
    """

    voltage: Array
    displacement: Array
    clamped: Mask
    state: State


def follow(
    axis: Axis,
    displacement: ArrayLike,
    *,
    state: State | None = None,
    present: float | None = None,
    time: ArrayLike | None = None,
    period: float | None = None,
    temperature: ArrayLike | None = None,
    velocity: Array | None = None,
    acceleration: Array | None = None,
) -> Followed:
    """Return the voltages of a path (n,) [m] from a `state`, by default the present one; the memory is unchanged.

    `present` [V]: before the first sample; default: the voltage that holds a given `state`, or without a `state` the
    last voltage sent. `time` (n,) [s]: needed with a slew rate, and by an actuator that depends on time; default: a
    sample every period. `period` [s]: time from the present voltage to the first sample, if shorter than the first
    step; default: that of the axis. `temperature` [degC]: replaces gain and offset of the axis. `velocity` [m/s],
    `acceleration` [m/s^2]: as in `Actuator.compensate`.
    """
    wanted = vector(displacement, "displacement")
    gain, offset = axis.scaling(temperature, wanted.size)
    rates = [None if values is None else values / gain for values in (velocity, acceleration)]
    if time is None and axis.period is not None:
        time = axis.period * np.arange(wanted.size)
    period = axis.period if period is None else period
    if present is None:
        present = axis.voltage if state is None else axis.held(state)
    begin, now = axis.state if state is None else state, axis.bounds.within(present, "present")
    plain = np.ndim(gain) == 0 and (gain, offset) == (1.0, 0.0)
    target = wanted if plain else (wanted - offset) / gain
    found = _follow(axis.actuator, axis.bounds, target, time, period, rates, begin, now)
    if plain:
        return found
    reached = np.where(found.displacement == target, wanted, offset + gain * found.displacement)
    return found._replace(displacement=reached)


def _follow(
    actuator: Actuator,
    limits: VoltageLimits,
    wanted: Array,
    time: ArrayLike | None,
    period: float | None,
    rates: Sequence[Array | None],
    start: State,
    present: float,
) -> Followed:
    """Return the voltages of a path of the model (n,) [m]; `rates`: its velocity and its acceleration."""
    steps = limits.steps(wanted.size, time, period)
    path, state = _Path(actuator, wanted, time, *rates), evaluator_of(actuator).complete_state(start)
    # `clock` raises if the time is missing or does not fit. With few runs of equal steps and without dynamics, the
    # samples after a clamped one are computed step by step.
    moves, rings = evaluator_of(actuator).has_dynamics, False
    steps_on = path.clock[1].size <= _FEW and not moves
    voltage, reached = np.empty_like(wanted), np.empty_like(wanted)
    clamped = np.zeros(wanted.size, dtype=bool)
    i, chunk = 0, _CHUNK
    # The state after the voltages that were sent, and the number of the next sample.
    real, after = state, 0
    while i < wanted.size:
        stop = min(i + chunk, wanted.size)
        candidate, planned = path.compensate(i, stop, state)
        allowed = limits.allowed(candidate, voltage[i - 1] if i else present, steps[i:stop])
        # The rounding of a voltage on a limit does not count as clamping.
        changed = np.flatnonzero(np.abs(allowed - candidate) > _ROUNDING * (limits.high - limits.low))
        end = i + int(changed[0]) if changed.size else stop
        voltage[i:stop], reached[i:end], clamped[end:stop] = allowed, wanted[i:end], np.arange(end, stop) == end
        chunk, rings = (_CHUNK, moves) if changed.size else (2 * chunk, rings)
        begin, i = i, min(end + 1, stop)
        if rings:
            # After a clamped voltage, a mass is not at the wanted displacement, and moves the elements.
            state = real = path.simulate(voltage, after, i, real)[1]
            after = i
        elif not changed.size:
            state = planned
        else:
            state = path.compensate(begin, end, state)[1] if end > begin else state
            reached[end], state = path.simulate(voltage, end, i, state)
        if steps_on and changed.size:
            # Other clamped samples will follow soon: compute the rest sample by sample.
            voltage[i:], reached[i:], clamped[i:], state = path.step(i, voltage[i - 1], state, limits)
            break
    if moves:
        motion = actuator.simulate(voltage, time=time, state=start, extrapolate=True)
        reached, state = motion.displacement, motion.state
    return Followed(voltage, reached if moves or clamped.any() else wanted, clamped, state)


@dataclass(frozen=True, eq=False)
class _Path:
    """A wanted path, followed in pieces that begin in the state at the sample before."""

    actuator: Actuator
    wanted: Array
    time: ArrayLike | None
    velocity: ArrayLike | None
    acceleration: ArrayLike | None

    @cached_property
    def clock(self) -> tuple[NDArray[np.int64], Array]:
        """Runs of equal steps, see `Evaluator.clock`."""
        return evaluator_of(self.actuator).clock(self.time, self.wanted.size, TIME_NEEDED)

    @cached_property
    def data(self) -> dict[str, Array]:
        """The given values of time and derivatives that have an effect, one for each sample."""
        columns = {"time": self.time}
        if self.actuator.dynamics is not None:
            data = PathData(self.time, None, self.velocity, self.acceleration)
            columns["velocity"], columns["acceleration"] = evaluator_of(self.actuator).derivatives(self.wanted, data)
        return {name: vector(values, name) for name, values in columns.items() if values is not None}

    def compensate(self, i: int, stop: int, start: State) -> tuple[Array, State]:
        """Return the voltages of samples i to stop - 1, from the state at sample i - 1, and the final state."""
        voltage, state = self._piece(i, stop, start)
        if self.actuator.lag and stop < self.wanted.size:
            # A lag needs the slope of the voltage, which the last sample of a piece has from one side only.
            voltage = self._piece(i, stop + 1, start)[0][:-1]
        return voltage, state

    def _piece(self, i: int, stop: int, start: State) -> tuple[Array, State]:
        path, time = PathData(**{name: values[i:stop] for name, values in self.data.items()}), self.data.get("time")
        since = 0.0 if time is None or not i else float(time[i] - time[i - 1])
        return evaluator_of(self.actuator).compensate(self.wanted[i:stop], path, start, True, since)

    def simulate(self, voltage: Array, i: int, stop: int, start: State) -> tuple[float, State]:
        """Return displacement and state after the voltages of samples i to stop - 1, from the state at sample i - 1."""
        # If time matters, a lag needs the voltage before too.
        piece = slice(max(i - 1, 0) if needs_time(self.actuator) else i, stop)
        data: dict[str, Any] = {name: self.data[name][piece] for name in ("time",) if name in self.data}
        motion = self.actuator.simulate(voltage[piece], **data, state=start, extrapolate=True)
        return float(motion.displacement[-1]), motion.state

    def step(self, first: int, before: float, start: State, limits: VoltageLimits) -> tuple[Array, Array, Mask, State]:
        """Step through the samples from `first`; return voltages, displacements, clamped samples and the state."""
        model, n, state = evaluator_of(self.actuator), self.wanted.size, start
        bounds, durations = self.clock
        voltage, reached, offers = np.empty(n), np.empty(n), np.empty(n)
        for r, seconds in enumerate(durations):
            run = slice(max(int(bounds[r]), first), int(bounds[r + 1]))
            if run.start >= run.stop:
                continue
            change = _UNLIMITED if limits.slew_rate is None else limits.slew_rate * seconds
            numbers = np.array([limits.low, limits.high, change, 0.0, 0.0, 0.0, 1.0])
            coefficients = model.step_coefficients(np.array([0, 1]), np.array([seconds]))
            loop = model.core.loop(coefficients, np.ones(1), numbers, lambda *_: None, model.core_state(state))
            rest = [before, before, before, before, 0.0, 1.0, 0.0, state.deformation, self.wanted[run.start - 1]]
            loop.go_on(np.array(rest), 0, 0, 0)
            voltage[run], reached[run], offers[run] = loop.trace(self.wanted[run])
            before, state = float(voltage[run.stop - 1]), model.state_of(CoreState(*loop.state()))
        clamped = (offers != _NOT_CLAMPED)[first:]
        clamped &= np.abs(reached - self.wanted)[first:] > _ROUNDING * float(np.ptp(model.spring.displacement))
        reached = np.where(clamped, reached[first:], self.wanted[first:])
        return voltage[first:], reached, clamped, state
