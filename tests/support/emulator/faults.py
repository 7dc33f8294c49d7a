"""Faults of a controller that can be rehearsed, each at a chosen time."""

import math
import re
from typing import NamedTuple

import numpy as np

from emulator.gcs_controller import GcsError

# The voltage that is read [V], of the one that is put out.
_MONITORS = {
    "zero": lambda _: 0.0,
    "shift": lambda voltage: voltage + 50.0,
    "invert": lambda voltage: -voltage,
    "blank": lambda _: math.nan,
}
# Share of the reported range that a controller with narrow limits has.
_NARROW = 0.8
# Share of a wave after which a fault without a time occurs.
_MIDDLE = 0.5
_FORM = re.compile(r"(?P<name>[a-z]+)(@(?P<at>\d+(\.\d*)?)(?P<unit>s?))?")


class Fault(NamedTuple):
    """A fault by its name, as `Rehearsal` and `actual_limits` have it, and when it occurs.

    It occurs at a device time of `seconds` [s], or after a number of `samples` of a wave; without either, in the middle
    of the first wave.
    """

    name: str
    seconds: float | None = None
    samples: float | None = None

    @classmethod
    def parse(cls, text):
        """Read a `text` NAME, NAME@SAMPLES or NAME@SECONDSs, as drop@2000 or unplug@3.5s."""
        match = _FORM.fullmatch(text)
        assert match, text
        at = None if match["at"] is None else float(match["at"])
        return cls(match["name"], at if match["unit"] else None, None if match["unit"] else at)

    def due(self, instrument):
        """Return whether the fault is due, by the clock and the wave of an `instrument`."""
        if self.seconds is not None:
            return instrument.now >= self.seconds
        recorded = instrument.recorded
        return recorded > 0 and recorded >= (_MIDDLE * instrument.planned if self.samples is None else self.samples)


class Rehearsal:
    """The `faults` of one controller, each of which occurs once.

    `report`: called with its name when a fault occurs.
    """

    def __init__(self, faults=(), *, report=lambda _: None):
        self._pending = [fault for fault in faults if fault.name != "narrow"]
        self._random, self._report = np.random.default_rng(0), report
        self._silent, self._corruption = False, ""

    def trigger(self, controller):
        """Trigger the due faults of a `controller`; return those that concern the connection: drop, refuse."""
        due = [fault for fault in self._pending if fault.due(controller.instrument)]
        for fault in due:
            self._pending.remove(fault)
            self._report(fault.name)
            # A sensor is that of the first axis.
            first = controller.axes[0].bench
            match fault.name:
                case "silence":
                    self._silent = True
                case "garble" | "truncate":
                    self._corruption = fault.name
                case "error":
                    controller.instrument.stop()
                    controller.error = GcsError.BROKEN_CABLE
                case "saturate":
                    present = min(first.displacement(), 0.5 * first.stroke)
                    first.sensor_range = (present - 2 * first.stroke, present)
                case "unplug":
                    first.unplugged = True
                case "stall":
                    for axis in controller.axes:
                        axis.bench.stalled = True
                case "drop" | "refuse":
                    pass
                case name:
                    for axis in controller.axes:
                        axis.monitor = _MONITORS[name]
        return {fault.name for fault in due} & {"drop", "refuse"}

    def corrupt(self, answer):
        """Return an `answer` as it leaves the controller: whole, corrupted, or empty."""
        corruption, self._corruption = self._corruption, ""
        if self._silent:
            return b""
        if corruption == "truncate":
            return answer[: len(answer) // 2]
        if corruption == "garble":
            noise = self._random.integers(0, 256, len(answer), dtype=np.uint8)
            hit = self._random.random(len(answer)) < 0.5
            hit[-1:] = False
            return np.where(hit, noise, np.frombuffer(answer, dtype=np.uint8)).tobytes()
        return answer


def actual_limits(reported, faults):
    """Return the limits [V] of a controller that reports limits and has these faults."""
    low, high = reported
    return (low, low + _NARROW * (high - low)) if any(fault.name == "narrow" for fault in faults) else reported
