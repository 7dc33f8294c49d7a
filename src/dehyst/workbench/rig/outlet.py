"""The messages of the rig process: JSON lines, written by a thread of its own so that no reader can block the rig."""

from __future__ import annotations

import json
import os
import threading
import time
from queue import Empty, SimpleQueue
from typing import Any

from dehyst._io.json_files import finite

# Waiting messages from which on new live data and progress are dropped.
_MANY = 50
# Waiting messages from which on new errors are dropped: nobody reads.
_TOO_MANY = 1000
_TICK = 0.01


class Outlet:
    """A queue of messages for the server, and the thread that writes them.

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
            messages = self._merged(self._waiting.get())
            self._write(b"".join(_line(message) for message in messages if message["kind"] != "flush"))
            for message in messages:
                if message["kind"] == "flush":
                    message["written"].set()

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
