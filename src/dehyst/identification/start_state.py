"""The carts at the start of a record, from its samples before every element is in a known state.

While element i has not slid since the first sample of a record, its cart stands at b_i; afterwards the displacement
alone determines it. Therefore the voltages before the widest range determine the carts, through

    tau(v) - eta(y) - smooth = sum_i force_i(y, b_i) + constant,

which is solved by bounded least squares from several starts (theory: the whole record, judged whole). In every state
that a history can reach, neighbouring carts differ by the difference of their thresholds at most:
b_1 = y_0 + rho_1 u_1, b_i+1 = b_i + (rho_i+1 - rho_i) u_i+1 with all u in [-1, 1].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from dehyst._native import slip_elongations, smooth_elongations
from dehyst._types import Array, Mask
from dehyst.identification.rules import RULES
from dehyst.model import GradedSlip, MaxwellSlip, SmoothSlip, segment_of

# Starts: all carts at the displacement, above, below; the next is tried if the residual exceeds this part of the range.
_STARTS = (0.0, 1.0, -1.0)
_GOOD = 5e-3
# Largest number of steps; the search ends if a step lowers the sum of squares by less than this part; a step may raise
# it by this rounding error, so that open directions do not depend on the last bit.
_STEPS, _WORTH, _SAME_COST = 12, 1e-4, 1e-9
# Weights of the differences of neighbouring carts, relative to the rows: carts of a history, and carts fitted alone.
_ALIKE, _HARDLY = 1e-2, 1e-9
# Step for numerical slopes, and tolerance of the search, of the elongation of a smooth element over its length.
_NEAR = 1e-3


class StartState(NamedTuple):
    """Carts and smooth elements at the first sample of a piece.

    `carts` (N,): positions [m], on the axis of the displacement. `constant`: offset of the voltages from the model [V].
    `held` (J,): voltages that smooth elements already hold at this sample [V]. `cost`: mean square of the residual
    voltages [V^2].
    """

    carts: Array
    constant: float
    held: Array
    cost: float


def fit_start(
    slip: MaxwellSlip | GradedSlip,
    displacement: Array,
    force: Array,
    fades: Array,
    most: Array,
    constant: float | None = None,
    counted: Mask | None = None,
) -> StartState:
    """Fit the carts, and the voltages that smooth elements hold, at the first sample.

    `displacement` (n,): path [m] from the first sample of a record, with all its turning points. `force` (n,): voltage
    that the elements hold along it [V], up to a constant, without the voltages held at the first sample. `fades`
    (n, J): remainder along the path of one volt that each smooth element held at the first sample. `most` (J,): largest
    voltages held there [V]. `constant`: the constant, if it is known. `counted` (n,) bool: samples whose forces count;
    the others only move the elements.
    """
    y, left, known = np.ascontiguousarray(displacement), force - (constant or 0.0), constant is not None
    problem = _Problem(slip, y, left, fades * most, known, slice(None) if counted is None else counted)
    solutions, count = [], len(slip)
    for sign in _STARTS:
        solutions.append(problem.solved(np.append(np.full(count, sign), np.zeros(most.size))))
        if solutions[-1][0] < (_GOOD * float(np.ptp(force))) ** 2:
            break
    cost, u, rest = min(solutions, key=lambda solution: solution[0])
    # From this solution, each cart is also fitted alone, even if no history leads to such carts.
    free = replace(problem, alone=True)
    start = np.clip((problem.carts(u) - displacement[0]) / slip.breakaway, -1.0, 1.0)
    polished = free.solved(np.append(start, u[count:]))
    if polished[0] < RULES.carts_alone_gain * cost:
        problem, (cost, u, rest) = free, polished
    return StartState(problem.carts(u), (constant or 0.0) + rest, u[count:] * most, cost)


def fit_strained(
    smooth: SmoothSlip, displacement: Array, force: Array, fit: Callable[[Array, Array, Array], StartState]
) -> tuple[StartState, Array]:
    """Fit smooth elements too; return the result of `fit_start`, and their elongations (L,) [m] at the first sample.

    `force` includes the voltages of smooth elements; `fit` is `fit_start` of the other elements, by force, fades and
    most. Gauss-Newton steps follow the voltage of a smooth element, a curve over its elongation (a line for closing 1).
    """
    length, stiffness = smooth.length, smooth.stiffness

    def along(start: Array) -> Array:
        return smooth_elongations(length, smooth.closing, displacement, start)

    first = np.zeros(len(smooth))
    for _ in range(_STEPS):
        low, high = np.maximum(first - _NEAR * length, -length), np.minimum(first + _NEAR * length, length)
        slopes = (along(high) - along(low)) / (high - low)
        line = force - (along(first) - slopes * first) @ stiffness
        found = fit(line, slopes, length * stiffness)
        before, held = first, found.held
        first = np.clip(np.divide(held, stiffness, out=np.zeros_like(held), where=stiffness > 0), -length, length)
        if np.all(np.abs(first - before) <= _NEAR * length):
            break
    none = np.zeros((force.size, 0))
    return fit(force - along(first) @ stiffness, none, none[0]), first


@dataclass(frozen=True, eq=False)
class _Problem:
    """Least squares over u (N + J,) in [-1, 1] of carts and of held voltages, and a constant."""

    slip: MaxwellSlip | GradedSlip
    displacement: Array
    force: Array
    fades: Array
    known: bool
    counted: Mask | slice
    alone: bool = False

    def carts(self, u: Array) -> Array:
        """Return the carts (N,) [m]."""
        rho = self.slip.breakaway
        if self.alone:
            return np.asarray(self.displacement[0] + rho * u[: rho.size])
        return np.asarray(self.displacement[0] + np.cumsum(np.diff(rho, prepend=0.0) * u[: rho.size]))

    def _residual(self, u: Array) -> tuple[Array, Array]:
        """Return the force minus the force of the elements (n,) [V], and its negative slopes over u (n, N + J)."""
        carts, slip, y = self.carts(u), self.slip, self.displacement[:, None]
        rho = slip.breakaway
        elongation, _ = slip_elongations(rho, carts, self.displacement)
        position = y - elongation
        if isinstance(slip, MaxwellSlip):
            held, stiffness = (y - position) @ slip.stiffness, slip.stiffness
        else:
            held = _integrals(slip, y).sum(axis=1) - _integrals(slip, position).sum(axis=1)
            stiffness = slip.slopes_at(carts)
        # After its first slide, an element no longer depends on the first position of its cart.
        standing = np.logical_and.accumulate(np.abs(position - carts) <= 1e-9 * rho, axis=0)
        # Reversed cumulative sums: u_i moves cart i and all carts of longer elements.
        by_cart = standing * -stiffness
        by_u = by_cart * rho if self.alone else np.cumsum(by_cart[:, ::-1], axis=1)[:, ::-1] * np.diff(rho, prepend=0.0)
        residual = self.force - held - self.fades @ u[rho.size :]
        return residual[self.counted], np.hstack([by_u, self.fades])[self.counted]

    def _cost(self, residual: Array) -> float:
        return float(np.mean(residual**2) if self.known else np.var(residual))

    def solved(self, u: Array) -> tuple[float, Array, float]:
        """Return the sum of squares, u and the constant, from a start, by Gauss-Newton steps."""
        from scipy.optimize import lsq_linear

        residual, slopes = self._residual(u)
        cost, count, branches = self._cost(residual), len(self.slip), self.fades.shape[1]
        # Rows that pull neighbouring carts together, and held voltages to 0.
        alike = np.zeros((count - 1 + branches, count + branches))
        alike[: count - 1, :count] = np.diff(np.eye(count), axis=0)
        alike[count - 1 :, count:] = np.eye(branches)
        alike *= (_HARDLY if self.alone else _ALIKE) * np.abs(slopes).max(initial=0.0) * np.sqrt(residual.size)
        for _ in range(_STEPS):
            both = np.column_stack([slopes, residual])
            both -= 0.0 if self.known else both.mean(axis=0)
            triangle = np.asarray(np.linalg.qr(both, mode="r"), dtype=np.float64)
            rows = np.vstack([triangle[:, :-1], alike])
            target = np.concatenate([triangle[:, -1], -alike @ u])
            step = lsq_linear(rows, target, bounds=(-1.0 - u - 1e-12, 1.0 - u + 1e-12), method="bvls").x
            if not np.isfinite(step).all():
                # No sample determines the carts.
                break
            for length in (1.0, 0.5, 0.25, 0.0):
                trial = np.clip(u + length * step, -1.0, 1.0)
                residual, slopes = self._residual(trial)
                if self._cost(residual) <= (1 + _SAME_COST) * cost or not length:
                    break
            now, before, u = self._cost(residual), cost, trial
            cost = min(now, cost)
            if now > (1 - _WORTH) * before:
                break
        return cost, u, 0.0 if self.known else float(residual.mean())


def _integrals(slip: GradedSlip, y: Array) -> Array:
    """Return the stiffness of each element, integrated from the first knot to y (n, N) or (n, 1) [V]."""
    knots, stiffness = slip.knots, slip.stiffness
    below = np.hstack([np.zeros((len(slip), 1)), np.cumsum(stiffness * np.diff(knots), axis=1)])
    segment, number = segment_of(knots, y), np.arange(len(slip))
    return np.asarray(below[number, segment] + stiffness[number, segment] * (y - knots[segment]))
