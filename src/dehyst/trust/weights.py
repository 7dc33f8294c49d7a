"""The weights of a model: factors on its stiffnesses and slopes, in which its inverse is linear.

Along a path of the displacement y,

    tau(v) = c + sum_g factor_g column_g(y),

where a column is the voltage that a group of neighbouring elements, a group of spring segments, a creep branch or a
smooth element holds in the initial model. Columns depend on the path and on thresholds, not on factors. A group
without stiffness gets a column of the mean stiffness and the factor 0. Creep in displacement and the effect of
temperature come after all of this: y is the displacement without them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dehyst._native import EMPTY
from dehyst._types import Array
from dehyst.identification import Grid
from dehyst.model import (
    Actuator,
    Creep,
    GradedSlip,
    MaxwellSlip,
    SmoothSlip,
    Spring,
    State,
    looped,
    parts_in_segments,
)

# Groups of elements along their thresholds, of grades along the stroke and of the spring's segments.
_ELEMENTS, _GRADES, _SEGMENTS = 20, 4, 40
# Least slope of an outermost branch, as a part of the least one of the model.
_FLOOR = 0.5


def _cuts(count: int, groups: int) -> NDArray[np.intp]:
    """Return where each of at most `groups` runs of `count` neighbours begins."""
    return np.unique(np.linspace(0, count, min(count, groups) + 1)[:-1].astype(np.intp))


@dataclass(frozen=True, eq=False)
class Weights:
    """Groups of the weights of an actuator and their columns.

    `actuator`: the initial model, whose factors are `initial`. `cuts`: beginnings of the groups of elements, of grades
    and of segments of the spring.
    """

    actuator: Actuator
    cuts: tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]

    @classmethod
    def of(cls, actuator: Actuator) -> Weights:
        """Group the weights of an actuator."""
        stiffness = actuator.slip.stiffness
        grades = stiffness.shape[1] if stiffness.ndim == 2 else 1
        counts = (len(stiffness), _ELEMENTS), (grades, _GRADES), (actuator.spring.slopes.size, _SEGMENTS)
        elements, across, segments = (_cuts(count, groups) for count, groups in counts)
        return cls(actuator, (elements, across, segments))

    @cached_property
    def parts(self) -> tuple[Array, Array, Array]:
        """Stiffnesses (N, M) [V/m], slopes (K,) [V/m] and stiffnesses of branches and smooth elements (J + L,)."""
        actuator = self.actuator
        stiffness = actuator.slip.stiffness
        kappa = stiffness if stiffness.ndim == 2 else stiffness[:, None]
        internal = [part.stiffness for part in (actuator.creep, actuator.smooth) if part is not None]
        return kappa, actuator.spring.slopes, np.concatenate([EMPTY, *internal])

    @cached_property
    def _units(self) -> tuple[Array, Array, Array]:
        """The same, groups without stiffness having the mean stiffness: what a factor multiplies."""
        kappa, slopes, internal = self.parts
        typical = float(np.mean(slopes)) / max(kappa.shape[0], 1)
        empty = self._grouped(kappa[None])[0] <= 1e-9 * typical
        rows, columns = (self._group_of(cut, size) for cut, size in zip(self.cuts, kappa.shape, strict=False))
        kappa = np.where(empty[np.ix_(rows, columns)], typical, kappa) if kappa.size else kappa
        return kappa, slopes, np.where(internal <= 1e-9 * typical, typical, internal)

    @staticmethod
    def _group_of(cuts: NDArray[np.intp], size: int) -> NDArray[np.intp]:
        return np.searchsorted(cuts, np.arange(size), side="right") - 1

    def _grouped(self, held: Array) -> Array:
        """Return sums (n, E, G) over groups of what elements (n, N, M) hold."""
        if not held.shape[1]:
            return np.zeros((len(held), 0, self.cuts[1].size))
        return np.add.reduceat(np.add.reduceat(held, self.cuts[0], axis=1), self.cuts[1], axis=2)

    @cached_property
    def initial(self) -> Array:
        """Factors (m,) of the initial model: 1, or 0 for a group without stiffness."""
        (kappa, _, internal), (units, _, whole) = self.parts, self._units
        own, unit = self._grouped(kappa[None]).ravel(), self._grouped(units[None]).ravel()
        return np.concatenate([(own > 0.5 * unit) * 1.0, np.ones(self.cuts[2].size), (internal >= whole) * 1.0])

    @property
    def springs(self) -> slice:
        """Places of the spring's factors."""
        first = self.cuts[0].size * self.cuts[1].size
        return slice(first, first + self.cuts[2].size)

    @cached_property
    def places(self) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        """Index of the factor of each weight: elements (N, M), spring (K,), creep and smooth elements (J + L,)."""
        kappa, slopes, internal = self.parts
        rows, columns = self._group_of(self.cuts[0], len(kappa)), self._group_of(self.cuts[1], kappa.shape[1])
        spring = self.springs
        return (
            rows[:, None] * self.cuts[1].size + columns,
            spring.start + self._group_of(self.cuts[2], slopes.size),
            spring.stop + np.arange(internal.size),
        )

    def columns(self, y: Array, carts: Array, internal: Array) -> Array:
        """Return the columns (n, m) [V] at displacements (n,) with carts (n, N), strains and elongations (n, J + L)."""
        kappa, slopes, whole = self._units
        if isinstance(self.actuator.slip, GradedSlip):
            knots = self.actuator.slip.knots
            n, count = carts.shape
            held = parts_in_segments(knots, carts.ravel()).reshape(n, count, knots.size - 1)
            held = parts_in_segments(knots, y)[:, None, :] - held
        else:
            held = (y[:, None] - carts)[:, :, None]
        elements = self._grouped(held * kappa).reshape(len(y), self.springs.start)
        springs = parts_in_segments(self.actuator.spring.displacement, y) * slopes
        return np.hstack([elements, np.add.reduceat(springs, self.cuts[2], axis=1), internal * whole])

    def row(self, state: State) -> Array:
        """Return the columns (m,) in a state of the actuator."""
        whole = self.actuator.model.complete_state(state)
        internal = np.concatenate([whole.creep, whole.smooth])
        return np.asarray(self.columns(np.array([whole.deformation]), whole.carts[None], internal[None])[0])

    @cached_property
    def anchors(self) -> Array:
        """Columns (2, m) at points of the model that do not move with ageing.

        These are the lower turning point of slow major loops, and rest without strain at the voltage nearest to 0 V.
        """
        low, high = self.actuator.voltage_range
        rest = self.actuator.relaxed(min(max(0.0, low), high))
        return np.stack([self.row(looped(self.actuator, (low, high), rising=False)), self.row(rest)])

    def constants(self, factors: Array) -> tuple[float, float]:
        """Return the least and the largest constant c [V] with which an anchor stays where it is."""
        kept = float(self.actuator.spring.voltage[0]) + self.anchors @ (self.initial - factors)
        return float(kept.min()), float(kept.max())

    def prior(self, sizes: Array, ridge: float, alike: float) -> Array:
        """Return the quadratic form (m, m) of the prior: changes are small, and similar in neighbouring groups.

        `sizes` (m,): squares of the columns, whose mean over groups of a kind is the unit of `ridge` and `alike`.
        """
        form = np.zeros((sizes.size, sizes.size))
        for kind, pairs in self._neighbours:
            unit = float(sizes[kind].mean()) if sizes[kind].size else 0.0
            form[kind, kind] = unit * (ridge * np.eye(kind.stop - kind.start) + alike * pairs.T @ pairs)
        return form

    @cached_property
    def _neighbours(self) -> list[tuple[slice, Array]]:
        """Groups of a kind, and rows that are the differences of neighbours among them."""
        elements, grades = (cut.size for cut in self.cuts[:2])
        along, across = np.diff(np.eye(elements), axis=0), np.diff(np.eye(grades), axis=0)
        spring, size = self.springs, self.initial.size
        both = np.vstack([np.kron(along, np.eye(grades)), np.kron(np.eye(elements), across)])
        kinds = slice(0, spring.start), spring, slice(spring.stop, size)
        chains = [np.diff(np.eye(kind.stop - kind.start), axis=0) for kind in kinds[1:]]
        return list(zip(kinds, [both, *chains], strict=True))

    @cached_property
    def least(self) -> Array:
        """Least factors (m,): no stiffness is negative, no slope of the spring below its floor."""
        least = np.zeros(self.initial.size)
        slopes = self.parts[1]
        floor = _FLOOR * self.floor
        weakest = np.minimum.reduceat(slopes, self.cuts[2])
        least[self.springs] = np.minimum(floor / weakest, 1.0)
        return least

    @cached_property
    def floor(self) -> float:
        """Least slope of an outermost branch of the model [V/m]."""
        slopes = [float(self.parts[1].min())]
        if isinstance(self.actuator.slip, GradedSlip):
            slopes.append(float((self._outermost @ np.concatenate([self.parts[0].ravel(), self.parts[1]])).min()))
        return min(slopes)

    @cached_property
    def _outermost(self) -> Array:
        return Grid.of_actuator(self.actuator, np.ones(len(self.actuator.slip), dtype=bool)).outermost

    @cached_property
    def limits(self) -> tuple[Array, Array]:
        """Matrix (p, m) and lower limits (p,): no outermost branch of graded elements rises less than the floor."""
        if not isinstance(self.actuator.slip, GradedSlip):
            return np.zeros((0, self.initial.size)), EMPTY
        kappa, slopes, _ = self._units
        units, places = (
            np.concatenate([kappa.ravel(), slopes]),
            np.concatenate([one.ravel() for one in self.places[:2]]),
        )
        rows = np.zeros((len(self._outermost), self.initial.size))
        for weight, (unit, place) in enumerate(zip(units.tolist(), places.tolist(), strict=True)):
            rows[:, place] += self._outermost[:, weight] * unit
        rows = np.unique(np.round(rows / np.abs(rows).max(), 12), axis=0) * np.abs(rows).max()
        return rows, np.full(len(rows), _FLOOR * self.floor)

    def model(self, factors: Array, constant: float) -> Actuator:
        """Return the actuator of factors (m,) and the constant c [V]."""
        kappa, slopes, internal = (unit * factors[place] for unit, place in zip(self._units, self.places, strict=True))
        given, branches = self.actuator, 0 if self.actuator.creep is None else len(self.actuator.creep)
        slip, creep, smooth = given.slip, given.creep, given.smooth
        return replace(
            given,
            slip=GradedSlip(slip.breakaway, slip.knots, kappa)
            if isinstance(slip, GradedSlip)
            else MaxwellSlip(slip.breakaway, kappa[:, 0]),
            spring=Spring.of_slopes(given.spring.displacement, slopes, constant),
            creep=None if creep is None else Creep(creep.time_constants, internal[:branches]),
            smooth=None if smooth is None else SmoothSlip(smooth.length, smooth.closing, internal[branches:]),
        )
