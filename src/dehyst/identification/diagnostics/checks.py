"""Checks of a model's assumptions on its records and on its residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import hypot, sqrt
from typing import NamedTuple

import numpy as np

from dehyst._text import counted
from dehyst._types import Array
from dehyst.identification.diagnostics.branches import Family, Mirrored, creep, families, gaps
from dehyst.identification.preprocessing.preparation import Prepared
from dehyst.identification.preprocessing.regressors import epochs
from dehyst.identification.results import Check, RecordErrors, Trace, Verdict, may_creep
from dehyst.identification.rules import RULES
from dehyst.model import Actuator, GradedSlip, MaxwellSlip, Slopes, Spring
from dehyst.records import turning_points, white_noise

_OF_RANGE = "% of range"
_HELD_UP = " There the fit imposed its floor, and the free slope is not known; try a smaller slope_floor."


def model_checks(
    actuator: Actuator,
    records: Sequence[Prepared],
    traces: Sequence[Trace],
    errors: Sequence[RecordErrors],
    *,
    floor: float | None = None,
) -> tuple[Check, ...]:
    """Test the assumptions of a model.

    Symmetry, closed loops and the absence of creep are assumptions of Maxwell-slip elements and a spring, tested on the
    records. A model with more parts follows loops without them: its residuals must show no pattern, no difference
    between rising and falling branches, between the ends of the stroke, or between early and late.

    `actuator`: as identified. `records`: training records, then held-out ones. `traces`, `errors`: as in `Fit`, one for
    each record. `floor`: least allowed slope of the spring [V/m], for Maxwell-slip only.

    Returns
    -------
    tuple of Check
        Of Maxwell-slip: Assumption I, Assumption II, Anti-symmetry, Symmetry of the width, Loop closure, No drift.
        Otherwise: Rising branches, Sliding elements, Width, Middle line, No drift.
    """
    stroke, slip = errors[0].stroke, actuator.slip
    if actuator.wide:
        seen = [trace for trace, error in zip(traces, errors, strict=True) if error.role == "training"]
        return (
            _rising(actuator, stroke),
            _sliding(slip, seen),
            *_patterns(seen, stroke),
            _residual_drift(seen, stroke),
        )
    training = [(item, error) for item, error in zip(records, errors, strict=True) if error.role == "training"]
    return (
        _assumption_1(actuator.spring, floor),
        _assumption_2(slip, [item for item, _ in training]),
        *_symmetry(_widest(training, actuator.delay)),
        _closure([item for item, _ in training], actuator.delay, stroke),
        _creep_at_extremes(records, errors, actuator.delay),
    )


def _tested(name: str, value: float, floor: float, holds: str, fails: str, unit: str = _OF_RANGE) -> Check:
    """Return a check that holds up to its floor, or up to what does not matter."""
    fine = value <= max(floor, RULES.smallest_pattern)
    return Check(name, Verdict.HOLDS if fine else Verdict.FAILS, value, floor, unit, holds if fine else fails)


def _unknown(name: str, sentence: str, unit: str = _OF_RANGE) -> Check:
    return Check(name, Verdict.UNKNOWN, None, None, unit, sentence)


def _calm(value: float) -> str:
    """Return why a value [% of the stroke] below its floor is no pattern."""
    return "which does not matter" if value <= RULES.smallest_pattern else "which scatter explains"


def _assumption_1(spring: Spring, floor: float | None) -> Check:
    slopes, knots = spring.slopes * 1e-6, spring.displacement * 1e6
    least = int(np.argmin(slopes))
    mean = float(np.ptp(spring.voltage) / np.ptp(spring.displacement)) * 1e-6
    sentence = (
        f"The spring's least slope is {slopes[least]:.3g} V/um, {100 * slopes[least] / mean:.3g} % of its mean, at "
        f"{knots[least]:.4g} to {knots[least + 1]:.4g} um."
    )
    verdict = Verdict.HOLDS
    if floor is not None and spring.slopes[least] <= floor * (1 + 1e-6):
        verdict, sentence = Verdict.UNKNOWN, sentence + _HELD_UP
    sentence += (
        f" Below {knots[0]:.4g} um and above {knots[-1]:.4g} um the spring continues at its end slopes, without "
        "data: the first rise after a rest may go there."
    )
    least_allowed = None if floor is None else floor * 1e-6
    return Check("Assumption I", verdict, float(slopes[least]), least_allowed, "V/um", sentence)


def _rising(actuator: Actuator, stroke: float) -> Check:
    slopes, known = Slopes.of(actuator.slip, actuator.spring), actuator.identification
    least = np.minimum(slopes.rising, slopes.falling)
    k = int(np.argmin(least))
    low, high = actuator.limits or (0.0, 0.0)
    allowed = (0.0 if known is None else known.slope_floor) * (high - low) / stroke
    value, floor = float(least[k]) * 1e-6, allowed * 1e-6 if allowed else None
    sentence = f"The least slope of an outermost branch is {value:.3g} V/um, at {slopes.displacement[k] * 1e6:.4g} um."
    if floor is not None and value <= floor * 1.01:
        return Check("Rising branches", Verdict.UNKNOWN, value, floor, "V/um", sentence + _HELD_UP)
    return Check("Rising branches", Verdict.HOLDS, value, floor, "V/um", sentence)


def _assumption_2(slip: MaxwellSlip | GradedSlip, training: Sequence[Prepared]) -> Check:
    """Count the elements that slide before the used samples; an element about to slide at an extreme counts."""
    needed, counts = 2 * slip.breakaway[slip.friction > 0], []
    for item in training:
        reach = max((epoch.reach for piece in item.pieces for epoch in epochs(piece, item.noise)), default=0.0)
        counts.append((reach, int(np.count_nonzero(needed <= (reach + 8 * item.noise) * (1 + 1e-9))), item.name))
    reach, slid, record = max(counts)
    sentence = f"{record}: {slid} of the {needed.size} elements with stiffness slide before the samples that count."
    still = [(count, name) for _, count, name in counts if count < slid]
    rest = ""
    if still:
        fewest, fewest_name = min(still)
        rest = (
            f" Fewer slide in {counted(len(still), 'other record')}, {fewest} in {fewest_name}: the rest are fixed "
            "springs there, with a constant for each record, which the fit finds."
        )
    return _slides("Assumption II", needed, slid, reach, sentence, rest)


def _sliding(slip: MaxwellSlip | GradedSlip, training: Sequence[Trace]) -> Check:
    """Count the elements that slide both ways in the widest motion."""
    needed = 2 * slip.breakaway[slip.friction > 0]
    reach = max(float(np.ptp(trace.simulated)) for trace in training)
    slid = int(np.count_nonzero(needed <= reach * (1 + 1e-3)))
    sentence = f"{slid} of the {needed.size} elements with stiffness slide in both directions in the widest motion."
    return _slides("Sliding elements", needed, slid, reach, sentence)


def _slides(name: str, needed: Array, slid: int, reach: float, sentence: str, rest: str = "") -> Check:
    """Return the check of the motions that elements with stiffness need [m], of which so many slide."""
    unit = "% of elements"
    if not needed.size:
        return Check(name, Verdict.HOLDS, None, None, unit, "No element has stiffness: none must slide.")
    if slid < needed.size:
        sentence += (
            f" The widest needs {needed[-1] * 1e6:.4g} um, the widest motion is {reach * 1e6:.4g} um: record a wider "
            "loop, or give fewer elements."
        )
    verdict = Verdict.HOLDS if slid == needed.size else Verdict.FAILS
    return Check(name, verdict, 100 * slid / needed.size, None, unit, sentence + rest)


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
    wide = [(family, noise) for family, noise in loops if family.range >= least]
    return Mirrored.of(*max(wide, key=lambda one: one[0].cycles))


def _symmetry(loop: Mirrored | None) -> tuple[Check, Check]:
    """Test that a loop is its own mirror image about the middle of its turning points, and as wide at mirrored places.

    The first is Lemma 2, with a linear spring; the second holds with any spring and any elements.
    """
    names = "Anti-symmetry", "Symmetry of the width"
    if loop is None:
        sentence = "No closed loop was found: record at least two cycles between the same two turning points."
        return _unknown(names[0], sentence), _unknown(names[1], sentence)
    cycles = f"{loop.cycles} cycle{'s' if loop.cycles > 1 else ''}"
    named = f"{loop.record}: the widest loop ({loop.range * 1e6:.4g} um, {cycles})"
    single = "" if loop.cycles > 1 else " One cycle only: its floor contains the sensor's noise, but no slow drift."
    (apart, apart_floor), (width, width_floor) = loop.asymmetry(), loop.width_asymmetry()
    value, wider, middle, half = (
        100 * float(np.abs(distance).max()) / loop.range
        for distance in (apart, width, loop.middle_asymmetry(), 0.5 * width)
    )
    # Where they are largest, on the model's axis [um].
    at, place = (1e6 * (loop.middle + float(loop.place[np.argmax(np.abs(one))])) for one in (apart, width))
    low, high = sorted((place, 2e6 * loop.middle - place))
    mirror = _tested(
        names[0],
        value,
        100 * apart_floor / loop.range,
        f"{named} equals its mirror image to {max(value, 0.01):.2g} % of the stroke. This does not prove that the "
        f"spring is linear: a spring that is odd about the loop's centre gives the same.{single}",
        f"{named} lies up to {value:.3g} % of the stroke from its mirror image, most at {at:.4g} um: a linear spring "
        f"(Lemma 2) cannot follow it. The bend of the middle line contributes {middle:.3g} %, which the nonlinear "
        f"spring follows; the width contributes {half:.2g} %.{single}",
    )
    return mirror, _tested(
        names[1],
        wider,
        100 * width_floor / loop.range,
        f"{named} is as wide at each place as at its mirror image to {max(wider, 0.01):.2g} % of the stroke.{single}",
        f"{named} is not as wide at {low:.4g} um as at {high:.4g} um: its width differs by {wider:.2g} % of the "
        "stroke. No plain Maxwell-slip model can follow that, with any number of elements and any spring: expect "
        f"largest errors on it of {wider / 4:.2g} % at least, of {wider / 2:.2g} % as a rule.{single}",
    )


def _closure(training: Sequence[Prepared], delay: float, stroke: float) -> Check:
    """Test that cycles from a known state that return to their voltage return to their displacement."""
    from scipy.special import ndtri

    name, openings = "Loop closure", []
    for item in training:
        open_by, noises = np.hstack([gaps(piece, item.noise) for _, piece, _ in item.delayed(0, delay)])
        if open_by.size:
            value, mean = 100 * float(np.abs(open_by).max()) / stroke, 100 * float(open_by.mean()) / stroke
            floor = 100 * float(ndtri(1 - RULES.check_risk / (2 * open_by.size)) * noises.max()) / stroke
            openings.append((value / max(floor, RULES.smallest_pattern), value, floor, mean, open_by.size, item.name))
    if not openings:
        return _unknown(
            name, "No cycle begins in a known state and returns to its voltage: record two equal cycles, or three."
        )
    _, value, floor, mean, cycles, record = max(openings)
    sentence = (
        f"{record}: {counted(cycles, 'cycle')} back at the same voltage ended up to {value:.2g} % of the stroke "
        f"away, {mean:.2g} % in the mean."
    )
    why = " A loop that stays open creeps or drifts; the model does neither: wait before recording, or record slower."
    return _tested(name, value, floor, sentence, sentence + why)


class _Drift(NamedTuple):
    """Drift of a record and its floor by scatter [% of the stroke a decade], and the decades of time that show it."""

    value: float
    floor: float
    decades: float
    record: str
    why: str = ""

    def ratio(self) -> float:
        """Return the drift as a part of the least significant one."""
        return self.value / max(self.floor, RULES.smallest_pattern)

    def check(self, what: str, moves: str, why: str) -> Check:
        """Return the check of a drift; `what` drifts, `moves` is the verb, and `why` the consequence."""
        value, floor, unit = self.value, self.floor, "% a decade"
        sentence = (
            f"{self.record}: {what} {moves} by {value:.2g} % of the stroke a decade of time since the record's start"
        )
        if not may_creep(value, self.decades):
            value, floor, unit = value * self.decades, floor * self.decades, _OF_RANGE
            sentence = f"{self.record}: {what} drifts by {value:.3g} % of the stroke in all"
        verdict = Verdict.FAILS if self.ratio() > 1 else Verdict.HOLDS
        rest = f": {why}." if verdict is Verdict.FAILS else f", {_calm(value)}."
        return Check("No drift", verdict, value, floor, unit, sentence + rest)


def _creep_at_extremes(records: Sequence[Prepared], errors: Sequence[RecordErrors], delay: float) -> Check:
    """Test how far the displacement creeps at an extreme of the voltage, which always leaves the same state."""
    drifts = []
    for item, error in zip(records, errors, strict=True):
        if trend := _creep(item, delay):
            value, floor = (100 * abs(number) / error.stroke for number in trend)
            decades = max(float(np.ptp(curve)) for _, _, curve in item.delayed(0, delay))
            aside = "it was set aside" if error.drift else "it was left in"
            drifts.append(_Drift(value, floor, decades, item.name, aside))
    fewer = "No record returns three times to an extreme of its voltage: fewer cannot separate drift from hysteresis."
    if not drifts:
        return _unknown("No drift", fewer, "% a decade")
    worst = max(drifts, key=_Drift.ratio)
    if worst.ratio() <= 1 and not may_creep(worst.floor, worst.decades):
        scatter = (
            f"{worst.record}: its displacements at the ends of its voltages scatter too much to determine a drift."
        )
        return _unknown("No drift", scatter, "% a decade")
    return worst.check(
        "at the ends of its voltages the displacement",
        "creeps",
        f"{worst.why}. The model does not depend on time: expect as much in use, or correct it by feedback",
    )


def _creep(item: Prepared, delay: float) -> tuple[float, float] | None:
    return creep([(piece, curve) for _, piece, curve in item.delayed(0, delay)], item.noise, RULES.check_risk)


# Places along the stroke; least legs at a place, or of a record, that have a scatter.
_PLACES = 12
_FEWEST = 3


def _legs(trace: Trace) -> list[tuple[int, int]]:
    v = trace.voltage
    edges = np.unique([0, *turning_points(v, 0.02 * float(np.ptp(v))), v.size])
    return [(int(a), int(b)) for a, b in pairwise(edges) if b - a > 1]


def _residual_drift(training: Sequence[Trace], stroke: float) -> Check:
    """Test the slope of the legs' mean residuals over the logarithm of the time since the record's start."""
    from scipy.special import stdtrit

    drifts = []
    for whole in training:
        trace = whole.settled
        legs = _legs(trace)
        if len(legs) <= _FEWEST:
            continue
        middle = np.array([0.5 * (trace.time[a] + trace.time[b - 1]) - whole.time[0] for a, b in legs])
        mean = np.array([float(trace.residual[a:b].mean()) for a, b in legs]) * 100 / stroke
        decades = np.log10(np.maximum(middle, middle[middle > 0].min()))
        off = decades - decades.mean()
        slope = float(off @ mean / (off @ off))
        rest = mean - mean.mean() - slope * off
        scatter = float(np.sqrt(rest @ rest / (len(legs) - 2) / (off @ off)))
        floor = float(stdtrit(len(legs) - 2, 1 - RULES.check_risk / (2 * len(training)))) * scatter
        drifts.append(_Drift(abs(slope), floor, float(np.ptp(decades)), trace.record))
    if not drifts:
        return _unknown("No drift", "No record has enough legs to determine a drift.", "% a decade")
    return max(drifts, key=_Drift.ratio).check(
        "the residual",
        "drifts",
        "the actuator creeps longer than the model's branches, or its surroundings changed; expect as much in use",
    )


def _patterns(traces: Sequence[Trace], stroke: float) -> tuple[Check, Check]:
    """Test that mean residuals of rising and falling legs lie neither apart nor off together at any place."""
    from scipy.special import stdtrit

    low = min(float(trace.simulated.min()) for trace in traces)
    high = max(float(trace.simulated.max()) for trace in traces)
    edges = np.linspace(low, high, _PLACES + 1)
    # Mean residuals [% of the stroke] of rising and of falling legs at each place.
    means: dict[tuple[int, bool], list[float]] = {}
    squares, count = 0.0, 0
    for trace in (one.settled for one in traces):
        percent = 100 * trace.residual / stroke
        at = np.clip(np.searchsorted(edges, trace.simulated, side="right") - 1, 0, _PLACES - 1)
        for start, stop in _legs(trace):
            up = bool(trace.voltage[stop - 1] > trace.voltage[start])
            total = np.bincount(at[start:stop], weights=percent[start:stop], minlength=_PLACES)
            size = np.bincount(at[start:stop], minlength=_PLACES)
            for k in np.flatnonzero(size).tolist():
                means.setdefault((k, up), []).append(float(total[k] / size[k]))
        squares, count = squares + float(np.sum(percent**2)), count + percent.size
    noise = sqrt(squares / max(count, 1))

    def scatter(values: list[float]) -> float:
        """Return the standard deviation of a mean."""
        return (float(np.std(values, ddof=1)) if len(values) >= _FEWEST else noise) / sqrt(len(values))

    def largest(sign: int) -> tuple[float, float, float]:
        """Return place [um], size and floor by scatter of the largest half of rising plus sign times falling."""
        places = []
        for k in range(_PLACES):
            up, down = means.get((k, True), []), means.get((k, False), [])
            if not (up and down):
                continue
            # The scatter of few legs is uncertain: Student's quantile, for the worst of all places.
            free = max(min(len(up), len(down)) - 1, _FEWEST - 1)
            factor = float(stdtrit(free, 1 - RULES.check_risk / (2 * _PLACES)))
            value = abs(0.5 * (float(np.mean(up)) + sign * float(np.mean(down))))
            floor = 0.5 * factor * hypot(scatter(up), scatter(down))
            places.append((value / max(floor, RULES.smallest_pattern), value, floor, k))
        _, value, floor, k = max(places)
        return 0.5e6 * float(edges[k] + edges[k + 1]), value, floor

    if not any((k, True) in means and (k, False) in means for k in range(_PLACES)):
        unpassed = "No place is passed in both directions."
        return _unknown("Width", unpassed), _unknown("Middle line", unpassed)
    place, value, floor = largest(-1)
    sentence = (
        f"Residuals of rising and of falling branches lie up to {2 * value:.2g} % of the stroke apart, most at "
        f"{place:.4g} um"
    )
    why = (
        "the loops are wider or narrower there than those of the model: add elements, grades, or loops that turn there"
    )
    width = _tested("Width", value, floor, f"{sentence}, {_calm(value)}.", f"{sentence}: {why}.")
    place, value, floor = largest(1)
    sentence = (
        f"The middle between rising and falling residuals lies up to {value:.2g} % of the stroke off, most at "
        f"{place:.4g} um"
    )
    why = "the spring or tau bends more sharply there than their knots allow"
    return width, _tested("Middle line", value, floor, f"{sentence}, {_calm(value)}.", f"{sentence}: {why}.")
