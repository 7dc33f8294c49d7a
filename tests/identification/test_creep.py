"""Creep in displacement: found from speeds and holds, compared and compensated."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
import structured_records as wide

import dehyst
from dehyst import DisplacementCreep, Record
from dehyst.identification import prepare, search, state_after
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops, recommended, staircase
from examples import at_night

HIGHEST, RATE = 100.0, 10.0


def actuator(creep):
    return PlayActuator(stroke=12e-6, highest=HIGHEST, noise=2e-9, creep=creep)


def records(truth, hold=30.0):
    """The recommended excitation, then a staircase with holds, in one run."""
    drive = Sampling(frequency=0.1, sample_rate=RATE, limits=(0.0, HIGHEST))
    parts = (recommended(HIGHEST, drive=drive), staircase(HIGHEST, hold=hold, back=True, drive=drive))
    time = np.arange(sum(len(part.time) for part in parts)) / RATE
    y = truth.play(np.concatenate([part.voltage for part in parts]), time=time)
    cut = len(parts[0].time)
    pairs = ((time[:cut], parts[0].voltage, y[:cut]), (time[cut:], parts[1].voltage, y[cut:]))
    return [Record(*pair, name) for pair, name in zip(pairs, ("tops", "stairs"), strict=True)]


@cache
def creeping():
    truth = actuator(0.02)
    found = records(truth)
    return truth, found, dehyst.identify(found)


def test_creep_in_displacement_is_found():
    _, _, fit = creeping()
    part = fit.actuator.displacement_creep
    decades = np.log10(part.time_constants[-1] / part.time_constants[0])
    # The truth creeps by 2 % a decade.
    assert 0.012 < part.gains.sum() / decades < 0.028
    assert all(error.rms_percent < 0.1 for error in fit.errors)


def test_little_creep_is_left_in_a_hold_of_five_minutes():
    truth, (_, stairs), fit = creeping()
    model = fit.actuator
    state, _ = state_after(model, stairs)
    wanted = np.concatenate([[0.0], 7e-6 * np.linspace(0, 1, 40), np.full(round(300 * RATE), 7e-6)])
    wanted += float(stairs.displacement[-20:].mean()) * (wanted < 7e-6)
    clock = float(stairs.time[-1]) + np.arange(wanted.size) / RATE
    voltage = model.compensate(wanted, time=clock, state=state, extrapolate=True).voltage
    reached = truth.play(voltage[1:], time=clock[1:])[39:]
    # A step of 7 um creeps by 2 % a decade, 3.3 decades here.
    assert abs(reached[-200:].mean() - reached[:5].mean()) < 0.15 * 3.3 * 0.02 * 7e-6


def test_the_state_after_a_record_continues_its_creep():
    _, (_, stairs), fit = creeping()
    model, middle = fit.actuator, 3000
    state, offset = state_after(model, stairs[:middle])
    rest = stairs[middle - 1 : middle + 1000]
    y = model.simulate(rest.voltage - offset, time=rest.time, state=state, extrapolate=True).displacement
    assert np.std(y - rest.displacement) < 0.002 * 12e-6


@pytest.mark.nightly
def test_without_holds_or_without_creep_the_model_has_no_creep():
    tops, stairs = records(actuator(0.0))
    assert dehyst.identify([tops]).actuator.displacement_creep is None
    assert dehyst.identify([tops, stairs]).actuator.displacement_creep is None


@pytest.mark.parametrize("block", [4, 5, 8])
def test_the_creep_of_averaged_samples_begins_with_the_record(block):
    """The rise before the samples that count belongs to the record of means too, whatever the block leaves over."""
    part = DisplacementCreep([0.5, 20.0], [0.02, 0.03])
    drive = Sampling(frequency=0.1, sample_rate=40.0, limits=(0.0, HIGHEST))
    voltage = descending_tops(HIGHEST, steps=3, drive=drive).voltage
    time = np.arange(voltage.size) / 40.0
    item = prepare(Record(time, voltage, actuator(0.02).play(voltage, time=time), "tops"))
    assert item.lead is not None
    reduced = replace(item, block=block).reduced
    assert reduced.record.sample_time == pytest.approx(block / 40.0)
    moved, whole = (state.without_creep(part).record for state in (reduced, item))
    expected = np.interp(moved.time, whole.time, whole.displacement)
    assert np.abs(moved.displacement - expected).max() < 1e-3 * np.ptp(expected)


def with_holds(places, *, creep=0.0, drift=0.0, seed=33):
    """Random turns with holds of 40 s after two of them; the sensor drifts by a part of the stroke."""
    levels = np.concatenate([[0, 100, 0], np.random.default_rng([seed, 7]).uniform(0, 100, 24), [0]])
    counts = np.maximum(np.abs(np.diff(levels)) * (1 + np.arange(27) % 3) / 3, 4).astype(int)
    branches = [np.linspace(a, b, n + 1)[1:] for (a, b), n in zip(pairwise(levels), counts, strict=True)]
    held = [np.append(branch, np.full(400 * (k in places), branch[-1])) for k, branch in enumerate(branches)]
    voltage = np.concatenate(held)
    time = np.arange(voltage.size) / RATE
    y = actuator(creep).play(voltage, time=time)
    return Record(time, voltage, y + drift * 12e-6 * np.log10(1 + time / 5), "holds")


@pytest.mark.parametrize("places", [(3, 15), at_night((5, 9)), at_night((12, 24))])
def test_creep_is_found_in_holds_and_is_distinguished_from_drift(places):
    for kind, options in {"creep": {"creep": 0.01}, "drift": {"drift": 0.01}}.items():
        frame = wide.frame([with_holds(places, **options)])
        assert len(frame.rests[0]) == 2
        found, names, _ = search.moving(frame, lambda _: None, lag=True, drift=True, more=True)
        assert kind in names and ("creep" in names) == (kind == "creep") and found.motion.hidden == 0
    # Creep is found or left open where it never rests.
    motion = search.moving(wide.frame([with_holds((), creep=0.01)]), print, lag=True, drift=True, more=True)[0].motion
    assert motion.creep is not None or motion.hidden >= 0.01


@pytest.mark.parametrize("lag", [at_night(0.0), 0.003, at_night(0.02)])
def test_a_lag_is_found_beside_creep(lag):
    given = recommended(HIGHEST, drive=Sampling(0.1, sample_rate=40.0))
    late = np.interp(given.time - lag, given.time, given.voltage)
    record = Record(given.time, given.voltage, actuator(0.01).play(late, time=given.time))
    motion = search.moving(wide.frame([record]), lambda _: None, lag=True, drift=True, more=True)[0].motion
    assert motion.creep is not None and motion.delay + motion.lag == pytest.approx(lag, abs=1e-3)
