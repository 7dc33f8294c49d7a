"""Random sequences of all calls that send a voltage: it must not leave the limits or jump from the present voltage.

A jump is a larger change than slew rate times time, also from the voltage before the first one. A refused call changes
nothing, `run` equals steps, and the state equals that of a simulation of the sent voltages.
"""

import contextlib
import copy
import pickle
import struct
import warnings
import zlib
from dataclasses import dataclass, field, replace

import numpy as np
import strategies
from fake_rig import FakeRig

from dehyst import Actuator, Bank, Compensator, DehystError
from dehyst.control import PossibleStart, plan_path, wave_table
from dehyst.control.following import follow
from dehyst.model import DisplacementCreep, Dynamics, SmoothSlip, Stage, needs_time, turned
from dehyst.waveforms import Excitation
from dehyst.waveforms.scans import scan_of

PARTS = (*("plain",) * 9, *("transformer", "graded") * 3, "creep", "creep", "dynamics", "lag", "smooth", "all")
HOSTILE = (np.nan, np.inf, -np.inf, 1e308, -1.7e308, 1e281, -1e281, 1e100, -1e100, 1e30, -1e16, 5e-324, -1e-310, -0.0)
# Frequency of each call, in 1000; slow calls are rare.
SHARES = {
    "step": 250,
    "offer": 80,
    "hold": 40,
    "run": 170,
    "reset": 30,
    "refused": 50,
    "damaged": 60,
    "preview": 20,
    "follow": 250,
    "home": 30,
    "lead": 25,
    "table": 4,
    "stage": 10,
    "stage_home": 3,
    "bank": 20,
    "rig": 7,
}


def random_actuator(rng):
    """An actuator of 1 to 20 um and 20 to 200 V, and its kind."""
    kind, span, volts = str(rng.choice(PARTS)), rng.uniform(1e-6, 2e-5), rng.uniform(20, 200)
    seed, elements, knots = int(rng.integers(2**32)), int(rng.integers(1, 8)), int(rng.integers(2, 6))
    plain = strategies.make_actuator(seed, elements, knots, True, 0.0)
    in_length, in_voltage = span / strategies.span_of(plain), volts / float(np.ptp(plain.spring.voltage))
    low = float(plain.spring.voltage[0])
    slip = type(plain.slip)(plain.slip.breakaway * in_length, plain.slip.stiffness * in_voltage / in_length)
    begin = float(plain.spring.displacement[0])
    spring = type(plain.spring)(
        (plain.spring.displacement - begin) * in_length, (plain.spring.voltage - low) * in_voltage
    )
    actuator, more = Actuator(slip, spring), {}
    if kind in ("transformer", "graded", "all"):
        flags = {"graded": kind != "transformer", "transformer": kind != "graded", "creep": False}
        actuator = strategies.make_wider(actuator, seed, **flags)
    if kind in ("creep", "all"):
        more["displacement_creep"] = DisplacementCreep([0.05, 1.0], np.full(2, 0.02))
    if kind in ("dynamics", "all"):
        more["dynamics"] = Dynamics(rng.uniform(50, 500), rng.uniform(0.05, 1))
    if kind in ("lag", "all"):
        more["lag"] = 10 ** rng.uniform(-4, -2)
    if kind in ("smooth", "all"):
        stiffness = volts / span * rng.uniform(0, 0.4, 2)
        more["smooth"] = SmoothSlip(span * rng.uniform(0.02, 0.5, 2), rng.uniform(0.5, 1, 2), stiffness)
    made = Actuator(actuator.slip, actuator.spring, transformer=actuator.transformer, **more)
    edge = sorted(rng.uniform(-0.2, 1.2, 2))
    low, high = (volts * np.array(edge)).tolist() if edge[1] - edge[0] > 0.2 else (0.0, volts)
    return replace(made, limits=(low, high)), kind


