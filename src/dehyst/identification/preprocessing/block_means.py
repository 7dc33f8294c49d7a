"""Means of neighbouring samples: a record sampled far faster than it moves shows its motion better in fewer samples.

White noise of single samples hides a delay or a lag, and moves the elements back and forth; means over a part of the
motion's shortest time have the same motion, and less noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dehyst._types import Array
from dehyst.records import Record
from dehyst.records.signals import bandwidth

# The voltage has this share of its energy above the bandwidth; this many times that rate is kept, this many samples of
# the shortest cycle, and this many of all training records.
_SHARE, _TIMES = 1e-5, 10.0
_A_CYCLE, ENOUGH = 60, 4000


def block_of(record: Record, most: float) -> int:
    """Return how many samples a mean may be taken of: `most` at most, 1 at least."""
    cycles = record.cycles() if most >= 2 else []
    if not cycles:
        return 1
    fastest = min(cycle.stop - cycle.start for cycle in cycles) / _A_CYCLE
    of_motion = 1 / (_TIMES * bandwidth(record.voltage, record.sample_time, _SHARE) * record.sample_time)
    return max(int(min(fastest, of_motion, most)), 1)


def block_means(record: Record, block: int) -> Record:
    """Return the means of `block` neighbouring samples each; what is left at the end is no block."""
    if block == 1:
        return record

    def means(values: Array) -> Array:
        whole = len(values) // block * block
        return np.asarray(values[:whole].reshape(-1, block).mean(axis=1))

    return replace(
        record,
        time=means(record.time),
        voltage=means(record.voltage),
        displacement=means(record.displacement),
    )
