"""The process that holds the rig: `python -m dehyst.workbench.rig.process`.

It speaks JSON lines with the workbench's server on standard input and output. The first line is
``{"stop_key": KEY, "origins": [...]}``. It contains the watchdog and the emergency stop. When its input ends, it
retreats and ends. See `docs/how_to/workbench_rig.md`.

With ``--rescue PROCESS ADDRESS LOW HIGH SLEW REASON`` it is the last resort instead. If the rig's own process hangs in
a driver, or ended without a retreat, this fresh process connects to the rig and brings its voltage to the safe value.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any

from dehyst._process import Inlet, Outlet, lines_of, own_output
from dehyst.instruments import BY_HAND, open_rig
from dehyst.workbench.rig.driver import RigDriver
from dehyst.workbench.rig.stop_listener import StopListener
from dehyst.workbench.rig.watchdog import Watchdog

# Seconds that the last messages may take.
_FAREWELL = 1.0
_RESCUE = "--rescue"
# Of the messages with changes of the state.
KIND = "rig"
# Seconds that the process before may take to end, and attempts to connect: a controller takes one client at a time.
_PATIENCE, _ATTEMPTS, _PAUSE = 5.0, 3, 0.5
_HUNG = 70


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the process with `arguments` of the command line; return the exit status."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    # What a driver prints must neither break the protocol nor wait for its reader.
    descriptor = own_output()
    outlet = Outlet(descriptor, KIND)
    if words[:1] == [_RESCUE]:
        # Not by the parser, which takes a negative number for an option.
        return _rescued(outlet, *words[1:])
    options = _parser().parse_args(words)
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
        command = [sys.executable, "-m", *rescue(address, (rig.limits.low, rig.limits.high), rig.slew_rate, reason)]
        outlet.state(status="stopping", words=[f"Stopped: {reason}.", "A fresh process connects, and retreats."])
        outlet.flush(_FAREWELL)
        # Started before the end, as nothing runs after it; it waits for the end.
        subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=descriptor)
    os._exit(_HUNG)


def rescue(
    address: str, limits: tuple[float, float], slew_rate: float, reason: str, *, waits: bool = True
) -> list[str]:
    """Return the module and the arguments that bring the rig at `address` to its safe voltage.

    `limits` [V] and `slew_rate` [V/s] were in force; `reason` is a sentence. With `waits` it begins when this process
    has ended.
    """
    numbers = map(repr, (*limits, slew_rate))
    before = str(os.getpid() if waits else 0)
    return ["dehyst.workbench.rig.process", _RESCUE, before, address, *numbers, reason]


def _rescued(outlet: Outlet, before: str, address: str, low: str, high: str, slew: str, reason: str) -> int:
    """Retreat; return the exit status: 0 if the voltage is safe."""
    end = time.monotonic() + _PATIENCE
    while os.getppid() == int(before) and time.monotonic() < end:
        time.sleep(0.01)
    status, outcome = _outcome(address, (float(low), float(high)), float(slew))
    outlet.state(status=status, words=[f"Stopped: {reason}.", outcome])
    outlet.flush(_FAREWELL)
    return 0 if status == "none" else 1


def _outcome(address: str, limits: tuple[float, float], slew_rate: float) -> tuple[str, str]:
    """Return the status of the rig after the attempt, and a sentence."""
    failure: Exception | None = None
    for _ in range(_ATTEMPTS):
        try:
            with open_rig(address, limits=limits, slew_rate=slew_rate) as rig:
                return "none", f"A fresh connection brought the voltage to {rig.retreat():.6g} V."
        # Whatever a driver raises: the next attempt, or the sentence.
        except Exception as error:
            failure = error
            time.sleep(_PAUSE)
    sentence = f"A fresh connection could not bring the voltage to a safe one ({failure})"
    return "lost", f"{sentence}: {BY_HAND}."


if __name__ == "__main__":
    sys.exit(main())
