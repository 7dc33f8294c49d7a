"""Messages of an identification: what the records leave open, and what was repaired, in sentences."""

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
from dehyst.records.signals import turning_points

# Below this many times the noise the stiffness of an element is estimated too small.
_LOUD = 30
# Least creep a decade, as a part of the stroke, that is reported.
_SMALLEST_DRIFT = 2e-4
# The outer part of the limits' range at each end, and the part of one passage through it that is enough.
_END, _PASSAGE = 0.1, 0.25
# Fewer turns are no protocol.
_FEWEST_TURNS = 4
# Voltages may leave those of training by this part of their range; errors may be this many times those of training.
_MARGIN, _USUAL = 0.02, 2

LONGER_ELEMENTS = (
    "The loops grow. Elements that slide once only, as the range gets wider, lower the error of the records simulated "
    "whole: they are in the model."
)


_EXCITATIONS = {
    "inertia": "Faster motion, up to a fifth of the resonance at least, would show it",
    "creep": "A step that is held for as long as a cycle lasts, or loops at two speeds, would show it",
}


def of_dropped(part: str, without: float, within: float, stroke: float) -> str:
    """Return the sentence for a part that does not predict time that was not trained on."""
    named = {"inertia": "A resonance", "creep": "Creep"}[part]
    return (
        f"{named} was found and left out: it does not predict parts of the records that were not trained on "
        f"(RMS {100 * within / stroke:.2g} % of the range with it, {100 * without / stroke:.2g} % without). Drift, "
        f"vibration, the sensor's noise or its filter may look like it. {_EXCITATIONS[part]}."
    )


def of_lag(lag: float, moved: float, stroke: float) -> str:
    """Return the sentence for a lag [s] that may be the sensor's, in which the displacement moves by `moved` [m]."""
    return (
        f"The displacement lags by {1e3 * lag:.3g} ms, in which it moves by {100 * moved / stroke:.2g} % of the stroke "
        "(RMS). This was taken as the actuator's, and is compensated. If it is the sensor's filter, a path is missed "
        "by as much: look for its time constant in the sensor's data sheet, or watch a step with a faster sensor, and "
        "give it as sensor_lag=SECONDS (0 if the sensor has none)."
    )


def of_one_ended_loops(voltages: Sequence[Array]) -> list[str]:
    """Return a remark if all inner loops turn at one end of the voltages [V]: a path may have others."""
    low, high = min(float(v.min()) for v in voltages), max(float(v.max()) for v in voltages)
    near = _END * (high - low)
    minima, maxima = [], []
    for v in voltages:
        turns = v[turning_points(v, _MARGIN * (high - low))]
        rises = np.diff(turns, append=turns[-2:-1]) > 0
        minima += turns[rises].tolist()
        maxima += turns[~rises].tolist()
    at_low, at_high = all(v < low + near for v in minima), all(v > high - near for v in maxima)
    if at_low == at_high or len(minima) + len(maxima) < _FEWEST_TURNS:
        return []
    return [
        f"All inner loops of the records turn at the {'lowest' if at_low else 'highest'} voltage. Loops that turn "
        "elsewhere were not tested, and a path that has them may be missed by several times the expected error. "
        "Reversal curves or a random sequence as a validation record would show it."
    ]


def of_noise(first: float, noise: float) -> list[str]:
    """Return a remark if jitter, which only wider structures remove, drags the first element, at `first` [m]."""
    if first >= _LOUD * noise:
        return []
    return [
        f"The first element slides at {first * 1e6:.4g} um, {first / noise:.3g} times the sensor's noise; "
        f"below {_LOUD} times its stiffness is estimated too small."
    ]


def of_turns(probe: Identifiability) -> list[str]:
    """Return a remark if the turning points leave some of a few plain elements open."""
    if probe.determined == probe.of:
        return []
    return [
        f"Wider structures were not tried: the turning points determine {probe.determined} of {probe.of} directions of "
        "ten plain elements. Wider structures need loops within loops: add minor loops with other turning points."
    ]


def of_plain(
    identifiability: Identifiability, regression: Regression, coefficients: Coefficients
) -> tuple[Outcome, list[str]]:
    """Return the outcome with plain elements, and remarks about what stays open or lies on its floor."""
    remarks = []
    if identifiability.determined < identifiability.of:
        remarks.append(
            f"The records determine {identifiability.determined} of {identifiability.of} directions of the "
            "stiffnesses; minor loops with other turning points determine more (run dehyst insight for proposals)."
        )
    still = int(np.count_nonzero(~regression.movable))
    if still > 1 or not regression.movable.any():
        remarks.append(
            f"{still} of {regression.movable.size} elements slide at half of the range or more: they never slide over "
            "all of it, act as part of the spring, and got no stiffness."
        )
    low = np.flatnonzero(coefficients.slopes <= regression.floor * (1 + 1e-6))
    if low.size:
        ends = regression.knots * 1e6
        places = ", ".join(f"{ends[j]:.4g} to {ends[j + 1]:.4g} um" for j in low[:4])
        remarks.append(f"The spring's slope lies on its floor at {places}{' and elsewhere' if low.size > 4 else ''}.")
    if identifiability.determined < identifiability.of:
        return Outcome.UNDETERMINED, remarks
    return (Outcome.FLOOR_ACTIVE if low.size else Outcome.IDENTIFIED), remarks


