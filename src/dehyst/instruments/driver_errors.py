"""What comes from a driver's own code: its errors, re-raised as `DeviceError`, its readings and its samples."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import DehystError, DeviceError, LinkError
from dehyst.instruments.samples import Reading

_Kind = TypeVar("_Kind", bound="np.generic[Any]")
_Batch = TypeVar("_Batch")


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


def pieces(values: NDArray[_Kind], longest: int | None) -> Iterator[NDArray[_Kind]]:
    """Yield rows (n, ...) in pieces of `longest` at most, each beginning where the one before ended."""
    size = len(values)
    step = longest or size
    for start in range(0, max(1, size - 1), step - 1):
        yield values[start : start + step]


def arrivals(
    name: str,
    wave: Callable[[], Iterator[_Batch]],
    admit: Callable[[_Batch], _Batch],
    compare: Callable[[_Batch], None],
) -> Generator[_Batch, None, None]:
    """Yield each batch of a `wave` that is not empty, admitted first and compared when it was used.

    Whatever the driver raises is re-raised as `DeviceError` of the rig `name`; the driver's generator is closed.
    """
    with driver_errors(name, "_wave"):
        batches = iter(wave())
    try:
        while True:
            with driver_errors(name, "_wave"):
                batch = next(batches, None)
                if batch is None:
                    break
                admitted = admit(batch)
            if admitted[0].size:  # type: ignore[index]
                yield admitted
                compare(admitted)
    finally:
        if isinstance(batches, Generator):
            batches.close()
