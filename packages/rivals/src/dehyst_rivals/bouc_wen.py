"""The model of Bouc and Wen, followed by a cubic map.

    h' = alpha v' - beta |v'| h - gamma v' |h|,     w = v - h,     y = p(w)

Y.-K. Wen, J. Eng. Mech. Div. ASCE 102(2), 1976, 249-263; for piezo actuators, with a linear p, T. S. Low, W. Guo, J.
Microelectromech. Syst. 4(4), 1995, 230-237. Its loop is symmetric; the cubic map replaces the asymmetric extensions of
the literature. Its minor loops drift, because the model has no wiping out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from dehyst import ModelError
from dehyst._types import Array
from dehyst._validation import count, fraction, keep, number, vector
from dehyst.records import Record, rms
from dehyst.trust import AbstractBaseline
from dehyst_rivals import _rivals as compiled
from dehyst_rivals.least_squares import Solution, solve
from dehyst_rivals.training import Training, fit_with_delay

_SEARCH_ROWS = 2000
# Bounds of alpha, of the part of v that a reversal first hides, and of log((beta + gamma) times the range of v).
_LEAST, _MOST = np.array([0.02, 0.02, np.log(0.3)]), np.array([0.98, 0.98, np.log(60.0)])
_POLISHED = 6
_MAJOR_LOOPS = 8
_SIMULATE, _COMPENSATE, _LAG = 0, 1, 2


@dataclass(frozen=True)
class BoucWenState:
    """The memory: present voltage v [V] and hysteretic variable h [V]."""

    voltage: float
    hidden: float


@final
@dataclass(frozen=True, eq=False)
class BoucWen(AbstractBaseline):
    """Bouc and Wen's model; exact while the voltage is monotone.

    ``y = c_0 + c_1 t + c_2 t^2 + c_3 t^3`` with t from 0 to 1 between the limits of w, and linear beyond.

    `alpha`: above 0 and below 1. `beta`, `gamma` [1/V]: beta > 0, beta + gamma > 0 and 2 alpha beta < beta + gamma;
    then w and y increase with v. `limits`: lowest and highest w [V] of the cubic map. `cubic` (4,): c [m]; it increases
    from 0 to 1. `state`: default start of a motion; if not given, at the lower limit after a long fall. Raise
    `ModelError` if the displacement would fall somewhere while the voltage rises.
    """

    alpha: float
    beta: float
    gamma: float
    limits: tuple[float, float]
    cubic: Array
    state: BoucWenState = None  # type: ignore[assignment]
    delay: float = 0.0
    # Three coefficients of the equation, four of the map.
    parameters = 7

    def __post_init__(self) -> None:
        for name in ("alpha", "beta", "gamma", "delay"):
            number(getattr(self, name), name)
        total = self.beta + self.gamma
        if not (0 < self.alpha < 1 and self.beta > 0 and total > 0 and 2 * self.alpha * self.beta < total):
            raise ModelError(
                f"alpha {self.alpha:g}, beta {self.beta:g}, gamma {self.gamma:g}: need 0 < alpha < 1, beta > 0 and "
                "beta + gamma > 2 alpha beta; otherwise the displacement would fall while the voltage rises"
            )
        low, high = (number(end, "limits") for end in self.limits)
        cubic = vector(self.cubic, "cubic")
        keep(self, limits=(low, high), cubic=cubic)
        if low >= high or cubic.size != 4:
            raise ModelError(f"limits {self.limits} and cubic of {cubic.size}: need an interval and four coefficients")
        t = np.linspace(0, 1, 201)
        if np.any(np.polynomial.polynomial.polyval(t, cubic[1:] * [1, 2, 3]) <= 0):
            raise ModelError(
                f"cubic: got {cubic}, which does not increase from 0 to 1; need four coefficients of an increasing map"
            )
        if self.state is None:
            hidden = -self.alpha / total
            keep(self, state=BoucWenState(low + hidden, hidden))

    def _run(
        self, drive: Array, state: BoucWenState, time: ArrayLike | None, *, inverse: bool
    ) -> tuple[Array, BoucWenState]:
        # The inverse solves an increasing equation in v for each sample, by Newton's method within a bracket.
        most = self.alpha / (self.beta + self.gamma) * (1 + 1e-9)
        if not abs(state.hidden) <= most:
            raise ModelError(f"state: got {state!r}, need a BoucWenState whose hidden part is at most {most:g} V")
        low, high = self.limits
        numbers = np.array([self.alpha, self.beta, self.gamma, low, high - low, *self.cubic])
        out, v, h = compiled.bouc_wen(
            numbers, state.voltage, state.hidden, drive, _COMPENSATE if inverse else _SIMULATE
        )
        return out, BoucWenState(v, h)

    @classmethod
    def fit(
        cls,
        records: Record | Sequence[Record],
        *,
        starts: int = 200,
        slope_floor: float = 0.1,
        delay: float | None = None,
        seed: int = 0,
    ) -> BoucWen:
        """Fit by least squares of the simulated displacement, nonlinear in alpha, beta and gamma, from many starts.

        For given alpha, beta and gamma, the map and the constants of the records are linear parameters and are
        eliminated. Parameters are those of every model, see `training`, and `starts`: number of random
        starts, drawn from `seed`, of which the best six are polished. `slope_floor` applies to the map.
        """
        count(starts, "starts", most=None)
        fraction(slope_floor, "slope_floor")
        begins = np.random.default_rng(seed).uniform(_LEAST, _MOST, (starts, 3))

        def fit_model(training: Training) -> tuple[BoucWen, float]:
            best = _BoucWenFit(training.subsample(_SEARCH_ROWS), slope_floor).polished(begins)
            problem = _BoucWenFit(training, slope_floor)
            model = cls(*problem.equation(best), *problem.map(best), delay=training.delay)
            return model, rms(problem.residual(best))

        return fit_with_delay(records, delay, fit_model)


@dataclass(frozen=True, eq=False)
class _BoucWenFit:
    """The least squares in alpha, the part hidden at first and log((beta + gamma) range)."""

    training: Training
    slope_floor: float

    @property
    def floor(self) -> float:
        """Least slope of the map, dy/dt [m]."""
        return self.slope_floor * self.training.stroke

    def equation(self, at: Array) -> tuple[float, float, float]:
        """Return alpha, beta and gamma for the three unknowns."""
        alpha, hidden, log_rate = (float(x) for x in at)
        low, high = self.training.limits
        total = float(np.exp(log_rate)) / (high - low)
        beta = hidden * total / (2 * alpha)
        return alpha, beta, total - beta

    def solve(self, at: Array) -> tuple[Solution, tuple[float, float]]:
        """Return the map in Bernstein's form minus its least slopes, with the constants; and the limits of w."""
        alpha, beta, gamma = self.equation(at)
        numbers = np.array([alpha, beta, gamma, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0])
        low, high = self.training.limits
        # The state before a record is not known: take the state of the closed major loop.
        past = np.array([high, low] * _MAJOR_LOOPS)

        def lag(piece: Record) -> Array:
            path = np.concatenate([past, piece.voltage])
            return compiled.bouc_wen(numbers, low, -alpha / (beta + gamma), path, _LAG)[0][past.size :]

        w = self.training.sampled(lag)
        low, high = float(w.min()), float(w.max())
        t = (w - low) / (high - low)
        # Integrals of Bernstein polynomials of degree 2: if their coefficients are positive, the slope is positive.
        columns = np.column_stack([1 - (1 - t) ** 3, t * t * (3 - 2 * t), t**3]) / 3
        target = self.training.displacement - columns @ np.full(3, self.floor)
        return solve(self.training.nuisances, columns, target), (low, high)

    def residual(self, at: Array) -> Array:
        """Return the residuals (n,) in parts of the stroke."""
        return self.solve(at)[0].residual / self.training.stroke

    def polished(self, starts: Array) -> Array:
        """Return the best result of searches from the most promising starts."""
        from scipy.optimize import least_squares

        costs = [float(np.sum(self.residual(start) ** 2)) for start in starts]
        ends = [
            least_squares(self.residual, starts[k], bounds=(_LEAST - 1e-9, _MOST + 1e-9), x_scale=[0.1, 0.1, 0.3])
            for k in np.argsort(costs)[:_POLISHED]
        ]
        return np.asarray(min(ends, key=lambda end: float(end.cost)).x)

    def map(self, at: Array) -> tuple[tuple[float, float], Array]:
        """Return the limits and coefficients of the cubic."""
        solution, limits = self.solve(at)
        a, b, c = solution.nonnegative + self.floor
        constant = float(solution.free[self.training.reference])
        return limits, np.array([constant, a, b - a, (a - 2 * b + c) / 3])
