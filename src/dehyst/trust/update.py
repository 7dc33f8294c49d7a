"""A model updated from one new record: the program of its identification, held near the old model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, overload

import numpy as np

from dehyst._errors import IdentifyError, ModelError
from dehyst._threads import one_thread
from dehyst._types import Array
from dehyst._views import lines
from dehyst._views.fields import json_values
from dehyst.identification import (
    FOLDS,
    Parts,
    Program,
    Solution,
    Trace,
    coefficients,
    compare,
    errors_of,
    part_of,
    prepare_for,
)
from dehyst.model import (
    Actuator,
    GradedSlip,
    Promise,
    Stage,
    Validity,
    by_axis,
    major_loop,
    voltages_of,
    with_identification,
)
from dehyst.records import Record, beyond_noise, largest, percent, rms
from dehyst.trust.recheck import Recheck, check

# Weights that keep changes of neighbours similar: for a record of a few loops, whose held-out parts cannot determine
# this weight, and for one with many turning points. Number of rows of the program.
_ALIKE, _ALIKE_BY_MANY, _ROWS = 0.1, 0.02, 6000
# Largest common change of the thresholds, as a power of e, and tolerance of its search; what a change of all
# stiffnesses by 1 must explain besides, in errors of the model.
_STRETCH, _STRETCHED, _BESIDE = 0.8, 0.02, 3.0
# A zero of the sensor that has moved by less than this part of the stroke counts as unchanged.
_KEPT = 0.15
# Common changes with a smaller independent part count as dependent.
_DEPENDENT = 1e-8
# The updated model must predict held-out samples better than the old one by this part.
_BETTER = 0.95
# Least part of the voltages that is reported as not visited.
_NOT_VISITED = 0.02


@dataclass(frozen=True, eq=False)
class Update:
    """The result of an update: a model after a new record of its actuator.

    Attributes
    ----------
    actuator : Actuator
        The updated model, or the old one if the update does not predict the record better. If the old model does not
        keep its promise on the record, the promise is widened in both cases.
    recheck : Recheck
        The check of the old model against the record, with `changes` of gain, width and zero and their standard
        errors.
    used : bool
        Whether the model was updated.
    before, after, held_out : (float, float)
        Largest and RMS error [m]. `before`, `after`: of the old and the new model, simulated on the whole record.
        `held_out`: cross-validation of the update over parts of the record.
    missing : tuple of str
        Sentences on properties that the record could not show; there the old model stays.
    zero : float
        Sensor reading minus the updated model's displacement [m], attributed to the sensor's zero.
    unexplained : float
        The largest error on held-out parts that the sensor's noise does not explain [m].
    """

    actuator: Actuator
    recheck: Recheck
    used: bool
    before: tuple[float, float]
    after: tuple[float, float]
    held_out: tuple[float, float]
    missing: tuple[str, ...]
    zero: float
    unexplained: float = 0.0

    def __repr__(self) -> str:
        return f"<Update: {self.sentence}>"

    @property
    def sentence(self) -> str:
        """The result and its numbers in one line: whether the model was updated, and whether it is good enough."""
        lengths, goal = (self.held_out[1], self.before[1], self.recheck.without_noise), self.recheck.goal
        held, old, most = (lines.percent(length, self.recheck.stroke, *lengths, goal=goal) for length in lengths)
        text = f"Updated: the RMS error is {held} of the stroke on held-out parts, where the old model has {old}."
        if not self.used:
            kept = "which its promise allows" if self.recheck.kept else "and its promise is widened by that"
            text = f"Not updated: no other model predicts the record better. The old model misses it by {most}, {kept}."
        more = f": `{self.recheck.to_record}` shows more" if self.recheck.to_record else ""
        return text if self.good else f"{text} The goal of {goal:g} % on any path is not met{more}."

    @property
    def promise(self) -> Promise | None:
        """The promised error of any path within the recorded voltages; None if it is not known."""
        return self.actuator.promise()

    @property
    def good(self) -> bool:
        """Whether the error on held-out parts, without the sensor's noise, and the promise are within the goal."""
        allowed, promise = self.recheck.goal / 100 * self.recheck.stroke, self.promise
        return max(self.unexplained, 0.0 if promise is None else promise.largest) <= allowed

    def sentences(self) -> tuple[str, ...]:
        """Return sentences on the changes, the largest first, and on properties that the record could not show."""
        return (*self.recheck.change_sentences(), *self.missing)

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values without the model."""
        stroke, pairs = self.recheck.stroke, ("before", "after", "held_out")
        return {
            **json_values(self, "used good sentence promise missing zero_m=zero"),
            **json_values(self.recheck, "stroke_m=stroke remarks"),
            "sentences": list(self.sentences()),
            "changes": [change.as_dict(stroke) for change in self.recheck.changes],
            **{f"{name}_percent": [percent(length, stroke) for length in getattr(self, name)] for name in pairs},
        }


@dataclass(frozen=True, eq=False)
class StageUpdate:
    """A stage after a new record: an `Update` of each actuator; the coupling stays, and its changes are reported.

    Attributes
    ----------
    stage : Stage
    updates : tuple of Update
        Update of each actuator.
    coupling_changes : tuple of str
        Sentences on entries of the coupling that have changed: they need a new identification.
    """

    stage: Stage
    updates: tuple[Update, ...]
    coupling_changes: tuple[str, ...]

    @property
    def good(self) -> bool:
        """Whether the error of each actuator is within the goal, and the coupling has not changed."""
        return all(updated.good for updated in self.updates) and not self.coupling_changes

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values without the stage."""
        return {**json_values(self, "good coupling_changes"), "axes": by_axis(self.stage.axes, self.updates)}


