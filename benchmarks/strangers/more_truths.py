"""Further mechanisms, for the calibration of the promise; see `strangers.truths`."""

from __future__ import annotations

from math import exp

import numpy as np

from strangers.truths import Array, Truth


class Switching:
    """Ferroelectric units that switch by thermal activation, so that faster loops are wider and a hold creeps.

    A unit relaxes to the side of its field at the rate ``exp((|field| - coercive) / width)`` a period.
    """

    width, shift, reversible = 0.012, 0.25, 0.72

    def __init__(self, count: int = 500) -> None:
        rng = np.random.default_rng(31)
        self.coercive = rng.lognormal(np.log(0.10), 0.6, count)
        self.bias = rng.normal(0.5, self.shift, count)
        self.side = np.full(count, -1.0)
        self.u = 0.0

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; steps of time count in periods."""
        mean = np.empty(u.size)
        for t, (now, step) in enumerate(zip(u.tolist(), steps.tolist(), strict=True)):
            # Within a sample the field is that of its end; long steps of much change are divided.
            parts = max(1, round(abs(now - self.u) / 0.01))
            for k in range(1, parts + 1):
                field = self.u + (now - self.u) * k / parts - self.bias
                rate = np.exp(np.minimum((np.abs(field) - self.coercive) / self.width, 40.0))
                self.side += (np.sign(field) - self.side) * -np.expm1(-rate * step / parts)
            self.u = now
            mean[t] = self.side.mean()
        return self.reversible * (u + 0.15 * u * (u - 1)) + (1 - self.reversible) * 0.5 * (1 + mean)


class Envelopes:
    """Plays with different curves for rising and falling voltages, and a creep of fractional order behind them.

    Al Janaideh's generalised plays: ``z = max(rising(u) - r, min(falling(u) + r, z))``. The creep is ``t^order``, by
    twelve Kelvin-Voigt elements from a hundredth of a period to a thousand periods.
    """

    order, amount = 0.18, 0.035

    def __init__(self, count: int = 60) -> None:
        self.radius = np.geomspace(0.004, 0.42, count)
        self.weight = 1.5 * np.exp(-5 * self.radius) * np.gradient(self.radius)
        self.z = np.zeros(count)
        self.tau = np.geomspace(1e-2, 1e3, 12)
        self.share = self.tau**self.order / (self.tau**self.order).sum()
        self.strain, self.last = np.zeros(12), 0.0

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; steps of time count in periods."""
        reached = np.empty(u.size)
        rising, falling = np.tanh(1.6 * u - 0.15), 0.93 * np.tanh(1.35 * u + 0.05) + 0.02 * u
        for t, step in enumerate(steps.tolist()):
            self.z = np.maximum(rising[t] - self.radius, np.minimum(falling[t] + self.radius, self.z))
            x = 0.55 * u[t] + float(self.weight @ self.z)
            decay = np.exp(-step / self.tau)
            ramp = -np.expm1(-step / self.tau) * self.tau / step
            self.strain = decay * self.strain + (ramp - decay) * self.last + (1 - ramp) * x
            self.last = x
            reached[t] = x + 5 * self.amount * float(self.share @ self.strain)
        return reached


