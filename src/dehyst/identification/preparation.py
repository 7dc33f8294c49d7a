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
from dehyst.records import Record, bandwidth, counting, interpolate, of_one_axis

# The voltage has this share of its energy above the bandwidth; this many times that rate is kept, this many samples of
# the shortest cycle, and this many of all training records.
_SHARE, _TIMES = 1e-5, 10.0
_A_CYCLE, ENOUGH = 60, 4000
# A mean's samples ring if they differ by this many standard deviations of the noise.
_RINGS = 8.0


def block_of(record: Record, most: float) -> int:
    """Return how many samples a mean may be taken of: `most` at most, 1 at least."""
    # A mean of samples would move an event.
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
        # A mean with a sample that is left out is left out; a ring's highest and lowest samples drive the elements.
        wide = 0.5 * block * record.sample_time
        aside = tuple((first - wide, last + wide) for first, last in record.set_aside)
        blocks = record.displacement[: displacement.size * block].reshape(-1, block)
        # After it has faded, the noise's extremes would drive them.
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


_SHORTEST = 20
# Time at which a drift begins, in cycles.
_FIRST = 0.1
# Samples of a cycle through whose neighbours a derivative may be taken widely.
_MANY = 100


@dataclass(frozen=True, eq=False)
class Prepared:
    """A prepared record; its voltages are not yet delayed.

    Attributes
    ----------
    record : Record
        Without voltage glitches and its start-up transient.
    lead : Record or None
        Rest and the transient before the record: they set the state of creep.
    pieces : tuple of Record
        The parts of `record` between gaps.
    name : str
    samples : int
        Number of samples of the original record, without rest before and after its motion.
    start : float
        Time of the first of these [s], the origin of creep.
    noise : float
        Standard deviation of the sensor [m].
    cycle : float
        Median duration of a cycle of the excitation [s].
    can_drift : bool
        Whether it has enough cycles to separate drift from hysteresis.
    sentences : tuple of str
        Sentences: what was repaired.
    steady : bool
        Whether it drifts in proportion to time, as a sensor does, and not to its logarithm, as creep does.
    block : int
        Samples that `reduced` takes the mean of.
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
    # The last answer of `driving`, by what it was asked for.
    _driving: dict[tuple[float, float, Dynamics | None, float], list[Record]] = field(
        default_factory=dict, init=False, repr=False
    )

    @cached_property
    def reduced(self) -> Prepared:
        """The record as means of `block` samples: the same motion, and less noise."""
        if self.block == 1:
            return self
        lead = self.lead
        if lead is not None:
            size = min(self.block, max(len(lead) // 2, 1))
            # Its last mean ends where the record begins.
            lead = block_means(lead[len(lead) % size :], size)
        pieces = tuple(block_means(piece, self.block) for piece in self.pieces)
        record = block_means(self.record, self.block)
        samples = self.samples // self.block
        return replace(self, record=record, lead=lead, pieces=pieces, samples=samples, noise=record.noise, block=1)

    def without_lag(self, lag: float) -> Prepared:
        """Return the record with the displacements before its sensor's low-pass of first order: y + lag y'."""
        if not lag:
            return self
        demand_short(lag, "sensor_lag", self.cycle)
        # Few samples a cycle leave no room for a long window.
        window = 9 if self.cycle > _MANY * self.record.sample_time else 5

        def before(piece: Record) -> Array:
            rate = local_polynomials(piece.displacement, window, 4, 1, piece.sample_time)
            return np.asarray(piece.displacement + lag * rate)

        known = self if self.lead is None or len(self.lead) >= _SHORTEST else replace(self, lead=None)
        made = known._changed(before)
        sentence = f"{self.name}: displacements are those before the sensor's lag of {1e3 * lag:.4g} ms, as given."
        return replace(made, noise=made.record.noise, sentences=(*self.sentences, sentence))

    def without_creep(self, part: DisplacementCreep, start: Array | None = None) -> Prepared:
        """Return the record with the displacements before creep in displacement.

        `start` (K,): strains at the first sample [m]; default: all had crept as it began.
        """
        time, y = self.with_lead
        m = part.removed(time, y, start)
        return self._changed(lambda piece: np.interp(piece.time, time, m), time[0])

    def without_drift(self, drift: float) -> Prepared:
        """Return the record without a drift [m a unit of its drift curve]."""
        return self._changed(lambda piece: piece.displacement - drift * self.drift_curve(piece))

    def at_reference(self, thermal: Thermal) -> Prepared:
        """Return the record with the displacements at the reference temperature; without temperature as it is."""

        def before(piece: Record) -> Array:
            temperature = piece.temperature
            return piece.displacement if temperature is None else thermal.at_reference(piece.displacement, temperature)

        return self._changed(before)

    def _changed(self, displacement: Callable[[Record], Array], first: float = -np.inf) -> Prepared:
        """Return a copy with other displacements; a lead that begins before `first` [s] is left out."""

        def before(piece: Record) -> Record:
            return replace(piece, displacement=displacement(piece))

        lead = None if self.lead is None or self.lead.time[0] < first else before(self.lead)
        return replace(self, record=before(self.record), lead=lead, pieces=tuple(map(before, self.pieces)))

    @property
    def with_lead(self) -> tuple[Array, Array]:
        """Time and displacement, from the lead on if the record continues it."""
        lead, record = self.lead, self.record
        follows = lead is not None and (
            0 < record.time[0] - lead.time[-1] <= 0.75 * (lead.sample_time + record.sample_time)
        )
        parts = [lead, record] if lead is not None and follows else [record]
        return np.concatenate([part.time for part in parts]), np.concatenate([part.displacement for part in parts])

    def with_block(self, most: float) -> Prepared:
        """Return a copy that is reduced to the bandwidth of its motion, by means over at most `most` samples."""
        shortest = min(map(len, self.pieces), default=0) / (2 * _SHORTEST)
        return replace(self, block=block_of(self.record, min(most, shortest)))

    def span(self) -> tuple[float, float]:
        """Return the lowest and highest displacement [m] of the samples that count and of the turns before them."""
        pieces, stroke = self.pieces, float(np.ptp(self.record.displacement))
        if disturbs(self.noise, stroke):
            # The extremes of noise are no part of the stroke.
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
        """Return the acting pieces as they drive elements: before the resonance, and without jitter."""
        asked = delay, lag, dynamics, stroke
        if asked not in self._driving:
            self._driving.clear()
            paths = (remove_dynamics(piece, dynamics) for piece in self.acting(delay, lag))
            self._driving[asked] = [remove_jitter(path, self.noise, stroke) for path in paths]
        return self._driving[asked]

    def drift_curve(self, piece: Record) -> Array:
        """Return the curve of a drift at the samples of a piece: log10 of the time since the record began, mean zero.

        A steady drift is a straight line that covers as many decades.
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
        """Return the source of the record: name, file and hash."""
        meta = self.record.meta
        return {"name": self.record.name, **{key: meta[key] for key in ("source", "sha256") if key in meta}}


