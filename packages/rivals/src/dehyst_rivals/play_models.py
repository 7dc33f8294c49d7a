"""Sums of plays: Prandtl-Ishlinskii, its modified and generalized forms, and Krasnosel'skii-Pokrovskii."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self, final

import numpy as np
from numpy.typing import ArrayLike

from dehyst import IdentifyError, ModelError
from dehyst._types import Array
from dehyst._validation import count, fraction, keep, vector
from dehyst.model import on_curve
from dehyst.records import Record, rms
from dehyst.trust import AbstractBaseline
from dehyst_rivals.plays import EMPTY, PlayBank, PlayState
from dehyst_rivals.training import PlayRows, Training, fit_nonnegative, fit_with_delay, ramps

_QUARTERS = 4
# Least part of a decay that must not be explained by constants and other decays.
_NEW = 1e-6
# Most passes of the alternating fit; it ends when a pass lowers the residual by less than this part.
_PASSES, _SETTLED = 30, 1e-4
# Low-passes that are not fitted to creep do harm: they must lower the cross-validation error to this part.
_GAIN = 0.8


@dataclass(frozen=True, eq=False)
class AbstractPlayModel(AbstractBaseline):
    """A bank of play operators with the common interface of models.

    `bank`: its operators. `state`: default start of a motion, after a long descent to the lowest voltage of its
    records.
    """

    bank: PlayBank
    state: PlayState
    delay: float = 0.0

    @property
    def parameters(self) -> int:
        """Number of coefficients."""
        return self.bank.parameters

    def _run(self, drive: Array, state: PlayState, time: ArrayLike | None, *, inverse: bool) -> tuple[Array, PlayState]:
        return (self.bank.compensate if inverse else self.bank.simulate)(drive, state, time)

    @classmethod
    def _from_bank(cls, bank: PlayBank, training: Training) -> Self:
        """Return the model of a bank fitted to these records."""
        return cls(bank, bank.state_after_descent(training.limits[0]), training.delay)


@final
@dataclass(frozen=True, eq=False)
class PrandtlIshlinskii(AbstractPlayModel):
    """``y = offset + sum_i w_i play_i[v]``, all w_i >= 0: loops are symmetric about their centre."""

    @property
    def weights(self) -> Array:
        """w_i (N,) [m/V]."""
        return np.concatenate(self.bank.slopes)

    @classmethod
    def fit(
        cls,
        records: Record | Sequence[Record],
        *,
        plays: int = 20,
        slope_floor: float = 0.05,
        delay: float | None = None,
        drift: bool = True,
    ) -> PrandtlIshlinskii:
        """Fit the weights by nonnegative least squares; parameters are those of every model, see `training`.

        `slope_floor` applies to the weight of threshold 0.
        """
        count(plays, "plays")
        fraction(slope_floor, "slope_floor")

        def fit_model(training: Training) -> tuple[PrandtlIshlinskii, float]:
            rows = PlayRows.from_training(training, training.thresholds(plays))
            floors = np.zeros(plays)
            floors[0] = slope_floor * training.slope
            weights, nuisances, residual = rows.fit(rows.ramps(), floors)
            bank = PlayBank(rows.thresholds, [EMPTY] * plays, weights[:, None], float(nuisances[training.reference]))
            return cls._from_bank(bank, training), residual

        return fit_with_delay(records, delay, fit_model, drift=drift)


@final
@dataclass(frozen=True, eq=False)
class ModifiedPrandtlIshlinskii(AbstractBaseline):
    """``y = S(x)``, ``x = offset + sum_i w_i play_i[v]``, all w_i >= 0; S is increasing and piecewise linear.

    S is Kuhnen's superposition of one-sided dead zones: its slope changes at each dead zone's threshold.

    `bank`: the plays, whose sum is in volts; the first threshold is 0. `places`, `values` (M,): knots of S, [V] and
    [m], both strictly increasing; S continues linearly beyond. `state`: default start, after a long descent to the
    lowest voltage of its records. Raise `ModelError` if S does not increase.
    """

    bank: PlayBank
    places: Array
    values: Array
    state: PlayState
    delay: float = 0.0

    def __post_init__(self) -> None:
        for name in ("places", "values"):
            values = vector(getattr(self, name), name)
            if values.size < 2 or np.any(np.diff(values) <= 0):
                raise ModelError(argument=name, got=values, need="two or more, strictly increasing")
            keep(self, **{name: values})
        if self.places.size != self.values.size:
            raise ModelError(f"values: got {self.values.size}, need one for each of {self.places.size} places")

    @property
    def weights(self) -> Array:
        """w_i (N,)."""
        return np.concatenate(self.bank.slopes)

    @property
    def parameters(self) -> int:
        """Number of coefficients: weights, slopes and the offset; weights and slopes share one scale."""
        return self.weights.size + self.places.size - 1

    def _run(self, drive: Array, state: PlayState, time: ArrayLike | None, *, inverse: bool) -> tuple[Array, PlayState]:
        if inverse:
            return self.bank.compensate(on_curve(self.values, self.places, drive), state)
        x, after = self.bank.simulate(drive, state)
        return on_curve(self.places, self.values, x), after

    @classmethod
    def fit(
        cls,
        records: Record | Sequence[Record],
        *,
        plays: int = 20,
        segments: int = 10,
        slope_floor: float = 0.05,
        delay: float | None = None,
        drift: bool = True,
    ) -> ModifiedPrandtlIshlinskii:
        """Fit weights and slopes together, by repeated nonnegative least squares linearised at the last solution.

        Kuhnen's own program is linear in the weights and in the slopes of S's inverse, but needs one sensor zero for
        all records; here each record has an offset of its own.

        Parameters are those of every model, see `training`, and `segments`: number of segments of S, of
        equal length. `slope_floor` applies to the weight of threshold 0 and to the slopes of S.
        """
        count(plays, "plays")
        count(segments, "segments")
        fraction(slope_floor, "slope_floor")

        def fit_model(training: Training) -> tuple[ModifiedPrandtlIshlinskii, float]:
            thresholds, low = training.thresholds(plays), training.limits[0]
            problem = _AlternatingFit(PlayRows.from_training(training, thresholds), segments, slope_floor)
            weights, values, residual = problem.solve()
            offset = low - float(weights @ (low + thresholds))
            bank = PlayBank(thresholds, [EMPTY] * plays, weights[:, None], offset)
            return cls(bank, problem.places, values, bank.state_after_descent(low), training.delay), residual

        return fit_with_delay(records, delay, fit_model, drift=drift)


class _Unknowns(NamedTuple):
    """Weights (N,), slopes of S (M,) and shifts of the epochs in which a play does not move."""

    weights: Array
    slopes: Array
    shifts: Array


class _AlternatingFit:
    """The fit of weights and slopes; x runs from the lowest to the highest voltage on the major loop."""

    def __init__(self, rows: PlayRows, segments: int, floor: float) -> None:
        self._training, thresholds = rows.training, rows.thresholds
        low, high = self._training.limits
        self._low, self._reach, self._spacing = low, high - low - 2 * thresholds, (high - low) / segments
        self.places: Array = np.asarray(low + self._spacing * np.arange(segments + 1), dtype=np.float64)
        moved = rows.plays - low - thresholds
        # A play that does not move adds a constant to x: each epoch with such a play gets an unknown.
        self._z, self._still = moved * rows.known, moved * ~rows.known
        self._stretches = self._training.offsets[:, self._training.offsets.T @ np.any(~rows.known, axis=1) > 0]
        self._floors = np.full(thresholds.size + segments, floor * self._training.slope)
        self._floors[0], self._floors[1 : thresholds.size] = floor, 0.0

    def solve(self) -> tuple[Array, Array, float]:
        """Return the weights (N,), S at the places (M + 1,) [m], and the RMS residual [m]."""
        training = self._training
        floors = np.zeros(self._z.shape[1])
        floors[0] = self._floors[0] * self._floors[-1]
        weights = fit_nonnegative(self._z, training.nuisances, training.displacement, floors).weights
        share_of = self._stretches / np.maximum(self._stretches.sum(axis=0), 1)
        gauge = self._gauge(weights)
        slopes = np.ones(self.places.size - 1) / gauge
        at = _Unknowns(weights * gauge, slopes, np.asarray(share_of.T @ (self._still @ (weights * gauge))))
        best = rms(self._residual(at)[0])
        for _ in range(_PASSES):
            aim = self._gauss_newton_step(at)
            for part in 0.5 ** np.arange(6):
                trial = _Unknowns(*(old + part * (new - old) for old, new in zip(at, aim, strict=True)))
                cost = rms(self._residual(trial)[0])
                if cost < best:
                    break
            else:
                break
            settled, best = cost > (1 - _SETTLED) * best, cost
            gauge = self._gauge(trial.weights)
            at = _Unknowns(trial.weights * gauge, trial.slopes / gauge, trial.shifts * gauge)
            if settled:
                break
        values = ramps(self.places, self.places[1:-1]) @ at.slopes
        return at.weights, values + self._residual(at)[1][training.reference], best

    def _gauge(self, weights: Array) -> float:
        """Return the factor that scales x to the range of the voltage on the major loop."""
        return float(self._reach[0] / (weights @ self._reach))

    def _map(self, at: _Unknowns) -> tuple[Array, Array]:
        """Return x (n,) and the columns (n, M) of the slopes: S (n,) is their product with the slopes."""
        x = self._low + self._z @ at.weights + self._stretches @ at.shifts
        return x, ramps(x, self.places[1:-1])

    def _residual(self, at: _Unknowns) -> tuple[Array, Array]:
        """Return the residual (n,) [m], and the coefficients of the nuisances."""
        rest = self._training.displacement - self._map(at)[1] @ at.slopes
        nuisances = np.asarray(np.linalg.lstsq(self._training.nuisances, rest, rcond=None)[0], dtype=np.float64)
        return rest - self._training.nuisances @ nuisances, nuisances

    def _gauss_newton_step(self, at: _Unknowns) -> _Unknowns:
        """Return the best unknowns for S linearised at the present unknowns."""
        x, columns = self._map(at)
        slope = at.slopes[np.clip(((x - self._low) / self._spacing).astype(int), 0, at.slopes.size - 1)]
        of_weights, of_shifts = self._z * slope[:, None], self._stretches * slope[:, None]
        target = self._training.displacement + of_weights @ at.weights + of_shifts @ at.shifts
        nuisance = np.concatenate([self._training.nuisances, of_shifts], axis=1)
        # In units of their mean, slopes are of the size of weights.
        units = np.concatenate([np.ones(at.weights.size), np.full(at.slopes.size, at.slopes.mean())])
        both = np.concatenate([of_weights, columns], axis=1)
        solution = fit_nonnegative(both * units, nuisance, target, self._floors / units).weights * units
        rest = np.linalg.lstsq(nuisance, target - both @ solution, rcond=None)[0]
        weights, slopes = np.split(solution, [at.weights.size])
        return _Unknowns(weights, slopes, rest[self._training.nuisances.shape[1] :])


@final
@dataclass(frozen=True, eq=False)
class GeneralizedPrandtlIshlinskii(AbstractPlayModel):
    """``y = offset + sum_i phi_i(play_i[v]) + sum_k c_k lowpass_k[v]``, phi_i increasing and piecewise linear.

    Its inverse is exact: it steps from each change of slope to the next.
    """

    @classmethod
    def fit(
        cls,
        records: Record | Sequence[Record],
        *,
        plays: int = 30,
        segments: int = 12,
        lowpasses: ArrayLike | None = None,
        slope_floor: float = 0.05,
        smoothing: float = 1e-5,
        delay: float | None = None,
        drift: bool = True,
    ) -> GeneralizedPrandtlIshlinskii:
        """Fit the slopes of all curves and the low-passes' shares by nonnegative least squares.

        Parameters are those of every model, see `training`, and those below. `slope_floor` applies to the
        slope just after a reversal. Low-passes replace the drift.

        `segments`: number of segments of each curve, over the range of its play. `lowpasses` (K,): time constants [s];
        empty: no creep. Default: two per decade from two samples to a third of the longest record if they lower the
        cross-validation error much, else none. `smoothing`: weight of the squared differences of neighbouring slopes;
        it determines the slopes that the records leave open.
        """
        count(plays, "plays")
        count(segments, "segments")
        fraction(slope_floor, "slope_floor")
        given = None if lowpasses is None else vector(lowpasses, "lowpasses", error=IdentifyError)
        if given is not None and np.any(given <= 0):
            raise IdentifyError(f"lowpasses: got {given}, need time constants above 0, in seconds")

        def fit_model(training: Training) -> tuple[GeneralizedPrandtlIshlinskii, float]:
            choices = [_default_times(training), EMPTY] if given is None else [given]
            designs = [_Design.of(training, plays, segments, times, slope_floor, smoothing) for times in choices]
            if len(designs) > 1 and designs[0].held_out_error() > _GAIN * designs[1].held_out_error():
                del designs[0]
            bank, residual = designs[0].fit()
            return cls._from_bank(bank, training), residual

        return fit_with_delay(records, delay, fit_model, drift=drift)


@dataclass(frozen=True, eq=False)
class _Design:
    """The columns of slopes and low-passes, with their floors and their smoothing."""

    rows: PlayRows
    knots: list[Array]
    times: Array
    columns: Array
    floors: Array
    rough: Array
    smoothing: float

    @classmethod
    def of(cls, training: Training, plays: int, segments: int, times: Array, floor: float, smoothing: float) -> _Design:
        prepared = with_unknown_start(training, times) if times.size else training
        rows = PlayRows.from_training(prepared, training.thresholds(plays))
        knots = rows.knots(segments)
        columns = np.hstack([rows.ramps(knots), rows.training.sampled(lambda piece: low_pass(piece, times))])
        floors = np.zeros(columns.shape[1])
        floors[:segments] = floor * training.slope
        rough = np.pad(differences([segments] * plays), ((0, 0), (0, times.size)))
        return cls(rows, knots, times, columns, floors, rough, smoothing)

    def held_out_error(self) -> float:
        """Return the cross-validation RMS error [m] over quarters of the epochs, with free constants."""
        training = self.rows.training
        blocks = np.zeros(len(training), dtype=np.intp)
        for offset in training.offsets.T:
            stretch = np.flatnonzero(offset)
            blocks[stretch] = np.arange(stretch.size) * _QUARTERS // max(stretch.size, 1)
        squares, y, nuisances = 0.0, training.displacement, training.nuisances
        for block in range(_QUARTERS):
            kept, held_out = blocks != block, blocks == block
            own = self.columns[kept], nuisances[kept], y[kept]
            weights = fit_nonnegative(*own, self.floors, self.rough, self.smoothing).weights
            rest, offsets = y[held_out] - self.columns[held_out] @ weights, training.offsets[held_out]
            residual = rest - offsets @ np.linalg.lstsq(offsets, rest, rcond=None)[0]
            squares += float(residual @ residual)
        return float(np.sqrt(squares / len(training)))

    def fit(self) -> tuple[PlayBank, float]:
        weights, nuisances, residual = self.rows.fit(self.columns, self.floors, self.rough, self.smoothing)
        thresholds, offset = self.rows.thresholds, float(nuisances[self.rows.training.reference])
        slopes, shares = np.split(weights, [weights.size - self.times.size])
        bank = PlayBank(thresholds, self.knots, slopes.reshape(thresholds.size, -1), offset, self.times, shares)
        return bank, residual


def _default_times(training: Training) -> Array:
    shortest = 2 * max(piece.sample_time for piece in training.pieces)
    # A low-pass as slow as a record acts like a drift and shifts the axis.
    longest = max(max(float(np.ptp(piece.time)) for piece in training.pieces) / 3, shortest)
    return np.geomspace(shortest, longest, max(2, round(2 * np.log10(longest / shortest)) + 1))


def low_pass(piece: Record, times: Array) -> Array:
    """Return low-passes (n, K) of a voltage (n,) [V]: linear between samples, at rest at its first value before it."""
    v, alone = piece.voltage, np.ones(1)
    start = PlayState(float(v[0]), EMPTY, v[:1])
    banks = (PlayBank(EMPTY, (), (), 0.0, time, alone) for time in times[:, None])
    return np.column_stack([np.zeros((v.size, 0)), *(bank.simulate(v, start, piece.time)[0] for bank in banks)])


def with_unknown_start(training: Training, times: Array) -> Training:
    """Return a copy for a model with low-passes of time constants (K,) [s], which replace the drifts.

    Their outputs before the first sample are not known: therefore their decay in each piece is a nuisance column.
    """
    constants = training.offsets / np.linalg.norm(training.offsets, axis=0)

    def decays(piece: Record) -> Array:
        since = np.exp(-(piece.time[:, None] - piece.time[0]) / times)
        return np.hstack([since if other is piece else np.zeros_like(since) for other in training.pieces])

    found = training.sampled(decays)
    # Slow decays look like constants: keep only the part that is new, in an orthogonal basis.
    basis, sizes, _ = np.linalg.svd(found - constants @ (constants.T @ found), full_matrices=False)
    new = basis[:, sizes > _NEW * sizes.max(initial=0.0)] * np.sqrt(len(training))
    return replace(training, nuisances=np.hstack([training.offsets, new]))


@final
@dataclass(frozen=True, eq=False)
class KrasnoselskiiPokrovskii(AbstractPlayModel):
    """``y = offset + sum_p w_p k_p[v]``, p = (p1, p2) on a grid with p1 <= p2, all w_p >= 0.

    With r a ramp from 0 at 0 to 1 at the grid's spacing a, the kernel is
    ``k_p <- min(max(k_p, r(v - p2)), r(v - p1))``. Because clipping commutes with ramps, this is the ramp of a play
    with threshold (p2 - p1) / 2, ``r(z - (p1 + p2) / 2)``: kernels of one threshold are the segments of one curve, and
    the inverse is exact. Beyond the grid the kernels with p1 = p2 continue linearly, so that there is an inverse.
    """

    @property
    def parameters(self) -> int:
        """Number of coefficients: a weight for each kernel, and the offset."""
        levels = self.bank.thresholds.size
        return levels * (levels + 1) // 2 + 1

    @classmethod
    def fit(
        cls,
        records: Record | Sequence[Record],
        *,
        levels: int = 30,
        slope_floor: float = 0.05,
        smoothing: float = 1e-5,
        delay: float | None = None,
        drift: bool = True,
    ) -> KrasnoselskiiPokrovskii:
        """Fit the weights by nonnegative least squares.

        Parameters are those of every model, see `training`, and those below. `slope_floor` applies to the
        kernels with p1 = p2.

        `levels`: parts L into which the grid divides the voltage's range: L (L + 1) / 2 kernels. `smoothing`: weight of
        the squared differences of neighbouring weights; it determines the weights that the records leave open.
        """
        count(levels, "levels", most=60)
        fraction(slope_floor, "slope_floor")

        def fit_model(training: Training) -> tuple[KrasnoselskiiPokrovskii, float]:
            rows = PlayRows.from_training(training, training.thresholds(levels))
            low, high = training.limits
            # On each diagonal p2 - p1 = i a ramps begin at (p1 + p2) / 2.
            spacing = (high - low) / levels
            knots = [np.asarray(low + spacing * (np.arange(levels - i + 1) + 0.5 * i)) for i in range(levels)]
            # Every segment between knots is a kernel; the parts below the first and beyond the last knot are not.
            kernels = [[False, *[True] * (levels - i), False] for i in range(levels)]
            columns = rows.ramps(knots)[:, np.concatenate(kernels)]
            floors = np.zeros(columns.shape[1])
            floors[:levels] = slope_floor * training.slope
            rough = differences(range(levels, 0, -1), ((0, 1), (1, 0), (1, -1)))
            weights, nuisances, residual = rows.fit(columns, floors, rough, smoothing)
            first, *others = np.split(weights, np.cumsum(np.arange(levels, 1, -1)))
            slopes = [first[[0, *range(levels), -1]], *(np.pad(part, 1) for part in others)]
            bank = PlayBank(rows.thresholds, knots, slopes, float(nuisances[training.reference]))
            return cls._from_bank(bank, training), residual

        return fit_with_delay(records, delay, fit_model, drift=drift)


def differences(shape: Sequence[int], steps: Sequence[tuple[int, int]] = ((0, 1), (1, 0))) -> Array:
    """Return rows (m, p) of differences of neighbours in a table whose row i has shape[i] places, without row 0.

    `steps`: (rows, places) from a place to its neighbours.
    """
    first = np.cumsum([0, *shape])
    pairs = [
        (first[i] + j, first[i + di] + j + dj)
        for i in range(1, len(shape))
        for j in range(shape[i])
        for di, dj in steps
        if i + di < len(shape) and 0 <= j + dj < shape[i + di]
    ]
    rows = np.zeros((len(pairs), int(first[-1])))
    for row, (a, b) in zip(rows, pairs, strict=True):
        row[[a, b]] = 1.0, -1.0
    return rows
