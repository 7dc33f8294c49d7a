"""An actuator of a structure: the convex program within searches over what is not convex."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

from dehyst.identification.dynamics_search import SensedDynamics
from dehyst.identification.regression.coefficients import Coefficients
from dehyst.identification.regression.fold_sums import least_squares_of_sums
from dehyst.identification.regression.regression import Regression
from dehyst.identification.resonance_tuning import tune_resonance
from dehyst.identification.simulation_error import SimulationError
from dehyst.identification.solvers.program import Norm
from dehyst.identification.training_data import TrainingData
from dehyst.model import Actuator, Structure
from dehyst.records.metrics import rms

# The program and the simulation agree on dynamics after so many rounds, or when one lowers the error by less than this.
_ROUNDS = 3
_WORTH = 0.97


@dataclass(frozen=True, eq=False)
class StructuredFit:
    """What the records and a structure make.

    Attributes
    ----------
    frame : TrainingData
    structure : Structure
    norm : str
    regression : Regression
    found : Coefficients
        Of an actuator only if its solution is optimal.
    """

    frame: TrainingData
    structure: Structure
    norm: Norm
    regression: Regression
    found: Coefficients

    @classmethod
    def solve(cls, frame: TrainingData, structure: Structure, norm: Norm) -> StructuredFit:
        """Solve the program."""
        return cls(frame, structure, norm, *frame.fit(structure, norm))

    @classmethod
    def solve_quickly(cls, frame: TrainingData, structure: Structure) -> StructuredFit:
        """Solve the program by least squares, of the rows that fit in memory."""
        regression = frame.regression(structure)
        return cls(frame, structure, "l2", regression, least_squares_of_sums(regression))

    @cached_property
    def actuator(self) -> Actuator:
        """Without limits and name."""
        return self.frame.actuator_of(self.regression, self.found)

    def playback(self) -> SimulationError:
        """Return the training records, to be simulated."""
        return SimulationError.of(self.actuator, self.frame.training, self.regression.datum, self.frame.stroke)

    def tune_dynamics(self, report: Callable[[str], None]) -> StructuredFit:
        """Return the same with the dynamics that simulate the records best, if they do so better."""
        best, playback = self, self.playback()
        error = rms(playback.errors(self.actuator))
        for _ in range(_ROUNDS):
            report("tuning the resonance in simulation")
            actuator = tune_resonance(best.actuator, playback)
            frame = replace(best.frame, inertia=SensedDynamics.of(actuator))
            trial = StructuredFit.solve(frame, self.structure, self.norm)
            if not trial.found.solved.optimal:
                return best
            playback = trial.playback()
            now = rms(playback.errors(trial.actuator))
            if now > _WORTH * error:
                return trial if now < error else best
            best, error = trial, now
        return best
