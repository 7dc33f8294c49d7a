"""No model of hysteresis at all: the ratio of the ends, as who has nothing else uses it.

y = y_0 + stroke (v - v_low) / (v_high - v_low)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._native import number, vector
from dehyst.model import AbstractModel, Motion, State
from dehyst.record import Record
from dehyst.rivals.fitting import Training, least_missing


@dataclass(frozen=True)
class Linear(AbstractModel):
    """A straight line; its state is its displacement, which it does not need.

    Parameters
    ----------
    slope : float
        [m/V], above 0.
    offset : float
        Displacement at 0 V [m].
    delay : float, optional
        Seconds by which the measured displacement lagged the voltage.

    Raises
    ------
    ModelError
        If the slope is not above 0.
    """

    slope: float
    offset: float = 0.0
    delay: float = 0.0

    def __post_init__(self) -> None:
        number(self.offset, "offset")
        if number(self.slope, "slope") <= 0:
            raise ModelError(f"slope: got {self.slope}, need metres a volt, above 0")

    @property
    def parameters(self) -> int:
        """Number of coefficients."""
        return 2

    def simulate(self, voltage: ArrayLike, *, state: State | None = None, time: ArrayLike | None = None) -> Motion:
        """Displacement (n,) [m] that a voltage (n,) [V] causes; neither `state` nor `time` matters."""
        v = vector(voltage, "voltage")
        y = self.offset + self.slope * v
        return Motion(v, y, State(float(y[-1]) if y.size else self.offset, []))

    def compensate(
        self, displacement: ArrayLike, *, state: State | None = None, time: ArrayLike | None = None
    ) -> Motion:
        """Voltage (n,) [V] for a displacement (n,) [m]; neither `state` nor `time` matters."""
        y = vector(displacement, "displacement")
        return Motion((y - self.offset) / self.slope, y, State(float(y[-1]) if y.size else self.offset, []))

    @classmethod
    def fit(cls, records: Record | Sequence[Record], *, delay: float | None = None) -> Linear:
        """Take the slope from the ends of the widest loop, the offset from least squares.

        Raises
        ------
        RecordError
            If a record cannot be used.
        IdentifyError
            If no sample counts, or the delay is impossible.
        """

        def solved(ready: Training) -> tuple[Linear, float]:
            low, high = ready.limits
            slope = ready.stroke / (high - low)
            rest = ready.displacement - slope * ready.played(lambda v: v)
            constants = np.linalg.lstsq(ready.nuisances, rest, rcond=None)[0]
            miss = float(np.sqrt(np.mean((rest - ready.nuisances @ constants) ** 2)))
            return cls(slope, float(constants[ready.reference]), ready.delay), miss

        return least_missing(records, delay, solved)
