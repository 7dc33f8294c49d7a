"""Output-error refinement: Gauss-Newton steps on the simulation error from the convex solution, thresholds free.

The convex program minimises the error of an equation on the measured path. Here the error of a free-running simulation
is minimised: each step linearises the simulation and solves the same program for the remaining error, with the same
floors, inequalities and regularisation. The result is kept only if it is better on held-out cycles.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array, Progress
from dehyst.identification.regression.coefficients import Coefficients
from dehyst.identification.regression.fold_sums import blocks
from dehyst.identification.regression.regression import Regression
from dehyst.identification.simulation_error import SimulationError
from dehyst.identification.solvers.program import solve
from dehyst.identification.structured_fit import StructuredFit
from dehyst.model import Actuator
from dehyst.model.structure import Grid
from dehyst.records.metrics import rms

_STEPS = 3
_ROWS = 6000
# Parts of a step that are tried; the share to which another step, and the refinement, must reduce the error.
_PARTS = (1.0, 0.5, 0.2, 0.05)
_WORTH = 0.99
# One of so many blocks is held out to judge the refinement.
_FOLDS = 3
# Finite differences, as a part of a coefficient, of the largest of its kind, or of a threshold.
_DIFFERENCE = 1e-3
# A threshold that moves by this fraction costs as much as an error of the noise's size at every sample; no threshold
# moves further than this part of the distance to its neighbour.
_MOVING, _CLOSEST = 0.1, 0.4


@dataclass(frozen=True, eq=False)
class Refinement:
    """The result of a refinement.

    Attributes
    ----------
    actuator : Actuator
        The refined actuator, or the original.
    kept : bool
    before, after : float
        RMS error of simulation [m] on held-out cycles, of the original, which was fitted to them, and of a refined
        model that was not.
    """

    actuator: Actuator
    kept: bool
    before: float
    after: float


def refine(fit: StructuredFit, progress: Progress) -> Refinement:
    """Refine a wider actuator by the simulation error on its training records."""
    point = _Iterate.of(fit)
    errors = point.errors()
    held_out = blocks(point.simulation.voltage(), point.simulation.epoch_numbers()) % _FOLDS == _FOLDS - 1
    before = rms(errors[held_out])
    if not held_out.any() or held_out.all():
        return Refinement(fit.actuator, False, before, before)
    progress("refining in simulation")
    after = rms(_after_steps(point, ~held_out).errors()[held_out])
    if not after < _WORTH * before:
        return Refinement(fit.actuator, False, before, after)
    progress("refining in simulation, with every cycle")
    return Refinement(_after_steps(point, np.ones_like(held_out)).actuator, True, before, after)


def _after_steps(point: _Iterate, used: NDArray[np.bool_]) -> _Iterate:
    """Return the point after some steps on the used samples."""
    error = rms(point.errors()[used])
    for _ in range(_STEPS):
        aim, moves = point.aim(used)
        tried = [point.step(aim, moves, part) for part in _PARTS]
        least = min(tried, key=lambda candidate: rms(candidate.errors()[used]))
        now = rms(least.errors()[used])
        if not now < error:
            break
        worth = now < _WORTH * error
        point, error = least, now
        if not worth:
            break
    return point


@dataclass(frozen=True, eq=False)
class _Iterate:
    """Coefficients and thresholds, and their actuator.

    Attributes
    ----------
    given : Actuator
        Its parts lie on the grid of `regression`.
    regression : Regression
        Its rows are not used.
    x : (q,) array
        Unknowns of the program that are not negative.
    breakaway : (N,) array
        [m].
    """

    given: Actuator
    regression: Regression
    simulation: SimulationError
    x: Array
    breakaway: Array

    @classmethod
    def of(cls, fit: StructuredFit) -> _Iterate:
        grid = Grid.of_actuator(fit.actuator)
        regression = replace(fit.regression, grid=grid, strained=(), lasting=None)
        x = np.concatenate(regression.unknowns(Coefficients.from_actuator(fit.actuator)))
        return cls(fit.actuator, regression, fit.playback(), x, grid.breakaway)

    @property
    def actuator(self) -> Actuator:
        """The actuator with all branches, even those that hold nothing: the start states contain them."""
        grid = replace(self.regression.grid, breakaway=self.breakaway)
        given, first = self.given, float(self.given.spring.voltage[0])
        return self.regression.at(self.x).to_actuator(
            grid, first, least=-1.0, dynamics=given.dynamics, lag=given.lag, delay=given.delay
        )

    def errors(self) -> Array:
        """Return the error of every sample [m]."""
        return self.simulation.errors(self.actuator)

    def aim(self, used: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Return the solution of the linearised problem: unknowns (q,), moves of the thresholds' logarithms (N,)."""
        regression, errors = self.regression, self.errors()
        rows = np.flatnonzero(used)
        rows = rows[:: max(1, rows.size // _ROWS)]
        by_x, by_rho = self._slopes(errors, rows)
        noise, movable = rms(errors[rows]), regression.grid.movable
        constants = np.eye(len(self.simulation.epochs))[self.simulation.epoch_numbers()[rows]]
        free = np.hstack([constants, by_rho[:, movable]])
        still = np.hstack([np.zeros((movable.sum(), constants.shape[1])), np.eye(movable.sum())])
        still *= noise * np.sqrt(rows.size) / _MOVING
        alike = regression.regularization("l2", rows.size, free.shape[1], 1 / regression.mean_slope)
        table = [
            np.vstack([free, still, alike[0]]),
            np.vstack([by_x, np.zeros((len(still), self.x.size)), alike[1]]),
            np.concatenate([errors[rows] + by_x @ self.x, np.zeros(len(still)), alike[2]]),
            np.concatenate([np.ones(rows.size + len(still)), alike[3]]),
        ]
        solution = regression.constrained(
            lambda limits: solve(*table[:3], weights=table[3], norm="l2", constraints=limits)
        )
        moves = np.zeros(movable.size)
        moves[movable] = solution.free[constants.shape[1] :]
        return solution.nonnegative, moves

    def step(self, aim: Array, moves: Array, part: float) -> _Iterate:
        """Take a part of the step, with thresholds in their order."""
        rho, room = self.breakaway, _CLOSEST * np.diff(self.breakaway, prepend=0.0)
        above = np.append(room[1:], 0.0)
        breakaway = rho + np.clip(part * moves * rho, -room, above)
        return replace(self, x=self.x + part * (aim - self.x), breakaway=breakaway)

    def _slopes(self, errors: Array, rows: NDArray[np.intp]) -> tuple[Array, Array]:
        """Differentiate the simulation by each unknown (n, q) and by each threshold's logarithm (n, N)."""
        by_x = np.empty((rows.size, self.x.size))
        for k, step in enumerate(_DIFFERENCE * self._sizes()):
            x = self.x.copy()
            x[k] += step
            by_x[:, k] = (errors - replace(self, x=x).errors())[rows] / step
        by_rho = np.zeros((rows.size, self.breakaway.size))
        for i in np.flatnonzero(self.regression.grid.movable):
            rho = self.breakaway.copy()
            rho[i] *= 1 + _DIFFERENCE
            by_rho[:, i] = (errors - replace(self, breakaway=rho).errors())[rows] / _DIFFERENCE
        return by_x, by_rho

    def _sizes(self) -> Array:
        """Return the size of each unknown (q,), at least a part of the largest of its kind."""
        kinds = self.regression.unknowns(self.regression.at(self.x))
        least = 1e-3 * self.regression.mean_slope
        return np.concatenate(
            [
                np.maximum(kind, max(0.1 * kind.max(initial=0.0), least if k < 3 else 1e-3))
                for k, kind in enumerate(kinds)
            ]
        )
