"""A rig over TCP: a microcontroller with a converter for the amplifier and one for the sensor, which speaks lines.

LIMITS answers the lowest and highest voltage; READ time, voltage and displacement; PUT sends a voltage; WAVE begins to
play voltages at a rate; NEXT answers the samples since the last one, and "end" when there are no more; HALT stops.
"""

import socket
import time

import numpy as np

from dehyst import VoltageLimits
from dehyst.instruments import AbstractRig, DeviceError, LinkError, Reading, Samples, Scheme


class LineRig(AbstractRig):
    """Its device gives the limits; all that ramps, clamps and retreats is in the base class."""

    def __init__(self, host, port, **options):
        try:
            self._link = socket.create_connection((host, port), timeout=5.0)
        except OSError as error:
            raise LinkError(f"line://{host}:{port}: {error}; check cable and power") from error
        self._lines = self._link.makefile("r", encoding="ascii")
        low, high = map(float, self._ask("LIMITS").split())
        super().__init__(f"line {host}:{port}", VoltageLimits(low, high), longest=4096, **options)

    def nearest_rate(self, sample_rate):
        return 1e6 / max(100, round(1e6 / sample_rate))  # whole microseconds

    def _ask(self, command):
        try:
            self._link.sendall(f"{command}\n".encode())
            answer = self._lines.readline()
        except OSError as error:
            raise LinkError(f"no answer to {command[:20]}: {error}") from error
        if not answer.endswith("\n"):
            raise LinkError(f"the link was closed at {command[:20]}")
        if answer.startswith("ERROR"):
            raise DeviceError(f"{command[:20]}: {answer.strip()}")
        return answer.strip()

    def _read(self):
        return Reading(*map(float, self._ask("READ").split()))

    def _put(self, voltage):
        self._ask(f"PUT {voltage!r}")

    def _wave(self, voltage, rate):
        self._ask(f"WAVE {rate!r} {' '.join(map(repr, voltage.tolist()))}")
        while (answer := self._ask("NEXT")) != "end":
            if answer:
                yield Samples(*np.array(answer.split(), dtype=float).reshape(-1, 3).T)
            else:
                time.sleep(0.01)

    def _halt(self):
        self._ask("HALT")

    def _close(self):
        self._lines.close()
        self._link.close()


def open_line(rest, options):
    host, _, port = rest.partition(":")
    return LineRig(host, int(port or 5025), **options)


SCHEME = Scheme("line://host:port", open_line)
