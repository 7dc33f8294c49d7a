"""The paper's identification: break points of averaged loops, and a linear program (Sec. 4.1).

Displacements y and voltages v of break points satisfy, with kappa_i = k_i / (T c), rho_i = c r_i and c = keq / km:

    v = sum_i kappa_i s_i + eta(y) + constant of the loop,   s_i = -+rho_i +- min(motion, 2 rho_i)

s_i are the elongations on a branch where every sliding element starts from its breakaway elongation. An element that
does not slide in a minor loop is a spring with an unknown constant force (Remark 4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from dehyst import _validation
from dehyst._errors import IdentifyError
from dehyst._types import Array
from dehyst.model import Actuator, MaxwellSlip, Spring, parts_in_segments
from dehyst.records import Record, reversals

# Displacements (n,) [m] and voltages (n,) [V] of one branch, in the order of motion.
Branch: TypeAlias = "tuple[Array, Array]"
# Turning points closer than this part of the stroke count as the same.
_SAME_TURN = 0.02
# Slopes of the spring, as parts of the mean slope of the major loop: above the first, Assumption I holds; the second
# is the least slope that the program imposes if it does not hold.
_RISES, _FLOOR = 1e-3, 0.2


@dataclass(frozen=True, eq=False)
class BreakPointLoop:
    """A closed loop between two turning points, its cycles averaged.

    `bottom`, `top`: turning points [m]. `descending`, `ascending` (m, 2): break points (displacement [m], voltage [V])
    of the branch and its two ends, in the order of motion.
    """

    bottom: float
    top: float
    descending: Array
    ascending: Array

    @property
    def range(self) -> float:
        """Width of the loop [m]."""
        return self.top - self.bottom


@dataclass(frozen=True, eq=False)
class PaperFit:
    """The result of the paper's method.

    Attributes
    ----------
    actuator : Actuator
    outcome : str
        "IDENTIFIED"; "UNDETERMINED" with a single loop; or "ASSUMPTION_I_IMPOSED".
    loops : tuple of BreakPointLoop
        Loops, the widest first.
    error : float
        Sum of absolute errors at the break points [V].
    """

    actuator: Actuator
    outcome: str
    loops: tuple[BreakPointLoop, ...]
    error: float


def loops_of(records: Record | Sequence[Record], elements: int) -> tuple[BreakPointLoop, ...]:
    """Find the closed loops of records, the widest first, with their break points for N = `elements`.

    Raise `IdentifyError` if no record holds a closed loop.
    """
    given = [records] if isinstance(records, Record) else records
    closed = [loop for record in given for loop in _closed(record)]
    if not closed:
        raise IdentifyError(
            "no closed loop found: the voltage must go up, down and up again between the same two turning points",
            hint="record two cycles, or use dehyst.identify",
        )
    step = max(top - bottom for bottom, top, *_ in closed) / _validation.count(elements, "elements", least=2)
    loops = [
        BreakPointLoop(bottom, top, _break_points(down, top, bottom, step), _break_points(up, bottom, top, step))
        for bottom, top, down, up in closed
    ]
    return tuple(sorted(loops, key=lambda loop: -loop.range))


def _closed(record: Record) -> list[tuple[float, float, list[Branch], list[Branch]]]:
    """Return mean turning points [m], descending and ascending branches of each closed loop of a record.

    A branch is used if the motion before it was at least as wide. Then every element that slides on the branch starts
    from its breakaway elongation.
    """
    turns = [0, *reversals(record).tolist(), len(record) - 1]
    y, v = record.displacement, record.voltage
    same = _SAME_TURN * record.stroke
    # Turning points of the first branch of each group; descending and ascending branches.
    groups: list[tuple[float, float, list[Branch], list[Branch]]] = []
    for before, start, end in zip(turns[:-2], turns[1:-1], turns[2:], strict=True):
        if abs(y[start] - y[before]) < abs(y[end] - y[start]) - same:
            continue
        low, high = sorted((float(y[start]), float(y[end])))
        group = next((known for known in groups if abs(known[0] - low) < same and abs(known[1] - high) < same), None)
        if group is None:
            group = low, high, [], []
            groups.append(group)
        (group[3] if y[end] > y[start] else group[2]).append((y[start : end + 1], v[start : end + 1]))
    found = []
    for _, _, down, up in groups:
        if down and up:
            bottoms = [y[-1] for y, _ in down] + [y[0] for y, _ in up]
            tops = [y[0] for y, _ in down] + [y[-1] for y, _ in up]
            found.append((float(np.mean(bottoms)), float(np.mean(tops)), down, up))
    return found


def voltage_at(branch: Branch, places: Array) -> Array:
    """Interpolate the voltage [V] of one branch at displacements `places` (m,) [m], shape (m,).

    Noise moves the displacement of a branch back and forth; the mean of its upper and lower envelopes is used. Beyond
    the ends of the branch the voltage is constant.
    """
    y, v = branch if branch[0][-1] > branch[0][0] else (branch[0][::-1], branch[1][::-1])
    upper, lower = np.maximum.accumulate(y), np.minimum.accumulate(y[::-1])[::-1]
    monotone = 0.5 * (upper + lower)
    keep = np.append(True, np.diff(monotone) > 0)
    return np.asarray(np.interp(places, monotone[keep], v[keep]))


def _break_points(branches: list[Branch], start: float, end: float, step: float) -> Array:
    """Return mean voltages after motions of 0, step, 2 step, ... and at the end."""
    count = int(np.floor(abs(end - start) / step * (1 + 1e-9)))
    moved = np.minimum(np.arange(count + 1) * step, abs(end - start))
    if moved[-1] < abs(end - start) * (1 - 1e-6):
        moved = np.append(moved, abs(end - start))
    places = start + np.sign(end - start) * moved
    places[-1] = end
    return np.column_stack([places, np.mean([voltage_at(branch, places) for branch in branches], axis=0)])


def identify(records: Record | Sequence[Record], *, elements: int = 10) -> PaperFit:
    """Identify by the linear program of Sec. 4.1: least absolute errors at the break points of all loops.

    The turning points of the major loop are met exactly (Eq. 4 and closure). If the spring falls somewhere, the program
    is solved again with Assumption I imposed. If the loops do not determine all combinations of stiffnesses, the
    program has many optima, and returns one of them.

    Parameters
    ----------
    records : Record or sequence of Record
        Records with closed loops; the sensor keeps its zero in all records.
    elements : int, optional
        Number N of elements.

    Raises
    ------
    IdentifyError
        If there is no closed loop, or the program has no optimum.
    """
    loops = loops_of(records, elements)
    major = loops[0]
    mean_slope = (major.ascending[-1, 1] - major.ascending[0, 1]) / major.range
    rho, knots = _grid(major, elements), np.linspace(major.bottom, major.top, elements + 1)
    outcome = "UNDETERMINED" if len(loops) == 1 else "IDENTIFIED"
    x, error = _least_absolute(loops, rho, knots, -np.inf)
    if np.any(x[elements : 2 * elements] < _RISES * mean_slope):
        outcome = "ASSUMPTION_I_IMPOSED"
        x, error = _least_absolute(loops, rho, knots, _FLOOR * mean_slope)
    spring = Spring.of_slopes(knots, x[elements : 2 * elements], float(x[2 * elements]))
    return PaperFit(_actuator(major, rho, np.maximum(x[:elements], 0.0), spring), outcome, loops, error)


def _grid(major: BreakPointLoop, elements: int) -> Array:
    """Return the breakaway elongations (N,) [m] that give equally spaced break points."""
    return np.asarray(major.range / (2 * elements) * np.arange(1, elements + 1), dtype=np.float64)


def _actuator(major: BreakPointLoop, rho: Array, kappa: Array, spring: Spring) -> Actuator:
    volts = np.concatenate([major.descending[:, 1], major.ascending[:, 1]])
    return Actuator(MaxwellSlip(rho, kappa), spring, limits=(float(volts.min()), float(volts.max())))


def _least_absolute(loops: Sequence[BreakPointLoop], rho: Array, knots: Array, floor: float) -> tuple[Array, float]:
    """Return stiffnesses, slopes of the spring and a constant for each loop, and the sum of absolute errors [V]."""
    from scipy.optimize import linprog

    rows, target = _rows(loops, rho, knots)
    count, elements = len(target), rho.size
    scale, size = np.abs(rows).max(axis=0), float(np.abs(target).max())
    scale[scale == 0] = 1.0
    least = np.concatenate([np.zeros(elements), np.full(elements, floor), np.full(len(loops), -np.inf)]) * scale / size
    # Columns of positive and negative errors; without errors at the two turning points of the first loop.
    most = np.full(count, np.inf)
    most[[0, len(loops[0].descending) - 1]] = 0.0
    errors = np.column_stack([np.zeros(2 * count), np.tile(most, 2)])
    least_of: Any = linprog
    found = least_of(
        np.append(np.zeros(least.size), np.ones(2 * count)),
        A_eq=np.hstack([rows / scale, -np.eye(count), np.eye(count)]),
        b_eq=target / size,
        bounds=np.vstack([np.column_stack([least, np.full(least.size, np.inf)]), errors]),
        method="highs-ds",
        options={"primal_feasibility_tolerance": 1e-9, "dual_feasibility_tolerance": 1e-9},
    )
    if found.status:
        raise IdentifyError(f"the linear program has no optimum: {found.message}", hint="use fewer elements")
    return found.x[: least.size] / scale * size, float(found.fun) * size


def _rows(loops: Sequence[BreakPointLoop], rho: Array, knots: Array) -> tuple[Array, Array]:
    """Return a row for each break point: elongations, parts in the spring's segments, and a constant of each loop."""
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
