"""The records that a rival is fitted to, made ready: voltages to play, and the samples of them that count."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.records import Record


@dataclass(frozen=True, eq=False)
class Training:
    """Pieces of records to be played from their first sample, and their samples that count.

    Attributes
    ----------
    pieces : tuple of Record
        Voltages delayed.
    kept : tuple of (k,) int array
        Samples of each piece that count.
    displacement : (n,) array
        Of the samples that count, of all pieces [m].
    reach : (n,) array
        Range of the voltage [V] before the epoch of each of them: what has been through it is in a known state.
    nuisances : (n, m) array
        Columns that every fit is free to use: one constant for each epoch, then drifts.
    epochs : int
        Number of constants.
    reference : int
        Column whose coefficient is the model's own constant: that of the widest record's last epoch.
    limits : (float, float)
        Lowest and highest voltage [V].
    stroke : float
        Range of the widest record's loops [m].
    delay : float
        Seconds by which the displacement lags the voltage.
    sentences : tuple of str
        What was repaired in the records.
    """

    pieces: tuple[Record, ...]
    kept: tuple[NDArray[np.intp], ...]
    displacement: Array
    reach: Array
    nuisances: Array
    epochs: int
    reference: int
    limits: tuple[float, float]
    stroke: float
    delay: float
    sentences: tuple[str, ...] = ()

    def __len__(self) -> int:
        return self.displacement.size

    @property
    def slope(self) -> float:
        """Mean slope [m/V] of the widest loop."""
        return self.stroke / (self.limits[1] - self.limits[0])

    @property
    def offsets(self) -> Array:
        """The constants among the nuisances (n, epochs)."""
        return self.nuisances[:, : self.epochs]

    def played(self, run: Callable[[Array], Array]) -> Array:
        """What `run` makes of the voltage of each piece, at the samples that count: (n,) or (n, columns)."""
        return self.seen(lambda piece: run(piece.voltage))

    def seen(self, run: Callable[[Record], Array]) -> Array:
        """What `run` makes of each piece, at the samples that count: (n,) or (n, columns)."""
        return np.concatenate([run(piece)[rows] for piece, rows in zip(self.pieces, self.kept, strict=True)])

    def thinned(self, most: int) -> Training:
        """The same with about `most` samples that count, evenly; voltages stay whole."""
        step = max(1, len(self) // most)
        if step == 1:
            return self
        ends = np.cumsum([0, *(rows.size for rows in self.kept)])
        chosen = np.arange(0, len(self), step)
        kept = tuple(
            rows[chosen[(chosen >= a) & (chosen < b)] - a]
            for rows, a, b in zip(self.kept, ends[:-1], ends[1:], strict=True)
        )
        return replace(
            self,
            kept=kept,
            displacement=self.displacement[chosen],
            reach=self.reach[chosen],
            nuisances=self.nuisances[chosen],
        )
