"""Mechanisms made after the promise was finished, to measure it once more; see `strangers.truths`."""

from __future__ import annotations

import numpy as np

from strangers.truths import Array, Truth


class ElasticLine:
    """A domain wall: segments coupled by elasticity, each pinned by friction that depends on where it is.

    A segment is pulled by the field and by its neighbours, and moves as far as the rest exceeds the friction there.
    """

    coupling, reversible = 0.35, 0.62

    def __init__(self, count: int = 80) -> None:
        rng = np.random.default_rng(71)
        self.mean = rng.lognormal(np.log(0.09), 0.7, count)
        self.phase, self.depth = rng.uniform(0, 2 * np.pi, (3, count)), rng.uniform(0.1, 0.35, (3, count))
        self.place, self.u = np.zeros(count), 0.0

    def friction(self) -> Array:
        """Return the friction of each segment at its place."""
        waves = [np.sin((5 + 4 * k) * self.place + self.phase[k]) for k in range(3)]
        return self.mean * (1 + sum(depth * wave for depth, wave in zip(self.depth, waves, strict=True)))

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; time does not matter."""
        mean = np.empty(u.size)
        for t, now in enumerate(u.tolist()):
            parts = max(1, round(abs(now - self.u) / 0.01))
            for k in range(1, parts + 1):
                field = self.u + (now - self.u) * k / parts
                for _ in range(2):
                    pull = np.roll(self.place, 1) + np.roll(self.place, -1) - 2 * self.place
                    force = field - self.place + self.coupling * pull
                    over = np.abs(force) - self.friction()
                    self.place += np.where(over > 0, np.sign(force) * over / (1 + 2 * self.coupling), 0.0)
            self.u = now
            mean[t] = self.place.mean()
        return self.reversible * (u + 0.12 * u * (u - 1)) + (1 - self.reversible) * mean


class Dahl:
    """Dahl's friction with an exponent, stiffer on the way up, behind a fractional solid that creeps."""

    order, amount = 0.12, 0.05

    def __init__(self) -> None:
        self.z, self.u = np.zeros(3), 0.0
        self.rate, self.share = np.array([30.0, 9.0, 3.0]), np.array([0.25, 0.5, 0.9]) * 0.045
        self.tau = np.geomspace(3e-3, 300, 10)
        self.part = self.tau**self.order / (self.tau**self.order).sum()
        self.strain, self.last = np.zeros(10), 0.0

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; steps of time count in periods."""
        reached = np.empty(u.size)
        for t, (now, step) in enumerate(zip(u.tolist(), steps.tolist(), strict=True)):
            parts = max(1, round(abs(now - self.u) / 0.003))
            change = (now - self.u) / parts
            for _ in range(parts):
                side = 1 - np.sign(change) * self.z
                rate = self.rate * (1.1 if change > 0 else 0.95)
                self.z = np.clip(self.z + rate * change * np.abs(side) ** 1.6, -1.0, 1.0)
            self.u = now
            x = now + 0.18 * now * (now - 1) - float(self.share @ self.z)
            decay = np.exp(-step / self.tau)
            self.strain = decay * self.strain + (1 - decay) * 0.5 * (x + self.last)
            self.last = x
            reached[t] = x + self.amount * float(self.part @ self.strain)
        return reached


class Accommodating:
    """Preisach's relays whose thresholds move a little with each switching: loops settle over many cycles."""

    learning, reversible = 0.04, 0.58

    def __init__(self, count: int = 3000) -> None:
        rng = np.random.default_rng(83)
        half, centre = rng.weibull(1.3, 5 * count) * 0.13, rng.beta(2.2, 1.8, 5 * count)
        inside = (centre + half < 1.05) & (centre - half > -0.02) & (half > 0.004)
        self.up_at, self.down_at = (centre + half)[inside][:count], (centre - half)[inside][:count]
        self.up, self.first = np.zeros(self.up_at.size, dtype=bool), self.up_at.copy()

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; time does not matter."""
        share = np.empty(u.size)
        for t, now in enumerate(u.tolist()):
            rises, falls = ~self.up & (self.up_at <= now), self.up & (self.down_at >= now)
            self.up = (self.up | rises) & ~falls
            # A relay that has just risen rises a little earlier the next time, down to a limit.
            self.up_at = np.where(rises, np.maximum(self.up_at - self.learning * 0.1, self.first - 0.03), self.up_at)
            self.up_at = np.maximum(self.up_at, self.down_at + 0.004)
            share[t] = np.count_nonzero(self.up)
        return self.reversible * (u + 0.1 * u * (1 - u)) + (1 - self.reversible) * share / self.up.size


LAST = {
    truth.name: truth
    for truth in (
        Truth("line", ElasticLine, 0.0, 120.0, 20e-6, 20.0),
        Truth("dahl", Dahl, -10.0, 150.0, 35e-6, 15.0, parts=frozenset({"creep"})),
        Truth("accommodating", Accommodating, 0.0, 100.0, 12e-6, 20.0),
    )
}
