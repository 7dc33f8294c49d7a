"""Coefficients of the regression, the inequalities among them, and their regularization.

Inequalities between the constants of a record's epochs (`ties`): in an epoch of range [L, H] the cart of an element
that has not slid both ways lies between H - rho and L + rho. With K(z) the element's stiffness integrated up to z and M
the middle of the range, it adds K(M) - K(b) to the constant; so the constant lies within

    c + sum_stuck [K(M) - K(L + rho)]  <=  a  <=  c + sum_stuck [K(M) - K(H - rho)],

c being the same in all epochs of a record. As the range grows, a cart is pushed by no more than its end of the range
moves, and an element that becomes known leaves its part. All are linear in the stiffnesses: rows, no unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array, Mask
from dehyst.identification.preprocessing.regressors import EpochRange
from dehyst.identification.solvers.program import Solution
from dehyst.identification.structure import Grid
from dehyst.model import Actuator, Creep, GradedSlip, MaxwellSlip, SmoothSlip, Spring, Transformer
from dehyst.model.elements import parts_in_segments

# A branch or smooth element that holds less of the voltage than this over the whole range is left out.
_NOTHING = 1e-9


@dataclass(frozen=True, eq=False)
class Coefficients:
    """Coefficients of a regression.

    `stiffness` (N, M): kappa_im [V/m]; M = 1 for Maxwell-slip elements. `slopes` (K - 1,): slopes of the spring [V/m].
    `internal` (J + L,): stiffnesses of creep branches, then of smooth elements [V/m]. `transformer` (T,): slopes of
    tau; empty without one. `offsets`, `drifts`: constants by epoch and drifts by record [V of tau]. `solution`: the
    program's answer; None for those of a given actuator. `starts`: p_j (J,) by record [V of tau].
    """

    stiffness: Array
    slopes: Array
    internal: Array
    transformer: Array
    offsets: dict[int, float] = field(default_factory=dict)
    drifts: dict[int, float] = field(default_factory=dict)
    solution: Solution | None = None
    starts: dict[int, Array] = field(default_factory=dict)

    @classmethod
    def from_actuator(cls, actuator: Actuator) -> Coefficients:
        """Return an actuator's numbers as coefficients, without constants."""
        tau, stiffness = actuator.transformer, actuator.slip.stiffness
        internal = [np.zeros(0) if part is None else part.stiffness for part in (actuator.creep, actuator.smooth)]
        return cls(
            stiffness=stiffness if stiffness.ndim == 2 else stiffness[:, None],
            slopes=actuator.spring.slopes,
            internal=np.concatenate(internal),
            transformer=np.zeros(0) if tau is None else np.diff(tau.drive) / np.diff(tau.voltage),
        )

    @property
    def solved(self) -> Solution:
        """The program's answer.

        Raise `ValueError` if these are the coefficients of a given actuator.
        """
        if self.solution is None:
            raise ValueError("these coefficients are those of an actuator; fit a regression for an answer")
        return self.solution

    def to_actuator(self, grid: Grid, first: float, *, least: float | None = _NOTHING, **others: Any) -> Actuator:
        """Return the actuator that has these coefficients on a grid.

        `first`: the spring's voltage at its first knot [V]. `least`: creep branches and smooth elements that hold no
        more than this part of the voltage are left out; None: all stay, negative stiffnesses as zero. `**others`:
        further arguments of `Actuator`.
        """
        branches = grid.time_constants.size
        internal = np.maximum(self.internal, 0.0) if least is None else self.internal
        if least is None:
            kept = np.ones(internal.size, dtype=bool)
        else:
            kept = internal > least * float(self.slopes @ np.diff(grid.knots)) / float(np.ptp(grid.knots))
        creep, smooth = kept[:branches], kept[branches:]
        tau = grid.drive[:1] + np.concatenate([[0.0], np.cumsum(self.transformer * np.diff(grid.drive))])
        return Actuator(
            slip=GradedSlip(grid.breakaway, grid.grades, self.stiffness)
            if grid.graded
            else MaxwellSlip(grid.breakaway, self.stiffness[:, 0]),
            spring=Spring.of_slopes(grid.knots, self.slopes, first),
            transformer=Transformer(grid.drive, tau) if grid.drive.size else None,
            creep=Creep(grid.time_constants[creep], internal[:branches][creep]) if creep.any() else None,
            smooth=SmoothSlip(grid.lengths[smooth], grid.closings[smooth], internal[branches:][smooth])
            if smooth.any()
            else None,
            **others,
        )


