"""The plan of a calibration: all voltages, known before anything is sent, and voltages from files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dehyst._errors import FileFormatError, RecordError
from dehyst._text import counted
from dehyst._types import Array
from dehyst.calibration.tracking import PathPlanner
from dehyst.instruments import AbstractRig, played_rate
from dehyst.records import read_table
from dehyst.waveforms import (
    Excitation,
    Sampling,
    positive,
    raised_cosine,
    recommended,
    stage_excitation,
)

# Of one axis and of several: usual cycles a second, samples of a cycle, and how much faster than them the path is.
_ALONE, _TOGETHER = (0.1, 1000, 5.0), (1.0, 400, 1.0)
# Share of the median by which the steps of time may differ.
_UNEVEN = 1e-3


@dataclass(frozen=True)
class ExcitationPlan:
    """The excitations of a calibration of one axis, from `low` to `high` [V], at a `sample_rate` [Hz] of the rig.

    A leg takes half a cycle of the `frequency` [Hz], or longer if the `slew_rate` [V/s] requires it; the path and the
    homing before it are `faster`. Raise `RecordError` if a number is impossible, or there are fewer than 8 samples per
    cycle.
    """

    low: float
    high: float
    sample_rate: float
    frequency: float = 0.1
    slew_rate: float | None = None
    faster: float = 5.0

    def __post_init__(self) -> None:
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

    def recommended(self) -> Excitation:
        """Play the recommended excitation."""
        return recommended(self.high, drive=self.sampling())

    @property
    def leg(self) -> int:
        """Samples between two turns of a path: half a faster cycle, or more to use at most half of the slew rate."""
        samples = 0.5 * self.sample_rate / (self.faster * self.frequency)
        if self.slew_rate is not None:
            samples = max(samples, np.pi * (self.high - self.low) * self.sample_rate / self.slew_rate)
        return int(np.ceil(samples))

    def homing(self) -> Excitation:
        """Play two major cycles: after them the state is known."""
        return raised_cosine([self.high], cycles=2, drive=self.sampling(self.faster))


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

    def recommended(self) -> Excitation:
        """Play the axes one after the other, then together."""
        played = stage_excitation(
            [one.high for one in self.each],
            drive=[one.sampling() for one in self.each],
            steps=self.steps,
            cycles=self.cycles,
            axes=self.axes,
        )
        return Excitation("axes", played.voltage, played.sample_rate)

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


@dataclass(frozen=True)
class Plan:
    """The plan of a calibration.

    Parameters
    ----------
    frequency : float, optional
        Cycles per second [Hz] of the slowest loops, default 0.1, and 1 for several axes; the path is five times as fast
        as one actuator's loops.
    protocol : tuple of Excitation
        Excitations to record instead of the recommended one.
    goal : float
        Largest error along the path [% of the stroke] of a good calibration, on every axis.
    steps, cycles : int
        For several axes: number of descending tops of each axis alone, and cycles of the first axis when all move
        together. `protocol` then has no effect.

    Raises
    ------
    RecordError
        If a number is impossible.
    """

    frequency: float | None = None
    protocol: tuple[Excitation, ...] = ()
    goal: float = 1.0
    steps: int = 16
    cycles: int = 24

    def __post_init__(self) -> None:
        positive(1.0 if self.frequency is None else self.frequency, "frequency")
        positive(self.goal, "goal")

    def excitations(self, rig: AbstractRig) -> ExcitationPlan | AxesExcitations:
        """Return the excitations of this plan on a `rig`; raise RecordError if it has several axes and a protocol."""
        usual, samples, faster = _ALONE if len(rig.axes) == 1 else _TOGETHER
        frequency = self.frequency or usual
        each = tuple(
            ExcitationPlan(
                one.limits.low,
                one.limits.high,
                played_rate(one, samples * frequency),
                frequency,
                one.slew_rate,
                faster,
            )
            for one in rig.rigs
        )
        if len(each) == 1:
            return each[0]
        if self.protocol:
            hint = "leave it out, or calibrate one axis at a time"
            raise RecordError("a protocol is of one axis", argument="protocol", hint=hint)
        return AxesExcitations(rig.axes, each, self.steps, self.cycles)


class PlannedStep(NamedTuple):
    """One step and its `excitation`; `more`: samples that follow when the model is known."""

    name: str
    words: str
    excitation: Excitation
    more: int = 0


def steps(rig: AbstractRig, plan: Plan) -> tuple[PlannedStep, ...]:
    """Return the steps that a calibration would play; raise `RecordError` if they exceed the rig's limits."""
    planned = tuple(_steps(rig, plan))
    for step in planned:
        rig.check(step.excitation)
    return planned


def _steps(rig: AbstractRig, plan: Plan) -> Iterator[PlannedStep]:
    excitations = plan.excitations(rig)
    for i, given in enumerate(plan.protocol, 1):
        yield PlannedStep(f"given-{i}", f"{given.name}, as given", given)
    if isinstance(excitations, AxesExcitations):
        yield PlannedStep("axes", "each axis alone, then all together", excitations.recommended())
    elif not plan.protocol:
        words = "the recommended excitation: loops, random turns, speeds, holds"
        yield PlannedStep("recommended", words, excitations.recommended())
    homing = excitations.homing()
    path = PathPlanner(homing, [axis.limits for axis in rig.rigs], excitations.leg).samples
    for name, words in (("nominal", "by a constant ratio"), ("compensated", "by the model")):
        yield PlannedStep(name, f"homing, then a path of nine reversals {words}; its voltages follow", homing, path)


def entries(rig: AbstractRig, plan: Plan) -> list[dict[str, Any]]:
    """Return the steps as JSON values: excitation, duration and range of voltages.

    For several axes, voltages are lists. `rig` and `plan`, and the errors, are as in `steps`.
    """
    listed: list[dict[str, Any]] = []
    for step in steps(rig, plan):
        rate, v = rig.check(step.excitation), step.excitation.voltage
        samples = len(v) + step.more
        listed.append(
            {
                "step": step.name,
                "what": step.words,
                "samples": samples,
                "seconds": (samples - 1) / rate,
                "lowest_V": v.min(axis=0).tolist(),
                "highest_V": v.max(axis=0).tolist(),
                "steepest_V_per_s": (np.abs(np.diff(v, axis=0)).max(axis=0) * rate).tolist(),
            }
        )
    return listed


def read_voltage(path: Path) -> Excitation:
    """Read a voltage to play, as `dehyst excite` and `dehyst compensate` write it: time [s] and voltage [V].

    Raise `FileFormatError` if the file cannot be read, or its times do not rise evenly.
    """
    table = read_table(path)
    voltage = table.column("voltage")
    return Excitation(path.stem, voltage, even_rate(path, table.column("time")))


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
