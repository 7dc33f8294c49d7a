"""The compensated axis as a bluesky device: set a displacement, and the voltage that leads there is sent."""

from __future__ import annotations

import asyncio
import time
import warnings
from collections.abc import AsyncIterator, Sequence
from dataclasses import replace
from typing import Any

from dehyst._errors import DeviceError, MissingExtraError, ModelError, RigError
from dehyst._native import EMPTY
from dehyst._validation import number
from dehyst.control import Compensator, VoltageLimits, shortest_homing
from dehyst.control.ramps import homing_steps, ramp_step
from dehyst.control.reachable import state_at
from dehyst.instruments.epics import PvNames
from dehyst.instruments.samples import ASTRAY
from dehyst.model import Actuator

try:
    from bluesky.plan_stubs import stop, wait_for
    from bluesky.preprocessors import finalize_wrapper
    from bluesky.protocols import Checkable, Locatable, Location, Stoppable
    from bluesky.utils import MsgGenerator
    from ophyd_async.core import (
        SignalR,
        StandardReadable,
        StandardReadableFormat,
        WatchableAsyncStatus,
        WatcherUpdate,
        soft_signal_r_and_setter,
    )
    from ophyd_async.epics.core import epics_signal_r, epics_signal_rw
except ImportError as error:
    raise MissingExtraError.of("ophyd-async or bluesky", "bluesky", "a bluesky axis") from error

_NAMES = PvNames()
_MICRO = 1e-6
# An axis that nobody gave a slew rate takes so many seconds for its whole range.
_SWEEP = 1.0
# What rounding may make of a voltage, of its range.
_ROUNDING = 1e-9


