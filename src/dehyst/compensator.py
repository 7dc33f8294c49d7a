"""Wanted displacement to a voltage that may leave the program: within limits and slew rate, clamped loudly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._errors import ModelError
from dehyst._native import Array, number, vector
from dehyst.actuator import Actuator, interval
from dehyst.model import State

Mask = NDArray[np.bool_]
_CHUNK = 64


@dataclass(frozen=True, eq=False)
class Command:
    """A voltage to send.

    Attributes
    ----------
    voltage : (n,) array
        [V], within limits and slew rate.
    displacement : (n,) array
        What the model does with it [m]: the wanted path, but where the voltage was clamped.
    clamped : (n,) bool array
        Samples whose voltage was changed.
    state : State
        The state that the clamped voltage leads to.
    warnings : tuple of str
        What was clamped, in sentences; empty if nothing was.
    """

    voltage: Array
    displacement: Array
    clamped: Mask
    state: State
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class Compensator:
    """Inverse control within limits (Eqs. 11-12).

    Parameters
    ----------
    actuator : Actuator
    limits : (float, float), optional
        Lowest and highest voltage [V]; default: the actuator's, which are those of its training records.
    slew_rate : float, optional
        Largest abs(dv/dt) [V/s] between samples; default: not limited.

    Raises
    ------
    ModelError
        If there are no limits at all, or they are no interval, or the slew rate is not positive.
    """

    actuator: Actuator
    limits: tuple[float, float] | None = None
    slew_rate: float | None = None

    def __post_init__(self) -> None:
        limits = self.actuator.limits if self.limits is None else self.limits
        if limits is None:
            raise ModelError("no voltage limits: the actuator has none and none were given; give limits=(low, high)")
        object.__setattr__(self, "limits", interval(limits))
        if self.slew_rate is not None and number(self.slew_rate, "slew_rate") <= 0:
            raise ModelError(f"slew_rate: got {self.slew_rate}, need a positive number of volts a second")

    def trajectory(
        self, displacement: ArrayLike, *, time: ArrayLike | None = None, state: State | None = None
    ) -> Command:
        """Voltages for a path, each clamped with the state kept true: what follows knows what was really sent.

        Parameters
        ----------
        displacement : (n,) array_like
            Wanted displacement [m].
        time : (n,) array_like, optional
            [s], strictly increasing; needed with a slew rate.
        state : State, optional
            Where the actuator is; default the actuator's own. The first sample is not slew limited.

        Raises
        ------
        ModelError
            If the arrays do not fit, or a slew rate is given without time.
        """
        wanted = vector(displacement, "displacement")
        steps = self._steps(wanted.size, time)
        start = self.actuator.state if state is None else state
        voltage, reached = np.empty_like(wanted), np.empty_like(wanted)
        clamped = np.zeros(wanted.size, dtype=bool)
        i, chunk = 0, _CHUNK
        while i < wanted.size:
            stop = min(i + chunk, wanted.size)
            motion = self.actuator.compensate(wanted[i:stop], state=start)
            before = voltage[i - 1] if i else motion.voltage[0]
            allowed = self._allowed(motion.voltage, before, steps[i:stop])
            bad = np.flatnonzero(allowed != motion.voltage)
            good = int(bad[0]) if bad.size else stop - i
            voltage[i : i + good], reached[i : i + good] = motion.voltage[:good], wanted[i : i + good]
            if not bad.size:
                i, start, chunk = stop, motion.state, 2 * chunk
                continue
            if good:
                start = self.actuator.compensate(wanted[i : i + good], state=start).state
            i += good
            sent = self.actuator.simulate(allowed[good : good + 1], state=start)
            voltage[i], reached[i], clamped[i] = sent.voltage[0], sent.displacement[0], True
            i, start, chunk = i + 1, sent.state, _CHUNK
        return Command(voltage, reached, clamped, start, self._warnings(voltage, wanted, reached, clamped))

    def _steps(self, size: int, time: ArrayLike | None) -> Array:
        """Largest voltage step before each sample."""
        if self.slew_rate is None:
            return np.full(size, np.inf)
        if time is None:
            raise ModelError("a slew rate needs the time of each sample; give time=")
        t = vector(time, "time")
        if t.size != size or np.any(np.diff(t) <= 0):
            raise ModelError(f"time: got {t.size} values for {size} samples, need as many, strictly increasing")
        return np.concatenate([[np.inf], self.slew_rate * np.diff(t)])[:size]

    def _allowed(self, voltage: Array, before: float, steps: Array) -> Array:
        """The wish, clipped; right up to the first sample that is changed."""
        low, high = self.limits  # type: ignore[misc]
        previous = np.concatenate([[before], voltage[:-1]])
        # Limits come last: slew may not push a voltage out of them.
        return np.clip(np.clip(voltage, previous - steps, previous + steps), low, high)

    def _warnings(self, voltage: Array, wanted: Array, reached: Array, clamped: Mask) -> tuple[str, ...]:
        return (*self._clamps(voltage, wanted, reached, clamped), *self._extrapolates(voltage))

    def _extrapolates(self, voltage: Array) -> tuple[str, ...]:
        if self.actuator.limits is None:
            return ()
        low, high = self.actuator.limits
        count = int(np.count_nonzero((voltage < low) | (voltage > high)))
        if not count:
            return ()
        return (f"{count} voltages lie outside the identified range {low:.6g} to {high:.6g} V: extrapolated",)

    def _clamps(self, voltage: Array, wanted: Array, reached: Array, clamped: Mask) -> tuple[str, ...]:
        count = int(np.count_nonzero(clamped))
        if not count:
            return ()
        low, high = self.limits  # type: ignore[misc]
        at_limit = int(np.count_nonzero(clamped & ((voltage <= low) | (voltage >= high))))
        first, miss = int(np.flatnonzero(clamped)[0]), float(np.abs(wanted - reached).max())
        why = f"{at_limit} at the limits {low:.6g} to {high:.6g} V, {count - at_limit} by the slew rate"
        return (
            f"CLAMPED: {count} of {voltage.size} voltages ({why}), the first at sample {first}; the path is missed by "
            f"up to {miss * 1e6:.4g} um",
        )
