"""Feasible parameter set: bounds of the model's numbers that are consistent with the records.

The feasible set contains all coefficients that fit the records nearly as well as the model does. Linear programs find
the largest and the smallest stiffness, spring voltage, and voltage at points of a trajectory in this set. Each optimum
is a model; simulated along the trajectory, these models show the possible effect of open directions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import IdentifyError
from dehyst._native import slip_elongations
from dehyst._threads import one_thread
from dehyst._types import Array
from dehyst.identification import Coefficients, Regression, linear_programs
from dehyst.model import Actuator, State, parts_in_segments
from dehyst.records import turning_points
from dehyst.trust.evidence import Evidence

# Rows are means of neighbours on one leg, so that noise does not make the tolerance.
_ROWS = 300
# A model may miss a mean as far as the identified one does there, or by this many times its average misfit.
_TOLERANCE = 3.0
# The sum of absolute misfits may be this much larger than the identified model's.
_TOTAL = 1.2
_PLACES = 40
# Below this part of the voltage's range a tolerance is a matter of rounding.
_ROUNDING = 1e-7


@dataclass(frozen=True, eq=False)
class FeasibleSet:
    """Feasible parameter set: bounds of a model's numbers that are consistent with the records.

    Attributes
    ----------
    actuator : Actuator
        The identified model.
    stiffness : (2, N) array
        Lowest and highest kappa_i [V/m].
    spring : (2, M) array
        Lowest and highest voltage of the spring at its knots, relative to the first knot [V].
    slopes : (2, M - 1) array
        Lowest and highest slope of the spring's segments [V/m].
    actuators : tuple of Actuator
        Two for each point of the trajectory: the models with the smallest and the largest voltage there.
    tolerance : float
        Allowed misfit, averaged over the records [V].
    """

    actuator: Actuator
    stiffness: Array
    spring: Array
    slopes: Array
    actuators: tuple[Actuator, ...]
    tolerance: float

    def prediction(self, voltage: Array, state: Callable[[Actuator], State]) -> Array:
        """Return the lowest and highest displacement (2, n) [m] of these models for a voltage (n,) [V]."""
        every = (self.actuator, *self.actuators)
        paths = np.array([a.simulate(voltage, state=state(a), extrapolate=True).displacement for a in every])
        return np.array([paths.min(axis=0), paths.max(axis=0)])


def feasible_set(
    evidence: Evidence, displacement: Array | None = None, state: State | None = None
) -> FeasibleSet | None:
    """Compute feasible bounds of each coefficient, and of the voltage at some points of a path.

    Returns None for other models than Maxwell-slip ones, because columns of other parts depend on more than the path.

    Parameters
    ----------
    evidence : Evidence
    displacement : (n,) array, optional
        The path [m], on the model's axis.
    state : State, optional
        Fully known initial state of the path; default: the model's own.

    Raises
    ------
    IdentifyError
        If the linear programs have no solution.
    """
    if evidence.identifiability.probing:
        return None
    polytope = _Polytope.of(evidence)
    actuator, regression = evidence.actuator, evidence.regression
    numbers = _numbers(regression, polytope.rows.shape[1])
    path = np.zeros((0, polytope.rows.shape[1]))
    if displacement is not None:
        path = _costs(evidence, displacement, actuator.state if state is None else state)
    with one_thread():
        extremes = polytope.extremes(np.vstack([numbers, path]))
    if not any(x is not None for pair in extremes for x in pair):
        raise IdentifyError(
            "no model fits these records as well as the identified one; check that they belong to the same actuator"
        )
    count = int(np.count_nonzero(regression.grid.movable))
    ranges = _ranges(numbers, extremes[: len(numbers)], _vector(evidence, evidence.model))
    stiffness = np.tile(actuator.slip.stiffness, (2, 1))
    stiffness[:, regression.grid.movable] = ranges[:, :count]
    spring, slopes = np.split(ranges[:, count:], 2, axis=1)
    found = [
        evidence.actuator_of(_coefficients(evidence, x))
        for pair in extremes[len(numbers) :]
        for x in pair
        if x is not None
    ]
    risen = np.hstack([np.zeros((2, 1)), spring])
    return FeasibleSet(actuator, stiffness, risen, slopes, tuple(found), float(polytope.tolerance.mean()))


def _numbers(regression: Regression, unknowns: int) -> Array:
    """Return cost vectors that select each stiffness, spring voltage (relative to the first knot) and slope."""
    count, segments = int(np.count_nonzero(regression.grid.movable)), regression.grid.knots.size - 1
    costs = np.zeros((count + 2 * segments, unknowns))
    costs[:count, :count] = np.eye(count)
    spring = slice(count, count + segments)
    costs[spring, spring] = np.tril(np.tile(np.diff(regression.grid.knots), (segments, 1)))
    costs[count + segments :, spring] = np.eye(segments)
    return costs


def _ranges(costs: Array, extremes: list[tuple[Array | None, Array | None]], model: Array) -> Array:
    """Return the least and the largest value of each cost (2, p); the model's own value where there is no optimum."""
    ends = [[cost @ (model if x is None else x) for x in pair] for cost, pair in zip(costs, extremes, strict=True)]
    both = np.array([[*pair, cost @ model] for pair, cost in zip(ends, costs, strict=True)]).T
    return np.array([both.min(axis=0), both.max(axis=0)])


