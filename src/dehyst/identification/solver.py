"""Least squares with coefficients that may not be negative, and linear inequalities among them.

    minimise || W (F a + P x - b) ||_2,   a free,   x >= 0,   C x >= l

A program is solved from the sums G = A'A and c = A'b; the sums of left-out rows are subtracted. A guess says which
coefficients are positive and which inequalities hold with equality. The solution of these equations shows which guesses
are wrong. All wrong guesses change at once; if that does not help, only the last one changes (block principal pivoting
with Murty's rule; Portugal, Judice and Vicente 1994, Math. Comput. 63, 625). With a guess from a similar program this
takes a few Cholesky factorisations.

With linearly dependent columns this may never end: a ridge then makes them independent. With dependent inequalities,
non-negative least squares solve the dual (Lawson and Hanson 1974, chapter 23), which also finds contradictions between
inequalities.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dehyst._errors import IdentifyError
from dehyst._types import Array, Mask

_TINY = float(np.finfo(np.float64).tiny)
# Coefficients may be negative by this part of the largest one; multipliers by this part of the largest gradient.
_ZERO, _FLAT = 1e-9, 1e-8
# Largest number of exchanges without improvement before the dual is solved; largest number of all exchanges.
_PATIENCE, _EXCHANGES = 5, 80
# Ridges for the unit diagonal of G: the first keeps factors finite, the second makes columns independent; both change
# predictions by less than any noise.
_RIDGES = 1e-13, 1e-8
_RIDGE_OF_LIMITS, _REFINEMENTS = 1e-12, 3
# A column has no rows if its square falls below this part of its square before rows were subtracted.
_LEFT = 1e-10
# Dual: allowed violation of limits; rounding error of zero; largest number of steps for each equation.
_ROUGHLY, _NOTHING, _STEPS = 1e-6, 1e-14, 30


@dataclass(frozen=True, eq=False)
class ActiveSet:
    """Coefficients that are not at a bound (q,), and inequalities that hold with equality (m,)."""

    moving: Mask
    active: Mask


class _Program(NamedTuple):
    """Minimise y'G y / 2 - c'y, y[free:] >= 0, matrix y >= lower; G has a unit diagonal, c unit length."""

    gram: Array
    image: Array
    free: int
    matrix: Array
    lower: Array


class _Face(NamedTuple):
    """Minimum with some limits as equations: y, multipliers of the inequalities, and these limits."""

    y: Array
    multipliers: Array
    moving: Mask
    active: Mask


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """G (q, q), c (q,), and the number of free coefficients, which are the first ones."""

    gram: Array
    image: Array
    free: int

    def __add__(self, other: NormalEquations) -> NormalEquations:
        return NormalEquations(self.gram + other.gram, self.image + other.image, self.free)

    def __sub__(self, other: NormalEquations) -> NormalEquations:
        gram, image = self.gram - other.gram, self.image - other.image
        # A column without remaining rows holds rounding errors only.
        lost = np.diag(gram) <= _LEFT * np.diag(self.gram)
        gram[lost], gram[:, lost], image[lost] = 0.0, 0.0, 0.0
        return NormalEquations(gram, image, self.free)

    @classmethod
    def none(cls, size: int, free: int) -> NormalEquations:
        """Return the sums of zero rows, for `size` coefficients."""
        return cls(np.zeros((size, size)), np.zeros(size), free)

    def with_rows(self, rows: Array, goal: Array) -> NormalEquations:
        """Return the sums with rows (n, q) and targets (n,) added, in the lower triangle of G; it overwrites `self`."""
        from scipy.linalg.blas import dsyrk

        return NormalEquations(
            dsyrk(1.0, rows.T, 1.0, self.gram.T, overwrite_c=1).T, self.image + rows.T @ goal, self.free
        )

    @property
    def whole(self) -> NormalEquations:
        """The sums with all of G."""
        return NormalEquations(self.gram + np.tril(self.gram, -1).T, self.image, self.free)

    def minimum(self, inequalities: tuple[Array, Array], start: ActiveSet | None = None) -> tuple[Array, ActiveSet]:
        """Return the coefficients (q,), zero for columns without rows, and their active set.

        `inequalities` (m, q) and (m,): C and l; they hold to 1e-9 of the largest term, for columns of unit length.
        `start`: active set of a similar program; by default no coefficient is at its bound. Raise `IdentifyError` if
        the inequalities contradict one another.
        """
        matrix, lower = inequalities
        size = np.sqrt(np.maximum(np.diag(self.gram), 0.0))
        # Columns have different units: only a column without rows is left out.
        kept = size > 0
        places, scale = np.flatnonzero(kept), size[kept]
        # A free coefficient without rows can meet any inequality: such an inequality is left out.
        holding = ~np.any(matrix[:, : self.free][:, ~kept[: self.free]] != 0, axis=1)
        unit = float(np.linalg.norm(self.image[kept] / scale)) or 1.0
        matrix, lower = matrix[:, kept] * (unit / scale) * holding[:, None], lower * holding
        largest = np.abs(matrix).max(axis=1, initial=0.0)
        largest[largest == 0] = 1.0
        program = _Program(
            self.gram.take(places, 0).take(places, 1) / (scale[:, None] * scale),
            self.image[kept] / scale / unit,
            int(np.count_nonzero(places < self.free)),
            matrix / largest[:, None],
            lower / largest,
        )
        near, met = np.ones(scale.size, dtype=bool), np.zeros(lower.size, dtype=bool)
        if start is not None:
            # Inequalities that the similar program did not have are not active.
            near, common = start.moving[kept], min(met.size, start.active.size)
            met[:common] = start.active[:common]
        tries = (_exchanged(program, near, met, ridge) for ridge in _RIDGES)
        found = next((face for face in tries if face is not None), None) or _by_dual(program)
        x, moving = np.zeros(size.size), np.zeros(size.size, dtype=bool)
        x[kept], moving[kept] = found.y / scale * unit, found.moving
        return x, ActiveSet(moving, found.active)


def _exchanged(program: _Program, moving: Mask, active: Mask, ridge: float) -> _Face | None:
    """Exchange limits until none is violated; None if the number of violated limits does not fall."""
    gram, image, free, matrix, lower = program
    moving = moving.copy()
    moving[:free] = True
    flat = _FLAT * np.abs(image).max(initial=_TINY)
    least, patience = moving.size + active.size + 1, _PATIENCE
    for _ in range(_EXCHANGES):
        face = _on_face(program, moving, active, ridge)
        if face is None:
            return None
        y, multipliers = face.y, face.multipliers
        largest = np.abs(y).max(initial=_TINY)
        slope, slack = gram @ y - image - matrix.T @ multipliers, matrix @ y - lower
        of_bounds = np.where(moving, y < -_ZERO * largest, slope < -flat)
        of_bounds[:free] = False
        of_limits = np.where(active, multipliers < -flat, slack < -_ZERO * largest)
        wrong = np.append(of_bounds, of_limits)
        count = int(np.count_nonzero(wrong))
        if not count:
            y[free:] = np.maximum(y[free:], 0.0)
            # Contradicting limits, or limits without a column that can change, cannot all be met.
            return face if np.abs(slack[active]).max(initial=0.0) <= _ZERO * max(largest, 1.0) else None
        least, patience = (count, _PATIENCE) if count < least else (least, patience - 1)
        if patience < 0:
            return None
        moving, active = moving ^ wrong[: moving.size], active ^ wrong[moving.size :]
    return None


def _on_face(program: _Program, moving: Mask, active: Mask, ridge: float) -> _Face | None:
    """Solve with these limits as equations; None if they have no solution."""
    from scipy.linalg.lapack import dpotrf, dpotrs

    columns, limits = np.flatnonzero(moving), np.flatnonzero(active)
    y, multipliers = np.zeros(moving.size), np.zeros(active.size)
    if not columns.size:
        return None if limits.size else _Face(y, multipliers, moving, active)
    # The transpose of the symmetric G has LAPACK's order without another copy.
    part = program.gram.take(columns, 0).take(columns, 1).T
    part[np.diag_indices(columns.size)] += ridge
    factor, failure = dpotrf(part, lower=1, overwrite_a=1, clean=0)
    if failure:
        return None
    some = dpotrs(factor, program.image[columns], lower=1)[0]
    if limits.size:
        equations = program.matrix[np.ix_(limits, columns)]
        response = dpotrs(factor, np.asfortranarray(equations.T), lower=1)[0]
        normal = equations @ response
        normal[np.diag_indices(limits.size)] += _RIDGE_OF_LIMITS * max(np.trace(normal) / limits.size, _TINY)
        factor, failure = dpotrf(np.asfortranarray(normal), lower=1, overwrite_a=1, clean=0)
        if failure:
            return None
        # With the ridge the limits are not met exactly: further steps correct this, as in an augmented Lagrangian.
        for _ in range(_REFINEMENTS):
            force = dpotrs(factor, program.lower[limits] - equations @ some, lower=1)[0]
            if not np.all(np.isfinite(force)):
                return None
            multipliers[limits] += force
            some = some + response @ force
    y[columns] = some
    return _Face(y, multipliers, moving, active)


def _by_dual(program: _Program) -> _Face:
    """Return the minimum within all limits; the dual program finds the multipliers of the active limits."""
    from scipy.linalg import LinAlgError, cholesky, solve_triangular
    from scipy.optimize import nnls

    gram, image, free, matrix, lower = program
    ridge, triangle = _RIDGES[-1], None
    while triangle is None:
        try:
            triangle = cholesky(gram + ridge * np.eye(image.size), check_finite=False)
        except LinAlgError:
            ridge *= 10.0
    limits, least = np.vstack([np.eye(image.size)[free:], matrix]), np.append(np.zeros(image.size - free), lower)
    turned, at = (solve_triangular(triangle, part, trans="T") for part in (limits.T, image))
    short = least - turned.T @ at
    unit = float(np.abs(short).max(initial=0.0)) or 1.0
    goal = np.append(np.zeros(image.size), 1.0)
    try:
        forces = nnls(np.vstack([turned, short / unit]), goal, maxiter=_STEPS * goal.size)[0]
    except RuntimeError:
        forces = np.zeros(short.size)
    # The remainder is 1 / (1 + distance^2); it is 0 for limits that contradict each other.
    left = max(1.0 - float(short @ forces) / unit, _NOTHING)
    forces *= unit / left
    y = solve_triangular(triangle, at + turned @ forces)
    missed = float(np.max(least - limits @ y, initial=0.0))
    if left <= _NOTHING or not missed <= _ROUGHLY * max(float(np.abs(y).max(initial=0.0)), 1.0):
        raise IdentifyError(
            f"constraints: found no coefficients that meet all {lower.size} inequalities and are not negative",
            hint="leave out inequalities that contradict others",
        )
    y[free:] = np.maximum(y[free:], 0.0)
    bounds, others = np.split(forces, [image.size - free])
    moving, active = np.append(np.ones(free, dtype=bool), bounds == 0), others > 0
    return _exchanged(program, moving, active, ridge) or _Face(y, others, moving, active)
