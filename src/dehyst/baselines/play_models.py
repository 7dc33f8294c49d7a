"""Superpositions of plays: Prandtl-Ishlinskii, its modified and generalized forms, and Krasnosel'skii-Pokrovskii."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import IdentifyError, ModelError
from dehyst._types import Array
from dehyst._validation import count, fraction, keep, vector
from dehyst.baselines.base import AbstractBaseline, AbstractPlayModel, PlayBank, PlayInverse, PlayState
from dehyst.baselines.training import (
    PlayRows,
    Training,
    cross_validation_error,
    differences,
    even_thresholds,
    fit_nonnegative,
    fit_with_delay,
    ramps,
    with_unknown_start,
)
from dehyst.model.elements import on_curve
from dehyst.records import Record
from dehyst.records.signals import rms


@final
@dataclass(frozen=True, eq=False)
class PrandtlIshlinskii(AbstractPlayModel):
    """``y = offset + sum_i w_i play_i[v]``, all w_i >= 0: loops are symmetric about their centre."""

    inverse: PlayInverse = field(init=False, repr=False)

    def __post_init__(self) -> None:
        keep(self, inverse=PlayInverse(self.bank))

    @property
    def weights(self) -> Array:
        """w_i (N,) [m/V]."""
        return self.inverse.weights

    def _run(self, drive: Array, state: PlayState, time: ArrayLike | None, *, inverse: bool) -> tuple[Array, PlayState]:
        return self.inverse.compensate(drive, state) if inverse else self.bank.simulate(drive, state, time)

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
        """Fit the weights by nonnegative least squares.

        `records`, `delay`, `drift` and errors are those of every baseline, see `AbstractBaseline`.

        `plays`: number of plays; their thresholds divide half of the voltage's range into equal parts, from 0.
        `slope_floor`: least weight of threshold 0, as a fraction of the mean slope; 0 would have no inverse.
        """
        count(plays, "plays")
        fraction(slope_floor, "slope_floor")

        def fit_model(training: Training) -> tuple[PrandtlIshlinskii, float]:
            rows = PlayRows.from_training(training, even_thresholds(training, plays))
            floors = np.zeros(plays)
            floors[0] = slope_floor * training.slope
            weights, nuisances, residual = rows.fit(rows.ramps(), floors)
            offset = float(nuisances[training.reference])
            bank = PlayBank(rows.thresholds, [()] * plays, list(weights[:, None]), offset)
            return cls._from_bank(bank, training), residual

        return fit_with_delay(records, delay, fit_model, drift=drift)


_PASSES = 30
# A pass that makes the residual smaller by less than this part is the last one.
_SETTLED = 1e-4


@final
@dataclass(frozen=True, eq=False)
class ModifiedPrandtlIshlinskii(AbstractBaseline):
    """``y = S(x)``, ``x = offset + sum_i w_i play_i[v]``, all w_i >= 0; S is increasing and piecewise linear.

    S is Kuhnen's superposition of one-sided dead zones: its slope changes at each dead zone's threshold.

    Attributes
    ----------
    bank : PlayBank
        The plays, whose sum is in volts; the first threshold is 0.
    places, values : (M,) array
        Knots of S: [V] and [m], both strictly increasing; S continues linearly beyond.
    state : PlayState
        Default start: after a long descent to the lowest voltage of its records.
    remarks : tuple of str
        Repairs of the records, as sentences.

    Raises
    ------
    ModelError
        If S does not increase, or the plays have no closed-form inverse.
    """

    bank: PlayBank
    places: Array
    values: Array
    state: PlayState
    delay: float = 0.0
    remarks: tuple[str, ...] = ()
    inverse: PlayInverse = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name in ("places", "values"):
            values = vector(getattr(self, name), name)
            if values.size < 2 or np.any(np.diff(values) <= 0):
                raise ModelError(argument=name, got=values, need="two or more, strictly increasing")
            keep(self, **{name: values})
        if self.places.size != self.values.size:
            raise ModelError(f"values: got {self.values.size}, need one for each of {self.places.size} places")
        keep(self, inverse=PlayInverse(self.bank))

    @property
    def weights(self) -> Array:
        """w_i (N,)."""
        return self.inverse.weights

    @property
    def parameters(self) -> int:
        """Number of coefficients: weights, slopes and the offset; weights and slopes share one scale."""
        return self.weights.size + self.places.size - 1

    def _run(self, drive: Array, state: PlayState, time: ArrayLike | None, *, inverse: bool) -> tuple[Array, PlayState]:
        if inverse:
            return self.inverse.compensate(on_curve(self.values, self.places, drive), state)
        x, after = self.bank.simulate(drive, state, time)
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

        `records`, `delay`, `drift` and errors are those of every baseline, see `AbstractBaseline`.

        Parameters
        ----------
        plays : int, optional
            Number of plays; their thresholds divide half of the voltage's range into equal parts, from 0.
        segments : int, optional
            Number of segments of S, of equal length.
        slope_floor : float, optional
            Least weight of threshold 0 and least slope of S, as a fraction of the mean ones; 0 would have no inverse.
        """
        count(plays, "plays")
        count(segments, "segments")
        fraction(slope_floor, "slope_floor")

        def fit_model(training: Training) -> tuple[ModifiedPrandtlIshlinskii, float]:
            problem = _AlternatingFit(
                PlayRows.from_training(training, even_thresholds(training, plays)), segments, slope_floor
            )
            weights, values, residual = problem.solve()
            low, thresholds = training.limits[0], problem.thresholds
            bank = PlayBank(thresholds, [()] * plays, list(weights[:, None]), low - float(weights @ (low + thresholds)))
            return cls(
                bank, problem.places, values, bank.state_after_descent(low), training.delay, training.sentences
            ), residual

        return fit_with_delay(records, delay, fit_model, drift=drift)


