"""The methods of the paper: break points of averaged loops, a linear program (Sec. 4.1), Remark 2's closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dehyst._errors import IdentifyError
from dehyst._text import counted
from dehyst._types import Array
from dehyst.identification.diagnostics.branches import Branch, families, voltage_at
from dehyst.identification.settings import Direction
from dehyst.identification.solvers import highs
from dehyst.model import Actuator, MaxwellSlip, Outcome, Spring, parts_in_segments
from dehyst.records import Record


@dataclass(frozen=True, eq=False)
class BreakPointLoop:
    """A closed loop between two turning points, its cycles averaged.

    `bottom`, `top`: turning points [m]. `descending`, `ascending` (m, 2): break points (displacement [m], voltage [V])
    of the branch, its two ends among them, in the order of motion.
    """

    record: str
    bottom: float
    top: float
    descending: Array
    ascending: Array

    @property
    def range(self) -> float:
        """Width of the loop [m]."""
        return self.top - self.bottom


@dataclass(frozen=True, eq=False)
class Identified:
    """The result of one of these methods; `actuator` is None if the solver failed."""

    actuator: Actuator | None
    outcome: Outcome
    status: str
    gap: float
    remarks: tuple[str, ...] = ()


def loops_of(records: list[Record], elements: int) -> list[BreakPointLoop]:
    """Find the closed loops of the records, the widest first, with their break points for N = `elements`.

    A branch is used if the motion before it was at least as wide: then every element that slides on it starts from its
    breakaway elongation; the others are springs with an unknown constant force (Remark 4).

    Raise `IdentifyError` if no record holds a closed loop.
    """
    groups = [family for record in records for family in families(record)]
    if not groups:
        raise IdentifyError(
            "no closed loop found: the voltage must go up, down and up again between the same two turning points",
            hint="record two cycles, or use the method 'record'",
            change=("method",),
        )
    step = max(top - bottom for _, bottom, top, _, _ in groups) / elements
    loops = [
        BreakPointLoop(name, bottom, top, _break_points(down, top, bottom, step), _break_points(up, bottom, top, step))
        for name, bottom, top, down, up in groups
    ]
    return sorted(loops, key=lambda loop: -loop.range)


def _break_points(branches: list[Branch], start: float, end: float, step: float) -> Array:
    """Return mean voltages after motions of 0, step, 2 step, ... and at the end."""
    count = int(np.floor(abs(end - start) / step * (1 + 1e-9)))
    moved = np.minimum(np.arange(count + 1) * step, abs(end - start))
    if moved[-1] < abs(end - start) * (1 - 1e-6):
        moved = np.append(moved, abs(end - start))
    places = start + np.sign(end - start) * moved
    places[-1] = end
    return np.column_stack([places, np.mean([voltage_at(branch, places) for branch in branches], axis=0)])


def linear_program(loops: list[BreakPointLoop], elements: int, slope_floor: float) -> Identified:
    """Minimise the sum of absolute voltage errors at the break points of all loops (Sec. 4.1, Remark 4).

    The turning points of the major loop are met exactly (Eq. 4 and closure, Fdown_N = 0). Unknowns: k_i >= 0, the
    spring's slopes between its knots (the g_i), and a constant for each minor loop. If the spring falls
    somewhere, the program is solved again with Assumption I imposed.
    """
    major = loops[0]
    rho: Array = np.asarray(major.range / (2 * elements) * np.arange(1, elements + 1), dtype=np.float64)
    knots = np.linspace(major.bottom, major.top, elements + 1)
    rows, target = _rows(loops, rho, knots)
    mean_slope = (major.ascending[-1, 1] - major.ascending[0, 1]) / major.range
    unconstrained = _solve(rows, target, elements, len(loops), -np.inf, major)
    outcome, remarks, solution = Outcome.IDENTIFIED, [], unconstrained
    if not unconstrained[2] or np.any(unconstrained[0][elements : 2 * elements] < 1e-3 * mean_slope):
        outcome = Outcome.ASSUMPTION_I_IMPOSED
        solution = _solve(rows, target, elements, len(loops), slope_floor * mean_slope, major)
    x, objective, optimal, status, gap = solution
    if not optimal:
        return Identified(None, Outcome.FAILED, status, gap)
    kappa, slopes = np.maximum(x[:elements], 0.0), x[elements : 2 * elements]
    if len(loops) == 1 and outcome is Outcome.IDENTIFIED:
        outcome = Outcome.UNDETERMINED
        remarks.append(
            f"One loop determines {elements // 2} combinations of the {elements} stiffnesses: minor loops may be "
            "predicted wrongly (the program returns one of many optima)."
        )
    remarks.append(
        f"{len(target)} break points of {counted(len(loops), 'loop')}, sum of absolute errors {objective:.4g} V."
    )
    spring = Spring.of_slopes(knots, slopes, float(x[2 * elements]))
    actuator = Actuator(MaxwellSlip(rho, kappa), spring, name=major.record)
    return Identified(actuator, outcome, status, gap, tuple(remarks))


def _rows(loops: list[BreakPointLoop], rho: Array, knots: Array) -> tuple[Array, Array]:
    """Return a row for each break point: elongations, parts of the spring's segments, a constant for each loop."""
    rows, target = [], []
    for number, loop in enumerate(loops):
        slides = 2 * rho <= loop.range * (1 + 1e-9)
        for branch, sign in ((loop.descending, -1.0), (loop.ascending, 1.0)):
            y, v = branch[:, 0], branch[:, 1]
            moved = np.abs(y - y[0])[:, None]
            elongation = np.where(
                slides, sign * (np.minimum(moved, 2 * rho) - rho), (y - 0.5 * (loop.bottom + loop.top))[:, None]
            )
            constants = np.zeros((y.size, len(loops)))
            constants[:, number] = 1.0
            rows.append(np.hstack([elongation, parts_in_segments(knots, y), constants]))
            target.append(v)
    return np.vstack(rows), np.concatenate(target)


