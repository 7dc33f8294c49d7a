"""Linear programs solved by HiGHS on one thread."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from dehyst._types import Array


@dataclass(frozen=True)
class LinearSolution:
    """HiGHS's solution of a linear program."""

    value: Array
    row_dual: Array
    objective: float
    optimal: bool
    status: str


def minimum(
    cost: Array, bounds: tuple[Array, Array], rows: Array, limits: tuple[Array, Array], *, solver: str = "simplex"
) -> LinearSolution:
    """Minimise cost'x, bounds[0] <= x <= bounds[1], limits[0] <= rows x <= limits[1] (dense); "simplex" or "ipm"."""
    return _run(_highs_model(cost, bounds, rows, limits, solver), solver)


def dual_objective(
    solution: LinearSolution, cost: Array, bounds: tuple[Array, Array], rows: Array, limits: tuple[Array, Array]
) -> float:
    """Return the value of the dual program at a solution."""
    dual = solution.row_dual
    return _support(dual, *limits) + _support(cost - rows.T @ dual, *bounds)


def _highs_model(
    cost: Array, bounds: tuple[Array, Array], rows: Array, limits: tuple[Array, Array], solver: str
) -> Any:
    import highspy

    m, n = rows.shape
    lp: Any = highspy.HighsLp()
    lp.num_col_, lp.num_row_ = n, m
    lp.col_cost_, lp.col_lower_, lp.col_upper_ = cost, bounds[0], bounds[1]
    lp.row_lower_, lp.row_upper_ = limits
    lp.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    lp.a_matrix_.start_ = np.arange(n + 1) * m
    lp.a_matrix_.index_ = np.tile(np.arange(m), n)
    lp.a_matrix_.value_ = np.ascontiguousarray(rows.T).ravel()
    highs = _silent_highs()
    for option, value in (
        ("threads", 1),
        ("solver", solver),
        ("random_seed", 0),
        ("primal_feasibility_tolerance", 1e-9),
        ("dual_feasibility_tolerance", 1e-9),
    ):
        highs.setOptionValue(option, value)
    highs.passModel(lp)
    return highs


def _silent_highs() -> Any:
    """Return a HiGHS that prints nothing: from 1.16 on its constructor prints a header unless the output is off."""
    import highspy

    class Silent(highspy.Highs):
        def enableCallbacks(self) -> None:  # noqa: N802 - HiGHS's name; its constructor calls it first
            self.setOptionValue("output_flag", False)
            super().enableCallbacks()  # type: ignore[no-untyped-call]

    highs = Silent()  # type: ignore[no-untyped-call]
    highs.setOptionValue("output_flag", False)
    return highs


def _run(highs: Any, solver: str) -> LinearSolution:
    import highspy

    highs.run()
    status = highs.getModelStatus()
    solution = highs.getSolution()
    return LinearSolution(
        np.array(solution.col_value),
        np.array(solution.row_dual),
        float(highs.getInfo().objective_function_value),
        status == highspy.HighsModelStatus.kOptimal,
        f"HiGHS {solver}: {highs.modelStatusToString(status)}",
    )


def linear_programs(
    costs: Array, bounds: tuple[Array, Array], rows: Array, limits: tuple[Array, Array]
) -> Iterator[LinearSolution]:
    """Minimise each of many costs (p, n) as `minimum` does, each from the optimum of the previous one."""
    highs = _highs_model(costs[0], bounds, rows, limits, "simplex")
    every = np.arange(rows.shape[1], dtype=np.int32)
    # The previous optimum is feasible: the primal simplex continues from it, the dual simplex would start anew.
    for k, cost in enumerate(costs):
        highs.changeColsCost(every.size, every, cost)
        highs.setOptionValue("simplex_strategy", 4 if k else 1)
        yield _run(highs, "simplex")


def _support(multipliers: Array, lower: Array, upper: Array) -> float:
    """Return the least value of multipliers'z over lower <= z <= upper, without rounding at infinite bounds."""
    bound = np.where(multipliers > 0, lower, upper)
    finite = np.isfinite(bound)
    return float(multipliers[finite] @ bound[finite])
