"""A rig behind EPICS Channel Access: a laboratory's own IOC, by names of its process variables and blocking calls."""

from __future__ import annotations

import asyncio
import threading
import time
import warnings
from collections.abc import Coroutine, Iterator, Sequence
from dataclasses import astuple, dataclass, replace
from typing import Any, Self, TypeVar

import numpy as np

from dehyst._errors import DeviceError, LinkError, MissingExtraError, RigError
from dehyst._types import Array
from dehyst._units import COUNTS, symbol_of
from dehyst.control import VoltageLimits
from dehyst.instruments.base import AbstractRig
from dehyst.instruments.waves import HIGHEST_RATE, Reading, Samples, host_timed

# Seconds between two polls of a wave; reading samples takes this share of the time at most.
_POLL, _SHARE = 0.1, 0.1
# Seconds that the recorder may lag behind the wave's end, and sample periods without a new sample.
_LATE, _SILENT = 1.0, 5
# Rounding of a voltage that the IOC takes, as a share of the range.
_ROUNDED = 1e-3
# Most time [s] to wait for a reading of the voltage that is younger than the last command, and between two polls.
_STALE, _POLL_READBACK = 0.5, 0.01
# ECA_TIMEOUT of Channel Access.
_TIMED_OUT = 80
# Characters of an answer that a message quotes.
_QUOTED = 60
HINT = "is the IOC running, and does EPICS_CA_ADDR_LIST lead to it?"

_Value = TypeVar("_Value")


# The event loop, in a thread of its own, for all exchanges of this process; it runs until the process ends: channels
# belong to the loop that made them, and Channel Access calls it back as long as they exist.
_LOOP = asyncio.new_event_loop()
threading.Thread(target=_LOOP.run_forever, name="dehyst instruments", daemon=True).start()


def _run(task: Coroutine[Any, Any, _Value]) -> _Value:
    """Return the result of a coroutine; if the wait is interrupted, cancel the coroutine."""
    future = asyncio.run_coroutine_threadsafe(task, _LOOP)
    try:
        return future.result()
    except BaseException:
        future.cancel()
        raise


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

    def absent(self, names: Sequence[str]) -> list[str]:
        """Return the names for which no server answers within the timeout."""
        pvs = [self.prefix + name for name in names]
        answers = _run(self._ca.connect(pvs, timeout=self.timeout, throw=False))
        return [name for name, answer in zip(names, answers, strict=True) if not answer.ok]

    def connected(self, *names: str) -> bool:
        """Return whether these variables, which were used before, are connected now."""
        return _run(self._unconnected()).isdisjoint(self.prefix + name for name in names)

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

    def arrays(self, *names: str, count: int) -> list[Array]:
        """Read the first `count` numbers of each array; raise `LinkError` if an answer is late, or has fewer."""
        columns = [np.atleast_1d(np.asarray(value)) for value in self._get(names, count=count)]
        for name, values in zip(names, columns, strict=True):
            if values.size < count or values.dtype.kind not in "fiu":
                raise LinkError(
                    f"{self.prefix}{name}: got {values.size} values of {values.dtype}, need {count} numbers"
                )
        return [values[:count].astype(np.float64) for values in columns]

    def text(self, name: str) -> str:
        """Read a text, short or long."""
        (value,) = self._get([name])
        if isinstance(value, str):
            return str(value)
        return bytes(np.atleast_1d(np.asarray(value)).astype(np.uint8)).split(b"\0")[0].decode(errors="replace")

    def limits(self, name: str) -> tuple[float, float]:
        """Return the control limits of a number's record; 0 and 0 if it has none."""
        (value,) = self._get([name], format=self._ca.FORMAT_CTRL)
        return float(getattr(value, "lower_ctrl_limit", 0.0)), float(getattr(value, "upper_ctrl_limit", 0.0))

    def metres(self, name: str) -> float | None:
        """Return the unit of a record in metres, None if it has none; raise `LinkError` if it is not a length."""
        (value,) = self._get([name], format=self._ca.FORMAT_CTRL, count=1)
        unit = str(getattr(value, "units", "")).strip()
        count = COUNTS["m"].get(symbol_of(unit))
        if unit and count is None:
            raise LinkError(
                f"{self.prefix}{name}: its unit is {unit!r}, need m, mm, um or nm; correct EGU in its record"
            )
        return 1 / count if count else None

    def length(self, name: str) -> int:
        """Return the capacity of an array, in elements."""
        return int(self._answers(self._ca.cainfo, [name])[0].count)

    def put(self, name: str, value: float | Array | str) -> None:
        """Write a value, and wait until the IOC has processed it.

        Raise `LinkError` if there is no answer in time: the value may have been written, or not. Raise `DeviceError` if
        it is refused.
        """
        long_text = isinstance(value, str) and self.length(name) > 1
        options = {"datatype": self._ca.DBR_CHAR_STR} if long_text else {}

        async def request(pvs: list[str], **more: Any) -> list[Any]:
            return [await self._ca.caput(pvs[0], value, wait=True, **more)]

        self._answers(request, [name], **options)

    def _get(self, names: Sequence[str], **options: Any) -> list[Any]:
        return self._answers(self._ca.caget, names, **options)

    def _answers(self, request: Any, names: Sequence[str], **options: Any) -> list[Any]:
        """Return the answers to a request on these variables; raise LinkError or DeviceError if one failed."""
        pvs = [self.prefix + name for name in names]

        async def answered() -> list[Any]:
            answers: list[Any] = await request(pvs, timeout=self.timeout, throw=False, **options)
            for pv, answer in zip(pvs, answers, strict=True):
                if answer.ok:
                    continue
                if pv in await self._unconnected():
                    raise LinkError(f"{pv}: not connected for {self.timeout:g} s; {HINT}")
                if answer.errorcode == _TIMED_OUT:
                    raise LinkError(
                        f"{pv}: no answer within {self.timeout:g} s, though it is connected; does its IOC hang?"
                    )
                raise DeviceError(f"{pv}: {str(answer).removeprefix(pv + ': ')}; may this client write it?")
            return answers

        return _run(answered())

    async def _unconnected(self) -> set[str]:
        """Return all variables of this process that are not connected; on the loop's thread."""
        return {channel.name for channel in self._ca.get_channel_infos() if not channel.connected}


