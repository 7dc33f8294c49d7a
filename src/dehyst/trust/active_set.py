"""A small convex program solved step by step; each step ends at a feasible point with no larger objective."""

from __future__ import annotations

import numpy as np

from dehyst._types import Array, Mask

# Parts of the largest term: a step, and a multiplier, that are rounding; and a ridge, for rows may be dependent.
_STILL, _FLAT, _DEPENDENT = 1e-10, 1e-9, 1e-14
# Steps after which a program ends where it is.
_STEPS = 2000


class StepwiseProgram:
    """Minimise ``x' gram x / 2 - image' x`` with ``x >= least`` and ``matrix x >= lower``, by a primal active set.

    A step costs one solution of a linear system of the size of `gram` (m, m), which is positive definite. `x` (m,) is
    feasible before the first step and after each.
    """

    def __init__(self, gram: Array, image: Array, least: Array, matrix: Array, lower: Array, x: Array) -> None:
        self._gram, self._image = gram, image
        self.least, self.matrix, self.lower = least, matrix, lower
        self.x = np.maximum(x, least)
        self._fixed: Mask = self.x <= least
        self._active: list[int] = []

    def minimum(self) -> Array:
        """Return the point (m,) of the least objective."""
        for _ in range(_STEPS):
            if self.step():
                break
        return self.x

    def step(self) -> bool:
        """Go to the minimum on the active limits, or to the first other limit on the way there.

        Return whether it is the minimum, certified by its multipliers.
        """
        free = np.flatnonzero(~self._fixed)
        pull = self._gram @ self.x - self._image
        rows = self.matrix[self._active]
        size = free.size
        system = np.zeros((size + len(rows), size + len(rows)))
        system[:size, :size] = self._gram[np.ix_(free, free)]
        system[size:, :size] = rows[:, free]
        system[:size, size:] = -rows[:, free].T
        places = np.arange(size, len(system))
        system[places, places] = _DEPENDENT * np.trace(self._gram) / pull.size
        answer = np.linalg.solve(system, np.concatenate([-pull[free], np.zeros(len(rows))]))
        direction, forces = np.zeros(pull.size), answer[size:]
        direction[free] = answer[:size]
        share, limit = self._way(direction)
        self.x = np.maximum(self.x + share * direction, self.least)
        if limit is None:
            return not self._release(pull + self._gram @ direction - rows.T @ forces, forces)
        if limit < pull.size:
            self._fixed[limit] = True
        else:
            self._active.append(limit - pull.size)
        return False

    def _way(self, direction: Array) -> tuple[float, int | None]:
        """Return how much of a direction is allowed, and the limit that ends it: a coefficient, or m plus a row."""
        moved = self.matrix @ direction
        room = np.concatenate([self.x - self.least, self.matrix @ self.x - self.lower])
        speed = -np.concatenate([direction, moved])
        speed[[*np.flatnonzero(self._fixed), *(self.x.size + row for row in self._active)]] = 0.0
        closing = speed > _STILL * np.abs(speed).max(initial=0.0)
        share = np.divide(np.maximum(room, 0.0), speed, out=np.full(room.size, np.inf), where=closing)
        limit = int(np.argmin(share))
        return (1.0, None) if share[limit] >= 1 else (float(share[limit]), limit)

    def _release(self, pull: Array, forces: Array) -> bool:
        """Release the active limit with the most negative multiplier; return whether there is one."""
        flat = _FLAT * float(np.abs(self._image).max(initial=0.0))
        held = np.where(self._fixed, pull, np.inf)
        place, row = int(np.argmin(held)), int(np.argmin(forces)) if forces.size else -1
        if row >= 0 and forces[row] < -flat:
            del self._active[row]
        elif held[place] < -flat:
            self._fixed[place] = False
        else:
            return False
        return True
