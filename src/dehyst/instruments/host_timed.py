"""A wave timed by the host, one voltage at a time, for a device without a wave table: slow, with uneven steps."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from dehyst._types import Array
from dehyst.instruments.base import AbstractRig, Reading, Samples

# Highest rate [Hz] that a host keeps with one round trip a sample.
HIGHEST_RATE = 200.0
# Seconds between two batches of samples.
_BATCH_SECONDS = 0.2


def host_timed(rig: AbstractRig, voltage: Array, rate: float) -> Iterator[Samples]:
    """Send each `voltage` (n,) [V] to `rig` at `rate` [Hz] or slower, never faster, and read the instrument after each.

    For the `AbstractRig._wave` of a driver whose `nearest_rate` returns at most `HIGHEST_RATE`. The samples have the
    times at which they were read, by the device's clock.
    """
    period, readings, yielded = 1 / rate, [], time.monotonic()
    for v in voltage:
        rig._put(float(v))
        # The period starts when the voltage is out: by the slew rate the next step may come late, but not early.
        sent = time.monotonic()
        readings.append(rig._read())
        now = time.monotonic()
        if now - yielded >= _BATCH_SECONDS:
            yield _samples(readings)
            readings, yielded = [], now
        rig._wait(max(0.0, sent + period - time.monotonic()))
    if readings:
        yield _samples(readings)


def _samples(readings: list[Reading]) -> Samples:
    return Samples(*np.array(readings, dtype=np.float64).T)
