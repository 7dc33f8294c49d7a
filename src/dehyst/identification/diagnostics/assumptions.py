"""Tests of a plain model's assumptions on its records: Assumptions I and II, symmetry, closure, no drift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import sqrt

import numpy as np

from dehyst._text import counted
from dehyst._types import Array
from dehyst.identification.diagnostics.branches import Family, families
from dehyst.identification.diagnostics.closure import creep, gaps
from dehyst.identification.diagnostics.symmetry import RISK, Mirrored
from dehyst.identification.preprocessing.preparation import Prepared
from dehyst.identification.preprocessing.regressors import epochs
from dehyst.model import Actuator, Check, GradedSlip, MaxwellSlip, RecordErrors, Spring, Verdict
from dehyst.model.fit import may_creep
from dehyst.records.signals import white_noise

# A smaller value, in % of the range, does not matter: a record of 50 samples a cycle has this resolution.
_SMALLEST = 0.1
_OF_RANGE = "% of range"


def assumption_checks(
    actuator: Actuator,
    records: Sequence[Prepared],
    errors: Sequence[RecordErrors],
    *,
    floor: float | None = None,
    imposed: bool = False,
) -> tuple[Check, ...]:
    """Test the assumptions of the model.

    Parameters
    ----------
    actuator : Actuator
        As identified.
    records : sequence of Prepared
        Training records, then those held out.
    errors : sequence of RecordErrors
        One for each record.
    floor : float, optional
        Least allowed slope [V/m] of the spring.
    imposed : bool, optional
        Whether the spring would fall somewhere without the floor.

    Returns
    -------
    tuple of Check
        Assumption I, Assumption II, Anti-symmetry, Symmetry of the width, Loop closure, No drift.
    """
    training = [(item, error) for item, error in zip(records, errors, strict=True) if error.role == "training"]
    loop = _widest(training, actuator.delay)
    return (
        _assumption_1(actuator.spring, floor, imposed),
        _assumption_2(actuator.slip, [item for item, _ in training]),
        _antisymmetry(loop),
        _width(loop),
        _closure([item for item, _ in training], actuator.delay, errors[0].stroke),
        _drift(records, errors, actuator.delay),
    )


def _assumption_1(spring: Spring, floor: float | None, imposed: bool) -> Check:
    slopes, knots = spring.slopes * 1e-6, spring.displacement * 1e6
    least = int(np.argmin(slopes))
    mean = float(np.ptp(spring.voltage) / np.ptp(spring.displacement)) * 1e-6
    sentence = (
        f"The spring's least slope is {slopes[least]:.3g} V/um, {100 * slopes[least] / mean:.3g} % of its mean, at "
        f"{knots[least]:.4g} to {knots[least + 1]:.4g} um."
    )
    verdict = Verdict.HOLDS
    if imposed:
        verdict = Verdict.FAILS
        sentence += (
            " The fit held it up: without that the spring would fall, and one voltage would have several displacements."
        )
    elif floor is not None and spring.slopes[least] <= floor * (1 + 1e-6):
        verdict = Verdict.UNKNOWN
        sentence += (
            " The fit held it up there: whether it would rise by itself is not known; try a smaller slope_floor."
        )
    sentence += (
        f" Below {knots[0]:.4g} um and above {knots[-1]:.4g} um the spring continues at its end slopes, without "
        "data: the first rise after a rest may go there."
    )
    least_allowed = None if floor is None else floor * 1e-6
    return Check("Assumption I", verdict, float(slopes[least]), least_allowed, "V/um", sentence)


def _assumption_2(slip: MaxwellSlip | GradedSlip, training: Sequence[Prepared]) -> Check:
    """Count the elements that slide before the used samples; an element about to slide at an extreme counts."""
    name, unit = "Assumption II", "% of elements"
    needed = 2 * slip.breakaway[slip.friction > 0]
    if not needed.size:
        return Check(name, Verdict.HOLDS, None, None, unit, "No element has stiffness: none must slide.")
    counts = []
    for item in training:
        reach = max((epoch.reach for piece in item.pieces for epoch in epochs(piece, item.noise)), default=0.0)
        counts.append((reach, int(np.count_nonzero(needed <= (reach + 8 * item.noise) * (1 + 1e-9))), item.name))
    reach, slid, record = max(counts)
    sentence = f"{record}: {slid} of the {needed.size} elements with stiffness slide before the samples that count."
    if slid < needed.size:
        sentence += (
            f" The widest needs {needed[-1] * 1e6:.4g} um, the widest motion is {reach * 1e6:.4g} um: record a wider "
            "loop, or give fewer elements."
        )
    still = [(count, name_) for _, count, name_ in counts if count < slid]
    if still:
        fewest, fewest_name = min(still)
        sentence += (
            f" Fewer slide in {counted(len(still), 'other record')}, {fewest} in {fewest_name}: the rest are fixed "
            "springs there, with a constant for each record, which the fit finds."
        )
    verdict = Verdict.HOLDS if slid == needed.size else Verdict.FAILS
    return Check(name, verdict, 100 * slid / needed.size, None, unit, sentence)


def _widest(training: Sequence[tuple[Prepared, RecordErrors]], delay: float) -> Mirrored | None:
    """Return the widest closed loop; of several as wide, that with most cycles. Significant drifts are removed."""
    loops: list[tuple[Family, float]] = []
    for item, error in training:
        drift, floor = _creep(item, delay) or (0.0, 0.0)
        drift = drift if abs(drift) > floor else 0.0
        for _, piece, curve in item.delayed(0, delay):
            straight = replace(piece, displacement=piece.displacement - drift * curve + error.datum)
            slope = float(np.ptp(piece.voltage)) / piece.stroke
            noise = sqrt(item.noise**2 + (white_noise(piece.voltage) / slope) ** 2)
            loops += [(family, noise) for family in families(straight)]
    if not loops:
        return None
    least = 0.95 * max(family.range for family, _ in loops)
    wide = [(family.cycles, i) for i, (family, _) in enumerate(loops) if family.range >= least]
    family, noise = loops[max(wide, key=lambda pair: pair[0])[1]]
    return Mirrored.of(family, noise)


def _antisymmetry(loop: Mirrored | None) -> Check:
    """Test Lemma 2: with a linear spring the loop is its own mirror image about the middle of its turning points."""
    name = "Anti-symmetry"
    if loop is None:
        return _no_loop(name)
    distance, noise = loop.asymmetry()
    at, value, floor = _largest(loop, distance, noise)
    if value <= max(floor, _SMALLEST):
        sentence = (
            f"{_named(loop)} equals its mirror image {_to(value)}. This does not prove that the spring is linear: a "
            "spring that is odd about the loop's centre gives the same."
        )
        return Check(name, Verdict.HOLDS, value, floor, _OF_RANGE, sentence + _single(loop))
    middle, width = (_percent(loop, part) for part in (loop.middle_asymmetry(), 0.5 * loop.width_asymmetry()[0]))
    sentence = (
        f"{_named(loop)} lies up to {value:.3g} % of the range from its mirror image, most at {at * 1e6:.4g} um: a "
        f"linear spring (Lemma 2) cannot follow it. The bend of the middle line makes {middle:.3g} % of it, which the "
        f"nonlinear spring follows; the width makes {width:.2g} %."
    )
    return Check(name, Verdict.FAILS, value, floor, _OF_RANGE, sentence + _single(loop))


def _width(loop: Mirrored | None) -> Check:
    """Test that the width of the loop is symmetric about its centre, as with any spring and any elements."""
    name = "Symmetry of the width"
    if loop is None:
        return _no_loop(name)
    distance, noise = loop.width_asymmetry()
    at, value, floor = _largest(loop, distance, noise)
    if value <= max(floor, _SMALLEST):
        sentence = f"{_named(loop)} is as wide at each place as at its mirror image {_to(value)}."
        return Check(name, Verdict.HOLDS, value, floor, _OF_RANGE, sentence + _single(loop))
    low, high = sorted((at, 2 * loop.middle - at))
    sentence = (
        f"{_named(loop)} is not as wide at {low * 1e6:.4g} um as at {high * 1e6:.4g} um: its width differs by "
        f"{value:.2g} % of the range. No plain Maxwell-slip model can follow that, with any number of elements and any "
        f"spring: expect largest errors on it of {value / 4:.2g} % at least, of {value / 2:.2g} % as a rule."
    )
    return Check(name, Verdict.FAILS, value, floor, _OF_RANGE, sentence + _single(loop))


def _largest(loop: Mirrored, distance: Array, floor: float) -> tuple[float, float, float]:
    """Return where the largest distance lies [m] on the model's axis, its size and its floor [% of the range]."""
    at = loop.middle + float(loop.place[np.argmax(np.abs(distance))])
    return at, _percent(loop, distance), 100 * floor / loop.range


