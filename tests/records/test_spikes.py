"""Spikes of a sensor's displacement, beside what only looks like them."""

import numpy as np
import pytest

from dehyst.records.glitches import spikes

N = 4000
TIME = np.arange(N) * 1e-3


def triangle(frequency=2.0):
    phase = TIME * frequency % 1
    return 100 * (1 - np.abs(2 * phase - 1))


def test_spikes_of_one_to_three_samples_are_found_and_nothing_else():
    rng = np.random.default_rng(1)
    v = triangle()
    y = 1e-7 * v + 2e-8 * rng.normal(size=N)
    expected = np.zeros(N, dtype=bool)
    for start, size, height in [(100, 1, 1e-6), (777, 2, -2e-6), (1500, 3, 1e-6), (1508, 1, -8e-7), (3000, 1, 9e-7)]:
        y[start : start + size] += height
        expected[start : start + size] = True
    np.testing.assert_array_equal(spikes(v, y), expected)


@pytest.mark.parametrize(
    "displacement",
    [
        pytest.param(lambda: 1e-7 * triangle(40.0), id="corners"),
        pytest.param(lambda: 1e-5 * (np.floor(TIME / 0.2) % 3), id="steps"),
        pytest.param(
            lambda: 1e-5 * (1 - np.exp(-20 * (TIME % 0.5)) * np.cos(2 * np.pi * 180 * (TIME % 0.5))), id="ringing"
        ),
        pytest.param(lambda: 1e-6 * np.random.default_rng(0).normal(size=N), id="noise"),
        pytest.param(lambda: np.zeros(N), id="nothing"),
    ],
)
def test_what_moves_has_no_spikes(displacement):
    assert not spikes(triangle(), displacement()).any()


def test_what_the_voltage_does_is_no_spike():
    v = triangle()
    v[1000:1002] += 40
    y = 1e-7 * v
    assert not spikes(v, y).any()
    assert spikes(triangle(), y)[1000:1002].all()


def test_too_many_are_no_spikes():
    v, y = triangle(), 1e-7 * triangle()
    y[::9] += 2e-6
    assert not spikes(v, y).any()
