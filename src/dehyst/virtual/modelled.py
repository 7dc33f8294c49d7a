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
from dehyst._validation import untimely, vector
from dehyst.model import Actuator, State
from dehyst.model.serialization import DESCRIPTION
from dehyst.virtual.base import VirtualActuator
from dehyst.virtual.bouc_wen import BoucWenActuator
from dehyst.virtual.plays import PlayActuator
from dehyst.virtual.preisach import PreisachActuator

# Share of a step that the actuator "creep" adds in each decade of time.
_CREEP = 0.01
# Keys of a model file that do not describe the actuator itself.
_NOT_THE_ACTUATOR = DESCRIPTION | {"state", "limits"}
_DIGITS = 12


class ModelledActuator:
    """An identified actuator as a `VirtualActuator`, which keeps its state from call to call.

    Parameters
    ----------
    actuator : Actuator

    Attributes
    ----------
    highest : float
        Upper limit of the actuator [V], or the voltage at the end of its spring.
    stroke : float
        Displacement between 0 V and `highest` on the major loop [m].
    """

    def __init__(self, actuator: Actuator) -> None:
        self.actuator = actuator
        spring = actuator.spring.displacement
        end = actuator.voltage(actuator.turned(float(spring[-1])))
        self.highest = float(end if actuator.limits is None else actuator.limits[1])
        if not self.highest > 0:
            raise ModelError(f"{actuator.name}: its highest voltage is {self.highest:.6g} V, need one above 0 V")
        swing = np.array([0.0, self.highest, 0.0, self.highest, 0.0])
        slowly = 1e3 * np.arange(swing.size) if actuator.needs_time else None
        y = actuator.simulate(swing, time=slowly, state=actuator.relaxed(), extrapolate=True).displacement
        self.stroke = float(y[3] - y[4])
        self.relax()

    def relax(self) -> None:
        """Reset to rest at 0 V, without residual strain."""
        self._state: State = self.actuator.relaxed()
        self._voltage, self._time = 0.0, -np.inf

    def play(self, voltage: ArrayLike, *, time: ArrayLike | None = None, measured: bool = True) -> Array:
        """Play a `voltage` (n,) [V] as `VirtualActuator.play`; without a sensor, `measured` has no effect.

        `time` (n,) [s] is needed by models that move in time. Raise `ModelError` if the voltage is not finite, or an
        actuator that needs the time lacks it, or it does not fit.
        """
        v = vector(voltage, "voltage")
        if not v.size:
            return v
        if not self.actuator.needs_time:
            motion = self.actuator.simulate(v, state=self._state, extrapolate=True)
            self._state = motion.state
            return motion.displacement
        if time is None:
            raise ModelError("this actuator needs the time of each sample; give the time [s]")
        at = vector(time, "time")
        if at.size != v.size:
            raise ModelError(untimely(at, v.size))
        if not np.isfinite(self._time) or not at[0] > self._time:
            if at.size < 2:
                raise ModelError(
                    "got one sample that does not go on from an earlier one", argument="time", hint="need two at least"
                )
            self._time = float(2 * at[0] - at[1])
        motion = self.actuator.simulate(
            np.concatenate([[self._voltage], v]),
            time=np.concatenate([[self._time], at]),
            state=self._state,
            extrapolate=True,
        )
        self._state, self._voltage, self._time = motion.state, float(v[-1]), float(at[-1])
        return motion.displacement[1:]


VIRTUAL: dict[str, Callable[[], VirtualActuator]] = {
    "play": PlayActuator,
    "creep": lambda: PlayActuator(creep=_CREEP),
    "preisach": PreisachActuator,
    "boucwen": BoucWenActuator,
}


def virtual_actuator(name: str) -> VirtualActuator | Actuator:
    """Return a virtual actuator: one of `VIRTUAL`, or the model in a file.

    Raise `ModelError` if it is no such name, and no such file exists. Raise `FileFormatError` if the file cannot be
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
    """Return kind and hash of a virtual actuator: equal for equal parameters, whatever its name or file.

    Name, provenance, state and limits of a model do not count: the same actuator may have others.
    """
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
