"""An axis for bluesky plans that moves without hysteresis, on any rig and with the model of its actuator.

::

    axis = CompensatedAxis(open_rig("epics://BENCH"), Actuator.load("model.json"), name="axis")
    engine(homing(axis))
    engine(list_scan([], axis, [1.0, 2.0, 3.0, 2.0, 1.0]))

The rig keeps limits and slew rate, and brings the voltage back after an error; then the axis must be homed again.
"""

import asyncio
import time
from dataclasses import replace

from bluesky.plan_stubs import wait_for
from bluesky.protocols import Movable, Triggerable
from ophyd_async.core import AsyncStatus, StandardReadable, StandardReadableFormat, soft_signal_r_and_setter

from dehyst import Compensator
from dehyst.control import shortest_homing
from dehyst.instruments import RigError

PERIOD = 0.02


class CompensatedAxis(StandardReadable, Movable[float], Triggerable):
    """`set` takes the wanted displacement [um]; before the first call, home the axis with `yield from homing(axis)`.

    Signals: `wanted` [um], `voltage` [V] and `position` [um], the reading of the sensor. Inertia and lag of the model
    are ignored, because ramps are slow.
    """

    def __init__(self, rig, actuator, name=""):
        self._rig, self._actuator = rig, replace(actuator, dynamics=None, lag=0.0, state=None)
        self._compensator, self._since = None, 0.0
        with self.add_children_as_readables():
            self.wanted, self._set_wanted = soft_signal_r_and_setter(float, units="um")
            self.voltage, self._set_voltage = soft_signal_r_and_setter(float, units="V")
        with self.add_children_as_readables(StandardReadableFormat.HINTED_SIGNAL):
            self.position, self._set_position = soft_signal_r_and_setter(float, units="um")
        super().__init__(name=name)

    @AsyncStatus.wrap
    async def set(self, value):
        """Ramp to the voltage of a displacement [um]; one that is out of reach is refused, and nothing moves."""
        await asyncio.to_thread(self._move, value)
        self._set_wanted(value)

    @AsyncStatus.wrap
    async def trigger(self):
        """Read the instrument."""
        _, voltage, position = await asyncio.to_thread(self._rig.read)
        self._set_voltage(voltage)
        self._set_position(1e6 * position)

    def home(self):
        """Bring the actuator from any state to a known state."""
        self._compensator = None
        bounds = self._rig.limits.low, self._rig.limits.high
        homing = shortest_homing(self._actuator, limits=bounds, present=self._rig.read().voltage)
        self._rig.play(homing.played)
        self._compensator = Compensator(self._actuator, bounds, period=PERIOD, state=homing.state)
        self._since = time.monotonic()

    def _move(self, value):
        memory = self._compensator
        if memory is None:
            raise RigError(f"{self.name}: the state of its actuator is not known; home it first")
        # The model creeps for the time that the last voltage was held.
        for _ in range(int((time.monotonic() - self._since) / PERIOD)):
            memory.hold()
        low, high = memory.reach
        if not low <= 1e-6 * value <= high:
            raise RigError(argument="displacement", got=f"{value:g} um", need=f"{1e6 * low:g} to {1e6 * high:g} um")
        voltage = memory.offer(1e-6 * value)
        # After an error the rig has retreated, and the state is not known.
        self._compensator = None
        self._rig.set_voltage(voltage)
        memory.commit(voltage)
        self._compensator, self._since = memory, time.monotonic()


def homing(axis):
    """Home an axis in a plan."""
    for task in (yield from wait_for([lambda: asyncio.to_thread(axis.home)])):
        task.result()
