"""Selection of the structure: parts are added one by one while the error on held-out cycles falls."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dehyst._types import Array, Progress
from dehyst.identification.regression.fold_sums import FoldSums, Nearby, first_weights
from dehyst.identification.regression.regression import Regression
from dehyst.model import Structure
from dehyst.records.metrics import rms

Build = Callable[[Structure], Regression]
# A part must reduce the held-out error to this share: a smaller gain may be noise.
_WORTH = 0.97
# A transformer bends what graded elements can bend too; cycles held out hardly show which of them does.
_WORTH_BESIDE_GRADES = 0.8
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
    first = try_structure(build, start, progress)
    changes = [change for _, change in PARTS if not set(change) & set(without)]
    best, trials = _best_after(build, first, changes, progress)
    if best.trial.structure.transformer and best.trial.structure.grades > 1:
        straight = try_structure(build, replace(best.trial.structure, transformer=0), progress, best)
        trials.append(straight)
        if not best.trial.held_out < _WORTH_BESIDE_GRADES * straight.trial.held_out:
            best = straight
    tuning = [change for _, change in TUNING if "grades" not in change or best.trial.structure.grades > 1]
    best, tuned = _best_after(build, best, tuning, progress)
    return best.trial.structure, tuple(tried.trial for tried in (first, *trials, *tuned))


@dataclass(frozen=True, eq=False)
class Tried:
    """A trial, and what its successors start from: weights of the rows (n,), and unknowns that are not zero."""

    trial: StructureTrial
    weights: Array | None = None
    nearby: Nearby | None = None


def _best_after(build: Build, best: Tried, left: list[dict[str, Any]], progress: Progress) -> tuple[Tried, list[Tried]]:
    """Return the best structure after one change at a time, and all trials."""
    trials: list[Tried] = []
    while left:
        candidates = [try_structure(build, replace(best.trial.structure, **change), progress, best) for change in left]
        trials += candidates
        worth = [_worth(best.trial.structure, change) for change in left]
        gains = [tried.trial.held_out / share for tried, share in zip(candidates, worth, strict=True)]
        first = int(np.argmin(gains))
        if not gains[first] < best.trial.held_out:
            break
        best, taken = candidates[first], set(left[first])
        # Other values of the same field have been tried too.
        left = [change for change in left if not taken & set(change)]
    return best, trials


def _worth(structure: Structure, change: dict[str, Any]) -> float:
    """Return the share to which a change must reduce the held-out error."""
    return _WORTH_BESIDE_GRADES if "transformer" in change and structure.grades > 1 else _WORTH


def try_structure(build: Build, structure: Structure, progress: Progress, before: Tried | None = None) -> Tried:
    """Cross-validate a structure, rows weighted by the inverse slopes of the model before."""
    progress(f"trying {structure.words}")
    begin = time.perf_counter()
    regression = build(structure)
    weights = None if before is None else before.weights
    if before is None or weights is None:
        sums = FoldSums(regression, first_weights(regression))
    else:
        sums = FoldSums(regression, weights, before.nearby)
    held_out, training = rms(sums.held_out_errors()), sums.training_error()
    trial = StructureTrial(structure, held_out, training, time.perf_counter() - begin)
    return Tried(trial, sums.inverse_slopes, sums.handed_on())
