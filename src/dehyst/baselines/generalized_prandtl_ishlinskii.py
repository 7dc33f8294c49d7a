"""The generalised Prandtl-Ishlinskii model: plays of the voltage, each seen through a curve of its own, and low-passes.

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
from dehyst.baselines.fitting import least_missing
from dehyst.baselines.nonnegative_fit import differences
from dehyst.baselines.play_bank import PlayBank
from dehyst.baselines.play_model import AbstractPlayModel
from dehyst.baselines.play_regressors import PlayRows, even_thresholds, from_anywhere, left_out
from dehyst.baselines.training import Training
from dehyst.records import Record

# Low-passes fitted to what is no creep do harm elsewhere: they have to predict what was left out this much better.
_WORTH = 0.8


@final
@dataclass(frozen=True, eq=False)
class GeneralizedPrandtlIshlinskii(AbstractPlayModel):
    """``y = offset + sum_i phi_i(play_i[v]) + sum_k c_k lowpass_k[v]``, phi_i increasing and piecewise linear.

    Its inverse is walked exactly from one place where a slope changes to the next.
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

        Parameters
        ----------
        records : Record or sequence of Record
            Loops; none needs to start relaxed. Each has an offset of its own.
        plays : int, optional
            Their thresholds cut half of the voltage's range in equal parts, from 0.
        segments : int, optional
            Of each curve, over what its play can reach.
        lowpasses : (K,) array_like, optional
            Time constants [s]; an empty one leaves creep out. By default two a decade from two samples to a third of
            the longest record, or none unless quarters of the records left out of the fit are predicted much better so.
        slope_floor : float, optional
            Least slope just after a reversal, as a fraction of the mean one, without which there is no inverse.
        smoothing : float, optional
            Weight of the squared differences of neighbouring slopes, for those of which the records say nothing.
        delay : float, optional
            Seconds by which the displacement lags the voltage; by default looked for.
        drift : bool, optional
            Whether a record may creep by a logarithm of the time since its start, which is then set aside; low-passes
            stand for it where there are any.

        Raises
        ------
        RecordError, IdentifyError
            If a record cannot be used, or an option is impossible.
        """
        count(plays, "plays")
        count(segments, "segments")
        fraction(slope_floor, "slope_floor")
        given = None if lowpasses is None else _given(lowpasses)

        def solved(ready: Training) -> tuple[GeneralizedPrandtlIshlinskii, float]:
            choices = [_times(ready), np.zeros(0)] if given is None else [given]
            designs = [_Design.of(ready, plays, segments, times, slope_floor, smoothing) for times in choices]
            if len(designs) > 1 and designs[0].missed() > _WORTH * designs[1].missed():
                del designs[0]
            bank, miss = designs[0].fitted()
            return cls._of(bank, ready), miss

        return least_missing(records, delay, solved, drift=drift)


@dataclass(frozen=True, eq=False)
class _Design:
    """Columns of slopes and low-passes, floors below them, and how they hang together."""

    rows: PlayRows
    knots: list[Array]
    times: Array
    columns: Array
    floors: Array
    rough: Array
    smoothing: float

    @classmethod
    def of(cls, ready: Training, plays: int, segments: int, times: Array, floor: float, smoothing: float) -> _Design:
        rows = PlayRows.of(from_anywhere(ready, times) if times.size else ready, even_thresholds(ready, plays), times)
        low, high = ready.limits
        knots = [np.linspace(low + r, high - r, segments + 1)[1:-1] for r in rows.thresholds]
        floors = np.zeros(plays * segments + times.size)
        floors[:segments] = floor * ready.slope
        rough = np.pad(differences([segments] * plays), ((0, 0), (0, times.size)))
        return cls(rows, knots, times, rows.ramps(knots), floors, rough, smoothing)

    def missed(self) -> float:
        return left_out(self.rows.training, self.columns, self.floors, self.rough, self.smoothing)

    def fitted(self) -> tuple[PlayBank, float]:
        weights, free, miss = self.rows.solved(self.columns, self.floors, self.rough, self.smoothing)
        thresholds, offset = self.rows.thresholds, float(free[self.rows.training.reference])
        count = self.columns.shape[1] - self.times.size
        slopes = weights[:count].reshape(thresholds.size, -1)
        return PlayBank(thresholds, self.knots, list(slopes), offset, self.times, weights[count:]), miss


def _times(ready: Training) -> Array:
    shortest = 2 * max(piece.sample_time for piece in ready.pieces)
    # A low-pass as slow as a record is a drift to it, and shifts the axis.
    longest = max(max(float(np.ptp(piece.time)) for piece in ready.pieces) / 3, shortest)
    return np.geomspace(shortest, longest, max(2, round(2 * np.log10(longest / shortest)) + 1))


def _given(lowpasses: ArrayLike) -> Array:
    times = vector(lowpasses, "lowpasses", error=IdentifyError)
    if np.any(times <= 0):
        raise IdentifyError(f"lowpasses: got {times}, need time constants above 0, in seconds")
    return times
