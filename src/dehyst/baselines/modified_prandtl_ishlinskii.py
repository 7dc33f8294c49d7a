"""The modified Prandtl-Ishlinskii model: a sum of plays, then a sum of dead zones, each with a closed-form inverse.

K. Kuhnen, "Modeling, identification and compensation of complex hysteretic nonlinearities: a modified
Prandtl-Ishlinskii approach", European Journal of Control 9(4), 2003, 407-418.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import count, fraction, keep, vector
from dehyst.baselines.base import AbstractBaseline
from dehyst.baselines.play_bank import PlayBank, PlayInverse, PlayState
from dehyst.baselines.play_regressors import PlayRows, even_thresholds, fit_nonnegative, ramps
from dehyst.baselines.training import Training, fit_with_delay
from dehyst.model.elements import on_curve
from dehyst.records import Record
from dehyst.records.metrics import rms

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
                raise ModelError(f"{name}: got {values}, need two or more, strictly increasing")
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

    def _simulate(self, v: Array, state: PlayState, time: ArrayLike | None) -> tuple[Array, PlayState]:
        x, after = self.bank.simulate(v, state, time)
        return on_curve(self.places, self.values, x), after

    def _compensate(self, y: Array, state: PlayState, time: ArrayLike | None) -> tuple[Array, PlayState]:
        return self.inverse.compensate(on_curve(self.values, self.places, y), state)

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
