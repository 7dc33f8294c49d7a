"""Virtual actuators by name, or from a model file, for emulated instruments."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst.model import DESCRIPTION, Actuator, State
from dehyst.virtual.ageing import AgeingActuator
from dehyst.virtual.base import Clock, Sensor, VirtualActuator
from dehyst.virtual.bouc_wen import BoucWenActuator
from dehyst.virtual.plays import PlayActuator
from dehyst.virtual.preisach import PreisachActuator

# Share of a step that the actuator "creep" adds in each decade of time.
_CREEP = 0.01
# Keys of a model file that do not describe the actuator itself.
_NOT_THE_ACTUATOR = DESCRIPTION | {"state", "limits"}
_DIGITS = 12


class ModelledActuator(VirtualActuator):
    """An identified `actuator` as a virtual one, without noise.

    Its `highest` voltage [V] is the upper limit of the actuator, or the voltage at the end of its spring.
    """

    def __init__(self, actuator: Actuator) -> None:
        self.actuator = actuator
        end = actuator.voltage(actuator.turned(float(actuator.spring.displacement[-1])))
        self.highest = float(end if actuator.limits is None else actuator.limits[1])
        if not self.highest > 0:
            raise ModelError(f"{actuator.name}: its highest voltage is {self.highest:.6g} V, need one above 0 V")
        swing = np.array([0.0, self.highest, 0.0, self.highest, 0.0])
        slowly = 1e3 * np.arange(swing.size) if actuator.needs_time else None
        y = actuator.simulate(swing, time=slowly, state=actuator.relaxed(), extrapolate=True).displacement
        self.stroke, self._sensor = float(y[3] - y[4]), Sensor(0.0, 0)
        self.relax()

    def relax(self) -> None:
        """Reset to rest at 0 V, without residual strain."""
        self._state: State = self.actuator.relaxed()
        self._voltage, self._clock = 0.0, Clock()

    def _moved(self, v: Array, time: ArrayLike | None) -> Array:
        """Move; only an actuator that moves in time needs the `time`."""
        path, at = v, None
        if self.actuator.needs_time:
            self._clock.steps(time, v.size, "moves in time")
            path, at = np.concatenate([[self._voltage], v]), self._clock.times
        motion = self.actuator.simulate(path, time=at, state=self._state, extrapolate=True)
        self._state, self._voltage = motion.state, float(v[-1])
        return motion.displacement[-v.size :]


VIRTUAL: dict[str, Callable[[], VirtualActuator]] = {
    "play": PlayActuator,
    "creep": lambda: PlayActuator(creep=_CREEP),
    "preisach": PreisachActuator,
    "boucwen": BoucWenActuator,
}


def virtual_actuator(name: str) -> VirtualActuator | Actuator:
    """Return a virtual actuator: one of `VIRTUAL`, or the model in a file.

    Raise `ModelError` if there is neither such a name nor such a file. Raise `FileFormatError` if the file cannot be
    read.
    """
    if name in VIRTUAL:
        return VIRTUAL[name]()
    if not Path(name).suffix and not Path(name).exists():
        raise ModelError(
            argument="actuator", got=f"'{name}'", need=f"one of {', '.join(VIRTUAL)}, or the path of a model file"
        )
    return Actuator.load(name)


def fingerprint(actuator: VirtualActuator | Actuator) -> str:
    """Return kind and hash of a virtual actuator: equal for equal parameters, independent of name and file.

    Name, provenance, state and limits of a model have no effect, because they may differ for the same actuator.
    """
    if isinstance(actuator, AgeingActuator):
        actuator = actuator.new
    if isinstance(actuator, ModelledActuator):
        actuator = actuator.actuator
    kind = "model" if isinstance(actuator, Actuator) else type(actuator).__name__.removesuffix("Actuator").lower()
    text = json.dumps(_parameters(actuator), sort_keys=True, default=float)
    return f"{kind}-{hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]}"


def _parameters(actuator: VirtualActuator | Actuator) -> dict[str, Any]:
    """Return the parameters of a virtual actuator by name."""
    if isinstance(actuator, Actuator):
        parts = actuator.as_dict().items()
        return {key: value for key, value in parts if key not in _NOT_THE_ACTUATOR and value is not None}
    if is_dataclass(actuator):
        return {field.name: getattr(actuator, field.name) for field in fields(actuator) if field.init}
    return {"stroke": actuator.stroke, "highest": actuator.highest}
