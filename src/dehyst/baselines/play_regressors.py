"""What plays and low-passes see of the records: the rows to which rivals made of them are fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.baselines._native_plays import play_outputs
from dehyst.baselines.nonnegative_fit import Solved, nonnegative, ramps
from dehyst.baselines.training import Training
from dehyst.records import Record

_MOST_ROWS = 30_000
_QUARTERS = 4
# Least share of what decays leave beside constants and one another.
_NEW = 1e-6


@dataclass(frozen=True, eq=False)
class PlayRows:
    """Samples that count, of all records, stacked.

    Attributes
    ----------
    training : Training
        Displacements, and what records cannot be told without.
    thresholds : (N,) array
        r_i [V].
    plays : (n, N) array
        Outputs z_i [V].
    known : (n, N) bool array
        Whether play i is in a known state: else it stands still.
    lowpasses : (n, K) array
        Outputs [V].
    """

    training: Training
    thresholds: Array
    plays: Array
    known: NDArray[np.bool_]
    lowpasses: Array

    @classmethod
    def of(cls, training: Training, thresholds: Array, times: Array | None = None, most: int = _MOST_ROWS) -> PlayRows:
        """Play the records to plays of these thresholds (N,) [V] and low-passes of these times (K,) [s]."""
        few = training.thinned(most)
        constants = np.zeros(0) if times is None else times
        plays = few.played(lambda v: play_outputs(thresholds, np.full(thresholds.size, v[0]), v))
        passed = few.seen(lambda piece: lowpassed(piece, constants))
        # The range of a sampled wave ends a rounding error short of its turns.
        known = 2 * thresholds <= few.reach[:, None] * (1 + 1e-9)
        return cls(few, thresholds, plays, known, passed)

    def ramps(self, knots: Sequence[Array] | None = None) -> Array:
        """Columns (n, p) of the slopes of each play's curve, by default straight, and of the low-passes.

        Plays not known are left out.
        """
        bends = [np.zeros(0)] * self.thresholds.size if knots is None else knots
        curves = [ramps(z, k) * known[:, None] for z, k, known in zip(self.plays.T, bends, self.known.T, strict=True)]
        return np.concatenate([*curves, self.lowpasses], axis=1)

    def solved(
        self, columns: Array, floors: Array | None = None, rough: Array | None = None, smoothing: float = 0.0
    ) -> Solved:
        """Weights of columns (n, p) by nonnegative least squares; see `nonnegative_fit.nonnegative`."""
        few = self.training
        return nonnegative(columns, few.nuisances, few.displacement, floors, rough, smoothing)


def even_thresholds(training: Training, plays: int) -> Array:
    """Thresholds (N,) [V] from 0 that cut half of the voltage's range in equal parts."""
    low, high = training.limits
    return np.asarray(0.5 * (high - low) * np.arange(plays) / plays, dtype=np.float64)


def from_anywhere(training: Training, times: Array) -> Training:
    """The same for a model with low-passes of these times (K,) [s], which stand for drifts.

    What they held before the first sample is not known: its decay in each piece is a nuisance.
    """
    constants = training.offsets / np.linalg.norm(training.offsets, axis=0)
    decays = np.concatenate(
        [
            np.concatenate(
                [
                    _decay(piece, times) if piece is own else np.zeros((len(piece), times.size))
                    for own in training.pieces
                ],
                axis=1,
            )[rows]
            for piece, rows in zip(training.pieces, training.kept, strict=True)
        ]
    )
    # Slow ones look like constants: only what is new is kept, on an orthogonal basis.
    basis, sizes, _ = np.linalg.svd(decays - constants @ (constants.T @ decays), full_matrices=False)
    new = basis[:, sizes > _NEW * sizes.max(initial=0.0)] * np.sqrt(len(training))
    return replace(training, nuisances=np.hstack([training.offsets, new]))


def _decay(piece: Record, times: Array) -> Array:
    return np.asarray(np.exp(-(piece.time[:, None] - piece.time[0]) / times))


def lowpassed(piece: Record, times: Array) -> Array:
    """Low-passes (n, K) of a voltage (n,) [V], straight between samples, that rest at its first value before it."""
    v = piece.voltage
    ratio = np.diff(piece.time)[:, None] / times
    kept, taken = np.exp(-ratio), 1 + np.expm1(-ratio) / ratio
    pushed = v[:-1, None] * (1 - kept) + np.diff(v)[:, None] * taken
    out = np.empty((v.size, times.size))
    out[0] = v[0]
    for t in range(v.size - 1 if times.size else 0):
        out[t + 1] = kept[t] * out[t] + pushed[t]
    return out


def left_out(training: Training, columns: Array, floors: Array, rough: Array, smoothing: float) -> float:
    """RMS [m] over quarters of the epochs, each left out of a fit that then predicts it, but for its constant."""
    blocks = np.zeros(len(training), dtype=np.intp)
    for offset in training.offsets.T:
        stretch = np.flatnonzero(offset)
        blocks[stretch] = np.arange(stretch.size) * _QUARTERS // max(stretch.size, 1)
    squares, y, nuisances = 0.0, training.displacement, training.nuisances
    for block in range(_QUARTERS):
        kept, out = blocks != block, blocks == block
        weights = nonnegative(columns[kept], nuisances[kept], y[kept], floors, rough, smoothing).weights
        left, offsets = y[out] - columns[out] @ weights, training.offsets[out]
        missed = left - offsets @ np.linalg.lstsq(offsets, left, rcond=None)[0]
        squares += float(missed @ missed)
    return float(np.sqrt(squares / len(training)))
