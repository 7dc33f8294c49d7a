"""Lag, creep and drift of truths that no model was tuned to: what is found, and how far a path is missed.

``python benchmarks/lags.py [readme] [filters] [creep]`` prints a line for each record and a line of counts for each
question, which takes a few minutes. The mechanisms `Hodgdon` and `Nested` were written after the program was finished.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
from math import exp

import numpy as np
from strangers.cases import Case
from strangers.disturbances import DISTURBANCES, Disturbance, Raw, Scale
from strangers.protocols import PROTOCOLS, Part, Protocol
from strangers.truths import TRUTHS, Bristles, Mechanism, Relays, Truth
from virtual_trials import BoucWenActuator, PreisachActuator

import dehyst
from dehyst.identification import Fit
from dehyst.model import Actuator
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops

Array = np.ndarray
# Of the README's first steps: seconds a cycle, and the lags [s] of its stages.
PERIOD, LAGS = 10.0, (0.0, 0.002, 0.1)
QUIET = DISTURBANCES["none"]


class Hodgdon:
    """A path after Coleman and Hodgdon: ``dw/du = rate (target(u) - w) sgn(du) + slope``."""

    def __init__(self, rate: float = 4.0, bend: float = 0.25, slope: float = 0.45) -> None:
        self.rate, self.bend, self.slope = rate, bend, slope
        self.u, self.w = 0.0, 0.0

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; time does not matter."""
        out = np.empty(u.size)
        for t, now in enumerate(u.tolist()):
            parts = max(1, int(abs(now - self.u) / 0.002))
            step = (now - self.u) / parts
            for _ in range(parts):
                middle = self.u + 0.5 * step
                target = middle + self.bend * middle * (1 - middle)
                gap = (target - self.w) * abs(step) * self.rate
                self.w += gap + self.slope * step
                self.u += step
            out[t] = self.w
        return out


class Nested(Relays):
    """Relays of power-law widths whose share grows with the voltage, beside a cubic reversible part."""

    def __init__(self, power: float = 0.6, growth: float = 1.0, reversible: float = 0.5) -> None:
        rng = np.random.default_rng(77)
        half = 0.5 * rng.random(40_000) ** (1 / power)
        centre = rng.random(40_000) ** (1 / (1 + growth))
        inside = (centre + half < 1) & (centre - half > 0)
        self.up_at, self.down_at = (centre + half)[inside][:12_000], (centre - half)[inside][:12_000]
        self.up = np.zeros(self.up_at.size, dtype=bool)
        self.reversible = reversible

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement; time does not matter."""
        return super().play(u, steps) + 0.15 * u**3


class Virtual:
    """A virtual actuator of the package without time, over the whole range."""

    def __init__(self, kind: Callable[..., PlayActuator | PreisachActuator]) -> None:
        self.actuator = kind(stroke=1.0, highest=1.0, noise=0.0)

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement."""
        return self.actuator.play(u)


class Gradual:
    """Bouc and Wen's variable of the package's virtual actuator, without its resonance."""

    def __init__(self) -> None:
        self.actuator = BoucWenActuator(stroke=1.0, highest=1.0, noise=0.0)

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement."""
        return self.actuator._mapped(self.actuator._follow(u))


class Dahl(Bristles):
    """Bristles without their resonance, beside relays."""

    def __init__(self) -> None:
        super().__init__()
        self.relays = Relays(20_000)

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement."""
        held = np.array([self._held(now) for now in u.tolist()])
        return 0.5 * (u - held) + 0.5 * self.relays.play(u, steps)


class LowPass:
    """A low-pass of first order, exact for what is linear between samples; times count in periods."""

    def __init__(self, tau: float) -> None:
        self.tau, self.before, self.state = tau, 0.0, 0.0

    def play(self, x: Array, steps: Array) -> Array:
        """Return what passes."""
        if not self.tau:
            return x
        out = np.empty(x.size)
        for t, (now, step) in enumerate(zip(x.tolist(), steps.tolist(), strict=True)):
            keep = exp(-step / self.tau)
            ramp = (1 - keep) * self.tau / step
            self.state = keep * self.state + (ramp - keep) * self.before + (1 - ramp) * now
            self.before = out[t] = now
            out[t] = self.state
        return out


class Creeping:
    """A mechanism that creeps behind its hysteresis and follows behind a lag: branches as {time constant: share}."""

    def __init__(self, mechanism: Mechanism, branches: dict[float, float], lag: float) -> None:
        self.mechanism, self.lag = mechanism, LowPass(lag)
        self.branches = [(LowPass(tau), share) for tau, share in branches.items()]

    def play(self, u: Array, steps: Array) -> Array:
        """Return the displacement."""
        y = self.mechanism.play(self.lag.play(u, steps), steps)
        return y + sum(share * one.play(y, steps) for one, share in self.branches)


def logarithmic(decade: float, first: float, last: float) -> dict[float, float]:
    """Return branches of creep by the logarithm of time, from the first to the last time constant [s]."""
    times = np.geomspace(first, last, 15)
    return {float(tau) / PERIOD: decade * np.log10(last / first) / times.size for tau in times}


def creeping(lag: float) -> dict[str, Truth]:
    """Return stages of the README's first steps behind a lag [s]."""
    made = {
        "hodgdon": (Hodgdon, logarithmic(0.015, 0.02, 2000.0)),
        "nested": (Nested, {0.05: 0.012, 0.6: 0.015, 8.0: 0.02}),
        "relays and bristles": (Dahl, logarithmic(0.033, 0.01, 1000.0)),
    }
    return {
        name: Truth(name, lambda k=kind, b=branches: Creeping(k(), b, lag / PERIOD), 0.0, 100.0, 12e-6, PERIOD)
        for name, (kind, branches) in made.items()
    }