def regularization_rows(grid: Grid, slope: float) -> Array:
    """Differences between neighbours (p, q) [m]: of elements, spring and transformer, in the order of the unknowns.

    ``rho_i sqrt(M) (kappa_i,m+1 - kappa_im) / slope`` along the stroke,
    ``rho_i drho_i+1 (kappa_i+1,m / drho_i+1 - kappa_im / drho_i) / slope`` from one threshold to the next, and second
    differences of the slopes of the spring and of tau over a segment. They do not depend on how many rows there are;
    what creeps or yields gradually lies too far apart to have neighbours.

    `slope`: volts for a metre [V/m], which make forces elongations.
    """
    rho = grid.breakaway[grid.movable]
    elements, spring, drive = rho.size * grid.segments, grid.knots.size - 1, max(grid.drive.size - 2, 0)
    size = elements + spring + grid.moved + drive
    stiffness = np.arange(elements).reshape(rho.size, grid.segments)
    segment = float(np.ptp(grid.knots)) / spring
    rows = [
        _placed(_along(rho, grid.segments) / slope, stiffness.ravel(), size),
        _placed(_across(rho, grid.segments) / slope, stiffness.ravel(), size),
        _placed(_curvature(spring) * segment / slope, elements + np.arange(spring), size),
    ]
    if drive:
        length = float(np.ptp(grid.drive)) / (drive + 1)
        rows.append(_placed(_curvature(drive) * length / slope, size - drive + np.arange(drive), size))
    return np.vstack(rows)


def _along(rho: Array, segments: int) -> Array:
    """Of each element from one grade to the next."""
    one = np.diff(np.eye(segments), axis=0) * np.sqrt(segments)
    return np.asarray(np.kron(np.diag(rho), one))


def _across(rho: Array, segments: int) -> Array:
    """Of the density of stiffness from one threshold to the next, on each grade."""
    density = np.diag(1 / np.diff(rho, prepend=0.0))
    steps = np.diff(density, axis=0) * (rho[:-1] * np.diff(rho))[:, None]
    return np.asarray(np.kron(steps, np.eye(segments)))


def _curvature(count: int) -> Array:
    return np.asarray(np.diff(np.eye(count), n=2, axis=0))


def _placed(rows: Array, columns: NDArray[np.intp], size: int) -> Array:
    found = np.zeros((len(rows), size))
    found[:, columns] = rows
    return found


# Inequalities that one round adds at most, and how far [of the floor] one may be violated.
_ADDED = 40
_VIOLATED = 1e-6


def bounds(grid: Grid, records: int, unknowns: int, least: float) -> tuple[Array, Array]:
    """Return what the last segment of tau has left to give, and starts of creep that a branch can hold.

    `records`: records that may begin strained. `unknowns`: unknowns of the program that are not negative. `least`:
    least slope of tau.

    Returns
    -------
    (p, unknowns) array, (p,) array
        matrix and lower of ``matrix x >= lower``.
    """
    lengths, branches = np.diff(grid.drive), grid.time_constants.size
    spring = int(np.count_nonzero(grid.movable)) * grid.segments
    creep, starts = spring + grid.knots.size - 1, unknowns - 2 * records * branches
    rows = []
    if lengths.size:
        rows.append(np.zeros(unknowns))
        rows[-1][starts - (lengths.size - 1) : starts] = -lengths[:-1]
    for k in range(records * branches):
        rows.append(np.zeros(unknowns))
        rows[-1][creep + k % branches] = float(np.ptp(grid.knots))
        rows[-1][[starts + k, starts + records * branches + k]] = -1
    lower = np.zeros(len(rows))
    lower[: bool(lengths.size)] = -(1 - least) * float(lengths.sum())
    return np.array(rows).reshape(-1, unknowns), lower


