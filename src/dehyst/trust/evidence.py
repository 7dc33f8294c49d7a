"""The evidence for a model: its records on its axis, from which its uncertainty is estimated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.identification import (
    Coefficients,
    Grid,
    Identifiability,
    RecordComparison,
    Regression,
    Rows,
    RowSource,
    compare_all,
    driving_path,
    identifiability,
    left_of,
    probed,
)
from dehyst.model import Actuator, Identification
from dehyst.records import Record, largest, rms, turning_points

# Of the table of rows by coefficients.
_ENTRIES = 4_000_000
# A start that is not at rest must lower the RMS residual of its record to this part.
_WORTH_OF_START = 0.9


@dataclass(frozen=True, eq=False)
class Evidence:
    """The evidence for a model: records on the model's axis, with its grids, delay, dynamics and options.

    Neighbouring coefficients are smoothed as in the identification. Creep branches and smooth elements that got no
    stiffness are not fitted again.

    Attributes
    ----------
    actuator : Actuator
    comparisons : tuple of RecordComparison
        One for each record.
    regression : Regression
        Its rows (of long records an even selection), with the datum and drift of each record under the model.
    stroke : float
        The range of the widest loop [m].
    """

    actuator: Actuator
    comparisons: tuple[RecordComparison, ...]
    regression: Regression
    stroke: float

    @classmethod
    def from_records(cls, actuator: Actuator, records: Record | Sequence[Record]) -> Evidence:
        """Compare records with a model.

        Parameters
        ----------
        actuator : Actuator
            From `dehyst.identify` or a model file; without an `identification` the default options apply.
        records : Record or sequence of Record
            The records that it was identified from, or others, to see what these would determine.

        Raises
        ------
        RecordError, IdentifyError
            If a record cannot be used.
        """
        compared, stroke, floor = compare_all(actuator, records)
        grid = Grid.of_actuator(actuator)
        grid = replace(grid, sliding=2 * actuator.slip.breakaway < stroke * (1 - 1e-9))
        known = actuator.identification or Identification()
        regression = Regression(
            rows=_rows(actuator, grid, compared, stroke, [item.measured for item in compared]),
            grid=grid,
            floor=floor,
            datum=np.array([item.datum for item in compared]),
            drifting=tuple(q for q, item in enumerate(compared) if item.regression.drifting),
            strained=tuple(q for q, item in enumerate(compared) if actuator.creep is not None and _strained(item)),
            smoothing=known.smoothing or 0.0,
        )
        return cls(actuator, compared, regression, stroke)

    @cached_property
    def model(self) -> Coefficients:
        """The model's coefficients, with each epoch's constant and each record's drift [V]."""
        return self.regression.fit_nuisances(Coefficients.from_actuator(self.actuator))

    @cached_property
    def weights(self) -> Array:
        """1 / (d tau(v)/dy) of the model at each row (n,)."""
        return 1 / self.regression.slope(self.model)

    @cached_property
    def leg_starts(self) -> NDArray[np.intp]:
        """First row of each rise and fall (k,)."""
        rows = self.regression.rows
        return leg_starts(rows.voltage, np.flatnonzero(np.diff(rows.epoch)) + 1)

    @cached_property
    def reference(self) -> int:
        """The epoch whose constant is the constant of the model's spring: the one with the least offset."""
        base = float(self.actuator.spring.voltage[0])
        return min(self.model.offsets, key=lambda epoch: abs(self.model.offsets[epoch] - base))

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
        if not self.actuator.wide:
            return identifiability(records, self.regression.grid)
        knots = self.regression.grid.knots
        return probed(records, (float(knots[0]), float(knots[-1])))

    @cached_property
    def misfit(self) -> float:
        """Largest error of the model on the records [m]."""
        errors = [played[2] - played[3] for one in self.comparisons for *_, played in one.played(self.actuator)]
        return largest(np.concatenate(errors))

    def pieces(self) -> list[Record]:
        """Return all pieces on the model's axis, their voltages delayed."""
        return [
            replace(piece, displacement=piece.displacement + item.datum)
            for item in self.comparisons
            for _, piece, _ in item.pieces
        ]

    def with_pieces(self, pieces: list[list[Record]]) -> Regression:
        """Return the regression with other measured displacements for each piece."""
        rows = _rows(self.actuator, self.regression.grid, self.comparisons, self.stroke, pieces)
        return replace(self.regression, rows=rows)

    def actuator_of(self, found: Coefficients) -> Actuator:
        """Return the actuator with other coefficients on the same axes; parts without stiffness stay."""
        model = self.actuator
        first = found.offsets[self.reference] - self.model.offsets[self.reference] + float(model.spring.voltage[0])
        return found.to_actuator(
            self.regression.grid,
            first,
            every_part=True,
            limits=model.limits,
            delay=model.delay,
            dynamics=model.dynamics,
            lag=model.lag,
            load_stiffness=model.load_stiffness,
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the records' names and the stroke as JSON values."""
        return {"records": [item.record.name for item in self.comparisons], "stroke_m": self.stroke}


def _rows(
    actuator: Actuator, grid: Grid, compared: Sequence[RecordComparison], stroke: float, pieces: list[list[Record]]
) -> Rows:
    """Return the rows of measured pieces, prepared as in an identification."""
    stacked, noise = [], []
    for q, (item, measured) in enumerate(zip(compared, pieces, strict=True)):
        for (_, _, curve), piece in zip(item.pieces, measured, strict=True):
            stacked.append((q, driving_path(actuator, piece, item.record.noise, stroke), curve))
            noise.append(left_of(item.record.noise, stroke))
    source = RowSource.of(stacked, grid, noise, leads=[item.record.lead for item in compared])
    return source.thinned(rows_of(grid, _ENTRIES))


def leg_starts(voltage: Array, cuts: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the first sample of each rise and fall (k,): the first of all, those at cuts, and those at turns."""
    return np.unique([0, *cuts, *turning_points(voltage, 0.02 * float(np.ptp(voltage)))]).astype(np.intp)


def rows_of(grid: Grid, entries: int) -> int:
    """Return how many rows hold about this many entries; a row has one for each of up to hundreds of coefficients."""
    columns: int = grid.places()["transformer"].stop
    return max(1, entries // columns)


def _strained(compared: RecordComparison) -> bool:
    """Return whether a record shows creep from before its start: without that the model fits it much worse."""
    regression, found = compared.regression, compared.found
    weights = 1 / regression.slope(found)
    rested = replace(regression, strained=()).fit_nuisances(found)
    return bool(rms(found.solved.residual * weights) < _WORTH_OF_START * rms(rested.solved.residual * weights))