def stage(name: str, kind: Callable[[], Mechanism]) -> Truth:
    """Return a truth that does not creep."""
    return Truth(name, kind, 0.0, 100.0, 12e-6, PERIOD)


STILL = [
    *(TRUTHS[name] for name in ("relays", "domains", "stribeck")),
    stage("hodgdon", Hodgdon),
    stage("nested", Nested),
    stage("hodgdon, slim", lambda: Hodgdon(9.0, -0.2, 0.6)),
    stage("nested, wide", lambda: Nested(0.9, 0.3, 0.7)),
    stage("play", lambda: Virtual(PlayActuator)),
    stage("preisach", lambda: Virtual(PreisachActuator)),
    stage("gradual", Gradual),
]
FILTERED, FILTERS = ("relays", "domains", "stribeck", "hodgdon", "nested"), (60, 200)


def filtered(share: int) -> Disturbance:
    """Return a sensor behind a low-pass of this part of a period."""

    def change(raws: list[Raw], scale: Scale, rng: np.random.Generator) -> list[Raw]:
        late = []
        for raw in raws:
            one, y = LowPass(200 * scale.unit / share), raw.displacement
            one.before = one.state = float(y[0])
            steps = np.diff(raw.time, prepend=2 * raw.time[0] - raw.time[1])
            late.append(replace(raw, displacement=one.play(y, steps)))
        return late

    return Disturbance("filter", change, "lag|low-pass")


def first_steps(rng: np.random.Generator, fast: float) -> list[Part]:
    """Return the README's excitation."""
    drive = Sampling(frequency=1 / PERIOD, sample_rate=40.0, limits=(0.0, 100.0), slew_rate=50.0)
    return [Part(descending_tops(100, steps=5, drive=drive).voltage / 100)]


def identified(case: Case, **options: float) -> tuple[Fit, Actuator, dict[str, float]]:
    """Return fit, actuator and tracking errors of a case."""
    experiment = case.experiment()
    fit = dehyst.identify(experiment.records, **options)
    return fit, fit.actuator, experiment.track(fit.actuator)


def parts(fit: Fit, actuator: Actuator) -> str:
    """Return what moves in time, and what is promised, as words."""
    drift = max(abs(error.drifted_percent) for error in fit.errors)
    expected = fit.promise
    promise = f"{expected.largest_percent:.2f}/{100 * expected.rms / expected.stroke:.3f}"
    both = f" delay {1e3 * actuator.delay:.1f} lag {1e3 * actuator.lag:.1f} ms"
    return f"{both}, creep {actuator.displacement_creep is not None}, drift {drift:.2f} %, promised {promise}"


def readme() -> Iterator[tuple[bool, str]]:
    """Yield whether the lag is found within 20 % or 5 ms and the path followed as with the right delay given."""
    protocol = Protocol("first steps", first_steps, 400)
    for lag in LAGS:
        for name, truth in creeping(lag).items():
            case = Case(truth, protocol, QUIET, 5)
            fit, actuator, reached = identified(case)
            right = identified(case, delay=lag)[2]
            total = actuator.delay + actuator.lag
            near = abs(total - lag) <= max(0.2 * lag, 0.005)
            numbers = ", ".join(f"{one['largest']:.2f}/{one['rms']:.3f}" for one in (reached, right))
            good = near and reached["rms"] <= 1.02 * right["rms"]
            yield (
                good,
                f"{name} behind {1e3 * lag:g} ms: {parts(fit, actuator)}; reached, and with the lag given {numbers}",
            )


def filters() -> Iterator[tuple[bool, str]]:
    """Yield whether a sensor's low-pass is named and makes no creep."""
    for truth in (one for one in STILL if one.name in FILTERED):
        for protocol in ("tops", "growing", "curves", "random"):
            for share in FILTERS:
                fit, actuator, reached = identified(Case(truth, PROTOCOLS[protocol], filtered(share), 5))
                named = any("low-pass" in words for words in (*fit.repairs, *fit.remarks))
                sensed = f"{reached['sensed_largest']:.2f}/{reached['sensed_rms']:.3f}"
                words = f"{truth.name} {protocol}, {1e3 * truth.period / share:.0f} ms:{parts(fit, actuator)}"
                yield named and actuator.displacement_creep is None, f"{words}, sensed {sensed}, named {named}"


def creep() -> Iterator[tuple[bool, str]]:
    """Yield whether records at one speed, with drift or noise, make no creep."""
    for k, truth in enumerate(STILL):
        for j, name in enumerate(("drift", "walk", "white-0.3", "white-1")):
            protocol = ("tops", "curves", "random", "decaying")[(j + k) % 4]
            fit, actuator, _ = identified(Case(truth, PROTOCOLS[protocol], DISTURBANCES[name], 5))
            yield actuator.displacement_creep is None, f"{truth.name} {protocol} {name}:{parts(fit, actuator)}"


def main() -> None:
    """Print the lines of each question, and how many records are right."""
    questions = {"readme": readme, "filters": filters, "creep": creep}
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("question", nargs="*", choices=[[], *questions], help="all if none is named")
    for question in parser.parse_args().question or questions:
        right = []
        for good, words in questions[question]():
            right.append(good)
            print(f"{'right' if good else 'WRONG'}  {words}", flush=True)
        print(f"{question}: {sum(right)} of {len(right)} are right")


if __name__ == "__main__":
    main()
