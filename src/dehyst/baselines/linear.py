"""No model of hysteresis at all: the ratio of the ends, as who has nothing else uses it.

y = y_0 + stroke (v - v_low) / (v_high - v_low)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import number
from dehyst.baselines.base import AbstractBaseline
from dehyst.baselines.fitting import least_missing
from dehyst.baselines.training import Training
from dehyst.model import State
from dehyst.records import Record
from dehyst.records.metrics import rms


@final
@dataclass(frozen=True)
class Linear(AbstractBaseline):
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
    state: State = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        number(self.offset, "offset")
        if number(self.slope, "slope") <= 0:
            raise ModelError(f"slope: got {self.slope}, need metres a volt, above 0")
        object.__setattr__(self, "state", State(self.offset, []))

    @property
    def parameters(self) -> int:
        """Number of coefficients."""
        return 2

    def _displaced(self, v: Array, state: State, time: ArrayLike | None) -> tuple[Array, State]:
        y = self.offset + self.slope * v
        return y, self._after(y)

    def _driven(self, y: Array, state: State, time: ArrayLike | None) -> tuple[Array, State]:
        return (y - self.offset) / self.slope, self._after(y)

    def _after(self, y: Array) -> State:
        return State(float(y[-1]) if y.size else self.offset, [])

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
            miss = rms(rest - ready.nuisances @ constants)
            return cls(slope, float(constants[ready.reference]), ready.delay), miss

        return least_missing(records, delay, solved)