@dataclass(frozen=True, eq=False)
class _Polytope:
    """The feasible coefficients: each mean residual within the tolerance, and their sum nearly as small as the model's.

    Residuals are split into two parts, ``rows x + over - under = goal``; both are within the tolerance, and their sum
    is bounded.
    """

    rows: Array
    goal: Array
    weights: Array
    lower: Array
    tolerance: Array
    total: float

    @classmethod
    def of(cls, evidence: Evidence) -> _Polytope:
        regression = evidence.regression
        rows, goal, weights = _means(evidence)
        # Residuals in volts at the mean slope, whatever the slope where they are.
        weights = weights / np.median(weights)
        residual = np.abs((rows @ _vector(evidence, evidence.model) - goal) * weights)
        rounding = _ROUNDING * float(np.ptp(goal))
        tolerance = np.maximum(residual, max(_TOLERANCE * float(residual.mean()), rounding))
        total = max(_TOTAL * float(residual.sum()), rounding * len(goal))
        lower = np.full(rows.shape[1], -np.inf)
        count = int(np.count_nonzero(regression.grid.movable))
        lower[:count] = 0.0
        # A model that lies lower than the floor itself, as the paper's method may leave it, stays possible.
        spring = slice(count, count + regression.grid.knots.size - 1)
        lower[spring] = np.minimum(regression.floor, 0.5 * evidence.model.slopes)
        return cls(rows, goal, weights, lower, tolerance, total)

    def extremes(self, costs: Array) -> list[tuple[Array | None, Array | None]]:
        """Return the minimiser and the maximiser of each cost (rows); None where a program could not be solved."""
        n, unknowns = self.rows.shape
        scale = np.abs(self.rows).max(axis=0, initial=0.0)
        scale[scale == 0] = 1.0
        size = float(np.abs(self.goal * self.weights).max(initial=0.0)) or 1.0
        balance = np.hstack([self.rows / scale * self.weights[:, None], np.eye(n), -np.eye(n)])
        matrix = np.vstack([balance, np.concatenate([np.zeros(unknowns), np.ones(2 * n)])])
        goal = self.goal * self.weights / size
        limits = np.append(goal, 0.0), np.append(goal, self.total / size)
        box = np.tile(self.tolerance / size, 2)
        bounds = np.concatenate([self.lower * scale / size, 0 * box]), np.concatenate([np.full(unknowns, np.inf), box])
        each = np.hstack([costs / scale, np.zeros((len(costs), 2 * n))])
        each /= np.abs(each).max(axis=1, keepdims=True)
        # All minima, then all maxima: neighbours in a row have optima that lie close to one another.
        answers = linear_programs(np.concatenate([each, -each]), bounds, matrix, limits)
        found = [answer.value[:unknowns] / scale * size if answer.optimal else None for answer in answers]
        return list(zip(found[: len(costs)], found[len(costs) :], strict=True))


