"""Least error of simulation: Gauss and Newton's steps from the convex solution, thresholds free.

The convex program makes the error of an equation small, on the path that was measured. Here a model runs alone, and
what it then misses is made small: each step linearises the simulation and solves the same program for what is left,
with the same floors, inequalities and likeness of neighbours. It is kept only if it is better on unseen cycles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.identification.regression.coefficients import Coefficients
from dehyst.identification.regression.regression import Regression
from dehyst.identification.simulation_error import SimulationError
from dehyst.identification.solvers.program import solve
from dehyst.identification.structure_selection import blocks
from dehyst.identification.structured_fit import StructuredFit
from dehyst.model import Actuator
from dehyst.model.structure import Grid
from dehyst.records.metrics import rms

_STEPS = 3
_ROWS = 6000
# Parts of a step that are tried, and the fall of the error that is worth another step, and the whole.
_PARTS = (1.0, 0.5, 0.2, 0.05)
_WORTH = 0.99
# Of each third block, which tell whether it helped.
_FOLDS = 3
# Differences are taken over this part of a coefficient, or of the largest of its kind; thresholds move by fractions.
_DIFFERENCE = 1e-3
# A threshold that moves by this fraction costs as much as an error of the noise's size at every sample, and none
# moves further than this part of the way to its neighbour.
_MOVING, _CLOSEST = 0.1, 0.4


@dataclass(frozen=True, eq=False)
class Refinement:
    """What came of it.

    Attributes
    ----------
    actuator : Actuator
        The refined one, or the one given.
    kept : bool
    before, after : float
        RMS error of simulation [m] on the cycles held out, of the model given, which saw them, and of one that did not.
    """

    actuator: Actuator
    kept: bool
    before: float
    after: float


def refine(made: StructuredFit, tell: Callable[[str], None]) -> Refinement:
    """Refine a wider actuator by the simulated error of its training records."""
    point = _Iterate.of(made)
    errors = point.errors()
    held_out = blocks(point.playback.voltage(), point.playback.stretch()) % _FOLDS == _FOLDS - 1
    before = rms(errors[held_out])
    if not held_out.any() or held_out.all():
        return Refinement(made.actuator, False, before, before)
    tell("refining in simulation")
    after = rms(_descended(point, ~held_out).errors()[held_out])
    if not after < _WORTH * before:
        return Refinement(made.actuator, False, before, after)
    tell("refining in simulation, with every cycle")
    return Refinement(_descended(point, np.ones_like(held_out)).actuator, True, before, after)


def _descended(point: _Iterate, seen: NDArray[np.bool_]) -> _Iterate:
    """The point after some steps on the samples seen."""
    error = rms(point.errors()[seen])
    for _ in range(_STEPS):
        aim, moves = point.aim(seen)
        tried = [point.towards(aim, moves, part) for part in _PARTS]
        least = min(tried, key=lambda one: rms(one.errors()[seen]))
        now = rms(least.errors()[seen])
        if not now < error:
            break
        worth = now < _WORTH * error
        point, error = least, now
        if not worth:
            break
    return point


@dataclass(frozen=True, eq=False)
class _Iterate:
    """Coefficients and thresholds, and the actuator that they make.

    Attributes
    ----------
    given : Actuator
        Whose parts lie on the grid of `regression`.
    regression : Regression
        Of which all but the rows counts.
    x : (q,) array
        The program's unknowns that are not negative.
    breakaway : (N,) array
        [m].
    """

    given: Actuator
    regression: Regression
    playback: SimulationError
    x: Array
    breakaway: Array

    @classmethod
    def of(cls, made: StructuredFit) -> _Iterate:
        grid = Grid.of_actuator(made.actuator)
        regression = replace(made.regression, grid=grid, strained=(), lasting=None)
        x = np.concatenate(regression.unknowns(Coefficients.from_actuator(made.actuator)))
        return cls(made.actuator, regression, made.playback(), x, grid.breakaway)

    @property
    def actuator(self) -> Actuator:
        """The states of the playback have all its branches: none is left out, even if it holds nothing."""
        grid = replace(self.regression.grid, breakaway=self.breakaway)
        given, first = self.given, float(self.given.spring.voltage[0])
        return self.regression.at(self.x).to_actuator(
            grid, first, least=-1.0, dynamics=given.dynamics, lag=given.lag, delay=given.delay
        )

    def errors(self) -> Array:
        """Of every sample [m]."""
        return self.playback.errors(self.actuator)

    def aim(self, seen: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Unknowns (q,) and moves of the logarithms of thresholds (N,) that the linearised simulation asks for."""
        regression, errors = self.regression, self.errors()
        rows = np.flatnonzero(seen)
        rows = rows[:: max(1, rows.size // _ROWS)]
        by_x, by_rho = self._slopes(errors, rows)
        noise, movable = rms(errors[rows]), regression.grid.movable
        constants = np.eye(len(self.playback.stretches))[self.playback.stretch()[rows]]
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
        found = regression.constrained(
            lambda limits: solve(*table[:3], weights=table[3], norm="l2", constraints=limits)
        )
        moves = np.zeros(movable.size)
        moves[movable] = found.free[constants.shape[1] :]
        return found.nonnegative, moves

    def towards(self, aim: Array, moves: Array, part: float) -> _Iterate:
        """A part of the way there, thresholds in their order."""
        rho, room = self.breakaway, _CLOSEST * np.diff(self.breakaway, prepend=0.0)
        above = np.append(room[1:], 0.0)
        moved = rho + np.clip(part * moves * rho, -room, above)
        return replace(self, x=self.x + part * (aim - self.x), breakaway=moved)

    def _slopes(self, errors: Array, rows: NDArray[np.intp]) -> tuple[Array, Array]:
        """How the simulation changes with each unknown (n, q) and with each threshold's logarithm (n, N)."""
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
        """The size of each unknown (q,), or the largest of its kind if that is much larger."""
        kinds = self.regression.unknowns(self.regression.at(self.x))
        least = 1e-3 * self.regression.mean_slope
        return np.concatenate(
            [
                np.maximum(kind, max(0.1 * kind.max(initial=0.0), least if k < 3 else 1e-3))
                for k, kind in enumerate(kinds)
            ]
        )
