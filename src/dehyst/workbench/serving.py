"""Start of a workbench: its port, its link, its server."""

from __future__ import annotations

import errno
import socket
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from dehyst._errors import DehystError, MissingExtraError

if TYPE_CHECKING:
    import uvicorn

HOST = "127.0.0.1"
# Taken unless another port is given; if it is in use, any that is free.
PORT = 8754
# Seconds that open connections have to end.
_PATIENCE = 1
_LONGEST_MESSAGE = 65536


def serve(
    folder: Path,
    *,
    port: int | None = None,
    upload_limit: float = 1e9,
    opened: Callable[[str], None] = lambda _: None,
) -> None:
    """Serve a workbench until Ctrl-C or SIGTERM.

    Parameters
    ----------
    folder : path
        For everything that is made: new, empty, or of a workbench before.
    port : int, optional
        At which to listen; 0: any that is free. Default: 8754, or any if that is in use.
    upload_limit : float, optional
        Most bytes of an upload.
    opened : callable, optional
        Called with the link once the server listens.

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
        bench = Workbench(folder, upload_limit, [f"http://{host}:{taken}" for host in (HOST, "localhost")])
        gate = Gate(bench.app(), taken, bench.rig.stop_port)
        config = uvicorn.Config(
            gate,
            log_level="warning",
            access_log=False,
            server_header=False,
            ws="websockets-sansio",
            ws_max_size=_LONGEST_MESSAGE,
            timeout_graceful_shutdown=_PATIENCE,
        )
        _announcing(config, lambda: opened(f"http://{HOST}:{taken}/?token={gate.token}")).run(sockets=[listener])


def _announcing(config: uvicorn.Config, announce: Callable[[], None]) -> uvicorn.Server:
    """Return a server that announces when it listens."""
    import uvicorn

    class AnnouncingServer(uvicorn.Server):
        async def startup(self, sockets: list[socket.socket] | None = None) -> None:
            await super().startup(sockets)
            announce()

    return AnnouncingServer(config)


def _listening(port: int | None) -> socket.socket:
    """Return a socket that is bound to a port."""
    wanted = PORT if port is None else port
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((HOST, wanted))
    except OSError as error:
        if error.errno not in (errno.EADDRINUSE, errno.EACCES):
            raise
        if port is not None:
            listener.close()
            raise DehystError(f"port {port}: is in use or not allowed; give another --port, or 0 for any") from error
        listener.bind((HOST, 0))
    return listener
