"""The Duhem model of Coleman and Hodgdon, with polynomials.

    y' = a |v'| (f(v) - y) + v' g(v)

B. D. Coleman, M. L. Hodgdon, Int. J. Engng Sci. 24(6), 1986, 897-919; for piezo actuators J. M. Cruz-Hernandez, V.
Hayward, IEEE Trans. Control Syst. Technol. 9(1), 2001, 17-26 (this model beside phasers). It is one of the semilinear
Duhem models of J. Oh, D. S. Bernstein, IEEE Trans. Autom. Control 50(5), 2005, 631-645.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import ArrayLike

from dehyst import IdentifyError, ModelError
from dehyst._types import Array
from dehyst._validation import count, fraction, keep, number, vector
from dehyst.records import Record
from dehyst.trust import AbstractBaseline
from dehyst_rivals import _rivals as compiled
from dehyst_rivals.training import Training, fit_with_delay

_SEARCH_ROWS = 3000
_RATES = np.geomspace(0.2, 40.0, 25)
_PLACES = np.linspace(0, 1, 61)
_HIGHEST_DEGREE = 12


@dataclass(frozen=True)
class DuhemState:
    """The memory: present voltage [V] and displacement [m]."""

    voltage: float
    displacement: float


@final
@dataclass(frozen=True, eq=False)
class Duhem(AbstractBaseline):
    """Coleman and Hodgdon's model with polynomials of t, 0 to 1 between the limits; exact while v is monotone.

    Each branch is a polynomial P that depends only on the direction, plus a decaying distance from it:
    ``y = P(t) + (y_0 - P(t_0)) exp(-rate |t - t_0|)``. Beyond the limits y continues with its mean slope, and the
    distance does not decay.

    `limits`: lowest and highest voltage [V]. `rate`: a times the range of the voltage, above 0. `anhysteretic`,
    `reversible` (k,): coefficients [m] of f, and of g times the range, the constant first. `state`: default start of a
    motion; if not given, at the lowest voltage, at the bottom of the major loop. Raise `ModelError` if y does not
    follow v, rising and falling, everywhere within the major loop.
    """

    limits: tuple[float, float]
    rate: float
    anhysteretic: Array
    reversible: Array
    state: DuhemState = None  # type: ignore[assignment]
    delay: float = 0.0

    def __post_init__(self) -> None:
        low, high = (number(end, "limits") for end in self.limits)
        keep(self, limits=(low, high))
        if low >= high or number(self.rate, "rate") <= 0:
            raise ModelError(f"limits {self.limits} and rate {self.rate}: need an interval, and a rate above 0")
        keep(self, **{name: vector(getattr(self, name), name) for name in ("anhysteretic", "reversible")})
        if _slopes(self.rate, self.anhysteretic, self.reversible).min() <= 0:
            raise ModelError(
                "anhysteretic and reversible: the displacement would fall somewhere while the voltage rises; need a "
                "reversible share above the rate times half of the loop's width"
            )
        if self.state is None:
            bottom = _major_loop(self.rate, *_branches(self.rate, self.anhysteretic, self.reversible))[0][0]
            keep(self, state=DuhemState(low, float(bottom)))

    @property
    def parameters(self) -> int:
        """Number of coefficients."""
        return 1 + self.anhysteretic.size + self.reversible.size

    @cached_property
    def _tables(self) -> tuple[Array, Array, Array]:
        """Numbers and both polynomials, for the stepper."""
        low, high = self.limits
        rise, fall = _branches(self.rate, self.anhysteretic, self.reversible)
        mean = float(np.ptp(_major_loop(self.rate, rise, fall)[0])) / (high - low)
        return np.array([low, high - low, self.rate, mean, mean]), rise, fall

    def _run(
        self, drive: Array, state: DuhemState, time: ArrayLike | None, *, inverse: bool
    ) -> tuple[Array, DuhemState]:
        # The inverse solves an increasing equation in v for each sample, by Newton's method within a bracket.
        numbers, rise, fall = self._tables
        out, v, y = compiled.coleman_hodgdon(numbers, rise, fall, state.voltage, state.displacement, drive, inverse)
        return out, DuhemState(v, y)

    @classmethod
    def fit(
        cls,
        records: Record | Sequence[Record],
        *,
        degree: int = 5,
        slope_floor: float = 0.1,
        delay: float | None = None,
    ) -> Duhem:
        """Fit by least squares of the simulated displacement: linear in f and g, nonlinear only in the rate.

        The rate is searched from 25 starts over two decades; f and g are constrained so that y follows v. Parameters
        are those of every model, see `training`, and `degree`: degree of f; g has one less. `slope_floor`
        applies to dy/dv within the major loop.
        """
        count(degree, "degree", most=_HIGHEST_DEGREE)
        fraction(slope_floor, "slope_floor")

        def fit_model(training: Training) -> tuple[Duhem, float]:
            rate = _search_rate(training.subsample(_SEARCH_ROWS), degree, slope_floor)
            f, g, residual = _solve(training, rate, degree, slope_floor)
            return cls(training.limits, rate, f, g, delay=training.delay), residual

        return fit_with_delay(records, delay, fit_model)


def _branches(rate: float, f: Array, g: Array) -> tuple[Array, Array]:
    """Return the limits of a rising and of a falling branch: a P + P' = a f + g and a P - P' = a f - g."""
    size = max(f.size, g.size)
    both = []
    for sign in (1.0, -1.0):
        p = np.zeros(size + 1)
        p[: f.size] += f
        p[: g.size] += sign * g / rate
        for k in range(size - 1, -1, -1):
            p[k] -= sign * (k + 1) * p[k + 1] / rate
        both.append(p[:size])
    return both[0], both[1]


def _major_loop(rate: float, rise: Array, fall: Array) -> tuple[Array, Array]:
    """Return the displacement of both branches of the closed loop at `_PLACES`; linear in the polynomials."""
    up, down = polyval(_PLACES, rise), polyval(_PLACES, fall)
    decay = np.exp(-rate)
    # Each turning point is the end of the branch that begins at the other turning point.
    over, under = up[-1] - decay * up[0], down[0] - decay * down[-1]
    bottom = (under + decay * over) / (1 - decay**2)
    top = over + decay * bottom
    return up + (bottom - up[0]) * np.exp(-rate * _PLACES), down + (top - down[-1]) * np.exp(-rate * (1 - _PLACES))


def _slopes(rate: float, f: Array, g: Array) -> Array:
    """Return the least slopes dy/dt within the major loop, just after a turn on the other branch; linear in f, g."""
    lower, upper = _major_loop(rate, *_branches(rate, f, g))
    middle, share = polyval(_PLACES, f), polyval(_PLACES, g)
    return np.concatenate([share + rate * (middle - upper), share - rate * (middle - lower)])


def _solve(training: Training, rate: float, degree: int, slope_floor: float) -> tuple[Array, Array, float]:
    """Return the coefficients of f and g for a rate, and the RMS residual in parts of the stroke."""
    low, high = training.limits
    numbers = np.array([low, high - low, rate, 0.0, 0.0])
    # The constant of f is the constant of the record.
    units = [np.split(unit, [degree + 1]) for unit in np.eye(2 * degree + 1)[1:]]

    def column(f: Array, g: Array) -> Array:
        rise, fall = _branches(rate, f, g)
        begin = float(_major_loop(rate, rise, fall)[0][0])
        return training.sampled(
            lambda piece: compiled.coleman_hodgdon(numbers, rise, fall, low, begin, piece.voltage, False)[0]
        )

    columns = np.column_stack([column(f, g) for f, g in units])
    slopes = np.column_stack([_slopes(rate, f, g) for f, g in units])
    m = training.nuisances.shape[1]
    sides = np.hstack([np.zeros((len(slopes), m)), slopes])
    target = training.displacement / training.stroke
    x, residual = _least_squares(np.hstack([training.nuisances, columns]), target, sides, slope_floor)
    x *= training.stroke
    return np.concatenate([[x[training.reference]], x[m : m + degree]]), x[m + degree :], residual


def _least_squares(columns: Array, target: Array, sides: Array, least: float) -> tuple[Array, float]:
    """Solve least squares with constraints sides @ x >= least as a least-distance problem (Lawson and Hanson)."""
    from scipy.linalg import solve_triangular
    from scipy.optimize import nnls

    q, triangle = np.linalg.qr(columns)
    optimum = q.T @ target
    constraints = solve_triangular(triangle, sides.T, trans="T").T
    violation = least - constraints @ optimum
    shift = np.zeros(optimum.size)
    if violation.max() > 0:
        size = np.linalg.norm(constraints, axis=1)
        system, goal = np.vstack([(constraints / size[:, None]).T, violation / size]), np.eye(optimum.size + 1)[-1]
        rest = system @ nnls(system, goal, maxiter=100 * len(sides))[0] - goal
        if -rest[-1] < 1e-12:
            raise IdentifyError("no Duhem model of this degree follows the voltage everywhere; try another degree")
        shift = rest[:-1] / -rest[-1]
    x = solve_triangular(triangle, optimum + shift)
    return x, float(np.sqrt(np.mean((columns @ x - target) ** 2)))


def _search_rate(training: Training, degree: int, slope_floor: float) -> float:
    """Return the rate with the least residual, by a scan, and then by Brent's method around its best place."""
    from scipy.optimize import minimize_scalar

    def cost(log_rate: float) -> float:
        return _solve(training, float(np.exp(log_rate)), degree, slope_floor)[2]

    scan = np.log(_RATES)
    k = int(np.argmin([cost(float(x)) for x in scan]))
    bounds = scan[max(k - 1, 0)], scan[min(k + 1, scan.size - 1)]
    minimum = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 1e-6})
    return float(np.exp(minimum.x))
