"""Checks of a model's assumptions on its records and on its residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._text import counted
from dehyst._types import Array
from dehyst.identification.diagnostics.branches import Family, Mirrored, creep, families, gaps
from dehyst.identification.preprocessing.preparation import Prepared
from dehyst.identification.preprocessing.regressors import epochs
from dehyst.identification.results import Check, RecordErrors, Trace, Verdict, may_creep
from dehyst.identification.rules import RULES
from dehyst.model import Actuator, GradedSlip, MaxwellSlip, Spring
from dehyst.model.summary import Slopes
from dehyst.records.signals import turning_points, white_noise

_OF_RANGE = "% of range"


def model_checks(
    actuator: Actuator,
    records: Sequence[Prepared],
    traces: Sequence[Trace],
    errors: Sequence[RecordErrors],
    *,
    floor: float | None = None,
    imposed: bool = False,
) -> tuple[Check, ...]:
    """Test the assumptions of a model.

    Symmetry, closed loops and the absence of creep are assumptions of Maxwell-slip elements and a spring, tested on the
    records. A model with more parts follows loops without them: its residuals must show no pattern, no difference
    between rising and falling branches, between the ends of the stroke, or between early and late.

    `actuator`: as identified. `records`: training records, then those held out. `traces`, `errors`: those of a `Fit`,
    one for each record. `floor`: least allowed slope [V/m] of the spring; of Maxwell-slip only. `imposed`: whether the
    spring would fall somewhere without the floor; of Maxwell-slip only.

    Returns
    -------
    tuple of Check
        Of Maxwell-slip: Assumption I, Assumption II, Anti-symmetry, Symmetry of the width, Loop closure, No drift.
        Otherwise: Rising branches, Sliding elements, Width, Middle line, No drift.
    """
    stroke = errors[0].stroke
    if actuator.wide:
        seen = [trace for trace, error in zip(traces, errors, strict=True) if error.role == "training"]
        means = _Means.of(seen, stroke)
        return (
            _rising(actuator, stroke),
            _sliding(actuator, seen),
            _residual_width(means),
            _middle(means),
            _residual_drift(seen, stroke),
        )
    training = [(item, error) for item, error in zip(records, errors, strict=True) if error.role == "training"]
    loop = _widest(training, actuator.delay)
    return (
        _assumption_1(actuator.spring, floor, imposed),
        _assumption_2(actuator.slip, [item for item, _ in training]),
        _antisymmetry(loop),
        _loop_width(loop),
        _closure([item for item, _ in training], actuator.delay, stroke),
        _creep_at_extremes(records, errors, actuator.delay),
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
    needed = 2 * slip.breakaway[slip.friction > 0]
    counts = []
    for item in training:
        reach = max((epoch.reach for piece in item.pieces for epoch in epochs(piece, item.noise)), default=0.0)
        counts.append((reach, int(np.count_nonzero(needed <= (reach + 8 * item.noise) * (1 + 1e-9))), item.name))
    reach, slid, record = max(counts)
    sentence = f"{record}: {slid} of the {needed.size} elements with stiffness slide before the samples that count."
    still = [(count, name_) for _, count, name_ in counts if count < slid]
    rest = ""
    if still:
        fewest, fewest_name = min(still)
        rest = (
            f" Fewer slide in {counted(len(still), 'other record')}, {fewest} in {fewest_name}: the rest are fixed "
            "springs there, with a constant for each record, which the fit finds."
        )
    return _slides("Assumption II", needed, slid, reach, sentence, rest)


def _sliding(actuator: Actuator, training: Sequence[Trace]) -> Check:
    """Count the elements that slide both ways in the widest motion."""
    needed = 2 * actuator.slip.breakaway[actuator.slip.friction > 0]
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
    if value <= max(floor, RULES.smallest_pattern):
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


def _loop_width(loop: Mirrored | None) -> Check:
    """Test that the width of the loop is symmetric about its centre, as with any spring and any elements."""
    name = "Symmetry of the width"
    if loop is None:
        return _no_loop(name)
    distance, noise = loop.width_asymmetry()
    at, value, floor = _largest(loop, distance, noise)
    if value <= max(floor, RULES.smallest_pattern):
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
            floor = 100 * float(ndtri(1 - RULES.check_risk / (2 * open_by.size)) * noises.max()) / stroke
            openings.append((value / max(floor, RULES.smallest_pattern), value, floor, mean, open_by.size, item.name))
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


def _creep_at_extremes(records: Sequence[Prepared], errors: Sequence[RecordErrors], delay: float) -> Check:
    """Test how far the displacement creeps at an extreme of the voltage, which always leaves the same state."""
    drifts = []
    for item, error in zip(records, errors, strict=True):
        if trend := _creep(item, delay):
            value, floor = (100 * abs(number) / error.stroke for number in trend)
            decades = max(float(np.ptp(curve)) for _, _, curve in item.delayed(0, delay))
            aside = "it was set aside" if error.drift else "it was left in"
            drifts.append(_Drift(value, floor, decades, item.name, aside))
    if not drifts:
        return _no_drift(
            "No record returns three times to an extreme of its voltage: fewer cannot separate drift from hysteresis."
        )
    worst = max(drifts, key=_Drift.ratio)
    if worst.ratio() <= 1 and not may_creep(worst.floor, worst.decades):
        return _no_drift(
            f"{worst.record}: its displacements at the ends of its voltages scatter too much to determine a drift."
        )
    return worst.check(
        "at the ends of its voltages the displacement",
        "creeps",
        f"{worst.why}. The model does not depend on time: expect as much in use, or correct it by feedback",
    )


def _residual_drift(training: Sequence[Trace], stroke: float) -> Check:
    """Test the slope of the legs' mean residuals over the logarithm of the time since the record's start."""
    from scipy.special import stdtrit

    drifts = []
    for trace in training:
        legs = _legs(trace)
        if len(legs) <= _FEWEST:
            continue
        middle = np.array([0.5 * (trace.time[a] + trace.time[b - 1]) - trace.time[0] for a, b in legs])
        mean = np.array([float(trace.residual[a:b].mean()) for a, b in legs]) * 100 / stroke
        decades = np.log10(np.maximum(middle, middle[middle > 0].min()))
        off = decades - decades.mean()
        slope = float(off @ mean / (off @ off))
        rest = mean - mean.mean() - slope * off
        scatter = float(np.sqrt(rest @ rest / (len(legs) - 2) / (off @ off)))
        floor = float(stdtrit(len(legs) - 2, 1 - RULES.check_risk / (2 * len(training)))) * scatter
        drifts.append(_Drift(abs(slope), floor, float(np.ptp(decades)), trace.record))
    if not drifts:
        return _no_drift("No record has enough legs to determine a drift.")
    return max(drifts, key=_Drift.ratio).check(
        "the residual",
        "drifts",
        "the actuator creeps longer than the model's branches, or its surroundings changed; expect as much in use",
    )


class _Drift(NamedTuple):
    """Drift of a record and its floor by scatter [% of the range a decade], and the decades of time that show it."""

    value: float
    floor: float
    decades: float
    record: str
    why: str = ""

    def ratio(self) -> float:
        """Return the drift as a part of the least significant one."""
        return self.value / max(self.floor, RULES.smallest_pattern)

    def check(self, what: str, moves: str, why: str) -> Check:
        """Return the check of how `what` `moves`; `why`: what follows if it does."""
        value, floor, unit = self.value, self.floor, "% a decade"
        sentence = (
            f"{self.record}: {what} {moves} by {value:.2g} % of the range a decade of time since the record's start"
        )
        if not may_creep(value, self.decades):
            value, floor, unit = value * self.decades, floor * self.decades, _OF_RANGE
            sentence = f"{self.record}: {what} drifts by {value:.3g} % of the range in all"
        if self.ratio() > 1:
            return Check("No drift", Verdict.FAILS, value, floor, unit, f"{sentence}: {why}.")
        return Check("No drift", Verdict.HOLDS, value, floor, unit, f"{sentence}, {_calm(value)}.")


def _no_drift(sentence: str) -> Check:
    return Check("No drift", Verdict.UNKNOWN, None, None, "% a decade", sentence)


def _calm(value: float) -> str:
    """Return why a value [% of the range] below its floor is no pattern."""
    return "which does not matter" if value <= RULES.smallest_pattern else "which scatter explains"


def _creep(item: Prepared, delay: float) -> tuple[float, float] | None:
    return creep([(piece, curve) for _, piece, curve in item.delayed(0, delay)], item.noise, RULES.check_risk)


# Places along the stroke; least legs at a place that have a scatter.
_PLACES = 12
_FEWEST = 3


@dataclass(frozen=True, eq=False)
class _Means:
    """Mean residual of each leg at each place.

    `place`, `residual` (m,): number of the place, and residual in % of the range. `up` (m,) bool: whether the leg
    rises. `edges` (_PLACES + 1,): edges of the places [m]. `noise`: standard deviation of a residual [% of the range].
    """

    place: NDArray[np.intp]
    residual: Array
    up: NDArray[np.bool_]
    edges: Array
    noise: float

    @classmethod
    def of(cls, traces: Sequence[Trace], stroke: float) -> _Means:
        low = min(float(trace.simulated.min()) for trace in traces)
        high = max(float(trace.simulated.max()) for trace in traces)
        edges = np.linspace(low, high, _PLACES + 1)
        legs: list[tuple[int, float, bool]] = []
        squares, count = 0.0, 0
        for trace in traces:
            percent = 100 * trace.residual / stroke
            at = np.clip(np.searchsorted(edges, trace.simulated, side="right") - 1, 0, _PLACES - 1)
            for start, stop in _legs(trace):
                up = bool(trace.voltage[stop - 1] > trace.voltage[start])
                total = np.bincount(at[start:stop], weights=percent[start:stop], minlength=_PLACES)
                size = np.bincount(at[start:stop], minlength=_PLACES)
                legs += [(k, float(total[k] / size[k]), up) for k in np.flatnonzero(size).tolist()]
            squares, count = squares + float(np.sum(percent**2)), count + percent.size
        place, residual, up_ = (np.array(column) for column in zip(*legs, strict=True))
        return cls(place.astype(np.intp), residual, up_.astype(bool), edges, float(np.sqrt(squares / max(count, 1))))

    def at(self, k: int, up: bool) -> tuple[float, float, int]:
        """Return mean, standard deviation and number of the legs of one direction at a place; NaN without any."""
        residuals = self.residual[(self.place == k) & (self.up == up)]
        if not residuals.size:
            return float("nan"), 0.0, 0
        spread = float(residuals.std(ddof=1)) if residuals.size >= _FEWEST else self.noise
        return float(residuals.mean()), spread / float(np.sqrt(residuals.size)), residuals.size

    def largest(self, sign: int) -> tuple[float, float, float]:
        """Return place [m], size and floor by scatter [%] of the largest half of rising plus sign times falling."""
        from scipy.special import stdtrit

        places = []
        for k in range(_PLACES):
            (up, rise_scatter, rises), (down, fall_scatter, falls) = self.at(k, True), self.at(k, False)
            # The scatter of few legs is uncertain: Student's quantile, for the worst of all places.
            factor = float(stdtrit(max(min(rises, falls) - 1, _FEWEST - 1), 1 - RULES.check_risk / (2 * _PLACES)))
            value, scatter = 0.5 * (up + sign * down), 0.5 * factor * float(np.hypot(rise_scatter, fall_scatter))
            if np.isfinite(value):
                places.append((abs(value) / max(scatter, RULES.smallest_pattern), abs(value), scatter, k))
        if not places:
            return float("nan"), float("nan"), float("nan")
        _, value, scatter, k = max(places)
        return 0.5 * float(self.edges[k] + self.edges[k + 1]), value, scatter


def _legs(trace: Trace) -> list[tuple[int, int]]:
    v = trace.voltage
    edges = np.unique([0, *turning_points(v, 0.02 * float(np.ptp(v))), v.size])
    return [(int(a), int(b)) for a, b in pairwise(edges) if b - a > 1]


def _rising(actuator: Actuator, stroke: float) -> Check:
    slopes = Slopes.of(actuator.slip, actuator.spring)
    least = np.minimum(slopes.rising, slopes.falling)
    k = int(np.argmin(least))
    low, high = actuator.limits or (0.0, 0.0)
    known = actuator.identification
    allowed = (0.0 if known is None else known.slope_floor) * (high - low) / stroke
    value, floor = float(least[k]) * 1e-6, allowed * 1e-6 if allowed else None
    sentence = f"The least slope of an outermost branch is {value:.3g} V/um, at {slopes.displacement[k] * 1e6:.4g} um."
    verdict = Verdict.HOLDS
    if floor is not None and value <= floor * 1.01:
        verdict = Verdict.UNKNOWN
        sentence += (
            " The fit held it up there: whether it would rise by itself is not known; try a smaller slope_floor."
        )
    return Check("Rising branches", verdict, value, floor, "V/um", sentence)


def _residual_width(means: _Means) -> Check:
    at, value, floor = means.largest(-1)
    return _pattern(
        "Width",
        value,
        floor,
        f"Residuals of rising and of falling branches lie up to {2 * value:.2g} % of the range "
        f"apart, most at {at * 1e6:.4g} um",
        "the loops are wider or narrower there than those of the model: add elements, grades, or loops that turn there",
    )


def _middle(means: _Means) -> Check:
    at, value, floor = means.largest(1)
    return _pattern(
        "Middle line",
        value,
        floor,
        f"The middle between rising and falling residuals lies up to {value:.2g} % of the "
        f"range off, most at {at * 1e6:.4g} um",
        "the spring or tau bends more sharply there than their knots allow",
    )


def _pattern(name: str, value: float, floor: float, sentence: str, why: str) -> Check:
    if not np.isfinite(value):
        unpassed = "No place is passed in both directions."
        return Check(name, Verdict.UNKNOWN, None, None, _OF_RANGE, unpassed)
    if value <= max(floor, RULES.smallest_pattern):
        return Check(name, Verdict.HOLDS, value, floor, _OF_RANGE, f"{sentence}, {_calm(value)}.")
    return Check(name, Verdict.FAILS, value, floor, _OF_RANGE, f"{sentence}: {why}.")
