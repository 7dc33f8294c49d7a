"""Comparison of measurement and simulation: a model is simulated from a state that the record determines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from dehyst._errors import IdentifyError
from dehyst._native import slip_elongations
from dehyst._threads import one_thread
from dehyst._types import Array
from dehyst.identification.cleaning import disturbs
from dehyst.identification.events import filled, refilled
from dehyst.identification.frame import Frame, without_offset, zero_of
from dehyst.identification.motion import Motion, Parts, moved
from dehyst.identification.preparation import Prepared, as_list, prepare
from dehyst.identification.program import Program, Solution
from dehyst.identification.regressors import Epoch, RowSource
from dehyst.identification.results import RecordErrors, Trace
from dehyst.identification.rules import RULES
from dehyst.identification.solver import ActiveSet
from dehyst.identification.start_state import StartState, fit_start, fit_strained
from dehyst.identification.structure import Grid
from dehyst.model import Actuator, State, at_reference, major_loop, needs_time, stroke_of, voltages_of
from dehyst.records import Record, counting, largest, rms, thinned, turning_points, usable

# Largest number of rows; a longer record is thinned evenly.
MOST_ROWS = 200_000
# Number of samples for the fit of the carts at a start, and of samples after all elements are in a known state.
_START_SAMPLES, _KNOWN_SAMPLES = 1000, 200
# Least slope of a branch, as a part of the mean slope, so that weights stay bounded.
_LEAST = 0.05
# Least turn of a voltage of events, as a part of its range.
_TURN = 5e-3
# Share of the samples that counts as outliers.
_OUTLIERS = 1e-3
# Number of rows for the search of a zero, and for the numbers of parts; iterations for the numbers of parts.
_FEW, _SOME, _TURNS = 1000, 10_000, 2
# Search for the zero without an offset of the voltages: number of steps, and least step, as a part of the stroke.
_STEPS, _CLOSE = 8, 1e-5
# Usual size of creep from before a record, and least error of a model, both as parts of the stroke.
_STRAINED, _DOUBT = 0.3, 1e-3


@dataclass(frozen=True, eq=False)
class RecordComparison:
    """A record compared with a model: the samples that count, and the fitted constants.

    Attributes
    ----------
    given : Prepared
        The record as measured.
    frame : Frame
        The reduced record, with the path of the hysteresis on the model's axis, before resonance, creep and drift.
    source : RowSource
        Pieces of the record.
    program : Program
        Program with the rows of the record.
    found : Solution
        Coefficients of the model, and constants of this record.
    base : float
        Voltage of the model's spring at its first knot [V]: an offset is a constant minus this voltage.
    """

    given: Prepared
    frame: Frame
    source: RowSource
    program: Program
    found: Solution
    base: float

    @cached_property
    def before(self) -> Prepared:
        """The record without creep and drift."""
        return self.frame.motion.before(self.given, 0)

    @cached_property
    def whole(self) -> list[Record]:
        """Pieces for simulations: all samples, with delayed voltages, and displacements on the model's axis."""
        shift, at = self.frame.shift(0), self.frame.motion
        return [
            replace(piece, displacement=piece.displacement + shift) for piece in self.before.acting(at.delay, at.lag)
        ]

    def last_offsets(self) -> list[float]:
        """Offset [V] of the last epoch of each piece; if it has no rows, of the nearest epoch with rows."""
        known, numbers = sorted(self.found.offsets), np.cumsum([len(own) for own in self.source.epochs]) - 1
        nearest = [min(known, key=lambda k: abs(k - epoch)) for epoch in np.maximum(numbers, 0).tolist()]
        return [self.found.offsets[k] - self.base for k in nearest]

    def played(self, actuator: Actuator, number: int) -> tuple[State, list[Array]]:
        """Return the start of a piece, and time, voltage, measured and simulated displacement where samples count.

        The whole piece is simulated, with the offset removed from its voltages. In samples that do not count, the
        measured displacement drives the model.
        """
        start, offset, first = self.start_of(actuator, number)
        piece, block, runs = self.whole[number], self.given.block, []
        # The voltages of the piece already include the lag of the amplifier.
        model, state = replace(actuator._before_creep, lag=0.0), replace(start, displacement_creep=())
        begin = first * block + block // 2
        for low, high, counted in _runs(piece, begin, len(piece)):
            # A simulation has no time step before its first sample: later runs repeat the sample of the present state.
            again = int(needs_time(actuator) and low > begin)
            run, own = slice(low - again, high), slice(low, high)
            time, measured = piece.time[run], piece.displacement[run]
            if counted:
                voltage = without_offset(actuator, piece.voltage[run], offset)
                motion = model.simulate(voltage, time=time, state=state, extrapolate=True)
                simulated = motion.displacement[again:]
            else:
                motion = model.compensate(measured, time=time, state=state, extrapolate=True)
                simulated = measured[again:]
            state = motion.state
            voltage = without_offset(actuator, piece.voltage[own], offset)
            runs.append((piece.time[own], voltage, measured[again:], simulated))
        time, voltage, *paths = (np.concatenate(column) for column in zip(*runs, strict=True))
        if (creep := actuator.displacement_creep) is not None:
            paths = [creep.added(time, path, start.displacement_creep)[0] for path in paths]
        kept = np.ones(time.size, dtype=bool)
        for since, until in self.source.pieces[number].path.set_aside:
            kept &= (time < since) | (time > until)
        return start, [column[kept] for column in (time, voltage, *paths)]

    def start_of(self, actuator: Actuator, number: int) -> tuple[State, float, int]:
        """Return the state at the first sample of a piece that counts, the offset of its voltages [V], and that sample.

        No sample counts before the delay is over, as its voltage is not recorded. The carts are fitted to the voltages
        before the displacement alone determines them.
        """
        own, piece = self.source.epochs[number], self.source.pieces[number].path
        first = max(min(int(np.ceil(actuator.delay / piece.sample_time)), len(piece) - 1), 0)
        if (whole := counting(piece)) is not None:
            first = max(first, int(np.argmax(whole)))
        last = own[-1] if own else Epoch(0, 0, len(piece), 0.0)
        standing = bool(np.any((2 * actuator.slip.breakaway > last.reach) & (actuator.slip.friction > 0)))
        stop = last.stop if standing else max(last.start, first) + _KNOWN_SAMPLES
        path = piece.displacement[first:stop]
        # Some samples move the elements like all samples: the first one, the turning points, and evenly spaced ones.
        places = np.arange(path.size)
        if path.size > _START_SAMPLES:
            some = np.linspace(0, path.size - 1, _START_SAMPLES).astype(np.intp)
            places = np.union1d(some, turning_points(path, 1e-3 * float(np.ptp(path))))
        places, y = first + places, path[places]
        tau, voltage = actuator.transformer, piece.voltage[places]
        held = (voltage if tau is None else tau(voltage)) - actuator.spring(y)
        known = None if standing or not own else self.last_offsets()[number]
        counted = None if whole is None else whole[places]

        def fit(force: Array, fades: Array, most: Array) -> StartState:
            return fit_start(actuator.slip, y, force, fades, most, known, counted)

        smooth, none, at_start = self.source.states[number][places], np.zeros((y.size, 0)), None
        start = fit(held if actuator.smooth is None else held - smooth @ actuator.smooth.stiffness, none, none[0])
        if actuator.smooth is not None:
            # Smooth elements start at rest, unless the first voltages show another start.
            strained, elongations = fit_strained(actuator.smooth, y, held, fit)
            if strained.cost < RULES.carts_alone_gain * start.cost:
                start, at_start = strained, elongations
        state = self.frame.state(self.source, number, Epoch(first, first, first + 1, 0.0), actuator)
        state = replace(state, carts=start.carts, smooth=state.smooth if at_start is None else at_start)
        return self.with_creep(actuator, state, float(piece.time[first])), start.constant, first

    def with_creep(self, actuator: Actuator, state: State, time: float) -> State:
        """Return a state at a `time` [s] with creep in displacement."""
        creep = actuator.displacement_creep
        if creep is None:
            return state
        clock, m = self.before.with_lead
        strains = creep.strains(clock, m, self.frame.motion.creep_before[0] / creep.gains)
        return replace(state, displacement_creep=np.array([np.interp(time, clock, strain) for strain in strains.T]))