class _AlternatingFit:
    """The fit of weights and slopes; x runs from the lowest to the highest voltage on the major loop."""

    def __init__(self, rows: PlayRows, segments: int, floor: float) -> None:
        training, thresholds = rows.training, rows.thresholds
        low, high = training.limits
        self.thresholds = thresholds
        self.spacing = (high - low) / segments
        self.places: Array = np.asarray(low + self.spacing * np.arange(segments + 1), dtype=np.float64)
        self._training, self._low, self._reach = training, low, high - low - 2 * thresholds
        self._z = (rows.plays - low - thresholds) * rows.known
        self._floors = np.full(thresholds.size + segments, floor * training.slope)
        self._floors[0], self._floors[1 : thresholds.size] = floor, 0.0
        # A play that stands still adds a constant to x: each epoch with such a play gets an unknown.
        still = (rows.plays - low - thresholds) * ~rows.known
        open_ = (training.offsets.T @ np.any(~rows.known, axis=1)) > 0
        self._stretches, self._still = training.offsets[:, open_], still

    def solve(self) -> tuple[Array, Array, float]:
        """Return the weights (N,), S at the places (M + 1,) [m], and the RMS residual [m]."""
        weights = fit_nonnegative(
            self._z, self._training.nuisances, self._training.displacement, self._scaled_floors()
        ).weights
        weights, slopes = self._normal(weights, np.ones(self.places.size - 1))
        shifts = self._first_shifts(weights)
        best = self._cost(weights, slopes, shifts)
        for _ in range(_PASSES):
            aim = self._gauss_newton_step(weights, slopes, shifts)
            for part in 0.5 ** np.arange(6):
                trial = [old + part * (new - old) for old, new in zip((weights, slopes, shifts), aim, strict=True)]
                cost = self._cost(*trial)
                if cost < best:
                    break
            else:
                break
            settled = cost > (1 - _SETTLED) * best
            (weights, slopes), shifts, best = self._normal(trial[0], trial[1]), trial[2] * self._gauge(trial[0]), cost
            if settled:
                break
        values = ramps(self.places, self.places[1:-1]) @ slopes
        return weights, values + self._residual(weights, slopes, shifts)[1][self._training.reference], best

    def _scaled_floors(self) -> Array:
        floors = np.zeros(self._z.shape[1])
        floors[0] = self._floors[0] * self._floors[-1]
        return floors

    def _first_shifts(self, weights: Array) -> Array:
        share_of = self._stretches / np.maximum(self._stretches.sum(axis=0), 1)
        return np.asarray(share_of.T @ (self._still @ weights))

    def _gauge(self, weights: Array) -> float:
        """Return the factor that scales x to the range of the voltage on the major loop."""
        return float(self._reach[0] / (weights @ self._reach))

    def _normal(self, weights: Array, slopes: Array) -> tuple[Array, Array]:
        gauge = self._gauge(weights)
        return weights * gauge, slopes / gauge

    def _map(self, weights: Array, slopes: Array, shifts: Array) -> tuple[Array, Array, Array]:
        """Return the columns (n, M) of the slopes, S (n,) and S' (n,)."""
        x = self._low + self._z @ weights + self._stretches @ shifts
        columns = ramps(x, self.places[1:-1])
        j = np.clip(((x - self._low) / self.spacing).astype(int), 0, slopes.size - 1)
        return columns, columns @ slopes, slopes[j]

    def _residual(self, weights: Array, slopes: Array, shifts: Array) -> tuple[Array, Array]:
        """Return the residual (n,) [m], and the coefficients of the nuisances."""
        rest = self._training.displacement - self._map(weights, slopes, shifts)[1]
        nuisances = np.asarray(np.linalg.lstsq(self._training.nuisances, rest, rcond=None)[0], dtype=np.float64)
        return rest - self._training.nuisances @ nuisances, nuisances

    def _cost(self, weights: Array, slopes: Array, shifts: Array) -> float:
        return rms(self._residual(weights, slopes, shifts)[0])

    def _gauss_newton_step(self, weights: Array, slopes: Array, shifts: Array) -> tuple[Array, Array, Array]:
        """Return the weights, slopes and shifts that are best for S linearised at the present ones."""
        columns, mapped, slope = self._map(weights, slopes, shifts)
        of_weights, of_shifts = self._z * slope[:, None], self._stretches * slope[:, None]
        target = self._training.displacement - mapped + of_weights @ weights + columns @ slopes + of_shifts @ shifts
        nuisance = np.concatenate([self._training.nuisances, of_shifts], axis=1)
        # In units of their mean, slopes are as large as weights.
        units = np.concatenate([np.ones(weights.size), np.full(slopes.size, slopes.mean())])
        both = np.concatenate([of_weights, columns], axis=1)
        solution = fit_nonnegative(both * units, nuisance, target, self._floors / units).weights * units
        rest = np.linalg.lstsq(nuisance, target - both @ solution, rcond=None)[0]
        return solution[: weights.size], solution[weights.size :], rest[self._training.nuisances.shape[1] :]


