"""Wanted displacement to voltage, sample by sample or a whole path: within limits, the memory kept true."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._native import CoreError, CoreState, Loop, checked
from dehyst._types import Array
from dehyst._validation import interval, number, vector
from dehyst.control.limits import VoltageLimits
from dehyst.control.preview import Preview
from dehyst.control.reachable import reachable_range, state_within_limits
from dehyst.control.snapshot import Snapshot, key_of
from dehyst.control.trajectory import Command, follow
from dehyst.model import Actuator, State
from dehyst.model.plausibility import ANYWAY
from dehyst.model.python_control import compensator_block, labels

if TYPE_CHECKING:
    from control import NonlinearIOSystem


class ClampWarning(UserWarning):
    """A wanted displacement was not followed: its voltage was cut at a limit or held back by the slew rate."""


class Clamps(NamedTuple):
    """Samples whose voltage was cut at a limit, and held back by the slew rate."""

    limited: int
    slewed: int


class Compensator:
    """Inverse control within limits (Eqs. 11-12), the hysteresis cancelled.

    In a loop, `step` takes the displacement wanted now and returns the voltage to send. What cannot be reached is
    clamped, counted and said, and the memory follows the voltage that is really sent::

        compensator = dehyst.Compensator(actuator, (0, 100), slew_rate=2e4, period=1e-4)
        for wanted in path:
            dac.write(compensator.step(wanted))

    Where writing may fail or change the voltage, `offer` and `commit` take the place of `step`.

    Parameters
    ----------
    actuator : Actuator
    limits : (float, float), optional
        Lowest and highest voltage [V]; default: the actuator's, which are those of its training records.
    slew_rate : float, optional
        Largest abs(dv/dt) [V/s] between samples; default: not limited.
    period : float, optional
        Seconds between steps; needed with a slew rate or `preview`, and by an actuator with creep, dynamics or a lag.
    state : State, optional
        Where the actuator is, say as a homing leaves it; default the actuator's own. If it is held by a voltage outside
        the limits, it is taken to have been brought to the nearest limit.
    preview : bool, optional
        Make up for the actuator's delay and inertia too. The displacement given to a step is then the one wanted
        `samples_ahead` samples later. By default it is the one wanted now, and delay and inertia are left alone.

    Attributes
    ----------
    actuator, slew_rate, period, preview
        As given.
    limits : (float, float)
        [V].

    Raises
    ------
    ModelError
        If there are no limits at all, or they are no interval, a number is not positive, the state does not fit the
        actuator, or a period is missing or too long for a resonance.
    """

    def __init__(
        self,
        actuator: Actuator,
        limits: Sequence[float] | None = None,
        slew_rate: float | None = None,
        *,
        period: float | None = None,
        state: State | None = None,
        preview: bool = False,
    ) -> None:
        if not isinstance(actuator, Actuator):
            raise ModelError(f"actuator: got {type(actuator).__name__}, need an Actuator")
        low_high = actuator.limits if limits is None else limits
        if low_high is None:
            raise ModelError("no voltage limits: the actuator has none and none were given; give limits=(low, high)")
        self._actuator, self._preview = actuator, bool(preview)
        self._limits = VoltageLimits(*interval(low_high), slew_rate)
        self._period = None if period is None else _positive(period)
        if preview and period is None:
            raise ModelError("preview needs the time between steps; give period= [s]")
        self._given = actuator.state if state is None else state
        self._start = state_within_limits(actuator, self._given, self.limits)

    def __repr__(self) -> str:
        slew = "" if self.slew_rate is None else f", {self.slew_rate:g} V/s"
        period = "" if self.period is None else f", every {self.period:g} s"
        return (
            f"<Compensator of {self.actuator.name!r}, {self._limits.words}{slew}{period}, now at {self.voltage:.6g} V, "
            f"{self.clamps.limited} limited, {self.clamps.slewed} slewed>"
        )

    def __reduce__(self) -> tuple[Callable[..., Compensator], tuple[object, ...]]:
        """Copied and pickled with its memory."""
        made = self._actuator, self.limits, self.slew_rate, self._period, self._given, self._preview
        return _remade, (made, self.snapshot() if self._running else None)

    @property
    def actuator(self) -> Actuator:
        """The model of the actuator."""
        return self._actuator

    @property
    def period(self) -> float | None:
        """Seconds between steps."""
        return self._period

    @property
    def preview(self) -> bool:
        """Whether delay and inertia are made up for."""
        return self._preview

    @property
    def limits(self) -> tuple[float, float]:
        """Lowest and highest voltage [V]."""
        return self._limits.low, self._limits.high

    @property
    def slew_rate(self) -> float | None:
        """Largest abs(dv/dt) [V/s]."""
        return self._limits.slew_rate

    def step(self, displacement: float) -> float:
        """Voltage [V] to send for a displacement [m]; the memory takes it to be sent.

        Raises
        ------
        ModelError
            If the displacement is not finite: nothing has moved then, nor has time passed.

        Warns
        -----
        ClampWarning
            Once of limits and once of the slew rate. If the warning is made an error, nothing has moved.
        """
        try:
            return self._loop.step(displacement)
        except TypeError:
            return self._loop.step(number(displacement, "displacement"))
        except CoreError as error:
            raise _refusal(displacement) from error

    def offer(self, displacement: float) -> float:
        """Voltage [V] to send for a displacement [m]; nothing moves before `commit`. Raises and warns as `step`."""
        try:
            return self._loop.offer(displacement)
        except TypeError:
            return self._loop.offer(number(displacement, "displacement"))
        except CoreError as error:
            raise _refusal(displacement) from error

    def commit(self, voltage: float) -> None:
        """Take note that `voltage` [V] has been sent: the one on offer, or another that a converter made of it.

        Raises
        ------
        ModelError
            If it is not finite, or farther outside the limits than they are apart: nothing has moved then.
        """
        try:
            self._loop.commit(number(voltage, "voltage"))
        except CoreError as error:
            raise ModelError(
                f"voltage: got {voltage:g} V, which has nothing to do with the limits {self._limits.words}; need what "
                "was really sent, in volts"
            ) from error

    def hold(self) -> None:
        """Take note that a period has passed in which nothing was sent: the last voltage still acts."""
        self._loop.commit(self._loop.sent())

    def run(self, displacement: ArrayLike) -> Array:
        """Voltages (n,) [V] of so many steps, bit for bit, all taken to be sent.

        Parameters
        ----------
        displacement : (n,) array_like
            [m].

        Raises
        ------
        ModelError
            If a value is not finite: nothing has moved then.

        Warns
        -----
        ClampWarning
            As `step`.
        """
        wanted, before = vector(displacement, "displacement"), self.snapshot()
        voltage = self._loop.run(wanted)
        limited, slewed, refused = (int(n) for n in np.subtract(self._loop.counts(), before.counts))
        try:
            if refused:
                raise _refusal(float(wanted[np.argmax(np.abs(wanted))]))
            if limited or slewed:
                why = f"{limited} at the limits {self._limits.words}, {slewed} by the slew rate"
                words = self.strays(wanted)
                why += f". {words}" if words else ""
                warnings.warn(f"{limited + slewed} of {wanted.size} voltages clamped: {why}", ClampWarning, 2)
        except (ClampWarning, ModelError):
            self.restore(before)
            raise
        return voltage

    def trajectory(
        self,
        displacement: ArrayLike,
        *,
        time: ArrayLike | None = None,
        load: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        state: State | None = None,
        extrapolate: bool = False,
    ) -> Command:
        """Voltages for a whole path, which may be uneven in time and is known ahead; the loop's own memory stays.

        Each voltage is clamped with the state kept true: what follows knows what was really sent.

        Parameters
        ----------
        displacement : (n,) array_like
            Wanted displacement [m].
        time : (n,) array_like, optional
            [s], strictly increasing; needed with a slew rate, and by an actuator with creep, dynamics or a lag.
            Default: a sample every `period`, if the compensator has one.
        load, velocity, acceleration : (n,) array_like, optional
            As in `Actuator.compensate`.
        state : State, optional
            Where the actuator is; default: `self.state`, before any step as it was given. The first sample is not slew
            limited.
        extrapolate : bool, optional
            Follow a path too, as far as the limits allow, that lies more than one stroke outside of the reach of the
            actuator: as a rule it is in micrometres.

        Raises
        ------
        ModelError
            If the arrays do not fit, the path lies more than one stroke outside, or a time is needed and neither `time`
            nor `period` is given.
        """
        wanted = vector(displacement, "displacement")
        words = "" if extrapolate else self.strays(wanted, load)
        if words:
            raise ModelError(f"{words}; {ANYWAY}")
        return follow(
            self.actuator,
            self._limits,
            wanted,
            time=time,
            period=self.period,
            load=load,
            velocity=velocity,
            acceleration=acceleration,
            start=state if state is not None else self.state if self._running else self._given,
        )

    def strays(self, displacement: Array, load: ArrayLike | None = None) -> str:
        """Why displacements (n,) [m] cannot be meant, see `Actuator.implausibility`; what the limits allow can be."""
        return _strays(self.actuator, self._limits, displacement, load)

    @property
    def voltage(self) -> float:
        """The last voltage sent [V]; at first the one that holds the actuator in its state."""
        return self._loop.sent() if self._running else self._limits.nearest(self.actuator.voltage(self._start))

    @property
    def state(self) -> State:
        """Where the actuator is, by all that was sent."""
        return self.actuator.model.state_of(CoreState(*self._loop.state())) if self._running else self._start

    @property
    def clamps(self) -> Clamps:
        """How many samples were clamped so far."""
        return Clamps(*self._loop.counts()[:2]) if self._running else Clamps(0, 0)

    @property
    def asked_start(self) -> State:
        """The state that it was made or last reset in, before that was brought within the limits."""
        return self._given

    @property
    def samples_ahead(self) -> int:
        """How many samples before its time a displacement must be given to `step`; 0 without `preview`."""
        return self._foresight.ahead

    @cached_property
    def reach(self) -> tuple[float, float]:
        """Displacements [m] at the lower and the upper limit, once both have been visited and creep is at rest."""
        return reachable_range(self.actuator, self.limits)

    def reset(self, state: State | None = None) -> None:
        """Begin again in a state, by default the one of the construction; counts begin at 0.

        Raises
        ------
        ModelError
            If it does not fit the actuator.
        """
        if state is not None:
            self._start, self._given = state_within_limits(self.actuator, state, self.limits), state
        self.__dict__.pop("_loop", None)

    def snapshot(self) -> Snapshot:
        """All that the loop remembers, to be saved; `restore` goes on from it bit for bit."""
        return Snapshot(self._key, self.state, self._loop.rest(), self._loop.counts())

    def restore(self, snapshot: Snapshot) -> None:
        """Go on from a snapshot.

        Raises
        ------
        ModelError
            If it is of another actuator, period or preview, or damaged: the loop is as before then.
        """
        if not isinstance(snapshot, Snapshot):
            raise ModelError(f"snapshot: got {type(snapshot).__name__}, need a Snapshot; Snapshot.load reads a file")
        if snapshot.key != self._key:
            raise ModelError("snapshot: it is of another actuator, period or preview; make the compensator as it was")
        state = self.actuator.model.core_state(self.actuator.model.complete_state(snapshot.state))
        if snapshot.rest.size != self._loop.rest().size:
            raise ModelError(
                f"snapshot: got {snapshot.rest.size} numbers beside the state, need {self._loop.rest().size}"
            )
        if not self._limits.low <= snapshot.rest[0] <= self._limits.high:
            raise ModelError(
                f"snapshot: its voltage, {snapshot.rest[0]:g} V, lies outside the limits {self._limits.words}"
            )
        before = self._loop.state(), self._loop.rest(), self._loop.counts()
        checked(self._loop.begin, *state)
        try:
            checked(self._loop.go_on, snapshot.rest, *snapshot.counts)
        except ModelError:
            self._loop.begin(*before[0])
            self._loop.go_on(before[1], *before[2])
            raise

    def to_control(self, *, name: str = "compensator") -> NonlinearIOSystem:
        """A block for python-control: displacement wanted [m] in, voltage [V] out, from the present memory on.

        It is this compensator bit for bit and leaves it alone. All memory is in the block's state; `start` of the block
        is the present one, to be given as initial state. The voltage of a sample depends on the displacement of the
        same sample (direct feedthrough). Clamps are said, once of each kind, not counted.

        Parameters
        ----------
        name : str, optional
            Of the block; its input is called "wanted", its output "voltage".

        Returns
        -------
        control.NonlinearIOSystem
            In discrete time, of `period`; without one, of a period that is not told.

        Raises
        ------
        MissingExtraError
            If python-control is not installed.
        """
        loop, now = self._made_loop(), self.snapshot()
        loop.begin(*self.actuator.model.core_state(now.state))
        loop.go_on(now.rest, *now.counts)
        return compensator_block(loop, labels(self.actuator.model, self._foresight.taps.size), self.period, name)

    def afresh(self) -> Compensator:
        """Another one like it, as it was when made or last reset."""
        return Compensator(
            self.actuator, self.limits, self.slew_rate, period=self.period, state=self._given, preview=self.preview
        )

    def tables(self) -> dict[str, Array]:
        """Every number that a step reads, as the core made it; names as in `core/include/dehyst.h`."""
        return self._loop.tables()

    def start(self) -> CoreState:
        """The state that it was made or last reset in, in the core's numbers."""
        return self.actuator.model.core_state(self._start)

    @property
    def _running(self) -> bool:
        return "_loop" in self.__dict__

    @cached_property
    def _key(self) -> str:
        return key_of(self.actuator, self.period, self.preview)

    @cached_property
    def _foresight(self) -> Preview:
        return Preview.of(self.actuator, self.period) if self.preview and self.period else Preview.none()

    @cached_property
    def _loop(self) -> Loop:
        """The loop in C, made when it is first needed: a trajectory does without."""
        return self._made_loop()

    def _made_loop(self) -> Loop:
        model, period, slew = self.actuator.model, self.period, self.slew_rate
        if period is None and (model.needs_time or slew is not None):
            raise ModelError("creep, inertia, a lag or a slew rate need the time between steps; give period= [s]")
        seconds = 0.0 if period is None else period
        pace = model.step_coefficients(np.array([0, 1]), np.array([seconds]))
        most = float(np.finfo(np.float64).max)
        change = most if slew is None else min(slew * seconds, most)
        if change <= 0:
            raise ModelError(f"slew_rate: {slew:g} V/s allow no change in {seconds:g} s; give more, or a longer period")
        numbers = np.array([*self.limits, change, *model.amplifier(seconds)])
        listener = partial(_tell, self.actuator, self._limits)
        return model.core.loop(pace, self._foresight.taps, numbers, listener, model.core_state(self._start))


