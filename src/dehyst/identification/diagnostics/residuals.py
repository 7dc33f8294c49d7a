"""What a wider model takes for granted, looked for in what it leaves of the records.

Symmetry, closed loops and the absence of creep are of the plain class: a wider model follows loops that have none of
them. What it must not leave is a pattern: residuals that tell rising from falling branches, one end of the stroke from
the other, or early from late.
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

# Places along the stroke that are told apart; fewer legs than this at one have no scatter.
_PLACES = 12
_FEWEST = 3
# What is smaller, in % of the range, is of no consequence.
_SMALLEST = 0.1
_OF_RANGE = "% of range"


def residual_checks(actuator: Actuator, traces: Sequence[Trace], errors: Sequence[RecordErrors]) -> tuple[Check, ...]:
    """Look for what a wider model takes for granted.

    Parameters
    ----------
    actuator : Actuator
        As identified.
    traces, errors : sequence of Trace and of RecordErrors
        Those of a `Fit`, one a record; only training records count.

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
        Number of the place, and % of the range.
    up : (m,) bool array
        Whether the leg rises.
    edges : (_PLACES + 1,) array
        Of the places [m].
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
        found: list[tuple[int, float, bool]] = []
        squares, count = 0.0, 0
        for trace in traces:
            percent = 100 * trace.residual / stroke
            at = np.clip(np.searchsorted(edges, trace.simulated, side="right") - 1, 0, _PLACES - 1)
            for start, stop in _legs(trace):
                up = bool(trace.voltage[stop - 1] > trace.voltage[start])
                total = np.bincount(at[start:stop], weights=percent[start:stop], minlength=_PLACES)
                size = np.bincount(at[start:stop], minlength=_PLACES)
                found += [(k, float(total[k] / size[k]), up) for k in np.flatnonzero(size).tolist()]
            squares, count = squares + float(np.sum(percent**2)), count + percent.size
        place, residual, up_ = (np.array(column) for column in zip(*found, strict=True))
        return cls(place.astype(np.intp), residual, up_.astype(bool), edges, float(np.sqrt(squares / max(count, 1))))

    def at(self, k: int, up: bool) -> tuple[float, float, int]:
        """Mean of the legs of one direction at a place, its standard deviation, and their number; NaN without any."""
        own = self.residual[(self.place == k) & (self.up == up)]
        if not own.size:
            return float("nan"), 0.0, 0
        spread = float(own.std(ddof=1)) if own.size >= _FEWEST else self.noise
        return float(own.mean()), spread / float(np.sqrt(own.size)), own.size

    def largest(self, sign: int) -> tuple[float, float, float]:
        """Of half of rising plus sign times falling: where [m], how large, and what scatter alone gives [%]."""
        from scipy.special import stdtrit

        found = []
        for k in range(_PLACES):
            (up, one, rises), (down, other, falls) = self.at(k, True), self.at(k, False)
            # Of few legs the scatter itself is known badly: Student's quantile, for the place that is worst by chance.
            factor = float(stdtrit(max(min(rises, falls) - 1, _FEWEST - 1), 1 - RISK / (2 * _PLACES)))
            value, scatter = 0.5 * (up + sign * down), 0.5 * factor * float(np.hypot(one, other))
            if np.isfinite(value):
                found.append((abs(value) / max(scatter, _SMALLEST), abs(value), scatter, k))
        if not found:
            return float("nan"), float("nan"), float("nan")
        _, value, scatter, k = max(found)
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
    said = f"The least slope of an outermost branch is {value:.3g} V/um, at {slopes.displacement[k] * 1e6:.4g} um."
    verdict = Verdict.HOLDS
    if floor is not None and value <= floor * 1.01:
        verdict = Verdict.UNKNOWN
        said += " It was held up there: whether it would rise by itself is not known; try a smaller slope_floor."
    return Check("Rising branches", verdict, value, floor, "V/um", said)


