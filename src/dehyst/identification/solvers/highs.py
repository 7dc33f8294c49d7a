"""Linear programs solved by HiGHS on one thread."""

from __future__ import annotations

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
    return _solved(_model(cost, bounds, rows, limits, solver), solver)


def dual_objective(
    solution: LinearSolution, cost: Array, bounds: tuple[Array, Array], rows: Array, limits: tuple[Array, Array]
) -> float:
    """Return the value of the dual program at a solution."""
    dual, value = solution.row_dual, 0.0
    for multipliers, (lower, upper) in ((dual, limits), (cost - rows.T @ dual, bounds)):
        bound = np.where(multipliers > 0, lower, upper)
        # Infinite bounds have multipliers of zero, up to rounding.
        finite = np.isfinite(bound)
        value += float(multipliers[finite] @ bound[finite])
    return value


def _model(cost: Array, bounds: tuple[Array, Array], rows: Array, limits: tuple[Array, Array], solver: str) -> Any:
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

    class Silent(highspy.Highs):
        # From 1.16 on the constructor prints a header unless the output is off; this is what it calls first.
        def enableCallbacks(self) -> None:  # noqa: N802 - HiGHS's name
            self.setOptionValue("output_flag", False)
            super().enableCallbacks()  # type: ignore[no-untyped-call]

    highs = Silent()  # type: ignore[no-untyped-call]
    for option, value in (
        ("output_flag", False),
        ("threads", 1),
        ("solver", solver),
        ("random_seed", 0),
        ("primal_feasibility_tolerance", 1e-9),
        ("dual_feasibility_tolerance", 1e-9),
    ):
        highs.setOptionValue(option, value)
    highs.passModel(lp)
    return highs


def _solved(highs: Any, solver: str) -> LinearSolution:
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
