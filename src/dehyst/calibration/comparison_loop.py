"""The comparison loop: one loop of a record on disk is played again, to check that the actuator is the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.records import Record
from dehyst.waveforms import Excitation

# Number of mean values of a loop that are compared, each over as many samples.
_PARTS = 40
# A voltage this close to an end of the range, as a share of it, is at that end.
_NEAR = 1e-6
# Share of the stroke by which the same actuator may differ after hours, by temperature or creep. Two of one type differ
# by more, and a model of 1 % is useless if the actuator has changed by more.
_LEAST = 0.01
# Allowance for the spread from cycle to cycle, in spreads of two cycles, and at most as a share of the stroke.
_SPREADS, _MOST = 2.0, 0.1
# Peak to peak of the noise on the mean values of a loop without its drift, in standard deviations, with a margin.
_DEVIATIONS = 8.0
# Least samples of a cycle that is compared.
_FEWEST = 8


class Cycle(NamedTuple):
    """A cycle of an excitation, by its first and last sample: from the lowest voltage to the highest and back."""

    first: int
    last: int

    def parts(self, rows: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return, for each sample of a record, its part of the cycle, and -1 outside of the cycle.

        Where a device played in pieces and sampled one voltage twice, the second sample counts as outside.
        """
        count = min(_PARTS, (self.last - self.first + 1) // 2)
        part = (rows - self.first) * count // (self.last - self.first + 1)
        inside = (rows >= self.first) & (rows <= self.last) & (np.diff(rows, prepend=-1) > 0)
        return np.where(inside, part, -1)


@dataclass(frozen=True)
class Agreement:
    """The agreement of a replayed loop with the `record` of this name on disk.

    `difference`: peak-to-peak difference as a share of the stroke. `allowed`: largest difference that noise, spread
    from cycle to cycle, creep and temperature together may cause.
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
        """The error message for loops that differ by more than is allowed."""
        return (
            f"this looks like another actuator (loop differs by {100 * self.difference:.2g} % of the stroke from the "
            f"record '{self.record}' in this folder, at most {100 * self.allowed:.2g} % is expected of the same one); "
            "give another folder with -o, or bring load, sensor range and temperature back to what they were"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "record": self.record,
            "difference_percent": 100 * self.difference,
            "allowed_percent": 100 * self.allowed,
        }


def cycles(voltage: Array) -> list[Cycle]:
    """Return the cycles through the whole range of a voltage (n,) after the first visit of its highest value.

    They depend only on the excitation's own earlier samples, not on what was played before it.
    """
    low, high = float(voltage.min()), float(voltage.max())
    near = _NEAR * (high - low)
    bottoms = np.flatnonzero(voltage <= low + near)
    tops = np.flatnonzero(voltage >= high - near)
    if not near or not bottoms.size:
        return []
    pairs = zip(bottoms[:-1].tolist(), bottoms[1:].tolist(), strict=True)
    # A cycle lies between two visits of the lowest voltage with a visit of the highest between them.
    through = np.searchsorted(tops, bottoms)
    return [
        Cycle(a, b)
        for (a, b), before, after in zip(pairs, through[:-1], through[1:], strict=True)
        if 0 < before < after and b - a >= _FEWEST
    ]


def replay(excitation: Excitation) -> Excitation | None:
    """Return the last whole cycle of an excitation twice, or None; its first rise depends on what was played before."""
    whole = cycles(excitation.voltage)
    if not whole:
        return None
    cycle = excitation.voltage[whole[-1].first : whole[-1].last + 1]
    return Excitation("comparison", np.concatenate([cycle, cycle[1:]]), excitation.sample_rate)


def agreement(
    stored: Record, excitation: Excitation, played: Record, stored_rows: NDArray[np.intp], played_rows: NDArray[np.intp]
) -> Agreement:
    """Compare a record on disk with its `replay`.

    `stored`, `played`: records of the excitation and of its replay. `excitation`: the excitation of the stored record.
    `stored_rows`, `played_rows` (n,): for each sample of a record, the sample of its excitation, see
    `AbstractRig.rows`.
    """
    whole = cycles(excitation.voltage)
    length = whole[-1].last - whole[-1].first
    old = _means(stored, whole[-1].parts(stored_rows))
    new = _means(played, Cycle(length, 2 * length).parts(played_rows))
    stroke = float(np.ptp(old))
    if not stroke:
        return Agreement(stored.name, float(np.inf), _LEAST)
    a_mean = float(np.sqrt(old.size / (length + 1)))
    noise = _DEVIATIONS * a_mean * float(np.hypot(stored.noise, played.noise)) / stroke
    spread = _SPREADS * max(0.0, _spread(stored, whole, stored_rows) / stroke - noise)
    return Agreement(stored.name, _difference(old, new) / stroke, _LEAST + noise + min(spread, _MOST))


def _spread(stored: Record, whole: list[Cycle], rows: NDArray[np.intp]) -> float:
    """Return the peak-to-peak difference [m] of the last two cycles of a record, if they have one length; else 0."""
    if len(whole) < 2 or whole[-1].last - whole[-1].first != whole[-2].last - whole[-2].first:
        return 0.0
    return _difference(*(_means(stored, cycle.parts(rows)) for cycle in whole[-2:]))


def _means(record: Record, part: NDArray[np.intp]) -> Array:
    """Return the mean displacement [m] of each part."""
    inside = part >= 0
    return np.bincount(part[inside], record.displacement[inside]) / np.bincount(part[inside])


def _difference(first: Array, second: Array) -> float:
    """Return the peak-to-peak difference [m] of two loops, without its linear drift along the cycle."""
    difference = second - first
    drift = np.linspace(difference[0], difference[-1], difference.size)
    return float(np.ptp(difference - drift))
