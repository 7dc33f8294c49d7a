"""What an excitation is refused for, and the sentence that says so."""

import math
import tracemalloc

import numpy as np
import pytest

from dehyst import ModelError, RecordError
from dehyst.waveforms import (
    Excitation,
    Sampling,
    descending_tops,
    excitation,
    homing,
    minor_loop,
    raised_cosine,
    reversal_curves,
    staircase,
)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"frequency": 0}, "frequency: got 0, need a number above 0"),
        ({"frequency": math.nan}, "frequency: got nan, need a finite number"),
        ({"frequency": None}, "frequency: got None, need a finite number"),
        ({"sample_rate": -1.0}, "sample_rate: got -1, need a number above 0"),
        ({"sample_rate": 0.07}, "got 0.07 Hz for 0.01 Hz, need 8 samples a cycle at least; try 4 Hz"),
        ({"slew_rate": 0.0}, "slew_rate: got 0, need a number above 0"),
        ({"slew_rate": True}, "slew_rate: got True, need a finite number"),
        ({"base": "0"}, "base: got '0', need a finite number"),
        ({"base": None}, "base: got None, need a finite number"),
        ({"base": 2e6}, "base: got 2e\\+06 V, need 1e\\+06 V at most; check the unit"),
        ({"present": math.inf}, "present: got inf, need a finite number"),
        ({"present": 201.0, "limits": (0, 200)}, "present: got 201 V, but the limits are 0 to 200 V"),
        (
            {"base": -1.0, "limits": (0, 200)},
            "base: got -1 V, but the limits are 0 to 200 V; ask for less",
        ),
        (
            {"limits": (200, 0)},
            r"got \(200, 0\), need two finite voltages, the lower one first, such as \(0, 200\)",
        ),
        ({"limits": 200.0}, "limits: got 200.0, need two finite voltages"),
        ({"limits": (0, 1, 2)}, "need two finite voltages"),
        ({"limits": (0, math.nan)}, "limits: got nan, need a finite number"),
        ({"limits": "ab"}, "limits: got 'a', need a finite number"),
        ({"shape": "sine"}, "shape: got 'sine', need 'cosine' or 'triangle'"),
        ({"pace": ["rate"]}, r"pace: got \['rate'\], need 'frequency' or 'rate'"),
    ],
)
def test_drives(options, message):
    with pytest.raises(RecordError, match=message):
        Sampling(**options)


@pytest.mark.parametrize("peaks", [[], [0.0], -5.0, [10.0, 0.0]])
def test_peaks_not_above_the_base(peaks):
    with pytest.raises(RecordError, match=r"peaks: got .*above the base 0 V"):
        raised_cosine(peaks)


