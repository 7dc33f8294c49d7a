"""Actuators by mechanisms that neither the models nor the package's virtual actuators use.

Each works on u, the voltage as a part of its range (0 at the lowest, 1 at the highest), and returns parts of the
stroke; it keeps its state from one call to the next. Voltages are linear between samples.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import cos, exp, pi, sin, sqrt, tanh
from typing import Protocol

import numpy as np

Array = np.ndarray


class Mechanism(Protocol):
    """What makes the displacement: parts of the range in, about parts of the stroke out."""

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement (n,) for u (n,), each sample `steps` (n,) periods after the one before."""
        ...


class Relays:
    """Preisach's relays, thousands of them, drawn from an asymmetric density with two peaks.

    A relay goes up at u = centre + half and down at centre - half. The larger peak has narrow relays at low voltages,
    the smaller one wide relays at high voltages.
    """

    def __init__(self, count: int = 6000, reversible: float = 0.6) -> None:
        rng = np.random.default_rng(20)
        kinds = rng.random(4 * count) < 0.62
        centre = np.where(kinds, rng.normal(0.33, 0.16, kinds.size), rng.normal(0.70, 0.12, kinds.size))
        half = np.where(kinds, rng.gamma(2.0, 0.04, kinds.size), rng.gamma(6.0, 0.03, kinds.size))
        inside = (centre + half < 1) & (centre - half > 0)
        self.up_at, self.down_at = (centre + half)[inside][:count], (centre - half)[inside][:count]
        self.up = np.zeros(self.up_at.size, dtype=bool)
        self.reversible = reversible

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; time does not matter."""
        share = np.empty(u.size)
        for t, now in enumerate(u.tolist()):
            self.up |= self.up_at <= now
            self.up &= self.down_at < now
            share[t] = np.count_nonzero(self.up)
        return self.reversible * (u + 0.1 * u * (u - 1)) + (1 - self.reversible) * share / self.up.size


class Domains:
    """Populations of domain walls that approach the anhysteretic curve, after Jiles and Atherton.

    ``dm/dh = (anhysteretic(h) - m) / pinning`` while the field moves towards the anhysteretic state, 0 otherwise: no
    susceptibility is negative, and minor loops close only after many cycles.
    """

    pinning = (0.05, 0.14, 0.35)
    share = (0.4, 0.35, 0.25)
    coupling, bias, width, reversible = 0.06, 0.2, 0.9, 0.5
    finest = 0.01

    def __init__(self) -> None:
        self.field = 0.0
        self.walls = [tanh(self.bias / self.width)] * len(self.pinning)

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; time does not matter."""
        mean = np.empty(u.size)
        for t, target in enumerate((2 * u - 1).tolist()):
            self._move(target)
            mean[t] = sum(s * m for s, m in zip(self.share, self.walls, strict=True))
        return self.reversible * u + (1 - self.reversible) * 0.5 * (1 + mean)

    def _move(self, target: float) -> None:
        count = max(1, round(abs(target - self.field) / self.finest))
        step = (target - self.field) / count
        for _ in range(count):
            mean = sum(s * m for s, m in zip(self.share, self.walls, strict=True))
            free = tanh((self.field + 0.5 * step + self.coupling * mean + self.bias) / self.width)
            for j, pinning in enumerate(self.pinning):
                gap = free - self.walls[j]
                if gap * step > 0:
                    self.walls[j] += gap * (1 - exp(-abs(step) / pinning))
            self.field += step


