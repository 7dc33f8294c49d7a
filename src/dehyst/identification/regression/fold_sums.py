"""Cross-validation by sums: a fit without a fold needs the sums over all rows less those over the fold."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array, Mask
from dehyst.identification.regression.coefficients import Coefficients
from dehyst.identification.regression.regression import Regression
from dehyst.identification.solvers.least_squares import ActiveSet, NormalEquations
from dehyst.identification.solvers.program import Solution
from dehyst.records.signals import rms, turning_points

_FOLDS = 3
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
        """Return the same for other unknowns: kinds of as many unknowns as here, and the whole spring."""
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
    first fit starts from them. `folds`: parts of the rows. `given` (n,) int: the fold of each row.
    """

    regression: Regression
    weights: Array
    nearby: Nearby | None = None
    folds: int = _FOLDS
    given: NDArray[np.intp] | None = None

    @cached_property
    def fold(self) -> NDArray[np.intp]:
        """Fold of each row (n,): `given`, or every third cycle."""
        if self.given is not None:
            return self.given
        rows = self.regression.rows
        return blocks(rows.voltage, rows.epoch) % self.folds

    @cached_property
    def _columns(self) -> tuple[Array, int]:
        """All columns (n, q), the free ones first, and how many are free."""
        free, bounded, _ = self.regression.table()
        return np.hstack([free, bounded]), free.shape[1]

    @cached_property
    def _sums(self) -> list[NormalEquations]:
        columns, free = self._columns
        target, sums = self.regression.target, []
        if self.folds == 1:
            return [NormalEquations.of_rows(columns * self.weights[:, None], target * self.weights, free)]
        for k in range(self.folds):
            rows, weights = np.flatnonzero(self.fold == k), self.weights[self.fold == k]
            sums.append(NormalEquations.of_rows(columns[rows] * weights[:, None], target[rows] * weights, free))
        return sums

    @cached_property
    def _regularization(self) -> NormalEquations:
        """Sums of the regularisation beside one row."""
        free = self._columns[1]
        none, rows, target, weights = self.regression.regularization("l2", 1, free, 1 / self.regression.mean_slope)
        return NormalEquations.of_rows(np.hstack([none, rows]) * weights[:, None], target * weights, free)

    @cached_property
    def whole(self) -> Coefficients:
        """Fit of all rows."""
        return self._fit(np.ones(len(self.weights), dtype=bool), sum_of(self._sums), None)

    @cached_property
    def inverse_slopes(self) -> Array:
        """Inverse slopes of the fit of all rows (n,) [m/V]: weights for a structure nearby."""
        return np.asarray(1 / self.regression.slope(self.whole))

    def handed_on(self) -> Nearby:
        """Return the unknowns that are not zero in the fit of all rows."""
        active_set = self.whole.solved.active_set
        moving = np.zeros(0, dtype=bool) if active_set is None else active_set.moving[self._columns[1] :]
        return Nearby(self.regression.places(), moving)

    @property
    def _start(self) -> ActiveSet | None:
        if self.nearby is None:
            return None
        columns, free = self._columns
        moving = np.ones(columns.shape[1], dtype=bool)
        moving[free:] = self.nearby.moving_of(self.regression.places(), columns.shape[1] - free)
        return ActiveSet(moving, np.zeros(0, dtype=bool))

    def without(self, k: int) -> Coefficients | None:
        """Fit all rows but those of a fold; None if no other row is left."""
        used = self.fold != k
        return self._fit(used, sum_of(self._sums) - self._sums[k], self.whole) if used.any() else None

    def training_error(self) -> float:
        """Return the RMS error of the fit of all rows [m]."""
        return rms(self.residual() * self.inverse_slopes)

    def residual(self) -> Array:
        """Return the residual of the fit of all rows (n,) [V]."""
        return np.asarray(self._columns[0] @ _unknowns(self.whole) - self.regression.target)

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
        out, coefficients = self.fold == k, self.without(k)
        if coefficients is None or not out.any():
            return None
        left = self._columns[0][out] @ _unknowns(coefficients) - self.regression.target[out]
        epochs = self.regression.rows.epoch[out]
        for epoch in np.setdiff1d(epochs, self.regression.rows.epoch[~out]):
            left[epochs == epoch] -= np.median(left[epochs == epoch])
        return np.asarray(left / self.regression.chosen(out).slope(coefficients))

    def _fit(self, used: Mask, sums: NormalEquations, like: Coefficients | None) -> Coefficients:
        """Fit rows whose sums are given, from the active set and inequalities of another fit."""
        some = self._regularization
        count, free = int(np.count_nonzero(used)), self._columns[1]
        program = replace(sums, gram=sums.gram + count * some.gram)
        start = self._start if like is None else like.solved.active_set

        def solver(limits: tuple[Array, Array] | None) -> Solution:
            nonlocal start
            none = np.zeros((0, program.image.size)), np.zeros(0)
            x, start = program.minimum(none if limits is None else limits, start)
            return Solution(x[:free], x[free:], np.zeros(0), True, "", 0.0, active_set=start)

        return self.regression.solved_with(solver, like=like)


def sum_of(parts: list[NormalEquations]) -> NormalEquations:
    """Return the sum of normal equations."""
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return total


def _unknowns(found: Coefficients) -> Array:
    return np.concatenate([found.solved.free, found.solved.nonnegative])


def first_weights(regression: Regression) -> Array:
    """Return the inverse slopes of a first fit, in which all rows weigh the same (n,) [m/V]."""
    return _of_equal_weights(regression, None).inverse_slopes


def least_squares_of_sums(regression: Regression) -> Coefficients:
    """Fit the rows of a regression, weighted by the inverse slope of a first fit, by their sums alone: quickly."""
    found = FoldSums(regression, first_weights(regression), folds=1).whole
    return replace(found, solution=replace(found.solved, status="optimal (normal equations)"))


def nearly_least_absolute(regression: Regression, weights: Array) -> Coefficients:
    """Fit by least squares whose rows weigh less the more they are missed: nearly the weighted L1 fit, and quickly."""
    found = FoldSums(regression, weights, folds=1)
    for _ in range(_REWEIGHTED):
        missed = np.abs(found.residual() * weights)
        least = _LEAST_MISSED * float(np.median(missed))
        milder = weights * np.sqrt(np.median(missed) / np.maximum(missed, least))
        found = FoldSums(regression, milder, found.handed_on(), folds=1)
    return found.whole


class TrainingErrors:
    """Training errors of regressions nearby, for a search: each fit starts from the active set of the one before."""

    def __init__(self) -> None:
        self._nearby: Nearby | None = None

    def __call__(self, regression: Regression) -> float:
        """Return the RMS residual of the least-squares fit [m]."""
        sums = _of_equal_weights(regression, self._nearby)
        error = sums.training_error()
        self._nearby = sums.handed_on()
        return error


def _of_equal_weights(regression: Regression, nearby: Nearby | None) -> FoldSums:
    return FoldSums(regression, np.full(len(regression.rows), 1 / regression.mean_slope), nearby, 1)


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
