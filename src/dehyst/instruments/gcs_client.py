"""A client of one GCS controller over a TCP socket."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TypeVar

from dehyst._errors import DeviceError, LinkError, RigError
from dehyst.instruments import gcs_syntax

_Answer = TypeVar("_Answer")
IDENTITY = "*IDN?"
# Longest time [s] to restore a lost link: the first value, halved after each failure, but never below the second.
_LONGEST_SEARCH, _SHORTEST_SEARCH = 1.5, 0.5
# Seconds between two attempts to reconnect.
_PAUSE = 0.02


class TcpLink:
    """A socket for lines to one controller, which takes one client at a time, and for its answers.

    Raise `LinkError` if there is no connection. `where`: address, for messages. `timeout`: seconds
    after which an answer that is not whole is abandoned.
    """

    def __init__(self, host: str, port: int, timeout: float = 5.0) -> None:
        self.where = f"{host}:{port}"
        self._address, self._timeout = (host, port), timeout
        self._buffer = bytearray()
        self._half_sent = False
        self._search = _LONGEST_SEARCH
        self._socket: socket.socket | None = self._connect()

    def exchange(self, commands: Sequence[str], query: str) -> list[str]:
        """Send commands without answers, then a query; return the lines of its answer without line ends.

        Raise `LinkError` if there is no answer, or an incomplete one.
        """
        self._send([*commands, query])
        deadline = time.monotonic() + self._timeout
        lines: list[str] = []
        more = True
        while more:
            text, more = gcs_syntax.line_of(self._line(deadline))
            lines.append(text)
        return lines

    def settle(self, identity: str) -> None:
        """Resynchronise after an exchange that failed: read until it answers with its `identity`, else reconnect.

        Raise `LinkError` if that fails.
        """
        # After a lost answer the next waits are shorter: a retreat must not take minutes.
        self._timeout = min(_LONGEST_SEARCH, self._timeout)
        seconds, self._search = min(self._search, self._timeout), max(_SHORTEST_SEARCH, self._search / 2)
        if self._socket is not None and not self._half_sent:
            with suppress(LinkError):
                self._await(identity, seconds)
                return
        self.close()
        deadline = time.monotonic() + seconds
        while True:
            try:
                self._socket = self._connect()
                self._await(identity, seconds)
                return
            except LinkError:
                self.close()
                # The controller may not have noticed yet that its only client has disconnected.
                if time.monotonic() + _PAUSE > deadline:
                    raise
            time.sleep(_PAUSE)

    def close(self) -> None:
        """Close the socket."""
        link, self._socket = self._socket, None
        self._buffer.clear()
        if link is not None:
            with suppress(OSError):
                link.close()

    def _await(self, identity: str, seconds: float) -> None:
        """Query the identity, and discard what was still on its way, for some `seconds` [s]."""
        # The number of the error of a failed exchange is discarded too: the next exchange would take it for its own. A
        # line that a serial bridge sent in part becomes a command with an argument that no command has.
        self._send(["ERR?", IDENTITY])
        deadline = time.monotonic() + seconds
        wanted = identity.encode("ascii")
        # An earlier answer that was cut off has no line feed.
        while not self._line(deadline).rstrip().endswith(wanted):
            pass
        self._search = _LONGEST_SEARCH

    def _connect(self) -> socket.socket:
        host, port = self._address
        if not 0 < port < 1 << 16:
            raise LinkError(f"{self.where}: got the port {port}, need 1 to 65535 (PI's is 50000)")
        try:
            link = socket.create_connection((host, port), min(_LONGEST_SEARCH, self._timeout))
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except (socket.gaierror, UnicodeError) as error:
            raise LinkError(f"{self.where}: host {host!r} is not known; check its name, or give its number") from error
        except OSError as error:
            raise LinkError(
                f"{self.where}: cannot be reached ({error}); is the controller on, and {port} its port (PI's is 50000)?"
            ) from error
        return link

    def _send(self, lines: Sequence[str]) -> None:
        if self._socket is None:
            raise LinkError("the connection is closed")
        # Use one write: a second write would wait for the acknowledgement of the first.
        data = "".join(f"{line}\n" for line in lines).encode("ascii")
        self._half_sent = True
        try:
            self._socket.settimeout(self._timeout)
            self._socket.sendall(data)
        except OSError as error:
            raise LinkError(f"the connection was lost ({error})") from error
        self._half_sent = False

    def _line(self, deadline: float) -> bytes:
        """Return one line with its line feed."""
        searched = 0
        while (end := self._buffer.find(b"\n", searched)) < 0:
            searched = len(self._buffer)
            got = f"got {gcs_syntax.shown(bytes(self._buffer))}" if self._buffer else "got nothing"
            if self._socket is None:
                raise LinkError("the connection is closed")
            wait = deadline - time.monotonic()
            if wait <= 0:
                raise LinkError(f"{got}: the answer takes too long")
            try:
                self._socket.settimeout(wait)
                data = self._socket.recv(1 << 16)
            except TimeoutError as error:
                raise LinkError(f"{got} in {wait:.3g} s, need an answer") from error
            except OSError as error:
                raise LinkError(f"{got}: the connection was lost ({error})") from error
            if not data:
                raise LinkError(f"{got}: the controller closed the connection")
            self._buffer += data
        line = bytes(self._buffer[: end + 1])
        del self._buffer[: end + 1]
        return line


class GcsClient:
    """A client of a controller over a `link`; it sends nothing twice.

    `identity`: the controller's answer to *IDN?. `commands`: its supported commands. Raise `LinkError` if the answers
    do not come from a GCS controller.
    """

    def __init__(self, link: TcpLink) -> None:
        self._link, self.where = link, link.where
        self._synchronised = True
        try:
            lines = link.exchange([], IDENTITY)
        except LinkError as error:
            raise LinkError(
                f"{self.where}: sent '{IDENTITY}', {error}; is it a GCS controller, and no other client connected? "
                "It takes one at a time"
            ) from error
        self.identity = " ".join(lines).strip()
        if self.identity.count(",") < 2 or len(lines) > 1:
            raise LinkError(
                f"{self.where}: sent '{IDENTITY}', got {gcs_syntax.shown(self.identity)}, need maker, model, serial "
                "number; is it a GCS controller? PI's port is 50000"
            )
        self.commands = self.query("HLP?", gcs_syntax.commands)

    @property
    def name(self) -> str:
        """Identity and address."""
        return f"{self.identity} at {self.where}"

    def query(self, line: str, parse: Callable[[list[str]], _Answer], commands: Sequence[str] = ()) -> _Answer:
        """Send commands without answers and a query, and return the answer's lines as parsed by `parse`.

        Raise `LinkError` if there is no answer, or `parse` refuses it; the next call resynchronises first.
        """
        sent = [*commands, line]
        try:
            if not self._synchronised:
                self._link.settle(self.identity)
            # Ctrl-C may interrupt the exchange.
            self._synchronised = False
            answer = parse(self._link.exchange(commands, line))
        except RigError as error:
            reason = str(error).removeprefix(f"{self.where}: ")
            raise type(error)(f"{self.where}: sent {gcs_syntax.shown(sent)}, {reason}") from error
        self._synchronised = True
        return answer

    def numbers(self, word: str, *keys: str) -> list[float]:
        """Query the numbers of these keys, such as axes; raise as `query`."""
        return self.query(gcs_syntax.command(word, *keys), lambda lines: gcs_syntax.values(lines, keys))

    def set(self, *commands: str) -> None:
        """Send commands and query the error number; raise `DeviceError` if there is one."""
        number = self.query("ERR?", gcs_syntax.error, commands)
        if number:
            after = f" after {gcs_syntax.shown(commands)}" if commands else ""
            meaning = gcs_syntax.ERRORS.get(number, "see its manual, list of error codes")
            raise DeviceError(f"{self.name}: error {number}: {meaning}{after}")

    def clear(self) -> None:
        """Clear a latched error, and resynchronise."""
        self.query("ERR?", gcs_syntax.error)

    def close(self) -> None:
        """Close the link."""
        self._link.close()
