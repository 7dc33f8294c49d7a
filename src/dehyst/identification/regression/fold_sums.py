"""Cross-validation by sums: a fit without a fold needs the sums over all rows less those over the fold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array, Mask
from dehyst.identification.regression.coefficients import Coefficients
from dehyst.identification.regression.regression import Regression
from dehyst.identification.solvers.least_squares import ActiveSet, NormalEquations
from dehyst.identification.solvers.program import Solution
from dehyst.records import rms, turning_points

# Least number of blocks of a record, so that a staircase of two long legs can be held out in parts.
_BLOCKS = 12
# Passes towards least absolute residuals; those below this part of the median one weigh alike.
_REWEIGHTED, _LEAST_MISSED = 3, 0.1


@dataclass(frozen=True, eq=False)
class Nearby:
    """Which unknowns that are not negative are above zero in a fit (q,), and the places of each kind."""

    places: dict[str, slice]
    moving: Mask

    def moving_of(self, places: dict[str, slice], count: int) -> Mask:
        """Return a copy for other unknowns: kinds with the same number of unknowns, and the whole spring."""
        moving = np.zeros(count, dtype=bool)
        for kind, place in places.items():
            same = self.places[kind]
            if same.stop - same.start == place.stop - place.start:
                moving[place] = self.moving[same]
            elif kind == "spring":
                moving[place] = True
        return moving


@dataclass(frozen=True, eq=False)
class FoldSums:
    """The rows of a regression, and their weighted sums by fold.

    `weights` (n,): of the rows, as for `Regression.fit`. `nearby`: the unknowns of a fit nearby that are not zero: the
    first fit starts from them. `folds`: parts of the rows. `given` (n,) int: the fold of each row; default: cycles in
    turn.
    """

    regression: Regression
    weights: Array
    nearby: Nearby | None = None
    folds: int = 1
    given: NDArray[np.intp] | None = None

    @cached_property
    def fold(self) -> NDArray[np.intp]:
        """Fold of each row (n,)."""
        rows = self.regression.rows
        return blocks(rows.voltage, rows.epoch) % self.folds if self.given is None else self.given

    @cached_property
    def _sums(self) -> list[NormalEquations]:
        (columns, free), target, weights = self.regression.columns, self.regression.target, self.weights
        parts = [slice(None)] if self.folds == 1 else [np.flatnonzero(self.fold == k) for k in range(self.folds)]
        return [
            NormalEquations.of_rows(columns[part] * weights[part, None], target[part] * weights[part], free)
            for part in parts
        ]

    @cached_property
    def _total(self) -> NormalEquations:
        return sum(self._sums[1:], self._sums[0])

    @cached_property
    def whole(self) -> Coefficients:
        """Fit of all rows."""
        return self._fit(self.weights.size, self._total, None)

    @cached_property
    def inverse_slopes(self) -> Array:
        """Inverse slopes of the fit of all rows (n,) [m/V]: weights for a structure nearby."""
        return np.asarray(1 / self.regression.slope(self.whole))

    @cached_property
    def residual(self) -> Array:
        """Residual of the fit of all rows (n,) [V]."""
        return self._left(slice(None), self.whole)

    @property
    def training_error(self) -> float:
        """RMS error of the fit of all rows [m]."""
        return rms(self.residual * self.inverse_slopes)

    def handed_on(self) -> Nearby:
        """Return the unknowns that are not zero in the fit of all rows."""
        active_set = self.whole.solved.active_set
        moving = np.zeros(0, dtype=bool) if active_set is None else active_set.moving[self.regression.columns[1] :]
        return Nearby(self._places, moving)

    @property
    def _places(self) -> dict[str, slice]:
        return self.regression.grid.places(len(self.regression.strained))

    def without(self, k: int) -> Coefficients | None:
        """Fit all rows except one fold; None if no other row is left."""
        count = int(np.count_nonzero(self.fold != k))
        return self._fit(count, self._total - self._sums[k], self.whole) if count else None

    def held_out_errors(self) -> Array:
        """Return the error of each row [m] in the fit without its fold."""
        errors = np.empty(self.fold.size)
        for k in range(self.folds):
            left = self.errors_of(k)
            if left is not None:
                errors[self.fold == k] = left
        return errors

    def errors_of(self, k: int) -> Array | None:
        """Return the errors of the rows of a fold [m] in the fit of the others; None if either has no row."""
        out, coefficients, rows = self.fold == k, self.without(k), self.regression.rows
        if coefficients is None or not out.any():
            return None
        left, epochs = self._left(out, coefficients), rows.epoch[out]
        for epoch in np.setdiff1d(epochs, rows.epoch[~out]):
            left[epochs == epoch] -= np.median(left[epochs == epoch])
        return np.asarray(left / self.regression.slope(coefficients, out))

    def _left(self, some: Mask | slice, found: Coefficients) -> Array:
        """Return what a fit leaves of some rows [V]."""
        unknowns = np.concatenate([found.solved.free, found.solved.nonnegative])
        return np.asarray(self.regression.columns[0][some] @ unknowns - self.regression.target[some])

    @cached_property
    def _regularization(self) -> Array:
        """Gram matrix of the regularisation beside one row."""
        free = self.regression.columns[1]
        none, rows, _, weights = self.regression.regularization("l2", 1, free, 1 / self.regression.mean_slope)
        rows = np.hstack([none, rows]) * weights[:, None]
        return np.asarray(rows.T @ rows)

    def _fit(self, count: int, sums: NormalEquations, like: Coefficients | None) -> Coefficients:
        """Fit some rows by their sums, from the active set and inequalities of another fit."""
        columns, free = self.regression.columns
        program = replace(sums, gram=sums.gram + count * self._regularization)
        start = None
        if like is not None:
            start = like.solved.active_set
        elif self.nearby is not None:
            moving = np.ones(columns.shape[1], dtype=bool)
            moving[free:] = self.nearby.moving_of(self._places, columns.shape[1] - free)
            start = ActiveSet(moving, np.zeros(0, dtype=bool))

        def solver(limits: tuple[Array, Array] | None) -> Solution:
            nonlocal start
            none = np.zeros((0, program.image.size)), np.zeros(0)
            x, start = program.minimum(none if limits is None else limits, start)
            return Solution(x[:free], x[free:], np.zeros(0), True, "", 0.0, active_set=start)

        return self.regression.solved_with(solver, like)


def equally_weighted(regression: Regression, nearby: Nearby | None = None) -> FoldSums:
    """Return a first fit, in which all rows weigh the same; its `inverse_slopes` are weights for others."""
    return FoldSums(regression, np.full(len(regression.rows), 1 / regression.mean_slope), nearby)


def weighted_alike(regression: Regression, folds: int = 1, given: NDArray[np.intp] | None = None) -> FoldSums:
    """Return a fit of rows that are weighted by the inverse slopes of a first one."""
    return FoldSums(regression, equally_weighted(regression).inverse_slopes, None, folds, given)


def least_squares_of_sums(regression: Regression) -> Coefficients:
    """Fit the rows of a regression, weighted by the inverse slope of a first fit, by their sums alone: quickly."""
    found = weighted_alike(regression).whole
    return replace(found, solution=replace(found.solved, status="optimal (normal equations)"))


def nearly_least_absolute(before: FoldSums) -> Coefficients:
    """Fit by reweighted least squares, with less weight for larger errors: a fast approximation of the L1 fit.

    `before`: a fit of the same rows with the weights of the L1 fit.
    """
    weights, found = before.weights, before
    for _ in range(_REWEIGHTED):
        missed = np.abs(found.residual * weights)
        least = _LEAST_MISSED * float(np.median(missed))
        milder = weights * np.sqrt(np.median(missed) / np.maximum(missed, least))
        found = FoldSums(before.regression, milder, found.handed_on())
    return found.whole


def training_errors() -> Callable[[Regression], float]:
    """Return a function of the RMS residual of least-squares fits [m], for a search through regressions nearby.

    Each fit starts from the active set of the one before.
    """
    nearby: Nearby | None = None

    def error(regression: Regression) -> float:
        nonlocal nearby
        sums = equally_weighted(regression, nearby)
        found = sums.training_error
        nearby = sums.handed_on()
        return found

    return error


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
