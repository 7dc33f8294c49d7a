"""A check of a model against a new record of its actuator: present and earlier errors, and what has changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from dehyst import _validation
from dehyst._errors import IdentifyError
from dehyst._threads import one_thread
from dehyst._types import Array
from dehyst._views import lines
from dehyst.identification import Prepared, Trace, cleaning, compare, errors_of, prepare_for
from dehyst.model import Actuator, Identification, Promise, TemperatureCost, promised, tested_temperatures
from dehyst.records import NOISE_PEAK, Record, largest, percent, rms
from dehyst.trust.changes import LEARNT, SLOW, UPDATE, Change, Known, Slow, find_changes

# An error this many times that of the identification is another one.
_WORSE = 1.5
# Parts of the gain and of the stroke beyond which a record is not of the model's actuator, or in other units.
_ANOTHER = 0.5
# Changes that the error sets aside.
_SET_ASIDE = ("offset", *SLOW)


class Standing(Enum):
    """Whether a model is still true; the value is the words to show."""

    STILL_TRUE = "still true"
    DRIFTS = "still true, but the record drifts"
    WITHIN_GOAL = "within the goal, but worse than promised"
    NEVER_MET = "no worse than promised, but above the goal"
    RECALIBRATE = "recalibrate"
    ANOTHER = "another actuator, or other units"


@dataclass(frozen=True, eq=False)
class Recheck:
    """The result of a check: a model compared with a new record.

    Attributes
    ----------
    record : str
        Name of the record.
    model : str
        Name of the model.
    samples, left_out : int
        Number of samples of the record that were compared, and that were left out.
    largest, rms : float
        Largest and RMS difference of measured and simulated displacement [m], without an offset and, for a model
        without creep, without a drift.
    noise : float
        Standard deviation of the sensor [m].
    before : float or None
        Largest error on the records that the model was identified from [m]; None if the model file lacks it.
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
    promise : Promise or None
        Error that the identification promised for this record's path; None if the model file lacks it.
    """

    record: str
    model: str
    samples: int
    left_out: int
    largest: float
    rms: float
    noise: float
    before: float | None
    stroke: float
    goal: float
    drift: float
    changes: tuple[Change, ...]
    remarks: tuple[str, ...]
    trace: Trace
    promise: Promise | None = None

    @property
    def without_noise(self) -> float:
        """Largest error minus the peaks of the sensor's noise [m]; it is compared with the goal."""
        return max(self.largest - NOISE_PEAK * self.noise, 0.0)

    @property
    def ratio(self) -> float | None:
        """Largest error relative to the largest error at the identification; None if the latter is not known."""
        return self.largest / self.before if self.before else None

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
            return Standing.NEVER_MET if self.kept else Standing.RECALIBRATE
        if self.promise is not None and not self.kept:
            return Standing.WITHIN_GOAL
        return Standing.DRIFTS if abs(self.drift) > allowed else Standing.STILL_TRUE

    @property
    def kept(self) -> bool:
        """Whether the promise was kept; without a promise, whether the error is near that of the identification."""
        if self.promise is not None:
            return self.without_noise <= self.promise.largest
        return self.ratio is not None and self.ratio <= _WORSE

    @property
    def good(self) -> bool:
        """Whether the model itself may be used as before."""
        return self.standing in (Standing.STILL_TRUE, Standing.DRIFTS, Standing.WITHIN_GOAL)

    @property
    def mismatch(self) -> str:
        """A sentence on why the record clearly belongs to another actuator; empty if it may belong to the model's."""
        gain = next((one.value for one in self.changed if one.name == "gain"), 0.0)
        reasons = []
        if abs(gain) > _ANOTHER:
            reasons.append(f"the gain differs by {100 * gain:+.3g} %")
        if self.without_noise > _ANOTHER * self.stroke:
            reasons.append(f"the largest error is {self._percent(self.without_noise)} of the stroke")
        found = " and ".join(reasons)
        if not found:
            return ""
        return (
            f"{self.record}: is plainly not a record of the model's actuator, or in other units: {found}, "
            f"more than {100 * _ANOTHER:g} %; check that model and record belong together, and the scales"
        )

    @property
    def sentence(self) -> str:
        """The judgement and its numbers in one line."""
        error = f"{self._percent(self.without_noise)} of the stroke without the sensor's noise"
        if not self.without_noise:
            error = "within the sensor's noise"
        text = f"{self.standing.value.capitalize()}: the largest error is {error} (goal {self.goal:g} %)"
        if self.ratio is not None and self.before is not None:
            text += (
                f"; with noise {self._percent(self.largest)}, and {self._percent(self.before)} when it was identified"
            )
        if self.promise is not None and not self.mismatch:
            promised = f"{self._percent(self.promise.largest)} on this path from its fitted start"
            text += f". The model promised {promised}: {'kept' if self.kept else 'not kept'}"
        return f"{text}. {self._advice()}"

    @property
    def advises_update(self) -> bool:
        """Whether an update may learn why the model is worse than promised, or what has changed of one above the goal.

        That is gain, width, or another shape.
        """
        learnable = not self.changed or self.changed[0].name in LEARNT
        return learnable and (
            self.standing in (Standing.WITHIN_GOAL, Standing.RECALIBRATE)
            or (self.standing is Standing.NEVER_MET and bool(self.changed))
        )

    def _advice(self) -> str:
        learns = "dehyst update can learn the change from this record" if self.advises_update else ""
        again = "Identify the model again from new records."
        if learns:
            again = f"{learns}; otherwise identify the model again from new records."
        moved = f"the drift is {self._percent(abs(self.drift))} of the stroke and will also occur on a path"
        return {
            Standing.STILL_TRUE: "No new model is needed.",
            Standing.DRIFTS: f"No new model is needed; {moved}: let the actuator warm up and rest.",
            Standing.WITHIN_GOAL: f"{learns or 'No new model is needed'}.",
            Standing.NEVER_MET: again
            if any(change.name not in _SET_ASIDE for change in self.changed)
            else "Records of the same kind would give the same error: record more loops, or allow more parts.",
            Standing.RECALIBRATE: again,
            Standing.ANOTHER: "Check that model and record belong together.",
        }[self.standing]

    def _percent(self, length: float) -> str:
        return lines.percent(length, self.stroke)

    def change_sentences(self, *, lasting: str | None = UPDATE) -> tuple[str, ...]:
        """Return a sentence for each change that counts, the largest effect first; none of another actuator.

        `lasting`: as in `Change.sentence`.
        """
        changed = () if self.mismatch else self.changed
        return tuple(change.sentence(self.stroke, lasting=lasting) for change in changed)

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values without the trace."""
        ratio = self.ratio
        return {
            "standing": self.standing.name,
            "sentence": self.sentence,
            "good": self.good,
            "advises_update": self.advises_update,
            "model": self.model,
            "record": self.record,
            "samples": self.samples,
            "left_out": self.left_out,
            "largest_percent": percent(self.largest, self.stroke),
            "rms_percent": percent(self.rms, self.stroke),
            "without_noise_percent": percent(self.without_noise, self.stroke),
            "promise": None if self.promise is None else self.promise.as_dict(),
            "before_percent": None if self.before is None else percent(self.before, self.stroke),
            "ratio": None if ratio is None or not np.isfinite(ratio) else ratio,
            "goal_percent": self.goal,
            "drift_percent": percent(self.drift, self.stroke),
            "largest_m": self.largest,
            "rms_m": self.rms,
            "noise_m": self.noise,
            "stroke_m": self.stroke,
            "changes": [change.as_dict(self.stroke) for change in self.changes],
            "changed": [change.name for change in self.changed],
            "change_sentences": list(self.change_sentences()),
            "mismatch": self.mismatch,
            "remarks": list(self.remarks),
        }


_GOAL = 1.0
# A change counts if its effect exceeds this part of the goal.
_PART = 0.25
# Steps of the search for the sensor's zero, and the part of the stroke that ends it.
_STEPS, _CLOSE = 8, 1e-5
# Part of a cycle from which on the time of creep is counted.
_EARLY = 0.1
# Parts of the range of voltages: beyond the limits by more, the record says little of the model; less than so much of
# them, it says nothing of the longest elements; with less than most of them, gain and width are those of its own loops.
_BEYOND, _LITTLE, _WHOLE = 1e-3, 0.5, 0.9


def check(actuator: Actuator, record: Record, *, goal: float | None = None) -> Recheck:
    """Check whether a model is still true by a new record of its actuator, and what has changed.

    As with a validation record, the initial state is fitted, and the whole record is simulated from it.

    Parameters
    ----------
    actuator : Actuator
    record : Record
        At least one full loop of the voltage. Three loops show a drift; best is a record over the range of later use.
    goal : float, optional
        Largest error [% of the stroke] with which the model is still true; default: the goal of its identification, or
        1.

    Returns
    -------
    Recheck

    Raises
    ------
    RecordError
        If the record cannot be used: no loop, too few samples, columns swapped, a clipped sensor.
    IdentifyError
        If no sample counts, or the goal is impossible.
    """
    if not isinstance(actuator, Actuator):
        raise IdentifyError(
            argument="actuator", got=type(actuator).__name__, need="an Actuator, such as the one of a Fit"
        )
    origin = actuator.identification or Identification()
    goal = (origin.goal or _GOAL) if goal is None else goal
    goal = _validation.between(goal, "goal", 1e-3, 100, "a part of the stroke in %")
    if not isinstance(record, Record):
        raise IdentifyError(got=type(record).__name__, need="a record", hint="read a file with dehyst.read(path)")
    with one_thread():
        prepared = prepare_for(actuator, record)
        prepared.span()
        stroke = float(np.ptp(actuator.reach))
        compared = compare(actuator, prepared, stroke, datum=_zero(actuator, prepared, stroke))
        errors, trace = errors_of(actuator, compared, "validation")
    slow = _slow(prepared, trace) if origin.drift and prepared.can_drift else ()
    error, drift = _steadied(trace, slow if actuator.creep is None else ())
    before = origin.largest_error or None
    promise, _ = promised(actuator, record.voltage, record.time, record.temperature)
    known = Known(errors.datum, _doubt(actuator, record), (before or 0.0) / NOISE_PEAK)
    changes = find_changes(trace, slow, known, _PART * goal / 100 * stroke)
    return Recheck(
        record=record.name,
        model=actuator.name,
        samples=errors.samples,
        left_out=errors.left_out,
        largest=largest(error),
        rms=rms(error),
        noise=prepared.noise,
        before=before,
        stroke=stroke,
        goal=goal,
        drift=drift,
        changes=changes,
        remarks=(*_warmth(actuator, record), *_remarks(actuator, record, changes), *prepared.sentences),
        trace=trace,
        promise=promise,
    )


def _zero(actuator: Actuator, record: Prepared, stroke: float) -> float:
    """Return the shift [m] to the model's axis for which the voltages need no offset."""
    (low, high), measured = actuator.voltage_range, record.record.displacement
    expected = actuator.major_loop(record.record.voltage_range)
    # The middle of the loop first: a sensor may have its zero far away.
    datum = 0.5 * (sum(expected) - float(measured.min()) - float(measured.max()))
    for _ in range(_STEPS):
        offset = compare(actuator, record, stroke, datum=datum).last_offsets()[-1]
        step = offset * stroke / (high - low)
        datum += step
        if abs(step) < _CLOSE * stroke:
            break
    return datum


