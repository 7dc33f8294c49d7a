"""Mechanisms made after the factors of the promise were last changed, to measure it once; see `strangers.truths`."""

from __future__ import annotations

import numpy as np

from strangers.truths import Array, Truth


class RandomField:
    """Spins in a random field that pull each other: one that turns helps the others, and so they turn in avalanches."""

    coupling, reversible = 0.16, 0.6

    def __init__(self, count: int = 4000) -> None:
        rng = np.random.default_rng(97)
        self.field = np.concatenate([rng.normal(0.42, 0.2, 3 * count // 4), rng.normal(0.7, 0.1, count // 4)])
        self.half = rng.gamma(3.0, 0.025, self.field.size)
        self.up = np.zeros(self.field.size, dtype=bool)

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; time does not matter."""
        share = np.empty(u.size)
        for t, now in enumerate(u.tolist()):
            before = -1
            while before != (count := int(np.count_nonzero(self.up))):
                before, pull = count, now + self.coupling * (count / self.up.size - 0.5)
                self.up = (self.up | (pull >= self.field + self.half)) & ~(pull <= self.field - self.half)
            share[t] = count / self.up.size
        return self.reversible * (u + 0.08 * u * (1 - u)) + (1 - self.reversible) * share


class Cascade:
    """Friction behind friction: plays of what a first stage with play, a bent lever and a leak passes on."""

    def __init__(self) -> None:
        self.first, self.second = np.zeros(4), np.zeros(5)
        self.width_1, self.width_2 = np.array([0.015, 0.05, 0.12, 0.24]), np.array([0.01, 0.04, 0.09, 0.16, 0.3])
        self.share_1, self.share_2 = np.array([0.2, 0.15, 0.12, 0.08]), np.array([0.1, 0.12, 0.1, 0.08, 0.06])
        self.leaked = 0.0

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; steps of time count in periods."""
        reached = np.empty(u.size)
        for t, (now, step) in enumerate(zip(u.tolist(), steps.tolist(), strict=True)):
            self.first = np.clip(self.first, now - self.width_1, now + self.width_1)
            x = 0.45 * now + float(self.share_1 @ self.first)
            x += 0.15 * x * (x - 1)
            # The leak takes a part of what is passed on, with a time constant that grows with it.
            self.leaked += (x - self.leaked) * (1 - np.exp(-step / (2.0 + 3.0 * abs(x))))
            x += 0.02 * self.leaked
            self.second = np.clip(self.second, x - self.width_2 * (0.6 + 0.5 * x), x + self.width_2 * (0.6 + 0.5 * x))
            reached[t] = 0.54 * x + float(self.share_2 @ self.second)
        return reached


class Softening:
    """Masing's branches of a Ramberg-Osgood law that soften with the work done and harden at rest."""

    exponent, compliance, softening, recovery = 2.3, 0.55, 0.25, 6.0

    def __init__(self) -> None:
        self.branches: list[tuple[float, float]] = []
        self.u, self.x, self.soft, self.way = 0.0, 0.0, 0.0, 1.0

    def strain(self, stress: float) -> float:
        """Return what a change of stress causes."""
        return stress + self.compliance * (1 + self.soft) * np.sign(stress) * abs(stress) ** self.exponent

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; steps of time count in periods."""
        reached = np.empty(u.size)
        for t, (now, step) in enumerate(zip(u.tolist(), steps.tolist(), strict=True)):
            change = now - self.u
            if change * self.way < 0:
                self.branches.append((self.u, self.x))
                self.way = -self.way
            # A branch ends where it meets the point from which the one before it began.
            while len(self.branches) > 1 and self.way * (now - self.branches[-2][0]) >= 0:
                del self.branches[-2:]
            if self.branches:
                origin, at = self.branches[-1]
                self.x = at + 2 * self.strain((now - origin) / 2)
            else:
                self.x = self.strain(now)
            self.soft += self.softening * abs(change) * (1 - self.soft) * 0.2 - self.soft * step / self.recovery * 0.3
            self.soft = min(max(self.soft, 0.0), 0.5)
            self.u = now
            reached[t] = self.x + 0.1 * now**2
        return reached


NEWEST = {
    truth.name: truth
    for truth in (
        Truth("random field", RandomField, 0.0, 130.0, 25e-6, 20.0),
        Truth("cascade", Cascade, -20.0, 120.0, 40e-6, 12.0, parts=frozenset({"creep"})),
        Truth("softening", Softening, 0.0, 150.0, 18e-6, 20.0, parts=frozenset({"creep"})),
    )
}