@overload
def update(model: Actuator, record: Record, *, goal: float | None = None) -> Update: ...
@overload
def update(model: Stage, record: Record, *, goal: float | None = None) -> StageUpdate: ...
def update(model: Actuator | Stage, record: Record, *, goal: float | None = None) -> Update | StageUpdate:
    """Update a model from a new record of its actuator, even of one loop; return an `Update`, or a `StageUpdate`.

    Stiffnesses of slip and smooth elements, the spring and the transformer are solved for again, by the program of the
    identification. Common changes come first: one factor for all displacements, as by a gain, one for all thresholds,
    as by a change of friction, then the stiffness of all elements and the spring. Further changes are small, and
    similar for neighbours. Inertia, limits, creep in displacement and the effect of temperature stay; so does the
    delay, unless the record shows its change by itself.

    With several axes, each actuator is updated from the motion that it causes itself; the coupling stays, and is
    checked.

    Parameters
    ----------
    model : Actuator or Stage
    record : Record
        At least one full loop of the voltage; minor loops show more.
    goal : float, optional
        As in `dehyst.check`.

    Raises
    ------
    RecordError
        If the record cannot be used: no loop, too few samples, columns swapped, a clipped sensor.
    IdentifyError
        If the record clearly belongs to another actuator, no sample counts, or an argument is of another type.
    """
    if isinstance(model, Actuator):
        return _update_actuator(model, record, goal)
    changes = check(model, record, goal=goal).changes
    found = tuple(_update_actuator(axis, model.alone(record, j), goal) for j, axis in enumerate(model.actuators))
    return StageUpdate(replace(model, actuators=tuple(updated.actuator for updated in found)), found, changes)


def _update_actuator(actuator: Actuator, record: Record, goal: float | None) -> Update:
    """Check the model, and refit it unless the record is of another actuator."""
    recheck = check(actuator, record, goal=goal)
    if recheck.mismatch:
        raise IdentifyError(f"{recheck.mismatch}. The model is not updated")
    with one_thread():
        return _Refit(actuator, record, recheck).update()


