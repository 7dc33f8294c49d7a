"""Faults that can be rehearsed: what a laboratory does to a controller, at a time of one's own choice."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from dehyst._errors import ModelError
from dehyst.virtual.bench import VirtualBench
from dehyst.virtual.emulator.gcs_controller import Controller
from dehyst.virtual.emulator.gcs_errors import GcsError

FAULTS = {
    "drop": "the connection is lost",
    "silence": "no command is answered any more",
    "garble": "one answer comes garbled",
    "truncate": "one answer comes cut off",
    "error": "the controller stops, and reports an error",
    "narrow": "the limits are narrower than the controller tells, from the beginning",
    "saturate": "the sensor reads no further",
    "unplug": "the sensor is unplugged",
    "refuse": "the connection is lost, and none taken any more",
    "stall": "the wave generator hangs",
}
# Of the range that is told, a narrow controller has so much.
_NARROW = 0.8
# Where in a wave a fault comes that is not told when.
_MIDDLE = 0.5
_FORM = re.compile(r"(?P<name>[a-z]+)(@(?P<at>\d+(\.\d*)?)(?P<unit>s?))?")


@dataclass(frozen=True)
class Fault:
    """A fault, and when it comes.

    Attributes
    ----------
    name : str
        One of `FAULTS`.
    seconds : float or None
        Of the device, after which it comes.
    samples : float or None
        Of a wave, after which it comes. Without either it comes in the middle of the first wave.
    """

    name: str
    seconds: float | None = None
    samples: float | None = None

    @classmethod
    def parse(cls, text: str) -> Fault:
        """Read NAME, NAME@SAMPLES or NAME@SECONDSs, such as drop@2000 or unplug@3.5s.

        Raises
        ------
        ModelError
            If it is none of these.
        """
        found = _FORM.fullmatch(text.strip())
        if found is None or found["name"] not in FAULTS or (found["name"] == "narrow" and found["at"]):
            raise ModelError(
                f"fault: got '{text}', need NAME, NAME@SAMPLES of a wave or NAME@SECONDSs, as in drop@2000 or "
                f"unplug@3.5s, with a name of {', '.join(FAULTS)} (narrow without a time)"
            )
        at = None if found["at"] is None else float(found["at"])
        return cls(found["name"], at if found["unit"] else None, None if found["unit"] else at)

    def due(self, instrument: VirtualBench) -> bool:
        """Whether its time has come."""
        if self.seconds is not None:
            return instrument.now >= self.seconds
        recorded = instrument.recorded
        return recorded > 0 and recorded >= (_MIDDLE * instrument.planned if self.samples is None else self.samples)


class Rehearsal:
    """The faults of one controller, each of which comes once.

    Parameters
    ----------
    faults : iterable of Fault
    seed : int, optional
        Of what is garbled.
    tell : callable, optional
        Gets a sentence when one comes.
    """

    def __init__(
        self, faults: Iterable[Fault] = (), *, seed: int = 0, tell: Callable[[str], None] = lambda _: None
    ) -> None:
        self._to_come = [fault for fault in faults if fault.name != "narrow"]
        self._random = np.random.default_rng(seed)
        self._silent, self._spoil = False, ""
        self.said: list[str] = []
        self._tell = tell

    def strike(self, controller: Controller) -> set[str]:
        """Let come what is due; the names of those that the link has to see to: drop, refuse."""
        due = [fault for fault in self._to_come if fault.due(controller.instrument)]
        for fault in due:
            self._to_come.remove(fault)
            self.said.append(f"{fault.name}: {FAULTS[fault.name]}")
            self._tell(self.said[-1])
            self._strike(fault.name, controller)
        return {fault.name for fault in due} & {"drop", "refuse"}

    def spoiled(self, answer: bytes) -> bytes:
        """What of an answer leaves the controller."""
        if self._silent:
            return b""
        spoil, self._spoil = self._spoil, ""
        if spoil == "truncate":
            return answer[: len(answer) // 2]
        if spoil == "garble":
            noise = self._random.integers(0, 256, len(answer), dtype=np.uint8)
            hit = self._random.random(len(answer)) < 0.5
            hit[-1:] = False
            return bytes(np.where(hit, noise, np.frombuffer(answer, dtype=np.uint8)).astype(np.uint8))
        return answer

    def _strike(self, name: str, controller: Controller) -> None:
        instrument = controller.instrument
        if name == "silence":
            self._silent = True
        elif name in ("garble", "truncate"):
            self._spoil = name
        elif name == "error":
            instrument.stop()
            controller.error = GcsError.BROKEN_CABLE
        elif name == "saturate":
            present = min(instrument.displacement(), 0.5 * instrument.stroke)
            instrument.sensor_range = (present - 2 * instrument.stroke, present)
        elif name == "unplug":
            instrument.unplugged = True
        elif name == "stall":
            instrument.stalled = True


def narrowed(limits: tuple[float, float], faults: Iterable[Fault]) -> tuple[float, float]:
    """The limits [V] that a controller has which tells `limits`, given its faults."""
    low, high = limits
    return (low, low + _NARROW * (high - low)) if any(fault.name == "narrow" for fault in faults) else limits
