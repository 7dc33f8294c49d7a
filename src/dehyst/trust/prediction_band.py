"""The prediction band: where the displacement of a trajectory may be when its compensating voltage is played."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dehyst._types import Array
from dehyst.control import Command, shortest_homing
from dehyst.identification import cycle_time
from dehyst.model import Actuator, Promise, State
from dehyst.records import largest
from dehyst.trust.bootstrap import Intervals
from dehyst.trust.evidence import Evidence
from dehyst.trust.feasible_set import FeasibleSet

# What each of `PredictionBand.errors` comes from.
ERRORS = {
    "noise": "noise and finite records",
    "open": "models that the records do not contradict",
    "misfit": "largest misfit on the records themselves",
    "clamped": "voltages that are not allowed",
}


@dataclass(frozen=True, eq=False)
class PredictionBand:
    """Prediction band: where the displacement of a trajectory may be, in metres on the model's axis.

    Attributes
    ----------
    wanted : (n,) array
        The path to follow [m].
    voltage, displacement : (n,) array
        Voltage [V] within the limits, and the model's displacement [m]: the wanted path, except where it was clamped.
    noise : (2, n) array
        Lowest and highest prediction of models identified from resampled cycles.
    open : (2, n) array or None
        Lowest and highest prediction of models that the records do not contradict; None if there is no feasible set.
    misfit : float
        The largest error of the model on these records [m]; perhaps no model of its class does better.
    warnings : tuple of str
        What was clamped or extrapolated.
    level : float
        Confidence level of the intervals due to noise, 0 to 1.
    promise : Promise or None
        The promised error of this path; None if the model does not hold what its records tested.
    time : (n,) array or None
        Time of the path [s], if it was given.
    """

    wanted: Array
    voltage: Array
    displacement: Array
    noise: Array
    open: Array | None
    misfit: float
    warnings: tuple[str, ...]
    level: float = 0.9
    promise: Promise | None = None
    time: Array | None = None

    @classmethod
    def of(
        cls,
        wanted: Array,
        command: Command,
        intervals: Intervals,
        free: FeasibleSet | None,
        state: Callable[[Actuator], State],
        *,
        misfit: float,
        time: Array | None = None,
        promise: Promise | None = None,
    ) -> PredictionBand:
        """Simulate a command with every possible model, from the `state` of this model.

        `time` (n,) [s] of the command; needed by models that depend on time.
        """
        noise = intervals.prediction(command.voltage, state, time if intervals.actuator.needs_time else None)
        free_ = None if free is None else free.prediction(command.voltage, state)
        return cls(
            wanted,
            command.voltage,
            command.displacement,
            noise,
            free_,
            misfit,
            command.warnings,
            intervals.level,
            promise,
            time,
        )

    @property
    def lowest(self) -> Array:
        """(n,) lowest displacement to expect [m]: from the promise, or without a promise from noise and misfit.

        The band includes the models that the records do not contradict.
        """
        return self._edge(0)

    @property
    def highest(self) -> Array:
        """(n,) highest displacement to expect [m]."""
        return self._edge(1)

    def _edge(self, k: int) -> Array:
        way, further = (-1, np.minimum) if k == 0 else (1, np.maximum)
        edge = self.noise[k] + way * self.misfit
        if self.promise is not None:
            edge = self.displacement + way * self.promise.half
        return np.asarray(edge if self.open is None else further(edge, self.open[k] + way * self.misfit))

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
        half = float(0.5 * np.mean(self.highest - self.lowest))
        return {"half_width_m": half, **self.promise.as_dict(), "sentence": self.promise.sentence(stroke)}

    def errors(self) -> dict[str, float]:
        """Largest error [m] by cause: noise, open directions, misfit and clamping."""

        def off(band: Array) -> float:
            return largest(np.maximum(band[1] - self.displacement, self.displacement - band[0]))

        free = {} if self.open is None else {"open": off(self.open)}
        return {
            "noise": off(self.noise),
            **free,
            "misfit": self.misfit,
            "clamped": largest(self.displacement - self.wanted),
        }


def top_start(actuator: Actuator, limits: tuple[float, float] | None) -> Callable[[Actuator], State]:
    """Return a function of a model: its state at the top of the limits, after the rise that suits the `actuator`.

    For a model that depends on time, the rise is the homing that ends there
    (`dehyst.control.planning.homing.shortest_homing`); for others it goes once through the limits. Without limits, the
    function returns the state at the top of the spring.
    """
    if limits is None:
        return lambda model: model.turned(float(model.spring.displacement[-1]))
    played = shortest_homing(actuator, limits=limits, present=limits[0], end=limits[1]).played
    voltage = np.array(limits) if played is None else played.voltage

    def after_rise(model: Actuator) -> State:
        start = model.turned(float(model.spring.displacement[0]), rising=False)
        time = played.time if played is not None and model.needs_time else None
        state: State = model.simulate(voltage, time=time, state=start, extrapolate=True).state
        return state

    return after_rise


_SAMPLES = 400


@dataclass(frozen=True, eq=False)
class MajorLoopWidth:
    """The second of two major loops at the rate of the records, with its uncertainty.

    Attributes
    ----------
    voltage, displacement : (n,) array
        Voltage through the limits [V], up first, and the displacement of the model [m].
    noise : (2, n) array
        Lowest and highest displacement of models identified from resampled cycles [m].
    """

    voltage: Array
    displacement: Array
    noise: Array

    @classmethod
    def from_intervals(cls, evidence: Evidence, intervals: Intervals, limits: tuple[float, float]) -> MajorLoopWidth:
        """Simulate two cycles through the limits; the second counts."""
        seconds = min(cycle_time(item.record.record) for item in evidence.comparisons)
        phase = np.linspace(0, 2, 2 * _SAMPLES + 1)
        low, high = limits
        voltage = low + (high - low) * (0.5 - 0.5 * np.cos(2 * np.pi * phase))
        actuator = evidence.actuator
        time = seconds * phase if actuator.needs_time else None

        def state(model: Actuator) -> State:
            return model.turned(float(model.spring.displacement[0]), rising=False)

        noise = intervals.prediction(voltage, state, time)[:, _SAMPLES:]
        motion = actuator.simulate(voltage, time=time, state=state(actuator), extrapolate=True)
        return cls(voltage[_SAMPLES:], motion.displacement[_SAMPLES:], noise)

    @property
    def off(self) -> float:
        """The largest distance [m] of the models from resampled cycles from the model."""
        return float(np.abs(self.noise - self.displacement).max())