class Pinched:
    """Bouc and Wen's differential equation with an exponent, asymmetric, with a loop that is narrow in its middle."""

    exponent, shares = 1.4, ((0.02, 14.0), (0.06, 5.0))

    def __init__(self) -> None:
        self.z, self.u = [0.0, 0.0], 0.0

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; time does not matter."""
        held = np.empty(u.size)
        for t, now in enumerate(u.tolist()):
            parts = max(1, round(abs(now - self.u) / 0.002))
            change = (now - self.u) / parts
            for k in range(parts):
                at = self.u + (k + 0.5) * change
                for j, (_, rate) in enumerate(self.shares):
                    z, pinch = self.z[j], 1 - 0.45 * exp(-(((at - 0.45) / 0.18) ** 2))
                    strength = rate * (1.15 if change > 0 else 0.85)
                    z += change * strength * pinch - abs(change) * rate * abs(z) ** (self.exponent - 1) * z
                    self.z[j] = z
            self.u = now
            held[t] = sum(share * z for (share, _), z in zip(self.shares, self.z, strict=True))
        return u + 0.2 * u * (u - 1) - held


class Hodgdon:
    """Coleman and Hodgdon's equation, ``dx = alpha |du| (f(u) - x) + g(u) du``, with another alpha downward."""

    def __init__(self) -> None:
        self.x, self.u = self.curve(0.0), 0.0

    @staticmethod
    def curve(u: float) -> float:
        """f: bent, steeper in the middle."""
        return 1.15 * u + 0.12 * float(np.tanh(6 * (u - 0.5)))

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; time does not matter."""
        reached = np.empty(u.size)
        for t, now in enumerate(u.tolist()):
            parts = max(1, round(abs(now - self.u) / 0.004))
            change = (now - self.u) / parts
            for k in range(parts):
                at = self.u + (k + 0.5) * change
                alpha = 4.0 if change > 0 else 3.2
                slope = 0.78 + 0.12 * exp(-(((at - 0.5) / 0.25) ** 2))
                self.x += alpha * abs(change) * (self.curve(at) - self.x) + slope * change
            self.u = now
            reached[t] = self.x
        return reached


class Moving:
    """Preisach's relays in a field that the displacement itself feeds back, so that minor loops are not congruent."""

    feedback, reversible = 0.18, 0.55

    def __init__(self, count: int = 4000) -> None:
        rng = np.random.default_rng(47)
        half = rng.lognormal(np.log(0.07), 0.7, 4 * count)
        centre = rng.normal(0.58, 0.2, half.size)
        inside = (centre + half < 1.12) & (centre - half > 0.02)
        self.up_at, self.down_at = (centre + half)[inside][:count], (centre - half)[inside][:count]
        self.up = np.zeros(self.up_at.size, dtype=bool)

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; time does not matter."""
        share = np.empty(u.size)
        level = float(self.up.mean())
        for t, now in enumerate(u.tolist()):
            for _ in range(3):
                field = now + self.feedback * (level - 0.5)
                self.up |= self.up_at <= field
                self.up &= self.down_at < field
                level = float(self.up.mean())
            share[t] = level
        return self.reversible * (u + 0.08 * u * (1 - u)) + (1 - self.reversible) * share


MORE = {
    truth.name: truth
    for truth in (
        Truth("switching", Switching, 0.0, 120.0, 18e-6, 20.0, parts=frozenset({"creep"})),
        Truth("envelopes", Envelopes, -20.0, 100.0, 24e-6, 10.0, parts=frozenset({"creep"})),
        Truth("pinched", Pinched, 0.0, 100.0, 12e-6, 20.0),
        Truth("hodgdon", Hodgdon, -60.0, 60.0, 40e-6, 20.0),
        Truth("moving", Moving, 0.0, 150.0, 100e-6, 20.0),
    )
}


class Wells:
    """Dipoles in double wells, after Landau, each with a field of its own, that follow with a viscosity.

    ``dp = (field + p - p^3 / well^2) step / viscosity``, in steps of time so small that p moves by little.
    """

    viscosity, reversible = 0.004, 0.7

    def __init__(self, count: int = 240) -> None:
        rng = np.random.default_rng(59)
        self.depth = rng.lognormal(np.log(0.16), 0.55, count)
        self.bias = rng.normal(0.52, 0.22, count)
        self.p, self.u = np.full(count, -1.0), 0.0

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; steps of time count in periods."""
        mean = np.empty(u.size)
        for t, (now, step) in enumerate(zip(u.tolist(), steps.tolist(), strict=True)):
            parts = int(min(max(4, np.ceil(step / (0.15 * self.viscosity))), 400))
            pace = min(step / parts / self.viscosity, 0.2)
            for k in range(1, parts + 1):
                field = (self.u + (now - self.u) * k / parts - self.bias) / self.depth
                self.p = np.clip(self.p + pace * (field + 2.6 * (self.p - self.p**3)), -1.6, 1.6)
            self.u = now
            mean[t] = self.p.mean()
        return self.reversible * (u + 0.1 * u * (1 - u)) + (1 - self.reversible) * 0.5 * (1 + mean)


class Ageing:
    """Slip elements whose contacts strengthen with the logarithm of the time at rest, and wear in while they slide."""

    rate, memory = 0.06, 0.03

    def __init__(self, count: int = 40) -> None:
        self.force = np.geomspace(0.006, 0.4, count)
        self.weight = 1.9 * np.exp(-4.5 * self.force) * np.gradient(self.force)
        self.held, self.rested, self.u = np.zeros(count), np.full(count, 1e-3), 0.0

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; steps of time count in periods."""
        reached = np.empty(u.size)
        for t, (now, step) in enumerate(zip(u.tolist(), steps.tolist(), strict=True)):
            strength = self.force * (1 + self.rate * np.log1p(self.rested / 1e-3) / 7)
            stretched = now - self.held
            slips = np.abs(stretched) > strength
            slid = np.where(slips, np.abs(stretched) - strength, 0.0)
            self.held = np.where(slips, now - np.sign(stretched) * strength, self.held)
            self.rested = np.where(slips, self.rested * np.exp(-slid / self.memory), self.rested + step) + 1e-6
            self.u = now
            reached[t] = 0.6 * now + 0.05 * now**2 + float(self.weight @ self.held)
        return reached


class Branches:
    """Takacs' hyperbolic branches, each from the last turning point to the end of the range: no loop is wiped out.

    A branch closes on the major loop at the rate of its own length, whatever happened before its turning point.
    """

    width, steepness = 0.085, 2.1

    def __init__(self) -> None:
        self.u, self.y, self.turn, self.way = 0.0, self.major(0.0, -1.0), (0.0, self.major(0.0, -1.0)), -1.0

    @classmethod
    def major(cls, u: float, way: float) -> float:
        """Return the major loop, rising or falling, wider at high voltages and closed at both ends."""
        open_ = cls.width * (1 - (2 * u - 1) ** 2) * (0.8 + 0.5 * u)
        return 0.5 + 0.5 * float(np.tanh(cls.steepness * (u - 0.5)) / np.tanh(0.5 * cls.steepness)) - way * open_

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; time does not matter."""
        reached = np.empty(u.size)
        for t, now in enumerate(u.tolist()):
            way = float(np.sign(now - self.u)) or self.way
            if way != self.way:
                self.way, self.turn = way, (self.u, self.y)
            begun, from_ = self.turn
            gap = from_ - self.major(begun, way)
            left = max((1.0 - now) / max(1.0 - begun, 1e-9) if way > 0 else now / max(begun, 1e-9), 0.0)
            self.u, self.y = now, self.major(now, way) + gap * left**2.2
            reached[t] = self.y
        return reached


# Mechanisms that had no part in finding the factors of the promise.
UNSEEN = {
    truth.name: truth
    for truth in (
        Truth("wells", Wells, 0.0, 100.0, 15e-6, 20.0, parts=frozenset({"creep"})),
        Truth("ageing", Ageing, -30.0, 150.0, 60e-6, 10.0, parts=frozenset({"creep"})),
        Truth("branches", Branches, 0.0, 60.0, 9e-6, 20.0),
    )
}
