"""Checks of a model: patterns in its residuals, and their causes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._text import digits
from dehyst._types import Array
from dehyst.identification.results import Check, Trace, Verdict, may_creep
from dehyst.model import segment_of
from dehyst.records import rms, turning_points, white_noise

_OF_STROKE, _A_DECADE = "% of the stroke", "% a decade"
# Number of places along the stroke; least number of branches, at a place or in a record, to estimate their scatter.
_PLACES, _FEWEST = 12, 3
# Probability that noise alone exceeds the floor of a check; least pattern that a record resolves [%].
_RISK, _SMALLEST = 0.05, 0.1
_OTHER_WIDTH = "the loops of the model have another width there"
_OTHER_MIDDLE = "the spring or the transformer bends more there than its knots allow"
# Meaning or remedy of a failed check, by its name; the promise names the loops that would help.
REMEDIES = {
    "Width": "the loops of the model are wider or narrower than the loops of the records",
    "Middle line": "record slower loops over the whole range, and check that sensor and load do not change",
    "No drift": "let the actuator warm up, or record holds of a minute",
}
# Causes and remedies, by attribute of `RemainingError`.
_CAUSES = {
    "noise": ("white noise", "A quieter sensor or averaged cycles reduce it; a better model does not."),
    "slow": (
        "drift or another slow cause",
        "Let the actuator warm up, record at a constant temperature, or zero the sensor in time.",
    ),
    "vibration": ("a vibration", "Isolate the stage, or close the loop: no model of the voltage can predict it."),
    "model": ("the model", "Other loops may reduce it, if dehyst insight names some."),
}
# A spectral line is a vibration if it has this part of the residual's power and this ratio to its neighbours. It
# belongs to the voltage if the voltage has more than this power there, relative to the strongest line of the voltage.
_LINE_POWER, _LINE_HEIGHT, _DRIVEN = 0.05, 20.0, 1e-4
# A voltage is periodic if one line holds this part of its power, and it has at least this number of cycles.
_PERIODIC, _FEWEST_PERIODS = 0.5, 6
# Number of neighbours that a line is compared with; error of the frequency of a line, in steps of the spectrum.
_NEIGHBOURS, _APART = 20, 0.15


def residual_checks(traces: Sequence[Trace], stroke: float) -> tuple[Check, ...]:
    """Test the residuals of training records.

    If a model follows its records, the residuals do not differ between rising and falling branches, along the stroke,
    or in time.

    `traces`: as in `Fit`. `stroke`: range of the widest training loop [m].

    Returns
    -------
    tuple of Check
        Width, Middle line, No drift.
    """
    training = [trace.counted for trace in traces if trace.role == "training"]
    return *_patterns(training, stroke), _no_drift(training, stroke)


def _patterns(training: Sequence[Trace], stroke: float) -> list[Check]:
    """Test at every place that the mean residuals of rising and falling branches neither differ nor shift together."""
    from scipy.special import stdtrit

    settled = [trace.settled for trace in training]
    low, high = min(trace.simulated.min() for trace in settled), max(trace.simulated.max() for trace in settled)
    edges = np.linspace(low, high, _PLACES + 1)
    # Mean residuals at the places (K,) [% of the stroke], one row for each branch.
    falling, rising = list[Array](), list[Array]()
    for trace in settled:
        place = segment_of(edges, trace.simulated)
        for branch in _branches(trace):
            count = np.bincount(place[branch], minlength=_PLACES)
            total = np.bincount(place[branch], 100 * trace.residual[branch] / stroke, _PLACES)
            ends = trace.voltage[branch][[0, -1]]
            (rising if ends[1] > ends[0] else falling).append(np.where(count, total / np.maximum(count, 1), np.nan))
    usual = 100 * rms(np.concatenate([trace.residual for trace in settled])) / stroke
    (up, up_error, rises), (down, down_error, falls) = (_averaged(rows, usual) for rows in (rising, falling))
    passed = (rises > 0) & (falls > 0)
    if not passed.any():
        unpassed = "No branches of both directions pass the same place."
        return [Check(name, Verdict.UNKNOWN, None, None, _OF_STROKE, unpassed) for name in ("Width", "Middle line")]
    # The scatter of few branches is uncertain: the floor is Student's quantile, for the worst of all places.
    free = np.maximum(np.minimum(rises, falls), _FEWEST) - 1
    floors = 0.5 * stdtrit(free, 1 - _RISK / (2 * _PLACES)) * np.hypot(up_error, down_error)

    found = []
    for name, distance, words, why in (
        ("Width", up - down, "Half of the distance between rising and falling residuals", _OTHER_WIDTH),
        ("Middle line", up + down, "The middle of rising and falling residuals", _OTHER_MIDDLE),
    ):
        values = 0.5 * np.abs(distance)
        k = int(np.argmax(np.where(passed, values / np.maximum(floors, _SMALLEST), -1.0)))
        at = 0.5e6 * float(edges[k] + edges[k + 1])
        sentence = f"{words} is up to {digits(values[k])} % of the stroke, most at {at:.4g} um"
        found.append(_tested(name, float(values[k]), float(floors[k]), sentence, why))
    return found


def _no_drift(training: Sequence[Trace], stroke: float) -> Check:
    """Test the slope of the mean residuals of branches over the logarithm of the time since the start of a record."""
    from scipy.special import stdtrit

    drifts = []
    for whole in training:
        trace = whole.settled
        branches = _branches(trace)
        free = len(branches) - 2
        if free < _FEWEST - 1:
            continue
        time = np.array([float(trace.time[branch].mean()) for branch in branches]) - whole.time[0]
        means = np.array([100 * float(trace.residual[branch].mean()) / stroke for branch in branches])
        decades = np.log10(np.maximum(time, time[time > 0].min()))
        x, y, passed = decades - decades.mean(), means - means.mean(), float(np.ptp(decades))
        slope = float(x @ y / (x @ x))
        scatter = sqrt(float(np.sum((y - slope * x) ** 2)) / free / float(x @ x))
        value, floor = abs(slope), float(stdtrit(free, 1 - _RISK / (2 * len(training)))) * scatter
        unit = _A_DECADE
        if not may_creep(value, passed):
            value, floor, unit = value * passed, floor * passed, _OF_STROKE
        drifts.append((value / max(floor, _SMALLEST), value, floor, unit, trace.record))
    if not drifts:
        few = "No record has enough branches to determine a drift."
        return Check("No drift", Verdict.UNKNOWN, None, None, _A_DECADE, few)
    _, value, floor, unit, record = max(drifts)
    why = "the actuator has slower creep than the model, or its surroundings change"
    return _tested("No drift", value, floor, f"{record}: the residual drifts by {digits(value)} {unit}", why, unit)


def _branches(trace: Trace) -> list[slice]:
    """Return the branches of a record, between turning points of its voltage."""
    turns = turning_points(trace.voltage, 0.02 * float(np.ptp(trace.voltage)))
    ends = np.unique([0, *turns, trace.voltage.size]).tolist()
    return [slice(start, stop) for start, stop in pairwise(ends) if stop - start > 1]


def _averaged(rows: Sequence[Array], usual: float) -> tuple[Array, Array, NDArray[np.intp]]:
    """Return mean, standard error and number of the values of all rows at each place (K,); NaN is left out.

    `usual`: standard deviation of a value at places with too few values.
    """
    values = np.ma.masked_invalid(np.reshape(rows, (-1, _PLACES)))
    count = values.count(axis=0)
    deviation = np.where(count < _FEWEST, usual, values.std(axis=0, ddof=1).filled(usual))
    return values.mean(axis=0).filled(0.0), deviation / np.sqrt(np.maximum(count, 1)), count


def _tested(name: str, value: float, floor: float, sentence: str, why: str, unit: str = _OF_STROKE) -> Check:
    """Return a check that holds up to its floor, or up to the least pattern; `why` is the cause if it fails."""
    if value > max(floor, _SMALLEST):
        return Check(name, Verdict.FAILS, value, floor, unit, f"{sentence}: {why}.")
    cause = "has no effect" if value <= _SMALLEST else "scatter explains"
    return Check(name, Verdict.HOLDS, value, floor, unit, f"{sentence}, which {cause}.")


@dataclass(frozen=True)
class RemainingError:
    """Sources of a record's error, as shares of the power of its residual.

    Attributes
    ----------
    record, role : str
    rms : float
        RMS of the residual without its mean [m].
    noise, slow, vibration, model : float
        Shares of white noise, of drift and other slow causes, of vibration (a spectral line that the voltage does not
        have), and of the model.
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
        """RMS of the sensor error: white noise and vibration [m]."""
        return self.rms * float(np.sqrt(self.noise + self.vibration))

    def sentence(self, stroke: float) -> str:
        """Return record and shares as text, lengths as parts of `stroke` [m], and a remedy for the largest share."""
        shares = {name: float(getattr(self, name)) for name in _CAUSES}
        largest_first = sorted(shares, key=lambda name: -shares[name])
        parts = [f"{100 * shares[name]:.0f} % {_CAUSES[name][0]}" for name in largest_first if shares[name]]
        line = ""
        if self.vibration:
            size = 100 * self.vibration_amplitude / stroke
            line = f" The vibration has {self.frequency:.3g} Hz and {digits(size)} % of the stroke."
        text = f"{', '.join(parts) or 'none'}.{line} {_CAUSES[largest_first[0]][1]}"
        return f"{self.record}: power of the remaining error: {text}"

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