class StribeckSlip:
    """Generalised Maxwell slip whose friction depends on place, direction and speed, so that Masing's rule fails.

    Friction falls with speed, as Stribeck measured, and does so over a slip length, as rate-and-state friction does.
    """

    length = 0.02

    def __init__(self, count: int = 10) -> None:
        self.friction = 0.30 * np.geomspace(0.008, 0.45, count) * np.linspace(1.0, 0.35, count) / 3
        self.stiffness = self.friction / np.geomspace(0.008, 0.45, count)
        self.force = np.zeros(count)
        self.speed_factor, self.u = 1.2, 0.0

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; steps of time count in periods."""
        held = np.empty(u.size)
        for t, (now, step) in enumerate(zip(u.tolist(), steps.tolist(), strict=True)):
            change = now - self.u
            wanted = 1 + 0.25 * exp(-abs(change) / step / 4)
            self.speed_factor += (wanted - self.speed_factor) * (1 - exp(-abs(change) / self.length))
            most = self.friction * (self.speed_factor * (1.15 + 0.5 * now))
            least = -self.friction * (self.speed_factor * (0.95 - 0.3 * now))
            self.force = np.clip(self.force + self.stiffness * change, least, most)
            held[t] = self.force.sum()
            self.u = now
        return u + 0.15 * u * (u - 1) - held


class Rayleigh:
    """Rayleigh's parabolic branches, steeper at high voltages, with wiping out; creeping, after Kelvin and Voigt.

    A branch of length d about the middle s rises by the integral of the density ``1 + bend s + curve s^2`` over its
    triangle. Each creep element follows ``tau c' = compliance x - c``.
    """

    bend, curve, strength, reversible = 0.9, -0.6, 0.34, 0.75
    compliance, tau = (0.012, 0.015, 0.02), (0.02, 0.2, 2.0)

    def __init__(self) -> None:
        self.turns: list[tuple[float, float]] = [(0.0, 0.0), (0.0, 0.0)]
        self.creep = [0.0] * len(self.tau)
        self.last = 0.0

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; steps of time count in periods."""
        walls = np.array([self._walls(now) for now in u.tolist()])
        x = self.reversible * u + 0.1 * u * (u - 1) + self.strength * walls
        return x + self._crept(x, steps)

    def _walls(self, now: float) -> float:
        turns, present = self.turns, self.turns[-1][0]
        if now == present:
            return turns[-1][1]
        rising = now > present
        if (turns[-1][0] > turns[-2][0]) != rising or (len(turns) == 2 and turns[0] == turns[1]):
            turns.append(turns[-1])
        # Passing the last but one turn of this direction wipes a loop out.
        while len(turns) > 3 and (now >= turns[-3][0] if rising else now <= turns[-3][0]):
            del turns[-3:-1]
        start, level = turns[-2]
        turns[-1] = (now, level + (1 if rising else -1) * self._triangle(min(start, now), max(start, now)))
        return turns[-1][1]

    def _triangle(self, low: float, high: float) -> float:
        total, d = 0.0, high - low
        for node, weight in ((0.1127016654, 5 / 18), (0.5, 8 / 18), (0.8872983346, 5 / 18)):
            a, b = low + 0.5 * node * d, high - 0.5 * node * d
            total += weight * ((b - a) + self.bend / 2 * (b**2 - a**2) + self.curve / 3 * (b**3 - a**3))
        return total * d

    def _crept(self, x: Array, steps: Array) -> Array:
        before = np.concatenate([[self.last], x[:-1]])
        total = np.zeros(x.size)
        for j, (tau, compliance) in enumerate(zip(self.tau, self.compliance, strict=True)):
            decay = np.exp(-steps / tau)
            ramp = (1 - decay) * tau / steps
            pushed = compliance * ((ramp - decay) * before + (1 - ramp) * x)
            strain, strains = self.creep[j], []
            for keep, push in zip(decay.tolist(), pushed.tolist(), strict=True):
                strain = keep * strain + push
                strains.append(strain)
            self.creep[j] = strain
            total += strains
        self.last = float(x[-1])
        return total