def _solve(
    rows: Array, target: Array, elements: int, loops: int, floor: float, major: BreakPointLoop
) -> tuple[Array, float, bool, str, float]:
    """Solve the linear program with split residuals: x, objective [V], optimal, status, relative gap."""
    count, unknowns = rows.shape
    scale = np.abs(rows).max(axis=0)
    scale[scale == 0] = 1.0
    size = float(np.abs(target).max())
    matrix = np.hstack([rows / scale, -np.eye(count), np.eye(count)])
    fixed = np.zeros(count, dtype=bool)
    # The first loop's first and last break points: the turning points of the major loop, at its two ends.
    fixed[[0, len(major.descending) - 1]] = True
    cost = np.concatenate([np.zeros(unknowns), np.ones(2 * count)])
    lower = np.concatenate([np.zeros(elements), np.full(elements, floor), np.full(loops, -np.inf)]) * scale / size
    lower = np.concatenate([lower, np.zeros(2 * count)])
    upper = np.concatenate([np.full(unknowns, np.inf), np.where(np.tile(fixed, 2), 0.0, np.inf)])
    goal = target / size
    program = cost, (lower, upper), matrix, (goal, goal)
    found = highs.minimum(*program)
    gap = abs(found.objective - highs.dual_objective(found, *program)) / max(float(np.abs(goal).sum()), 1e-300)
    return found.value[:unknowns] / scale * size, found.objective * size, found.optimal, found.status, gap


def closed_form(loops: list[BreakPointLoop], elements: int, branch: Direction) -> Identified:
    """Apply Remark 2: k_i from second differences of one branch's break voltages, for an anti-symmetric loop without g.

    k_N acts as part of the spring and is set to zero; so are negative stiffnesses.
    """
    major = loops[0]
    points = getattr(major, branch)
    sign = 1.0 if branch == "descending" else -1.0
    step = major.range / elements
    v = points[: elements + 1, 1]
    kappa = np.append(sign * (v[:-2] + v[2:] - 2 * v[1:-1]) / step, 0.0)
    rho = 0.5 * step * np.arange(1, elements + 1)
    clipped = np.flatnonzero(kappa < 0)
    remarks = []
    if clipped.size:
        numbers = ", ".join(str(i + 1) for i in clipped)
        remarks.append(f"The closed form gave negative stiffnesses for elements {numbers}; set to zero.")
    kappa = np.maximum(kappa, 0.0)
    slope = abs(v[-1] - v[-2]) / step
    # Eq. 4, and its mirror image where the ascending branch starts.
    at_start = v[0] - sign * float(kappa @ rho)
    start, end = (major.top, major.bottom) if branch == "descending" else (major.bottom, major.top)
    knots, values = np.array([start, end]), np.array([at_start, at_start + slope * (end - start)])
    order = np.argsort(knots)
    actuator = Actuator(MaxwellSlip(rho, kappa), Spring(knots[order], values[order]), name=major.record)
    outcome = Outcome.STIFFNESS_CLIPPED if clipped.size else Outcome.IDENTIFIED
    return Identified(actuator, outcome, "closed form", 0.0, tuple(remarks))
