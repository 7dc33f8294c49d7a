"""A model of others behind the interface of an actuator: simulation and inverse from one method."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

from numpy.typing import ArrayLike

from dehyst._errors import IdentifyError, ModelError
from dehyst._types import Array
from dehyst._validation import demand_result, vector
from dehyst.identification import Prepared, as_list, prepare
from dehyst.model import AbstractModel, Motion
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
