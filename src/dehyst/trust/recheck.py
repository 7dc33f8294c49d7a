"""A check of a model against a new record of its actuator: present and earlier errors, and what has changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, overload

import numpy as np

from dehyst import _validation
from dehyst._errors import IdentifyError, RecordError
from dehyst._threads import one_thread
from dehyst._types import Array
from dehyst._views import lines
from dehyst._views.fields import json_values
from dehyst._views.pictures import Plotted
from dehyst.control import PossibleStart
from dehyst.identification import (
    SEPARATE,
    Plays,
    Trace,
    compare,
    errors_of,
    prepare_for,
    refuse_still,
    zero_by_voltages,
)
from dehyst.model import Actuator, ExciteCommand, Promise, Stage, State, by_axis, stroke_of, untested, voltages_of
from dehyst.records import NOISE_PEAK, Record, beyond_noise, largest, percent, rms, turning_points
from dehyst.trust.changes import LEARNT, SLOW, Change, Known, find_changes

# With a larger change of gain, or error in % of the stroke, a record is of another actuator, or in other units.
_MISMATCH = 50.0
# Paths of unchanged stages miss the promise by more than this factor in 1.2 % of cases (`benchmarks/promise.py`).
_CHANCE_FACTOR = 2.0
# Changes that are subtracted from the error.
_SUBTRACTED = ("zero", *SLOW)


class Standing(Enum):
    """Whether a model is still true; the value is the words to show."""

    STILL_TRUE = "still true"
    DRIFTS = "still true, but the record drifts"
    WITHIN_GOAL = "within the goal, but worse than promised"
    NEVER_MET = "as the model was, above the goal"
    RECALIBRATE = "recalibrate"
    ANOTHER = "another actuator, or other units"


@dataclass(frozen=True, eq=False)
class Recheck(Plotted):
    """The result of a check: a model compared with a new record.

    Attributes
    ----------
    record : str
        Name of the record.
    model : str
        Name of the model.
    largest, rms : float
        Largest and RMS difference of measured and simulated displacement [m], without an offset and, for a model
        without creep, without a drift, in the part of the record that is judged.
    noise : float
        Standard deviation of the sensor [m].
    without_noise, rms_without_noise : float
        The largest and the RMS difference that this noise does not explain [m]; these are judged.
    stroke : float
        Displacement between the model's limits [m], the reference of percentages.
    goal : float
        Allowed largest error [% of the stroke].
    drift : float
        Drift over the record [m] that was removed.
    changes : tuple of Change
        What may have changed, each with its standard error.
    remarks : tuple of str
        Sentences on what limits the result, and what was repaired.
    trace : Trace
        Measured and simulated displacement.
    unjudged : float
        Time [s] to the first turning point of the voltage if its errors may be those of an unknown start; else 0.
    promise : Promise or None
        Error that the identification promised for this record's path; None if the model file lacks it.
    to_record : str
        Command of a record that separates changes which this one cannot; empty if this one has as many loops.
    """

    record: str
    model: str
    largest: float
    rms: float
    noise: float
    without_noise: float
    rms_without_noise: float
    stroke: float
    goal: float
    drift: float
    changes: tuple[Change, ...]
    remarks: tuple[str, ...]
    trace: Trace
    unjudged: float
    promise: Promise | None = None
    to_record: str = ""

    def __repr__(self) -> str:
        return f"<Recheck of '{self.record}': {self.sentence}>"

    @property
    def changed(self) -> tuple[Change, ...]:
        """The changes that count, the largest effect first."""
        counted = [change for change in self.changes if change.counts]
        return tuple(sorted(counted, key=lambda change: -abs(change.effect)))

    @property
    def standing(self) -> Standing:
        """The judgement: whether the error is within the goal, and whether it is as promised."""
        allowed = self.goal / 100 * self.stroke
        if self.mismatch:
            return Standing.ANOTHER
        if self.without_noise > allowed:
            # Above the goal, a model is as it was if it keeps its promise, or nearly does and nothing has changed.
            unchanged = self.promise is not None and self.promise.largest > allowed
            unchanged = unchanged and all(change.name == "shape" for change in self.changed)
            as_it_was = self._missed_by <= (_CHANCE_FACTOR if unchanged else 1)
            return Standing.NEVER_MET if as_it_was else Standing.RECALIBRATE
        if self.promise is not None and not self.kept:
            return Standing.WITHIN_GOAL
        return Standing.DRIFTS if abs(self.drift) > allowed else Standing.STILL_TRUE

    @property
    def kept(self) -> bool:
        """Whether the largest and the RMS error keep the promise; False without a promise."""
        return self._missed_by <= 1

    @property
    def _missed_by(self) -> float:
        """How many times as large as promised the largest or the RMS error is; infinite without a promise."""
        return np.inf if self.promise is None else self.promise.missed_by(self.without_noise, self.rms_without_noise)

    @property
    def good(self) -> bool:
        """Whether the model itself may be used as before."""
        return self.standing in (Standing.STILL_TRUE, Standing.DRIFTS, Standing.WITHIN_GOAL)

    @property
    def mismatch(self) -> str:
        """A sentence on why a record clearly belongs to another actuator; empty if not, or if it is only late."""
        gain = next((change.value for change in self.changed if change.name == "gain"), 0.0)
        reasons = []
        if 100 * abs(gain) > _MISMATCH:
            reasons.append(f"the gain differs by {lines.percent(abs(gain), 1.0, goal=_MISMATCH)}")
        left = next((abs(change.effect) for change in self.changes if change.name == "shape"), np.inf)
        if percent(min(self.without_noise, left), self.stroke) > _MISMATCH:
            error = lines.percent(self.without_noise, self.stroke, goal=_MISMATCH)
            reasons.append(f"the largest error is {error} of the stroke")
        if not (found := " and ".join(reasons)):
            return ""
        return (
            f"{self.record}: is clearly not a record of the model's actuator, or in other units: {found}, "
            f"more than {_MISMATCH:g} %; check that model and record belong together, and the scales"
        )

    @property
    def sentence(self) -> str:
        """The judgement and its numbers in one line."""
        since = f" after the first {self.unjudged:.3g} s, whose start is not known," if self.unjudged else ""
        missed, known, stroke = (self.without_noise, self.rms_without_noise), self.promise, self.stroke
        bounds = () if known is None else (known.largest, known.rms)
        most, mean = (lines.percent(error, stroke, *bounds, goal=self.goal) for error in missed)
        text = f"{self.standing.value.capitalize()}: the error{since} is {most} of the stroke at most, {mean} RMS, "
        text += f"without a constant offset and the sensor's noise (goal {self.goal:g} %)"
        if known is not None and not self.mismatch:
            promised = " and ".join(lines.percent(bound, stroke, *missed) for bound in bounds)
            kept = "missed, as by one path in ten" if self.standing is Standing.NEVER_MET else "not kept"
            if self.kept:
                kept = "kept, but too large to be of use" if known.unusable else "kept"
            text += f". The model promised {promised} RMS on {known.path}: {kept}"
        return f"{text}. {self._advice()}"

    @property
    def advises_update(self) -> bool:
        """Whether an update may learn a change of gain, width or shape that explains the missed promise or goal."""
        own = [change for change in self.changed if not set(change.parts) <= set(_SUBTRACTED)]
        learnable = not self.changed or any(part in LEARNT for change in own[:1] for part in change.parts)
        return learnable and (
            self.standing in (Standing.WITHIN_GOAL, Standing.RECALIBRATE)
            or (self.standing is Standing.NEVER_MET and bool(self.changed))
        )

    def _advice(self) -> str:
        learns = "dehyst update may learn the change from this record" if self.advises_update else ""
        again = f"{learns}; otherwise identify" if learns else "Identify"
        again += " the model again from new records."
        drift = lines.percent(abs(self.drift), self.stroke, goal=self.goal)
        moved = f"the drift is {drift} of the stroke and will also occur on a path"
        return {
            Standing.STILL_TRUE: "No new model is needed.",
            Standing.DRIFTS: f"No new model is needed; {moved}: let the actuator warm up and rest.",
            Standing.WITHIN_GOAL: f"{learns or 'No new model is needed'}.",
            Standing.NEVER_MET: again
            if any(part not in _SUBTRACTED for change in self.changed for part in change.parts)
            else "Records of the same kind would give the same error: record more loops, or allow more parts.",
            Standing.RECALIBRATE: again,
            Standing.ANOTHER: "Check that model and record belong together.",
        }[self.standing]

    def change_sentences(self) -> tuple[str, ...]:
        """Return a sentence for each change that counts, the largest effect first; none for another actuator."""
        changed = () if self.mismatch else self.changed
        return tuple(change.sentence(self.stroke, self.to_record) for change in changed)

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values without the trace."""
        keys = "standing sentence good advises_update model record promise goal_percent=goal mismatch remarks "
        keys += "largest_m=largest rms_m=rms noise_m=noise stroke_m=stroke kept unjudged_s=unjudged"
        errors = "largest", "rms", "without_noise", "rms_without_noise", "drift"
        return {
            **json_values(self, keys),
            **{f"{name}_percent": percent(getattr(self, name), self.stroke) for name in errors},
            "changes": [change.as_dict(self.stroke) for change in self.changes],
            "changed": [change.name for change in self.changed],
            "change_sentences": list(self.change_sentences()),
        }


