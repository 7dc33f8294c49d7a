"""Wanted displacement to a voltage that may leave the program: within limits and slew rate, clamped loudly."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._errors import ModelError
from dehyst._native import Array, number, untimely, vector
from dehyst.actuator import Actuator, interval
from dehyst.model import Motion, State
from dehyst.wide import Course

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
        What the model does with it [m]: the wanted path, but where the voltage was clamped; with dynamics or a lag,
        simulated.
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
        self,
        displacement: ArrayLike,
        *,
        time: ArrayLike | None = None,
        load: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        state: State | None = None,
    ) -> Command:
        """Voltages for a path, each clamped with the state kept true: what follows knows what was really sent.

        Parameters
        ----------
        displacement : (n,) array_like
            Wanted displacement [m].
        time : (n,) array_like, optional
            [s], strictly increasing; needed with a slew rate, and by an actuator with creep, dynamics or a lag.
        load, velocity, acceleration : (n,) array_like, optional
            As in `Actuator.compensate`.
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
        path = _Path(self.actuator, wanted, time, load, velocity, acceleration)
        voltage, reached = np.empty_like(wanted), np.empty_like(wanted)
        clamped = np.zeros(wanted.size, dtype=bool)
        i, chunk = 0, _CHUNK
        while i < wanted.size:
            stop = min(i + chunk, wanted.size)
            wish, after = path.followed(i, stop, start)
            before = voltage[i - 1] if i else wish[0]
            allowed = self._allowed(wish, before, steps[i:stop])
            bad = np.flatnonzero(allowed != wish)
            good = int(bad[0]) if bad.size else stop - i
            voltage[i : i + good], reached[i : i + good] = wish[:good], wanted[i : i + good]
            if not bad.size:
                i, start, chunk = stop, after, 2 * chunk
                continue
            if good:
                start = path.followed(i, i + good, start)[1]
            i += good
            voltage[i], clamped[i] = allowed[good], True
            reached[i], start = path.sent(voltage, i, start)
            i, chunk = i + 1, _CHUNK
        if path.moves_on:
            motion = path.played(voltage, self.actuator.state if state is None else state)
            reached, start = motion.displacement, motion.state
        return Command(voltage, reached, clamped, start, self._warnings(voltage, wanted, reached, clamped))

    def _steps(self, size: int, time: ArrayLike | None) -> Array:
        """Largest voltage step before each sample."""
        if self.slew_rate is None:
            return np.full(size, np.inf)
        if time is None:
            raise ModelError("a slew rate needs the time of each sample; give time=")
        t = vector(time, "time")
        if t.size != size or np.any(np.diff(t) <= 0):
            raise ModelError(untimely(t, size))
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


@dataclass(frozen=True, eq=False)
class _Path:
    """A wanted path, followed in pieces. In time a piece begins with the sample at which the last one ended."""

    actuator: Actuator
    wanted: Array
    time: ArrayLike | None
    load: ArrayLike | None
    velocity: ArrayLike | None
    acceleration: ArrayLike | None

    @property
    def moves_on(self) -> bool:
        """Whether a mass or an amplifier still answers what was clamped before."""
        return self.actuator.dynamics is not None or self.actuator.lag > 0

    @cached_property
    def course(self) -> dict[str, Array | None]:
        """What goes with the path, a value a sample."""
        found = {"time": self.time, "load": self.load}
        if self.actuator.dynamics is not None:
            along = Course(self.time, self.load, self.velocity, self.acceleration)
            found["velocity"], found["acceleration"] = self.actuator.model.derivatives(self.wanted, along)
        return {name: None if values is None else vector(values, name) for name, values in found.items()}

    @cached_property
    def lead(self) -> Array:
        """W less the path [m]."""
        return self.actuator.model.lead(self.wanted, Course(**self.course))

    def followed(self, i: int, stop: int, start: State) -> tuple[Array, State]:
        """Voltages of samples i to stop - 1, from the state at sample i - 1, and the state at the last."""
        if not self.actuator.wide:
            motion = self.actuator.compensate(self.wanted[i:stop], load=self.load, state=start)
            return motion.voltage, motion.state
        motion = self._piece(i, stop, start)
        voltage = motion.voltage
        if self.actuator.lag and stop < self.wanted.size:
            # A lag asks for the slope of the voltage, which a piece's last sample knows from one side only.
            voltage = self._piece(i, stop + 1, start).voltage[:-1]
        return voltage[min(i, 1) :], motion.state

    def sent(self, voltage: Array, i: int, start: State) -> tuple[float, State]:
        """Where the voltage of sample i leads."""
        first = i if not self.actuator.wide else max(i - 1, 0)
        motion = self.actuator.simulate(voltage[first : i + 1], **self._cut(first, i + 1), state=start)
        return float(motion.displacement[-1]), motion.state

    def played(self, voltage: Array, start: State) -> Motion:
        """What the whole command does."""
        return self.actuator.simulate(voltage, time=self.time, load=self.load, state=start)

    def _piece(self, i: int, stop: int, start: State) -> Motion:
        first = max(i - 1, 0)
        path = self.wanted[first:stop].copy()
        if i:
            path[0] = start.displacement - self.lead[first]
        along: dict[str, Any] = {
            name: None if values is None else values[first:stop] for name, values in self.course.items()
        }
        return self.actuator.compensate(path, **along, state=start)

    def _cut(self, first: int, stop: int) -> dict[str, Any]:
        if not self.actuator.wide:
            return {}
        return {name: values[first:stop] for name in ("time", "load") if (values := self.course[name]) is not None}
