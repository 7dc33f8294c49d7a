"""How far a path unlike the records may be missed: what parts of the records held out in time do not show.

Records of loops that all turn at one end, or of a few heights, hold no other loops; a path does. Two numbers say how
much a model knows of them: the error on loops of sizes that were not trained on, and how far structures that explain
the records about as well disagree on a random path.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from dehyst._types import Array
from dehyst.identification.regression.fold_sums import FoldSums, blocks, first_weights, least_squares_of_sums
from dehyst.identification.regression.regression import Regression
from dehyst.identification.structure_selection import StructureTrial
from dehyst.identification.training_data import TrainingData
from dehyst.model import Actuator, Structure
from dehyst.records.metrics import rms

_ROWS = 4000
# Fewer rows say nothing.
_FEWEST = 20
# Number of different sizes; a cycle of at least this part of the largest one is as large.
_SIZES, _LARGEST = 20, 0.9
# Structures whose held-out error is within this ratio of the least explain the records; so many are compared.
_ABOUT, _COMPARED = 1.3, 4
# Random turning points of the path, and its samples from one to the next.
_TURNS, _LEG = 40, 24
# A disagreement of more than this part of the stroke is of a fit that failed.
_FAILED = 0.2


def size_error(regression: Regression) -> float:
    """Return the RMS error [m] on cycles of sizes that were not trained on: the larger of two groups.

    Of the sizes there are below the largest, in twentieths of it, the smallest third is held out, then the next one.
    0 if there are too few.
    """
    few = regression.thinned(_ROWS)
    cycle = blocks(few.rows.voltage, few.rows.epoch)
    sizes = np.array([np.ptp(few.axis[cycle == k]) for k in np.unique(cycle)])
    step = (_SIZES * sizes / max(float(sizes.max(initial=0.0)), 1e-300)).astype(int)
    smaller = np.unique(step[step < _LARGEST * _SIZES])
    third = 3 * np.searchsorted(smaller, step) // max(smaller.size, 1)
    fold = np.minimum(third, 2)[np.unique(cycle, return_inverse=True)[1]]
    sums = FoldSums(few, first_weights(few), folds=3, given=fold)
    errors = [sums.errors_of(k) for k in (0, 1) if smaller.size and np.count_nonzero(fold == k) >= _FEWEST]
    return max((rms(left) for left in errors if left is not None), default=0.0)


def disagreement(
    frame: TrainingData, actuator: Actuator, voltages: tuple[float, float], trials: Sequence[StructureTrial]
) -> float:
    """Return the median RMS distance [m] on a random path from other structures that explain the records about as well.

    Parameters
    ----------
    frame : TrainingData
    actuator : Actuator
    voltages : (float, float)
        Lowest and highest voltage of the path [V].
    trials : sequence of StructureTrial
        All that were tried; 0 if no other one explains the records as well.
    """
    voltage, known = _random_path(*voltages)
    time = np.arange(voltage.size) * frame.times[0]

    def played(one: Actuator) -> Array:
        return one.simulate(voltage, time=time if one.needs_time else None, extrapolate=True).displacement[known:]

    mine, distances = played(actuator), []
    for structure in _others(trials, creeps=actuator.creep is not None):
        regression = frame.regression(structure, _ROWS)
        found = least_squares_of_sums(regression)
        if found.solved.optimal:
            distances.append(float(np.std(played(frame.actuator_of(regression, found)) - mine)))
    distances = [one for one in distances if one < _FAILED * frame.stroke]
    return float(np.median(distances)) if distances else 0.0


def _others(trials: Sequence[StructureTrial], creeps: bool) -> list[Structure]:
    """Return the structures whose held-out errors are about the least, the simplest first."""
    counted = [trial for trial in trials if bool(trial.structure.creep) == creeps]
    least = min((trial.held_out for trial in counted), default=0.0)
    near = {trial.structure for trial in counted if trial.held_out <= _ABOUT * least}
    return sorted(near, key=lambda structure: (structure.parameters, repr(structure)))[:_COMPARED]


def _random_path(low: float, high: float) -> tuple[Array, int]:
    """Return voltages between random turning points, after two full loops, and how many samples these have."""
    turns = np.concatenate([[low, high, low, high, low], np.random.default_rng(1).uniform(low, high, _TURNS)])
    legs = [np.linspace(a, b, _LEG, endpoint=False) for a, b in pairwise(turns)]
    return np.concatenate(legs), 4 * _LEG
