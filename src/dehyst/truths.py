"""Virtual actuators that no model of this package is an instance of: for the demo, tests and benchmarks.

They share no code with the models. Where a model says v = stops(y) + eta(y), the truth here says y = map(plays(v)).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._native import Array, vector


@dataclass(eq=False)
class PlayActuator:
    """Play operators of the voltage, summed and seen through an asymmetric map.

    ``w = (1 - width) v / highest + width sum_j p_j play_{r_j}[v]``, 0 and 1 at the ends of the major loop, then
    ``y = stroke (w + asymmetry w (w - 1) + bend w (w - 1)(w - 1/2))``: the loop is not anti-symmetric and its width
    changes along the stroke.

    Parameters
    ----------
    stroke : float
        Displacement [m] at the highest voltage.
    highest : float
        Highest voltage [V]; displacement is 0 at 0 V after a long descent.
    width : float
        Share of w that the plays hold, 0 to 1.
    asymmetry, bend : float
        Of the map; it must stay increasing.
    plays : int
        Number of play operators, thresholds uniform up to half of `highest`.
    noise : float
        Standard deviation of the sensor [m].
    seed : int
        Of the noise.
    """

    stroke: float = 16.152e-6
    highest: float = 200.0
    width: float = 0.55
    asymmetry: float = 0.10
    bend: float = 0.12
    plays: int = 300
    noise: float = 2e-9
    seed: int = 0
    _thresholds: Array = field(init=False, repr=False)
    _weights: Array = field(init=False, repr=False)
    _outputs: Array = field(init=False, repr=False)
    _random: np.random.Generator = field(init=False, repr=False)

    def __post_init__(self) -> None:
        w = np.linspace(-0.1, 1.1, 400)
        if np.any(np.diff(self._mapped(w)) <= 0):
            raise ModelError(f"asymmetry {self.asymmetry} and bend {self.bend}: the map must increase; try less")
        self._thresholds = 0.5 * self.highest * (np.arange(self.plays) + 0.5) / self.plays
        density = np.exp(-2.5 * self._thresholds / (0.5 * self.highest))
        reach = self.highest - 2 * self._thresholds
        self._weights = self.width * density / float(density @ reach)
        self._random = np.random.default_rng(self.seed)
        self.relax()

    def relax(self) -> None:
        """Forget: no residual strain, 0 V."""
        self._outputs = np.zeros(self.plays)

    def drive(self, voltage: ArrayLike, *, measured: bool = True) -> Array:
        """Play a voltage (n,) [V]; returns the displacement (n,) [m], with sensor noise if `measured`.

        Raises
        ------
        ModelError
            If the voltage is not finite.
        """
        v = vector(voltage, "voltage")
        outputs, low, high = self._outputs, -self._thresholds, self._thresholds
        summed = np.empty(v.size)
        for t, now in enumerate(v):
            np.clip(outputs, now + low, now + high, out=outputs)
            summed[t] = self._weights @ outputs
        # A long descent to 0 V leaves each play at its threshold, a long rise to the highest voltage that far below it.
        rest, span = float(self._weights @ high), float(self._weights @ (self.highest + 2 * low))
        w = (1 - self.width) * v / self.highest + self.width * (summed - rest) / span
        y = self.stroke * self._mapped(w)
        return y + self._random.normal(0.0, self.noise, v.size) if measured and self.noise else y

    def _mapped(self, w: Array) -> Array:
        return w + self.asymmetry * w * (w - 1) + self.bend * w * (w - 1) * (w - 0.5)
