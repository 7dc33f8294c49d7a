"""Time that was not trained on: what a model of two thirds of the records makes of the rest, simulated.

Folds that interleave cycles never extrapolate, and the equation of a row knows the measured displacement: both let a
resonance filter the sensor's noise, and creep follow a drift. Here sixths of the time, two at a time, are simulated
from the voltages alone by a model of the others. Where parts that move in time compete, a straight line in time is
taken from what is missed in each record: drift is no reason for such a part.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array, Mask, Progress
from dehyst.identification.preprocessing.preparation import Prepared
from dehyst.identification.regression.fold_sums import FoldSums, first_weights
from dehyst.identification.regression.regression import Regression
from dehyst.identification.training_data import TrainingData
from dehyst.identification.validation import Protocol, compare, errors_of
from dehyst.model import Actuator, Structure
from dehyst.records.metrics import rms

_ROWS = 4000
_PARTS = 6
# A start is not fitted where this part of a record comes after all elements are known.
_SOON = 0.5
# A part of the model stays only if without it the error is larger by more than this ratio.
_WORTH = 1.2


@dataclass(frozen=True)
class Dropped:
    """A part that the records do not support.

    Attributes
    ----------
    part : str
        "inertia", "creep" or "delay".
    without, within : float
        Error [m] of time that was not trained on, without the part and with it.
    """

    part: str
    without: float
    within: float


def extrapolation_error(frame: TrainingData, structure: Structure) -> float:
    """Return the error [m] of parts of the time that were not trained on, less a straight line in each record."""
    parts = _Parts(frame, frame.regression(structure, _ROWS))
    return _typical([_detrended(*one)[where] for one, where in parts.residuals()])


def block_error(frame: TrainingData, regression: Regression) -> float:
    """Return the error [m] of parts of the time that were not trained on."""
    return _typical([residual[where] for (_, residual), where in _Parts(frame, regression.thinned(_ROWS)).residuals()])


def _typical(parts: list[Array]) -> float:
    """Return the median RMS error: a part with the only loops of their size says little of the others."""
    return float(np.median([rms(part) for part in parts if part.size])) if any(map(np.size, parts)) else 0.0


@dataclass(frozen=True, eq=False)
class _Parts:
    """Sixths of the time of all records, two of them held out at a time.

    Samples beyond the displacements of the rest do not count: there nothing is known.
    """

    frame: TrainingData
    regression: Regression

    def _part(self, q: int, time: Array) -> NDArray[np.intp]:
        """Return the part in which each time of a record lies."""
        first, last = self.frame.training[q].record.time[[0, -1]]
        return np.asarray(np.clip((_PARTS * (time - first) / (last - first)).astype(np.intp), 0, _PARTS - 1))

    def residuals(self) -> Iterator[tuple[tuple[Array, Array], Mask]]:
        """Yield time and residual of a record under a model that lacks a group, and which samples were held out."""
        rows = self.regression.rows
        part = np.zeros(len(rows), dtype=np.intp)
        for q in range(len(self.frame.training)):
            part[rows.record == q] = self._part(q, rows.time[rows.record == q])
        weights = first_weights(self.regression)
        for k in range(_PARTS // 2):
            group = k, k + _PARTS // 2
            out = np.isin(part, group)
            fitted = FoldSums(self.regression, weights, folds=2, given=out.astype(np.intp)).without(1)
            if fitted is None:
                continue
            actuator = self.frame.actuator_of(self.regression, fitted)
            known = self.regression.axis[~out]
            for q, item in enumerate(self.frame.training):
                datum = float(self.regression.datum[q])
                protocol = Protocol("training", actuator.delay, datum, q in self.regression.drifting, self.frame.stroke)
                time, measured, simulated = _played(actuator, item, protocol)
                inside = (measured >= known.min()) & (measured <= known.max())
                yield (time, measured - simulated), np.isin(self._part(q, time), group) & inside


def _played(actuator: Actuator, item: Prepared, protocol: Protocol) -> tuple[Array, Array, Array]:
    """Return time, measured and simulated displacement: from where all elements are known, if that is soon enough."""
    beside = compare(actuator, item, protocol)
    last = [one for one in beside.played(actuator) if one[1] is beside.epochs[one[0]][-1]]
    if sum(epoch.stop - epoch.start for _, epoch, _ in last) < _SOON * sum(map(len, beside.measured)):
        _, trace = errors_of(actuator, item, protocol)
        return trace.time, trace.measured, trace.simulated
    time, _, measured, simulated, _ = (np.concatenate(column) for column in zip(*(one[2] for one in last), strict=True))
    return time, measured, simulated


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
        simpler.append(("creep", replace(frame, creepless=True), replace(structure, creep=0)))
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
