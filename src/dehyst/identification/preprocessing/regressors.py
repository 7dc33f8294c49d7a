"""Regressors: the samples of a record that count, and the elongations of elements at them (theory: running range).

While a record's range does not grow, an element whose 2 rho fits into the range so far is in a known state, and every
other cart stands still: it adds kappa y and a constant. Such an interval is an epoch; each has one constant.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._native import slip_elongations, smooth_elongations, strains
from dehyst._types import Array
from dehyst.identification.structure import Grid
from dehyst.model import Creep
from dehyst.model.dynamics import clock
from dehyst.records import Record
from dehyst.records.signals import white_noise

_SHORTEST_EPOCH = 16
# Samples whose elongations are in memory at a time.
_BLOCK = 8_192
# Samples whose voltages are compared at a time.
_AT_A_TIME = 1 << 19


@dataclass(frozen=True)
class Epoch:
    """Samples start..stop-1 of a piece, over which the range of the excitation did not grow.

    `turn`: the sample before `start` at which the range grew last. `reach`: range of displacement [m] so far: elements
    with 2 rho <= reach are in a known state. `middle`: displacement [m] to which the constant of the carts that stand
    still refers. `width`: range of displacement [m], noise included.
    """

    turn: int
    start: int
    stop: int
    reach: float
    middle: float
    width: float = np.inf


@dataclass(frozen=True)
class EpochRange:
    """Range of displacement over an epoch.

    `number`, `record`, `piece`: numbers of the epoch, of its record and of its piece of the record. `low`, `high`: [m],
    on the axis of the record. `reach`: high - low less the noise [m]: elements with 2 rho <= reach are in a known
    state.
    """

    number: int
    record: int
    piece: int
    low: float
    high: float
    reach: float

    @property
    def middle(self) -> float:
        """Displacement to which the constant of carts that stand still refers [m]."""
        return 0.5 * (self.low + self.high)

    def shifted(self, datum: float) -> EpochRange:
        """Return the same on another axis."""
        return EpochRange(self.number, self.record, self.piece, self.low + datum, self.high + datum, self.reach)


@dataclass(frozen=True, eq=False)
class Rows:
    """Samples that count, of all records, stacked.

    `elongation` (n, N): s_i [m], or for a cart that stands still y minus the middle of its epoch. `stuck` (n, N) bool:
    whether cart i stands still at this sample. `displacement`, `voltage`, `drift` (n,): y [m], v [V] and the record's
    creep curve (log of time since its start, mean zero). `time` (n,): [s]. `moved` (n, E): internal states besides
    carts, such as creep strains [m]; E is 0 without such parts.
    """

    elongation: Array
    stuck: NDArray[np.bool_]
    displacement: Array
    voltage: Array
    drift: Array
    record: NDArray[np.intp]
    epoch: NDArray[np.intp]
    time: Array
    moved: Array

    def __len__(self) -> int:
        return len(self.voltage)

    def thinned(self, most: int) -> Rows:
        """Return about `most` of the rows, evenly."""
        return self._taken(slice(None, None, max(1, len(self) // most)))

    def chosen(self, which: NDArray[np.bool_]) -> Rows:
        """Return some of the rows."""
        return self._taken(which)

    def _taken(self, which: Any) -> Rows:
        return Rows(*(getattr(self, name)[which] for name in self.__dataclass_fields__))


def epochs(record: Record, noise: float = 0.0) -> list[Epoch]:
    """Find the epochs by the voltage, whose extremes are exact where the displacement drifts.

    A growth below 0.2 % of the voltage's range, or below its noise, is ignored.

    `record`: without gaps, its delay removed. `noise`: standard deviation of the sensor [m]: the reach is reduced by
    the part of a range that is noise.
    """
    v, y = record.voltage, record.displacement
    tolerance = max(2e-3 * float(np.ptp(v)), 6 * white_noise(v))
    growing = np.flatnonzero(_grows(v, tolerance) | _grows(-v, tolerance))
    edges = np.append(growing, len(v))
    intervals: list[Epoch] = []
    for start, stop in zip(edges[:-1] + 1, edges[1:], strict=True):
        if stop - start >= _SHORTEST_EPOCH:
            seen, since = y[:start], intervals[-1].stop if intervals else 0
            low, high = float(seen.min()), float(seen.max())
            turn = since + max(int(np.argmax(v[since:start])), int(np.argmin(v[since:start])))
            intervals.append(Epoch(turn, int(start), int(stop), high - low - 4 * noise, 0.5 * (low + high), high - low))
    return intervals


def _grows(v: Array, tolerance: float) -> NDArray[np.bool_]:
    """Return the samples of runs near the running maximum that raise it by more than the tolerance."""
    highest = np.maximum.accumulate(v)
    near = np.zeros(len(v) + 2, dtype=bool)
    for begin in range(0, len(v), _AT_A_TIME):
        span = slice(begin, begin + _AT_A_TIME)
        near[1:-1][span] = v[span] >= highest[span] - tolerance
    starts, stops_ = np.flatnonzero(~near[:-1] & near[1:]), np.flatnonzero(near[:-1] & ~near[1:])
    grown = np.zeros(len(v), dtype=bool)
    for start, stop in zip(starts, stops_, strict=True):
        if start == 0 or highest[stop - 1] > highest[start - 1] + tolerance:
            grown[start:stop] = True
    return grown


@dataclass(frozen=True, eq=False)
class RowSource:
    """The samples that count, in blocks: they need not be in memory all at once.

    `breakaway` (N,): rho [m]. `epochs`: epochs of each piece. `moved`: internal states besides carts along each piece,
    at all its samples.
    """

    pieces: list[tuple[int, Record, Array]]
    breakaway: Array
    epochs: list[list[Epoch]]
    moved: list[InternalStates]

    @classmethod
    def of(
        cls,
        pieces: list[tuple[int, Record, Array]],
        grid: Grid,
        noise: list[float],
        *,
        relaxed: Collection[int] = (),
        leads: Sequence[Record | None] = (),
    ) -> RowSource:
        """Find the epochs; `leads` are those of the records, see `InternalStates`, the others as for `collect`."""
        spans: list[list[Epoch]] = []
        rested = set(relaxed)
        for (number, piece, _), sigma in zip(pieces, noise, strict=True):
            first = float(piece.displacement[0])
            spans.append([Epoch(0, 0, len(piece), np.inf, first)] if number in rested else epochs(piece, sigma))
            rested.discard(number)
        moved = [InternalStates(grid, piece, leads[number] if leads else None) for number, piece, _ in pieces]
        return cls(pieces, grid.breakaway, spans, moved)

    def __len__(self) -> int:
        return sum(epoch.stop - epoch.start for spans in self.epochs for epoch in spans)

    @property
    def count(self) -> int:
        """Number of epochs; they are numbered from 0 through all pieces."""
        return sum(map(len, self.epochs))

    def ranges(self) -> tuple[EpochRange, ...]:
        """Return the range of each epoch."""
        numbered = [(piece, q, one) for piece, (q, _, _) in enumerate(self.pieces) for one in self.epochs[piece]]
        return tuple(
            EpochRange(number, q, piece, one.middle - 0.5 * one.width, one.middle + 0.5 * one.width, one.reach)
            for number, (piece, q, one) in enumerate(numbered)
        )

    def thinned(self, most: int) -> Rows:
        """Return about `most` of the rows, evenly, in memory."""
        return self._stacked(max(1, len(self) // most))

    def blocks(self, step: int = 1) -> Iterator[Rows]:
        """Yield all rows, or every step-th, some thousands at a time."""
        count = place = 0
        for (number, piece, drift), spans, moved in zip(self.pieces, self.epochs, self.moved, strict=True):
            numbered = list(enumerate(spans, count))
            count += len(spans)
            carts, counted = np.full(self.breakaway.size, piece.displacement[0]), piece.counted
            stop = spans[-1].stop if spans else 0
            for begin, others in zip(range(0, stop, _BLOCK), moved.blocks(_BLOCK), strict=False):
                y = np.ascontiguousarray(piece.displacement[begin : begin + _BLOCK])
                elongation, carts = slip_elongations(self.breakaway, carts, y)
                for k, epoch in numbered:
                    first, last = max(epoch.start, begin), min(epoch.stop, begin + y.size)
                    if first >= last:
                        continue
                    at = np.arange(first + -place % step, last, step)
                    place += last - first
                    at = at if counted is None else at[counted[at]]
                    if at.size:
                        local = at - begin
                        yield self._rows(piece, drift[at], elongation[local], others[local], at, epoch, number, k)

    def moved_at(self, number: int, sample: int) -> Array:
        """Return the internal states besides carts at a sample of a piece (E,)."""
        for first, block in zip(range(0, sample + 1, _BLOCK), self.moved[number].blocks(_BLOCK), strict=False):
            if sample < first + len(block):
                return np.asarray(block[sample - first])
        raise IndexError(sample)

    def _rows(
        self,
        piece: Record,
        drift: Array,
        elongation: Array,
        moved: Array,
        at: NDArray[np.intp],
        epoch: Epoch,
        number: int,
        k: int,
    ) -> Rows:
        y, known = piece.displacement[at], 2 * self.breakaway <= epoch.reach
        s = np.where(known, elongation, y[:, None] - epoch.middle)
        stuck = ~known | (np.abs(elongation) < self.breakaway * (1 - 1e-9))
        numbers = np.full(at.size, number), np.full(at.size, k)
        return Rows(s, stuck, y, piece.voltage[at], drift, *numbers, piece.time[at], moved)

    def _stacked(self, step: int) -> Rows:
        parts = list(self.blocks(step))
        if not parts:
            empty, none = np.zeros(0), np.zeros((0, self.breakaway.size))
            numbers, moved = empty.astype(int), np.zeros((0, self.moved[0].width if self.moved else 0))
            return Rows(none, none > 0, empty, empty, empty, numbers, numbers, empty, moved)
        names = Rows.__dataclass_fields__
        return Rows(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def collect(
    pieces: list[tuple[int, Record, Array]], breakaway: Array, noise: list[float], *, relaxed: Collection[int] = ()
) -> tuple[Rows, list[list[Epoch]]]:
    """Stack the samples that count.

    `breakaway` (N,): rho [m]. `noise`: sensor noise [m] of each piece. `relaxed`: records that start with no element
    strained: all their samples count up to the first gap.

    Returns
    -------
    Rows, list of list of Epoch
        The epochs of each piece.
    """
    source = RowSource.of(pieces, Grid.maxwell_slip(breakaway, np.zeros(2)), noise, relaxed=relaxed)
    return source.thinned(max(1, len(source))), source.epochs


# Samples of a lead processed at a time.
_LEAD_BLOCK = 32_768


@dataclass(frozen=True, eq=False)
class InternalStates:
    """Internal states of a piece besides carts, at rest at its first sample or at that of the `lead` it continues.

    Columns: creep strains (n, J) [m], smooth elongations (n, L) [m], decay of strains at the start (n, J).

    `lead`: samples left out before the piece; used only if the piece continues them.
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
        for begin in range(0, len(lead), _LEAD_BLOCK):
            span = slice(begin, begin + _LEAD_BLOCK)
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
