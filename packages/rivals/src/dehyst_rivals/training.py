"""Records prepared for a fit: the samples to fit, constants and drifts, a delay, and plays along the voltage.

Every model's `fit` takes `records`, one Record or a sequence: loops, each with its own offset, which need not start
relaxed. `delay` [s]: lag of the displacement behind the voltage; default: estimated. With `drift`, a drift of each
record that is logarithmic in time is estimated and removed. `plays`: number of play operators; their thresholds divide
half of the voltage's range into equal parts, from 0. `slope_floor`: least slope as a fraction of the mean slope,
because a slope of 0 has no inverse. `fit` raises `RecordError` if a record cannot be used, and `IdentifyError` if no
sample counts or an option is impossible.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from dehyst import IdentifyError, Record
from dehyst._threads import one_thread
from dehyst._types import Array
from dehyst.identification import (
    Prepared,
    as_list,
    cycle_time,
    epochs,
    prepare,
)
from dehyst.records import counting, rms
from dehyst_rivals import _rivals as compiled
from dehyst_rivals.searches import searched_delay, worthwhile

Model = TypeVar("Model")
# Numbers of samples in a fit of plays, and in the search for a delay.
_MOST_ROWS, _SEARCH_ROWS = 30_000, 4000
# Numbers of plays, and of segments of each play's curve, in the model that estimates a delay.
_PLAYS, _SEGMENTS = 30, 4


@dataclass(frozen=True, eq=False)
class Training:
    """Pieces of records, each simulated from its first sample, and the samples that count.

    `pieces`: their voltages are delayed. `kept`: samples of each piece that count. `displacement` (n,) [m]: at the
    samples that count, over all pieces. `reach` (n,) [V]: for each of these samples, the range of the voltage before
    its epoch; a play is in a known state if the voltage has been through its range.

    `nuisances` (n, m): columns that every fit is free to use, one constant for each of the `epochs`, then drifts.
    `reference`: the column whose coefficient is the model's own constant: the column of the widest record's last epoch.

    `limits`: lowest and highest voltage [V]. `stroke`: range of the widest record's loops [m]. `delay`: seconds by
    which the displacement lags the voltage.
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

    def thresholds(self, plays: int) -> Array:
        """Return thresholds (N,) [V] of N `plays`, from 0, that divide half of the voltage's range into equal parts."""
        low, high = self.limits
        return np.asarray(0.5 * (high - low) * np.arange(plays) / plays, dtype=np.float64)

    def fit_constant(self, rest: Array) -> tuple[float, float]:
        """Fit the nuisances to a model's residual `rest` (n,) [m]; return its own constant and the RMS residual."""
        constants = np.linalg.lstsq(self.nuisances, rest, rcond=None)[0]
        return float(constants[self.reference]), rms(rest - self.nuisances @ constants)

    def sampled(self, run: Callable[[Record], Array]) -> Array:
        """Return the results of `run` on each piece at the samples that count: (n,) or (n, columns)."""
        return np.concatenate([run(piece)[rows] for piece, rows in zip(self.pieces, self.kept, strict=True)])

    def subsample(self, most: int) -> Training:
        """Return a copy that fits about `most` evenly spaced samples; the voltages keep all samples."""
        step = max(1, len(self) // most)
        if step == 1:
            return self
        chosen = np.arange(0, len(self), step)
        ends = np.cumsum([0, *(rows.size for rows in self.kept)])
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
    """Fit a model to prepared `records`; without a given delay, keep the better of the fits with and without a delay.

    The `delay` [s] is estimated with plays, which can mistake the effect of another model for a delay. `fit`: function
    of a `Training` that returns the model and its RMS residual. With `drift`, a drift of each record is removed. Raise
    as `prepare_training`.
    """
    training = prepare_training(records, delay=delay, drift=drift)
    model, residual = fit(training)
    if delay is None and training.delay:
        undelayed, residual_undelayed = fit(prepare_training(records, delay=0.0, drift=drift))
        if residual_undelayed <= residual:
            return undelayed
    return model


def prepare_training(records: Record | Sequence[Record], *, delay: float | None = None, drift: bool = True) -> Training:
    """Prepare records for the fit of a model that maps voltage to displacement; parameters as in its `fit`.

    Without `delay`, the delay is estimated; it is 0 unless a delay lowers the residual clearly. Raise `RecordError` if
    a record cannot be used, `IdentifyError` if there is none, no sample counts, or the delay is impossible.
    """
    items = [prepare(record) for record in as_list(records)]
    if not items:
        raise IdentifyError("got no records, need at least one loop of voltage and displacement")
    able = [q for q, item in enumerate(items) if item.can_drift] if drift else []
    shortest = min(cycle_time(item.record) for item in items)
    if delay is None:
        delay = _estimated_delay(items, able, 0.05 * shortest)
    elif not isinstance(delay, Real) or isinstance(delay, bool) or not 0 <= float(delay) < 0.25 * shortest:
        need = f"seconds, 0 or more and less than a quarter of a cycle of {shortest:.4g} s"
        raise IdentifyError(argument="delay", got=repr(delay), need=need)
    lag = float(delay)
    drifting: Sequence[int] = ()
    if able:
        stroke = max(high - low for low, high in (item.span() for item in items))
        drifting = worthwhile(lambda which: _play_residual(_assemble(items, lag, which)), able, stroke)
    return _assemble(items, lag, drifting)


def _estimated_delay(items: list[Prepared], able: Sequence[int], longest: float) -> float:
    """Return the delay [s] with the least residual of plays."""
    sample = min(item.record.sample_time for item in items)
    undelayed = _assemble(items, 0.0, ())
    voltage = undelayed.sampled(lambda piece: piece.voltage)
    return searched_delay(
        lambda delay: _play_residual(_assemble(items, delay, able)), longest, sample, voltage, undelayed.stroke
    )


def _play_residual(training: Training) -> float:
    """Return the RMS residual [m] of a fit of plays from voltage to displacement."""
    rows = PlayRows.from_training(training, training.thresholds(_PLAYS), most=_SEARCH_ROWS)
    return rows.fit(rows.ramps(rows.knots(_SEGMENTS))).rms


def _assemble(items: list[Prepared], lag: float, drifting: Sequence[int]) -> Training:
    """Return the samples to fit at this delay [s], with a drift of each of these records."""
    spans = [item.span() for item in items]
    widest = int(np.argmax([high - low for low, high in spans]))
    pieces, kept, reach, drifts, owner = [], [], [], [], []
    for q, item in enumerate(items):
        for piece in item.acting(lag):
            rows = np.zeros(0, np.intp)
            for own in epochs(piece, item.noise):
                at = np.arange(own.start, own.stop)
                at = at if (counted := counting(piece)) is None else at[counted[at]]
                rows = np.append(rows, at)
                reach.append(np.full(at.size, np.ptp(piece.voltage[: own.start])))
                drifts.append(item.drift_curve(piece)[at])
                owner += [q] if at.size else []
            pieces.append(piece)
            kept.append(rows)
    stretches = [turns for turns in reach if turns.size]
    if widest not in owner:
        raise IdentifyError(
            f"{items[widest].name}: no sample counts with a delay of {lag:.3g} s; need at least one full cycle"
        )
    epoch = np.repeat(np.arange(len(stretches)), [stretch.size for stretch in stretches])
    record, drift = np.array(owner)[epoch], np.concatenate(drifts)
    constants = (epoch[:, None] == np.arange(len(stretches))).astype(float)
    nuisances = np.hstack([constants, *(np.where(record == q, drift, 0.0)[:, None] for q in drifting)])
    voltages = np.concatenate([piece.voltage for piece in pieces])
    return Training(
        pieces=tuple(pieces),
        kept=tuple(kept),
        displacement=np.concatenate([piece.displacement[rows] for piece, rows in zip(pieces, kept, strict=True)]),
        reach=np.concatenate(stretches),
        nuisances=nuisances,
        epochs=len(stretches),
        reference=int(epoch[record == widest].max()),
        limits=(float(voltages.min()), float(voltages.max())),
        stroke=spans[widest][1] - spans[widest][0],
        delay=lag,
    )


class WeightFit(NamedTuple):
    """Weights (p,), coefficients of the nuisances (B,) and the RMS residual."""

    weights: Array
    nuisances: Array
    rms: float


@dataclass(frozen=True, eq=False)
class PlayRows:
    """Outputs of plays at the samples that count, over all records.

    `training`: displacements and nuisances. `thresholds` (N,): r_i [V]. `plays` (n, N): outputs z_i [V]. `known` (n, N)
    bool: whether the state of play i is known; a play with unknown state does not move.
    """

    training: Training
    thresholds: Array
    plays: Array
    known: NDArray[np.bool_]

    @classmethod
    def from_training(cls, training: Training, thresholds: Array, most: int = _MOST_ROWS) -> PlayRows:
        """Simulate plays of these thresholds (N,) [V] on the records."""
        few = training.subsample(most)
        plays = few.sampled(
            lambda piece: compiled.play_outputs(thresholds, np.full(thresholds.size, piece.voltage[0]), piece.voltage)
        )
        # The range of a sampled wave is too small by a rounding error.
        return cls(few, thresholds, plays, 2 * thresholds <= few.reach[:, None] * (1 + 1e-9))

    def knots(self, segments: int) -> list[Array]:
        """Return the inner ends [V] of equal segments over the range of each play."""
        low, high = self.training.limits
        return [np.linspace(low + r, high - r, segments + 1)[1:-1] for r in self.thresholds]

    def ramps(self, knots: Sequence[Array] | None = None) -> Array:
        """Return the columns (n, p) for the slopes of each play's curve, by default a straight line.

        A play with unknown state contributes 0.
        """
        bends = [np.zeros(0)] * self.thresholds.size if knots is None else knots
        curves = [ramps(z, k) * known[:, None] for z, k, known in zip(self.plays.T, bends, self.known.T, strict=True)]
        return np.concatenate(curves, axis=1)

    def fit(
        self, columns: Array, floors: Array | None = None, rough: Array | None = None, smoothing: float = 0.0
    ) -> WeightFit:
        """Fit the weights of columns (n, p) by nonnegative least squares; see `fit_nonnegative`."""
        training = self.training
        return fit_nonnegative(columns, training.nuisances, training.displacement, floors, rough, smoothing)


def ramps(z: Array, knots: Array) -> Array:
    """Return columns (n, K + 1) whose weights are slopes of a curve through (knots[0], 0), or without knots (0, 0)."""
    edges = np.concatenate([[-np.inf], knots, [np.inf]])
    origin = knots[0] if knots.size else 0.0
    return np.asarray(np.clip(z[:, None], edges[:-1], edges[1:]) - np.clip(origin, edges[:-1], edges[1:]))


def fit_nonnegative(
    columns: Array,
    nuisance: Array,
    target: Array,
    floors: Array | None = None,
    rough: Array | None = None,
    smoothing: float = 0.0,
) -> WeightFit:
    """Fit weights of columns, each at least its floor, together with nuisances of any sign, by least squares.

    `floors` (p,): least weights; by default 0. `rough` (m, p): combinations of the weights to keep small; by default
    each weight. `smoothing`: weight of their squares, relative to the largest mean square of a column.
    """
    from scipy.optimize import nnls

    count = columns.shape[1]
    least = np.zeros(count) if floors is None else floors
    scale, y_scale = float(np.sqrt(np.mean(columns**2, axis=0)).max()), float(np.ptp(target))
    rest = (target - columns @ least) / y_scale
    # The triangular factor below the rows of the nuisances is the same problem without nuisances.
    r = np.asarray(np.linalg.qr(np.column_stack([nuisance, columns / scale, rest]), mode="r"))
    r = r[nuisance.shape[1] :, nuisance.shape[1] :]
    penalty = np.sqrt(smoothing * target.size) * (np.eye(count) if rough is None else rough)
    penalty_target = -penalty @ least * scale / y_scale
    excess, _ = nnls(np.concatenate([r[:, :-1], penalty]), np.append(r[:, -1], penalty_target), maxiter=30 * count)
    weights = least + excess * y_scale / scale
    rest = target - columns @ weights
    coefficients = np.asarray(np.linalg.lstsq(nuisance, rest, rcond=None)[0], dtype=np.float64)
    return WeightFit(weights, coefficients, rms(rest - nuisance @ coefficients))