@dataclass(frozen=True)
class WaveNames:
    """Names of the process variables of a wave generator and its recorder, without the prefix.

    `period` is the time per sample [s]. A put to `start` resets `count` before its callback, `stop` ends the wave.
    """

    voltage: str = "WAVE:VOLTAGE"
    period: str = "WAVE:PERIOD"
    start: str = "WAVE:START"
    stop: str = "WAVE:STOP"
    busy: str = "WAVE:BUSY"
    count: str = "REC:COUNT"
    recorded_time: str = "REC:TIME"
    recorded_voltage: str = "REC:VOLTAGE"
    recorded_position: str = "REC:POSITION"


@dataclass(frozen=True)
class PvNames:
    """Names of process variables without the prefix; None for those that an IOC does not have.

    Voltages are in V, times in s; positions in the unit of their record's EGU: m, mm, um or nm. `error` is a text that
    stays until an empty one overwrites it. `waves`: None for an IOC that plays none.
    """

    voltage: str = "VOLTAGE"
    readback: str = "VOLTAGE:RBV"
    position: str = "POSITION"
    time: str | None = "TIME"
    identity: str | None = "IDN"
    error: str | None = "ERROR"
    low: str | None = "LIMIT:LOW"
    high: str | None = "LIMIT:HIGH"
    slew: str | None = "SLEW"
    waves: WaveNames | None = WaveNames()

    @property
    def all(self) -> list[str]:
        """All names, without those that are None."""
        waves = () if self.waves is None else astuple(self.waves)
        return [name for name in (*astuple(replace(self, waves=None)), *waves) if name is not None]


