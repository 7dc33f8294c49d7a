"""Start of a workbench: its port, its server, and its links, each of which lets one browser in."""

from __future__ import annotations

import errno
import os
import secrets
import socket
import threading
import time
from collections.abc import Callable
from hmac import compare_digest
from pathlib import Path

from dehyst._errors import DehystError, MissingExtraError

# Seconds for which a link is valid.
LIFETIME = 60.0
_PAGE = "open-workbench.html"
_REDIRECT = """<!DOCTYPE html>
<meta charset="utf-8">
<meta http-equiv="refresh" content="0; url={link}">
<title>dehyst workbench</title>
"""


class Door:
    """The links of a workbench.

    Parameters
    ----------
    address : str
        Of the server: ``http://127.0.0.1:8754``.
    folder : Path
        For the private file.
    clock : callable, optional
        Returns seconds; for tests.

    Attributes
    ----------
    remark : str
        A remark on the folder's permissions, or empty.
    """

    def __init__(
        self, address: str, folder: Path, remark: str = "", clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.remark = remark
        self._address, self._file, self._clock = address, folder / _PAGE, clock
        self._lock = threading.Lock()
        # When each token that was not used ends, and the token of the private file.
        self._ends: dict[str, float] = {}
        self._filed = ""
        # A killed workbench may have left one.
        self._file.unlink(missing_ok=True)

    def link(self) -> str:
        """Return a new link, which lets one browser in within a minute."""
        return self._link(self._token())

    def page(self) -> Path:
        """Write a file that leads a browser to a new link, and return it; it is deleted when the link is used.

        A browser's command line, which other users can read, then holds no token.
        """
        token = self._token()
        self.close()
        with self._lock:
            self._filed = token
        with os.fdopen(os.open(self._file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as stream:
            stream.write(_REDIRECT.format(link=self._link(token)))
        return self._file

    def admits(self, given: str) -> bool:
        """Return whether a browser with this token may enter; this uses the token up."""
        with self._lock:
            now = self._clock()
            self._ends = {token: end for token, end in self._ends.items() if now < end}
            token = next((known for known in self._ends if compare_digest(known.encode(), given.encode())), None)
            if token is None:
                return False
            del self._ends[token]
            if token == self._filed:
                self.close()
        return True

    def close(self) -> None:
        """Delete the private file."""
        self._file.unlink(missing_ok=True)

    def _token(self) -> str:
        token = secrets.token_urlsafe(32)
        with self._lock:
            self._ends[token] = self._clock() + LIFETIME
        return token

    def _link(self, token: str) -> str:
        return f"{self._address}/?token={token}"


HOST = "127.0.0.1"
# Taken unless another port is given; if it is in use, any that is free.
PORT = 8754
# Seconds that open connections have to end.
_PATIENCE = 1
# Connections at once, and the longest message of a page.
_MOST, _LONGEST_MESSAGE = 96, 65536


def serve(
    folder: Path,
    *,
    port: int | None = None,
    upload_limit: float = 1e9,
    opened: Callable[[Door], None] = lambda _: None,
) -> None:
    """Serve a workbench until Ctrl-C or SIGTERM.

    Parameters
    ----------
    folder : path
        Folder for all results: new, empty, or of an earlier workbench.
    port : int, optional
        Port of the server; 0: any free port. Default: 8754, or any free port if it is in use.
    upload_limit : float, optional
        Most bytes of an upload.
    opened : callable, optional
        Called with the door, which makes the links, once a browser may come.

    Raises
    ------
    FileFormatError
        The folder holds other files, or another workbench uses it.
    DehystError
        The port is in use.
    MissingExtraError
        starlette or uvicorn is not installed.
    """
    try:
        import uvicorn
        import websockets  # noqa: F401

        from dehyst.workbench.gate import Gate
        from dehyst.workbench.server import Workbench
    except ImportError as error:
        raise MissingExtraError(
            f"workbench: needs {error.name}, which is not installed; install it with: pip install 'dehyst[workbench]'"
        ) from error
    with _listening(port) as listener:
        taken = listener.getsockname()[1]
        bench = Workbench(folder, upload_limit)
        door = Door(f"http://{HOST}:{taken}", bench.session.folder.path, bench.session.folder.privacy)
        config = uvicorn.Config(
            Gate(bench.app(), taken, door.admits),
            loop="asyncio",
            limit_concurrency=_MOST,
            log_level="warning",
            access_log=False,
            server_header=False,
            ws="websockets-sansio",
            ws_max_size=_LONGEST_MESSAGE,
            timeout_graceful_shutdown=_PATIENCE,
        )
        try:
            # The socket listens already: a browser that is faster than the server waits.
            opened(door)
            uvicorn.Server(config).run(sockets=[listener])
        finally:
            door.close()


def _listening(port: int | None) -> socket.socket:
    """Return a socket that listens at a port."""
    try:
        return socket.create_server((HOST, PORT if port is None else port))
    except OSError as error:
        if error.errno not in (errno.EADDRINUSE, errno.EACCES):
            raise
        if port is not None:
            raise DehystError(f"port {port}: is in use or not allowed; give another --port, or 0 for any") from error
        return socket.create_server((HOST, 0))
