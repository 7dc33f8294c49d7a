"""Errors raised by a driver's own code, re-raised as `DeviceError`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

from dehyst._errors import DehystError, DeviceError, LinkError
from dehyst.instruments.samples import Reading


@contextmanager
def driver_errors(name: str, method: str) -> Iterator[None]:
    """Re-raise what a driver's `method` raises as DeviceError; errors of dehyst pass unchanged."""
    try:
        yield
    except DehystError:
        raise
    # A driver, or its library, may raise anything.
    except Exception as error:
        raise DeviceError(
            f"{name}: {method} of the rig raised {type(error).__name__}: {error}; check its code, or the device"
        ) from error


def reading_of(name: str, values: object) -> Reading:
    """Return three numbers as a reading, finite or not; raise `DeviceError` if `values` are not three numbers."""
    try:
        time, voltage, displacement = map(float, values)  # type: ignore[call-overload]
    except (TypeError, ValueError) as error:
        raise DeviceError(
            f"{name}: read {values!r}, need time, voltage and displacement; check the rig's _read"
        ) from error
    return Reading(time, voltage, displacement)


def finite(name: str, reading: Reading) -> Reading:
    """Return the reading; raises LinkError if a number is not finite."""
    if not all(map(math.isfinite, reading)):
        raise LinkError(f"{name}: read {reading}, need finite numbers; check the device and its sensor")
    return reading
