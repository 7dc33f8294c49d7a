"""What all structures of one identification share, and the regression of a structure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from dehyst._types import Array
from dehyst.identification.preprocessing.cleaning import cycle_time
from dehyst.identification.preprocessing.denoising import left_of, significant_delay
from dehyst.identification.preprocessing.preparation import Prepared
from dehyst.identification.preprocessing.regressors import RowSource
from dehyst.identification.regression.coefficients import Coefficients
from dehyst.identification.regression.fold_sums import training_errors
from dehyst.identification.regression.nuisances import worthwhile
from dehyst.identification.regression.regression import Regression
from dehyst.identification.rules import RULES
from dehyst.identification.settings import Deadline
from dehyst.identification.structure import Grid, Structure
from dehyst.model import Actuator, DisplacementCreep, Dynamics
from dehyst.records import Record, bandwidth, resolution, turning_points

# Rows for a trial, and for the final program.
FEW_ROWS, _MOST_ROWS = 4000, 30_000
# The speed of a voltage is that over a few samples, which noise hardly changes.
FEW_STEPS = 3
# Structures that show how records drift, whether a record began at rest, and whether the stage has inertia.
_DRIFTING = Structure(elements=20, grades=4)
_CREEPING = Structure(elements=20, transformer=20, grades=4, creep=9)
_SWINGING = Structure(elements=20, grades=3, transformer=10, smooth=True)
# Masses [samples squared] that are tried before inertia is searched, and evaluations of the error in that search.
_ROOTS, _EVALUATIONS = (0.7, 1.5, 3.0, 6.0), 90


@dataclass(frozen=True)
class Lagging:
    """How the displacement lags the voltage: `delay` and `lag`, time constant of the amplifier [s], and `dynamics`."""

    delay: float = 0.0
    lag: float = 0.0
    dynamics: Dynamics | None = None


def dynamics_of(damping: float, mass: float) -> Dynamics:
    """Return the dynamics of w(t - delay) = y + damping y' + mass y'', w being the output of the hysteresis.

    `damping`: 2 zeta / omega [s]. `mass`: 1 / omega^2 [s2].
    """
    omega = 1 / np.sqrt(mass)
    return Dynamics(float(omega), float(0.5 * damping * omega))


def find_dynamics(error: Callable[[Lagging], float], delay: float, sample_time: float, fastest: float) -> Lagging:
    """Minimise the RMS residual over delay, damping and mass; without mass if the gain is small.

    `error`: lagging -> RMS residual [m] of a fit of few rows. `delay`: delay without inertia [s]: the start of the
    search. `sample_time`: [s]. `fastest`: least duration of a cycle of the excitation [s].
    """
    from scipy.optimize import minimize

    # Dynamics slower than a tenth of the fastest cycle would show as a resonance in it; dynamics faster than the
    # sampling have no effect.
    scale = max(sample_time, 0.02 * fastest)

    def lagging_at(x: Array) -> Lagging:
        late, damping, root = np.abs(x) * scale
        mass = float(root**2)
        return Lagging(float(late), 0.0, dynamics_of(float(damping), mass) if mass else None)

    none = Lagging(delay)
    cost, start = error(none), delay / scale
    simplex = np.array([[start, 0.1, 0.5], [start, 0.1, 1.5], [0.5 * start, 0.3, 1.0], [start + 0.3, 0.0, 0.8]])
    options: Any = {"maxfev": _EVALUATIONS, "initial_simplex": simplex, "xatol": 1e-3, "fatol": 0}
    least: Any = minimize
    optimum = least(lambda x: error(lagging_at(x)), simplex[0], method="Nelder-Mead", options=options)
    if optimum.fun >= RULES.inertia_gain * cost:
        return none
    best = lagging_at(optimum.x)
    return replace(best, delay=significant_delay(best.delay, sample_time))


@dataclass(frozen=True, eq=False)
class TrainingData:
    """Data shared by all structures of one identification.

    Attributes
    ----------
    training : sequence of Prepared
    lagging : Lagging
    span, voltages : (float, float)
        Lowest and highest displacement [m] of the widest loop, and voltage [V] of all records.
    floor : float
        Least slope [V/m].
    datum : (records,) array
        [m].
    widest : int
        Record whose last constant is the spring's.
    can_drift : tuple of int
        Records that may creep by a logarithm of time since their start, where no branches account for creep.
    denoised : bool
        Whether the sensor's noise is taken out of the path that drives the elements.
    creepless : bool
        Whether creep was found not to predict: records may drift instead.
    """

    training: Sequence[Prepared]
    lagging: Lagging
    span: tuple[float, float]
    voltages: tuple[float, float]
    floor: float
    datum: Array
    widest: int = 0
    can_drift: tuple[int, ...] = ()
    denoised: bool = True
    creepless: bool = False

    @property
    def stroke(self) -> float:
        """Range of the widest loop [m]."""
        return self.span[1] - self.span[0]

    @property
    def times(self) -> tuple[float, float]:
        """Shortest sample time and longest record [s]."""
        records = [item.record for item in self.training]
        return min(one.sample_time for one in records), max(float(np.ptp(one.time)) for one in records)

    def regression(self, structure: Structure, most: int = _MOST_ROWS) -> Regression:
        """Return the regression of all records under a structure, of about `most` rows."""
        strained, drifting = (self.strained, ()) if structure.creep else ((), self.drifting)
        return replace(self._rows_of(structure, most), strained=strained, drifting=drifting)

    def _rows_of(self, structure: Structure, most: int) -> Regression:
        grid = structure.grid(self.span, self.voltages, (self.fastest_creep, self.times[1]))
        # No drift where creep branches are there for that: its curves take room.
        drifts = bool(self.can_drift) and not self.supports_creep()
        return self.on_grid(grid, most, smoothing=structure.smoothing, drifts=drifts)

    def on_grid(self, grid: Grid, most: int, *, smoothing: float = 0.0, drifts: bool = True) -> Regression:
        """Return the regression of all records on a grid, of about `most` rows."""
        source = self._source(grid, drifts)
        ranges = source.numbered() if grid.reaches_beyond else ()
        return Regression(source.thinned(most), grid, self.floor, self.datum, smoothing=smoothing, ranges=ranges)

    def _source(self, grid: Grid, drifts: bool) -> RowSource:
        """Return all rows of all records on a grid."""
        curves = [
            self.training[q].drift_curve(path) if drifts else np.broadcast_to(0.0, len(path)) for q, path in self._paths
        ]
        pieces = [(q, path, curve) for (q, path), curve in zip(self._paths, curves, strict=True)]
        # Where a record is loud all are denoised, and nothing of its noise is left.
        noise = [left_of(self.training[q].noise, self.stroke) for q, _ in self._paths]
        return RowSource.of(pieces, grid, noise, leads=[item.lead for item in self.training])

    @cached_property
    def _paths(self) -> list[tuple[int, Record]]:
        """Record number and path that drives the elements of each piece of all records."""
        at = self.lagging
        every = (
            item.driving(at.delay, at.lag, at.dynamics, self.stroke) if self.denoised else item.acting(at.delay, at.lag)
            for item in self.training
        )
        return [(q, path) for q, paths in enumerate(every) for path in paths]

    def without_creep(self, part: DisplacementCreep) -> TrainingData:
        """Return the records before creep in displacement: they creep no more."""
        training = [item.without_creep(part) for item in self.training]
        low, high = training[self.widest].span()
        floor, datum = self.floor * self.stroke / (high - low), self.datum / part.at_rest
        return replace(self, training=training, span=(low, high), floor=floor, datum=datum, creepless=True)

    def grows(self) -> bool:
        """Whether most samples of a record come before its range is at its widest."""
        source = self._source(Grid.maxwell_slip(np.array([self.stroke]), np.array(self.span)), drifts=False)
        last = sum(own[-1].stop - own[-1].start for own in source.epochs if own)
        return last < RULES.growing * sum(len(path) for _, path in self._paths)

    def with_inertia(self, deadline: Deadline | None = None) -> TrainingData:
        """Return a copy with estimated delay, damping and inertia, where they are significant.

        The search is left when the deadline passes.
        """
        step, cycle = self.times[0], min(cycle_time(item.record) for item in self.training)
        # Events are too few to show how a resonance swings.
        events = any(item.record.measured is not None for item in self.training)
        if events or cycle > RULES.slowest_cycle * step:
            return self
        training_error = training_errors()

        def error(lagging: Lagging) -> float:
            if deadline is not None:
                deadline.check()
            return training_error(replace(self, lagging=lagging)._rows_of(_SWINGING, FEW_ROWS // 2))

        without = error(self.lagging)
        masses = [replace(self.lagging, dynamics=dynamics_of(0.0, (root * step) ** 2)) for root in _ROOTS]
        if min(error(one) for one in masses) > RULES.mass_gain * without:
            return self
        found = find_dynamics(error, self.lagging.delay, step, cycle)
        if found.dynamics is None:
            return self
        # Where no voltage has energy at a resonance, noise is what is fitted.
        resonance = found.dynamics.frequency / (2 * np.pi)
        pieces = [piece for item in self.training for piece in item.pieces]
        highest = max(bandwidth(piece.voltage, piece.sample_time, RULES.excited) for piece in pieces)
        return replace(self, lagging=found) if highest > 0.5 * resonance else self

    @cached_property
    def drifting(self) -> tuple[int, ...]:
        """Records that drift, seen from Maxwell-slip elements; none if branches account for creep."""
        if self.supports_creep():
            return ()
        few, error = self._rows_of(Structure(), FEW_ROWS), training_errors()
        return worthwhile(lambda drifting: error(replace(few, drifting=drifting)), self.can_drift, self.stroke)

    def drifts_steadily(self) -> bool:
        """Whether a drift in proportion to time explains the records better than one by its logarithm."""
        if not self.can_drift:
            return False
        lines = replace(self, training=[replace(item, steady=True) for item in self.training])
        error, grid = training_errors(), _DRIFTING.grid(self.span, self.voltages, self.times)
        by_logarithm, by_time = (
            error(replace(one.on_grid(grid, FEW_ROWS), drifting=self.can_drift)) for one in (self, lines)
        )
        return by_time < RULES.steady_drift_gain * by_logarithm

    @cached_property
    def strained(self) -> tuple[int, ...]:
        """Records that creep as if they had not been at rest as they began, where that explains much."""
        regression, error = self._rows_of(_CREEPING, FEW_ROWS), training_errors()
        kept: tuple[int, ...] = ()
        cost = error(regression)
        alone = [error(replace(regression, strained=(q,))) for q in range(len(self.training))]
        # The one that explains most first, or a record at rest would be given what another one needs.
        for q in np.argsort(alone, kind="stable").tolist():
            trial = error(replace(regression, strained=(*kept, q)))
            if trial < RULES.creep_at_start_gain * cost:
                kept, cost = (*kept, q), trial
        return tuple(sorted(kept))

    def supports_creep(self) -> bool:
        """Whether there are legs alike at different speeds, or a hold: else creep looks like hysteresis."""
        if self.creepless:
            return False
        return _has_two_speeds(self.training) or any(
            longest > needed for longest, needed in map(longest_standstill, self.training)
        )

    @property
    def fastest_creep(self) -> float:
        """Sample time [s] by which creep branches are laid out: none follows within a twentieth of a cycle.

        What follows sooner is a lag. The cycle is one of full height at the greatest speed in the records.
        """
        span, step = self.voltages[1] - self.voltages[0], self.times[0]
        speed = max(_fastest(piece) for item in self.training for piece in item.pieces)
        return max(step, RULES.slowest_lag * 2 * span / speed / FEW_STEPS) if speed else step

    def followed_at_once(self, shares: Array, time_constants: Array) -> float:
        """Return the part of a step that creep adds within a twentieth of a cycle, where that is a low-pass; else 0.

        `shares` (K,): what each branch adds, as parts of the step. `time_constants` (K,): [s].
        """
        followed = float(shares @ -np.expm1(-self.fastest_creep * FEW_STEPS / time_constants))
        return followed if followed > RULES.creep_at_once else 0.0

    def actuator_of(self, regression: Regression, found: Coefficients) -> Actuator:
        """Return the actuator of coefficients, without limits and name."""
        rows, at = regression.rows, self.lagging
        reference = int(rows.epoch[rows.record == self.widest].max())
        return found.to_actuator(
            regression.grid, found.offsets[reference], dynamics=at.dynamics, delay=at.delay, lag=at.lag
        )


def _has_two_speeds(records: Sequence[Prepared]) -> bool:
    """Whether legs of the voltage that are alike in height differ in their speed |dv/dt|, not only in duration."""
    least = RULES.least_leg * max(float(np.ptp(item.record.voltage)) for item in records)
    legs = []
    for piece in (piece for item in records for piece in item.pieces):
        turns = turning_points(piece.voltage, 0.2 * least)
        height, seconds = np.abs(np.diff(piece.voltage[turns])), np.diff(piece.time[turns])
        high = height > least
        if piece.counted is not None:
            # No leg with a step.
            high &= np.diff(np.cumsum(~piece.counted)[turns]) == 0
        legs.append((height[high], height[high] / seconds[high]))
    height, speed = (np.concatenate(column) for column in zip(*legs, strict=True))
    alike = height <= RULES.legs_alike * height[:, None]
    alike &= alike.T
    return bool(np.any(alike & (speed > RULES.speed_ratio * speed[:, None])))


def _fastest(piece: Record) -> float:
    """Return the greatest speed of the voltage over a few samples that count [V/s]."""
    change = np.abs(piece.voltage[FEW_STEPS:] - piece.voltage[:-FEW_STEPS])
    if piece.counted is not None:
        aside = np.cumsum(~piece.counted)
        change = change[aside[FEW_STEPS:] == aside[:-FEW_STEPS]]
    return float(change.max(initial=0.0)) / (FEW_STEPS * piece.sample_time)


def longest_standstill(item: Prepared) -> tuple[float, float]:
    """Return how long the voltage stands still at most, and the least hold that shows creep [s].

    That is as long as a leg lasts, or a tenth of the record.
    """
    v, record = item.record.voltage, item.record
    turns = turning_points(v, 0.02 * float(np.ptp(v)))
    leg = cycle_time(record) / 2 if len(turns) > 1 else float(np.ptp(record.time))
    needed = min(leg, 0.1 * float(np.ptp(record.time)))
    # A coarse voltage stands still wherever it moves by less than one of its steps.
    if resolution(v)[1] > RULES.coarse_voltage:
        return 0.0, needed
    still = np.abs(np.diff(v)) < 1e-3 * RULES.hold_span * np.ptp(v)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    longest = int(np.diff(edges)[::2].max(initial=0))
    return (float(longest * record.sample_time) if longest > 1 else 0.0), needed