class _Refit:
    """The program of a record near an old model."""

    def __init__(self, actuator: Actuator, record: Record, recheck: Recheck) -> None:
        late = sum(change.value for change in recheck.changed if change.name == "lag")
        self.old = replace(actuator, delay=max(actuator.delay + late, 0.0)) if late else actuator
        self.given, self.recheck, self.record = actuator, recheck, record
        self.prepared = prepare_for(actuator, record)
        self.drifts = self.prepared.can_drift
        zero = next(change.value for change in recheck.changes if change.name == "zero")
        # A smaller change of the zero may come from the stage: from earlier creep, or from a gain.
        self.zero = -zero if abs(zero) > _KEPT * recheck.stroke else 0.0
        tested = actuator.identification.validity
        self.own = recheck.noise if tested is None else tested.rms

    def update(self) -> Update:
        """Update, and judge."""
        self.old = self._stretched()
        made, held_out_models = self._solved(self.old)
        if self.old.displacement_creep is not None or self.record.measured is not None:
            # Prepare again: the updated model predicts creep from before the record, and positions between events.
            self.prepared = prepare_for(made, self.record)
            made, held_out_models = self._solved(made)
        before, after = self._error(self.recheck.trace.counted), self._error(self._trace(made))
        held_out = self._held_out(held_out_models)
        used = max(rms(held_out), rms(after)) < _BETTER * rms(before)
        known: dict[str, Any] = {}
        if used:
            known["largest_error"] = largest(after)
            source = {"updated_from": self.old.name, "updated_with": self.prepared.source()}
            made = replace(made, provenance={**self.old.provenance, **source})
        else:
            # The old model stays as its own records gave it.
            made, after, held_out = self.given, before, before
        if used or not self.recheck.kept:
            made = with_identification(made, validity=self._validity(after, held_out, used=used), **known)
        old, new, unseen = ((largest(error), rms(error)) for error in (before, after, held_out))
        unexplained = beyond_noise(held_out, self.recheck.noise)[0]
        return Update(made, self.recheck, used, old, new, unseen, self._missing(made), -self.zero, unexplained)

    def _stretched(self) -> Actuator:
        """Return the old model with the friction that explains the record best; its gain may change too.

        A gain of the displacement scales all thresholds and places; a gain of the voltage is left to the stiffnesses.
        """
        from scipy.optimize import minimize_scalar

        settled, used = self.recheck.trace.settled.counted, self.record.voltage_range
        slope = float(np.polyfit(settled.simulated, settled.measured, 1)[0])
        reach = float(np.ptp(major_loop(self.old, used)))

        def scaled(power: float, *, gains: bool) -> Actuator:
            slip, smooth, factor = self.old.slip, self.old.smooth, float(np.exp(power))
            made = replace(
                self.old,
                slip=replace(slip, breakaway=factor * slip.breakaway),
                smooth=smooth and replace(smooth, length=factor * smooth.length),
                state=None,  # type: ignore[arg-type]
            )
            low, high = major_loop(made, used)
            return _grown(made, slope * reach / (high - low), low) if gains else made

        def missed(power: float, gains: bool) -> float:
            try:
                program = self._program(made := scaled(power, gains=gains))
            except ModelError:  # The voltage would not rise with the displacement.
                return self.recheck.stroke
            return self._in_common(program, program.unknowns_of(coefficients(made)), _BESIDE * self.own)[1]

        options: Any = {"bounds": (-_STRETCH, _STRETCH), "method": "bounded", "options": {"xatol": _STRETCHED}}
        found = {gains: minimize_scalar(missed, args=(gains,), **options) for gains in (False, True)}
        gains = found[True].fun < found[False].fun
        return scaled(float(found[gains].x), gains=gains)

    def _program(self, near: Actuator) -> Program:
        """Return the program of the record, near a model."""
        compared = compare(near, self.prepared, self.recheck.stroke, zero=self.zero)
        rho = near.slip.breakaway
        moving = np.any(np.reshape(near.slip.stiffness, (rho.size, -1)) > 0, axis=1)
        moving |= 2 * rho < np.ptp(near.spring.displacement) * (1 - 1e-9)
        rows, grid = compared.program.rows.thinned(_ROWS), replace(compared.program.grid, sliding=moving)
        fold = part_of((rows.time - self.record.time[0]) / float(np.ptp(self.record.time))) % FOLDS
        alike = _ALIKE if self.recheck.to_record else _ALIKE_BY_MANY
        # A drift is solved for together with the changes: solved for first, it would take a part of them.
        drift = Parts(compared.frame.motion, [self.prepared.reduced], rows).of(("drift",) if self.drifts else ())
        return Program(rows, grid, compared.program.floor, alike, tuple(drift), coefficients(near), FOLDS, fold)

    def _solved(self, near: Actuator) -> tuple[Actuator, list[Actuator]]:
        """Return the model of the whole record, and one for each part of it that is left out."""
        program = self._program(near)
        toward = self._in_common(program, program.unknowns_of(coefficients(self.old)))[0]
        program = replace(program, toward=toward)
        whole = program.solved()
        others = [program.solved(whole, without=k) for k in range(FOLDS)]
        return self._model(program, whole, whole), [self._model(program, solution, whole) for solution in others]

    @staticmethod
    def _in_common(program: Program, unknowns: Array, beside: float = 0.0) -> tuple[Array, float]:
        """Return unknowns (q,) after a bend of the spring and a linear change of the elements, and their residual [m].

        `beside` [m]: what a change of all stiffnesses by 1 must explain.
        """
        grid, places = program.grid, program.grid.places
        columns, free = program.columns
        count = int(np.count_nonzero(grid.movable))
        elements, smooth = np.zeros_like(unknowns), places["smooth"]
        elements[places["elements"]], elements[smooth] = unknowns[places["elements"]], unknowns[smooth]
        longer = np.zeros_like(unknowns)
        longer[places["elements"]] = unknowns[places["elements"]] * np.repeat(np.linspace(-1, 1, count), grid.segments)
        changes, along = [elements, longer], np.linspace(-1, 1, grid.knots.size - 1)
        for power in range(3):
            changes.append(np.zeros_like(unknowns))
            changes[-1][places["spring"]] = (unknowns[places["spring"]] + program.floor) * along**power
        fixed, basis = columns[:, free:], np.array(changes).T
        common = np.hstack([columns[:, :free], fixed @ basis])
        ridge = np.zeros((2, common.shape[1]))
        ridge[:, free : free + 2] = beside * len(program) ** 0.5 * np.eye(2)
        common, target = np.vstack([common, ridge]), np.append(program.target - fixed @ unknowns, np.zeros(2))
        sizes = np.linalg.lstsq(common, target, rcond=_DEPENDENT)[0]
        return np.maximum(unknowns + basis @ sizes[free:], 0.0), rms(common @ sizes - target)

    def _model(self, program: Program, found: Solution, whole: Solution) -> Actuator:
        """Return the old model with the coefficients of a solution; an offset without rows is that of `whole`."""
        old, last = self.old, max(whole.offsets)
        made = found.to_actuator(program.grid, found.offsets.get(last, whole.offsets[last]))
        parts = {name: getattr(made, name) for name in ("slip", "spring", "transformer")}
        return replace(old, **parts, smooth=old.smooth and replace(old.smooth, stiffness=found.smooth))

    def _trace(self, made: Actuator) -> Trace:
        """Return a model simulated along the record, with a start and a zero of the sensor that are fitted to it."""
        compared = compare(made, self.prepared, self.recheck.stroke, drifting=self.drifts)
        return errors_of(made, compared, "validation")[1].counted

    @staticmethod
    def _error(trace: Trace) -> Array:
        """Return the residual of a trace (n,) [m] without its offset."""
        return np.asarray(trace.residual - trace.residual.mean())

    def _held_out(self, models: list[Actuator]) -> Array:
        """Return the error [m] of all parts of the record, each simulated by the model that was fitted without it."""
        errors = []
        for k, model in enumerate(models):
            trace = self._trace(model)
            place = (trace.time - self.record.time[0]) / float(np.ptp(self.record.time))
            errors.append(self._error(trace)[part_of(place) % FOLDS == k])
        return np.concatenate(errors)

    def _validity(self, after: Array, held_out: Array, *, used: bool) -> Validity | None:
        """Return the validity of the model after the old records and the new one; its errors (n,) as measured [m].

        A record that confirms the promise does not widen it.
        """
        noise, tested = self.recheck.noise, self.old.identification.validity
        if tested is None:
            return None
        most, missed = (beyond_noise(error, noise)[k] for k, error in enumerate((after, held_out)))
        most, missed = (0.0, 0.0) if self.recheck.kept else (most, missed)
        lag = next(change for change in self.recheck.changes if change.name == "lag")
        # The update may take a lag for a width, unless the record names the change by itself.
        named = any(len(change.parts) == 1 for change in self.recheck.changed)
        validity = _with_record(tested, self.record, missed, most, alone=used and not named)
        error = lag.error if lag.counts else 0.0 if named else abs(lag.value)
        error, delay = max(error, validity.lag_error), self.old.delay + self.old.lag
        return replace(validity, lag=delay, lag_error=error) if used else validity

    def _missing(self, made: Actuator) -> tuple[str, ...]:
        """Return sentences on what the record could not show of the model that is `made`."""
        actuator, record, missing = self.old, self.record, list[str]()
        low, high = voltages_of(actuator)
        least, most = record.voltage_range
        parts = (low, min(least, high)), (max(most, low), high)
        unseen = [lines.ends(a, b, "V") for a, b in parts if b - a > _NOT_VISITED * (high - low)]
        if unseen:
            missing.append(f"{' and '.join(unseen)} were not visited: the old model stays there.")
        delay = actuator.delay if actuator.delay == self.given.delay else 0.0
        kept = {"delay": delay, "inertia": actuator.dynamics, "creep": actuator.displacement_creep}
        names = [name for name, part in kept.items() if part]
        if names:
            missing.append(f"Not fitted again: {', '.join(names)} and the ratios of thresholds.")
        before, after = (own.identification.validity for own in (self.given, made))
        if before and after and after.speeds[1] < before.speeds[1]:
            missing.append(f"Branches with a mean speed above {after.speeds[1]:.3g} V/s count as not tested.")
        return tuple(missing)


