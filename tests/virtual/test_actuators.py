"""The virtual actuators: hysteretic, seeded, and no instances of the models."""

from itertools import pairwise

import numpy as np
import pytest
from truths import BoucWenActuator, PreisachActuator

import dehyst
from dehyst.virtual import PlayActuator
from dehyst.waveforms import standard


def test_the_falling_branch_is_above_the_rising_one_and_loops_are_asymmetric():
    truth = PlayActuator(noise=0)
    y = truth.play(standard.raised_cosine(truth.highest, cycles=2).voltage)[400:]
    up, down = y[1:200], y[201:400][::-1]
    assert np.all(down[5:-5] > up[5:-5])
    middle = 0.5 * (up + down) - 0.5 * truth.stroke
    assert np.abs(middle + middle[::-1]).max() > 0.01 * truth.stroke


KINDS = [PlayActuator, PreisachActuator, BoucWenActuator]


def slowly(truth, voltage, seconds=1.0):
    """Displacement [m] without noise, a sample each `seconds`."""
    return truth.play(voltage, time=seconds * np.arange(1, len(voltage) + 1), measured=False)


def branches(turns, samples=200):
    """Voltage through turning points, straight."""
    return np.concatenate([[turns[0]], *(np.linspace(a, b, samples + 1)[1:] for a, b in pairwise(turns))])


@pytest.mark.parametrize("kind", KINDS)
def test_the_major_loop_has_the_stated_height_and_the_width_of_a_piezo(kind):
    truth = kind()
    y = slowly(truth, branches([0, 200] * 3 + [0]))
    loop = y[800:]
    up, down = loop[:201], loop[200:401][::-1]
    assert loop.min() == pytest.approx(0, abs=1e-4 * truth.stroke)
    assert loop.max() == pytest.approx(truth.stroke, rel=1e-4)
    assert 0.13 < (down - up).max() / truth.stroke < 0.18
    assert np.all(np.diff(up) > 0)
    assert np.all(np.diff(down) > 0)
    np.testing.assert_allclose(loop, y[400:801], rtol=0, atol=1e-4 * truth.stroke)


@pytest.mark.parametrize("kind", KINDS)
def test_a_drive_continues_from_the_end_of_the_last_one(kind):
    options = {"creep": 0.02} if kind is PlayActuator else {}
    voltage = branches([0, 200, 30, 120, 0, 170], 37)
    time = np.cumsum(np.random.default_rng(1).uniform(1e-4, 2e-3, voltage.size))
    whole = kind(**options).play(voltage, time=time)
    parts = kind(**options)
    cut = [parts.play(voltage[a:b], time=time[a:b]) for a, b in pairwise([0, 2, 50, 51, voltage.size])]
    np.testing.assert_allclose(np.concatenate(cut), whole, rtol=0, atol=1e-11 * parts.stroke)
    parts.relax()
    np.testing.assert_allclose(
        slowly(parts, voltage), slowly(kind(**options), voltage), rtol=0, atol=1e-12 * parts.stroke
    )


@pytest.mark.parametrize("creep", [0.01, 0.03])
def test_creep_adds_the_stated_share_of_a_step_in_each_decade(creep):
    truth = PlayActuator(creep=creep, noise=0)
    time = np.concatenate([np.arange(1, 11) * 1e-3, 0.01 + np.geomspace(1e-3, 600, 4000)])
    y = truth.play(np.where(time <= 0.01, 0.0, 150.0), time=time)
    step = PlayActuator(noise=0).play([0.0, 150.0])
    decades = np.interp([0.2, 2.0, 20.0, 200.0], time - 0.011, y) / np.diff(step)
    np.testing.assert_allclose(np.diff(decades), creep, rtol=0.06)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: PlayActuator(creep=-0.1), "creep: got -0.1"),
        (lambda: PlayActuator(noise=-1.0), "noise: got -1.0"),
        (lambda: PlayActuator(asymmetry=2.0), "asymmetry 2"),
        (lambda: BoucWenActuator().play([0, 1]), "swings"),
        (lambda: PlayActuator(creep=0.01).play([0, 1]), "creeps"),
        (lambda: BoucWenActuator().play([0, 1], time=[0]), "time: got 1 samples"),
        (lambda: BoucWenActuator().play([0, 1], time=[0, 0]), "at sample 1"),
        (lambda: BoucWenActuator().play([0], time=[0]), "got one sample"),
    ],
)
def test_impossible_truths_and_times_are_refused(build, message):
    with pytest.raises(dehyst.ModelError, match=message):
        build()
