"""Voltages through turning points, for records of which every branch is half a cosine."""

from itertools import pairwise

import numpy as np

VOLTS = 200.0


def cosine(turns, samples):
    """Values through turning points, half a cosine of so many samples for each branch."""
    u = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, samples + 1) / samples)
    return np.concatenate([[float(turns[0])], *(a + (b - a) * u for a, b in pairwise(turns))])


def tops(steps, samples):
    """Voltages: two major loops, then tops that descend to naught, each branch as long as the others."""
    lower = [VOLTS * (1 - k / steps) for k in range(steps)]
    return cosine([0, *([VOLTS, 0] * 2), *(v for top in lower for v in (top, 0))], samples)
