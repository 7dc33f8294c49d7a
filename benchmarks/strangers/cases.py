"""A case: a truth, excited by a protocol, recorded with a disturbance; and the design of all cases."""

from __future__ import annotations

import copy
import zlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from dehyst import Record, plan_path
from dehyst.model import AbstractModel, Actuator, simulated
from dehyst.model.states import timed
from strangers.disturbances import DISTURBANCES, QUIET, Disturbance, Raw, Scale
from strangers.protocols import PROTOCOLS, Part, Protocol, path, through
from strangers.truths import TRUTHS, Bench, Truth

Array = np.ndarray


@dataclass(frozen=True)
class Case:
    """One case of the suite; its name is TRUTH/PROTOCOL/DISTURBANCE."""

    truth: Truth
    protocol: Protocol
    disturbance: Disturbance
    seed: int

    @property
    def name(self) -> str:
        """Return the three names, joined."""
        return f"{self.truth.name}/{self.protocol.name}/{self.disturbance.name}"

    @property
    def command(self) -> str:
        """Return the command line that runs this case alone."""
        return f"python benchmarks/strangers.py --only {self.name} --seed {self.seed}"

    @property
    def parts(self) -> frozenset[str]:
        """Return the parts that move in time and that a model may have: those of the truth and the disturbance."""
        return self.truth.parts | self.disturbance.parts

    def random(self, what: str) -> np.random.Generator:
        """Return a generator that only this case and purpose have."""
        return np.random.default_rng([self.seed, zlib.crc32(f"{self.name}:{what}".encode())])

    def experiment(self) -> Experiment:
        """Return its records and what comes after them."""
        return Experiment(self)


def named(name: str, seed: int) -> Case:
    """Return the case of a name."""
    truth, protocol, disturbance = name.split("/")
    return Case(TRUTHS[truth], PROTOCOLS[protocol], DISTURBANCES[disturbance], seed)


def design(seed: int) -> list[Case]:
    """Return cases in which each truth meets each disturbance once, and each protocol about twice.

    They are in such an order that the first 40 have each truth with each protocol.
    """
    rng = np.random.default_rng(seed)
    disturbances, rows = list(DISTURBANCES), []
    for truth in TRUTHS:
        first, again = (list(rng.permutation(list(PROTOCOLS))) for _ in range(2))
        meetings = zip([*first, *again], rng.permutation(disturbances), strict=False)
        rows.append([named(f"{truth}/{protocol}/{disturbance}", seed) for protocol, disturbance in meetings])
    return [row[k] for k in range(len(disturbances)) for row in rows]


class Experiment:
    """The records of a case, the homing after them, and the path to be followed then."""

    def __init__(self, case: Case) -> None:
        self.case = case
        truth, protocol = case.truth, case.protocol
        parts = protocol.parts(case.random("protocol"), truth.fast)
        self.sample = truth.period / protocol.samples
        self.shortest = self.sample / max(part.speed for part in parts)
        # A lag is a part of the fastest period, however few samples that has.
        self.unit = truth.period / 200 / max(part.speed for part in parts)
        self.bench = Bench(truth, case.disturbance.delay * self.unit)
        self.now, self.history = 0.0, ([], [])
        if parts[0].u[0]:
            self._play(through([0.0, parts[0].u[0]], [protocol.samples // 4]), self.sample)
        played = [self._play(part.u, self.sample / part.speed) for part in parts]
        self.end = len(np.concatenate(self.history[0]))
        self.records = self._recorded(played, parts)
        home = through([parts[-1].u[-1], 0.0, 1.0, 0.0, 1.0, 0.0], [protocol.samples // 2] * 5)
        homed = self._play(home, self.sample)[2]
        self.reached = float(np.ptp(homed[-protocol.samples :]))
        # The two speeds, and some between them.
        self.between = truth.fast**0.5 if len(parts) > 1 else 1.0

    def _play(self, u: Array, step: float) -> tuple[Array, Array, Array]:
        """Play a voltage; return times, voltages and true displacements, and keep the first two as history."""
        truth = self.case.truth
        time = self.now + step * np.arange(1, u.size + 1)
        voltage = truth.low + (truth.high - truth.low) * u
        self.now = float(time[-1])
        self.history[0].append(time)
        self.history[1].append(voltage)
        return time, voltage, self.bench.play(time, voltage)

    def _recorded(self, played: list[tuple[Array, Array, Array]], parts: list[Part]) -> list[Record]:
        truth, disturbance = self.case.truth, self.case.disturbance
        scale = Scale(truth.stroke, truth.high - truth.low, truth.period, self.unit)
        rng = self.case.random("disturbance")
        raws = [Raw(*columns, f"{self.case.truth.name}-{k}") for k, columns in enumerate(played)]
        noisy = [
            Raw(raw.time, raw.voltage, raw.displacement + rng.normal(0, QUIET * truth.stroke, raw.time.size), raw.name)
            for raw in raws
        ]
        return [
            Record(raw.time, raw.voltage, raw.displacement, raw.name) for raw in disturbance.change(noisy, scale, rng)
        ]

    @cached_property
    def path(self) -> tuple[Array, Array]:
        """Times (n,) [s] and displacements (n,) [m] of the path, from the last sample of the homing."""
        samples = self.case.protocol.samples
        speeds = [1.0] if self.between == 1 else [1.0, self.between]
        u = path(self.case.random("path"), samples, speeds)
        return self.now + self.sample / self.between * np.arange(u.size), self.reached * u

    def track(self, model: AbstractModel) -> dict[str, float]:
        """Compensate the path with a model and play it into the truth; errors less one constant, in % of the stroke.

        The model takes its state from the voltages of the records and of the homing. `clamped` is the share of the
        voltages that its limits changed; `sensed` errors are those that the record's sensor sees, if it has a filter.
        """
        when, along = self.path
        time, voltage = (np.concatenate(column) for column in self.history)
        motion = simulated(model, voltage, time)
        wanted = float(motion.displacement[-1]) + along
        delay = float(getattr(model, "delay", 0.0))
        ahead = CubicSpline(when, wanted)(np.minimum(when + delay, when[-1])) if delay else wanted
        sent, clamped = self._voltages(model, ahead, when, motion.state)
        reached = copy.deepcopy(self.bench).play(when[1:], sent[1:])
        figures = self._errors("", wanted[1:] - reached) | {"clamped": clamped}
        if self.case.disturbance.name == "filter":
            raw = [Raw(when[1:], sent[1:], reached, "reached")]
            scale = Scale(self.case.truth.stroke, 1.0, 1.0, self.unit)
            seen = self.case.disturbance.change(raw, scale, self.case.random("sensor"))[0].displacement
            figures |= self._errors("sensed_", wanted[1:] - seen)
        return figures

    def _voltages(self, model: AbstractModel, path: Array, time: Array, state: object) -> tuple[Array, float]:
        truth = self.case.truth
        if isinstance(model, Actuator):
            plan = plan_path(model, path, time=time, start=state, home=False, on_time=False)
            return plan.voltage[plan.first :], float(np.mean(plan.clamped))
        voltage = model.compensate(path, state=state, **timed(model, time)).voltage
        allowed = np.clip(voltage, truth.low, truth.high)
        return allowed, float(np.mean(allowed != voltage))

    def _errors(self, prefix: str, error: Array) -> dict[str, float]:
        percent = 100 * (error - error.mean()) / self.reached
        return {
            f"{prefix}largest": float(np.abs(percent).max()),
            f"{prefix}rms": float(np.sqrt(np.mean(percent**2))),
        }
