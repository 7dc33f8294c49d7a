"""Least squares given by sums over rows, solved from the active set of a program nearby.

    minimise 1/2 x'Gx - c'x,   G = A'A,  c = A'b,   x[free:] >= 0,   C x >= l

Cross-validation solves many programs that differ by a few rows: their sums are differences of sums, and their active
sets differ by a few coefficients. Coefficients and inequalities are exchanged all at once, and one at a time where
that does not end (block principal pivoting; Portugal, Judice and Vicente 1994, Math. Comput. 63, 625).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array, Mask
from dehyst.identification.solvers.problem import TINY
from dehyst.identification.solvers.quadratic import Quadratic
from dehyst.identification.solvers.quadratic_interior_point import interior_point

# Coefficients and multipliers may be negative by so much of the largest one, or of the largest gradient.
_ZERO, _FLAT = 1e-9, 1e-8
# Exchanges of all limits that make nothing better before one at a time, and exchanges in all.
_PATIENCE, _EXCHANGES = 5, 80
# The diagonal of G being one: keeps factors of dependent columns finite.
_RIDGE, _RIDGE_OF_LIMITS, _REFINEMENTS = 1e-13, 1e-12, 3
_CLOSE = 1e-11
# Of columns that depend on one another: changes predictions by less than any noise.
_INDEPENDENT = 1e-8


@dataclass(frozen=True, eq=False)
class ActiveSet:
    """Coefficients that are not at a bound (q,), and inequalities that are met with equality (m,)."""

    moving: Mask
    active: Mask

    def of_limits(self, count: int) -> ActiveSet:
        """Return the same among `count` inequalities, the new ones not active."""
        return ActiveSet(self.moving, np.append(self.active[:count], np.zeros(max(count - self.active.size, 0), bool)))


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """G (q, q), c (q,), and the number of free coefficients, which come first."""

    gram: Array
    image: Array
    free: int

    def __add__(self, other: NormalEquations) -> NormalEquations:
        return NormalEquations(self.gram + other.gram, self.image + other.image, self.free)

    def __sub__(self, other: NormalEquations) -> NormalEquations:
        return NormalEquations(self.gram - other.gram, self.image - other.image, self.free)

    @classmethod
    def of_rows(cls, rows: Array, goal: Array, free: int) -> NormalEquations:
        """Return the sums of rows (n, q) with targets (n,)."""
        return cls(rows.T @ rows, rows.T @ goal, free)

    def minimum(self, inequalities: tuple[Array, Array], start: ActiveSet | None = None) -> tuple[Array, ActiveSet]:
        """Return the coefficients (q,), zero for columns without rows, and their active set.

        Parameters
        ----------
        inequalities : (m, q) and (m,) array
            C and l; met to 1e-9 of the largest term, columns being scaled to one length.
        start : ActiveSet, optional
            Of a program nearby; by default no coefficient is at its bound.
        """
        diagonal = np.sqrt(np.maximum(np.diag(self.gram), 0.0))
        kept = np.flatnonzero(diagonal > 1e-12 * diagonal.max(initial=TINY))
        scale = diagonal[kept]
        unit = float(np.linalg.norm(self.image[kept] / scale)) or 1.0
        # An inequality of a free coefficient without rows has nothing to hold.
        lost = np.setdiff1d(np.arange(self.free), kept)
        holding = ~np.any(inequalities[0][:, lost] != 0, axis=1)
        matrix, lower = inequalities[0][:, kept] / scale * unit * holding[:, None], inequalities[1] * holding
        size = np.abs(matrix).max(axis=1, initial=0.0)
        size[size == 0] = 1.0
        scaled = _UnitProgram(
            self.gram[np.ix_(kept, kept)] / np.outer(scale, scale),
            self.image[kept] / scale / unit,
            int(np.count_nonzero(kept < self.free)),
            matrix / size[:, None],
            lower / size,
        )
        near = np.ones(kept.size, dtype=bool) if start is None else start.moving[kept]
        met = np.zeros(lower.size, dtype=bool) if start is None else start.of_limits(lower.size).active
        x, moving, active = scaled.exchanged(near, met) or scaled.ridged().exchanged(near, met) or scaled.from_inside()
        return _spread(x / scale * unit, kept, diagonal.size), ActiveSet(_spread(moving, kept, diagonal.size), active)


def _spread(values: NDArray[Any], places: NDArray[np.intp], size: int) -> NDArray[Any]:
    whole = np.zeros(size, dtype=values.dtype)
    whole[places] = values
    return whole


@dataclass(frozen=True, eq=False)
class _UnitProgram:
    """The program with a unit diagonal of G and an image of unit length."""

    gram: Array
    image: Array
    free: int
    matrix: Array
    lower: Array

    def ridged(self) -> _UnitProgram:
        """Return a program nearby whose columns are independent: exchanges end where they may go round otherwise."""
        return replace(self, gram=self.gram + _INDEPENDENT * np.eye(len(self.gram)))

    def from_inside(self) -> tuple[Array, Mask, Mask]:
        """Return the minimum, its moving coefficients and active inequalities, by an interior point first."""
        x, bound, multipliers = interior_point(self.gram, self.image, self.free, (self.matrix, self.lower), _CLOSE)
        moving, active = x > bound, self.matrix @ x - self.lower < multipliers
        solution = self.exchanged(moving, active)
        if solution is not None:
            return solution
        # Orthogonal factors of each face: slower, and right where limits nearly depend on one another.
        values, vectors = np.linalg.eigh(self.gram)
        root = np.sqrt(np.maximum(values, _RIDGE))
        basis, triangle = np.linalg.qr(root[:, None] * vectors.T)
        minimum = Quadratic(
            triangle, basis.T @ (vectors.T @ self.image / root), self.free, self.matrix, self.lower
        ).minimum()
        return minimum.x, minimum.moving, minimum.active

    def exchanged(self, moving: Mask, active: Mask) -> tuple[Array, Mask, Mask] | None:
        """Exchange limits until none is violated; None if that does not end."""
        moving, active = moving.copy(), active.copy()
        moving[: self.free] = True
        least, patience = moving.size + active.size + 1, _PATIENCE
        for _ in range(_EXCHANGES):
            solution = self._on_face(moving, active)
            if solution is None:
                return None
            x, wrong, unmet = self._violations(*solution, moving, active)
            count = int(np.count_nonzero(wrong) + np.count_nonzero(unmet))
            if not count:
                # Limits that contradict one another, or have no column that moves, cannot all be met.
                missed = np.abs(self.matrix[active] @ x - self.lower[active]).max(initial=0.0)
                if not missed <= _ZERO * max(np.abs(x).max(initial=0.0), 1.0):
                    return None
                x[self.free :] = np.maximum(x[self.free :], 0.0)
                return x, moving, active
            least, patience = (count, _PATIENCE) if count < least else (least, patience - 1)
            if patience < 0:
                wrong, unmet = _last_alone(wrong, unmet)
            moving, active = moving ^ wrong, active ^ unmet
        return None

    def _violations(self, x: Array, multipliers: Array, moving: Mask, active: Mask) -> tuple[Array, Mask, Mask]:
        """Return x, and the coefficients and inequalities that are on the wrong side of their limits."""
        pull = self.gram @ x - self.image - self.matrix.T @ multipliers
        size, steep = np.abs(x).max(initial=TINY), np.abs(self.image).max(initial=TINY)
        wrong = np.where(moving, x < -_ZERO * size, pull < -_FLAT * steep)
        wrong[: self.free] = False
        left = self.matrix @ x - self.lower
        unmet = np.where(active, multipliers < -_FLAT * steep, left < -_ZERO * size)
        return x, wrong, unmet

    def _on_face(self, moving: Mask, active: Mask) -> tuple[Array, Array] | None:
        """Return x and multipliers with these limits as equations; None if they have no solution."""
        from scipy.linalg.lapack import dpotrf, dpotrs

        columns, limits = np.flatnonzero(moving), np.flatnonzero(active)
        x, multipliers = np.zeros(moving.size), np.zeros(active.size)
        if not columns.size:
            return None if limits.size else (x, multipliers)
        part = np.asfortranarray(self.gram[np.ix_(columns, columns)])
        part[np.diag_indices(columns.size)] += _RIDGE
        factor, failure = dpotrf(part, lower=1, overwrite_a=1, clean=0)
        if failure:
            return None
        some = dpotrs(factor, self.image[columns], lower=1)[0]
        if limits.size:
            equations = self.matrix[np.ix_(limits, columns)]
            response = dpotrs(factor, np.asfortranarray(equations.T), lower=1)[0]
            normal = equations @ response
            if not np.all(np.isfinite(normal)):
                return None
            normal[np.diag_indices(limits.size)] += _RIDGE_OF_LIMITS * max(np.trace(normal) / limits.size, TINY)
            factor, failure = dpotrf(np.asfortranarray(normal), lower=1, overwrite_a=1, clean=0)
            if failure:
                return None
            # The ridge leaves a little of the limits unmet: again for what is left, as an augmented Lagrangian does.
            for _ in range(_REFINEMENTS):
                force = dpotrs(factor, self.lower[limits] - equations @ some, lower=1)[0]
                if not np.all(np.isfinite(force)):
                    return None
                multipliers[limits] += force
                some = some + response @ force
        x[columns] = some
        return x, multipliers


def _last_alone(wrong: Mask, unmet: Mask) -> tuple[Mask, Mask]:
    """Return the last of both alone (Murty's rule, which ends)."""
    both = np.concatenate([wrong, unmet])
    alone = np.zeros(both.size, dtype=bool)
    alone[np.flatnonzero(both)[-1]] = True
    return alone[: wrong.size], alone[wrong.size :]
