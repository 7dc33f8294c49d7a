"""Records made ready for a rival that maps voltage to displacement: what `dehyst.identify` leaves out is left out too.

Start-up transients, gaps, the delay, a drift: all as in `dehyst.identify`. A sample counts once the voltage has been
through its range, for from then on plays, relays and states that the range does not move add a constant; each such
stretch has one of its own, so that no record's offset enters the fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from numbers import Real
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import IdentifyError
from dehyst._threads import one_thread
from dehyst.baselines.play_regressors import PlayRows, even_thresholds
from dehyst.baselines.training import Training
from dehyst.identification.preprocessing import cleaning
from dehyst.identification.preprocessing.preparation import Prepared, as_list, prepare
from dehyst.identification.preprocessing.regressors import Epoch, collect
from dehyst.identification.regression.nuisances import searched_delay, worthwhile
from dehyst.identification.regression.regression import Regression
from dehyst.model.structure import Grid
from dehyst.records import Record

Model = TypeVar("Model")

_SEARCH_ROWS = 4000
# Plays and segments of each play's curve by which a delay is looked for.
_PLAYS, _SEGMENTS = 30, 4


@one_thread()
def least_missing(
    records: Record | Sequence[Record],
    delay: float | None,
    fit: Callable[[Training], tuple[Model, float]],
    *,
    drift: bool = True,
) -> Model:
    """Fit on records prepared with a given delay; with none given, with the estimated one and without, the better one.

    The estimate is made with plays, and can mistake for a delay what another model explains.

    Parameters
    ----------
    fit : callable
        Training -> model and its RMS residual.

    Raises
    ------
    RecordError, IdentifyError
        Those of `training`.
    """
    ready = training(records, delay=delay, drift=drift)
    model, miss = fit(ready)
    if delay is None and ready.delay:
        undelayed, without = fit(training(records, delay=0.0, drift=drift))
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
        Seconds by which the displacement lags the voltage; default: estimated, and 0 unless one is worth it.
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
    able = [q for q, item in enumerate(items) if item.can_drift] if drift else []
    lag = _estimated(items, widest, able) if delay is None else _given(delay, items)
    return _ready(items, widest, lag, _drifting(items, widest, lag, able))


def _ready(items: list[Prepared], widest: int, lag: float, drifting: Sequence[int]) -> Training:
    parts = [part for q, item in enumerate(items) for part in item.delayed(q, lag)]
    rows, epochs = collect(parts, np.zeros(0), [items[q].noise for q, _, _ in parts])
    pieces = [piece for _, piece, _ in parts]
    low, high = items[widest].span()
    grid = Grid.plain(np.zeros(0), np.array([low, high]))
    nuisances = Regression(rows, grid, 0.0, np.zeros(len(items)), tuple(drifting)).nuisances()
    voltages = np.concatenate([piece.voltage for piece in pieces])
    found = [(piece, epoch) for piece, own in zip(pieces, epochs, strict=True) for epoch in own]
    reach = [np.full(epoch.stop - epoch.start, np.ptp(piece.voltage[: epoch.start])) for piece, epoch in found]
    return Training(
        pieces=tuple(pieces),
        kept=tuple(_samples(own) for own in epochs),
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


def _given(delay: object, items: list[Prepared]) -> float:
    cycle = min(cleaning.cycle_time(item.record) for item in items)
    if isinstance(delay, Real) and not isinstance(delay, bool) and 0 <= float(delay) < 0.25 * cycle:
        return float(delay)
    raise IdentifyError(
        f"delay: got {delay!r}, need seconds, 0 or more and less than a quarter of a cycle of {cycle:.4g} s"
    )


def _missed(ready: Training) -> float:
    """RMS residual [m] of plays, which map voltage to displacement as rivals do; records' offsets do not matter."""
    rows = PlayRows.of(ready, even_thresholds(ready, _PLAYS), most=_SEARCH_ROWS)
    low, high = ready.limits
    knots = [np.linspace(low + r, high - r, _SEGMENTS + 1)[1:-1] for r in rows.thresholds]
    return rows.solved(rows.ramps(knots)).rms


def _estimated(items: list[Prepared], widest: int, able: Sequence[int]) -> float:
    """The delay [s] at which plays leave least."""
    longest = 0.05 * min(cleaning.cycle_time(item.record) for item in items)
    sample = min(item.record.sample_time for item in items)
    plain = _ready(items, widest, 0.0, ())

    def cost(delay: float) -> float:
        return _missed(_ready(items, widest, delay, able))

    return searched_delay(cost, longest, sample, plain.played(lambda v: v), plain.stroke)


def _drifting(items: list[Prepared], widest: int, lag: float, able: Sequence[int]) -> tuple[int, ...]:
    """Records among those that can drift whose creep is worth a coefficient."""

    def cost(drifting: Sequence[int]) -> float:
        return _missed(_ready(items, widest, lag, drifting))

    low, high = items[widest].span()
    return worthwhile(cost, able, high - low) if able else ()
