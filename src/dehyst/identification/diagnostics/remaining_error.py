"""Where the remaining error comes from: the power of a residual, by cause."""

from __future__ import annotations

import numpy as np

from dehyst._types import Array
from dehyst.model import RemainingError, Trace
from dehyst.records.signals import turning_points, white_noise

# A line of the spectrum counts if it holds this part of the power, and this many times its neighbours'.
_LINE, _ABOVE = 0.05, 20.0
# A voltage has energy at a frequency if it holds this part of that of its strongest line there.
_DRIVEN = 1e-4
_NEIGHBOURS = 20
# A voltage is periodic if one line holds this part of its power, so many cycles from the lowest.
_MOSTLY, _FEWEST_CYCLES = 0.5, 6
# The middle of a line is known to this part of a step.
_APART = 0.15


def remaining_error(trace: Trace) -> RemainingError:
    """Split the mean square of a record's residual.

    White noise is what differs from one sample to the next. Slow is what remains in means over a cycle: drift,
    temperature, creep that the model lacks. A line that the voltage does not have is a vibration. The rest repeats
    with the voltage: the model's own error.
    """
    residual = trace.residual - trace.residual.mean()
    total = float(np.mean(residual**2))
    if residual.size < 64 or not total:
        return RemainingError(trace.record, trace.role, float(np.sqrt(total)), 0.0, 0.0, 0.0, 0.0, 0.0)
    white = min(white_noise(trace.residual) ** 2, total)
    slow = _slow(trace, residual)
    fast = residual - slow
    frequency, line = _vibration(trace, fast)
    drifting = float(np.mean(slow**2))
    model = max(total - white - drifting - line, 0.0)
    # Estimates of parts may add up to more than the whole.
    scale = total / max(white + drifting + line + model, total)
    noise, drift, vibration, rest = (part * scale / total for part in (white, drifting, line, model))
    means = _means(trace, fast)
    return RemainingError(
        trace.record, trace.role, float(np.sqrt(total)), noise, drift, vibration, rest, frequency, means
    )


def _means(trace: Trace, residual: Array) -> tuple[float, ...]:
    """Return the mean residual by thirds of the displacements, where the voltage rises, then where it falls."""
    y = trace.simulated
    third = np.clip((3 * (y - y.min()) / max(float(np.ptp(y)), 1e-300)).astype(int), 0, 2)
    change = np.gradient(trace.voltage)
    places = [(change * way > 0) & (third == k) for way in (1, -1) for k in range(3)]
    return tuple(float(residual[place].mean()) if place.any() else 0.0 for place in places)


def _slow(trace: Trace, residual: Array) -> Array:
    """Return means over a cycle of the voltage (n,)."""
    turns = turning_points(trace.voltage, 0.02 * float(np.ptp(trace.voltage)))
    cycle = max(int(2 * residual.size / max(len(turns), 2)), 2)
    if cycle >= residual.size:
        return np.zeros(residual.size)
    padded = np.pad(residual, (cycle // 2, cycle - 1 - cycle // 2), mode="reflect")
    sums = np.cumsum(np.append(0.0, padded))
    return np.asarray((sums[cycle:] - sums[:-cycle]) / cycle)


def _vibration(trace: Trace, residual: Array) -> tuple[float, float]:
    """Return frequency [Hz] and mean square [m2] of the strongest line that the voltage does not have; 0 if none."""
    step = float(np.median(np.diff(trace.time)))
    window = np.hanning(residual.size)
    power = np.abs(np.fft.rfft(residual * window)) ** 2
    drive = np.abs(np.fft.rfft((trace.voltage - trace.voltage.mean()) * window)) ** 2
    k = int(np.argmax(power[2:])) + 2
    near = slice(max(k - 2, 1), k + 3)
    around = np.concatenate([power[max(k - _NEIGHBOURS, 1) : near.start], power[near.stop : k + _NEIGHBOURS]])
    share = float(power[near].sum()) / max(float(power[1:].sum()), 1e-300)
    driven = float(drive[near].max()) > _DRIVEN * float(drive[1:].max(initial=0.0)) or _harmonic(drive, k)
    if driven or share < _LINE or not around.size or power[k] < _ABOVE * float(np.median(around)):
        return 0.0, 0.0
    frequency, amplitude = _line(residual, step, k / (step * residual.size))
    return frequency, 0.5 * amplitude**2


def _harmonic(drive: Array, k: int) -> bool:
    """Whether line k is a multiple of the one that holds most of the voltage: hysteresis makes those."""
    first = int(np.argmax(drive[1:])) + 1
    lines = np.arange(max(first - 2, 1), min(first + 3, drive.size))
    own = drive[lines]
    if first < _FEWEST_CYCLES or float(own.sum()) < _MOSTLY * float(drive[1:].sum()):
        return False
    middle = float(lines @ own / own.sum())
    multiple = max(round(k / middle), 1)
    within = _APART * multiple + 1
    # Beyond a quarter of the distance between multiples, any line would count as one.
    return abs(k - multiple * middle) <= within <= middle / 4


def _line(residual: Array, step: float, near: float) -> tuple[float, float]:
    """Return frequency [Hz] and amplitude [m] of the sine next to a frequency that holds most of a residual."""
    time = np.arange(residual.size) * step
    frequencies = near + np.linspace(-1, 1, 21) / time[-1]
    sizes = [2 * abs(np.mean(residual * np.exp(-2j * np.pi * f * time))) for f in frequencies]
    k = int(np.argmax(sizes))
    return float(frequencies[k]), float(sizes[k])
