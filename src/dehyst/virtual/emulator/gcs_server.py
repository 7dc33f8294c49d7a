"""A TCP server of an emulated controller: one client at a time, as real ones have it. One thread, nothing blocks."""

from __future__ import annotations

import errno
import selectors
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
# Seconds in which the server looks after the instrument, and a client that takes no answers is let go.
_TICK, _PATIENCE = 0.02, 10.0
# Bytes of one line that are read, and of answers that wait before further commands are looked at.
_LONGEST_LINE, _MOST_WAITING = 65536, 1 << 20
_SINGLE = frozenset((5, 7, 9, 24))


class _Client:
    """A connection: what came of it and what waits to be sent."""

    def __init__(self, link: socket.socket) -> None:
        link.setblocking(False)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        link.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        # A client that vanished without a word must not lock out the next one for hours.
        for option, value in (("TCP_KEEPIDLE", 10), ("TCP_KEEPINTVL", 5), ("TCP_KEEPCNT", 2)):
            if hasattr(socket, option):
                link.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
        self.link, self.came, self.waiting = link, bytearray(), bytearray()
        self.overlong, self.ended, self.moved = False, False, time.monotonic()

    def receive(self) -> None:
        """Read what is there; OSError if the connection broke."""
        with suppress(BlockingIOError):
            data = self.link.recv(_LONGEST_LINE)
            self.ended = not data
            self.came += data

    def send(self) -> None:
        """Send what the connection takes; OSError if it broke, or takes nothing for long."""
        if not self.waiting:
            self.moved = time.monotonic()
            return
        with suppress(BlockingIOError):
            sent = self.link.send(self.waiting)
            del self.waiting[:sent]
            self.moved = time.monotonic()
        if time.monotonic() - self.moved > _PATIENCE:
            raise ConnectionAbortedError("takes no answers")

    @property
    def ready(self) -> bool:
        """Whether a command waits to be done, and its answer has room."""
        whole = self.came[:1] and (self.came[0] in _SINGLE or b"\n" in self.came)
        return bool(whole) and len(self.waiting) < _MOST_WAITING

    def command(self) -> bytes:
        """Take off what came: one byte if it is a command at the beginning of a line, or else a line."""
        size = 1 if self.came[0] in _SINGLE and not self.overlong else self.came.index(b"\n") + 1
        found = bytes(self.came[:size])
        del self.came[:size]
        if self.overlong:
            self.overlong = False
            return b"\0" * (_LONGEST_LINE + 1)
        return found

    def forget_overlong(self) -> None:
        """Drop the beginning of a line that does not end."""
        if len(self.came) > _LONGEST_LINE and b"\n" not in self.came:
            self.overlong = True
            self.came.clear()


class Server:
    """Serves a controller over TCP; a context manager, in a thread of its own.

    Parameters
    ----------
    controller : Controller
    host, port : str, int, optional
        Where to listen; port 0 is any that is free.
    lock : threading.Lock, optional
        Held while the controller is spoken to: share it with whatever else serves its instrument.
    rehearsal : Rehearsal, optional
        Faults to come.

    Attributes
    ----------
    host, port : str, int
        Where it listens.

    Raises
    ------
    LinkError
        If it cannot listen there.
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
            # Names that are not known have numbers below 0.
            number = getattr(error, "errno", None) or 0
            elsewhere = number < 0 or number == errno.EADDRNOTAVAIL
            advice = "give an address of this machine (127.0.0.1)" if elsewhere else "give another port, or 0 for any"
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
        """Let `serve` return; from any thread, or from a signal."""
        self._stopped.set()

    def serve(self, seconds: float | None = None) -> None:
        """Serve until `stop`, or for so many seconds; closes all connections at the end."""
        end = None if seconds is None else time.monotonic() + seconds
        try:
            while not self._stopped.is_set() and (end is None or time.monotonic() < end):
                self._turn()
        finally:
            self._let_go()
            self._listening.close()

    def _turn(self) -> None:
        """Wait for something to come, for a tick at most, and see to it."""
        with selectors.DefaultSelector() as selector:
            if not self._refusing:
                selector.register(self._listening, selectors.EVENT_READ)
            client = self._client
            if client is not None:
                wanted = selectors.EVENT_WRITE if client.waiting else 0
                if len(client.waiting) < _MOST_WAITING and not client.ready:
                    wanted |= selectors.EVENT_READ
                if wanted:
                    selector.register(client.link, wanted)
            tick = 0.0 if client is not None and client.ready else _TICK
            ready = {key.fileobj for key, _ in selector.select(tick)} if selector.get_map() else set()
            if self._refusing and client is None:
                self._stopped.wait(_TICK)
        if self._listening in ready:
            self._accept()
        if client is not None:
            self._attend(client, came=client.link in ready)
        self._look_after()

    def _accept(self) -> None:
        """Take a client, or turn it away if there is one: by closing at once."""
        try:
            link, _ = self._listening.accept()
        except OSError:
            return
        if self._client is None:
            try:
                self._client = _Client(link)
                return
            except OSError:
                pass
        link.close()

    def _attend(self, client: _Client, *, came: bool) -> None:
        try:
            if came and not client.ready and len(client.waiting) < _MOST_WAITING:
                client.receive()
            turn = time.monotonic() + _TICK
            while client.ready and time.monotonic() < turn:
                client.waiting += self._answer(client.command())
            client.forget_overlong()
            client.send()
        except OSError:
            client.ended = True
        if client.ended:
            self._let_go()

    def _answer(self, command: bytes) -> bytes:
        with self.lock:
            if len(command) == 1 and command[0] in _SINGLE:
                answer = self.controller.single(command[0])
            else:
                answer = self.controller.answer(command.decode("latin-1"))
        return self.rehearsal.spoiled(answer.encode("latin-1", "replace")) if answer else b""

    def _look_after(self) -> None:
        """Bring the instrument up to now, and let faults come."""
        with self.lock:
            self.controller.instrument.advance()
            link = self.rehearsal.strike(self.controller)
        if link:
            self._let_go()
        if "refuse" in link:
            self._refusing = True
            self._listening.close()

    def _let_go(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            client.link.close()