class EpicsRig(AbstractRig):
    """A rig behind an IOC's process variables; made by `connect`."""

    def __init__(
        self, link: ChannelAccess, names: PvNames, *, limits: tuple[float, float] | None, slew_rate: float | None
    ) -> None:
        self._link, self._names, self._waves = link, names, names.waves
        identity = "" if names.identity is None else link.text(names.identity).strip()
        # A record without a unit is in um, as those of the emulator.
        self._metres = link.metres(names.position) or 1e-6
        self._recorded_metres, longest = self._metres, None
        if waves := self._waves:
            self._recorded_metres = link.metres(waves.recorded_position) or self._metres
            self._tables = [waves.recorded_time, waves.recorded_voltage, waves.recorded_position]
            longest = min(link.length(table) for table in (waves.voltage, *self._tables))
        self._last, self._began = 0.0, time.monotonic()
        # The variable of the last command.
        self._commanded = names.voltage
        name = f"epics://{link.prefix.removesuffix(':')}" + (f" ({identity})" if identity else "")
        super().__init__(name, self._device_limits(limits), limits=limits, slew_rate=slew_rate, longest=longest)
        self._clear_error()

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

        Raise `LinkError` if variables are missing, `RigError` if the device's limits are not an interval. Warn if all
        variables for waves are missing: the host then times every voltage, slowly.

        Parameters
        ----------
        prefix : str
            Of all `names`; a colon is added to one that ends in a letter or digit.
        limits : (float, float), optional
            Voltages that the user allows [V]. Limits of the device come from their own variables, or from the limits of
            the voltage's record.
        slew_rate : float, optional
            Largest abs(dv/dt) [V/s] that the user allows.
        timeout : float, optional
            Seconds that one exchange may take.
        """
        link = ChannelAccess(f"{prefix}:" if prefix[-1:].isalnum() else prefix, timeout)
        names = _available(link, names)
        return cls(link, names, limits=limits, slew_rate=slew_rate)

    def nearest_rate(self, sample_rate: float) -> float:
        """Set `sample_rate` [Hz], and return the rate to which the device rounds it."""
        if self._waves is None:
            return min(sample_rate, HIGHEST_RATE)
        self._link.put(self._waves.period, 1 / sample_rate)
        self._raise_error()
        (period,) = self._link.numbers(self._waves.period)
        if not period > 0:
            raise DeviceError(
                f"{self.name}: its sample period is {period:.6g} s where {sample_rate:.6g} Hz was requested"
            )
        return 1 / period

    def _read(self) -> Reading:
        names = self._names
        voltage, position, *clock = self._link.numbers(names.readback, names.position, *filter(None, [names.time]))
        now = clock[0] if clock else time.monotonic() - self._began
        return Reading(now, voltage, self._metres * position)

    def _read_voltage(self) -> float:
        deadline = time.monotonic() + _STALE
        while True:
            (_, commanded), (voltage, read) = self._link.timed(self._commanded, self._names.readback)
            if read >= commanded or time.monotonic() > deadline:
                return voltage
            self._wait(_POLL_READBACK)

    def _put(self, voltage: float) -> None:
        self._commanded = self._names.voltage
        self._link.put(self._names.voltage, voltage)
        self._raise_error()
        (taken,) = self._link.numbers(self._names.voltage)
        if not abs(taken - voltage) <= _ROUNDED * (self.limits.high - self.limits.low):
            raise DeviceError(
                f"{self.name}: took {taken:.6g} V when {voltage:.6g} V was sent: its limits are narrower than it "
                "reports, or another client sends too"
            )

    def _wave(self, voltage: Array, rate: float) -> Iterator[Samples]:
        if (waves := self._waves) is None:
            yield from host_timed(self, voltage, rate)
            return
        for name, value in ((waves.voltage, voltage), (waves.period, 1 / rate), (waves.start, 1)):
            self._link.put(name, value)
            self._raise_error()
        got, latest, cost, shift = 0, time.monotonic(), 0.0, None
        while got < voltage.size:
            count, idle = self._progress(waves, got, latest, max(self._link.timeout, _SILENT / rate))
            now = time.monotonic()
            if count > got and (count >= voltage.size or idle or now - latest >= cost / _SHARE):
                arrays = self._link.arrays(*self._tables, count=min(count, voltage.size))
                times, volts, positions = (column[got:] for column in arrays)
                latest = time.monotonic()
                cost, got = latest - now, got + times.size
                if shift is None:
                    # Times of a recorder may restart with every wave.
                    shift = 0.0 if times[0] > self._last else self._last + 1 / rate - times[0]
                self._last = float(times[-1] + shift)
                yield Samples(times + shift, volts, self._recorded_metres * positions)
            elif idle and now - latest > _LATE:
                raise DeviceError(
                    f"{self.name}: stopped after {got} of {voltage.size} samples; did another client stop it?"
                )
            if got < voltage.size:
                self._wait(_POLL)

    def _progress(self, waves: WaveNames, got: int, latest: float, patience: float) -> tuple[int, bool]:
        """Return the number of recorded samples, and whether the wave has ended."""
        # In this order: once the end is read, the count includes all samples recorded by then.
        if not self._link.connected(waves.busy, waves.count):
            raise LinkError(f"{self.name}: the connection was lost after {got} samples; the IOC may continue to play")
        busy, count = self._link.numbers(waves.busy, waves.count)
        if not got <= count < float("inf"):
            raise LinkError(
                f"{self.name}: its recorder counts {count:g} after {got} samples; does another client use it?"
            )
        if count == got and busy and time.monotonic() - latest > patience:
            raise LinkError(
                f"{self.name}: no new sample for {patience:.3g} s, {got} so far, though it reports that it plays"
            )
        return int(count), not busy

    def _halt(self) -> None:
        self._clear_error()
        if self._waves is None:
            return
        self._commanded = self._waves.stop
        self._link.put(self._commanded, 1)
        end = time.monotonic() + self._link.timeout
        while self._link.numbers(self._waves.busy)[0]:
            if time.monotonic() > end:
                raise DeviceError(f"{self.name}: still plays {self._link.timeout:g} s after the stop command")
            self._wait(_POLL)

    def _close(self) -> None:
        """Leave the channels open: they belong to the process, and another rig may use them."""

    def _raise_error(self) -> None:
        error = "" if self._names.error is None else self._link.text(self._names.error)
        if error:
            raise DeviceError(f"{self.name}: reports: {error}")

    def _clear_error(self) -> None:
        """Overwrite an earlier error, which would stay."""
        if self._names.error is not None and self._link.text(self._names.error):
            self._link.put(self._names.error, "")

    def _device_limits(self, given: tuple[float, float] | None) -> VoltageLimits:
        """Return the device's limits: its variables, and its record's limits where they are narrower."""
        names, link = self._names, self._link
        low, high = link.limits(names.voltage)
        if names.low is not None and names.high is not None:
            lowest, highest = link.numbers(names.low, names.high)
            low, high = (max(low, lowest), min(high, highest)) if low < high else (lowest, highest)
        elif not low < high and given is not None:
            low, high = given
        if not low < high:
            raise RigError(
                f"{link.prefix}{names.voltage}: its limits are {low:g} to {high:g} V; set DRVL and DRVH in its record"
            )
        slew = 0.0 if names.slew is None else link.numbers(names.slew)[0]
        return VoltageLimits(low, high, slew if slew > 0 else None)


def _available(link: ChannelAccess, names: PvNames) -> PvNames:
    """Return the names, without those for waves if all of these are missing; refuse any other missing name."""
    absent = link.absent(names.all)
    if not absent:
        return names
    if names.waves and set(absent) == set(astuple(names.waves)):
        warnings.warn(
            f"{link.prefix}{absent[0]} and all others for waves are missing: every voltage is timed by this computer, "
            f"{HIGHEST_RATE:g} a second at most and unevenly",
            stacklevel=3,
        )
        return replace(names, waves=None)
    if len(absent) == len(names.all):
        raise LinkError(
            f"{link.prefix}*: none of {len(absent)} process variables answered within {link.timeout:g} s, not even "
            f"{link.prefix}{absent[0]}; {HINT}"
        )
    listed = ", ".join(link.prefix + name for name in absent)
    raise LinkError(
        f"{listed}: no such process variable within {link.timeout:g} s; give names, with None for those it lacks"
    )
