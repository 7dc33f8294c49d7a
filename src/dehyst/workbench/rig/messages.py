"""Messages of the rig process: JSON lines, read and written by threads of their own, and the checks of their fields."""

from __future__ import annotations

import json
import math
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from dehyst._errors import RigError
from dehyst._io import finite

# Bytes of the longest line.
LONGEST = 1 << 16


class Inlet:
    """A thread that reads lines and hands over the objects in them.

    Parameters
    ----------
    lines : iterator of bytes or None
        As `lines_of` yields them.
    take : callable
        Called with each object, in the thread.
    refuse : callable
        Called with a sentence for each line that holds no object.
    end : callable
        Called once, when the other end is closed.
    """

    def __init__(
        self,
        lines: Iterator[bytes | None],
        take: Callable[[dict[str, Any]], None],
        refuse: Callable[[str], None],
        end: Callable[[], None],
    ) -> None:
        self._lines, self._take, self._refuse, self._end = lines, take, refuse, end

    def start(self) -> None:
        """Begin to read."""
        threading.Thread(target=self._run, name="inlet", daemon=True).start()

    def _run(self) -> None:
        try:
            for line in self._lines:
                self._hand_over(line)
        finally:
            self._end()

    def _hand_over(self, line: bytes | None) -> None:
        if line is None:
            self._refuse(f"got a line of more than {LONGEST} bytes, which was ignored")
            return
        try:
            command = json.loads(line)
        except (ValueError, RecursionError):
            self._refuse(f"got a line that is not JSON: {line[:60].decode('utf-8', 'replace')!r}")
            return
        if not isinstance(command, dict):
            self._refuse(f"got {line[:60].decode('utf-8', 'replace')!r}, need an object with 'do' or 'alive'")
            return
        self._take(command)


def lines_of(descriptor: int) -> Iterator[bytes | None]:
    """Yield the lines of a `descriptor` until its end, without line ends; None for one that is too long."""
    buffer, overlong = bytearray(), False
    while True:
        try:
            data = os.read(descriptor, LONGEST)
        except OSError:
            return
        if not data:
            return
        buffer += data
        *lines, rest = bytes(buffer).split(b"\n")
        for line in lines:
            if overlong or len(line) > LONGEST:
                yield None
            elif line.strip():
                yield line
            overlong = False
        overlong = overlong or len(rest) > LONGEST
        buffer = bytearray() if overlong else bytearray(rest)


# Waiting messages from which on new live data and progress are dropped.
_MANY = 50
# Waiting messages from which on new errors are dropped: nobody reads.
_TOO_MANY = 1000
_TICK = 0.01
# Seconds without a message after which it sends a sign of life.
_BEAT = 0.25


class Outlet:
    """A queue of messages for the server, and the thread that writes them.

    If there is nothing to send, it sends a sign of life four times a second.
    If nobody reads, live data and progress are dropped; changes of the state wait, merged into one. No call waits for
    the reader, and none holds a lock that a signal could leave locked.

    Parameters
    ----------
    descriptor : int
        Of the open file, usually a pipe.

    Attributes
    ----------
    closed : bool
        Whether the reader is gone.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor, self.closed = descriptor, False
        self._waiting: SimpleQueue[dict[str, Any]] = SimpleQueue()
        threading.Thread(target=self._run, name="outlet", daemon=True).start()

    def state(self, **change: Any) -> None:
        """Send the fields of the state that changed."""
        self._waiting.put({"kind": "rig", **change})

    def progress(self, **change: Any) -> None:
        """Send fields of the state that soon change again."""
        if self._waiting.qsize() < _MANY:
            self.state(**change)

    def live(self, message: dict[str, Any]) -> None:
        """Send samples, a `message` with its kind."""
        if self._waiting.qsize() < _MANY:
            self._waiting.put(message)

    def error(self, sentence: str) -> None:
        """Send a `sentence` on what was refused or failed."""
        if self._waiting.qsize() < _TOO_MANY:
            self._waiting.put({"kind": "error", "error": sentence})

    def done(self, key: object, **outcome: Any) -> None:
        """Answer the request `key`, None if it wants no answer: it was done, refused or stopped."""
        if key is not None and self._waiting.qsize() < _TOO_MANY:
            self._waiting.put({"kind": "done", "id": key, **outcome})

    def flush(self, seconds: float) -> bool:
        """Wait until all is written, for so many `seconds` at most; return whether it is."""
        end, written = time.monotonic() + seconds, threading.Event()
        self._waiting.put({"kind": "flush", "written": written})
        while not (self.closed or written.wait(_TICK)):
            if time.monotonic() > end:
                return False
        return not self.closed

    def _run(self) -> None:
        while True:
            messages = self._merged(self._next())
            self._write(b"".join(_line(message) for message in messages if message["kind"] != "flush"))
            for message in messages:
                if message["kind"] == "flush":
                    message["written"].set()

    def _next(self) -> dict[str, Any]:
        try:
            return self._waiting.get(timeout=_BEAT)
        except Empty:
            return {"kind": "alive"}

    def _merged(self, first: dict[str, Any]) -> list[dict[str, Any]]:
        """Return all waiting messages, successive changes of the state as one."""
        messages = [first]
        while True:
            try:
                message = self._waiting.get_nowait()
            except Empty:
                return messages
            if message["kind"] == messages[-1]["kind"] == "rig":
                messages[-1] = {**messages[-1], **message}
            else:
                messages.append(message)

    def _write(self, data: bytes) -> None:
        try:
            while data and not self.closed:
                data = data[os.write(self._descriptor, data) :]
        except OSError:
            self.closed = True


def _line(message: dict[str, Any]) -> bytes:
    return json.dumps(finite(message), allow_nan=False).encode() + b"\n"


Request = dict[str, Any]


def text(request: Request, name: str) -> str:
    """Return the field `name` of a `request`; raise `RigError` if it is no text."""
    value = request.get(name)
    if not isinstance(value, str) or not value:
        raise RigError(f"{request['do']}: got {name} {value!r}, need a text")
    return value


def path(request: Request, name: str) -> Path:
    """Return the field `name` of a `request` as a path; raise `RigError` if it is no text."""
    value = text(request, name)
    if "\0" in value:
        raise RigError(f"{request['do']}: {name} is not the name of a file")
    return Path(value)


def number(request: Request, name: str, default: float | None = None) -> float | None:
    """Return the field `name` of a `request`, or `default` if it is null; raise `RigError` if it is no number."""
    value = request.get(name)
    if value is None:
        return default
    with suppress(OverflowError):  # a whole number beyond all floats
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
            return float(value)
    raise RigError(f"{request['do']}: got {name} {str(value)[:60]}, need a finite number")


def pair(request: Request, name: str) -> tuple[float, float] | None:
    """Return the field `name` of a `request`, two numbers or null; raise `RigError` if it is neither."""
    value = request.get(name)
    if value is None:
        return None
    if not isinstance(value, list) or len(value) != 2:
        raise RigError(f"{request['do']}: got {name} {str(value)[:60]}, need [lowest, highest]")
    low, high = (number({"do": request["do"], name: end}, name) for end in value)
    if low is None or high is None:
        raise RigError(f"{request['do']}: got {name} {value}, need two numbers")
    return low, high
