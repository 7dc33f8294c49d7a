"""Simulation of a record's voltage by any model, from a suitable start state."""

from __future__ import annotations

import inspect
from typing import Any

from dehyst._types import Array
from dehyst.model.actuator import Actuator
from dehyst.model.base import AbstractModel, Motion


def timed(model: AbstractModel, time: Array) -> dict[str, Any]:
    """Return the keywords `time` and `extrapolate` if a model has them: records may exceed those of its fit."""
    given = {"time": time, "extrapolate": True}
    return {name: value for name, value in given.items() if name in inspect.signature(model.simulate).parameters}


def beginning(model: AbstractModel, voltage: Array) -> Any:
    """Return the start of a model before a voltage (n,): None for its default, of an actuator the nearest loop end.

    A distant start would set a mass swinging. An actuator that creeps starts relaxed, as before the records, because
    its later motion depends on where it stood.
    """
    if not isinstance(model, Actuator) or not voltage.size:
        return None
    if model.creep is not None:
        return model.relaxed(float(voltage[0]), extrapolate=True)
    low, high = (float(end) for end in model.spring.displacement[[0, -1]])
    ends = [model.turned(high), model.turned(low, rising=False)]
    return min(ends, key=lambda state: abs(model.voltage(state) - float(voltage[0])))


def simulated(model: AbstractModel, voltage: Array, time: Array) -> Motion:
    """Return the motion that a `voltage` causes from its `beginning`. `model` is any. `time` (n,) [s]."""
    return model.simulate(voltage, state=beginning(model, voltage), **timed(model, time))