def compare(
    actuator: Actuator, record: Prepared, stroke: float, *, zero: float | None = None, drifting: bool = False
) -> RecordComparison:
    """Compare a record with a fixed model: fit constants, zero, drift, and creep from before the record.

    `stroke` [m]: reference of the percentages. `zero` [m]: shift to the model's axis; default: estimated. `drifting`:
    whether a drift is fitted too. Raise `IdentifyError` if no sample counts.
    """
    creep, dynamics = actuator.displacement_creep, actuator.dynamics
    motion = replace(
        Motion.none(1),
        delay=actuator.delay,
        lag=actuator.lag,
        mass=0.0 if dynamics is None else 1 / dynamics.omega**2,
        damping=0.0 if dynamics is None else 2 * dynamics.damping / dynamics.omega,
    )
    if creep is not None:
        motion = replace(
            motion, time_constants=creep.time_constants, gains=creep.gains, creep_before=np.zeros((1, len(creep)))
        )
    names = (*(["drift"] if drifting else []), *(["creep_before"] if creep is not None else []))
    first = zero or 0.0
    compared = _compared(actuator, record, stroke, replace(motion, zero=np.array([first])), names)
    found = _zero(compared, actuator) if zero is None else zero
    motion = replace(motion, zero=np.array([found]))
    for left in reversed(range(_TURNS if names else int(found != first))):
        motion = moved(motion, names, compared.found.numbers)
        compared = _compared(actuator, record, stroke, motion, names if left else ())
    return compared