# Low-passes fitted to anything but creep do harm elsewhere: their cross-validation error must be this much smaller.
_WORTH = 0.8


@final
@dataclass(frozen=True, eq=False)
class GeneralizedPrandtlIshlinskii(AbstractPlayModel):
    """``y = offset + sum_i phi_i(play_i[v]) + sum_k c_k lowpass_k[v]``, phi_i increasing and piecewise linear.

    Its inverse is exact: it steps from one place where a slope changes to the next.
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

        `records`, `delay`, `drift`, which low-passes replace, and errors are those of every baseline, see
        `AbstractBaseline`.

        Parameters
        ----------
        plays : int, optional
            Number of plays; their thresholds divide half of the voltage's range into equal parts, from 0.
        segments : int, optional
            Segments of each curve, over the range of its play.
        lowpasses : (K,) array_like, optional
            Time constants [s]; an empty one leaves creep out. Default: two per decade from two samples to a third of
            the longest record if they lower the cross-validation error much, else none.
        slope_floor : float, optional
            Least slope just after a reversal, as a fraction of the mean slope; 0 would have no inverse.
        smoothing : float, optional
            Weight of the squared differences of neighbouring slopes; it determines those that the records leave open.
        """
        count(plays, "plays")
        count(segments, "segments")
        fraction(slope_floor, "slope_floor")
        given = None if lowpasses is None else _checked_times(lowpasses)

        def fit_model(training: Training) -> tuple[GeneralizedPrandtlIshlinskii, float]:
            choices = [_default_times(training), np.zeros(0)] if given is None else [given]
            designs = [
                _Design.from_training(training, plays, segments, times, slope_floor, smoothing) for times in choices
            ]
            if len(designs) > 1 and designs[0].held_out_error() > _WORTH * designs[1].held_out_error():
                del designs[0]
            bank, residual = designs[0].fit()
            return cls._from_bank(bank, training), residual

        return fit_with_delay(records, delay, fit_model, drift=drift)


