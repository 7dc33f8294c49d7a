"""Training records of the baselines: prepared as `dehyst.identify` prepares them, with the samples that count.

Start-up transients, gaps, the delay and a drift are treated as in `dehyst.identify`. A sample counts once the voltage
has been through its range: from then on plays, relays and states that the range does not move add a constant. Each
such stretch has a constant of its own, so that no record's offset enters the fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import IdentifyError
from dehyst._threads import one_thread
from dehyst._types import Array
from dehyst.baselines.play_regressors import PlayRows, even_thresholds
from dehyst.identification.preprocessing import cleaning
from dehyst.identification.preprocessing.preparation import Prepared, as_list, prepare
from dehyst.identification.preprocessing.regressors import Epoch, collect
from dehyst.identification.regression.nuisances import searched_delay, worthwhile
from dehyst.identification.regression.regression import Regression
from dehyst.model.structure import Grid
from dehyst.records import Record

Model = TypeVar("Model")

_SEARCH_ROWS = 4000
# Plays, and segments of each play's curve, of the model that estimates a delay.
_PLAYS, _SEGMENTS = 30, 4


@dataclass(frozen=True, eq=False)
class Training:
    """Pieces of records, each simulated from its first sample, and their samples that count.

    Attributes
    ----------
    pieces : tuple of Record
        Their voltages are delayed.
    kept : tuple of (k,) int array
        Samples of each piece that count.
    displacement : (n,) array
        Displacement [m] of the samples that count, of all pieces.
    reach : (n,) array
        Range of the voltage [V] before the epoch of each of them: what has been through it is in a known state.
    nuisances : (n, m) array
        Columns that every fit is free to use: one constant for each epoch, then drifts.
    epochs : int
        Number of constants.
    reference : int
        Column whose coefficient is the model's own constant: that of the widest record's last epoch.
    limits : (float, float)
        Lowest and highest voltage [V].
    stroke : float
        Range of the widest record's loops [m].
    delay : float
        Seconds by which the displacement lags the voltage.
    sentences : tuple of str
        Repairs of the records, as sentences.
    """

    pieces: tuple[Record, ...]
    kept: tuple[NDArray[np.intp], ...]
    displacement: Array
    reach: Array
    nuisances: Array
    epochs: int
    reference: int
    limits: tuple[float, float]
    stroke: float
    delay: float
    sentences: tuple[str, ...] = ()

    def __len__(self) -> int:
        return self.displacement.size

    @property
    def slope(self) -> float:
        """Mean slope [m/V] of the widest loop."""
        return self.stroke / (self.limits[1] - self.limits[0])

    @property
    def offsets(self) -> Array:
        """The constants among the nuisances (n, epochs)."""
        return self.nuisances[:, : self.epochs]

    def map_voltages(self, run: Callable[[Array], Array]) -> Array:
        """Return `run` of each piece's voltage at the samples that count: (n,) or (n, columns)."""
        return self.map_records(lambda piece: run(piece.voltage))

    def map_records(self, run: Callable[[Record], Array]) -> Array:
        """Return `run` of each piece at the samples that count: (n,) or (n, columns)."""
        return np.concatenate([run(piece)[rows] for piece, rows in zip(self.pieces, self.kept, strict=True)])

    def subsample(self, most: int) -> Training:
        """Return a copy in which about `most` evenly spaced samples count; voltages stay whole."""
        step = max(1, len(self) // most)
        if step == 1:
            return self
        ends = np.cumsum([0, *(rows.size for rows in self.kept)])
        chosen = np.arange(0, len(self), step)
        kept = tuple(
            rows[chosen[(chosen >= a) & (chosen < b)] - a]
            for rows, a, b in zip(self.kept, ends[:-1], ends[1:], strict=True)
        )
        fewer = {name: getattr(self, name)[chosen] for name in ("displacement", "reach", "nuisances")}
        return replace(self, kept=kept, **fewer)


@one_thread()
def fit_with_delay(
    records: Record | Sequence[Record],
    delay: float | None,
    fit: Callable[[Training], tuple[Model, float]],
    *,
    drift: bool = True,
) -> Model:
    """Fit a model to prepared records; without a given delay, keep the better of the fits with and without a delay.

    The delay is estimated with plays; they can mistake for a delay what another model explains. Raise `RecordError` or
    `IdentifyError` as `prepare_training`.

    `fit`: training -> model and its RMS residual.
    """
    training = prepare_training(records, delay=delay, drift=drift)
    model, residual = fit(training)
    if delay is None and training.delay:
        undelayed, residual_undelayed = fit(prepare_training(records, delay=0.0, drift=drift))
        if residual_undelayed <= residual:
            return undelayed
    return model


def prepare_training(records: Record | Sequence[Record], *, delay: float | None = None, drift: bool = True) -> Training:
    """Prepare records for the fit of a model that maps voltage to displacement.

    Raise `RecordError` if a record cannot be used. Raise `IdentifyError` if there is none, no sample counts, or the
    delay is impossible.

    `records`: at least one loop. `delay`: seconds by which the displacement lags the voltage; default: estimated, 0
    unless a delay lowers the residual clearly. `drift`: whether a record may creep by a logarithm of the time since its
    start; the drift is then removed.
    """
    items = [prepare(record) for record in as_list(records)]
    if not items:
        raise IdentifyError("got no records, need at least one loop of voltage and displacement")
    spans = [item.span() for item in items]
    widest = int(np.argmax([high - low for low, high in spans]))
    able = [q for q, item in enumerate(items) if item.can_drift] if drift else []
    lag = _estimate_delay(items, widest, able) if delay is None else _checked_delay(delay, items)
    return _assemble(items, widest, lag, _drifting_records(items, widest, lag, able))


def _assemble(items: list[Prepared], widest: int, lag: float, drifting: Sequence[int]) -> Training:
    parts = [part for q, item in enumerate(items) for part in item.delayed(q, lag)]
    rows, epochs = collect(parts, np.zeros(0), [items[q].noise for q, _, _ in parts])
    pieces = [piece for _, piece, _ in parts]
    low, high = items[widest].span()
    grid = Grid.plain(np.zeros(0), np.array([low, high]))
    nuisances = Regression(rows, grid, 0.0, np.zeros(len(items)), tuple(drifting)).nuisances()
    voltages = np.concatenate([piece.voltage for piece in pieces])
    reach = [
        np.full(epoch.stop - epoch.start, np.ptp(piece.voltage[: epoch.start]))
        for piece, its_epochs in zip(pieces, epochs, strict=True)
        for epoch in its_epochs
    ]
    return Training(
        pieces=tuple(pieces),
        kept=tuple(map(_samples, epochs)),
        displacement=rows.displacement,
        reach=np.concatenate(reach),
        nuisances=nuisances,
        epochs=nuisances.shape[1] - len(drifting),
        reference=int(rows.epoch[rows.record == widest].max()),
        limits=(float(voltages.min()), float(voltages.max())),
        stroke=high - low,
        delay=lag,
        sentences=tuple(sentence for item in items for sentence in item.sentences),
    )


def _samples(epochs: list[Epoch]) -> NDArray[np.intp]:
    return np.concatenate([np.zeros(0, np.intp), *(np.arange(epoch.start, epoch.stop) for epoch in epochs)])


def _checked_delay(delay: object, items: list[Prepared]) -> float:
    cycle = min(cleaning.cycle_time(item.record) for item in items)
    if isinstance(delay, Real) and not isinstance(delay, bool) and 0 <= float(delay) < 0.25 * cycle:
        return float(delay)
    raise IdentifyError(
        f"delay: got {delay!r}, need seconds, 0 or more and less than a quarter of a cycle of {cycle:.4g} s"
    )


def _play_residual(training: Training) -> float:
    """RMS residual [m] of a fit of plays; like every baseline they map voltage to displacement."""
    rows = PlayRows.from_training(training, even_thresholds(training, _PLAYS), most=_SEARCH_ROWS)
    low, high = training.limits
    knots = [np.linspace(low + r, high - r, _SEGMENTS + 1)[1:-1] for r in rows.thresholds]
    return rows.fit(rows.ramps(knots)).rms


def _estimate_delay(items: list[Prepared], widest: int, able: Sequence[int]) -> float:
    """Return the delay [s] with the least residual of plays."""
    longest = 0.05 * min(cleaning.cycle_time(item.record) for item in items)
    sample = min(item.record.sample_time for item in items)
    undelayed = _assemble(items, widest, 0.0, ())

    def cost(delay: float) -> float:
        return _play_residual(_assemble(items, widest, delay, able))

    return searched_delay(cost, longest, sample, undelayed.map_voltages(lambda v: v), undelayed.stroke)


def _drifting_records(items: list[Prepared], widest: int, lag: float, able: Sequence[int]) -> tuple[int, ...]:
    """Return those of the `able` records whose drift is worth a coefficient."""

    def cost(drifting: Sequence[int]) -> float:
        return _play_residual(_assemble(items, widest, lag, drifting))

    low, high = items[widest].span()
    return worthwhile(cost, able, high - low) if able else ()
