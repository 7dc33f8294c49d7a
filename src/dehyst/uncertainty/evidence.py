"""What records say beside a model that was identified from them: the ground on which its uncertainty is judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from dehyst._types import Array
from dehyst.identification.diagnostics.identifiability import Identifiability, identifiability
from dehyst.identification.preprocessing.regressors import RowSource
from dehyst.identification.regression.regression import Coefficients, Regression
from dehyst.identification.validation import MOST_ROWS, RecordComparison, compare_all
from dehyst.model import Actuator, MaxwellSlip, Spring
from dehyst.records import Record


@dataclass(frozen=True, eq=False)
class Evidence:
    """Records beside a model, on the model's axis; its thresholds, knots, delay and options are those of the model.

    Attributes
    ----------
    actuator : Actuator
    comparisons : tuple of RecordComparison
        One a record.
    regression : Regression
        Rows (of long records some, evenly), with the datums and drifts that the model leaves to each record.
    stroke : float
        The range of the widest loop [m].
    """

    actuator: Actuator
    comparisons: tuple[RecordComparison, ...]
    regression: Regression
    stroke: float

    @classmethod
    def of(cls, actuator: Actuator, records: Record | Sequence[Record]) -> Evidence:
        """Put records beside a model.

        Parameters
        ----------
        actuator : Actuator
            As `dehyst.identify` or a model file gives it; options that its provenance lacks are the defaults.
        records : Record or sequence of Record
            Those it was identified from, or others, if one wants to know what they would tell.

        Raises
        ------
        RecordError, IdentifyError
            If a record cannot be used.
        """
        compared, stroke, floor = compare_all(actuator, records)
        movable = 2 * actuator.slip.breakaway < stroke * (1 - 1e-9)
        drifting = tuple(q for q, one in enumerate(compared) if one.regression.drifting)
        datums = np.array([one.datum for one in compared])
        rows = _rows(actuator, compared, [[piece for _, piece, _ in one.pieces] for one in compared])
        return cls(
            actuator, compared, Regression(rows, actuator.spring.displacement, floor, movable, datums, drifting), stroke
        )

    @cached_property
    def model(self) -> Coefficients:
        """The model's coefficients, with each epoch's constant and each record's drift [V]."""
        slip, spring = self.actuator.slip, self.actuator.spring
        return self.regression.nuisances_of(
            Coefficients(slip.stiffness, spring.slopes, {}, {}, None)  # type: ignore[arg-type]
        )

    @cached_property
    def weights(self) -> Array:
        """1 / (dv/dy) of the model at each row (n,)."""
        return 1 / self.regression.slope(self.model)

    @cached_property
    def reference(self) -> int:
        """The epoch whose constant is that of the model's spring: the one that needs the least offset."""
        base = float(self.actuator.spring.voltage[0])
        return min(self.model.offsets, key=lambda epoch: abs(self.model.offsets[epoch] - base))

    @cached_property
    def identifiability(self) -> Identifiability:
        """What the turning points of these records tell of the stiffnesses."""
        return identifiability(self.pieces(), self.actuator.slip.breakaway, self.regression)

    def pieces(self) -> list[Record]:
        """All pieces on the model's axis, their voltages delayed."""
        return [
            replace(piece, displacement=piece.displacement + one.datum)
            for one in self.comparisons
            for _, piece, _ in one.pieces
        ]

    def with_pieces(self, pieces: list[list[Record]]) -> Regression:
        """The same regression on other displacements, piece for piece."""
        return replace(self.regression, rows=_rows(self.actuator, self.comparisons, pieces))

    def actuator_of(self, found: Coefficients) -> Actuator:
        """The actuator that other coefficients make, on the same axes."""
        base = float(self.actuator.spring.voltage[0])
        first = found.offsets[self.reference] - self.model.offsets[self.reference] + base
        slip = MaxwellSlip(self.actuator.slip.breakaway, found.stiffness)
        spring = Spring.of_slopes(self.regression.knots, found.slopes, first)
        return Actuator(slip, spring, limits=self.actuator.limits, delay=self.actuator.delay)

    def as_dict(self) -> dict[str, Any]:
        """JSON values: the records' names and the stroke."""
        return {"records": [one.record.name for one in self.comparisons], "stroke_m": self.stroke}


def _rows(actuator: Actuator, compared: Sequence[RecordComparison], pieces: list[list[Record]]) -> Any:
    stacked, noise = [], []
    for q, (one, own) in enumerate(zip(compared, pieces, strict=True)):
        for (_, _, curve), piece in zip(one.pieces, own, strict=True):
            stacked.append((q, piece, curve))
            noise.append(one.record.noise)
    return RowSource.of(stacked, actuator.slip.breakaway, noise).thinned(MOST_ROWS)
