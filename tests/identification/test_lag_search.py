"""What lags is found beside what creeps: neither is taken for the other, nor for a drift."""

import itertools
import sys
from dataclasses import replace
from functools import cache

import numpy as np
import plain_records
import pytest
import structured_records as wide
from truths import BoucWenActuator

import dehyst
from dehyst import Record
from dehyst.identification.held_out import drift_and_creep
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops
from examples import at_night

PERIOD, STEP = 10.0, 0.05
SENSOR_LAG = PERIOD / 60


def low_pass(values, lag, step):
    """Values behind a low-pass of first order, exact where they are linear between samples; lag and step in s."""
    if not lag:
        return values
    keep = np.exp(-step / lag)
    mean = (1 - keep) * lag / step
    passed = [float(values[0])]
    for before, now in itertools.pairwise(values.tolist()):
        passed.append(keep * passed[-1] + (mean - keep) * before + (1 - mean) * now)
    return np.array(passed)


@cache
def tops(truth, lag, sensor_lag=0.0, **options):
    """Falling tops of one duration, played into a truth behind a lag [s], seen by a sensor behind another."""
    played = descending_tops(100, steps=5, drive=Sampling(frequency=1 / PERIOD, sample_rate=1 / STEP))
    actuator = truth(stroke=12e-6, highest=100.0, noise=0.0, **options)
    y = actuator.play(low_pass(played.voltage, lag, STEP), time=played.time)
    noise = 2e-4 * 12e-6 * np.random.default_rng(1).normal(size=y.size)
    return Record(played.time, played.voltage, low_pass(y, sensor_lag, STEP) + noise, "tops")


@pytest.mark.parametrize(
    ("truth", "lag", "options"),
    [(PlayActuator, 0.1, {"creep": 0.03}), at_night(BoucWenActuator, 0.3, {"delay": 0.0})],
    ids=["creeping", "gradual friction"],
)
def test_a_lag_is_found_beside_what_looks_like_one(truth, lag, options):
    """Searched without creep and gradual elements, the first was read as 124 ms and the second not found."""
    found = dehyst.identify(tops(truth, lag, **options), norm="l2").actuator
    assert found.delay + found.lag == pytest.approx(lag, rel=0.1)


@pytest.mark.parametrize("creep", [at_night(0.0), 0.03])
def test_creep_is_no_lag(creep):
    found = dehyst.identify(tops(PlayActuator, 0.0, creep=creep), norm="l2").actuator
    assert (found.delay, found.lag) == (0, 0)


@cache
def one_speed():
    """Falling tops at one slew rate, seen by a sensor behind a low-pass."""
    drive = Sampling(frequency=1 / PERIOD, sample_rate=1 / STEP, shape="triangle", pace="rate")
    played = descending_tops(100, steps=8, drive=drive)
    y = PlayActuator(stroke=12e-6, highest=100.0, noise=0.0).play(played.voltage)
    noise = 2e-4 * 12e-6 * np.random.default_rng(1).normal(size=y.size)
    return Record(played.time, played.voltage, low_pass(y, SENSOR_LAG, STEP) + noise, "one speed")


@cache
def found_at_one_speed():
    return dehyst.identify(one_speed(), norm="l2")


def test_a_sensor_s_low_pass_is_a_lag_of_first_order_and_no_creep():
    fit = found_at_one_speed()
    assert fit.actuator.creep is None
    assert fit.actuator.lag > 0.3 * SENSOR_LAG
    assert fit.actuator.delay + fit.actuator.lag == pytest.approx(SENSOR_LAG, rel=0.1)


def test_the_error_is_promised_for_either_cause_of_a_lag_until_it_is_known():
    unknown = found_at_one_speed()
    none, known = (dehyst.identify(one_speed(), norm="l2", sensor_lag=lag) for lag in (0.0, SENSOR_LAG))
    rms, largest = unknown.expectation.if_actuator_lags
    assert unknown.expectation.rms > 2 * rms
    assert unknown.expectation.largest > largest
    assert unknown.expectation.as_dict()["if_actuator_lags_m"] == [rms, largest]
    assert none.expectation.if_actuator_lags is None
    assert len(none.expectation.reasons) < len(unknown.expectation.reasons)
    # A derivative over nine samples rounds the turns by part of a sample.
    assert known.actuator.delay + known.actuator.lag < 0.5 * STEP