def _with_record(old: Validity, record: Record, missed: float, most: float, *, alone: bool) -> Validity:
    """Return a validity after one more `record`, with RMS and largest errors [m] that replace smaller ones.

    `alone`: whether the model is tested at the paces of this record alone.
    """
    warmth, played = old.temperatures, [(record.time, record.voltage)]
    if warmth is not None and record.temperature is not None:
        warmth = min(warmth[0], float(record.temperature.min())), max(warmth[1], float(record.temperature.max()))
    new = Validity.by_records(played, rms=missed, largest=most, disagreement=missed, stroke=old.stroke)
    both = {name: (*getattr(old, name), *getattr(new, name)) for name in ("limits", "speeds", "rates")}
    pairs: dict[str, Any] = {name: (min(ends), max(ends)) for name, ends in both.items()}
    names = "rms", "largest", "disagreement", "hold", "lasts"
    numbers = {name: max(getattr(old, name), getattr(new, name)) for name in names}
    if alone and old.speeds[1]:
        pairs |= {"speeds": new.speeds, "rates": new.rates}
        numbers["growth"] = old.growth * min(new.speeds[1] / old.speeds[1], 1.0)
    return replace(old, branches=np.concatenate([old.branches, new.branches]), temperatures=warmth, **pairs, **numbers)


def _grown(actuator: Actuator, factor: float, fixed: float) -> Actuator:
    """Return an actuator whose distances from a `fixed` displacement [m] are multiplied by `factor`."""
    slip, spring, smooth = actuator.slip, actuator.spring, actuator.smooth
    grades: Any = {"knots": fixed + factor * (slip.knots - fixed)} if isinstance(slip, GradedSlip) else {}
    return replace(
        actuator,
        slip=replace(slip, breakaway=factor * slip.breakaway, stiffness=slip.stiffness / factor, **grades),
        spring=replace(spring, displacement=fixed + factor * (spring.displacement - fixed)),
        smooth=smooth and replace(smooth, length=factor * smooth.length, stiffness=smooth.stiffness / factor),
        state=None,  # type: ignore[arg-type]
    )
