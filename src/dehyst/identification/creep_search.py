"""Creep in displacement: identified from the drift in holds, and selected by held-out holds (theory section 19).

``y = m + sum_k g_k lowpass_k(m)``, m the displacement without creep. With m known, y is linear in the gains and in a
curve of plays of the voltage, which stands for any hysteresis: hats of plays. So the gains follow from a non-negative
least-squares problem and m from the gains, in turns. Rows for the drift within holds of the voltage are added, because
the whole record hardly depends on the gains.

Creep as a force beside the elements and creep in displacement drift alike while the voltage holds. They differ in what
follows from it where the displacement holds, and in how much drifts where the hysteresis curve is flat or steep: parts
of the records are held out, and decide.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array, Mask
from dehyst.identification.preprocessing.preparation import Prepared
from dehyst.identification.preprocessing.regressors import epochs, play_curves
from dehyst.identification.rules import RULES
from dehyst.identification.training_data import FEW_STEPS, TrainingData
from dehyst.model import DisplacementCreep
from dehyst.records import Record, white_noise

# Time constants in a decade, rounds of gains and displacement, weight of the drift in holds and of equal neighbours.
_A_DECADE, _ROUNDS, _OF_HOLDS, _ALIKE = 2, 5, 5.0, 0.5
# The fastest in `TrainingData.fastest_creep`, the slowest in lengths of the longest record.
_FASTEST, _LONGEST = 3.0, 2.0
_ROWS = 4000
# Ridge of the curves of plays, relative to their mean square.
_RIDGE = 1e-6
# Branches of less than this part of all gains are left out.
_LEAST = 1e-3
# A voltage holds while it stays within this part of its range; fewer samples are no hold.
_STILL, _FEWEST = 1e-4, 12


def holds(record: Record, span: float, least: float) -> list[slice]:
    """Return the samples of each time that a voltage holds for at least `least` [s]; `span` is its range [V]."""
    v, found = record.voltage, []
    width = max(_STILL * span, 6 * white_noise(v))
    # Where it moves by more from one sample to the next, no hold goes on.
    jumps = np.flatnonzero(np.abs(np.diff(v)) > width) + 1
    for a, b in pairwise([0, *jumps.tolist(), len(v)]):
        first = a
        while b - first >= _FEWEST:
            inside = np.maximum.accumulate(v[first:b]) - np.minimum.accumulate(v[first:b]) <= width
            last = first + (int(np.argmin(inside)) if not inside.all() else b - first)
            if last - first >= _FEWEST and record.time[last - 1] - record.time[first] >= least:
                found.append(slice(first, last))
            first = max(last, first + 1)
    return found


class _PlayedPiece(NamedTuple):
    """A piece of a record.

    `number`: of the record. `rows`: the samples that count. `curves` (n, C): hats of plays, a constant of the piece,
    and the decay of creep from before the record. `holds`: the samples that hold.
    """

    number: int
    item: Prepared
    piece: Record
    rows: NDArray[np.intp]
    curves: Array
    holds: list[slice]


@dataclass(frozen=True, eq=False)
class CreepSearch:
    """The search for creep in displacement: pieces of records, and time constants [s]."""

    paths: tuple[_PlayedPiece, ...]
    time_constants: Array

    @classmethod
    def of(cls, frame: TrainingData) -> CreepSearch | None:
        """Return the search in records; None if no hold is long enough to show creep."""
        low, high = frame.voltages
        sampled = [
            (q, item, piece, (late.voltage - low) / (high - low))
            for q, item in enumerate(frame.training)
            for late, piece in zip(item.acting(frame.lagging.delay, frame.lagging.lag), item.pieces, strict=True)
        ]
        step = max(1, sum(u.size for _, _, _, u in sampled) // _ROWS)
        # As long as the fastest cycle lasts.
        least, paths = FEW_STEPS * frame.fastest_creep / RULES.slowest_lag, []
        fastest, longest = _FASTEST * frame.fastest_creep, _LONGEST * frame.times[1]
        tau = np.geomspace(fastest, longest, max(2, round(_A_DECADE * np.log10(longest / fastest)) + 1))
        for number, (q, item, piece, u) in enumerate(sampled):
            if not (own := epochs(piece, item.noise)):
                continue
            constants, starts = (
                np.zeros((u.size, len(sampled))),
                np.zeros((u.size, len(frame.training), tau[1::2].size)),
            )
            constants[:, number] = 1.0
            starts[:, q] = _fading(item, piece.time, tau[1::2])
            curves = np.hstack([play_curves(u), constants, starts.reshape(u.size, -1)])
            rows = np.arange(own[-1].start, own[-1].stop, step)
            paths.append(_PlayedPiece(q, item, piece, rows, curves, holds(piece, high - low, least)))
        return cls(tuple(paths), tau) if any(path.holds for path in paths) else None

    def held(self, number: int) -> list[tuple[float, float]]:
        """Return the first and last time [s] of each hold of the record of this number."""
        spans = [path.piece.time[one] for path in self.paths if path.number == number for one in path.holds]
        return [(float(time[0]), float(time[-1])) for time in spans]

    def flattens(self, part: DisplacementCreep) -> bool:
        """Whether the displacements before this creep drift less in holds than those measured."""
        measured, before = [], []
        for path in self.paths:
            item = path.item.without_creep(part).record
            m = part.at_rest * np.interp(path.piece.time, item.time, item.displacement)
            measured += [float(np.var(path.piece.displacement[one])) for one in path.holds]
            before += [float(np.var(m[one])) for one in path.holds]
        return float(np.mean(before)) < RULES.hold_gain**2 * float(np.mean(measured))

    def find(self, skipped: Callable[[Prepared, Array], Mask] | None = None) -> DisplacementCreep | None:
        """Return the creep with the least error; None if there is no creep.

        `skipped`: record and times (n,) [s] -> mask of the held-out samples.
        """
        from scipy.optimize import nnls

        used = [
            path.rows if skipped is None else path.rows[~skipped(path.item, path.piece.time[path.rows])]
            for path in self.paths
        ]
        held = [
            [one for one in path.holds if skipped is None or not skipped(path.item, path.piece.time[one]).any()]
            for path in self.paths
        ]

        def rows_of(columns: Sequence[Array]) -> Array:
            """Return rows of the columns (n, K) of each piece: rows of samples, then rows of the drift in holds."""
            values = [column[rows] for column, rows in zip(columns, used, strict=True)]
            parts = [column[one] for column, own in zip(columns, held, strict=True) for one in own]
            return np.concatenate([*values, *(_OF_HOLDS * (drift - drift.mean(axis=0)) for drift in parts)])

        curves = rows_of([path.curves for path in self.paths])
        gram = curves.T @ curves
        project = np.linalg.solve(gram + _RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram)), curves.T)

        def unexplained(columns: Sequence[Array]) -> Array:
            """Return the part of the rows of columns that no curve explains."""
            rows = rows_of(columns)
            return np.asarray(rows - curves @ (project @ rows))

        wanted = unexplained([path.piece.displacement for path in self.paths])
        tau = self.time_constants
        part, alike = DisplacementCreep(tau, np.zeros(tau.size)), np.diff(np.eye(tau.size), axis=0)
        for _ in range(_ROUNDS):
            slow = unexplained([_low_passes(path, part) for path in self.paths])
            equal = _ALIKE * np.sqrt(np.sum(slow**2) / tau.size) * alike
            gains, _ = nnls(np.vstack([slow, equal]), np.concatenate([wanted, np.zeros(len(equal))]))
            part = DisplacementCreep(tau, gains)
        kept = gains > _LEAST * gains.sum()
        return DisplacementCreep(tau[kept], gains[kept]) if kept.any() else None


def _fading(item: Prepared, time: Array, time_constants: Array) -> Array:
    """Return exponentials (n, T) of the time (n,) [s] since a record began."""
    return np.asarray(np.exp(-np.maximum(time - item.record.time[0], 0.0)[:, None] / time_constants))


def _low_passes(path: _PlayedPiece, part: DisplacementCreep) -> Array:
    """Return the low-passes (n, K) [m] of the displacement of a piece without creep."""
    item, time = path.item.without_creep(part), path.piece.time
    m = np.interp(time, item.record.time, item.record.displacement)
    return np.asarray(m[:, None] - item.creep_strains(part, time))
