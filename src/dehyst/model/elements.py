"""Rate-independent elements: slip elements, the spring, the transformer, and smooth slip."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._errors import ModelError
from dehyst._native import smooth_elongations
from dehyst._types import Array
from dehyst._validation import keep, vector
from dehyst.model.entries import Entries, Numbers, entry

if TYPE_CHECKING:
    from dehyst.model.entries import Numeric


# Breakaway elongations of slip elements [m], and their stiffnesses [V/m] by the number of dimensions.
_BREAKAWAY = Numbers(1, positive=True, rising=True)
_STIFFNESS = [Numbers(dimensions, least=0.0, plausible=1e20) for dimensions in (0, 1, 2)]
_KNOTS = Numbers(1, rising=True, divides=True)


def segment_of(knots: Array, y: ArrayLike) -> NDArray[np.intp]:
    """Return the number of the segment between knots (M,) in which each y lies; end segments are unbounded."""
    return np.clip(np.searchsorted(knots, y, side="right") - 1, 0, knots.size - 2)


def parts_in_segments(knots: Array, y: ArrayLike) -> Array:
    """Return the part of y (...) in each segment between knots, shape (..., M - 1); end segments are unbounded.

    A spring of slopes a_j between its knots holds ``eta(knots[0]) + sum_j a_j parts_j(y)``.
    """
    lower, upper = np.append(-np.inf, knots[1:-1]), np.append(knots[1:-1], np.inf)
    return np.asarray(np.clip(np.asarray(y, dtype=np.float64)[..., None], lower, upper) - knots[:-1])


def on_curve(knots: Array, values: Array, at: ArrayLike) -> Array:
    """Evaluate a piecewise-linear curve through knots and values (M,), continued linearly, at places of any shape."""
    x = np.asarray(at, dtype=np.float64)
    j = segment_of(knots, x)
    slopes = np.diff(values) / np.diff(knots)
    return np.asarray(values[j] + slopes[j] * (x - knots[j]))


@dataclass(frozen=True, eq=False, repr=False)
class MaxwellSlip(Entries):
    """N Maxwell-slip elements in parallel: springs in series with Coulomb friction (Eq. 1).

    Element i holds the voltage ``stiffness_i * s_i``; its elongation follows the displacement y as the stop operator
    ``s_i <- clip(s_i + dy, -breakaway_i, +breakaway_i)``.

    `breakaway` (N,): largest elongations rho_i = c r_i [m], positive and strictly increasing. `stiffness` (N,): kappa_i
    = k_i / (T c) [V/m], not negative. Raise `ModelError` if lengths differ, or a value is impossible.
    """

    _part = "slip"
    breakaway: Numeric = entry("breakaway_m", _BREAKAWAY)
    stiffness: Numeric = entry("stiffness_V_per_m", _STIFFNESS[1])

    _demand_together = Entries._demand_one_size

    def __len__(self) -> int:
        return self.breakaway.size

    @property
    def friction(self) -> Array:
        """(N,) breakaway voltages kappa_i rho_i [V]: the friction forces f_i in terminal coordinates."""
        return self.stiffness * self.breakaway


@dataclass(frozen=True, eq=False, repr=False)
class GradedSlip(Entries):
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

    _part = "slip"
    breakaway: Numeric = entry("breakaway_m", _BREAKAWAY)
    knots: Numeric = entry("knots_m", _KNOTS)
    stiffness: Numeric = entry("stiffness_V_per_m", _STIFFNESS[2])

    def _demand_together(self) -> None:
        """Raise `ModelError` unless the stiffnesses have a row for each element and a column for each segment."""
        elements, segments = len(self), self.knots.size - 1
        if not elements:
            keep(self, stiffness=np.zeros((0, max(segments, 0))))
        if segments < 1 or self.stiffness.shape != (elements, segments):
            raise ModelError(
                argument="slip stiffness",
                got=f"the shape {self.stiffness.shape} for {elements} breakaway elongations and {segments + 1} knots",
                need=f"({elements}, {max(segments, 1)}): a row for each element, a column for each segment",
            )

    def __len__(self) -> int:
        return self.breakaway.size

    @property
    def friction(self) -> Array:
        """(N,) largest voltage [V] that each element can hold at any position."""
        bends = np.concatenate([self.knots[:, None] + np.zeros(len(self)), self.knots[:, None] + self.breakaway])
        return np.asarray((self.internal_voltage(bends) - self.internal_voltage(bends - self.breakaway)).max(axis=0))

    def internal_voltage(self, positions: ArrayLike) -> Array:
        """Return psi_i [V] at `positions` [m] of shape (..., N) or (..., 1), as shape (..., N); 0 at the first knot."""
        return np.asarray((parts_in_segments(self.knots, positions) * self.stiffness).sum(axis=-1))

    def slopes_at(self, positions: ArrayLike) -> Array:
        """Return kappa_i [V/m] at `positions` [m] of shape (..., N) or (..., 1), as shape (..., N)."""
        return np.asarray(self.stiffness[np.arange(len(self)), segment_of(self.knots, positions)])


class Curve(Entries):
    """A rising curve, the second entry over the first: piecewise linear through knots, and continued linearly."""

    def _demand_together(self) -> None:
        """Raise `ModelError` unless there are at least two knots, each with one value."""
        self._demand_one_size()
        if self._points[0].size < 2:
            raise ModelError(argument=self._part, got=f"{self._points[0].size} knots", need="at least two")

    @property
    def _points(self) -> tuple[Array, Array]:
        x, y = (getattr(self, entry.name) for entry in fields(self))  # type: ignore[arg-type]
        return x, y

    @property
    def slopes(self) -> Array:
        """(M - 1,) slopes of the segments: of a spring [V/m], of a transformer [V/V]."""
        x, y = self._points
        return np.asarray(np.diff(y) / np.diff(x))

    def __call__(self, at: ArrayLike) -> Array:
        """Return the voltage [V] of a spring at displacements [m], or the drive [V] at voltages [V], of any shape."""
        return on_curve(*self._points, at)


@dataclass(frozen=True, eq=False, repr=False)
class Spring(Curve):
    """The parallel spring h in terminal coordinates: voltage eta(y), piecewise linear, continued linearly.

    `displacement` (M,): knots [m], strictly increasing, M >= 2. `voltage` (M,): eta at the knots [V], strictly
    increasing (Assumption I). Raise `ModelError` if lengths differ, a curve does not strictly increase, or a number is
    too large to compute with (over 1e30).
    """

    _part = "spring"
    displacement: Numeric = entry("displacement_m", _KNOTS)
    voltage: Numeric = entry("voltage_V", replace(_KNOTS, hint="identify with a slope floor, or with fewer elements"))

    @classmethod
    def of_slopes(cls, displacement: Array, slopes: Array, first: float) -> Spring:
        """Build a spring from the `slopes` of its segments (M - 1,) [V/m] and the voltage at its `first` knot [V].

        `displacement` (M,) [m] holds the knots.
        """
        return cls(displacement, first + np.concatenate([[0.0], np.cumsum(slopes * np.diff(displacement))]))


@dataclass(frozen=True, eq=False, repr=False)
class Transformer(Curve):
    """A nonlinear transformer: tau(v) drives the elements instead of v (theory section 8).

    Piecewise linear, strictly increasing, continued linearly. This is a fitted map: with it, the charge q = T x no
    longer balances power.

    `voltage` (K,): knots [V], strictly increasing, K >= 2. `drive` (K,): tau at the knots [V], strictly increasing.
    Raise `ModelError` if lengths differ, a curve does not strictly increase, or a number is too large to compute with
    (over 1e30).
    """

    _part = "transformer"
    voltage: Numeric = entry("voltage_V", _KNOTS)
    drive: Numeric = entry("drive_V", replace(_KNOTS, hint="each drive needs one voltage"))

    def inverse(self, drive: ArrayLike) -> Array:
        """Return the voltages [V] at which tau equals `drive`.

        `drive`: values of tau [V], of any shape.
        """
        return on_curve(self.drive, self.voltage, drive)


@dataclass(frozen=True, eq=False, repr=False)
class SmoothSlip(Entries):
    """L elements in parallel whose friction grows gradually.

    Element l holds ``k_l q_l``; its elongation q follows the displacement y as
    ``dq = dy (1 - |q / length| (closing sgn(q dy) + 1 - closing))`` and tends to the length on a long motion. With
    closing 1 it is P. R. Dahl's element ("A solid friction model", Aerospace Corp. TOR-0158(3107-18)-1, 1968); with 1/2
    it returns on a straight line. Y.-K. Wen's model (J. Eng. Mech. Div. ASCE 102(2), 1976, 249-263) covers both. Unlike
    Maxwell-slip elements, these elements do not return to the point at which an inner loop began.

    Parameters
    ----------
    length : (L,) array_like
        Largest elongations [m], positive.
    closing : (L,) array_like
        Shape of the loop, 1/2 to 1.
    stiffness : (L,) array_like
        k_l [V/m] at elongation 0, not negative.

    Raises
    ------
    ModelError
        If lengths differ, or a value is impossible or too large to compute with (magnitude over 1e30).
    """

    _part = "smooth"
    length: Numeric = entry("length_m", Numbers(1, positive=True, divides=True))
    closing: Numeric = entry("closing", Numbers(1, least=0.5, most=1.0))
    stiffness: Numeric = entry("stiffness_V_per_m", _STIFFNESS[1])

    _demand_together = Entries._demand_one_size

    def __len__(self) -> int:
        return self.length.size

    def elongations(self, displacement: ArrayLike) -> Array:
        """Return q_l (n, L) [m] along a `displacement` (n,) [m], 0 at the first sample; exact for any steps."""
        return smooth_elongations(self.length, self.closing, vector(displacement, "displacement"))
