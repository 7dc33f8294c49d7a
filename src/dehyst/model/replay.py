"""A model's answer to a voltage from the state in which it begins."""

from __future__ import annotations

import inspect
from typing import Any

from dehyst._types import Array
from dehyst.model.actuator import Actuator
from dehyst.model.base import AbstractModel, Motion


def timed(model: AbstractModel, time: Array) -> dict[str, Any]:
    """The keywords `time` and `extrapolate` for a model that has them: records may go farther than those of its fit."""
    given = {"time": time, "extrapolate": True}
    return {name: value for name, value in given.items() if name in inspect.signature(model.simulate).parameters}


def beginning(model: AbstractModel, voltage: Array) -> Any:
    """Where a model starts before a voltage (n,): its own default, or of an actuator the end of its loop nearest by.

    A start far away would set a mass swinging. What creeps has stood relaxed, as before the records: what it does long
    after depends on where it stood.
    """
    if not isinstance(model, Actuator) or not voltage.size:
        return None
    if model.creep is not None:
        return model.relaxed(float(voltage[0]), extrapolate=True)
    low, high = (float(end) for end in model.spring.displacement[[0, -1]])
    ends = [model.turned(high), model.turned(low, rising=False)]
    return min(ends, key=lambda state: abs(model.voltage(state) - float(voltage[0])))


def simulated(model: AbstractModel, voltage: Array, time: Array) -> Motion:
    """The motion that a voltage causes from its `beginning`."""
    return model.simulate(voltage, state=beginning(model, voltage), **timed(model, time))
