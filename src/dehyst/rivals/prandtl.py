"""The classical Prandtl-Ishlinskii model: a weighted sum of plays of the voltage, with a closed-form inverse.

K. Kuhnen, H. Janocha, "Adaptive inverse control of piezoelectric actuators with hysteresis operators", European Control
Conference 1999; M. A. Krasnosel'skii, A. V. Pokrovskii, Systems with Hysteresis, Springer 1989.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from dehyst._native import Array, vector
from dehyst.model import AbstractModel, Motion
from dehyst.program import one_thread
from dehyst.record import Record
from dehyst.rivals.inverse import PlayInverse
from dehyst.rivals.least_squares import nonnegative
from dehyst.rivals.plays import PlayBank, PlayState
from dehyst.rivals.training import Training, count, share


@dataclass(frozen=True, eq=False)
class Prandtl(AbstractModel):
    """``y = offset + sum_i w_i play_i[v]``, all w_i >= 0: loops are symmetric about their centre.

    Attributes
    ----------
    bank : PlayBank
        Its operators; the first threshold is 0.
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
    inverse: PlayInverse = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "inverse", PlayInverse(self.bank))

    @property
    def weights(self) -> Array:
        """w_i (N,) [m/V]."""
        return self.inverse.weights

    @property
    def parameters(self) -> int:
        """Numbers that the fit chose."""
        return self.bank.parameters

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
        """Voltage (n,) [V] for a displacement (n,) [m], in closed form; arguments and errors as `simulate`."""
        y = vector(displacement, "displacement")
        v, after = self.inverse.compensate(y, self.state if state is None else state)
        return Motion(v, y, after)

    @classmethod
    @one_thread()
    def fit(
        cls, records: Record | Sequence[Record], *, plays: int = 20, slope_floor: float = 0.05,
        delay: float | None = None, drift: bool = True,
    ) -> Prandtl:  # fmt: skip
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
        share(slope_floor, "slope_floor")
        training = Training.of(records)
        thresholds = training.thresholds(plays)
        lag = training.lag(delay)
        rows = training.rows(thresholds, np.zeros(0), lag, drift)
        floors = np.zeros(plays)
        floors[0] = slope_floor * training.slope
        straight = [np.zeros(0)] * plays
        weights, _ = nonnegative(rows.ramps(straight), rows.nuisance, rows.displacement, floors)
        bank, state = training.placed(PlayBank(thresholds, straight, [weights[i : i + 1] for i in range(plays)]))
        return cls(bank, state, lag, training.sentences)