def _slow(record: Prepared, trace: Trace) -> tuple[Slow, ...]:
    """Return the curves of creep, per decade of time, and of a drift over the record; both are 0 at its beginning."""
    time = trace.time - record.start
    creep = np.log10(1 + time / (_EARLY * cleaning.cycle_time(record.record)))
    return Slow("creep", creep), Slow("drift", time / float(time[-1]))


def _steadied(trace: Trace, slow: tuple[Slow, ...]) -> tuple[Array, float]:
    """Return the error (n,) [m] without its mean and its linear drift, and the drift [m]."""
    residual = trace.residual - trace.residual.mean()
    error, drift = residual, 0.0
    for one in slow:
        curve = one.curve - one.curve.mean()
        share = float(curve @ residual) / float(curve @ curve)
        left = residual - share * curve
        if left @ left < error @ error:
            error, drift = left, share * float(np.ptp(curve))
    return error, drift


def _doubt(actuator: Actuator, record: Record) -> float:
    """Return the uncertainty of the offset [m] due to elements that stay strained, and to creep before the record."""
    slope = float(np.ptp(actuator.voltage_range)) / float(np.ptp(actuator.reach))
    standing = 2 * actuator.slip.breakaway > record.stroke
    held = float(np.sum(actuator.slip.friction[standing]))
    if actuator.creep is not None:
        long = actuator.creep.time_constants > float(np.ptp(record.time)) / 3
        held += 0.5 * record.stroke * float(np.sum(actuator.creep.stiffness[long]))
    return held / slope


