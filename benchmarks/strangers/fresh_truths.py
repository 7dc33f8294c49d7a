"""Mechanisms that showed a bolder promise to be false, then of those on which it is found; see `strangers.truths`."""

from __future__ import annotations

from math import cos, pi

import numpy as np

from strangers.truths import Array, Truth


class VectorPlays:
    """Discs that dry friction holds in a plane, each drawn by a string whose end goes along an arc."""

    def __init__(self) -> None:
        self.width = np.geomspace(0.01, 0.3, 14)
        self.share, self.place = 0.05 * np.exp(-2.5 * self.width), np.zeros((14, 2))

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; time does not matter."""
        along = np.empty(u.size)
        for t, end in enumerate(np.column_stack([u, 0.12 * np.sin(pi * u)])):
            apart = end - self.place
            length = np.maximum(np.hypot(*apart.T), 1e-12)
            self.place += apart * np.maximum(1 - self.width / length, 0)[:, None]
            along[t] = self.share @ self.place[:, 0]
        return 0.6 * u + along


class Landau:
    """Cells of two wells each, of random depth and field, that relax as Landau and Khalatnikov have it."""

    def __init__(self, count: int = 400) -> None:
        rng = np.random.default_rng(909)
        self.depth, self.field = rng.gamma(4.0, 0.08, count), rng.normal(0.5, 0.25, count)
        self.p, self.u = np.full(count, -0.5), 0.0

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; steps of time count in periods."""
        mean = np.empty(u.size)
        for t, (now, step) in enumerate(zip(u.tolist(), steps.tolist(), strict=True)):
            for part in (0.25, 0.5, 0.75, 1.0):
                drive = self.u + part * (now - self.u) - self.field
                for _ in range(3):
                    slope = -self.depth + 3 * self.depth * self.p**2 + 0.02 + 0.004 / (0.25 * min(step, 10.0))
                    force = drive + self.depth * self.p - self.depth * self.p**3 - 0.02 * self.p
                    self.p += np.clip(force / np.maximum(slope, 0.1), -0.2, 0.2)
            self.u, mean[t] = now, self.p.mean()
        return 0.55 * u + 0.1 * mean + 0.02 * mean**2


class Kinetics:
    """Phases that grow along cosines from the fraction at the last turn, after Liang and Rogers."""

    def __init__(self) -> None:
        self.start, self.span = np.linspace(-0.1, 0.55, 9), np.linspace(0.35, 0.5, 9)
        self.back = np.array([0.05, 0.08, 0.1, 0.1, 0.14, 0.12, 0.16, 0.1, 0.2])
        self.now, self.turn, self.u, self.rises = np.zeros(9), np.zeros(9), 0.0, True

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; time does not matter."""
        mean = np.empty(u.size)
        for t, now in enumerate(u.tolist()):
            if now != self.u and (now > self.u) != self.rises:
                self.turn, self.rises = self.now.copy(), now > self.u
            part = np.clip((now - self.start + (0.0 if self.rises else self.back)) / self.span, 0, 1)
            grown = 0.5 - 0.5 * np.cos(pi * part)
            up = np.maximum(self.now, self.turn + (1 - self.turn) * grown)
            self.now = up if self.rises else np.minimum(self.now, self.turn * grown)
            self.u, mean[t] = now, self.now.mean()
        return 0.75 * u + 0.25 * mean


class Eyring:
    """Springs behind dashpots that flow by thermal activation, faster than in proportion to their force."""

    def __init__(self) -> None:
        self.yields, self.rate = np.geomspace(0.004, 0.08, 12), np.geomspace(0.3, 3e-3, 12)
        self.share, self.strain = np.linspace(0.06, 0.03, 12), np.zeros(12)
        self.u = 0.0

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; steps of time count in periods."""
        held = np.empty(u.size)
        for t, (now, step) in enumerate(zip(u.tolist(), steps.tolist(), strict=True)):
            # d(strain)/dt = rate sinh(strain / yields), exact while the drive rests: tanh of the half falls as exp.
            self.strain += now - self.u
            half = np.tanh(0.5 * np.clip(self.strain / self.yields, -30, 30))
            fallen = half * np.exp(-self.rate * step / self.yields)
            self.strain = 2 * self.yields * np.arctanh(np.clip(fallen, -1 + 1e-13, 1 - 1e-13))
            self.u, held[t] = now, self.share @ self.strain
        return 0.9 * u + 0.1 * u**2 - held * (1 + 0.3 * cos(pi * self.u))


FRESH = {
    truth.name: truth
    for truth in (
        Truth("vector plays", VectorPlays, 0.0, 110.0, 14e-6, 12.0),
        Truth("landau", Landau, -20.0, 130.0, 28e-6, 16.0, parts=frozenset({"creep"})),
        Truth("kinetics", Kinetics, 0.0, 90.0, 10e-6, 20.0),
        Truth("eyring", Eyring, -10.0, 140.0, 45e-6, 9.0, parts=frozenset({"creep"})),
    )
}
