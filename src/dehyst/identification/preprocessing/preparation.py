"""Preparation of a record for identification: checks, removal of its start-up transient, cuts at gaps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from dehyst._errors import IdentifyError
from dehyst._types import Array
from dehyst.identification.preprocessing import cleaning
from dehyst.identification.preprocessing.block_means import block_means, block_of
from dehyst.identification.preprocessing.local_polynomial import local_polynomial
from dehyst.identification.preprocessing.regressors import epochs
from dehyst.model import Creep
from dehyst.records import Record

_SHORTEST = 20
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
        The transient: it sets the state of creep.
    pieces : tuple of Record
        The parts of `record` between gaps.
    name : str
    samples : int
        Number of samples of the original record.
    start : float
        Time of the first sample [s], the origin of creep.
    noise : float
        Standard deviation of the sensor [m].
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
    can_drift: bool
    sentences: tuple[str, ...]
    steady: bool = False
    block: int = 1

    @cached_property
    def reduced(self) -> Prepared:
        """The record as means of `block` samples: the same motion, and less noise."""
        if self.block == 1:
            return self
        lead = None if self.lead is None else block_means(self.lead, min(self.block, max(len(self.lead) // 2, 1)))
        pieces = tuple(block_means(piece, self.block) for piece in self.pieces)
        record = block_means(self.record, self.block)
        samples = self.samples // self.block
        return replace(self, record=record, lead=lead, pieces=pieces, samples=samples, noise=record.noise, block=1)

    def without_lag(self, lag: float) -> Prepared:
        """Return the record with the displacements before its sensor's low-pass of first order: y + lag y'."""
        if not lag:
            return self
        cycle = cleaning.cycle_time(self.record)
        if lag > 0.25 * cycle:
            raise IdentifyError(f"sensor_lag: got {lag:g} s, need less than a quarter of a cycle of {cycle:.4g} s")
        # Few samples a cycle leave no room for a long window.
        window = 9 if cycle > _MANY * self.record.sample_time else 5

        def before(one: Record) -> Record:
            rate = local_polynomial(one.displacement, window, 4, 1, one.sample_time)
            return replace(one, displacement=one.displacement + lag * rate)

        pieces, record = tuple(map(before, self.pieces)), before(self.record)
        sentence = f"{self.name}: displacements are those before the sensor's lag of {1e3 * lag:.4g} ms, as given."
        lead = None if self.lead is None or len(self.lead) < _SHORTEST else before(self.lead)
        sentences = (*self.sentences, sentence)
        return replace(self, record=record, lead=lead, pieces=pieces, noise=record.noise, sentences=sentences)

    def with_block(self, most: float) -> Prepared:
        """Return the same, to be reduced to the bandwidth of its motion, by means of `most` samples at most."""
        shortest = min(map(len, self.pieces), default=0) / (2 * _SHORTEST)
        return replace(self, block=block_of(self.record, min(most, shortest)))

    def span(self) -> tuple[float, float]:
        """Return the lowest and highest displacement [m] of the samples that count and of the turns before them."""
        counted = [
            np.append(piece.displacement[epoch.start : epoch.stop], piece.displacement[epoch.turn])
            for piece in self.pieces
            for epoch in epochs(piece, self.noise)
        ]
        if not counted:
            raise IdentifyError(
                f"{self.record.name}: no sample counts, because the voltage never returns into its earlier range. "
                "Record at least one full cycle, better two"
            )
        return min(float(y.min()) for y in counted), max(float(y.max()) for y in counted)

    def acting(self, delay: float, lag: float = 0.0) -> Iterator[Record]:
        """Yield the pieces with acting voltages: `delay` [s] late, through an amplifier of time constant `lag` [s]."""
        for piece in self.pieces:
            late = piece.delayed(delay) if delay else piece
            yield _amplified(late, lag) if lag else late

    def delayed(self, number: int, delay: float, lag: float = 0.0) -> list[tuple[int, Record, Array]]:
        """Return (record number, piece with acting voltage, drift curve) of each piece, for `regressors.collect`."""
        return [(number, piece, self.drift_curve(piece)) for piece in self.acting(delay, lag)]

    def drift_curve(self, piece: Record) -> Array:
        """Return the curve of a drift at the samples of a piece: a logarithm of the time since the record began.

        A steady drift is a straight line that covers as many decades.
        """
        curve = cleaning.drift_curve(self.record, self.start)
        if self.steady:
            time = self.record.time
            curve = (time - time.mean()) * float(np.ptp(curve)) / float(np.ptp(time))
        return np.interp(piece.time, self.record.time, curve)

    def coarser(self, cycle: int, most: int) -> Prepared:
        """Return the record in fewer samples, for searches.

        Every k-th sample, with at least `cycle` samples a cycle, up to `most` of them, or up to the end of the first
        three cycles if these are longer.
        """
        cycles = self.record.cycles()
        step = max(1, min((c.stop - c.start for c in cycles), default=0) // cycle)
        stop = max(most * step, cycles[min(3, len(cycles)) - 1].stop if cycles else len(self.record))
        if step == 1 and stop >= len(self.record):
            return self
        ends = np.cumsum([len(piece) for piece in self.pieces])
        remaining = [stop - int(end) + len(piece) for piece, end in zip(self.pieces, ends, strict=True)]
        pieces = tuple(
            _every(piece, step, n)
            for piece, n in zip(self.pieces, remaining, strict=True)
            if min(n, len(piece)) >= _SHORTEST * step
        )
        return replace(self, record=_every(self.record, step, stop), pieces=pieces)

    def source(self) -> dict[str, Any]:
        """Return the source of the record: name, file and hash."""
        meta = self.record.meta
        return {"name": self.record.name, **{key: meta[key] for key in ("source", "sha256") if key in meta}}


def _amplified(piece: Record, lag: float) -> Record:
    difference = Creep([lag], [0.0]).strains(piece.time, piece.voltage)[:, 0]
    return replace(piece, voltage=piece.voltage - difference)


def _every(record: Record, step: int, stop: int) -> Record:
    """Return every step-th sample of a record's first `stop`."""
    return replace(
        record,
        time=record.time[:stop:step],
        voltage=record.voltage[:stop:step],
        displacement=record.displacement[:stop:step],
    )


