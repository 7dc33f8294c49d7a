"""What the constants of a record's epochs owe to one another: carts that stand still, and those that a growth moves.

In an epoch of range [L, H] the cart of an element that has not slid both ways lies between H - rho and L + rho. With
K(z) the element's stiffness integrated up to z and M the middle of the range, it adds K(M) - K(b) to the constant; so
the constant lies within

    c + sum_stuck [K(M) - K(L + rho)]  <=  a  <=  c + sum_stuck [K(M) - K(H - rho)],

c being the same in all epochs of a record. As the range grows, a cart is pushed by no more than its end of the range
moves, and an element that becomes known leaves its part. All are linear in the stiffnesses: rows, no unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dehyst._types import Array, Mask
from dehyst.model.elements import parts_in_segments
from dehyst.model.structure import Grid


@dataclass(frozen=True)
class EpochRange:
    """Range of displacement over an epoch.

    Attributes
    ----------
    number, record, piece : int
        Numbers of the epoch, of its record and of its piece of the record.
    low, high : float
        [m], on the axis of the record.
    reach : float
        high - low less the noise [m]: elements with 2 rho <= reach are in a known state.
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


def ties(grid: Grid, ranges: Sequence[EpochRange]) -> list[tuple[dict[int, float], Array]]:
    """Return inequalities ``sum_e sign_e a_e + row kappa >= 0`` between constants.

    Parameters
    ----------
    grid : Grid
    ranges : sequence of EpochRange
        On the model's axis, in order.

    Returns
    -------
    list of (signs by epoch number, row over the stiffnesses of the movable elements (m M,))
    """
    rows: list[tuple[dict[int, float], Array]] = []
    for record in dict.fromkeys(one.record for one in ranges):
        own = [_Epoch(grid, one) for one in ranges if one.record == record]
        for one in own[:-1]:
            rows += _alike(one, own[-1])
        for before, after in pairwise(own):
            if before.range.piece == after.range.piece:
                rows += _grown(before, after)
    return rows


class _Epoch:
    """An epoch, with the movable elements that are not in a known state."""

    def __init__(self, grid: Grid, at: EpochRange) -> None:
        self.range, self._grid, self.rho = at, grid, grid.breakaway[grid.movable]
        self.stuck: Mask = 2 * self.rho > at.reach
        self.middle = np.full(self.rho.size, at.middle)
        # A reach reduced by noise may let the two ends cross.
        self.lowest = np.minimum(at.high - self.rho, self.middle)
        self.highest = np.maximum(at.low + self.rho, self.middle)

    def change(self, upper: Array, lower: Array, which: Mask) -> Array:
        """Return the row of sum K(upper) - K(lower) over some of the elements (m M,)."""
        grades = self._grid.grades
        parts = parts_in_segments(grades, upper) - parts_in_segments(grades, lower)
        return np.asarray(np.where(which[:, None], parts, 0.0).ravel())


def _alike(one: _Epoch, last: _Epoch) -> list[tuple[dict[int, float], Array]]:
    """Return how far the constants of two epochs of a record may lie apart."""
    number, reference = one.range.number, last.range.number
    above = one.change(one.middle, one.lowest, one.stuck) + last.change(last.highest, last.middle, last.stuck)
    below = one.change(one.highest, one.middle, one.stuck) + last.change(last.middle, last.lowest, last.stuck)
    return [({number: -1.0, reference: 1.0}, above), ({number: 1.0, reference: -1.0}, below)]


def _grown(before: _Epoch, after: _Epoch) -> list[tuple[dict[int, float], Array]]:
    """Return how the constant changes as the range grows from one epoch to the next."""
    first, second = before.range.number, after.range.number
    released = before.stuck & ~after.stuck
    moved = before.change(after.middle, before.middle, after.stuck)
    down = before.change(before.highest, np.minimum(after.highest, before.highest), after.stuck)
    up = before.change(np.maximum(after.lowest, before.lowest), before.lowest, after.stuck)
    most = moved + down + before.change(before.highest, before.middle, released)
    least = moved - up - before.change(before.middle, before.lowest, released)
    return [({second: -1.0, first: 1.0}, most), ({second: 1.0, first: -1.0}, -least)]
