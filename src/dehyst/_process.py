"""Child processes that speak JSON lines: the rig's process, the workers of the workbench, the reader of files.

A line is one object. A child writes with an `Outlet`, which never waits for its reader, and reads with an `Inlet`; both
have their own threads. The parent uses `started`, `written` and `messages` in an event loop. Each child runs in a
session of its own, so that signals to the parent's group or terminal do not reach it, and ends when its input does.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any, BinaryIO

from dehyst._errors import LinkError
from dehyst._io import finite

Message = dict[str, Any]
# Bytes of the longest line that a child reads, and that a parent does.
LONGEST, _LONGEST_ANSWER = 1 << 16, 1 << 26
# Seconds that a message may wait to be written.
_PATIENCE = 5.0


def line_of(message: Mapping[str, Any]) -> bytes:
    """Return a message as a line; numbers that are not finite become null."""
    return json.dumps(finite(message), allow_nan=False).encode() + b"\n"


# The child's end


def own_output() -> int:
    """Return a descriptor of standard output for messages only: the output of libraries is discarded."""
    descriptor = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)
    return descriptor


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


class Inlet:
    """A thread that reads lines and hands over the objects in them.

    Parameters
    ----------
    lines : iterator of bytes or None
        Lines as from `lines_of`.
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
        take: Callable[[Message], None],
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
        shown = line[:60].decode("utf-8", "replace")
        try:
            command = json.loads(line)
        except (ValueError, RecursionError):
            self._refuse(f"got a line that is not JSON: {shown!r}")
            return
        if not isinstance(command, dict):
            self._refuse(f"got {shown!r}, need an object with 'do' or 'alive'")
            return
        self._take(command)


# Waiting messages from which on new live data and progress are dropped, and errors and answers: nobody reads.
_MANY, _TOO_MANY = 50, 1000
_TICK = 0.01
# Seconds without a message after which it sends a sign of life.
_BEAT = 0.25


class Outlet:
    """A queue of messages for the parent, and the thread that writes them.

    If there is nothing to send, it sends a sign of life four times a second.
    If nobody reads, live data and progress are dropped; changes of the state are merged into one that waits. No call
    waits for the reader, and no call holds a lock that a signal could leave locked.

    Parameters
    ----------
    descriptor : int
        Of the open file, usually a pipe.
    kind : str, optional
        Of the messages with changes of the state.

    Attributes
    ----------
    closed : bool
        Whether the reader is gone.
    """

    def __init__(self, descriptor: int, kind: str = "state") -> None:
        self._descriptor, self._kind, self.closed = descriptor, kind, False
        self._waiting: SimpleQueue[Message] = SimpleQueue()
        threading.Thread(target=self._run, name="outlet", daemon=True).start()

    def state(self, **change: Any) -> None:
        """Send the fields of the state that changed."""
        self._waiting.put({"kind": self._kind, **change})

    def progress(self, **change: Any) -> None:
        """Send fields of the state that change often."""
        if self._waiting.qsize() < _MANY:
            self.state(**change)

    def live(self, message: Message) -> None:
        """Send samples, a `message` with its kind."""
        if self._waiting.qsize() < _MANY:
            self._waiting.put(message)

    def error(self, sentence: str) -> None:
        """Send a `sentence` on what was refused or failed."""
        if self._waiting.qsize() < _TOO_MANY:
            self._waiting.put({"kind": "error", "error": sentence})

    def done(self, key: object, **outcome: Any) -> None:
        """Answer the request `key` (None: no answer is needed), because it was done, refused or stopped."""
        if key is not None and self._waiting.qsize() < _TOO_MANY:
            self._waiting.put({"kind": "done", "id": key, **outcome})

    def flush(self, seconds: float) -> bool:
        """Wait at most `seconds` [s] until all messages are written; return whether they are."""
        end, written = time.monotonic() + seconds, threading.Event()
        self._waiting.put({"kind": "flush", "written": written})
        while not (self.closed or written.wait(_TICK)):
            if time.monotonic() > end:
                return False
        return not self.closed

    def _run(self) -> None:
        while True:
            messages = self._merged(self._next())
            self._write(b"".join(line_of(message) for message in messages if message["kind"] != "flush"))
            for message in messages:
                if message["kind"] == "flush":
                    message["written"].set()

    def _next(self) -> Message:
        try:
            return self._waiting.get(timeout=_BEAT)
        except Empty:
            return {"kind": "alive"}

    def _merged(self, first: Message) -> list[Message]:
        """Return all waiting messages, successive changes of the state as one."""
        messages = [first]
        while True:
            try:
                message = self._waiting.get_nowait()
            except Empty:
                return messages
            if message["kind"] == messages[-1]["kind"] == self._kind:
                messages[-1] = {**messages[-1], **message}
            else:
                messages.append(message)

    def _write(self, data: bytes) -> None:
        try:
            while data and not self.closed:
                data = data[os.write(self._descriptor, data) :]
        except OSError:
            self.closed = True


# The parent's end


async def started(
    module: str,
    *arguments: str,
    errors: int | BinaryIO = asyncio.subprocess.DEVNULL,
    folder: os.PathLike[str] | None = None,
    pass_fds: Sequence[int] = (),
) -> asyncio.subprocess.Process:
    """Start a module as a child with pipes, in a session of its own; raise `LinkError` if that is impossible.

    `errors` receives its standard error. It runs in the `folder`, and has the descriptors `pass_fds`.
    """
    try:
        return await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", module, *arguments),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=errors,
            cwd=folder,
            start_new_session=True,
            pass_fds=tuple(pass_fds),
            limit=_LONGEST_ANSWER,
        )
    except OSError as error:
        raise LinkError(f"a process cannot be started ({error.strerror}); is there memory left?") from error


async def written(process: asyncio.subprocess.Process, message: Mapping[str, Any]) -> None:
    """Send a message to a child; raise `LinkError` if the child does not accept it."""
    if process.stdin is None:
        raise LinkError("the process has no input")
    try:
        process.stdin.write(line_of(message))
        await asyncio.wait_for(process.stdin.drain(), _PATIENCE)
    except (TimeoutError, OSError) as error:
        raise LinkError(f"the process takes no commands ({error or 'timeout'})") from error


async def messages(process: asyncio.subprocess.Process) -> AsyncIterator[Message]:
    """Yield the messages of a child until it closes its output; signs of life are empty messages."""
    while process.stdout is not None:
        try:
            line = await process.stdout.readline()
        except ValueError:
            # Longer than any message: the rest is no message either.
            continue
        if not line:
            return
        with suppress(ValueError):
            message = json.loads(line)
            if isinstance(message, dict):
                yield {} if message.get("kind") == "alive" else message
