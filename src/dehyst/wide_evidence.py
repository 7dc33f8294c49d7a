"""What records say beside a wider model: its regression on their samples, the grids of its parts held."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from dehyst._native import Array
from dehyst.actuator import Actuator
from dehyst.composition import coefficients_of, grid_of, moved_along
from dehyst.creep import Creep
from dehyst.elements import GradedSlip, MaxwellSlip, Spring, Transformer
from dehyst.inertia import Inertia, undone
from dehyst.preparation import Prepared, as_list, prepare
from dehyst.program import one_thread
from dehyst.record import Record
from dehyst.rows import RowSource
from dehyst.smooth import SmoothSlip
from dehyst.smoothing import without_jitter
from dehyst.structured import Frame
from dehyst.verify import Comparison, Protocol, compare
from dehyst.wide_regression import WideCoefficients, WideRegression

# A row has a column for each coefficient, of which there may be hundreds.
_MOST_ROWS = 8000


@dataclass(frozen=True, eq=False)
class WideEvidence:
    """Records beside a wider model, as `dehyst.evidence.Evidence` puts them beside a plain one.

    The grids of all parts, delay and inertia are those of the model. Branches of creep and smooth elements that got no
    stiffness are not looked for again.

    Attributes
    ----------
    actuator : Actuator
    comparisons : tuple of Comparison
        One a record.
    regression : WideRegression
        Rows (of long records some, evenly).
    stroke : float
        The range of the widest loop [m].
    """

    actuator: Actuator
    comparisons: tuple[Comparison, ...]
    regression: WideRegression
    stroke: float

    @classmethod
    def of(cls, actuator: Actuator, records: Record | Sequence[Record]) -> WideEvidence:
        """Put records beside a model; parameters and errors are those of `dehyst.evidence.Evidence.of`."""
        prepared = [prepare(record) for record in as_list(records)]
        options = actuator.provenance
        spans = [item.span() for item in prepared]
        widest = int(np.argmax([high - low for low, high in spans]))
        stroke = spans[widest][1] - spans[widest][0]
        datum = 0.0 if options.get("shared_datum") else None
        with one_thread():
            compared = tuple(
                compare(actuator, item, Protocol("training", actuator.delay, datum, False, stroke)) for item in prepared
            )
        floor = float(np.ptp(prepared[widest].record.voltage)) / stroke * float(options.get("slope_floor", 0.2))
        datums = np.array([one.datum for one in compared])
        rows = _rows(actuator, compared, stroke, [one.measured for one in compared])
        regression = WideRegression(rows, grid_of(actuator), floor, datums)
        if actuator.creep is not None:
            strained = _frame(actuator, prepared, spans[widest], floor, datums).strained
            regression = replace(regression, strained=strained)
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
            slip, Spring.of_slopes(grid.knots, found.slopes, first), limits=own.limits, delay=own.delay,
            transformer=Transformer(grid.drive, drive) if grid.drive.size else None,
            creep=Creep(grid.time_constants, creep) if creep.size else None,
            smooth=SmoothSlip(grid.lengths, grid.closings, smooth) if smooth.size else None,
            dynamics=own.dynamics, lag=own.lag, load_stiffness=own.load_stiffness,
        )  # fmt: skip

    def as_dict(self) -> dict[str, Any]:
        """JSON values: the records' names and the stroke."""
        return {"records": [one.record.name for one in self.comparisons], "stroke_m": self.stroke}


def _rows(actuator: Actuator, compared: Sequence[Comparison], stroke: float, pieces: list[list[Record]]) -> Any:
    """Rows of measured pieces, made ready as an identification makes them."""
    grid, stacked, noise, leads = grid_of(actuator), [], [], []
    for q, (one, own) in enumerate(zip(compared, pieces, strict=True)):
        for (_, _, curve), piece in zip(one.pieces, own, strict=True):
            path = without_jitter(undone(piece, actuator.dynamics), one.record.noise, stroke)
            stacked.append((q, path, curve))
            noise.append(one.record.noise)
        leads.append(one.record.lead)

    def moved(number: int, piece: Record) -> Array:
        return moved_along(grid, piece, leads[number])

    return RowSource.of(stacked, actuator.slip.breakaway, noise, moved=moved).thinned(_MOST_ROWS)


def _frame(
    actuator: Actuator, prepared: list[Prepared], span: tuple[float, float], floor: float, datum: Array
) -> Frame:
    dynamics = actuator.dynamics
    inertia = Inertia(actuator.delay, 0.0, 0.0)
    if dynamics is not None:
        omega = dynamics.frequency
        inertia = Inertia(actuator.delay, 2 * dynamics.damping / omega, 1 / omega**2)
    volts = np.array([item.record.voltage_range for item in prepared])
    return Frame(prepared, inertia, span, (float(volts[:, 0].min()), float(volts[:, 1].max())), floor, datum)
