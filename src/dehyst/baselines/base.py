"""The base class of every baseline: both directions, with checked input, from a given state or its own."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

from numpy.typing import ArrayLike

from dehyst._computable import demand_result
from dehyst._types import Array
from dehyst._validation import vector
from dehyst.model import AbstractModel, Motion


class AbstractBaseline(AbstractModel):
    """A model that others published, behind the common interface.

    Its `fit` takes `records`, a Record or a sequence of them: loops, each with an offset of its own; none needs to
    start relaxed. `delay` [s] is that by which the displacement lags the voltage; default: estimated. With `drift` a
    record may creep by a logarithm of the time since its start; the drift is then removed. It raises `RecordError` if a
    record cannot be used, and `IdentifyError` if no sample counts or an option is impossible.

    `state`: default start of a motion. `delay`: seconds by which the measured displacement lagged the voltage;
    `simulate` and `compensate` do not apply it.
    """

    state: Any
    delay: float

    def simulate(self, voltage: ArrayLike, *, state: Any = None, time: ArrayLike | None = None) -> Motion:
        """Return the displacement (n,) [m] that a voltage (n,) [V] causes.

        Raise `ModelError` if the voltage is not a path of finite numbers, the state is not one of this model, a model
        with creep gets no increasing time, or a displacement is too large to be computed.

        `voltage` (n,) [V]. `state`: state before the first sample, as a motion of this model returned it; default: the
        model's own. `time` (n,) [s], increasing; models without creep ignore it.
        """
        v = vector(voltage, "voltage")
        y, after = self._simulate(v, self.state if state is None else state, time)
        demand_result(y, "displacement")
        return Motion(v, y, after)

    def compensate(self, displacement: ArrayLike, *, state: Any = None, time: ArrayLike | None = None) -> Motion:
        """Return the voltage (n,) [V] for a displacement (n,) [m]; arguments as `simulate`.

        Raise `ModelError` as `simulate`, and if no voltage reaches a displacement.
        """
        y = vector(displacement, "displacement")
        v, after = self._compensate(y, self.state if state is None else state, time)
        demand_result(v, "voltage")
        return Motion(v, y, after)

    @abstractmethod
    def _simulate(self, v: Array, state: Any, time: ArrayLike | None) -> tuple[Array, Any]:
        """Return the displacement (n,) [m] that a voltage (n,) [V] causes, and the state after it."""

    @abstractmethod
    def _compensate(self, y: Array, state: Any, time: ArrayLike | None) -> tuple[Array, Any]:
        """Return the voltage (n,) [V] for a displacement (n,) [m], and the state after it."""
