"""The virtual actuator: hysteretic, seeded, and no instance of the model."""

import numpy as np
import pytest

import dehyst
from dehyst import excite
from dehyst.truths import PlayActuator


def test_the_major_loop_spans_the_stroke_and_closes():
    truth = PlayActuator(noise=0)
    voltage = excite.raised_cosine([truth.highest] * 3)
    y = truth.drive(voltage)
    loop = y[400:]
    assert loop.min() == pytest.approx(0, abs=1e-12)
    assert loop.max() == pytest.approx(truth.stroke, rel=1e-9)
    np.testing.assert_allclose(y[400:800], y[800:], atol=1e-15)


def test_descending_lies_above_ascending_and_the_loop_is_not_antisymmetric():
    truth = PlayActuator(noise=0)
    y = truth.drive(excite.raised_cosine([truth.highest] * 2))[400:]
    up, down = y[:199], y[200:399][::-1]
    assert np.all(down[5:-5] > up[5:-5])
    middle = 0.5 * (up + down) - 0.5 * truth.stroke
    assert np.abs(middle + middle[::-1]).max() > 0.01 * truth.stroke


def test_noise_is_seeded_and_of_the_stated_size():
    one, two = PlayActuator(seed=3), PlayActuator(seed=3)
    voltage = excite.raised_cosine([150.0] * 2)
    first = one.drive(voltage)
    np.testing.assert_array_equal(first, two.drive(voltage))
    clean = PlayActuator(noise=0).drive(voltage)
    assert np.std(first - clean) == pytest.approx(2e-9, rel=0.1)


def test_a_map_that_falls_is_refused():
    with pytest.raises(dehyst.ModelError, match="the map must increase"):
        PlayActuator(asymmetry=2.0)


@pytest.mark.parametrize("peaks", [[], [0.0], [10.0, float("nan")], [-5.0]])
def test_impossible_peaks_are_refused(peaks):
    with pytest.raises(dehyst.RecordError, match="need voltages above the base"):
        excite.raised_cosine(peaks)


def test_excitations_touch_every_peak_and_return():
    voltage = excite.descending_tops(200.0, steps=4, base=10.0, samples=100)
    tops = voltage.reshape(4, 100)
    np.testing.assert_allclose(tops.max(axis=1), 10 + 190 * np.array([1, 0.75, 0.5, 0.25]))
    np.testing.assert_allclose(tops[:, -1], 10)
    with pytest.raises(dehyst.RecordError, match="need 8 at least"):
        excite.raised_cosine([1.0], samples=4)
