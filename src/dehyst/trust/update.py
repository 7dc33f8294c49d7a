"""A model updated from one new record: regularised least squares with the old model as prior."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import IdentifyError
from dehyst._text import counted
from dehyst._threads import one_thread
from dehyst._types import Array
from dehyst._views import lines
from dehyst._views.fields import json_values
from dehyst.identification import Trace, compare, errors_of, prepare_for
from dehyst.model import Actuator, Promise, Stage, Validity, by_axis
from dehyst.records import NOISE_PEAK, Record, largest, percent, rms
from dehyst.trust.active_set import StepwiseProgram
from dehyst.trust.changes import IDENTIFY, Change
from dehyst.trust.recheck import Recheck, check
from dehyst.trust.stage_assessment import check_stage
from dehyst.trust.weights import Weights

# Likeness of neighbours that is tried, as a part of what the record says, and smallness of all changes beside it: a
# strong likeness leaves a common change of all elements, and one of the spring.
_STRENGTHS, _SMALL = np.geomspace(1e-5, 1e2, 15), 1e-4
# Contiguous parts of the record: held out by equations for the choice of a strength, and by simulation for the promise.
_FOLDS, _PROMISED = 8, 3
# The updated model must predict held-out samples better than the old one by this part.
_BETTER = 0.95
# A part of the voltages that is not visited counts from here on; an element moves if twice its breakaway is reached.
_NOT_VISITED = 0.02
# Size of the strain of a branch of creep before a record, as a part of the reach, and of an error that is not noise, of
# the stroke.
_STRAINED, _DOUBT = 0.3, 5e-4


@dataclass(frozen=True, eq=False)
class Update:
    """The result of an update: a model after a new record of its actuator.

    Attributes
    ----------
    actuator : Actuator
        The updated model, or the old one if the update does not predict the record better. The record counts in the
        promise of either.
    recheck : Recheck
        The check of the old model against the record, with `changes` of gain, width and offset and their standard
        errors.
    used : bool
        Whether the model was updated.
    shape, shape_error : float
        RMS displacement [m] of the change besides gain and width, and its standard error.
    before, after, held_out : (float, float)
        Largest and RMS error [m]. `before`, `after`: of the old and the new model, simulated on the whole record.
        `held_out`: cross-validation of the update over parts of the record.
    missing : tuple of str
        Sentences on properties that the record could not show; there the old model stays.
    datum : float
        Sensor reading minus the updated model's displacement [m], attributed to the sensor's zero.
    """

    actuator: Actuator
    recheck: Recheck
    used: bool
    shape: float
    shape_error: float
    before: tuple[float, float]
    after: tuple[float, float]
    held_out: tuple[float, float]
    missing: tuple[str, ...]
    datum: float

    @property
    def stroke(self) -> float:
        """Displacement between the model's limits [m], the reference of percentages."""
        return self.recheck.stroke

    @property
    def changes(self) -> tuple[Change, ...]:
        """Possible changes with their standard errors; see `Change`."""
        return self.recheck.changes

    @property
    def sentence(self) -> str:
        """The result and its numbers in one line."""
        old, held = (lines.percent(largest_, self.stroke) for largest_ in (self.before[0], self.held_out[0]))
        if self.used:
            return (
                f"Updated: the largest error is {held} of the stroke on parts held out, where the old model has {old}."
            )
        return f"Not updated: no other model predicts the record better. Its largest error is {old} of the stroke."

    @property
    def promise(self) -> Promise | None:
        """The promised error of any path within the recorded voltages; None if it is not known."""
        known = self.actuator.identification
        return None if known is None or known.validity is None else known.validity.anywhere

    @property
    def good(self) -> bool:
        """Whether the error on held-out parts, without the sensor's noise, is within the goal."""
        return self.held_out[0] - NOISE_PEAK * self.recheck.noise <= self.recheck.goal / 100 * self.stroke

    def sentences(self) -> tuple[str, ...]:
        """Return sentences on the changes, the largest first, and on properties that the record could not show."""
        found = list(self.recheck.change_sentences(lasting=None if self.used else IDENTIFY))
        if self.used and self.shape > 2 * self.shape_error:
            size, error = (lines.percent(value, self.stroke) for value in (self.shape, self.shape_error))
            found.append(f"The shape of the loops has changed by {size} ± {error} of the stroke (RMS).")
        return (*found, *self.missing)

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values without the model."""
        pairs = {"before": self.before, "after": self.after, "held_out": self.held_out}
        return {
            **json_values(self, "used good sentence promise"),
            "sentences": list(self.sentences()),
            "changes": [change.as_dict(self.stroke) for change in self.changes],
            "shape_percent": percent(self.shape, self.stroke),
            "shape_error_percent": percent(self.shape_error, self.stroke),
            **{f"{name}_percent": [percent(one, self.stroke) for one in pair] for name, pair in pairs.items()},
            "missing": list(self.missing),
            "datum_m": self.datum,
            "stroke_m": self.stroke,
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
        return all(one.good for one in self.updates) and not self.coupling_changes

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values without the stage."""
        return {**json_values(self, "good coupling_changes"), "axes": by_axis(self.stage.axes, self.updates)}


