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
from itertools import groupby, pairwise
from typing import Any

import numpy as np

from dehyst._types import Array, Mask
from dehyst.identification.preprocessing.regressors import NumberedEpoch
from dehyst.identification.solvers.program import Solution
from dehyst.identification.structure import Grid
from dehyst.model import Actuator, Creep, GradedSlip, MaxwellSlip, SmoothSlip, Spring, Transformer, parts_in_segments

# A branch or smooth element that holds less of the voltage than this over the whole range is left out.
_NOTHING = 1e-9


@dataclass(frozen=True, eq=False)
class Coefficients:
    """Coefficients of a regression.

    `stiffness` (N, M): kappa_im [V/m]; M = 1 for Maxwell-slip elements. `slopes` (K - 1,): slopes of the spring [V/m].
    `internal` (J + L,): stiffnesses of creep branches, then of smooth elements [V/m]. `transformer` (T,): slopes of
    tau; empty without one. `offsets`, `drifts`: constants by epoch and drifts by record [V of tau]. `solution`: the
    program's answer; None for coefficients of a given actuator. `starts`: p_j (J,) by record [V of tau].
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

    def to_actuator(self, grid: Grid, first: float, **others: Any) -> Actuator:
        """Return the actuator that has these coefficients on a grid.

        Creep branches and smooth elements that hold nothing are left out. `first`: the spring's voltage at its first
        knot [V]. `**others`: further arguments of `Actuator`.
        """
        branches = grid.time_constants.size
        mean_slope = float(self.slopes @ np.diff(grid.knots)) / float(np.ptp(grid.knots))
        internal, kept = self.internal, self.internal > _NOTHING * mean_slope
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
    creep branches and smooth elements are too far apart to have neighbours.

    `slope`: volts for a metre [V/m], which make forces elongations.
    """
    rho, segments, places = grid.breakaway[grid.movable], grid.segments, grid.places()
    along = np.kron(np.diag(rho), np.diff(np.eye(segments), axis=0) * np.sqrt(segments))
    steps = np.diff(np.diag(1 / np.diff(rho, prepend=0.0)), axis=0) * (rho[:-1] * np.diff(rho))[:, None]
    parts = [("elements", along), ("elements", np.kron(steps, np.eye(segments)))]
    for kind, knots in (("spring", grid.knots), ("transformer", grid.drive)):
        count = places[kind].stop - places[kind].start
        if count:
            length = float(np.ptp(knots)) / (knots.size - 1)
            parts.append((kind, np.diff(np.eye(count), n=2, axis=0) * length))
    rows = []
    for kind, differences in parts:
        row = np.zeros((len(differences), places["transformer"].stop))
        row[:, places[kind]] = differences / slope
        rows.append(row)
    return np.vstack(rows)


# Inequalities that one round adds at most, and how far [of the floor] one may be violated.
_ADDED = 40
_VIOLATED = 1e-6


def bounds(grid: Grid, strained: int, least: float) -> tuple[Array, Array]:
    """Return inequalities for the last segment of tau, and for starts of creep that a branch can hold.

    `strained`: records that may begin strained. `least`: least slope of tau.

    Returns
    -------
    (p, q) array, (p,) array
        matrix and lower of ``matrix x >= lower`` over the unknowns that are not negative.
    """
    lengths, places = np.diff(grid.drive), grid.places(strained)
    starts, unknowns, branches = places["starts"].start, places["starts"].stop, grid.time_constants.size
    count = strained * branches
    matrix, lower = np.zeros((bool(lengths.size) + count, unknowns)), np.zeros(bool(lengths.size) + count)
    if lengths.size:
        matrix[0, places["transformer"]] = -lengths[:-1]
        lower[0] = -(1 - least) * float(lengths.sum())
    for k, row in enumerate(matrix[bool(lengths.size) :]):
        row[places["creep"].start + k % branches] = float(np.ptp(grid.knots))
        row[[starts + k, starts + count + k]] = -1
    return matrix, lower


def violated(grid: Grid, x: Array, floor: float) -> Array:
    """Return the outermost branches that rise least at the unknowns x (q,), of those that do not rise enough."""
    rising = grid.outermost
    value = rising @ x[: rising.shape[1]]
    worst = np.argsort(value, kind="stable")[:_ADDED]
    return np.asarray(rising[worst[value[worst] < -_VIOLATED * floor]])


# Signs of constants by epoch number, and a row over the stiffnesses of the movable elements (m M,).
Tie = tuple[dict[int, float], Array]


def ties(grid: Grid, ranges: Sequence[NumberedEpoch], datum: Array) -> list[Tie]:
    """Return inequalities ``sum_e sign_e a_e + row kappa >= 0`` between constants.

    `ranges`: in order, on the axes of the records. `datum`: shift of each record to the model's axis [m].
    """
    rows: list[Tie] = []
    for record, own in groupby(ranges, key=lambda one: one.record):
        states = [_StuckElements(grid, one, float(datum[record])) for one in own]
        for one in states[:-1]:
            rows += _alike(one, states[-1])
        for before, after in pairwise(states):
            if before.at.piece == after.at.piece:
                rows += _grown(before, after)
    return rows


class _StuckElements:
    """The movable elements that are not in a known state in an epoch, and where their carts can stand."""

    def __init__(self, grid: Grid, at: NumberedEpoch, datum: float) -> None:
        self.at, self._grades, rho = at, grid.grades, grid.breakaway[grid.movable]
        low, high = (at.epoch.middle + part * at.epoch.width + datum for part in (-0.5, 0.5))
        self.stuck: Mask = 2 * rho > at.epoch.reach
        self.middle = np.full(rho.size, 0.5 * (low + high))
        # A reach reduced by noise may let the two ends cross.
        self.lowest, self.highest = np.minimum(high - rho, self.middle), np.maximum(low + rho, self.middle)

    def change(self, upper: Array, lower: Array, which: Mask) -> Array:
        """Return the row of sum K(upper) - K(lower) over some of the elements (m M,)."""
        parts = parts_in_segments(self._grades, upper) - parts_in_segments(self._grades, lower)
        return np.asarray(np.where(which[:, None], parts, 0.0).ravel())


def _alike(one: _StuckElements, last: _StuckElements) -> list[Tie]:
    """Return how far the constants of two epochs of a record may lie apart."""
    number, reference = one.at.number, last.at.number
    above = one.change(one.middle, one.lowest, one.stuck) + last.change(last.highest, last.middle, last.stuck)
    below = one.change(one.highest, one.middle, one.stuck) + last.change(last.middle, last.lowest, last.stuck)
    return [({number: -1.0, reference: 1.0}, above), ({number: 1.0, reference: -1.0}, below)]


def _grown(before: _StuckElements, after: _StuckElements) -> list[Tie]:
    """Return how the constant changes as the range grows from one epoch to the next."""
    first, second = before.at.number, after.at.number
    released = before.stuck & ~after.stuck
    moved = before.change(after.middle, before.middle, after.stuck)
    down = before.change(before.highest, np.minimum(after.highest, before.highest), after.stuck)
    up = before.change(np.maximum(after.lowest, before.lowest), before.lowest, after.stuck)
    most = moved + down + before.change(before.highest, before.middle, released)
    least = moved - up - before.change(before.middle, before.lowest, released)
    return [({second: -1.0, first: 1.0}, most), ({second: 1.0, first: -1.0}, -least)]
