"""Regressors of a stage: plays of every voltage, what a record adds of its own, and the outputs of the models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dehyst._native import slip_elongations
from dehyst._types import Array, Mask
from dehyst.identification import Fit
from dehyst.records import Record
from dehyst.stages.stage import apply, inverse

# Thresholds of the plays in half ranges of the voltage, and where their curves bend, in ranges.
_THRESHOLDS = np.array([0.0, 0.04, 0.1, 0.18, 0.28, 0.4, 0.54, 0.7])
_BENDS = (0.25, 0.5, 0.75)
# Rows of a regression; more samples are averaged over blocks.
MOST_ROWS = 24_000
# Time constants of slow nuisances: logarithms of the time since the start of a record, in its durations.
_LOGARITHM = 1e-3
# Cycles of a span of time whose level is free, and most spans of a record.
_CYCLES, _MOST_SPANS = 3, 24
# Relative size below which a column is rounding.
_EMPTY = 1e-9
# Least size of a direction of nuisances that is new, and of the motion of a block that determines anything.
_NEW, _MOVING = 1e-6, 1e-4
# Of the range of a voltage: it stands while it moves by less.
_STANDING = 2e-3


@dataclass(frozen=True, eq=False)
class PlayColumns:
    """Regressors of records of a stage, block means over samples, the records one after another.

    Attributes
    ----------
    blocks : tuple of (m, K) array
        For each axis, plays of its voltage bent by ramps, in ranges of the voltage.
    nuisances : (m, P) array
        Of each record: a constant, drifts, and the decaying effects of its unknown start.
    displacement : (m, axes) array
        [m].
    record : (m,) array
        Index of the record.
    place : (m,) array
        Share of the record's duration, 0 to 1.
    samples : tuple of int
        How many samples a mean is taken of, for each record.
    """

    blocks: tuple[Array, ...]
    nuisances: Array
    displacement: Array
    record: NDArray[np.intp]
    place: Array
    samples: tuple[int, ...]

    @classmethod
    def of(cls, records: Sequence[Record], most: int = MOST_ROWS) -> PlayColumns:
        """Make the regressors of records of one stage."""
        every = max(1, sum(map(len, records)) // most)
        low = np.min([record.voltage.min(axis=0) for record in records], axis=0)
        high = np.max([record.voltage.max(axis=0) for record in records], axis=0)
        parts = [_columns(record, low, np.maximum(high - low, 1e-12), every) for record in records]
        axes = range(len(low))
        blocks = tuple(np.concatenate([part[0][j] for part in parts]) for j in axes)
        nuisances = _diagonal([part[1] for part in parts])
        displacement = np.concatenate([block_means(record.displacement, every) for record in records])
        sizes = [len(part[1]) for part in parts]
        number = np.repeat(np.arange(len(records)), sizes)
        place = np.concatenate([(np.arange(size) + 0.5) / size for size in sizes])
        return cls(blocks, nuisances, displacement, number, place, tuple(every for _ in records))

    @cached_property
    def own(self) -> Array:
        """An orthonormal basis (m, p) of the nuisances."""
        sizes = np.linalg.norm(self.nuisances, axis=0)
        return _basis(self.nuisances / np.where(sizes > 0, sizes, 1.0), _NEW)

    @cached_property
    def whitened(self) -> tuple[Array, ...]:
        """An orthonormal basis (m, r) of each block's motion, the nuisances set aside."""
        return tuple(_basis(self.without_nuisances(block), _MOVING) for block in self.blocks)

    def without_nuisances(self, values: Array) -> Array:
        """Return what the nuisances do not explain of `values` (m, ...)."""
        return np.asarray(values - self.own @ (self.own.T @ values))

    def groups(self, count: int) -> NDArray[np.intp]:
        """Return a number (m,) for each row: contiguous spans of each record, `count` in all of each."""
        return np.minimum((self.place * count).astype(np.intp), count - 1)


