"""An identified virtual actuator, and later records of it with one change."""

from functools import cache

import numpy as np
from virtual_loops import PLAYS, record_loops

import dehyst
from dehyst import Record
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, raised_cosine

GAIN, WIDTH, OFFSET, DELAY = 0.02, 0.1, 0.2e-6, 2.0


@cache
def model():
    """The identified model of the actuator."""
    return dehyst.identify(record_loops()[0]).actuator


def later(seed=1, *, gain=0.0, offset=0.0, delay=0.0, width=0.0, slow=None, tops=(200.0, 120.0, 160.0), cycles=2):
    """A record of the same actuator: two cycles to each of three tops.

    `width`: factor of the loop's width, with the same ends; `slow` gives a displacement [m] at times [s].
    """
    drive = raised_cosine(list(tops), cycles=cycles, drive=Sampling(sample_rate=4.0))
    usual = PlayActuator(plays=PLAYS)
    truth = PlayActuator(plays=PLAYS, seed=seed, width=usual.width * (1 + width))
    y = truth.play(drive.voltage, time=drive.time)
    y = np.interp(drive.time - delay, drive.time, y)
    y = (1 + gain) * y + offset + (slow(drive.time) if slow else 0.0)
    return Record(drive.time, drive.voltage, y, f"later-{seed}")
