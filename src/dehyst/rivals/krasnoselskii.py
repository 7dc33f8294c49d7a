"""The Krasnosel'skii-Pokrovskii model: Preisach's relays with ramps for jumps, on a grid of the Preisach plane.

H. T. Banks, A. J. Kurdila, G. Webb, "Identification of hysteretic control influence operators representing smart
actuators, part I", Math. Probl. Eng. 3, 1997, 287-328; W. S. Galinaitis, R. C. Rogers, "Control of a hysteretic
actuator using inverse hysteresis compensation", Proc. SPIE 3323, 1998, 267-277.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dehyst._native import Array, vector
from dehyst.model import AbstractModel, Motion
from dehyst.program import one_thread
from dehyst.record import Record
from dehyst.rivals.least_squares import differences, nonnegative
from dehyst.rivals.plays import PlayBank, PlayState
from dehyst.rivals.training import Training, count, share


@dataclass(frozen=True, eq=False)
class Krasnoselskii(AbstractModel):
    """``y = offset + sum_p w_p k_p[v]``, p = (p1, p2) on a grid with p1 <= p2, all w_p >= 0.

    With r a ramp from 0 at 0 to 1 at the grid's spacing a, the kernel is
    ``k_p <- min(max(k_p, r(v - p2)), r(v - p1))``. For clips commute with ramps, this is the ramp of a play of
    threshold (p2 - p1) / 2, ``r(z - (p1 + p2) / 2)``: kernels of one threshold are the segments of one curve, and the
    inverse is walked exactly. Beyond the grid the kernels with p1 = p2 go on linearly, so that there is an inverse.

    Attributes
    ----------
    bank : PlayBank
        One play for each diagonal of the grid.
    state : PlayState
        Where it starts: by default after a long descent to the lowest voltage of its records.
    delay : float
        Seconds by which the displacement lags the voltage; `simulate` and `compensate` leave it to the caller.
    remarks : tuple of str
        Sentences: what was repaired in the records.
    """

    bank: PlayBank
    state: PlayState
    delay: float = 0.0
    remarks: tuple[str, ...] = ()

    @property
    def parameters(self) -> int:
        """Numbers that the fit chose: a weight for each kernel, and the offset."""
        levels = self.bank.thresholds.size
        return levels * (levels + 1) // 2 + 1

    def simulate(self, voltage: ArrayLike, *, state: PlayState | None = None, time: ArrayLike | None = None) -> Motion:
        """Displacement (n,) [m] that a voltage (n,) [V] causes; `time` is not looked at.

        Raises
        ------
        ModelError
            If a value is not finite or the state is not this model's.
        """
        v = vector(voltage, "voltage")
        y, after = self.bank.simulate(v, self.state if state is None else state, time)
        return Motion(v, y, after)

    def compensate(
        self, displacement: ArrayLike, *, state: PlayState | None = None, time: ArrayLike | None = None
    ) -> Motion:
        """Voltage (n,) [V] for a displacement (n,) [m]; arguments and errors as `simulate`."""
        y = vector(displacement, "displacement")
        v, after = self.bank.compensate(y, self.state if state is None else state, time)
        return Motion(v, y, after)

    @classmethod
    @one_thread()
    def fit(
        cls, records: Record | Sequence[Record], *, levels: int = 30, slope_floor: float = 0.05,
        smoothing: float = 1e-5, delay: float | None = None, drift: bool = True,
    ) -> Krasnoselskii:  # fmt: skip
        """Fit the weights by nonnegative least squares.

        Parameters
        ----------
        records : Record or sequence of Record
            Loops; none needs to start relaxed. Each has an offset of its own.
        levels : int, optional
            Parts L in which the grid cuts the voltage's range: L (L + 1) / 2 kernels.
        slope_floor : float, optional
            Least slope of the kernels with p1 = p2, as a fraction of the mean slope, without which there is no inverse.
        smoothing : float, optional
            Weight of the squared differences of neighbouring weights, for kernels of which the records say nothing.
        delay : float, optional
            Seconds by which the displacement lags the voltage; by default looked for.
        drift : bool, optional
            Whether a record may creep by a logarithm of the time since its start, which is then set aside.

        Raises
        ------
        RecordError, IdentifyError
            If a record cannot be used, or an option is impossible.
        """
        count(levels, "levels", 60)
        share(slope_floor, "slope_floor")
        training = Training.of(records)
        thresholds = training.thresholds(levels)
        knots = _knots(training.low, training.high, levels)
        lag = training.lag(delay)
        rows = training.rows(thresholds, np.zeros(0), lag, drift)
        # Every segment between knots is a kernel; what lies below the first and beyond the last is none.
        columns = rows.ramps(knots)[:, _kernels(levels)]
        floors = np.zeros(columns.shape[1])
        floors[:levels] = slope_floor * training.slope
        rough = differences(range(levels, 0, -1), beside=((0, 1), (1, 0), (1, -1)))
        weights, _ = nonnegative(columns, rows.nuisance, rows.displacement, floors, rough, smoothing)
        parts = np.split(weights, np.cumsum(np.arange(levels, 1, -1)))
        slopes = [parts[0][[0, *range(levels), -1]], *(np.pad(part, 1) for part in parts[1:])]
        bank, state = training.placed(PlayBank(thresholds, knots, slopes))
        return cls(bank, state, lag, training.sentences)


def _knots(low: float, high: float, levels: int) -> list[Array]:
    """Of each diagonal p2 - p1 = i a: ramps begin at (p1 + p2) / 2."""
    spacing = (high - low) / levels
    return [np.asarray(low + spacing * (np.arange(levels - i + 1) + 0.5 * i)) for i in range(levels)]


def _kernels(levels: int) -> Array:
    """Which of the columns of `Rows.ramps` are kernels, (p,) bool."""
    return np.concatenate([[False, *[True] * (levels - i), False] for i in range(levels)])