def _remade(made: tuple[Any, ...], memory: Snapshot | None) -> Compensator:
    actuator, limits, slew_rate, period, state, preview = made
    compensator = Compensator(actuator, limits, slew_rate, period=period, state=state, preview=preview)
    if memory is not None:
        compensator.restore(memory)
    return compensator


def _tell(actuator: Actuator, limits: VoltageLimits, slewed: bool, displacement: float, voltage: float) -> None:
    why = "the slew rate allows no more" if slewed else "that is a limit"
    words = _strays(actuator, limits, np.array([displacement]))
    why += f". {words}" if words else ""
    warnings.warn(f"CLAMPED: {displacement * 1e6:.6g} um wanted, {voltage:.6g} V to be sent: {why}", ClampWarning, 3)


def _strays(actuator: Actuator, limits: VoltageLimits, displacement: Array, load: ArrayLike | None = None) -> str:
    words = actuator.implausibility(displacement, load)
    if not words or (limits.low, limits.high) == actuator.limits:
        return words
    try:
        return actuator.implausibility(displacement, load, reachable_range(actuator, (limits.low, limits.high)))
    except ModelError:
        return words


def _refusal(displacement: float) -> ModelError:
    return ModelError(f"displacement: got {displacement!r}, need a finite number of metres that the model can follow")


def _positive(period: float) -> float:
    seconds = number(period, "period")
    if seconds <= 0:
        raise ModelError(f"period: got {period}, need a positive number of seconds")
    return seconds
