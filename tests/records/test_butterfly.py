"""Butterfly loops are refused as such, with the voltages between which to record; other loops are not taken for one."""

import numpy as np
import plain_records
import pytest
from truths import BoucWenActuator

from dehyst import Record, RecordError
from dehyst.operations.demo import record_loops
from dehyst.records import loops
from dehyst.virtual import PlayActuator

COERCIVE = 60.0


def butterfly(low, high, noise=0.0, cycles=4, seed=0):
    """A ferroelectric whose polarisation P follows the voltage by a play of tanh: strain d P v + Q P^2."""
    t = np.arange(cycles * 1000 + 1) / 1000
    v = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(2 * np.pi * t)
    polarisation, now = np.empty_like(v), -1.0 if low < -COERCIVE else 1.0
    for i, volts in enumerate(v):
        now = min(max(now, np.tanh((volts - COERCIVE) / 8)), np.tanh((volts + COERCIVE) / 8))
        polarisation[i] = now
    y = 1e-8 * polarisation * v + 5e-7 * polarisation**2
    return Record(t, v, y + noise * np.random.default_rng(seed).normal(size=y.size), "bipolar")


def with_displacement(record, displacement):
    return Record(record.time, record.voltage, displacement, record.name)


@pytest.mark.parametrize("noise", [0.0, 1e-8, 1e-7])
@pytest.mark.parametrize(("low", "high"), [(-200, 200), (-100, 300), (-140, 260), (-70, 170), (-70, 70)])
def test_a_butterfly_is_refused_with_the_voltages_to_record(low, high, noise):
    record = butterfly(low, high, noise)
    with pytest.raises(RecordError, match="rising voltage: a butterfly"):
        record.check_usable()
    _, _, turn = loops.butterfly(record.voltage, record.displacement)
    assert -COERCIVE < turn < COERCIVE
    # And above it is a loop like any other.
    butterfly(turn, high, noise or 1e-9).check_usable()


@pytest.mark.parametrize("noise", [0.0, 1e-7])
def test_a_butterfly_seen_by_an_inverted_sensor_is_one_too(noise):
    record = butterfly(-200, 120, noise)
    _, _, turn = loops.butterfly(record.voltage, -record.displacement)
    assert -COERCIVE < turn < COERCIVE
    with pytest.raises(RecordError, match="a butterfly loop"):
        with_displacement(record, -record.displacement).check_usable()


@pytest.mark.parametrize("noise", [0.0, 1e-7])
def test_loops_within_the_coercive_field_are_none(noise):
    record = butterfly(-40, 120, noise)
    record.check_usable()
    with pytest.raises(RecordError, match="the sensor's sign"):
        with_displacement(record, -record.displacement).check_usable()
    # Poled the other way and kept there: the whole displacement falls.
    with pytest.raises(RecordError, match="actuator is poled"):
        butterfly(-160, 40, noise).check_usable()


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.1, 0.2])
def test_a_lag_is_no_butterfly(delay):
    """A phase lag makes the displacement fall at the beginning of each rise, but rise at the beginning of each fall."""
    t = np.arange(4001) / 1000
    v, y = (100 - 100 * np.cos(2 * np.pi * (t - late)) for late in (0.0, delay))
    assert loops.butterfly(v, 1e-8 * y) is None


@pytest.mark.parametrize(
    "turns",
    [plain_records.MAJOR, plain_records.THREE_LOOPS, plain_records.DESCENDING_TOPS, plain_records.REVERSAL_CURVES],
)
def test_loops_of_the_model_with_a_drift_are_none(turns):
    record = plain_records.loops(plain_records.plant(10, curved=0.6), turns)
    for drift in (-0.5, 0.0, 0.5):
        y = record.displacement + drift * plain_records.STROKE * np.linspace(0, 1, len(record))
        assert loops.butterfly(record.voltage, y) is None


@pytest.mark.parametrize("truth", [PlayActuator, BoucWenActuator])
def test_loops_of_virtual_actuators_are_none(truth):
    if truth is PlayActuator:
        record = record_loops(truth())[0]
    else:
        v = np.interp(np.arange(20_000), np.arange(0, 20_001, 500), np.resize([0, 100, 0, 60, 20, 100], 41))
        time = np.arange(v.size) * 1e-4
        record = Record(time, v, truth().play(v, time=time))
    assert loops.butterfly(record.voltage, record.displacement) is None
