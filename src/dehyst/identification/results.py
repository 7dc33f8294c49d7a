"""The results of an identification: outcome, errors and traces of records, checks; files of traces."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import Enum
from math import isnan, nan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._io import PathLike, packed, reading_errors, write_atomically
from dehyst._text import counted, escaped
from dehyst._types import Array
from dehyst._validation import keep
from dehyst._views import tables
from dehyst._views.fields import json_values
from dehyst._views.lines import length
from dehyst.identification.rules import RULES
from dehyst.model import Actuator, State
from dehyst.records import turning_points, white_noise

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True)
class RecordErrors:
    """Measured minus simulated displacement of one `record`, where its state is known.

    `role` is training or validation. `samples` were compared. `left_out` samples were not compared.
    `largest_with_drift` [m] is the largest error with the drift included. `offset` [V] is the constant that was
    removed. `datum` [m] is the datum of the sensor.

    Attributes
    ----------
    largest, rms : float
        [m], with the reported drift of the record removed.
    rms_with_drift : float
        [m], with the drift included.
    stroke : float
        The range of the widest training loop [m], to which the percentages refer.
    drift : float
        Removed drift [m a decade of time since the record's start].
    decades : float
        Decades of that time that the used samples cover.
    steady : bool
        Whether the drift is in proportion to time; `drift` times `decades` is all of it.
    settled_largest, settled_rms : float
        Errors after the second turning point of the voltage [m], the largest one but for one sample in a thousand: the
        first rise from an unknown state, and single outliers, are set aside. Default: errors of all samples.
    starts : tuple of State
        The states on the model's axis from which the record was simulated, one for each of its pieces: at the first
        sample that was compared.
    """

    record: str
    role: str
    samples: int
    left_out: int
    largest: float
    rms: float
    largest_with_drift: float
    rms_with_drift: float
    stroke: float
    offset: float
    datum: float
    drift: float
    decades: float = 1.0
    steady: bool = False
    starts: tuple[State, ...] = field(default=(), compare=False)
    settled_largest: float = nan
    settled_rms: float = nan

    def __post_init__(self) -> None:
        if isnan(self.settled_rms):
            keep(self, settled_largest=self.largest, settled_rms=self.rms)

    def __repr__(self) -> str:
        errors = f"largest {self.largest_percent:.3g} %, RMS {self.rms_percent:.3g} %"
        return f"<RecordErrors '{escaped(self.record)}' ({self.role}): {errors}, {counted(self.samples, 'sample')}>"

    @property
    def drifted_percent(self) -> float:
        """Displacement by drift over the used samples, in % of the stroke."""
        return 100 * self.drift * self.decades / self.stroke

    @property
    def creeps(self) -> bool:
        """Whether the drift can be creep, so that its rate is reported."""
        return not self.steady and may_creep(100 * self.drift / self.stroke, self.decades)

    @property
    def largest_percent(self) -> float:
        """Largest error in % of the stroke."""
        return 100 * self.largest / self.stroke

    @property
    def rms_percent(self) -> float:
        """RMS error in % of the stroke."""
        return 100 * self.rms / self.stroke

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values, lengths in metres."""
        return {
            **json_values(self, "record role samples left_out largest_percent rms_percent largest_m=largest rms_m=rms"),
            "largest_with_drift_percent": 100 * self.largest_with_drift / self.stroke,
            "rms_with_drift_percent": 100 * self.rms_with_drift / self.stroke,
            **json_values(self, "offset_V=offset datum_m=datum"),
            "drift_percent": 100 * self.drift / self.stroke,
            **json_values(self, "drift_decades=decades drift_steady=steady starts"),
            **json_values(self, "settled_largest_m=settled_largest settled_rms_m=settled_rms"),
        }


def may_creep(rate: float, decades: float) -> bool:
    """Return whether a drift can be creep, by its rate [% of the stroke a decade] and the decades covered.

    Piezoelectric actuators creep by a few percent a decade; a larger drift has another cause. A rate from a small part
    of a decade is an extrapolation.
    """
    return abs(rate) <= RULES.most_creep and decades >= RULES.fewest_decades


@dataclass(frozen=True, eq=False)
class Trace:
    """A `record` and its simulation: `time` [s], acting `voltage` [V], displacements [m] on the model's axis.

    `role` is training or validation. `measured` and `simulated` are (n,) [m]. `began` is the time of the record's first
    sample [s], compared or not.
    """

    record: str
    role: str
    time: Array
    voltage: Array
    measured: Array
    simulated: Array
    began: float = float("inf")

    def __repr__(self) -> str:
        largest = float(np.abs(self.residual).max(initial=0.0))
        size = counted(self.time.size, "sample")
        return f"<Trace '{escaped(self.record)}' ({self.role}): {size}, largest residual {length(largest)}>"

    @property
    def residual(self) -> Array:
        """Measured minus simulated displacement (n,) [m]."""
        return self.measured - self.simulated

    @property
    def settled(self) -> Trace:
        """The trace from the second turning point of its voltage on, its first sample aside; all of it without one."""
        turns = turning_points(self.voltage, 0.02 * float(np.ptp(self.voltage)))
        later = turns[turns > 0]
        at = int(later[1]) if len(later) > 2 else 0
        kept = {name: getattr(self, name)[at:] for name in ("time", "voltage", "measured", "simulated")}
        return replace(self, **kept)

    def to_dataframe(self) -> DataFrame:
        """Return the columns time_s, voltage_V, measured_um and simulated_um as a pandas DataFrame.

        Raise `MissingExtraError` if pandas is not installed.
        """
        lengths = {"measured_um": self.measured * 1e6, "simulated_um": self.simulated * 1e6}
        columns = {"time_s": self.time, "voltage_V": self.voltage, **lengths}
        return tables.frame(columns, record=self.record, role=self.role)


# The model's part is located if it is the first share, and worth a better model if it is the second.
_NAMED, _WORTH = 0.1, 0.25
# By the first word of the largest part.
_REMEDIES = {
    "white": "A quieter sensor or averaged cycles would reduce it; a better model would not.",
    "drift": "Let the actuator warm up, record at a constant temperature, or zero the sensor in time.",
    "the": "More elements, grades or loops that turn elsewhere may reduce it.",
    "a": "Isolate the stage, or close the loop: no model of the voltage can follow it.",
}
# Lines around a vibration; the middle of one is known to this part of a step.
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
    means : tuple of float
        Mean residual, its slow part aside [m]: where the voltage rises, in the lowest, middle and highest third of the
        displacements, then where it falls. Empty without an error.
    """

    record: str
    role: str
    rms: float
    noise: float
    slow: float
    vibration: float
    model: float
    frequency: float
    means: tuple[float, ...] = ()

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
        parts = [(self.noise, "white noise"), (self.slow, "drift or another slow cause"), (self.model, "the model")]
        if self.vibration:
            size = f"{100 * self.vibration_amplitude / stroke:.2g} % of the stroke, which the voltage does not cause"
            parts.append((self.vibration, f"a vibration of {self.frequency:.3g} Hz, {size}"))
        parts.sort(reverse=True)
        shares = ", ".join(f"{100 * share:.0f} % {cause}" for share, cause in parts)
        remedy, place = _REMEDIES[parts[0][1].split()[0]], ""
        if self.noise == parts[0][0] and self.model > _WORTH:
            remedy = "A quieter sensor or averaged cycles would reduce it; a better model, its own part."
        if self.model >= _NAMED and self.means:
            worst = max(range(len(self.means)), key=lambda k: abs(self.means[k]))
            way, third = ("rising", "falling")[worst // 3], ("lowest", "middle", "highest")[worst % 3]
            mean = f"{100 * self.means[worst] / stroke:+.2g} % of the stroke"
            place = f" The model's part is largest where {way} in the {third} third: {mean} on average."
        return f"{shares}.{place} {remedy}"

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
    # Means where the voltage rises, then where it falls, by thirds of the displacements.
    y, change = trace.simulated, np.gradient(trace.voltage)
    third = np.clip((3 * (y - y.min()) / max(float(np.ptp(y)), 1e-300)).astype(int), 0, 2)
    places = [(change * way > 0) & (third == k) for way in (1, -1) for k in range(3)]
    means = tuple(float(fast[place].mean()) if place.any() else 0.0 for place in places)
    return RemainingError(trace.record, trace.role, size, noise, drift, vibration, rest, frequency, means)


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
    driven = float(drive[near].max()) > RULES.driven_line * float(drive[1:].max(initial=0.0)) or _harmonic(drive, k)
    if driven or share < RULES.line_power or not around.size or power[k] < RULES.line_height * float(np.median(around)):
        return 0.0, 0.0
    # The sine next to that line that holds most of the residual.
    time = np.arange(residual.size) * step
    frequencies = k / (step * residual.size) + np.linspace(-1, 1, 21) / time[-1]
    sizes = [2 * abs(np.mean(residual * np.exp(-2j * np.pi * f * time))) for f in frequencies]
    best = int(np.argmax(sizes))
    return float(frequencies[best]), 0.5 * float(sizes[best]) ** 2


def _harmonic(drive: Array, k: int) -> bool:
    """Whether line k is a multiple of the one that holds most of the voltage: hysteresis makes those."""
    first = int(np.argmax(drive[1:])) + 1
    lines = np.arange(max(first - 2, 1), min(first + 3, drive.size))
    own = drive[lines]
    if first < RULES.fewest_periods or float(own.sum()) < RULES.periodic * float(drive[1:].sum()):
        return False
    middle = float(lines @ own / own.sum())
    multiple = max(round(k / middle), 1)
    within = _APART * multiple + 1
    # Beyond a quarter of the distance between multiples, any line would count as one.
    return abs(k - multiple * middle) <= within <= middle / 4


class Verdict(Enum):
    """Whether an assumption of a model holds; the value is the word to show."""

    HOLDS = "holds"
    FAILS = "does not hold"
    UNKNOWN = "not known"


@dataclass(frozen=True)
class Check:
    """An assumption of a model, tested on the records.

    Attributes
    ----------
    name : str
        The assumption: "Assumption I", "Anti-symmetry", ...
    verdict : Verdict
    value, floor : float or None
        The measured value, and the largest value due to noise alone (for Assumption I the least allowed value); None if
        there is no such number.
    unit : str
        Unit of both.
    sentence : str
        The finding and its meaning.
    """

    name: str
    verdict: Verdict
    value: float | None
    floor: float | None
    unit: str
    sentence: str

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {**asdict(self), "verdict": self.verdict.name}


# Name of the first array of traces.
_HEADS = "dehyst-output"
_COLUMNS = {"time_s": "time", "voltage_V": "voltage", "measured_m": "measured", "simulated_m": "simulated"}


@dataclass(frozen=True)
class HeldOutHolds:
    """RMS errors [m] of the drift in held-out holds of the voltage, by form of creep; see `held_out.held_out_holds`.

    `without`: of a model without creep. `force`: with creep as a force parallel to the elements. `displacement`: with
    creep in displacement, behind them.
    """

    without: float
    force: float
    displacement: float

    @property
    def in_displacement(self) -> bool:
        """Whether creep in displacement predicts held-out holds, and creep as a force not much better."""
        predicts = self.displacement < RULES.hold_gain * self.without
        return predicts and RULES.force_gain * self.displacement < self.force

    def as_dict(self) -> dict[str, float]:
        """Return JSON values [m]."""
        return {f"{name}_m": error for name, error in asdict(self).items()}

    def sentence(self, actuator: Actuator) -> str:
        """Return a sentence on the form of creep of an `actuator`, and on the remaining drift with each form."""
        force, behind = (100 * error / self.without for error in (self.force, self.displacement))
        forms = {"as a force": (actuator.creep, force), "in displacement": (actuator.displacement_creep, behind)}
        others = [f"{left:.0f} % {form}" for form, (part, left) in forms.items() if part is None]
        for form, (part, left) in forms.items():
            if part is not None:
                first, last = part.time_constants[[0, -1]].tolist()
                spread = f"{len(part)} time constants from {first:.3g} to {last:.4g} s"
                return f"Creep: {form}, {spread}; of the drift in held-out holds {left:.0f} % is left ({others[0]})."
        return f"Creep: none; of the drift in held-out holds {others[0]} and {others[1]} would be left."


def write_traces(path: PathLike, traces: Sequence[Trace]) -> None:
    """Write `traces` to a `path` that ends in .npz.

    It has the arrays time_s_1, voltage_V_1, measured_m_1 and simulated_m_1 of the first record, and so on; the array
    "dehyst-output" is JSON in bytes: name, role and first time [s] of each.

    Raise `FileFormatError` if the suffix is not .npz, or the file cannot be written.
    """
    if Path(path).suffix.lower() != ".npz":
        raise FileFormatError(f"{path}: traces are written as a NumPy archive; give a name that ends in .npz")
    heads = [{"record": one.record, "role": one.role, "first_s": min(one.began, *one.time[:1])} for one in traces]
    arrays = {_HEADS: np.frombuffer(json.dumps(heads).encode(), dtype=np.uint8)}
    for k, one in enumerate(traces, 1):
        arrays |= {f"{column}_{k}": getattr(one, name) for column, name in _COLUMNS.items()}
    write_atomically(path, packed(arrays))


def read_traces(path: PathLike) -> Iterator[Trace]:
    """Yield the traces that `write_traces` wrote to a `path`, one at a time.

    Raise `FileFormatError` if the file cannot be read, or holds no traces.
    """
    with reading_errors(Path(path), ".npz"), np.load(path, allow_pickle=False) as archive:
        if _HEADS not in archive:
            raise FileFormatError(f"{path}: holds no traces; write them with dehyst identify --traces")
        heads: list[dict[str, Any]] = json.loads(archive[_HEADS].tobytes())
        for k, head in enumerate(heads, 1):
            columns = {name: archive[f"{column}_{k}"] for column, name in _COLUMNS.items()}
            yield Trace(head["record"], head["role"], **columns, began=float(head["first_s"]))
