"""Regressors: the samples of a record that count, and the elongations of elements at them (theory: running range).

While the range of a record does not grow, an element with 2 rho below this range is in a known state. Every other cart
stands still; its element adds kappa y and a constant. Such an interval is an epoch; each epoch has one constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._native import slip_elongations, smooth_elongations
from dehyst._types import Array, Mask
from dehyst.identification.structure import Grid
from dehyst.records import Record, counting, white_noise

_SHORTEST_EPOCH = 16


@dataclass(frozen=True)
class Epoch:
    """Samples start..stop-1 of a piece, over which the range of the excitation did not grow.

    `turn`: the sample before `start` at which the range grew last. `reach`: range of displacement [m] so far, minus
    noise: elements with 2 rho <= reach are in a known state. `middle`: reference displacement [m] of the constant of
    carts that stand still. `width`: range of displacement [m], with noise.
    """

    turn: int
    start: int
    stop: int
    reach: float
    middle: float = 0.0
    width: float = np.inf


def epochs(record: Record, noise: float = 0.0) -> list[Epoch]:
    """Find the epochs from the voltage, because a drift of the displacement would move its extremes.

    A growth below 0.2 % of the voltage's range, or below its noise, is ignored.

    `record`: record without gaps and without delay. `noise`: standard deviation of the sensor [m]; the reach is reduced
    by the range of the noise.
    """
    v, y = record.voltage, record.displacement
    tolerance = max(2e-3 * float(np.ptp(v)), 6 * white_noise(v))
    growing = np.flatnonzero(_grows(v, tolerance) | _grows(-v, tolerance))
    intervals: list[Epoch] = []
    for before, stop in pairwise(np.append(growing, len(v)).tolist()):
        start = before + 1
        if stop - start >= _SHORTEST_EPOCH:
            seen, since = y[:start], intervals[-1].stop if intervals else 0
            low, high = float(seen.min()), float(seen.max())
            turn = since + max(int(np.argmax(v[since:start])), int(np.argmin(v[since:start])))
            intervals.append(Epoch(turn, start, stop, high - low - 4 * noise, 0.5 * (low + high), high - low))
    return intervals


def _grows(v: Array, tolerance: float) -> Mask:
    """Return the samples of runs near the running maximum if a run raises the maximum by more than the tolerance."""
    highest = np.maximum.accumulate(v)
    near = np.zeros(len(v) + 2, dtype=bool)
    near[1:-1] = v >= highest - tolerance
    starts, stops_ = np.flatnonzero(~near[:-1] & near[1:]), np.flatnonzero(near[:-1] & ~near[1:])
    grown = np.zeros(len(v), dtype=bool)
    for start, stop in zip(starts, stops_, strict=True):
        if start == 0 or highest[stop - 1] > highest[start - 1] + tolerance:
            grown[start:stop] = True
    return grown


@dataclass(frozen=True, eq=False)
class Rows:
    """Samples that count, of all records, stacked.

    `elongation` (n, N): s_i [m]; for a cart that stands still, y minus the middle of its epoch. `stuck` (n, N) bool:
    whether cart i stands still at this sample. `displacement`, `voltage` (n,): y [m] and v [V]. `record`, `epoch` (n,):
    numbers of record and epoch. `time` (n,): [s]. `moved` (n, L): elongations of smooth elements [m].
    """

    elongation: Array
    stuck: Mask
    displacement: Array
    voltage: Array
    record: NDArray[np.intp]
    epoch: NDArray[np.intp]
    time: Array
    moved: Array

    def __len__(self) -> int:
        return len(self.voltage)

    def thinned(self, most: int) -> Rows:
        """Return about `most` rows, evenly spaced."""
        some = slice(None, None, max(1, len(self) // most))
        return Rows(**{name: column[some] for name, column in vars(self).items()})


class Piece(NamedTuple):
    """A piece of a record.

    `record`: the record's number. `path`: acting voltages, and the displacements that drive the elements.
    """

    record: int
    path: Record


class NumberedEpoch(NamedTuple):
    """An epoch with its number among all epochs, and the number of its piece."""

    number: int
    piece: int
    epoch: Epoch


@dataclass(frozen=True, eq=False)
class RowSource:
    """Pieces of records, and their epochs, whose samples give the rows.

    `epochs`: epochs of each piece. `leads`: samples left out before each record, by its number; empty: none.
    """

    pieces: list[Piece]
    grid: Grid
    epochs: list[list[Epoch]]
    leads: Sequence[Record | None] = ()

    @classmethod
    def of(
        cls,
        pieces: Sequence[tuple[int, Record]],
        grid: Grid,
        noise: list[float],
        *,
        leads: Sequence[Record | None] = (),
    ) -> RowSource:
        """Find the epochs of pieces; `noise`: noise of each piece [m]; for `grid` and `leads` see `internal_states`."""
        spans = [epochs(path, sigma) for (_, path), sigma in zip(pieces, noise, strict=True)]
        return cls([Piece(*piece) for piece in pieces], grid, spans, leads)

    def __len__(self) -> int:
        return sum(epoch.stop - epoch.start for spans in self.epochs for epoch in spans)

    @property
    def count(self) -> int:
        """Number of epochs; the numbers of epochs start at 0 and continue through all pieces."""
        return sum(map(len, self.epochs))

    def numbered(self) -> tuple[NumberedEpoch, ...]:
        """Return all epochs with their numbers."""
        places = [(piece, epoch) for piece, own in enumerate(self.epochs) for epoch in own]
        return tuple(NumberedEpoch(number, *place) for number, place in enumerate(places))

    def thinned(self, most: int) -> Rows:
        """Return about `most` rows, evenly spaced."""
        step, before, place = max(1, len(self) // most), 0, 0
        empty, numbers = np.zeros(0), np.zeros(0, dtype=np.intp)
        none = np.zeros((0, self.grid.breakaway.size))
        internal = np.zeros((0, self.grid.lengths.size))
        parts = [Rows(none, none > 0, empty, empty, numbers, numbers, empty, internal)]
        rho = self.grid.breakaway
        for piece, spans, states in zip(self.pieces, self.epochs, self.states, strict=True):
            path, counted = piece.path, counting(piece.path)
            elongations, _ = slip_elongations(
                rho, np.full(rho.size, path.displacement[0]), np.ascontiguousarray(path.displacement)
            )
            for k, epoch in enumerate(spans, before):
                # Records of events have few samples: all are used.
                at = np.arange(epoch.start + -place % step, epoch.stop, 1 if path.measured is not None else step)
                place += epoch.stop - epoch.start
                at = at if counted is None else at[counted[at]]
                y, elongation, known = path.displacement[at], elongations[at], 2 * rho <= epoch.reach
                rows = Rows(
                    elongation=np.where(known, elongation, y[:, None] - epoch.middle),
                    stuck=~known | (np.abs(elongation) < rho * (1 - 1e-9)),
                    displacement=y,
                    voltage=path.voltage[at],
                    record=np.full(at.size, piece.record),
                    epoch=np.full(at.size, k),
                    time=path.time[at],
                    moved=states[at],
                )
                parts.append(rows)
            before += len(spans)
        return Rows(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])})

    @cached_property
    def states(self) -> list[Array]:
        """Elongations of smooth elements at every sample of each piece (n, L) [m]."""
        leads = self.leads or [None] * (1 + max((piece.record for piece in self.pieces), default=0))
        return [internal_states(self.grid, piece.path, leads[piece.record]) for piece in self.pieces]


def internal_states(grid: Grid, path: Record, lead: Record | None) -> Array:
    """Return the elongations of smooth elements along a path (n, L) [m].

    They are at rest at the first sample of the path; if the path continues a `lead` (left-out samples), at the first
    sample of the lead.
    """
    begin, y = np.zeros(grid.lengths.size), np.ascontiguousarray(path.displacement)
    if not begin.size:
        return np.zeros((y.size, 0))
    if lead is None or not lead.time[-1] < path.time[0] <= lead.time[-1] + 1.5 * lead.sample_time:
        return smooth_elongations(grid.lengths, grid.closings, y, begin)
    whole = np.concatenate([lead.displacement, y])
    return smooth_elongations(grid.lengths, grid.closings, whole, begin)[-y.size :]
