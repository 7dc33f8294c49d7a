"""Mechanisms made to measure the promise once, and then among those on which it is found; see `strangers.truths`."""

from __future__ import annotations

import numpy as np

from strangers.truths import Array, Truth


class RatePlays:
    """Plays that become wider with speed, behind a curved lever: rate-dependent Prandtl-Ishlinskii."""

    def __init__(self, count: int = 30) -> None:
        self.width, self.z = np.geomspace(0.006, 0.4, count), np.zeros(count)
        self.share = np.exp(-4 * self.width) * np.gradient(self.width)
        self.u = 0.0

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; steps of time count in periods."""
        reached = np.empty(u.size)
        for t, (now, step) in enumerate(zip(u.tolist(), steps.tolist(), strict=True)):
            width = self.width * (1 + 0.12 * np.log1p(abs(now - self.u) / step))
            self.z, self.u = np.clip(self.z, now - width, now + width), now
            x = 0.5 * now + 1.3 * float(self.share @ self.z)
            reached[t] = x + 0.1 * x * (1 - x) * (1.7 - x)
        return reached


class Kernels:
    """Krasnosel'skii and Pokrovskii's kernels: relays that go up and down along ramps of finite width, and leak."""

    ramp, leak = 0.13, 0.004

    def __init__(self, count: int = 900) -> None:
        rng = np.random.default_rng(404)
        low, wide = rng.beta(2.0, 2.6, count) - 0.15, rng.gamma(1.8, 0.05, count)
        self.down, self.up = low, low + wide
        self.z = np.zeros(count)

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; steps of time count in periods."""
        mean = np.empty(u.size)
        for t, (now, step) in enumerate(zip(u.tolist(), steps.tolist(), strict=True)):
            least, most = ((now - edge) / self.ramp for edge in (self.up, self.down))
            self.z = np.clip(np.clip(self.z, least, most), 0, 1)
            # Where neither ramp holds a kernel, thermal agitation moves it towards the middle of both.
            middle = np.clip(0.5 * (least + most), 0, 1)
            self.z += (middle - self.z) * -np.expm1(-self.leak * step)
            mean[t] = self.z.mean()
        return 0.55 * (u - 0.06 * np.sin(3 * u)) + 0.45 * mean


class SelfHeating:
    """Friction elements in a body that its own losses warm: gain and friction follow the work of the last minutes."""

    warming, cooling = 0.45, 6.0

    def __init__(self) -> None:
        self.reach = np.array([0.012, 0.03, 0.07, 0.15, 0.3])
        self.stiff = np.array([0.1, 0.14, 0.14, 0.1, 0.08])
        self.z, self.u, self.heat = np.zeros(5), 0.0, 0.0

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; steps of time count in periods."""
        reached = np.empty(u.size)
        for t, (now, step) in enumerate(zip(u.tolist(), steps.tolist(), strict=True)):
            free, limit = self.z + now - self.u, self.reach * (1 - 0.25 * self.heat)
            self.z = np.clip(free, -limit, limit)
            lost = float(self.stiff @ np.abs(free - self.z)) * 0.1
            self.heat += self.warming * lost * (1 - self.heat) - self.heat * -np.expm1(-step / self.cooling)
            self.u = now
            reached[t] = (now + 0.05 * now**2) * (1 + 0.01 * self.heat) - float(self.stiff @ self.z)
        return reached


class PolarGrains:
    """Grains at random angles that switch by 180 and by 90 degrees at their own fields, clamped by their neighbours."""

    def __init__(self, count: int = 1500) -> None:
        rng = np.random.default_rng(77)
        self.gain = np.cos(rng.uniform(0, 1.3, count))
        self.coercive = rng.gamma(3.0, 0.035, count)
        self.bias = rng.normal(0.45, 0.22, count)
        self.mean, self.side = 0.0, np.zeros(count)

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; time does not matter."""
        mean = np.empty(u.size)
        for t, now in enumerate(u.tolist()):
            for _ in range(2):
                field = (now - 0.12 * (self.mean - 0.4) - self.bias) * self.gain
                # Between its two fields a grain keeps its side; beyond them it turns within a fifth of its field.
                low, high = ((field + sign * self.coercive) / (0.2 * self.coercive) for sign in (-1, 1))
                self.side = np.clip(self.side, np.clip(low, 0, 1), np.clip(high, 0, 1))
                self.mean = float(np.average(self.side, weights=self.gain))
            mean[t] = self.mean
        return 0.62 * u + 0.03 * u**3 + 0.35 * mean


MADE = {
    truth.name: truth
    for truth in (
        Truth("rate plays", RatePlays, 0.0, 120.0, 22e-6, 10.0),
        Truth("kernels", Kernels, -30.0, 130.0, 30e-6, 15.0, parts=frozenset({"creep"})),
        Truth("self-heating", SelfHeating, 0.0, 150.0, 16e-6, 8.0, parts=frozenset({"creep"})),
        Truth("grains", PolarGrains, 0.0, 100.0, 12e-6, 20.0),
    )
}
