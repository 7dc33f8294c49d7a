"""A virtual actuator after Bouc and Wen, behind a resonance and a delay.

Y.-K. Wen, "Method for random vibration of hysteretic systems", J. Eng. Mech. Div. ASCE 102(2), 1976, 249-263; for
piezo actuators T. S. Low, W. Guo, "Modeling of a three-layer piezoelectric bimorph beam with hysteresis", J.
Microelectromech. Syst. 4(4), 1995, 230-237.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from dehyst._types import Array
from dehyst.virtual.base import Clock, Sensor, VirtualActuator, cubic_map

# Largest step of the Runge-Kutta rule, as a share of the highest voltage.
_FINEST = 1e-3


@dataclass(eq=False)
class BoucWenActuator(VirtualActuator):
    """A lagging variable z of the voltage, a cubic map, a resonance and a delay; u is v / highest.

    ``dz/du = slope (1 - |z / lag|^power (closing sgn(z du) + 1 - closing))``, w = u - z scaled to 0 and 1 at the ends
    of the major loop, ``p = w + asymmetry w (w - 1) + bend w (w - 1)(w - 1/2)``, and
    ``y'' + 2 zeta omega y' + omega^2 y = omega^2 stroke p(t - delay)``. Voltage is linear between samples.

    Parameters
    ----------
    lag, slope, power, closing : float
        Largest z, its initial slope, the sharpness of its levelling off, and the share that a reversal undoes;
        2 slope closing < 1.
    asymmetry, bend : float
        Of the map; it must stay increasing.
    resonance : float
        omega / (2 pi) [Hz].
    damping : float
        zeta, above 0 and below 1.
    delay : float
        Of the voltage [s], 0 or more.
    """

    stroke: float = 16.0e-6
    highest: float = 200.0
    lag: float = 0.075
    slope: float = 0.45
    power: float = 1.2
    closing: float = 0.6
    asymmetry: float = 0.08
    bend: float = 0.10
    resonance: float = 300.0
    damping: float = 0.03
    delay: float = 2e-4
    noise: float = 2e-9
    seed: int = 0

    def __post_init__(self) -> None:
        self._sensor = Sensor(self.noise, self.seed)
        self._ends = (0.0, 1.0)
        self._lagging = 0.0
        turns = np.concatenate([np.linspace(a, b, 1001)[1:] for a, b in pairwise([0.0, 1.0] * 4 + [0.0])])
        w = self._follow(np.concatenate([[0.0], turns]))
        self._ends = float(w[-1]), float(w[-1001])
        self.relax()

    def relax(self) -> None:
        """Reset to rest at 0 V, without residual strain."""
        self._lagging = 0.0
        self._motion = float(self._mapped(self._follow(np.zeros(2)))[0]), 0.0
        self._now = 0.0
        self._sent = np.array([self.delay]), np.zeros(1)
        self._clock = Clock()

    def _moved(self, v: Array, time: ArrayLike | None) -> Array:
        """Move at the `time`, which is required."""
        at = self._now + np.cumsum(self._clock.steps(time, v.size, "swings"))
        grid, u = self._delayed(at, v / self.highest)
        y = self._respond(grid, self._mapped(self._follow(u)))[np.searchsorted(grid, at)]
        self._now = float(at[-1])
        return y

    def _delayed(self, at: Array, u: Array) -> tuple[Array, Array]:
        """Return times from now to the last of `at`, and the delayed voltage at them, in small steps of voltage."""
        when, sent = (np.concatenate(pair) for pair in zip(self._sent, (at + self.delay, u), strict=True))
        knots = np.union1d(np.concatenate([[self._now], at]), when[(when > self._now) & (when < at[-1])])
        level = np.interp(knots, when, sent)
        parts = np.maximum(1, np.ceil(np.abs(np.diff(level)) / _FINEST)).astype(int)
        index = np.arange(parts.size).repeat(parts)
        part = (np.arange(index.size) - (np.cumsum(parts) - parts)[index] + 1) / parts[index]
        whole = part == 1
        times = np.where(whole, knots[1:][index], knots[index] + part * np.diff(knots)[index])
        levels = np.where(whole, level[1:][index], level[index] + part * np.diff(level)[index])
        # Voltages that have not arrived yet, and the last that has.
        first = max(0, int(np.searchsorted(when, at[-1], side="right")) - 1)
        self._sent = when[first:], sent[first:]
        return np.concatenate([knots[:1], times]), np.concatenate([level[:1], levels])

    def _follow(self, u: Array) -> Array:
        """Return w (n,) along a path of voltages (n,) that begins where the last path ended."""
        z, steps = self._lagging, np.diff(u).tolist()
        states = [z]
        for h in steps:
            a = self._rate(z, h)
            b = self._rate(z + 0.5 * h * a, h)
            c = self._rate(z + 0.5 * h * b, h)
            z += h / 6 * (a + 2 * b + 2 * c + self._rate(z + h * c, h))
            states.append(z)
        self._lagging = z
        low, high = self._ends
        return np.asarray((u - np.array(states) - low) / (high - low))

    def _rate(self, z: float, h: float) -> float:
        forward = self.closing if z * h > 0 else -self.closing
        return self.slope * (1 - float(abs(z / self.lag) ** self.power) * (forward + 1 - self.closing))

    def _mapped(self, w: Array) -> Array:
        return self.stroke * cubic_map(w, self.asymmetry, self.bend)

    def _respond(self, times: Array, target: Array) -> Array:
        """Return the displacement (n,) at the times, exact if `target` is linear between them."""
        omega, zeta = 2 * np.pi * self.resonance, self.damping
        steps = np.diff(times)
        damped = omega * np.sqrt(1 - zeta**2)
        decay = np.exp(-zeta * omega * steps)
        sine, cosine = decay * np.sin(damped * steps) / damped, decay * np.cos(damped * steps)
        speed = np.diff(target) / steps
        y, rate = self._motion
        displacement = [y]
        lag = 2 * zeta / omega
        for c, s, v, a, b in zip(*(x.tolist() for x in (cosine, sine, speed, target[:-1], target[1:])), strict=True):
            e, f = y - a + lag * v, rate - v
            y = b - lag * v + e * (c + zeta * omega * s) + f * s
            rate = v + f * (c - zeta * omega * s) - e * omega**2 * s
            displacement.append(y)
        self._motion = y, rate
        return np.array(displacement)
