"""The emergency stop: an HTTP listener of the rig's own process, which works while the workbench's server hangs.

One thread serves all connections without waiting for any: slow, small or malformed requests cannot keep a stop out.
The answer to a stop comes when the rig's process confirms it; it is 409 if nothing was armed, and 504 without a
confirmation in time.
"""

from __future__ import annotations

import hmac
import selectors
import socket
import threading
import time
from collections.abc import Callable, Collection
from contextlib import suppress

KEY_HEADER = "x-dehyst-stop"
# Bytes of the longest request, seconds that it and the confirmation may take each, and most connections: beyond, the
# oldest is closed.
_LONGEST, _PATIENCE, _MOST = 8192, 2.0, 32
# Seconds between two looks, without and with a stop that waits for its confirmation.
_TICK, _SOON = 0.1, 0.01
_REASONS = {200: "OK", 204: "No Content", 400: "Bad Request", 403: "Forbidden", 404: "Not Found"}
_REASONS |= {405: "Method Not Allowed", 409: "Conflict", 413: "Content Too Large", 504: "Gateway Timeout"}


class StopRules:
    """Rules on who may stop the rig.

    Parameters
    ----------
    key : str
        Secret that a stop must carry.
    origins : collection of str
        Origins of the workbench's page.
    hosts : collection of str
        Values of the header Host.
    """

    def __init__(self, key: str, origins: Collection[str], hosts: Collection[str]) -> None:
        self._key, self._origins, self._hosts = key.encode(), frozenset(origins), frozenset(hosts)

    def answer(self, method: str, path: str, headers: dict[str, str]) -> int:
        """Return the status of the answer to a request; 200 is a stop.

        `method`, `path` and `headers` (lower-case names) as received.
        """
        if headers.get("host", "").lower() not in self._hosts or not self.knows(headers):
            return 403
        if path != "/stop":
            return 404
        if method == "OPTIONS":
            return 204
        if method != "POST":
            return 405
        key = headers.get(KEY_HEADER, "").encode("utf-8", "replace")
        return 200 if self._key and hmac.compare_digest(key, self._key) else 403

    def knows(self, headers: dict[str, str]) -> bool:
        """Return whether the request comes from the workbench's page; `headers` as received."""
        return headers.get("origin") in self._origins


class _Request:
    """A connection: its request as far as it came, its answer as far as it is sent, and when it began."""

    def __init__(self, link: socket.socket) -> None:
        self.link, self.received, self.answer, self.began = link, bytearray(), b"", time.monotonic()
        # Whether a stop waits for its confirmation, and of which origin it is; then whether the rig was armed.
        self.pressed, self.origin = False, ""
        self.armed: bool | None = None

    def confirm(self, armed: bool) -> None:
        """Confirm the stop, in any thread."""
        self.armed = armed


