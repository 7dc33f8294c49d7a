"""Regressors of models made of plays and low-passes, and the nonnegative least squares that fits their weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.baselines._native import play_outputs
from dehyst.records import Record
from dehyst.records.metrics import rms

if TYPE_CHECKING:
    from dehyst.baselines.training import Training

_MOST_ROWS = 30_000
_QUARTERS = 4
# Least share of a decay that constants and the other decays do not explain already.
_NEW = 1e-6


@dataclass(frozen=True, eq=False)
class PlayRows:
    """Outputs of plays and low-passes at the samples that count, stacked over all records.

    Attributes
    ----------
    training : Training
        Displacements and nuisances.
    thresholds : (N,) array
        r_i [V].
    plays : (n, N) array
        Outputs z_i [V].
    known : (n, N) bool array
        Whether the state of play i is known; a play whose state is not known stands still.
    lowpasses : (n, K) array
        Outputs [V].
    """

    training: Training
    thresholds: Array
    plays: Array
    known: NDArray[np.bool_]
    lowpasses: Array

    @classmethod
    def from_training(
        cls, training: Training, thresholds: Array, times: Array | None = None, most: int = _MOST_ROWS
    ) -> PlayRows:
        """Simulate plays of these thresholds (N,) [V] and low-passes of these times (K,) [s] on the records."""
        few = training.subsample(most)
        constants = np.zeros(0) if times is None else times
        plays = few.map_voltages(lambda v: play_outputs(thresholds, np.full(thresholds.size, v[0]), v))
        passed = few.map_records(lambda piece: low_pass(piece, constants))
        # The range of a sampled wave ends a rounding error short of its turns.
        known = 2 * thresholds <= few.reach[:, None] * (1 + 1e-9)
        return cls(few, thresholds, plays, known, passed)

    def ramps(self, knots: Sequence[Array] | None = None) -> Array:
        """Return the columns (n, p) of the slopes of each play's curve, by default straight, and of the low-passes.

        A play whose state is not known contributes 0.
        """
        bends = [np.zeros(0)] * self.thresholds.size if knots is None else knots
        curves = [ramps(z, k) * known[:, None] for z, k, known in zip(self.plays.T, bends, self.known.T, strict=True)]
        return np.concatenate([*curves, self.lowpasses], axis=1)

    def fit(
        self, columns: Array, floors: Array | None = None, rough: Array | None = None, smoothing: float = 0.0
    ) -> WeightFit:
        """Fit the weights of columns (n, p) by nonnegative least squares; see `fit_nonnegative`."""
        training = self.training
        return fit_nonnegative(columns, training.nuisances, training.displacement, floors, rough, smoothing)


def even_thresholds(training: Training, plays: int) -> Array:
    """Return thresholds (N,) [V] from 0 that divide half of the voltage's range into equal parts."""
    low, high = training.limits
    return np.asarray(0.5 * (high - low) * np.arange(plays) / plays, dtype=np.float64)


def with_unknown_start(training: Training, times: Array) -> Training:
    """Return a copy for a model with low-passes of these times (K,) [s], which replace the drifts.

    Their outputs before the first sample are not known: their decay in each piece is a nuisance.
    """
    constants = training.offsets / np.linalg.norm(training.offsets, axis=0)

    def decay(piece: Record, decaying: Record) -> Array:
        since = piece.time[:, None] - piece.time[0]
        return np.asarray(np.exp(-since / times)) if piece is decaying else np.zeros((len(piece), times.size))

    decays = training.map_records(lambda piece: np.hstack([decay(piece, other) for other in training.pieces]))
    # Slow decays look like constants: keep only what is new, on an orthogonal basis.
    basis, sizes, _ = np.linalg.svd(decays - constants @ (constants.T @ decays), full_matrices=False)
    new = basis[:, sizes > _NEW * sizes.max(initial=0.0)] * np.sqrt(len(training))
    return replace(training, nuisances=np.hstack([training.offsets, new]))


def low_pass(piece: Record, times: Array) -> Array:
    """Return low-passes (n, K) of a voltage (n,) [V]: linear between samples, at rest at its first value before it."""
    v = piece.voltage
    ratio = np.diff(piece.time)[:, None] / times
    kept, taken = np.exp(-ratio), 1 + np.expm1(-ratio) / ratio
    pushed = v[:-1, None] * (1 - kept) + np.diff(v)[:, None] * taken
    out = np.empty((v.size, times.size))
    out[0] = v[0]
    for t in range(v.size - 1 if times.size else 0):
        out[t + 1] = kept[t] * out[t] + pushed[t]
    return out


