"""The complete experiment on one axis or several: excite, record, identify, compensate, and verify on the bench."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._io import PathLike
from dehyst._text import digits
from dehyst._types import Array
from dehyst._version import __version__
from dehyst._views.fields import json_values
from dehyst.calibration.plan import Plan, steps
from dehyst.calibration.session import ProgressListener, Session, slower
from dehyst.calibration.tracking import PathPlanner, PlannedRun, TrackedPath
from dehyst.identification import Fit, StageFit, identify
from dehyst.instruments import AbstractRig
from dehyst.model import Actuator, Stage
from dehyst.records import Record, guesses
from dehyst.trust import Insight, Recheck, check, insight
from dehyst.waveforms import Excitation

# Names of the model's file beside the folder of records: for one axis, and for several.
RESULT, STAGE_RESULT = "model.json", "stage.json"
# Changes that cause a remark: of the temperature [K], and in the check of the last record.
_TEMPERATURE_CHANGE, _DRIFT_PARTS = 0.5, {"gain", "zero", "drift"}
# A readback that differs from the voltage sent by more than this share causes a remark.
_READBACK_ERROR = 0.005


@dataclass(frozen=True, eq=False)
class Calibration:
    """The result of a calibration.

    `fit`: a Fit, or for several axes a StageFit, without an `insight`. `nominal` and `compensated`: the measured path
    with a constant ratio and with the model; `checked`: the check of each axis by the record of `compensated`. `goal`:
    allowed error on the path [% of the stroke]. `remarks`: sentences on a rig that warms or drifts, and on voltages
    that could not follow the path. `training`: the record of the identification; `kept`: records that were on disk
    already; `played`: records that were played. `aside`: files in the folder that were cut off, damaged, or of another
    plan. `instrument`: the rig with its axes and limits.
    """

    fit: Fit | StageFit
    training: Record
    nominal: TrackedPath
    compensated: TrackedPath
    checked: tuple[Recheck, ...]
    goal: float
    remarks: tuple[str, ...] = ()
    instrument: dict[str, Any] = field(default_factory=dict)
    insight: Insight | None = None
    kept: tuple[str, ...] = ()
    played: tuple[str, ...] = ()
    aside: tuple[Path, ...] = ()

    @property
    def model(self) -> Actuator | Stage:
        """The identified model."""
        return self.fit.model

    @property
    def good(self) -> bool:
        """Whether the model is usable and every axis followed the path within the goal."""
        return self.fit.good and all(path.largest_percent <= self.goal for path in self.compensated.each)

    def warnings(self) -> tuple[str, ...]:
        """Return warnings to consider before the model is used."""
        first = () if self.insight is None else self.insight.warnings()
        missed = []
        for axis, path in zip(self.compensated.axes or ("",), self.compensated.each, strict=True):
            if path.largest_percent > self.goal:
                subject = f"Axis {axis} followed the path" if axis else "The path was followed"
                far = f"{subject} to {digits(path.largest_percent, 3, self.goal)} % of the stroke, the goal is"
                advice = "record at the speed of use (--frequency), or allow more with --goal."
                missed.append(f"{far} {self.goal:g} %; look at the report's residuals, {advice}")
        unused = [f"Not used, because cut off, damaged or of another plan: {path}." for path in self.aside]
        return (*first, *self.remarks, *missed, *unused)

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "program": __version__,
            **self.instrument,
            **json_values(self, "good goal_percent=goal stroke_m=nominal.stroke"),
            "records": [self.training.name],
            "warnings": list(self.warnings()),
            **json_values(self, "nominal compensated kept played fit"),
            "check": [recheck.as_dict() for recheck in self.checked],
            "aside": [str(path) for path in self.aside],
        }


def calibrate(
    rig: AbstractRig, folder: PathLike, *, plan: Plan | None = None, watcher: ProgressListener | None = None
) -> Calibration:
    """Run the complete experiment; records and model go to a folder, the voltage ends at a safe value.

    Parameters
    ----------
    rig : AbstractRig
        The rig; its actuator, or each of several axes, is driven through its limits.
    folder : path
        Folder of the results. Complete records in it, of the same plan and instrument, are not played again.
    plan : Plan, optional
    watcher : ProgressListener, optional
        Receives the progress.

    Raises
    ------
    RigError
        If the instrument fails; the samples that arrived are on disk.
    RecordError, IdentifyError, FileFormatError
        If the records cannot be used, the folder holds records of another instrument, another calibration writes into
        it, or it cannot be written.
    """
    listener, plan = watcher or ProgressListener(), plan or Plan()
    # Check everything that can be checked before anything is sent.
    steps(rig, plan)
    whole = plan.excitations(rig).recommended()
    with Session(folder, rig, listener) as session:
        model = session.folder / (RESULT if len(rig.axes) == 1 else STAGE_RESULT)
        if model.exists() and session.stored(whole.name, whole) is None:
            raise FileFormatError(
                f"{model}: is of another calibration, by other limits or another frequency; give another folder with "
                "-o, or move this model away; nothing was sent"
            )
        with rig.safely():
            calibration = _calibrated(rig, session, plan, whole, listener)
            if calibration.played:
                rig.retreat()
    calibration.model.save(model)
    return calibration


def _calibrated(
    rig: AbstractRig, session: Session, plan: Plan, whole: Excitation, listener: ProgressListener
) -> Calibration:
    """Record and identify, then play a path with a constant ratio and with the model."""
    excitations, several = plan.excitations(rig), len(rig.axes) > 1
    training, sent = session.record(whole, whole.name), whole.voltage[rig.rows(len(whole))]
    fit, insight_ = _identified(rig, training, listener)
    planner = PathPlanner(excitations)

    def play(planned: PlannedRun, *, again: bool = False) -> Record:
        return session.record(planned.excitation, planned.excitation.name, again=again)

    linear = planner.nominal(fit.model, session.sequence)
    before = play(linear)
    modelled = planner.compensated(fit.model, session.sequence)
    if "nominal" in session.kept and session.stored("compensated", modelled.excitation) is None:
        # With creep, only a record just before the path gives its start.
        session.sequence.pop()
        before = play(linear, again=True)
        modelled = planner.compensated(fit.model, session.sequence)
    after = play(modelled)
    found: Any = check(fit.model, after, goal=plan.goal)
    checked: tuple[Recheck, ...] = getattr(found, "rechecks", (found,))
    limits, rates = [[each.limits.low, each.limits.high] for each in rig.rigs], [each.slew_rate for each in rig.rigs]
    return Calibration(
        fit,
        training=training,
        nominal=TrackedPath.of(linear, before, rig.rows(len(linear.excitation))),
        compensated=TrackedPath.of(modelled, after, rig.rows(len(modelled.excitation))),
        checked=checked,
        goal=plan.goal,
        remarks=(*modelled.warnings, *slower(training, whole), *_remarks(session.sequence, checked, sent)),
        instrument={
            "rig": rig.identity,
            **({"axes": list(rig.axes)} if several else {"axis": rig.axis}),
            "limits_V": limits if several else limits[0],
            "slew_rate_V_per_s": rates if several else rates[0],
        },
        insight=insight_,
        kept=tuple(session.kept),
        played=tuple(session.played),
        aside=tuple(session.aside),
    )


def _identified(
    rig: AbstractRig, training: Record, listener: ProgressListener
) -> tuple[Fit | StageFit, Insight | None]:
    """Identify the record; for a single axis, also assess what the record determines."""
    listener.step("identify")
    fit: Any = identify(training, progress=listener.message)
    if len(rig.axes) > 1:
        return replace(fit, stage=replace(fit.stage, name=f"{rig.identity}, axes {', '.join(rig.axes)}")), None
    listener.message("assessing what the record determines")
    fit = replace(fit, actuator=replace(fit.actuator, name=f"{rig.identity}, axis {rig.axis}"))
    return fit, insight(fit.actuator, [training])


def _remarks(records: Sequence[Record], checked: Sequence[Recheck], sent: Array) -> Iterator[str]:
    """Yield remarks if the rig warms, drifts or reads in a wrong unit, by its records and the check of the last record.

    `sent` (n,) or (n, axes) [V]: the voltages of the first record.
    """
    for j, axis in enumerate(records[0].axes or ("",)):
        out, read = sent.reshape(len(sent), -1)[:, j], records[0].axis(j).voltage
        factor, where = float(np.polyfit(out, read, 1)[0]), f"Axis {axis}" if axis else "The rig"
        if abs(factor - 1) > _READBACK_ERROR:
            yield f"{where} reads {factor:.4g} V per volt sent: calibrate the readback, or return the sent voltage."
    warmth = [record.temperature for record in records if record.temperature is not None]
    if warmth and np.ptp(np.concatenate(warmth)) > _TEMPERATURE_CHANGE:
        low, high = min(map(np.min, warmth)), max(map(np.max, warmth))
        yield f"The rig warmed or cooled during the calibration, from {low:.2f} to {high:.2f} degC in all."
    for j, (axis, recheck) in enumerate(zip(records[-1].axes or ("",), checked, strict=True)):
        yield from guesses(records[-1].axis(j))
        for change in recheck.changed:
            if set(change.parts) <= _DRIFT_PARTS:
                where = f"Axis {axis}, since" if axis else "Since"
                yield f"{where} the first records: {change.sentence(recheck.stroke)}"