class Bristles:
    """Dahl's bristles of four lengths that yield sooner downward, before a lightly damped resonance.

    ``dz/du = 1 - sgn(du) z / length``; ``y'' + 2 zeta omega y' + omega^2 y = omega^2 x``, time in periods.
    """

    lengths, strengths, downward = (0.03, 0.1, 0.3, 0.8), (0.008, 0.016, 0.045, 0.09), 0.75
    frequency, damping = 20.0, 0.05

    def __init__(self) -> None:
        self.bristles, self.u = [0.0] * len(self.lengths), 0.0
        self.motion, self.last = (0.0, 0.0), 0.0

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; steps of time count in periods."""
        held = np.array([self._held(now) for now in u.tolist()])
        return self._swing(u + 0.1 * u * (u - 1) - held, steps)

    def _held(self, now: float) -> float:
        change, self.u = now - self.u, now
        for j, length in enumerate(self.lengths):
            end = length if change > 0 else -self.downward * length
            self.bristles[j] = end + (self.bristles[j] - end) * exp(-abs(change / end))
        return sum(s * z / n for s, z, n in zip(self.strengths, self.bristles, self.lengths, strict=True)) * 0.5

    def _swing(self, x: Array, steps: Array) -> Array:
        omega, zeta = 2 * pi * self.frequency, self.damping
        damped, lag = omega * sqrt(1 - zeta**2), 2 * zeta / omega
        (y, rate), before, reached = self.motion, self.last, []
        for target, step in zip(x.tolist(), steps.tolist(), strict=True):
            decay, speed = exp(-zeta * omega * step), (target - before) / step
            c, s = decay * cos(damped * step), decay * sin(damped * step) / damped
            e, f = y - before + lag * speed, rate - speed
            y = target - lag * speed + e * (c + zeta * omega * s) + f * s
            rate = speed + f * (c - zeta * omega * s) - e * omega**2 * s
            before = target
            reached.append(y)
        self.motion, self.last = (y, rate), before
        return np.array(reached)


@dataclass(frozen=True)
class Truth:
    """An actuator: its mechanism, range of voltages [V], stroke [m] and the period of its slow loops [s].

    `parts` are those that move in time and that it has: "creep" or "resonance". `fast` is by how much its fast loops
    are faster. `own` are the rivals of whose class it is.
    """

    name: str
    mechanism: Callable[[], Mechanism]
    low: float
    high: float
    stroke: float
    period: float
    fast: float = 10.0
    parts: frozenset[str] = frozenset()
    own: tuple[str, ...] = ()


@dataclass(eq=False)
class Bench:
    """A truth at rest at 0 V, and a delay [s] of what drives it; time goes on from one call to the next."""

    truth: Truth
    delay: float = 0.0
    mechanism: Mechanism = field(init=False)
    scale: float = field(init=False, default=1.0)
    sent: tuple[Array, Array] = field(init=False)

    def __post_init__(self) -> None:
        calibrated = self.truth.mechanism()
        cycle = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(1, 801) / 400)
        reached = calibrated.play(cycle, np.full(800, 1 / 400))[400:]
        self.scale = self.truth.stroke / float(np.ptp(reached))
        self.mechanism = self.truth.mechanism()
        # From 0 V at rest to the lowest voltage within a period.
        rest = -self.truth.low / (self.truth.high - self.truth.low)
        self.mechanism.play(np.linspace(0.0, rest, 50), np.full(50, 0.02))
        self.mechanism.play(np.linspace(rest, rest, 50), np.full(50, 10.0))
        self.sent = np.array([-1e-3 * self.truth.period]), np.zeros(1)

    def play(self, time: Array, voltage: Array) -> Array:
        """Return the displacement (n,) [m] that a voltage (n,) [V] at the times (n,) [s] causes."""
        last = self.sent[0][-1]
        times, voltages = np.concatenate([self.sent[0], time]), np.concatenate([self.sent[1], voltage])
        self.sent = times[-400:], voltages[-400:]
        acting = np.interp(time - self.delay, times, voltages) if self.delay else voltage
        steps = np.diff(time, prepend=last) / self.truth.period
        u = (acting - self.truth.low) / (self.truth.high - self.truth.low)
        return self.scale * self.mechanism.play(u, steps)


class VirtualStranger:
    """A mechanism as a virtual actuator: `stroke` [m] at `highest` [V].

    Its steps of time are those of the samples times `rate` [Hz], without one 1 each.
    """

    def __init__(
        self, mechanism: Callable[[], Mechanism], stroke: float, highest: float, rate: float | None = None
    ) -> None:
        self.make, self.stroke, self.highest, self.rate = mechanism, stroke, highest, rate
        self.relax()

    def relax(self) -> None:
        """Begin anew."""
        self.mechanism = self.make()

    def play(self, voltage: Array, *, time: Array, measured: bool = False) -> Array:
        """Return the displacement (n,) [m]; without noise, whatever `measured` is."""
        steps = np.ones(len(voltage)) if self.rate is None else np.r_[1.0, np.diff(time) * self.rate]
        return self.stroke * self.mechanism.play(np.asarray(voltage) / self.highest, steps)


TRUTHS = {
    truth.name: truth
    for truth in (
        Truth("relays", Relays, 0.0, 100.0, 30e-6, 20.0, own=("Preisach", "Preisach, reversal curves")),
        Truth("domains", Domains, -90.0, 90.0, 80e-6, 10.0, own=("Duhem",)),
        Truth("stribeck", StribeckSlip, -20.0, 120.0, 15e-6, 20.0),
        Truth("voigt", Rayleigh, 0.0, 150.0, 9e-6, 20.0, parts=frozenset({"creep"})),
        Truth(
            "bristles",
            Bristles,
            0.0,
            100.0,
            6e-6,
            0.05,
            fast=3.0,
            parts=frozenset({"resonance"}),
            own=("Duhem", "Bouc-Wen"),
        ),
    )
}
