"""The training records with the numbers of their motion: paths, programs, and simulations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import exp
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._native import slip_elongations
from dehyst._types import Array
from dehyst.identification.cleaning import derivatives, disturbs
from dehyst.identification.motion import Motion, Parts
from dehyst.identification.preparation import Prepared, counted_samples
from dehyst.identification.program import SMALLEST_GAIN, Program, Solution
from dehyst.identification.regressors import Epoch, NumberedEpoch, Piece, RowSource
from dehyst.identification.rules import RULES
from dehyst.identification.structure import Structure
from dehyst.model import Actuator, Dynamics, State
from dehyst.records import Record, rms

# A record is divided into this number of parts in time; two parts at a time are held out.
_PARTS = 6
FOLDS = _PARTS // 2
# Number of places in the search for a zero, and largest zero, as a part of the stroke.
_PLACES, _WITHIN = 25, 0.6
# Least slope of the spring, as a part of the mean slope of the widest loop.
SLOPE_FLOOR = 0.2
# Step of finite differences in the search for a resonance.
_STEP = 1e-3
# If the last epochs hold less than this part of the samples, earlier epochs count too.
_SOON = 0.5


@dataclass(frozen=True, eq=False)
class Frame:
    """Training records, and the numbers that relate them to the path of the hysteresis.

    Attributes
    ----------
    training : sequence of Prepared
    motion : Motion
    voltages : (float, float)
        Lowest and highest voltage of all records [V].
    widest : int
        Number of the record whose last constant is the constant of the spring.
    stroke : float
        Range of the widest loop as measured [m].
    denoised : bool
        Whether the sensor's noise is taken out of the path that drives the elements.
    """

    training: Sequence[Prepared]
    motion: Motion
    voltages: tuple[float, float]
    widest: int
    stroke: float
    denoised: bool = True

    @property
    def times(self) -> tuple[float, float]:
        """Shortest sample time and longest record [s]."""
        records = [item.record for item in self.training]
        return min(record.sample_time for record in records), max(float(np.ptp(record.time)) for record in records)

    @cached_property
    def rests(self) -> list[list[tuple[float, float]]]:
        """Begin and end [s] of the rests of the voltage in each record that last as long as the shortest cycle."""
        shortest = min(item.cycle for item in self.training)
        return [[rest for rest in _rests(item.record) if rest[1] - rest[0] >= shortest] for item in self.training]

    @cached_property
    def before(self) -> list[Prepared]:
        """The records without drift, temperature and creep."""
        return [self.motion.before(item, q) for q, item in enumerate(self.training)]

    def with_motion(self, **numbers: Any) -> Frame:
        """Return the records with other `numbers` of the motion."""
        return replace(self, motion=replace(self.motion, **numbers))

    def shift(self, number: int) -> float:
        """Return the shift of a record to the axis of the model, before creep [m]."""
        return float(self.motion.zero[number]) / self.motion.at_rest

    @cached_property
    def paths(self) -> list[tuple[int, int, Record]]:
        """Record number, piece number and path that drives the elements, on the model's axis, of all pieces."""
        at, found = self.motion, []
        for q, item in enumerate(self.before):
            shift = self.shift(q)
            driving = (
                item.driving(at.delay, at.lag, at.dynamics, self.stroke)
                if self.denoised
                else list(item.acting(at.delay, at.lag))
            )
            for k, path in enumerate(driving):
                found.append((q, k, replace(path, displacement=path.displacement + shift) if shift else path))
        return found

    @cached_property
    def bare(self) -> RowSource:
        """Epochs of all paths, without elements."""
        grid = Structure(elements=2, knots=2).grid((0.0, 1.0), self.voltages)
        # Loud noise does not count, as the paths are denoised.
        left = [0.0 if disturbs(item.noise, self.stroke) else item.noise for item in self.training]
        noise = [left[q] for q, _, _ in self.paths]
        pieces = [Piece(q, path) for q, _, path in self.paths]
        return RowSource.of(pieces, grid, noise, leads=[item.lead for item in self.before])

    @cached_property
    def span(self) -> tuple[float, float]:
        """Lowest and highest displacement of the widest record's path [m]."""
        own = [
            (piece.path.displacement, epochs)
            for piece, epochs in zip(self.bare.pieces, self.bare.epochs, strict=True)
            if piece.record == self.widest
        ]
        counted = counted_samples(own)
        return min(float(y.min()) for y in counted), max(float(y.max()) for y in counted)

    def source(self, structure: Structure) -> RowSource:
        """Return all rows of all records on the grid of a structure."""
        return replace(self.bare, grid=structure.grid(self.span, self.voltages))

    def program(
        self,
        source: RowSource,
        structure: Structure,
        most: int,
        names: Sequence[str] = (),
        near: Solution | None = None,
    ) -> Program:
        """Return the program of about `most` rows, with the parts in `names`; `near`: solution of a similar program."""
        rows = source.thinned(most)
        floor = SLOPE_FLOOR * float(np.ptp(self.voltages)) / (self.span[1] - self.span[0])
        parts = [] if near is None else Parts(self.motion, self.training, rows).of(names)
        return Program(rows, source.grid, floor, structure.smoothing, tuple(parts), near)

    def actuator(self, program: Program, found: Solution) -> Actuator:
        """Return the actuator of a solution, without limits and name."""
        rows, at = program.rows, self.motion
        reference = int(rows.epoch[rows.record == self.widest].max())
        gains = found.numbers.get("creep", at.gains)
        creep = replace(at, gains=gains).creep
        return found.to_actuator(
            program.grid,
            found.offsets[reference],
            dynamics=at.dynamics,
            delay=max(at.delay, 0.0),
            lag=at.lag,
            displacement_creep=creep,
            thermal=at.thermal,
        )

    def folds(self, program: Program) -> NDArray[np.intp]:
        """Return the fold of each row (n,): each fold holds two of six parts of the time of each record.

        Each long rest is divided likewise: creep shows in rests, and each fold must hold a part of every rest.
        """
        fold = np.zeros(len(program.rows), dtype=np.intp)
        for q, (item, rests) in enumerate(zip(self.training, self.rests, strict=True)):
            own = program.rows.record == q
            time, ends = program.rows.time[own], item.record.time[[0, -1]]
            place = (time - ends[0]) / np.ptp(ends)
            for begin, end in rests:
                resting = (time >= begin) & (time <= end)
                place[resting] = (time[resting] - begin) / (end - begin)
            fold[own] = part_of(place) % FOLDS
        return fold

    def held_out_error(self, source: RowSource, program: Program, whole: Solution) -> float:
        """Return the error [m] of the displacement in held-out parts of the time, simulated from the voltages alone.

        It is the median RMS error of the parts: a part that holds the only loops of some size is not representative.
        """
        errors, rows, creep = list[float](), program.rows, self.motion.creep
        for k in range(FOLDS):
            found = program.solved(whole, without=k)
            left = self.residual(source, program, found, whole, k)
            known = rows.displacement[program.fold != k]
            counted = np.isfinite(left) & (rows.displacement >= known.min()) & (rows.displacement <= known.max())
            away = program.fold == k
            for epoch in np.unique(rows.epoch[counted]).tolist():
                own = np.flatnonzero(counted & (rows.epoch == epoch))
                kept = own[~away[own]]
                left[own] -= left[kept if kept.size else own].mean()
            for q in range(len(self.training)):
                own = np.flatnonzero(counted & (rows.record == q))
                if creep is not None and own.size > 1:
                    left[own], _ = creep.added(rows.time[own], left[own], np.zeros(len(creep)))
                errors += [rms(left[own[away[own]]])] if away[own].any() else []
        return float(np.median(errors)) if errors else 0.0

    def residual(
        self, source: RowSource, program: Program, found: Solution, whole: Solution, without: int | None = None
    ) -> Array:
        """Return measured minus simulated displacement [m] of each row (n,); NaN where it does not count.

        `found`: the solution `without` a fold; `whole`: the solution of all rows.
        """
        rows, out = program.rows, np.zeros(len(program.rows), dtype=bool)
        if without is not None:
            out = program.fold == without
        # An epoch that is left out as a whole takes its constant from the solution of all rows.
        lost = set(rows.epoch[out].tolist()) - set(rows.epoch[~out].tolist())
        offsets = {e: whole.offsets[e] if e in lost else offset for e, offset in found.offsets.items()}
        actuator = self.actuator(program, replace(found, offsets=offsets))
        base, left = float(actuator.spring.voltage[0]), np.full(len(rows), np.nan)
        for place in self.judged(source):
            own = np.flatnonzero(rows.epoch == place.number)
            if own.size:
                state = self.state(source, place.piece, place.epoch, actuator)
                time, missed = self.missed(place.piece, place.epoch, actuator, state, offsets[place.number] - base)
                left[own] = np.interp(rows.time[own], time, missed)
        for part in program.parts:
            # The numbers found for a fold also move the path; the simulation already includes a resonance.
            if part.name != "inertia":
                moved = part.columns @ (found.numbers[part.name] - part.value)
                left += moved / program.scale if part.volts else moved
        return left

    def judged(self, source: RowSource) -> list[NumberedEpoch]:
        """Return the last epoch of each piece, or all epochs where the last ones are short."""
        epochs = list(source.numbered())
        last = [place for place in epochs if place.epoch is source.epochs[place.piece][-1]]
        samples = sum(place.epoch.stop - place.epoch.start for place in last)
        return last if samples >= _SOON * sum(len(path) for _, _, path in self.paths) else epochs

    def state(self, source: RowSource, place: int, epoch: Epoch, actuator: Actuator) -> State:
        """Return the state of an actuator at the first sample of an epoch of a piece, before creep."""
        (q, k, path), rho, grid = self.paths[place], actuator.slip.breakaway, source.grid
        y = path.displacement
        _, carts = slip_elongations(rho, np.full(rho.size, y[0]), np.ascontiguousarray(y[: epoch.start + 1]))
        carts = np.where(2 * rho <= epoch.reach, carts, epoch.middle)
        smooth = source.states[place][epoch.start]
        if grid.lengths.size:
            part = actuator.smooth
            held = [] if part is None else list(zip(part.length, part.closing, strict=True))
            smooth = smooth[[pair in held for pair in zip(grid.lengths, grid.closings, strict=True)]]
        start, motion = float(y[epoch.start]), list[float]()
        if actuator.dynamics is not None:
            piece = self.before[q].pieces[k]
            motion = [float(self._measured(q, k)[epoch.start]), float(derivatives(piece)[0][epoch.start])]
        return State(start, np.clip(carts, start - rho, start + rho), motion, smooth)

    def _measured(self, number: int, piece: int) -> Array:
        """Displacements of a piece before creep on the model's axis (n,) [m]."""
        return np.asarray(self.before[number].pieces[piece].displacement + self.shift(number))

    def missed(
        self, place: int, epoch: Epoch, actuator: Actuator, state: State, offset: float, late: Array | None = None
    ) -> tuple[Array, Array]:
        """Return times [s], and measured minus simulated displacement before creep [m], of one epoch of a piece.

        `late`: acting voltages of the piece (n,) [V], by default the voltages of its path.
        """
        (q, k, path), own = self.paths[place], slice(epoch.start, epoch.stop)
        model = replace(actuator._before_creep, lag=0.0, thermal=None)
        voltage = without_offset(model, (path.voltage if late is None else late)[own], offset)
        time = path.time[own]
        played = model.simulate(voltage, time=time, state=state, extrapolate=True)
        measured = path.displacement if actuator.dynamics is None else self._measured(q, k)
        return time, measured[own] - played.displacement


