"""An NV200/D of piezosystem jena as a rig, with the manufacturer's library nv200 (Python 3.12).

Tested with an emulator only: check the output with an oscilloscope, without an actuator connected. Then edit the
address, and::

    dehyst calibrate examples/instruments/jena.py:JenaRig --limits 0 100
"""

import asyncio
import threading
import time

from nv200.nv200_device import NV200Device
from nv200.serial_protocol import SerialProtocol
from nv200.telnet_protocol import TelnetProtocol

from dehyst.control import VoltageLimits
from dehyst.instruments import AbstractRig, LinkError, Reading, RigError

ADDRESS = "192.168.0.5"  # a host, or a serial port
# Answer of the amplifier: an actuator with a sensor in micrometres, open loop, setpoints from here.
NEEDED = {"acmeasure": ("1",), "cl": ("0",), "modsrc": ("0",), "unitcl": ("um", "\xb5m", "\u03bcm")}
# Data recorder: no automatic start, piezo voltage in memory 0, position in memory 1, 20 samples of 50 us.
RECORDER = ("recast,0", "recsrc,0,2", "recsrc,1,0", "recstr,1", "reclen,20")
# A slew rate of this value [% of the range in 1 ms] or above means that the amplifier does not limit it.
NO_SLEW_RATE = 2000.0


class JenaRig(AbstractRig):
    """A rig that sends setpoints; after each one the recorder samples voltage and position at the same instant."""

    def __init__(self, *, limits=None, slew_rate=None):
        # A separate event loop: an exchange that Ctrl-C interrupts ends, and no later exchange gets its answer.
        self._loop, self._one = asyncio.new_event_loop(), asyncio.Lock()
        threading.Thread(target=self._loop.run_forever, daemon=True).start()
        serial = ADDRESS.startswith(("/", "COM"))
        self._device = NV200Device(SerialProtocol(port=ADDRESS) if serial else TelnetProtocol(host=ADDRESS))
        self._run(self._device.connect(True))
        for query, needed in NEEDED.items():
            if (answer := self._ask(query)[0].strip()) not in needed:
                raise RigError(argument=query, got=answer, need=" or ".join(needed), hint="set it at the amplifier")
        low, high, slew = (self._number(query) for query in ("avmin", "avmax", "sr"))
        device = VoltageLimits(low, high, None if slew >= NO_SLEW_RATE else slew / 100 * (high - low) * 1e3)
        for setting in RECORDER:
            self._ask(setting)
        begin = time.monotonic()
        for _ in range(5):
            self._read()
        # A voltage is sent before each reading.
        self._fastest = 2.5 / (time.monotonic() - begin)
        name = f"NV200/D with {self._ask('desc')[0]} #{self._ask('acserno')[0]}"
        super().__init__(name, device, limits=limits, slew_rate=slew_rate)

    def nearest_rate(self, sample_rate):
        """Return a rate [Hz] that the host keeps."""
        return min(sample_rate, self._fastest)

    def _read(self):
        self._ask("recrun,1")
        return Reading(time.monotonic(), self._number("recout,0,0,1"), 1e-6 * self._number("recout,1,0,1"))

    def _put(self, voltage):
        self._ask(f"set,{voltage:.6f}")

    def _halt(self):
        """Do nothing: no wave plays by itself."""

    def _close(self):
        self._run(self._device.close())

    def _number(self, query):
        return float(self._ask(query)[-1])

    def _ask(self, command):
        """Send a command; return the values of the answer."""

        async def exchange():
            async with self._one:
                return await self._device.read_response(command)

        name, answer = self._run(exchange())
        if name and name != command.partition(",")[0]:
            raise LinkError(f"got an answer to {name[:20]!r}, need an answer to {command!r}; check the link")
        return list(answer)

    def _run(self, task):
        return asyncio.run_coroutine_threadsafe(task, self._loop).result()