def behind(record: Record, lag: float) -> Record:
    """Return a record with the voltages behind an amplifier of time constant `lag` [s]."""
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
    """Return the samples of columns of pieces that count, and of the turns before them, an array an epoch."""
    return [np.append(values[epoch.start : epoch.stop], values[epoch.turn]) for values, own in columns for epoch in own]


def prepare(record: Record, *, ringing: bool = False) -> Prepared:
    """Check a record and remove unusable parts.

    `ringing`: whether the elements follow the ringing after steps; these samples do not count in either case.

    Raise `RecordError` if it cannot be used at all.
    """
    given = of_one_axis(record)
    whole, holes, left_out = cleaning.clean(given, ringing=ringing)
    first, last = cleaning.rest_at_ends(whole)
    counted = np.ones(len(whole), dtype=bool) if (known := counting(whole)) is None else known
    rests = [(int(counted[:first].sum()), "before"), (int(counted[last:].sum()), "after")]
    record = whole[first:last] if last - first < len(whole) else whole
    if first and not counted[first - 1]:
        record, way_out = cleaning.without_way_out(record)
        left_out = (*left_out, *way_out)
    record.check_usable()
    sentences = [*left_out]
    sentences += [
        f"{record.name}: at rest for {count * record.sample_time:.4g} s ({count} samples) {end} its motion; "
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
            f"{record.name}: the first {until:.4g} s ({dropped} samples) lie outside the loops that follow, a start-up "
            "transient or a rise from an unknown state; left out."
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


def list_of(records: Record | Sequence[Record]) -> list[Record]:
    """Return one or several records as a list, all of one axis or all of several.

    Raise `IdentifyError` if they are no records.
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
    """Return records as `list_of`; raise `IdentifyError` too without training, or for copies: none would be unseen."""
    first, others, seen = list_of(training), list_of(validation), dict[bytes, str]()
    if not first:
        raise IdentifyError("got no records, need one loop of voltage and displacement at least")
    for record in (*first, *others):
        key = record.displacement.tobytes() + record.voltage.tobytes()
        if key in seen:
            raise IdentifyError(
                f"{record.name}: has the same samples as {seen[key]}; give each record once, and another to validate"
            )
        seen[key] = record.name
    return first, others


def as_list(records: Record | Sequence[Record]) -> list[Record]:
    """Return one or several records of one axis as a list, as `list_of`; raise `RecordError` if one has several."""
    return [of_one_axis(item) for item in list_of(records)]
