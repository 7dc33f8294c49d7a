"""The complete experiment on one axis or several: excite, record, identify, compensate, and verify on the bench."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dehyst._errors import IdentifyError, ModelError
from dehyst._io import PathLike, finite, write_json
from dehyst._version import __version__
from dehyst._views.fields import json_values
from dehyst.calibration.comparison_loop import Agreement
from dehyst.calibration.plan import Plan, steps
from dehyst.calibration.protocol import CreepCheck, creep_of
from dehyst.calibration.session import NullProgress, ProgressListener, Session
from dehyst.calibration.tracking import PathPlanner, PlannedRun, TrackedPath
from dehyst.identification import Fit, StageFit, identify, identify_stage
from dehyst.identification.preprocessing.cleaning import remove_glitches
from dehyst.identification.results import write_traces
from dehyst.instruments import AbstractRig
from dehyst.model import Actuator, Stage
from dehyst.records import Record
from dehyst.trust import Insight, insight
from dehyst.waveforms import Excitation

# Files that are written at the end, next to the folder of records: of one axis, and of several.
RESULTS = ("model.json", "model.npz", "calibration.json")
STAGE_RESULTS = ("stage.json", "calibration.json")


@dataclass(frozen=True, eq=False)
class Calibration:
    """The result of a calibration.

    Attributes
    ----------
    fit : Fit or StageFit
        A StageFit of several axes.
    training, held_out : tuple of Record
    nominal, compensated : TrackedPath
        The measured path, by a constant ratio and by the model.
    goal : float
        [% of the stroke].
    unreached : tuple of str
        Where the voltage could not follow, in sentences.
    instrument : mapping
        Rig, axis, limits.
    insight : Insight or None
        None of several axes.
    creep : CreepCheck or None
        Of the first look; None of several axes.
    kept, played : tuple of str
        Records that were on disk already, and those that were played.
    agreement : Agreement or None
        Of a loop on disk with the same loop played now; None if no record was on disk.
    """

    fit: Fit | StageFit
    training: tuple[Record, ...]
    held_out: tuple[Record, ...]
    nominal: TrackedPath
    compensated: TrackedPath
    goal: float
    unreached: tuple[str, ...] = ()
    instrument: dict[str, Any] = field(default_factory=dict)
    insight: Insight | None = None
    creep: CreepCheck | None = None
    kept: tuple[str, ...] = ()
    played: tuple[str, ...] = ()
    agreement: Agreement | None = None

    @property
    def since(self) -> str:
        """When the first of its records began, in UTC."""
        return min(str(record.meta.get("started", "")) for record in (*self.training, *self.held_out))

    @property
    def model(self) -> Actuator | Stage:
        """The identified model."""
        model = self.fit.stage if isinstance(self.fit, StageFit) else self.fit.actuator
        if model is None:
            raise IdentifyError(f"{self.fit.summary()}; there is no model")
        return model

    @property
    def good(self) -> bool:
        """Whether the model is usable and the path was followed to the goal, by every axis."""
        return self.fit.good and all(one.largest_percent <= self.goal for one in self.compensated.each)

    def warnings(self) -> tuple[str, ...]:
        """Return the warnings to read before the model is used."""
        first = self.fit.remarks if self.insight is None else self.insight.warnings()
        missed = []
        for axis, one in zip(self.compensated.axes or ("",), self.compensated.each, strict=True):
            if one.largest_percent > self.goal:
                subject = f"Axis {axis} followed the path" if axis else "The path was followed"
                missed.append(
                    f"{subject} to {one.largest_percent:.3g} % of the stroke, the goal is {self.goal:g} %; look at the "
                    "report's residuals, record at the speed of use (--frequency), or allow more with --goal."
                )
        return (*first, *self.unreached, *missed)

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "program": __version__,
            **self.instrument,
            **json_values(self, "good goal_percent=goal stroke_m=nominal.stroke"),
            "creep_percent": None if self.creep is None else 100 * self.creep.share,
            "records": [record.name for record in (*self.training, *self.held_out)],
            "warnings": list(self.warnings()),
            **json_values(self, "nominal compensated kept played comparison=agreement fit"),
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
        The actuator, or each of several axes, is driven through its limits.
    folder : path
        Complete records of one axis in it are not played again, except one loop that must agree with them; those of
        several axes are moved aside.
    plan : Plan, optional
    watcher : ProgressListener, optional
        Receives the progress, like the result of `dehyst.cli.live.display`.

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
    # All that is known before is checked before anything is sent.
    steps(rig, plan)
    session = Session(folder, rig, listener)
    kind = _OneAxisRun if len(rig.axes) == 1 else _SeveralAxesRun
    run: _AbstractRun = kind(rig, session, plan, listener)
    with rig.safely():
        calibration = run.calibration()
        if calibration.played or calibration.agreement is not None:
            rig.retreat()
    run.write(calibration)
    return calibration


class _AbstractRun(ABC):
    """What calibrations of one and of several axes share: the path, the instrument and the files."""

    def __init__(self, rig: AbstractRig, session: Session, plan: Plan, listener: ProgressListener) -> None:
        self.rig, self.session, self.plan, self.listener = rig, session, plan, listener

    @abstractmethod
    def calibration(self) -> Calibration:
        """Play, identify, and play the path."""

    def write(self, calibration: Calibration) -> None:
        """Write model, traces and numbers."""
        folder, fit = self.session.folder, calibration.fit
        numbers = finite({**calibration.as_dict(), "sha256": self.session.hashes()})
        if isinstance(fit, StageFit):
            calibration.model.save(folder / STAGE_RESULTS[0])
        else:
            calibration.model.save(folder / RESULTS[0])
            write_traces(folder / RESULTS[1], fit.traces)
        write_json(folder / RESULTS[-1], {"format": "dehyst-calibration-results", "version": 1, **numbers})

    def _play(self, planned: PlannedRun, *, afresh: bool = False) -> Record:
        excitation = planned.excitation
        return self.session.record(
            excitation, excitation.name, wanted=planned.wanted, stroke=planned.stroke, afresh=afresh
        )

    def _result(self, fit: Fit | StageFit, runs: Sequence[tuple[PlannedRun, Record]], **known: Any) -> Calibration:
        """Return the result, with the paths that were played: nominal, then compensated."""
        nominal, compensated = (
            TrackedPath.of(planned, record, self.rig.rows(len(planned.excitation))) for planned, record in runs
        )
        return Calibration(
            fit,
            nominal=nominal,
            compensated=compensated,
            goal=self.plan.goal,
            unreached=runs[-1][0].warnings,
            instrument=self._instrument(),
            kept=tuple(self.session.kept),
            played=tuple(self.session.played),
            agreement=self.session.agreement,
            **known,
        )

    def _instrument(self) -> dict[str, Any]:
        limits = [[one.limits.low, one.limits.high] for one in self.rig.rigs]
        rates = [one.slew_rate for one in self.rig.rigs]
        if len(limits) == 1:
            axis = {"axis": self.rig.axis, "limits_V": limits[0], "slew_rate_V_per_s": rates[0]}
        else:
            axis = {"axes": list(self.rig.axes), "limits_V": limits, "slew_rate_V_per_s": rates}
        return {"rig": self.rig.identity, **axis}


class _SeveralAxesRun(_AbstractRun):
    """One calibration of several axes."""

    def calibration(self) -> Calibration:
        """Play, identify, and play the path."""
        excitations, record = self.plan.axes_excitations(self.rig), self.session.record
        training, held_out = record(excitations.training(), "axes"), record(excitations.others(), "others")
        self.listener.step("identify")
        fit = identify_stage(training, validate=held_out, progress=self.listener.message)
        if fit.stage is None:
            raise IdentifyError(f"{fit.verdict}; look at the records in {self.session.records}")
        stage = replace(fit.stage, name=f"{self.rig.identity}, axes {', '.join(self.rig.axes)}")
        planner = PathPlanner(excitations.homing(), [one.limits for one in self.rig.rigs], excitations.leg)
        linear = planner.nominal(stage, self.session.sequence)
        before = self._play(linear)
        modelled = planner.compensated(stage, self.session.sequence)
        runs = [(linear, before), (modelled, self._play(modelled))]
        return self._result(replace(fit, stage=stage), runs, training=(training,), held_out=(held_out,))


class _OneAxisRun(_AbstractRun):
    """One calibration of one axis."""

    def __init__(self, rig: AbstractRig, session: Session, plan: Plan, listener: ProgressListener) -> None:
        super().__init__(rig, session, plan, listener)
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
        planner = PathPlanner(self.excitations.homing(), [self.rig.limits], self.excitations.leg, _ends(loops))
        linear = planner.nominal()
        before = self._play(linear)
        modelled = planner.compensated(fit.actuator, self.session.sequence)
        if "nominal" in self.session.kept and not self.session.is_complete(modelled.excitation, "compensated"):
            # Only a record just before shows what crept meanwhile.
            before = self._play(linear, afresh=True)
            modelled = planner.compensated(fit.actuator, self.session.sequence)
        runs = [(linear, before), (modelled, self._play(modelled))]
        known = {"training": tuple(training), "held_out": (held_out,), "insight": assessment, "creep": creep}
        return self._result(fit, runs, **known)

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
            fit = identify(loops, structure="maxwell_slip", throw=False)
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


def _ends(loops: Record) -> tuple[float, float]:
    """Return the displacements [m] at the lowest and the highest voltage of major loops."""
    clean, _, _ = remove_glitches(loops)
    v, y = clean.voltage, clean.displacement
    near = 1e-4 * float(np.ptp(v))
    return float(y[v <= v.min() + near].mean()), float(y[v >= v.max() - near].mean())
