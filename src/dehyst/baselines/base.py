"""What every rival shares: both directions, checked, from the state that it is given or its own."""

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

    Attributes
    ----------
    state : Any
        Where a motion starts if it is not told.
    delay : float
        Seconds by which the measured displacement lagged the voltage; `simulate` and `compensate` leave it to the
        caller.
    """

    state: Any
    delay: float

    def simulate(self, voltage: ArrayLike, *, state: Any = None, time: ArrayLike | None = None) -> Motion:
        """Displacement (n,) [m] that a voltage (n,) [V] causes.

        Parameters
        ----------
        voltage : (n,) array_like
            [V].
        state : optional
            Before the first sample, as a motion of this model left it; by default the model's own.
        time : (n,) array_like, optional
            [s], increasing; models without creep do not look at it.

        Raises
        ------
        ModelError
            If the voltage is no path of finite numbers, the state is none of this model, or a model with creep is not
            told an increasing time, or a displacement is too large to be computed.
        """
        v = vector(voltage, "voltage")
        y, after = self._displaced(v, self.state if state is None else state, time)
        demand_result(y, "displacement")
        return Motion(v, y, after)

    def compensate(self, displacement: ArrayLike, *, state: Any = None, time: ArrayLike | None = None) -> Motion:
        """Voltage (n,) [V] for a displacement (n,) [m]; arguments as `simulate`.

        Raises
        ------
        ModelError
            As `simulate`, and if no voltage reaches a displacement.
        """
        y = vector(displacement, "displacement")
        v, after = self._driven(y, self.state if state is None else state, time)
        demand_result(v, "voltage")
        return Motion(v, y, after)

    @abstractmethod
    def _displaced(self, v: Array, state: Any, time: ArrayLike | None) -> tuple[Array, Any]:
        """Displacement (n,) [m] that a voltage (n,) [V] causes, and the state after it."""

    @abstractmethod
    def _driven(self, y: Array, state: Any, time: ArrayLike | None) -> tuple[Array, Any]:
        """Voltage (n,) [V] for a displacement (n,) [m], and the state after it."""
