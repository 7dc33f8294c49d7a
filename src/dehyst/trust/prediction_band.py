"""The prediction band: where the displacement of a trajectory may be when its compensating voltage is played."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dehyst._types import Array
from dehyst.control import shortest_homing
from dehyst.model import Actuator, Promise, State
from dehyst.records import largest

# What each of `PredictionBand.errors` comes from.
ERRORS = {"misfit": "largest misfit on the records themselves", "clamped": "voltages that are not allowed"}


@dataclass(frozen=True, eq=False)
class PredictionBand:
    """Prediction band: where the displacement of a trajectory may be, in metres on the model's axis.

    Attributes
    ----------
    wanted : (n,) array
        The path to follow [m].
    voltage, displacement : (n,) array
        Voltage [V] within the limits, and the model's displacement [m]: the wanted path, except where it was clamped.
    misfit : float
        The largest error of the model on these records [m]; perhaps no model of its class does better.
    warnings : tuple of str
        What was clamped or extrapolated.
    promise : Promise or None
        The promised error of this path; None if the model does not hold what its records tested.
    time : (n,) array or None
        Time of the path [s], if it was given.
    """

    wanted: Array
    voltage: Array
    displacement: Array
    misfit: float
    warnings: tuple[str, ...]
    promise: Promise | None = None
    time: Array | None = None

    @property
    def half(self) -> Array:
        """(n,) half the width of the band [m]: the promise, or without one the misfit."""
        return np.full(self.displacement.size, self.misfit) if self.promise is None else self.promise.half

    @property
    def lowest(self) -> Array:
        """(n,) lowest displacement to expect [m]."""
        return self.displacement - self.half

    @property
    def highest(self) -> Array:
        """(n,) highest displacement to expect [m]."""
        return self.displacement + self.half

    def columns(self) -> dict[str, Array]:
        """Columns for a file, in volts and micrometres."""
        return {
            "wanted_um": self.wanted * 1e6,
            "voltage_V": self.voltage,
            "expected_um": self.displacement * 1e6,
            "lowest_um": self.lowest * 1e6,
            "highest_um": self.highest * 1e6,
        }

    def as_dict(self, stroke: float) -> dict[str, Any] | None:
        """Return the promise as JSON values; None without one."""
        if self.promise is None:
            return None
        half = float(np.mean(self.half))
        return {"half_width_m": half, **self.promise.as_dict(), "sentence": self.promise.sentence(stroke)}

    def errors(self) -> dict[str, float]:
        """Largest error [m] by cause: misfit and clamping."""
        return {"misfit": self.misfit, "clamped": largest(self.displacement - self.wanted)}


def top_state(actuator: Actuator, limits: tuple[float, float] | None) -> State:
    """Return the state at the top of the limits, after a rise.

    For a model that depends on time, the rise is the homing that ends there
    (`dehyst.control.planning.homing.shortest_homing`); for others it goes once through the limits. Without limits,
    return the state at the top of the spring.
    """
    if limits is None:
        return actuator.turned(float(actuator.spring.displacement[-1]))
    played = shortest_homing(actuator, limits=limits, present=limits[0], end=limits[1]).played
    voltage = np.array(limits) if played is None else played.voltage
    time = played.time if played is not None and actuator.needs_time else None
    start = actuator.turned(float(actuator.spring.displacement[0]), rising=False)
    state: State = actuator.simulate(voltage, time=time, state=start, extrapolate=True).state
    return state
