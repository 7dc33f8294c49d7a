"""Internal states besides the carts along a record, in blocks: creep strains, smooth elongations, start strains."""

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

# Samples of a lead processed at a time.
_BLOCK = 32_768


@dataclass(frozen=True, eq=False)
class InternalStates:
    """Internal states of a piece besides carts, at rest at its first sample or at that of the `lead` it continues.

    Columns: creep strains (n, J) [m], smooth elongations (n, L) [m], decay of strains at the start (n, J).

    Attributes
    ----------
    grid : Grid
    piece : Record
    lead : Record or None
        Samples left out before the piece; used only if the piece continues them.
    """

    grid: Grid
    piece: Record
    lead: Record | None

    @property
    def width(self) -> int:
        """2 J + L."""
        return 2 * self.grid.time_constants.size + self.grid.lengths.size

    def blocks(self, size: int) -> Iterator[Array]:
        """Yield rows of all samples in order, (size, 2 J + L) at a time except the last."""
        time, y = self.piece.time, self.piece.displacement
        at = self._after_lead()
        first = time[0] if at is None or self.lead is None else self.lead.time[0]
        for begin in range(0, time.size, size):
            now = time[begin : begin + size]
            internal, at = self._advance(at, now, y[begin : begin + size])
            yield np.hstack([internal, np.exp(-(now[:, None] - first) / self.grid.time_constants)])

    @cached_property
    def _creep(self) -> Creep:
        return Creep(self.grid.time_constants, np.zeros(self.grid.time_constants.size))

    def _after_lead(self) -> _LastSample | None:
        """Return the last sample of the lead; None if the piece does not continue it."""
        lead, first = self.lead, self.piece.time[0]
        if lead is None or not lead.time[-1] < first <= lead.time[-1] + 1.5 * lead.sample_time:
            return None
        at: _LastSample | None = None
        for begin in range(0, len(lead), _BLOCK):
            span = slice(begin, begin + _BLOCK)
            _, at = self._advance(at, lead.time[span], lead.displacement[span])
        return at

    def _advance(self, at: _LastSample | None, time: Array, y: Array) -> tuple[Array, _LastSample]:
        """Return strains and elongations (n, J + L) of samples that continue `at` or begin at rest, and the last."""
        repeated = int(at is not None)
        branches, elements = self.grid.time_constants.size, self.grid.lengths.size
        internal = np.zeros(branches + elements) if at is None else at.internal
        if at is not None:
            time, y = np.append(at.time, time), np.append(at.displacement, y)
        else:
            y = np.ascontiguousarray(y)
        columns = [np.zeros((y.size, 0))]
        if branches:
            bounds, durations = clock(time, y.size)
            columns.append(strains(y, bounds, *self._creep.tables(durations), internal[:branches]))
        if elements:
            columns.append(smooth_elongations(self.grid.lengths, self.grid.closings, y, internal[branches:]))
        rows = np.hstack(columns)
        return rows[repeated:], _LastSample(float(time[-1]), float(y[-1]), rows[-1])


@dataclass(frozen=True, eq=False)
class _LastSample:
    """The last processed sample: its time [s], displacement [m], strains and elongations (J + L,) [m]."""

    time: float
    displacement: float
    internal: Array
