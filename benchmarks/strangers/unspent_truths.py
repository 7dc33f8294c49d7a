"""Mechanisms made after the promise had its present numbers, to measure it once; see `strangers.truths`."""

from __future__ import annotations

import numpy as np

from strangers.truths import Array, Truth


class Particles:
    """Particles of one easy axis each, which turn into a minimum of their energy, after Stoner and Wohlfarth."""

    def __init__(self, count: int = 250) -> None:
        rng = np.random.default_rng(515)
        self.axis, self.field = rng.uniform(0.05, 1.3, count), rng.gamma(6.0, 0.05, count)
        self.bias, self.angle = rng.normal(0.5, 0.15, count), np.full(count, np.pi)

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; time does not matter."""
        mean = np.empty(u.size)
        for t, now in enumerate(u.tolist()):
            drive = (now - self.bias) / self.field
            for _ in range(6):
                slope = np.sin(2 * (self.angle - self.axis)) / 2 + drive * np.sin(self.angle)
                bend = np.cos(2 * (self.angle - self.axis)) + drive * np.cos(self.angle)
                self.angle -= np.clip(slope / np.maximum(bend, 0.3), -0.3, 0.3)
            mean[t] = np.cos(self.angle).mean()
        return 0.6 * u + 0.2 * mean


class PowerFlow:
    """Springs whose dashpots flow by a power of their force, in a body with a bent characteristic."""

    def __init__(self) -> None:
        self.scale, self.share = np.geomspace(0.01, 0.25, 10), np.linspace(0.07, 0.03, 10)
        self.strain, self.u = np.zeros(10), 0.0

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; steps of time count in periods."""
        held = np.empty(u.size)
        for t, (now, step) in enumerate(zip(u.tolist(), steps.tolist(), strict=True)):
            self.strain += now - self.u
            # d(strain)/dt = -8 strain (strain / scale)**4, exact while the drive rests.
            self.strain /= (1 + 32 * step * (self.strain / self.scale) ** 4) ** 0.25
            self.u, held[t] = now, self.share @ self.strain
        return u + 0.12 * np.sin(2.5 * u) - held


class Stack:
    """Two materials in a row: relays with soft edges, and walls that the strain of the relays pushes."""

    def __init__(self, count: int = 700) -> None:
        rng = np.random.default_rng(616)
        self.centre, self.half = rng.beta(2.5, 2.0, count), rng.gamma(1.5, 0.06, count)
        self.x, self.wall, self.last = np.zeros(count), 0.0, 0.0

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; time does not matter."""
        reached = np.empty(u.size)
        for t, now in enumerate(u.tolist()):
            up, down = (np.clip((now - self.centre - sign * self.half) / 0.04, 0, 1) for sign in (1, -1))
            self.x = np.clip(self.x, up, down)
            share = float(self.x.mean())
            drive = now + 0.2 * share
            change = drive - self.last
            free = np.tanh(1.6 * drive)
            if (free - self.wall) * change > 0:
                self.wall += (free - self.wall) * -np.expm1(-abs(change) / 0.12)
            self.last, reached[t] = drive, 0.5 * now + 0.25 * share + 0.25 * self.wall
        return reached


UNSPENT = {
    truth.name: truth
    for truth in (
        Truth("particles", Particles, 0.0, 100.0, 20e-6, 14.0),
        Truth("power flow", PowerFlow, 0.0, 120.0, 11e-6, 10.0, parts=frozenset({"creep"})),
        Truth("stack", Stack, -20.0, 100.0, 33e-6, 18.0),
    )
}