def _percent(loop: Mirrored, distance: Array) -> float:
    return 100 * float(np.abs(distance).max()) / loop.range


def _named(loop: Mirrored) -> str:
    cycles = f"{loop.cycles} cycle{'s' if loop.cycles > 1 else ''}"
    return f"{loop.record}: the widest loop ({loop.range * 1e6:.4g} um, {cycles})"


def _to(value: float) -> str:
    return f"to {max(value, 0.01):.2g} % of the range"


def _single(loop: Mirrored) -> str:
    return "" if loop.cycles > 1 else " One cycle only: its floor contains the sensor's noise, but no slow drift."


def _no_loop(name: str) -> Check:
    sentence = "No closed loop was found: record at least two cycles between the same two turning points."
    return Check(name, Verdict.UNKNOWN, None, None, _OF_RANGE, sentence)


def _closure(training: Sequence[Prepared], delay: float, stroke: float) -> Check:
    """Test that cycles from a known state that return to their voltage return to their displacement."""
    from scipy.special import ndtri

    name = "Loop closure"
    openings = []
    for item in training:
        open_by, noises = np.hstack([gaps(piece, item.noise) for _, piece, _ in item.delayed(0, delay)])
        if open_by.size:
            value, mean = 100 * float(np.abs(open_by).max()) / stroke, 100 * float(open_by.mean()) / stroke
            floor = 100 * float(ndtri(1 - RISK / (2 * open_by.size)) * noises.max()) / stroke
            openings.append((value / max(floor, _SMALLEST), value, floor, mean, open_by.size, item.name))
    if not openings:
        sentence = "No cycle begins in a known state and returns to its voltage: record two equal cycles, or three."
        return Check(name, Verdict.UNKNOWN, None, None, _OF_RANGE, sentence)
    ratio, value, floor, mean, cycles, record = max(openings)
    sentence = (
        f"{record}: {counted(cycles, 'cycle')} back at the same voltage ended up to {value:.2g} % of the range "
        f"away, {mean:.2g} % in the mean."
    )
    if ratio <= 1:
        return Check(name, Verdict.HOLDS, value, floor, _OF_RANGE, sentence)
    sentence += (
        " A loop that stays open creeps or drifts; the model does neither: wait before recording, or record slower."
    )
    return Check(name, Verdict.FAILS, value, floor, _OF_RANGE, sentence)


