"""Random lives of compensators: models, limits, slew rates, and orders of calls, hostile numbers among them.

Checked after every call: the voltage lies within limits and slew rate, the state is finite, run is step by step, what
is refused moves nothing, and the state is where a simulation of the voltages that were sent leads.
"""

import copy
import pickle
import struct
import sys
import warnings
import zlib
from dataclasses import dataclass, field, replace
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "support")]

import sanitized

sanitized.lay_over()

import batches
import numpy as np
import strategies

from dehyst import Actuator, Compensator, DehystError
from dehyst.control.following import follow
from dehyst.model import Dynamics, SmoothSlip, needs_time, turned

KINDS = ("plain", "plain", "wide", "dynamics", "lag", "smooth", "all")


def random_model(rng, kind):
    """An actuator as identifications make them, with the parts of a kind."""
    seed, uniform = int(rng.integers(2**32)), bool(rng.integers(2))
    actuator = strategies.make_actuator(
        seed, int(rng.integers(0, 12)), int(rng.integers(2, 12)), uniform, float(rng.choice([0, 0, 0.3]))
    )
    span, volts = strategies.span_of(actuator), float(np.ptp(actuator.spring.voltage))
    if kind == "plain":
        return actuator
    graded, transformer, creep = rng.random(3) < 0.5
    actuator = strategies.make_wider(actuator, seed, graded=graded, transformer=transformer, creep=creep)
    parts = {}
    if kind in ("dynamics", "all"):
        stiffness = volts / span * rng.uniform(0.1, 3)
        parts["dynamics"] = Dynamics(10 ** rng.uniform(0, 4), rng.uniform(0.005, 1), stiffness)
    if kind in ("lag", "all"):
        parts["lag"] = 10 ** rng.uniform(-6, -2)
    if kind in ("smooth", "all"):
        lengths, stiffness = span * rng.uniform(0.02, 0.5, 2), volts / span * rng.uniform(0, 0.4, 2)
        parts["smooth"] = SmoothSlip(lengths, rng.uniform(0.5, 1, 2), stiffness)
    # Its own start has no smooth elements elongated nor a mass.
    made = Actuator(
        actuator.slip,
        actuator.spring,
        transformer=actuator.transformer,
        displacement_creep=actuator.displacement_creep,
        **parts,
    )
    return replace(made, delay=10 ** rng.uniform(-6, -3)) if rng.random() < 0.2 else made


def random_start(rng, actuator):
    """A state that a compensator begins in: its own, reached, or farther away than its limits."""
    if rng.random() < 0.5:
        return None
    y = actuator.spring.displacement[0] + strategies.span_of(actuator) * rng.uniform(-1, 2)
    return turned(actuator, float(y), rising=bool(rng.integers(2)))


def random_compensator(rng, kind):
    """One within limits that may lie beside the model's own range."""
    actuator = random_model(rng, kind)
    low = float(actuator.spring.voltage[0]) + np.ptp(actuator.spring.voltage) * rng.uniform(-0.5, 0.6)
    high = low + np.ptp(actuator.spring.voltage) * 10 ** rng.uniform(-2, 0.3)
    period = 10 ** rng.uniform(-6, 0)
    slew = None if rng.random() < 0.3 else (high - low) / period * 10 ** rng.uniform(-3, 0.5)
    preview, start = bool(rng.random() < 0.3), random_start(rng, actuator)
    return Compensator(actuator, (low, high), slew, period=period, preview=preview, state=start)


HOSTILE = (np.nan, np.inf, -np.inf, 1e308, -1.7e308, 1e281, -1e281, 1e100, -1e100, 1e30, -1e16, 5e-324, -1e-310, -0.0)
# Part of the spring's range.
NEAR = 1e-6


