"""A straight line through the end points: the usual feedforward without a model of hysteresis.

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
from dehyst.baselines.base import AbstractBaseline, widest_record
from dehyst.model import State
from dehyst.records import Record


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
    parameters = 2

    def __post_init__(self) -> None:
        number(self.offset, "offset")
        if number(self.slope, "slope") <= 0:
            raise ModelError(f"slope: got {self.slope}, need metres a volt, above 0")
        keep(self, state=State(self.offset, []))

    def _run(self, drive: Array, state: State, time: ArrayLike | None, *, inverse: bool) -> tuple[Array, State]:
        y = drive if inverse else self.offset + self.slope * drive
        after = State(float(y[-1]) if y.size else self.offset, [])
        return (y - self.offset) / self.slope if inverse else y, after

    @classmethod
    def fit(cls, records: Record | Sequence[Record]) -> Linear:
        """Take the slope from the end points of the widest record, and the offset from its mean.

        Raise `RecordError` if a record cannot be used, and `IdentifyError` if there is none.
        """
        record = widest_record(records)
        slope = float(np.ptp(record.displacement) / np.ptp(record.voltage))
        return cls(slope, float((record.displacement - slope * record.voltage).mean()))
