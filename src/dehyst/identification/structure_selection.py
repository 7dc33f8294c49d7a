"""How much model records support: parts are added one by one while the error on held-out cycles falls."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.identification.regression.regression import Regression
from dehyst.model import Structure
from dehyst.records.metrics import rms
from dehyst.records.signals import turning_points

Build = Callable[[Structure], Regression]
_FOLDS = 3
# Blocks that a record is cut into at least, so that a staircase of two long legs can be held out in parts.
_BLOCKS = 12
# A part must make the held-out error smaller by this much; of less, noise decides.
_WORTH = 0.97
# What is tried, part by part.
PARTS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("more elements, dense where loops are small", {"elements": 40, "spacing": 2.0, "knots": 41}),
    ("a transformer", {"transformer": 20}),
    ("graded elements", {"grades": 8}),
    ("creep", {"creep": 9}),
    ("smooth elements", {"smooth": True}),
)
# What is tried then, on what was found.
TUNING: tuple[tuple[str, dict[str, Any]], ...] = (
    ("finer grades", {"grades": 16}),
    ("more smoothing", {"smoothing": 1e-2}),
    ("less smoothing", {"smoothing": 1e-3}),
)


@dataclass(frozen=True)
class StructureTrial:
    """A structure that was tried.

    Attributes
    ----------
    structure : Structure
    held_out, training : float
        RMS error [m]: of cycles held out in turn, and of the records themselves.
    seconds : float
        That it took.
    """

    structure: Structure
    held_out: float
    training: float
    seconds: float

    def as_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {
            "structure": self.structure.as_dict(),
            "words": self.structure.words,
            "parameters": self.structure.parameters,
            "held_out_m": self.held_out,
            "training_m": self.training,
            "seconds": self.seconds,
        }


def label(structure: Structure, trials: Sequence[StructureTrial]) -> str:
    """A structure in words, with its smoothing where that alone tells it from another that was tried."""
    like = {one.structure.smoothing for one in trials if one.structure.words == structure.words}
    return structure.words if len(like) < 2 else f"{structure.words}; smoothing {structure.smoothing:g}"


def select(
    build: Build, start: Structure, tell: Callable[[str], None], *, without: Sequence[str] = ()
) -> tuple[Structure, tuple[StructureTrial, ...]]:
    """Add the part that helps most on held-out cycles, again and again, until none is worth it; then tune.

    Parameters
    ----------
    build : callable
        Structure -> regression on the same samples, thinned.
    start : Structure
    tell : callable
        Called with a few words at each trial.
    without : sequence of str
        Fields of a structure that are left as they are.

    Returns
    -------
    Structure, tuple of Trial
        The chosen one, and all that were tried in order.
    """
    trials = [_tried(build, start, tell)]
    best = _climbed(build, trials[0], [change for _, change in PARTS if not set(change) & set(without)], trials, tell)
    tuning = [change for _, change in TUNING if "grades" not in change or best.structure.grades > 1]
    best = _climbed(build, best, tuning, trials, tell)
    return best.structure, tuple(trials)


def _climbed(
    build: Build,
    best: StructureTrial,
    left: list[dict[str, Any]],
    trials: list[StructureTrial],
    tell: Callable[[str], None],
) -> StructureTrial:
    """The best after one change at a time; what is tried is added to the trials."""
    while left:
        found = [_tried(build, replace(best.structure, **change), tell) for change in left]
        trials += found
        first = int(np.argmin([one.held_out for one in found]))
        if not found[first].held_out < _WORTH * best.held_out:
            break
        best, taken = found[first], set(left[first])
        # Another value of the same field was tried beside it.
        left = [change for change in left if not taken & set(change)]
    return best


def _tried(build: Build, structure: Structure, tell: Callable[[str], None]) -> StructureTrial:
    tell(f"trying {structure.words}")
    begin = time.perf_counter()
    regression = build(structure)
    first = regression.fit("l2")
    weights = 1 / regression.slope(first)
    whole = regression.fit("l2", weights)
    training = rms(regression.residual(whole) / regression.slope(whole))
    held_out = rms(held_out_errors(regression, weights))
    return StructureTrial(structure, held_out, training, time.perf_counter() - begin)


def held_out_error(regression: Regression) -> float:
    """RMS error [m] of cycles held out in turn, rows weighted by the inverse slope of a first fit."""
    return rms(held_out_errors(regression, 1 / regression.slope(regression.fit("l2"))))


def held_out_errors(regression: Regression, weights: Array) -> Array:
    """Error of each row [m] from a fit without its cycle and every third other."""
    fold = blocks(regression.rows.voltage, regression.rows.epoch) % _FOLDS
    errors = np.empty(len(fold))
    for k in range(_FOLDS):
        out = fold == k
        found = regression.chosen(~out).fit("l2", weights[~out])
        left = regression.chosen(out)
        errors[out] = left.residual(found) / left.slope(found)
    return errors


def blocks(voltage: Array, epoch: NDArray[np.intp]) -> NDArray[np.intp]:
    """Number of the cycle of each row (n,), from its voltage and its epoch's number; long monotone legs are cut."""
    cut = np.zeros(voltage.size, dtype=bool)
    cut[1:] = np.diff(epoch) != 0
    cut[turning_points(voltage, 0.02 * float(np.ptp(voltage)))[::2]] = True
    starts = np.append(np.flatnonzero(cut), voltage.size)
    longest = max(voltage.size // _BLOCKS, 2)
    for a, b in zip(np.append(0, starts[:-1]), starts, strict=True):
        cut[a + longest : b : longest] = True
    return np.cumsum(cut)
