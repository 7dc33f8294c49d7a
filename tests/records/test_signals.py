"""Noise, turns and interpolation of signals that are worked through in parts."""

import numpy as np
import pytest

from dehyst.records import signals


def test_interpolation_in_blocks_is_interpolation(monkeypatch):
    rng = np.random.default_rng(0)
    x = np.cumsum(rng.uniform(0.5, 1.5, 3000))
    y, asked = np.cumsum(rng.normal(size=3000)), np.clip(x - 7.3, x[0], x[-1])
    one = signals.interpolate(x, y, asked, "pchip")
    monkeypatch.setattr(signals, "_BLOCK", 64)
    np.testing.assert_allclose(signals.interpolate(x, y, asked, "pchip"), one, rtol=1e-12, atol=1e-12)


def test_what_a_long_signal_tells_is_told_from_parts_of_it(monkeypatch):
    rng = np.random.default_rng(0)
    values = np.sin(np.arange(40_000) / 300) + 1e-3 * rng.normal(size=40_000)
    noise, turns = signals.white_noise(values), signals.turning_points(values, 0.1)
    monkeypatch.setattr(signals, "_STRETCH", 1000)
    monkeypatch.setattr(signals, "_BLOCK", 97)
    assert signals.white_noise(values) == pytest.approx(noise, rel=0.05)
    assert signals.white_noise(values) != noise
    np.testing.assert_array_equal(signals.turning_points(values, 0.1), turns)
    assert len(turns) == round(40_000 / 300 / np.pi)
