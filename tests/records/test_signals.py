"""Noise and turns of long signals."""

import numpy as np
import pytest

from dehyst.records import signals


def test_what_a_long_signal_tells_is_told_from_parts_of_it(monkeypatch):
    rng = np.random.default_rng(0)
    values = np.sin(np.arange(40_000) / 300) + 1e-3 * rng.normal(size=40_000)
    noise = signals.white_noise(values)
    monkeypatch.setattr(signals, "_STRETCH", 1000)
    assert signals.white_noise(values) == pytest.approx(noise, rel=0.05)
    assert signals.white_noise(values) != noise
    assert len(signals.turning_points(values, 0.1)) == round(40_000 / 300 / np.pi)