def prepare(record: Record) -> Prepared:
    """Check a record and remove what cannot be used.

    Raises
    ------
    RecordError
        If it cannot be used at all.
    """
    given = record
    record, holes, left_out = cleaning.remove_glitches(given)
    record, replaced = cleaning.remove_spikes(record)
    record.check_usable()
    sentences = [*left_out, *replaced]
    sentences += [
        sentence if record.name in sentence else f"{record.name}: {sentence}"
        for sentence in record.problems()
        if "gap" not in sentence
    ]
    dropped = cleaning.transient(record)
    kept = record.slice(dropped, len(record)) if dropped else record
    if dropped:
        until = float(record.time[dropped] - record.time[0])
        sentences.append(
            f"{record.name}: the first {until:.4g} s ({dropped} samples) lie outside the loops that follow, a start-up "
            "transient or a rise from an unknown state; left out."
        )
    pieces, gaps = cleaning.split_at_gaps(kept, holes)
    lead = record.slice(0, dropped) if dropped > 1 else None
    return Prepared(
        kept,
        lead,
        tuple(pieces),
        record.name,
        len(given),
        float(given.time[0]),
        record.noise,
        len(record.cycles()) >= 3,
        (*sentences, *gaps),
    )


def as_list(records: Record | Sequence[Record]) -> list[Record]:
    """Return one or several records as a list.

    Raises
    ------
    IdentifyError
        If they are no records.
    """
    given = [records] if not isinstance(records, Sequence) or isinstance(records, str) else list(records)
    for item in given:
        if not isinstance(item, Record):
            raise IdentifyError(f"got {type(item).__name__}, need records; read a file with dehyst.read(path)")
    return given
