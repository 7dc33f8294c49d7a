"""The experiment on a rig of several axes: excite, record, identify the stage, compensate, verify on the bench."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from dehyst._errors import IdentifyError
from dehyst._io.drafts import PathLike
from dehyst._io.json_files import finite, write_json
from dehyst._types import Array
from dehyst._version import __version__
from dehyst.instruments import AbstractStageRig
from dehyst.instruments.calibration import ProgressListener
from dehyst.instruments.calibration.protocol import sample_rate_for
from dehyst.instruments.calibration.session import NullProgress
from dehyst.stages.calibration.session import StageSession
from dehyst.stages.calibration.tracking import StagePathPlanner, StageRun, TrackedStage
from dehyst.stages.excitation import StageExcitation, stage_excitation
from dehyst.stages.fit import StageFit
from dehyst.stages.identify import identify_stage
from dehyst.stages.record import StageRecord
from dehyst.stages.stage import Stage
from dehyst.waveforms import Sampling, raised_cosine
from dehyst.waveforms.excitation import positive

# Files that are written at the end, next to the folder of records.
STAGE_RESULTS = ("stage.json", "calibration.json")
# Steps of every calibration, for a progress display.
STAGE_STEPS = ("axes", "others", "identify", "nominal", "compensated", "report")
# The held-out record is of other heights, periods and turning points.
_HEIGHT, _SLOWER, _SEED = 0.97, 0.83, 100


@dataclass(frozen=True)
class StagePlan:
    """The plan of a calibration of several axes.

    Parameters
    ----------
    frequency : float
        Cycles a second [Hz] of the first axis; the others are slower when they move together.
    steps : int
        Descending tops of each axis alone.
    cycles : int
        Cycles of the first axis together with the others.
    goal : float
        Largest error along the path [% of the stroke] of a good calibration, on every axis.

    Raises
    ------
    RecordError
        If a number is impossible.
    """

    frequency: float = 1.0
    steps: int = 16
    cycles: int = 24
    goal: float = 1.0

    def __post_init__(self) -> None:
        positive(self.frequency, "frequency")
        positive(self.goal, "goal")

    def sample_rate(self, rig: AbstractStageRig) -> float:
        """Return the sample rate [Hz] on `rig`."""
        return rig.nearest_rate(sample_rate_for(self.frequency))

    def training(self, rig: AbstractStageRig) -> StageExcitation:
        """Return the axes of `rig` one after the other, then together."""
        return self._excitation(rig, 1.0, 1.0, 0)

    def others(self, rig: AbstractStageRig) -> Array:
        """Return voltages (n, axes) [V] of all axes of `rig` together, to be held out."""
        excitation = self._excitation(rig, _HEIGHT, _SLOWER, _SEED)
        return excitation.voltage[excitation.parts[-1][1] :]

    def homing(self, rig: AbstractStageRig) -> Array:
        """Return two major cycles (n, axes) [V] of all axes of `rig` at once."""
        cycles = [
            raised_cosine([top], cycles=2, drive=drive).voltage
            for top, drive in zip(_highest(rig, 1.0), self._drives(rig, 1.0), strict=True)
        ]
        longest = max(map(len, cycles))
        # Axes that are faster wait at their lowest voltage first.
        return np.column_stack([np.concatenate([np.full(longest - len(one), one[0]), one]) for one in cycles])

    def leg(self, rig: AbstractStageRig) -> int:
        """Return the samples between two turns of a path of the first axis: half a cycle, or what slew rates need.

        `rig`: its rate and slew rates count.
        """
        rate = self.sample_rate(rig)
        spans = np.array([one.high - one.low for one in rig.limits])
        return int(np.ceil(max(0.5 * rate / self.frequency, float((np.pi * spans * rate / rig.slew_rate).max()))))

    def _excitation(self, rig: AbstractStageRig, height: float, slower: float, seed: int) -> StageExcitation:
        return stage_excitation(
            _highest(rig, height),
            drive=self._drives(rig, slower),
            steps=self.steps,
            cycles=self.cycles,
            axes=rig.axes,
            seed=seed,
        )

    def _drives(self, rig: AbstractStageRig, slower: float) -> list[Sampling]:
        rate = self.sample_rate(rig)
        return [
            Sampling(
                frequency=slower * self.frequency,
                sample_rate=rate,
                base=one.low,
                limits=(one.low, one.high),
                slew_rate=one.slew_rate,
            )
            for one in rig.limits
        ]


class StageStep(NamedTuple):
    """One step of a plan: its name, what it does in words, and its voltages (n, axes) [V] as far as they are known."""

    name: str
    words: str
    voltage: Array


def stage_steps(rig: AbstractStageRig, plan: StagePlan) -> tuple[StageStep, ...]:
    """Return what a calibration would send, without sending it; of paths, only the homing is known before.

    Raise `RecordError` if it cannot be played within the rig's limits.
    """
    homing = plan.homing(rig)
    steps = (
        StageStep("axes", "each axis alone, then all together", plan.training(rig).voltage),
        StageStep("others", "all axes together, held out", plan.others(rig)),
        StageStep("nominal", "homing, then a path of all axes by constant ratios; its voltages follow", homing),
        StageStep("compensated", "homing, then the same path by the model; its voltages follow", homing),
    )
    for step in steps:
        rig.check(step.voltage, plan.sample_rate(rig), step.name)
    return steps


def stage_entries(rig: AbstractStageRig, plan: StagePlan) -> list[dict[str, Any]]:
    """Return the steps of a calibration as JSON values; parameters and errors as of `stage_steps`."""
    rate, path = plan.sample_rate(rig), plan.leg(rig)
    entries = []
    for step in stage_steps(rig, plan):
        v = step.voltage
        following = 0 if step.name in ("axes", "others") else StagePathPlanner.samples(path, len(rig.axes))
        entries.append(
            {
                "step": step.name,
                "what": step.words,
                "samples": len(v) + following,
                "seconds": (len(v) + following) / rate,
                "lowest_V": v.min(axis=0).tolist(),
                "highest_V": v.max(axis=0).tolist(),
                "steepest_V_per_s": (np.abs(np.diff(v, axis=0)).max(axis=0) * rate).tolist(),
            }
        )
    return entries


@dataclass(frozen=True, eq=False)
class StageCalibration:
    """The result of a calibration of several axes.

    Attributes
    ----------
    fit : StageFit
    stage : Stage
    training, held_out : StageRecord
    nominal, compensated : TrackedStage
        The measured path: by constant ratios, and by the model.
    goal : float
        [% of the stroke].
    unreached : tuple of str
        Where a voltage could not follow, in sentences.
    instrument : mapping
        Rig, axes, limits.
    """

    fit: StageFit
    stage: Stage
    training: StageRecord
    held_out: StageRecord
    nominal: TrackedStage
    compensated: TrackedStage
    goal: float
    unreached: tuple[str, ...] = ()
    instrument: dict[str, Any] = field(default_factory=dict)

    @property
    def good(self) -> bool:
        """Whether the stage may be used and every axis followed the path to the goal."""
        return self.fit.good and max(self.compensated.largest_percent) <= self.goal

    def warnings(self) -> Iterator[str]:
        """Yield the warnings to read before the stage is used."""
        yield from self.fit.remarks
        yield from self.unreached
        for axis, error in zip(self.compensated.axes, self.compensated.largest_percent, strict=True):
            if error > self.goal:
                yield (
                    f"Axis {axis} followed the path to {error:.3g} % of its stroke, the goal is {self.goal:g} %; look "
                    "at the report, record at the speed of use (--frequency), or allow more with --goal."
                )

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "program": __version__,
            **self.instrument,
            "good": self.good,
            "goal_percent": self.goal,
            "nominal": self.nominal.as_dict(),
            "compensated": self.compensated.as_dict(),
            "warnings": list(self.warnings()),
            "fit": self.fit.as_dict(),
        }


def calibrate_stage(
    rig: AbstractStageRig,
    folder: PathLike,
    *,
    plan: StagePlan | None = None,
    watcher: ProgressListener | None = None,
) -> StageCalibration:
    """Run the experiment on all axes; records, stage and numbers go to a folder, the voltages end at safe values.

    Parameters
    ----------
    rig : AbstractStageRig
        The actuators are driven through its limits.
    folder : path
        Records in it from before are moved aside.
    plan : StagePlan, optional
    watcher : ProgressListener, optional
        Receives the progress.

    Raises
    ------
    RigError
        If the instrument fails; the samples that arrived are on disk.
    RecordError, IdentifyError
        If the records cannot be used.
    FileFormatError
        If the folder cannot be written.
    """
    plan, listener = plan or StagePlan(), watcher or NullProgress()
    # All that is known before is checked before anything is sent.
    steps = {step.name: step.voltage for step in stage_steps(rig, plan)}
    rate, session = plan.sample_rate(rig), StageSession(folder, rig, listener)

    def tracked(run: StageRun) -> TrackedStage:
        played = session.record(run.voltage, rate, run.name, wanted=run.wanted, strokes=run.strokes)
        return TrackedStage.of(run, played, rig.rows(len(run.voltage)))

    with rig.safely():
        training = session.record(steps["axes"], rate, "axes")
        held_out = session.record(steps["others"], rate, "others")
        listener.step("identify")
        fit = identify_stage(training, validate=held_out, progress=listener.message)
        if fit.stage is None:
            raise IdentifyError(f"{fit.verdict}; look at the records in {session.records}")
        stage = replace(fit.stage, name=f"{rig.identity}, axes {', '.join(rig.axes)}")
        planner = StagePathPlanner(stage, steps["nominal"], rate, rig.limits, plan.leg(rig))
        nominal = tracked(planner.nominal(session.sequence))
        run = planner.compensated(session.sequence)
        compensated = tracked(run)
        rig.retreat()
    instrument = {
        "rig": rig.identity,
        "axes": list(rig.axes),
        "limits_V": [[one.low, one.high] for one in rig.limits],
        "slew_rate_V_per_s": rig.slew_rate.tolist(),
    }
    calibration = StageCalibration(
        fit, stage, training, held_out, nominal, compensated, plan.goal, run.warnings, instrument
    )
    stage_file, results = (session.folder / name for name in STAGE_RESULTS)
    stage.save(stage_file)
    numbers = finite({**calibration.as_dict(), "sha256": session.hashes()})
    write_json(results, {"format": "dehyst-calibration-results", "version": 1, **numbers})
    return calibration


def _highest(rig: AbstractStageRig, height: float) -> list[float]:
    return [one.low + height * (one.high - one.low) for one in rig.limits]
