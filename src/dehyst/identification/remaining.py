"""The remaining error of a record: the power of its residual, by its causes."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from dehyst._types import Array
from dehyst.identification.results import Trace
from dehyst.records import turning_points, white_noise

# Causes and remedies, by attribute of `RemainingError`.
_CAUSES = {
    "noise": ("white noise", "A quieter sensor or averaged cycles reduce it; a better model does not."),
    "slow": (
        "drift or another slow cause",
        "Let the actuator warm up, record at a constant temperature, or zero the sensor in time.",
    ),
    "vibration": ("a vibration", "Isolate the stage, or close the loop: no model of the voltage can follow it."),
    "model": ("the model", "Loops that turn elsewhere may reduce it."),
}
# A line of the residual with this part of its power, so much higher than its neighbours, is a vibration; one that has
# more power than this, relative to the voltage's strongest line, belongs to the voltage.
_LINE_POWER, _LINE_HEIGHT, _DRIVEN = 0.05, 20.0, 1e-4
# A voltage is periodic if one line holds this part of its power, in as many cycles at least.
_PERIODIC, _FEWEST_PERIODS = 0.5, 6
# Number of lines around a vibration to compare with; error of a line's middle, in steps of the frequency.
_NEIGHBOURS, _APART = 20, 0.15


@dataclass(frozen=True)
class RemainingError:
    """Sources of a record's error, as shares of the power of its residual.

    Attributes
    ----------
    record, role : str
    rms : float
        RMS of the residual without its mean [m].
    noise, slow, vibration, model : float
        Shares of white noise, of drift and other slow causes, of vibration (a line not in the voltage), and of the
        model.
    frequency : float
        Frequency of the vibration [Hz]; 0 without one.
    """

    record: str
    role: str
    rms: float
    noise: float
    slow: float
    vibration: float
    model: float
    frequency: float

    @property
    def vibration_amplitude(self) -> float:
        """Amplitude of the line [m]."""
        return self.rms * float(np.sqrt(2 * self.vibration))

    @property
    def sensed(self) -> float:
        """RMS of the sensor's part: white noise and vibration [m]."""
        return self.rms * float(np.sqrt(self.noise + self.vibration))

    def sentence(self, stroke: float) -> str:
        """Return the record and its `causes`; lengths are parts of `stroke` [m]."""
        return f"{self.record}: of the remaining error's power, {self.causes(stroke)}"

    def causes(self, stroke: float) -> str:
        """Return the shares as text, with lengths as parts of `stroke` [m], and a remedy for the largest share."""
        shares = {name: float(getattr(self, name)) for name in _CAUSES}
        largest_first = sorted(shares, key=lambda name: -shares[name])
        parts = [f"{100 * shares[name]:.0f} % {_CAUSES[name][0]}" for name in largest_first if shares[name]]
        line = ""
        if self.vibration:
            size = 100 * self.vibration_amplitude / stroke
            line = f" The vibration has {self.frequency:.3g} Hz and {size:.2g} % of the stroke."
        return f"{', '.join(parts) or 'none'}.{line} {_CAUSES[largest_first[0]][1]}"

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


def remaining_error(trace: Trace) -> RemainingError:
    """Split the mean square of a record's residual.

    White noise differs from sample to sample. The slow part remains in means over a cycle: drift, temperature, creep
    that the model lacks. A line that is not in the voltage is a vibration. The rest repeats with the voltage: it is the
    model's own error.
    """
    residual = trace.residual - trace.residual.mean()
    total = float(np.mean(residual**2))
    size = float(np.sqrt(total))
    if residual.size < 64 or not total:
        return RemainingError(trace.record, trace.role, size, 0.0, 0.0, 0.0, 0.0, 0.0)
    white = min(white_noise(trace.residual) ** 2, total)
    slow = _slow(trace, residual)
    fast = residual - slow
    frequency, line = _vibration(trace, fast)
    drifting = float(np.mean(slow**2))
    model = max(total - white - drifting - line, 0.0)
    # Estimates of parts may add up to more than the whole.
    scale = total / max(white + drifting + line + model, total)
    noise, drift, vibration, rest = (part * scale / total for part in (white, drifting, line, model))
    return RemainingError(trace.record, trace.role, size, noise, drift, vibration, rest, frequency)


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
    step, window = float(np.median(np.diff(trace.time))), np.hanning(residual.size)
    power = np.abs(np.fft.rfft(residual * window)) ** 2
    drive = np.abs(np.fft.rfft((trace.voltage - trace.voltage.mean()) * window)) ** 2
    k = int(np.argmax(power[2:])) + 2
    near = slice(max(k - 2, 1), k + 3)
    around = np.concatenate([power[max(k - _NEIGHBOURS, 1) : near.start], power[near.stop : k + _NEIGHBOURS]])
    share = float(power[near].sum()) / max(float(power[1:].sum()), 1e-300)
    driven = float(drive[near].max()) > _DRIVEN * float(drive[1:].max(initial=0.0)) or _harmonic(drive, k)
    if driven or share < _LINE_POWER or not around.size or power[k] < _LINE_HEIGHT * float(np.median(around)):
        return 0.0, 0.0
    # The sine next to that line that holds most of the residual.
    time = np.arange(residual.size) * step
    frequencies = k / (step * residual.size) + np.linspace(-1, 1, 21) / time[-1]
    sizes = [2 * abs(np.mean(residual * np.exp(-2j * np.pi * f * time))) for f in frequencies]
    best = int(np.argmax(sizes))
    return float(frequencies[best]), 0.5 * float(sizes[best]) ** 2


def _harmonic(drive: Array, k: int) -> bool:
    """Return whether line k is a multiple of the voltage's strongest line, as hysteresis makes them."""
    first = int(np.argmax(drive[1:])) + 1
    lines = np.arange(max(first - 2, 1), min(first + 3, drive.size))
    own = drive[lines]
    if first < _FEWEST_PERIODS or float(own.sum()) < _PERIODIC * float(drive[1:].sum()):
        return False
    middle = float(lines @ own / own.sum())
    multiple = max(round(k / middle), 1)
    within = _APART * multiple + 1
    # Beyond a quarter of the distance between multiples, any line would count as one.
    return abs(k - multiple * middle) <= within <= middle / 4