@dataclass(frozen=True, eq=False)
class StageRecheck:
    """Whether a stage is still true: a `Recheck` of each axis, and changes of the coupling.

    Attributes
    ----------
    axes : tuple of str
    rechecks : tuple of Recheck
        Check of each actuator.
    coupling, uncertainty : (axes, axes) array
        The coupling matrix estimated from the new record, and its standard errors.
    changes : tuple of str
        Sentences on entries of the coupling matrix that have changed.
    """

    axes: tuple[str, ...]
    rechecks: tuple[Recheck, ...]
    coupling: Array
    uncertainty: Array
    changes: tuple[str, ...]

    @property
    def good(self) -> bool:
        """Whether the model of each actuator and the coupling are still true."""
        return all(recheck.good for recheck in self.rechecks) and not self.changes

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return json_values(self, "good coupling uncertainty changes") | {"axes": by_axis(self.axes, self.rechecks)}


_GOAL = 1.0
# A change counts if its effect exceeds this part of the goal.
_EFFECT_PART = 0.25
# Number of turning points of a record that separates all changes; least return after a turn, as a part of the range.
_TURNS, _TURN_PART = 20, 0.02
# A coupling has changed if its difference exceeds this value and this multiple of its standard error.
_LEAST_CHANGE, _SIGMAS = 0.005, 3.0
# A record over less than this part of the model's voltages does not show the longest elements. A fitted start is like
# one after slow loops if their paths to the first turn differ by less than this part of the promise; samples of its
# error.
_COVERED, _START_PART, _START_SAMPLES = 0.5, 0.5, 5


