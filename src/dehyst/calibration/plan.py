"""The plan of a calibration: all voltages, known before anything is sent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from dehyst.control import VoltageLimits
from dehyst.instruments import AbstractRig, played_rate
from dehyst.waveforms import RATIO, TURNS, Excitation, Sampling, positive, raised_cosine, recommended, stage_excitation

# Default cycles per second, samples per cycle, and speed of the path relative to them: for one axis, and for several.
_SINGLE_AXIS, _SEVERAL_AXES = (0.1, 1000, 5.0), (1.0, 400, 1.0)
# For several axes: descending tops of each axis alone, and cycles of the first axis when all move together.
_STEPS, _CYCLES = 16, 24


@dataclass(frozen=True)
class Excitations:
    """The excitations of a calibration of one axis or several, with one column for each of several `axes`.

    `limits`: voltages and slew rate of each axis. A branch takes half a cycle of the `frequency` [Hz], or longer if a
    slew rate requires it; the path and the homing before it are `faster` by this factor. Raise `RecordError` for an
    impossible number, and for fewer than 8 samples per cycle.
    """

    limits: tuple[VoltageLimits, ...]
    sample_rate: float
    frequency: float = 0.1
    faster: float = 5.0
    axes: tuple[str, ...] = ("1",)

    def __post_init__(self) -> None:
        self.samplings()

    def samplings(self, faster: float = 1.0) -> list[Sampling]:
        """Return the sampling of the voltages of each axis, `faster` times faster."""
        return [
            Sampling(
                frequency=faster * self.frequency,
                sample_rate=self.sample_rate,
                base=bounds.low,
                limits=(bounds.low, bounds.high),
                slew_rate=bounds.slew_rate,
            )
            for bounds in self.limits
        ]

    def recommended(self) -> Excitation:
        """Return the recommended excitation; of several axes one after the other, then together."""
        tops, drives = [bounds.high for bounds in self.limits], self.samplings()
        if len(tops) == 1:
            return recommended(tops[0], drive=drives[0])
        played = stage_excitation(tops, drive=drives, steps=_STEPS, cycles=_CYCLES, axes=self.axes)
        return Excitation("axes", played.voltage, played.sample_rate)

    @property
    def branches(self) -> list[int]:
        """Number of samples between two turns of the path on each axis; the periods of the axes have no simple ratio.

        Half a faster cycle on the first axis, or more to use at most half of each slew rate.
        """
        seconds = [np.pi * (bounds.high - bounds.low) / (bounds.slew_rate or np.inf) for bounds in self.limits]
        first = int(np.ceil(self.sample_rate * max(0.5 / (self.faster * self.frequency), *seconds)))
        return [round(first * RATIO**j) for j in range(len(self.limits))]

    def homing(self) -> Excitation:
        """Return two major cycles of all axes at once: after them the state is known."""
        drives = zip(self.limits, self.samplings(self.faster), strict=True)
        cycles = [raised_cosine([bounds.high], cycles=2, drive=drive) for bounds, drive in drives]
        if len(cycles) == 1:
            return cycles[0]
        longest = max(map(len, cycles))
        # Axes that are faster wait at their lowest voltage first.
        columns = [np.append(np.full(longest - len(cycle), cycle.voltage[0]), cycle.voltage) for cycle in cycles]
        return Excitation("homing", np.column_stack(columns), self.sample_rate)


@dataclass(frozen=True)
class Plan:
    """The plan of a calibration.

    Parameters
    ----------
    frequency : float, optional
        Cycles per second [Hz] of the slowest loops; default: 0.1, and 1 for several axes. The path of a single axis is
        five times as fast.
    goal : float
        Largest error along the path [% of the stroke] of a good calibration, on every axis.

    Raises
    ------
    RecordError
        If a number is impossible.
    """

    frequency: float | None = None
    goal: float = 1.0

    def __post_init__(self) -> None:
        positive(1.0 if self.frequency is None else self.frequency, "frequency")
        positive(self.goal, "goal")

    def excitations(self, rig: AbstractRig) -> Excitations:
        """Return the excitations of this plan on a `rig`."""
        usual, samples, faster = _SINGLE_AXIS if len(rig.axes) == 1 else _SEVERAL_AXES
        frequency = self.frequency or usual
        limits = tuple(each.limits for each in rig.rigs)
        return Excitations(limits, played_rate(rig, samples * frequency), frequency, faster, rig.axes)


class PlannedStep(NamedTuple):
    """One step and its `excitation`; `more`: number of samples that follow when the model is known."""

    name: str
    words: str
    excitation: Excitation
    more: int = 0

    def as_dict(self, rig: AbstractRig) -> dict[str, Any]:
        """Return JSON values on a `rig`: duration, and range of voltages, which are lists for several axes."""
        rate, v = rig.check(self.excitation), self.excitation.voltage
        samples = len(v) + self.more
        return {
            "step": self.name,
            "what": self.words,
            "samples": samples,
            "seconds": (samples - 1) / rate,
            "lowest_V": v.min(axis=0).tolist(),
            "highest_V": v.max(axis=0).tolist(),
            "steepest_V_per_s": (np.abs(np.diff(v, axis=0)).max(axis=0) * rate).tolist(),
        }


def steps(rig: AbstractRig, plan: Plan) -> tuple[PlannedStep, ...]:
    """Return the steps that a calibration would play; raise `RecordError` if they exceed the rig's limits."""
    excitations = plan.excitations(rig)
    whole = excitations.recommended()
    what = "the recommended excitation: loops, random turns, speeds, holds"
    if len(excitations.axes) > 1:
        what = "each axis alone, then all together"
    planned = [PlannedStep(whole.name, what, whole)]
    homing, branches = excitations.homing(), excitations.branches
    # The way to the path, and the path.
    path = branches[0] + (len(TURNS) - 1) * max(branches)
    for name, words in (("nominal", "by a constant ratio"), ("compensated", "by the model")):
        what = f"homing, then a path of nine reversals {words}; its voltages are computed later"
        planned.append(PlannedStep(name, what, homing, path))
    for step in planned:
        rig.check(step.excitation)
    return tuple(planned)
