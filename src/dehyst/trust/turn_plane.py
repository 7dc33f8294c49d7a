"""The plane of turning points: between which voltages records turned, how fast they went, and how long they held.

A rise that begins at a lower turning point tests the model there for all upper voltages that it passes, and a fall that
begins at an upper turning point for all lower ones. A loop between two voltages is tested if both branches are.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array, Mask
from dehyst.records import turning_points

# Cells of the plane on each side, and how many cells around a passed one count as tested: 5 % of the range.
_CELLS, _AROUND = 40, 2
# Samples of a record that are looked at, how far a voltage goes back at a turn, as a part of the range, and turns that
# are shown as one if they differ by less than that.
_ENOUGH, _BAND = 100_000, 0.01
# A sine stays near its ends for an eighth of a rise: a longer stay, as a part of the rise before it, is a hold.
_HOLD = 0.2
# Turns that are kept of all records.
_MOST = 2000


class Turn(NamedTuple):
    """A branch between two turning points: voltages [V], mean speed [V/s], hold at its end [s], and how often."""

    record: str
    begin: float
    end: float
    speed: float
    held: float
    times: int

    @property
    def words(self) -> str:
        """Voltages, speed and hold."""
        held = f", held {self.held:.2g} s" if self.held > 0 else ""
        often = f", {self.times} times" if self.times > 1 else ""
        return f"{self.record}: from {self.begin:.4g} to {self.end:.4g} V at {self.speed:.3g} V/s{held}{often}"


@dataclass(frozen=True, eq=False)
class TurnPlane:
    """Where records turned.

    Attributes
    ----------
    turns : tuple of Turn
        Similar ones are one.
    edges : (n + 1,) array
        Of the cells, both of the lower and of the upper turning point [V].
    rising, falling : (n, n) bool array
        Whether the records test that branch of a loop; a row has one upper turning point.
    """

    turns: tuple[Turn, ...]
    edges: Array
    rising: Mask
    falling: Mask

    @property
    def speeds(self) -> tuple[float, float]:
        """Lowest and highest speed [V/s]."""
        speeds = [turn.speed for turn in self.turns]
        return min(speeds), max(speeds)

    @property
    def longest_hold(self) -> float:
        """Longest hold at a turning point [s]."""
        return max(turn.held for turn in self.turns)

    def legs(self, voltage: Array) -> Array:
        """Return where each rise or fall of a voltage begins and ends (k, 2) [V]; see `sentence`."""
        at = _legs(voltage, _BAND * float(np.ptp(self.edges)))
        return voltage[at]

    def untested(self, voltage: Array) -> tuple[int, int]:
        """Count the rises and falls of a voltage [V] that no record tests, and all of them."""
        pairs = self.legs(voltage)
        place = np.clip(np.searchsorted(self.edges, np.sort(pairs), side="right") - 1, 0, len(self.rising) - 1)
        upward = pairs[:, 1] > pairs[:, 0]
        tested = np.where(upward, self.rising[place[:, 1], place[:, 0]], self.falling[place[:, 1], place[:, 0]])
        return int(np.count_nonzero(~tested)), len(pairs)

    def sentence(self, voltage: Array) -> str:
        """Return what of a voltage [V] the records do not test."""
        outside, all_ = self.untested(voltage)
        if not outside:
            return "This path turns where records turned."
        return f"{outside} of {all_} branches of this path begin where no record turned."

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "edges_V": self.edges.tolist(),
            # Row by row: 1 for a rising branch that is tested, 2 for a falling one, 3 for both.
            "cells": "".join(map(str, (self.rising + 2 * self.falling).ravel().tolist())),
            "lower_V": [min(turn.begin, turn.end) for turn in self.turns],
            "upper_V": [max(turn.begin, turn.end) for turn in self.turns],
            "names": [turn.words for turn in self.turns],
            "speeds_V_per_s": list(self.speeds),
            "longest_hold_s": self.longest_hold,
        }


def turn_plane(
    records: Iterable[tuple[str, Array, Array]], limits: tuple[float, float] | None = None
) -> TurnPlane | None:
    """Find where records turned.

    Parameters
    ----------
    records : iterable of (name, time, voltage)
        Time [s] and voltage [V], both (n,).
    limits : (float, float), optional
        Voltages that the plane covers at least [V].

    Returns
    -------
    TurnPlane or None
        None if no voltage changes.
    """
    kept = [(name, time[:: _stride(time)], voltage[:: _stride(time)]) for name, time, voltage in records]
    ends = [*(limits or ()), *(float(end) for _, _, v in kept if v.size for end in (v.min(), v.max()))]
    if not ends or max(ends) == min(ends):
        return None
    edges = np.linspace(min(ends), max(ends), _CELLS + 1)
    band = _BAND * (max(ends) - min(ends))
    found = [turn for name, time, voltage in kept if voltage.size for turn in _turns(name, time, voltage, band)]
    if not found:
        return None
    rising, falling = (_tested([one for one in found if (one.end > one.begin) is up], edges) for up in (True, False))
    return TurnPlane(tuple(found[:_MOST]), edges, rising, falling)


def _legs(voltage: Array, band: float) -> NDArray[np.intp]:
    """Return the samples (k, 2) at which each rise or fall begins and ends.

    The first begins at the first turning point: nobody knows from where the voltage came before. An end of the range at
    the very beginning counts as one.
    """
    first = voltage[0] <= voltage.min() + band or voltage[0] >= voltage.max() - band
    at = np.array([*([0] if first else []), *turning_points(voltage, band), len(voltage) - 1], dtype=np.intp)
    pairs = np.column_stack([at[:-1], at[1:]])
    return pairs[np.abs(np.diff(voltage[pairs], axis=1)[:, 0]) > band]


def _stride(time: Array) -> int:
    return 1 + time.size // _ENOUGH


def _turns(name: str, time: Array, voltage: Array, band: float) -> list[Turn]:
    """Return the turns of a record, those that are alike as one."""
    alike: dict[tuple[int, int], list[Turn]] = {}
    for begin, end in _legs(voltage, band).tolist():
        near = np.abs(voltage - voltage[end]) <= band
        after = end + int(np.argmin(near[end:])) if not near[end:].all() else len(near)
        arrived = end - int(np.argmin(near[begin : end + 1][::-1])) + 1
        seconds, volts = float(time[end] - time[begin]), (float(voltage[begin]), float(voltage[end]))
        held = float(time[after - 1] - time[arrived])
        turn = Turn(name, *volts, abs(volts[1] - volts[0]) / seconds, held if held > _HOLD * seconds else 0.0, 1)
        alike.setdefault((round(volts[0] / band), round(volts[1] / band)), []).append(turn)
    return [
        max(turns, key=lambda turn: turn.speed)._replace(held=max(turn.held for turn in turns), times=len(turns))
        for turns in alike.values()
    ]


def _tested(turns: Sequence[Turn], edges: Array) -> Mask:
    """Return the cells through or near which a rise, or a fall, passes after its turning point."""
    wide = np.zeros((_CELLS + 2 * _AROUND,) * 2, bool)
    for turn in turns:
        begin, end = np.clip(np.searchsorted(edges, (turn.begin, turn.end), side="right") - 1, 0, _CELLS - 1)
        near = slice(begin, begin + 2 * _AROUND + 1)
        passed = slice(min(begin, end), max(begin, end) + 2 * _AROUND + 1)
        wide[(passed, near) if end > begin else (near, passed)] = True
    # Below the diagonal there is nothing.
    return np.asarray(wide[_AROUND:-_AROUND, _AROUND:-_AROUND] & np.tri(_CELLS, dtype=bool))
