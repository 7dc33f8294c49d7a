"""The complete experiment on an instrument: look, excite, record, identify, compensate, and verify on the bench."""

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

# Files that are written at the end, next to the folder of records.
RESULTS = ("model.json", "calibration.json")


@dataclass(frozen=True, eq=False)
class Calibration:
    """The result of a calibration.

    Attributes
    ----------
    fit : Fit
    insight : Insight
    creep : CreepCheck
        Of the first look.
    training, held_out : tuple of Record
    nominal, compensated : TrackedPath
        The measured path, by a constant ratio and by the model.
    goal : float
        [% of the stroke].
    unreached : tuple of str
        Where the voltage could not follow, in sentences.
    instrument : mapping
        Rig, axis, limits.
    kept, played : tuple of str
        Records that were on disk already, and those that were played.
    agreement : Agreement or None
        Of a loop on disk with the same loop played now; None if no record was on disk.
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
        return min(str(record.meta.get("started", "")) for record in (*self.training, *self.held_out))

    @property
    def good(self) -> bool:
        """Whether the model is usable and the path was followed to the goal."""
        return self.fit.good and self.compensated.largest_percent <= self.goal

    def warnings(self) -> tuple[str, ...]:
        """Return the warnings to read before the model is used."""
        error = self.compensated.largest_percent
        warnings = [*self.insight.warnings(), *self.unreached]
        if error > self.goal:
            warnings.append(
                f"The path was followed to {error:.3g} % of the stroke, the goal is {self.goal:g} %; look at the "
                "report's residuals, record at the speed of use (--frequency), or allow more with --goal."
            )
        return tuple(warnings)

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "program": __version__,
            **self.instrument,
            "good": self.good,
            "goal_percent": self.goal,
            "stroke_m": self.nominal.stroke,
            "creep_percent": 100 * self.creep.share,
            "nominal": self.nominal.as_dict(),
            "compensated": self.compensated.as_dict(),
            "records": [record.name for record in (*self.training, *self.held_out)],
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
    """Run the complete experiment; records, model and numbers go to a folder, the voltage ends at a safe value.

    Parameters
    ----------
    rig : AbstractRig
        The actuator is driven through its limits.
    folder : path
        Complete records in it are not played again, except one loop that must agree with them.
    plan : Plan, optional
    watcher : ProgressListener, optional
        Receives the progress, like the result of `dehyst.cli.output.live.display`.

    Raises
    ------
    RigError
        If the instrument fails; the samples that arrived are on disk.
    RecordError, IdentifyError
        If the records cannot be used, or those in the folder look like those of another actuator.
    FileFormatError
        If the folder cannot be written.
    """
    listener = watcher or NullProgress()
    plan = plan or Plan()
    for step in steps(rig, plan):
        if step.excitation is not None:
            rig.check(step.excitation)
    run = _CalibrationRun(rig, Session(folder, rig, listener), plan, listener)
    with rig.safely():
        calibration = run.calibration()
        if calibration.played or calibration.agreement is not None:
            rig.retreat()
    run.write(calibration)
    return calibration


class _CalibrationRun:
    """One calibration."""

    def __init__(self, rig: AbstractRig, session: Session, plan: Plan, listener: ProgressListener) -> None:
        self.rig, self.session, self.plan, self.listener = rig, session, plan, listener
        self.excitations = plan.excitations(rig)

    def calibration(self) -> Calibration:
        """Play, identify, and play the path."""
        record = self.session.record
        look = record(self.excitations.look(), "look")
        loops, creep = self.excitations.loops(look), creep_of(look)
        training = [look, *(record(excitation, name) for name, excitation in self._training(loops, creep))]
        held_out = record(self.excitations.others(), "others")
        fit, assessment = self._identify(training, held_out)
        for i in range(1, self.plan.rounds + 1):
            if assessment.trustworthy or self.plan.protocol:
                break
            training.append(record(self._more(assessment, i), f"more-{i}"))
            fit, assessment = self._identify(training, held_out)
        planner = PathPlanner(self.excitations.homing(), _ends(loops), self.rig.limits, self.excitations.leg)
        linear = planner.nominal()
        before = self._play(linear)
        modelled = planner.compensated(fit.actuator, self.session.sequence)
        if "nominal" in self.session.kept and not self.session.is_complete(modelled.excitation, "compensated"):
            # Only a record just before shows what crept meanwhile.
            before = self._play(linear, afresh=True)
            modelled = planner.compensated(fit.actuator, self.session.sequence)
        nominal, compensated = self._tracked(linear, before), self._tracked(modelled, self._play(modelled))
        return Calibration(
            fit,
            assessment,
            creep,
            tuple(training),
            (held_out,),
            nominal,
            compensated,
            self.plan.goal,
            modelled.warnings,
            self._instrument(),
            tuple(self.session.kept),
            tuple(self.session.played),
            self.session.agreement,
        )

    def write(self, calibration: Calibration) -> None:
        """Write model and numbers."""
        folder = self.session.folder
        numbers = finite({**calibration.as_dict(), "sha256": self.session.hashes()})
        model, results = (folder / name for name in RESULTS)
        calibration.fit.actuator.save(model)
        write_json(results, {"format": "dehyst-calibration-results", "version": 1, **numbers})

    def _training(self, loops: Record, creep: CreepCheck) -> Iterator[tuple[str, Excitation]]:
        """Yield the excitations to record for training, by name."""
        if self.plan.protocol:
            yield from ((f"given-{i}", excitation) for i, excitation in enumerate(self.plan.protocol, 1))
            return
        yield "loops", self._most_informative(loops)
        if creep.seen:
            yield from zip(("fast", "stairs"), self.excitations.creep_pair(), strict=True)

    def _most_informative(self, loops: Record) -> Excitation:
        """Return the excitation that adds most to the major loops."""
        self.listener.message("choosing what to record")
        try:
            fit = identify(loops, structure="paper", throw=False)
            if fit.actuator is None:
                return self.excitations.tops()
            assessment = self._insight(fit, loops)
        except (IdentifyError, ModelError):
            return self.excitations.tops()
        return self._suggested(assessment) or self.excitations.tops()

    def _more(self, assessment: Insight, number: int) -> Excitation:
        return self._suggested(assessment) or self.excitations.tops(10 * (number + 1))

    def _suggested(self, assessment: Insight) -> Excitation | None:
        if not assessment.advice:
            return None
        return self.excitations.within_slew_rate(assessment.advice[0].excitation)

    def _identify(self, training: Sequence[Record], held_out: Record) -> tuple[Fit, Insight]:
        self.listener.step("identify")
        fit = identify(training, validate=held_out, progress=self.listener.message)
        self.listener.message("assessing what the records determine")
        name = f"{self.rig.identity}, axis {self.rig.axis}"
        fit = replace(fit, actuator=replace(fit.actuator, name=name))
        return fit, self._insight(fit, training)

    def _insight(self, fit: Fit, records: Record | Sequence[Record]) -> Insight:
        return insight(fit.actuator, records, limits=(self.excitations.low, self.excitations.high), repeats=0)

    def _play(self, planned: PlannedRun, *, afresh: bool = False) -> Record:
        excitation = planned.excitation
        return self.session.record(
            excitation, excitation.name, wanted=planned.wanted, stroke=planned.stroke, afresh=afresh
        )

    def _tracked(self, planned: PlannedRun, record: Record) -> TrackedPath:
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
    """Return the displacements [m] at the lowest and the highest voltage of major loops."""
    clean, _, _ = remove_glitches(loops)
    v, y = clean.voltage, clean.displacement
    near = 1e-4 * float(np.ptp(v))
    return float(y[v <= v.min() + near].mean()), float(y[v >= v.max() - near].mean())