def remaining_error(trace: Trace) -> RemainingError:
    """Split the mean square of a record's residual.

    White noise differs from sample to sample. The slow part remains in means over a cycle: drift, temperature, creep
    that the model lacks. A line that the voltage does not have is a vibration. The rest repeats with the voltage: it is
    the error of the model.
    """
    trace, residual = trace.counted, trace.counted.residual - trace.counted.residual.mean()
    total, size = float(np.mean(residual**2)), rms(residual)
    if residual.size < 64 or not total:
        return RemainingError(trace.record, trace.role, size, 0.0, 0.0, 0.0, 0.0, 0.0)
    white = min(white_noise(trace.residual) ** 2, total)
    slow = _slow(trace, residual)
    fast = residual - slow
    frequency, line = _vibration(trace, fast)
    drifting = float(np.mean(slow**2))
    model = max(total - white - drifting - line, 0.0)
    # The estimated parts may have a larger sum than the whole.
    scale = total / max(white + drifting + line + model, total)
    noise, drift, vibration, rest = (part * scale / total for part in (white, drifting, line, model))
    return RemainingError(trace.record, trace.role, size, noise, drift, vibration, rest, frequency)


def _slow(trace: Trace, residual: Array) -> Array:
    """Return the means of a residual over a cycle of the voltage (n,)."""
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
    # Find the sine near this line that explains most of the residual.
    time = np.arange(residual.size) * step
    frequencies = k / (step * residual.size) + np.linspace(-1, 1, 21) / time[-1]
    sizes = [2 * abs(np.mean(residual * np.exp(-2j * np.pi * f * time))) for f in frequencies]
    best = int(np.argmax(sizes))
    return float(frequencies[best]), 0.5 * float(sizes[best]) ** 2


def _harmonic(drive: Array, k: int) -> bool:
    """Return whether line k is a harmonic of the strongest line of the voltage: hysteresis makes harmonics."""
    first = int(np.argmax(drive[1:])) + 1
    lines = np.arange(max(first - 2, 1), min(first + 3, drive.size))
    own = drive[lines]
    if first < _FEWEST_PERIODS or float(own.sum()) < _PERIODIC * float(drive[1:].sum()):
        return False
    middle = float(lines @ own / own.sum())
    multiple = max(round(k / middle), 1)
    within = _APART * multiple + 1
    # With a tolerance above a quarter of the distance between harmonics, any line would count as a harmonic.
    return abs(k - multiple * middle) <= within <= middle / 4
