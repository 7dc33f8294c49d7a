"""The numbers of a model, part by part, with their intervals: what of them is known to a stated precision."""

from __future__ import annotations

import numpy as np

from dehyst._types import Array, Mask
from dehyst.uncertainty.bootstrap import Intervals
from dehyst.uncertainty.evidence import Evidence
from dehyst.uncertainty.feasible_set import FeasibleSet
from dehyst.uncertainty.part_identifiability import PartIdentifiability
from dehyst.uncertainty.precision import PartPrecision, Precision

_STIFFNESS = ("stiffness", "stiffnesses", "V/m")
_SPRING = ("spring segment", "spring segments", "V/m")


def plain_precision(evidence: Evidence, intervals: Intervals, free: FeasibleSet, precision: float) -> Precision:
    """Judge the stiffnesses of plain elements that slide, and the spring's segments, by noise and compatible models."""
    actuator, directions = evidence.actuator, evidence.identifiability
    movable = directions.movable
    elements = PartPrecision.of(
        _STIFFNESS,
        actuator.slip.stiffness[movable],
        intervals.stiffness[:, movable],
        directions.alone[movable],
        precision,
        free.stiffness[:, movable],
    )
    slopes = actuator.spring.slopes
    # An open direction that moves a segment shows in the segment's range among compatible models.
    every = np.ones(slopes.size, dtype=bool)
    spring = PartPrecision.of(_SPRING, slopes, intervals.slopes, every, precision, free.slopes)
    return Precision((elements, spring), precision, intervals.level)


def structured_precision(
    evidence: Evidence, intervals: Intervals, parts: tuple[PartIdentifiability, ...], precision: float
) -> Precision:
    """Judge all coefficients of a structured model by noise; those that the structure holds at nothing are left out."""
    known = {one.part: one.alone for one in parts}
    actuator, movable = evidence.actuator, evidence.regression.movable
    kappa, noise = actuator.slip.stiffness[movable], intervals.stiffness[:, movable]
    elements = next((known[name] for name in known if name.endswith("elements") and name != "smooth elements"), None)
    judged = [
        (_STIFFNESS, kappa.ravel(), noise.reshape(2, -1), elements),
        (_SPRING, actuator.spring.slopes, intervals.slopes, known.get("parallel spring")),
    ]
    if actuator.creep is not None and intervals.creep is not None:
        names = "creep branch", "creep branches", "V/m"
        judged.append((names, actuator.creep.stiffness, intervals.creep, known.get("creep")))
    if actuator.smooth is not None and intervals.smooth is not None:
        names = "smooth element", "smooth elements", "V/m"
        judged.append((names, actuator.smooth.stiffness, intervals.smooth, known.get("smooth elements")))
    if actuator.transformer is not None and intervals.gains is not None:
        names = "transformer segment", "transformer segments", "V/V"
        judged.append((names, actuator.transformer.slopes, intervals.gains, _with_last(known.get("transformer"))))
    made = [_part(names, estimate, ends, alone, precision) for names, estimate, ends, alone in judged]
    return Precision(tuple(part for part in made if part.of_all), precision, intervals.level)


def _part(
    names: tuple[str, str, str], estimate: Array, noise: Array, alone: Mask | None, precision: float
) -> PartPrecision:
    determined = np.zeros(estimate.size, dtype=bool) if alone is None else alone
    return PartPrecision.of(names, estimate, noise, determined, precision)


def _with_last(alone: Mask | None) -> Mask | None:
    """Add the last segment of tau, whose slope follows from the others as the ends are fixed."""
    return None if alone is None else np.append(alone, alone.all())
