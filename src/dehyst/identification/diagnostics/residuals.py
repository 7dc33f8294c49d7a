"""Tests of a wider model's assumptions on its residuals.

Symmetry, closed loops and the absence of creep are assumptions of plain models: a wider model follows loops without
them. Its residuals must show no pattern: no difference between rising and falling branches, between the ends of the
stroke, or between early and late.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.identification.diagnostics.symmetry import RISK
from dehyst.model import Actuator, Check, RecordErrors, Trace, Verdict
from dehyst.model.fit import may_creep
from dehyst.model.summary import Slopes
from dehyst.records.signals import turning_points

# Places along the stroke; least legs at a place that have a scatter.
_PLACES = 12
_FEWEST = 3
# A smaller value, in % of the range, does not matter.
_SMALLEST = 0.1
_OF_RANGE = "% of range"


def residual_checks(actuator: Actuator, traces: Sequence[Trace], errors: Sequence[RecordErrors]) -> tuple[Check, ...]:
    """Test the assumptions of a wider model.

    Parameters
    ----------
    actuator : Actuator
        As identified.
    traces, errors : sequence of Trace and of RecordErrors
        Those of a `Fit`, one for each record; only training records are used.

    Returns
    -------
    tuple of Check
        Rising branches, Sliding elements, Width, Middle line, No drift.
    """
    training = [trace for trace, error in zip(traces, errors, strict=True) if error.role == "training"]
    stroke = errors[0].stroke
    means = _Means.of(training, stroke)
    return (
        _rising(actuator, stroke),
        _sliding(actuator, training),
        _width(means),
        _middle(means),
        _drift(training, stroke),
    )


@dataclass(frozen=True, eq=False)
class _Means:
    """Mean residual of each leg at each place.

    Attributes
    ----------
    place, residual : (m,) array
        Number of the place, and residual in % of the range.
    up : (m,) bool array
        Whether the leg rises.
    edges : (_PLACES + 1,) array
        Edges of the places [m].
    noise : float
        Standard deviation of a residual [% of the range].
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
            factor = float(stdtrit(max(min(rises, falls) - 1, _FEWEST - 1), 1 - RISK / (2 * _PLACES)))
            value, scatter = 0.5 * (up + sign * down), 0.5 * factor * float(np.hypot(rise_scatter, fall_scatter))
            if np.isfinite(value):
                places.append((abs(value) / max(scatter, _SMALLEST), abs(value), scatter, k))
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
    allowed = float(actuator.provenance.get("slope_floor", 0.0)) * (high - low) / stroke
    value, floor = float(least[k]) * 1e-6, allowed * 1e-6 if allowed else None
    sentence = f"The least slope of an outermost branch is {value:.3g} V/um, at {slopes.displacement[k] * 1e6:.4g} um."
    verdict = Verdict.HOLDS
    if floor is not None and value <= floor * 1.01:
        verdict = Verdict.UNKNOWN
        sentence += (
            " The fit held it up there: whether it would rise by itself is not known; try a smaller slope_floor."
        )
    return Check("Rising branches", verdict, value, floor, "V/um", sentence)


def _sliding(actuator: Actuator, training: Sequence[Trace]) -> Check:
    name, unit = "Sliding elements", "% of elements"
    needed = 2 * actuator.slip.breakaway[actuator.slip.friction > 0]
    if not needed.size:
        return Check(name, Verdict.HOLDS, None, None, unit, "No element has stiffness: none must slide.")
    reach = max(float(np.ptp(trace.simulated)) for trace in training)
    slid = int(np.count_nonzero(needed <= reach * (1 + 1e-3)))
    sentence = f"{slid} of the {needed.size} elements with stiffness slide in both directions in the widest motion."
    if slid < needed.size:
        sentence += (
            f" The widest needs {needed[-1] * 1e6:.4g} um, the motion is {reach * 1e6:.4g} um: record a wider loop."
        )
    verdict = Verdict.HOLDS if slid == needed.size else Verdict.FAILS
    return Check(name, verdict, 100 * slid / needed.size, None, unit, sentence)


def _width(means: _Means) -> Check:
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
    if value <= max(floor, _SMALLEST):
        reason = "which does not matter" if value <= _SMALLEST else "which their scatter explains"
        return Check(name, Verdict.HOLDS, value, floor, _OF_RANGE, f"{sentence}, {reason}.")
    return Check(name, Verdict.FAILS, value, floor, _OF_RANGE, f"{sentence}: {why}.")


def _drift(training: Sequence[Trace], stroke: float) -> Check:
    """Test the slope of the legs' mean residuals over the logarithm of the time since the record's start."""
    from scipy.special import stdtrit

    name, unit = "No drift", "% a decade"
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
        floor = float(stdtrit(len(legs) - 2, 1 - RISK / (2 * len(training)))) * scatter
        drifts.append((abs(slope) / max(floor, _SMALLEST), abs(slope), floor, float(np.ptp(decades)), trace.record))
    if not drifts:
        return Check(name, Verdict.UNKNOWN, None, None, unit, "No record has enough legs to determine a drift.")
    ratio, value, floor, seen, record = max(drifts)
    sentence = f"{record}: the residual drifts by {value:.2g} % of the range a decade of time since the record's start"
    if not may_creep(value, seen):
        value, floor, unit = value * seen, floor * seen, _OF_RANGE
        sentence = f"{record}: the residual drifts by {value:.3g} % of the range in all"
    if ratio <= 1:
        reason = "which does not matter" if value <= _SMALLEST else "which its scatter explains"
        return Check(name, Verdict.HOLDS, value, floor, unit, f"{sentence}, {reason}.")
    why = "the actuator creeps longer than the model's branches, or its surroundings changed; expect as much in use"
    return Check(name, Verdict.FAILS, value, floor, unit, f"{sentence}: {why}.")
