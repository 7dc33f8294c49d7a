"""The plan of a calibration: all voltages, known before anything is sent, and voltages from files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dehyst._errors import FileFormatError, RecordError
from dehyst._text import counted
from dehyst._types import Array
from dehyst.calibration.comparison_loop import replay
from dehyst.calibration.tracking import PathPlanner
from dehyst.instruments import AbstractRig, played_rate
from dehyst.records import Record, read_table
from dehyst.waveforms import (
    Excitation,
    Leg,
    Sampling,
    descending_tops,
    positive,
    raised_cosine,
    recommended,
    stage_excitation,
)

_SAMPLES_A_CYCLE = 400
# Cycles that each hold of the look lasts, and cycles of the look after its holds, where the state is known.
_HOLD, _LOOPS = 3.0, 2
# Shares of a hold between which creep is measured: early, but after the ramp has decayed, and late.
_EARLY, _LATE = (0.1, 0.2), (0.9, 1.0)
# Creep that a model may ignore, as a share of the stroke.
_LITTLE = 1e-3
# A rig may round a rate up.
_SLOWER = 0.95
# Share of the median by which the steps of time may differ.
_UNEVEN = 1e-3
# The held-out record of several axes is of other heights, periods and turning points.
_HEIGHT, _PERIOD, _SEED = 0.97, 0.83, 100


@dataclass(frozen=True)
class ExcitationPlan:
    """The excitations of a calibration of one axis, from `low` to `high` [V], at a `sample_rate` [Hz] of the rig.

    A leg takes half a cycle of the `frequency` [Hz], or longer if the `slew_rate` [V/s] requires it; each hold that
    measures creep lasts `hold` [s]. Raise `RecordError` if a number is impossible, or there are fewer than 8 samples
    per cycle.
    """

    low: float
    high: float
    sample_rate: float
    frequency: float = 1.0
    hold: float = 3.0
    slew_rate: float | None = None

    def __post_init__(self) -> None:
        positive(self.hold, "hold")
        self.sampling()

    def sampling(self, faster: float = 1.0) -> Sampling:
        """Return the sampling of the voltages, `faster` times faster."""
        return Sampling(
            frequency=faster * self.frequency,
            sample_rate=self.sample_rate,
            base=self.low,
            limits=(self.low, self.high),
            slew_rate=self.slew_rate,
        )

    def look(self) -> Excitation:
        """Play up, a hold, down, a hold, then two major loops: for stroke, noise, creep and the first insight."""
        sampling = self.sampling()
        rise, fall = sampling.legs([self.low, self.high, self.low])
        stay, rest = (Leg(level, level, self.hold) for level in (self.high, self.low))
        return sampling.play("look", [rise, stay, fall, rest, *(rise, fall) * _LOOPS])

    def major_loops(self, look: Record) -> Record:
        """Return the major loops at the end of a look."""
        sampling = self.sampling()
        cycle = sampling.play("loop", sampling.legs([self.low, self.high, self.low]))
        return replace(look[len(look) - 1 - _LOOPS * (len(cycle) - 1) :], name="look's loops")

    def loops(self) -> Excitation:
        """Play the recommended excitation."""
        return recommended(self.high, drive=self.sampling())

    def tops(self, steps: int) -> Excitation:
        """Play two major loops and descending tops."""
        return descending_tops(self.high, steps=steps, drive=self.sampling())

    def others(self) -> Excitation:
        """Play loops of other heights for held-out records."""
        heights = self.low + (self.high - self.low) * np.array([1.0, 0.75, 0.45])
        return raised_cosine(heights, cycles=2, drive=self.sampling())

    @property
    def leg(self) -> int:
        """Samples between two turns of a path: half a cycle, or more to use at most half of the slew rate."""
        samples = 0.5 * self.sample_rate / self.frequency
        if self.slew_rate is not None:
            samples = max(samples, np.pi * (self.high - self.low) * self.sample_rate / self.slew_rate)
        return int(np.ceil(samples))

    def homing(self) -> Excitation:
        """Play two major cycles: after them the state is known."""
        return raised_cosine([self.high], cycles=2, drive=self.sampling())


@dataclass(frozen=True)
class AxesExcitations:
    """The excitations of a calibration of several axes, with one column for each axis.

    `axes`: names. `each`: speed and voltages of each axis. `steps`: number of descending tops of each axis alone.
    `cycles`: cycles of the first axis when all move together.
    """

    axes: tuple[str, ...]
    each: tuple[ExcitationPlan, ...]
    steps: int
    cycles: int

    def training(self) -> Excitation:
        """Play the axes one after the other, then together."""
        played = self._played(1.0, 1.0, 0)
        return Excitation("axes", played.voltage, played.sample_rate)

    def others(self) -> Excitation:
        """Play all axes together for held-out records."""
        played = self._played(_HEIGHT, _PERIOD, _SEED)
        return Excitation("others", played.voltage[played.parts[-1][1] :], played.sample_rate)

    def homing(self) -> Excitation:
        """Play two major cycles of all axes at once."""
        cycles = [one.homing().voltage for one in self.each]
        longest = max(map(len, cycles))
        # Axes that are faster wait at their lowest voltage first.
        columns = [np.concatenate([np.full(longest - len(one), one[0]), one]) for one in cycles]
        return Excitation("homing", np.column_stack(columns), self.each[0].sample_rate)

    @property
    def leg(self) -> int:
        """Samples between two turns of a path of the first axis: half a cycle, or more if slew rates require it."""
        return max(one.leg for one in self.each)

    def _played(self, height: float, faster: float, seed: int) -> Excitation:
        return stage_excitation(
            [one.low + height * (one.high - one.low) for one in self.each],
            drive=[one.sampling(faster) for one in self.each],
            steps=self.steps,
            cycles=self.cycles,
            axes=self.axes,
            seed=seed,
        )


@dataclass(frozen=True)
class Plan:
    """The plan of a calibration.

    Parameters
    ----------
    frequency : float
        Cycles per second [Hz] of the recorded loops.
    hold : float, optional
        Time [s] at each voltage of the holds that measure creep; default three cycles.
    protocol : tuple of Excitation
        Excitations to record instead of descending tops and what shows creep.
    rounds : int
        How often more tops are recorded while the records leave stiffnesses open.
    goal : float
        Largest error along the path [% of the stroke] of a good calibration, on every axis.
    steps, cycles : int
        For several axes: number of descending tops of each axis alone, and cycles of the first axis when all move
        together. `hold`, `protocol` and `rounds` then have no effect.

    Raises
    ------
    RecordError
        If a number is impossible.
    """

    frequency: float = 1.0
    hold: float | None = None
    protocol: tuple[Excitation, ...] = ()
    rounds: int = 2
    goal: float = 1.0
    steps: int = 16
    cycles: int = 24

    def __post_init__(self) -> None:
        positive(self.frequency, "frequency")
        positive(self.goal, "goal")
        if not isinstance(self.rounds, int) or self.rounds < 0:
            raise RecordError(argument="rounds", got=repr(self.rounds), need="a whole number, 0 or more")

    def excitations(self, rig: AbstractRig) -> ExcitationPlan:
        """Return the excitations of this plan on a `rig` of one axis."""
        hold = _HOLD / self.frequency if self.hold is None else self.hold
        rate = played_rate(rig, _SAMPLES_A_CYCLE * self.frequency)
        return ExcitationPlan(rig.limits.low, rig.limits.high, rate, self.frequency, hold, rig.slew_rate)

    def axes_excitations(self, rig: AbstractRig) -> AxesExcitations:
        """Return the excitations on a `rig` of several axes; raise RecordError if the plan is for one axis."""
        if self.hold is not None or self.protocol:
            raise RecordError(
                "hold and protocol are of one axis",
                argument="plan",
                hint="leave them out, or calibrate one axis at a time",
            )
        each = tuple(self.excitations(one) for one in rig.rigs)
        return AxesExcitations(rig.axes, each, self.steps, self.cycles)


class PlannedStep(NamedTuple):
    """One step and its `excitation`, or None if it depends on earlier records; `more`: samples that follow later."""

    name: str
    words: str
    excitation: Excitation | None
    more: int = 0


def steps(rig: AbstractRig, plan: Plan) -> tuple[PlannedStep, ...]:
    """Return the steps that a calibration would play; raise `RecordError` if they exceed the rig's limits."""
    planned = tuple(_steps_of_one(rig, plan) if len(rig.axes) == 1 else _steps_of_several(rig, plan))
    for step in planned:
        if step.excitation is not None:
            rig.check(step.excitation)
    return planned


