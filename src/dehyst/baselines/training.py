"""Training of baselines: records and splits in one regression with a delay; plays as its columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import IdentifyError
from dehyst._threads import one_thread
from dehyst._types import Array
from dehyst.baselines._native import play_outputs
from dehyst.identification.preprocessing import cleaning
from dehyst.identification.preprocessing.preparation import Prepared, as_list, prepare
from dehyst.identification.preprocessing.regressors import collect
from dehyst.identification.regression.nuisances import searched_delay, worthwhile
from dehyst.identification.regression.regression import Regression
from dehyst.identification.structure import Grid
from dehyst.records import Record
from dehyst.records.signals import rms

_MOST_ROWS = 30_000
_QUARTERS = 4
# Least share of a decay that constants and the other decays do not explain already.
_NEW = 1e-6


@dataclass(frozen=True, eq=False)
class PlayRows:
    """Outputs of plays and low-passes at the samples that count, stacked over all records.

    `training`: displacements and nuisances. `thresholds` (N,): r_i [V]. `plays` (n, N): outputs z_i [V]. `known` (n, N)
    bool: whether the state of play i is known; a play whose state is not known stands still. `lowpasses` (n, K):
    outputs [V].
    """

    training: Training
    thresholds: Array
    plays: Array
    known: NDArray[np.bool_]
    lowpasses: Array

    @classmethod
    def from_training(
        cls, training: Training, thresholds: Array, times: Array | None = None, most: int = _MOST_ROWS
    ) -> PlayRows:
        """Simulate plays of these thresholds (N,) [V] and low-passes of these times (K,) [s] on the records."""
        few = training.subsample(most)
        constants = np.zeros(0) if times is None else times
        plays = few.map_voltages(lambda v: play_outputs(thresholds, np.full(thresholds.size, v[0]), v))
        passed = few.map_records(lambda piece: low_pass(piece, constants))
        # The range of a sampled wave ends a rounding error short of its turns.
        known = 2 * thresholds <= few.reach[:, None] * (1 + 1e-9)
        return cls(few, thresholds, plays, known, passed)

    def ramps(self, knots: Sequence[Array] | None = None) -> Array:
        """Return the columns (n, p) of the slopes of each play's curve, by default straight, and of the low-passes.

        A play whose state is not known contributes 0.
        """
        bends = [np.zeros(0)] * self.thresholds.size if knots is None else knots
        curves = [ramps(z, k) * known[:, None] for z, k, known in zip(self.plays.T, bends, self.known.T, strict=True)]
        return np.concatenate([*curves, self.lowpasses], axis=1)

    def fit(
        self, columns: Array, floors: Array | None = None, rough: Array | None = None, smoothing: float = 0.0
    ) -> WeightFit:
        """Fit the weights of columns (n, p) by nonnegative least squares; see `fit_nonnegative`."""
        training = self.training
        return fit_nonnegative(columns, training.nuisances, training.displacement, floors, rough, smoothing)


def even_thresholds(training: Training, plays: int) -> Array:
    """Return thresholds (N,) [V] from 0 that divide half of the voltage's range into equal parts."""
    low, high = training.limits
    return np.asarray(0.5 * (high - low) * np.arange(plays) / plays, dtype=np.float64)


def with_unknown_start(training: Training, times: Array) -> Training:
    """Return a copy for a model with low-passes of these times (K,) [s], which replace the drifts.

    Their outputs before the first sample are not known: their decay in each piece is a nuisance.
    """
    constants = training.offsets / np.linalg.norm(training.offsets, axis=0)

    def decay(piece: Record, decaying: Record) -> Array:
        since = piece.time[:, None] - piece.time[0]
        return np.asarray(np.exp(-since / times)) if piece is decaying else np.zeros((len(piece), times.size))

    decays = training.map_records(lambda piece: np.hstack([decay(piece, other) for other in training.pieces]))
    # Slow decays look like constants: keep only what is new, on an orthogonal basis.
    basis, sizes, _ = np.linalg.svd(decays - constants @ (constants.T @ decays), full_matrices=False)
    new = basis[:, sizes > _NEW * sizes.max(initial=0.0)] * np.sqrt(len(training))
    return replace(training, nuisances=np.hstack([training.offsets, new]))


def low_pass(piece: Record, times: Array) -> Array:
    """Return low-passes (n, K) of a voltage (n,) [V]: linear between samples, at rest at its first value before it."""
    v = piece.voltage
    ratio = np.diff(piece.time)[:, None] / times
    kept, taken = np.exp(-ratio), 1 + np.expm1(-ratio) / ratio
    pushed = v[:-1, None] * (1 - kept) + np.diff(v)[:, None] * taken
    out = np.empty((v.size, times.size))
    out[0] = v[0]
    for t in range(v.size - 1 if times.size else 0):
        out[t + 1] = kept[t] * out[t] + pushed[t]
    return out


