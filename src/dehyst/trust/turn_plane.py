"""The plane of turning points: between which voltages records turned, and their speeds.

A rise from a lower turning point tests the model for all upper voltages that it passes, a fall from an upper one for
all lower ones.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import isfinite, nan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array, Mask
from dehyst._views.lines import ends
from dehyst.model import CELLS, branches_of, paces_of, tested_loops

# Largest number of used samples of a record; distance of voltages that are shown as one turn, as a part of the range.
_ENOUGH, _BAND = 100_000, 0.01
# Largest number of turns of all records that are kept.
_MOST = 2000


class Turn(NamedTuple):
    """A branch between two turning points: voltages [V], mean speed [V/s] and its count.

    Time at rest does not count for the speed. Without time the speed is NaN.
    """

    record: str
    begin: float
    end: float
    speed: float
    times: int

    @property
    def words(self) -> str:
        """Voltages and speed as text."""
        speed = f" at {self.speed:.3g} V/s on average" if isfinite(self.speed) else ""
        often = f", {self.times} times" if self.times > 1 else ""
        return f"{self.record}: from {ends(self.begin, self.end, 'V')}{speed}{often}"


@dataclass(frozen=True, eq=False)
class TurnPlane:
    """Where records turned.

    Attributes
    ----------
    turns : tuple of Turn
        Branches; similar ones are merged.
    edges : (n + 1,) array
        Edges of the cells [V], the same for lower and upper turning points.
    rising, falling : (n, n) bool array
        Whether the records test the rising or falling branch of a loop; a row belongs to one upper turning point.
    """

    turns: tuple[Turn, ...]
    edges: Array
    rising: Mask
    falling: Mask

    @property
    def cells(self) -> NDArray[np.intp]:
        """Tested branches of the loops of each cell (n, n): 0 none, 1 the falling, 2 the rising one, 3 both."""
        return np.asarray(self.falling + 2 * self.rising, dtype=np.intp)

    def path(self, voltage: Array, time: Array | None = None, name: str = "this path") -> tuple[Turn, ...]:
        """Return the branches of a path by its voltage (n,) [V] and time (n,) [s]."""
        clock = np.arange(voltage.size, dtype=np.float64) if time is None else time
        turns = _turns(name, clock, voltage, float(np.ptp(self.edges)))
        return tuple(turns if time is not None else (turn._replace(speed=nan) for turn in turns))


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
    given = list(records)
    ends = [*(limits or ()), *(float(end) for _, _, v in given if v.size for end in (v.min(), v.max()))]
    span = max(ends, default=0.0) - min(ends, default=0.0)
    found = [turn for name, time, voltage in given if voltage.size > 1 for turn in _turns(name, time, voltage, span)]
    if not found:
        return None
    edges = np.linspace(min(ends), max(ends), CELLS + 1)
    rising, falling = tested_loops(np.array([(branch.begin, branch.end) for branch in found]), edges)
    return TurnPlane(tuple(found[:_MOST]), edges, rising, falling)


def _turns(name: str, time: Array, voltage: Array, span: float) -> list[Turn]:
    """Return the turns of a record, similar ones merged; `span`: the range of all voltages [V].

    The first rise or fall begins at the first turning point, because the voltage before the record is unknown. A record
    that begins at an end of its range has its first turning point there.
    """
    step, band = 1 + voltage.size // _ENOUGH, _BAND * span
    time, voltage = time[::step], voltage[::step]
    at = branches_of(voltage, span)
    alike: dict[tuple[int, int], list[Turn]] = {}
    for (first, last), speed in zip(at.tolist(), paces_of(time, voltage, at)[:, 0].tolist(), strict=True):
        begin, end = float(voltage[first]), float(voltage[last])
        alike.setdefault((round(begin / band), round(end / band)), []).append(Turn(name, begin, end, speed, 1))
    return [max(turns, key=lambda turn: turn.speed)._replace(times=len(turns)) for turns in alike.values()]