def two_speeds(sensor_lag, **options):
    """Falling tops, fast and slow, seen by a sensor behind a low-pass."""
    actuator, records, begin = PlayActuator(stroke=12e-6, highest=100.0, noise=0.0, **options), [], 0.0
    for period in (PERIOD, 5 * PERIOD):
        played = descending_tops(100, steps=5, drive=Sampling(frequency=1 / period, sample_rate=200 / period))
        step = period / 200
        y = low_pass(actuator.play(played.voltage, time=begin + played.time), sensor_lag, step)
        noise = 2e-4 * 12e-6 * np.random.default_rng(1).normal(size=y.size)
        records.append(Record(begin + played.time, played.voltage, y + noise, f"{period:g} s"))
        begin += played.time[-1] + step
    return records


@pytest.mark.nightly
def test_branches_that_follow_a_step_at_once_are_no_creep():
    """Even where a lag was excluded by an option, so that only creep is left to explain it."""
    fit = dehyst.identify(two_speeds(PERIOD / 30), norm="l2", delay=0.0)
    assert fit.actuator.creep is None
    assert any("low-pass" in remark for remark in fit.remarks)


@pytest.mark.nightly
def test_creep_at_two_speeds_stays():
    fit = dehyst.identify(two_speeds(0.0, creep=0.02), norm="l2")
    assert fit.actuator.creep is not None
    assert fit.actuator.delay + fit.actuator.lag < 0.2 * STEP


def growing():
    """Loops that grow from the middle of the range: their free constants make room for a drift."""
    samples, halves = 60, np.linspace(0.04, 0.5, 12)
    turns = 50 + 100 * np.array([0.0, *(side * half for half in halves for side in (1, -1))])
    leg = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, samples // 2 + 1) / (samples // 2))
    voltage = np.concatenate([turns[:1], *(a + (b - a) * leg for a, b in itertools.pairwise(turns))])
    time, before = np.arange(voltage.size) * PERIOD / samples, 0.05 * np.arange(100)
    truth = BoucWenActuator(stroke=12e-6, highest=100.0, noise=0.0, delay=0.0)
    truth.play(np.linspace(0, 50, before.size), time=before)
    y = truth.play(voltage, time=time + 6.0)
    return Record(time, voltage, y + 2e-9 * np.random.default_rng(1).normal(size=y.size), "growing")


def drifting():
    """Falling tops, seen by a sensor that drifts by 3 %."""
    seen = tops(PlayActuator, 0.0)
    return replace(seen, displacement=seen.displacement + 0.03 * 12e-6 * seen.time / seen.time[-1])


@pytest.mark.slow
@pytest.mark.parametrize(("record", "real"), [(growing, False), (drifting, True)])
def test_a_drift_is_kept_only_if_it_predicts(record, real):
    """Plain elements take either for a drift; creep could explain both, at one speed."""
    frame = replace(wide.frame([record()]), can_drift=(0,))
    assert frame.drifting == (0,)
    assert drift_and_creep(frame) == (real, True)


def test_a_delay_is_found_in_every_so_many_th_sample_too(monkeypatch):
    rng = np.random.default_rng(0)
    made = plain_records.loops(plain_records.plant(12), plain_records.THREE_LOOPS, samples=400)
    late = np.interp(made.time - 0.03, made.time, made.displacement)
    record = dehyst.Record(made.time, made.voltage, late + 1e-9 * rng.normal(size=len(made)), "late")
    fine = dehyst.identify(record, elements=12).options["delay_s"]
    monkeypatch.setattr(sys.modules["dehyst.identification.run"], "_SEARCH_CYCLE", 200)
    coarse = dehyst.identify(record, elements=12).options["delay_s"]
    assert fine == pytest.approx(0.03, abs=0.1 / 200)
    assert coarse == pytest.approx(0.03, abs=0.3 / 200)
    assert coarse != fine
