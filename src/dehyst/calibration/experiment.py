"""The complete experiment on one axis or several: excite, record, identify, compensate, and verify on the bench."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dehyst._io import PathLike, finite, write_json
from dehyst._version import __version__
from dehyst._views.fields import json_values
from dehyst.calibration.comparison_loop import Agreement
from dehyst.calibration.plan import CreepCheck, Plan, creep_of, steps
from dehyst.calibration.session import NullProgress, ProgressListener, Session
from dehyst.calibration.tracking import PathPlanner, PlannedRun, TrackedPath
from dehyst.identification import Fit, StageFit, identify, write_traces
from dehyst.instruments import AbstractRig
from dehyst.model import Actuator, Stage, at_reference
from dehyst.records import Record, cleaned
from dehyst.trust import Insight, insight
from dehyst.waveforms import Excitation

# Files that are written at the end, next to the folder of records: of one axis, and of several.
RESULTS = ("model.json", "model.npz", "calibration.json")
STAGE_RESULTS = ("stage.json", "calibration.json")


@dataclass(frozen=True, eq=False)
class Calibration:
    """The result of a calibration.

    `fit`: a Fit, or a StageFit of several axes; these have no `insight` and no `creep` of a first look. `nominal` and
    `compensated`: the measured path with a constant ratio and with the model. `goal`: allowed error on the path [% of
    the stroke]. `unreached`: sentences on where the voltage could not follow. `training`, `held_out`: the records;
    those in `kept` were on disk already, those in `played` were played; files in `aside` were there too, but cut off,
    damaged, or of another plan. `agreement`: comparison of a loop on disk with its replay. `instrument`: the rig with
    its axes and limits.
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
    aside: tuple[Path, ...] = ()

    @property
    def since(self) -> str:
        """Time at which the first record began, in UTC."""
        return min(str(record.meta.get("started", "")) for record in (*self.training, *self.held_out))

    @property
    def model(self) -> Actuator | Stage:
        """The identified model."""
        return self.fit.model

    @property
    def good(self) -> bool:
        """Whether the model is usable and every axis followed the path within the goal."""
        return self.fit.good and all(one.largest_percent <= self.goal for one in self.compensated.each)

    def warnings(self) -> tuple[str, ...]:
        """Return warnings to consider before the model is used."""
        first = () if self.insight is None else self.insight.warnings()
        missed = []
        for axis, one in zip(self.compensated.axes or ("",), self.compensated.each, strict=True):
            if one.largest_percent > self.goal:
                subject = f"Axis {axis} followed the path" if axis else "The path was followed"
                missed.append(
                    f"{subject} to {one.largest_percent:.3g} % of the stroke, the goal is {self.goal:g} %; look at the "
                    "report's residuals, record at the speed of use (--frequency), or allow more with --goal."
                )
        unused = [f"Not used, because cut off, damaged or of another plan: {path}." for path in self.aside]
        return (*first, *self.unreached, *missed, *unused)

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
            "aside": [str(path) for path in self.aside],
        }


def calibrate(
    rig: AbstractRig, folder: PathLike, *, plan: Plan | None = None, watcher: ProgressListener | None = None
) -> Calibration:
    """Run the complete experiment; records, model and numbers go to a folder, the voltage ends at a safe value.

    Parameters
    ----------
    rig : AbstractRig
        The rig; its actuator, or each of several axes, is driven through its limits.
    folder : path
        Folder of the results. Complete records of one axis in it are not played again, except one loop that must agree
        with them. Records of several axes are moved aside.
    plan : Plan, optional
    watcher : ProgressListener, optional
        Receives the progress.

    Raises
    ------
    RigError
        If the instrument fails; the samples that arrived are on disk.
    RecordError, IdentifyError, FileFormatError
        If the records cannot be used, the records in the folder seem to belong to another actuator, or the folder
        cannot be written.
    """
    listener = watcher or NullProgress()
    plan = plan or Plan()
    # All that is known before is checked before anything is sent.
    steps(rig, plan)
    run = _Run(rig, Session(folder, rig, listener), plan, listener)
    with rig.safely():
        calibration = run.calibration()
        if calibration.played or calibration.agreement is not None:
            rig.retreat()
    run.write(calibration)
    return calibration


class _Measured(NamedTuple):
    """Identification result, its records, and the path's beginning: after a `homing`, in legs of `leg` samples.

    `ends`: displacements [m] at the ends of the range of a single axis.
    """

    fit: Fit | StageFit
    model: Actuator | Stage
    training: tuple[Record, ...]
    held_out: Record
    homing: Excitation
    leg: int
    ends: tuple[float, float] | None = None
    insight: Insight | None = None
    creep: CreepCheck | None = None


