"""A virtual actuator of Preisach relays with a smooth density, summed exactly over the staircase of its memory.

I. D. Mayergoyz, Mathematical Models of Hysteresis, Springer 1991, chapter 1 (Everett's integral, the staircase).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dehyst._types import Array
from dehyst.virtual.base import Sensor, VirtualActuator

# The relays' plane, in units of the highest voltage: beyond it only the reversible share moves.
_LOWEST, _UPPERMOST = -0.5, 1.5
_NODES, _SHARES = np.polynomial.legendre.leggauss(32)
_CYCLES_TO_RELAX = 60


@dataclass(eq=False)
class PreisachActuator(VirtualActuator):
    """Relays that switch up at alpha and down at beta <= alpha, and a reversible share; u is v / highest.

    Their density is ``exp(-(d / ridge)^2 / 2) exp(-((m - centre) / spread)^2 / 2) + uniform`` with d = alpha - beta and
    m = (alpha + beta) / 2, from -1/2 to 3/2 of the highest voltage. The reversible share is
    ``u + bend u (u - 1)``. Displacement is 0 and `stroke` at the ends of the major loop from 0 V to `highest`.

    Parameters
    ----------
    reversible : float
        Share of the stroke without relays, above 0 and below 1.
    bend : float
        Curvature of the reversible share.
    ridge, centre, spread, uniform : float
        Of the density, in units of the highest voltage; `uniform` relative to its peak.
    """

    stroke: float = 16.0e-6
    highest: float = 200.0
    reversible: float = 0.55
    bend: float = 0.15
    ridge: float = 0.25
    centre: float = 0.60
    spread: float = 0.45
    uniform: float = 0.25
    noise: float = 2e-9
    seed: int = 0

    def __post_init__(self) -> None:
        self._sensor = Sensor(self.noise, self.seed)
        self._span = float(self._everett(np.ones(1), np.zeros(1))[0])
        self._bottom = float(self._everett(np.ones(1), np.full(1, _LOWEST))[0]) - self._span
        self.relax()

    def relax(self) -> None:
        """Reset to the state after an alternating voltage that decayed to 0 V."""
        self._links: list[tuple[float, float]] = [(_LOWEST, 0.0)]
        decay = 0.5 * (1 - np.arange(2 * _CYCLES_TO_RELAX + 1) / (2 * _CYCLES_TO_RELAX))
        self._relays(decay * (-1.0) ** np.arange(decay.size))

    def _moved(self, v: Array, time: ArrayLike | None) -> Array:
        """Move; relays ignore the `time`."""
        u = v / self.highest
        relays = (self._relays(np.clip(u, _LOWEST, _UPPERMOST)) - self._bottom) / self._span
        free = u + self.bend * np.where((u > 0) & (u < 1), u * (u - 1), np.where(u > 0, u - 1, -u))
        return self.stroke * (self.reversible * free + (1 - self.reversible) * relays)

    def _relays(self, u: Array) -> Array:
        """Return the integral of the density over the relays that are up, for each voltage of a path (n,).

        A link is an extreme of the memory, with the integral at that extreme. Links alternate between minima (the first
        is the plane's corner) and maxima, each nested within the one before.
        """
        links = self._links
        turn, base, up = np.empty(u.size), np.empty(u.size), np.empty(u.size, dtype=bool)
        # The last link is the present voltage; the present branch began at the one before it.
        for t, now in enumerate(u.tolist()):
            self._follow(links, now)
            (begin, level), rising = links[-2] if len(links) > 1 else links[-1], len(links) % 2 == 0
            turn[t], base[t], up[t] = begin, level, rising
        change = self._everett(np.where(up, u, turn), np.where(up, turn, u))
        return base + np.where(up, change, -change)

    def _follow(self, links: list[tuple[float, float]], now: float) -> None:
        """Move the last link to `now`: a reversal adds a link, passing an older extreme wipes two out."""
        if len(links) > 1:
            rising = len(links) % 2 == 0
            if (now < links[-1][0]) if rising else (now > links[-1][0]):
                links[-1] = (links[-1][0], self._level(links))
                links.append((now, 0.0))
                rising = not rising
            while len(links) > 2 and ((now >= links[-3][0]) if rising else (now <= links[-3][0])):
                del links[-3:-1]
            if not rising and now <= _LOWEST:
                del links[1:]
                links[0] = (_LOWEST, 0.0)
                return
            links[-1] = (now, 0.0)
        elif now > _LOWEST:
            links.append((now, 0.0))

    def _level(self, links: list[tuple[float, float]]) -> float:
        (a, base), (b, _) = links[-2], links[-1]
        change = float(self._everett(np.array([max(a, b)]), np.array([min(a, b)]))[0])
        return base + (change if b > a else -change)

    def _everett(self, high: Array, low: Array) -> Array:
        """Return the integral of the density over low <= beta <= alpha <= high, by Gauss's rule in alpha - beta."""
        from scipy.special import ndtr

        reach = (high - low)[:, None]
        d = 0.5 * reach * (_NODES + 1)
        above = ndtr((high[:, None] - 0.5 * d - self.centre) / self.spread)
        below = ndtr((low[:, None] + 0.5 * d - self.centre) / self.spread)
        peak = np.exp(-0.5 * (d / self.ridge) ** 2) * self.spread * np.sqrt(2 * np.pi) * (above - below)
        return np.asarray(0.5 * reach[:, 0] * ((peak + self.uniform * (reach - d)) @ _SHARES))
