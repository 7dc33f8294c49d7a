"""What commands that drive an instrument print when it, or the user, stops them."""

from __future__ import annotations

import signal
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from dehyst.cli.output.terminal import note

if TYPE_CHECKING:
    from dehyst.instruments import AbstractRig


def note_narrower(rig: AbstractRig, limits: tuple[float, float] | None, slew: float | None, axis: str = "") -> None:
    """Print where the device allows less than was requested; `axis`: its name, where there are several."""
    allowed, device = rig.limits, f"axis {axis} of the device" if axis else "the device"
    if limits is not None and (allowed.low, allowed.high) != limits:
        note(f"{limits[0]:g} to {limits[1]:g} V was given, {device} allows {allowed.words}")
    if slew is not None and rig.slew_rate < slew:
        note(f"{slew:g} V/s was given, {device} allows {rig.slew_rate:.6g} V/s")


@contextmanager
def reported_errors(output: Path, *, again: bool = True) -> Iterator[None]:
    """Print what happened to voltage and samples, instead of a traceback, when an instrument or the user stops it."""
    from dehyst._errors import DehystError

    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_, **__: note(str(message))
        try:
            yield
        except (DehystError, KeyboardInterrupt, SystemExit) as error:
            reason = str(error) if isinstance(error, DehystError) else f"stopped by {_stopper(error)}"
            for line in (reason, *getattr(error, "__notes__", ()), *_left(output, error, again)):
                note(line)
            sys.exit(_status(error))


def _stopper(error: BaseException) -> str:
    """Name what stopped it: Ctrl-C, or a signal."""
    if isinstance(error, KeyboardInterrupt):
        return "Ctrl-C"
    try:
        return signal.Signals(_status(error) - 128).name
    except ValueError:
        return "a request to exit"


def _left(output: Path, error: BaseException, continues: bool = True) -> Iterator[str]:
    """Yield where samples are, and whether the same command continues, as sentences."""
    from dehyst._errors import RigError

    records = output / "records"
    if any(records.glob("*.h5*")):
        # A full disk may have room later; a folder of another instrument remains one.
        temporary = isinstance(error, RigError) or isinstance(error.__cause__, OSError)
        again = continues and (not isinstance(error, Exception) or temporary)
        yield f"what was recorded is in {records}" + ("; the same command goes on from there" if again else "")


def _status(error: BaseException) -> int:
    from dehyst._errors import DeviceError, LinkError, SensorError

    if isinstance(error, KeyboardInterrupt):
        return 130
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else 1
    return 1 if isinstance(error, LinkError | DeviceError | SensorError) else 2
