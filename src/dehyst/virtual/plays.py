"""A virtual actuator of play operators: y = map(plays(v)) + creep, where a model has v = stops(y) + eta(y)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst.virtual.base import Clock, Sensor, VirtualActuator, cubic_map, refuse_falling_map

# Time constants [s] of first-order branches whose sum creeps as the logarithm of time.
_CREEP_TIMES = np.geomspace(0.05, 1000.0, 12)


@dataclass(eq=False)
class PlayActuator(VirtualActuator):
    """Play operators of the voltage, summed and mapped asymmetrically.

    ``w = (1 - width) v / highest + width sum_j p_j play_{r_j}[v]``, 0 and 1 at the ends of the major loop, then
    ``y = stroke (w + asymmetry w (w - 1) + bend w (w - 1)(w - 1/2))``. The loop is not anti-symmetric, and its width
    changes along the stroke. With creep, low-pass filters of y are added to y: after a step, the displacement grows as
    the logarithm of time from 0.1 s to 500 s, and exceeds the stroke.

    Parameters
    ----------
    width : float
        Share of the plays in w, 0 to 1.
    asymmetry, bend : float
        Parameters of the map, which must increase.
    plays : int
        Number of play operators, with thresholds equally spaced up to half of `highest`.
    creep : float
        Creep per decade of time, as a share of the step; 0.01 is 1 %. With creep, `play` needs the time.
    """

    stroke: float = 16.152e-6
    highest: float = 200.0
    width: float = 0.55
    asymmetry: float = 0.10
    bend: float = 0.12
    plays: int = 300
    noise: float = 2e-9
    seed: int = 0
    creep: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.creep < 1:
            raise ModelError(f"creep: got {self.creep}, need a share of the step for each decade, 0 to 1")
        refuse_falling_map(self.asymmetry, self.bend)
        self._thresholds = 0.5 * self.highest * (np.arange(self.plays) + 0.5) / self.plays
        density = np.exp(-2.5 * self._thresholds / (0.5 * self.highest))
        reach = self.highest - 2 * self._thresholds
        self._weights = self.width * density / float(density @ reach)
        self._sensor = Sensor(self.noise, self.seed)
        self.relax()

    def relax(self) -> None:
        """Reset to rest at 0 V, without residual strain."""
        self._outputs = np.zeros(self.plays)
        self._crept = np.zeros(_CREEP_TIMES.size)
        self._before = 0.0
        self._clock = Clock()

    def _moved(self, v: Array, time: ArrayLike | None) -> Array:
        """Move by a voltage; only creep needs the `time`."""
        steps = self._clock.steps(time, v.size, "creeps") if self.creep else None
        y = self._mapped(self._sum_plays(v))
        return y if steps is None else y + self._creep(y - self._mapped(self._level(np.zeros(1))), steps)

    def _mapped(self, w: Array) -> Array:
        return self.stroke * cubic_map(w, self.asymmetry, self.bend)

    def _sum_plays(self, v: Array) -> Array:
        outputs, low, high = self._outputs, -self._thresholds, self._thresholds
        summed = np.empty(v.size)
        for t, now in enumerate(v):
            np.clip(outputs, now + low, now + high, out=outputs)
            summed[t] = self._weights @ outputs
        return (1 - self.width) * v / self.highest + self._level(summed)

    def _level(self, summed: Array) -> Array:
        # After a long descent to 0 V each play is at its threshold, after a long rise at the highest voltage minus it.
        rest = float(self._weights @ self._thresholds)
        span = float(self._weights @ (self.highest - 2 * self._thresholds))
        return self.width * (summed - rest) / span

    def _creep(self, y: Array, steps: Array) -> Array:
        """Return the creep (n,) for a displacement (n,) since rest, exact if it is linear within a time step."""
        ratio = steps[:, None] / _CREEP_TIMES
        kept = np.exp(-ratio)
        # Share of a linear rise in the step that a branch has followed at the end of the step.
        followed = 1 + np.expm1(-ratio) / ratio
        start = np.concatenate([[self._before], y[:-1]])
        pushed = start[:, None] * -np.expm1(-ratio) + (y - start)[:, None] * followed
        added, state = np.empty(y.size), self._crept
        for t in range(y.size):
            state = kept[t] * state + pushed[t]
            added[t] = state.sum()
        self._crept, self._before = state, float(y[-1])
        decades = np.log10(_CREEP_TIMES[1] / _CREEP_TIMES[0])
        return np.asarray(self.creep * decades * added)
