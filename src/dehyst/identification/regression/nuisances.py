"""What a record has besides the actuator: the sensor's delay, each record's datum and drift."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from math import inf, sqrt

import numpy as np

from dehyst._types import Array
from dehyst.identification.regression.coefficients import Coefficients
from dehyst.identification.regression.fold_sums import training_errors
from dehyst.identification.regression.regression import Regression
from dehyst.identification.rules import RULES
from dehyst.identification.solvers.program import solve
from dehyst.model import segment_of
from dehyst.records import turning_points

_SEARCH_ROWS = 4000
_STEPS = 20


def searched_delay(
    cost: Callable[[float], float], longest: float, sample_time: float, voltage: Array, stroke: float, points: int = 13
) -> float:
    """Return the delay [s] with the least cost, an RMS residual [m]; 0 unless the improvement is significant.

    `cost`: delay [s] -> [m]. `longest`, `sample_time`: largest delay looked for, and the time of a sample [s]; the
    answer is good to 1 % of a sample. `voltage` (n,): of the samples that count [V]: loops of one height have to
    explain more. `stroke`: [m]. `points`: delays of the first, even scan.
    """
    legs = np.abs(np.diff(voltage[turning_points(voltage, 0.02 * float(np.ptp(voltage)))]))
    one_height = legs.size < 2 or legs.min() > RULES.one_height * legs.max()
    share = RULES.delay_gain_at_turns if one_height else RULES.drift_gain
    cost = cache(cost)

    def worth(error: float) -> bool:
        return _worth(error, cost(0.0), stroke, share)

    best = _search(cost, 0.0, longest, points, 0.002 * sample_time, worth)
    return best if abs(best) > RULES.found_delay * sample_time and worth(cost(best)) else 0.0


def with_datums(regression: Regression, records: list[int], stroke: float) -> Regression:
    """Put records on one axis: search for each datum separately, then refine all found ones together (Gauss-Newton).

    A datum that was looked for while others were still wrong may have been missed, hence two rounds.
    """
    few = regression.thinned(_SEARCH_ROWS)
    for _ in range(2 if len(records) > 1 else 1):
        for q in records:
            if not few.datum[q]:
                datum = few.datum.copy()
                datum[q] = find_datum(few, q, stroke)
                few = replace(few, datum=datum)
        few = _polished(few, [q for q in records if few.datum[q]])
    return replace(regression, datum=few.datum)


def _polished(regression: Regression, records: list[int]) -> Regression:
    """All these datums at once, of Maxwell-slip elements; each step may only make the residual smaller."""
    if not records:
        return regression
    error = training_errors()
    best = error(regression)
    for _ in range(_STEPS):
        # The changes that least squares ask for, the spring linearised at the present datums.
        slope = regression.fit("l2").slopes[segment_of(regression.grid.knots, regression.axis)]
        shifts = [np.where(regression.rows.record == q, slope, 0.0)[:, None] for q in records]
        free, bounded, target = regression.table()
        datum = regression.datum.copy()
        datum[records] += solve(np.hstack([free, *shifts]), bounded, target, norm="l2").free[-len(records) :]
        trial = replace(regression, datum=datum)
        cost = error(trial)
        if not cost < best:
            break
        regression, best = trial, cost
    return regression


def find_datum(regression: Regression, record: int, stroke: float, given: Coefficients | None = None) -> float:
    """Shift d_q [m] of a record to the axis of the others, or of a given model; 0 unless it is significant."""
    few, error = regression.thinned(_SEARCH_ROWS), training_errors()

    def cost(shift: float) -> float:
        datum = few.datum.copy()
        datum[record] = shift
        moved = replace(few, datum=datum)
        return error(moved) if given is None else moved.rms(moved.fit_nuisances(given))

    best = _search(cost, -0.6 * stroke, 0.6 * stroke, 25, 1e-9 * stroke)
    return best if _worth(cost(best), cost(0.0), float(np.ptp(few.grid.knots)), RULES.datum_gain) else 0.0


def find_drifts(regression: Regression, candidates: Sequence[int]) -> tuple[int, ...]:
    """Return the candidate records with significant creep since the start."""
    few, error = regression.thinned(_SEARCH_ROWS), training_errors()
    stroke = float(np.ptp(few.grid.knots))
    return worthwhile(lambda drifting: error(replace(few, drifting=drifting)), candidates, stroke)


def worthwhile(cost: Callable[[tuple[int, ...]], float], candidates: Sequence[int], stroke: float) -> tuple[int, ...]:
    """Return the candidates that, one after another, reduce a cost, an RMS residual [m], enough."""
    kept: tuple[int, ...] = ()
    best = cost(kept)
    for q in candidates:
        trial = cost((*kept, q))
        if _worth(trial, best, stroke):
            kept, best = (*kept, q), trial
    return kept


def _worth(after: float, before: float, stroke: float, share: float = RULES.drift_gain) -> bool:
    """Whether a repair lowers the RMS residual enough."""
    return after < share * before and before - after > RULES.smallest_gain * stroke


def _search(
    cost: Callable[[float], float],
    low: float,
    high: float,
    points: int,
    tolerance: float,
    worth: Callable[[float], bool] = lambda error: True,
) -> float:
    """Global scan on `points` places, then Brent's method between the neighbours of the best.

    It ends early where no place there can have a cost that is worth it.
    """
    from scipy.optimize import minimize_scalar

    grid = np.linspace(low, high, points)
    errors = [cost(float(x)) for x in grid]
    k = int(np.argmin(errors))
    near = slice(max(k - 1, 0), min(k + 1, points - 1) + 1)
    squares = {float(x): error**2 for x, error in zip(grid[near], errors[near], strict=True)}

    # A residual is nearly the root of a parabola, which Brent's method finds in few steps.
    def square(x: float) -> float:
        squares[x] = cost(x) ** 2
        if not worth(sqrt(max(_least_of_convex(squares), 0.0))):
            raise StopIteration
        return squares[x]

    bounds = float(grid[near][0]), float(grid[near][-1])
    try:
        found = minimize_scalar(square, bounds=bounds, method="bounded", options={"xatol": tolerance, "maxiter": 60})
    except StopIteration:
        return min(squares, key=squares.__getitem__)
    return float(found.x)


def _least_of_convex(values: Mapping[float, float]) -> float:
    """Return a lower bound of a convex function between its places; -inf where the values are not convex."""
    x = np.array(sorted(values))
    y = np.array([values[one] for one in x])
    slopes = np.diff(y) / np.diff(x)
    if x.size < 4 or np.any(np.diff(slopes) < 0):
        return -inf
    # Between two places the function lies above the lines through the pairs left and right of them.
    bounds = [*y]
    for k, width in enumerate(np.diff(x)):
        left = slopes[k - 1] if k else None
        right = slopes[k + 1] if k + 2 < x.size else None
        if right is None or left == right:
            bounds.append(y[k] + (left or 0.0) * width)
        elif left is None:
            bounds.append(y[k + 1] - right * width)
        else:
            bounds.append(y[k] + left * (y[k + 1] - right * width - y[k]) / (left - right))
    return float(min(bounds))
