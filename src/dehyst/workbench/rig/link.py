"""The server's end of the rig process: it starts the process, sends commands and passes its messages on."""

from __future__ import annotations

import asyncio
import secrets
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from dehyst._errors import LinkError
from dehyst._process import Message, line_of, messages, started, written
from dehyst.workbench.rig.driver import OF_RIG
from dehyst.workbench.rig.process import rescue

_MODULE = "dehyst.workbench.rig.process"
# Bytes that may wait to be written.
_MOST_WAITING = 1 << 16
# Seconds that the process has to retreat and end.
_RETREAT = 60.0
# Seconds to wait for one that was about to end when it got a command.
_ENDS = 10.0
# Seconds that the process has until its first message.
_BEGIN = 10.0
_ARMED = ("armed", "playing", "calibrating", "stopping")
_ALIVE = line_of({"alive": True})
_NO_RIG: Message = dict.fromkeys((*OF_RIG, "step"))


class RigLink:
    """A link to the process that holds the rig.

    The process is in a session of its own: signals to the server's group or terminal do not reach it. When this process
    ends in any way, the rig's process retreats and ends by itself. If the rig's process ends while armed, without a
    retreat, a fresh process connects to the rig and retreats.

    Parameters
    ----------
    on_message : callable
        Called in the event loop with each message: a dict whose "kind" is "rig", "live" or "error". It must not block.
    origins : sequence of str
        Origins of the page that may send the emergency stop: ``["http://127.0.0.1:8000", "http://localhost:8000"]``.
    folder : Path, optional
        Folder in which the process runs, to which names of files refer.
    errors : Path, optional
        File for the standard error of the process; by default it is discarded.

    Attributes
    ----------
    stop : dict
        Port and key of the emergency stop. Each process has a socket and a key of its own; the port stays the same if
        it is still free.
    """

    def __init__(
        self,
        on_message: Callable[[Message], None],
        *,
        origins: Sequence[str] = (),
        folder: Path | None = None,
        errors: Path | None = None,
    ) -> None:
        self._on_message, self._origins, self._folder, self._errors = on_message, list(origins), folder, errors
        self._listening = _bound(0)
        self.stop: dict[str, Any] = {"port": self._listening.getsockname()[1], "key": ""}
        self._process: asyncio.subprocess.Process | None = None
        self._reader: asyncio.Task[None] | None = None
        self._state: Message = {}
        self._starting, self._ending, self._heard_at = asyncio.Lock(), False, 0.0

    @property
    def running(self) -> bool:
        """Whether the process runs."""
        return self._process is not None

    @property
    def pid(self) -> int | None:
        """Number of the process, if it runs."""
        return None if self._process is None else self._process.pid

    @property
    def silent(self) -> float:
        """Seconds since the process sent its last message; 0 if it does not run."""
        return 0.0 if self._process is None else max(0.0, time.monotonic() - self._heard_at)

    async def start(self) -> None:
        """Start the process, if it does not run; raise `LinkError` if it cannot be started.

        Of two simultaneous calls, the second one waits for the first. A call while a process ends waits for its end.
        """
        async with self._starting:
            if self._ending and self._reader is not None:
                await asyncio.shield(self._reader)
            if self._process is not None:
                return
            listening = self._listening.fileno()
            self._state, self.stop["key"] = {}, secrets.token_urlsafe(32)
            self._heard_at = time.monotonic() + _BEGIN
            self._process = await self._started(_MODULE, "--stop-fd", str(listening), pass_fds=(listening,))
            # The process has its own copy: with it ends the socket.
            self._listening.close()
            if self._process.stdin is not None:
                self._process.stdin.write(line_of({"stop_key": self.stop["key"], "origins": self._origins}))
            self._reader = asyncio.create_task(self._read(self._process), name="rig link")

    async def send(self, command: Message) -> None:
        """Send a command such as ``{"do": "arm", "limits": [0, 100], "slew": 100}``.

        Raises
        ------
        LinkError
            If the process does not run, or takes no commands.
        """
        process, reader = self._process, self._reader
        if process is None:
            raise LinkError("the rig's process does not run; connect the rig again")
        try:
            await written(process, command)
        except LinkError as error:
            if command.get("do") != "connect" or reader is None or process.stdin is None:
                raise LinkError(f"the rig: {error}; connect it again") from error
            # The process was about to end when it got the command: another one connects.
            process.stdin.close()
            try:
                await asyncio.wait_for(asyncio.shield(reader), _ENDS)
                await self.start()
                if self._process is not None:
                    await written(self._process, command)
            except (LinkError, TimeoutError) as again:
                raise LinkError(f"the rig: {error}; connect it again") from again

    def alive(self) -> None:
        """Forward a sign of life of the page; does nothing if the process does not run."""
        stdin = None if self._process is None else self._process.stdin
        if stdin is None or stdin.is_closing():
            return
        if stdin.transport.get_write_buffer_size() < _MOST_WAITING:
            stdin.write(_ALIVE)

    async def close(self) -> None:
        """Let the process retreat and end; wait for it at most a minute, and never kill it."""
        async with self._starting:
            process, reader = self._process, self._reader
        if process is not None and process.stdin is not None:
            process.stdin.close()
        if reader is not None:
            with suppress(TimeoutError):
                await asyncio.wait_for(asyncio.shield(reader), _RETREAT)
        self._listening.close()

    async def _started(self, module: str, *arguments: str, **options: Any) -> asyncio.subprocess.Process:
        if self._errors is None:
            return await started(module, *arguments, folder=self._folder, **options)
        with self._errors.open("ab") as errors:
            return await started(module, *arguments, folder=self._folder, errors=errors, **options)

    async def _read(self, process: asyncio.subprocess.Process) -> None:
        """Pass messages on until the process, and a fresh one that replaces it, have ended."""
        await self._pass_on(process)
        self._ending = True
        status = await process.wait()
        state = self._state
        if status and state.get("status") in _ARMED:
            await self._rescue(f"the rig's process ended, with status {status}, before the voltage was safe")
        self._process, self._ending = None, False
        self._listening = _renewed(self.stop["port"])
        self.stop["port"] = self._listening.getsockname()[1]
        words = self._state.get("words", [])
        final = "lost" if self._state.get("status") == "lost" else "none"
        self._hand_over({"kind": "rig", "status": final, **_NO_RIG, "words": words})

    async def _rescue(self, reason: str) -> None:
        address, limits, slew = (self._state.get(name) for name in ("address", "limits", "slew"))
        if not isinstance(address, str) or not isinstance(limits, list) or slew is None:
            return
        self._hand_over({"kind": "rig", "status": "stopping", "words": [f"Stopped: {reason}."]})
        with suppress(LinkError):
            module, *arguments = rescue(address, (limits[0], limits[1]), slew, reason, waits=False)
            fresh = await self._started(module, *arguments)
            await self._pass_on(fresh)
            await fresh.wait()

    async def _pass_on(self, process: asyncio.subprocess.Process) -> None:
        async for message in messages(process):
            self._hand_over(message)

    def _hand_over(self, message: Message) -> None:
        self._heard_at = time.monotonic()
        if not message:
            return
        if message.get("kind") == "rig":
            self._ending = message.pop("ends", self._ending)
            if "stop" in message:
                message = {**message, "stop": dict(self.stop)}
            self._state.update(message)
        try:
            self._on_message(message)
        # A fault of the receiver must not leave the pipe unread.
        except Exception as error:
            trouble = {"message": "a message of the rig's process was not taken", "exception": error}
            asyncio.get_running_loop().call_exception_handler(trouble)


def _bound(port: int) -> socket.socket:
    """Return a socket at this port of 127.0.0.1 that refuses connections until a process listens."""
    bound = socket.socket()
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    bound.bind(("127.0.0.1", port))
    return bound


def _renewed(port: int) -> socket.socket:
    """Return a socket at this port that nobody listens at; at another one if it is taken."""
    try:
        return _bound(port)
    except OSError:
        return _bound(0)
