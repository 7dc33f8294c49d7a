"""Held-out errors: time-block cross-validation by simulation, held-out loop sizes, and disagreement of structures.

Folds that interleave cycles never extrapolate, and the equation of a row knows the measured displacement: both let a
resonance filter the sensor's noise, and creep follow a drift. Here sixths of the time, two at a time, are simulated
from the voltages alone by a model of the others. Where parts that move in time compete, a straight line in time is
taken from the residual of each record: drift is no reason for such a part.

Records of loops that all turn at one end, or of a few heights, hold no other loops; a path does. Two numbers say how
much a model knows of them: how far held-out legs are from all others, and the disagreement, on a random path, of
structures whose held-out errors are about equal.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array, Mask, Progress
from dehyst.identification.creep_search import CreepSearch
from dehyst.identification.expectation import new_legs
from dehyst.identification.preprocessing.preparation import Prepared
from dehyst.identification.regression.fold_sums import least_squares_of_sums, weighted_alike
from dehyst.identification.regression.regression import Regression
from dehyst.identification.results import HeldOutHolds
from dehyst.identification.rules import RULES
from dehyst.identification.structure import Structure
from dehyst.identification.structure_selection import StructureTrial
from dehyst.identification.training_data import TrainingData
from dehyst.identification.validation import RecordComparison, compare, counted_of, errors_of, joined
from dehyst.model import Actuator, legs
from dehyst.records import rms

_ROWS = 4000
_PARTS = 6
# A start is not fitted where this part of a record comes after all elements are known.
_SOON = 0.5
# The structure with which drift and creep compete, and the branches of creep.
_STEADY = Structure(elements=20, grades=3, transformer=10, smooth=True)
_BRANCHES = 4
# Most structures that are compared.
_COMPARED = 4
# Random turning points of the path, and its samples from one to the next.
_TURNS, _LEG = 40, 24


class Dropped(NamedTuple):
    """A part that the records do not support, "inertia" or "creep"; errors of held-out time without and with it [m]."""

    part: str
    without: float
    within: float


def block_error(frame: TrainingData, regression: Regression, *, detrended: bool = False) -> float:
    """Return the error [m] on held-out parts of the time; `detrended`: without a linear trend in each record.

    It is the median RMS error of the parts, because a part with the only loops of their size is not representative.
    """
    errors = []
    for _, time, residual, held_out in _residuals(frame, regression.thinned(_ROWS)):
        off, line = time - time.mean(), 0.0
        if detrended:
            line = residual.mean() + off * float(off @ residual) / max(float(off @ off), 1e-300)
        if held_out.any():
            errors.append(rms((residual - line)[held_out]))
    return float(np.median(errors)) if errors else 0.0


def drift_and_creep(frame: TrainingData) -> tuple[bool, bool]:
    """Return whether a drift predicts held-out time, and whether creep predicts it equally well."""
    drifting = frame.regression(_STEADY, _ROWS // 2)
    creeping = frame.regression(replace(_STEADY, creep=_BRANCHES), _ROWS // 2)
    without, drift, creep = (block_error(frame, one) for one in (replace(drifting, drifting=()), drifting, creeping))
    return drift < RULES.drift_prediction_gain * without, creep * RULES.drift_prediction_gain < drift


def followed_at_once(frame: TrainingData, structure: Structure) -> float:
    """Return the part of a step that a structure's creep adds within a twentieth of a cycle, as a low-pass does.

    It is 0 if it is as slow as creep.
    """
    if not structure.creep:
        return 0.0
    regression = frame.regression(structure, _ROWS)
    stiffness = least_squares_of_sums(regression).internal[: regression.grid.time_constants.size]
    return frame.followed_at_once(stiffness / regression.mean_slope, regression.grid.time_constants)


def _part_of(item: Prepared, time: Array) -> NDArray[np.intp]:
    """Return the part of the time of a record in which times (n,) [s] are."""
    first, last = item.record.time[[0, -1]]
    return np.asarray(np.clip((_PARTS * (time - first) / (last - first)).astype(np.intp), 0, _PARTS - 1))


def _residuals(
    frame: TrainingData, regression: Regression, folds: Sequence[int] = range(_PARTS // 2)
) -> Iterator[tuple[int, Array, Array, Mask]]:
    """Yield number, time and residual of a record under a model that lacks two sixths of the time, and those samples.

    Samples beyond the displacements of the rest do not count: there nothing is known.
    """
    rows = regression.rows
    part = np.zeros(len(rows), dtype=np.intp)
    for q, item in enumerate(frame.training):
        part[rows.record == q] = _part_of(item, rows.time[rows.record == q])
    sums = weighted_alike(regression, _PARTS // 2, part % (_PARTS // 2))
    for k in folds:
        fitted = sums.without(k)
        if fitted is None:
            continue
        actuator, known = frame.actuator_of(regression, fitted), regression.axis[sums.fold != k]
        for q, item in enumerate(frame.training):
            datum, drifting = float(regression.datum[q]), q in regression.drifting
            compared = compare(actuator, item, frame.stroke, datum=datum, drifting=drifting)
            time, measured, simulated = _played(actuator, compared)
            inside = (measured >= known.min()) & (measured <= known.max())
            yield q, time, measured - simulated, (_part_of(item, time) % (_PARTS // 2) == k) & inside


def _played(actuator: Actuator, compared: RecordComparison) -> tuple[Array, Array, Array]:
    """Return time, measured and simulated displacement: from where all elements are known, if that is soon enough."""
    last = [one for one in compared.played(actuator) if one[1] is compared.epochs[one[0]][-1]]
    if sum(epoch.stop - epoch.start for _, epoch, _ in last) < _SOON * sum(map(len, compared.measured)):
        _, trace = errors_of(actuator, compared, "training")
        return trace.time, trace.measured, trace.simulated
    columns = list(zip(*(counted_of(played, compared.record.record) for _, _, played in last), strict=True))
    time, measured, simulated = (joined(columns[k]) for k in (0, 2, 3))
    return time, measured, simulated


def unsupported(frame: TrainingData, still: TrainingData, structure: Structure, report: Progress) -> Dropped | None:
    """Return the first time-dependent part that does not predict held-out time; None if all do.

    `frame`, `structure`: as they were found. `still`: the same records without inertia. `report`: called with a few
    words at each step.
    """
    simpler = []
    if frame.lagging.dynamics is not None:
        simpler.append(("inertia", still, structure))
    if structure.creep:
        simpler.append(("creep", replace(frame, creepless=True), replace(structure, creep=0)))
    if not simpler:
        return None

    def error(one: TrainingData, own: Structure) -> float:
        return block_error(one, one.regression(own, _ROWS), detrended=True)

    report("predicting time that was not trained on")
    within = error(frame, structure)
    for part, other, fewer in simpler:
        report(f"predicting time that was not trained on, without {part}")
        without = error(other, fewer)
        if without <= RULES.prediction_loss * within:
            return Dropped(part, without, within)
    return None


def new_in_time(frame: TrainingData) -> tuple[float, float]:
    """Return the distances of rises, and of falls, in the parts held out by `block_error` from all others.

    Each is an RMS over the parts, relative to the range.
    """
    low, high = frame.voltages
    part, pairs = [], []
    for item in frame.training:
        voltage = item.record.voltage
        at = legs(voltage, high - low)
        # A leg is in the part that its middle is in.
        part.append(np.minimum(_PARTS * at.mean(axis=1) / len(voltage), _PARTS - 1).astype(int))
        pairs.append(voltage[at])
    of, all_ = np.concatenate(part) % (_PARTS // 2), np.concatenate(pairs)
    squares = [np.square(new_legs(all_[of == k], all_[of != k])) for k in range(_PARTS // 2)]
    rising, falling = np.sqrt(np.mean(squares, axis=0)).tolist()
    return rising, falling


def disagreement(
    frame: TrainingData, actuator: Actuator, voltages: tuple[float, float], trials: Sequence[StructureTrial]
) -> float:
    """Return the median RMS distance [m] on a random path from other structures that explain the records about as well.

    The path has random turning points after two full loops. `voltages`: its lowest and highest voltage [V]. `trials`:
    all that were tried; 0 if no other one explains the records as well.
    """
    low, high = voltages
    turns = np.concatenate([[low, high, low, high, low], np.random.default_rng(1).uniform(low, high, _TURNS)])
    voltage = np.concatenate([np.linspace(a, b, _LEG, endpoint=False) for a, b in pairwise(turns)])
    time = np.arange(voltage.size) * frame.times[0]

    def played(one: Actuator) -> Array:
        path = one.simulate(voltage, time=time if one.needs_time else None, extrapolate=True).displacement
        return path[4 * _LEG :]

    alike = [trial for trial in trials if bool(trial.structure.creep) == (actuator.creep is not None)]
    least = min((trial.held_out for trial in alike), default=0.0)
    near = {trial.structure for trial in alike if trial.held_out <= RULES.about_as_good * least}
    mine, distances = played(actuator), []
    for structure in sorted(near, key=lambda one: (one.parameters, repr(one)))[:_COMPARED]:
        regression = frame.regression(structure, _ROWS)
        found = least_squares_of_sums(regression)
        if found.solved.optimal:
            distances.append(float(np.std(played(frame.actuator_of(regression, found)) - mine)))
    distances = [one for one in distances if one < RULES.failed_fit * frame.stroke]
    return float(np.median(distances)) if distances else 0.0


def held_out_holds(frame: TrainingData, search: CreepSearch) -> HeldOutHolds | None:
    """Return the errors of the drift in held-out holds; None if no hold can be held out.

    Creep in displacement is identified again without the held-out time.
    """
    forced = replace(_STEADY, creep=_BRANCHES)
    still = replace(frame, creepless=True)
    fixed = [(one, one.regression(own, _ROWS)) for one, own in ((still, _STEADY), (frame, forced))]
    squares: tuple[list[float], ...] = ([], [], [])
    for fold in range(_PARTS // 2):

        def is_out(item: Prepared, time: Array, fold: int = fold) -> Mask:
            return np.asarray(_part_of(item, time) % (_PARTS // 2) == fold)

        part = search.find(is_out)
        if part is None:
            continue
        before = frame.without_creep(part)
        for kind, (one, regression) in enumerate((*fixed, (before, before.regression(_STEADY, _ROWS)))):
            for q, time, residual, _ in _residuals(one, regression, (fold,)):
                crept = part.added(time, residual, np.zeros(len(part)))[0] if one is before else residual
                holds = [ends for ends in search.held(q) if is_out(frame.training[q], np.array(ends)).all()]
                inside = [(time >= begin) & (time <= end) for begin, end in holds]
                squares[kind].extend(float(np.var(crept[which])) for which in inside if which.any())
    return HeldOutHolds(*(float(np.sqrt(np.median(one))) for one in squares)) if all(squares) else None
