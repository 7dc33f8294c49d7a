"""Measured against simulated: a model played along a record, from a state that the record itself determines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count, pairwise

import numpy as np
from numpy.typing import NDArray

from dehyst._native import slip_elongations
from dehyst._threads import one_thread
from dehyst._types import Array
from dehyst.identification.preprocessing.denoising import derivatives, disturbs, left_of, remove_dynamics, remove_jitter
from dehyst.identification.preprocessing.preparation import Prepared, as_list, prepare
from dehyst.identification.preprocessing.regressors import Epoch, Piece, RowSource
from dehyst.identification.regression.coefficients import Coefficients
from dehyst.identification.regression.nuisances import find_datum
from dehyst.identification.regression.regression import Regression
from dehyst.identification.results import RecordErrors, Trace
from dehyst.identification.start_state import fit_start
from dehyst.identification.structure import Grid
from dehyst.model import Actuator, Identification, Motion, State
from dehyst.records import Record
from dehyst.records.signals import largest, turning_points

# Rows in memory: more are gone through in blocks.
MOST_ROWS = 200_000
# Of a longer record so many suffice for what is not found by going through them all.
_FEW_ROWS = 20_000
# Samples played at a time, and kept for pictures.
_AT_A_TIME = 1 << 20
_MOST_DRAWN = 1 << 20
# Elongations of all elements are made for each of these samples.
_STOPS_AT_A_TIME = 32_768
# Samples that the carts at a start are fitted to, and how many of them after all elements are in a known state.
_START_SAMPLES, _KNOWN_SAMPLES = 1000, 200
# Least slope of a branch, of the mean one: a weight must not grow without bound.
_LEAST = 0.05


@dataclass(frozen=True, eq=False)
class RecordComparison:
    """A record compared with a model: its samples that count, and the constants that it needs.

    Attributes
    ----------
    given : Prepared
    record : Prepared
        Reduced.
    stroke : float
        Reference of the percentages [m].
    source : RowSource
        Its pieces, voltages delayed; with dynamics the displacements are those that hysteresis makes, before the
        resonance.
    measured : list of Record
        The same pieces with the displacements measured.
    regression : Regression
        Its rows (of a long record some, evenly), with its datum and drift.
    found : Coefficients
        The model's, with this record's constants and drift [V].
    base : float
        Voltage of the model's spring at its first knot [V]: a constant less this is an offset.
    whole : list of (number, Record, drift curve (n,))
        The pieces with all their samples, measured, voltages delayed: those that are played.
    """

    given: Prepared
    record: Prepared
    stroke: float
    source: RowSource
    measured: list[Record]
    regression: Regression
    found: Coefficients
    base: float
    whole: list[tuple[int, Record, Array]]

    @property
    def pieces(self) -> list[Piece]:
        """Record number, piece and drift curve of each piece of `source`."""
        return self.source.pieces

    @property
    def epochs(self) -> list[list[Epoch]]:
        """Of each piece."""
        return self.source.epochs

    @property
    def datum(self) -> float:
        """Shift [m] to the model's axis."""
        return float(self.regression.datum[0])

    @property
    def drift(self) -> float:
        """Coefficient of the drift curve [V]."""
        return self.found.drifts.get(0, 0.0)

    @property
    def start(self) -> Array:
        """What creep branches held as the record began (J,) [V]."""
        return self.found.starts.get(0, np.zeros(0))

    @property
    def offsets(self) -> list[float]:
        """Offset [V] of each epoch; one of which thinning left no row has that of the nearest."""
        known = sorted(self.found.offsets)
        nearest = [min(known, key=lambda k: abs(k - epoch)) for epoch in range(self.source.count)]
        return [self.found.offsets[k] - self.base for k in nearest]

    def played(self, actuator: Actuator) -> list[tuple[int, Epoch, tuple[Array, ...]]]:
        """Piece number, epoch, and what `play` gives, of every epoch."""
        parts, left = [], iter(self.offsets)
        for number, own in enumerate(self.epochs):
            for epoch in own:
                state, size = self.state_before(actuator, number, epoch), epoch.stop - epoch.start
                runs = self.play(
                    actuator, number, slice(epoch.start, epoch.stop), (state, next(left)), self.given.block * size
                )
                parts.append((number, epoch, tuple(map(np.concatenate, zip(*runs, strict=True)))))
        return parts

    def last_offsets(self) -> list[float]:
        """Offset [V] of the last epoch of each piece, that of the one before where a piece has none."""
        offsets = self.offsets
        return [offsets[max(count - 1, 0)] for count in np.cumsum([len(own) for own in self.epochs])]

    def play(
        self, actuator: Actuator, number: int, span: slice, begin: tuple[State, float], size: int
    ) -> Iterator[tuple[Array, ...]]:
        """Time, voltage, measured, simulated, and simulated with the drift left in, `size` samples at a time.

        Over samples of the reduced piece of this number, from a state of the record's axis, its voltages less an offset
        [V]. Through what is set aside the displacement leads the model.
        """
        (_, piece, curve), (state, offset) = self.whole[number], begin
        block = self.given.block
        last = len(piece) if span.stop == len(self.measured[number]) else span.stop * block
        span = slice(span.start * block + block // 2, last)
        y, drift = piece.displacement, self.drift * curve
        level = float(drift[span].mean())
        steady = drifting = state.shifted(self.datum)
        for start, stop, counted in _runs(piece, span, size):
            # A run's first sample has no step of time before it: a later one repeats the sample that the state is of.
            again = int(actuator.needs_time and start > span.start)
            run, own = slice(start - again, stop), slice(start, stop)
            if not counted:
                steady, drifting = (_followed(actuator, piece, run, self.datum, one) for one in (steady, drifting))
                moved = y[own] + self.datum
                yield piece.time[own], without_offset(actuator, piece.voltage[own], offset), moved, moved, moved
                continue
            one = _driven(actuator, piece, run, (offset, drift[run]), steady)
            other = _driven(actuator, piece, run, (offset, level), drifting)
            steady, drifting = one.state, other.state
            voltage = without_offset(actuator, piece.voltage[own], offset)
            yield piece.time[own], voltage, y[own] + self.datum, one.displacement[again:], other.displacement[again:]

    def start_of(self, actuator: Actuator, number: int, first: int = 0) -> tuple[State, float]:
        """Return the state at a piece's sample `first` on the record's axis, and the offset of its voltages [V].

        The carts are those that explain its voltages best before the displacement alone determines them.
        """
        own, piece = self.epochs[number], self.pieces[number][1]
        last = own[-1] if own else Epoch(0, 0, len(piece), 0.0)
        standing = bool(np.any((2 * actuator.slip.breakaway > last.reach) & (actuator.slip.friction > 0)))
        stop = last.stop if standing else max(last.start, first) + _KNOWN_SAMPLES
        places = first + _places(piece.displacement[first:stop])
        y = piece.displacement[places] + self.datum
        rows = [
            block[places[(places >= k) & (places < k + len(block))] - k]
            for k, block in zip(count(0, _STOPS_AT_A_TIME), self.source.states(number, _STOPS_AT_A_TIME))
        ]
        states = np.concatenate(rows)
        tau, spring = actuator.transformer, actuator.spring(y)
        force = piece.voltage[places] if tau is None else tau(piece.voltage[places])
        internal = np.split(
            states, np.cumsum([self.regression.grid.time_constants.size, self.regression.grid.lengths.size]), axis=1
        )
        fades, most = internal[2], np.zeros(internal[2].shape[1])
        if actuator.creep is not None:
            force = force - internal[0] @ actuator.creep.stiffness
            most = float(np.ptp(self.regression.grid.knots)) * actuator.creep.stiffness
        if actuator.smooth is not None:
            force = force - internal[1] @ actuator.smooth.stiffness
        known = None if standing or not own else self.last_offsets()[number]
        held = force - spring - self.drift * self.pieces[number][2][places]
        counted = None if piece.counted is None else piece.counted[places]
        start = fit_start(actuator.slip, y, held, fades, most, known, counted)
        state = self.state_before(actuator, number, Epoch(first, first, first + 1, 0.0), start.creep)
        return replace(state, carts=start.carts - self.datum), start.constant

    def state_before(self, actuator: Actuator, number: int, epoch: Epoch, begun: Array | None = None) -> State:
        """Return the state at an epoch's first sample on the record's axis: the displacement before determines it.

        Creep branches held `begun` (J,) [V] as the record began, by default the start that was fitted.
        """
        begun = self.start if begun is None else begun
        rho, grid = actuator.slip.breakaway, Grid.of_actuator(actuator)
        y = self.pieces[number][1].displacement[: epoch.start + 1]
        carts = np.full(rho.size, y[0])
        for start in range(0, y.size, _STOPS_AT_A_TIME):
            _, carts = slip_elongations(rho, carts, np.ascontiguousarray(y[start : start + _STOPS_AT_A_TIME]))
        carts = np.where(2 * rho <= epoch.reach, carts, epoch.middle)
        moved = self.source.state_at(number, epoch.start)
        creep, smooth, left = np.split(moved, np.cumsum([grid.time_constants.size, grid.lengths.size]))
        if actuator.creep is not None and begun.size:
            c = actuator.creep.stiffness
            creep = creep + np.divide(begun * left, c, out=np.zeros_like(left), where=c > 0)
        motion: list[float] = []
        if actuator.dynamics is not None:
            measured = self.measured[number]
            motion = [measured.displacement[epoch.start], derivatives(measured)[0][epoch.start]]
        return State(float(y[-1]), np.clip(carts, y[-1] - rho, y[-1] + rho), creep, motion, smooth)


def compare(
    actuator: Actuator, record: Prepared, stroke: float, *, datum: float | None = None, drifting: bool = False
) -> RecordComparison:
    """Compare a record with a model: fit constants, datum and drift by least squares, the model held fixed.

    `stroke` [m]: reference of the percentages. `datum` [m]: shift to the model's axis; default: estimated. `drifting`:
    whether a drift is set aside.
    """
    delay, few, whole = actuator.delay, record.reduced, record.delayed(0, actuator.delay, actuator.lag)
    measured = whole if record.block == 1 else few.delayed(0, delay, actuator.lag)
    pieces = [(q, _path(actuator, piece, few.noise, stroke), drift) for q, piece, drift in measured]
    grid = Grid.of_actuator(actuator, np.ones(len(actuator.slip), dtype=bool))
    noise = [left_of(few.noise, stroke)] * len(pieces)
    source = RowSource.of(pieces, grid, noise, leads=[few.lead])
    regression, model = (
        _regression(actuator, source, grid, (0,) if drifting else ()),
        Coefficients.from_actuator(actuator),
    )
    if datum is None:
        datum = find_datum(regression, 0, stroke, given=model)
    regression = replace(regression, datum=np.array([datum]), source=None if regression.strained else source)
    found = regression.fit_nuisances(model)
    base = float(actuator.spring.voltage[0])
    samples = [piece for _, piece, _ in measured]
    return RecordComparison(record, few, stroke, source, samples, regression, found, base, whole)


def prepare_for(actuator: Actuator, record: Record) -> Prepared:
    """Prepare a record as those that an actuator was identified from: before its sensor's lag, if that was given."""
    known = actuator.identification or Identification()
    return prepare(record, ringing=known.ringing).without_lag(known.sensor_lag)


def compare_all(
    actuator: Actuator, records: Record | Sequence[Record]
) -> tuple[tuple[RecordComparison, ...], float, float]:
    """Put the records that an actuator was identified from beside it, by the options of its identification.

    Returns
    -------
    tuple of Comparison, float, float
        One a record, the range of the widest loop [m], and the least slope that the spring was allowed [V/m].
    """
    prepared = [prepare_for(actuator, record) for record in as_list(records)]
    known = actuator.identification or Identification()
    spans = [high - low for low, high in (item.span() for item in prepared)]
    stroke, widest = max(spans), prepared[int(np.argmax(spans))].record
    datum = 0.0 if known.shared_datum else None
    # Where branches creep, a drift of the record would be counted twice.
    drift = known.drift and actuator.creep is None
    with one_thread():
        compared = tuple(
            compare(actuator, item, stroke, datum=datum, drifting=drift and item.can_drift) for item in prepared
        )
    return compared, stroke, float(np.ptp(widest.voltage)) / stroke * known.slope_floor


def state_after(actuator: Actuator, lead: Record, stroke: float | None = None) -> tuple[State, float]:
    """Return the state at a record's last sample, on the model's axis, and the offset of its voltages [V].

    Its displacements determine them, and how far its sensor's zero lies from the model's: the offset by least squares
    over the samples that count. Where none does, for the record is too short or has no full cycle, the offset is that
    of its last sample, and what the record leaves open of the carts is taken as none.

    `actuator`: the model. `lead`: the record before the state. `stroke` [m]: range of the widest training loop; default
    that between the actuator's limits.
    """
    stroke = float(np.ptp(actuator.reach)) if stroke is None else stroke
    try:
        record = prepare_for(actuator, lead)
        beside = compare(actuator, record, stroke)
        number, own = len(beside.pieces) - 1, beside.epochs[-1]
    except ValueError:
        own = []
    if own:
        last = replace(own[-1], start=len(beside.pieces[number][1]) - 1)
        return beside.state_before(actuator, number, last).shifted(beside.datum), beside.last_offsets()[-1]
    y = lead.displacement
    _, carts = slip_elongations(actuator.slip.breakaway, np.full(len(actuator.slip), y[0]), np.ascontiguousarray(y))
    creep = () if actuator.creep is None else actuator.creep.strains(lead.time, y)[-1]
    smooth = () if actuator.smooth is None else actuator.smooth.elongations(y)[-1]
    state = State(float(y[-1]), carts, creep, smooth=smooth)
    held, given = actuator.voltage(state), float(lead.voltage[-1])
    tau = actuator.transformer
    return state, given - held if tau is None else float(tau(given) - tau(held))


def initial_state(actuator: Actuator, record: Record, stroke: float | None = None) -> tuple[State, float]:
    """Return the state in which a record began, on the model's axis, and the offset of its voltages [V].

    The start from which the model's simulation is nearest to the record, as in `RecordErrors.starts`: the carts and
    creep strains that explain its first voltages best (`fit_start`). Smooth elements are taken as not elongated.

    `actuator`: the model. `record`: that began in the state. `stroke` [m]: range of the widest training loop; default
    that between the actuator's limits. Raise `RecordError` if the record is too short to be compared.
    """
    stroke = float(np.ptp(actuator.reach)) if stroke is None else stroke
    beside = compare(actuator, prepare_for(actuator, record), stroke)
    state, offset = beside.start_of(actuator, 0, _first_sample(beside.pieces[0][1], actuator.delay))
    return state.shifted(beside.datum), offset


def _first_sample(piece: Record, delay: float) -> int:
    """Return the first sample that counts, and whose voltage is recorded: none is before the delay [s] is over."""
    first = min(int(np.ceil(delay / piece.sample_time)), len(piece) - 1) if delay > 0 else 0
    return first if piece.counted is None else max(first, int(np.argmax(piece.counted)))


def _regression(actuator: Actuator, source: RowSource, grid: Grid, drifting: tuple[int, ...]) -> Regression:
    """Return the regression of a record for an actuator, on some of its samples if there are many."""
    most = MOST_ROWS if len(source) <= MOST_ROWS else _FEW_ROWS
    spring = actuator.spring
    floor = min(_LEAST * float(np.ptp(spring.voltage)) / float(np.ptp(grid.knots)), float(spring.slopes.min()))
    strained = (0,) if grid.time_constants.size else ()
    return Regression(source.thinned(most), grid, floor, np.zeros(1), drifting, strained, source=source)


def _path(actuator: Actuator, piece: Record, noise: float, stroke: float) -> Record:
    """Return the path that drives the elements; Maxwell-slip takes a displacement of little noise as it is."""
    if not actuator.wide and not disturbs(noise, stroke):
        return piece
    return remove_jitter(remove_dynamics(piece, actuator.dynamics), noise, stroke)


def errors_of(actuator: Actuator, compared: RecordComparison, role: str) -> tuple[RecordErrors, Trace]:
    """Simulate each piece of a record whole, from the state at its first sample that suits it best, and compare.

    `role`: "training" or "validation".
    """
    found, regression, record = compared.found, compared.regression, compared.given
    sums = _Sums(max(1, sum(len(piece) for _, piece, _ in compared.pieces) // _MOST_DRAWN))
    starts = []
    for number, (_, piece, _) in enumerate(compared.pieces):
        first = _first_sample(piece, actuator.delay)
        start = compared.start_of(actuator, number, first)
        starts.append(start[0].shifted(compared.datum))
        for played in compared.play(actuator, number, slice(first, len(piece)), start, _AT_A_TIME):
            sums.add(counted_of(played, piece))
    time, voltage, measured, simulated = (np.concatenate(column) for column in zip(*sums.drawn, strict=True))
    trace = Trace(record.name, role, time, voltage, measured, simulated, record.start)
    slope = float(np.median(regression.slope(found)))
    offset = float(np.median(list(found.offsets.values()))) - compared.base
    return RecordErrors(
        record=record.name,
        role=role,
        samples=sums.samples,
        left_out=record.samples - sums.samples,
        largest=sums.largest[0],
        rms=sums.rms[0],
        largest_with_drift=sums.largest[1],
        rms_with_drift=sums.rms[1],
        stroke=compared.stroke,
        offset=offset,
        datum=compared.datum,
        drift=-compared.drift / slope,
        decades=float(np.ptp(regression.rows.drift)),
        steady=record.steady,
        starts=tuple(starts),
    ), trace


def counted_of(played: tuple[Array, ...], piece: Record) -> tuple[Array, ...]:
    """Return those of the samples that `RecordComparison.play` yields which are not set aside."""
    if not piece.set_aside:
        return played
    time = played[0]
    kept = np.ones(time.size, dtype=bool)
    for first, last in piece.set_aside:
        kept &= (time < first) | (time > last)
    return tuple(column[kept] for column in played)


class _Sums:
    """Errors of a record, steady and with its drift, added up as it is played; every step-th sample is kept."""

    def __init__(self, step: int) -> None:
        self.samples, self.drawn, self.largest = 0, list[tuple[Array, ...]](), [0.0, 0.0]
        self._step, self._squares = step, [0.0, 0.0]

    @property
    def rms(self) -> list[float]:
        """Root mean squares of both errors [m]."""
        return [float(np.sqrt(squares / self.samples)) for squares in self._squares]

    def add(self, played: tuple[Array, ...]) -> None:
        """Add a stretch, as `RecordComparison.play` yields it."""
        first = -self.samples % self._step
        self.drawn.append(tuple(column[first :: self._step].copy() for column in played[:4]))
        self.samples += played[0].size
        for k, simulated in enumerate(played[3:]):
            error = played[2] - simulated
            self.largest[k] = max(self.largest[k], largest(error))
            self._squares[k] += float(np.sum(error**2))


def _runs(piece: Record, span: slice, size: int) -> Iterator[tuple[int, int, bool]]:
    """Yield the first and one after the last sample of runs of at most `size`, and whether their samples count."""
    edges = [span.start, span.stop]
    if piece.counted is not None:
        edges[1:1] = [k for k in (np.flatnonzero(np.diff(piece.counted)) + 1).tolist() if span.start < k < span.stop]
    for first, last in pairwise(edges):
        for start in range(first, last, size):
            yield start, min(start + size, last), piece.counted is None or bool(piece.counted[start])


def _followed(actuator: Actuator, piece: Record, run: slice, datum: float, state: State) -> State:
    """Return the state after a model has followed the displacements of a piece."""
    actuator = replace(actuator, lag=0.0) if actuator.lag else actuator
    time = piece.time[run] if actuator.needs_time else None
    path = piece.displacement[run] + datum
    reached: State = actuator.compensate(path, time=time, state=state, extrapolate=True).state
    return reached


def _driven(actuator: Actuator, piece: Record, span: slice, less: tuple[float, Array | float], state: State) -> Motion:
    """Play samples of a piece from a state, their voltages less offset and drift [V]."""
    # The piece's voltages are those that act, behind the amplifier.
    actuator = replace(actuator, lag=0.0) if actuator.lag else actuator
    time = piece.time[span] if actuator.needs_time else None
    voltage = without_offset(actuator, piece.voltage[span], *less)
    return actuator.simulate(voltage, time=time, state=state, extrapolate=True)


def _places(y: Array) -> NDArray[np.intp]:
    """Return samples that lead elements as all of them do: the first one, the turning points, and some evenly."""
    if y.size <= _START_SAMPLES:
        return np.arange(y.size)
    some = np.linspace(0, y.size - 1, _START_SAMPLES).astype(np.intp)
    return np.union1d(some, turning_points(y, 1e-3 * float(np.ptp(y))))


def without_offset(actuator: Actuator, voltage: Array, offset: float, drift: Array | float = 0.0) -> Array:
    """Voltages (n,) [V] less offset and drift, which a transformer's curve does not bend."""
    tau = actuator.transformer
    if tau is None:
        return voltage - offset - drift
    return tau.inverse(tau(voltage) - offset - drift)
