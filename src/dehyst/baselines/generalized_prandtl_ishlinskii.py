"""The generalised Prandtl-Ishlinskii model: plays of the voltage, each followed by its own curve, and low-passes.

M. Al Janaideh, S. Rakheja, C.-Y. Su, "An analytical generalized Prandtl-Ishlinskii model inversion for hysteresis
compensation in micropositioning control", IEEE/ASME Trans. Mechatronics 16(4), 2011, 734-744 (envelope functions); here
each play has an envelope, piecewise linear and fitted, and first-order low-passes stand for creep as in H. Jung,
D.-G. Gweon, "Creep characteristics of piezoelectric actuators", Rev. Sci. Instrum. 71(4), 2000, 1896-1900.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import IdentifyError
from dehyst._types import Array
from dehyst._validation import count, fraction, vector
from dehyst.baselines.play_bank import AbstractPlayModel, PlayBank
from dehyst.baselines.play_regressors import (
    PlayRows,
    cross_validation_error,
    differences,
    even_thresholds,
    with_unknown_start,
)
from dehyst.baselines.training import Training, fit_with_delay
from dehyst.records import Record

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
