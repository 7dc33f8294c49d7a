"""Time that was not trained on: parts that move in time must predict the first and the last third of the records.

Folds that interleave cycles never extrapolate, and the equation of a row knows the measured displacement: both let a
resonance filter the sensor's noise, and creep follow a drift. Here a model of two thirds of the time is simulated from
the voltages alone over the other third. A straight line in time is taken from what it misses in each record, for the
comparison only: drift is no reason for a part.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dehyst._types import Array, Progress
from dehyst.identification.regression.fold_sums import FoldSums, first_weights
from dehyst.identification.training_data import TrainingData
from dehyst.identification.validation import Protocol, errors_of
from dehyst.model import Structure
from dehyst.records.metrics import rms

_ROWS = 4000
_THIRDS = 3
# A part stays only if without it the thirds not trained on are missed by more than this ratio.
_WORTH = 1.03


@dataclass(frozen=True)
class Dropped:
    """A part that the records do not support.

    Attributes
    ----------
    part : str
        "inertia", "creep" or "delay".
    without, within : float
        RMS error [m] of the thirds not trained on, without the part and with it.
    """

    part: str
    without: float
    within: float


def extrapolation_error(frame: TrainingData, structure: Structure) -> float:
    """Return the RMS error [m] of the first and the last third, each simulated by a model of the rest."""
    regression = frame.regression(structure, _ROWS)
    rows = regression.rows
    begin = np.array([item.record.time[0] for item in frame.training])
    end = np.array([item.record.time[-1] for item in frame.training])
    part = (rows.time - begin[rows.record]) / (end - begin)[rows.record]
    third = np.clip((_THIRDS * part).astype(np.intp), 0, _THIRDS - 1)
    sums = FoldSums(regression, first_weights(regression), folds=_THIRDS, given=third)
    squares: list[Array] = []
    for k in (0, _THIRDS - 1):
        coefficients = sums.without(k)
        if coefficients is None:
            continue
        actuator = frame.actuator_of(regression, coefficients)
        for q, item in enumerate(frame.training):
            protocol = Protocol("training", actuator.delay, float(regression.datum[q]), False, frame.stroke)
            _, trace = errors_of(actuator, item, protocol)
            where = np.clip((_THIRDS * (trace.time - begin[q]) / (end[q] - begin[q])).astype(np.intp), 0, _THIRDS - 1)
            squares.append(_detrended(trace.time, trace.residual)[where == k])
    return rms(np.concatenate(squares)) if squares else float("nan")


def _detrended(time: Array, residual: Array) -> Array:
    """Return a residual less its straight line in time."""
    off = time - time.mean()
    return np.asarray(residual - residual.mean() - off * float(off @ residual) / max(float(off @ off), 1e-300))


def unsupported(frame: TrainingData, still: TrainingData, structure: Structure, report: Progress) -> Dropped | None:
    """Return the first part that moves in time and does not predict time that was not trained on; None if all do.

    Parameters
    ----------
    frame, structure : TrainingData, Structure
        As they were found.
    still : TrainingData
        The same records without inertia.
    report : callable
        Called with a few words at each step.
    """
    simpler = []
    if frame.inertia.mass:
        simpler.append(("inertia", still, structure))
    if structure.creep:
        simpler.append(("creep", frame, replace(structure, creep=0)))
    if not simpler:
        return None
    report("predicting time that was not trained on")
    within = extrapolation_error(frame, structure)
    for part, other, fewer in simpler:
        report(f"predicting time that was not trained on, without {part}")
        without = extrapolation_error(other, fewer)
        if without <= _WORTH * within:
            return Dropped(part, without, within)
    return None
