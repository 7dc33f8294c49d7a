"""Comparison of measurement and simulation: a model simulated from a state that the record determines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from dehyst._errors import IdentifyError
from dehyst._native import slip_elongations
from dehyst._threads import one_thread
from dehyst._types import Array
from dehyst.identification.preprocessing.denoising import derivatives, disturbs, left_of
from dehyst.identification.preprocessing.preparation import Prepared, as_list, prepare
from dehyst.identification.preprocessing.regressors import Epoch, Piece, RowSource
from dehyst.identification.regression.coefficients import Coefficients
from dehyst.identification.regression.nuisances import find_datum
from dehyst.identification.regression.regression import Regression
from dehyst.identification.results import RecordErrors, Trace
from dehyst.identification.rules import RULES
from dehyst.identification.start_state import StartState, fit_start, fit_strained
from dehyst.identification.structure import Grid
from dehyst.model import Actuator, DisplacementCreep, Identification, State
from dehyst.records import Record, largest, rms, turning_points

# Rows of a program: of a longer record they are means of samples, or some of its samples, evenly.
MOST_ROWS = 200_000
# Samples that the carts at a start are fitted to, and how many of them after all elements are in a known state.
_START_SAMPLES, _KNOWN_SAMPLES = 1000, 200
# Least slope of a branch, of the mean one: a weight must not grow without bound.
_LEAST = 0.05
# Part of the samples that count as outliers.
_OUTLIERS = 1e-3


@dataclass(frozen=True, eq=False)
class RecordComparison:
    """A record compared with a model: its samples that count, and the constants that it needs.

    Attributes
    ----------
    given : Prepared
    stroke : float
        Reference of the percentages [m].
    source : RowSource
        The pieces of `record`, voltages delayed; with dynamics the displacements are those that hysteresis makes,
        before the resonance.
    measured : list of Record
        The same pieces with the displacements measured.
    whole : list of Piece
        The pieces with all their samples, measured, voltages delayed: those that are played.
    regression : Regression
        Its rows, with its datum and drift.
    found : Coefficients
        The model's, with this record's constants and drift [V].
    base : float
        Voltage of the model's spring at its first knot [V]: a constant less this is an offset.
    creep : DisplacementCreep or None
        Creep in displacement that was taken out of all displacements here: `pieces`, states and what is played are
        those before it.
    """

    given: Prepared
    stroke: float
    source: RowSource
    measured: list[Record]
    whole: list[Piece]
    regression: Regression
    found: Coefficients
    base: float
    creep: DisplacementCreep | None = None

    @property
    def record(self) -> Prepared:
        """The record, reduced."""
        return self.given.reduced

    @property
    def pieces(self) -> list[Piece]:
        """Of `source`."""
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
    def offsets(self) -> list[float]:
        """Offset [V] of each epoch; an epoch without rows after thinning has the offset of the nearest one."""
        known = sorted(self.found.offsets)
        nearest = [min(known, key=lambda k: abs(k - epoch)) for epoch in range(self.source.count)]
        return [self.found.offsets[k] - self.base for k in nearest]

    def last_offsets(self) -> list[float]:
        """Offset [V] of the last epoch of each piece; a piece without epochs has the offset of the piece before."""
        offsets = self.offsets
        return [offsets[max(count - 1, 0)] for count in np.cumsum([len(own) for own in self.epochs])]

    def played(self, actuator: Actuator) -> list[tuple[int, Epoch, tuple[Array, ...]]]:
        """Piece number, epoch, and result of `play` for every epoch."""
        parts, left = [], iter(self.offsets)
        for number, own in enumerate(self.epochs):
            for epoch in own:
                begin, span = (self.state_before(actuator, number, epoch), next(left)), slice(epoch.start, epoch.stop)
                runs = self.play(actuator, number, span, begin)
                parts.append((number, epoch, tuple(map(joined, zip(*runs, strict=True)))))
        return parts

    def play(
        self, actuator: Actuator, number: int, span: slice, begin: tuple[State, float]
    ) -> Iterator[tuple[Array, ...]]:
        """Time, voltage, measured, simulated, and simulated with the drift left in, of each run of samples that count.

        Over samples of the reduced piece of this number, from a state of the record's axis, its voltages less an offset
        [V]. In excluded stretches, the measured displacement drives the model.
        """
        (_, piece, curve), (state, offset), block = self.whole[number], begin, self.given.block
        last = len(piece) if span.stop == len(self.measured[number]) else span.stop * block
        first = span.start * block + block // 2
        drift = self.drift * curve
        level = float(drift[first:last].mean())
        # The piece's voltages are those that act, behind the amplifier.
        model = actuator.before_creep
        model = replace(model, lag=0.0) if actuator.lag else model
        # Without a drift both are the same motion.
        states = [state.shifted(self.datum)] * (2 if self.drift else 1)
        for start, stop, counted in _runs(piece, first, last):
            # A run's first sample has no step of time before it: a later one repeats the sample that the state is of.
            again = int(actuator.needs_time and start > first)
            run, own = slice(start - again, stop), slice(start, stop)
            time = piece.time[run] if model.needs_time else None
            measured = piece.displacement[run] + self.datum
            if counted:
                less_of: list[Array | float] = [drift[run], level]
                motions = [
                    model.simulate(
                        without_offset(actuator, piece.voltage[run], offset, less),
                        time=time,
                        state=state,
                        extrapolate=True,
                    )
                    for state, less in zip(states, less_of, strict=False)
                ]
                simulated, drifted = motions[0].displacement[again:], motions[-1].displacement[again:]
            else:
                motions = [model.compensate(measured, time=time, state=state, extrapolate=True) for state in states]
                simulated = drifted = measured[again:]
            states = [motion.state for motion in motions]
            voltage = without_offset(actuator, piece.voltage[own], offset)
            yield piece.time[own], voltage, measured[again:], simulated, drifted

    def start_of(self, actuator: Actuator, number: int, first: int = 0) -> tuple[State, float]:
        """Return the state at a piece's sample `first` on the record's axis, and the offset of its voltages [V].

        The carts are those that explain its voltages best before the displacement alone determines them.
        """
        own, (_, piece, curve) = self.epochs[number], self.pieces[number]
        last = own[-1] if own else Epoch(0, 0, len(piece), 0.0)
        standing = bool(np.any((2 * actuator.slip.breakaway > last.reach) & (actuator.slip.friction > 0)))
        stop = last.stop if standing else max(last.start, first) + _KNOWN_SAMPLES
        path = piece.displacement[first:stop]
        # Samples that lead elements as all of them do: the first one, the turning points, and some evenly.
        places = np.arange(path.size)
        if path.size > _START_SAMPLES:
            some = np.linspace(0, path.size - 1, _START_SAMPLES).astype(np.intp)
            places = np.union1d(some, turning_points(path, 1e-3 * float(np.ptp(path))))
        places, y = first + places, path[places] + self.datum
        states = self.source.states[number][places]
        tau, voltage, (creep, smooth, fades) = actuator.transformer, piece.voltage[places], self._split(states)
        held, most = voltage if tau is None else tau(voltage), np.zeros(fades.shape[1])
        if actuator.creep is not None:
            held = held - creep @ actuator.creep.stiffness
            most = float(np.ptp(self.regression.grid.knots)) * actuator.creep.stiffness
        held = held - actuator.spring(y) - self.drift * curve[places]
        known = None if standing or not own else self.last_offsets()[number]
        counted = None if piece.counted is None else piece.counted[places]

        def fit(force: Array, fading: Array, largest: Array) -> StartState:
            return fit_start(actuator.slip, y, force, fading, largest, known, counted)

        start, begun = (
            fit(held if actuator.smooth is None else held - smooth @ actuator.smooth.stiffness, fades, most),
            None,
        )
        if actuator.smooth is not None:
            # At rest, unless the voltages before the elements forget say otherwise.
            strained, elongations = fit_strained(actuator.smooth, y, held, fades, most, fit)
            if strained.cost < RULES.carts_alone_gain * start.cost:
                start, begun = strained, elongations
        state = self.state_before(actuator, number, Epoch(first, first, first + 1, 0.0), start.held)
        state = replace(state, carts=start.carts - self.datum)
        return (state if begun is None else replace(state, smooth=begun)), start.constant

    def state_before(self, actuator: Actuator, number: int, epoch: Epoch, begun: Array | None = None) -> State:
        """Return the state at an epoch's first sample on the record's axis: the displacement before determines it.

        Creep branches held `begun` (J,) [V] as the record began, by default the start that was fitted.
        """
        begun = self.found.starts.get(0, np.zeros(0)) if begun is None else begun
        rho = actuator.slip.breakaway
        y = self.pieces[number].path.displacement[: epoch.start + 1]
        carts = np.full(rho.size, y[0])
        _, carts = slip_elongations(rho, carts, np.ascontiguousarray(y))
        carts = np.where(2 * rho <= epoch.reach, carts, epoch.middle)
        creep, smooth, left = self._split(self.source.states[number][epoch.start])
        if actuator.creep is not None and begun.size:
            c = actuator.creep.stiffness
            creep = creep + np.divide(begun * left, c, out=np.zeros_like(left), where=c > 0)
        motion: list[float] = []
        if actuator.dynamics is not None:
            measured = self.measured[number]
            motion = [measured.displacement[epoch.start], derivatives(measured)[0][epoch.start]]
        return State(float(y[-1]), np.clip(carts, y[-1] - rho, y[-1] + rho), creep, motion, smooth)

    def on_model_axis(self, state: State, time: float) -> State:
        """Return a state of the record's axis at a `time` [s] on the model's, creep in displacement included."""
        state = state.shifted(self.datum)
        if self.creep is None:
            return state
        return replace(state, displacement_creep=self.given.creep_strains(self.creep, np.array([time]))[0])

    def with_creep(self, runs: Iterator[tuple[Array, ...]], start: State) -> Iterator[tuple[Array, ...]]:
        """Yield the `runs` of `play` with creep in displacement, from a `start` that includes it."""
        if self.creep is None:
            yield from runs
            return
        strains, ends = [start.displacement_creep] * 3, [np.zeros(0)] * 4
        for time, voltage, *paths in runs:
            columns = [np.append(end, column) for end, column in zip(ends, (time, *paths), strict=True)]
            crept = []
            for k, path in enumerate(columns[1:]):
                y, strains[k] = self.creep.added(columns[0], path, strains[k])
                crept.append(y[-time.size :])
            ends = [column[-1:] for column in columns]
            yield (time, voltage, *crept)

    def _split(self, states: Array) -> list[Array]:
        """Return internal states as creep strains, smooth elongations and decays."""
        grid = self.source.grid
        return np.split(states, np.cumsum([grid.time_constants.size, grid.lengths.size]), axis=-1)


def compare(
    actuator: Actuator, record: Prepared, stroke: float, *, datum: float | None = None, drifting: bool = False
) -> RecordComparison:
    """Compare a record with a model: fit constants, datum and drift by least squares with the model fixed.

    `stroke` [m]: reference of the percentages. `datum` [m]: shift to the model's axis; default: estimated. `drifting`:
    whether a drift is fitted too. Raise `IdentifyError` if no sample counts.
    """
    creep = actuator.displacement_creep
    if creep is not None:
        record, actuator = record.without_creep(creep), actuator.before_creep
    few, whole = record.reduced, record.delayed(0, actuator.delay, actuator.lag)
    measured = whole if record.block == 1 else few.delayed(0, actuator.delay, actuator.lag)
    pieces = measured
    if _denoised(actuator, few.noise, stroke):
        paths = few.driving(actuator.delay, actuator.lag, actuator.dynamics, stroke)
        pieces = [one._replace(path=path) for one, path in zip(measured, paths, strict=True)]
    grid = Grid.of_actuator(actuator, np.ones(len(actuator.slip), dtype=bool))
    source = RowSource.of(pieces, grid, [left_of(few.noise, stroke)] * len(pieces), leads=[few.lead])
    if not len(source):
        lasts = float(np.ptp(record.record.time))
        raise IdentifyError(
            f"{record.record.name}: no sample counts; it lasts {lasts:.3g} s, and the model lags by "
            f"{actuator.delay + actuator.lag:.3g} s. Record longer, or check the unit of the time"
        )
    spring, model = actuator.spring, Coefficients.from_actuator(actuator)
    regression = Regression(
        source.thinned(MOST_ROWS),
        grid,
        min(_LEAST * float(np.ptp(spring.voltage)) / float(np.ptp(grid.knots)), float(spring.slopes.min())),
        np.zeros(1),
        (0,) if drifting else (),
        (0,) if grid.time_constants.size else (),
    )
    if datum is None:
        datum = find_datum(regression, 0, stroke, given=model)
    regression = replace(regression, datum=np.array([datum]))
    found, samples = regression.fit_nuisances(model), [one.path for one in measured]
    return RecordComparison(record, stroke, source, samples, whole, regression, found, float(spring.voltage[0]), creep)


def _denoised(actuator: Actuator, noise: float, stroke: float) -> bool:
    """Whether noise is taken out of the path: Maxwell-slip elements take a displacement of little noise as it is."""
    return actuator.wide or disturbs(noise, stroke)


def prepare_for(actuator: Actuator, record: Record) -> Prepared:
    """Prepare a record as for an identification: at the reference temperature, without the lag of the sensor."""
    known = actuator.identification or Identification()
    return prepare(actuator.at_reference(record), ringing=known.ringing).without_lag(known.sensor_lag)


def compare_all(actuator: Actuator, records: Record | Sequence[Record]) -> tuple[tuple[RecordComparison, ...], float]:
    """Compare an actuator with the records that it was identified from, by the options of its identification.

    Returns
    -------
    tuple of RecordComparison, float
        One for each record, and the range of the widest loop [m].
    """
    prepared = [prepare_for(actuator, record).with_block(len(record) / MOST_ROWS) for record in as_list(records)]
    known = actuator.identification or Identification()
    stroke = max(high - low for low, high in (item.span() for item in prepared))
    datum = 0.0 if known.shared_datum else None
    # Where branches creep, a drift of the record would be counted twice.
    drift = known.drift and actuator.creep is None
    with one_thread():
        compared = tuple(
            compare(actuator, item, stroke, datum=datum, drifting=drift and item.can_drift) for item in prepared
        )
    return compared, stroke


def state_after(actuator: Actuator, lead: Record, stroke: float | None = None) -> tuple[State, float]:
    """Return the state at a record's last sample, on the model's axis, and the offset of the record's voltages [V].

    The record's displacements determine the state and the shift of its sensor's zero; the offset is fitted by least
    squares over the samples that count. If no sample counts, because the record is too short or has no full cycle, the
    offset is taken from its last sample, and the remaining uncertainty of the carts is ignored.

    `actuator`: the model. `lead`: the record before the state. `stroke` [m]: range of the widest training loop; default
    that between the actuator's limits.
    """
    stroke = float(np.ptp(actuator.reach)) if stroke is None else stroke
    try:
        compared = compare(actuator, prepare_for(actuator, lead), stroke)
        own = compared.epochs[-1]
    except ValueError:
        own = []
    if own:
        number = len(compared.pieces) - 1
        last = replace(own[-1], start=len(compared.measured[number]) - 1)
        state = compared.state_before(actuator, number, last)
        end = float(compared.measured[number].time[-1])
        state = compared.on_model_axis(state, end)
        if compared.creep is not None:
            # At rest after its motion, which does not count, the record creeps on.
            rested = np.exp(-(float(lead.time[-1]) - end) / compared.creep.time_constants)
            state = replace(state, displacement_creep=rested * state.displacement_creep)
        return state, compared.last_offsets()[-1]
    behind, y = actuator.displacement_creep, lead.displacement
    crept: Array | tuple[()] = ()
    if behind is not None:
        y = behind.removed(lead.time, y)
        crept = behind.strains(lead.time, y)[-1]
    _, carts = slip_elongations(actuator.slip.breakaway, np.full(len(actuator.slip), y[0]), np.ascontiguousarray(y))
    creep = () if actuator.creep is None else actuator.creep.strains(lead.time, y)[-1]
    smooth = () if actuator.smooth is None else actuator.smooth.elongations(y)[-1]
    state = State(float(y[-1]), carts, creep, smooth=smooth, displacement_creep=crept)
    held, given = actuator.voltage(state), float(lead.voltage[-1])
    tau = actuator.transformer
    return state, given - held if tau is None else float(tau(given) - tau(held))


def initial_state(actuator: Actuator, record: Record, stroke: float | None = None) -> tuple[State, float]:
    """Return the state at a record's beginning, on the model's axis, and the offset of the record's voltages [V].

    It is the start from which the simulation is nearest to the record, as in `RecordErrors.starts`: its carts, creep
    strains and smooth elongations explain the first voltages best (`fit_start`).

    `actuator`: the model. `record`: the record that began in the state. `stroke` [m]: range of the widest training
    loop; default that between the actuator's limits. Raise `RecordError` if the record is too short to be compared.
    """
    stroke = float(np.ptp(actuator.reach)) if stroke is None else stroke
    compared = compare(actuator, prepare_for(actuator, record), stroke)
    piece = compared.pieces[0].path
    first = _first_sample(piece, actuator.delay)
    state, offset = compared.start_of(actuator, 0, first)
    return compared.on_model_axis(state, float(piece.time[first])), offset


def _first_sample(piece: Record, delay: float) -> int:
    """Return the first sample that counts, and whose voltage is recorded: none is before the delay [s] is over."""
    first = min(int(np.ceil(delay / piece.sample_time)), len(piece) - 1) if delay > 0 else 0
    return first if piece.counted is None else max(first, int(np.argmax(piece.counted)))


def errors_of(actuator: Actuator, compared: RecordComparison, role: str) -> tuple[RecordErrors, Trace]:
    """Simulate each piece of a record whole, from the best-fitting state at its first sample, and compare.

    `role`: "training" or "validation".
    """
    found, regression, record = compared.found, compared.regression, compared.given
    # Errors are steady, then with the drift left in.
    starts, drawn, samples, worst, squares = [], [], 0, [0.0, 0.0], [0.0, 0.0]
    for number, (_, piece, _) in enumerate(compared.pieces):
        first = _first_sample(piece, actuator.delay)
        start = compared.start_of(actuator, number, first)
        starts.append(compared.on_model_axis(start[0], float(piece.time[first])))
        runs = compared.play(actuator, number, slice(first, len(piece)), start)
        for played in compared.with_creep(runs, starts[-1]):
            columns = counted_of(played, piece)
            drawn.append(columns[:4])
            samples += columns[0].size
            for k, simulated in enumerate(columns[3:]):
                error = columns[2] - simulated
                worst[k] = max(worst[k], largest(error))
                squares[k] += float(np.sum(error**2))
    time, voltage, measured, simulated = (np.concatenate(column) for column in zip(*drawn, strict=True))
    trace = Trace(record.name, role, time, voltage, measured, simulated, record.start)
    settled = np.abs(trace.settled.residual)
    whole, with_drift = (float(np.sqrt(one / samples)) for one in squares)
    return RecordErrors(
        record=record.name,
        role=role,
        samples=samples,
        left_out=record.samples - samples,
        largest=worst[0],
        rms=whole,
        largest_with_drift=worst[1],
        rms_with_drift=with_drift,
        stroke=compared.stroke,
        offset=float(np.median(list(found.offsets.values()))) - compared.base,
        datum=actuator.at_rest * compared.datum,
        drift=-actuator.at_rest * compared.drift / float(np.median(regression.slope(found))),
        decades=float(np.ptp(regression.rows.drift)),
        steady=record.steady,
        starts=tuple(starts),
        settled_largest=float(np.quantile(settled, 1 - _OUTLIERS, method="lower")),
        settled_rms=rms(settled),
    ), trace


def joined(parts: Sequence[Array]) -> Array:
    """Return arrays one after the other; a single one is not copied."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def counted_of(played: tuple[Array, ...], piece: Record) -> tuple[Array, ...]:
    """Return the samples of `RecordComparison.play` that are not set aside."""
    if not piece.set_aside:
        return played
    time = played[0]
    kept = np.ones(time.size, dtype=bool)
    for first, last in piece.set_aside:
        kept &= (time < first) | (time > last)
    return tuple(column[kept] for column in played)


def _runs(piece: Record, first: int, last: int) -> Iterator[tuple[int, int, bool]]:
    """Yield the first and one after the last sample of runs of one kind, and whether their samples count."""
    edges = [first, last]
    if piece.counted is not None:
        edges[1:1] = [k for k in (np.flatnonzero(np.diff(piece.counted)) + 1).tolist() if first < k < last]
    for start, stop in pairwise(edges):
        yield start, stop, piece.counted is None or bool(piece.counted[start])


def without_offset(actuator: Actuator, voltage: Array, offset: float, drift: Array | float = 0.0) -> Array:
    """Voltages (n,) [V] less offset and drift, which a transformer's curve does not bend."""
    tau = actuator.transformer
    if tau is None:
        return voltage - offset - drift
    return tau.inverse(tau(voltage) - offset - drift)
