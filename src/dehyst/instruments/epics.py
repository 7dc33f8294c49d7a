"""A rig behind EPICS Channel Access: the process variables of a laboratory's own IOC, with blocking calls."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from typing import Any, Self

import numpy as np

from dehyst._errors import DeviceError, LinkError, MissingExtraError, RigError
from dehyst._units import COUNTS, symbol_of
from dehyst.control import VoltageLimits
from dehyst.instruments.base import AbstractRig
from dehyst.instruments.waves import Reading

# Rounding of a voltage that the IOC takes, as a share of the range.
_ROUNDING = 1e-3
# Longest wait [s] for a reading of the voltage that is newer than the last command; time [s] between two polls.
_LONGEST_READBACK_WAIT, _POLL_READBACK = 0.5, 0.01
# Longest wait [s] for an answer after an answer was lost.
_WAIT_AFTER_LOSS = 2.0
# ECA_TIMEOUT and ECA_DISCONN of Channel Access.
_SILENT = (80, 192)
# Characters of an answer that a message quotes.
_QUOTED = 60
HINT = "check this name, whether the IOC runs or hangs, and whether EPICS_CA_ADDR_LIST leads to it"


# The event loop, in a thread of its own, for all exchanges of this process; it runs until the process ends: channels
# belong to the loop that made them, and Channel Access calls it back as long as they exist.
_LOOP = asyncio.new_event_loop()
threading.Thread(target=_LOOP.run_forever, name="dehyst instruments", daemon=True).start()


class ChannelAccess:
    """Process variables with a common `prefix`, put before each name as it is.

    `timeout`: seconds that one exchange may take. Raise `MissingExtraError` if aioca is not installed.
    """

    def __init__(self, prefix: str, timeout: float) -> None:
        try:
            import aioca
        except ImportError as error:
            raise MissingExtraError.of("aioca", "bench", "An EPICS rig") from error
        self.prefix, self.timeout = prefix, timeout
        self._ca: Any = aioca

    def connect(self, names: Sequence[str]) -> None:
        """Connect to all names at the same time; raise `LinkError` if no server answers for any of them."""
        self._answers(self._ca.connect, names)

    def numbers(self, *names: str) -> list[float]:
        """Read numbers, all at the same time; raise `LinkError` if an answer is late, or is not a number."""
        return [number for number, _ in self.timed(*names)]

    def timed(self, *names: str) -> list[tuple[float, float]]:
        """Read numbers as `numbers`, each with the time [s] at which its record was processed, by the IOC's clock."""
        numbers = []
        for name, value in zip(names, self._get(names, format=self._ca.FORMAT_TIME), strict=True):
            try:
                numbers.append((float(value), float(value.timestamp)))
            except (TypeError, ValueError) as error:
                raise LinkError(f"{self.prefix}{name}: got {repr(value)[:_QUOTED]}, need a number") from error
        return numbers

    def text(self, name: str) -> str:
        """Read a text, short or long."""
        (value,) = self._get([name])
        if isinstance(value, str):
            return str(value).strip()
        return bytes(np.atleast_1d(value).astype(np.uint8)).split(b"\0")[0].decode(errors="replace").strip()

    def limits(self, name: str) -> tuple[float, float]:
        """Return the control limits of a number's record; 0 and 0 if it has none."""
        (value,) = self._get([name], format=self._ca.FORMAT_CTRL)
        return float(getattr(value, "lower_ctrl_limit", 0.0)), float(getattr(value, "upper_ctrl_limit", 0.0))

    def metres(self, name: str) -> float:
        """Return the unit of a record in metres; raise `LinkError` if it is not a length."""
        (value,) = self._get([name], format=self._ca.FORMAT_CTRL, count=1)
        unit = str(getattr(value, "units", "")).strip()
        count = COUNTS["m"].get(symbol_of(unit)) if unit else None
        if count is None:
            raise LinkError(
                f"{self.prefix}{name}: its unit is {unit!r}, need m, mm, um or nm; correct EGU in its record"
            )
        return 1 / count

    def put(self, name: str, value: float) -> None:
        """Write a number, and wait until the IOC has processed it.

        Raise `LinkError` if there is no answer in time: the value may have been written, or not. Raise `DeviceError` if
        it is refused.
        """

        async def request(pvs: list[str], **options: Any) -> list[Any]:
            return [await self._ca.caput(pvs[0], value, wait=True, **options)]

        self._answers(request, [name])

    def _get(self, names: Sequence[str], **options: Any) -> list[Any]:
        return self._answers(self._ca.caget, names, **options)

    def _answers(self, request: Any, names: Sequence[str], **options: Any) -> list[Any]:
        """Return the answers to a request on these variables; raise LinkError or DeviceError if one failed."""
        pvs = [self.prefix + name for name in names]
        task = request(pvs, timeout=self.timeout, throw=False, **options)
        future = asyncio.run_coroutine_threadsafe(task, _LOOP)
        try:
            answers: list[Any] = future.result()
        except BaseException:
            future.cancel()
            raise
        for pv, answer in zip(pvs, answers, strict=True):
            if answer.ok:
                continue
            if answer.errorcode not in _SILENT:
                raise DeviceError(f"{pv}: {str(answer).removeprefix(pv + ': ')}; may this client write it?")
            # After a lost answer the next waits are shorter: a retreat must not take minutes.
            waited, self.timeout = self.timeout, min(_WAIT_AFTER_LOSS, self.timeout)
            raise LinkError(f"{pv}: no answer within {waited:g} s; {HINT}")
        return answers


