"""The paper's experiment on a virtual actuator: loops, models, a tracked path, and lower bounds of a class's errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from dehyst import identification
from dehyst._types import Array, Progress
from dehyst.control import Compensator
from dehyst.identification import Norm
from dehyst.model import Actuator, State
from dehyst.paper.methods import BreakPointLoop, identify, loops_of
from dehyst.records import Record, largest, percent
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops, raised_cosine

# The paper names the major loop's peak only; those of the two minor loops are a choice, in the ratio 10 : 7 : 3.5.
PEAKS = {"major": 200.0, "medium": 140.0, "small": 70.0}
PRE_ENERGISED = 100.0
CYCLES = 3
DRIVE = Sampling(frequency=0.01, sample_rate=5.0)
ELEMENTS = 10
# With it the nominal ratio misses a full-stroke raised cosine by what the paper reports, 13.6 % of the range.
WIDTH = 0.715
# Samples of half a cycle and of a cycle.
_HALF, CYCLE = int(DRIVE.rate * DRIVE.half), int(2 * DRIVE.rate * DRIVE.half)
# Voltages applied between the relaxed state and t = 0.
RELAXED, ENERGISED = "relaxed", "pre-energised"
STARTS = {RELAXED: np.zeros(1), ENERGISED: raised_cosine(PRE_ENERGISED, drive=DRIVE).voltage}
# Fine enough that the sampling adds less than 1e-4 % of the range.
_FINE = Sampling(sample_rate=40.0)
_PLACES = 801


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """The closed major loop of an actuator without noise.

    `rising`, `falling` (2, n): displacement [m] and voltage [V] of the two branches, both with increasing displacement.
    """

    rising: Array
    falling: Array

    @classmethod
    def of(cls, truth: PlayActuator) -> ClosedLoop:
        """Play two major cycles into a relaxed copy."""
        twin = replace(truth, noise=0.0)
        voltage = raised_cosine(truth.highest, cycles=2, drive=_FINE).voltage
        both = np.vstack([twin.play(voltage), voltage])
        n = (voltage.size - 1) // 4
        return cls(both[:, 2 * n : 3 * n + 1], both[:, 4 * n : 3 * n - 1 : -1])

    @property
    def range(self) -> float:
        """From the lower to the upper turning point [m]."""
        return float(np.ptp(self.falling[0]))

    def width(self, places: Array, apart: float) -> Array:
        """Return the voltage between the branches, the rising one moved down, the falling one up by `apart`."""
        return np.asarray(np.interp(places + apart, *self.rising) - np.interp(places - apart, *self.falling))


def symmetric_width_floor(loop: ClosedLoop) -> float:
    """Return a lower bound of the largest error [% of the range] of models with equal widths at mirrored places.

    At one y the branches of a plain Maxwell-slip model lie ``sum_i 2 kappa_i min(...)`` apart, which is the same at the
    mirror image of y about the loop's centre (theory, section 6), whatever N and the spring. If the error of the model
    is at most e on both branches, its width at y lies between two bounds: the widths of the true loop with the branches
    moved together, and moved apart, by e. The bound is the least e for which these intervals overlap at every mirrored
    pair; the centre of the model's loop is free within e.
    """
    places = np.linspace(float(loop.falling[0, 0]), float(loop.falling[0, -1]), _PLACES)

    def overlap(least: Array, most: Array, moved: float) -> bool:
        """Whether one width fits at each place and at its mirror image about the centre moved by `moved`."""
        mirrored = places[0] + places[-1] + 2 * moved - places
        inside = (mirrored >= places[0]) & (mirrored <= places[-1])
        rounding = 1e-9 * float(most.max())
        there = np.interp(mirrored, places, least), np.interp(mirrored, places, most)
        return bool(np.all((least <= there[1] + rounding)[inside] & (there[0] <= most + rounding)[inside]))

    low, high = 0.0, loop.range
    while high - low > 1e-6 * loop.range:
        e = 0.5 * (low + high)
        least, most = loop.width(places, -e), loop.width(places, e)
        possible = any(overlap(least, most, moved) for moved in np.linspace(-e, e, 21))
        low, high = (low, e) if possible else (e, high)
    return percent(high, loop.range)


def chord_error(loop: ClosedLoop, elements: int) -> float:
    """Return the largest error [% of the range] of straight segments through the break points of N = `elements`.

    A model that passes through every break point has it; most of it lies in the first segment after a turning point.
    """
    errors = []
    for displacement, voltage in (loop.rising, loop.falling):
        knots = np.linspace(displacement[0], displacement[-1], elements + 1)
        chord = np.interp(voltage, np.interp(knots, displacement, voltage), knots)
        errors.append(np.abs(chord - displacement).max())
    return percent(float(max(errors)), loop.range)


def parabola_chord_error(nominal: float, elements: int) -> float:
    """Return `chord_error` [%] of a parabola (Rayleigh's law) that leaves the straight line by `nominal` [%].

    With y = s u + (1 - s) u^2, u the share of the voltage, y that of the displacement, the branch leaves the line by
    (1 - s)/4; the first chord ends where y = 1/N, and leaves the branch by (1 - s) u^2 / 4.
    """
    bend = 4 * nominal / 100
    start = 1 - bend
    u = (-start + np.sqrt(start**2 + 4 * bend / elements)) / (2 * bend)
    return float(100 * bend * u**2 / 4)


class PaperError(NamedTuple):
    """Largest error against the truth and against the measurement with its noise [% of the range]."""

    true: float
    measured: float


@dataclass(frozen=True, eq=False)
class Measured:
    """A record whose sensor reads zero at its first sample, and the readings of a perfect sensor with the same zero.

    `true` (n,) [m]. `zero`: where the sensor's zero lies on the actuator's own axis [m]. `start`: one of `STARTS`.
    """

    record: Record
    true: Array
    zero: float
    start: str

    def cut(self, loop: str) -> Record:
        """Return the cycles of one amplitude."""
        first = CYCLES * CYCLE * list(PEAKS).index(loop)
        return self.record.slice(first, first + CYCLES * CYCLE + 1).with_name(loop)

    def known(self, loop: str) -> slice[int, int, None]:
        """Return the samples of one amplitude from the first peak on, where the start has no effect (Lemma 1)."""
        first = CYCLES * CYCLE * list(PEAKS).index(loop)
        return slice(max(first, _HALF), first + CYCLES * CYCLE + 1)


@dataclass(frozen=True, eq=False)
class PaperTracking:
    """A wanted path (n,) [m] on the sensor's axis, the voltage sent [V] and the displacement reached [m]."""

    time: Array
    wanted: Array
    voltage: Array
    reached: Array
    stroke: float
    clamped: int = 0

    @property
    def error(self) -> Array:
        """Reached minus wanted (n,) [% of the range]."""
        return 100 * (self.reached - self.wanted) / self.stroke

    @property
    def largest(self) -> float:
        """Largest error [% of the range]."""
        return largest(self.error)


@dataclass(frozen=True)
class PaperPlan:
    """One identification to try: number of elements, norm and records.

    `whole`: whether by the whole record, or by the paper's method. `tops`: whether descending tops are in the training,
    in addition to the major and the small loop. `noiseless`:
    whether the sensor is perfect.
    """

    key: str
    whole: bool = True
    elements: int = ELEMENTS
    norm: Norm = "l1"
    tops: bool = False
    noiseless: bool = False


PLANS = (
    PaperPlan("breakpoints", whole=False),
    PaperPlan("breakpoints_40", whole=False, elements=40),
    PaperPlan("record_10"),
    PaperPlan("record_20", elements=20),
    PaperPlan("record", elements=40),
    PaperPlan("record_noiseless", elements=40, noiseless=True),
    PaperPlan("record_tops", elements=40, tops=True),
    PaperPlan("record_tops_l2", elements=40, norm="l2", tops=True),
)


@dataclass(frozen=True, eq=False)
class PaperTrial:
    """An identified model compared with the truth.

    `simulated` (n,): displacement [m] for the voltage of the run, from the run alone: no constant is fitted. `errors`:
    of each amplitude, from the first peak on. `shift`: by how much Eq. 10 predicts the loop to lie above the relaxed
    one after pre-energising [m]. `outcome`: name of the `Outcome`.
    """

    actuator: Actuator
    simulated: Array
    errors: Mapping[str, PaperError]
    tracking: PaperTracking
    shift: float
    outcome: str
    remarks: tuple[str, ...]


class Shift(NamedTuple):
    """The loop after pre-energising minus the relaxed loop [m]: mean and standard deviation from the first peak on.

    `rest` is its value by Eq. 10 from measured numbers: minus the reading at t = 0 of a sensor not zeroed again.
    """

    loop: float
    deviation: float
    rest: float


@dataclass(frozen=True, eq=False)
class Experiment:
    """One virtual actuator: its runs, its major and small loop with their break points, and every trial."""

    truth: PlayActuator
    runs: Mapping[str, Measured]
    loops: tuple[BreakPointLoop, ...]
    trials: Mapping[str, PaperTrial]
    nominal: PaperTracking
    exact: ClosedLoop

    @property
    def shift(self) -> Shift:
        """Shift of the loop by pre-energising."""
        before, after = self.runs[RELAXED], self.runs[ENERGISED]
        moved = (after.record.displacement - before.record.displacement)[_HALF:]
        return Shift(float(moved.mean()), float(moved.std()), before.zero - after.zero)

    @property
    def midpoints(self) -> Array:
        """Midpoints of pairs of break points of the major loop minus half of its peak (N - 1,) [V]; 0 by Lemma 2."""
        loop = self.loops[0]
        return np.asarray(0.5 * (loop.descending[1:-1, 1] + loop.ascending[1:-1, 1] - PEAKS["major"]))


def virtual_actuator(*, asymmetric: bool = True) -> PlayActuator:
    """Return the virtual E-280.10, 16.152 um at 200 V, with its asymmetric map or without."""
    return PlayActuator(width=WIDTH) if asymmetric else PlayActuator(width=WIDTH, asymmetry=0.0, bend=0.0)


def run(truth: PlayActuator, progress: Progress) -> Experiment:
    """Run the paper's protocol on an actuator and identify it in every way; seeded and thus reproducible."""
    progress("recording loops, relaxed and pre-energised")
    loops = raised_cosine(list(PEAKS.values()), cycles=CYCLES, drive=DRIVE).voltage
    runs = {start: _record(truth, start, loops, seed) for seed, start in enumerate(STARTS)}
    runs["tops"] = _record(truth, RELAXED, descending_tops(PEAKS["major"], drive=DRIVE).voltage, len(runs))
    trials = {plan.key: _identify(truth, runs, plan, progress) for plan in PLANS}
    relaxed = runs[RELAXED]
    break_points = loops_of([relaxed.cut("major"), relaxed.cut("small")], ELEMENTS)
    return Experiment(truth, runs, break_points, trials, _track(truth, relaxed, None), ClosedLoop.of(truth))


def _record(truth: PlayActuator, start: str, voltage: Array, seed: int) -> Measured:
    """Play a voltage from a start; the sensor is zeroed by its first, noisy, sample."""
    sensed, exact = replace(truth, seed=truth.seed + seed), replace(truth, noise=0.0)
    for actuator in (sensed, exact):
        actuator.play(STARTS[start], measured=False)
    displacement, true = sensed.play(voltage), exact.play(voltage)
    zero = float(displacement[0])
    record = Record(np.arange(voltage.size) / DRIVE.rate, voltage, displacement - zero, start)
    return Measured(record, true - zero, zero, start)


def _identify(truth: PlayActuator, runs: Mapping[str, Measured], plan: PaperPlan, progress: Progress) -> PaperTrial:
    """Identify on the major and the small loop, and on the further records of the plan."""
    step = f"identifying, {plan.key.replace('_', ' ')}"
    progress(step)
    relaxed = seen = runs[RELAXED]
    if plan.noiseless:
        seen = replace(relaxed, record=replace(relaxed.record, displacement=relaxed.true))
    records = [seen.cut("major"), seen.cut("small")]
    if plan.tops:
        # Recorded later, with the sensor's zero left where it was.
        tops = runs["tops"]
        moved = tops.record.displacement + tops.zero - relaxed.zero
        records.append(replace(tops.record, displacement=moved, name="tops"))
    if not plan.whole:
        found = identify(records, elements=plan.elements)
        return paper_trial(truth, relaxed, found.actuator, found.outcome, ())
    fit = identification.identify(
        records,
        validate=seen.cut("medium"),
        progress=lambda words: progress(f"{step}: {words}"),
        elements=plan.elements,
        norm=plan.norm,
        # The virtual sensor neither lags nor creeps, and it is not zeroed between loops.
        shared_datum=True,
        delay=0.0,
        drift=False,
    )
    return paper_trial(truth, relaxed, fit.actuator, fit.outcome.name, fit.remarks)


def paper_trial(
    truth: PlayActuator, run: Measured, actuator: Actuator, outcome: str, remarks: Sequence[str]
) -> PaperTrial:
    """Compare an actuator identified from a run with the truth, and track with it."""
    simulated = actuator.simulate(run.record.voltage, time=run.record.time, extrapolate=True).displacement
    errors = {}
    for loop in PEAKS:
        samples = run.known(loop)
        misses = (simulated[samples] - y[samples] for y in (run.true, run.record.displacement))
        errors[loop] = PaperError(*(percent(largest(miss), truth.stroke) for miss in misses))
    # Eq. 10: the sensor reads y - y(0), and once every element has slid y does not depend on the start (Lemma 1): the
    # rest of the loop moves in the (v, y) plane by -(y(0) - y_relaxed), the paper's -(keq/km) x(0).
    energised = _after(actuator, STARTS[ENERGISED], actuator.relaxed())
    rest = actuator.relaxed(actuator.voltage(energised), extrapolate=True)
    shift = rest.deformation - energised.deformation
    tracking = _track(truth, run, actuator)
    return PaperTrial(actuator, simulated, errors, tracking, shift, outcome, tuple(remarks))


def _track(truth: PlayActuator, run: Measured, actuator: Actuator | None) -> PaperTracking:
    """Track two raised cosines of the full stroke after a major loop, by inverse control or by the nominal ratio."""
    shape = raised_cosine(1.0, cycles=2, drive=DRIVE).voltage
    # From the lower turning point of the major loop, as the sensor shows it.
    bottom = float(run.record.displacement[[CYCLE * i for i in range(1, CYCLES + 1)]].mean())
    wanted = bottom + truth.stroke * shape
    homing = raised_cosine(truth.highest, drive=DRIVE).voltage
    voltage, clamped = truth.highest * shape, 0
    if actuator is not None:
        compensator = Compensator(actuator, (0.0, truth.highest), period=1 / DRIVE.rate)
        command = compensator.trajectory(wanted, state=_after(actuator, homing))
        voltage, clamped = command.voltage, int(command.clamped.sum())
    exact = replace(truth, noise=0.0)
    exact.play(np.concatenate([STARTS[run.start], homing]))
    time = np.arange(wanted.size) / DRIVE.rate
    return PaperTracking(time, wanted, voltage, exact.play(voltage) - run.zero, truth.stroke, clamped)


def _after(actuator: Actuator, voltage: Array, state: State | None = None) -> State:
    """Return the state after a voltage sampled at the drive's rate."""
    time = np.arange(voltage.size) / DRIVE.rate
    reached: State = actuator.simulate(voltage, time=time, state=state, extrapolate=True).state
    return reached
