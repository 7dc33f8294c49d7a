"""A rig over TCP: a microcontroller with a converter for the amplifier and one for the sensor, which speaks lines.

LIMITS answers the lowest and highest voltage; READ time, voltage and displacement; PUT sends a voltage; WAVE begins to
play voltages at a rate; NEXT waits for samples and answers them, or "end" after the last ones; HALT stops.
"""

import socket

import numpy as np

from dehyst import VoltageLimits
from dehyst.instruments import AbstractRig, DeviceError, Reading, Samples, Scheme


class LineRig(AbstractRig):
    """Its device gives the limits; all that ramps, clamps and retreats is in the base class."""

    def __init__(self, address, **options):
        self._link = socket.create_connection(address.split(":"), timeout=5.0)
        self._lines = self._link.makefile("r", encoding="ascii")
        low, high = map(float, self._ask("LIMITS").split())
        super().__init__(f"line {address}", VoltageLimits(low, high), longest=4096, **options)

    def _ask(self, command):
        self._link.sendall(f"{command}\n".encode())
        answer = self._lines.readline()
        if not answer.endswith("\n") or answer.startswith("ERROR"):
            raise DeviceError(f"{command[:20]}: {answer.strip() or 'the link was closed'}")
        return answer.strip()

    def nearest_rate(self, sample_rate):
        return 1e6 / max(100, round(1e6 / sample_rate))  # whole microseconds

    def _read(self):
        return Reading(*map(float, self._ask("READ").split()))

    def _put(self, voltage):
        self._ask(f"PUT {voltage!r}")

    def _wave(self, voltage, rate):
        self._ask(f"WAVE {rate!r} {' '.join(map(repr, voltage.tolist()))}")
        while (answer := self._ask("NEXT")) != "end":
            yield Samples(*np.array(answer.split(), dtype=float).reshape(-1, 3).T)

    def _halt(self):
        self._ask("HALT")

    def _close(self):
        self._link.close()


SCHEME = Scheme("line://host:port", lambda rest, options: LineRig(rest, **options))
