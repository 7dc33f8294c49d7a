"""Measured against simulated: a model played along a record, from a state that the record itself tells."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dehyst._native import Array, stops
from dehyst.actuator import Actuator, demand_plain
from dehyst.metrics import largest, rms
from dehyst.model import RecordErrors, State, Trace
from dehyst.preparation import Prepared
from dehyst.record import Record
from dehyst.regression import Coefficients, Regression
from dehyst.repairs import find_datum
from dehyst.rows import Epoch, collect


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
        Its rows, with its datum and drift.
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
                played = _play(actuator, piece, epoch, offsets[first + i], self.drift * curve, self.datum)
                parts.append((number, epoch, played))
            first += len(own)
        return parts


def compare(actuator: Actuator, record: Prepared, protocol: Protocol) -> Comparison:
    """Put a record beside a model: its constants, datum and drift by least squares, the model held fixed."""
    demand_plain(actuator, "a comparison with records")
    pieces = record.delayed(0, protocol.delay)
    rho = actuator.slip.breakaway
    rows, epochs = collect(pieces, rho, [record.noise] * len(pieces))
    model = Coefficients(actuator.slip.stiffness, actuator.spring.slopes, {}, {}, None)  # type: ignore[arg-type]
    drifting = (0,) if protocol.drifting else ()
    every = np.ones(rho.size, dtype=bool)
    regression = Regression(rows, actuator.spring.displacement, 0.0, every, np.zeros(1), drifting)
    datum = protocol.datum
    if datum is None:
        datum = find_datum(regression, 0, protocol.stroke, given=model)
    regression = replace(regression, datum=np.array([datum]))
    base = float(actuator.spring.voltage[0])
    return Comparison(record, pieces, epochs, regression, regression.nuisances_of(model), base)


def errors_of(actuator: Actuator, record: Prepared, protocol: Protocol) -> tuple[RecordErrors, Trace]:
    """Simulate a record's last epoch, in which the range of the excitation no longer grows, and compare.

    The state at its start follows from the displacement measured before. What a record cannot be told without, its
    constant, datum and drift, is found by least squares with the model held fixed.
    """
    compared = compare(actuator, record, protocol)
    found, regression, datum = compared.found, compared.regression, compared.datum
    last = [played for i, epoch, played in compared.played(actuator) if epoch is compared.epochs[i][-1]]
    time, voltage, measured, simulated, with_drift = (np.concatenate(column) for column in zip(*last, strict=True))
    trace = Trace(record.name, protocol.role, time, voltage, measured, simulated)
    slope = float(np.median(regression.slope(found)))
    offset = float(np.median(list(found.offsets.values()))) - compared.base
    return RecordErrors(
        record=record.name, role=protocol.role, samples=time.size, left_out=record.samples - time.size,
        largest=largest(trace.residual), rms=rms(trace.residual),
        largest_with_drift=largest(measured - with_drift), rms_with_drift=rms(measured - with_drift),
        stroke=protocol.stroke, offset=offset, datum=datum, drift=-compared.drift / slope,
    ), trace  # fmt: skip


def _play(
    actuator: Actuator, piece: Record, epoch: Epoch, offset: float, drift: Array, datum: float
) -> tuple[Array, ...]:
    """Time, voltage, measured, simulated, and simulated with the drift left in, over an epoch."""
    rho = actuator.slip.breakaway
    before = piece.displacement[: epoch.start + 1]
    _, carts = stops(rho, np.full(rho.size, before[0]), np.ascontiguousarray(before))
    carts = np.where(2 * rho <= epoch.reach, carts, epoch.middle)
    carts = np.clip(carts, before[-1] - rho, before[-1] + rho)
    state = State(float(before[-1]), carts).shifted(datum)
    span = slice(epoch.start, epoch.stop)
    voltage = piece.voltage[span] - offset
    steady = actuator.simulate(voltage - drift[span], state=state).displacement
    drifting = actuator.simulate(voltage - float(drift[span].mean()), state=state).displacement
    return piece.time[span], voltage, piece.displacement[span] + datum, steady, drifting