def entries(rig: AbstractRig, plan: Plan) -> list[dict[str, Any]]:
    """Return the steps as JSON values: excitation, duration and range of voltages.

    A step that depends on earlier records has no numbers; for several axes, voltages are lists. `rig` and `plan`, and
    the errors, are as in `steps`.
    """
    listed = []
    for step in steps(rig, plan):
        entry: dict[str, Any] = {"step": step.name, "what": step.words}
        if step.excitation is not None:
            rate, v = rig.check(step.excitation), step.excitation.voltage
            entry["samples"] = len(v) + step.more
            entry["seconds"] = (entry["samples"] - 1) / rate
            entry["lowest_V"], entry["highest_V"] = v.min(axis=0).tolist(), v.max(axis=0).tolist()
            entry["steepest_V_per_s"] = (np.abs(np.diff(v, axis=0)).max(axis=0) * rate).tolist()
        listed.append(entry)
    return listed


def _steps_of_one(rig: AbstractRig, plan: Plan) -> Iterator[PlannedStep]:
    excitations = plan.excitations(rig)
    look = excitations.look()
    yield PlannedStep("comparison", "if the folder holds records: their loop twice, which must agree", replay(look))
    yield PlannedStep("look", "holds at both ends, two major loops", look)
    for i, given in enumerate(plan.protocol, 1):
        yield PlannedStep(f"given-{i}", f"{given.name}, as given", given)
    if not plan.protocol:
        yield PlannedStep(
            "loops", "the recommended excitation: loops, random turns, speeds, holds", excitations.loops()
        )
        for i in range(1, plan.rounds + 1):
            yield PlannedStep(f"more-{i}", "if stiffnesses are not determined", None)
    yield PlannedStep("others", "loops of other heights, held out", excitations.others())
    # With a constant ratio the voltages of the path depend on no measured displacement.
    path = PathPlanner(excitations.homing(), [rig.limits], excitations.leg, (0.0, 1.0)).nominal().excitation
    yield PlannedStep("nominal", "homing, then a path of nine reversals by a constant ratio", path)
    yield PlannedStep("compensated", "homing, then the same path by the model; its voltages follow", path)


