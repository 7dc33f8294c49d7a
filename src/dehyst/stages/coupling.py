"""The coupling matrix of a stage by one linear least squares (theory section 16), and by its actuators' models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import IdentifyError, RecordError
from dehyst._types import Array
from dehyst.records import Record
from dehyst.stages.regressors import PlayColumns

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
    rows = np.hstack(blocks)
    sizes = np.cumsum([0, *(block.shape[1] for block in blocks)])
    groups = columns.groups(_SPANS)
    grams = [_products(rows[groups == g], measured[groups == g]) for g in range(_SPANS)]
    total = _summed(grams)
    matrix, share = _factored(*total, sizes)
    left_out = [_factored(total[0] - gram, total[1] - right, sizes)[0] for gram, right in grams]
    return Coupling(matrix, _jackknife(left_out), share)


def coupling_by_models(
    displacement: Array, outputs: Array, nuisances: Array, groups: NDArray[np.intp], share: Array
) -> Coupling:
    """Return the coupling by least squares of displacements (m, axes) on the models' outputs (m, axes).

    Spans of time, the `groups` (m,), differ in what the models miss: while an axis moves it misses most. Each span has
    the weight of its mean square residual, for each displacement by itself.
    """
    count = outputs.shape[1]
    rows = np.hstack([outputs, nuisances])
    scales = np.sqrt((rows**2).sum(axis=0))
    rows = rows / np.where(scales > 0, scales, 1.0)
    spans = np.unique(groups)
    grams = [_products(rows[groups == g], displacement[groups == g]) for g in spans]
    matrix, uncertainty = np.empty((count, count)), np.empty((count, count))
    for i in range(count):
        weights = np.ones(len(spans))
        for _ in range(_REWEIGHTED):
            solution = _solution(
                *_summed([(w * gram, w * right) for w, (gram, right) in zip(weights, grams, strict=True)])
            )
            left = displacement[:, i] - rows @ solution[:, i]
            power = np.array([np.mean(left[groups == g] ** 2) for g in spans])
            weights = power.mean() / np.maximum(power, _LEAST_POWER * power.mean())
            weights /= weights.mean()
        weighted = [(w * gram, w * right) for w, (gram, right) in zip(weights, grams, strict=True)]
        total = _summed(weighted)

        def row(gram: Array, right: Array, i: int = i) -> Array:
            raw = _solution(gram, right)[:count, i] / scales[:count]
            return np.asarray(raw / raw[i])

        matrix[i] = row(*total)
        uncertainty[i] = _jackknife([row(total[0] - gram, total[1] - right) for gram, right in weighted])
    return Coupling(matrix, uncertainty, share)


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


def refuse_inseparable(records: Sequence[Record], shares: Array) -> list[str]:
    """Return remarks on axes that hardly move by themselves; raise `IdentifyError` if an axis never does."""
    names, remarks = records[0].axes, []
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


def _products(rows: Array, right: Array) -> tuple[Array, Array]:
    return rows.T @ rows, rows.T @ right


def _summed(parts: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    return np.sum([gram for gram, _ in parts], axis=0), np.sum([right for _, right in parts], axis=0)


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


def _jackknife(left_out: Sequence[Array]) -> Array:
    """Return the standard error of each entry by leaving one span out in turn."""
    table = np.array(left_out)
    count = len(table)
    return np.asarray(np.sqrt((count - 1) / count * ((table - table.mean(axis=0)) ** 2).sum(axis=0)))


def refuse_still_or_equal(records: Sequence[Record]) -> None:
    """Raise `RecordError` if an axis moves in none of the records, or two displacements differ by a constant."""
    names = records[0].axes
    for j, name in enumerate(names):
        if all(np.ptp(one.voltage[:, j]) == 0 for one in records):
            held = records[0].voltage[0, j]
            raise RecordError(
                f"axis {name}: its voltage is constant, {held:.6g} V, need one that moves; record each axis alone: "
                "dehyst excite stage"
            )
        if all(np.ptp(one.displacement[:, j]) == 0 for one in records):
            raise RecordError(
                f"axis {name}: its displacement does not move; check its sensor, and the column that is read: --columns"
            )
    for i, j in combinations(range(len(names)), 2):
        if all(_same(one, i, j) for one in records):
            raise RecordError(
                f"axes {names[i]} and {names[j]}: their displacements are the same but for a constant; check which "
                "column is read as which axis: --columns"
            )


def refuse_unmoved(columns: PlayColumns, names: Sequence[str]) -> None:
    """Raise `RecordError` if the voltages together explain next to nothing of the motion of a displacement."""
    motion = columns.without_nuisances(columns.displacement)
    basis = np.linalg.qr(np.hstack(columns.whitened))[0]
    energy = (motion**2).sum(axis=0)
    explained = ((basis.T @ motion) ** 2).sum(axis=0)
    for name, part, whole in zip(names, explained, energy, strict=True):
        if part < _EXPLAINED * whole:
            raise RecordError(
                f"axis {name}: its displacement follows none of the voltages: they explain {100 * part / whole:.2g} % "
                "of its motion; check its sensor, and the column that is read: --columns"
            )


def _same(record: Record, i: int, j: int) -> bool:
    difference = record.displacement[:, i] - record.displacement[:, j]
    return bool(np.ptp(difference) <= _SAME * np.ptp(record.displacement[:, [i, j]], axis=0).max())
