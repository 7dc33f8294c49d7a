"""A wave put out by the host, a voltage at a time, where a device has no wave table: slow, and its steps uneven."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from dehyst._types import Array
from dehyst.instruments.base import AbstractRig, Reading, Samples

# Hz that a host and a round trip keep.
HIGHEST_RATE = 200.0
# Seconds between two lots.
_LOT = 0.2


def host_timed(rig: AbstractRig, voltage: Array, rate: float) -> Iterator[Samples]:
    """Put voltages (n,) [V] at `rate` [Hz] or slower, never faster, and read the instrument after each.

    For the `AbstractRig._wave` of a leaf, whose `nearest_rate` gives no more than `HIGHEST_RATE`. What is yielded has
    the times at which it was read, by the device's clock.
    """
    period, lot, shown = 1 / rate, [], time.monotonic()
    for v in voltage:
        rig._put(float(v))
        # From when it has surely been put: the next step may come late, but by the slew rate not early.
        put = time.monotonic()
        lot.append(rig._read())
        now = time.monotonic()
        if now - shown >= _LOT:
            yield _samples(lot)
            lot, shown = [], now
        rig._wait(max(0.0, put + period - time.monotonic()))
    if lot:
        yield _samples(lot)


def _samples(lot: list[Reading]) -> Samples:
    return Samples(*np.array(lot, dtype=np.float64).T)
