"""What a record moves besides carts, some samples at a time: creep strains, smooth elongations, what fades."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dehyst._native import smooth_elongations, strains
from dehyst._types import Array
from dehyst.model import Creep
from dehyst.model.creep import clock
from dehyst.model.structure import Grid
from dehyst.records import Record

# Samples of a lead that are gone through at a time.
_BLOCK = 32_768


@dataclass(frozen=True, eq=False)
class InternalStates:
    """What a piece moves besides carts, from rest at its first sample or at that of the `lead` that it goes on from.

    Side by side: creep strains (n, J) [m], smooth elongations (n, L) [m], what is left of strains at the start (n, J).

    Attributes
    ----------
    grid : Grid
    piece : Record
    lead : Record or None
        What was left out before the piece; of no use unless the piece goes on from it.
    """

    grid: Grid
    piece: Record
    lead: Record | None

    @property
    def width(self) -> int:
        """2 J + L."""
        return 2 * self.grid.time_constants.size + self.grid.lengths.size

    def blocks(self, size: int) -> Iterator[Array]:
        """Rows of all samples in order, (size, 2 J + L) at a time but for the last."""
        time, y = self.piece.time, self.piece.displacement
        at = self._after_lead()
        first = time[0] if at is None or self.lead is None else self.lead.time[0]
        for begin in range(0, time.size, size):
            now = time[begin : begin + size]
            moved, at = self._moved(at, now, y[begin : begin + size])
            yield np.hstack([moved, np.exp(-(now[:, None] - first) / self.grid.time_constants)])

    @cached_property
    def _creep(self) -> Creep:
        return Creep(self.grid.time_constants, np.zeros(self.grid.time_constants.size))

    def _after_lead(self) -> _Place | None:
        """Where the lead ends; None if the piece does not go on from it."""
        lead, first = self.lead, self.piece.time[0]
        if lead is None or not lead.time[-1] < first <= lead.time[-1] + 1.5 * lead.sample_time:
            return None
        at: _Place | None = None
        for begin in range(0, len(lead), _BLOCK):
            span = slice(begin, begin + _BLOCK)
            _, at = self._moved(at, lead.time[span], lead.displacement[span])
        return at

    def _moved(self, at: _Place | None, time: Array, y: Array) -> tuple[Array, _Place]:
        """Strains and elongations (n, J + L) of samples that follow on a place, or begin at rest; where they end."""
        again = int(at is not None)
        branches, elements = self.grid.time_constants.size, self.grid.lengths.size
        moved = np.zeros(branches + elements) if at is None else at.moved
        if at is not None:
            time, y = np.append(at.time, time), np.append(at.displacement, y)
        else:
            y = np.ascontiguousarray(y)
        columns = [np.zeros((y.size, 0))]
        if branches:
            bounds, durations = clock(time, y.size)
            columns.append(strains(y, bounds, *self._creep.tables(durations), moved[:branches]))
        if elements:
            columns.append(smooth_elongations(self.grid.lengths, self.grid.closings, y, moved[branches:]))
        rows = np.hstack(columns)
        return rows[again:], _Place(float(time[-1]), float(y[-1]), rows[-1])


@dataclass(frozen=True, eq=False)
class _Place:
    """The last sample gone through: its time [s], displacement [m], strains and elongations (J + L,) [m]."""

    time: float
    displacement: float
    moved: Array