class StopListener:
    """A listener for POST /stop.

    Parameters
    ----------
    listening : socket
        Bound to 127.0.0.1.
    key, origins : str, collection of str
        As in `StopRules`.
    stop : callable
        Called in the listener's thread with a function. This function must be called once the stop has taken effect,
        with a bool: whether the rig was armed.
    """

    def __init__(
        self,
        listening: socket.socket,
        key: str,
        origins: Collection[str],
        stop: Callable[[Callable[[bool], None]], None],
    ) -> None:
        listening.listen(128)
        listening.setblocking(False)
        self.port = int(listening.getsockname()[1])
        self._rules = StopRules(key, origins, {f"127.0.0.1:{self.port}", f"localhost:{self.port}"})
        self._stop, self._listening = stop, listening
        self._selector = selectors.DefaultSelector()
        self._selector.register(listening, selectors.EVENT_READ)
        self._requests: dict[socket.socket, _Request] = {}

    def start(self) -> None:
        """Begin to listen, in a thread."""
        threading.Thread(target=self._run, name="stop", daemon=True).start()

    def _run(self) -> None:
        while True:
            # A fault of one request must not end the listener.
            with suppress(Exception):
                self._turn()

    def _turn(self) -> None:
        waiting = [request for request in self._requests.values() if request.pressed]
        for key, _ in self._selector.select(_SOON if waiting else _TICK):
            if key.fileobj is self._listening:
                self._accept()
            else:
                self._attend(key.data)
        late = time.monotonic() - _PATIENCE
        for request in waiting:
            if request.armed is not None or request.began < late:
                request.pressed, request.began = False, time.monotonic()
                status = {True: 200, False: 409, None: 504}[request.armed]
                request.answer = _response(status, request.origin)
                self._attend(request)
        for request in [request for request in self._requests.values() if request.began < late]:
            self._end(request)

    def _accept(self) -> None:
        try:
            link, _ = self._listening.accept()
        except OSError:
            return
        link.setblocking(False)
        if len(self._requests) >= _MOST:
            others = (request for request in self._requests.values() if not request.pressed)
            self._end(next(others, next(iter(self._requests.values()))))
        self._requests[link] = request = _Request(link)
        self._selector.register(link, selectors.EVENT_READ, request)

    def _attend(self, request: _Request) -> None:
        try:
            if not request.answer:
                self._read(request)
            if request.answer:
                request.answer = request.answer[request.link.send(request.answer) :]
                if not request.answer:
                    self._end(request)
                else:
                    self._selector.modify(request.link, selectors.EVENT_WRITE, request)
        except BlockingIOError:
            return
        except OSError:
            self._end(request)

    def _read(self, request: _Request) -> None:
        data = request.link.recv(_LONGEST)
        if not data:
            raise ConnectionResetError
        if request.pressed:
            return
        request.received += data
        if len(request.received) > _LONGEST:
            request.answer = _response(413, None)
        elif b"\r\n\r\n" in request.received:
            request.answer = self._answer(request)

    def _answer(self, request: _Request) -> bytes:
        """Return the answer to a request; nothing for a stop, which is answered when it is confirmed."""
        head = bytes(request.received).split(b"\r\n\r\n", 1)[0].decode("latin-1")
        first, *lines = head.split("\r\n")
        words = first.split(" ")
        headers = _headers(lines)
        if len(words) != 3 or not words[2].startswith("HTTP/1.") or headers is None:
            return _response(400, None)
        status = self._rules.answer(words[0], words[1], headers)
        if status == 200:
            request.pressed, request.origin, request.began = True, headers["origin"], time.monotonic()
            self._stop(request.confirm)
            return b""
        return _response(status, headers["origin"] if self._rules.knows(headers) else None)

    def _end(self, request: _Request) -> None:
        self._requests.pop(request.link, None)
        with suppress(KeyError, ValueError):
            self._selector.unregister(request.link)
        with suppress(OSError):
            request.link.shutdown(socket.SHUT_WR)
        request.link.close()


def _headers(lines: list[str]) -> dict[str, str] | None:
    """Return the headers by lower-case name; None if a line has no header, or a name comes twice."""
    headers: dict[str, str] = {}
    for line in lines:
        name, colon, value = line.partition(":")
        if not colon or name != name.strip() or not name or name.lower() in headers:
            return None
        headers[name.lower()] = value.strip()
    return headers


def _response(status: int, origin: str | None) -> bytes:
    """Return an answer; only the workbench's own `origin` may read it."""
    body = {200: b'{"stopped": true}', 409: b'{"stopped": false}'}.get(status, b"")
    lines = [f"HTTP/1.1 {status} {_REASONS[status]}", "Connection: close", "Cache-Control: no-store", "Vary: Origin"]
    if status != 204:
        lines += ["Content-Type: application/json", f"Content-Length: {len(body)}"]
    if origin is not None:
        lines.append(f"Access-Control-Allow-Origin: {origin}")
        if status == 204:
            lines += ["Access-Control-Allow-Methods: POST", f"Access-Control-Allow-Headers: {KEY_HEADER}"]
            lines.append("Access-Control-Max-Age: 600")
    return "\r\n".join([*lines, "", ""]).encode() + body