def tuned(frame: Frame, source: RowSource, program: Program, found: Solution) -> Frame:
    """Return the records with the frequency, damping and delay of least simulation error; unchanged without resonance.

    A simulation determines a resonance better than derivatives of a measured displacement do.
    """
    from scipy.optimize import least_squares

    actuator, motion = frame.actuator(program, found), frame.motion
    start = actuator.dynamics
    if start is None:
        return frame
    base = float(actuator.spring.voltage[0])
    epochs = [place for place in frame.judged(source) if place.number in found.offsets]
    states = [frame.state(source, place.piece, place.epoch, actuator) for place in epochs]

    def numbers(x: Array) -> tuple[float, float, float]:
        # All numbers are near 1, because the finite differences are relative.
        frequency, damping, delay = (x - 1).tolist()
        return (start.frequency * exp(frequency), max(start.damping + damping, 0.0), motion.delay + delay / start.omega)

    rows, columns = program.rows, program.columns[0][:, found.active_set.moving]
    regular = len(rows) * program.regularization[np.ix_(found.active_set.moving, found.active_set.moving)]
    follow = np.linalg.solve(columns.T @ columns + regular, columns.T)

    def error(x: Array) -> Array:
        frequency, damping, delay = numbers(x)
        model, at_rows, played = replace(actuator, dynamics=Dynamics(frequency, damping)), np.zeros(len(rows)), []
        late = [path.voltage for item in frame.training for path in item.acting(delay, motion.lag)]
        for place, state in zip(epochs, states, strict=True):
            offset, own = found.offsets[place.number] - base, rows.epoch == place.number
            time, missed = frame.missed(place.piece, place.epoch, model, state, offset, late[place.piece])
            at_rows[own] = np.interp(rows.time[own], time, missed)
            played.append((own, time, missed))
        # The part of the error that the other coefficients can follow does not belong to the resonance.
        followed = columns @ (follow @ at_rows)
        left = [missed - np.interp(time, rows.time[own], followed[own]) for own, time, missed in played]
        return np.concatenate([part - part.mean() for part in left]) / frame.stroke

    # The search for a resonance must not make a lead: only an earlier lead is allowed.
    lead = max(motion.delay, 0.0)
    least = 1 - np.array([np.inf, start.damping, lead * start.omega])
    first = np.maximum(np.ones(3), least + 2 * _STEP)
    best = least_squares(error, first, x_scale=0.1, diff_step=np.full(3, _STEP), bounds=(least, np.inf), max_nfev=15)
    if not rms(best.fun) < rms(error(np.ones(3))):
        return frame
    frequency, damping, delay = numbers(best.x)
    omega = Dynamics(frequency, damping).omega
    if abs(delay) < RULES.shortest_lag * frame.times[0]:
        delay = 0.0
    changed = replace(motion, mass=1 / omega**2, damping=2 * damping / omega, delay=delay)
    return replace(frame, motion=changed)


