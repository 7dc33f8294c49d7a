"""Small quadratic programs on a triangle: first the active limits, then the numbers by equations.

minimise 1/2 || R x - d ||^2,   x[free:] >= 0,   C x >= l
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dehyst._types import Array, Mask
from dehyst.identification.solvers.problem import TINY
from dehyst.identification.solvers.quadratic_interior_point import interior_point

# The interior point ends when the mean complementarity is this part of the objective at zero.
_CLOSE = 1e-13
_ROUNDS = 50


@dataclass(frozen=True, eq=False)
class Minimum:
    """Coefficients, multipliers of the inequalities, free coefficients and active inequalities.

    Attributes
    ----------
    x : (q,) array
    multipliers : (m,) array
        Not negative.
    moving : (q,) bool array
        Coefficients that are unbounded or above zero.
    active : (m,) bool array
        Inequalities met with equality.
    status : str
        The method that found it.
    """

    x: Array
    multipliers: Array
    moving: Mask
    active: Mask
    status: str


@dataclass(frozen=True, eq=False)
class Quadratic:
    """The program: triangle R (k, q), image d (k,), number of free coefficients, inequalities (m, q) and (m,)."""

    triangle: Array
    image: Array
    free: int
    matrix: Array
    lower: Array

    def minimum(self) -> Minimum:
        """Solve the program."""
        if not self.lower.size:
            solution = self._by_nnls()
            if solution is not None:
                return solution
        x, z, multipliers = self._interior()
        slack = self.matrix @ x - self.lower
        moving = x > z
        moving[: self.free] = True
        return self._exchange_limits(Minimum(x, multipliers, moving, slack < multipliers, "interior point"))

    def corrected(self, minimum: Minimum, misfit: Array) -> Minimum:
        """Return a corrected minimum, given R^-T times the true negative gradient at it; active limits stay active."""
        step, change = self._on_face(minimum.moving, minimum.active, misfit, self.lower - self.matrix @ minimum.x)
        x = minimum.x + step
        x[self.free :] = np.maximum(x[self.free :], 0.0)
        multipliers = np.maximum(change, 0.0)
        return Minimum(x, multipliers, minimum.moving, minimum.active, minimum.status)

    def gradient(self, x: Array) -> Array:
        """Return the gradient of the objective (q,)."""
        return np.asarray(self.triangle.T @ (self.triangle @ x - self.image))

    def _by_nnls(self) -> Minimum | None:
        """Solve by Lawson and Hanson's method, free coefficients eliminated; None if it does not end."""
        from scipy.linalg import solve_triangular
        from scipy.optimize import nnls

        p, q = self.free, self.triangle.shape[1]
        x = np.zeros(q)
        try:
            if p < q:  # SciPy's nnls breaks the heap when it is given no column
                x[p:], _ = nnls(self.triangle[p:, p:], self.image[p:], maxiter=50 * q + 1000)
        except RuntimeError:
            return None
        if p:
            x[:p] = solve_triangular(self.triangle[:p, :p], self.image[:p] - self.triangle[:p, p:] @ x[p:])
        moving = (x > 0) | (np.arange(q) < p)
        return Minimum(x, np.zeros(0), moving, np.zeros(0, dtype=bool), "non-negative least squares")

    def _exchange_limits(self, first: Minimum) -> Minimum:
        """Exchange limits until the equations on the active ones meet all others; `first` if that does not end."""
        moving, active = first.moving.copy(), first.active.copy()
        for _ in range(_ROUNDS):
            x, multipliers = self._on_face(moving, active, self.image, self.lower)
            size = np.abs(x).max(initial=1.0)
            reduced = self.gradient(x) - self.matrix.T @ multipliers
            below = moving & (x < -1e-13 * size)
            below[: self.free] = False
            missed = ~active & (self.matrix @ x < self.lower - 1e-13 * size)
            steep = np.abs(self.image).max(initial=0.0)
            pulled = ~moving & (reduced < -1e-12 * steep)
            loose = active & (multipliers < -1e-12 * steep)
            if not (below.any() or missed.any() or pulled.any() or loose.any()):
                x[self.free :] = np.maximum(x[self.free :], 0.0)
                return Minimum(x, np.maximum(multipliers, 0.0), moving, active, "interior point and active set")
            moving, active = (moving & ~below) | pulled, (active & ~loose) | missed
        return first

    def _on_face(self, moving: Mask, active: Mask, image: Array, lower: Array) -> tuple[Array, Array]:
        """Solve least squares over the moving coefficients, active inequalities as equations; also multipliers (m,)."""
        from scipy.linalg import lstsq, qr, solve_triangular

        x, multipliers = np.zeros(moving.size), np.zeros(active.size)
        some, equations = self.triangle[:, moving], self.matrix[np.ix_(active, moving)]
        basis, factor, order = qr(equations.T, pivoting=True)
        diagonal = np.abs(np.diag(factor))
        rank = int(np.count_nonzero(diagonal > 1e-12 * diagonal.max(initial=0.0)))
        kept = np.flatnonzero(active)[order[:rank]]
        fixed = basis[:, :rank] @ solve_triangular(factor[:rank, :rank], lower[kept], trans="T")
        null = some @ basis[:, rank:]
        rest = lstsq(null, image - some @ fixed, lapack_driver="gelsy", cond=1e-14)[0] if null.shape[1] else np.zeros(0)
        x[moving] = fixed + basis[:, rank:] @ rest
        pull = self.triangle[:, moving].T @ (self.triangle @ x - image)
        multipliers[kept] = solve_triangular(factor[:rank, :rank], basis[:, :rank].T @ pull)
        return x, multipliers

    def _interior(self) -> tuple[Array, Array, Array]:
        """Return x, multipliers of the bounds (0 for free ones) and of the inequalities."""
        gram, linear = self.triangle.T @ self.triangle, self.triangle.T @ self.image
        close = _CLOSE * max(float(self.image @ self.image), TINY)
        return interior_point(gram, linear, self.free, (self.matrix, self.lower), close)
