"""Records to the regression of a structure, and the structure that they support."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dehyst._types import Array
from dehyst.identification.deadline import Deadline
from dehyst.identification.dynamics_search import SensedDynamics, find_dynamics
from dehyst.identification.preprocessing.cleaning import cycle_time
from dehyst.identification.preprocessing.denoising import remove_jitter
from dehyst.identification.preprocessing.dynamics import remove_dynamics
from dehyst.identification.preprocessing.internal_states import InternalStates
from dehyst.identification.preprocessing.preparation import Prepared
from dehyst.identification.preprocessing.regressors import RowSource
from dehyst.identification.regression.coefficients import Coefficients
from dehyst.identification.regression.fold_sums import (
    FoldSums,
    TrainingErrors,
    first_weights,
    held_out_error,
    nearly_least_absolute,
)
from dehyst.identification.regression.nuisances import worthwhile
from dehyst.identification.regression.regression import Regression
from dehyst.identification.regression.streaming import Stream
from dehyst.identification.solvers.program import Norm
from dehyst.identification.structure_selection import StructureTrial, select
from dehyst.model import Actuator, Structure
from dehyst.model.structure import Grid
from dehyst.records import Record
from dehyst.records.signals import energy_share, resolution, turning_points

# Rows for a trial, and for the final program.
_FEW_ROWS = 4000
_MOST_ROWS = 30_000
# Cycles of which the slowest lasts this many times the fastest distinguish creep from hysteresis; a hold of a cycle
# does, too.
_SPEEDS = 3.0
_HELD = 0.005
# Steps of a voltage, as a part of its range, that are too coarse for a hold to be one, and for a model to be ready.
COARSE = 0.002
# The structure that shows how records drift, and by how much a straight line must lower the RMS residual.
_DRIFTING = Structure(elements=20, grades=4)
_WORTH_OF_LINE = 0.97
# Least part of the voltage's energy above half the frequency of a resonance.
_EXCITED = 1e-7
# The structure that shows whether a record began at rest, and by how much that must lower the RMS residual.
_CREEPING = Structure(elements=20, transformer=20, grades=4, creep=9)
_WORTH_OF_START = 0.9
# Inertia shows in cycles of fewer samples than this; masses [samples squared] that are tried before it is looked for.
_SLOWEST = 1000.0
_ROOTS = (0.7, 1.5, 3.0, 6.0)
_WORTH_OF_MASS = 0.95
_SWINGING = Structure(elements=20, grades=3, transformer=10, smooth=True)
# Records of which a smaller part has its widest range grow: their constants are tied, and longer elements tried.
_GROWING = 0.5
# A delay is a false one if without it held-out cycles are missed by this part only.
_TRAILING = replace(_SWINGING, creep=9)
_FALSE_DELAY = 0.5
# The structure without any part that moves in time, and the least ratio of its errors without a delay and with it.
_PROMPT, _WORTH_OF_DELAY = Structure(elements=40, spacing=2.0, grades=8, knots=41, transformer=20), 1.05


@dataclass(frozen=True, eq=False)
class TrainingData:
    """What all structures of one identification share.

    Attributes
    ----------
    training : sequence of Prepared
    inertia : SensedDynamics
        Delay, and how the displacement lags behind what hysteresis makes.
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
    inertia: SensedDynamics
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
        """Return the rows of all records under a structure, thinned to about `most`."""
        return self.stream(structure, most).regression

    def stream(self, structure: Structure, most: int = _MOST_ROWS) -> Stream:
        """All rows of all records under a structure, about `most` of them in memory."""
        found = self._stream_of(structure, most)
        strained, drifting = (self.strained, ()) if structure.creep else ((), self.drifting)
        return replace(found, regression=replace(found.regression, strained=strained, drifting=drifting))

    def fit(self, structure: Structure, norm: Norm) -> tuple[Regression, Coefficients]:
        """Solve the program of all rows; return the regression of those in memory beside its answer."""
        stream = self.stream(structure)
        regression = stream.regression
        if not stream.whole:
            return regression, stream.fit_weighted(norm)
        weights = FoldSums(regression, first_weights(regression), folds=1).inverse_slopes
        return regression, regression.fit(norm, weights, like=nearly_least_absolute(regression, weights))

    def _rows_of(self, structure: Structure, most: int) -> Regression:
        return self._stream_of(structure, most).regression

    def _stream_of(self, structure: Structure, most: int) -> Stream:
        grid = structure.grid(self.span, self.voltages, self.times)
        # No drift where creep branches are there for that: its curves take room.
        drifts = bool(self.can_drift) and not self.supports_creep()
        return self.on_grid(grid, most, smoothing=structure.smoothing, drifts=drifts)

    def on_grid(self, grid: Grid, most: int, *, smoothing: float = 0.0, drifts: bool = True) -> Stream:
        """Return all rows of all records on a grid, about `most` of them in memory: the only maker of rows."""
        pieces = [
            (q, path, self.training[q].drift_curve(path) if drifts else np.broadcast_to(0.0, len(path)))
            for q, path in self._paths
        ]
        noise = [self.training[q].noise for q, _, _ in pieces]

        def internal(number: int, piece: Record) -> InternalStates:
            return InternalStates(grid, piece, self.training[number].lead)

        source = RowSource.of(pieces, grid.breakaway, noise, moved=internal)
        rows = source.thinned(most)
        ranges = source.ranges() if grid.reaches_beyond else ()
        regression = Regression(rows, grid, self.floor, self.datum, smoothing=smoothing, ranges=ranges)
        return Stream(source, regression)

    @cached_property
    def _paths(self) -> list[tuple[int, Record]]:
        """Record number and path that drives the elements of each piece of all records."""
        delay, lag, stroke = self.inertia.delay, self.inertia.lag, self.stroke
        paths = [(q, piece) for q, item in enumerate(self.training) for piece in item.acting(delay, lag)]
        if not self.denoised:
            return paths
        dynamics = self.inertia.dynamics
        return [
            (q, remove_jitter(remove_dynamics(path, dynamics), self.training[q].noise, stroke)) for q, path in paths
        ]

    def grows(self) -> bool:
        """Whether most samples of a record come before its range is at its widest."""
        source = self.on_grid(Grid.plain(np.array([self.stroke]), np.array(self.span)), 1).source
        last = sum(own[-1].stop - own[-1].start for own in source.epochs if own)
        return last < _GROWING * sum(len(piece) for _, piece, _ in source.pieces)

    def with_checked_delay(self, structure: Structure | None = None) -> TrainingData:
        """Return the same without a delay, if held-out cycles are then missed by far less.

        Where an actuator creeps fast or friction yields gradually the displacement trails behind at every turn: a
        delay, for plain elements. A true delay fast creep can imitate, but not so much better.
        """
        if not self.inertia.delay:
            return self
        without = replace(self, inertia=replace(self.inertia, delay=0.0))
        late, prompt = (held_out_error(one._rows_of(structure or _TRAILING, _FEW_ROWS)) for one in (self, without))
        if prompt < _FALSE_DELAY * late:
            return without
        # Nothing in graded elements can imitate a delay: if they need none, plain ones only bent to their misfit.
        late, prompt = (held_out_error(one._rows_of(_PROMPT, _FEW_ROWS)) for one in (self, without))
        return without if prompt < _WORTH_OF_DELAY * late else self

    def with_inertia(self, deadline: Deadline | None = None) -> TrainingData:
        """Return the same with the delay, damping and mass that the records ask for, if they do.

        The search is left when the deadline passes.
        """
        step, cycle = self.times[0], min(cycle_time(item.record) for item in self.training)
        if cycle > _SLOWEST * step:
            return self

        training_error = TrainingErrors()

        def error(inertia: SensedDynamics) -> float:
            if deadline is not None:
                deadline.check()
            return training_error(replace(self, inertia=inertia)._rows_of(_SWINGING, _FEW_ROWS // 2))

        without = error(self.inertia)
        masses = [replace(self.inertia, mass=(root * step) ** 2) for root in _ROOTS]
        if min(error(one) for one in masses) > _WORTH_OF_MASS * without:
            return self
        found = find_dynamics(error, self.inertia.delay, step, cycle)
        excited = found.dynamics is not None and self._excites(found.dynamics.frequency / (2 * np.pi))
        return replace(self, inertia=found) if excited else self

    def _excites(self, frequency: float) -> bool:
        """Whether a voltage has energy where a resonance [Hz] would show: without it noise is what is fitted."""
        pieces = [piece for item in self.training for piece in item.pieces]
        return max(energy_share(piece.voltage, piece.sample_time, 0.5 * frequency) for piece in pieces) > _EXCITED

    @cached_property
    def drifting(self) -> tuple[int, ...]:
        """Records that drift, seen from plain elements; none if branches account for creep."""
        if self.supports_creep():
            return ()
        few, stroke, error = self._rows_of(Structure(), _FEW_ROWS), self.stroke, TrainingErrors()
        return worthwhile(lambda drifting: error(replace(few, drifting=drifting)), self.can_drift, stroke)

    def drifts_steadily(self) -> bool:
        """Whether a drift in proportion to time explains the records better than one by its logarithm."""
        if not self.can_drift:
            return False
        lines = replace(self, training=[replace(item, steady=True) for item in self.training])
        error, grid = TrainingErrors(), _DRIFTING.grid(self.span, self.voltages, self.times)
        by_logarithm, by_time = (
            error(replace(one.on_grid(grid, _FEW_ROWS).regression, drifting=self.can_drift)) for one in (self, lines)
        )
        return by_time < _WORTH_OF_LINE * by_logarithm

    @cached_property
    def strained(self) -> tuple[int, ...]:
        """Records that creep as if they had not been at rest as they began, where that explains much."""
        regression, error = self._rows_of(_CREEPING, _FEW_ROWS), TrainingErrors()
        kept: tuple[int, ...] = ()
        cost = error(regression)
        alone = [error(replace(regression, strained=(q,))) for q in range(len(self.training))]
        # The one that explains most first, or a record at rest would be given what another one needs.
        for q in np.argsort(alone, kind="stable").tolist():
            trial = error(replace(regression, strained=(*kept, q)))
            if trial < _WORTH_OF_START * cost:
                kept, cost = (*kept, q), trial
        return tuple(sorted(kept))

    def supports_creep(self) -> bool:
        """Whether there are loops at different speeds, or a hold: else creep looks like hysteresis."""
        if self.creepless:
            return False
        cycles = [cycle.stop - cycle.start for item in self.training for cycle in item.record.cycles()]
        times = [item.record.sample_time for item in self.training for _ in item.record.cycles()]
        lasting = [count * step for count, step in zip(cycles, times, strict=True)]
        return (len(lasting) > 1 and max(lasting) > _SPEEDS * min(lasting)) or any(map(_holds, self.training))

    def actuator_of(self, regression: Regression, found: Coefficients) -> Actuator:
        """Return the actuator of coefficients, without limits and name."""
        rows = regression.rows
        reference = int(rows.epoch[rows.record == self.widest].max())
        return found.to_actuator(
            regression.grid,
            found.offsets[reference],
            dynamics=self.inertia.dynamics,
            delay=self.inertia.delay,
            lag=self.inertia.lag,
        )

    def chosen(
        self,
        start: Structure,
        report: Callable[[str], None],
        without: tuple[str, ...] = (),
        deadline: Deadline | None = None,
    ) -> tuple[Structure, tuple[StructureTrial, ...], list[str]]:
        """Return the structure that the records support, the trials, and what they do not support.

        Fields in `without` do not change. No trial begins after the deadline.
        """
        remarks = []
        if not self.supports_creep() and not without:
            without = ("creep",)
            remarks.append(
                "Creep was not looked for: the records neither hold still for as long as their cycles last nor have "
                "loops at two speeds; add a staircase or slower loops."
            )
        best, trials = select(
            lambda one: self.regression(one, _FEW_ROWS),
            start,
            report,
            without=without,
            stroke=self.stroke,
            deadline=deadline,
        )
        return best, trials, remarks


def _holds(item: Prepared) -> bool:
    """Whether the voltage stands still for as long as a cycle lasts somewhere, or for a tenth of the record."""
    v, record = item.record.voltage, item.record
    # A coarse voltage stands still wherever it moves by less than one of its steps.
    if resolution(v)[1] > COARSE:
        return False
    still = np.abs(np.diff(v)) < 1e-3 * _HELD * np.ptp(v)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    longest = max((b - a for a, b in zip(edges[::2], edges[1::2], strict=True)), default=0) * record.sample_time
    turns = turning_points(v, 0.02 * float(np.ptp(v)))
    leg = cycle_time(record) / 2 if len(turns) > 1 else float(np.ptp(record.time))
    return bool(longest > min(leg, 0.1 * float(np.ptp(record.time))))
