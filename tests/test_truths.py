"""The virtual actuator: hysteretic, seeded, and no instance of the model."""

import numpy as np
import pytest

import dehyst
from dehyst import excite
from dehyst.truths import PlayActuator


def test_the_major_loop_spans_the_stroke_and_closes():
    truth = PlayActuator(noise=0)
    y = truth.drive(excite.raised_cosine(truth.highest, cycles=3).voltage)
    loop = y[400:]
    assert loop.min() == pytest.approx(0, abs=1e-12)
    assert loop.max() == pytest.approx(truth.stroke, rel=1e-9)
    np.testing.assert_allclose(y[400:800], y[800:1200], atol=1e-15)


def test_descending_lies_above_ascending_and_the_loop_is_not_antisymmetric():
    truth = PlayActuator(noise=0)
    y = truth.drive(excite.raised_cosine(truth.highest, cycles=2).voltage)[400:]
    up, down = y[1:200], y[201:400][::-1]
    assert np.all(down[5:-5] > up[5:-5])
    middle = 0.5 * (up + down) - 0.5 * truth.stroke
    assert np.abs(middle + middle[::-1]).max() > 0.01 * truth.stroke


def test_noise_is_seeded_and_of_the_stated_size():
    one, two = PlayActuator(seed=3), PlayActuator(seed=3)
    voltage = excite.raised_cosine(150.0, cycles=2).voltage
    first = one.drive(voltage)
    np.testing.assert_array_equal(first, two.drive(voltage))
    clean = PlayActuator(noise=0).drive(voltage)
    assert np.std(first - clean) == pytest.approx(2e-9, rel=0.1)


def test_a_map_that_falls_is_refused():
    with pytest.raises(dehyst.ModelError, match="the map must increase"):
        PlayActuator(asymmetry=2.0)
