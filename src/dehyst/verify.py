"""Measured against simulated: a model played along a record, from a state that the record itself tells."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from dehyst._native import Array, stops
from dehyst.actuator import Actuator
from dehyst.metrics import largest
from dehyst.model import RecordErrors, State, Trace
from dehyst.preparation import Prepared
from dehyst.record import Record
from dehyst.regression import Coefficients, Regression
from dehyst.repairs import find_datum
from dehyst.rows import Epoch, RowSource
from dehyst.stream import Stream

# Rows in memory: more are gone through in blocks.
MOST_ROWS = 200_000
# Of a longer record so many suffice for what is not found by going through them all.
_FEW_ROWS = 20_000
# Samples played at a time, and kept for pictures.
_AT_A_TIME = 1 << 20
_MOST_DRAWN = 1 << 20
# Elongations of all elements are made for each of these samples.
_STOPS_AT_A_TIME = 32_768


@dataclass(frozen=True)
class Protocol:
    """How a record is compared with a model.

    Attributes
    ----------
    role : str
        "training" or "validation".
    delay : float
        Seconds by which voltages are delayed.
    datum : float or None
        Shift [m] to the model's axis; None: find it.
    drifting : bool
        Whether a drift is set aside.
    stroke : float
        Reference of the percentages [m].
    """

    role: str
    delay: float
    datum: float | None
    drifting: bool
    stroke: float


@dataclass(frozen=True, eq=False)
class Comparison:
    """A record beside a model: its samples that count, and what it cannot be told without.

    Attributes
    ----------
    record : Prepared
    pieces : list of (record number, Record, drift curve)
        Voltages delayed.
    epochs : list of list of Epoch
        Of each piece.
    regression : Regression
        Its rows (of a long record some, evenly), with its datum and drift.
    found : Coefficients
        The model's, with this record's constants and drift [V].
    base : float
        Voltage of the model's spring at its first knot [V]: a constant less this is an offset.
    """

    record: Prepared
    pieces: list[tuple[int, Record, Array]]
    epochs: list[list[Epoch]]
    regression: Regression
    found: Coefficients
    base: float

    @property
    def datum(self) -> float:
        """Shift [m] to the model's axis."""
        return float(self.regression.datum[0])

    @property
    def drift(self) -> float:
        """Coefficient of the drift curve [V]."""
        return self.found.drifts.get(0, 0.0)

    def played(self, actuator: Actuator) -> list[tuple[int, Epoch, tuple[Array, ...]]]:
        """Piece number, epoch, and what `_play` gives, of every epoch."""
        offsets = [offset - self.base for _, offset in sorted(self.found.offsets.items())]
        parts, first = [], 0
        for number, ((_, piece, curve), own) in enumerate(zip(self.pieces, self.epochs, strict=True)):
            for i, epoch in enumerate(own):
                whole = epoch.stop - epoch.start
                (played,) = _play(actuator, piece, epoch, offsets[first + i], self.drift * curve, self.datum, whole)
                parts.append((number, epoch, played))
            first += len(own)
        return parts

    def last_offsets(self) -> list[float]:
        """Offset [V] of the last epoch of each piece, that of the one before where a piece has none."""
        offsets = [offset - self.base for _, offset in sorted(self.found.offsets.items())]
        return [offsets[max(count - 1, 0)] for count in np.cumsum([len(own) for own in self.epochs])]


def compare(actuator: Actuator, record: Prepared, protocol: Protocol) -> Comparison:
    """Put a record beside a model: its constants, datum and drift by least squares, the model held fixed."""
    pieces = record.delayed(0, protocol.delay)
    rho = actuator.slip.breakaway
    source = RowSource.of(pieces, rho, [record.noise] * len(pieces))
    model = Coefficients(actuator.slip.stiffness, actuator.spring.slopes, {}, {}, None)  # type: ignore[arg-type]
    drifting = (0,) if protocol.drifting else ()
    every = np.ones(rho.size, dtype=bool)
    some = source.thinned(MOST_ROWS if len(source) <= MOST_ROWS else _FEW_ROWS)
    regression = Regression(some, actuator.spring.displacement, 0.0, every, np.zeros(1), drifting)
    datum = protocol.datum
    if datum is None:
        datum = find_datum(regression, 0, protocol.stroke, given=model)
    regression = replace(regression, datum=np.array([datum]))
    base = float(actuator.spring.voltage[0])
    found = Stream(source, regression).nuisances_of(model)
    return Comparison(record, pieces, source.epochs, regression, found, base)


