"""A watch on the sensor during a record: whether the displacement still follows the voltage."""

from __future__ import annotations

import numpy as np

from dehyst._errors import SensorError
from dehyst._types import Array

# A reading that is constant to the last digit while the voltage crosses this share of its range is not a piezo's.
_DEAD = 0.2


class SensorWatch:
    """A check of samples as they arrive: it raises when the reading is constant while the voltage moves.

    `span`: range of the voltage [V]. `name`: of the sensor, in messages.
    """

    def __init__(self, span: float, name: str = "the sensor") -> None:
        self._enough, self._name = _DEAD * span, name
        self._value: float | None = None
        self._low = self._high = 0.0
        self._moved = False

    def observe(self, voltage: Array, displacement: Array) -> None:
        """Check samples (n,) [V], (n,) [m] that follow the ones before.

        Raise `SensorError` if the reading has not changed while the voltage crossed a fifth of its range; the message
        depends on whether it moved before.
        """
        if not displacement.size:
            return
        starts = np.flatnonzero(np.concatenate([[displacement[0] != self._value], np.diff(displacement) != 0]))
        for first, stop in zip([0, *starts], [*starts, displacement.size], strict=True):
            if first == stop:
                continue
            self._extend(float(displacement[first]), voltage[first:stop])

    def _extend(self, value: float, voltage: Array) -> None:
        low, high = float(voltage.min()), float(voltage.max())
        if value == self._value:
            low, high = min(low, self._low), max(high, self._high)
        else:
            self._moved = self._moved or self._value is not None
        self._value, self._low, self._high = value, low, high
        if high - low > self._enough:
            self._refuse()

    def _refuse(self) -> None:
        what = f"stays at {1e6 * (self._value or 0.0):.6g} um while the voltage goes from {self._low:.6g} to "
        what += f"{self._high:.6g} V"
        if self._moved:
            raise SensorError(
                f"{self._name} hangs or is saturated: it {what}; shift its range, use less voltage (--limits), or look "
                "at its cable"
            )
        raise SensorError(f"{self._name} does not move: it {what}; is it plugged in, switched on, the right channel?")