@dataclass
class Life:
    """A compensator, its last voltage sent, and the faults that were found."""

    rng: np.random.Generator
    note: object = lambda _: None
    findings: list = field(default_factory=list)
    history: list = field(default_factory=list)

    def __post_init__(self):
        rng = self.rng
        self.actuator, self.kind = random_actuator(rng)
        self.low, self.high = self.actuator.limits
        self.period = 10 ** rng.uniform(-3, -1)
        self.slew = (self.high - self.low) / self.period * 10 ** rng.uniform(-1.8, 0.3)
        self.options = {"period": self.period}
        self.loop = Compensator(self.actuator, None, self.slew, state=self.state(), **self.options)
        self.before, self.start = self.loop.voltage, self.loop.state

    def wish(self):
        low, high = self.actuator.reach
        return low + (high - low) * self.rng.uniform(-0.3, 1.3)

    def path(self, size=None):
        """A path that is smooth, jumps, or rests."""
        size = int(self.rng.choice([1, 2, 30, 120])) if size is None else size
        turns = np.array([self.wish() for _ in range(int(self.rng.integers(1, 6)))])
        if self.rng.random() < 0.3:
            return turns[np.arange(size) * turns.size // size]
        return np.interp(np.linspace(0, turns.size, size), np.arange(turns.size), turns)

    def clock(self, size):
        if self.rng.random() < 0.5:
            return self.rng.uniform(-5, 5) + self.period * np.arange(size)
        return np.cumsum(self.period * self.rng.uniform(0.3, 2, size))

    def state(self):
        if self.rng.random() < 0.4:
            return None
        low, high = self.actuator.reach
        return turned(
            self.actuator, low + (high - low) * self.rng.uniform(-0.2, 1.2), rising=bool(self.rng.integers(2))
        )

    def held(self, state):
        return min(max(self.actuator.voltage(state), self.low), self.high)

    def hold_against(self, call, voltage, present, intervals, slew=None, slack=1e-9):
        """Check voltages (n,) [V] that are sent, with the time (n,) [s] before each, against limits and slew rate."""
        voltage, slew = np.atleast_1d(np.asarray(voltage, dtype=float)), self.slew if slew is None else slew
        self.note("voltages")
        tolerance = 2e-12 * (self.high - self.low)
        if not np.all((voltage >= self.low - tolerance) & (voltage <= self.high + tolerance)):
            self.findings.append(f"{self.kind}: {call}: {voltage.min()!r} to {voltage.max()!r} V outside the limits")
        change = np.abs(np.diff(voltage, prepend=present))
        most = slew * np.broadcast_to(intervals, change.shape) * (1 + slack) + tolerance
        if (change > most).any():
            k = int(np.argmax(change - most))
            self.findings.append(f"{self.kind}: {call}: sample {k} jumps by {change[k]!r} V, {most[k]!r} are allowed")

    def sent(self, call, voltage):
        self.hold_against(call, voltage, self.before, self.period)
        self.before = float(np.atleast_1d(voltage)[-1]) if np.size(voltage) else self.before
        self.history.extend(np.atleast_1d(voltage).tolist())

    def step(self):
        self.sent("step", self.loop.step(self.wish()))

    def offer(self):
        voltage = self.loop.offer(self.wish())
        self.loop.commit(voltage)
        self.sent("offer", voltage)

    def hold(self):
        self.loop.hold()
        self.sent("hold", self.loop.voltage)

    def run(self):
        """A run, the same steps in a copy, and the same run in a copy from a snapshot."""
        path = self.path()
        twin = copy.deepcopy(self.loop) if self.rng.random() < 0.8 else pickle.loads(pickle.dumps(self.loop))
        other = self.loop._clone()
        other.restore(self.loop.snapshot())
        stepped = np.array([twin.step(y) for y in path])
        here, there = self.loop.run(path), other.run(path)
        if not stepped.tobytes() == here.tobytes() == there.tobytes() or twin.clamps != self.loop.clamps:
            self.findings.append(f"{self.kind}: run is not step by step")
        self.sent("run", here)
        self.loop = other

    def reset(self):
        self.loop.reset(self.state())
        self.before, self.start, self.history = self.loop.voltage, self.loop.state, []

    def refused(self):
        """An invalid or unreachable displacement changes nothing; an accepted one is undone."""
        loop, before, bad = self.loop, self.loop.snapshot(), float(self.rng.choice(HOSTILE))
        calls = (loop.step, loop.commit, lambda x: loop.run([0.0, x]), lambda x: follow(loop._axes[0], [x], time=[0.0]))
        far = self.low - 1.5 * (self.high - self.low)
        for call, number in (*((call, bad) for call in calls), (loop.commit, far)):
            try:
                call(number)
            except DehystError:
                self.note("voltages")
                if loop.snapshot() != before:
                    self.findings.append(f"{self.kind}: {number!r} was refused and moved something")
                continue
            if number == far:
                self.findings.append(f"{self.kind}: commit took {far!r} V")
            self.finite(loop)
            loop.restore(before)

    def damaged(self):
        """A snapshot with a damaged number is refused, or the loop continues within limits and slew rate."""
        loop, data = self.loop._clone(), bytearray(self.loop.snapshot())
        if self.rng.random() < 0.8:
            # A number, with the checksum that belongs to it.
            place = 40 + 8 * int(self.rng.integers((len(data) - 40) // 8))
            data[place : place + 8] = struct.pack("<d", float(self.rng.choice(HOSTILE)))
            data[12:16] = zlib.crc32(data[16:]).to_bytes(4, "little")
        else:
            data[self.rng.integers(len(data))] ^= 1 << int(self.rng.integers(8))
        with contextlib.suppress(DehystError):
            loop.restore(bytes(data))
            for _ in range(10):
                before = loop.voltage
                voltage = loop.step(self.wish())
                self.hold_against("after a damaged snapshot", voltage, before, self.period)
            self.finite(loop)

    def preview(self):
        """The same with a compensator with preview."""
        own = self.loop, self.before, self.history
        self.loop = Compensator(self.actuator, None, self.slew, preview=True, **self.options)
        self.before, self.history = self.loop.voltage, []
        try:
            for name in self.rng.choice(["step", "run", "offer", "hold", "refused", "damaged"], 4):
                getattr(self, name)()
        finally:
            self.loop, self.before, self.history = own

    def finite(self, loop):
        state = loop.state
        for name in ("deformation", "carts", "displacement_creep", "smooth", "motion"):
            if not np.isfinite(getattr(state, name)).all():
                self.findings.append(f"{self.kind}: the {name} is not finite")

    def end(self):
        """The state must be that to which its voltages lead."""
        self.finite(self.loop)
        if self.kind in ("lag", "dynamics", "all") or not self.history:
            return
        voltage, time = np.array(self.history), {}
        if needs_time(self.actuator):
            voltage = np.append(self.actuator.voltage(self.start), voltage)
            time = {"time": np.arange(voltage.size) * self.period}
        reached, state = (
            self.actuator.simulate(voltage, state=self.start, extrapolate=True, **time).state,
            self.loop.state,
        )
        errors = [reached.deformation - state.deformation, *(reached.carts - state.carts)]
        self.note("states compared")
        if not np.abs(errors).max() < 1e-6 * strategies.span_of(self.actuator):
            self.findings.append(f"{self.kind}: the state is off by {np.abs(errors).max():.3g} m")

    def follow(self):
        path, options = self.path(), {}
        present, time = self.before, None
        if (state := self.state()) is not None:
            options["state"], present = state, self.held(state)
        if self.rng.random() < 0.3:
            present = options["present"] = float(self.rng.uniform(self.low, self.high))
        intervals = np.full(path.size, self.period)
        if self.rng.random() < 0.7:
            options["time"] = time = self.clock(path.size)
            intervals[1:] = np.diff(time)
            intervals[0] = min([self.period, *intervals[1:2]])
        command = follow(self.loop._axes[0], path, **options)
        self.hold_against("follow", command.voltage, present, intervals)

    def home(self):
        """A path after a homing."""
        if self.kind in ("creep", "all") and self.rng.random() < 0.9:
            return
        path, present = self.path(60), float(self.rng.uniform(self.low, self.high))
        self.homed("plan_path", path, present=present)

    def lead(self):
        """A path from a state at rest within the limits."""
        state = self.actuator.relaxed(float(np.clip(0.0, self.low, self.high)))
        if self.kind not in ("dynamics", "lag", "all"):
            voltage = [self.rng.uniform(self.low, self.high)]
            state = self.actuator.simulate(voltage, time=[0.0], extrapolate=True).state
        self.homed("from a state", self.path(60), start=PossibleStart("given", (state,)))

    def homed(self, call, path, **options):
        time = self.clock(path.size)
        homed = plan_path(self.loop, path, time=time, home=True, **options)
        present = options["present"] if "present" in options else self.held(options["start"].state)
        step = float(np.median(np.diff(time)))
        self.hold_against(call, homed.voltage, present, np.diff(homed.time, prepend=homed.time[0] - step), slack=1e-6)
        if not np.allclose(homed.displacement[homed.first :], path, rtol=1e-9):
            self.findings.append(f"{call}: the displacement is another")

    def table(self):
        if self.kind not in ("plain", "transformer", "graded"):
            return
        low, high = (1e6 * (self.actuator.reach[0] + np.ptp(self.actuator.reach) * share) for share in (0.2, 0.8))
        options = {"low": low, "high": high, "frequency": 10 ** self.rng.uniform(-2.5, -1.5) / self.period}
        path = scan_of("triangle", options, 1 / self.period).path()
        state, present = self.state(), float(self.rng.uniform(self.low, self.high))
        table = wave_table(self.actuator, path, slew_rate=self.slew, start=state, present=None if state else present)
        cycle, time = table.cycle, table.plan.time[:-1]
        voltage = np.concatenate([table.plan.voltage[:-1], cycle.voltage, cycle.voltage])
        begin = present if state is None else self.held(state)
        intervals = np.append(np.diff(time, prepend=time[0] - self.period), np.full(2 * len(cycle), self.period))
        self.hold_against("wave table", voltage, begin, intervals, slack=1e-6)

    def stage(self):
        other, _ = random_actuator(self.rng)
        coupling = np.array([[1, 0.1], [-0.05, 1]])
        slews = [self.slew, None]
        stage = Stage((self.actuator, other), coupling, ("x", "y"))
        loop = Compensator(stage, period=self.period, slew_rate=slews)
        present = float(loop.voltage[0])
        wanted = np.column_stack([self.path(20), np.full(20, np.mean(other.reach))])
        stepped = np.array([loop.step(row) for row in wanted])
        self.hold_against("stage: step", stepped[:, 0], present, self.period)

    def stage_home(self):
        stage = Stage((self.actuator, replace(self.actuator, name="y")), np.array([[1, 0.1], [-0.05, 1]]), ("x", "y"))
        if self.kind in ("creep", "all"):
            return
        loop = Compensator(stage, period=self.period, slew_rate=[self.slew] * 2)
        time = self.period * np.arange(40)
        wanted = np.column_stack([self.path(40), self.path(40)])
        known = bool(self.rng.integers(2))
        start = [PossibleStart("given", (state,)) for state in loop.state] if known else None
        homed = plan_path(loop, wanted, time=time, start=start, home=True)
        voltage = homed.voltage
        present = loop.voltage if known else np.full(2, min(max(0.0, self.low), self.high))
        for j in range(2):
            intervals = np.diff(homed.time, prepend=homed.time[0] - self.period)
            self.hold_against("homed stage", voltage[:, j], present[j], intervals, slack=1e-6)

    def bank(self):
        bank = Bank([self.actuator] * 3, None, self.slew, period=self.period)
        present = self.held(self.actuator.state)
        first = bank.step(np.array([self.wish() for _ in range(3)]))
        later = bank.run(np.column_stack([self.path(30).clip(*self.actuator.reach) for _ in range(3)]))
        for j in range(3):
            self.hold_against("bank", np.append(first[j], later[:, j]), present, self.period)

    def rig(self):
        """An excitation on a rig: it is refused, or a ramp within the slew rate leads to it."""
        # Its list of voltages begins at 0 V.
        limits = min(self.low, 0.0), max(self.high, 1.0)
        rig = FakeRig(limits, limits=limits, slew_rate=self.slew)
        waits, wait = {}, rig._wait
        # Waits before each voltage, by the number of the voltage.
        vars(rig)["_wait"] = lambda seconds: (
            waits.update({(at := len(rig.instrument.sent)): waits.get(at, 0.0) + seconds}),
            wait(seconds),
        )
        command = follow(self.loop._axes[0], self.path(40))
        with contextlib.suppress(DehystError):
            rig.play(Excitation("path", command.voltage, 1 / self.period), lambda _: None)
        sent = np.array(rig.instrument.sent)
        intervals = [waits.get(at, self.period) for at in range(1, sent.size)]
        own, (self.low, self.high) = (self.low, self.high), limits
        self.hold_against("rig", sent[1:], sent[0], intervals, slack=1e-5)
        self.low, self.high = own


def play(seed, case, note):
    """Play one sequence of calls; return the faults."""
    rng = np.random.default_rng([seed, case])
    names, shares = list(SHARES), np.array([*SHARES.values()]) / sum(SHARES.values())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        life = Life(rng, note)
        note(life.kind)
        for name in rng.choice(names, int(rng.choice([3, 6, 12])), p=shares):
            try:
                getattr(life, name)()
                note(name)
            except DehystError as error:
                note(f"refused: {name}: {str(error)[:40]}")
        life.end()
    return life.findings
