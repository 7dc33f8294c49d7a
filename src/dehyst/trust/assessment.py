"""How far a model can be trusted: the promise of a path, what the records do not test, and what to record next."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from dehyst._errors import ModelError
from dehyst._text import counted, digits, escaped
from dehyst._threads import one_thread
from dehyst._types import Array, Progress
from dehyst._views.fields import json_values
from dehyst._views.pictures import Plotted
from dehyst.control import PathPlan
from dehyst.identification import Identifiability, RecordComparison, compare_all, errors_of, identifiability, probed
from dehyst.model import Actuator, ExciteCommand, Promise, Stage, by_axis, matrix_lines, voltages_of
from dehyst.records import Record, largest
from dehyst.trust.recheck import coupling_of
from dehyst.trust.turn_plane import TurnPlane, turn_plane

# A model was identified from other records if it misses these by more than this [% of their range], and by more than
# this multiple of its error on its own records.
_WORTH, _TIMES = 0.5, 3.0
# Number of samples that shows the error of a branch; duration of a cycle of the recommended excitation, in crossings of
# the range at the speed of its fastest branch.
_ENOUGH, _CYCLE = 16, 45.0
# Half the width of a 90 % interval, in standard errors; half interval above which a coupling is uncertain.
_DEVIATIONS, _CHANGED = 1.6448536269514722, 0.005


def insight(
    model: Actuator | Stage,
    records: Record | Sequence[Record],
    *,
    plan: PathPlan | None = None,
    progress: Progress = lambda _: None,
) -> Any:
    """Assess an identified model by its records: its promise, what they do not test, and what to record next.

    Parameters
    ----------
    model : Actuator or Stage
        For a stage, each of its actuators and its coupling are assessed.
    records : Record or sequence of Record
        The records that the model was identified from.
    plan : PathPlan, optional
        A path that the model is to follow, from `dehyst.control.plan_path`; its promise is shown. Default: any path
        like the records.
    progress : callable, optional
        Called with a short text at each step.

    Returns
    -------
    Insight or StageInsight

    Raises
    ------
    RecordError, IdentifyError
        If a record cannot be used.
    ModelError
        If `model` is of another type.
    """
    if isinstance(model, Stage):
        every = [records] if isinstance(records, Record) else records
        return _stage_insight(model, every, plan, progress)
    if not isinstance(model, Actuator):
        raise ModelError(argument="model", got=type(model).__name__, need="an Actuator or a Stage")
    progress("reading the records beside the model")
    with one_thread():
        compared = compare_all(model, records)
        return Insight(model, compared, plan)


@dataclass(frozen=True, eq=False)
class Insight(Plotted):
    """How far a model can be trusted, and what to record next.

    Attributes
    ----------
    actuator : Actuator
        The model.
    comparisons : tuple
        Each record on the model's axis, for the program's own use.
    plan : PathPlan or None
        The path that is judged; None: any path like the records.
    """

    actuator: Actuator
    comparisons: tuple[RecordComparison, ...]
    plan: PathPlan | None = None

    @property
    def stroke(self) -> float:
        """The range of the widest loop of the model's records [m]."""
        return self.comparisons[0].frame.stroke

    @property
    def promise(self) -> Promise | None:
        """The promised error of the path; None if the model file lacks what its records tested."""
        return self.actuator.promise() if self.plan is None else self.plan.promise

    @property
    def expected(self) -> tuple[str, ...]:
        """The promise in sentences; none for records of another stage, which have a warning instead."""
        return () if self.promise is None or self._of_others() else self.promise.lines()

    @cached_property
    def identifiability(self) -> Identifiability:
        """Which combinations of stiffnesses of a Maxwell-slip model the turning points determine, regardless of noise.

        For a model with more parts, the result is that of ten plain Maxwell-slip elements.
        """
        pieces = [piece for item in self.comparisons for _, piece in item.source.pieces]
        grid = self.comparisons[0].program.grid
        if self.actuator._wide:
            return probed(pieces, (float(grid.knots[0]), float(grid.knots[-1])))
        sliding = 2 * self.actuator.slip.breakaway < self.stroke * (1 - 1e-9)
        return identifiability(pieces, replace(grid, sliding=sliding))

    @cached_property
    def misfit(self) -> float:
        """Largest error of the model on the records [m]."""
        traces = (errors_of(self.actuator, each, "training")[1] for each in self.comparisons)
        return max(largest(trace.settled.counted.residual) for trace in traces)

    @property
    def turns(self) -> TurnPlane | None:
        """The plane of turning points: where the records turned, and which regions they test."""
        records = (comparison.given.reduced.record for comparison in self.comparisons)
        return turn_plane(((record.name, record.time, record.voltage) for record in records), self.actuator.limits)

    def __repr__(self) -> str:
        directions = f"{self.identifiability.determined} of {self.identifiability.of} directions determined"
        return f"<Insight of '{escaped(self.actuator.name)}': {directions}, {counted(len(self.warnings()), 'warning')}>"

    def summary(self, full: bool = False) -> str:
        """Return the error to expect, warnings, what to record next, and with `full` the directions, in lines."""
        return "\n".join(escaped(line) for line in lines(self, full=full))

    @property
    def record_next(self) -> tuple[str, ...]:
        """Commands that write what to record next; empty if no excitation tests more, or the records do not fit."""
        # Records of a counted signal know the largest step of the voltage in a sample.
        step = min(item.given.record.meta.get("step_V", 0.0) for item in self.comparisons)
        allowed, fine = self.actuator.identification.allowed_slew_rate, bool(self.few_samples)
        return tuple(dict.fromkeys(str(each.within(allowed, step, fine=fine)) for each in self._asked()))

    @property
    def nothing_next(self) -> str:
        """Why no record is asked for; empty if one is."""
        why = "not known, as these records do not fit the model" if self._of_others() else "no excitation tests more"
        return "" if self.record_next else why

    def _asked(self) -> list[ExciteCommand]:
        """Return excitations that test more, whatever slew rate is allowed."""
        tested, usual = self.actuator.identification.validity, ExciteCommand(*voltages_of(self.actuator)[::-1])
        gaps = self.promise.untested if self.promise and not self._of_others() else ()
        asked = [gap.command for gap in gaps if gap.command] or [usual] * bool(self._open())
        if tested and self.few_samples and usual.kind not in {each.kind for each in asked}:
            asked.append(usual.with_cycle(_CYCLE * tested.span / tested.speeds[1]))
        return asked

    @property
    def few_samples(self) -> int:
        """Samples of the records' fastest branches, if few, and the error of fast branches misses the goal; else 0."""
        tested = self.actuator.identification.validity
        sample = min(each.given.record.sample_time for each in self.comparisons)
        goal = 0.01 * self.stroke * (self.actuator.identification.goal or 1.0)
        if not tested or not self.promise or self.promise.largest <= goal or self._of_others():
            return 0
        samples = 1 / max(tested.rates[1] * sample, 1e-300)
        return round(samples) if samples < _ENOUGH and tested.growth > tested.shown else 0

    def warnings(self) -> tuple[str, ...]:
        """Return warnings to consider before the model is used or follows the path of the `plan`."""
        missed, useless = self.plan.failure if self.plan else "", self.promise.unusable if self.promise else ""
        return tuple(filter(None, [missed, self._of_others(), useless, self._open()]))

    @property
    def origin(self) -> str:
        """A remark on records that are not those of the model, by the checksums of their files; or empty."""
        known, records = str(self.actuator.provenance), [item.given.record for item in self.comparisons]
        others = [each.name for each in records if str(each.meta.get("sha256", "sha256")) not in known]
        if "sha256" not in known or not others or self._of_others():
            return ""
        return f"The model was not identified from {', '.join(others)}: its promise rests on its own records."

    def _of_others(self) -> str:
        """Return a warning if the records are not those that the model was identified from."""
        missed, own = 100 * self.misfit / self.stroke, self.actuator.identification.largest_error
        sources = str(self.actuator.provenance)
        sums = [str(item.given.record.meta.get("sha256", "none")) for item in self.comparisons]
        # A record with a drift, which the identification removed, is not another one.
        if own is None or missed <= _WORTH or self.misfit <= _TIMES * own or all(each in sources for each in sums):
            return ""
        return (
            f"The model misses these records by up to {missed:.3g} % of their range, {digits(self.misfit / own)} times "
            "as far as the records it was identified from: give those, or run dehyst check on these."
        )

    def _open(self) -> str:
        """Return a warning if the records leave combinations of stiffnesses open that the turns of the path need."""
        found, promise = self.identifiability, self.promise
        turned = promise is not None and all(gap.what != "turns" for gap in promise.untested)
        if found.determined == found.of or turned or self._of_others():
            return ""
        return (
            f"{found.of - found.determined} of {found.of} directions of {found.subject} are open: motions that turn "
            "elsewhere than the records do may be predicted wrongly."
        )

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values; lengths in metres."""
        return {
            "records": [item.given.name for item in self.comparisons],
            "stroke_m": self.stroke,
            "origin": self.origin,
            "warnings": list(self.warnings()),
            **json_values(self, "promise few_samples record_next nothing_next"),
            "directions": json_values(self.identifiability, "determined of singular_values_V_per_V=values"),
        }


@dataclass(frozen=True, eq=False)
class StageInsight:
    """How far to trust a stage.

    Attributes
    ----------
    axes : tuple of str
    coupling, low, high : (axes, axes) array
        The coupling matrix of the stage, and the ends of the 90 % confidence interval of each entry.
    insights : tuple of Insight
        Assessment of each actuator.
    remarks : tuple of str
        Sentences on what the records leave open, and what to record next.
    """

    axes: tuple[str, ...]
    coupling: Array
    low: Array
    high: Array
    insights: tuple[Insight, ...]
    remarks: tuple[str, ...]

    def lines(self) -> list[str]:
        """Return the assessment of the coupling in lines."""
        half = (self.high - self.low) / 2
        head = "Coupling, with half the interval of each entry that the records allow (90 %):"
        return [head, *matrix_lines(self.axes, self.coupling, half), *(f"  - {remark}" for remark in self.remarks)]

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        keys = "axes coupling lowest=low highest=high remarks"
        return json_values(self, keys) | {"insights": by_axis(self.axes, self.insights)}


def _stage_insight(stage: Stage, records: Sequence[Record], plan: PathPlan | None, progress: Progress) -> StageInsight:
    """Assess a stage by the records it was identified from."""
    half = _DEVIATIONS * coupling_of(stage, records)[1]
    insights = tuple(
        insight(actuator, [stage.alone(record, j) for record in records], plan=plan and plan.each[j], progress=progress)
        for j, actuator in enumerate(stage.actuators)
    )
    remarks = tuple(
        f"coupling of {stage.axes[j]} into {stage.axes[i]} is known to ±{digits(half[i, j])} only: "
        "record `dehyst excite stage`, which moves each axis alone first"
        for i, j in np.argwhere(half > _CHANGED).tolist()
    )
    return StageInsight(stage.axes, stage.coupling, stage.coupling - half, stage.coupling + half, insights, remarks)


def lines(found: Insight, *, full: bool = True) -> Iterator[str]:
    """Yield the lines of a summary, in the order in which they matter."""
    yield from found.expected
    for warning in found.warnings():
        yield f"WARNING: {warning}"
    yield from filter(None, [found.origin])
    if full:
        known = found.identifiability
        words = f"Directions of {known.subject} that the turning points determine, whatever the noise"
        yield f"{words}: {known.determined} of {known.of}"
    if found.few_samples:
        yield f"The error grows with the speed; the fastest branches have only {found.few_samples} samples each."
    allowed = found.actuator.identification.allowed_slew_rate or np.inf
    if over := [each.speed for each in found._asked() if each.speed > allowed]:
        yield f"A test of the path takes {digits(max(over), 3)} V/s; excitations keep to the allowed {allowed:.6g} V/s."
    yield f"To record next: {found.nothing_next}." if found.nothing_next else "To record next:"
    yield from (f"    {command}" for command in found.record_next)
    if found.expected and found.promise and found.promise.delay:
        yield "To state, if it is known: who lags (dehyst identify --lag-of or --sensor-lag). This lowers the promise."
