"""Selection of the structure: parts are added one by one while the error on held-out cycles falls."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array, Progress
from dehyst.identification.regression.regression import Regression
from dehyst.model import Structure
from dehyst.records.metrics import rms
from dehyst.records.signals import turning_points

Build = Callable[[Structure], Regression]
_FOLDS = 3
# Least number of blocks of a record, so that a staircase of two long legs can be held out in parts.
_BLOCKS = 12
# A part must reduce the held-out error to this share: a smaller gain may be noise.
_WORTH = 0.97
# Parts, tried one by one.
PARTS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("more elements, dense where loops are small", {"elements": 40, "spacing": 2.0, "knots": 41}),
    ("a transformer", {"transformer": 20}),
    ("graded elements", {"grades": 8}),
    ("creep", {"creep": 9}),
    ("smooth elements", {"smooth": True}),
)
# Changes of the structure with these parts, tried afterwards.
TUNING: tuple[tuple[str, dict[str, Any]], ...] = (
    ("finer grades", {"grades": 16}),
    ("more smoothing", {"smoothing": 1e-2}),
    ("less smoothing", {"smoothing": 1e-3}),
)


@dataclass(frozen=True)
class StructureTrial:
    """A structure and its cross-validation error.

    Attributes
    ----------
    structure : Structure
    held_out, training : float
        RMS error [m] on cycles held out in turn, and on the training records.
    seconds : float
        Duration of the trial.
    """

    structure: Structure
    held_out: float
    training: float
    seconds: float

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "structure": self.structure.as_dict(),
            "words": self.structure.words,
            "parameters": self.structure.parameters,
            "held_out_m": self.held_out,
            "training_m": self.training,
            "seconds": self.seconds,
        }


def label(structure: Structure, trials: Sequence[StructureTrial]) -> str:
    """Describe a structure in words, with its smoothing if only that differs from another trial."""
    smoothings = {trial.structure.smoothing for trial in trials if trial.structure.words == structure.words}
    return structure.words if len(smoothings) < 2 else f"{structure.words}; smoothing {structure.smoothing:g}"


def select(
    build: Build, start: Structure, progress: Progress, *, without: Sequence[str] = ()
) -> tuple[Structure, tuple[StructureTrial, ...]]:
    """Add the part that reduces the held-out error most, repeatedly, until no part is worth it; then tune.

    Parameters
    ----------
    build : callable
        Structure -> regression on the same samples, thinned.
    start : Structure
    progress : callable
        Called with a few words at each trial.
    without : sequence of str
        Fields of a structure that must not change.

    Returns
    -------
    Structure, tuple of StructureTrial
        The selected structure, and all trials in order.
    """
    trials = [_trial(build, start, progress)]
    best = _best_after(
        build, trials[0], [change for _, change in PARTS if not set(change) & set(without)], trials, progress
    )
    tuning = [change for _, change in TUNING if "grades" not in change or best.structure.grades > 1]
    best = _best_after(build, best, tuning, trials, progress)
    return best.structure, tuple(trials)


def _best_after(
    build: Build,
    best: StructureTrial,
    left: list[dict[str, Any]],
    trials: list[StructureTrial],
    progress: Progress,
) -> StructureTrial:
    """Return the best structure after one change at a time; append all trials to `trials`."""
    while left:
        candidates = [_trial(build, replace(best.structure, **change), progress) for change in left]
        trials += candidates
        first = int(np.argmin([trial.held_out for trial in candidates]))
        if not candidates[first].held_out < _WORTH * best.held_out:
            break
        best, taken = candidates[first], set(left[first])
        # Other values of the same field have been tried too.
        left = [change for change in left if not taken & set(change)]
    return best


def _trial(build: Build, structure: Structure, progress: Progress) -> StructureTrial:
    progress(f"trying {structure.words}")
    begin = time.perf_counter()
    regression = build(structure)
    first = regression.fit("l2")
    weights = 1 / regression.slope(first)
    whole = regression.fit("l2", weights)
    training = rms(regression.residual(whole) / regression.slope(whole))
    held_out = rms(held_out_errors(regression, weights))
    return StructureTrial(structure, held_out, training, time.perf_counter() - begin)


def held_out_error(regression: Regression) -> float:
    """Return the RMS error [m] of cycles held out in turn, rows weighted by the inverse slope of a first fit."""
    return rms(held_out_errors(regression, 1 / regression.slope(regression.fit("l2"))))


def held_out_errors(regression: Regression, weights: Array) -> Array:
    """Return the error of each row [m] in a fit without every third cycle, its own among them."""
    fold = blocks(regression.rows.voltage, regression.rows.epoch) % _FOLDS
    errors = np.empty(len(fold))
    for k in range(_FOLDS):
        out = fold == k
        coefficients = regression.chosen(~out).fit("l2", weights[~out])
        held_out = regression.chosen(out)
        errors[out] = held_out.residual(coefficients) / held_out.slope(coefficients)
    return errors


def blocks(voltage: Array, epoch: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the cycle number of each row (n,), from voltage and epoch number; long monotone legs are cut."""
    cut = np.zeros(voltage.size, dtype=bool)
    cut[1:] = np.diff(epoch) != 0
    cut[turning_points(voltage, 0.02 * float(np.ptp(voltage)))[::2]] = True
    starts = np.append(np.flatnonzero(cut), voltage.size)
    longest = max(voltage.size // _BLOCKS, 2)
    for a, b in zip(np.append(0, starts[:-1]), starts, strict=True):
        cut[a + longest : b : longest] = True
    return np.cumsum(cut)
