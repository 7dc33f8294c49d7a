"""Preparation of a record for identification: checks, removal of its start-up transient, cuts at gaps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from dehyst._errors import IdentifyError
from dehyst._types import Array
from dehyst.identification import cleaning
from dehyst.identification.cleaning import disturbs, local_polynomials, remove_dynamics, remove_jitter
from dehyst.identification.regressors import Epoch, epochs
from dehyst.identification.rules import RULES
from dehyst.model import DisplacementCreep, Dynamics, Thermal
from dehyst.records import Record, bandwidth, counting, interpolate, of_one_axis, reversals, usable

# Share of the voltage's energy above its bandwidth; least sample rate over this bandwidth; least number of samples of
# the shortest cycle, and of all training records.
_SHARE, _TIMES = 1e-5, 10.0
_A_CYCLE, ENOUGH = 60, 4000
# The samples of a mean ring if their range exceeds this number of standard deviations of the noise.
_RINGS = 8.0


def block_of(record: Record, most: float) -> int:
    """Return the number of samples that a mean may have: `most` at most, 1 at least."""
    # A mean of samples would shift an event.
    cycles = record.cycles() if most >= 2 and record.measured is None else []
    if not cycles:
        return 1
    fastest = min(cycle.stop - cycle.start for cycle in cycles) / _A_CYCLE
    voltage = record.voltage
    if (counted := counting(record)) is not None:
        # Changes in samples that are left out do not count.
        voltage = np.cumsum(np.where(counted, np.diff(voltage, prepend=voltage[0]), 0.0))
    of_motion = 1 / (_TIMES * bandwidth(voltage, record.sample_time, _SHARE) * record.sample_time)
    return max(int(min(fastest, of_motion, most)), 1)


def block_means(record: Record, block: int) -> Record:
    """Return the means of blocks of `block` neighbouring samples; an incomplete last block is dropped."""
    if block == 1:
        return record

    def means(values: Array) -> Array:
        whole = len(values) // block * block
        return np.asarray(values[:whole].reshape(-1, block).mean(axis=1))

    displacement, aside = means(record.displacement), record.set_aside
    if (counted := counting(record)) is not None:
        # A mean with a left-out sample is left out; while it rings, the extreme samples of a block drive the elements.
        wide = 0.5 * block * record.sample_time
        aside = tuple((first - wide, last + wide) for first, last in record.set_aside)
        blocks = record.displacement[: displacement.size * block].reshape(-1, block)
        # After the ringing has decayed, the extremes would be noise.
        rings = np.ptp(blocks, axis=1) > _RINGS * record.noise
        ends = np.where(np.arange(len(blocks)) % 2, blocks.max(axis=1), blocks.min(axis=1))
        whole = counted[: displacement.size * block].reshape(-1, block).any(axis=1)
        displacement = np.where(whole | ~rings, displacement, ends)
    return replace(
        record,
        set_aside=aside,
        time=means(record.time),
        voltage=means(record.voltage),
        displacement=displacement,
        others=tuple(channel._replace(values=means(channel.values)) for channel in record.others),
    )


# Least number of samples; the ends of a loop are at one place, apart from this part of its ranges.
_SHORTEST, _CLOSED = 20, 0.04
# Origin of the logarithm of a drift, in cycles before the record.
_FIRST = 0.1
# Cycles with more samples than this allow a wide window for derivatives.
_MANY = 100


@dataclass(frozen=True, eq=False)
class Prepared:
    """A prepared record; its voltages are not yet delayed.

    Attributes
    ----------
    record : Record
        The record without voltage glitches and start-up transient.
    lead : Record or None
        Rest and transient before the record, which determine the state of creep.
    pieces : tuple of Record
        The parts of `record` between gaps.
    name : str
    samples : int
        Number of samples of the original record, without rest before and after its motion.
    start : float
        Time of the first of these samples [s], the origin of creep.
    noise : float
        Standard deviation of the sensor [m].
    cycle : float
        Median duration of a cycle of the excitation [s].
    can_drift : bool
        Whether the record has enough cycles to separate drift from hysteresis.
    sentences : tuple of str
        Sentences about repairs of the record.
    steady : bool
        Whether the drift is linear in time, like the drift of a sensor, or else logarithmic, like creep.
    block : int
        Number of samples of a mean in `reduced`.
    """

    record: Record
    lead: Record | None
    pieces: tuple[Record, ...]
    name: str
    samples: int
    start: float
    noise: float
    cycle: float
    can_drift: bool
    sentences: tuple[str, ...]
    steady: bool = False
    block: int = 1
    # Last result of `driving`, by its arguments.
    _driving: dict[tuple[float, float, Dynamics | None, float], list[Record]] = field(
        default_factory=dict, init=False, repr=False
    )

    @cached_property
    def reduced(self) -> Prepared:
        """The record as means of `block` samples: the same motion with less noise."""
        if self.block == 1:
            return self
        lead = self.lead
        if lead is not None:
            size = min(self.block, max(len(lead) // 2, 1))
            # The last mean of the lead ends where the record begins.
            lead = block_means(lead[len(lead) % size :], size)
        pieces = tuple(block_means(piece, self.block) for piece in self.pieces)
        record = block_means(self.record, self.block)
        samples = self.samples // self.block
        return replace(self, record=record, lead=lead, pieces=pieces, samples=samples, noise=record.noise, block=1)

    def without_lag(self, lag: float) -> Prepared:
        """Return the record with the displacements before the first-order low-pass of the sensor: y + lag y'."""
        if not lag:
            return self
        demand_short(lag, "sensor_lag", self.cycle)
        # Cycles with few samples need a short window.
        window = 9 if self.cycle > _MANY * self.record.sample_time else 5

        def before(piece: Record) -> Array:
            rate = local_polynomials(piece.displacement, window, 4, 1, piece.sample_time)
            return np.asarray(piece.displacement + lag * rate)

        known = self if self.lead is None or len(self.lead) >= _SHORTEST else replace(self, lead=None)
        made = known.changed(before)
        sentence = f"{self.name}: the given lag of the sensor, {1e3 * lag:.4g} ms, was removed from the displacements."
        return replace(made, noise=made.record.noise, sentences=(*self.sentences, sentence))

    def without_creep(self, part: DisplacementCreep, start: Array | None = None) -> Prepared:
        """Return the record before creep in displacement; `start` (K,): strains at its begin [m], default: at rest."""
        time, y = self.with_lead
        m = part.removed(time, y, start)
        return self.changed(lambda piece: np.interp(piece.time, time, m), time[0])

    def at_reference(self, thermal: Thermal) -> Prepared:
        """Return the record corrected to the reference temperature; unchanged if it has no temperature."""

        def before(piece: Record) -> Array:
            temperature = piece.temperature
            return piece.displacement if temperature is None else thermal.at_reference(piece.displacement, temperature)

        return self.changed(before)

    def changed(self, displacement: Callable[[Record], Array], first: float = -np.inf) -> Prepared:
        """Return a copy with other displacements; a lead that begins before `first` [s] is left out."""

        def before(piece: Record) -> Record:
            return replace(piece, displacement=displacement(piece))

        lead = None if self.lead is None or self.lead.time[0] < first else before(self.lead)
        return replace(self, record=before(self.record), lead=lead, pieces=tuple(map(before, self.pieces)))

    @property
    def with_lead(self) -> tuple[Array, Array]:
        """Time and displacement of the record, with the lead before it if there is one."""
        lead, record = self.lead, self.record
        follows = lead is not None and (
            0 < record.time[0] - lead.time[-1] <= 0.75 * (lead.sample_time + record.sample_time)
        )
        parts = [lead, record] if lead is not None and follows else [record]
        return np.concatenate([part.time for part in parts]), np.concatenate([part.displacement for part in parts])

    def with_block(self, most: float) -> Prepared:
        """Return a copy with the block that the bandwidth of its motion allows, `most` samples at most."""
        shortest = min(map(len, self.pieces), default=0) / (2 * _SHORTEST)
        return replace(self, block=block_of(self.record, min(most, shortest)))

    def span(self) -> tuple[float, float]:
        """Return the lowest and highest displacement [m] of the samples that count and of the turns before them."""
        pieces, stroke = self.pieces, float(np.ptp(self.record.displacement))
        if disturbs(self.noise, stroke):
            # The extremes of noise do not belong to the stroke.
            pieces = tuple(remove_jitter(piece, self.noise, stroke) for piece in pieces)
        counted = counted_samples([(piece.displacement, epochs(piece, self.noise)) for piece in pieces])
        if not counted:
            raise IdentifyError(
                f"{self.record.name}: no sample counts, because the voltage never returns into its earlier range. "
                "Record at least one full cycle, better two"
            )
        return min(float(y.min()) for y in counted), max(float(y.max()) for y in counted)

    def acting(self, delay: float, lag: float = 0.0) -> Iterator[Record]:
        """Yield the pieces with acting voltages: `delay` [s] late, through an amplifier of time constant `lag` [s]."""
        for piece in self.pieces:
            late = piece
            if delay:
                times = np.clip(piece.time - delay, piece.time[0], piece.time[-1])
                late = replace(piece, voltage=interpolate(piece.time, piece.voltage, times))
            yield behind(late, lag)

    def driving(self, delay: float, lag: float, dynamics: Dynamics | None, stroke: float) -> list[Record]:
        """Return the acting pieces with the displacement that drives elements: before the resonance, without jitter."""
        asked = delay, lag, dynamics, stroke
        if asked not in self._driving:
            self._driving.clear()
            paths = (remove_dynamics(piece, dynamics) for piece in self.acting(delay, lag))
            self._driving[asked] = [remove_jitter(path, self.noise, stroke) for path in paths]
        return self._driving[asked]

    def drift_curve(self, piece: Record) -> Array:
        """Return the curve of a drift at the samples of a piece: log10 of the time since the record began, mean zero.

        The curve of a steady drift is a straight line with the same range.
        """
        return np.interp(piece.time, *self._drift_curve)

    @cached_property
    def _drift_curve(self) -> tuple[Array, Array]:
        time = self.record.time
        curve = np.log10(1 + (time - self.start) / (_FIRST * self.cycle))
        if self.steady:
            return time, (time - time.mean()) * float(np.ptp(curve)) / float(np.ptp(time))
        return time, curve - curve.mean()

    def source(self) -> dict[str, Any]:
        """Return the source of the record: name, file, hash and guesses."""
        meta = self.record.meta
        return {"name": self.record.name, **{key: meta[key] for key in ("source", "sha256", "guesses") if key in meta}}


