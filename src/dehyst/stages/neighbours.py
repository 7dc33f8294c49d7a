"""Whether what one actuator's model leaves follows another voltage of its file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dehyst._types import Array
from dehyst.model import Trace
from dehyst.stages.coupling.cross_talk import held_out_gain
from dehyst.stages.coupling.play_columns import block_means, motion_of

_SPANS, _MOST_ROWS = 24, 12_000
# Worth a warning: so much of the stroke (RMS), on time that was held out, by so many times the scatter.
_LEAST, _CERTAIN = 0.002, 3.0


@dataclass(frozen=True)
class Neighbour:
    """Another voltage that the residual of a record follows.

    `column`: its name. `share`: RMS of what it predicts of the residual, as a share of the stroke. `explained`: the
    share of the residual's power.
    """

    record: str
    column: str
    share: float
    explained: float

    @property
    def sentence(self) -> str:
        """The warning."""
        return (
            f"{self.record}: the residual follows the voltage '{self.column}', by {100 * self.share:.2g} % of the "
            f"stroke (RMS; {100 * self.explained:.0f} % of the residual's power): it moves this axis too. "
            "Identify both axes together: --axes 'THIS_V:THIS_um OTHER_V:OTHER_um'"
        )


def followed(trace: Trace, time: Array, others: Mapping[str, Array], stroke: float) -> list[Neighbour]:
    """Return the voltages that predict the residual of a trace on time that was held out, the largest first.

    Parameters
    ----------
    trace : Trace
    time : (n,) array
        [s] of the samples of the file.
    others : mapping of str to (n,) array
        Its other voltages, in any unit.
    stroke : float
        [m].
    """
    found = []
    rows = np.minimum(np.searchsorted(time, trace.time - 1e-9), len(time) - 1)
    every = max(1, len(rows) // _MOST_ROWS)
    residual = block_means(trace.residual, every) / stroke
    place = np.arange(len(residual)) * _SPANS // max(len(residual), 1)
    base = _moving(block_means(_motion(trace.voltage), every))
    for name, voltage in others.items():
        if np.ptp(voltage) > 0 and np.isfinite(voltage).all():
            motion = _moving(block_means(_motion(voltage)[rows], every))
            size, certainty = held_out_gain(base, motion, residual, place)
            if size > _LEAST and certainty > _CERTAIN:
                found.append(Neighbour(trace.record, name, size, min(size**2 / float(np.mean(residual**2)), 1.0)))
    return sorted(found, key=lambda one: -one.share)


def _motion(voltage: Array) -> Array:
    low, high = float(voltage.min()), float(voltage.max())
    return motion_of(voltage, low, max(high - low, 1e-12))[0]


def _moving(block: Array) -> Array:
    """Return the directions of a block that move most first."""
    return np.asarray(np.linalg.svd(block - block.mean(axis=0), full_matrices=False)[0])
