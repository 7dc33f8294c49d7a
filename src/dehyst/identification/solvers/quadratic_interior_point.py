"""Mehrotra's interior point for quadratic programs whose bounds enter the normal matrix on its diagonal only.

minimise 1/2 x'Gx - c'x,   x[free:] >= 0,   C x >= l
"""

from __future__ import annotations

import numpy as np

from dehyst._types import Array
from dehyst.identification.solvers.interior_point_algebra import (
    barrier_matrix,
    corrector_target,
    reach,
    regularised_solver,
)

_STEPS = 100


def interior_point(
    gram: Array, linear: Array, free: int, inequalities: tuple[Array, Array], close: float
) -> tuple[Array, Array, Array]:
    """Return x, multipliers of the bounds (0 for free coefficients) and of the inequalities.

    Parameters
    ----------
    gram, linear : (q, q) and (q,) array
        G and c.
    free : int
        Number of coefficients without a bound; they come first.
    inequalities : (m, q) and (m,) array
        C and l.
    close : float
        Mean complementarity at which the method ends.
    """
    matrix, lower = inequalities
    q, bounded = linear.size, linear.size - free
    x, slack, dual = np.ones(q), np.ones(bounded + lower.size), np.ones(bounded + lower.size)
    unit = float(np.diag(gram).max(initial=0.0)) or 1.0
    for _ in range(_STEPS):
        pull = gram @ x - linear - matrix.T @ dual[bounded:]
        pull[free:] -= dual[:bounded]
        missed = np.concatenate([x[free:], matrix @ x - lower]) - slack
        mean = float(slack @ dual) / max(dual.size, 1)
        if mean < close and np.abs(pull).max() < 1e-12 * unit and np.abs(missed).max(initial=0.0) < 1e-12:
            break
        newton = _Newton(gram, matrix, free, (pull, missed), slack, dual)
        _, ds, dz = newton.step(np.zeros(dual.size))
        length = min(reach(slack, ds), reach(dual, dz))
        after = float((slack + length * ds) @ (dual + length * dz)) / max(dual.size, 1)
        dx, ds, dz = newton.step(corrector_target(mean, after) - ds * dz)
        length = 0.995 * min(reach(slack, ds), reach(dual, dz))
        x, slack, dual = x + length * dx, slack + length * ds, dual + length * dz
    x[free:] = np.maximum(x[free:], 0.0)
    return x, np.concatenate([np.zeros(free), dual[:bounded]]), dual[bounded:]


class _Newton:
    """Newton's equations at a point; `left` are the dual and the primal residual."""

    def __init__(
        self, gram: Array, matrix: Array, free: int, left: tuple[Array, Array], slack: Array, dual: Array
    ) -> None:
        self._matrix, self._free, (self._pull, self._missed) = matrix, free, left
        self._slack, self._dual, self._ratio = slack, dual, dual / slack
        bounded = gram.shape[0] - free
        normal = gram + barrier_matrix(matrix, dual[bounded:], slack[bounded:])
        places = np.arange(free, gram.shape[0])
        normal[places, places] += self._ratio[:bounded]
        self._solve = regularised_solver(normal)

    def step(self, target: Array) -> tuple[Array, Array, Array]:
        """Return changes of x, slack and dual that bring slack times dual to the target."""
        force = target / self._slack - self._dual - self._ratio * self._missed
        bounded = force.size - len(self._matrix)
        right = self._matrix.T @ force[bounded:] - self._pull
        right[self._free :] += force[:bounded]
        dx = self._solve(right)
        moved = np.concatenate([dx[self._free :], self._matrix @ dx])
        return dx, moved + self._missed, force - self._ratio * moved