def block_means(values: Array, every: int) -> Array:
    """Return the means (m, ...) of `every` neighbouring rows each; what is left at the end is no block."""
    whole = len(values) // every * every
    return np.asarray(values[:whole].reshape(-1, every, *values.shape[1:]).mean(axis=1))


def _columns(record: Record, low: Array, span: Array, every: int) -> tuple[list[Array], Array]:
    """Return the block of each axis, and the nuisances."""
    blocks, nuisances = [], []
    since = (record.time - record.time[0]) / (record.time[-1] - record.time[0])
    for j in range(len(record.axes)):
        block, starts = motion_of(record.voltage[:, j], low[j], span[j])
        blocks.append(block_means(block, every))
        nuisances += [column for column in block_means(starts, every).T if np.ptp(column) > _EMPTY]
    logarithm = np.log1p(since / _LOGARITHM) / np.log1p(1 / _LOGARITHM)
    slow = [since - 0.5, logarithm - 0.5, *span_levels(record)]
    nuisances += list(block_means(np.column_stack(slow), every).T)
    return blocks, np.column_stack(nuisances)


def span_levels(record: Record) -> Array:
    """Return the unknown level of each span of some cycles (spans, n): slow motions that no voltage explains."""
    cycles = [len(record.axis(j).cycles()) for j in range(len(record.axes))]
    count = int(np.clip(sum(cycles) / _CYCLES, 1, _MOST_SPANS))
    place = np.arange(len(record)) * count // len(record)
    return np.asarray(place == np.arange(count)[:, None], dtype=np.float64)


def motion_of(voltage: Array, low: float, span: float) -> tuple[Array, Array]:
    """Return bent plays (n, K) of a voltage (n,) [V], and the decaying effects (n, p) of their unknown start."""
    u = np.ascontiguousarray((voltage - low) / span)
    relaxed, *others = (_plays(u, start) for start in (0.0, -1.0, 1.0))
    # A play that began elsewhere differs until its voltage has moved far enough.
    return _bent(relaxed), np.hstack([other - relaxed for other in others])


def _plays(u: Array, start: float) -> Array:
    """Return plays (n, K) of u (n,): begun relaxed, after a long fall (-1) or after a long rise (1)."""
    radius = 0.5 * _THRESHOLDS[1:]
    elongations, _ = slip_elongations(radius, u[0] - start * radius, u)
    return np.column_stack([u, u[:, None] - elongations])


def _bent(plays: Array) -> Array:
    """Return plays and their parts above each bend (n, K (1 + bends))."""
    return np.hstack([plays, *(np.maximum(plays - bend, 0.0) for bend in _BENDS)])


def _diagonal(parts: Sequence[Array]) -> Array:
    rows, columns = sum(len(part) for part in parts), sum(part.shape[1] for part in parts)
    result = np.zeros((rows, columns))
    row = column = 0
    for part in parts:
        result[row : row + len(part), column : column + part.shape[1]] = part
        row, column = row + len(part), column + part.shape[1]
    return result


def _basis(block: Array, least: float) -> Array:
    """Return an orthonormal basis of the columns, without directions that are smaller than `least` of the largest."""
    left, sizes, _ = np.linalg.svd(block, full_matrices=False)
    return np.asarray(left[:, sizes > least * sizes.max(initial=0.0)])


@dataclass(frozen=True, eq=False)
class AxisTraces:
    """Models of all axes beside a record.

    Attributes
    ----------
    record : Record
    outputs : (n, axes) array
        Displacement of each actuator by its model [m]; NaN where it is not compared. While the voltage of an actuator
        has not moved yet, its output is its mean.
    standing : (n, axes) bool array
        Where a voltage has not moved yet.
    """

    record: Record
    outputs: Array
    standing: Mask

    @classmethod
    def of(cls, record: Record, fits: Sequence[Fit], number: int, coupling: Array) -> AxisTraces:
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
