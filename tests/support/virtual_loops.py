"""Loops of a virtual actuator, from which a model is identified quickly."""

import numpy as np

from dehyst import Record
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, homing, raised_cosine

PLAYS = 60


def record_loops():
    """Return a record for training, with many different turning points, and a record for validation."""
    truth, drive = PlayActuator(plays=PLAYS), Sampling(sample_rate=4.0)
    falling = [v for top in np.linspace(1, 1 / 6, 6) * truth.highest for v in (top, 0.0)]
    inner = [0.64 * truth.highest, 50.0, 0.41 * truth.highest, 10.0, 0.9 * truth.highest, 0.0]
    tops = homing(turns=[*(truth.highest, 0.0) * 2, *falling, *inner], drive=drive)
    others = raised_cosine([0.75 * truth.highest, 0.45 * truth.highest], cycles=2, drive=drive)
    return (
        Record(tops.time, tops.voltage, truth.play(tops.voltage), name="loops"),
        Record(others.time, others.voltage, truth.play(others.voltage), name="other-loops"),
    )
