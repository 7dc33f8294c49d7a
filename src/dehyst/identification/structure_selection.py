"""Selection of the structure: parts are added one by one while the error on held-out cycles falls."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from dehyst._types import Array, Progress
from dehyst._views.fields import json_values
from dehyst.identification.regression.fold_sums import FoldSums, Nearby, weighted_alike
from dehyst.identification.regression.regression import Regression
from dehyst.identification.rules import RULES
from dehyst.identification.settings import Deadline
from dehyst.identification.structure import Structure
from dehyst.records import rms

# Each fold of the cycles is held out in turn.
_FOLDS = 3
Build = Callable[[Structure], Regression]
# Fields of a structure, and their values with a part more.
Change = dict[str, Any]
# Parts, tried one by one: more elements, dense where loops are small, a transformer, graded elements, creep and smooth
# elements.
PARTS: tuple[Change, ...] = (
    {"elements": 40, "spacing": 2.0, "knots": 41},
    {"transformer": 20},
    {"grades": 8},
    {"creep": 9},
    {"smooth": True},
)
# Changes of the structure with these parts, tried afterwards.
TUNING: tuple[Change, ...] = ({"grades": 16}, {"smoothing": 1e-2}, {"smoothing": 1e-3})


@dataclass(frozen=True)
class StructureTrial:
    """A structure and its cross-validation error.

    `held_out`, `training`: RMS error [m] on cycles held out in turn, and on the training records. `seconds`: duration
    of the trial.
    """

    structure: Structure
    held_out: float
    training: float
    seconds: float

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        described = "structure words=structure.words parameters=structure.parameters"
        return json_values(self, f"{described} held_out_m=held_out training_m=training seconds")


class Tried(NamedTuple):
    """A trial, and the start of its successors: weights of the rows (n,), and nonzero unknowns."""

    trial: StructureTrial
    weights: Array | None = None
    nearby: Nearby | None = None


def select(
    build: Build,
    start: Structure,
    progress: Progress,
    *,
    without: Sequence[str] = (),
    stroke: float = float("nan"),
    deadline: Deadline | None = None,
) -> tuple[Structure, tuple[StructureTrial, ...]]:
    """Add the part that reduces the held-out error most, repeatedly, until no part improves it enough; then tune.

    `build`: structure -> regression on the same samples, thinned. `progress`: called with a few words at each trial.
    `without`: fields of a structure that must not change. `stroke`: range of the widest loop [m], to which reported
    errors refer. `deadline`: when no further trial begins.

    Returns
    -------
    Structure, tuple of StructureTrial
        The selected structure, and all trials in order: none if the deadline had passed before.
    """
    search = _Search(build, progress, stroke, deadline or Deadline())
    changes = [change for change in PARTS if not set(change) & set(without)]
    changes = [change for change in changes if replace(start, **change) != start]
    first = search.tried(start, changes)
    if first is None:
        return start, ()
    best = search.straightened(search.best_after(first, changes))
    tuning, search.later = search.later, []
    tuning = [change for change in tuning if "grades" not in change or best.trial.structure.grades > 1]
    best = search.best_after(best, tuning)
    return best.trial.structure, tuple(tried.trial for tried in search.done)


def simplest(trials: Sequence[StructureTrial], *, creep: bool) -> Structure | None:
    """Return the structure of fewest parameters whose held-out error is nearly the least; None without a trial.

    If not `creep`, only structures without creep count.
    """
    counted = [trial for trial in trials if creep or not trial.structure.creep]
    least = min((trial.held_out for trial in counted), default=0.0)
    near = [trial.structure for trial in counted if RULES.part_gain * trial.held_out <= least]
    return min(near, key=lambda structure: structure.parameters, default=None)


@dataclass(eq=False)
class _Search:
    """The trials of one selection, until the deadline: those done, changes that come later, and how many at most."""

    build: Build
    progress: Progress
    stroke: float
    deadline: Deadline
    done: list[Tried] = field(default_factory=list)
    later: list[Change] = field(default_factory=lambda: list(TUNING))
    most: int = 0
    stopped: bool = False

    def best_after(self, best: Tried, left: list[Change]) -> Tried:
        """Return the best structure after one change at a time."""
        while left and not self.stopped:
            candidates, gains = [], []
            for k, change in enumerate(left):
                tried = self.tried(replace(best.trial.structure, **change), left, k, best)
                if tried is None:
                    break
                # The share to which a change must reduce the held-out error.
                bends = "transformer" in change and best.trial.structure.grades > 1
                share = RULES.transformer_gain_with_grades if bends else RULES.part_gain
                candidates.append(tried)
                gains.append(tried.trial.held_out / share)
            first = int(np.argmin(gains)) if gains else 0
            if not gains or not gains[first] < best.trial.held_out:
                break
            best, taken = candidates[first], set(left[first])
            # Other values of the same field have been tried too.
            left = [change for change in left if not taken & set(change)]
        return best

    def straightened(self, best: Tried) -> Tried:
        """Return the structure without a transformer, if graded elements make the error hardly larger without it."""
        structure = best.trial.structure
        if self.stopped or not structure.transformer or structure.grades == 1:
            return best
        simpler = replace(structure, transformer=0)
        known = next((tried for tried in self.done if tried.trial.structure == simpler), None)
        straight = known or self.tried(simpler, [], before=best)
        kept = straight is None or best.trial.held_out < RULES.transformer_gain_with_grades * straight.trial.held_out
        return best if kept or straight is None else straight

    def tried(
        self, structure: Structure, left: list[Change], place: int = -1, before: Tried | None = None
    ) -> Tried | None:
        """Try a structure, the one at this place of the changes that are left; None if the deadline passes."""
        # The first structure is tried before all changes.
        remaining = _most_trials(left) - max(place, 0) + (place < 0)
        self.most = len(self.done) + remaining + _most_trials(self.later)
        cut = f"the search for a structure after {len(self.done)} of up to {self.most} trials"
        tried = self.deadline.attempt(lambda: try_structure(self.build, structure, self._report, before), None, cut)
        self.stopped = tried is None
        self.done += [] if tried is None else [tried]
        return tried

    def _report(self, words: str) -> None:
        least = min((100 * tried.trial.held_out / self.stroke for tried in self.done), default=float("nan"))
        error = f"best held-out error {least:.2g} % of the stroke; " if np.isfinite(least) else ""
        self.progress(f"trial {len(self.done) + 1} (of up to {self.most}): {words}; {error}{self.deadline.clock}")


def _most_trials(left: list[Change]) -> int:
    """Return the most trials that can follow: all of these changes, and those left after any of them is taken."""
    rests = [[change for change in left if not set(taken) & set(change)] for taken in left]
    return len(left) + max(map(_most_trials, rests), default=0)


def try_structure(build: Build, structure: Structure, progress: Progress, before: Tried | None = None) -> Tried:
    """Cross-validate a structure, rows weighted by the inverse slopes of the model before."""
    progress(structure.words)
    begin = time.perf_counter()
    regression = build(structure)
    if before is None or before.weights is None:
        sums = weighted_alike(regression, _FOLDS)
    else:
        sums = FoldSums(regression, before.weights, before.nearby, _FOLDS)
    held_out, training = rms(sums.held_out_errors()), sums.training_error
    trial = StructureTrial(structure, held_out, training, time.perf_counter() - begin)
    return Tried(trial, sums.inverse_slopes, sums.handed_on())
