"""What is to be said of an identification: what the records do not tell, and what was repaired, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dehyst._types import Array
from dehyst.identification.diagnostics.identifiability import Identifiability
from dehyst.identification.dynamics_search import significant_delay
from dehyst.identification.preprocessing.preparation import Prepared
from dehyst.identification.preprocessing.regressors import epochs
from dehyst.identification.regression.coefficients import Coefficients
from dehyst.identification.regression.regression import Regression
from dehyst.model import Outcome, RecordErrors
from dehyst.model.fit import FEWEST_DECADES

# Below this many times the noise an element's stiffness comes out too small.
_LOUD = 30
# Less creep a decade than this part of the stroke is not worth a sentence.
_SMALLEST_DRIFT = 2e-4
# The outer part of the limits' range at each end, and the part of one passage of it, as a triangle's, that is enough.
_END, _PASSAGE = 0.1, 0.25
# Voltages may leave those of training by this part of their range, and errors be so many times those of training.
_MARGIN, _USUAL = 0.02, 2


def of_noise(first: float, noise: float) -> list[str]:
    """A remark where jitter, which only wider structures are spared, drags the first element, at `first` [m]."""
    if first >= _LOUD * noise:
        return []
    return [
        f"The first element lets go at {first * 1e6:.4g} um, {first / noise:.3g} times the sensor's noise; "
        f"below {_LOUD} times its stiffness comes out too small."
    ]


def of_turns(told: Identifiability) -> list[str]:
    """A remark where turning points leave some of a few plain elements open."""
    if told.determined == told.of:
        return []
    return [
        f"Wider structures were not tried: the turning points tell {told.determined} of {told.of} directions of "
        "ten plain elements. They need loops within loops; add minor loops with other turning points."
    ]


def of_plain(told: Identifiability, regression: Regression, found: Coefficients) -> tuple[Outcome, list[str]]:
    """How the identification of plain elements ended, and remarks about what stays open or lies on its floor."""
    said = []
    if told.determined < told.of:
        said.append(
            f"The records determine {told.determined} of {told.of} directions of the stiffnesses; minor loops with "
            "other turning points determine more (dehyst insight says which)."
        )
    still = int(np.count_nonzero(~regression.movable))
    if still > 1 or not regression.movable.any():
        said.append(
            f"{still} of {regression.movable.size} elements let go at half of the range or more: they never slide "
            "over all of it, are one with the spring, and got no stiffness."
        )
    low = np.flatnonzero(found.slopes <= regression.floor * (1 + 1e-6))
    if low.size:
        ends = regression.knots * 1e6
        places = ", ".join(f"{ends[j]:.4g} to {ends[j + 1]:.4g} um" for j in low[:4])
        said.append(f"The spring's slope lies on its floor at {places}{' and elsewhere' if low.size > 4 else ''}.")
    if told.determined < told.of:
        return Outcome.UNDETERMINED, said
    return (Outcome.FLOOR_ACTIVE if low.size else Outcome.IDENTIFIED), said


def of_rare_voltages(records: Sequence[Prepared], limits: tuple[float, float]) -> list[str]:
    """Remarks about an end of the limits [V] that the samples that count reach for less than a part of one cycle.

    Tops that descend pass the end in one cycle only, and in all of it: that is enough.
    """
    low, high = limits
    width = _END * (high - low)
    counted = [(_counted(item), _samples_a_cycle(item)) for item in records]
    total, said = sum(v.size for v, _ in counted), []
    for end, inward, words in ((high, -1, ("above", "highest")), (low, 1, ("below", "lowest"))):
        edge = end + inward * width
        found = [(np.count_nonzero(inward * (edge - v) > 0), cycle) for v, cycle in counted]
        if sum(count / cycle for count, cycle in found) < _PASSAGE * _END:
            count = sum(count for count, _ in found)
            said.append(
                f"Only {count} of {total} samples that count lie {words[0]} {edge:.4g} V, the {words[1]} voltage is "
                f"{end:.4g} V: the model is little better than extrapolated there. Record loops that go there slowly."
            )
    return said


def _counted(item: Prepared) -> Array:
    """Voltages of the samples that count, and of the turns before them."""
    parts = [
        np.append(piece.voltage[epoch.start : epoch.stop], piece.voltage[epoch.turn])
        for piece in item.pieces
        for epoch in epochs(piece, item.noise)
    ]
    return np.concatenate([np.zeros(0), *parts])


def _samples_a_cycle(item: Prepared) -> float:
    cycles = [one.stop - one.start - 1 for one in item.record.cycles()]
    return float(np.median(cycles)) if cycles else float(len(item.record))


def of_held_out(records: Sequence[Prepared], limits: tuple[float, float], errors: Sequence[RecordErrors]) -> list[str]:
    """Remarks about held-out records that the model should not, or cannot, be expected to meet."""
    low, high = limits
    margin, said = _MARGIN * (high - low), []
    for item in records:
        lowest, highest = item.record.voltage_range
        if lowest < low - margin or highest > high + margin:
            said.append(
                f"{item.name}: its voltages, {lowest:.4g} to {highest:.4g} V, leave those of the training records, "
                f"{low:.4g} to {high:.4g} V: the model is extrapolated there."
            )
    usual = max(error.rms for error in errors if error.role == "training")
    return said + [
        f"{error.record}: held out, its RMS error is {error.rms / usual:.2g} times that of training: the training "
        "records lack motions like it, or it is of another stage."
        for error in errors
        if error.role == "validation" and error.rms > _USUAL * usual
    ]


def repaired(errors: Sequence[RecordErrors], delay: float, sample: float, *, given: bool) -> list[str]:
    """Sentences about the delay [s], of samples `sample` [s] apart, and about each record's datum and drift."""
    said = []
    if significant_delay(delay, sample):
        said.append(
            f"The displacement lags the voltage by {delay * 1e3:.4g} ms ({delay / sample:.3g} samples, "
            f"{'given' if given else 'estimated'}); voltages were delayed by it."
        )
    for error in errors:
        if error.datum:
            said.append(
                f"{error.record}: fits best with its sensor's zero moved by {error.datum * 1e6:.4g} um; moved so."
            )
        if abs(error.drift) > _SMALLEST_DRIFT * error.stroke:
            said.append(f"{error.record}: {_drift(error)}; set aside.")
    return said


def _drift(error: RecordErrors) -> str:
    """A drift in words; it is a rate only where it can be creep."""
    if error.creeps:
        return f"creeps by {100 * error.drift / error.stroke:.3g} % of the range a decade of time since its start"
    few = error.decades < FEWEST_DECADES
    why = "too short a time to tell a rate of creep" if few else "which is more than creep"
    return f"drifts by {error.drifted_percent:.3g} % of the range over the samples that count, {why}"