def _compared(
    actuator: Actuator, record: Prepared, stroke: float, motion: Motion, names: Sequence[str]
) -> RecordComparison:
    """Compare a record with a model for given numbers of `motion`; fit the numbers of the parts in `names` too."""
    noise, spring = record.reduced.noise, actuator.spring
    # Maxwell-slip elements need no denoising of a displacement with little noise.
    denoised = actuator._wide or disturbs(noise, stroke)
    frame = Frame([record.reduced], motion, (spring.voltage[0], spring.voltage[-1]), 0, stroke, denoised=denoised)
    grid = Grid.of_actuator(actuator, np.ones(len(actuator.slip), dtype=bool))
    source = replace(frame.bare, grid=grid)
    if not len(source):
        lasts = float(np.ptp(record.record.time))
        raise IdentifyError(
            f"{record.record.name}: no sample counts; it lasts {lasts:.3g} s, and the model lags by "
            f"{actuator.delay + actuator.lag:.3g} s. Record longer, or check the unit of the time"
        )
    rows = source.thinned(_SOME if names else MOST_ROWS)
    least = min(_LEAST * float(np.ptp(spring.voltage)) / float(np.ptp(grid.knots)), float(spring.slopes.min()))
    parts, model = tuple(Parts(motion, frame.training, rows).of(names)), coefficients(actuator)
    program = Program(rows, grid, least, 0.0, parts, model)
    found = _with_nuisances(program, model, motion.gains)
    return RecordComparison(record, frame, source, program, found, float(spring.voltage[0]))


def coefficients(actuator: Actuator) -> Solution:
    """Return the numbers of an actuator as the solution of a program, without constants."""
    tau, stiffness, smooth = actuator.transformer, actuator.slip.stiffness, actuator.smooth
    return Solution(
        stiffness if stiffness.ndim == 2 else stiffness[:, None],
        actuator.spring.slopes,
        np.zeros(0) if smooth is None else smooth.stiffness,
        np.zeros(0) if tau is None else np.diff(tau.drive) / np.diff(tau.voltage),
        {},
        {},
        np.zeros(0),
        ActiveSet(np.zeros(0, dtype=bool), np.zeros(0, dtype=bool)),
        (np.zeros((0, 0)), np.zeros(0)),
    )


def _with_nuisances(program: Program, model: Solution, gains: Array | float = 1.0) -> Solution:
    """Return the coefficients of a model, with the constants and numbers of parts that fit the rows best.

    `gains`: gains of the creep whose strains from before the record are among the parts.
    """
    rows = program.free_columns
    left = program.target - program.static(program.unknowns_of(model))
    prior, place = np.zeros(rows.shape[1]), program.numbers.size
    for part in program.parts:
        if part.name == "creep_before":
            # Errors of a model are similar in many rows; the errors of a changed actuator are large.
            others = rows[:, :place]
            missed = rms(left - others @ np.linalg.lstsq(others, left, rcond=None)[0])
            doubt = max(_DOUBT, missed / float(np.ptp(program.grid.knots))) / _STRAINED
            prior[place : place + part.value.size] = doubt / gains * np.sqrt(len(rows)) / 10
        place += part.value.size
    held = np.diag(prior)[prior > 0]
    numbers = np.linalg.lstsq(np.vstack([rows, held]), np.append(left, np.zeros(len(held))), rcond=None)[0]
    constants, place = numbers[: program.numbers.size], program.numbers.size
    found = {}
    for part in program.parts:
        found[part.name] = numbers[place : place + part.value.size]
        place += part.value.size
    offsets = dict(zip(program.numbers.tolist(), constants.tolist(), strict=True))
    residual = rows @ numbers - left
    return replace(model, offsets=offsets, numbers=found, unknowns=residual)