def cross_validation_error(training: Training, columns: Array, floors: Array, rough: Array, smoothing: float) -> float:
    """Return the RMS error [m] of predicting each quarter of the epochs from a fit to the rest, its constant free."""
    blocks = np.zeros(len(training), dtype=np.intp)
    for offset in training.offsets.T:
        stretch = np.flatnonzero(offset)
        blocks[stretch] = np.arange(stretch.size) * _QUARTERS // max(stretch.size, 1)
    squares, y, nuisances = 0.0, training.displacement, training.nuisances
    for block in range(_QUARTERS):
        kept, held_out = blocks != block, blocks == block
        weights = fit_nonnegative(columns[kept], nuisances[kept], y[kept], floors, rough, smoothing).weights
        rest, offsets = y[held_out] - columns[held_out] @ weights, training.offsets[held_out]
        residual = rest - offsets @ np.linalg.lstsq(offsets, rest, rcond=None)[0]
        squares += float(residual @ residual)
    return float(np.sqrt(squares / len(training)))


class WeightFit(NamedTuple):
    """Weights (p,), coefficients of the nuisances (B,) and the RMS residual."""

    weights: Array
    nuisances: Array
    rms: float


def ramps(z: Array, knots: Array) -> Array:
    """Return columns (n, K + 1) whose weights are the slopes of a curve through (knots[0], 0), without knots (0, 0)."""
    edges = np.concatenate([[-np.inf], knots, [np.inf]])
    origin = knots[0] if knots.size else 0.0
    return np.asarray(np.clip(z[:, None], edges[:-1], edges[1:]) - np.clip(origin, edges[:-1], edges[1:]))


def fit_nonnegative(
    columns: Array,
    nuisance: Array,
    target: Array,
    floors: Array | None = None,
    rough: Array | None = None,
    smoothing: float = 0.0,
) -> WeightFit:
    """Fit weights of columns, each at least its floor, beside nuisances of any sign, by least squares.

    Parameters
    ----------
    columns : (n, p) array
    nuisance : (n, B) array
    target : (n,) array
    floors : (p,) array, optional
        Least weights; by default 0.
    rough : (m, p) array, optional
        Combinations of the weights that shall be small; by default each weight.
    smoothing : float, optional
        Weight of their squares, relative to the largest mean square of a column.
    """
    from scipy.optimize import nnls

    count = columns.shape[1]
    least = np.zeros(count) if floors is None else floors
    scale, y_scale = float(np.sqrt(np.mean(columns**2, axis=0)).max()), float(np.ptp(target))
    rest = (target - columns @ least) / y_scale
    # The triangular factor below the nuisances' rows is the same problem without them.
    r = np.asarray(np.linalg.qr(np.column_stack([nuisance, columns / scale, rest]), mode="r"))
    r = r[nuisance.shape[1] :, nuisance.shape[1] :]
    penalty = np.sqrt(smoothing * target.size) * (np.eye(count) if rough is None else rough)
    penalty_target = -penalty @ least * scale / y_scale
    excess, _ = nnls(np.concatenate([r[:, :-1], penalty]), np.append(r[:, -1], penalty_target), maxiter=30 * count)
    weights = least + excess * y_scale / scale
    rest = target - columns @ weights
    coefficients = np.asarray(np.linalg.lstsq(nuisance, rest, rcond=None)[0], dtype=np.float64)
    return WeightFit(weights, coefficients, rms(rest - nuisance @ coefficients))


def differences(shape: Sequence[int], *, beside: Sequence[tuple[int, int]] = ((0, 1), (1, 0))) -> Array:
    """Return rows (m, p) that subtract neighbours in a table whose row i has shape[i] places; row 0 is left out.

    `beside` holds the steps (rows, places) from a place to its neighbours.
    """
    first = np.cumsum([0, *shape])
    pairs = [
        (first[i] + j, first[i + di] + j + dj)
        for i in range(1, len(shape))
        for j in range(shape[i])
        for di, dj in beside
        if i + di < len(shape) and 0 <= j + dj < shape[i + di]
    ]
    rows = np.zeros((len(pairs), int(first[-1])))
    for row, (a, b) in zip(rows, pairs, strict=True):
        row[[a, b]] = 1.0, -1.0
    return rows
