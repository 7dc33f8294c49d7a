"""The last resort: a fresh process that connects to a rig and brings its voltage to the safe one.

Started when the rig's own process hangs in a driver, or ended without a retreat:
``python -m dehyst.workbench.rig.rescue PROCESS ADDRESS LOW HIGH SLEW REASON``.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence

from dehyst.instruments import open_rig
from dehyst.workbench.rig.messages import Outlet

# Seconds that the process before may take to end, and attempts to connect: a controller takes one client at a time.
_PATIENCE, _ATTEMPTS, _PAUSE = 5.0, 3, 0.5
_FAREWELL = 1.0


def command_of(
    address: str, limits: tuple[float, float], slew_rate: float, reason: str, *, waits: bool = True
) -> list[str]:
    """Return the command that brings the rig at `address` to its safe voltage.

    `limits` [V] and `slew_rate` [V/s] were in force; `reason` is a sentence. With `waits` it begins when this process
    has ended.
    """
    numbers = map(repr, (*limits, slew_rate))
    before = str(os.getpid() if waits else 0)
    return [sys.executable, "-m", "dehyst.workbench.rig.rescue", before, address, *numbers, reason]


def main(arguments: Sequence[str]) -> int:
    """Retreat; `arguments` as `command_of` makes them. Return the exit status: 0 if the voltage is safe."""
    before, address, low, high, slew, reason = arguments
    end = time.monotonic() + _PATIENCE
    while os.getppid() == int(before) and time.monotonic() < end:
        time.sleep(0.01)
    outlet = Outlet(1)
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
    return "lost", f"{sentence}: the device holds, or plays to its end, what it has; see to it by hand."


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
