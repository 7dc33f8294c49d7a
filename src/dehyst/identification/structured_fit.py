"""A wider actuator of a structure: the convex program within searches over what is not convex."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

from dehyst.identification.dynamics_search import Inertia
from dehyst.identification.regression.coefficients import parts
from dehyst.identification.regression.wide_regression import WideCoefficients, WideRegression
from dehyst.identification.resonance_tuning import rung
from dehyst.identification.simulation_error import Playback
from dehyst.identification.solvers.program import Norm
from dehyst.identification.training_data import Frame
from dehyst.model.actuator import Actuator
from dehyst.model.structure import Structure
from dehyst.records.metrics import rms

# The program and the simulation agree on dynamics after so many rounds, or when one lowers the error by less than this.
_ROUNDS = 3
_WORTH = 0.97


@dataclass(frozen=True, eq=False)
class Wider:
    """What the records and a structure make.

    Attributes
    ----------
    frame : Frame
    structure : Structure
    norm : str
    regression : WideRegression
    found : WideCoefficients
        Of an actuator only if its solution is optimal.
    """

    frame: Frame
    structure: Structure
    norm: Norm
    regression: WideRegression
    found: WideCoefficients

    @classmethod
    def solve(cls, frame: Frame, structure: Structure, norm: Norm) -> Wider:
        """Solve the program."""
        return cls(frame, structure, norm, *frame.fitted(structure, norm))

    @cached_property
    def actuator(self) -> Actuator:
        """Without limits and name."""
        rows, inertia = self.regression.rows, self.frame.inertia
        reference = int(rows.epoch[rows.record == self.frame.widest].max())
        return Actuator(
            **parts(self.regression.grid, self.found, self.found.offsets[reference]),
            dynamics=inertia.dynamics,
            delay=inertia.delay,
            lag=inertia.lag,
        )

    def playback(self) -> Playback:
        """The training records, to be simulated."""
        stroke = self.frame.span[1] - self.frame.span[0]
        return Playback.of(self.actuator, self.frame.training, self.regression.datum, stroke)

    def tuned(self, tell: Callable[[str], None]) -> Wider:
        """The same with the dynamics that simulate the records best, if they do so better."""
        best, playback = self, self.playback()
        error = rms(playback.errors(self.actuator))
        for _ in range(_ROUNDS):
            tell("tuning the resonance in simulation")
            actuator = rung(best.actuator, playback)
            frame = replace(best.frame, inertia=Inertia.of(actuator))
            trial = Wider.solve(frame, self.structure, self.norm)
            if not trial.found.solution.optimal:
                return best
            playback = trial.playback()
            now = rms(playback.errors(trial.actuator))
            if now > _WORTH * error:
                return trial if now < error else best
            best, error = trial, now
        return best