@pytest.mark.parametrize("peaks", [[10.0, math.nan], math.inf, "200", [[1.0, 2.0]], None, [True]])
def test_peaks_that_are_no_voltages(peaks):
    with pytest.raises(RecordError, match=r"peaks: .*in V"):
        raised_cosine(peaks)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: raised_cosine(1.0, cycles=0), "cycles: got 0, need a whole number from 1 to 500000"),
        (lambda: raised_cosine(1.0, cycles=10**12), "cycles: got 1000000000000, need a whole number"),
        (lambda: raised_cosine(np.ones(10_000), cycles=1000), "cycles: got 1000, need a whole number from 1 to 50"),
        (lambda: descending_tops(1.0, steps=2.0), r"steps: got 2.0, need a whole number"),
        (lambda: descending_tops(1.0, majors=-1), "majors: got -1, need a whole number from 0 to"),
        (lambda: descending_tops(0.0), "highest: got 0 V, need a voltage above the base 0 V"),
        (lambda: descending_tops(math.nan), "highest: got nan, need a finite number"),
        (lambda: descending_tops(1e-323, steps=10), "turns: got 0 V twice in a row, need different voltages"),
        (lambda: reversal_curves(1.0, lowest=1.0), "lowest: got 1 V, need a voltage below the highest, 1 V"),
        (lambda: reversal_curves(1.0, count=True), "count: got True, need a whole number"),
        (lambda: minor_loop(3, 2, highest=9), "got 3 to 2 V, need low below high, both between the base 0 V and"),
        (lambda: minor_loop(3, 10, highest=9), "got 3 to 10 V, need .* and the highest, 9 V"),
        (lambda: minor_loop(-3, 2, highest=9), "got -3 to 2 V, need"),
        (lambda: staircase(1.0, hold=0), "hold: got 0, need a number above 0"),
        (lambda: staircase(1.0, ramp=-1), "ramp: got -1, need a number above 0"),
        (lambda: staircase(1.0, steps=0), "steps: got 0, need a whole number from 1 to"),
        (homing, "homing: got neither of highest and turns, need one; try the highest"),
        (lambda: homing(5.0, turns=[1.0]), "homing: got both of highest and turns, need one"),
        (lambda: homing(turns=[]), "turns: got 0 beside the present 0 V, need 1 to"),
        (lambda: homing(turns=[0.0]), "turns: got 0 beside the present 0 V, need 1 to"),
        (lambda: homing(turns=[3.0, 3.0]), "turns: got 3 V twice in a row"),
        (lambda: homing(turns=["a"]), "turns: got list, need an array of numbers; give voltages in V"),
        (lambda: Excitation("mine", [1.0], 1.0), r"voltage: got 1 sample, need 2"),
        (lambda: Excitation("mine", [1.0, 2.0], 0.0), "sample_rate: got 0, need"),
    ],
)
def test_kinds(make, message):
    with pytest.raises(RecordError, match=message):
        make()


@pytest.mark.parametrize(
    "make",
    [
        lambda: raised_cosine(1.0, cycles=10_000, drive=Sampling(sample_rate=1000.0)),
        lambda: raised_cosine(1.0, drive=Sampling(frequency=1e-12, sample_rate=1e12)),
        lambda: raised_cosine(200.0, drive=Sampling(slew_rate=1e-6)),
        lambda: staircase(1.0, hold=1e12),
        lambda: staircase(1.0, ramp=1e12),
    ],
)
def test_too_long_before_memory_is_taken(make):
    tracemalloc.start()
    try:
        with pytest.raises(RecordError, match=r"5e\+07 at most"):
            make()
        assert tracemalloc.get_traced_memory()[1] < 10e6
    finally:
        tracemalloc.stop()


def test_what_does_not_fit_behind():
    first = raised_cosine(10.0)
    with pytest.raises(RecordError, match="present voltage 0"):
        first.then(homing(turns=[9.0], drive=Sampling(present=5.0)))
    with pytest.raises(RecordError, match="rates: got 4 and then 8"):
        first.then(raised_cosine(10.0, drive=Sampling(sample_rate=8.0)))


def test_both_together_too_long(monkeypatch):
    first = raised_cosine(10.0)
    monkeypatch.setattr(excitation, "_MOST_SAMPLES", 800)
    with pytest.raises(RecordError, match="got 801 samples"):
        first.then(first)


def test_voltages_cannot_be_changed_afterwards():
    made = raised_cosine(10.0)
    with pytest.raises(ValueError, match="read-only"):
        made.voltage[0] = 1.0
    assert repr(made) == "<Excitation 'raised-cosine': 401 samples, 100 s, 0 to 10 V>"


def test_an_own_voltage_can_be_joined_too():
    given_away = np.array([0.0, 1.0, 0.5])
    own = Excitation("own", given_away, 4)
    given_away[1] = 9.0
    joined = raised_cosine(10.0).then(own)
    assert joined.turns.tolist() == [0, 10, 0, 1, 0.5]
    assert joined.name == "raised-cosine+own"


def test_errors_are_the_records_own():
    """One kind of exception for all that is wrong with an excitation."""
    with pytest.raises(RecordError) as caught:
        raised_cosine([math.nan])
    assert not isinstance(caught.value, ModelError)
