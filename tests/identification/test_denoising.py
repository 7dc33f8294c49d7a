"""A measured path without the sensor's jitter: laws, and what jitter does to the elements that the path drags."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest
import structured_records as wide
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import savgol_filter

from dehyst import Record
from dehyst.identification.cleaning import disturbs, local_polynomials, monotone, remove_jitter
from dehyst.records.signals import turning_points
from dehyst.virtual import PlayActuator

SEEDS = st.integers(0, 2**32 - 1)
NOISE = 1e-3 * plain_records.STROKE


def made(seed, *, noise=0.0, samples=40, hold=0):
    """A record of random branches of the voltage, its displacement by play operators, and that without noise."""
    rng = np.random.default_rng(seed)
    v = plain_records.VOLTS / plain_records.STROKE * wide.wandering(12, int(rng.integers(1000)), samples, hold)
    truth = PlayActuator(noise=0.0, plays=300)
    y = truth.play(v)
    sensed = y + noise * rng.normal(size=y.size)
    return Record(np.arange(v.size) / 200.0, v, sensed, "made"), y


def branches(record):
    turns = turning_points(record.voltage, 0.01 * plain_records.VOLTS)
    return zip(np.append(0, turns), np.append(turns, len(record)), strict=True)


@given(seed=SEEDS, noise=st.floats(0, 0.05), hold=st.sampled_from([0, 20]))
@settings(max_examples=30)
def test_the_path_moves_in_the_direction_of_the_voltage(seed, noise, hold):
    record, _ = made(seed, noise=noise * plain_records.STROKE, hold=hold)
    smoothed = monotone(record)
    np.testing.assert_array_equal(smoothed.voltage, record.voltage)
    moved = np.diff(record.voltage) * np.diff(smoothed.displacement)
    # From one branch to the next, and to a hold, there is no order to keep.
    place = np.arange(moved.size) % (40 + hold)
    assert np.all(moved[(place > 2) & (place < 37)] >= 0)


@given(seed=SEEDS, noise=st.floats(0, 0.05))
@settings(max_examples=30)
def test_smoothing_keeps_the_mean_of_a_branch_and_increases_no_error(seed, noise):
    """Least squares over a convex cone: means stay, and no monotone path lies farther from the result than before."""
    record, true = made(seed, noise=noise * plain_records.STROKE)
    smoothed = monotone(record).displacement
    for a, b in branches(record):
        assert smoothed[a:b].mean() == pytest.approx(record.displacement[a:b].mean(), abs=1e-12 * plain_records.STROKE)
    before, after = (float(np.sum((y - true) ** 2)) for y in (record.displacement, smoothed))
    assert after <= before * (1 + 1e-9)


@given(seed=SEEDS, hold=st.sampled_from([0, 30]))
@settings(max_examples=20)
def test_without_noise_nothing_changes(seed, hold):
    record, true = made(seed, hold=hold)
    for smoothed in (monotone(record), remove_jitter(record, 0.0, plain_records.STROKE)):
        assert np.abs(smoothed.displacement - true).max() < 1e-12 * plain_records.STROKE


@pytest.mark.parametrize(("samples", "kept"), [(40, 17 / 35), (200, 25 / 143)])
def test_smoothing_reduces_jitter_without_bias(samples, kept):
    """A parabola through 5 neighbours keeps 17/35 of the variance, through 13 of them 25/143; order takes from that."""
    record, true = made(0, samples=samples)
    errors = []
    for seed in range(60):
        noisy = replace(record, displacement=true + NOISE * np.random.default_rng(seed).normal(size=true.size))
        errors.append(remove_jitter(noisy, NOISE, plain_records.STROKE).displacement - true)
    errors = np.array(errors) / NOISE
    bias, chance = errors.mean(axis=0), errors.std() / np.sqrt(len(errors))
    assert errors.std() < 1.05 * kept**0.5
    assert abs(bias.mean()) < 5 * chance / np.sqrt(true.size / samples)
    # Kinks, where a branch turns or an inner loop closes, are rounded off; all else is chance.
    assert np.abs(bias).max() < 0.5
    assert bias.std() < 1.25 * chance


@pytest.mark.parametrize(("samples", "width"), [(100, 7), (200, 13)])
def test_with_loud_noise_a_turn_is_the_mean_of_both_branches(samples, width):
    """The end of a parabola through w samples has 3 (3 w^2 - 3 w + 2) / (w (w + 1) (w + 2)) of their variance."""
    record, true = made(0, samples=samples)
    noise = 0.05 * plain_records.STROKE
    assert disturbs(noise, plain_records.STROKE)
    turns = turning_points(record.voltage, 0.01 * plain_records.VOLTS)
    errors = []
    for seed in range(20):
        noisy = replace(record, displacement=true + noise * np.random.default_rng(seed).normal(size=true.size))
        errors.append((remove_jitter(noisy, noise, plain_records.STROKE).displacement - true)[turns])
    kept = 3 * (3 * width**2 - 3 * width + 2) / (width * (width + 1) * (width + 2))
    assert np.std(errors) == pytest.approx(noise * (kept / 2) ** 0.5, rel=0.05)


def test_creep_in_a_hold_is_monotone():
    rng = np.random.default_rng(1)
    v = np.concatenate([np.linspace(0, 100, 50), np.full(200, 100.0), np.linspace(100, 0, 50), np.full(200, 0.0)])
    v = np.tile(v, 2)
    y = np.cumsum(np.diff(v, prepend=0.0)) * 1e-7
    for start, sign in ((50, 1), (300, -1), (550, 1), (800, -1)):
        y[start : start + 200] += sign * 2e-7 * np.log1p(np.arange(200) / 5)
        y[start + 200 :] += sign * 2e-7 * np.log1p(40)
    noisy = Record(np.arange(v.size) / 100.0, v, y + 3e-8 * rng.normal(size=y.size))
    smoothed = monotone(noisy).displacement
    for start, sign in ((50, 1), (300, -1), (550, 1), (800, -1)):
        # The hold is seen some samples after the voltage has come to rest.
        assert np.all(sign * np.diff(smoothed[start + 8 : start + 195]) >= 0)
        errors = [np.std((column - y)[start : start + 200]) for column in (smoothed, noisy.displacement)]
        assert errors[0] < 0.5 * errors[1]


def test_jitter_does_not_change_the_elongations_of_smooth_elements():
    """Where a sample moves no farther than jitter does, jitter pulls Dahl's elements back at every other one."""
    plant = wide.plant(wide.STRUCTURES["smooth"], path=wide.wandering(12, samples=400))
    record = plant.record(noise=NOISE)
    smooth = plant.actuator.smooth
    true = smooth.elongations(plant.path)
    kept = remove_jitter(record, NOISE, plain_records.STROKE).displacement
    shortest = smooth.length == smooth.length.min()
    errors = [
        np.std((smooth.elongations(y) - true)[:, shortest]) / np.std(true[:, shortest])
        for y in (record.displacement, kept)
    ]
    assert errors[0] > 0.1
    assert errors[1] < 0.2 * errors[0]


def test_a_short_piece_without_turns_is_smoothed():
    rising = Record(np.arange(6) / 10, np.arange(6.0), np.array([0, 1, 3, 2, 4, 5]) * 1e-6)
    np.testing.assert_allclose(monotone(rising).displacement, np.array([0, 1, 2.5, 2.5, 4, 5]) * 1e-6)
    np.testing.assert_allclose(remove_jitter(rising, 1e-6, 5e-6).displacement, np.array([0, 1, 2.5, 2.5, 4, 5]) * 1e-6)


@pytest.mark.parametrize(("samples", "window", "order", "derivative"), [(9, 9, 4, 1), (50, 9, 4, 2), (300, 25, 2, 0)])
def test_local_polynomials_are_those_of_savitzky_and_golay(samples, window, order, derivative):
    values = np.random.default_rng(0).normal(size=samples).cumsum()
    expected = savgol_filter(values, window, order, deriv=derivative, delta=0.3)
    np.testing.assert_allclose(local_polynomials(values, window, order, derivative, 0.3), expected, atol=1e-10)
