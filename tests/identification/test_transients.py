"""Records with rest, and with steps that ring: what does not count, and what is expected of the model."""

from itertools import product

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter
from truths import BoucWenActuator, PreisachActuator

import dehyst
from dehyst import Record
from dehyst.fleet import loop_width
from dehyst.identification.cleaning import cycle_time, rest_at_ends
from dehyst.identification.preparation import prepare
from dehyst.virtual import PlayActuator
from examples import at_night

RATE, MIDDLE, NOISE = 5000.0, 100.0, 20e-9
# The frequency [Hz] and the damping of the resonance of each.
TRUTHS = {
    "plays": (lambda: PlayActuator(plays=60, noise=0.0), 1000.0, 0.09),
    "relays": (lambda: PreisachActuator(noise=0.0), 400.0, 0.03),
}


def rung(y, frequency, damping):
    """Return displacements (n,) behind a resonance that rests at the first sample; y is linear between samples."""
    omega = 2 * np.pi * frequency
    plant = [omega**2], [1, 2 * damping * omega, omega**2]
    num, den, _ = cont2discrete(plant, 1 / RATE, "foh")
    return y[0] + lfilter(num.ravel(), den, y - y[0])


def sines(count, seed, before=MIDDLE):
    """Return voltages of cycles of 1 s and random heights, the first two of the full one, from `before`."""
    heights = np.append(np.ones(2), np.random.default_rng(seed).uniform(0.25, 1, count // int(RATE) + 1))
    levels = np.append(before, MIDDLE + MIDDLE * np.outer(heights, [1, -1]).ravel())
    half = np.arange(count) * 2 / RATE
    branch = half.astype(int)
    return levels[branch] + np.diff(levels)[branch] * (0.5 - 0.5 * np.cos(np.pi * (half - branch)))


def record_of(name, kind, samples, seed=1):
    """Return a record, and a new path of voltages after it with the displacements that it causes."""
    levels = {"step first": [MIDDLE], "step last": [], "staircase": [100, 140, 180, 150, 80, 20, 60, 100]}[kind]
    stairs = np.repeat(np.asarray(levels, float), round(0.33 * samples / max(len(levels), 1)))
    rest = np.full(round(0.33 * samples) if kind == "step last" else 0, MIDDLE)
    moving = sines(samples - stairs.size - rest.size, seed, MIDDLE - 58 * (kind == "step first"))
    voltage, path = np.concatenate([stairs, moving, rest]), sines(40_000, seed + 100)
    # It was in use before, at rest at the middle.
    used = np.concatenate([sines(10_000, 0), np.full(2000, MIDDLE)])
    make, *resonance = TRUTHS[name]
    y = rung(make().play(np.concatenate([used, voltage, path])), *resonance)[used.size :]
    noisy = y[: voltage.size] + np.random.default_rng(seed).normal(0, NOISE, voltage.size)
    return Record(np.arange(voltage.size) / RATE, voltage, noisy, f"{name}, {kind}"), path, y[voltage.size :]


def followed(name, kind, samples):
    """Identify one record; return the fit and the RMS error of a new path after it [% of the stroke]."""
    record, path, reached = record_of(name, kind, samples)
    fit = dehyst.identify(record)
    both = np.append(record.voltage, path)
    times = np.arange(both.size) / RATE
    acting = np.interp(times - fit.actuator.delay, times, both)
    moved = fit.actuator.simulate(acting, time=times, extrapolate=True).displacement[record.voltage.size :]
    # The first cycle leads both into the same loops; a constant is the sensor's zero.
    return fit, 100 * np.std((moved - reached)[round(RATE) :]) / fit.errors[0].stroke


@pytest.mark.parametrize(
    ("name", "kind"), [("plays", "step first"), at_night("relays", "step first"), at_night("relays", "step last")]
)
def test_the_promise_holds_beside_a_transient_which_is_named(name, kind):
    fit, rms = followed(name, kind, samples=30_000)
    error, expected = fit.errors[0], fit.promise
    assert any("left out" in sentence for sentence in fit.repairs)
    assert expected.largest_percent < 1.0
    assert rms < 2 * 100 * expected.rms / error.stroke
    # Rest counts neither as used nor as left out; what rings is left out.
    assert error.samples < 21_000
    assert 40 < error.left_out < 4000


def test_ringing_is_neither_fitted_nor_compared():
    record, _, _ = record_of("plays", "staircase", samples=20_000)
    prepared = prepare(record)
    aside = prepared.record.set_aside
    assert len(aside) >= 6
    fit = dehyst.identify(record, structure="maxwell_slip")
    for first, last in aside:
        assert not np.any((fit.traces[0].time >= first) & (fit.traces[0].time <= last))


def resting(seconds, creep=0.0):
    """A record at rest before and after three cycles of 1 s; the displacement creeps at the end."""
    time = np.arange(0, 3 + 2 * seconds, 0.002)
    since = np.clip(time - seconds, 0, 3)
    voltage = 50 - 50 * np.cos(2 * np.pi * since)
    y = PlayActuator(noise=0.0).play(voltage)
    y = y + creep * np.ptp(y) * np.log10(1 + np.clip(time - seconds - 3, 0, None) / 0.01)
    return Record(time, voltage, y + np.random.default_rng(1).normal(0, 1e-9, time.size))


def test_rest_before_and_after_the_motion_is_left_out():
    prepared, moving = prepare(resting(4.0)), prepare(resting(0.1))
    assert len(prepared.record) < 1.05 * len(moving.record)
    assert cycle_time(prepared.record) == pytest.approx(1.0, rel=0.02)
    assert prepared.samples == pytest.approx(moving.samples, rel=0.05)
    assert prepared.lead is not None
    assert len([sentence for sentence in prepared.sentences if "rest" in sentence]) == 2


def test_rest_in_which_the_displacement_creeps_stays():
    prepared = prepare(resting(4.0, creep=0.01))
    assert prepared.record.time[-1] == pytest.approx(11.0, abs=0.01)


def test_a_short_rest_changes_nothing():
    record = resting(0.1)
    assert rest_at_ends(record) == (0, len(record))


MAKES = {
    "plays": lambda: PlayActuator(plays=120, noise=0.0),
    "relays": lambda: PreisachActuator(noise=0.0),
    "bouc-wen": lambda: BoucWenActuator(noise=0.0),
}


@pytest.mark.parametrize(
    ("name", "noise", "shape"),
    [("plays", 0.01, "sine"), *(at_night(*each) for each in product([*MAKES], [0.01, 0.005], ["sine", "triangle"]))],
)
def test_noise_of_the_sensor_does_not_narrow_the_loop(name, noise, shape):
    part = np.arange(500) / 500
    cycle = 0.5 - 0.5 * np.cos(2 * np.pi * part) if shape == "sine" else 1 - np.abs(2 * part - 1)
    voltage = 200 * np.tile(cycle, 4)
    y = MAKES[name]().play(voltage, time=1e-3 * np.arange(voltage.size), measured=False)
    up, down = slice(500, 751), slice(750, 1001)
    true = np.interp(100, voltage[down][::-1], y[down][::-1]) - np.interp(100, voltage[up], y[up])
    noisy = y + np.random.default_rng(1).normal(0, noise * np.ptp(y), y.size)
    fit = dehyst.identify(Record(1e-3 * np.arange(y.size), voltage, noisy))
    assert loop_width(fit.actuator) == pytest.approx(true, rel=10 * noise)
