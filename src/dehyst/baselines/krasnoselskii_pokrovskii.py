"""The Krasnosel'skii-Pokrovskii model: Preisach's relays with ramps for jumps, on a grid of the Preisach plane.

H. T. Banks, A. J. Kurdila, G. Webb, "Identification of hysteretic control influence operators representing smart
actuators, part I", Math. Probl. Eng. 3, 1997, 287-328; W. S. Galinaitis, R. C. Rogers, "Control of a hysteretic
actuator using inverse hysteresis compensation", Proc. SPIE 3323, 1998, 267-277.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from dehyst._types import Array
from dehyst._validation import count, fraction
from dehyst.baselines.play_bank import AbstractPlayModel, PlayBank
from dehyst.baselines.play_regressors import PlayRows, differences, even_thresholds
from dehyst.baselines.training import Training, fit_with_delay
from dehyst.records import Record


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
