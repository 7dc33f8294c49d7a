"""Measured against simulated: a model played along a record, from a state that the record itself tells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dehyst._native import Array, stops
from dehyst.actuator import Actuator
from dehyst.metrics import largest, rms
from dehyst.model import RecordErrors, State, Trace
from dehyst.record import Record
from dehyst.regression import Coefficients, Regression
from dehyst.repairs import find_datum
from dehyst.rows import Epoch, collect

Piece = tuple[Record, Array]


def errors_of(
    actuator: Actuator,
    name: str,
    pieces: list[Piece],
    noise: float,
    role: str,
    datum: float | None,
    drifting: bool,
    stroke: float,
) -> tuple[RecordErrors, Trace]:
    """Simulate a record's last epoch, in which the range of the excitation no longer grows, and compare.

    The state at its start follows from the displacement measured before. What a record cannot be told without, its
    constant, datum and drift, is found by least squares with the model held fixed.

    Parameters
    ----------
    actuator : Actuator
    name : str
        The record's.
    pieces : list of (Record, drift curve)
        The record without gaps, delayed.
    noise : float
        Sensor noise [m].
    role : str
        "training" or "validation".
    datum : float or None
        Shift [m] to the model's axis; None: find it.
    drifting : bool
        Whether a drift is set aside.
    stroke : float
        Reference of the percentages [m].
    """
    rho = actuator.slip.breakaway
    rows, epochs = collect([(0, piece, curve) for piece, curve in pieces], rho, [noise] * len(pieces))
    model = Coefficients(actuator.slip.stiffness, actuator.spring.slopes, {}, {}, None)  # type: ignore[arg-type]
    regression = Regression(
        rows, actuator.spring.displacement, 0.0, np.ones(rho.size, bool), np.zeros(1), (0,) if drifting else ()
    )
    shift = find_datum(regression, 0, stroke, given=model) if datum is None else datum
    regression = replace(regression, datum=np.array([shift]))
    found = regression.nuisances_of(model)
    drift = found.drifts.get(0, 0.0)
    parts = []
    first = 0
    for (piece, curve), own in zip(pieces, epochs, strict=True):
        if own:
            offset = found.offsets[first + len(own) - 1] - float(actuator.spring.voltage[0])
            parts.append(_play(actuator, piece, own[-1], offset, drift * curve, shift))
        first += len(own)
    time, voltage, measured, simulated, with_drift = (np.concatenate(column) for column in zip(*parts, strict=True))
    error, error_with_drift = measured - simulated, measured - with_drift
    slope = float(np.median(regression.slope(model)))
    offset = float(np.median(list(found.offsets.values()))) - float(actuator.spring.voltage[0])
    summary = RecordErrors(
        record=name, role=role, samples=time.size, left_out=sum(len(piece) for piece, _ in pieces) - time.size,
        largest=largest(error), rms=rms(error),
        largest_with_drift=largest(error_with_drift), rms_with_drift=rms(error_with_drift),
        stroke=stroke, offset=offset, datum=shift, drift=-drift / slope,
    )  # fmt: skip
    return summary, Trace(name, role, time, voltage, measured, simulated)


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
