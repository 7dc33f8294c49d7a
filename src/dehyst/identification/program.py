"""The program: stiffnesses, slopes, and the numbers of `Motion`, in one non-negative least-squares problem.

    tau(v) = sum_im kappa_im [R_m(y) - R_m(b_i)] + sum_j slope_j R_j(y) + sum_l k_l q_l + s sum_p c_p m_p + a_e + rest

with y the path that drives the elements (`Motion`), R_m(z) the part of z in segment m with unbounded end segments, b_i
the position of cart i, q_l the elongation of smooth element l and a_e the constant of epoch e. m_p is the motion of the
path per unit of number c_p (`Part`), s the slope dv/dy of an earlier fit. All unknowns are >= 0, except the constants
and the numbers that may be negative; slope_j and the slopes of tau are >= a floor (Assumption I). tau does not change
the ends of the voltages, which fixes scale and offset. Rows are weighted by 1/s: residuals are lengths.

With graded elements the right-hand side must rise by the floor at least on every outermost branch. Only violated
inequalities enter the program.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import IdentifyError
from dehyst._types import Array
from dehyst.identification.motion import Part
from dehyst.identification.regressors import Rows
from dehyst.identification.solver import ActiveSet, NormalEquations
from dehyst.identification.structure import Grid
from dehyst.model import (
    Actuator,
    GradedSlip,
    MaxwellSlip,
    SmoothSlip,
    Spring,
    Transformer,
    parts_in_segments,
    segment_of,
)
from dehyst.records import rms

TRANSFORMER_FLOOR = 0.2
# A repair of a record must lower the RMS residual by this part of the stroke at least.
SMALLEST_GAIN = 1e-5
# Least voltage of a smooth element, as a part of the voltage's range; smaller ones are left out.
_NOTHING = 1e-9
# Largest numbers of rounds of inequalities, and of inequalities added in a round; allowed violation [of the floor].
_ROUNDS, _ADDED, _VIOLATED = 12, 40, 1e-6
# Ridge of the numbers of `Part`, relative to their columns.
_RIDGE = 0.02
# Number of rows whose columns fit into the cache of a processor.
_CACHED = 256
# Passes towards least absolute residuals; residuals below this part of the median have equal weights.
_REWEIGHTED, _LEAST_MISSED = 3, 0.1


@dataclass(frozen=True, eq=False)
class Solution:
    """The coefficients of a program.

    `stiffness` (N, M): kappa_im [V/m]; M = 1 for Maxwell-slip elements. `slopes` (K - 1,): slopes of the spring [V/m].
    `smooth` (L,): stiffnesses of smooth elements [V/m]. `transformer` (T,): slopes of tau; empty without one.
    `offsets`: constants by epoch [V of tau]. `numbers`: numbers of each part, by its name. `unknowns`: all unknowns, in
    the order of the program. `active_set`, `inequalities`: start for a similar program.
    """

    stiffness: Array
    slopes: Array
    smooth: Array
    transformer: Array
    offsets: dict[int, float]
    numbers: dict[str, Array]
    unknowns: Array
    active_set: ActiveSet
    inequalities: tuple[Array, Array]

    def to_actuator(self, grid: Grid, first: float, **others: Any) -> Actuator:
        """Return the actuator with these coefficients on a grid.

        Smooth elements without stiffness are left out. `first`: voltage of the spring at its first knot [V].
        `**others`: further arguments of `Actuator`.
        """
        mean_slope = float(self.slopes @ np.diff(grid.knots)) / float(np.ptp(grid.knots))
        kept = self.smooth > _NOTHING * mean_slope
        tau = grid.drive[:1] + np.concatenate([[0.0], np.cumsum(self.transformer * np.diff(grid.drive))])
        return Actuator(
            slip=GradedSlip(grid.breakaway, grid.grades, self.stiffness)
            if grid.graded
            else MaxwellSlip(grid.breakaway, self.stiffness[:, 0]),
            spring=Spring.of_slopes(grid.knots, self.slopes, first),
            transformer=Transformer(grid.drive, tau) if grid.drive.size else None,
            smooth=SmoothSlip(grid.lengths[kept], grid.closings[kept], self.smooth[kept]) if kept.any() else None,
            **others,
        )


@dataclass(frozen=True, eq=False)
class Program:
    """Rows of records, a grid of elements, and parts that move the path.

    Attributes
    ----------
    rows : Rows
    grid : Grid
    floor : float
        Least slope of the spring, and of every outermost branch [V/m].
    smoothing : float
        Weight of the differences of neighbouring unknowns.
    parts : tuple of Part
    near : Solution, optional
        Solution of a similar program. Rows are weighted by the inverse of its slope dv/dy, by default of the mean
        slope. It also determines how elements respond to a motion of the path.
    folds : int
        Number of parts of the rows that can be held out; `fold` (n,) is the part of each row.
    weights : (n,) array, optional
        Weights of the rows.
    toward : (q,) array, optional
        Static unknowns. The smoothing then acts on the differences from them, which are also kept small.
    """

    rows: Rows
    grid: Grid
    floor: float
    smoothing: float
    parts: tuple[Part, ...] = ()
    near: Solution | None = None
    folds: int = 1
    fold: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    weights: Array | None = None
    toward: Array | None = None

    def __len__(self) -> int:
        return len(self.rows)

    def with_static(self, rows: Rows, grid: Grid, smoothing: float) -> Program:
        """Return the program of the same samples, on another grid or with another smoothing.

        The weights and the moving parts stay; on the same grid, all sums stay.
        """
        other, same = replace(self, rows=rows, grid=grid, smoothing=smoothing), ["scale", "responses"]
        if grid is self.grid:
            same += ["target", "sums"]
        other.__dict__.update({name: getattr(self, name) for name in same})
        return other

    @cached_property
    def mean_slope(self) -> float:
        """Mean slope of voltage over displacement [V/m]."""
        return float(np.ptp(self.rows.voltage) / np.ptp(self.grid.knots))

    @cached_property
    def numbers(self) -> NDArray[np.intp]:
        """Numbers of the epochs that get a constant (E,)."""
        return np.unique(self.rows.epoch)

    @cached_property
    def carts(self) -> Array:
        """Positions of the movable carts (n, m) [m]."""
        return np.asarray(self.rows.displacement[:, None] - self.rows.elongation[:, self.grid.movable])

    @cached_property
    def _tau_parts(self) -> Array:
        """The part of each voltage in each segment of tau (n, T)."""
        knots = self.grid.drive
        return parts_in_segments(knots, self.rows.voltage) if knots.size else np.zeros((len(self.rows), 0))

    @cached_property
    def scale(self) -> Array:
        """Slope of each row (n,) [V/m]."""
        return np.full(len(self.rows), self.mean_slope) if self.near is None else self.slope(self.near)

    @property
    def _split(self) -> tuple[list[Part], list[Part]]:
        """Parts whose numbers are free, and those whose numbers are not negative."""
        return [p for p in self.parts if not p.bounded], [p for p in self.parts if p.bounded]

    @property
    def size(self) -> int:
        """Total number of columns."""
        bounded = sum(part.value.size for part in self._split[1])
        return int(self.free_columns.shape[1] + self.grid.places["transformer"].stop + bounded)

    def _write_static(self, out: Array, part: slice) -> None:
        """Write the columns of elements, spring, smooth elements and tau for some rows, in the order of `Grid.places`.

        `part`: slice of the rows. `out`: array (rows of the part, q) to write to.
        """
        grid, rows, places = self.grid, self.rows, self.grid.places
        y, elements = rows.displacement[part], out[:, places["elements"]]
        if grid.segments > 1:
            # One segment at a time, because an innermost loop over few numbers is slow.
            by_segment, ends = elements.reshape(y.size, -1, grid.segments), [-np.inf, *grid.grades[1:-1], np.inf]
            for k, (low, high) in enumerate(pairwise(ends)):
                held = np.clip(self.carts[part], low, high)
                np.subtract(np.clip(y, low, high)[:, None], held, out=by_segment[:, :, k])
        else:
            elements[:] = rows.elongation[part, grid.movable]
        out[:, places["spring"]] = parts_in_segments(grid.knots, y)
        out[:, places["smooth"]] = rows.moved[part]
        # The ends of tau are fixed: if one segment rises by a voltage, the last segment falls by it.
        tau, lengths = self._tau_parts[part], np.diff(grid.drive)
        if lengths.size:
            out[:, places["transformer"]] = tau[:, -1:] * (lengths[:-1] / lengths[-1]) - tau[:, :-1]

    def _weighted(self) -> Iterator[tuple[slice, Array]]:
        """Yield slices of rows that fit into the cache, with an array of all their weighted columns [m].

        The array (m, E + F + q) has the free columns first; the next slice overwrites it.
        """
        free, count = self.free_columns.shape[1], self.grid.places["transformer"].stop
        bounded = np.hstack([np.empty((len(self), 0)), *(self.responses[part.name] for part in self._split[1])])
        some = np.empty((_CACHED, self.size))
        for first in range(0, len(self), _CACHED):
            own, part = some[: len(self) - first], slice(first, first + _CACHED)
            own[:, :free], own[:, free + count :] = self.free_columns[part], bounded[part]
            self._write_static(own[:, free : free + count], part)
            own[:, free:] /= self.scale[part, None]
            yield part, own

    def static(self, unknowns: Array) -> Array:
        """Return the part of each row (n,) [m] that static unknowns (q,) explain, see `unknowns_of`."""
        found, free = np.empty(len(self)), self.free_columns.shape[1]
        for part, own in self._weighted():
            found[part] = own[:, free : free + unknowns.size] @ unknowns
        return found

    @cached_property
    def columns(self) -> tuple[Array, int]:
        """All weighted columns (n, E + F + q) [m], the free columns first; and the number of free columns."""
        return np.vstack([own.copy() for _, own in self._weighted()]), self.free_columns.shape[1]

    @cached_property
    def free_columns(self) -> Array:
        """Columns (n, E + F) of the constants, and of parts whose numbers are free, weighted [m]."""
        constants = (self.rows.epoch[:, None] == self.numbers).astype(np.float64)
        moving = [self.responses[part.name] for part in self._split[0]]
        return np.asarray(np.hstack([constants, *moving]) / self.scale[:, None])

    @cached_property
    def responses(self) -> dict[str, Array]:
        """Voltage changes (n, k) [V] of each row per unit of the numbers of parts, by the names of parts.

        While an element does not slide, its cart stands where the path last moved it: the force changes by the motion
        of the path since then.
        """
        moved = {part.name: part.columns for part in self.parts if not part.volts}
        found = {part.name: part.columns for part in self.parts if part.volts}
        if not moved or self.near is None:
            return found | moved
        near, grid = self.near, self.grid
        columns = np.hstack(list(moved.values()))
        spring, own, carts = self._segments
        kappa = near.stiffness[grid.movable]
        volts = (near.slopes[spring] + kappa.sum(axis=0)[own])[:, None] * columns
        stuck, number = self.rows.stuck[:, grid.movable], np.arange(len(self.rows))
        first = np.searchsorted(self.rows.epoch, self.rows.epoch)
        since = np.maximum.accumulate(np.where(stuck, first[:, None], number[:, None]), axis=0)
        for i, row in enumerate(kappa):
            volts -= row[carts[:, i]][:, None] * columns[since[:, i]]
        if near.smooth.size:
            shares = self._shares @ near.smooth
            volts += shares[:, None] * (columns - columns[since[:, 0]] if len(kappa) else columns)
        ends = np.cumsum([block.shape[1] for block in moved.values()])[:-1]
        return found | dict(zip(moved, np.split(volts, ends, axis=1), strict=True))

    @cached_property
    def target(self) -> Array:
        """Right-hand side (n,), weighted [m]."""
        v, knots, y = self.rows.voltage, self.grid.drive, self.rows.displacement
        spring = self.floor * (y - self.grid.knots[0])
        left = v - spring
        if knots.size:
            last = (1 - TRANSFORMER_FLOOR) * np.ptp(knots) / (knots[-1] - knots[-2]) * self._tau_parts[:, -1]
            left = knots[0] + TRANSFORMER_FLOOR * (v - knots[0]) + last - spring
        moved = sum(self.responses[part.name] @ part.value for part in self.parts)
        return np.asarray((left + moved) / self.scale)

    @cached_property
    def regularization(self) -> Array:
        """Gram matrix (E + F + q, E + F + q) of the smoothing, for a weight of one row of data."""
        free, alike, (moving, held) = self.free_columns.shape[1], _alike(self.grid), self._split
        static = slice(free, free + len(alike))
        whole = np.zeros((self.size, self.size))
        whole[static, static] = (self.smoothing / self.mean_slope) ** 2 * alike
        if self.toward is not None:  # Differences do not limit a common change, nor smooth elements.
            squares = sum(np.diag(sums.gram)[static] for sums in self.sums) / len(self)
            whole[static, static] += np.diag(self.smoothing**2 * squares)
        first = self.numbers.size
        for part in (*moving, *held):
            if part is (held[0] if held else None):
                first = static.stop
            own = slice(first, first + part.value.size)
            if part.ridge.size:
                ridge = _RIDGE * rms(part.columns) / (self.mean_slope if part.volts else 1.0) * part.ridge
                whole[own, own] = ridge.T @ ridge
            first += part.value.size
        return whole

    @cached_property
    def sums(self) -> list[NormalEquations]:
        """Weighted sums of the rows of each fold."""
        found = [NormalEquations.none(self.size, self.free_columns.shape[1]) for _ in range(self.folds)]
        fold = self.fold if self.fold.size else np.zeros(len(self), dtype=np.intp)
        for part, own in self._weighted():
            goal, number = self.target[part], fold[part]
            if self.weights is not None:
                goal = goal * self.weights[part]
                np.multiply(own, self.weights[part, None], out=own)
            for k in np.unique(number).tolist():
                rows = slice(None) if np.all(number == k) else number == k
                found[k] = found[k].with_rows(own[rows], goal[rows])
        return [sums.whole for sums in found]

    def solved(self, like: Solution | None = None, *, without: int | None = None) -> Solution:
        """Return the least-squares solution, of all rows or `without` a fold; `like`: solution of a similar program."""
        total, count = sum(self.sums[1:], self.sums[0]), len(self.rows)
        if without is not None:
            total, count = total - self.sums[without], int(np.count_nonzero(self.fold != without))
        return self._solve(total, count, like)

    def reweighted(self, like: Solution) -> tuple[Program, Solution]:
        """Return the program with smaller weights for larger residuals, near least absolute ones, and its solution."""
        program, found = self, like
        for _ in range(_REWEIGHTED):
            missed = np.abs(program.residual(found))
            program = replace(self, weights=np.sqrt(1 / np.maximum(missed / np.median(missed), _LEAST_MISSED)))
            program.__dict__.update({name: getattr(self, name) for name in ("scale", "responses", "target")})
            found = program.solved(found)
        return program, found

    def unknowns_of(self, model: Solution) -> Array:
        """Return the unknowns (q,) of elements, spring, smooth elements and tau of a model."""
        stiffness, tau = model.stiffness[self.grid.movable].ravel(), model.transformer[:-1] - TRANSFORMER_FLOOR
        return np.concatenate([stiffness, model.slopes - self.floor, model.smooth, tau])

    def residual(self, found: Solution) -> Array:
        """Return the residual of a solution at each row (n,) [m], its sign reversed."""
        missed = -self.target
        for part, own in self._weighted():
            missed[part] += own @ found.unknowns
        return missed

    def step(self, found: Solution) -> float:
        """Return the standard deviation [m] of the motion of the path by the parts of a solution."""
        volts = sum(self.responses[part.name] @ (found.numbers[part.name] - part.value) for part in self.parts)
        return float(np.std(volts / self.scale))

    def _solve(self, sums: NormalEquations, count: int, like: Solution | None) -> Solution:
        """Solve sums of `count` rows; each round adds the violated inequalities."""
        image = sums.image
        if self.toward is not None:
            image = image + count * self.regularization[:, sums.free : sums.free + self.toward.size] @ self.toward
        program = replace(sums, gram=sums.gram + count * self.regularization, image=image)
        size, free = program.image.size, program.free
        start, limits = ActiveSet(np.ones(size, dtype=bool), np.zeros(0, dtype=bool)), self._limits(size, free)
        if like is not None and like.unknowns.size == size:
            start, limits = like.active_set, like.inequalities
        x = np.zeros(size)
        for _ in range(_ROUNDS):
            try:
                x, start = program.minimum(limits, start)
            except IdentifyError:
                # Zero meets every inequality, so that the failure is rounding: no such model follows the record.
                break
            more = np.zeros((0, size))
            if self.grid.segments > 1:
                rising = self.grid.outermost
                value = rising @ x[free : free + rising.shape[1]]
                worst = np.argsort(value, kind="stable")[:_ADDED]
                worst = worst[value[worst] < -_VIOLATED * self.floor]
                more = np.zeros((worst.size, size))
                more[:, free : free + rising.shape[1]] = rising[worst]
            if not len(more):
                break
            limits = np.vstack([limits[0], more]), np.append(limits[1], np.zeros(len(more)))
        return self._named(self._rising(x, free), start, limits)

    def _rising(self, x: Array, free: int) -> Array:
        """Return the unknowns with the stiffnesses of all elements reduced until every outermost branch rises."""
        if self.grid.segments == 1:
            return x
        rising, count = self.grid.outermost, self.grid.places["elements"].stop
        elements = rising[:, :count] @ x[free : free + count]
        spring = rising[:, count:] @ x[free + count : free + rising.shape[1]]
        falls = elements + spring < -_VIOLATED * self.floor
        if falls.any():
            x = x.copy()
            x[free : free + count] *= float(np.min(spring[falls] / -elements[falls]))
        return x

    def _limits(self, size: int, free: int) -> tuple[Array, Array]:
        """Return the inequality of the last segment of tau."""
        lengths, place = np.diff(self.grid.drive), self.grid.places["transformer"]
        matrix = np.zeros((int(lengths.size > 0), size))
        if not lengths.size:
            return matrix, np.zeros(0)
        matrix[0, free + place.start : free + place.stop] = -lengths[:-1]
        return matrix, np.array([-(1 - TRANSFORMER_FLOOR) * float(lengths.sum())])

    def _named(self, x: Array, active_set: Any, limits: tuple[Array, Array]) -> Solution:
        """Return the solution of the unknowns (E + F + q,)."""
        grid, (free, bounded) = self.grid, self._split
        first = self.numbers.size
        numbers = {}
        for part in free:
            numbers[part.name] = x[first : first + part.value.size]
            first += part.value.size
        places = {kind: slice(first + p.start, first + p.stop) for kind, p in grid.places.items()}
        last = places["transformer"].stop
        for part in bounded:
            numbers[part.name] = x[last : last + part.value.size]
            last += part.value.size
        stiffness = np.zeros((grid.movable.size, grid.segments))
        stiffness[grid.movable] = x[places["elements"]].reshape(-1, grid.segments)
        tau, lengths = x[places["transformer"]], np.diff(grid.drive)
        if lengths.size:
            left = max((1 - TRANSFORMER_FLOOR) * lengths.sum() - tau @ lengths[:-1], 0.0) / lengths[-1]
            tau = TRANSFORMER_FLOOR + np.append(tau, left)
        offsets = dict(zip(self.numbers.tolist(), x[: self.numbers.size].tolist(), strict=True))
        slopes, smooth = x[places["spring"]] + self.floor, x[places["smooth"]]
        return Solution(stiffness, slopes, smooth, tau, offsets, numbers, x, active_set, limits)

    @cached_property
    def _segments(self) -> tuple[NDArray[np.intp], ...]:
        """Segments of the spring (n,) and grades (n,) at the displacements; grades at the movable carts (n, m)."""
        y, grades = self.rows.displacement, self.grid.grades
        return segment_of(self.grid.knots, y), segment_of(grades, y), segment_of(grades, self.carts)

    def slope(self, found: Solution) -> Array:
        """Return d tau(v)/dy of a solution at each row (n,) [V/m], at the floor at least."""
        grid = self.grid
        spring, own, carts = self._segments
        kappa = found.stiffness[grid.movable]
        sliding = ~self.rows.stuck[:, grid.movable]
        at = np.take_along_axis(kappa.T, carts, axis=0)
        slope = kappa.sum(axis=0)[own] - np.where(sliding, at, 0.0).sum(axis=1) + found.slopes[spring]
        smooth = self._shares @ found.smooth
        return np.asarray(np.maximum(slope + smooth, self.floor))

    @property
    def _shares(self) -> Array:
        """The part of each smooth element that has not yielded at each row, dq/dy (n, L)."""
        grid, q = self.grid, self.rows.moved
        # The first slip element slides soonest: its elongation shows the direction of motion.
        forward = np.sign(q * self.rows.elongation[:, :1])
        return np.asarray(1 - np.minimum(np.abs(q) / grid.lengths, 1) * (grid.closings * forward + 1 - grid.closings))


def _alike(grid: Grid) -> Array:
    """Return the Gram matrix (q, q) [m2] of differences between neighbours, in the order of `Grid.places`.

    ``rho_i sqrt(M) (kappa_i,m+1 - kappa_im)`` along the stroke, ``rho_i drho_i+1 (kappa_i+1,m / drho_i+1 - kappa_im /
    drho_i)`` from one threshold to the next, and second differences of the slopes of the spring and of tau over a
    segment. The differences of tau are in volts; the mean slope converts them to metres.
    """
    rho, segments, places = grid.breakaway[grid.movable], grid.segments, grid.places
    along = np.diff(np.eye(segments), axis=0) * np.sqrt(segments)
    steps = np.diff(np.diag(1 / np.diff(rho, prepend=0.0)), axis=0) * (rho[:-1] * np.diff(rho))[:, None]
    whole = np.zeros((places["transformer"].stop,) * 2)
    whole[places["elements"], places["elements"]] = np.kron(np.diag(rho**2), along.T @ along)
    whole[places["elements"], places["elements"]] += np.kron(steps.T @ steps, np.eye(segments))
    for kind, knots in (("spring", grid.knots), ("transformer", grid.drive)):
        count = places[kind].stop - places[kind].start
        if count:
            bends = np.diff(np.eye(count), n=2, axis=0) * (float(np.ptp(knots)) / (knots.size - 1))
            whole[places[kind], places[kind]] = bends.T @ bends
    return whole


def with_folds(program: Program, fold: Sequence[int] | NDArray[np.intp]) -> Program:
    """Return the program with the fold of each row (n,)."""
    numbers = np.asarray(fold, dtype=np.intp)
    return replace(program, fold=numbers, folds=int(numbers.max(initial=0)) + 1)
