"""The plan of a calibration, known before anything is sent."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from dehyst._errors import RecordError
from dehyst.calibration.comparison_loop import replay
from dehyst.calibration.protocol import AxesExcitations, ExcitationPlan, sample_rate_for
from dehyst.calibration.tracking import PathPlanner
from dehyst.instruments import AbstractRig
from dehyst.waveforms import Excitation
from dehyst.waveforms.excitation import positive

# Cycles that each hold of the look lasts.
_HOLD = 3.0


@dataclass(frozen=True)
class Plan:
    """The plan of a calibration.

    Parameters
    ----------
    frequency : float
        Cycles a second [Hz] at which loops are recorded.
    hold : float, optional
        Time [s] at each voltage of the holds that measure creep; default three cycles.
    protocol : tuple of Excitation
        To be recorded instead of those that `insight` would choose.
    rounds : int
        How often `insight` may request more records.
    goal : float
        Largest error along the path [% of the stroke] of a good calibration, on every axis.
    steps, cycles : int
        Of several axes: descending tops of each alone, and cycles of the first one together with the others. They need
        no `hold`, `protocol` and `rounds`.

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
        rate = rig.nearest_rate(sample_rate_for(self.frequency))
        return ExcitationPlan(rig.limits.low, rig.limits.high, rate, self.frequency, hold, rig.slew_rate)

    def axes_excitations(self, rig: AbstractRig) -> AxesExcitations:
        """Return the excitations of this plan on a `rig` of several axes; raise RecordError if it has none."""
        if self.hold is not None or self.protocol:
            raise RecordError(
                "hold and protocol are of one axis",
                argument="plan",
                hint="leave them out, or calibrate one axis at a time",
            )
        each = tuple(self.excitations(one) for one in rig.rigs)
        return AxesExcitations(rig.axes, each, self.steps, self.cycles)

    def step_names(self, rig: AbstractRig) -> tuple[str, ...]:
        """Return the steps of every calibration of a `rig`, for a progress display."""
        first = ("look", "loops") if len(rig.axes) == 1 else ("axes",)
        return *first, "others", "identify", "nominal", "compensated", "report"


class PlannedStep(NamedTuple):
    """One step, and what is played of which `more` samples follow later; `excitation` None: by earlier records."""

    name: str
    words: str
    excitation: Excitation | None
    more: int = 0


def steps(rig: AbstractRig, plan: Plan) -> tuple[PlannedStep, ...]:
    """Return what a calibration would send, without sending it.

    Raise `RecordError` if it cannot be played within the rig's limits.
    """
    planned = _steps_of_one(rig, plan) if len(rig.axes) == 1 else _steps_of_several(rig, plan)
    for step in planned:
        if step.excitation is not None:
            rig.check(step.excitation)
    return planned


def entries(rig: AbstractRig, plan: Plan) -> list[dict[str, Any]]:
    """Return the steps as JSON values: what is played, for how long, and within which voltages.

    A step that depends on earlier records has no numbers; of several axes, voltages are lists. `rig` and `plan` as in
    `steps`, which may raise.
    """
    return [_entry(rig, step) for step in steps(rig, plan)]


def _entry(rig: AbstractRig, step: PlannedStep) -> dict[str, Any]:
    entry: dict[str, Any] = {"step": step.name, "what": step.words}
    if step.excitation is None:
        return entry
    rate, v = rig.nearest_rate(step.excitation.sample_rate), step.excitation.voltage
    samples = len(v) + step.more
    return entry | {
        "samples": samples,
        "seconds": (samples - 1) / rate,
        "lowest_V": v.min(axis=0).tolist(),
        "highest_V": v.max(axis=0).tolist(),
        "steepest_V_per_s": (np.abs(np.diff(v, axis=0)).max(axis=0) * rate).tolist(),
    }


def _steps_of_one(rig: AbstractRig, plan: Plan) -> tuple[PlannedStep, ...]:
    excitations = plan.excitations(rig)
    # With a constant ratio the voltages of the path depend on no measured displacement.
    path = PathPlanner(excitations.homing(), [rig.limits], excitations.leg, (0.0, 1.0)).nominal().excitation
    look = excitations.look()
    return (
        PlannedStep("comparison", "if the folder holds records: their loop twice, which must agree", replay(look)),
        PlannedStep("look", "holds at both ends, two major loops", look),
        *_training_steps(excitations, plan),
        PlannedStep("others", "loops of other heights, held out", excitations.others()),
        PlannedStep("nominal", "homing, then a path of nine reversals by a constant ratio", path),
        PlannedStep("compensated", "homing, then the same path by the model; its voltages follow", path),
    )


def _steps_of_several(rig: AbstractRig, plan: Plan) -> tuple[PlannedStep, ...]:
    excitations = plan.axes_excitations(rig)
    homing = excitations.homing()
    path = PathPlanner(homing, [one.limits for one in rig.rigs], excitations.leg).samples
    words = "homing, then a path of all axes by constant ratios; its voltages follow"
    return (
        PlannedStep("axes", "each axis alone, then all together", excitations.training()),
        PlannedStep("others", "all axes together, held out", excitations.others()),
        PlannedStep("nominal", words, homing, path),
        PlannedStep("compensated", "homing, then the same path by the model; its voltages follow", homing, path),
    )


def _training_steps(excitations: ExcitationPlan, plan: Plan) -> Iterator[PlannedStep]:
    if plan.protocol:
        for i, given in enumerate(plan.protocol, 1):
            yield PlannedStep(f"given-{i}", f"{given.name}, as given", given)
        return
    yield PlannedStep("loops", "what insight chooses after the look, e.g. descending tops", excitations.tops())
    for name, excitation in zip(("fast", "stairs"), excitations.creep_pair(), strict=True):
        yield PlannedStep(name, "if the look shows creep", excitation)
    for i in range(1, plan.rounds + 1):
        yield PlannedStep(f"more-{i}", "if insight finds undetermined stiffnesses", None)