def _zero(compared: RecordComparison, actuator: Actuator) -> float:
    """Return the shift [m] of a record to the axis of a model, creep at rest; 0 unless it is significant."""
    program, stroke, model = compared.program, compared.frame.stroke, coefficients(actuator)
    few = program.rows.thinned(_FEW)

    def cost(shift: float) -> float:
        rows = replace(few, displacement=few.displacement + shift)
        fresh = Program(rows, program.grid, program.floor, 0.0, near=model)
        return rms(_with_nuisances(fresh, model).unknowns)

    return compared.frame.motion.at_rest * zero_of(cost, stroke, 1e-9)


def zero_by_voltages(actuator: Actuator, record: Prepared, stroke: float) -> float:
    """Return the shift [m] of a record to the axis of a model with which its voltages need no offset."""
    (low, high), measured = voltages_of(actuator), record.record.displacement
    # The search starts at the middle of the loop, as the zero of a sensor may be far away.
    zero = 0.5 * (sum(major_loop(actuator, record.record.voltage_range)) - float(measured.min() + measured.max()))
    for _ in range(_STEPS):
        step = compare(actuator, record, stroke, zero=zero).last_offsets()[-1] * stroke / (high - low)
        zero += step
        if abs(step) < _CLOSE * stroke:
            break
    return zero


def prepare_for(actuator: Actuator, record: Record) -> Prepared:
    """Prepare a record like for an identification: at the reference temperature, without the lag of the sensor.

    Its voltages are moved in time by the lead of the identification; the model fills what lies between events.
    """
    known = actuator.identification
    measured = at_reference(actuator, filled(thinned(record)))
    if known.lead and record.hold == "line":
        measured = earlier(measured, known.lead)
    prepared = prepare(measured, ringing=known.ringing).without_lag(known.sensor_lag)
    if record.measured is None:
        return prepared
    stroke = stroke_of(actuator)
    compared = compare(actuator, prepared, stroke, zero=zero_by_voltages(actuator, prepared, stroke))
    trace = errors_of(actuator, compared, "validation")[1]
    return prepared.changed(lambda piece: refilled(piece, trace.time, trace.simulated).displacement)


def earlier(record: Record, seconds: float) -> Record:
    """Return a record whose voltages act earlier by `seconds`."""
    time = np.minimum(record.time + seconds, record.time[-1])
    return replace(record, voltage=np.interp(time, record.time, record.voltage))


def compare_all(actuator: Actuator, records: Record | Sequence[Record]) -> tuple[RecordComparison, ...]:
    """Compare an actuator with records, by the options of its identification and as parts of its stroke."""
    prepared = [prepare_for(actuator, record).with_block(len(record) / MOST_ROWS) for record in as_list(records)]
    known = actuator.identification
    zero, stroke = 0.0 if known.shared_zero else None, stroke_of(actuator)
    with one_thread():
        return tuple(
            compare(actuator, item, stroke, zero=zero, drifting=known.drift and item.can_drift) for item in prepared
        )


def state_after(actuator: Actuator, lead: Record) -> tuple[State, float]:
    """Return the state at a record's last sample, on the model's axis, and the offset of the record's voltages [V].

    The record's displacements determine the state and the shift of its sensor's zero; the offset is fitted by least
    squares over the samples that count. If no sample counts, because the record is too short or has no full cycle, the
    offset is taken from its last sample, and the remaining uncertainty of the carts is ignored.
    """
    try:
        compared = compare(actuator, prepare_for(actuator, lead), stroke_of(actuator))
        own, pieces = compared.source.epochs[-1], compared.source.pieces
    except ValueError:
        own = []
    if own:
        last = replace(own[-1], start=len(pieces[-1].path) - 1)
        state = compared.frame.state(compared.source, len(pieces) - 1, last, actuator)
        end = float(pieces[-1].path.time[-1])
        state, creep = compared.with_creep(actuator, state, end), actuator.displacement_creep
        if creep is not None:
            # The rest after the motion is not in the pieces, but creep continues in it.
            rested = np.exp(-(float(lead.time[-1]) - end) / creep.time_constants)
            state = replace(state, displacement_creep=rested * state.displacement_creep)
        return state, compared.last_offsets()[-1]
    behind, y = actuator.displacement_creep, lead.displacement
    crept: Array | tuple[()] = ()
    if behind is not None:
        y = behind.removed(lead.time, y)
        crept = behind.strains(lead.time, y)[-1]
    _, carts = slip_elongations(actuator.slip.breakaway, np.full(len(actuator.slip), y[0]), np.ascontiguousarray(y))
    smooth = () if actuator.smooth is None else actuator.smooth.elongations(y)[-1]
    state = State(float(y[-1]), carts, smooth=smooth, displacement_creep=crept)
    held, given = actuator.voltage(state), float(lead.voltage[-1])
    tau = actuator.transformer
    return state, given - held if tau is None else float(tau(given) - tau(held))