def behind(record: Record, lag: float) -> Record:
    """Return a record with the output voltages of an amplifier of time constant `lag` [s]."""
    if not lag:
        return record
    strain = DisplacementCreep([lag], [0.0]).strains(record.time, record.voltage)[:, 0]
    return replace(record, voltage=record.voltage - strain)


def demand_short(seconds: float, argument: str, cycle: float) -> None:
    """Raise `IdentifyError` if a lag [s] is longer than a quarter of a cycle [s]."""
    if seconds > 0.25 * cycle:
        need = f"less than a quarter of a cycle of {cycle:.4g} s"
        raise IdentifyError(argument=argument, got=f"{seconds:g} s", need=need)


def counted_samples(columns: Sequence[tuple[Array, Sequence[Epoch]]]) -> list[Array]:
    """Return for each epoch the samples of a piece's column that count, and the turns before them."""
    return [np.append(values[epoch.start : epoch.stop], values[epoch.turn]) for values, own in columns for epoch in own]


def prepare(record: Record, *, ringing: bool = False) -> Prepared:
    """Check a record and remove unusable parts.

    `ringing`: whether the elements follow the ringing after steps; these samples do not count in either case.

    Raise `RecordError` if no part of the record can be used.
    """
    given = of_one_axis(record)
    whole, holes, left_out = cleaning.clean(given, ringing=ringing)
    first, last = cleaning.rest_at_ends(whole)
    counted, every = usable(whole), whole.meta.get("every", 1)
    rests = [(int(counted[:first].sum()), "before"), (int(counted[last:].sum()), "after")]
    record = whole[first:last] if last - first < len(whole) else whole
    if first and not usable(whole)[first - 1]:
        record, way_out = cleaning.without_way_out(record)
        left_out = (*left_out, *way_out)
    record.check_usable()
    sentences = [*left_out]
    sentences += [
        f"{record.name}: at rest for {count * record.sample_time:.4g} s ({every * count} samples) {end} its motion; "
        "that time does not count."
        for count, end in rests
        if count
    ]
    sentences += [
        sentence if record.name in sentence else f"{record.name}: {sentence}"
        for sentence in record.problems()
        if "gap" not in sentence
    ]
    dropped = cleaning.transient(record)
    kept = record[dropped:] if dropped else record
    if dropped:
        until = float(record.time[dropped] - record.time[0])
        sentences.append(
            f"{record.name}: the first {until:.4g} s ({every * dropped} samples) lie outside the later loops and are "
            "left out: a start-up transient, or a rise from an unknown state."
        )
    pieces, gaps = cleaning.split_at_gaps(kept, holes)
    lead = whole[: first + dropped] if first + dropped > 1 else None
    return Prepared(
        kept,
        lead,
        tuple(pieces),
        record.name,
        len(given) - sum(count for count, _ in rests),
        float(given.time[0] if not first else record.time[0]),
        record.noise,
        cleaning.cycle_time(kept),
        len(record.cycles()) >= RULES.fewest_cycles,
        (*sentences, *gaps),
    )


