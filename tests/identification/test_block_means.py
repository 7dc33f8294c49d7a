"""Records sampled far faster than they move, as means of neighbouring samples."""

from dataclasses import replace

import numpy as np
import pytest

from dehyst import Actuator, Record, identify
from dehyst.identification.comparison import compare, errors_of
from dehyst.identification.preparation import block_of, prepare
from dehyst.model import MaxwellSlip, Spring
from dehyst.records.signals import bandwidth

STROKE = 10e-6
DELAY = 4e-3


def voltage(seconds, rate, seed):
    """Raised cosines of 1 Hz between random turns, in 0..100 V; the first two cycles are full."""
    rng = np.random.default_rng(seed)
    turns = [0.0, 100.0, 0.0, 100.0, 0.0]
    while len(turns) < 2 * seconds + 1:
        turns += [rng.uniform(50, 100), rng.uniform(0, 40)]
    turns = np.array(turns[: 2 * seconds + 1])
    phase = np.arange(seconds * rate) / rate * 2
    branch = phase.astype(int)
    return turns[branch] + (turns[branch + 1] - turns[branch]) * 0.5 * (1 - np.cos(np.pi * (phase - branch)))


def truth():
    rho = STROKE / 2 * np.array([0.06, 0.2, 0.45, 0.8])
    slip = MaxwellSlip(rho, 1e6 * np.array([2.0, 1.2, 0.8, 0.5]))
    return Actuator(slip, Spring([-0.2 * STROKE, 1.5 * STROKE], 7e6 * np.array([-0.2 * STROKE, 1.5 * STROKE])))


def recorded(seconds, rate, seed, noise):
    time = np.arange(seconds * rate) / rate
    v = voltage(seconds, rate, seed)
    late = truth().simulate(np.interp(time - DELAY, time, v)).displacement
    return Record(time, v, late + noise * STROKE * np.random.default_rng(seed + 1).normal(size=time.size))


@pytest.mark.parametrize(("rate", "least", "most"), [(200, 1, 1), (1000, 2, 5), (10_000, 16, 50)])
def test_a_block_keeps_the_motion_and_enough_samples(rate, least, most):
    record = recorded(20, rate, 3, 0.003)
    block = block_of(record, len(record) / 4000)
    assert least <= block <= most
    assert block * record.sample_time <= 1 / 60
    # A mean would move an event.
    assert block_of(replace(record, measured=np.arange(len(record)) % 9 == 0), len(record) / 4000) == 1


def test_steps_have_no_bandwidth_below_their_sampling():
    time = np.arange(20_000) * 1e-3
    steps = np.floor(time / 2) % 4
    assert block_of(Record(time, steps, 1e-6 * steps), 5) == 1
    assert bandwidth(np.sin(2 * np.pi * time), 1e-3, 1e-5) < 2


@pytest.mark.nightly
def test_a_fast_recording_gives_the_model_of_a_slow_one():
    unseen = recorded(12, 500, 40, 0.0)
    found = {}
    for rate in (200, 10_000):
        fit = identify(recorded(20, rate, 3, 0.003), structure="maxwell_slip")
        found[rate] = errors_of(fit.actuator, compare(fit.actuator, prepare(unseen), STROKE), "validation")[0]
        assert fit.actuator.delay == pytest.approx(DELAY, abs=1e-3)
        assert fit.errors[0].samples > 0.99 * 20 * rate
    assert found[10_000].rms < 0.0015 * STROKE
    assert found[10_000].rms < 1.2 * found[200].rms + 2e-4 * STROKE