class _Run:
    """One calibration under way."""

    def __init__(self, rig: AbstractRig, session: Session, plan: Plan, listener: ProgressListener) -> None:
        self.rig, self.session, self.plan, self.listener = rig, session, plan, listener

    def calibration(self) -> Calibration:
        """Play and identify, then play a path with a constant ratio and with the model."""
        session, rigs, several = self.session, self.rig.rigs, len(self.rig.axes) > 1
        known = self._measure_axes() if several else self._measure_axis()
        planner = PathPlanner(known.homing, [one.limits for one in rigs], known.leg, known.ends)
        linear = planner.nominal(known.model, session.sequence)
        before = self._play(linear)
        modelled = planner.compensated(known.model, session.sequence)
        if "nominal" in session.kept and not session.is_complete(modelled.excitation, "compensated"):
            # Only a record just before shows what crept meanwhile.
            before = self._play(linear, again=True)
            modelled = planner.compensated(known.model, session.sequence)
        nominal, compensated = (
            TrackedPath.of(planned, record, self.rig.rows(len(planned.excitation)))
            for planned, record in ((linear, before), (modelled, self._play(modelled)))
        )
        limits, rates = [[one.limits.low, one.limits.high] for one in rigs], [one.slew_rate for one in rigs]
        return Calibration(
            known.fit,
            training=known.training,
            held_out=(known.held_out,),
            nominal=nominal,
            compensated=compensated,
            goal=self.plan.goal,
            unreached=modelled.warnings,
            instrument={
                "rig": self.rig.identity,
                **({"axes": list(self.rig.axes)} if several else {"axis": self.rig.axis}),
                "limits_V": limits if several else limits[0],
                "slew_rate_V_per_s": rates if several else rates[0],
            },
            insight=known.insight,
            creep=known.creep,
            kept=tuple(session.kept),
            played=tuple(session.played),
            agreement=session.agreement,
            aside=tuple(session.aside),
        )

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

    def _play(self, planned: PlannedRun, *, again: bool = False) -> Record:
        excitation = planned.excitation
        return self.session.record(
            excitation, excitation.name, wanted=planned.wanted, stroke=planned.stroke, again=again
        )

    def _measure_axes(self) -> _Measured:
        """Record several axes, and identify them together."""
        excitations, record = self.plan.axes_excitations(self.rig), self.session.record
        training, held_out = record(excitations.training(), "axes"), record(excitations.others(), "others")
        self.listener.step("identify")
        fit: Any = identify(training, validate=held_out, progress=self.listener.message)
        name = f"{self.rig.identity}, axes {', '.join(self.rig.axes)}"
        stage = replace(fit.stage, name=name)
        homing, leg = excitations.homing(), excitations.leg
        return _Measured(replace(fit, stage=stage), stage, (training,), held_out, homing, leg)

    def _measure_axis(self) -> _Measured:
        """Record one axis, with further records as long as they leave stiffnesses open."""
        plan, record, excitations = self.plan, self.session.record, self.plan.excitations(self.rig)
        look = record(excitations.look(), "look")
        loops, creep = excitations.major_loops(look), creep_of(look)
        played = [(f"given-{i}", excitation) for i, excitation in enumerate(plan.protocol, 1)]
        training = [
            look,
            *(record(excitation, name) for name, excitation in played or [("loops", excitations.loops())]),
        ]
        held_out = record(excitations.others(), "others")
        fit, assessment = self._identify(training, held_out)
        for i in range(1, 1 + (0 if plan.protocol else plan.rounds)):
            if assessment.trustworthy:
                break
            training.append(record(excitations.tops(10 * (i + 1)), f"more-{i}"))
            fit, assessment = self._identify(training, held_out)
        return _Measured(
            fit,
            fit.actuator,
            tuple(training),
            held_out,
            excitations.homing(),
            excitations.leg,
            ends=_ends(at_reference(fit.actuator, loops)),
            insight=assessment,
            creep=creep,
        )

    def _identify(self, training: Sequence[Record], held_out: Record) -> tuple[Fit, Insight]:
        self.listener.step("identify")
        fit = identify(training, validate=held_out, progress=self.listener.message)
        self.listener.message("assessing what the records determine")
        name = f"{self.rig.identity}, axis {self.rig.axis}"
        fit = replace(fit, actuator=replace(fit.actuator, name=name))
        return fit, self._insight(fit, training)

    def _insight(self, fit: Fit, records: Record | Sequence[Record]) -> Insight:
        limits = self.rig.limits
        found: Insight = insight(fit.actuator, records, limits=(limits.low, limits.high))
        return found


def _ends(loops: Record) -> tuple[float, float]:
    """Return the displacements [m] at the lowest and the highest voltage of major loops."""
    clean = cleaned(loops).record
    v, y = clean.voltage, clean.displacement
    near = 1e-4 * float(np.ptp(v))
    return float(y[v <= v.min() + near].mean()), float(y[v >= v.max() - near].mean())
