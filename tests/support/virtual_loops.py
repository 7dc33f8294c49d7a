"""Loops of a virtual actuator, from which a model is identified quickly."""

from dehyst import Record
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops, raised_cosine

PLAYS = 60


def record_loops():
    """Return records for training and validation as the demo's: fewer plays, and turning points anywhere."""
    truth, drive = PlayActuator(plays=PLAYS), Sampling(sample_rate=4.0)
    tops = descending_tops(truth.highest, steps=6, random=6, drive=drive)
    others = raised_cosine([0.75 * truth.highest, 0.45 * truth.highest], cycles=2, drive=drive)
    return (
        Record(tops.time, tops.voltage, truth.play(tops.voltage), name="loops"),
        Record(others.time, others.voltage, truth.play(others.voltage), name="other-loops"),
    )