@dataclass(frozen=True, eq=False)
class _Design:
    """Columns of slopes and low-passes, their floors and their smoothing."""

    rows: PlayRows
    knots: list[Array]
    times: Array
    columns: Array
    floors: Array
    rough: Array
    smoothing: float

    @classmethod
    def from_training(
        cls, training: Training, plays: int, segments: int, times: Array, floor: float, smoothing: float
    ) -> _Design:
        prepared = with_unknown_start(training, times) if times.size else training
        rows = PlayRows.from_training(prepared, even_thresholds(training, plays), times)
        low, high = training.limits
        knots = [np.linspace(low + r, high - r, segments + 1)[1:-1] for r in rows.thresholds]
        floors = np.zeros(plays * segments + times.size)
        floors[:segments] = floor * training.slope
        rough = np.pad(differences([segments] * plays), ((0, 0), (0, times.size)))
        return cls(rows, knots, times, rows.ramps(knots), floors, rough, smoothing)

    def held_out_error(self) -> float:
        return cross_validation_error(self.rows.training, self.columns, self.floors, self.rough, self.smoothing)

    def fit(self) -> tuple[PlayBank, float]:
        weights, nuisances, residual = self.rows.fit(self.columns, self.floors, self.rough, self.smoothing)
        thresholds, offset = self.rows.thresholds, float(nuisances[self.rows.training.reference])
        count = self.columns.shape[1] - self.times.size
        slopes = weights[:count].reshape(thresholds.size, -1)
        return PlayBank(thresholds, self.knots, list(slopes), offset, self.times, weights[count:]), residual


def _default_times(training: Training) -> Array:
    shortest = 2 * max(piece.sample_time for piece in training.pieces)
    # A low-pass as slow as a record acts as a drift and shifts the axis.
    longest = max(max(float(np.ptp(piece.time)) for piece in training.pieces) / 3, shortest)
    return np.geomspace(shortest, longest, max(2, round(2 * np.log10(longest / shortest)) + 1))


def _checked_times(lowpasses: ArrayLike) -> Array:
    times = vector(lowpasses, "lowpasses", error=IdentifyError)
    if np.any(times <= 0):
        raise IdentifyError(f"lowpasses: got {times}, need time constants above 0, in seconds")
    return times


@final
@dataclass(frozen=True, eq=False)
class KrasnoselskiiPokrovskii(AbstractPlayModel):
    """``y = offset + sum_p w_p k_p[v]``, p = (p1, p2) on a grid with p1 <= p2, all w_p >= 0.

    With r a ramp from 0 at 0 to 1 at the grid's spacing a, the kernel is
    ``k_p <- min(max(k_p, r(v - p2)), r(v - p1))``. For clips commute with ramps, this is the ramp of a play of
    threshold (p2 - p1) / 2, ``r(z - (p1 + p2) / 2)``: kernels of one threshold are the segments of one curve, and the
    inverse is exact. Beyond the grid the kernels with p1 = p2 continue linearly, so that there is an inverse.
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

        `records`, `delay`, `drift` and errors are those of every baseline, see `AbstractBaseline`.

        Parameters
        ----------
        levels : int, optional
            Parts L into which the grid divides the voltage's range: L (L + 1) / 2 kernels.
        slope_floor : float, optional
            Least slope of the kernels with p1 = p2, as a fraction of the mean slope; 0 would have no inverse.
        smoothing : float, optional
            Weight of the squared differences of neighbouring weights; it determines those that the records leave open.
        """
        count(levels, "levels", most=60)
        fraction(slope_floor, "slope_floor")

        def fit_model(training: Training) -> tuple[KrasnoselskiiPokrovskii, float]:
            rows = PlayRows.from_training(training, even_thresholds(training, levels))
            knots = _knots(*training.limits, levels)
            # Every segment between knots is a kernel; the parts below the first and beyond the last are not.
            kernels = [[False, *[True] * (levels - i), False] for i in range(levels)]
            columns = rows.ramps(knots)[:, np.concatenate(kernels)]
            floors = np.zeros(columns.shape[1])
            floors[:levels] = slope_floor * training.slope
            rough = differences(range(levels, 0, -1), beside=((0, 1), (1, 0), (1, -1)))
            weights, nuisances, residual = rows.fit(columns, floors, rough, smoothing)
            parts = np.split(weights, np.cumsum(np.arange(levels, 1, -1)))
            slopes = [parts[0][[0, *range(levels), -1]], *(np.pad(part, 1) for part in parts[1:])]
            bank = PlayBank(rows.thresholds, knots, slopes, float(nuisances[training.reference]))
            return cls._from_bank(bank, training), residual

        return fit_with_delay(records, delay, fit_model, drift=drift)


def _knots(low: float, high: float, levels: int) -> list[Array]:
    """Return the knots of each diagonal p2 - p1 = i a: ramps begin at (p1 + p2) / 2."""
    spacing = (high - low) / levels
    return [np.asarray(low + spacing * (np.arange(levels - i + 1) + 0.5 * i)) for i in range(levels)]
