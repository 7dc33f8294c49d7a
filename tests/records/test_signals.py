"""Signals: noise and turns of long ones, and the speed of recorded voltages, whatever noise and steps do."""

import numpy as np
import pytest

from dehyst.records import recorded_slew_rate, signals

TIME = np.arange(8000) * 2.5e-3
TRIANGLE = 50 + 50 * (4 * np.abs((TIME / 4) % 1 - 0.5) - 1)
SINE = 50 + 50 * np.sin(2 * np.pi * TIME)
RNG = np.random.default_rng(3)


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.2])
@pytest.mark.parametrize(("voltage", "speed"), [(TRIANGLE, 50.0), (SINE, 100 * np.pi)])
def test_it_is_that_of_the_branches_whatever_the_noise(voltage, speed, noise):
    noisy = voltage + noise * RNG.normal(size=TIME.size)
    assert speed <= recorded_slew_rate([(TIME, noisy)]) <= 1.15 * speed


def test_a_coarse_converter_adds_no_speed():
    coarse = np.round(SINE / 100 * 255) * 100 / 255
    assert recorded_slew_rate([(TIME, coarse)]) == pytest.approx(100 * np.pi, rel=0.15)


def test_steps_and_glitches_do_not_count():
    voltage = TRIANGLE + 30.0 * (TIME > 1)
    voltage[[500, 2000, 2001]] -= 90
    voltage[4000:4006] = np.linspace(0, 100, 6)
    assert recorded_slew_rate([(TIME, voltage)]) == pytest.approx(52.5, rel=0.02)


def test_the_fastest_of_many_records_counts():
    assert recorded_slew_rate([(TIME, TRIANGLE), (TIME, SINE)]) == pytest.approx(100 * np.pi, rel=0.06)
    assert recorded_slew_rate([(2 * TIME, TRIANGLE), (10 * TIME, TRIANGLE)]) == pytest.approx(25, rel=0.06)


def test_ramps_between_rests_have_their_own_speed():
    ramps = np.interp(TIME, [0, 3, 3.1, 9, 9.1, 15, 15.1, 20], [0, 0, 30, 30, 60, 60, 90, 90])
    assert recorded_slew_rate([(TIME, ramps)]) == pytest.approx(300, rel=0.06)


@pytest.mark.parametrize("voltage", [np.where(TIME % 1 < 0.5, 0.0, 100.0), np.full(TIME.size, 3.0)])
def test_steps_and_rests_alone_tell_no_speed(voltage):
    assert recorded_slew_rate([(TIME, voltage)]) is None
    assert recorded_slew_rate([(TIME[:3], TRIANGLE[:3])]) is None
    assert recorded_slew_rate([]) is None


def test_what_a_long_signal_tells_is_told_from_parts_of_it(monkeypatch):
    rng = np.random.default_rng(0)
    values = np.sin(np.arange(40_000) / 300) + 1e-3 * rng.normal(size=40_000)
    noise = signals.white_noise(values)
    monkeypatch.setattr(signals, "_STRETCH", 1000)
    assert signals.white_noise(values) == pytest.approx(noise, rel=0.05)
    assert signals.white_noise(values) != noise
    assert len(signals.turning_points(values, 0.1)) == round(40_000 / 300 / np.pi)
