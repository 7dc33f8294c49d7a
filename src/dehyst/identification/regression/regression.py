"""From rows to coefficients: stiffnesses, slopes and the nuisances of each record, in one convex program.

    tau(v) = sum_im kappa_im [R_m(y) - R_m(b_i)] + sum_j slope_j R_j(y) + sum_j c_j d_j + sum_l k_l q_l
             + sum_j p_jq exp(-t/tau_j) + a_e + c_q L(t) + residual

with y the displacement shifted by the datum d_q of its record q. R_m(z) is the part of z in segment m, the end segments
being unbounded; b_i the position of cart i; a_e the constant of epoch e and c_q the drift of record q; p_jq, what is
left at time t since record q began of the creep before it, is at most c_j times the range. All unknowns are >= 0 but
the constants and drifts; slope_j and the slopes of tau are >= a floor (Assumption I). tau keeps the ends of the
voltages where they are, which fixes scale and offset.

With one segment, no tau, no creep and no smooth elements this is Yeh's Maxwell-slip class:
``v = sum_i kappa_i s_i + sum_j slope_j R_j(y) + a_e + c_q L(t) + residual``.

With graded elements the right-hand side must increase by the floor at least on every outermost branch; those of these
inequalities that would be violated go into the program.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array, Mask
from dehyst.identification.preprocessing.regressors import NumberedEpoch, Rows
from dehyst.identification.regression.coefficients import Coefficients, bounds, regularization_rows, ties, violated
from dehyst.identification.solvers.program import Norm, Solution, Table, solve
from dehyst.identification.structure import Grid
from dehyst.model import parts_in_segments, segment_of
from dehyst.records import rms

TRANSFORMER_FLOOR = 0.2
_ROUNDS = 12
# Of the creep before a record, what is less than this at its first sample that counts is nothing.
_FORGOTTEN = 0.01
# Constants may miss what ties them by this part of the voltages, for the sensor's noise moves the ends of a range.
_SLACK = 1e-3

# Inequalities (matrix, lower) -> answer.
Solver = Callable[[tuple[Array, Array] | None], Solution]


@dataclass(frozen=True, eq=False)
class Regression:
    """The regression: everything that is fixed while coefficients are fitted.

    Attributes
    ----------
    rows : Rows
    grid : Grid
    floor : float
        Least slope of the spring, and of every outermost branch [V/m].
    datum : (records,) array
        d_q [m].
    drifting : tuple of int
        Records that get a drift.
    strained : tuple of int
        Records whose creep branches may not be at rest as they begin.
    smoothing : float
        How much alike neighbours are held, see `regularization`; 0: not at all.
    ranges : tuple of NumberedEpoch
        Epochs whose ranges tie the constants of a record to one another.
    """

    rows: Rows
    grid: Grid
    floor: float
    datum: Array
    drifting: tuple[int, ...] = ()
    strained: tuple[int, ...] = ()
    smoothing: float = 0.0
    ranges: tuple[NumberedEpoch, ...] = ()

    def __len__(self) -> int:
        return len(self.rows)

    def thinned(self, most: int) -> Regression:
        """Return the regression on about `most` evenly spaced rows."""
        return replace(self, rows=self.rows.thinned(most))

    @property
    def mean_slope(self) -> float:
        """Mean slope of voltage over displacement [V/m]."""
        return float(np.ptp(self.rows.voltage) / np.ptp(self.grid.knots))

    @cached_property
    def numbers(self) -> NDArray[np.intp]:
        """Epochs that get a constant (E,)."""
        return np.unique(self.rows.epoch)

    @cached_property
    def axis(self) -> Array:
        """Displacement of each row on the model's axis (n,)."""
        return self.rows.displacement + self.datum[self.rows.record]

    @cached_property
    def carts(self) -> Array:
        """Positions of the movable carts (n, m) [m]."""
        return np.asarray(self.axis[:, None] - self.rows.elongation[:, self.grid.movable])

    @cached_property
    def spring_parts(self) -> Array:
        """Part of each displacement in each segment of the spring, R_j(y) (n, K - 1)."""
        return parts_in_segments(self.grid.knots, self.axis)

    def nuisances(self) -> Array:
        """Return columns of the constants of epochs, then of the drifts (n, E + D)."""
        constants = (self.rows.epoch[:, None] == self.numbers).astype(float)
        drifts = [np.where(self.rows.record == q, self.rows.drift, 0.0)[:, None] for q in self.drifting]
        return np.hstack([constants, *drifts])

    @cached_property
    def bounded(self) -> Array:
        """Columns of the unknowns that are not negative (n, q), in the order of `Grid.places`."""
        elements, grid = self.rows.elongation[:, self.grid.movable], self.grid
        if grid.segments > 1:
            n, count = elements.shape
            held = parts_in_segments(grid.grades, self.carts.ravel()).reshape(n, count, grid.segments)
            free = parts_in_segments(grid.grades, self.axis)[:, None, :]
            elements = (free - held).reshape(n, count * grid.segments)
        # Changes of tau leave its ends where they are: the last segment gives back what another one gets.
        tau, lengths = self._tau_parts, np.diff(grid.drive)
        if lengths.size:
            tau = tau[:, :-1] - tau[:, -1:] * (lengths[:-1] / lengths[-1])
        starts = self.start_columns
        return np.hstack([elements, self.spring_parts, self.rows.moved[:, : grid.moved], -tau, starts, -starts])

    @property
    def start_columns(self) -> Array:
        """Remaining creep from before strained records (n, S J), one block of branches for each record."""
        fades = self.rows.moved[:, self.grid.moved :]
        blocks = [fades * (self.rows.record == q)[:, None] for q in self.strained]
        columns = np.hstack([np.zeros((len(fades), 0)), *blocks])
        # What was forgotten before the first sample that counts is no column.
        return np.where(columns.max(axis=0, initial=0.0) >= _FORGOTTEN, columns, 0.0)

    @cached_property
    def _tau_parts(self) -> Array:
        """The part of each voltage in each segment of tau (n, T)."""
        knots = self.grid.drive
        return parts_in_segments(knots, self.rows.voltage) if knots.size else np.zeros((len(self.rows), 0))

    @cached_property
    def target(self) -> Array:
        """Right-hand side (n,) [V], without the contribution of the floors."""
        v, spring, knots = self.rows.voltage, self.floor * self.spring_parts.sum(axis=1), self.grid.drive
        if not knots.size:
            return np.asarray(v - spring)
        last = (1 - TRANSFORMER_FLOOR) * np.ptp(knots) / (knots[-1] - knots[-2]) * self._tau_parts[:, -1]
        return np.asarray(knots[0] + TRANSFORMER_FLOOR * (v - knots[0]) + last - spring)

    @cached_property
    def columns(self) -> tuple[Array, int]:
        """All columns (n, E + D + q), the free ones first, and how many are free."""
        free = self.nuisances()
        return np.hstack([free, self.bounded]), free.shape[1]

    def table(self) -> tuple[Array, Array, Array]:
        """Return free columns, columns that are not negative, and target."""
        return self.nuisances(), self.bounded, self.target

    def fit(self, norm: Norm, weights: Array | None = None, like: Coefficients | None = None) -> Coefficients:
        """Solve the program, inequalities added round by round where they would be violated.

        `like`: another fit of this regression, whose inequalities the first round has.
        """
        n, weight = len(self.rows), np.ones(len(self.rows)) if weights is None else weights
        blocks = [(*self.table(), weight)]
        count = blocks[0][0].shape[1]
        if n >= max(count, 1):
            usual = 1.0 if weights is None else 1 / self.mean_slope
            blocks.append(self.regularization(norm, n, count, usual))
        free, bounded, target, weight = (np.concatenate(column) for column in zip(*blocks, strict=True))
        found = self.solved_with(
            lambda limits: solve(free, bounded, target, weights=weight, norm=norm, constraints=limits), like
        )
        return replace(found, solution=replace(found.solved, residual=found.solved.residual[:n]))

    def fit_weighted(self, norm: Norm) -> Coefficients:
        """Fit all rows, weighted by the inverse slope of a least-squares fit of equal weights."""
        like = self.fit("l2")
        return self.fit(norm, 1 / self.slope(like), like=like)

    def regularization(self, norm: Norm, count: int, free: int, weight: float) -> Table:
        """Return rows that hold neighbours alike, as a block of a table of `count` others: see `regularization_rows`.

        The rows do not involve the `free` columns; `weight` is the weight of a row with the mean slope. The relative
        weight does not depend on the number of samples.
        """
        if not self.smoothing:
            return np.zeros((0, free)), self.bounded[:0], np.zeros(0), np.zeros(0)
        rows = self._padded(regularization_rows(self.grid, self.mean_slope))
        p = len(rows)
        strength = self.smoothing * self.mean_slope * (np.sqrt(count) if norm == "l2" else count / np.sqrt(p))
        return np.zeros((p, free)), strength * rows, np.zeros(p), np.full(p, weight)

    def _padded(self, rows: Array, free: int = 0) -> Array:
        """Rows over the first unknowns that are not negative, with nothing for the others and `free` free ones."""
        others = self.bounded.shape[1] - rows.shape[1]
        return np.hstack([np.zeros((len(rows), free)), rows, np.zeros((len(rows), others))])

    def solved_with(self, solver: Solver, like: Coefficients | None = None) -> Coefficients:
        """Return the coefficients that a solver finds, see `constrained`."""
        answer = self.constrained(solver, like)
        return self._with_nuisances(self.at(answer.nonnegative), answer)

    def constrained(self, solver: Solver, like: Coefficients | None = None) -> Solution:
        """Return the answer of a solver when no other inequality is violated.

        The first round has the inequalities of the fit `like`: by default ties of constants and bounds of tau and
        starts.
        """
        free = self.numbers.size + len(self.drifting)
        known = None if like is None else like.solved.inequalities
        matrix, lower = self._limits(free) if known is None else known
        for _ in range(_ROUNDS):
            answer = solver((matrix, lower) if lower.size else None)
            if self.grid.segments == 1 or not answer.optimal:
                break
            more = self._padded(violated(self.grid, answer.nonnegative, self.floor), free)
            if not len(more):
                break
            matrix, lower = np.vstack([matrix, more]), np.append(lower, np.zeros(len(more)))
        return replace(answer, inequalities=(matrix, lower))

    def _limits(self, free: int) -> tuple[Array, Array]:
        matrix, lower = bounds(self.grid, len(self.strained), TRANSFORMER_FLOOR)
        place = {int(number): k for k, number in enumerate(self.numbers)}
        rows = []
        for signs, stiffness in ties(self.grid, self.ranges, self.datum):
            if set(signs) <= set(place):
                row = self._padded(stiffness[None], free)[0]
                row[[place[number] for number in signs]] = list(signs.values())
                rows.append(row)
        whole = np.hstack([np.zeros((lower.size, free)), matrix])
        slack = _SLACK * float(np.ptp(self.rows.voltage)) if len(self.rows) else 0.0
        return np.vstack([whole, *rows]), np.append(lower, np.full(len(rows), -slack))

    @cached_property
    def _segments(self) -> tuple[NDArray[np.intp], ...]:
        """Segments of the spring (n,), and of the grades, that displacements (n,) and movable carts (n, m) are in."""
        y, grades = self.axis, self.grid.grades
        return segment_of(self.grid.knots, y), segment_of(grades, y), segment_of(grades, self.carts)

    def slope(self, found: Coefficients, some: Mask | slice = slice(None)) -> Array:
        """Return d tau(v)/dy of the model at some rows [V/m], at the floor at least; weights are its inverse."""
        grid, branches = self.grid, self.grid.time_constants.size
        if grid.segments == 1 and not (grid.drive.size or grid.moved):
            # One product, for regressions of many rows.
            elements, spring = self.rows.stuck[some] @ found.stiffness[:, 0], segment_of(grid.knots, self.axis[some])
        else:
            spring, own, carts = (one[some] for one in self._segments)
            kappa = found.stiffness[grid.movable]
            sliding = ~self.rows.stuck[some][:, grid.movable]
            at = np.take_along_axis(kappa.T, carts, axis=0)
            elements = kappa.sum(axis=0)[own] - np.where(sliding, at, 0.0).sum(axis=1)
        slope = elements + found.slopes[spring] + found.internal[:branches].sum()
        # Part of each smooth element that has not yielded, dq/dy. The first slip element yields soonest: it shows where
        # the row is bound for.
        q = self.rows.moved[some, branches : grid.moved]
        forward = np.sign(q * self.rows.elongation[some, :1])
        shares = 1 - np.minimum(np.abs(q) / grid.lengths, 1) * (grid.closings * forward + 1 - grid.closings)
        return np.asarray(np.maximum(slope + shares @ found.internal[branches:], self.floor))

    def rms(self, found: Coefficients) -> float:
        """Return the RMS residual [m] of a fit."""
        return rms(found.solved.residual / self.slope(found))

    def model(self, found: Coefficients) -> Array:
        """Return right-hand side less tau(v) of each row (n,) [V], without constants and drifts."""
        grades, stiffness, y = self.grid.grades, found.stiffness, self.axis
        if self.grid.segments == 1:
            forces = self.rows.elongation @ stiffness[:, 0]
        else:
            # Each stiffness, integrated from the cart to the displacement.
            below = np.hstack([np.zeros((len(stiffness), 1)), np.cumsum(stiffness * np.diff(grades), axis=1)])
            k = segment_of(grades, y)
            forces = below.sum(axis=0)[k] + stiffness.sum(axis=0)[k] * (y - grades[k])
            for i in np.flatnonzero(stiffness.any(axis=1)):
                cart = y - self.rows.elongation[:, i]
                k = segment_of(grades, cart)
                forces -= below[i, k] + stiffness[i, k] * (cart - grades[k])
        tau = self.grid.drive[0] + self._tau_parts @ found.transformer if found.transformer.size else self.rows.voltage
        internal = self.rows.moved[:, : self.grid.moved] @ found.internal
        return np.asarray(forces + self.spring_parts @ found.slopes + internal - tau)

    def residual(self, found: Coefficients) -> Array:
        """Return the residual of the equation of each row [V]; an epoch without a constant gets its median."""
        left = self.model(found)
        for q, drift in found.drifts.items():
            left += drift * np.where(self.rows.record == q, self.rows.drift, 0.0)
        for q, start in found.starts.items():
            left += (self.rows.moved[:, self.grid.moved :] @ start) * (self.rows.record == q)
        for epoch in np.unique(self.rows.epoch).tolist():
            own = self.rows.epoch == epoch
            left[own] += found.offsets.get(epoch, -float(np.median(left[own])))
        return left

    def _with_nuisances(self, model: Coefficients, answer: Solution) -> Coefficients:
        """Return a model with the constants, drifts and starts of an answer."""
        offsets, drifts = answer.free[: self.numbers.size].tolist(), answer.free[self.numbers.size :].tolist()
        count = 2 * len(self.strained) * self.grid.time_constants.size
        starts: dict[int, Array] = {}
        if count:
            # What is added, and what is taken away.
            plus, minus = answer.nonnegative[-count:].reshape(2, len(self.strained), -1)
            starts = dict(zip(self.strained, plus - minus, strict=True))
        return replace(
            model,
            solution=answer,
            offsets=dict(zip(self.numbers.tolist(), offsets, strict=True)),
            drifts=dict(zip(self.drifting, drifts, strict=True)),
            starts=starts,
        )

    def fit_nuisances(self, found: Coefficients) -> Coefficients:
        """Fit only the constants, drifts and starts, for a model that is given."""
        fades = self.start_columns
        starts = np.hstack([fades, -fades])
        stiffness = np.tile(found.internal[: self.grid.time_constants.size], len(self.strained))
        limits = -np.hstack([np.eye(stiffness.size)] * 2), -float(np.ptp(self.grid.knots)) * stiffness
        answer = solve(
            self.nuisances(),
            starts,
            -self.model(found),
            weights=1 / self.slope(found),
            norm="l2",
            constraints=limits if stiffness.size else None,
        )
        return self._with_nuisances(found, answer)

    def at(self, x: Array) -> Coefficients:
        """Return the coefficients of the unknowns (q,) that are not negative, without constants and starts."""
        grid, places = self.grid, self.grid.places()
        stiffness = np.zeros((grid.movable.size, grid.segments))
        stiffness[grid.movable] = x[places["elements"]].reshape(-1, grid.segments)
        tau, lengths = x[places["transformer"]], np.diff(grid.drive)
        if lengths.size:
            left = max((1 - TRANSFORMER_FLOOR) * lengths.sum() - tau @ lengths[:-1], 0.0) / lengths[-1]
            tau = TRANSFORMER_FLOOR + np.append(tau, left)
        internal = x[places["creep"].start : places["smooth"].stop]
        return Coefficients(stiffness, x[places["spring"]] + self.floor, internal, tau)
