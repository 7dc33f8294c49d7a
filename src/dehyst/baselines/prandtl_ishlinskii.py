"""The classical Prandtl-Ishlinskii model: a weighted sum of plays of the voltage, with a closed-form inverse.

K. Kuhnen, H. Janocha, "Adaptive inverse control of piezoelectric actuators with hysteresis operators", European Control
Conference 1999; M. A. Krasnosel'skii, A. V. Pokrovskii, Systems with Hysteresis, Springer 1989.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from dehyst._types import Array
from dehyst._validation import count, fraction
from dehyst.baselines.fitting import least_missing
from dehyst.baselines.play_bank import PlayBank, PlayState
from dehyst.baselines.play_inverse import PlayInverse
from dehyst.baselines.play_model import AbstractPlayModel
from dehyst.baselines.play_regressors import PlayRows, even_thresholds
from dehyst.baselines.training import Training
from dehyst.records import Record


@final
@dataclass(frozen=True, eq=False)
class PrandtlIshlinskii(AbstractPlayModel):
    """``y = offset + sum_i w_i play_i[v]``, all w_i >= 0: loops are symmetric about their centre."""

    inverse: PlayInverse = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "inverse", PlayInverse(self.bank))

    @property
    def weights(self) -> Array:
        """w_i (N,) [m/V]."""
        return self.inverse.weights

    def _driven(self, y: Array, state: PlayState, time: ArrayLike | None) -> tuple[Array, PlayState]:
        return self.inverse.compensate(y, state)

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

        Parameters
        ----------
        records : Record or sequence of Record
            Loops; none needs to start relaxed. Each has an offset of its own.
        plays : int, optional
            Their thresholds cut half of the voltage's range in equal parts, from 0.
        slope_floor : float, optional
            Least weight of threshold 0, as a fraction of the mean slope, without which there is no inverse.
        delay : float, optional
            Seconds by which the displacement lags the voltage; by default looked for.
        drift : bool, optional
            Whether a record may creep by a logarithm of the time since its start, which is then set aside.

        Raises
        ------
        RecordError, IdentifyError
            If a record cannot be used, or an option is impossible.
        """
        count(plays, "plays")
        fraction(slope_floor, "slope_floor")

        def solved(ready: Training) -> tuple[PrandtlIshlinskii, float]:
            rows = PlayRows.of(ready, even_thresholds(ready, plays))
            floors = np.zeros(plays)
            floors[0] = slope_floor * ready.slope
            weights, free, miss = rows.solved(rows.ramps(), floors)
            bank = PlayBank(rows.thresholds, [()] * plays, list(weights[:, None]), float(free[ready.reference]))
            return cls._of(bank, ready), miss

        return least_missing(records, delay, solved, drift=drift)
