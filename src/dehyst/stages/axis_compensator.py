"""The compensator of one axis of a stage, which leaves warnings to the stage."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from dehyst._native import Loop
from dehyst.control import Compensator, Snapshot
from dehyst.control.core_loop import step_numbers


class AxisCompensator(Compensator):
    """A `Compensator` without `ClampWarning` in steps.

    It receives targets that are corrected for the other axes. The stage warns, of the displacement that is wanted.
    """

    def __reduce__(self) -> tuple[Callable[..., AxisCompensator], tuple[object, ...]]:
        """Return how to copy and unpickle the compensator, with its memory."""
        return _again, super().__reduce__()[1]

    def _new_loop(self) -> Loop:
        pace, numbers = step_numbers(self.actuator, self._limits, self.period)
        return self.actuator.model.core.loop(pace, self._lookahead.taps, np.array(numbers), _silent, self.start())


def _silent(slewed: bool, displacement: float, voltage: float) -> None:
    pass


def _again(options: tuple[Any, ...], memory: Snapshot | None) -> AxisCompensator:
    actuator, limits, slew_rate, period, state, preview, units = options
    axis = AxisCompensator(actuator, limits, slew_rate, period=period, state=state, preview=preview, units=units)
    if memory is not None:
        axis.restore(memory)
    return axis
