"""Searches for a delay and for records with a drift, by the residual of a fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from math import inf, sqrt

import numpy as np

from dehyst._types import Array
from dehyst.records import turning_points

# A repair must lower the residual to the first part (to the second at the turns of loops of one height), and by the
# third part of the stroke. The fourth is the least delay in samples. Loops have one height within the last part.
_GAIN, _AT_TURNS, _SMALLEST, _FOUND, _ONE_HEIGHT = 0.97, 0.5, 1e-5, 0.02, 0.9


def searched_delay(
    cost: Callable[[float], float], longest: float, sample_time: float, voltage: Array, stroke: float, points: int = 13
) -> float:
    """Return the delay [s] with the least cost, an RMS residual [m]; 0 unless the improvement is significant.

    `cost`: delay [s] -> [m]. `longest`, `sample_time`: largest delay looked for, and the time of a sample [s]; the
    answer is good to 1 % of a sample. `voltage` (n,): of the samples that count [V]: loops of one height have to
    explain more. `stroke`: [m]. `points`: delays of the first, even scan.
    """
    branches = np.abs(np.diff(voltage[turning_points(voltage, 0.02 * float(np.ptp(voltage)))]))
    one_height = branches.size < 2 or branches.min() > _ONE_HEIGHT * branches.max()
    share = _AT_TURNS if one_height else _GAIN
    cost = cache(cost)

    def worth(error: float) -> bool:
        return _worth(error, cost(0.0), stroke, share)

    best = _search(cost, 0.0, longest, points, 0.002 * sample_time, worth)
    return best if abs(best) > _FOUND * sample_time and worth(cost(best)) else 0.0


def worthwhile(cost: Callable[[tuple[int, ...]], float], candidates: Sequence[int], stroke: float) -> tuple[int, ...]:
    """Return the candidates that, one after another, reduce a cost, an RMS residual [m], enough."""
    kept: tuple[int, ...] = ()
    best = cost(kept)
    for q in candidates:
        trial = cost((*kept, q))
        if _worth(trial, best, stroke):
            kept, best = (*kept, q), trial
    return kept


def _worth(after: float, before: float, stroke: float, share: float = _GAIN) -> bool:
    """Return whether a repair lowers the RMS residual enough."""
    return after < share * before and before - after > _SMALLEST * stroke


def _search(
    cost: Callable[[float], float],
    low: float,
    high: float,
    points: int,
    tolerance: float,
    worth: Callable[[float], bool] = lambda error: True,
) -> float:
    """Scan `points` places, then search with Brent's method between the neighbours of the best.

    The search ends early if no place there can have a low enough cost.
    """
    from scipy.optimize import minimize_scalar

    grid = np.linspace(low, high, points)
    errors = [cost(float(x)) for x in grid]
    k = int(np.argmin(errors))
    near = slice(max(k - 1, 0), min(k + 1, points - 1) + 1)
    squares = {float(x): error**2 for x, error in zip(grid[near], errors[near], strict=True)}

    # A squared residual is nearly a parabola, for which Brent's method needs few steps.
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
    y = np.array([values[number] for number in x])
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
