"""A look at the sensor while a record is made: whether the displacement still follows the voltage."""

from __future__ import annotations

import numpy as np

from dehyst._errors import SensorError
from dehyst._types import Array

# No piezo actuator stands still, to the last digit of a reading, while its voltage crosses so much of its range.
_DEAD = 0.2


class SensorWatch:
    """Sees samples as they come, and raises when the reading stands still while the voltage moves.

    Parameters
    ----------
    span : float
        Range of the voltage [V].
    """

    def __init__(self, span: float) -> None:
        self._enough = _DEAD * span
        self._value: float | None = None
        self._low = self._high = 0.0
        self._moved = False

    def see(self, voltage: Array, displacement: Array) -> None:
        """Look at samples (n,) [V], (n,) [m] that follow the ones before.

        Raises
        ------
        SensorError
            If the reading has not changed while the voltage crossed a fifth of its range; whether it moved
            before makes the message.
        """
        if not displacement.size:
            return
        starts = np.flatnonzero(np.concatenate([[displacement[0] != self._value], np.diff(displacement) != 0]))
        for first, stop in zip([0, *starts], [*starts, displacement.size], strict=True):
            if first == stop:
                continue
            self._stretch(float(displacement[first]), voltage[first:stop])

    def _stretch(self, value: float, voltage: Array) -> None:
        low, high = float(voltage.min()), float(voltage.max())
        if value == self._value:
            low, high = min(low, self._low), max(high, self._high)
        else:
            self._moved = self._moved or self._value is not None
        self._value, self._low, self._high = value, low, high
        if high - low > self._enough:
            self._refuse()

    def _refuse(self) -> None:
        went = f"stays at {1e6 * (self._value or 0.0):.6g} um while the voltage goes from {self._low:.6g} to "
        went += f"{self._high:.6g} V"
        if self._moved:
            raise SensorError(
                f"the sensor hangs or is saturated: it {went}; shift its range, use less voltage (--limits), or look "
                "at its cable"
            )
        raise SensorError(f"the sensor does not move: it {went}; is it plugged in, switched on, the right channel?")