@dataclass
class Life:
    """A compensator, what it has sent, and what is wrong."""

    rng: np.random.Generator
    compensator: Compensator
    kind: str
    note: object
    findings: list = field(default_factory=list)
    sent: list = field(default_factory=list)

    def __post_init__(self):
        self.before, self.start = self.compensator.voltage, self.compensator.state
        self.true = True
        if not self.low <= self.before <= self.high:
            self.find(f"starts at {self.before!r}, outside the limits")

    @property
    def low(self):
        return self.compensator.limits[0]

    @property
    def high(self):
        return self.compensator.limits[1]

    @property
    def actuator(self):
        return self.compensator.actuator

    @property
    def most(self):
        """The largest change of the voltage in a period [V], with what rounding adds."""
        slew, period = self.compensator.slew_rate, self.compensator.period
        return np.inf if slew is None else slew * period * (1 + 1e-9) + 1e-12 * (abs(self.low) + abs(self.high))

    def find(self, what):
        self.findings.append(f"{self.kind}: {what}")

    def wish(self):
        """A displacement [m], now and then far away."""
        spring, far = self.actuator.spring, 1.0
        if self.rng.random() < 0.1:
            far = float(self.rng.choice([3, 1e3, 1e9, 1e16, 1e100]))
        return float(spring.displacement[0] + np.ptp(spring.displacement) * self.rng.uniform(-0.3, 1.3) * far)

    def was_sent(self, voltage, call):
        """Hold a voltage that leaves against limits and slew rate."""
        self.note("voltages")
        if not self.low <= voltage <= self.high:
            self.find(f"{call}: {voltage!r} V outside the limits {self.low!r} to {self.high!r}")
        if abs(voltage - self.before) > self.most:
            self.find(f"{call}: changes by {abs(voltage - self.before)!r} V, {self.most!r} are allowed")
        self.before = voltage
        self.sent.append(voltage)

    def step(self):
        self.was_sent(self.compensator.step(self.wish()), "step")

    def offer(self):
        for _ in range(self.rng.integers(1, 4)):
            voltage = self.compensator.offer(self.wish())
        if not self.low <= voltage <= self.high:
            self.find(f"offer: {voltage!r} V outside the limits")
        if self.rng.random() < 0.6:
            self.compensator.commit(voltage)
            self.was_sent(voltage, "commit")
            return
        bit = (self.high - self.low) / 4096
        rounded = min(max(self.low + round((voltage - self.low) / bit) * bit, self.low), self.high)
        if abs(rounded - self.before) > self.most:
            self.hold()
        else:
            self.compensator.commit(rounded)
            self.was_sent(rounded, "commit of a rounded voltage")

    def hold(self):
        self.compensator.hold()
        self.was_sent(self.compensator.voltage, "hold")

    def run(self):
        """A run, the same steps in a copy, and the same run in one that goes on from a snapshot."""
        wanted = np.array([self.wish() for _ in range(self.rng.choice([0, 1, 5, 30]))])
        twin = (
            copy.deepcopy(self.compensator) if self.rng.random() < 0.8 else pickle.loads(pickle.dumps(self.compensator))
        )
        other = self.compensator._clone()
        other.restore(self.compensator.snapshot())
        stepped = np.array([twin.step(y) for y in wanted.tolist()])
        here, there = self.compensator.run(wanted), other.run(wanted)
        if not stepped.tobytes() == here.tobytes() == there.tobytes():
            self.find("run is not step by step")
        if twin.clamps != self.compensator.clamps:
            self.find(f"run counts {self.compensator.clamps}, steps count {twin.clamps}")
        for voltage in here.tolist():
            self.was_sent(voltage, "run")

    def refused(self):
        """What is no number, or leads nowhere, moves nothing."""
        bad = float(self.rng.choice(HOSTILE))
        loop, before = self.compensator, self.compensator.snapshot()
        for call in (
            loop.step,
            loop.commit,
            lambda x: loop.run([x]),
            lambda x: follow(loop._axes[0], [x], time=[0.0]),
        ):
            # A refused call must move nothing; an accepted one is forgotten again here.
            try:
                call(bad)
            except DehystError:
                self.note("refused")
                self.same(before, loop.snapshot(), f"{bad!r} was refused and moved something")
            else:
                self.finite(loop)
                loop.restore(before)
        far = self.low - (self.high - self.low) * 1.5
        try:
            loop.commit(far)
            self.find(f"commit took {far!r} V")
        except DehystError:
            self.same(before, loop.snapshot(), "a voltage far outside moved something")

    def same(self, first, second, what):
        if first != second:
            self.find(what)

    def finite(self, compensator):
        state = compensator.state
        numbers = np.concatenate(
            [[state.deformation], state.carts, state.displacement_creep, state.smooth, state.motion]
        )
        if not np.isfinite(numbers).all():
            self.find(f"the state is not finite: {numbers}")

    def restore(self):
        before, voltage = self.compensator.snapshot(), self.compensator.voltage
        for _ in range(3):
            self.compensator.step(self.wish())
        self.compensator.restore(before)
        if self.compensator.voltage != voltage:
            self.find("restore: the voltage differs")

    def damaged(self):
        """A snapshot with a damaged number is refused, or the loop goes on within its limits."""
        loop = self.compensator._clone()
        data = bytearray(self.compensator.snapshot())
        if self.rng.random() < 0.8:
            # A number, with the checksum that belongs to it.
            place = 40 + 8 * int(self.rng.integers((len(data) - 40) // 8))
            data[place : place + 8] = struct.pack("<d", float(self.rng.choice(HOSTILE)))
            data[12:16] = zlib.crc32(data[16:]).to_bytes(4, "little")
        else:
            data[self.rng.integers(len(data))] ^= 1 << int(self.rng.integers(8))
        try:
            loop.restore(bytes(data))
        except DehystError:
            self.note("damaged snapshots refused")
            return
        self.note("damaged snapshots taken")
        for _ in range(10):
            before = loop.voltage
            try:
                voltage = loop.step(self.wish())
            except DehystError:
                break
            if not self.low <= voltage <= self.high or abs(voltage - before) > self.most:
                self.find(f"after a damaged snapshot: {before!r} to {voltage!r} V")
        self.finite(loop)

    def trajectory(self):
        if self.compensator._axes[0].previews:
            return
        period, n = self.compensator.period, int(self.rng.choice([1, 2, 5, 80, 200]))
        path = np.array([self.wish() for _ in range(n)])
        time = np.arange(n) * period
        if self.rng.random() < 0.4:
            time = np.cumsum(period * self.rng.uniform(0.2, 2, n))
        try:
            command = follow(self.compensator._axes[0], path, time=time)
        except DehystError:
            self.note("trajectories refused")
            return
        voltage, slew = command.voltage, self.compensator.slew_rate
        self.note("trajectories")
        if not (np.isfinite(voltage).all() and voltage.min() >= self.low and voltage.max() <= self.high):
            self.find("trajectory: outside the limits")
        if not np.isfinite(command.displacement).all():
            self.find("trajectory: a displacement that is not finite")
        rounding = 1e-9 * (self.high - self.low)
        if slew is not None and (np.abs(np.diff(voltage)) > slew * np.diff(time) * (1 + 1e-6) + rounding).any():
            self.find("trajectory: over the slew rate")

    def end(self):
        """Where it is must be where its voltages lead."""
        self.finite(self.compensator)
        if self.kind in ("lag", "dynamics", "all") or not self.sent:
            return
        voltage, time = np.array(self.sent), {}
        if needs_time(self.actuator):
            voltage = np.append(self.actuator.voltage(self.start), voltage)
            time = {"time": np.arange(voltage.size) * self.compensator.period}
        reached = self.actuator.simulate(voltage, state=self.start, extrapolate=True, **time).state
        state, span = self.compensator.state, strategies.span_of(self.actuator)
        error = (
            max(abs(reached.deformation - state.deformation), np.abs(reached.carts - state.carts).max(initial=0)) / span
        )
        self.note("states compared")
        if not error < NEAR * self.conditioning:
            self.find(f"the state is off by {error:.3g} of the range")

    @property
    def conditioning(self):
        """How far beyond the range of the model its limits lead, in which rounding grows."""
        volts = float(np.ptp(self.actuator.spring.voltage))
        return max(1.0, max(abs(self.low), abs(self.high)) / volts)


CALLS = (
    ("step", 45),
    ("offer", 10),
    ("hold", 5),
    ("run", 8),
    ("refused", 7),
    ("restore", 5),
    ("damaged", 8),
    ("trajectory", 4),
)
NAMES = [name for name, _ in CALLS]
SHARES = np.array([share for _, share in CALLS]) / sum(share for _, share in CALLS)


def play(seed, case, note):
    """One life."""
    rng = np.random.default_rng([seed, case])
    kind = str(rng.choice(KINDS))
    try:
        compensator = random_compensator(rng, kind)
        _ = compensator.snapshot()
    except DehystError as error:
        note(f"refused at once: {str(error)[:30]}")
        return []
    note(kind)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        life = Life(rng, compensator, kind, note)
        for name in rng.choice(NAMES, int(rng.choice([8, 20, 40])), p=SHARES):
            note(name)
            getattr(life, name)()
        life.end()
    return life.findings


if __name__ == "__main__":
    batches.main("compensators", play)
