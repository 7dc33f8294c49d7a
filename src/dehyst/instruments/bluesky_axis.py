"""The compensated axis as a bluesky device, which sends the voltage for the displacement that is set."""

from __future__ import annotations

import asyncio
import time
import warnings
from collections.abc import AsyncIterator, Sequence
from typing import Any

from dehyst._errors import DeviceError, MissingExtraError, ModelError, RigError
from dehyst._validation import number
from dehyst.control import Compensator, VoltageLimits, homing_steps, shortest_homing
from dehyst.instruments.epics import PvNames
from dehyst.instruments.samples import READBACK_TOLERANCE
from dehyst.model import Actuator, state_at

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
# Seconds for the whole range, if neither IOC nor user gives a slew rate.
_SWEEP = 1.0
# Rounding of a voltage, as a share of its range.
_ROUNDING = 1e-9


class CompensatedAxis(StandardReadable, Locatable[float], Stoppable, Checkable[float]):
    """A piezo axis without hysteresis, driven through an IOC's process variables.

    `set` takes the wanted displacement [um] and moves there in steps within the slew rate; every voltage that was
    sent becomes part of the actuator's memory. Before the first `set` the axis must be homed, in a plan by
    ``yield from homing(axis)``: the history of the actuator is unknown.

    A displacement outside the reach of the limits is refused before anything moves. `stop` holds the voltage. Signals:
    `wanted` [um], after a stop the displacement of the model; `voltage` [V] that was sent, and if anything else sets
    it, the axis must be homed again; `position` [um], the reading of the sensor, in the device's hints. Raise
    `ModelError` if a number is impossible.

    Parameters
    ----------
    prefix, names : str, PvNames
        Prefix and names of the process variables, as for `dehyst.instruments.epics.EpicsRig`; `name` is the name of the
        device.
    actuator : Actuator
        Its inertia and its amplifier's lag are ignored: steps are slow against them.
    limits : (float, float), optional
        Allowed voltages [V]; they are narrowed to those of actuator and IOC.
    slew_rate : float, optional
        Largest abs(dv/dt) [V/s], where the IOC allows it; default: the IOC's, or the whole range in a second.
    period : float, optional
        Seconds from one step to the next.
    settle, timeout : float, optional
        Seconds to wait at the end of a move, so that the IOC has read the sensor again, and that one exchange may take.
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
            raise ModelError(
                argument="period, settle", got=f"{period} and {settle} s", need="more than 0, and 0 or more"
            )
        self._actuator, self._period, self._settle = actuator.quasistatic(), period, settle
        self._given = [VoltageLimits(*ends) for ends in (limits, actuator.limits) if ends is not None]
        self._given_slew_rate = None if slew_rate is None else VoltageLimits(0.0, 1.0, slew_rate).slew_rate
        # Set by each homing.
        self._limits = VoltageLimits(0.0, 1.0)
        self._compensator: Compensator | None = None
        self._unhomed_reason = "it was not homed yet"
        self._stopped: bool | None = None
        self._move_lock, self._send_lock = asyncio.Lock(), asyncio.Lock()
        # The time [s] that the model's memory has reached, from the voltage of the homing on.
        self._modelled_at = 0.0
        address = f"ca://{prefix}{names.joint}"

        def readable(what: str) -> SignalR[float]:
            return epics_signal_r(float, address + what, timeout=timeout)

        with self.add_children_as_readables():
            self.wanted, self._set_wanted = soft_signal_r_and_setter(float, units="um", precision=5)
        with self.add_children_as_readables(StandardReadableFormat.UNCACHED_SIGNAL):
            self.voltage = epics_signal_rw(float, address + names.voltage, timeout=timeout)
        with self.add_children_as_readables(StandardReadableFormat.HINTED_UNCACHED_SIGNAL):
            self.position = readable(names.position)
        self.readback = readable(names.readback)
        optional = (names.low, names.high, names.slew)
        self.low, self.high, self.slew = (None if each is None else readable(each) for each in optional)
        super().__init__(name=name)

    @property
    def reach(self) -> tuple[float, float]:
        """Displacements [um] at the lower and the upper limit of the voltage, once the axis is homed."""
        low, high = self._homed().reach
        return low / _MICRO, high / _MICRO

    async def home(self) -> None:
        """Play the shortest voltage that leads from any state of the actuator to a known one.

        Raise `RigError` if the limits have no voltage in common, the IOC takes another voltage, or the axis is stopped
        on the way. Warn if the limits are too narrow to determine the state well.
        """
        async with self._move_lock:
            self._stopped = None
            self._forget("its homing was broken off")
            self._limits = limits = await self._common_limits()
            present = limits.nearest(await self.readback.get_value())
            homing = shortest_homing(self._actuator, limits=(limits.low, limits.high), present=present)
            if not homing.certified:
                warnings.warn(f"{self.name}: homing {'; '.join(homing.remarks)}", UserWarning, stacklevel=2)
            for voltage, seconds in homing_steps(homing, limits, self._period):
                await asyncio.shield(self._send(voltage, None, limits, seconds))
                self._refuse_stopped()
            self._compensator = Compensator(
                self._actuator, (limits.low, limits.high), period=self._period, state=homing.state
            )
            self._set_wanted(self._actuator.displacement(homing.state) / _MICRO)

    @WatchableAsyncStatus.wrap
    async def set(self, value: float) -> AsyncIterator[WatcherUpdate[float]]:
        """Move to a displacement [um]; the move is done when the voltage has reached its final value.

        The status fails with `RigError` if the axis is not homed, something else sent a voltage, or it is stopped
        without success; with `ModelError` if the displacement is out of reach: nothing has moved.
        """
        async with self._move_lock:
            self._stopped = None
            await self._refuse_other_voltage(self._homed())
            await self.check_value(value)
            self._set_wanted(float(value))
            initial, reached = await self.position.get_value(), False
            while not reached and self._stopped is None:
                reached = await asyncio.shield(self._step(float(value)))
                now = await self.position.get_value()
                yield WatcherUpdate(now, initial, float(value), name=self.name, unit="um", precision=5)
            if not reached:
                self._set_wanted(self._actuator.displacement(self._homed().state) / _MICRO)
                self._refuse_stopped()
            await asyncio.sleep(self._settle)

    async def check_value(self, value: float) -> None:
        """Raise `ModelError` for a displacement [um] that cannot be reached, `RigError` if the axis is not homed."""
        compensator = self._homed()
        wanted = _MICRO * number(value, f"{self.name}: displacement")
        needed = self._actuator.voltage(state_at(self._actuator, compensator.state, wanted))
        low, high = compensator.limits
        slack = _ROUNDING * (high - low)
        if not low - slack <= needed <= high + slack:
            lowest, highest = self.reach
            raise ModelError(
                f"{self.name}: got {value:.6g} um, need {lowest:.6g} to {highest:.6g} um; it needs {needed:.6g} V "
                f"where {low:.6g} to {high:.6g} V is allowed; nothing was sent"
            )

    async def stop(self, success: bool = True) -> None:
        """End a move at its present voltage; without `success` it ends with an error."""
        self._stopped = success

    async def locate(self) -> Location[float]:
        """Return the wanted and the measured displacement [um]."""
        wanted, measured = await asyncio.gather(self.wanted.get_value(), self.position.get_value())
        return Location(setpoint=wanted, readback=measured)

    def _homed(self) -> Compensator:
        if self._compensator is None:
            raise RigError(f"{self.name}: the state of its actuator is unknown: {self._unhomed_reason}; home it first")
        return self._compensator

    def _forget(self, reason: str) -> None:
        self._compensator, self._unhomed_reason = None, reason

    def _refuse_stopped(self) -> None:
        if self._stopped is False or (self._stopped and self._compensator is None):
            raise RigError(f"{self.name}: was stopped on its way; it holds the voltage where it was")

    async def _refuse_other_voltage(self, compensator: Compensator) -> None:
        """Raise RigError if a voltage was sent that this axis did not send."""
        # A step of a cancelled move may still be on its way to the memory.
        async with self._send_lock:
            sent, output = await asyncio.gather(self.voltage.get_value(), self.readback.get_value())
            modelled = compensator.voltage
        low, high = compensator.limits
        if abs(sent - modelled) > _ROUNDING * (high - low) or abs(output - modelled) > READBACK_TOLERANCE * (
            high - low
        ):
            self._forget(
                f"another client has sent {sent:.6g} V, and the output is {output:.6g} V instead of {modelled:.6g} V"
            )
            self._homed()

    async def _step(self, value: float) -> bool:
        """Take one step towards a displacement [um], and return whether it is reached."""
        compensator, limits = self._homed(), self._limits
        # The duration of a step depends on the IOC and this machine: the model creeps for as long as the voltage was
        # held, up to the period of the next step.
        behind = int((time.monotonic() - self._modelled_at) / self._period) - 1
        if self._actuator.needs_time and behind > 0:
            for _ in range(behind):
                compensator.hold()
            self._modelled_at += behind * self._period
        target = limits.nearest(compensator.offer(_MICRO * value))
        voltage = limits.towards(target, compensator.voltage, self._period)
        await self._send(voltage, compensator, limits, self._period)
        return voltage == target

    async def _send(self, voltage: float, memory: Compensator | None, limits: VoltageLimits, seconds: float) -> None:
        """Send a voltage [V], commit the one that the IOC took, and wait; call it shielded from cancellation."""
        async with self._send_lock:
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
                    f"{self.name}: the IOC took {taken:.6g} V when {voltage:.6g} V was sent; are its limits narrower "
                    "than it reports?"
                )
            await asyncio.sleep(seconds)

    async def _common_limits(self) -> VoltageLimits:
        """Return the limits that user, actuator and IOC all allow."""
        control: dict[str, Any] = dict((await self.voltage.describe())[self.voltage.name].get("limits", {}))
        record = control.get("control") or {}
        ends = [(each.low, each.high) for each in self._given]
        if record.get("low") is not None and record.get("high") is not None:
            ends.append((record["low"], record["high"]))
        if self.low is not None and self.high is not None:
            ends.append((await self.low.get_value(), await self.high.get_value()))
        low, high = max((end[0] for end in ends), default=0.0), min((end[1] for end in ends), default=0.0)
        if not low < high:
            raise RigError(
                f"{self.name}: the limits of user, actuator and IOC have no voltage in common: their largest lower one "
                f"is {low:.6g} V, their smallest upper one {high:.6g} V; give other limits"
            )
        device = 0.0 if self.slew is None else await self.slew.get_value()
        rates = [rate for rate in (device, self._given_slew_rate) if rate]
        return VoltageLimits(low, high, min(rates, default=(high - low) / _SWEEP))


def homing(axis: CompensatedAxis) -> MsgGenerator[None]:
    """Home an axis in a plan, and stop it if the plan is broken off."""

    def home() -> MsgGenerator[None]:
        for task in (yield from wait_for([axis.home])) or ():
            task.result()

    wrapper: Any = finalize_wrapper
    yield from wrapper(home(), stop(axis))