def of_rare_voltages(records: Sequence[Prepared], limits: tuple[float, float]) -> list[str]:
    """Return remarks about ends of the limits [V] that the used samples reach for less than a part of one cycle.

    Descending tops pass the end in one cycle only, but in all of it: that is enough.
    """
    low, high = limits
    width = _END * (high - low)
    counted = [(_counted(item), _samples_a_cycle(item)) for item in records]
    total, remarks = sum(v.size for v, _ in counted), []
    for end, inward, words in ((high, -1, ("above", "highest")), (low, 1, ("below", "lowest"))):
        edge = end + inward * width
        counts = [(np.count_nonzero(inward * (edge - v) > 0), cycle) for v, cycle in counted]
        if sum(count / cycle for count, cycle in counts) < _PASSAGE * _END:
            count = sum(count for count, _ in counts)
            remarks.append(
                f"Only {count} of {total} samples that count lie {words[0]} {edge:.4g} V, the {words[1]} voltage is "
                f"{end:.4g} V: the model is little better than extrapolated there. Record loops that go there slowly."
            )
    return remarks


def _counted(item: Prepared) -> Array:
    """Return the voltages of the used samples, and of the turns before them."""
    parts = [
        np.append(piece.voltage[epoch.start : epoch.stop], piece.voltage[epoch.turn])
        for piece in item.pieces
        for epoch in epochs(piece, item.noise)
    ]
    return np.concatenate([np.zeros(0), *parts])


def _samples_a_cycle(item: Prepared) -> float:
    cycles = [cycle.stop - cycle.start - 1 for cycle in item.record.cycles()]
    return float(np.median(cycles)) if cycles else float(len(item.record))


def of_held_out(records: Sequence[Prepared], limits: tuple[float, float], errors: Sequence[RecordErrors]) -> list[str]:
    """Return remarks about held-out records that the model cannot be expected to predict."""
    low, high = limits
    margin, remarks = _MARGIN * (high - low), []
    for item in records:
        lowest, highest = item.record.voltage_range
        if lowest < low - margin or highest > high + margin:
            remarks.append(
                f"{item.name}: its voltages, {lowest:.4g} to {highest:.4g} V, leave those of the training records, "
                f"{low:.4g} to {high:.4g} V: the model is extrapolated there."
            )
    usual = max(error.rms for error in errors if error.role == "training")
    return remarks + [
        f"{error.record}: held out, its RMS error is {error.rms / usual:.2g} times that of training: the training "
        "records lack motions like it, or it is from another stage."
        for error in errors
        if error.role == "validation" and error.rms > _USUAL * usual
    ]


def repaired(errors: Sequence[RecordErrors], delay: float, sample: float, *, given: bool) -> list[str]:
    """Return sentences about the delay [s], for samples `sample` [s] apart, and each record's datum and drift."""
    sentences = []
    if significant_delay(delay, sample):
        sentences.append(
            f"The displacement lags the voltage by {delay * 1e3:.4g} ms ({delay / sample:.3g} samples, "
            f"{'given' if given else 'estimated'}); voltages were delayed by it."
        )
    for error in errors:
        if error.datum:
            sentences.append(
                f"{error.record}: fits best with its sensor's zero moved by {error.datum * 1e6:.4g} um; it was moved."
            )
        if abs(error.drift) > _SMALLEST_DRIFT * error.stroke:
            sentences.append(f"{error.record}: {_drift(error)}; set aside.")
    return sentences


def _drift(error: RecordErrors) -> str:
    """Describe a drift; as a rate only if it can be creep."""
    if error.creeps:
        return f"creeps by {100 * error.drift / error.stroke:.3g} % of the range a decade of time since its start"
    if error.steady:
        return (
            f"drifts steadily by {error.drifted_percent:.3g} % of the range over the samples that count: the sensor, "
            "the temperature, or creep that lasts longer than the record"
        )
    few = error.decades < FEWEST_DECADES
    why = "too short a time to determine a rate of creep" if few else "which is more than creep"
    return f"drifts by {error.drifted_percent:.3g} % of the range over the samples that count, {why}"
