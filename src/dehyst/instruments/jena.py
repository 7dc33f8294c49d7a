"""An NV200/D amplifier of piezosystem jena as a rig, by the library nv200 of its maker. Tried with an emulator only."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Coroutine, Iterator
from contextlib import suppress
from typing import Any, Self, TypeVar

from dehyst._errors import DeviceError, LinkError, MissingExtraError, RigError
from dehyst._types import Array
from dehyst._units import COUNTS, symbol_of
from dehyst.control import VoltageLimits
from dehyst.instruments.base import AbstractRig, host_timed
from dehyst.instruments.channel_access import event_loop
from dehyst.instruments.gcs_syntax import volts
from dehyst.instruments.samples import Reading, Samples

# Data recorder: no automatic start, piezo voltage in memory 0 and position in memory 1, 20 samples of 50 us.
_RECORDER = ("recast,0", "recsrc,0,2", "recsrc,1,0", "recstr,1", "reclen,20")
# This slew rate [% of the range in 1 ms], and any above, means none.
_NO_SLEW_RATE = 2000.0
# Readings that are timed, and periods of a sample for each: a voltage is sent before it.
_TIMED, _PERIODS = 5, 2.0

_Answer = TypeVar("_Answer")


class JenaRig(AbstractRig):
    """An NV200/D and an actuator with a position sensor, in open loop; made by `connect`.

    NOT TRIED ON HARDWARE: written from the maker's library and its documentation, and tested with an emulator of ours.
    Check the output with an oscilloscope, without an actuator connected, before you trust it.

    Each voltage is a setpoint, and the data recorder then takes the voltage of the piezo and the position at one
    instant. The host times the voltages: some ten a second over Ethernet, more over USB. The waveform generator is not
    used, because no document says what it puts out before and after a wave.

    Parameters
    ----------
    transport : object
        ``TelnetProtocol`` or ``SerialProtocol`` of the library.
    limits : (float, float), optional
        Voltages that the user allows [V].
    slew_rate : float, optional
        Largest abs(dv/dt) [V/s] that the user allows.
    adjust : bool
        Whether the library may set the flow control of the Ethernet module, as it needs.
    """

    def __init__(
        self,
        transport: Any,
        *,
        limits: tuple[float, float] | None = None,
        slew_rate: float | None = None,
        adjust: bool = True,
    ) -> None:
        from nv200.nv200_device import NV200Device

        self._device, self._label = NV200Device(transport), "NV200/D"
        try:
            self._run("its connection", self._device.connect(adjust))
            self._metres = self._demand_open_loop()
            actuator = f"{self._text('desc')} #{self._text('acserno')}"
            low, high, slew = (self._number(query) for query in ("avmin", "avmax", "sr"))
            device = VoltageLimits(low, high, None if slew >= _NO_SLEW_RATE else slew / 100 * (high - low) * 1e3)
            for setting in _RECORDER:
                self._ask(setting)
            self._began = begin = time.monotonic()
            for _ in range(_TIMED):
                self._read()
            self._fastest = _TIMED / (_PERIODS * (time.monotonic() - begin))
            name = f"NV200/D with {actuator} (not tried on hardware)"
            super().__init__(name, device, limits=limits, slew_rate=slew_rate, identity=f"NV200/D {actuator}")
        except BaseException:
            self._close()
            raise

    @classmethod
    def connect(
        cls, address: str, *, limits: tuple[float, float] | None = None, slew_rate: float | None = None
    ) -> Self:
        """Connect to an amplifier by Ethernet, at a host name or number, or by USB, at a port such as /dev/ttyUSB0.

        Raise `RigError` if the loop is closed, the setpoint comes from elsewhere, or the sensor measures no length;
        `LinkError` if nothing answers; `MissingExtraError` if the library is not installed.
        """
        try:
            from nv200.serial_protocol import SerialProtocol
            from nv200.telnet_protocol import TelnetProtocol
        except ImportError as error:
            raise MissingExtraError.of("nv200 (for Python 3.12 and 3.13)", "jena", "An NV200/D") from error
        serial = address.startswith(("/", "COM"))
        transport = SerialProtocol(port=address) if serial else TelnetProtocol(host=address)
        return cls(transport, limits=limits, slew_rate=slew_rate)

    def nearest_rate(self, sample_rate: float) -> float:
        """Return `sample_rate`, or the highest rate [Hz] that the link allowed when the rig was opened."""
        return min(sample_rate, self._fastest)

    def _read(self) -> Reading:
        self._ask("recrun,1")
        now = time.monotonic() - self._began
        return Reading(now, self._number("recout,0,0,1"), self._metres * self._number("recout,1,0,1"))

    def _put(self, voltage: float) -> None:
        self._ask(f"set,{volts(voltage, self.limits.low, self.limits.high)}")

    def _wave(self, voltage: Array, rate: float) -> Iterator[Samples]:
        return host_timed(self, voltage, rate)

    def _halt(self) -> None:
        """Nothing continues to play by itself."""

    def _close(self) -> None:
        with suppress(Exception):
            self._run("its end", self._device.close())

    def _demand_open_loop(self) -> float:
        """Return the metres of a unit of the position; raise RigError if a setpoint would not be a voltage."""
        if self._number("acmeasure") == 0:
            raise RigError(f"{self._label}: its actuator has no position sensor; connect one that has")
        if self._number("cl") != 0:
            raise RigError(
                f"{self._label}: its loop is closed, need open loop; open it there (cl,0) at a low voltage, as the "
                "output may jump"
            )
        if self._number("modsrc") != 0:
            raise RigError(
                f"{self._label}: its setpoint comes from elsewhere; choose USB and Ethernet there (modsrc,0)"
            )
        unit = self._text("unitcl")
        # The library reads bytes as Latin-1.
        for text in (unit, unit.encode("latin1", "replace").decode(errors="replace")):
            if (symbol := symbol_of(text)) in COUNTS["m"]:
                return 1 / COUNTS["m"][symbol]
        raise RigError(f"{self._label}: its position has the unit {unit!r}, need a length such as um")

    def _text(self, query: str) -> str:
        return ",".join(self._ask(query)).strip()

    def _number(self, query: str) -> float:
        """Return the number that a query is answered with, after the indices in it."""
        answer, indices = self._ask(query), query.split(",")[1:3]
        try:
            if answer[: len(indices)] != indices:
                raise ValueError
            return float(answer[len(indices)])
        except (IndexError, ValueError) as error:
            raise LinkError(f"{self._label}: got {','.join(answer)[:40]!r} to {query!r}, need a number") from error

    def _ask(self, command: str) -> list[str]:
        """Send a command; return the answer without the command's name."""

        async def exchange() -> Any:
            # One that is interrupted ends by itself, so that the next one does not get its answer.
            return await asyncio.shield(self._device.read_response(command))

        name, answer = self._run(repr(command), exchange())
        if name and name != command.split(",", maxsplit=1)[0]:
            raise LinkError(f"{self._label}: got an answer to {name[:20]!r} instead of {command!r}")
        return list(answer)

    def _run(self, what: str, task: Coroutine[Any, Any, _Answer]) -> _Answer:
        from nv200.shared_types import DeviceError as Refusal

        try:
            return event_loop.run(task)
        except Refusal as error:
            raise DeviceError(f"{self._label}: refused {what}: {error}") from error
        except (OSError, EOFError, RuntimeError, AttributeError) as error:  # the library's, of a link that was lost too
            raise LinkError(
                f"{self._label}: {what} failed ({str(error) or type(error).__name__}); check cable, address and power"
            ) from error
