"""What no stage can be identified from: axes that never move, an axis measured twice, motion without a voltage."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from dehyst._errors import RecordError
from dehyst.stages.coupling.play_columns import PlayColumns
from dehyst.stages.record import StageRecord

# Two displacements are the same if they differ by less, of the stroke: by the rounding of a file.
_SAME = 1e-6
# Least share of a displacement's motion that the voltages explain. Noise alone has that of the regressors among the
# samples, about a hundredth.
_EXPLAINED = 0.05


def refuse_still_or_equal(records: Sequence[StageRecord]) -> None:
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


def _same(record: StageRecord, i: int, j: int) -> bool:
    difference = record.displacement[:, i] - record.displacement[:, j]
    return bool(np.ptp(difference) <= _SAME * record.strokes[[i, j]].max())
