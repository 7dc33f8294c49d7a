"""The fit of one structure: the convex program, tuned and refined by simulation.

The convex program minimises the error of an equation on the measured path. Output-error refinement minimises that of a
free-running simulation, by Gauss-Newton steps from the convex solution with free thresholds: each step linearises the
simulation and solves the same program for the remaining error, with the same floors, inequalities and regularisation.
The result is kept only if it is better on held-out cycles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import exp

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array, Mask, Progress
from dehyst.identification.preprocessing.denoising import significant_delay
from dehyst.identification.preprocessing.preparation import Prepared
from dehyst.identification.preprocessing.regressors import Epoch
from dehyst.identification.regression import fold_sums
from dehyst.identification.regression.coefficients import Coefficients
from dehyst.identification.regression.regression import Regression
from dehyst.identification.rules import RULES
from dehyst.identification.solvers.program import Norm, solve
from dehyst.identification.structure import Grid, Structure
from dehyst.identification.training_data import Lagging, TrainingData
from dehyst.identification.validation import compare, without_offset
from dehyst.model import Actuator, Dynamics, State
from dehyst.records import Record, rms

# The program and the simulation agree on dynamics after so many rounds.
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class StructuredFit:
    """The fit of a structure to the records.

    `found`: of an actuator only if its solution is optimal.
    """

    frame: TrainingData
    structure: Structure
    norm: Norm
    regression: Regression
    found: Coefficients

    @classmethod
    def solve(cls, frame: TrainingData, structure: Structure, norm: Norm) -> StructuredFit:
        """Solve the program of all rows."""
        regression = frame.regression(structure)
        if regression.whole:
            weighted = fold_sums.FoldSums(regression, fold_sums.weighted_alike(regression).inverse_slopes)
            found = regression.fit(norm, weighted.weights, like=fold_sums.nearly_least_absolute(weighted))
        else:
            found = regression.fit_weighted(norm)
        return cls(frame, structure, norm, regression, found)

    @classmethod
    def solve_quickly(cls, frame: TrainingData, structure: Structure) -> StructuredFit:
        """Solve the program by least squares, of the rows that fit in memory."""
        regression = frame.regression(structure)
        return cls(frame, structure, "l2", regression, fold_sums.least_squares_of_sums(regression))

    @cached_property
    def actuator(self) -> Actuator:
        """Without limits and name."""
        return self.frame.actuator_of(self.regression, self.found)

    def playback(self) -> SimulationError:
        """Return the training records, to be simulated."""
        return SimulationError.of(self.actuator, self.frame.training, self.regression.datum, self.frame.stroke)

    def tune_dynamics(self, report: Progress) -> StructuredFit:
        """Return a copy with the dynamics that simulate the records best, if they improve the simulation."""
        best, playback = self, self.playback()
        error = rms(playback.errors(self.actuator))
        for _ in range(_ROUNDS):
            report("tuning the resonance in simulation")
            tuned = tune_resonance(best.actuator, playback)
            frame = replace(best.frame, lagging=Lagging(tuned.delay, tuned.lag, tuned.dynamics))
            trial = StructuredFit.solve(frame, self.structure, self.norm)
            if not trial.found.solved.optimal:
                return best
            playback = trial.playback()
            now = rms(playback.errors(trial.actuator))
            if now > RULES.resonance_gain * error:
                return trial if now < error else best
            best, error = trial, now
        return best


@dataclass(frozen=True, eq=False)
class FinalEpoch:
    """The last epoch of one piece of a record.

    `number`: number of the piece. `state`: at its first sample, on the model's axis. `offset`: offset of its voltages
    [V]. `datum`: datum of its displacements [m].
    """

    record: Prepared
    number: int
    epoch: Epoch
    state: State
    offset: float
    datum: float
    _cache: dict[tuple[float, float], Record] = field(default_factory=dict, init=False, repr=False)

    def piece(self, delay: float, lag: float = 0.0) -> Record:
        """Return its samples with acting voltages, their offset included."""
        if (delay, lag) not in self._cache:
            whole = list(self.record.acting(delay, lag))[self.number]
            self._cache.clear()
            self._cache[delay, lag] = whole.slice(self.epoch.start, self.epoch.stop)
        return self._cache[delay, lag]

    def error(self, actuator: Actuator) -> Array:
        """Return measured minus simulated displacement (n,) [m], mean zero."""
        piece, rho = self.piece(actuator.delay, actuator.lag), actuator.slip.breakaway
        actuator = replace(actuator, lag=0.0)
        y = self.state.displacement
        start = replace(self.state, carts=np.clip(self.state.carts, y - rho, y + rho))
        time = piece.time if actuator.needs_time else None
        voltage = without_offset(actuator, piece.voltage, self.offset)
        played = actuator.simulate(voltage, time=time, state=start, extrapolate=True)
        error = piece.displacement + self.datum - played.displacement
        if piece.counted is None:
            return np.asarray(error - error.mean())
        return np.asarray(np.where(piece.counted, error - error[piece.counted].mean(), 0.0))


@dataclass(frozen=True, eq=False)
class SimulationError:
    """The last epochs of records, from whose start states models of the same structure are simulated."""

    epochs: tuple[FinalEpoch, ...]

    @classmethod
    def of(cls, actuator: Actuator, records: Sequence[Prepared], datum: Array, stroke: float) -> SimulationError:
        """Find states and offsets by comparison with an actuator; `datum` [m] of each record."""
        finals = []
        for record, shift in zip(records, datum.tolist(), strict=True):
            compared = compare(actuator, record, stroke, datum=shift)
            for number, (own, offset) in enumerate(zip(compared.epochs, compared.last_offsets(), strict=True)):
                if own:
                    state = compared.state_before(actuator, number, own[-1]).shifted(shift)
                    finals.append(FinalEpoch(record, number, own[-1], state, offset, shift))
        return cls(tuple(finals))

    def errors(self, actuator: Actuator) -> Array:
        """Return the error of every sample (n,) [m], mean zero in each epoch."""
        return np.concatenate([epoch.error(actuator) for epoch in self.epochs])

    @cached_property
    def numbers(self) -> NDArray[np.intp]:
        """Number of the epoch of every sample (n,)."""
        sizes = [epoch.epoch.stop - epoch.epoch.start for epoch in self.epochs]
        return np.repeat(np.arange(len(sizes)), sizes)


# Start of the search for the lag [1/omega], and its finite differences.
_FIRST_LAG = 0.05
_STEP = 1e-3


def tune_resonance(actuator: Actuator, simulation: SimulationError) -> Actuator:
    """Return the actuator with the dynamics, delay and lag of least RMS simulation error, by least squares.

    `simulation`: of records in which the actuator rings. Without dynamics the actuator is returned as it is.
    """
    without = _tuned(actuator, simulation, lagging=False)
    lagging = _tuned(without, simulation, lagging=True)
    worth = rms(simulation.errors(lagging)) < RULES.amplifier_lag_gain * rms(simulation.errors(without))
    return lagging if worth else without


def _tuned(actuator: Actuator, simulation: SimulationError, *, lagging: bool) -> Actuator:
    from scipy.optimize import least_squares

    start = actuator.dynamics
    if start is None:
        return actuator
    unit = 1 / start.frequency

    def with_numbers(x: Array) -> Actuator:
        # Numbers near 1, because finite differences are relative to them.
        frequency, damping, delay, *lag = (x - 1).tolist()
        return replace(
            actuator,
            dynamics=Dynamics(start.frequency * exp(frequency), max(start.damping + damping, 0), start.series),
            delay=max(actuator.delay + delay * unit, 0),
            lag=max(_FIRST_LAG + lag[0], 0) * unit if lag else actuator.lag,
        )

    stroke = float(np.ptp(actuator.spring.displacement))

    def error(x: Array) -> Array:
        return simulation.errors(with_numbers(x)) / stroke

    # Delay, lag and damping are not negative; the start lies a finite difference inside, where slopes exist.
    least = 1 - np.array([np.inf, start.damping, actuator.delay / unit, *([_FIRST_LAG] if lagging else [])])
    first = np.maximum(np.ones(least.size), least + 2 * _STEP)
    steps = np.full(first.size, _STEP)
    found = with_numbers(least_squares(error, first, x_scale=0.1, diff_step=steps, bounds=(least, np.inf)).x)
    sample = min((epoch.record.record.sample_time for epoch in simulation.epochs), default=0.0)
    return replace(found, delay=significant_delay(found.delay, sample), lag=significant_delay(found.lag, sample))


_STEPS = 3
_ROWS = 6000
# Parts of a step that are tried.
_PARTS = (1.0, 0.5, 0.2, 0.05)
# Blocks of the record, of which one is held out to judge the refinement.
_FOLDS = 3
# Finite differences, as a part of a coefficient, of the largest of its kind, or of a threshold.
_DIFFERENCE = 1e-3
# A threshold that moves by this fraction costs as much as an error of the noise's size at every sample; no threshold
# moves further than this part of the distance to its neighbour.
_MOVING, _CLOSEST = 0.1, 0.4


@dataclass(frozen=True, eq=False)
class Refinement:
    """The result of a refinement.

    `actuator`: the refined actuator, or the original. `before`, `after`: RMS error of simulation [m] on held-out
    cycles, of the original, which was fitted to them, and of a refined model that was not.
    """

    actuator: Actuator
    kept: bool
    before: float
    after: float


def refine(fit: StructuredFit, progress: Progress) -> Refinement:
    """Refine an actuator by the simulation error on its training records."""
    point = _Iterate.of(fit)
    voltage = np.concatenate([epoch.piece(0.0).voltage for epoch in point.simulation.epochs])
    held_out = fold_sums.blocks(voltage, point.simulation.numbers) % _FOLDS == _FOLDS - 1
    before = rms(point.errors()[held_out])
    if not held_out.any() or held_out.all():
        return Refinement(fit.actuator, False, before, before)
    progress("refining in simulation")
    after = rms(_after_steps(point, ~held_out).errors()[held_out])
    if not after < RULES.refinement_gain * before:
        return Refinement(fit.actuator, False, before, after)
    progress("refining in simulation, with every cycle")
    return Refinement(_after_steps(point, np.ones_like(held_out)).actuator, True, before, after)


def _after_steps(point: _Iterate, used: Mask) -> _Iterate:
    """Return the point after some steps on the used samples."""
    error = rms(point.errors()[used])
    for _ in range(_STEPS):
        aim, moves = point.aim(used)
        tried = [point.step(aim, moves, part) for part in _PARTS]
        errors = [rms(candidate.errors()[used]) for candidate in tried]
        now, before = min(errors), error
        if not now < before:
            break
        point, error = tried[errors.index(now)], now
        if not now < RULES.refinement_gain * before:
            break
    return point


@dataclass(frozen=True, eq=False)
class _Iterate:
    """Coefficients and thresholds, and their actuator.

    `given`: its parts lie on the grid of `regression`. `regression`: its rows are not used. `x` (q,): unknowns of the
    program that are not negative. `breakaway` (N,): [m].
    """

    given: Actuator
    regression: Regression
    simulation: SimulationError
    x: Array
    breakaway: Array

    @classmethod
    def of(cls, fit: StructuredFit) -> _Iterate:
        grid = Grid.of_actuator(fit.actuator)
        # The errors of a simulation have no constants of the program's epochs, drifts or starts.
        none = np.zeros(0, dtype=np.intp)
        regression = replace(fit.regression, grid=grid, strained=(), drifting=(), lasting=None, ranges=(), epochs=none)
        x = np.concatenate(regression.unknowns(Coefficients.from_actuator(fit.actuator)))
        return cls(fit.actuator, regression, fit.playback(), x, grid.breakaway)

    @property
    def actuator(self) -> Actuator:
        """The actuator with all branches, even those that hold nothing: the start states contain them."""
        grid = replace(self.regression.grid, breakaway=self.breakaway)
        given, first = self.given, float(self.given.spring.voltage[0])
        return self.regression.at(self.x).to_actuator(
            grid, first, every_part=True, dynamics=given.dynamics, lag=given.lag, delay=given.delay
        )

    def errors(self) -> Array:
        """Return the error of every sample [m]."""
        return self.simulation.errors(self.actuator)

    def aim(self, used: Mask) -> tuple[Array, Array]:
        """Return the solution of the linearised problem: unknowns (q,), moves of the thresholds' logarithms (N,)."""
        regression, errors = self.regression, self.errors()
        rows = np.flatnonzero(used)
        rows = rows[:: max(1, rows.size // _ROWS)]
        by_x, by_rho = self._slopes(errors, rows)
        noise, movable = rms(errors[rows]), regression.grid.movable
        constants = np.eye(len(self.simulation.epochs))[self.simulation.numbers[rows]]
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
        least = 3 * [1e-3 * self.regression.mean_slope] + [1e-3]
        kinds = zip(self.regression.unknowns(self.regression.at(self.x)), least, strict=True)
        return np.concatenate([np.maximum(kind, max(0.1 * kind.max(initial=0.0), low)) for kind, low in kinds])