@overload
def check(model: Actuator, record: Record, *, goal: float | None = None) -> Recheck: ...
@overload
def check(model: Stage, record: Record, *, goal: float | None = None) -> StageRecheck: ...
def check(model: Actuator | Stage, record: Record, *, goal: float | None = None) -> Recheck | StageRecheck:
    """Check whether a model is still true by a new record of its actuator; return a `Recheck`, or a `StageRecheck`.

    As with a validation record, the initial state is fitted, and the whole record is simulated from it.
    Of several axes each actuator is checked, and the coupling is estimated from the record: an entry has changed if it
    differs by more than 0.005 and three standard errors.

    Parameters
    ----------
    model : Actuator or Stage
    record : Record
        At least one full loop of the voltage. Three loops show a drift; best is a record over the range of later use.
    goal : float, optional
        Largest error [% of the stroke] with which the model is still true; default: the goal of its identification, or
        1.

    Raises
    ------
    RecordError
        If the record has other axes than the model, or cannot be used: no loop, too few samples, columns swapped, a
        clipped sensor.
    IdentifyError
        If no sample counts, or the goal is impossible.
    """
    if not isinstance(model, Actuator | Stage):
        raise IdentifyError(argument="model", got=type(model).__name__, need="an Actuator or a Stage, as of a Fit")
    if not isinstance(record, Record):
        raise IdentifyError(argument="record", got=type(record).__name__, need="a record, as of dehyst.read(path)")
    return _check_stage(model, record, goal) if isinstance(model, Stage) else _check_actuator(model, record, goal)


