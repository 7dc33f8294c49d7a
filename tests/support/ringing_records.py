"""Records at 5 kHz that begin, end or are cut by voltage steps which ring, by truths that no model has.

Each truth is a virtual actuator before a resonance; the rest is at 100 V, and sines of 1 Hz go from 0 to 200 V.
"""

import numpy as np
from scipy.signal import cont2discrete, lfilter
from truths import PreisachActuator

import dehyst
from dehyst import Record
from dehyst.virtual import PlayActuator

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