def _sliding(actuator: Actuator, training: Sequence[Trace]) -> Check:
    name, unit = "Sliding elements", "% of elements"
    needed = 2 * actuator.slip.breakaway[actuator.slip.friction > 0]
    if not needed.size:
        return Check(name, Verdict.HOLDS, None, None, unit, "No element has stiffness: there is none that must slide.")
    reach = max(float(np.ptp(trace.simulated)) for trace in training)
    slid = int(np.count_nonzero(needed <= reach * (1 + 1e-3)))
    said = f"{slid} of the {needed.size} elements with stiffness slide all the way in the widest motion."
    if slid < needed.size:
        said += f" The widest needs {needed[-1] * 1e6:.4g} um, there are {reach * 1e6:.4g} um: record a wider loop."
    verdict = Verdict.HOLDS if slid == needed.size else Verdict.FAILS
    return Check(name, verdict, 100 * slid / needed.size, None, unit, said)


def _width(means: _Means) -> Check:
    at, value, floor = means.largest(-1)
    return _pattern(
        "Width",
        value,
        floor,
        f"Residuals of rising and of falling branches lie up to {2 * value:.2g} % of the range "
        f"apart, most at {at * 1e6:.4g} um",
        "the loops are wider or narrower there than the model's: add elements, grades, or loops that turn there",
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


def _pattern(name: str, value: float, floor: float, said: str, why: str) -> Check:
    if not np.isfinite(value):
        words = "No place is passed both rising and falling."
        return Check(name, Verdict.UNKNOWN, None, None, _OF_RANGE, words)
    if value <= max(floor, _SMALLEST):
        reason = "which does not matter" if value <= _SMALLEST else "which their scatter explains"
        return Check(name, Verdict.HOLDS, value, floor, _OF_RANGE, f"{said}, {reason}.")
    return Check(name, Verdict.FAILS, value, floor, _OF_RANGE, f"{said}: {why}.")


def _drift(training: Sequence[Trace], stroke: float) -> Check:
    """Slope of the legs' mean residuals against the logarithm of the time since the record's start."""
    from scipy.special import stdtrit

    name, unit = "No drift", "% a decade"
    found = []
    for trace in training:
        legs = _legs(trace)
        if len(legs) <= _FEWEST:
            continue
        middle = np.array([0.5 * (trace.time[a] + trace.time[b - 1]) - trace.time[0] for a, b in legs])
        mean = np.array([float(trace.residual[a:b].mean()) for a, b in legs]) * 100 / stroke
        decades = np.log10(np.maximum(middle, middle[middle > 0].min()))
        off = decades - decades.mean()
        slope = float(off @ mean / (off @ off))
        left = mean - mean.mean() - slope * off
        scatter = float(np.sqrt(left @ left / (len(legs) - 2) / (off @ off)))
        floor = float(stdtrit(len(legs) - 2, 1 - RISK / (2 * len(training)))) * scatter
        found.append((abs(slope) / max(floor, _SMALLEST), abs(slope), floor, float(np.ptp(decades)), trace.record))
    if not found:
        return Check(name, Verdict.UNKNOWN, None, None, unit, "No record has legs enough to tell a drift.")
    ratio, value, floor, seen, record = max(found)
    said = f"{record}: what the model leaves drifts by {value:.2g} % of the range a decade of time since its start"
    if not may_creep(value, seen):
        value, floor, unit = value * seen, floor * seen, _OF_RANGE
        said = f"{record}: what the model leaves drifts by {value:.3g} % of the range in all"
    if ratio <= 1:
        reason = "which does not matter" if value <= _SMALLEST else "which its scatter explains"
        return Check(name, Verdict.HOLDS, value, floor, unit, f"{said}, {reason}.")
    why = "it creeps longer than the model's branches last, or its surroundings changed; expect as much in use"
    return Check(name, Verdict.FAILS, value, floor, unit, f"{said}: {why}.")
