"""A wider actuator of a structure: the convex program within searches over what is not convex."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from dehyst.actuator import Actuator
from dehyst.composition import parts
from dehyst.inertia import Inertia
from dehyst.metrics import rms
from dehyst.playback import Playback
from dehyst.program import Norm
from dehyst.ringing import rung
from dehyst.structure import Structure
from dehyst.structured import Frame
from dehyst.wide_regression import WideCoefficients, WideRegression

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
    actuator : Actuator
        Without limits and name.
    """

    frame: Frame
    structure: Structure
    norm: Norm
    regression: WideRegression
    found: WideCoefficients
    actuator: Actuator

    @classmethod
    def solve(cls, frame: Frame, structure: Structure, norm: Norm) -> Wider:
        """Solve the program."""
        stream = frame.stream(structure)
        regression, found = stream.regression, stream.fit_weighted(norm)
        reference = regression.rows.epoch[regression.rows.record == frame.widest].max()
        actuator = Actuator(
            **parts(regression.grid, found, found.offsets[int(reference)]),
            dynamics=frame.inertia.dynamics, delay=frame.inertia.delay, lag=frame.inertia.lag,
        )  # fmt: skip
        return cls(frame, structure, norm, regression, found, actuator)

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
