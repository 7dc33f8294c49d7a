"""The paper's experiment (Secs. 4.2 and 4.3) on a virtual actuator: loops, models, pre-energising, a tracked path."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dehyst import identification
from dehyst._types import Array, Progress
from dehyst.control import plan_path
from dehyst.identification import Structure
from dehyst.model import Actuator, State
from dehyst.paper.methods import BreakPointLoop, identify, loops_of
from dehyst.records import Record, largest, percent
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops, raised_cosine

# The paper states the peak of the major loop only; we chose the peaks of the two minor loops (ratio 10 : 7 : 3.5).
PEAKS = {"major": 200.0, "medium": 140.0, "small": 70.0}
PRE_ENERGISED = 100.0
CYCLES = 3
DRIVE = Sampling(frequency=0.01, sample_rate=5.0)
# Number of elements of the paper's method, and of the identification from whole records.
ELEMENTS, MORE_ELEMENTS = 10, 40
# With this width the nominal ratio misses a full-stroke raised cosine by 13.6 % of the range, as the paper reports.
WIDTH = 0.715
# Number of samples of half a cycle and of a cycle.
_HALF, CYCLE = int(DRIVE.rate * DRIVE.half), int(2 * DRIVE.rate * DRIVE.half)
# Voltages applied between the relaxed state and t = 0.
RELAXED, ENERGISED = "relaxed", "pre-energised"
STARTS = {RELAXED: np.zeros(1), ENERGISED: raised_cosine(PRE_ENERGISED, drive=DRIVE).voltage}


@dataclass(frozen=True, eq=False)
class Measured:
    """A record whose sensor reads zero at its first sample, and the readings of a perfect sensor with the same zero.

    `true` (n,) [m]. `zero`: displacement of the actuator at which the sensor reads zero [m]. `start`: one of `STARTS`.
    """

    record: Record
    true: Array
    zero: float
    start: str

    @classmethod
    def of(cls, truth: PlayActuator, start: str, voltage: Array, seed: int) -> Measured:
        """Play a voltage from a start; the first sample, with its noise, sets the zero of the sensor."""
        sensed, exact = replace(truth, seed=truth.seed + seed), replace(truth, noise=0.0)
        for actuator in (sensed, exact):
            actuator.play(STARTS[start], measured=False)
        displacement, true = sensed.play(voltage), exact.play(voltage)
        zero = float(displacement[0])
        record = Record(np.arange(voltage.size) / DRIVE.rate, voltage, displacement - zero, start)
        return cls(record, true - zero, zero, start)

    def cut(self, loop: str) -> Record:
        """Return the cycles of one amplitude."""
        first = CYCLES * CYCLE * list(PEAKS).index(loop)
        return replace(self.record[first : first + CYCLES * CYCLE + 1], name=loop)

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

    @property
    def error(self) -> Array:
        """Reached minus wanted (n,) [% of the range]."""
        return 100 * (self.reached - self.wanted) / self.stroke


@dataclass(frozen=True, eq=False)
class PaperTrial:
    """An identified model compared with the truth.

    `simulated` (n,): displacement [m] from the voltage of the run alone; no constant is fitted. `errors`: largest error
    against the truth for each amplitude, from the first peak on [% of the range]. `shift`: predicted displacement [m]
    of the loop after pre-energising, relative to the relaxed loop (Eq. 10).
    """

    actuator: Actuator
    simulated: Array
    errors: Mapping[str, float]
    tracking: PaperTracking
    shift: float


@dataclass(frozen=True, eq=False)
class Experiment:
    """One virtual actuator: its runs, its major and small loop with break points, and all trials."""

    truth: PlayActuator
    runs: Mapping[str, Measured]
    loops: tuple[BreakPointLoop, ...]
    trials: Mapping[str, PaperTrial]
    nominal: PaperTracking

    @property
    def shift(self) -> Array:
        """The loop after pre-energising minus the relaxed loop, from the first peak on (n,) [m]: constant by Eq. 10."""
        before, after = (self.runs[start].record.displacement[_HALF:] for start in (RELAXED, ENERGISED))
        return np.asarray(after - before)

    @property
    def midpoints(self) -> Array:
        """Midpoints of pairs of break points of the major loop minus half of its peak (N - 1,) [V]; 0 by Lemma 2."""
        loop = self.loops[0]
        return np.asarray(0.5 * (loop.descending[1:-1, 1] + loop.ascending[1:-1, 1] - PEAKS["major"]))


def virtual_actuator(*, asymmetric: bool = True) -> PlayActuator:
    """Return the virtual E-280.10, 16.152 um at 200 V, with or without its asymmetric map."""
    return PlayActuator(width=WIDTH) if asymmetric else PlayActuator(width=WIDTH, asymmetry=0.0, bend=0.0)


def run(truth: PlayActuator, progress: Progress) -> Experiment:
    """Run the paper's protocol on an actuator and identify it by all methods; seeds make the result reproducible."""
    progress("recording loops, relaxed and pre-energised")
    loops = raised_cosine(list(PEAKS.values()), cycles=CYCLES, drive=DRIVE).voltage
    runs = {start: Measured.of(truth, start, loops, seed) for seed, start in enumerate(STARTS)}
    runs["tops"] = Measured.of(truth, RELAXED, descending_tops(PEAKS["major"], drive=DRIVE).voltage, len(runs))
    relaxed = runs[RELAXED]
    major_and_small = [relaxed.cut("major"), relaxed.cut("small")]
    progress("identifying by the paper's method")
    models = {"breakpoints": identify(major_and_small, elements=ELEMENTS).actuator}
    progress("identifying from whole records")
    # The tops were recorded later, and the zero of the sensor was kept.
    tops = runs["tops"]
    moved = tops.record.displacement + tops.zero - relaxed.zero
    models["record"] = _from_records(
        [*major_and_small, replace(tops.record, displacement=moved, name="tops")], progress
    )
    trials = {key: paper_trial(truth, relaxed, actuator) for key, actuator in models.items()}
    break_points = loops_of(major_and_small, ELEMENTS)
    return Experiment(truth, runs, break_points, trials, _track(truth, relaxed, None))


