"""Rate-independent elements: slip elements, the spring, the transformer, and smooth slip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._errors import ModelError
from dehyst._native import smooth_elongations
from dehyst._types import Array
from dehyst._validation import demand_curve, demand_divisors, demand_magnitudes, keep, matrix, vector
from dehyst._views.lines import brief


def segment_of(knots: Array, y: ArrayLike) -> NDArray[np.intp]:
    """Return the number of the segment between knots (M,) in which each y lies; end segments are unbounded."""
    return np.clip(np.searchsorted(knots, y, side="right") - 1, 0, knots.size - 2)


def parts_in_segments(knots: Array, y: Array) -> Array:
    """Return the part of y in each segment between knots, shape (n, M - 1); end segments are unbounded.

    A spring of slopes a_j between its knots holds ``eta(knots[0]) + sum_j a_j parts_j(y)``.
    """
    lower, upper = knots[:-1].copy(), knots[1:].copy()
    lower[0], upper[-1] = -np.inf, np.inf
    return np.asarray(np.clip(y[:, None], lower, upper) - knots[:-1])


def on_curve(knots: Array, values: Array, at: ArrayLike) -> Array:
    """Evaluate a piecewise-linear curve through knots and values (M,), continued linearly, at places of any shape."""
    x = np.asarray(at, dtype=np.float64)
    j = segment_of(knots, x)
    slopes = np.diff(values) / np.diff(knots)
    return np.asarray(values[j] + slopes[j] * (x - knots[j]))


def _elements(breakaway: ArrayLike, stiffness: Array) -> tuple[Array, Array]:
    """Return breakaway elongations (N,) [m] and stiffnesses (N, ...) [V/m] of slip elements after checking them."""
    rho = vector(breakaway, "breakaway elongations")
    if np.any(rho <= 0) or np.any(np.diff(rho) <= 0):
        raise ModelError(f"breakaway elongations must be positive and strictly increasing, got {rho}")
    if np.any(stiffness < 0):
        place = ", ".join(map(str, np.unravel_index(int(np.argmin(stiffness)), stiffness.shape)))
        raise ModelError(f"stiffness {place} is {stiffness.min():g} V/m; a negative one grows without bound")
    demand_magnitudes(stiffness, "stiffnesses")
    demand_magnitudes(rho, "breakaway elongations")
    return rho, stiffness


def _curve(x: ArrayLike, y: ArrayLike, what: str, names: tuple[str, str]) -> tuple[Array, Array]:
    """Return the points of a curve after checking that there are at least two and the knots strictly increase."""
    (first, second), (knots, values) = names, (vector(x, f"{what} {names[0]}"), vector(y, f"{what} {names[1]}"))
    if knots.size != values.size or knots.size < 2:
        sizes = f"{knots.size} {what} {first} and {values.size} {second}"
        raise ModelError(f"got {sizes}, need the same number, at least two")
    if np.any(np.diff(knots) <= 0):
        raise ModelError(f"{what} {first} must strictly increase, got {knots}")
    return knots, values


@dataclass(frozen=True, eq=False)
class MaxwellSlip:
    """N Maxwell-slip elements in parallel: springs in series with Coulomb friction (Eq. 1).

    Element i holds the voltage ``stiffness_i * s_i``; its elongation follows the displacement y as the stop operator
    ``s_i <- clip(s_i + dy, -breakaway_i, +breakaway_i)``.

    `breakaway` (N,): largest elongations rho_i = c r_i [m], positive and strictly increasing. `stiffness` (N,): kappa_i
    = k_i / (T c) [V/m], not negative. Raise `ModelError` if lengths differ, or a value is impossible.
    """

    breakaway: Array
    stiffness: Array

    __repr__ = brief

    def __init__(self, breakaway: ArrayLike, stiffness: ArrayLike) -> None:
        rho, kappa = _elements(breakaway, vector(stiffness, "stiffnesses"))
        if rho.size != kappa.size:
            raise ModelError(
                f"got {rho.size} breakaway elongations and {kappa.size} stiffnesses, need one of each for an element"
            )
        keep(self, breakaway=rho, stiffness=kappa)

    def __len__(self) -> int:
        return self.breakaway.size

    @property
    def friction(self) -> Array:
        """(N,) breakaway voltages kappa_i rho_i [V]: the friction forces f_i in terminal coordinates."""
        return self.stiffness * self.breakaway

    def stiffest(self) -> MaxwellSlip:
        """Return the elements themselves, which have one stiffness each; see `GradedSlip.stiffest`."""
        return self


@dataclass(frozen=True, eq=False)
class GradedSlip:
    """N Maxwell-slip elements whose stiffness depends on the position of their cart (theory section 8).

    Element i holds ``psi_i(y) - psi_i(b_i)``, with b_i the position of its cart, which is dragged along at the distance
    ``breakaway_i``; psi_i is piecewise linear on knots that all elements share, with unbounded end segments. With one
    segment this is `MaxwellSlip`.

    Parameters
    ----------
    breakaway : (N,) array_like
        Largest elongations rho_i [m], positive and strictly increasing.
    knots : (M + 1,) array_like
        [m], strictly increasing, M >= 1. The outer two have no effect: end segments are unbounded.
    stiffness : (N, M) array_like
        kappa_im [V/m], not negative: the slope of psi_i in each segment.

    Raises
    ------
    ModelError
        If shapes do not fit, or a value is impossible or too large to compute with (magnitude over 1e30).
    """

    breakaway: Array
    knots: Array
    stiffness: Array

    __repr__ = brief

    def __init__(self, breakaway: ArrayLike, knots: ArrayLike, stiffness: ArrayLike) -> None:
        ends = vector(knots, "grade knots")
        rho, kappa = _elements(breakaway, matrix(stiffness, "stiffnesses"))
        if ends.size < 2 or kappa.shape != (rho.size, ends.size - 1):
            raise ModelError(
                f"got stiffnesses of shape {kappa.shape} for {rho.size} breakaway elongations and {ends.size} grade "
                f"knots, need ({rho.size}, {max(ends.size, 2) - 1}): one row for an element, one column for a segment"
            )
        if np.any(np.diff(ends) <= 0):
            raise ModelError(f"grade knots must strictly increase, got {ends}")
        demand_magnitudes(ends, "grade knots")
        demand_divisors(np.diff(ends), "grade knots: steps")
        keep(self, breakaway=rho, knots=ends, stiffness=kappa)

    def __len__(self) -> int:
        return self.breakaway.size

    @property
    def friction(self) -> Array:
        """(N,) largest voltage [V] that each element can hold at any position."""
        bends = np.concatenate([self.knots[:, None] + np.zeros(len(self)), self.knots[:, None] + self.breakaway])
        return np.asarray((self.internal_voltage(bends) - self.internal_voltage(bends - self.breakaway)).max(axis=0))

    def stiffest(self) -> MaxwellSlip:
        """Return Maxwell-slip elements of the same `friction`: for a picture, not for a simulation."""
        return MaxwellSlip(self.breakaway, self.friction / self.breakaway)

    def internal_voltage(self, positions: ArrayLike) -> Array:
        """Return psi_i [V] at `positions` [m] of shape (..., N) or (..., 1), as shape (..., N); 0 at the first knot."""
        z = np.asarray(positions, dtype=np.float64)[..., None]
        lower, upper = np.append(-np.inf, self.knots[1:-1]), np.append(self.knots[1:-1], np.inf)
        return np.asarray(((np.clip(z, lower, upper) - self.knots[:-1]) * self.stiffness).sum(axis=-1))

    def slopes_at(self, positions: ArrayLike) -> Array:
        """Return kappa_i [V/m] at `positions` [m] of shape (..., N) or (..., 1), as shape (..., N)."""
        segment = np.searchsorted(self.knots[1:-1], np.asarray(positions), side="right")
        return np.asarray(self.stiffness[np.arange(len(self)), segment])


@dataclass(frozen=True, eq=False)
class Spring:
    """The parallel spring h in terminal coordinates: voltage eta(y), piecewise linear, continued linearly.

    `displacement` (M,): knots [m], strictly increasing, M >= 2. `voltage` (M,): eta at the knots [V], strictly
    increasing (Assumption I). Raise `ModelError` if lengths differ, a curve does not strictly increase, or a number is
    too large to compute with (over 1e30).
    """

    displacement: Array
    voltage: Array

    __repr__ = brief

    def __init__(self, displacement: ArrayLike, voltage: ArrayLike) -> None:
        y, v = _curve(displacement, voltage, "spring", ("knots", "voltages"))
        falls = np.flatnonzero(np.diff(v) <= 0)
        if falls.size:
            raise ModelError(
                f"the spring's voltage must strictly increase (Assumption I); it does not between knots {falls[0]} and "
                f"{falls[0] + 1}. Identify with a slope floor, or with fewer elements"
            )
        demand_curve(y, v, "spring")
        keep(self, displacement=y, voltage=v)

    @classmethod
    def of_slopes(cls, displacement: Array, slopes: Array, first: float) -> Spring:
        """Build a spring from the `slopes` of its segments (M - 1,) [V/m] and the voltage at its `first` knot [V].

        `displacement` (M,) [m] holds the knots.
        """
        return cls(displacement, first + np.concatenate([[0.0], np.cumsum(slopes * np.diff(displacement))]))

    @property
    def slopes(self) -> Array:
        """(M - 1,) slopes of the segments [V/m]."""
        return np.diff(self.voltage) / np.diff(self.displacement)

    def __call__(self, displacement: ArrayLike) -> Array:
        """Return the voltage [V] at displacements [m] of any shape."""
        return on_curve(self.displacement, self.voltage, displacement)


@dataclass(frozen=True, eq=False)
class Transformer:
    """A nonlinear transformer: tau(v) drives the elements instead of v (theory section 8).

    Piecewise linear, strictly increasing, continued linearly. This is a fitted map: with it, the charge q = T x no
    longer balances power.

    `voltage` (K,): knots [V], strictly increasing, K >= 2. `drive` (K,): tau at the knots [V], strictly increasing.
    Raise `ModelError` if lengths differ, a curve does not strictly increase, or a number is too large to compute with
    (over 1e30).
    """

    voltage: Array
    drive: Array

    __repr__ = brief

    def __init__(self, voltage: ArrayLike, drive: ArrayLike) -> None:
        v, tau = _curve(voltage, drive, "transformer", ("knots", "drives"))
        if np.any(np.diff(tau) <= 0):
            raise ModelError(f"transformer drives must strictly increase, got {tau}: each drive needs one voltage")
        demand_curve(v, tau, "transformer")
        keep(self, voltage=v, drive=tau)

    @property
    def slopes(self) -> Array:
        """(K - 1,) slopes of the segments [V/V]."""
        return np.diff(self.drive) / np.diff(self.voltage)

    def __call__(self, voltage: ArrayLike) -> Array:
        """Return the drive tau(v) [V] at voltages [V] of any shape."""
        return on_curve(self.voltage, self.drive, voltage)

    def inverse(self, drive: ArrayLike) -> Array:
        """Return the voltages [V] at which tau equals `drive`.

        `drive`: values of tau [V], of any shape.
        """
        return on_curve(self.drive, self.voltage, drive)


@dataclass(frozen=True, eq=False)
class SmoothSlip:
    """L elements in parallel whose friction grows gradually.

    Element l holds ``k_l q_l``; its elongation q follows the displacement y as
    ``dq = dy (1 - |q / length| (closing sgn(q dy) + 1 - closing))`` and tends to the length on a long motion. With
    closing 1 it is P. R. Dahl's element ("A solid friction model", Aerospace Corp. TOR-0158(3107-18)-1, 1968); with 1/2
    it returns on a straight line. Y.-K. Wen's model (J. Eng. Mech. Div. ASCE 102(2), 1976, 249-263) covers both. Unlike
    Maxwell-slip elements they do not return to the point at which an inner loop began.

    Parameters
    ----------
    length : (L,) array_like
        Largest elongations [m], positive.
    closing : (L,) array_like
        1/2 to 1.
    stiffness : (L,) array_like
        k_l [V/m] at elongation 0, not negative.

    Raises
    ------
    ModelError
        If lengths differ, or a value is impossible or too large to compute with (magnitude over 1e30).
    """

    length: Array
    closing: Array
    stiffness: Array

    __repr__ = brief

    def __init__(self, length: ArrayLike, closing: ArrayLike, stiffness: ArrayLike) -> None:
        given = {"length": length, "closing": closing, "stiffness": stiffness}
        columns = {name: vector(values, f"smooth elements: {name}") for name, values in given.items()}
        keep(self, **columns)
        if len({column.size for column in columns.values()}) > 1:
            sizes = ", ".join(f"{column.size} of {name}" for name, column in columns.items())
            raise ModelError(f"smooth elements: got {sizes}; need one of each for an element")
        if np.any(self.length <= 0) or np.any(self.stiffness < 0):
            raise ModelError("smooth elements: need lengths above 0 and stiffnesses of 0 or more")
        demand_divisors(self.length, "smooth elements: length [m]")
        demand_magnitudes(self.stiffness, "smooth elements: stiffness [V/m]")
        if np.any((self.closing < 0.5) | (self.closing > 1)):
            raise ModelError(f"smooth elements: closing must be 1/2 to 1, got {self.closing}")

    def __len__(self) -> int:
        return self.length.size

    def elongations(self, displacement: ArrayLike) -> Array:
        """Return q_l (n, L) [m] along a `displacement` (n,) [m], 0 at the first sample; exact for any steps."""
        return smooth_elongations(self.length, self.closing, vector(displacement, "displacement"))
