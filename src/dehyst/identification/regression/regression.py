"""From rows to a model: stiffnesses, spring slopes and the nuisances of each record, in one convex program.

    v = sum_i kappa_i s_i + sum_j slope_j R_j(y + d_q) + a_e + c_q L(t) + residual

R_j(y) is the part of y in segment j of the spring, the end segments being unbounded; kappa_i >= 0, slope_j >= floor
(Assumption I); a_e a constant for each epoch, d_q the datum and c_q the drift of record q.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.identification.preprocessing.regressors import Rows
from dehyst.identification.solvers.least_squares import triangle_of
from dehyst.identification.solvers.program import Norm, Solution, solve
from dehyst.model.elements import parts_in_segments, segment_of
from dehyst.records.metrics import rms


class Fitted(Protocol):
    """What any regression finds."""

    @property
    def solution(self) -> Solution:
        """The program's answer."""
        ...


Found = TypeVar("Found", bound=Fitted)


class AbstractRegression(ABC, Generic[Found]):
    """Rows whose voltages a program meets, whatever the class of the model.

    Attributes
    ----------
    rows : Rows
    datum : (records,) array
        d_q [m].
    drifting : tuple of int
        Records that get a drift.
    """

    rows: Rows
    datum: Array
    drifting: tuple[int, ...]

    @abstractmethod
    def fit(self, norm: Norm, weights: Array | None = None) -> Found:
        """Solve the program."""

    @abstractmethod
    def slope(self, found: Found) -> Array:
        """dv/dy of the model at each row (n,) [V/m]; the weight of a row is its inverse."""

    @cached_property
    def axis(self) -> Array:
        """Displacement of each row on the model's axis (n,)."""
        return self.rows.displacement + self.datum[self.rows.record]

    def nuisances(self, epochs: NDArray[np.intp] | None = None) -> Array:
        """Columns of the constants of these epochs, by default of those there are, then of the drifts."""
        numbers = np.unique(self.rows.epoch) if epochs is None else epochs
        constants = (self.rows.epoch[:, None] == numbers).astype(float)
        drifts = [np.where(self.rows.record == q, self.rows.drift, 0.0)[:, None] for q in self.drifting]
        return np.hstack([constants, *drifts])

    def constants(
        self, answer: Solution, epochs: NDArray[np.intp] | None = None
    ) -> tuple[dict[int, float], dict[int, float]]:
        """An answer's constants by epoch and drifts by record [V]; epochs as in `nuisances`."""
        numbers = np.unique(self.rows.epoch) if epochs is None else epochs
        offsets, drifts = answer.free[: numbers.size].tolist(), answer.free[numbers.size :].tolist()
        return dict(zip(numbers.tolist(), offsets, strict=True)), dict(zip(self.drifting, drifts, strict=True))

    def fit_weighted(self, norm: Norm, passes: int = 2) -> Found:
        """Fit with rows weighted by the inverse slope of the model that least-squares passes before it find."""
        weights = None
        for _ in range(passes - 1):
            weights = 1 / self.slope(self.fit("l2", weights))
        return self.fit(norm, weights)

    def rms(self, found: Found | None = None) -> float:
        """RMS residual [m] of a fit; by default of that by least squares."""
        fitted = self.fit("l2") if found is None else found
        return rms(fitted.solution.residual / self.slope(fitted))