def _from_records(records: list[Record], progress: Progress) -> Actuator:
    """Identify from whole records of a sensor that neither lags nor creeps, and is not zeroed between loops."""
    structure = Structure(elements=MORE_ELEMENTS, knots=MORE_ELEMENTS + 1, smoothing=0.0)
    fixed: dict[str, Any] = {"shared_zero": True, "delay": 0.0, "drift": False}
    return identification.identify(records, progress=progress, structure=structure, **fixed).actuator


def paper_trial(truth: PlayActuator, run: Measured, actuator: Actuator) -> PaperTrial:
    """Compare an identified actuator with the truth."""
    simulated = actuator.simulate(run.record.voltage, extrapolate=True).displacement
    missed = simulated - run.true
    errors = {loop: percent(largest(missed[run.known(loop)]), truth.stroke) for loop in PEAKS}
    # Eq. 10: the sensor reads y - y(0). After every element has slid, y does not depend on the start (Lemma 1), and the
    # rest of the loop moves in the (v, y) plane by -(y(0) - y_relaxed); the paper writes -(keq/km) x(0).
    energised = _after(actuator, STARTS[ENERGISED], actuator.relaxed())
    rest = actuator.relaxed(actuator.voltage(energised), extrapolate=True)
    tracking = _track(truth, run, actuator)
    return PaperTrial(actuator, simulated, errors, tracking, rest.deformation - energised.deformation)


def _track(truth: PlayActuator, run: Measured, actuator: Actuator | None) -> PaperTracking:
    """Track two raised cosines of the full stroke after a major loop, by inverse control or by the nominal ratio."""
    shape = raised_cosine(1.0, cycles=2, drive=DRIVE).voltage
    # The path begins at the lower turning point of the major loop, as the sensor measures it.
    bottom = float(run.record.displacement[[CYCLE * i for i in range(1, CYCLES + 1)]].mean())
    wanted = bottom + truth.stroke * shape
    homing, voltage = raised_cosine(truth.highest, drive=DRIVE).voltage, truth.highest * shape
    if actuator is not None:
        options: dict[str, Any] = {"limits": (0.0, truth.highest), "start": _after(actuator, homing), "home": False}
        voltage = plan_path(actuator, wanted, **options).voltage
    exact = replace(truth, noise=0.0)
    exact.play(np.concatenate([STARTS[run.start], homing]))
    time = np.arange(wanted.size) / DRIVE.rate
    return PaperTracking(time, wanted, voltage, exact.play(voltage) - run.zero, truth.stroke)


def _after(actuator: Actuator, voltage: Array, state: State | None = None) -> State:
    """Return the state after a voltage."""
    reached: State = actuator.simulate(voltage, state=state, extrapolate=True).state
    return reached