def cross_validation_error(training: Training, columns: Array, floors: Array, rough: Array, smoothing: float) -> float:
    """Return the RMS error [m] of predicting each quarter of the epochs from a fit to the rest, its constant free."""
    blocks = np.zeros(len(training), dtype=np.intp)
    for offset in training.offsets.T:
        stretch = np.flatnonzero(offset)
        blocks[stretch] = np.arange(stretch.size) * _QUARTERS // max(stretch.size, 1)
    squares, y, nuisances = 0.0, training.displacement, training.nuisances
    for block in range(_QUARTERS):
        kept, held_out = blocks != block, blocks == block
        weights = fit_nonnegative(columns[kept], nuisances[kept], y[kept], floors, rough, smoothing).weights
        rest, offsets = y[held_out] - columns[held_out] @ weights, training.offsets[held_out]
        residual = rest - offsets @ np.linalg.lstsq(offsets, rest, rcond=None)[0]
        squares += float(residual @ residual)
    return float(np.sqrt(squares / len(training)))


class WeightFit(NamedTuple):
    """Weights (p,), coefficients of the nuisances (B,) and the RMS residual."""

    weights: Array
    nuisances: Array
    rms: float


def ramps(z: Array, knots: Array) -> Array:
    """Return columns (n, K + 1) whose weights are the slopes of a curve through (knots[0], 0), without knots (0, 0)."""
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
    """Fit weights of columns, each at least its floor, beside nuisances of any sign, by least squares.

    `floors` (p,): least weights; by default 0. `rough` (m, p): combinations of the weights that shall be small; by
    default each weight. `smoothing`: weight of their squares, relative to the largest mean square of a column.
    """
    from scipy.optimize import nnls

    count = columns.shape[1]
    least = np.zeros(count) if floors is None else floors
    scale, y_scale = float(np.sqrt(np.mean(columns**2, axis=0)).max()), float(np.ptp(target))
    rest = (target - columns @ least) / y_scale
    # The triangular factor below the nuisances' rows is the same problem without them.
    r = np.asarray(np.linalg.qr(np.column_stack([nuisance, columns / scale, rest]), mode="r"))
    r = r[nuisance.shape[1] :, nuisance.shape[1] :]
    penalty = np.sqrt(smoothing * target.size) * (np.eye(count) if rough is None else rough)
    penalty_target = -penalty @ least * scale / y_scale
    excess, _ = nnls(np.concatenate([r[:, :-1], penalty]), np.append(r[:, -1], penalty_target), maxiter=30 * count)
    weights = least + excess * y_scale / scale
    rest = target - columns @ weights
    coefficients = np.asarray(np.linalg.lstsq(nuisance, rest, rcond=None)[0], dtype=np.float64)
    return WeightFit(weights, coefficients, rms(rest - nuisance @ coefficients))


def differences(shape: Sequence[int], *, beside: Sequence[tuple[int, int]] = ((0, 1), (1, 0))) -> Array:
    """Return rows (m, p) that subtract neighbours in a table whose row i has shape[i] places; row 0 is left out.

    `beside` holds the steps (rows, places) from a place to its neighbours.
    """
    first = np.cumsum([0, *shape])
    pairs = [
        (first[i] + j, first[i + di] + j + dj)
        for i in range(1, len(shape))
        for j in range(shape[i])
        for di, dj in beside
        if i + di < len(shape) and 0 <= j + dj < shape[i + di]
    ]
    rows = np.zeros((len(pairs), int(first[-1])))
    for row, (a, b) in zip(rows, pairs, strict=True):
        row[[a, b]] = 1.0, -1.0
    return rows


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

    def fit_constant(self, rest: Array) -> tuple[float, float]:
        """Fit the nuisances to what a model leaves (n,) [m]; return the model's own constant and the RMS residual."""
        constants = np.linalg.lstsq(self.nuisances, rest, rcond=None)[0]
        return float(constants[self.reference]), rms(rest - self.nuisances @ constants)

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
    grid = Grid.maxwell_slip(np.zeros(0), np.array([low, high]))
    nuisances = Regression(rows, grid, 0.0, np.zeros(len(items)), tuple(drifting)).nuisances()
    voltages = np.concatenate([piece.voltage for piece in pieces])
    reach = [
        np.full(epoch.stop - epoch.start, np.ptp(piece.voltage[: epoch.start]))
        for piece, its_epochs in zip(pieces, epochs, strict=True)
        for epoch in its_epochs
    ]
    return Training(
        pieces=tuple(pieces),
        kept=tuple(
            np.concatenate([np.zeros(0, np.intp), *(np.arange(epoch.start, epoch.stop) for epoch in own)])
            for own in epochs
        ),
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


def _checked_delay(delay: object, items: list[Prepared]) -> float:
    cycle = min(cleaning.cycle_time(item.record) for item in items)
    if isinstance(delay, Real) and not isinstance(delay, bool) and 0 <= float(delay) < 0.25 * cycle:
        return float(delay)
    raise IdentifyError(
        argument="delay",
        got=repr(delay),
        need=f"seconds, 0 or more and less than a quarter of a cycle of {cycle:.4g} s",
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
