"""What records say beside a wider model: its regression on their samples, the grids of its parts held."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from dehyst._types import Array
from dehyst.identification.preprocessing.denoising import remove_jitter
from dehyst.identification.preprocessing.dynamics import remove_dynamics
from dehyst.identification.preprocessing.internal_states import InternalStates
from dehyst.identification.preprocessing.regressors import RowSource
from dehyst.identification.regression.coefficients import coefficients_of, grid_of
from dehyst.identification.regression.wide_regression import WideCoefficients, WideRegression
from dehyst.identification.validation import RecordComparison, compare_all
from dehyst.model import Actuator, Creep, GradedSlip, MaxwellSlip, SmoothSlip, Spring, Structure, Transformer
from dehyst.records import Record
from dehyst.records.metrics import rms

# A row has a column for each coefficient, of which there may be hundreds.
_MOST_ROWS = 8000
# A start that is not at rest must lower the RMS residual of its record to this part.
_WORTH_OF_START = 0.9


@dataclass(frozen=True, eq=False)
class WideEvidence:
    """Records beside a wider model, as `dehyst.uncertainty.evidence.Evidence` puts them beside a plain one.

    The grids of all parts, delay, lag and inertia are those of the model, and neighbours are held as much alike.
    Branches of creep and smooth elements that got no stiffness are not looked for again.

    Attributes
    ----------
    actuator : Actuator
    comparisons : tuple of RecordComparison
        One a record.
    regression : WideRegression
        Rows (of long records some, evenly).
    stroke : float
        The range of the widest loop [m].
    """

    actuator: Actuator
    comparisons: tuple[RecordComparison, ...]
    regression: WideRegression
    stroke: float

    @classmethod
    def of(cls, actuator: Actuator, records: Record | Sequence[Record]) -> WideEvidence:
        """Put records beside a model; parameters and errors are those of `dehyst.uncertainty.evidence.Evidence.of`."""
        compared, stroke, floor = compare_all(actuator, records)
        options = actuator.provenance
        datums = np.array([one.datum for one in compared])
        rows = _rows(actuator, compared, stroke, [one.measured for one in compared])
        drifting = tuple(q for q, one in enumerate(compared) if one.regression.drifting)
        regression = WideRegression(rows, grid_of(actuator), floor, datums, drifting, smoothing=_smoothing(options))
        if actuator.creep is not None:
            regression = replace(regression, strained=tuple(q for q, one in enumerate(compared) if _strained(one)))
        return cls(actuator, compared, regression, stroke)

    @cached_property
    def model(self) -> WideCoefficients:
        """The model's coefficients, with each epoch's constant [V]."""
        return self.regression.nuisances_of(coefficients_of(self.actuator))

    @cached_property
    def weights(self) -> Array:
        """1 / (d tau(v)/dy) of the model at each row (n,)."""
        return 1 / self.regression.slope(self.model)

    @cached_property
    def reference(self) -> int:
        """The epoch whose constant is that of the model's spring: the one that needs the least offset."""
        base = float(self.actuator.spring.voltage[0])
        return min(self.model.offsets, key=lambda epoch: abs(self.model.offsets[epoch] - base))

    def with_pieces(self, pieces: list[list[Record]]) -> WideRegression:
        """The same regression on other measured displacements, piece for piece."""
        return replace(self.regression, rows=_rows(self.actuator, self.comparisons, self.stroke, pieces))

    def actuator_of(self, found: WideCoefficients) -> Actuator:
        """The actuator that other coefficients make, on the same axes; parts without stiffness stay."""
        grid, own = self.regression.grid, self.actuator
        base = float(own.spring.voltage[0])
        first = found.offsets[self.reference] - self.model.offsets[self.reference] + base
        creep, smooth = np.split(np.maximum(found.moved, 0.0), [grid.time_constants.size])
        drive = grid.drive[:1] + np.concatenate([[0.0], np.cumsum(found.drive * np.diff(grid.drive))])
        slip = (
            GradedSlip(grid.breakaway, grid.grades, found.stiffness)
            if isinstance(own.slip, GradedSlip)
            else MaxwellSlip(grid.breakaway, found.stiffness[:, 0])
        )
        return Actuator(
            slip,
            Spring.of_slopes(grid.knots, found.slopes, first),
            limits=own.limits,
            delay=own.delay,
            transformer=Transformer(grid.drive, drive) if grid.drive.size else None,
            creep=Creep(grid.time_constants, creep) if creep.size else None,
            smooth=SmoothSlip(grid.lengths, grid.closings, smooth) if smooth.size else None,
            dynamics=own.dynamics,
            lag=own.lag,
            load_stiffness=own.load_stiffness,
        )

    def as_dict(self) -> dict[str, Any]:
        """JSON values: the records' names and the stroke."""
        return {"records": [one.record.name for one in self.comparisons], "stroke_m": self.stroke}


def _rows(actuator: Actuator, compared: Sequence[RecordComparison], stroke: float, pieces: list[list[Record]]) -> Any:
    """Rows of measured pieces, made ready as an identification makes them."""
    grid, stacked, noise, leads = grid_of(actuator), [], [], []
    for q, (one, own) in enumerate(zip(compared, pieces, strict=True)):
        for (_, _, curve), piece in zip(one.pieces, own, strict=True):
            path = remove_jitter(remove_dynamics(piece, actuator.dynamics), one.record.noise, stroke)
            stacked.append((q, path, curve))
            noise.append(one.record.noise)
        leads.append(one.record.lead)

    def moved(number: int, piece: Record) -> InternalStates:
        return InternalStates(grid, piece, leads[number])

    return RowSource.of(stacked, actuator.slip.breakaway, noise, moved=moved).thinned(_MOST_ROWS)


def _smoothing(options: Mapping[str, Any]) -> float:
    """How much alike neighbours were held as the model was identified."""
    structure = options.get("structure")
    known = isinstance(structure, Mapping) and "smoothing" in structure
    return float(structure["smoothing"]) if known else Structure().smoothing  # type: ignore[index]


def _strained(compared: RecordComparison) -> bool:
    """Whether a record creeps as if it had not been at rest as it began: the model says much worse of it without."""
    regression, found = compared.regression, compared.found
    if not isinstance(regression, WideRegression) or not isinstance(found, WideCoefficients):
        return False
    weights = 1 / regression.slope(found)
    rested = replace(regression, strained=()).nuisances_of(found)
    return bool(rms(found.solution.residual * weights) < _WORTH_OF_START * rms(rested.solution.residual * weights))
