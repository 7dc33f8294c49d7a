"""What an excitation is refused for, and the sentence that says so."""

import math
import tracemalloc

import numpy as np
import pytest

from dehyst import RecordError
from dehyst.waveforms import (
    Excitation,
    Sampling,
    descending_tops,
    homing,
    raised_cosine,
    recommended,
    staircase,
)


@pytest.mark.parametrize(
    "options",
    [
        {"frequency": 0},
        {"frequency": math.nan},
        {"frequency": None},
        {"sample_rate": -1.0},
        {"sample_rate": 0.07},
        {"slew_rate": 0.0},
        {"slew_rate": True},
        {"base": "0"},
        {"base": 2e6},
        {"present": math.inf},
        {"present": 201.0, "limits": (0, 200)},
        {"base": -1.0, "limits": (0, 200)},
        {"limits": (200, 0)},
        {"limits": 200.0},
        {"limits": (0, 1, 2)},
        {"limits": (0, math.nan)},
        {"limits": "ab"},
    ],
)
def test_drives(options):
    with pytest.raises(RecordError):
        Sampling(**options)


PEAKS = ([], [0.0], -5.0, [10.0, 0.0], [10.0, math.nan], math.inf, "200", [[1.0, 2.0]], None, [True])


@pytest.mark.parametrize(
    "make",
    [
        *(lambda peaks=peaks: raised_cosine(peaks) for peaks in PEAKS),
        lambda: raised_cosine(1.0, cycles=0),
        lambda: raised_cosine(1.0, cycles=10**12),
        lambda: raised_cosine(np.ones(10_000), cycles=1000),
        lambda: raised_cosine(200.0, drive=Sampling(slew_rate=1e-10, sample_rate=1e6)),
        lambda: descending_tops(1.0, steps=2.0),
        lambda: descending_tops(1.0, majors=-1),
        lambda: descending_tops(0.0),
        lambda: descending_tops(math.nan),
        lambda: descending_tops(1e-323, steps=10),
        lambda: recommended(0.0),
        lambda: staircase(1.0, hold=0),
        lambda: staircase(1.0, steps=0),
        homing,
        lambda: homing(5.0, turns=[1.0]),
        lambda: homing(turns=[]),
        lambda: homing(turns=[0.0]),
        lambda: homing(turns=[3.0, 3.0]),
        lambda: homing(turns=["a"]),
        lambda: Excitation("mine", [1.0], 1.0),
        lambda: Excitation("mine", [1.0, 2.0], 0.0),
    ],
)
def test_kinds(make):
    with pytest.raises(RecordError):
        make()


@pytest.mark.parametrize(
    "make",
    [
        lambda: raised_cosine(1.0, cycles=10_000, drive=Sampling(sample_rate=1000.0)),
        lambda: raised_cosine(1.0, drive=Sampling(frequency=1e-12, sample_rate=1e12)),
        lambda: raised_cosine(200.0, drive=Sampling(slew_rate=1e-6)),
        lambda: staircase(1.0, hold=1e12),
    ],
)
def test_too_long_before_memory_is_taken(make):
    tracemalloc.start()
    try:
        with pytest.raises(RecordError):
            make()
        assert tracemalloc.get_traced_memory()[1] < 10e6
    finally:
        tracemalloc.stop()


def test_voltages_cannot_be_changed_afterwards():
    made = raised_cosine(10.0)
    with pytest.raises(ValueError, match="read-only"):
        made.voltage[0] = 1.0
    assert repr(made) == "<Excitation 'raised-cosine': 401 samples, 100 s, 0 to 10 V>"


def test_an_own_voltage_is_a_copy():
    given_away = np.array([0.0, 1.0, 0.5])
    own = Excitation("own", given_away, 4)
    given_away[1] = 9.0
    assert own.turns.tolist() == [0, 1, 0.5]
