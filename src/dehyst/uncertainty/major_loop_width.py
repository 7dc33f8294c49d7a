"""How far the displacement on the major loop may be off by noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dehyst._types import Array
from dehyst.identification.preprocessing.cleaning import cycle_time
from dehyst.model import Actuator, State
from dehyst.uncertainty.bootstrap import Intervals
from dehyst.uncertainty.evidence import Evidence

_SAMPLES = 400


@dataclass(frozen=True, eq=False)
class MajorLoopWidth:
    """The major loop at the rate of the records, after one before it.

    Attributes
    ----------
    voltage, displacement : (n,) array
        Through the limits [V], up first, and the displacement of the model [m].
    noise : (2, n) array
        Lowest and highest displacement of models identified from resampled cycles [m].
    """

    voltage: Array
    displacement: Array
    noise: Array

    @classmethod
    def from_intervals(cls, evidence: Evidence, intervals: Intervals, limits: tuple[float, float]) -> MajorLoopWidth:
        """Play two cycles through the limits; the second counts."""
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
        """The largest distance of the noise's models from the model [m]."""
        return float(np.abs(self.noise - self.displacement).max())
