"""A TCP server of an emulated controller: one client at a time, as on real ones. One thread, nothing blocks."""

from __future__ import annotations

import errno
import select
import socket
import threading
import time
from contextlib import suppress
from types import TracebackType
from typing import Self

from dehyst._errors import LinkError
from dehyst.virtual.emulator.faults import Rehearsal
from dehyst.virtual.emulator.gcs_controller import Controller

PORT = 50000
# Seconds between updates of the instrument, and until a client that takes no answers is disconnected.
_TICK, _PATIENCE = 0.02, 10.0
# Bytes of the longest line, and of waiting answers beyond which no further commands are read.
_LONGEST_LINE, _MOST_WAITING = 65536, 1 << 20
_SINGLE = frozenset((5, 7, 9, 24))


class _Client:
    """A connection: the bytes received, and those that wait to be sent."""

    def __init__(self, link: socket.socket) -> None:
        link.setblocking(False)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        link.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        # A client that vanished without closing must not block the next one for hours.
        for option, value in (("TCP_KEEPIDLE", 10), ("TCP_KEEPINTVL", 5), ("TCP_KEEPCNT", 2)):
            if hasattr(socket, option):
                link.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
        self.link, self.received, self.waiting = link, bytearray(), bytearray()
        self.overlong, self.ended, self.last_sent = False, False, time.monotonic()

    @property
    def full(self) -> bool:
        """Whether no more commands are read until answers have been taken."""
        return len(self.waiting) >= _MOST_WAITING

    @property
    def ready(self) -> bool:
        """Whether a command is waiting, and there is room for its answer."""
        whole = self.received[:1] and (self.received[0] in _SINGLE or b"\n" in self.received)
        return bool(whole) and not self.full

    def receive(self) -> None:
        """Read what has arrived; raise OSError if the connection broke."""
        with suppress(BlockingIOError):
            data = self.link.recv(_LONGEST_LINE)
            self.ended = not data
            self.received += data

    def send(self) -> None:
        """Send what the connection takes; raise OSError if it broke, or takes nothing for long."""
        now = time.monotonic()
        if not self.waiting:
            self.last_sent = now
            return
        with suppress(BlockingIOError):
            del self.waiting[: self.link.send(self.waiting)]
            self.last_sent = now
        if now - self.last_sent > _PATIENCE:
            raise ConnectionAbortedError("takes no answers")

    def command(self) -> bytes:
        """Remove the first command from the received bytes: a command of one byte, or else a line."""
        size = 1 if self.received[0] in _SINGLE and not self.overlong else self.received.index(b"\n") + 1
        command = bytes(self.received[:size])
        del self.received[:size]
        if self.overlong:
            self.overlong = False
            return b"\0" * (_LONGEST_LINE + 1)
        return command

    def forget_overlong(self) -> None:
        """Drop the beginning of a line that does not end."""
        if len(self.received) > _LONGEST_LINE and b"\n" not in self.received:
            self.overlong = True
            self.received.clear()


class Server:
    """A TCP server of a controller; as a context manager it runs in a thread of its own.

    Parameters
    ----------
    controller : Controller
    host, port : str, int, optional
        Address to listen at; port 0 is any free port.
    lock : threading.Lock, optional
        Held while the controller is used: share it with every other user of its instrument.
    rehearsal : Rehearsal, optional
        Faults to trigger.

    Attributes
    ----------
    host, port : str, int
        Address at which it listens.

    Raises
    ------
    LinkError
        If it cannot listen at this address.
    """

    def __init__(
        self,
        controller: Controller,
        *,
        host: str = "127.0.0.1",
        port: int = PORT,
        lock: threading.Lock | None = None,
        rehearsal: Rehearsal | None = None,
    ) -> None:
        self.controller, self.lock = controller, lock or threading.Lock()
        self.rehearsal = rehearsal or Rehearsal()
        try:
            self._listening = socket.create_server((host, port), backlog=16)
        except (OSError, OverflowError) as error:
            # Unknown host names have numbers below 0.
            number = getattr(error, "errno", None) or 0
            foreign = number < 0 or number == errno.EADDRNOTAVAIL
            advice = "give an address of this machine (127.0.0.1)" if foreign else "give another port, or 0 for any"
            raise LinkError(f"{host}:{port}: cannot listen there ({error}); {advice}") from error
        self._listening.setblocking(False)
        self.host, self.port = host, int(self._listening.getsockname()[1])
        self._client: _Client | None = None
        self._refusing, self._stopped = False, threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        self._thread = threading.Thread(target=self.serve, name=f"pi://{self.host}:{self.port}", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        if self._thread is not None:
            self._thread.join()

    def stop(self) -> None:
        """Make `serve` return; from any thread, or from a signal."""
        self._stopped.set()

    def serve(self, seconds: float | None = None) -> None:
        """Serve until `stop`, or for so many `seconds`; close all connections at the end."""
        end = None if seconds is None else time.monotonic() + seconds
        try:
            while not self._stopped.is_set() and (end is None or time.monotonic() < end):
                self._turn()
        finally:
            self._disconnect()
            self._listening.close()

    def _turn(self) -> None:
        """Wait for an event, for a tick at most, and handle it; bring the instrument up to now, and trigger faults."""
        client = self._client
        reading = [] if self._refusing else [self._listening]
        if client is not None and not (client.full or client.ready):
            reading.append(client.link)
        writing = [client.link] if client is not None and client.waiting else []
        readable: list[socket.socket] = []
        if reading or writing:
            tick = 0.0 if client is not None and client.ready else _TICK
            readable, _, _ = select.select(reading, writing, [], tick)
        elif client is None:
            self._stopped.wait(_TICK)
        if self._listening in readable:
            self._accept()
        if client is not None:
            self._attend(client, readable=client.link in readable)
        with self.lock:
            self.controller.instrument.advance()
            faults = self.rehearsal.trigger(self.controller)
        if faults:
            self._disconnect()
        if "refuse" in faults:
            self._refusing = True
            self._listening.close()

    def _accept(self) -> None:
        """Accept a client; if there is one already, close the new connection at once."""
        with suppress(OSError):
            link, _ = self._listening.accept()
            if self._client is not None:
                link.close()
                return
            try:
                self._client = _Client(link)
            except OSError:
                link.close()

    def _attend(self, client: _Client, *, readable: bool) -> None:
        try:
            if readable:
                client.receive()
            end = time.monotonic() + _TICK
            while client.ready and time.monotonic() < end:
                client.waiting += self._answer(client.command())
            client.forget_overlong()
            client.send()
        except OSError:
            client.ended = True
        if client.ended:
            self._disconnect()

    def _answer(self, command: bytes) -> bytes:
        with self.lock:
            single = len(command) == 1 and command[0] in _SINGLE
            text = command.decode("latin-1")
            answer = self.controller.single(command[0]) if single else self.controller.answer(text)
        return self.rehearsal.corrupt(answer.encode("latin-1", "replace")) if answer else b""

    def _disconnect(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            client.link.close()