def _check_actuator(actuator: Actuator, record: Record, goal: float | None) -> Recheck:
    """Simulate a record from its fitted start, and judge what is left."""
    origin = actuator.identification
    goal = (origin.goal or _GOAL) if goal is None else goal
    goal = _validation.Numbers(least=1e-3, most=100.0, error=IdentifyError)(goal, "goal")
    with one_thread():
        prepared = prepare_for(actuator, record)
        prepared.span()
        stroke = stroke_of(actuator)
        compared = compare(actuator, prepared, stroke, zero=zero_by_voltages(actuator, prepared, stroke))
        errors, whole = errors_of(actuator, compared, "validation")
        promise = actuator.promise(record.voltage, record.time, temperature=record.temperature, begins="fitted")
        begin = _judged_from(actuator, whole, errors.starts[0], promise)
    slow, cycle, trace = origin.drift and prepared.can_drift, prepared.cycle, whole.counted
    error, drift = _steadied(trace) if slow else (trace.residual - trace.residual.mean(), 0.0)
    # The constant is the mean error of complete loops.
    judged = error[trace.time >= whole.time[begin]] - error[-whole.settled.counted.time.size if begin else 0 :].mean()
    # With as many turns as the recommended excitation has, another record would not show more.
    many = turning_points(record.voltage, _TURN_PART * float(np.ptp(record.voltage))).size > _TURNS
    own = (origin.largest_error or 0.0) / NOISE_PEAK if promise is None else promise.rms
    least = _EFFECT_PART * goal / 100 * stroke
    known = Known(errors.zero, _doubt(actuator, record), own, prepared.noise, cycle, slow, stroke, least)
    unexplained = beyond_noise(judged, prepared.noise)
    # The judgement itself says that a promise is too large to be of use.
    said = untested(actuator, promise, record.temperature)
    remarks = [words for words in said if promise is None or words != promise.unusable]
    # Loops that are slow enough to show creep; a counted signal needs a small step of the voltage in each sample.
    asked = ExciteCommand(*voltages_of(actuator)[::-1]).with_cycle(max(cycle, 10.0))
    return Recheck(
        record=record.name,
        model=actuator.name,
        largest=largest(judged),
        rms=rms(judged),
        noise=prepared.noise,
        without_noise=unexplained[0],
        rms_without_noise=unexplained[1],
        stroke=stroke,
        goal=goal,
        drift=drift,
        changes=find_changes(whole, known),
        remarks=(*remarks, *_uncovered(actuator, record), *prepared.sentences),
        trace=whole,
        unjudged=float(whole.time[begin]) - min(whole.began, float(whole.time[0])) if begin else 0.0,
        promise=promise,
        to_record="" if many else str(asked.within(origin.allowed_slew_rate, record.meta.get("step_V", 0.0))),
    )


def _check_stage(stage: Stage, record: Record, goal: float | None) -> StageRecheck:
    """Check each actuator of a stage, and estimate its coupling with plays of the voltages."""
    coupling, uncertainty = coupling_of(stage, [record])
    rechecks = tuple(check(actuator, stage.alone(record, j), goal=goal) for j, actuator in enumerate(stage.actuators))
    away, changes = coupling - stage.coupling, list[str]()
    for i, j in np.argwhere((np.abs(away) > _LEAST_CHANGE) & (np.abs(away) > _SIGMAS * uncertainty)).tolist():
        changes.append(
            f"coupling of {stage.axes[j]} into {stage.axes[i]}: {coupling[i, j]:+.4f} now, "
            f"{stage.coupling[i, j]:+.4f} in the model; identify the stage again"
        )
    return StageRecheck(stage.axes, rechecks, coupling, uncertainty, tuple(changes))