def _drift(records: Sequence[Prepared], errors: Sequence[RecordErrors], delay: float) -> Check:
    """Test how far the displacement creeps at an extreme of the voltage, which always leaves the same state."""
    name, unit = "No drift", "% a decade"
    drifts = []
    for item, error in zip(records, errors, strict=True):
        trend = _creep(item, delay)
        if trend:
            value, floor = (100 * abs(number) / error.stroke for number in trend)
            decades = max(float(np.ptp(curve)) for _, _, curve in item.delayed(0, delay))
            drifts.append((value / max(floor, _SMALLEST), value, floor, decades, bool(error.drift), item.name))
    if not drifts:
        sentence = (
            "No record returns three times to an extreme of its voltage: fewer cannot separate drift from hysteresis."
        )
        return Check(name, Verdict.UNKNOWN, None, None, unit, sentence)
    ratio, value, floor, decades, aside, record = max(drifts)
    if ratio <= 1 and not may_creep(floor, decades):
        sentence = f"{record}: its displacements at the ends of its voltages scatter too much to determine a drift."
        return Check(name, Verdict.UNKNOWN, None, None, unit, sentence)
    sentence = (
        f"{record}: at the ends of its voltages the displacement creeps by {value:.2g} % of the range a decade of time "
        "since the record's start"
    )
    if not may_creep(value, decades):
        value, floor, unit = value * decades, floor * decades, _OF_RANGE
        sentence = f"{record}: at the ends of its voltages the displacement drifts by {value:.3g} % of the range in all"
    if ratio <= 1:
        sentence += ", which does not matter." if value <= _SMALLEST else ", which its scatter explains."
        return Check(name, Verdict.HOLDS, value, floor, unit, sentence)
    sentence += "; it was set aside." if aside else "; it was left in."
    sentence += " The model does not depend on time: expect as much in use, or correct it by feedback."
    return Check(name, Verdict.FAILS, value, floor, unit, sentence)


def _creep(item: Prepared, delay: float) -> tuple[float, float] | None:
    return creep([(piece, curve) for _, piece, curve in item.delayed(0, delay)], item.noise, RISK)
