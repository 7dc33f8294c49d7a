"""The whole experiment on an instrument: look, excite, record, identify, compensate, and measure what it is worth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dehyst._errors import IdentifyError, ModelError
from dehyst._io.drafts import PathLike
from dehyst._io.json_files import finite, write_json
from dehyst._version import __version__
from dehyst.control import PathPlanner, TrackedPath
from dehyst.control.tracking import PlannedRun
from dehyst.identification import identify
from dehyst.identification.preprocessing.cleaning import remove_glitches
from dehyst.instruments.base import AbstractRig
from dehyst.instruments.calibration.comparison_loop import Agreement
from dehyst.instruments.calibration.plan import Plan, steps
from dehyst.instruments.calibration.protocol import CreepCheck, creep_of
from dehyst.instruments.calibration.session import NullProgress, ProgressListener, Session
from dehyst.model import Fit
from dehyst.records import Record
from dehyst.uncertainty import Insight, insight
from dehyst.waveforms import Excitation

__all__ = ["RESULTS", "Calibration", "Plan", "calibrate"]

# Files that are written at the end, beside the records.
RESULTS = ("model.json", "calibration.json")


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a calibration found.

    Attributes
    ----------
    fit : Fit
    insight : Insight
    creep : CreepCheck
        Seen in the first look.
    training, held_out : tuple of Record
    nominal, compensated : TrackedPath
        What was measured along it, by a constant ratio and by the model.
    goal : float
        [% of the stroke].
    unreached : tuple of str
        What the voltage could not follow, in sentences.
    instrument : mapping
        Rig, axis, limits.
    kept, played : tuple of str
        Records that were on disk already, and those that were played.
    agreement : Agreement or None
        Of a loop of those on disk with the same loop played now; None if none was on disk.
    """

    fit: Fit
    insight: Insight
    creep: CreepCheck
    training: tuple[Record, ...]
    held_out: tuple[Record, ...]
    nominal: TrackedPath
    compensated: TrackedPath
    goal: float
    unreached: tuple[str, ...] = ()
    instrument: dict[str, Any] = field(default_factory=dict)
    kept: tuple[str, ...] = ()
    played: tuple[str, ...] = ()
    agreement: Agreement | None = None

    @property
    def since(self) -> str:
        """When the first of its records began, in UTC."""
        return min(str(one.meta.get("started", "")) for one in (*self.training, *self.held_out))

    @property
    def good(self) -> bool:
        """Whether the model is of use and the path was followed as well as asked."""
        return self.fit.outcome.good and self.compensated.largest_percent <= self.goal

    def warnings(self) -> tuple[str, ...]:
        """What must be known before the model is used."""
        missed = self.compensated.largest_percent
        said = [*self.insight.warnings(), *self.unreached]
        if missed > self.goal:
            said.append(
                f"The path was followed to {missed:.3g} % of the stroke, and {self.goal:g} % was asked for; look at "
                "the report's residuals, record at the speed of use (--frequency), or allow more with --goal."
            )
        return tuple(said)

    def as_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {
            "program": __version__,
            **self.instrument,
            "good": self.good,
            "goal_percent": self.goal,
            "stroke_m": self.nominal.stroke,
            "creep_percent": 100 * self.creep.share,
            "nominal": self.nominal.as_dict(),
            "compensated": self.compensated.as_dict(),
            "records": [one.name for one in (*self.training, *self.held_out)],
            "kept": list(self.kept),
            "played": list(self.played),
            "comparison": None if self.agreement is None else self.agreement.as_dict(),
            "warnings": list(self.warnings()),
            "fit": self.fit.as_dict(),
        }


def calibrate(
    rig: AbstractRig,
    folder: PathLike,
    *,
    plan: Plan | None = None,
    watcher: ProgressListener | None = None,
) -> Calibration:
    """Do the whole experiment; records, model and numbers are left in a folder, the voltage at a safe value.

    Parameters
    ----------
    rig : AbstractRig
        Its limits are what is driven through.
    folder : path
        Records in it that are whole are not played again, but for one loop that must agree with them.
    plan : Plan, optional
    watcher : ProgressListener, optional
        Is told how it goes on, as by `dehyst.cli.live.display`.

    Raises
    ------
    RigError
        If the instrument fails; what came is on disk.
    RecordError, IdentifyError
        If what was recorded cannot be used, or the records in the folder look like those of another actuator.
    FileFormatError
        If the folder cannot be written.
    """
    told = watcher or NullProgress()
    plan = plan or Plan()
    for step in steps(rig, plan):
        if step.excitation is not None:
            rig.check(step.excitation)
    job = _CalibrationRun(rig, Session(folder, rig, told), plan, told)
    with rig.safely():
        found = job.run()
        if found.played or found.agreement is not None:
            rig.retreat()
    job.write(found)
    return found


