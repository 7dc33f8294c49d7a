"""The commands of the rig process: JSON lines on standard input, read by a thread of its own."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable, Iterator
from typing import Any

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