def errors_of(actuator: Actuator, record: Prepared, protocol: Protocol) -> tuple[RecordErrors, Trace]:
    """Simulate a record's last epoch, in which the range of the excitation no longer grows, and compare.

    The state at its start follows from the displacement measured before. What a record cannot be told without, its
    constant, datum and drift, is found by least squares with the model held fixed.
    """
    compared = compare(actuator, record, protocol)
    found, regression = compared.found, compared.regression
    sums = _Sums(max(1, sum(own[-1].stop - own[-1].start for own in compared.epochs if own) // _MOST_DRAWN))
    for (_, piece, curve), own, offset in zip(compared.pieces, compared.epochs, compared.last_offsets(), strict=True):
        if own:
            for played in _play(actuator, piece, own[-1], offset, compared.drift * curve, compared.datum, _AT_A_TIME):
                sums.add(played)
    trace = Trace(record.name, protocol.role, *(np.concatenate(column) for column in zip(*sums.drawn, strict=True)))
    slope = float(np.median(regression.slope(found)))
    offset = float(np.median(list(found.offsets.values()))) - compared.base
    return RecordErrors(
        record=record.name, role=protocol.role, samples=sums.samples, left_out=record.samples - sums.samples,
        largest=sums.largest[0], rms=sums.rms[0], largest_with_drift=sums.largest[1], rms_with_drift=sums.rms[1],
        stroke=protocol.stroke, offset=offset, datum=compared.datum, drift=-compared.drift / slope,
    ), trace  # fmt: skip


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
        """Add a stretch, as `_play` gives it."""
        first = -self.samples % self._step
        self.drawn.append(tuple(column[first :: self._step].copy() for column in played[:4]))
        self.samples += played[0].size
        for k, simulated in enumerate(played[3:]):
            error = played[2] - simulated
            self.largest[k] = max(self.largest[k], largest(error))
            self._squares[k] += float(np.sum(error**2))


def _play(
    actuator: Actuator, piece: Record, epoch: Epoch, offset: float, drift: Array, datum: float, size: int
) -> Iterator[tuple[Array, ...]]:
    """Time, voltage, measured, simulated, and simulated with the drift left in, over an epoch, `size` at a time."""
    steady = drifting = _state_before(actuator.slip.breakaway, piece, epoch).shifted(datum)
    level = float(drift[epoch.start : epoch.stop].mean())
    for start in range(epoch.start, epoch.stop, size):
        span = slice(start, min(start + size, epoch.stop))
        voltage = piece.voltage[span] - offset
        one = actuator.simulate(voltage - drift[span], state=steady)
        other = actuator.simulate(voltage - level, state=drifting)
        steady, drifting = one.state, other.state
        yield piece.time[span], voltage, piece.displacement[span] + datum, one.displacement, other.displacement


def _state_before(rho: Array, piece: Record, epoch: Epoch) -> State:
    """The state at an epoch's first sample, which the displacement before it tells."""
    y = piece.displacement[: epoch.start + 1]
    carts = np.full(rho.size, y[0])
    for start in range(0, y.size, _STOPS_AT_A_TIME):
        _, carts = stops(rho, carts, np.ascontiguousarray(y[start : start + _STOPS_AT_A_TIME]))
    carts = np.where(2 * rho <= epoch.reach, carts, epoch.middle)
    return State(float(y[-1]), np.clip(carts, y[-1] - rho, y[-1] + rho))
