"""The result of `dehyst.insight`: how far a model can be trusted, and what to do about it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dehyst._text import escaped
from dehyst._types import Array
from dehyst._views import tables
from dehyst._views.pictures import plotted
from dehyst.control import Homing
from dehyst.identification.diagnostics.identifiability import Identifiability
from dehyst.model import Actuator
from dehyst.uncertainty import insight_summary
from dehyst.uncertainty.bootstrap import Intervals
from dehyst.uncertainty.evidence import Evidence
from dehyst.uncertainty.experiment_design import Suggestion
from dehyst.uncertainty.feasible_set import FeasibleSet
from dehyst.uncertainty.major_loop_width import MajorLoopWidth
from dehyst.uncertainty.messages import beyond, not_homed, of_another
from dehyst.uncertainty.part_identifiability import SHARP, PartIdentifiability
from dehyst.uncertainty.precision import Precision
from dehyst.uncertainty.prediction_band import PredictionBand
from dehyst.uncertainty.state_knowledge import StateKnowledge

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

_NOT_JUDGED = (
    "Not judged of a structured model: what other models of its class the records do not contradict, whether its "
    "structure "
    "is the right one, and which excitation would determine most. Delay, inertia and sensor zeros are held where "
    "they are."
)


@dataclass(frozen=True, eq=False)
class Insight:
    """How far a model can be trusted, and what to do about it.

    Attributes
    ----------
    actuator : Actuator
    evidence : Evidence
    identifiability : Identifiability
        Of the stiffnesses; for a structured model of ten plain elements: whether there are inner loops enough.
    knowledge : tuple of StateKnowledge
    misfit : float
        The largest error of the model on these records [m].
    limits : (float, float) or None
        Voltages allowed [V].
    homing : Homing or None
        None if the model has no voltage limits.
    intervals : Intervals or None
        From resampled cycles; None if they were not asked for.
    band : PredictionBand or None
        If a trajectory was given; for a structured model without what the records do not contradict.
    feasible_set : FeasibleSet or None
        What the records do not contradict; None without intervals and for a structured model.
    advice : tuple of Suggestion
        Best first; empty if nothing on the menu determines more, or for a structured model.
    parts : tuple of PartIdentifiability
        What the records determine of each part of a structured model; empty for a plain one.
    loop : MajorLoopWidth or None
        The major loop of a structured model, with the intervals.
    precision : Precision or None
        Which numbers are known to the precision that was asked for; None without intervals.
    """

    actuator: Actuator
    evidence: Evidence
    identifiability: Identifiability
    knowledge: tuple[StateKnowledge, ...]
    misfit: float
    limits: tuple[float, float] | None
    homing: Homing | None = None
    intervals: Intervals | None = None
    band: PredictionBand | None = None
    feasible_set: FeasibleSet | None = None
    advice: tuple[Suggestion, ...] = ()
    parts: tuple[PartIdentifiability, ...] = ()
    loop: MajorLoopWidth | None = None
    precision: Precision | None = None

    def __repr__(self) -> str:
        return insight_summary.one_line(self)

    def _repr_html_(self) -> str:
        return insight_summary.as_html(self)

    def summary(self) -> str:
        """Return what `dehyst insight` prints, in lines, in the order in which it matters."""
        return "\n".join(escaped(line) for line in insight_summary.lines(self))

    def to_dataframe(self) -> DataFrame:
        """Return the judged numbers of the model as a pandas DataFrame, a row a number; stiffnesses in V/um.

        Columns: part, number, unit, estimate, lowest, highest, verdict; no rows without intervals. Raise
        `MissingExtraError` if pandas is not installed.
        """
        parts = () if self.precision is None else self.precision.parts
        names = "part", "number", "unit", "estimate", "lowest", "highest", "verdict"
        rows = [
            (part.part, i + 1, unit, part.estimate[i] * factor, *part.interval[:, i] * factor, verdict.value)
            for part in parts
            for factor, unit in ((1e-6, "V/um") if part.unit == "V/m" else (1.0, part.unit),)
            for i, verdict in enumerate(part.verdicts)
        ]
        return tables.frame({name: [row[k] for row in rows] for k, name in enumerate(names)})

    def plot(
        self,
        kind: Literal["stiffnesses", "directions", "loop", "band"] | None = None,
        *,
        ax: Axes | None = None,
    ) -> Axes:
        """Draw what the records leave open.

        Parameters
        ----------
        kind : str, optional
            "stiffnesses": each with its interval. "directions": their singular values, determined or open. "loop":
            uncertainty of the displacement on the major loop of a structured model. "band": where the displacement of
            the trajectory may be, less the wanted path. Default: the last of "directions", "stiffnesses", "loop" and
            "band" for which there are numbers.
        ax : matplotlib.axes.Axes, optional
            Where to draw; default: the axes of a new figure.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        ModelError
            If there is no such kind, or no numbers for it.
        MissingExtraError
            If matplotlib is not installed.
        """
        return plotted("insight", self, kind, ax)

    @property
    def structured(self) -> bool:
        """Whether the model has more than plain elements and a spring."""
        return self.actuator.wide

    @property
    def not_judged(self) -> str:
        """What is left open of such a model; empty if nothing is."""
        return _NOT_JUDGED if self.structured else ""

    @property
    def stiffness(self) -> Array | None:
        """Lowest and highest kappa_i (2, N) [V/m] by noise and open directions together; None without intervals."""
        if self.intervals is None or self.feasible_set is None:
            return None
        noise, free = self.intervals.stiffness, self.feasible_set.stiffness
        return np.array([np.minimum(noise[0], free[0]), np.maximum(noise[1], free[1])])

    @property
    def trustworthy(self) -> bool:
        """Whether the records leave no direction open: of the stiffnesses, or of ten plain elements."""
        return self.identifiability.determined == self.identifiability.of

    def warnings(self) -> tuple[str, ...]:
        """Return what must be heeded before the model is used."""
        remarks = [
            of_another(self.actuator, self.misfit, self.evidence.stroke),
            self._open(),
            self._imprecise(),
            beyond(self.actuator, self.limits),
        ]
        if self.band is not None:
            remarks += [*self.band.warnings, self._open_on(self.band), not_homed(self.homing)]
        return tuple(remark for remark in remarks if remark)

    def _open(self) -> str | None:
        if self.trustworthy:
            return None
        total = self.identifiability.of
        left = total - self.identifiability.determined
        if not self.structured:
            next_ = f" Add {self.advice[0].words}." if self.advice else ""
            return (
                f"{left} of {total} directions of the stiffnesses are open: motions that turn elsewhere than the "
                f"records do may be predicted wrongly.{next_}"
            )
        top = "" if self.limits is None else f" (dehyst excite descending-tops {self.limits[1]:.6g} -o voltage.csv)"
        return (
            f"The turning points of these records leave {left} of {total} directions of plain elements open, let alone "
            "of this model's: motions that turn elsewhere than the records do may be predicted wrongly. Add tops that "
            f"descend{top}."
        )

    def _imprecise(self) -> str | None:
        """Return what is not known to the precision that was asked for, and what to record next."""
        if self.precision is None or self.precision.all_known:
            return None
        # The warning of open directions says what to add.
        next_ = self.precision.next if self.trustworthy else ""
        return " ".join(words for words in (self.precision.sentence, self.precision.others, next_) if words)

    def _open_on(self, band: PredictionBand) -> str | None:
        """Return what open directions make of a trajectory, where that is more than the rest."""
        parts = {name: 100 * error / self.evidence.stroke for name, error in band.errors().items()}
        known = max(parts["misfit"], parts["noise"], 0.1)
        if self.structured or self.trustworthy or parts["open"] <= known:
            return None
        return (
            f"On this trajectory open directions may cause an error of {parts['open']:.2g} % of the range; the "
            f"model misses its own records by {parts['misfit']:.2g} % only, which does not bound it."
        )

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values; lengths in metres."""
        return {
            **self.evidence.as_dict(),
            "warnings": list(self.warnings()),
            "misfit_m": self.misfit,
            **(self._structured_dict() if self.structured else self._plain_dict()),
            "level": None if self.intervals is None else self.intervals.level,
            "known": None if self.precision is None else self.precision.as_dict(),
            "state": [item.as_dict() for item in self.knowledge],
            "homing": self._homing_dict(),
            "trajectory": None
            if self.band is None
            else {f"{name}_m": error for name, error in self.band.errors().items()},
            "band": None if self.band is None else self.band.as_dict(self.evidence.stroke),
        }

    def _plain_dict(self) -> dict[str, Any]:
        directions, noise, free, both = self.identifiability, self.intervals, self.feasible_set, self.stiffness
        return {
            "directions": {
                "determined": directions.determined,
                "of": directions.of,
                "singular_values_V_per_V": directions.values.tolist(),
                "open": [change.tolist() for change in directions.open],
                "sentences": list(directions.sentences()),
            },
            "stiffness_V_per_m": {
                "model": self.actuator.slip.stiffness.tolist(),
                "noise": None if noise is None else noise.stiffness.tolist(),
                "open": None if free is None else free.stiffness.tolist(),
                "both": None if both is None else both.tolist(),
            },
            "spring_V": {
                "knots_m": self.actuator.spring.displacement.tolist(),
                "noise": None if noise is None else noise.spring.tolist(),
                "open": None if free is None else free.spring.tolist(),
            },
            "advice": [item.as_dict() for item in self.advice],
        }

    def _structured_dict(self) -> dict[str, Any]:
        return {
            "not_judged": self.not_judged,
            "probed": {"determined": self.identifiability.determined, "of": self.identifiability.of},
            "told": {"allowed_deviation_of_the_voltages": SHARP, "parts": [part.as_dict() for part in self.parts]},
            "parts": {
                name: {"model": model.tolist(), "noise": None if noise is None else noise.tolist()}
                for name, (model, noise) in self.numbers().items()
            },
            "major_loop_off_m": None if self.loop is None else self.loop.off,
        }

    def _homing_dict(self) -> dict[str, Any] | None:
        homing = self.homing
        if homing is None:
            return None
        timed = {
            "seconds": None if homing.played is None else homing.played.duration,
            "error_m": homing.error,
        }
        return {
            "turns_V": list(homing.turns),
            "travel_V": homing.travel,
            "certified": homing.certified,
            **(timed if self.structured else {"width_m": homing.width}),
            "remarks": list(homing.remarks),
        }

    def numbers(self) -> dict[str, tuple[Array, Array | None]]:
        """Return coefficients of parts that stand alone, by name with unit, and their lowest and highest by noise."""
        model, noise = self.actuator, self.intervals
        parts: dict[str, tuple[Array, Array | None]] = {}
        if model.transformer is not None:
            parts["transformer_V"] = model.transformer.drive, None if noise is None else noise.drive
        if model.creep is not None:
            parts["creep_V_per_m"] = model.creep.stiffness, None if noise is None else noise.creep
        if model.smooth is not None:
            parts["smooth_V_per_m"] = model.smooth.stiffness, None if noise is None else noise.smooth
        return parts
