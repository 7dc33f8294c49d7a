"""A model beside a new record: the errors now and then, and what has changed."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from math import isfinite

import numpy as np

from dehyst import _validation
from dehyst._errors import IdentifyError
from dehyst._threads import one_thread
from dehyst._types import Array
from dehyst.identification.checking.changes import Known, Slow, find_changes
from dehyst.identification.checking.recheck import Recheck
from dehyst.identification.preprocessing import cleaning
from dehyst.identification.preprocessing.preparation import Prepared
from dehyst.identification.validation import Protocol, compare, errors_of, prepare_for
from dehyst.model import Actuator, Trace
from dehyst.records import Record
from dehyst.records.hdf5 import sha256_of
from dehyst.records.metrics import NOISE_PEAK, largest, rms

_GOAL = 1.0
# A change counts if its effect exceeds this part of the goal.
_PART = 0.25
# Steps of the search for the sensor's zero, and the part of the stroke that ends it.
_STEPS, _CLOSE = 8, 1e-5
# Part of a cycle from which on the time of creep is counted.
_EARLY = 0.1
# Parts of the range of voltages: beyond the limits by more, the record says little of the model; less than so much of
# them, it says nothing of the longest elements.
_BEYOND, _LITTLE = 1e-3, 0.5
# Of hashes; and what of a model file is not part of the model.
_DIGITS = 16
_NO_NUMBERS = {"format", "version", "name", "provenance", "state"}


def check(actuator: Actuator, record: Record, *, goal: float | None = None) -> Recheck:
    """Compare a model with a new record of its actuator: whether it is still true, and what has changed.

    The whole record is simulated from a start that is fitted to it, as a validation record is.

    Parameters
    ----------
    actuator : Actuator
    record : Record
        One full loop of the voltage at least; three show a drift, the range of later use shows most.
    goal : float, optional
        Largest error [% of the stroke] with which the model is still true; default: that of its identification, or 1.

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
        raise IdentifyError(f"actuator: got {type(actuator).__name__}, need an Actuator, such as the one of a Fit")
    goal = (_number_of(actuator, "goal_percent") or _GOAL) if goal is None else goal
    goal = _validation.between(goal, "goal", 1e-3, 100, "a part of the stroke in %")
    if not isinstance(record, Record):
        raise IdentifyError(f"got {type(record).__name__}, need a record; read a file with dehyst.read(path)")
    with one_thread():
        prepared = prepare_for(actuator, record)
        prepared.span()
        stroke = float(np.ptp(actuator.reach))
        protocol = Protocol("validation", actuator.delay, 0.0, False, stroke)
        protocol = replace(protocol, datum=_zero(actuator, prepared, protocol))
        errors, trace = errors_of(actuator, prepared, protocol)
    drifts = bool(actuator.provenance.get("drift", True)) and prepared.can_drift
    slow = _slow(prepared, trace) if drifts else ()
    error, drift = _steadied(trace, slow if actuator.creep is None else ())
    before = _number_of(actuator, "largest_error_m")
    known = Known(errors.datum, _doubt(actuator, record), (before or 0.0) / NOISE_PEAK)
    return Recheck(
        record=record.name,
        model=actuator.name,
        record_id=_record_id(record),
        model_id=_model_id(actuator),
        samples=errors.samples,
        left_out=errors.left_out,
        largest=largest(error),
        rms=rms(error),
        noise=prepared.noise,
        before=before,
        stroke=stroke,
        goal=goal,
        drift=drift,
        changes=find_changes(trace, slow, known, _PART * goal / 100 * stroke),
        remarks=(*_remarks(actuator, record), *prepared.sentences),
        trace=trace,
    )


def _record_id(record: Record) -> str:
    """Return a hash of the samples."""
    return sha256_of((record.time, record.voltage, record.displacement))[:_DIGITS]


def _model_id(actuator: Actuator) -> str:
    """Return a hash of the numbers, whatever the model's name and origin."""
    numbers = {key: value for key, value in actuator.as_dict().items() if key not in _NO_NUMBERS}
    return hashlib.sha256(json.dumps(numbers, sort_keys=True).encode()).hexdigest()[:_DIGITS]


def _zero(actuator: Actuator, record: Prepared, protocol: Protocol) -> float:
    """Return the shift [m] to the model's axis with which the voltages need no offset."""
    (low, high), measured = actuator.voltage_range, record.record.displacement_range
    expected = actuator.major_loop(record.record.voltage_range)
    # The middle of the loop first: a sensor may have its zero far away.
    datum = 0.5 * (sum(expected) - sum(measured))
    for _ in range(_STEPS):
        offset = compare(actuator, record, replace(protocol, datum=datum)).last_offsets()[-1]
        step = offset * protocol.stroke / (high - low)
        datum += step
        if abs(step) < _CLOSE * protocol.stroke:
            break
    return datum


def _slow(record: Prepared, trace: Trace) -> tuple[Slow, ...]:
    """Return the curves of creep, by decade of time, and of a drift, over the record; both 0 as the record began."""
    time = trace.time - record.start
    creep = np.log10(1 + time / (_EARLY * cleaning.cycle_time(record.record)))
    return Slow("creep", creep), Slow("drift", time / float(time[-1]))


def _steadied(trace: Trace, slow: tuple[Slow, ...]) -> tuple[Array, float]:
    """Return the error (n,) [m] without its mean and the drift that explains most of it, and that drift [m]."""
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
    """Return what a record leaves open of the offset [m]: elements that stay strained throughout, creep before it."""
    slope = float(np.ptp(actuator.voltage_range)) / float(np.ptp(actuator.reach))
    standing = 2 * actuator.slip.breakaway > record.stroke
    held = float(np.sum(actuator.slip.friction[standing]))
    if actuator.creep is not None:
        long = actuator.creep.time_constants > float(np.ptp(record.time)) / 3
        held += 0.5 * record.stroke * float(np.sum(actuator.creep.stiffness[long]))
    return held / slope


def _number_of(actuator: Actuator, entry: str) -> float | None:
    """Return a positive number of a model's provenance, which anybody may have written; None if it has no such."""
    value = actuator.provenance.get(entry)
    known = isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value) and value > 0
    return float(value) if known and value is not None else None


def _remarks(actuator: Actuator, record: Record) -> list[str]:
    """Return sentences on voltages outside of the model's, and on those that the record leaves out."""
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
    return remarks