@dataclass(frozen=True)
class PvNames:
    """Names of process variables without the prefix; None for those that an IOC does not have.

    Voltages are in V, positions in the unit of their record's EGU: m, mm, um or nm. The device's limits are
    those of the voltage's record, DRVL and DRVH.
    """

    voltage: str = "VOLTAGE"
    readback: str = "VOLTAGE:RBV"
    position: str = "POSITION"
    identity: str | None = "IDN"


class EpicsRig(AbstractRig):
    """A rig behind an IOC's process variables, made by `connect`; this computer times every voltage."""

    def __init__(
        self, link: ChannelAccess, names: PvNames, *, limits: tuple[float, float] | None, slew_rate: float | None
    ) -> None:
        self._link, self._names = link, names
        identity = "" if names.identity is None else link.text(names.identity)
        self._metres = link.metres(names.position)
        self._began = self._now()
        name = f"epics://{link.prefix.removesuffix(':')}" + (f" ({identity})" if identity else "")
        low, high = link.limits(names.voltage)
        if not low < high:
            low, high = limits or (low, high)
        if not low < high:
            raise RigError(
                f"{link.prefix}{names.voltage}: its limits are {low:g} to {high:g} V; set DRVL and DRVH in its record"
            )
        super().__init__(name, VoltageLimits(low, high), limits=limits, slew_rate=slew_rate)

    @classmethod
    def connect(
        cls,
        prefix: str,
        *,
        limits: tuple[float, float] | None = None,
        slew_rate: float | None = None,
        timeout: float = 5.0,
        names: PvNames = PvNames(),
    ) -> Self:
        """Connect to all variables; nothing is sent.

        Raise `LinkError` if variables are missing, `RigError` if the device's limits are not an interval.

        Parameters
        ----------
        prefix : str
            Prefix of all `names`; a colon is added if it ends in a letter or digit.
        limits : (float, float), optional
            Voltages that the user allows [V]; needed if the voltage's record has no limits.
        slew_rate : float, optional
            Largest abs(dv/dt) [V/s] that the user allows.
        timeout : float, optional
            Seconds that one exchange may take.
        """
        link = ChannelAccess(f"{prefix}:" if prefix[-1:].isalnum() else prefix, timeout)
        link.connect([name for name in astuple(names) if name is not None])
        return cls(link, names, limits=limits, slew_rate=slew_rate)

    def _read(self) -> Reading:
        voltage, position = self._link.numbers(self._names.readback, self._names.position)
        return Reading(self._now() - self._began, voltage, self._metres * position)

    def _read_voltage(self) -> float:
        deadline = time.monotonic() + _LONGEST_READBACK_WAIT
        while True:
            (_, commanded), (voltage, read) = self._link.timed(self._names.voltage, self._names.readback)
            if read >= commanded or time.monotonic() > deadline:
                return voltage
            self._wait(_POLL_READBACK)

    def _put(self, voltage: float) -> None:
        self._link.put(self._names.voltage, voltage)
        (taken,) = self._link.numbers(self._names.voltage)
        if not abs(taken - voltage) <= _ROUNDING * (self.limits.high - self.limits.low):
            raise DeviceError(
                f"{self.name}: took {taken:.6g} V when {voltage:.6g} V was sent: its limits are narrower than it "
                "reports, or another client sends too"
            )

    def _halt(self) -> None:
        """Do nothing: nothing plays by itself."""

    def _close(self) -> None:
        """Leave the channels open: they belong to the process, and another rig may use them."""
