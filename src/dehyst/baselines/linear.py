"""No model of hysteresis: the ratio of the end points, the usual feedforward without a model.

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
from dehyst._validation import keep, number
from dehyst.baselines.base import AbstractBaseline
from dehyst.baselines.training import Training, fit_with_delay
from dehyst.model import State
from dehyst.records import Record
from dehyst.records.signals import rms


@final
@dataclass(frozen=True)
class Linear(AbstractBaseline):
    """A straight line; its state is its displacement, which has no effect.

    `slope` [m/V], above 0. `offset`: displacement at 0 V [m]. Raise `ModelError` if the slope is not above 0.
    """

    slope: float
    offset: float = 0.0
    delay: float = 0.0
    state: State = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        number(self.offset, "offset")
        if number(self.slope, "slope") <= 0:
            raise ModelError(f"slope: got {self.slope}, need metres a volt, above 0")
        keep(self, state=State(self.offset, []))

    @property
    def parameters(self) -> int:
        """Number of coefficients."""
        return 2

    def _simulate(self, v: Array, state: State, time: ArrayLike | None) -> tuple[Array, State]:
        y = self.offset + self.slope * v
        return y, self._after(y)

    def _compensate(self, y: Array, state: State, time: ArrayLike | None) -> tuple[Array, State]:
        return (y - self.offset) / self.slope, self._after(y)

    def _after(self, y: Array) -> State:
        return State(float(y[-1]) if y.size else self.offset, [])

    @classmethod
    def fit(cls, records: Record | Sequence[Record], *, delay: float | None = None) -> Linear:
        """Take the slope from the end points of the widest loop, and fit the offset by least squares.

        `records`, `delay` and errors are those of every baseline, see `AbstractBaseline`.
        """

        def fit_model(training: Training) -> tuple[Linear, float]:
            low, high = training.limits
            slope = training.stroke / (high - low)
            rest = training.displacement - slope * training.map_voltages(lambda v: v)
            constants = np.linalg.lstsq(training.nuisances, rest, rcond=None)[0]
            residual = rms(rest - training.nuisances @ constants)
            return cls(slope, float(constants[training.reference]), training.delay), residual

        return fit_with_delay(records, delay, fit_model)
