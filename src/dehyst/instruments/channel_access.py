"""Process variables with a common prefix, read and written over EPICS Channel Access by blocking calls."""

from __future__ import annotations

import asyncio
import concurrent.futures
import threading
from collections.abc import Coroutine, Sequence
from typing import Any, TypeVar

import numpy as np

from dehyst._errors import DeviceError, LinkError, MissingExtraError
from dehyst._types import Array
from dehyst._units import COUNTS, symbol_of

# ECA_TIMEOUT of Channel Access.
_TIMED_OUT = 80
# Characters of an answer that a message quotes.
_QUOTED = 60
HINT = "is the IOC running, and does EPICS_CA_ADDR_LIST lead to it?"

_Value = TypeVar("_Value")


class EventLoop:
    """The event loop, in a thread of its own, for all exchanges of this process; it runs until the process ends.

    Channels belong to the loop that made them, and Channel Access calls it back as long as they exist.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._loop: asyncio.AbstractEventLoop | None = None

    def run(self, task: Coroutine[Any, Any, _Value]) -> _Value:
        """Return the result of a coroutine; if the wait is interrupted, cancel the coroutine."""
        with self._lock:
            if self._loop is None:
                self._loop = asyncio.new_event_loop()
                threading.Thread(target=self._loop.run_forever, name="dehyst instruments", daemon=True).start()
            future: concurrent.futures.Future[_Value] = asyncio.run_coroutine_threadsafe(task, self._loop)
        try:
            return future.result()
        except BaseException:
            future.cancel()
            raise


event_loop = EventLoop()


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
        answers = event_loop.run(self._ca.connect(pvs, timeout=self.timeout, throw=False))
        return [name for name, answer in zip(names, answers, strict=True) if not answer.ok]

    def connected(self, *names: str) -> bool:
        """Return whether these variables, which were used before, are connected now."""

        async def unconnected() -> set[str]:
            return self._unconnected()

        return event_loop.run(unconnected()).isdisjoint(self.prefix + name for name in names)

    def numbers(self, *names: str) -> list[float]:
        """Read numbers, all at the same time; raise `LinkError` if an answer is late, or is not a number."""
        numbers = []
        for name, value in zip(names, self._get(names), strict=True):
            try:
                numbers.append(float(value))
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
                if pv in self._unconnected():
                    raise LinkError(f"{pv}: not connected for {self.timeout:g} s; {HINT}")
                if answer.errorcode == _TIMED_OUT:
                    raise LinkError(
                        f"{pv}: no answer within {self.timeout:g} s, though it is connected; does its IOC hang?"
                    )
                raise DeviceError(f"{pv}: {str(answer).removeprefix(pv + ': ')}; may this client write it?")
            return answers

        return event_loop.run(answered())

    def _unconnected(self) -> set[str]:
        """Return all variables of this process that are not connected; on the loop's thread."""
        return {channel.name for channel in self._ca.get_channel_infos() if not channel.connected}