def initial_state(actuator: Actuator, record: Record) -> tuple[State, float]:
    """Return the state at a record's beginning, on the model's axis, and the offset of the record's voltages [V].

    Simulations of the record start from this state, see `RecordErrors.starts`: its carts, creep strains and smooth
    elongations explain the first voltages best (`fit_start`).

    Raise `RecordError` if the `record` is too short to be compared.
    """
    return compare(actuator, prepare_for(actuator, record), stroke_of(actuator)).start_of(actuator, 0)[:2]


def errors_of(actuator: Actuator, compared: RecordComparison, role: str) -> tuple[RecordErrors, Trace]:
    """Simulate each whole piece of a record, from the best-fitting state at its first sample, and compare.

    `role`: "training" or "validation".
    """
    record = compared.given
    starts, drawn = zip(*(compared.played(actuator, k) for k in range(len(compared.source.pieces))), strict=True)
    time, voltage, measured, simulated = (np.concatenate(column) for column in zip(*drawn, strict=True))
    known, counts = record.record.measured, None
    if known is not None:
        # Only errors at events count; the displacement at turns and ends of the voltage is filled in.
        turns = turning_points(record.record.voltage, _TURN * float(np.ptp(record.record.voltage)))
        events = np.setdiff1d(np.flatnonzero(known), [0, *turns, known.size - 1])
        counts = np.isin(time, record.record.time[events])
        measured = simulated + np.interp(time, time[counts], (measured - simulated)[counts])
    whole = Trace(record.name, role, time, voltage, measured, simulated, record.start, counts)
    trace = whole.counted
    settled, error, time = whole.settled.counted, trace.residual, trace.time
    curve, slope = record.drift_curve(record.record), float(compared.frame.motion.drift[0])
    drift = np.interp(time, record.record.time, curve)
    drifting = error + slope * (drift - drift.mean())
    return RecordErrors(
        record=record.name,
        role=role,
        samples=time.size,
        left_out=(record.samples if known is None else events.size) - time.size,
        largest=largest(error),
        rms=rms(error),
        largest_with_drift=largest(drifting),
        rms_with_drift=rms(drifting),
        stroke=compared.frame.stroke,
        offset=float(np.median(list(compared.found.offsets.values()))) - compared.base,
        zero=float(compared.frame.motion.zero[0]),
        drift=slope,
        decades=float(np.ptp(curve)),
        steady=record.steady,
        starts=starts,
        settled_largest=float(np.quantile(np.abs(settled.residual), 1 - _OUTLIERS, method="lower")),
        settled_rms=max(rms(settled.residual), rms_over_travel(settled)),
    ), whole


def rms_over_travel(trace: Trace) -> float:
    """Return the RMS residual [m] over the travel of the voltage, in which fast branches count like slow ones."""
    way = np.abs(np.diff(trace.voltage, prepend=trace.voltage[0])) + 1e-300
    return float(np.average(trace.residual**2, weights=way) ** 0.5)


def _runs(piece: Record, first: int, last: int) -> Iterator[tuple[int, int, bool]]:
    """Yield the first and one after the last sample of runs of one kind, and whether their samples count."""
    edges = [first, last]
    # Between events the voltage drives the model.
    counted = usable(piece)
    edges[1:1] = [k for k in (np.flatnonzero(np.diff(counted)) + 1).tolist() if first < k < last]
    for start, stop in pairwise(edges):
        yield start, stop, bool(counted[start])
