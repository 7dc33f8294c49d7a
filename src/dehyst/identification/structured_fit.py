"""The fit of one structure: the convex program, and its resonance tuned by simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import exp

import numpy as np

from dehyst._types import Array, Progress
from dehyst.identification.preprocessing.denoising import significant_delay
from dehyst.identification.preprocessing.preparation import Prepared
from dehyst.identification.preprocessing.regressors import Epoch
from dehyst.identification.regression import fold_sums
from dehyst.identification.regression.coefficients import Coefficients
from dehyst.identification.regression.regression import Regression
from dehyst.identification.rules import RULES
from dehyst.identification.solvers.program import Norm
from dehyst.identification.structure import Structure
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
        weighted = fold_sums.FoldSums(regression, fold_sums.weighted_alike(regression).inverse_slopes)
        found = regression.fit(norm, weighted.weights, like=fold_sums.nearly_least_absolute(weighted))
        return cls(frame, structure, norm, regression, found)

    @classmethod
    def solve_quickly(cls, frame: TrainingData, structure: Structure) -> StructuredFit:
        """Solve the program by least squares."""
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
            self._cache[delay, lag] = whole[self.epoch.start : self.epoch.stop]
        return self._cache[delay, lag]

    def error(self, actuator: Actuator) -> Array:
        """Return measured minus simulated displacement (n,) [m], mean zero."""
        piece, rho = self.piece(actuator.delay, actuator.lag), actuator.slip.breakaway
        actuator = replace(actuator, lag=0.0)
        y = self.state.deformation
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
