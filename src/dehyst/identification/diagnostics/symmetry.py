"""A closed loop compared with its mirror image: Lemma 2's anti-symmetry, and the symmetry of the loop's width.

V_up and V_down are the voltages of its branches at u, the displacement from its centre, minus the centre's voltage:

    V_up(u) + V_down(-u) = 0                               with a linear spring (Lemma 2)
    V_up(u) - V_down(u) = V_up(-u) - V_down(-u)            with any spring and any slip elements

The first sum has an even part, the bend of the middle line, which a nonlinear spring follows, and an odd part, half of
the residual of the second equation, which no spring follows.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from dehyst._types import Array
from dehyst.identification.diagnostics.branches import Branch, Family, averaged_at

# Probability that noise alone exceeds a floor.
RISK = 0.05
_PLACES = 40


@dataclass(frozen=True, eq=False)
class Mirrored:
    """A loop, its cycles read at places that lie symmetrically about its centre.

    Attributes
    ----------
    record : str
    range, middle : float
        Width and centre [m].
    place : (K,) array
        u [m], from the centre of each cycle, which removes a slow drift of the sensor.
    rising, falling : (M, K) array
        V_up and V_down [V] of each cycle, minus the mean voltage of its turning points.
    noise : float
        Standard deviation of a sample [m].
    gain : float
        Largest part of its variance that a reading keeps.
    opening : float
        Mean distance of the ends of descending and ascending branches [m]: it limits what an open loop shows.
    """

    record: str
    range: float
    middle: float
    place: Array
    rising: Array
    falling: Array
    noise: float
    gain: float
    opening: float

    @classmethod
    def of(cls, family: Family, noise: float) -> Mirrored:
        """Read the branches of a family; `noise` is the standard deviation of a sample [m]."""
        half = min(max(0.01 * family.range, 4 * noise), 0.1 * family.range)
        place = np.linspace(half - 0.5 * family.range, 0.5 * family.range - half, _PLACES)
        # Symmetric to the last bit, so that a symmetric loop gives exactly 0.
        place = 0.5 * (place - place[::-1])
        rising: list[Array] = []
        falling: list[Array] = []
        gains: list[Array] = []
        pairs = list(zip(family.descending, family.ascending, strict=False))
        for down, up in pairs:
            y, v = (_mean_of_ends(down, up, column) for column in (0, 1))
            for branch, read in ((up, rising), (down, falling)):
                voltage, kept = averaged_at((branch[0] - y, branch[1] - v), place, half)
                read.append(voltage)
                gains.append(kept)
        gain = float(np.max(np.mean(gains, axis=0)))
        apart = np.mean([(down[0][0] - up[0][-1], down[0][-1] - up[0][0]) for down, up in pairs], axis=0)
        return cls(
            family.record,
            family.range,
            0.5 * (family.top + family.bottom),
            place,
            np.array(rising),
            np.array(falling),
            noise,
            gain,
            float(np.abs(apart).sum()),
        )

    @property
    def cycles(self) -> int:
        """Number of cycles M."""
        return len(self.rising)

    def asymmetry(self) -> tuple[Array, float]:
        """Return the distance of the loop from its mirror image (K,) [m], and the floor of its largest value [m]."""
        rising, falling = self._slopes()
        slope = np.sqrt(0.5 * (rising**2 + falling[::-1] ** 2))
        centre = (rising + falling[::-1]) / slope
        return self._distance(self.rising + self.falling[:, ::-1], slope, 2, centre)

    def width_asymmetry(self) -> tuple[Array, float]:
        """Return the width at u minus the width at -u (K,) [m], and the floor of its largest value [m]."""
        rising, falling = self._slopes()
        slope = self._mean_slope()
        narrowing = rising - falling
        width = self.rising - self.falling
        return self._distance(width - width[:, ::-1], slope, 4, (narrowing - narrowing[::-1]) / slope)

    def middle_asymmetry(self) -> Array:
        """Return the distance of the middle line from its mirror image (K,) [m]."""
        middle = (self.rising + self.falling).mean(axis=0)
        return np.asarray(0.5 * (middle + middle[::-1]) / self._mean_slope())

    def _distance(self, voltage: Array, slope: Array, readings: int, centre: Array) -> tuple[Array, float]:
        """Return the mean over cycles of voltages (M, K), in metres, and the floor of its largest absolute value.

        Noise alone stays below the floor with 95 % probability. Its variance is that of the sensor's white noise, of
        which each of the `readings` keeps its gain, and which enters the centre, the mean of four samples at turning
        points, with the factor `centre` (K,); or that of the scatter between cycles if larger. The opening is added.
        """
        from scipy.special import ndtri

        distance = voltage / slope
        variance = self.noise**2 * (readings * self.gain + 0.5 * float((centre**2).max()))
        if self.cycles > 1:
            variance = max(variance, float(distance.var(axis=0, ddof=1).mean()))
        floor = float(ndtri(1 - RISK / (2 * _PLACES))) * sqrt(variance / self.cycles) + self.opening
        return distance.mean(axis=0), floor

    def _slopes(self) -> tuple[Array, Array]:
        """Return the slopes of the rising and of the falling branch (K,) [V/m]."""
        rising, falling = (np.gradient(branch.mean(axis=0), self.place) for branch in (self.rising, self.falling))
        return np.asarray(rising), np.asarray(falling)

    def _mean_slope(self) -> Array:
        """Return the root mean square of the slopes of both branches at u and -u (K,) [V/m]."""
        rising, falling = self._slopes()
        squares = rising**2 + falling**2
        return np.asarray(np.sqrt(0.25 * (squares + squares[::-1])))


def _mean_of_ends(down: Branch, up: Branch, column: int) -> float:
    return float(0.25 * (down[column][0] + down[column][-1] + up[column][0] + up[column][-1]))