def _columns(regression: Regression, elongation: Array, y: Array, nuisances: Array) -> Array:
    return np.hstack([elongation[:, regression.grid.movable], parts_in_segments(regression.grid.knots, y), nuisances])


def _means(evidence: Evidence) -> tuple[Array, Array, Array]:
    """Return rows, voltages and weights, each a mean over neighbours in one epoch and one leg."""
    regression = evidence.regression
    rows = regression.rows
    columns = _columns(regression, rows.elongation, regression.axis, regression.nuisances())
    # Stuck elements without a column keep their part.
    still = rows.elongation[:, ~regression.grid.movable] @ evidence.model.stiffness[~regression.grid.movable, 0]
    number = _groups(evidence)
    size = np.bincount(number).astype(float)
    mean = np.zeros((size.size, columns.shape[1] + 2))
    np.add.at(mean, number, np.column_stack([columns, rows.voltage - still, evidence.weights]))
    mean /= size[:, None]
    return mean[:, :-2], mean[:, -2], mean[:, -1]


def _groups(evidence: Evidence) -> NDArray[np.intp]:
    """Return the group of each row: runs of neighbours, cut at epochs and at turning points."""
    size, starts = len(evidence.regression.rows), evidence.leg_starts
    length = max(1, size // _ROWS)
    within = np.arange(size) - np.repeat(starts, np.diff(np.append(starts, size)))
    return np.cumsum(within % length == 0) - 1


def _vector(evidence: Evidence, found: Coefficients) -> Array:
    regression = evidence.regression
    constants = [found.offsets[epoch] for epoch in np.unique(regression.rows.epoch).tolist()]
    drifts = [found.drifts[q] for q in regression.drifting]
    return np.concatenate([found.stiffness[regression.grid.movable, 0], found.slopes, constants, drifts])


def _coefficients(evidence: Evidence, x: Array) -> Coefficients:
    regression, model = evidence.regression, evidence.model
    count, segments = int(np.count_nonzero(regression.grid.movable)), regression.grid.knots.size - 1
    stiffness = model.stiffness.copy()
    stiffness[regression.grid.movable, 0] = np.maximum(x[:count], 0.0)
    epochs = np.unique(regression.rows.epoch).tolist()
    offsets = x[count + segments : count + segments + len(epochs)]
    return replace(
        model,
        stiffness=stiffness,
        slopes=x[count : count + segments],
        offsets=dict(zip(epochs, offsets.tolist(), strict=True)),
    )


def _costs(evidence: Evidence, displacement: Array, state: State) -> Array:
    """Return the columns of the voltage at points of the path: turning points, middles of legs, and points between."""
    regression = evidence.regression
    y = np.ascontiguousarray(displacement)
    turns = [0, *turning_points(y, 0.01 * float(np.ptp(y))).tolist(), y.size - 1]
    middles = [(a + b) // 2 for a, b in pairwise(turns)]
    places = np.unique([*turns, *middles])
    if places.size > _PLACES:
        places = places[np.linspace(0, places.size - 1, _PLACES).astype(int)]
    elongation, _ = slip_elongations(evidence.actuator.slip.breakaway, state.carts, y)
    epochs = np.unique(regression.rows.epoch)
    nuisances = np.zeros((places.size, epochs.size + len(regression.drifting)))
    nuisances[:, int(np.flatnonzero(epochs == evidence.reference)[0])] = 1.0
    return _columns(regression, elongation[places], y[places], nuisances)
