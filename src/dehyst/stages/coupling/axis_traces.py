"""What the models of all axes give on the samples of a record, and what is left of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dehyst._types import Array, Mask
from dehyst.model import Fit
from dehyst.stages.coupling.play_columns import span_levels
from dehyst.stages.decoupling import apply, inverse
from dehyst.stages.record import StageRecord

# Of the range of a voltage: it stands while it moves by less.
_STANDING = 2e-3


@dataclass(frozen=True, eq=False)
class AxisTraces:
    """Models of all axes beside a record.

    Attributes
    ----------
    record : StageRecord
    outputs : (n, axes) array
        Displacement of each actuator by its model [m]; NaN where it is not compared. While the voltage of an actuator
        has not moved yet, its output is its mean.
    standing : (n, axes) bool array
        Where a voltage has not moved yet.
    """

    record: StageRecord
    outputs: Array
    standing: Mask

    @classmethod
    def of(cls, record: StageRecord, fits: Sequence[Fit], number: int, coupling: Array) -> AxisTraces:
        """Collect trace `number` of the identification of each axis, made with a `coupling`."""
        moved = apply(inverse(coupling), record.displacement)
        outputs, standing = np.full(moved.shape, np.nan), np.zeros(moved.shape, dtype=bool)
        for j, fit in enumerate(fits):
            trace, v = fit.traces[number], record.voltage[:, j]
            where = np.minimum(np.searchsorted(record.time, trace.time - 1e-9), len(record) - 1)
            # What a sensor's zero or a drift has moved is moved back: the residual is what counts.
            outputs[where, j] = moved[where, j] - trace.residual
            away = np.flatnonzero(np.abs(v - v[0]) > _STANDING * np.ptp(v))
            still = np.arange(len(record)) < (away[0] if away.size else len(record))
            standing[:, j] = still & np.isnan(outputs[:, j])
            if standing[:, j].any():
                outputs[standing[:, j], j] = moved[standing[:, j], j].mean()
        return cls(record, outputs, standing)

    @property
    def counted(self) -> Mask:
        """Samples (n,) that are compared on all axes."""
        return np.asarray(np.isfinite(self.outputs).all(axis=1))

    def residual(self, coupling: Array) -> Array:
        """Return measured minus modelled displacements (n, axes) [m]; NaN where they are not compared."""
        return self.record.displacement - apply(coupling, self.outputs)

    def nuisances(self) -> Array:
        """Return a constant, drifts, and the unknown level of each voltage that stands (n, p)."""
        since = (self.record.time - self.record.time[0]) / np.ptp(self.record.time)
        levels = [column for column in self.standing.T.astype(np.float64) if 0 < column.sum() < len(column)]
        return np.column_stack(
            [since - 0.5, np.log1p(1e3 * since) / np.log(1e3) - 0.5, *levels, *span_levels(self.record)]
        )
