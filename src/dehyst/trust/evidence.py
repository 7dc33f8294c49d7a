"""The evidence for a model: its records on its axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from dehyst.identification import (
    Grid,
    Identifiability,
    RecordComparison,
    compare_all,
    errors_of,
    identifiability,
    probed,
)
from dehyst.model import Actuator
from dehyst.records import Record, largest


@dataclass(frozen=True, eq=False)
class Evidence:
    """The evidence for a model: records on the model's axis.

    Attributes
    ----------
    actuator : Actuator
    comparisons : tuple of RecordComparison
        One for each record.
    grid : Grid
        The model's, with the elements that slide in the widest loop.
    stroke : float
        The range of the widest loop [m].
    """

    actuator: Actuator
    comparisons: tuple[RecordComparison, ...]
    grid: Grid
    stroke: float

    @classmethod
    def from_records(cls, actuator: Actuator, records: Record | Sequence[Record]) -> Evidence:
        """Compare with a model the records it was identified from, or others, to see what these would determine.

        Raise `RecordError` or `IdentifyError` if a record cannot be used.
        """
        compared, stroke = compare_all(actuator, records)
        sliding = 2 * actuator.slip.breakaway < stroke * (1 - 1e-9)
        return cls(actuator, compared, replace(Grid.of_actuator(actuator), sliding=sliding), stroke)

    @cached_property
    def identifiability(self) -> Identifiability:
        """What the turning points determine of the stiffnesses, regardless of noise; see `directions`."""
        return self.directions()

    def directions(self, *more: Record) -> Identifiability:
        """Return the directions that the turning points of the records, and of `more` on the model's axis, determine.

        For Maxwell-slip models it concerns their stiffnesses, whose columns depend on turning points only. For models
        with more parts it concerns ten plain Maxwell-slip elements instead.
        """
        records = [*self.pieces(), *more]
        if not self.actuator._wide:
            return identifiability(records, self.grid)
        knots = self.grid.knots
        return probed(records, (float(knots[0]), float(knots[-1])))

    @cached_property
    def misfit(self) -> float:
        """Largest error of the model on the records [m]."""
        return max(largest(errors_of(self.actuator, one, "training")[1].settled.residual) for one in self.comparisons)

    def pieces(self) -> list[Record]:
        """Return all pieces on the model's axis, their voltages delayed."""
        return [
            replace(piece, displacement=piece.displacement + item.datum)
            for item in self.comparisons
            for _, piece in item.pieces
        ]

    def as_dict(self) -> dict[str, Any]:
        """Return the records' names and the stroke as JSON values."""
        return {"records": [item.record.name for item in self.comparisons], "stroke_m": self.stroke}