class CompensatedAxis(StandardReadable, Locatable[float], Stoppable, Checkable[float]):
    """A piezo axis without hysteresis, driven through an IOC's process variables.

    `set` takes the wanted displacement [um] and leads there in steps within the slew rate; every voltage that was
    sent becomes part of the actuator's memory. Before the first `set` the axis must be homed, in a plan by
    ``yield from homing(axis)``: what the actuator went through before is not known.

    A displacement that the limits do not reach is refused before anything moves. `stop` holds the voltage.

    Parameters
    ----------
    prefix : str
        Of the process variables, as for `dehyst.instruments.epics.EpicsRig`.
    actuator : Actuator
        Its inertia and its amplifier's lag are left alone: steps are slow against them.
    limits : (float, float), optional
        Voltages [V] that are allowed; what actuator or IOC do not allow is left out.
    slew_rate : float, optional
        Largest abs(dv/dt) [V/s], where the IOC allows it; default: the IOC's, or the whole range in a second.
    period : float, optional
        Seconds from one step to the next.
    settle : float, optional
        Seconds to wait at the end of a move, so that the IOC has read the sensor again.
    timeout : float, optional
        Seconds that one exchange with the IOC may take.
    names : PvNames, optional
    name : str, optional
        Of the device.

    Attributes
    ----------
    wanted : SignalR
        Displacement [um] that was asked for; after a stop, where the model takes the actuator to be.
    voltage : SignalRW
        The voltage that was sent [V]. Who sets it behind the axis must home again.
    position : SignalR
        What the sensor measures [um]; it is in the device's hints.

    Raises
    ------
    ModelError
        If a number is impossible.
    """

    def __init__(
        self,
        prefix: str,
        actuator: Actuator,
        *,
        limits: Sequence[float] | None = None,
        slew_rate: float | None = None,
        period: float = 0.02,
        settle: float = 0.1,
        timeout: float = 5.0,
        names: PvNames = _NAMES,
        name: str = "",
    ) -> None:
        period, settle = number(period, "period"), number(settle, "settle")
        if period <= 0 or settle < 0:
            raise ModelError(f"period, settle: got {period} and {settle} s, need more than 0, and 0 or more")
        self._actuator, self._period, self._settle = _slow(actuator), period, settle
        self._asked = [VoltageLimits(*ends) for ends in (limits, actuator.limits) if ends is not None]
        self._asked_slew = None if slew_rate is None else VoltageLimits(0.0, 1.0, slew_rate).slew_rate
        self._limits: VoltageLimits | None = None
        self._compensator: Compensator | None = None
        self._unknown = "it was not homed yet"
        self._stopped: bool | None = None
        self._moves, self._sends = asyncio.Lock(), asyncio.Lock()
        # When the voltage of a homing was sent, and from then on the time that the model's memory has reached [s].
        self._modelled_at = 0.0

        def readable(what: str) -> SignalR[float]:
            return epics_signal_r(float, f"ca://{prefix}{names.joint}{what}", timeout=timeout)

        with self.add_children_as_readables():
            self.wanted, self._show_wanted = soft_signal_r_and_setter(float, units="um", precision=5)
        with self.add_children_as_readables(StandardReadableFormat.UNCACHED_SIGNAL):
            self.voltage = epics_signal_rw(float, f"ca://{prefix}{names.joint}{names.voltage}", timeout=timeout)
        with self.add_children_as_readables(StandardReadableFormat.HINTED_UNCACHED_SIGNAL):
            self.position = readable(names.position)
        self.readback = readable(names.readback)
        told = (names.low, names.high, names.slew)
        self.low, self.high, self.slew = (None if each is None else readable(each) for each in told)
        super().__init__(name=name)

    @property
    def reach(self) -> tuple[float, float]:
        """Displacements [um] at the lower and the upper limit of the voltage; known when the axis is homed."""
        low, high = self._known().reach
        return low / _MICRO, high / _MICRO

    async def home(self) -> None:
        """Play the shortest voltage after which the actuator's state is known, whatever it was.

        Raises
        ------
        RigError
            If no voltage is allowed by all, the IOC does something else, or the axis is stopped on the way.

        Warns
        -----
        UserWarning
            If the limits are too narrow to know the state well.
        """
        async with self._moves:
            self._stopped, self._compensator, self._unknown = None, None, "its homing was broken off"
            limits = await self._allowed()
            present = limits.nearest(await self.readback.get_value())
            homing = shortest_homing(self._actuator, limits=(limits.low, limits.high), present=present)
            if not homing.certified:
                warnings.warn(f"{self.name}: homing {'; '.join(homing.remarks)}", UserWarning, stacklevel=2)
            for voltage, seconds in homing_steps(homing, limits, self._period):
                await asyncio.shield(self._send(voltage, None, limits, seconds))
                self._refuse_stopped()
            self._limits = limits
            self._compensator = Compensator(
                self._actuator, (limits.low, limits.high), period=self._period, state=homing.state
            )
            self._show_wanted(homing.state.displacement / _MICRO)

    @WatchableAsyncStatus.wrap
    async def set(self, value: float) -> AsyncIterator[WatcherUpdate[float]]:
        """Go to a displacement [um]; done when the voltage is there.

        Raises
        ------
        RigError
            In the status: if the axis is not homed, something else sent a voltage, or it is stopped without success.
        ModelError
            In the status: if the displacement is out of reach; nothing has moved then.
        """
        async with self._moves:
            self._stopped = None
            compensator, limits = self._known(), self._limits or VoltageLimits(0.0, 1.0)
            await self._refuse_moved(compensator, limits)
            await self.check_value(value)
            self._show_wanted(float(value))
            initial, there = await self.position.get_value(), False
            while not there and self._stopped is None:
                there = await asyncio.shield(self._step(compensator, float(value), limits))
                now = await self.position.get_value()
                yield WatcherUpdate(now, initial, float(value), name=self.name, unit="um", precision=5)
            if not there:
                self._show_wanted(compensator.state.displacement / _MICRO)
                self._refuse_stopped()
            await asyncio.sleep(self._settle)

    async def check_value(self, value: float) -> None:
        """Refuse a displacement [um] that cannot be reached, by a `ModelError`; nothing moves.

        Raises
        ------
        RigError
            If the axis is not homed.
        """
        compensator = self._known()
        wanted = _MICRO * number(value, f"{self.name}: displacement")
        needed = self._actuator.voltage(state_at(self._actuator, compensator.state, wanted))
        low, high = compensator.limits
        slack = _ROUNDING * (high - low)
        if not low - slack <= needed <= high + slack:
            lowest, highest = self.reach
            raise ModelError(
                f"{self.name}: got {value:.6g} um, need {lowest:.6g} to {highest:.6g} um; it would take {needed:.6g} V "
                f"where {low:.6g} to {high:.6g} V is allowed; nothing was sent"
            )

    async def stop(self, success: bool = True) -> None:
        """End what moves at its present voltage; without `success` it ends in an error."""
        self._stopped = success

    async def locate(self) -> Location[float]:
        """Displacements [um] wanted and measured."""
        wanted, measured = await asyncio.gather(self.wanted.get_value(), self.position.get_value())
        return Location(setpoint=wanted, readback=measured)

    def _known(self) -> Compensator:
        if self._compensator is None:
            raise RigError(f"{self.name}: where its actuator stands is not known: {self._unknown}; home it first")
        return self._compensator

    def _refuse_stopped(self) -> None:
        if self._stopped is False or (self._stopped and self._compensator is None):
            raise RigError(f"{self.name}: was stopped on its way; it holds the voltage where it was")

    async def _refuse_moved(self, compensator: Compensator, limits: VoltageLimits) -> None:
        """Refuse to go on where another voltage was sent than by this axis."""
        # A step of a move that was cancelled may still be on its way to the memory.
        async with self._sends:
            sent, output = await asyncio.gather(self.voltage.get_value(), self.readback.get_value())
            at = compensator.voltage
        span = limits.high - limits.low
        if abs(sent - at) > _ROUNDING * span or abs(output - at) > ASTRAY * span:
            self._forget(f"somebody else has sent {sent:.6g} V, and {output:.6g} V is put out in place of {at:.6g} V")
            self._known()

    def _catch_up(self, compensator: Compensator) -> None:
        """Let the model creep as long as the voltage was held, up to the period that the next step stands for.

        A step takes as long as the IOC and this machine make it.
        """
        behind = int((time.monotonic() - self._modelled_at) / self._period) - 1
        if self._actuator.needs_time and behind > 0:
            for _ in range(behind):
                compensator.hold()
            self._modelled_at += behind * self._period

    async def _step(self, compensator: Compensator, value: float, limits: VoltageLimits) -> bool:
        """One step towards a displacement [um]; whether it has been reached."""
        self._catch_up(compensator)
        wish = limits.nearest(compensator.offer(_MICRO * value))
        voltage = ramp_step(wish, compensator.voltage, limits, self._period)
        await self._send(voltage, compensator, limits, self._period)
        return voltage == wish

    async def _send(self, voltage: float, memory: Compensator | None, limits: VoltageLimits, seconds: float) -> None:
        """Put a voltage [V], remember what was taken of it, and wait. To be shielded: what is begun is remembered."""
        async with self._sends:
            try:
                await self.voltage.set(limits.nearest(voltage))
                taken = await self.voltage.get_value()
                if memory is None:
                    self._modelled_at = time.monotonic()
                else:
                    memory.commit(taken)
                    self._modelled_at += self._period
            except BaseException as error:
                self._forget(f"a voltage may have been sent, or not ({type(error).__name__}: {error})")
                raise
            if abs(taken - voltage) > _ROUNDING * (limits.high - limits.low):
                raise DeviceError(
                    f"{self.name}: {taken:.6g} V was taken when {voltage:.6g} V was sent; are the IOC's limits "
                    "narrower than it says?"
                )
            await asyncio.sleep(seconds)

    def _forget(self, why: str) -> None:
        self._compensator, self._unknown = None, why

    async def _allowed(self) -> VoltageLimits:
        """What user, actuator and IOC all allow."""
        control: dict[str, Any] = dict((await self.voltage.describe())[self.voltage.name].get("limits", {}))
        record = control.get("control") or {}
        ends = [(each.low, each.high) for each in self._asked]
        if record.get("low") is not None and record.get("high") is not None:
            ends.append((record["low"], record["high"]))
        if self.low is not None and self.high is not None:
            ends.append((await self.low.get_value(), await self.high.get_value()))
        low, high = max((end[0] for end in ends), default=0.0), min((end[1] for end in ends), default=0.0)
        if not low < high:
            raise RigError(f"{self.name}: {low:.6g} to {high:.6g} V is what all allow; give other limits=")
        device = 0.0 if self.slew is None else await self.slew.get_value()
        rates = [rate for rate in (device, self._asked_slew) if rate]
        return VoltageLimits(low, high, min(rates, default=(high - low) / _SWEEP))


def homing(axis: CompensatedAxis) -> MsgGenerator[None]:
    """A plan that homes an axis, and stops it if the plan is broken off."""

    def home() -> MsgGenerator[None]:
        for task in (yield from wait_for([axis.home])) or ():
            task.result()

    wrapper: Any = finalize_wrapper
    yield from wrapper(home(), stop(axis))


def _slow(actuator: Actuator) -> Actuator:
    """The same without what slow steps do not feel."""
    return replace(actuator, dynamics=None, lag=0.0, state=replace(actuator.state, motion=EMPTY))
