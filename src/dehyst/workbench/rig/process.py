"""The process that holds the rig: `python -m dehyst.workbench.rig.process`.

It speaks JSON lines with the workbench's server on standard input and output. The first line is
``{"stop_key": KEY, "origins": [...]}``. It has the watchdog and the emergency stop, and ends when its input ends, after
a retreat. See `docs/how_to/workbench_rig.md`.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from dehyst.workbench.rig.driver import RigDriver
from dehyst.workbench.rig.messages import Inlet, Outlet, lines_of
from dehyst.workbench.rig.rescue import command_of
from dehyst.workbench.rig.stop_listener import StopListener
from dehyst.workbench.rig.watchdog import Watchdog

# Seconds that the last messages may take.
_FAREWELL = 1.0
_HUNG = 70


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the process; `arguments` are those of the command line. Return the exit status."""
    options = _parser().parse_args(arguments)
    # What a driver prints must neither break the protocol nor wait for its reader.
    descriptor = os.dup(1)
    with Path(os.devnull).open("wb") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    outlet = Outlet(descriptor)
    watchdog = Watchdog(lambda reason: _abandon(reason, driver, outlet, descriptor))
    driver = RigDriver(watchdog, outlet)
    watchdog.start()
    lines: Iterator[bytes | None] = lines_of(0)
    key, origins = _secret(next(lines, None))
    reason = "the emergency stop was pressed"
    listener = StopListener(_listening(options), key, origins, lambda confirm: watchdog.stop(reason, confirm))
    listener.start()
    Inlet(lines, driver.take, outlet.error, lambda: watchdog.trip("the workbench ended", ends=True)).start()
    outlet.state(status="none", stop={"port": listener.port})
    driver.run()
    outlet.flush(_FAREWELL)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="dehyst.workbench.rig.process", description="Hold a rig for the workbench.")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--stop-port", type=int, default=0, help="port of the emergency stop; 0: any that is free")
    where.add_argument("--stop-fd", type=int, help="descriptor of a bound socket to use instead")
    return parser


def _secret(line: bytes | None) -> tuple[str, list[str]]:
    """Return key and origins of the emergency stop from the first line; without them it stops for nobody."""
    with suppress(ValueError, RecursionError):
        first: Any = json.loads(line or b"")
        if isinstance(first, dict) and isinstance(key := first.get("stop_key"), str):
            origins = first.get("origins")
            return key, [origin for origin in origins if isinstance(origin, str)] if isinstance(origins, list) else []
    return "", []


def _listening(options: argparse.Namespace) -> socket.socket:
    if options.stop_fd is not None:
        return socket.socket(fileno=options.stop_fd)
    listening = socket.socket()
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    listening.bind(("127.0.0.1", options.stop_port))
    return listening


def _abandon(reason: str, driver: RigDriver, outlet: Outlet, descriptor: int) -> None:
    """Leave the rig to a fresh process, and end this one at once: its main thread hangs.

    The device's link ends with this process; the fresh one connects by the same address, and retreats.
    """
    rig, address = driver.rig, driver.address
    if rig is not None and address is not None:
        command = command_of(address, (rig.limits.low, rig.limits.high), rig.slew_rate, reason)
        outlet.state(status="stopping", words=[f"Stopped: {reason}.", "A fresh process connects, and retreats."])
        outlet.flush(_FAREWELL)
        # Started before the end, as nothing runs after it; it waits for the end.
        subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=descriptor)
    os._exit(_HUNG)


if __name__ == "__main__":
    sys.exit(main())
