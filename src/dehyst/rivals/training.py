"""Records to the rows that rivals driven by voltage are fitted to, and the fit: nonnegative least squares.

What the records cannot tell is set aside as our own identification does: start-up transients are dropped, samples count
once the range of the voltage no longer grows, each such stretch has an offset of its own, a delay is looked for, and a
record may creep by a logarithm of time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Integral, Real

import numpy as np
from numpy.typing import NDArray

from dehyst import repairs
from dehyst._errors import IdentifyError
from dehyst._native import Array
from dehyst._native_plays import play_outputs
from dehyst.preparation import Prepared, as_list, prepare
from dehyst.program import one_thread
from dehyst.record import Record
from dehyst.rivals.least_squares import Rows, nonnegative
from dehyst.rivals.plays import PlayBank, PlayState
from dehyst.rows import epochs
from dehyst.signals import turning_points

_MOST_ROWS = 30_000
_SEARCH_ROWS = 4000
# As in our own identification: what a delay has to explain, and where all loops are of one height.
_WORTH, _WORTH_OF_ONE_HEIGHT = 0.97, 0.5


@dataclass(frozen=True, eq=False)
class Training:
    """Records, prepared.

    Attributes
    ----------
    records : tuple of Prepared
    low, high : float
        Lowest and highest voltage [V] of the samples that count and of the turns before them.
    stroke : float
        Displacement peak to peak [m] of the widest record.
    sentences : tuple of str
        What was repaired.
    """

    records: tuple[Prepared, ...]
    low: float
    high: float
    stroke: float
    sentences: tuple[str, ...]

    @classmethod
    def of(cls, records: Record | Sequence[Record]) -> Training:
        """Check and prepare records.

        Raises
        ------
        RecordError
            If a record cannot be used.
        IdentifyError
            If there are none, or no sample counts.
        """
        given = as_list(records)
        if not given:
            raise IdentifyError("got no records, need one loop of voltage and displacement at least")
        prepared = tuple(prepare(record) for record in given)
        stroke = max(high - low for low, high in (item.span() for item in prepared))
        low = min(item.record.voltage_range[0] for item in prepared)
        high = max(item.record.voltage_range[1] for item in prepared)
        return cls(prepared, low, high, stroke, tuple(s for item in prepared for s in item.sentences))

    @property
    def names(self) -> tuple[str, ...]:
        """Of the records."""
        return tuple(item.name for item in self.records)

    @property
    def slope(self) -> float:
        """Mean slope [m/V] of the widest loop."""
        return self.stroke / (self.high - self.low)

    def thresholds(self, plays: int) -> Array:
        """Thresholds (N,) [V] from 0 that cut half of the range in equal parts."""
        return np.asarray(0.5 * (self.high - self.low) * np.arange(plays) / plays, dtype=np.float64)

    def placed(self, bank: PlayBank) -> tuple[PlayBank, PlayState]:
        """The bank and its state after a long descent to the lowest voltage, where displacement is that of the records.

        Records have offsets of their own; the widest one's lowest displacement counts.
        """
        bottom, _ = max((item.span() for item in self.records), key=lambda span: span[1] - span[0])
        state = bank.descended(self.low)
        return replace(bank, offset=bank.offset + bottom - bank.level(state)), state

    @property
    def seconds(self) -> tuple[float, float]:
        """Longest sample time and longest record [s]."""
        return (max(item.record.sample_time for item in self.records),
                max(float(np.ptp(item.record.time)) for item in self.records))  # fmt: skip

    def rows(self, thresholds: Array, times: Array, delay: float, drift: bool = True) -> Rows:
        """Samples that count, evenly thinned if many, as plays and low-passes see them."""
        parts = [part for q in range(len(self.records)) for part in self._rows_of(q, thresholds, times, delay)]
        plays, known, passed, y, curve = (np.concatenate([part[i] for part in parts]) for i in range(5))
        stretch = np.concatenate([np.full(len(part[3]), i) for i, part in enumerate(parts)])
        record = np.concatenate([np.full(len(part[3]), part[5]) for part in parts])
        offsets = stretch[:, None] == np.arange(len(parts))
        drifts = (record[:, None] == np.arange(len(self.records))) * curve[:, None]
        drifts = drifts[:, [drift and item.can_drift for item in self.records]]
        return Rows(plays, known, passed, offsets.astype(np.float64), drifts, y).thinned(_MOST_ROWS)

    def _rows_of(
        self, number: int, thresholds: Array, times: Array, delay: float
    ) -> list[tuple[Array, NDArray[np.bool_], Array, Array, Array, int]]:
        """Plays, known, low-passes, displacement, drift curve and record number of each stretch of a record."""
        item, found = self.records[number], []
        for _, piece, curve in item.delayed(number, delay):
            v = np.ascontiguousarray(piece.voltage)
            z = play_outputs(thresholds, np.full(thresholds.size, v[0]), v)
            passed = lowpassed(v, piece.time, times)
            for epoch in epochs(piece, item.noise):
                span, reach = slice(epoch.start, epoch.stop), float(np.ptp(v[: epoch.start]))
                # The range of a sampled wave ends a rounding error short of its turns.
                known = np.broadcast_to(2 * thresholds <= reach * (1 + 1e-9), z[span].shape)
                found.append((z[span], known, passed[span], piece.displacement[span], curve[span], number))
        return found

    def lag(self, given: float | None) -> float:
        """The delay [s] that was given, if it is one, or that is found.

        Raises
        ------
        IdentifyError
            If it is negative, or a quarter of a cycle or more.
        """
        if given is None:
            return self.delay()
        cycle = min(repairs.cycle_time(item.record) for item in self.records)
        if not isinstance(given, Real) or not 0 <= float(given) < 0.25 * cycle:
            raise IdentifyError(
                f"delay: got {given!r}, need seconds, 0 or more and less than a quarter of a cycle of {cycle:.4g} s"
            )
        return float(given)

    @one_thread()
    def delay(self) -> float:
        """Seconds by which the displacement lags the voltage: least residual of plays alone; 0 unless worth it."""
        from scipy.optimize import minimize_scalar

        thresholds = np.linspace(0, 0.5 * (self.high - self.low), 31)[:-1]
        longest = 0.05 * min(repairs.cycle_time(item.record) for item in self.records)
        sample = min(item.record.sample_time for item in self.records)

        def cost(delay: float) -> float:
            rows = self.rows(thresholds, np.zeros(0), float(delay)).thinned(_SEARCH_ROWS)
            knots = [np.linspace(self.low + r, self.high - r, 5)[1:-1] for r in thresholds]
            return nonnegative(rows.ramps(knots), rows.nuisance, rows.displacement)[1]

        grid = np.linspace(0.0, longest, 13)
        costs = [cost(x) for x in grid]
        k = int(np.argmin(costs))
        bounds = grid[max(k - 1, 0)], grid[min(k + 1, 12)]
        found = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 0.01 * sample, "maxiter": 40})
        share = _WORTH_OF_ONE_HEIGHT if all(map(_one_height, self.records)) else _WORTH
        worth = found.fun < share * costs[0] and costs[0] - found.fun > 1e-5 * self.stroke
        return float(found.x) if worth and found.x > 0.02 * sample else 0.0


def _one_height(item: Prepared) -> bool:
    """Whether all legs of the voltage are of one height."""
    v = item.record.voltage
    legs = np.abs(np.diff(v[turning_points(v, 0.02 * float(np.ptp(v)))]))
    return legs.size < 2 or bool(legs.min() > 0.9 * legs.max())


def lowpassed(v: Array, time: Array, times: Array) -> Array:
    """Low-passes (n, K) of a voltage (n,) [V], straight between samples, that rest at its first value before it."""
    ratio = np.diff(time)[:, None] / times
    kept, taken = np.exp(-ratio), 1 + np.expm1(-ratio) / ratio
    pushed = v[:-1, None] * (1 - kept) + np.diff(v)[:, None] * taken
    out = np.empty((v.size, times.size))
    out[0] = v[0]
    for t in range(v.size - 1 if times.size else 0):
        out[t + 1] = kept[t] * out[t] + pushed[t]
    return out


def count(value: object, what: str, most: int = 500) -> None:
    """Refuse what is no whole number from 1 to `most`.

    Raises
    ------
    IdentifyError
    """
    if not isinstance(value, Integral) or isinstance(value, bool) or not 1 <= int(value) <= most:
        raise IdentifyError(f"{what}: got {value!r}, need a whole number from 1 to {most}")


def share(value: object, what: str) -> None:
    """Refuse what is no number above 0 and below 1.

    Raises
    ------
    IdentifyError
    """
    if not isinstance(value, Real) or not 0 < float(value) < 1:
        raise IdentifyError(f"{what}: got {value!r}, need a fraction between 0 and 1")
