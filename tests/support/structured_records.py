"""Virtual actuators of wider structures, and records of them that are exact to rounding.

The parts lie where `Structure.grid` would put them for this record: identified and true coefficients can be compared
one by one.
"""

from dataclasses import dataclass, replace

import numpy as np
import plain_records

from dehyst import Actuator, MaxwellSlip, Record, Spring, State
from dehyst.identification import Structure
from dehyst.identification.frame import Frame
from dehyst.identification.motion import Motion
from dehyst.identification.preparation import prepare
from dehyst.identification.program import Program, Solution
from dehyst.identification.regressors import RowSource
from dehyst.identification.structure import Grid
from dehyst.model import GradedSlip, SmoothSlip, Transformer, turned

SLOPE = plain_records.VOLTS / plain_records.STROKE
FLOOR = 0.1 * SLOPE
RATE = 200.0


def wandering(branches=70, seed=5, samples=30, hold=0):
    """A path [m]: major loops, then branches between random turning points, each followed by a hold of some samples."""
    rng = np.random.default_rng(seed)
    turns = [1.0, 0.0, 1.0, 0.0, 1.0]
    for k in range(branches):
        share = rng.uniform(0.2, 1.0)
        turns.append(turns[-1] + share * ((0.02 if k % 2 == 0 else 0.98) - turns[-1]))
    path = plain_records.path([*turns, 0.0], samples)
    if not hold:
        return path
    parts = np.split(path[1:], np.arange(samples, path.size - 1, samples))
    return np.concatenate([path[:1], *(np.append(part, np.full(hold, part[-1])) for part in parts)])


@dataclass(frozen=True, eq=False)
class Plant:
    """An actuator, its path, its first state, and the grid of its parts."""

    actuator: Actuator
    path: np.ndarray
    state: State
    grid: Grid

    @property
    def time(self):
        return np.arange(self.path.size) / RATE

    def record(self, *, state=None, noise=0.0, seed=0, name="made"):
        """Voltages by `Actuator.compensate`, the path with the sensor's noise."""
        start = self.state if state is None else state
        motion = self.actuator.compensate(self.path, time=self.time, state=start)
        sensed = self.path + noise * np.random.default_rng(seed).normal(size=self.path.size)
        return Record(self.time, motion.voltage, sensed, name)

    def solution(self, program):
        """The true coefficients, with the constant of every epoch."""
        actuator, (columns, free) = self.actuator, program.columns
        base = float(actuator.spring.voltage[0])
        kappa, tau = actuator.slip.stiffness.reshape(len(actuator.slip), -1), actuator.transformer
        smooth = np.zeros(0) if actuator.smooth is None else actuator.smooth.stiffness
        rises = np.zeros(0) if tau is None else np.diff(tau.drive) / np.diff(tau.voltage)
        static = [kappa[self.grid.movable].ravel(), actuator.spring.slopes - program.floor, smooth]
        unknowns = np.concatenate([np.full(free, base), *static, rises[:-1] - 0.2])
        assert unknowns.size == columns.shape[1]
        offsets = dict.fromkeys(program.numbers.tolist(), base)
        return Solution(kappa, actuator.spring.slopes, smooth, rises, offsets, {}, unknowns, None, None)


def plant(structure, seed=0, path=None):
    """An actuator of a structure; every branch rises by a fifth of the mean slope at least."""
    rng = np.random.default_rng([seed, 7])
    y = wandering() if path is None else path
    grid = structure.grid((0.0, plain_records.STROKE), (0.0, plain_records.VOLTS))
    parts = {"slip": _slip(grid, rng), "spring": _spring(grid, rng)}
    if structure.smooth:
        share = 0.05 * plain_records.VOLTS * rng.uniform(0.2, 1, grid.lengths.size)
        parts["smooth"] = SmoothSlip(grid.lengths, grid.closings, share / grid.lengths / grid.lengths.size)
    actuator = Actuator(**parts)
    # Smooth elements begin at zero, as the program assumes; they would forget another start only after many cycles.
    state = replace(turned(actuator, float(y[0])), smooth=np.zeros(grid.lengths.size))
    if structure.transformer:
        drive = actuator.compensate(y, time=np.arange(y.size) / RATE, state=state).voltage
        ends = float(drive.min()), float(drive.max())
        grid = structure.grid((0.0, plain_records.STROKE), ends)
        actuator = replace(actuator, transformer=_transformer(grid, rng), state=state)
    return Plant(actuator, y, state, grid)


def _slip(grid, rng):
    n = grid.breakaway.size
    kappa = rng.uniform(0.3, 1.5, n) * np.exp(-np.arange(n) / n) * grid.movable
    kappa *= 0.3 * plain_records.VOLTS / max(2 * float(kappa @ grid.breakaway), 1e-9)
    if grid.segments == 1:
        return MaxwellSlip(grid.breakaway, kappa)
    return GradedSlip(grid.breakaway, grid.grades, kappa[:, None] * rng.uniform(0.8, 1.0, (n, grid.segments)))


def _spring(grid, rng):
    slopes = SLOPE * rng.uniform(0.55, 0.85, grid.knots.size - 1)
    return Spring.of_slopes(grid.knots, slopes, 0.15 * plain_records.VOLTS)


def _transformer(grid, rng):
    rises = np.diff(grid.drive) * rng.uniform(0.7, 1.4, grid.drive.size - 1)
    rises *= np.ptp(grid.drive) / rises.sum()
    return Transformer(grid.drive, grid.drive[0] + np.append(0, np.cumsum(rises)))


def moved_along(grid, piece, lead):
    """Compute the result of `dehyst.identification.regressors.internal_states` with the parts of a model."""
    smooth = SmoothSlip(grid.lengths, grid.closings, np.zeros(grid.lengths.size))
    y = piece.displacement
    if lead is not None and lead.time[-1] < piece.time[0] <= lead.time[-1] + 1.5 * lead.sample_time:
        y = np.concatenate([lead.displacement, y])
    return smooth.elongations(y)[-len(piece) :] if len(smooth) else np.zeros((len(piece), 0))


def program(grid, records, *, leads=()):
    """The least-squares program of records, without smoothing and without a search."""
    pieces = list(enumerate(records))
    source = RowSource.of(pieces, grid, [0.0] * len(pieces), leads=leads or [None] * len(records))
    return Program(source.thinned(len(source)), grid, FLOOR, 0.0)


def _rough(**parts):
    """A structure whose neighbours may differ as in a random actuator: only then can it match this actuator exactly."""
    return Structure(smoothing=0.0, **parts)


STRUCTURES = {
    "plain": _rough(elements=8, knots=7),
    "dense": _rough(elements=10, spacing=2.0, knots=7),
    "graded": _rough(elements=6, grades=3, knots=7),
    "transformer": _rough(elements=8, knots=7, transformer=6),
    "smooth": _rough(elements=8, knots=7, smooth=True),
    "graded, transformer": _rough(elements=6, grades=3, knots=7, transformer=5),
    "all": _rough(elements=6, grades=3, knots=7, transformer=5, smooth=True),
}


def frame(records, **motion):
    """The start of an identification of these records; `motion`: known numbers of the motion."""
    training = [prepare(record) for record in records]
    spans = [float(np.ptp(item.span())) for item in training]
    volts = np.array([record.voltage_range for record in records])
    ends, widest = (float(volts[:, 0].min()), float(volts[:, 1].max())), int(np.argmax(spans))
    moved = replace(Motion.none(len(records)), **motion)
    return Frame(training, moved, ends, widest, spans[widest])
