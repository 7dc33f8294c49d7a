"""The parts an actuator is made of: frozen, validated, in seconds, volts and metres of displacement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._native import Array, vector


def frozen(array: Array) -> Array:
    """Return a read-only copy."""
    copy = array.copy()
    copy.flags.writeable = False
    return copy


def parts_in_segments(knots: Array, y: Array) -> Array:
    """The part of y that lies in each segment between knots, the end segments being unbounded, shape (n, M - 1).

    A spring of slopes a_j between its knots holds ``eta(knots[0]) + sum_j a_j parts_j(y)``.
    """
    lower, upper = knots[:-1].copy(), knots[1:].copy()
    lower[0], upper[-1] = -np.inf, np.inf
    return np.asarray(np.clip(y[:, None], lower, upper) - knots[:-1])


@dataclass(frozen=True, eq=False)
class MaxwellSlip:
    """N Maxwell-slip elements in parallel: springs in series with Coulomb friction (Eq. 1).

    Element i holds the voltage ``stiffness_i * s_i``; its elongation follows the displacement y as the stop operator
    ``s_i <- clip(s_i + dy, -breakaway_i, +breakaway_i)``.

    Parameters
    ----------
    breakaway : (N,) array_like
        Largest elongations rho_i = c r_i [m], positive and strictly increasing.
    stiffness : (N,) array_like
        kappa_i = k_i / (T c) [V/m], not negative.

    Raises
    ------
    ModelError
        If lengths differ, or a value is impossible.
    """

    breakaway: Array
    stiffness: Array

    def __init__(self, breakaway: ArrayLike, stiffness: ArrayLike) -> None:
        rho, kappa = vector(breakaway, "breakaway elongations"), vector(stiffness, "stiffnesses")
        if rho.size != kappa.size:
            raise ModelError(
                f"got {rho.size} breakaway elongations and {kappa.size} stiffnesses, need one of each an element"
            )
        if np.any(rho <= 0) or np.any(np.diff(rho) <= 0):
            raise ModelError(f"breakaway elongations must be positive and strictly increasing, got {rho}")
        if np.any(kappa < 0):
            raise ModelError(
                f"stiffness {int(np.argmin(kappa))} is {kappa.min():g} V/m; a negative one never lets go (footnote 3)"
            )
        object.__setattr__(self, "breakaway", frozen(rho))
        object.__setattr__(self, "stiffness", frozen(kappa))

    def __len__(self) -> int:
        return self.breakaway.size

    @property
    def friction(self) -> Array:
        """(N,) breakaway voltages kappa_i rho_i [V]: f_i seen at the terminals."""
        return self.stiffness * self.breakaway


@dataclass(frozen=True, eq=False)
class Spring:
    """The parallel spring h seen at the terminals: voltage eta(y), piecewise linear, continued linearly.

    Parameters
    ----------
    displacement : (M,) array_like
        Knots [m], strictly increasing, M >= 2.
    voltage : (M,) array_like
        eta at the knots [V], strictly increasing (Assumption I).

    Raises
    ------
    ModelError
        If lengths differ or a curve does not strictly increase.
    """

    displacement: Array
    voltage: Array

    def __init__(self, displacement: ArrayLike, voltage: ArrayLike) -> None:
        y, v = vector(displacement, "spring knots"), vector(voltage, "spring voltages")
        if y.size != v.size or y.size < 2:
            raise ModelError(f"got {y.size} spring knots and {v.size} voltages, need the same number and two at least")
        if np.any(np.diff(y) <= 0):
            raise ModelError(f"spring knots must strictly increase, got {y}")
        falls = np.flatnonzero(np.diff(v) <= 0)
        if falls.size:
            raise ModelError(
                f"the spring's voltage must strictly increase (Assumption I); it does not between knots {falls[0]} and "
                f"{falls[0] + 1}. Identify with a slope floor, or with fewer elements"
            )
        object.__setattr__(self, "displacement", frozen(y))
        object.__setattr__(self, "voltage", frozen(v))

    @classmethod
    def of_slopes(cls, displacement: Array, slopes: Array, first: float) -> Spring:
        """Build a spring from the slopes of its segments (M - 1,) [V/m] and the voltage at its first knot [V]."""
        return cls(displacement, first + np.concatenate([[0.0], np.cumsum(slopes * np.diff(displacement))]))

    @property
    def slopes(self) -> Array:
        """(M - 1,) slopes of the segments [V/m]."""
        return np.diff(self.voltage) / np.diff(self.displacement)

    def __call__(self, displacement: ArrayLike) -> Array:
        """Voltage [V] at displacements [m] of any shape."""
        y = np.asarray(displacement, dtype=np.float64)
        j = np.clip(np.searchsorted(self.displacement, y, side="right") - 1, 0, self.slopes.size - 1)
        return np.asarray(self.voltage[j] + self.slopes[j] * (y - self.displacement[j]))
