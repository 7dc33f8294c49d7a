"""Linear programs solved by SciPy's HiGHS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from dehyst._types import Array

# Data are of the order of one: these are absolute.
_TOLERANCES = {"primal_feasibility_tolerance": 1e-9, "dual_feasibility_tolerance": 1e-9}


@dataclass(frozen=True)
class LinearSolution:
    """HiGHS's solution of a linear program.

    `value` (n,). `multipliers` (p + m,): change of the objective by the right-hand sides of equations, then
    inequalities. Both are empty without an optimum.
    """

    value: Array
    multipliers: Array
    optimal: bool
    status: str


def minimum(
    cost: Array,
    bounds: tuple[Array, Array],
    equal: tuple[Array, Array],
    below: tuple[Array, Array],
    solver: Literal["highs-ds", "highs-ipm"] = "highs-ds",
) -> LinearSolution:
    """Minimise cost'x, bounds[0] <= x <= bounds[1], equal[0] x = equal[1], below[0] x <= below[1] (dense)."""
    from scipy.optimize import linprog

    least: Any = linprog
    found = least(
        cost,
        A_ub=below[0],
        b_ub=below[1],
        A_eq=equal[0],
        b_eq=equal[1],
        bounds=np.column_stack(bounds),
        method=solver,
        options=_TOLERANCES,
    )
    if found.status:
        return LinearSolution(np.zeros(0), np.zeros(0), False, f"HiGHS: {found.message}")
    multipliers = np.concatenate([found.eqlin.marginals, found.ineqlin.marginals])
    return LinearSolution(found.x, multipliers, True, f"HiGHS, {solver}")
