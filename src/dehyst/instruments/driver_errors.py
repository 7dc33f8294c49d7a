"""What a leaf's own code may do wrong: it is told as an instrument's fault is, and not by a traceback."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

from dehyst._errors import DehystError, DeviceError, LinkError
from dehyst.instruments.samples import Reading


@contextmanager
def leafs_own(name: str, what: str) -> Iterator[None]:
    """Turn whatever the `what` of a leaf raises into DeviceError; what it raises on purpose is left as it is."""
    try:
        yield
    except DehystError:
        raise
    # A laboratory's code, or its library, may raise anything.
    except Exception as error:
        raise DeviceError(
            f"{name}: {what} of the rig raised {type(error).__name__}: {error}; see to its code, or to the device"
        ) from error


def reading_of(name: str, values: object) -> Reading:
    """Three numbers as a reading, finite or not.

    Raises
    ------
    DeviceError
        If they are something else.
    """
    try:
        time, voltage, displacement = map(float, values)  # type: ignore[call-overload]
    except (TypeError, ValueError) as error:
        raise DeviceError(
            f"{name}: read {values!r}, need time, voltage and displacement; check the rig's _read"
        ) from error
    return Reading(time, voltage, displacement)


def finite(name: str, reading: Reading) -> Reading:
    """The same; raises LinkError if a number is not finite."""
    if not all(map(math.isfinite, reading)):
        raise LinkError(f"{name}: read {reading}, need finite numbers; check the device and its sensor")
    return reading