def _warmth(actuator: Actuator, record: Record) -> list[str]:
    """Return a remark if the record has no temperature on which the model depends, or one that was not tested."""
    if record.temperature is not None:
        stroke, tested = float(np.ptp(actuator.reach)), tested_temperatures(actuator)
        sentence = TemperatureCost(actuator.thermal, tested, stroke, record.temperature).sentence
        return [f"{record.name}: {sentence}"] if sentence else []
    if actuator.thermal is None:
        return []
    return [
        f"{record.name}: has no temperature, on which the model depends; it is taken for the reference, "
        f"{actuator.thermal.reference:.3g} degC"
    ]


def _remarks(actuator: Actuator, record: Record, changes: Sequence[Change]) -> list[str]:
    """Return sentences on voltages outside of the model's limits, and on voltages that the record does not cover."""
    if actuator.limits is None:
        return []
    (low, high), (least, most) = actuator.limits, record.voltage_range
    remarks, width = [], high - low
    if least < low - _BEYOND * width or most > high + _BEYOND * width:
        part = 100 * float(np.mean((record.voltage < low) | (record.voltage > high)))
        remarks.append(
            f"{record.name}: its voltages, {least:.4g} to {most:.4g} V, leave the model's limits, {low:.4g} to "
            f"{high:.4g} V, at {part:.2g} % of the samples: there the model is extrapolated, and an error is no sign "
            "of a change."
        )
    covered = (min(most, high) - max(least, low)) / width
    if covered < _LITTLE:
        remarks.append(
            f"{record.name}: covers {100 * max(covered, 0.0):.0f} % of the model's voltages: what lies beyond was not "
            "checked. Record a loop over the whole range."
        )
    if covered < _WHOLE and any(change.counts and change.name in LEARNT for change in changes):
        remarks.append(
            f"{record.name}: gain and width are those of its own loops, over {100 * max(covered, 0.0):.0f} % of the "
            "model's voltages. A change of one looks like a change of both there: a loop over the whole "
            "range separates them."
        )
    return remarks