def zero_of(cost: Callable[[float], float], stroke: float, exact: float) -> float:
    """Return the zero [m] of a sensor with the least cost [m], to a part `exact` of the stroke.

    It is 0 unless another zero has a much lower cost.
    """
    from scipy.optimize import minimize_scalar

    places = np.linspace(-_WITHIN * stroke, _WITHIN * stroke, _PLACES)
    k = int(np.argmin([cost(float(place)) for place in places]))
    ends = float(places[max(k - 1, 0)]), float(places[min(k + 1, _PLACES - 1)])
    best = minimize_scalar(cost, bounds=ends, method="bounded", options={"xatol": exact * stroke, "maxiter": 60})
    none = cost(0.0)
    worth = best.fun < RULES.zero_gain * none and none - best.fun > SMALLEST_GAIN * stroke
    return float(best.x) if worth else 0.0


def part_of(place: Array) -> NDArray[np.intp]:
    """Return the number of the time part of places (n,), which are 0 to 1 in a record."""
    return np.asarray(np.clip((_PARTS * place).astype(np.intp), 0, _PARTS - 1))


def without_offset(actuator: Actuator, voltage: Array, offset: float) -> Array:
    """Return voltages (n,) [V] minus an offset; with a transformer, the offset applies to tau(v)."""
    tau = actuator.transformer
    if tau is None:
        return voltage - offset
    return tau.inverse(tau(voltage) - offset)


def _rests(record: Record) -> list[tuple[float, float]]:
    """Return begin and end [s] of each rest of a voltage; smaller changes than a coarse step are rest."""
    levels = np.round(record.voltage / (RULES.coarse_voltage * np.ptp(record.voltage)))
    begins = np.flatnonzero(np.diff(levels, prepend=np.inf))
    ends = np.append(begins[1:], levels.size) - 1
    return list(zip(record.time[begins].tolist(), record.time[ends].tolist(), strict=True))
