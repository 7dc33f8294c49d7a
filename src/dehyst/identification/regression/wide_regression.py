"""The regression of wider actuators: graded elements, a transformer, creep and smooth elements beside the spring.

    tau(v) = sum_im kappa_im [R_m(y) - R_m(b_i)] + sum_j slope_j R_j(y) + sum_j c_j d_j + sum_l k_l q_l
             + sum_j p_jq exp(-t/tau_j) + a_e + c_q L(t) + residual

R_m(z) is the part of z in segment m; b_i the position of cart i; all unknowns >= 0 but the constants, slope_j and the
slopes of tau >= a floor; p_jq, what is left at time t since record q began of the creep before it, is at most c_j times
the range. tau keeps the ends of the voltages where they are, which fixes scale and offset. On every
outermost branch the right-hand side must increase by the floor at least; those of these inequalities that would be
violated go into the program.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.identification.preprocessing.regressors import Rows
from dehyst.identification.regression.regression import AbstractRegression
from dehyst.identification.regression.regularization import regularization_rows
from dehyst.identification.solvers.program import Norm, Solution, solve
from dehyst.model.elements import parts_in_segments, segment_of
from dehyst.model.structure import Grid

_DRIVE_FLOOR = 0.2
_ROUNDS = 12
# Inequalities that one round adds at most, and how far [of the floor] one may be violated.
_ADDED = 40
_VIOLATED = 1e-6
# Of the creep before a record, what is less than this at its first sample that counts is nothing.
_FORGOTTEN = 0.01


Solver = Callable[[tuple[Array, Array] | None], Solution]


@dataclass(frozen=True, eq=False)
class WideCoefficients:
    """What a regression found.

    Attributes
    ----------
    stiffness : (N, M) array
        kappa_im [V/m].
    slopes : (K - 1,) array
        Of the spring [V/m].
    moved : (J + L,) array
        Stiffnesses of creep branches, then of smooth elements [V/m].
    drive : (T,) array
        Slopes of tau; empty without one.
    offsets, drifts : dict
        Constants by epoch and drifts by record [V of tau].
    starts : dict
        p_j (J,) by record [V of tau].
    solution : Solution
    """

    stiffness: Array
    slopes: Array
    moved: Array
    drive: Array
    offsets: dict[int, float]
    drifts: dict[int, float]
    solution: Solution
    starts: dict[int, Array] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class WideRegression(AbstractRegression[WideCoefficients]):
    """What is fixed while coefficients are sought; see `Regression`, whose place it takes.

    Attributes
    ----------
    rows : Rows
        With what moves along the path: creep strains, smooth elongations, then exp(-t/tau_j).
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
    lasting : (S J,) bool array, optional
        Starts of creep that are not forgotten before the first sample that counts; default: told from the rows.
    """

    rows: Rows
    grid: Grid
    floor: float
    datum: Array
    drifting: tuple[int, ...] = ()
    strained: tuple[int, ...] = ()
    smoothing: float = 0.0
    lasting: NDArray[np.bool_] | None = None

    def thinned(self, most: int) -> WideRegression:
        """The same on fewer rows."""
        return replace(self, rows=self.rows.thinned(most))

    def chosen(self, which: NDArray[np.bool_]) -> WideRegression:
        """The same on some of the rows."""
        return replace(self, rows=self.rows.chosen(which))

    @property
    def knots(self) -> Array:
        """Knots of the spring [m]."""
        return self.grid.knots

    @cached_property
    def carts(self) -> Array:
        """Positions of the movable carts (n, m) [m]."""
        return np.asarray(self.axis[:, None] - self.rows.elongation[:, self.grid.movable])

    @cached_property
    def bounded(self) -> Array:
        """Columns of the unknowns that are not negative (n, q): elements, spring, what moves, transformer, starts."""
        grades, n = self.grid.grades, len(self.rows)
        if self.grid.segments == 1:
            elements = self.rows.elongation[:, self.grid.movable]
        else:
            count = self.carts.shape[1]
            held = parts_in_segments(grades, self.carts.ravel()).reshape(n, count, self.grid.segments)
            elements = (parts_in_segments(grades, self.axis)[:, None, :] - held).reshape(n, count * self.grid.segments)
        moved = self.rows.moved[:, : self.grid.moved]
        spring = parts_in_segments(self.knots, self.axis)
        return np.hstack([elements, spring, moved, -self._drive_columns, self.start_columns, -self.start_columns])

    @property
    def start_columns(self) -> Array:
        """What is left of the creep before strained records, a block of branches a record (n, S J)."""
        fades = self.rows.moved[:, self.grid.moved :]
        blocks = [fades * (self.rows.record == q)[:, None] for q in self.strained]
        columns = np.hstack([np.zeros((len(fades), 0)), *blocks])
        # What was forgotten before the first sample that counts is no column.
        lasting = columns.max(axis=0, initial=0.0) >= _FORGOTTEN if self.lasting is None else self.lasting
        return np.where(lasting, columns, 0.0)

    @cached_property
    def _drive_parts(self) -> Array:
        """The part of each voltage in each segment of tau (n, T)."""
        knots = self.grid.drive
        return parts_in_segments(knots, self.rows.voltage) if knots.size else np.zeros((len(self.rows), 0))

    @property
    def _drive_columns(self) -> Array:
        """Changes of tau that leave its ends where they are: the last segment gives back what another one gets."""
        parts, lengths = self._drive_parts, np.diff(self.grid.drive)
        return parts[:, :-1] - parts[:, -1:] * (lengths[:-1] / lengths[-1]) if lengths.size else parts

    @cached_property
    def target(self) -> Array:
        """Right-hand side (n,) [V]: what the floors leave."""
        v, spring = self.rows.voltage, self.floor * parts_in_segments(self.knots, self.axis).sum(axis=1)
        knots = self.grid.drive
        if not knots.size:
            return np.asarray(v - spring)
        last = (1 - _DRIVE_FLOOR) * np.ptp(knots) / (knots[-1] - knots[-2]) * self._drive_parts[:, -1]
        return np.asarray(knots[0] + _DRIVE_FLOOR * (v - knots[0]) + last - spring)

    def fit(self, norm: Norm, weights: Array | None = None) -> WideCoefficients:
        """Solve the program, inequalities added round by round where they would be violated."""
        free, n = self.nuisances(), len(self.rows)
        given = np.ones(n) if weights is None else weights
        table = [free, self.bounded, self.target, given]
        if n >= max(free.shape[1], 1):
            alike = self.held_alike(norm, n, free.shape[1], 1.0 if weights is None else 1 / self.mean_slope)
            table = [np.concatenate(pair) for pair in zip(table, alike, strict=True)]
        *program, weight = table
        found = self.fitted(lambda limits: solve(*program, weights=weight, norm=norm, constraints=limits))
        return replace(found, solution=replace(found.solution, residual=found.solution.residual[:n]))

    def held_alike(self, norm: Norm, count: int, free: int, weight: float) -> tuple[Array, Array, Array, Array]:
        """Rows that hold neighbours alike, as a block of a table of `count` others: see `regularization`.

        `free` columns are not theirs, and `weight` is that of a row where the slope is the mean one. They weigh as much
        beside few samples as beside many. The largest residual is no matter of neighbours: for that there are none.
        """
        if not self.smoothing or norm == "linf":
            return np.zeros((0, free)), self.bounded[:0], np.zeros(0), np.zeros(0)
        rows = self._all_columns(regularization_rows(self.grid, self.mean_slope))
        p = len(rows)
        strength = self.smoothing * self.mean_slope * (np.sqrt(count) if norm == "l2" else count / np.sqrt(p))
        return np.zeros((p, free)), strength * rows, np.zeros(p), np.full(p, weight)

    @property
    def mean_slope(self) -> float:
        """Of voltage over displacement [V/m]."""
        return float(np.ptp(self.rows.voltage) / np.ptp(self.knots))

    def fitted(self, solved: Solver, epochs: NDArray[np.intp] | None = None) -> WideCoefficients:
        """What `solved` finds in the end; epochs as in `nuisances`."""
        return self.coefficients(self.settled(solved), epochs)

    def settled(self, solved: Solver) -> Solution:
        """The answer of `solved`, inequalities -> answer, when no other inequality is violated."""
        matrix, lower = self._inequalities()
        for _ in range(_ROUNDS):
            answer = solved((matrix, lower) if lower.size else None)
            more = self._violated(answer.nonnegative) if self.grid.segments > 1 and answer.optimal else matrix[:0]
            if not len(more):
                break
            matrix, lower = np.vstack([matrix, more]), np.append(lower, np.zeros(len(more)))
        return answer

    def slope(self, found: WideCoefficients) -> Array:
        """D tau(v)/dy of the model at each row (n,) [V/m], at the floor at least."""
        grid, y = self.grid, self.axis
        kappa = found.stiffness[grid.movable]
        slope = kappa.sum(axis=0)[segment_of(grid.grades, y)] + found.slopes[segment_of(self.knots, y)]
        sliding = ~self.rows.stuck[:, grid.movable]
        at = np.take_along_axis(kappa.T, segment_of(grid.grades, self.carts), axis=0)
        branches = grid.time_constants.size
        slope = slope - np.where(sliding, at, 0.0).sum(axis=1) + found.moved[:branches].sum()
        return np.asarray(np.maximum(slope + self._smooth_shares @ found.moved[branches:], self.floor))

    @property
    def _smooth_shares(self) -> Array:
        """Part of each smooth element that has not let go, dq/dy (n, L)."""
        lengths, closings = self.grid.lengths, self.grid.closings
        q = self.rows.moved[:, self.grid.time_constants.size : self.grid.moved]
        # The first slip element lets go soonest: it tells where the row is bound for.
        forward = np.sign(q * self.rows.elongation[:, :1])
        pulled = np.minimum(np.abs(q) / lengths, 1) if lengths.size else q
        return np.asarray(1 - pulled * (closings * forward + 1 - closings))

    def model(self, found: WideCoefficients) -> Array:
        """Right-hand side less tau(v) of each row (n,) [V], without constants and drifts: what they must make up."""
        known = np.concatenate([found.stiffness[self.grid.movable].ravel(), found.slopes, found.moved])
        tau = self.grid.drive[0] + self._drive_parts @ found.drive if found.drive.size else self.rows.voltage
        return np.asarray(self.bounded[:, : known.size] @ known - tau)

    def residual(self, found: WideCoefficients) -> Array:
        """What the equation of each row leaves [V], with the constants found; an epoch without one gets its median."""
        left = self.model(found)
        for q, drift in found.drifts.items():
            left += drift * np.where(self.rows.record == q, self.rows.drift, 0.0)
        for q, start in found.starts.items():
            left += (self.rows.moved[:, self.grid.moved :] @ start) * (self.rows.record == q)
        for epoch in np.unique(self.rows.epoch).tolist():
            own = self.rows.epoch == epoch
            left[own] += found.offsets.get(epoch, -float(np.median(left[own])))
        return left

    def nuisances_of(self, found: WideCoefficients) -> WideCoefficients:
        """Fit only the constants and drifts of these rows, for a model that is given."""
        fades = self.start_columns
        starts = np.hstack([fades, -fades])
        stiffness = np.tile(found.moved[: self.grid.time_constants.size], len(self.strained))
        limits = -np.hstack([np.eye(stiffness.size)] * 2), -float(np.ptp(self.knots)) * stiffness
        answer = solve(
            self.nuisances(),
            starts,
            -self.model(found),
            weights=1 / self.slope(found),
            norm="l2",
            constraints=limits if stiffness.size else None,
        )
        offsets, drifts = self.constants(answer)
        return replace(found, solution=answer, offsets=offsets, drifts=drifts, starts=self._starts(answer.nonnegative))

    def _inequalities(self) -> tuple[Array, Array]:
        """What the last segment of tau has left to give; starts of creep that a branch can hold."""
        grid, records, unknowns = self.grid, len(self.strained), self.bounded.shape[1]
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
        lower[: bool(lengths.size)] = -(1 - _DRIVE_FLOOR) * float(lengths.sum())
        return np.array(rows).reshape(-1, unknowns), lower

    def _violated(self, x: Array) -> Array:
        """The inequalities that x violates most."""
        rising = self.grid.outermost
        value = rising @ x[: rising.shape[1]]
        worst = np.argsort(value, kind="stable")[:_ADDED]
        return self._all_columns(rising[worst[value[worst] < -_VIOLATED * self.floor]])

    def _all_columns(self, rows: Array) -> Array:
        """Rows over the first unknowns, with nothing for the others."""
        return np.hstack([rows, np.zeros((len(rows), self.bounded.shape[1] - rows.shape[1]))])

    def coefficients(self, answer: Solution, epochs: NDArray[np.intp] | None = None) -> WideCoefficients:
        """An answer's coefficients; epochs as in `nuisances`."""
        x = answer.nonnegative
        starts = x[x.size - 2 * len(self.strained) * self.grid.time_constants.size :]
        offsets, drifts = self.constants(answer, epochs)
        return replace(self.at(x), offsets=offsets, drifts=drifts, solution=answer, starts=self._starts(starts))

    def at(self, x: Array) -> WideCoefficients:
        """The coefficients of the program's unknowns (q,) that are not negative, without constants and starts."""
        grid = self.grid
        count, segments, spring = int(np.count_nonzero(grid.movable)), grid.segments, grid.knots.size - 1
        stiffness = np.zeros((grid.movable.size, segments))
        stiffness[grid.movable] = x[: count * segments].reshape(count, segments)
        rest = x[count * segments :]
        lengths = np.diff(grid.drive)
        drive = rest[spring + grid.moved :][: max(lengths.size - 1, 0)]
        if lengths.size:
            left = max((1 - _DRIVE_FLOOR) * lengths.sum() - drive @ lengths[:-1], 0.0) / lengths[-1]
            drive = _DRIVE_FLOOR + np.append(drive, left)
        moved = rest[spring : spring + grid.moved]
        return WideCoefficients(stiffness, rest[:spring] + self.floor, moved, drive, {}, {}, None)  # type: ignore[arg-type]

    def unknowns(self, found: WideCoefficients) -> tuple[Array, ...]:
        """The program's unknowns that make coefficients, kind by kind: elements, spring, what moves, transformer."""
        elements = found.stiffness[self.grid.movable].ravel()
        return elements, found.slopes - self.floor, found.moved, found.drive[:-1] - _DRIVE_FLOOR

    def _starts(self, both: Array) -> dict[int, Array]:
        """By record, from what is added and what is taken away."""
        if not both.size:
            return {}
        plus, minus = both.reshape(2, len(self.strained), -1)
        return dict(zip(self.strained, plus - minus, strict=True))
