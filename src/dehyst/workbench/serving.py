"""The start of a workbench: its port, its server, and the link for a browser."""

from __future__ import annotations

import errno
import os
import secrets
import socket
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from dehyst._errors import DehystError, MissingExtraError

_PAGE = "open-workbench.html"
_REDIRECT = """<!DOCTYPE html>
<meta charset="utf-8">
<meta http-equiv="refresh" content="0; url={link}">
<title>dehyst workbench</title>
"""


class Door(NamedTuple):
    """The way into a workbench: a link, a private file with this link, and a remark on the folder's permissions.

    The browser is opened with the file: other users can read its command line, which must not contain the token.
    """

    link: str
    page: Path
    remark: str


def _written_page(folder: Path, link: str) -> Path:
    """Write the private file that opens a link in a browser."""
    page = folder / _PAGE
    # A killed workbench may have left this file.
    page.unlink(missing_ok=True)
    with os.fdopen(os.open(page, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as stream:
        stream.write(_REDIRECT.format(link=link))
    return page


HOST = "127.0.0.1"
# The default port; if it is in use, any free port is taken.
PORT = 8754
# Seconds that open connections may take to end.
_PATIENCE = 1
# Most simultaneous connections, and the longest message of a page.
_MOST, _LONGEST_MESSAGE = 96, 65536


def serve(folder: Path, *, port: int | None = None, opened: Callable[[Door], None] = lambda _: None) -> None:
    """Serve a workbench until Ctrl-C or SIGTERM.

    Parameters
    ----------
    folder : path
        Folder for all results: new, empty, or of an earlier workbench.
    port : int, optional
        Port of the server; 0: any free port. Default: 8754, or any free port if it is in use.
    opened : callable, optional
        Called with the way in, once a browser may come.

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
        taken, bench = listener.getsockname()[1], Workbench(folder)
        place, token = bench.session.folder, secrets.token_urlsafe(32)
        link = f"http://{HOST}:{taken}/?token={token}"
        door = Door(link, _written_page(place.path, link), place.privacy)
        config = uvicorn.Config(
            Gate(bench.app(), taken, token),
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
            # The socket listens already: a browser that is faster than the server has to wait.
            opened(door)
            uvicorn.Server(config).run(sockets=[listener])
        finally:
            door.page.unlink(missing_ok=True)


def _listening(port: int | None) -> socket.socket:
    """Return a socket that listens at a port."""
    try:
        return socket.create_server((HOST, PORT if port is None else port))
    except OSError as error:
        if error.errno not in (errno.EADDRINUSE, errno.EACCES):
            raise
        if port is not None:
            raise DehystError(
                f"port {port}: is in use or not allowed; give another --port, or 0 for a free one"
            ) from error
        return socket.create_server((HOST, 0))
