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
from dehyst._validation import count, fraction, keep
from dehyst.baselines.play_bank import AbstractPlayModel, PlayBank, PlayInverse, PlayState
from dehyst.baselines.play_regressors import PlayRows, even_thresholds
from dehyst.baselines.training import Training, fit_with_delay
from dehyst.records import Record


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

    def _compensate(self, y: Array, state: PlayState, time: ArrayLike | None) -> tuple[Array, PlayState]:
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