def update(actuator: Actuator, record: Record, *, goal: float | None = None) -> Update:
    """Update a model from a new record of its actuator, even of one loop.

    Stiffnesses of slip and smooth elements, of creep branches and of the spring are fitted again, by non-negative least
    squares with a prior that groups of them change little, and like their neighbours. Cross-validation on the record
    determines the strength of the prior. Thresholds, transformer, delay, inertia, limits, creep in displacement and the
    effect of temperature stay.

    Parameters
    ----------
    actuator : Actuator
    record : Record
        At least one full loop of the voltage; minor loops show more.
    goal : float, optional
        As in `dehyst.check`.

    Returns
    -------
    Update

    Raises
    ------
    RecordError
        If the record cannot be used: no loop, too few samples, columns swapped, a clipped sensor.
    IdentifyError
        If the record clearly belongs to another actuator, no sample counts, or an argument is of another type.
    """
    if not isinstance(actuator, Actuator):
        raise IdentifyError(argument="actuator", got=type(actuator).__name__, need="an Actuator")
    if not isinstance(record, Record):
        raise IdentifyError(argument="record", got=type(record).__name__, need="a record, as of dehyst.read(path)")
    creep, thermal = actuator.displacement_creep, actuator.thermal
    if creep is not None or thermal is not None:
        found = update(replace(actuator.before_creep, thermal=None), _before(actuator, record), goal=goal)
        state = replace(found.actuator.state, displacement_creep=actuator.state.displacement_creep)
        return replace(found, actuator=replace(found.actuator, displacement_creep=creep, thermal=thermal, state=state))
    recheck = check(actuator, record, goal=goal)
    if recheck.mismatch:
        raise IdentifyError(f"{recheck.mismatch}. The model is not updated")
    trace = recheck.trace
    datum = float(np.mean(trace.measured - np.interp(trace.time, record.time, record.displacement)))
    with one_thread():
        rows = _Rows(actuator, record, recheck, datum)
        strength = rows.strength()
        if not rows.constant(rows.factors(rows.whole, strength))[1]:
            # The sensor kept its zero: the record lies on the model's axis as it is.
            rows = _Rows(actuator, record, recheck, 0.0)
            strength = rows.strength()
        return rows.update(strength)


def update_stage(stage: Stage, record: Record, *, goal: float | None = None) -> StageUpdate:
    """Update each actuator of a stage from a new record; the coupling stays, and is checked.

    Parameters
    ----------
    stage : Stage
    record : Record
        Of all axes.
    goal : float, optional
        As in `dehyst.check`.

    Raises
    ------
    RecordError, IdentifyError
        As `update`, for any axis.
    """
    changes = check_stage(stage, record, goal=goal).changes
    found = tuple(update(one, stage.alone(record, j), goal=goal) for j, one in enumerate(stage.actuators))
    return StageUpdate(replace(stage, actuators=tuple(one.actuator for one in found)), found, changes)


def _before(actuator: Actuator, record: Record) -> Record:
    """Return a record at the reference temperature and before creep in displacement."""
    settled = actuator.at_reference(record)
    if actuator.displacement_creep is None:
        return settled
    return replace(settled, displacement=actuator.displacement_creep.removed(record.time, settled.displacement))


