"""Records made ready for a rival that maps voltage to displacement: what `dehyst.identify` leaves out is left out too.

Start-up transients, gaps, the delay, a drift: all as in `dehyst.identify`. A sample counts once the voltage has been
through its range, for from then on relays and states that the range does not move add a constant; each such stretch has
one of its own, so that no record's offset enters the fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite
from numbers import Real
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dehyst import repairs
from dehyst._errors import IdentifyError
from dehyst._native import Array
from dehyst.preparation import Prepared, as_list, prepare
from dehyst.record import Record
from dehyst.regression import Regression
from dehyst.rows import Epoch, Rows, collect

Model = TypeVar("Model")


@dataclass(frozen=True, eq=False)
class Training:
    """Pieces of records to be played from their first sample, and their samples that count.

    Attributes
    ----------
    pieces : tuple of Record
        Voltages delayed.
    kept : tuple of (k,) int array
        Samples of each piece that count.
    displacement : (n,) array
        Of the samples that count, of all pieces [m].
    nuisances : (n, m) array
        Columns that every fit is free to use: one constant for each epoch, then drifts.
    reference : int
        Column whose coefficient is the model's own constant: that of the widest record's last epoch.
    limits : (float, float)
        Lowest and highest voltage [V].
    stroke : float
        Range of the widest record's loops [m].
    delay : float
        Seconds by which the displacement lags the voltage.
    """

    pieces: tuple[Record, ...]
    kept: tuple[NDArray[np.intp], ...]
    displacement: Array
    nuisances: Array
    reference: int
    limits: tuple[float, float]
    stroke: float
    delay: float

    def __len__(self) -> int:
        return self.displacement.size

    def played(self, run: Callable[[Array], Array]) -> Array:
        """What `run` makes of the voltage of each piece, at the samples that count: (n,) or (n, columns)."""
        return np.concatenate([run(piece.voltage)[rows] for piece, rows in zip(self.pieces, self.kept, strict=True)])

    def thinned(self, most: int) -> Training:
        """The same with about `most` samples that count, evenly; voltages stay whole."""
        step = max(1, len(self) // most)
        if step == 1:
            return self
        ends = np.cumsum([0, *(rows.size for rows in self.kept)])
        chosen = np.arange(0, len(self), step)
        kept = tuple(rows[chosen[(chosen >= a) & (chosen < b)] - a]
                     for rows, a, b in zip(self.kept, ends[:-1], ends[1:], strict=True))  # fmt: skip
        return Training(self.pieces, kept, self.displacement[chosen], self.nuisances[chosen], self.reference,
                        self.limits, self.stroke, self.delay)  # fmt: skip


def least_missing(
    records: Record | Sequence[Record], delay: float | None, fit: Callable[[Training], tuple[Model, float]]
) -> Model:
    """Fit on records prepared with a given delay; with none given, with the estimated one and without, the better one.

    The estimate is made with slip elements, and can mistake for a delay what another model explains.

    Parameters
    ----------
    fit : callable
        Training -> model and its RMS residual.

    Raises
    ------
    RecordError, IdentifyError
        Those of `training`.
    """
    ready = training(records, delay=delay)
    model, miss = fit(ready)
    if delay is None and ready.delay:
        undelayed, without = fit(training(records, delay=0.0))
        if without <= miss:
            return undelayed
    return model


def training(records: Record | Sequence[Record], *, delay: float | None = None, drift: bool = True) -> Training:
    """Prepare records.

    Parameters
    ----------
    records : Record or sequence of Record
        One loop at least.
    delay : float, optional
        Seconds by which the displacement lags the voltage; default: estimated as `dehyst.identify` does.
    drift : bool, optional
        Whether a record may creep by a logarithm of the time since its start, which is then set aside.

    Raises
    ------
    RecordError
        If a record cannot be used.
    IdentifyError
        If there is none, no sample counts, or the delay is impossible.
    """
    items = [prepare(record) for record in as_list(records)]
    if not items:
        raise IdentifyError("got no records, need one loop of voltage and displacement at least")
    spans = [item.span() for item in items]
    widest = int(np.argmax([high - low for low, high in spans]))
    stroke = spans[widest][1] - spans[widest][0]
    lag = _estimated(items, stroke, drift) if delay is None else _given(delay, items)
    rows, epochs, pieces = _collected(items, lag, np.zeros(0))
    knots = np.linspace(*spans[widest], 31)
    drifting = _drifts(items, lag, stroke, knots) if drift else ()
    nuisances = Regression(rows, knots, 0.0, np.zeros(0, bool), np.zeros(len(items)), drifting).nuisances()
    voltages = np.concatenate([piece.voltage for piece in pieces])
    return Training(
        pieces=tuple(pieces),
        kept=tuple(_samples(own) for own in epochs),
        displacement=rows.displacement,
        nuisances=nuisances,
        reference=int(rows.epoch[rows.record == widest].max()),
        limits=(float(voltages.min()), float(voltages.max())),
        stroke=stroke,
        delay=lag,
    )


def _samples(epochs: list[Epoch]) -> NDArray[np.intp]:
    return np.concatenate([np.zeros(0, np.intp), *(np.arange(epoch.start, epoch.stop) for epoch in epochs)])


def _collected(items: list[Prepared], lag: float, rho: Array) -> tuple[Rows, list[list[Epoch]], list[Record]]:
    parts = [part for q, item in enumerate(items) for part in item.delayed(q, lag)]
    rows, epochs = collect(parts, rho, [items[q].noise for q, _, _ in parts])
    return rows, epochs, [piece for _, piece, _ in parts]


def _given(delay: object, items: list[Prepared]) -> float:
    cycle = min(repairs.cycle_time(item.record) for item in items)
    if not isinstance(delay, Real) or not isfinite(delay) or abs(float(delay)) > 0.25 * cycle:
        raise IdentifyError(f"delay: got {delay!r}, need seconds, less than a quarter of a cycle of {cycle:.4g} s")
    return float(delay)


def _with_stops(items: list[Prepared], lag: float, stroke: float, knots: Array) -> Regression:
    """The regression on Maxwell-slip elements by which `dehyst.identify` looks for delay and drift."""
    rho = stroke / 60 * np.arange(1.0, 31.0)
    rows, _, _ = _collected(items, lag, rho)
    floor = 0.01 * float(np.ptp(rows.voltage)) / stroke
    return Regression(rows, knots, floor, 2 * rho < stroke * (1 - 1e-9), np.zeros(len(items)))


def _can_drift(items: list[Prepared]) -> list[int]:
    return [q for q, item in enumerate(items) if item.can_drift]


def _estimated(items: list[Prepared], stroke: float, drift: bool) -> float:
    longest = 0.05 * min(repairs.cycle_time(item.record) for item in items)
    sample = min(item.record.sample_time for item in items)
    low, high = max((item.span() for item in items), key=lambda span: span[1] - span[0])
    drifting = tuple(_can_drift(items)) if drift else ()

    def build(lag: float) -> Regression:
        found = _with_stops(items, lag, stroke, np.linspace(low, high, 31))
        return Regression(found.rows, found.knots, found.floor, found.movable, found.datum, drifting)

    return repairs.find_delay(build, longest, sample)


def _drifts(items: list[Prepared], lag: float, stroke: float, knots: Array) -> tuple[int, ...]:
    return repairs.find_drifts(_with_stops(items, lag, stroke, knots), _can_drift(items))