class _CalibrationRun:
    """One calibration."""

    def __init__(self, rig: AbstractRig, campaign: Session, plan: Plan, watcher: ProgressListener) -> None:
        self.rig, self.campaign, self.plan, self.watcher = rig, campaign, plan, watcher
        self.pace = plan.pace(rig)

    def run(self) -> Calibration:
        """Play, identify, play again."""
        record = self.campaign.record
        look = record(self.pace.look(), "look")
        loops, creep = self.pace.loops(look), creep_of(look)
        training = [look, *(record(one, name) for name, one in self._excitations(loops, creep))]
        held_out = record(self.pace.others(), "others")
        fit, told = self._identified(training, held_out)
        for i in range(1, self.plan.rounds + 1):
            if told.trustworthy or self.plan.protocol:
                break
            training.append(record(self._more(told, i), f"more-{i}"))
            fit, told = self._identified(training, held_out)
        planner = PathPlanner(self.pace.homing(), _ends(loops), self.rig.limits, self.pace.leg)
        linear = planner.nominal()
        before = self._played(linear)
        modelled = planner.compensated(fit.actuator, self.campaign.sequence)
        if "nominal" in self.campaign.kept and not self.campaign.holds(modelled.excitation, "compensated"):
            # What crept meanwhile, only a record just before tells.
            before = self._played(linear, afresh=True)
            modelled = planner.compensated(fit.actuator, self.campaign.sequence)
        nominal, compensated = self._followed(linear, before), self._followed(modelled, self._played(modelled))
        return Calibration(
            fit,
            told,
            creep,
            tuple(training),
            (held_out,),
            nominal,
            compensated,
            self.plan.goal,
            modelled.warnings,
            self._instrument(),
            tuple(self.campaign.kept),
            tuple(self.campaign.played),
            self.campaign.agreement,
        )

    def write(self, found: Calibration) -> None:
        """Leave model and numbers."""
        folder = self.campaign.folder
        numbers = finite({**found.as_dict(), "sha256": self.campaign.hashes()})
        model, results = (folder / name for name in RESULTS)
        found.fit.actuator.save(model)
        write_json(results, {"format": "dehyst-calibration-results", "version": 1, **numbers})

    def _excitations(self, loops: Record, creep: CreepCheck) -> Iterator[tuple[str, Excitation]]:
        """What is to be recorded, by name."""
        if self.plan.protocol:
            yield from ((f"given-{i}", one) for i, one in enumerate(self.plan.protocol, 1))
            return
        yield "loops", self._chosen(loops)
        if creep.seen:
            yield from zip(("fast", "stairs"), self.pace.slowly_and_fast(), strict=True)

    def _chosen(self, loops: Record) -> Excitation:
        """What tells most beside the major loop."""
        self.watcher.tell("choosing what to record")
        try:
            fit = identify(loops, structure="paper", throw=False)
            if fit.actuator is None:
                return self.pace.tops()
            told = insight(fit.actuator, loops, limits=(self.pace.low, self.pace.high), repeats=0)
        except (IdentifyError, ModelError):
            return self.pace.tops()
        return self._advised(told) or self.pace.tops()

    def _more(self, told: Insight, number: int) -> Excitation:
        return self._advised(told) or self.pace.tops(10 * (number + 1))

    def _advised(self, told: Insight) -> Excitation | None:
        if not told.advice:
            return None
        return self.pace.kept(told.advice[0].excitation)

    def _identified(self, training: Sequence[Record], held_out: Record) -> tuple[Fit, Insight]:
        self.watcher.step("identify")
        fit = identify(training, validate=held_out, progress=self.watcher.tell)
        self.watcher.tell("asking what the records tell")
        name = f"{self.rig.identity}, axis {self.rig.axis}"
        fit = replace(fit, actuator=replace(fit.actuator, name=name))
        return fit, insight(fit.actuator, training, limits=(self.pace.low, self.pace.high), repeats=0)

    def _played(self, planned: PlannedRun, *, afresh: bool = False) -> Record:
        excitation = planned.excitation
        return self.campaign.record(
            excitation, excitation.name, wanted=planned.wanted, stroke=planned.stroke, afresh=afresh
        )

    def _followed(self, planned: PlannedRun, record: Record) -> TrackedPath:
        return TrackedPath.of(planned, record, self.rig.rows(len(planned.excitation)))

    def _instrument(self) -> dict[str, Any]:
        limits = self.rig.limits
        return {
            "rig": self.rig.identity,
            "axis": self.rig.axis,
            "limits_V": [limits.low, limits.high],
            "slew_rate_V_per_s": self.rig.slew_rate,
        }


def _ends(loops: Record) -> tuple[float, float]:
    """Displacement [m] where the voltage of major loops turns, lowest and highest."""
    clean, _, _ = remove_glitches(loops)
    v, y = clean.voltage, clean.displacement
    near = 1e-4 * float(np.ptp(v))
    return float(y[v <= v.min() + near].mean()), float(y[v >= v.max() - near].mean())