class _Rows:
    """The rows of a record in the weights of a model, less its constants, drift and creep before it, and their sums."""

    def __init__(self, actuator: Actuator, record: Record, recheck: Recheck, datum: float) -> None:
        self.weights, self.recheck, self.record = Weights.of(actuator), recheck, record
        self.prepared, self.datum = prepare_for(actuator, record), datum
        drifts = self.prepared.can_drift and actuator.creep is None
        self.compared = compare(actuator, self.prepared, recheck.stroke, datum=self.datum, drifting=drifts)
        regression = self.compared.regression
        weight = 1 / regression.slope(self.compared.found)
        internal = regression.rows.moved[:, : regression.grid.moved]
        columns = self.weights.columns(regression.axis, regression.carts, internal) * weight[:, None]
        voltage = regression.rows.voltage
        target = (voltage if actuator.transformer is None else actuator.transformer(voltage)) * weight
        nuisances, starts = regression.nuisances(), regression.start_columns
        free = np.hstack([nuisances, starts]) * weight[:, None]
        whole = np.column_stack([columns, target])
        # A branch of creep was strained before the record by a part of the reach: the prior is one row for each.
        stiffness = np.zeros(0) if actuator.creep is None else actuator.creep.stiffness
        strained = _STRAINED * float(np.ptp(actuator.reach)) * np.resize(stiffness, starts.shape[1])
        doubt = max(recheck.noise, _DOUBT * recheck.stroke) / np.maximum(strained, 1e-9 * strained.max(initial=0.0))
        prior = np.hstack([np.zeros((doubt.size, nuisances.shape[1])), np.diag(doubt)])
        known = np.any(free != 0, axis=0)
        basis = np.linalg.qr(np.vstack([free, prior])[:, known])[0]
        rows = np.vstack([whole, np.zeros((doubt.size, whole.shape[1]))])
        rows -= basis @ (basis.T @ rows)
        self.rows, self.before = np.split(rows, [len(whole)])
        self.slope = float(1 / np.mean(weight))
        self.folds: NDArray[np.intp] = np.arange(len(whole)) * _FOLDS // len(whole)
        self.sums = np.array([own.T @ own for own in (self.rows[self.folds == k] for k in range(_FOLDS))])
        self.whole = self.sums.sum(axis=0) + self.before.T @ self.before
        self.mean = np.average(whole / weight[:, None], axis=0, weights=weight)

    def update(self, strength: float) -> Update:
        """Update with a strength of the prior, and judge."""
        factors = self.factors(self.whole, strength)
        constant, datum = self.constant(factors)
        made = self.weights.model(factors, constant)
        before = self._errors(self.recheck.trace)
        after = self._errors(self._trace(made))
        held_out = self._held_out(strength)
        used = strength < np.inf and held_out[1] < _BETTER * before[1] and after[1] < _BETTER * before[1]
        shape, spread = self._shape(strength)
        old, own = self.weights.actuator, after[0]
        if used:
            source = {"updated_from": old.name, "updated_with": self.record.name}
            made = replace(made, provenance={**old.provenance, **source})
        else:
            # The old model is still that of its own records.
            made, after, held_out, own = old, before, before, self.recheck.before or before[0]
        return Update(
            made.with_validity(self._validity(after[0], held_out[1]), own),
            self.recheck,
            used,
            shape,
            spread,
            before,
            after,
            held_out,
            tuple(self._missing()),
            -datum,
        )

    def _validity(self, largest: float, held_out: float) -> Validity:
        """Return the validity of the model after the old records and the new one; its errors as measured [m]."""
        noise, known = self.recheck.noise, self.weights.actuator.identification
        rms_ = float(np.sqrt(max(held_out**2 - noise**2, 0.0)))
        largest_ = max(largest - NOISE_PEAK * noise, 0.0)
        if known is None or known.validity is None:
            stroke = self.recheck.stroke
            played = self.record.time, self.record.voltage
            return Validity.by_records([played], rms=rms_, largest=largest_, disagreement=0.0, stroke=stroke)
        return known.validity.with_record(self.record, rms=rms_, largest=largest_)

    def factors(self, sums: Array, strength: float) -> Array:
        """Return the factors (m,) from sums over rows, with a prior of given strength."""
        weights = self.weights
        if not strength < np.inf:
            return weights.initial
        gram, image = sums[:-1, :-1], sums[:-1, -1]
        prior = weights.prior(np.diag(self.whole)[:-1], _SMALL * strength, strength)
        image = image + prior @ weights.initial
        return StepwiseProgram(gram + prior, image, weights.least, *weights.limits, weights.initial).minimum()

    def strength(self) -> float:
        """Return the prior strength with the least cross-validation error; infinite if no update helps."""
        whole, errors = self.whole, []
        for strength in (*_STRENGTHS, np.inf):
            left = 0.0
            for fold in self.sums:
                vector = np.append(self.factors(whole - fold, strength), -1.0)
                left += float(vector @ fold @ vector)
            errors.append(left)
        # The strongest prior that does nearly as well.
        good = np.flatnonzero(np.array(errors) <= 1.05 * min(errors))
        return float([*_STRENGTHS, np.inf][good[-1]])

    def constant(self, factors: Array) -> tuple[float, float]:
        """Return the spring's constant [V], and the shift [m] from the sensor's axis to the model's that belongs to it.

        The shift is 0 if a change of the weights explains the offset.
        """
        fitted = float(self.mean[-1] - self.mean[:-1] @ factors)
        wanted = fitted + self.slope * self.datum
        slack = self.slope * self.recheck.rms
        low, high = self.weights.constants(factors)
        constant = min(max(wanted, low - slack), high + slack)
        return constant, (wanted - constant) / self.slope

    def _trace(self, made: Actuator) -> Trace:
        """Return a model played along the record, from a start and with a sensor's zero that are fitted to it."""
        drifts = self.prepared.can_drift and made.creep is None
        compared = compare(made, self.prepared, self.recheck.stroke, drifting=drifts)
        return errors_of(made, compared, "validation")[1]

    def _errors(self, trace: Trace, kept: Array | None = None) -> tuple[float, float]:
        """Return the largest and the RMS residual of a trace [m], an offset set aside."""
        error = trace.residual - trace.residual.mean()
        error = error if kept is None else error[kept]
        return largest(error), rms(error)

    def _held_out(self, strength: float) -> tuple[float, float]:
        """Return largest and RMS error [m] of contiguous parts of the record, simulated by models without them."""
        if not strength < np.inf:
            return self._errors(self.recheck.trace)
        rows, time = np.arange(len(self.rows)) * _PROMISED // len(self.rows), self.compared.regression.rows.time
        parts = []
        for k in range(_PROMISED):
            own = rows == k
            others = np.vstack([self.rows[~own], self.before])
            factors = self.factors(others.T @ others, strength)
            trace = self._trace(self.weights.model(factors, self.constant(factors)[0]))
            error = trace.residual - trace.residual.mean()
            first, last = time[own].min() if k else -np.inf, time[own].max() if k < _PROMISED - 1 else np.inf
            parts.append(error[(trace.time >= first) & (trace.time <= last)])
        errors = np.concatenate(parts)
        return largest(errors), rms(errors)

    def _shape(self, strength: float) -> tuple[float, float]:
        """Return the RMS of what changed beside gain and width [m], and its standard error by the jackknife."""

        def size(sums: Array, count: int) -> float:
            fine = np.append(self.factors(sums, strength), -1.0)
            spring, initial = self.weights.springs, self.weights.initial
            common = np.zeros((initial.size + 1, 3))
            common[: spring.start, 0], common[spring, 1], common[-1, 2] = initial[: spring.start], 1.0, 1.0
            common[spring.stop : -1, 0] = initial[spring.stop :]
            small = common.T @ sums @ common
            coarse = common @ np.append(np.linalg.lstsq(small[:2, :2], small[:2, 2], rcond=None)[0], -1.0)
            return float(np.sqrt(max(coarse @ sums @ coarse - fine @ sums @ fine, 0.0) / count))

        whole, count = self.whole, len(self.rows)
        without = np.array([size(whole - one, count - int(np.sum(self.folds == k))) for k, one in enumerate(self.sums)])
        spread = float(np.sqrt((_FOLDS - 1) * np.mean((without - without.mean()) ** 2)))
        return size(whole, count), spread

    def _missing(self) -> list[str]:
        """Return sentences on what the record could not show."""
        actuator, record, missing = self.weights.actuator, self.record, []
        low, high = actuator.voltage_range
        least, most = record.voltage_range
        unseen = [
            f"{a:.4g} to {b:.4g} V"
            for a, b in ((low, min(least, high)), (max(most, low), high))
            if b - a > _NOT_VISITED * (high - low)
        ]
        if unseen:
            missing.append(f"{' and '.join(unseen)} were not visited: the old model holds there.")
        rho = actuator.slip.breakaway
        reach = float(np.ptp(self.compared.regression.axis))
        stuck = int(np.count_nonzero(2 * rho[rho * 2 < np.ptp(actuator.reach)] > reach))
        if stuck:
            missing.append(
                f"{counted(stuck, 'slip element')} did not slide both ways; the neighbours' change is taken."
            )
        span = float(np.ptp(record.time))
        if actuator.creep is not None and float(actuator.creep.time_constants.max()) > span / 3:
            missing.append(f"Creep slower than {span / 3:.3g} s is that of the old model.")
        kept = {"transformer": actuator.transformer, "delay": actuator.delay, "inertia": actuator.dynamics}
        names = [name for name, part in kept.items() if part]
        if names:
            missing.append(f"Not fitted anew: {', '.join(names)} and thresholds.")
        return missing
