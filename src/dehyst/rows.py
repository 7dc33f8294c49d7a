"""Which samples of a record count, and what each says about the slip elements (theory: the running range).

While a record's range does not grow, an element whose 2 rho fits into the range seen so far is in a known state, and
every other cart stands still: it adds kappa y and a constant. Such a stretch is an epoch; each has one constant.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._native import Array, stops
from dehyst.record import Record, white_noise

_SHORTEST_EPOCH = 16


@dataclass(frozen=True)
class Epoch:
    """Samples start..stop-1 of a piece, over which the range of the excitation did not grow.

    Attributes
    ----------
    turn : int
        The sample before `start` at which the range grew last.
    reach : float
        Range of displacement [m] seen up to here: elements with 2 rho <= reach are known.
    middle : float
        The place [m] to which the constant of the carts that stand still refers.
    """

    turn: int
    start: int
    stop: int
    reach: float
    middle: float


@dataclass(frozen=True, eq=False)
class Rows:
    """Samples that count, of all records, stacked.

    Attributes
    ----------
    elongation : (n, N) array
        s_i [m], or for a cart that stands still y less the middle of its epoch.
    stuck : (n, N) bool array
        Whether cart i stands still at this sample.
    displacement, voltage, drift : (n,) array
        y [m], v [V] and the record's creep curve (log of time since its start, mean zero).
    record, epoch : (n,) int array
    moved : (n, E) array
        What other parts do along the path, creep strains and the like [m]; E is 0 if none were asked for.
    """

    elongation: Array
    stuck: NDArray[np.bool_]
    displacement: Array
    voltage: Array
    drift: Array
    record: NDArray[np.intp]
    epoch: NDArray[np.intp]
    moved: Array

    def __len__(self) -> int:
        return len(self.voltage)

    def thinned(self, most: int) -> Rows:
        """About `most` of the rows, evenly."""
        return self._taken(slice(None, None, max(1, len(self) // most)))

    def chosen(self, which: NDArray[np.bool_]) -> Rows:
        """Some of the rows."""
        return self._taken(which)

    def _taken(self, which: Any) -> Rows:
        return Rows(*(getattr(self, name)[which] for name in self.__dataclass_fields__))


def epochs(record: Record, noise: float = 0.0) -> list[Epoch]:
    """Stretches of constant range, told by the voltage, whose extremes are clean where the displacement drifts.

    A growth below 0.2 % of the voltage's range, or below its noise, is not seen.

    Parameters
    ----------
    record : Record
        In one piece, its delay removed.
    noise : float, optional
        Standard deviation of the sensor [m]: the reach is cut by what noise adds to a range.
    """
    v, y = record.voltage, record.displacement
    tolerance = max(2e-3 * float(np.ptp(v)), 6 * white_noise(v))
    growing = np.flatnonzero(_grows(v, tolerance) | _grows(-v, tolerance))
    edges = np.append(growing, len(v))
    found: list[Epoch] = []
    for start, stop in zip(edges[:-1] + 1, edges[1:], strict=True):
        if stop - start >= _SHORTEST_EPOCH:
            seen, since = y[:start], found[-1].stop if found else 0
            low, high = float(seen.min()), float(seen.max())
            turn = since + max(int(np.argmax(v[since:start])), int(np.argmin(v[since:start])))
            found.append(Epoch(turn, int(start), int(stop), high - low - 4 * noise, 0.5 * (low + high)))
    return found


def _grows(v: Array, tolerance: float) -> NDArray[np.bool_]:
    """Samples of the runs near the running maximum that raise it by more than the tolerance."""
    highest = np.maximum.accumulate(v)
    near = np.concatenate([[False], v >= highest - tolerance, [False]])
    starts, stops_ = np.flatnonzero(~near[:-1] & near[1:]), np.flatnonzero(near[:-1] & ~near[1:])
    grown = np.zeros(len(v), dtype=bool)
    for start, stop in zip(starts, stops_, strict=True):
        if start == 0 or highest[stop - 1] > highest[start - 1] + tolerance:
            grown[start:stop] = True
    return grown


def collect(
    pieces: list[tuple[int, Record, Array]],
    breakaway: Array,
    noise: list[float],
    *,
    relaxed: Collection[int] = (),
    moved: Callable[[int, Record], Array] = lambda _, record: np.zeros((len(record), 0)),
) -> tuple[Rows, list[list[Epoch]]]:
    """Stack the samples that count.

    Parameters
    ----------
    pieces : list of (record number, Record, drift curve (n,))
    breakaway : (N,) array
        rho [m].
    noise : list of float
        Sensor noise [m] of each piece.
    relaxed : collection of int, optional
        Records that start with no element strained: all their samples count, up to the first gap.
    moved : callable, optional
        Record number and piece -> (n, E): what else moves along its path.

    Returns
    -------
    Rows, list of list of Epoch
        The epochs of each piece.
    """
    parts: list[tuple[NDArray[Any], ...]] = []
    all_epochs: list[list[Epoch]] = []
    count = 0
    rested = set(relaxed)
    for (number, piece, drift), sigma in zip(pieces, noise, strict=True):
        y = np.ascontiguousarray(piece.displacement)
        elongation, _ = stops(breakaway, np.full(breakaway.size, y[0]), y)
        others = moved(number, piece)
        found = [Epoch(0, 0, len(y), np.inf, float(y[0]))] if number in rested else epochs(piece, sigma)
        rested.discard(number)
        all_epochs.append(found)
        for epoch in found:
            span = slice(epoch.start, epoch.stop)
            known = 2 * breakaway <= epoch.reach
            here = y[span, None]
            s = np.where(known, elongation[span], here - epoch.middle)
            stuck = ~known | (np.abs(elongation[span]) < breakaway * (1 - 1e-9))
            size = s.shape[0]
            parts.append((s, stuck, y[span], piece.voltage[span], drift[span],
                          np.full(size, number), np.full(size, count), others[span]))  # fmt: skip
            count += 1
    if not parts:
        empty = np.zeros(0)
        none = np.zeros((0, breakaway.size))
        numbers = empty.astype(int)
        return Rows(none, none > 0, empty, empty, empty, numbers, numbers, none[:, :0]), all_epochs
    return Rows(*(np.concatenate(column) for column in zip(*parts, strict=True))), all_epochs
