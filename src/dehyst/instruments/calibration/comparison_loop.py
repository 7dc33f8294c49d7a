"""One loop of a record on disk, played again: whether the actuator is still the one that was recorded."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.records import Record
from dehyst.waveforms import Excitation

# A loop is compared in so many mean values, each over as many samples.
_PARTS = 40
# A voltage this near to an end of the range, as a share of it, is at that end.
_NEAR = 1e-6
# Share of the stroke by which the same actuator may differ after hours, by temperature or creep. Two of one type differ
# by more, and a model of 1 % is of no use if the actuator has changed by more.
_LEAST = 0.01
# What the spread from cycle to cycle may add, in spreads of two cycles, and as a share of the stroke at most.
_SPREADS, _MOST = 2.0, 0.1
# Peak to peak of the noise on the mean values of a loop without its drift, in standard deviations, with a margin.
_DEVIATIONS = 8.0
# Samples that a cycle must have to be compared.
_FEWEST = 8


class Cycle(NamedTuple):
    """Samples first to last of an excitation: from the lowest voltage to the highest and back."""

    first: int
    last: int

    def parts(self, rows: NDArray[np.intp]) -> NDArray[np.intp]:
        """Which of the parts of the cycle each sample of a record is in, and -1 for those outside.

        Of two samples of one voltage, where a device played in pieces, the second one is outside, too.
        """
        count = min(_PARTS, (self.last - self.first + 1) // 2)
        part = (rows - self.first) * count // (self.last - self.first + 1)
        inside = (rows >= self.first) & (rows <= self.last) & (np.diff(rows, prepend=-1) > 0)
        return np.where(inside, part, -1)


@dataclass(frozen=True)
class Agreement:
    """How far a loop that was played again agrees with the record on disk.

    Attributes
    ----------
    record : str
        Name of the record on disk.
    difference : float
        Peak to peak, as a share of the stroke of the loop on disk.
    allowed : float
        What noise, spread from cycle to cycle, creep and temperature may come to, as a share of the stroke.
    """

    record: str
    difference: float
    allowed: float

    @property
    def good(self) -> bool:
        """Whether the actuator can be the one that was recorded."""
        return self.difference <= self.allowed

    @property
    def words(self) -> str:
        """The result as a sentence."""
        return (
            f"a loop of '{self.record}' was played again and agrees within {100 * self.difference:.2g} % of the stroke"
        )

    @property
    def refusal(self) -> str:
        """What to raise if the loops differ by more than is allowed."""
        return (
            f"this looks like another actuator (loop differs by {100 * self.difference:.2g} % of the stroke from the "
            f"record '{self.record}' in this folder, at most {100 * self.allowed:.2g} % is expected of the same one); "
            "give another folder with -o, or bring load, sensor range and temperature back to what they were"
        )

    def as_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {
            "record": self.record,
            "difference_percent": 100 * self.difference,
            "allowed_percent": 100 * self.allowed,
        }


def cycles(voltage: Array) -> list[Cycle]:
    """Cycles through the whole range of a voltage (n,) that follow an earlier visit of its highest value.

    What was played before the excitation does not matter to them, only what it went through before.
    """
    low, high = float(voltage.min()), float(voltage.max())
    near = _NEAR * (high - low)
    bottoms = np.flatnonzero(voltage <= low + near)
    tops = np.flatnonzero(voltage >= high - near)
    if not near or not bottoms.size:
        return []
    pairs = zip(bottoms[:-1].tolist(), bottoms[1:].tolist(), strict=True)
    # Only between two visits of the lowest voltage with one of the highest between them there is a cycle.
    through = np.searchsorted(tops, bottoms)
    return [
        Cycle(a, b)
        for (a, b), before, after in zip(pairs, through[:-1], through[1:], strict=True)
        if 0 < before < after and b - a >= _FEWEST
    ]


def replay(excitation: Excitation) -> Excitation | None:
    """The last whole cycle of an excitation, twice; the first rise depends on what was played before.

    Returns
    -------
    Excitation or None
        None if it has no such cycle.
    """
    found = cycles(excitation.voltage)
    if not found:
        return None
    cycle = excitation.voltage[found[-1].first : found[-1].last + 1]
    return Excitation("comparison", np.concatenate([cycle, cycle[1:]]), excitation.sample_rate)


def agreement(
    stored: Record, excitation: Excitation, played: Record, stored_rows: NDArray[np.intp], played_rows: NDArray[np.intp]
) -> Agreement:
    """Compare a record on disk with its `replay`.

    Parameters
    ----------
    stored, played : Record
        Of the excitation, and of its replay.
    excitation : Excitation
        That of the stored record.
    stored_rows, played_rows : (n,) int array
        Which sample of its excitation each sample of a record belongs to, see `AbstractRig.rows`.
    """
    found = cycles(excitation.voltage)
    length = found[-1].last - found[-1].first
    old = _means(stored, found[-1].parts(stored_rows))
    new = _means(played, Cycle(length, 2 * length).parts(played_rows))
    stroke = float(np.ptp(old))
    if not stroke:
        return Agreement(stored.name, float(np.inf), _LEAST)
    a_mean = float(np.sqrt(old.size / (length + 1)))
    noise = _DEVIATIONS * a_mean * float(np.hypot(stored.noise, played.noise)) / stroke
    spread = _SPREADS * max(0.0, _spread(stored, found, stored_rows) / stroke - noise)
    return Agreement(stored.name, _apart(old, new) / stroke, _LEAST + noise + min(spread, _MOST))


def _spread(stored: Record, found: list[Cycle], rows: NDArray[np.intp]) -> float:
    """Peak to peak [m] of what the last two cycles of a record differ by, if they were played alike; else 0."""
    if len(found) < 2 or found[-1].last - found[-1].first != found[-2].last - found[-2].first:
        return 0.0
    return _apart(*(_means(stored, cycle.parts(rows)) for cycle in found[-2:]))


def _means(record: Record, part: NDArray[np.intp]) -> Array:
    """Mean displacement [m] of each part."""
    inside = part >= 0
    return np.bincount(part[inside], record.displacement[inside]) / np.bincount(part[inside])


def _apart(one: Array, other: Array) -> float:
    """Peak to peak [m] of the difference of two loops, without what drifts from the beginning to the end of a cycle."""
    difference = other - one
    drift = np.linspace(difference[0], difference[-1], difference.size)
    return float(np.ptp(difference - drift))