def _steps_of_several(rig: AbstractRig, plan: Plan) -> Iterator[PlannedStep]:
    excitations = plan.axes_excitations(rig)
    homing = excitations.homing()
    yield PlannedStep("axes", "each axis alone, then all together", excitations.training())
    yield PlannedStep("others", "all axes together, held out", excitations.others())
    path = PathPlanner(homing, [one.limits for one in rig.rigs], excitations.leg).samples
    words = "homing, then a path of all axes by constant ratios; its voltages follow"
    yield PlannedStep("nominal", words, homing, path)
    yield PlannedStep("compensated", "homing, then the same path by the model; its voltages follow", homing, path)


@dataclass(frozen=True)
class CreepCheck:
    """Creep in a first look, as shares of the stroke: the displacement during a hold, and its standard uncertainty."""

    share: float
    doubt: float

    @property
    def seen(self) -> bool:
        """Whether a model should include creep."""
        return abs(self.share) > max(_LITTLE, 4 * self.doubt)


def creep_of(look: Record) -> CreepCheck:
    """Return the creep while the voltage of a first look was held at its top."""
    # The longest hold at the highest voltage; a readback has noise.
    top = look.voltage > look.voltage.max() - 0.01 * float(np.ptp(look.voltage))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], top.astype(int), [0]])))
    first, last = max(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True), key=lambda span: span[1] - span[0])
    y = look.displacement[first:last]
    early, late = (y[int(a * y.size) : max(int(b * y.size), int(a * y.size) + 1)] for a, b in (_EARLY, _LATE))
    share = float(late.mean()) - float(early.mean())
    return CreepCheck(share / look.stroke, look.noise * float(np.sqrt(1 / early.size + 1 / late.size)) / look.stroke)


class WantedVoltage(NamedTuple):
    """An `excitation`, and the `wanted` displacement (n,) [m] at each of its samples, or None."""

    excitation: Excitation
    wanted: Array | None


def read_voltage(path: Path) -> WantedVoltage:
    """Read a voltage to play, as `dehyst excite` and `dehyst compensate` write it.

    The file is a table with time [s] and voltage [V], and perhaps the wanted displacement.
    Raise `FileFormatError` if it cannot be read, or the times do not rise, or not evenly.
    """
    table = read_table(path)
    voltage = table.column("voltage")
    rate = even_rate(path, table.column("time"))
    excitation = Excitation(path.stem, voltage, rate)
    try:
        wanted = table.column("displacement")
    except FileFormatError:
        wanted = None
    return WantedVoltage(excitation, wanted)


def even_rate(path: Path, time: Array) -> float:
    """Return the rate [Hz] of the `time` (n,) [s] in a file; raise `FileFormatError` if it does not rise evenly."""
    if time.size < 2:
        raise FileFormatError(f"{path}: got {counted(time.size, 'sample')}, need at least two")
    steps = np.diff(time)
    if not (steps > 0).all():
        raise FileFormatError(f"{path}: the times do not rise; write it with dehyst excite, or correct them")
    if float(np.ptp(steps)) > _UNEVEN * float(np.median(steps)):
        raise FileFormatError(f"{path}: the times are not evenly spaced; write it with dehyst excite, or resample it")
    return 1 / float(np.median(steps))
