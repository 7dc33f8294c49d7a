"""Models of others behind the interface of an actuator, and a straight line, the usual feedforward without a model.

y = y_0 + stroke (v - v_low) / (v_high - v_low)
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import IdentifyError, ModelError
from dehyst._types import Array
from dehyst._validation import demand_result, keep, number, vector
from dehyst.identification import Prepared, as_list, prepare
from dehyst.model import AbstractModel, Motion, State
from dehyst.records import Record


class AbstractBaseline(AbstractModel):
    """A model of others behind the interface of an actuator; `dehyst compare` has one row for each.

    Attributes: `state` is the default start of a motion. `delay` [s] is the lag of the measured displacement behind the
    voltage; `simulate` and `compensate` do not apply it.
    """

    state: Any
    delay: float

    def simulate(self, voltage: ArrayLike, *, state: Any = None, time: ArrayLike | None = None) -> Motion:
        """Return the displacement (n,) [m] that a voltage (n,) [V] causes.

        Raise `ModelError` if the voltage is not a path of finite numbers, the state belongs to another model, a model
        with creep gets no increasing time, or a displacement is too large to be computed.

        `voltage` (n,) [V]. `state`: state before the first sample, from a motion of this model; default: the model's
        own. `time` (n,) [s], increasing; models without creep ignore it.
        """
        v = vector(voltage, "voltage")
        y, after = self._run(v, self._start(state), time, inverse=False)
        demand_result(y, "displacement")
        return Motion(v, y, after)

    def compensate(self, displacement: ArrayLike, *, state: Any = None, time: ArrayLike | None = None) -> Motion:
        """Return the voltage (n,) [V] for a displacement (n,) [m]; arguments as `simulate`.

        Raise `ModelError` as `simulate`, and if no voltage reaches a displacement.
        """
        y = vector(displacement, "displacement")
        v, after = self._run(y, self._start(state), time, inverse=True)
        demand_result(v, "voltage")
        return Motion(v, y, after)

    def _start(self, state: Any) -> Any:
        start = self.state if state is None else state
        if not isinstance(start, type(self.state)):
            kind = type(self.state).__name__
            raise ModelError(f"state: got {type(start).__name__}, need a {kind} that a motion of this model returned")
        return start

    @abstractmethod
    def _run(self, drive: Array, state: Any, time: ArrayLike | None, *, inverse: bool) -> tuple[Array, Any]:
        """Return displacements (n,) [m] for voltages (n,) [V], inverse: voltages for displacements; and the state."""


def widest_record(records: Record | Sequence[Record]) -> Record:
    """Return the record with the widest loops, without what cannot be used.

    Raise `RecordError` if a record cannot be used, and `IdentifyError` if there is none.
    """
    items = [prepare(record) for record in as_list(records)]
    if not items:
        raise IdentifyError("got no records, need at least one loop of voltage and displacement")

    def width(item: Prepared) -> float:
        low, high = item.span()
        return high - low

    return max(items, key=width).record


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