def coupling_of(stage: Stage, records: Sequence[Record]) -> tuple[Array, Array]:
    """Return the coupling matrix (axes, axes) of records, and standard errors; infinite errors if voltages are alike.

    Raise `RecordError` if a record is not one of the stage's axes, or an axis stands still.
    """
    for record in records:
        if record.axes != stage.axes:
            own, axes = ", ".join(record.axes), ", ".join(stage.axes)
            raise RecordError(f"record '{record.name}': has the axes {own}, the stage has {axes}")
    refuse_still(records)
    plays = Plays.of(records)
    if plays.separate().min() < SEPARATE:
        return stage.coupling, np.full_like(stage.coupling, np.inf)
    return plays.coupling()


def _judged_from(actuator: Actuator, trace: Trace, start: State, promise: Promise | None) -> int:
    """Return the first sample that is judged: that of the first turning point, unless the fitted `start` is known.

    It is known if the error keeps the promise, and its path is nearly the one after slow loops. Otherwise a changed
    actuator and an actuator with another past look alike until the turn. Half of a single loop would not show its
    width.
    """
    if trace.settled.time.size == trace.time.size:
        return 0
    turns = turning_points(trace.voltage, _TURN_PART * float(np.ptp(trace.voltage)))
    turn = int(turns[turns > 0][0])
    model, voltage, time = replace(actuator._before_creep, lag=0.0), trace.voltage[: turn + 1], trace.time[: turn + 1]
    ends = (PossibleStart.named(model, "top"), PossibleStart.named(model, "bottom"))
    looped = (end.standing_at(model, float(voltage[0])).state for end in ends)
    fitted, *known = (
        model.simulate(voltage, time=time, state=state, extrapolate=True).displacement
        for state in (replace(start, displacement_creep=()), *looped)
    )
    bound, apart = 0.0 if promise is None else promise.largest, np.abs(trace.residual - trace.residual[turn:].mean())
    # An error of the start is largest at the start, and gone after the turn.
    of_start = np.median(apart[:_START_SAMPLES]) > bound >= apart[turn:].max()
    return turn if of_start or min(largest(way - fitted) for way in known) > _START_PART * bound else 0


def _steadied(trace: Trace) -> tuple[Array, float]:
    """Return the error (n,) [m] without its mean and its linear drift, and the drift [m]."""
    error, time = trace.residual - trace.residual.mean(), trace.time - trace.time.mean()
    drift = float(time @ error) / float(time @ time)
    return error - drift * time, drift * float(np.ptp(time))


def _doubt(actuator: Actuator, record: Record) -> float:
    """Return the uncertainty of the offset [m] due to elements that stay strained, and to creep before the record."""
    slope = float(np.ptp(voltages_of(actuator))) / float(np.ptp(actuator.reach))
    standing, slow = 2 * actuator.slip.breakaway > record.stroke, float(np.ptp(record.time)) / 3
    held, crept = float(np.sum(actuator.slip.friction[standing])), actuator.displacement_creep
    before = 0.0 if crept is None else float(np.sum(crept.gains[crept.time_constants > slow]))
    return held / slope + 0.5 * record.stroke * before


def _uncovered(actuator: Actuator, record: Record) -> tuple[str, ...]:
    """Return a sentence if the record covers little of the model's voltages."""
    (low, high), (least, most) = voltages_of(actuator), record.voltage_range
    covered = max((min(most, high) - max(least, low)) / (high - low), 0.0)
    words = f"{record.name}: covers {100 * covered:.0f} % of the model's voltages. Record a loop over the whole range."
    return (words,) if covered < _COVERED else ()
