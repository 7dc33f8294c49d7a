"""The plan of a calibration, known before anything is sent."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from dehyst._errors import RecordError
from dehyst.control import PathPlanner
from dehyst.instruments.base import AbstractRig
from dehyst.instruments.calibration.comparison_loop import replay
from dehyst.instruments.calibration.protocol import ExcitationPlan, sample_rate_for
from dehyst.waveforms import Excitation
from dehyst.waveforms.excitation import positive

# Steps of every calibration, for a progress display.
STEPS = ("look", "loops", "others", "identify", "nominal", "compensated", "report")
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
        Largest error along the path [% of the stroke] of a good calibration.

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

    def __post_init__(self) -> None:
        positive(self.frequency, "frequency")
        positive(self.goal, "goal")
        if not isinstance(self.rounds, int) or self.rounds < 0:
            raise RecordError(f"rounds: got {self.rounds!r}, need a whole number, 0 or more")

    def excitations(self, rig: AbstractRig) -> ExcitationPlan:
        """Return the excitations of this plan on `rig`."""
        hold = _HOLD / self.frequency if self.hold is None else self.hold
        rate = rig.nearest_rate(sample_rate_for(self.frequency))
        return ExcitationPlan(rig.limits.low, rig.limits.high, rate, self.frequency, hold, rig.slew_rate)


class PlannedStep(NamedTuple):
    """One step, and when it is played; `excitation` is None if it depends on earlier records."""

    name: str
    words: str
    excitation: Excitation | None


def steps(rig: AbstractRig, plan: Plan) -> tuple[PlannedStep, ...]:
    """Return what a calibration would send, without sending it.

    Raise `RecordError` if it cannot be played within the rig's limits.
    """
    excitations = plan.excitations(rig)
    # With a constant ratio the voltages of the path depend on no measured displacement.
    path = PathPlanner(excitations.homing(), (0.0, 1.0), rig.limits, excitations.leg).nominal().excitation
    look = excitations.look()
    return (
        PlannedStep("comparison", "if the folder holds records: their loop twice, which must agree", replay(look)),
        PlannedStep("look", "holds at both ends, two major loops", look),
        *_training_steps(excitations, plan),
        PlannedStep("others", "loops of other heights, held out", excitations.others()),
        PlannedStep("nominal", "homing, then a path of nine reversals by a constant ratio", path),
        PlannedStep("compensated", "homing, then the same path by the model; its voltages follow", path),
    )


def entries(rig: AbstractRig, plan: Plan) -> list[dict[str, Any]]:
    """Return the steps as JSON values: what is played, for how long, and within which voltages.

    A step that depends on earlier records has no numbers. `rig` and `plan` as in `steps`, which may raise.
    """
    return [_entry(rig, step) for step in steps(rig, plan)]


def _entry(rig: AbstractRig, step: PlannedStep) -> dict[str, Any]:
    entry: dict[str, Any] = {"step": step.name, "what": step.words}
    if (voltage := step.excitation) is None:
        return entry
    rate = rig.nearest_rate(voltage.sample_rate)
    low, high = voltage.voltage_range
    return entry | {
        "samples": len(voltage),
        "seconds": (len(voltage) - 1) / rate,
        "lowest_V": low,
        "highest_V": high,
        "steepest_V_per_s": float(np.abs(np.diff(voltage.voltage)).max()) * rate,
    }


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