def violated(grid: Grid, x: Array, floor: float) -> Array:
    """Return the outermost branches that rise least at the unknowns x (q,), of those that do not rise enough."""
    rising = grid.outermost
    value = rising @ x[: rising.shape[1]]
    worst = np.argsort(value, kind="stable")[:_ADDED]
    return np.asarray(rising[worst[value[worst] < -_VIOLATED * floor]])


def ties(grid: Grid, ranges: Sequence[EpochRange]) -> list[tuple[dict[int, float], Array]]:
    """Return inequalities ``sum_e sign_e a_e + row kappa >= 0`` between constants.

    `ranges`: on the model's axis, in order.

    Returns
    -------
    list of (signs by epoch number, row over the stiffnesses of the movable elements (m M,))
    """
    rows: list[tuple[dict[int, float], Array]] = []
    for record in dict.fromkeys(one.record for one in ranges):
        own = [_Epoch(grid, one) for one in ranges if one.record == record]
        for one in own[:-1]:
            rows += _alike(one, own[-1])
        for before, after in pairwise(own):
            if before.range.piece == after.range.piece:
                rows += _grown(before, after)
    return rows


class _Epoch:
    """An epoch, with the movable elements that are not in a known state."""

    def __init__(self, grid: Grid, at: EpochRange) -> None:
        self.range, self._grid, self.rho = at, grid, grid.breakaway[grid.movable]
        self.stuck: Mask = 2 * self.rho > at.reach
        self.middle = np.full(self.rho.size, at.middle)
        # A reach reduced by noise may let the two ends cross.
        self.lowest = np.minimum(at.high - self.rho, self.middle)
        self.highest = np.maximum(at.low + self.rho, self.middle)

    def change(self, upper: Array, lower: Array, which: Mask) -> Array:
        """Return the row of sum K(upper) - K(lower) over some of the elements (m M,)."""
        grades = self._grid.grades
        parts = parts_in_segments(grades, upper) - parts_in_segments(grades, lower)
        return np.asarray(np.where(which[:, None], parts, 0.0).ravel())


def _alike(one: _Epoch, last: _Epoch) -> list[tuple[dict[int, float], Array]]:
    """Return how far the constants of two epochs of a record may lie apart."""
    number, reference = one.range.number, last.range.number
    above = one.change(one.middle, one.lowest, one.stuck) + last.change(last.highest, last.middle, last.stuck)
    below = one.change(one.highest, one.middle, one.stuck) + last.change(last.middle, last.lowest, last.stuck)
    return [({number: -1.0, reference: 1.0}, above), ({number: 1.0, reference: -1.0}, below)]


def _grown(before: _Epoch, after: _Epoch) -> list[tuple[dict[int, float], Array]]:
    """Return how the constant changes as the range grows from one epoch to the next."""
    first, second = before.range.number, after.range.number
    released = before.stuck & ~after.stuck
    moved = before.change(after.middle, before.middle, after.stuck)
    down = before.change(before.highest, np.minimum(after.highest, before.highest), after.stuck)
    up = before.change(np.maximum(after.lowest, before.lowest), before.lowest, after.stuck)
    most = moved + down + before.change(before.highest, before.middle, released)
    least = moved - up - before.change(before.middle, before.lowest, released)
    return [({second: -1.0, first: 1.0}, most), ({second: 1.0, first: -1.0}, -least)]
