"""The coupling matrix of a stage by one linear least squares (theory section 16), and by its actuators' models.

The regressors of the first are plays of every voltage, and what a record adds of its own; of the other, the outputs of
the models.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import IdentifyError, RecordError
from dehyst._native import slip_elongations
from dehyst._types import Array, Mask
from dehyst.identification.fit import Fit
from dehyst.model import apply, inverse
from dehyst.records import Record

# Of the energy of the columns: a ridge against columns that the record hardly moves.
_RIDGE = 1e-8
# Spans of the records that are left out in turn for the standard errors.
_SPANS = 24
# Passes in which spans of time get the weight of their residuals, and the least power of one, of the mean.
_REWEIGHTED, _LEAST_POWER = 4, 1e-3
# Share of a voltage's motion that no other voltage explains: below the first the axes cannot be distinguished, below
# the second they are distinguished badly.
INSEPARABLE, BARELY = 0.01, 0.1
# Two displacements are the same if they differ by less, of the stroke: by the rounding of a file.
_SAME = 1e-6
# Least share of a displacement's motion that the voltages explain. Noise alone has that of the regressors among the
# samples, about a hundredth.
_EXPLAINED = 0.05
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
class Coupling:
    """A coupling matrix.

    Attributes
    ----------
    matrix, uncertainty : (axes, axes) array
        The matrix, and the standard error of each entry.
    share : (axes,) array
        Rank-one share: the part of the energy of all displacements by each voltage that is one shape times a column of
        the matrix.
    """

    matrix: Array
    uncertainty: Array
    share: Array


def coupling_by_plays(columns: PlayColumns) -> Coupling:
    """Return the coupling by one least squares of all displacements on the plays of all voltages."""
    blocks, measured = columns.whitened, columns.without_nuisances(columns.displacement)
    sizes = np.cumsum([0, *(block.shape[1] for block in blocks)])
    grams, rights = _products(np.hstack(blocks), measured, columns.groups(_SPANS), range(_SPANS))
    gram, right = grams.sum(axis=0), rights.sum(axis=0)
    matrix, share = _factored(gram, right, sizes)
    left_out = [_factored(gram - one, right - other, sizes)[0] for one, other in zip(grams, rights, strict=True)]
    return Coupling(matrix, _jackknife(left_out), share)


def coupling_by_models(traces: Sequence[AxisTraces], share: Array) -> Coupling:
    """Return the coupling by least squares of the displacements on the outputs of the models.

    The models' errors differ between spans of time and are largest while an axis moves. So each span is weighted by its
    mean square residual, separately for each displacement.
    """
    counted = [one.counted for one in traces]
    displacement = np.concatenate([one.record.displacement[rows] for one, rows in zip(traces, counted, strict=True)])
    outputs = np.concatenate([one.outputs[rows] for one, rows in zip(traces, counted, strict=True)])
    nuisances = _diagonal([one.nuisances()[rows] for one, rows in zip(traces, counted, strict=True)])
    moving = (np.ptp(nuisances, axis=0) > 0) | (nuisances != 0).all(axis=0)
    sizes = [int(rows.sum()) for rows in counted]
    groups = np.concatenate([np.arange(size) * _SPANS // max(size, 1) for size in sizes])
    count = outputs.shape[1]
    rows = np.hstack([outputs, nuisances[:, moving]])
    scales = np.sqrt((rows**2).sum(axis=0))
    rows = rows / np.where(scales > 0, scales, 1.0)
    spans = np.unique(groups)
    grams, rights = _products(rows, displacement, groups, spans)
    matrix, uncertainty = np.empty((count, count)), np.empty((count, count))
    for i in range(count):
        weights = np.ones((len(spans), 1, 1))
        for _ in range(_REWEIGHTED):
            solution = _solution((weights * grams).sum(axis=0), (weights * rights).sum(axis=0))
            left = displacement[:, i] - rows @ solution[:, i]
            power = np.array([np.mean(left[groups == g] ** 2) for g in spans])
            found = power.mean() / np.maximum(power, _LEAST_POWER * power.mean())
            weights = (found / found.mean())[:, None, None]
        weighted, right = weights * grams, weights * rights
        # All spans, then without one in turn.
        sums = [(weighted.sum(axis=0), right.sum(axis=0))]
        sums += [(sums[0][0] - one, sums[0][1] - other) for one, other in zip(weighted, right, strict=True)]
        raw = np.array([_solution(*one)[:count, i] / scales[:count] for one in sums])
        entries = raw / raw[:, i : i + 1]
        matrix[i], uncertainty[i] = entries[0], _jackknife(entries[1:])
    return Coupling(matrix, uncertainty, share)


def _products(rows: Array, right: Array, groups: NDArray[np.intp], spans: Iterable[int]) -> tuple[Array, Array]:
    """Return the products (S, p, p) and (S, p, axes) of each span of time."""
    parts = [(rows[groups == g], right[groups == g]) for g in spans]
    return np.array([own.T @ own for own, _ in parts]), np.array([own.T @ other for own, other in parts])


def _solution(gram: Array, right: Array) -> Array:
    return np.asarray(np.linalg.solve(gram + _RIDGE * np.eye(len(gram)), right))


def _factored(gram: Array, right: Array, sizes: Array) -> tuple[Array, Array]:
    """Return the coupling matrix and the rank-one share of each block of the solution.

    The columns of a block are orthonormal up to their scale: the singular vectors of the coefficients in their own
    metric are those of the displacements that they cause.
    """
    solution, count = _solution(gram, right), right.shape[1]
    matrix, shares = np.empty((count, count)), np.empty(count)
    for j in range(count):
        part = slice(int(sizes[j]), int(sizes[j + 1]))
        metric = np.linalg.cholesky(gram[part, part] + _RIDGE * np.eye(part.stop - part.start))
        _, values, axes = np.linalg.svd(metric.T @ solution[part], full_matrices=False)
        matrix[:, j] = axes[0] / axes[0, j]
        shares[j] = values[0] ** 2 / np.sum(values**2)
    return matrix, shares


def _jackknife(left_out: Sequence[Array] | Array) -> Array:
    """Return the standard error of each entry by leaving one span out in turn."""
    table = np.array(left_out)
    count = len(table)
    return np.asarray(np.sqrt((count - 1) / count * ((table - table.mean(axis=0)) ** 2).sum(axis=0)))


def separate_motion(columns: PlayColumns) -> Array:
    """Return the share (axes,) of the motion of each voltage that no function of the other voltages explains."""
    shares = []
    for j, block in enumerate(columns.blocks):
        own = columns.without_nuisances(block[:, 0])
        others = np.hstack([other for k, other in enumerate(columns.whitened) if k != j] or [np.zeros((len(own), 1))])
        left = own - others @ np.linalg.lstsq(others, own, rcond=1e-9)[0]
        energy = float(own @ own)
        shares.append(float(left @ left) / energy if energy > 0 else 0.0)
    return np.array(shares)


def refuse_inseparable(names: Sequence[str], shares: Array) -> list[str]:
    """Return remarks on axes that hardly move by themselves; raise `IdentifyError` if an axis never does."""
    remarks = []
    for name, share in zip(names, shares, strict=True):
        if share < INSEPARABLE:
            others = ", ".join(other for other in names if other != name)
            raise IdentifyError(
                f"axis {name}: its voltage moves together with those of {others} at all times ({100 * share:.2g} % of "
                "its motion is its own), so that their displacements cannot be distinguished; record the axes one "
                "after the other, or together with different periods: dehyst excite stage"
            )
        if share < BARELY:
            remarks.append(
                f"axis {name}: only {100 * share:.2g} % of the motion of its voltage is its own; record it alone too: "
                "dehyst excite stage"
            )
    return remarks


def refuse_still(records: Sequence[Record]) -> None:
    """Raise `RecordError` if the voltage or the displacement of an axis moves in none of the records."""
    names = records[0].axes
    for j, name in enumerate(names):
        if all(np.ptp(one.voltage[:, j]) == 0 for one in records):
            held = records[0].voltage[0, j]
            raise RecordError(
                f"axis {name}: its voltage is constant, {held:.6g} V, need one that moves: record all axes moving, one "
                "after the other or together: dehyst excite stage"
            )
        if all(np.ptp(one.displacement[:, j]) == 0 for one in records):
            raise RecordError(
                f"axis {name}: its displacement does not move; check its sensor, and the column that is read: --columns"
            )


def refuse_equal(records: Sequence[Record]) -> None:
    """Raise `RecordError` if the displacements of two axes differ by a constant."""
    names = records[0].axes
    for i, j in combinations(range(len(names)), 2):
        pairs = [one.displacement[:, [i, j]] for one in records]
        if all(np.ptp(pair[:, 0] - pair[:, 1]) <= _SAME * np.ptp(pair, axis=0).max() for pair in pairs):
            raise RecordError(
                f"axes {names[i]} and {names[j]}: their displacements are the same but for a constant; check which "
                "column is read as which axis: --columns"
            )


def refuse_unmoved(columns: PlayColumns, names: Sequence[str]) -> None:
    """Raise `RecordError` if the voltages together explain next to nothing of the motion of a displacement."""
    motion = columns.without_nuisances(columns.displacement)
    basis = np.linalg.qr(np.hstack(columns.whitened))[0]
    explained = ((basis.T @ motion) ** 2).sum(axis=0) / (motion**2).sum(axis=0)
    for name, share in zip(names, explained, strict=True):
        if share < _EXPLAINED:
            raise RecordError(
                f"axis {name}: its displacement follows none of the voltages: they explain {100 * share:.2g} % of its "
                "motion; check its sensor, and the column that is read: --columns"
            )


@dataclass(frozen=True, eq=False)
class PlayColumns:
    """Regressors of records of a stage, block means over samples, the records one after another.

    Attributes
    ----------
    blocks : tuple of (m, K) array
        For each axis, plays of its voltage bent by ramps, in ranges of the voltage.
    nuisances : (m, P) array
        For each record: a constant, drifts, and the decaying effects of its unknown start.
    displacement : (m, axes) array
        Displacements [m].
    place : (m,) array
        Share of the record's duration, 0 to 1.
    every : int
        Number of samples in each mean.
    """

    blocks: tuple[Array, ...]
    nuisances: Array
    displacement: Array
    place: Array
    every: int

    @classmethod
    def of(cls, records: Sequence[Record], most: int = MOST_ROWS) -> PlayColumns:
        """Make the regressors of records of one stage."""
        every = max(1, sum(map(len, records)) // most)
        low = np.min([record.voltage.min(axis=0) for record in records], axis=0)
        high = np.max([record.voltage.max(axis=0) for record in records], axis=0)
        span = np.maximum(high - low, 1e-12)
        blocks: list[list[Array]] = [[] for _ in low]
        nuisances = []
        for record in records:
            own = []
            for j, block in enumerate(blocks):
                motion, starts = motion_of(record.voltage[:, j], low[j], span[j])
                block.append(block_means(motion, every))
                own += [column for column in block_means(starts, every).T if np.ptp(column) > _EMPTY]
            slow = np.column_stack([*drifts(record), *span_levels(record)])
            nuisances.append(np.column_stack([*own, *block_means(slow, every).T]))
        place = np.concatenate([(np.arange(len(own)) + 0.5) / len(own) for own in nuisances])
        displacement = np.concatenate([block_means(record.displacement, every) for record in records])
        return cls(tuple(map(np.concatenate, blocks)), _diagonal(nuisances), displacement, place, every)

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
        """Return the part of `values` (m, ...) that the nuisances do not explain."""
        return np.asarray(values - self.own @ (self.own.T @ values))

    def groups(self, count: int) -> NDArray[np.intp]:
        """Return a number (m,) for each row: contiguous spans of each record, `count` in all of each."""
        return np.minimum((self.place * count).astype(np.intp), count - 1)


def block_means(values: Array, every: int) -> Array:
    """Return the means (m, ...) of blocks of `every` neighbouring rows; an incomplete last block is dropped."""
    whole = len(values) // every * every
    return np.asarray(values[:whole].reshape(-1, every, *values.shape[1:]).mean(axis=1))


def drifts(record: Record) -> tuple[Array, Array]:
    """Return slow nuisances (n,): linear and logarithmic in the time since the start of a record."""
    since = (record.time - record.time[0]) / (record.time[-1] - record.time[0])
    return since - 0.5, np.log1p(since / _LOGARITHM) / np.log1p(1 / _LOGARITHM) - 0.5


def span_levels(record: Record) -> Array:
    """Return the unknown level of each span of some cycles (spans, n): slow motions that no voltage explains."""
    cycles = [len(record.axis(j).cycles()) for j in range(len(record.axes))]
    count = int(np.clip(sum(cycles) / _CYCLES, 1, _MOST_SPANS))
    place = np.arange(len(record)) * count // len(record)
    return np.asarray(place == np.arange(count)[:, None], dtype=np.float64)


def motion_of(voltage: Array, low: float, span: float) -> tuple[Array, Array]:
    """Return bent plays (n, K) of a voltage (n,) [V], and the decaying effects (n, p) of their unknown start."""
    u = np.ascontiguousarray((voltage - low) / span)
    radius = 0.5 * _THRESHOLDS[1:]

    def plays(start: float) -> Array:
        elongations, _ = slip_elongations(radius, u[0] - start * radius, u)
        return np.column_stack([u, u[:, None] - elongations])

    # Begun relaxed, after a long fall and after a long rise: a play that began elsewhere differs until its voltage has
    # moved far enough.
    relaxed, *others = map(plays, (0.0, -1.0, 1.0))
    bent = np.hstack([relaxed, *(np.maximum(relaxed - bend, 0.0) for bend in _BENDS)])
    return bent, np.hstack([other - relaxed for other in others])


def _diagonal(parts: Sequence[Array]) -> Array:
    """Return the block-diagonal matrix of some."""
    result = np.zeros((sum(len(part) for part in parts), sum(part.shape[1] for part in parts)))
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
    """Models of all axes compared with a record.

    Attributes
    ----------
    record : Record
    outputs : (n, axes) array
        Displacement of each actuator by its model [m]; NaN where it is not compared, as before the second turning point
        of its voltage. While the voltage has not moved yet, the output is its mean.
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
            trace, v = fit.traces[number].settled, record.voltage[:, j]
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
        levels = [column for column in self.standing.T.astype(np.float64) if 0 < column.sum() < len(column)]
        return np.column_stack([*drifts(self.record), *levels, *span_levels(self.record)])