def after_loops(records: list[Record]) -> list[Record]:
    """Return records that are one closed loop each as after an equal loop, a stated guess; other records unchanged."""
    # Only branches with a known begin count: of a single loop one branch, which has no hysteresis.
    signals = [values for record in records for values in (record.voltage, record.displacement)]
    closed = all(abs(values[-1] - values[0]) < _CLOSED * np.ptp(values) for values in signals)
    single = closed and all(len(reversals(record)) == 1 for record in records)
    return [*map(_after_loop, records)] if single else records


def _after_loop(record: Record) -> Record:
    """Return a loop with an equal one before it, a guess that is stated."""
    v, y, time, known = record.voltage, record.displacement, record.time, record.measured
    guess = {"motion before the record": "equal loops. It has one loop: record two or more"}
    return replace(
        record,
        time=np.append(time[:-1] - np.ptp(time), time),
        voltage=np.append(v[:-1], v),
        displacement=np.append(y[:-1] + y[0] - y[-1], y),
        measured=None if known is None else np.append(known[:-1], known),
        others=tuple(each._replace(values=np.append(each.values[:-1], each.values)) for each in record.others),
        meta={**record.meta, "guesses": {**record.meta.get("guesses", {}), **guess}},
    )


def list_of(records: Record | Sequence[Record]) -> list[Record]:
    """Return one or several records as a list; all have one axis, or all have several.

    Raise `IdentifyError` if they are not records.
    """
    given = [records] if not isinstance(records, Sequence) or isinstance(records, str) else list(records)
    for item in given:
        if not isinstance(item, Record):
            raise IdentifyError(
                f"got {type(item).__name__}, need records; read a file with dehyst.read(path), or make a record "
                "of arrays with dehyst.Record.from_arrays"
            )
    return given


def distinct(training: Any, validation: Any) -> tuple[list[Record], list[Record]]:
    """Return records as `list_of`; raise `IdentifyError` also without training records, or for equal records."""
    first, others, seen = list_of(training), list_of(validation), dict[bytes, str]()
    if not first:
        raise IdentifyError("got no records, need at least one loop of voltage and displacement")
    for record in (*first, *others):
        key = record.displacement.tobytes() + record.voltage.tobytes()
        if key in seen:
            raise IdentifyError(
                f"{record.name}: has the same samples as {seen[key]}; give each record once, and other ones to validate"
            )
        seen[key] = record.name
    return first, others


def as_list(records: Record | Sequence[Record]) -> list[Record]:
    """Return one or several records of one axis as a list, see `list_of`; raise `RecordError` for several axes."""
    return [of_one_axis(item) for item in list_of(records)]