@dataclass(frozen=True, eq=False)
class Regression(AbstractRegression["Coefficients"]):
    """What is fixed while coefficients are sought.

    Attributes
    ----------
    rows : Rows
    knots : (M,) array
        Knots of the spring [m].
    floor : float
        Least slope of the spring [V/m].
    movable : (N,) bool array
        Elements that slide in some record; the others are one with the spring and get no stiffness.
    datum : (records,) array
        d_q [m].
    drifting : tuple of int
        Records that get a drift.
    """

    rows: Rows
    knots: Array
    floor: float
    movable: NDArray[np.bool_]
    datum: Array
    drifting: tuple[int, ...] = ()

    def thinned(self, most: int) -> Regression:
        """The same on fewer rows, for searches."""
        return replace(self, rows=self.rows.thinned(most))

    def parts_of_spring(self, y: Array) -> Array:
        """R_j(y), shape (n, M - 1)."""
        return parts_in_segments(self.knots, y)

    def table(self, epochs: NDArray[np.intp]) -> tuple[Array, Array, Array]:
        """Free columns, with a constant for each of these epochs, columns that are not negative, and target."""
        spring = self.parts_of_spring(self.axis)
        bounded = np.hstack([self.rows.elongation[:, self.movable], spring])
        return self.nuisances(epochs), bounded, self.rows.voltage - self.floor * spring.sum(axis=1)

    def rest(self, model: Coefficients) -> Array:
        """Voltage less a model's, without constants and drifts (n,)."""
        spring = self.parts_of_spring(self.axis) @ model.slopes
        return np.asarray(self.rows.voltage - self.rows.elongation @ model.stiffness - spring)

    def coefficients(self, answer: Solution, epochs: NDArray[np.intp]) -> Coefficients:
        """What an answer to the program of `table` says."""
        stiffness, count = np.zeros(self.movable.size), int(np.count_nonzero(self.movable))
        stiffness[self.movable] = answer.nonnegative[:count]
        slopes = answer.nonnegative[count:] + self.floor
        return self.with_nuisances(Coefficients(stiffness, slopes, {}, {}, answer), answer, epochs)

    def with_nuisances(self, model: Coefficients, answer: Solution, epochs: NDArray[np.intp]) -> Coefficients:
        """A model with the constants and drifts of an answer."""
        offsets, drifts = self.constants(answer, epochs)
        return replace(model, offsets=offsets, drifts=drifts, solution=answer)

    def fit(self, norm: Norm, weights: Array | None = None, held: tuple[Array, Array] | None = None) -> Coefficients:
        """Solve the program; `held`: combinations (p, movable) of stiffnesses and their values [V], met besides."""
        epochs = np.unique(self.rows.epoch)
        free, bounded, target = self.table(epochs)
        if held is not None:
            combinations, values = held
            none = np.zeros((values.size, self.knots.size - 1))
            free = np.vstack([free, np.zeros((values.size, free.shape[1]))])
            bounded = np.vstack([bounded, np.hstack([combinations, none])])
            target = np.concatenate([target, values])
            own = np.ones(len(self.rows)) if weights is None else weights
            weights = np.concatenate([own, np.full(values.size, own.max() * np.sqrt(own.size))])
        return self.coefficients(solve(free, bounded, target, weights=weights, norm=norm), epochs)

    def slope(self, found: Coefficients) -> Array:
        """dv/dy of the model at each row (n,) [V/m]; the weight of a row is its inverse."""
        return np.asarray(self.rows.stuck @ found.stiffness + found.slopes[segment_of(self.knots, self.axis)])

    def datum_steps(self, records: list[int]) -> Array:
        """Changes of the datums [m] that a least-squares fit asks for, the spring linearised at the present ones."""
        found = self.fit("l2")
        y = self.axis
        slope = found.slopes[segment_of(self.knots, y)]
        shifts = np.column_stack([np.where(self.rows.record == q, slope, 0.0) for q in records])
        spring, slip = self.parts_of_spring(y), self.rows.elongation[:, self.movable]
        target = self.rows.voltage - self.floor * spring.sum(axis=1)
        answer = solve(np.hstack([self.nuisances(), shifts]), np.hstack([slip, spring]), target, norm="l2")
        return answer.free[-len(records) :]

    def nuisances_of(self, found: Coefficients) -> Coefficients:
        """Fit only the constants and drifts of these rows, for a model that is given."""
        none = np.zeros((len(self.rows), 0))
        answer = solve(self.nuisances(), none, self.rest(found), weights=1 / self.slope(found), norm="l2")
        return self.with_nuisances(found, answer, np.unique(self.rows.epoch))

    def projected(self, breakaway: Array) -> Array:
        """Columns of the movable elements over their rho, all others projected out: a triangle (m, m) at most."""
        others = np.hstack([self.nuisances(), self.parts_of_spring(self.axis)])
        others = others / np.maximum(np.abs(others).max(axis=0), np.finfo(float).tiny)
        slip = self.rows.elongation[:, self.movable] / breakaway[self.movable]
        triangle = triangle_of(np.hstack([others, slip]))
        return np.asarray(triangle[others.shape[1] :, others.shape[1] :])


@dataclass(frozen=True, eq=False)
class Coefficients:
    """What a regression found: (N,) kappa and (M - 1,) slopes [V/m], constants by epoch and drifts by record [V]."""

    stiffness: Array
    slopes: Array
    offsets: dict[int, float]
    drifts: dict[int, float]
    solution: Solution
