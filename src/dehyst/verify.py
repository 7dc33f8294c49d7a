"""Measured against simulated: a model played along a record, from a state that the record itself tells."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dehyst._native import Array, stops
from dehyst.actuator import Actuator
from dehyst.composition import coefficients_of, grid_of, moved_along
from dehyst.inertia import derivatives, undone
from dehyst.metrics import largest, rms
from dehyst.model import RecordErrors, State, Trace
from dehyst.preparation import Prepared
from dehyst.record import Record
from dehyst.regression import Coefficients, Regression
from dehyst.repairs import find_datum
from dehyst.rows import Epoch, collect
from dehyst.smoothing import without_jitter
from dehyst.wide_regression import WideCoefficients, WideRegression

# Least slope of a branch, of the mean one: a weight must not grow without bound.
_LEAST = 0.05


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
        Voltages delayed; with dynamics the displacements are those that hysteresis makes, before the resonance.
    measured : list of Record
        The same pieces with the displacements measured.
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
    measured: list[Record]
    epochs: list[list[Epoch]]
    regression: Regression | WideRegression
    found: Coefficients | WideCoefficients
    base: float

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
        return self.found.starts.get(0, np.zeros(0)) if isinstance(self.found, WideCoefficients) else np.zeros(0)

    def played(self, actuator: Actuator) -> list[tuple[int, Epoch, tuple[Array, ...]]]:
        """Piece number, epoch, and what `_play` gives, of every epoch."""
        offsets = [offset - self.base for _, offset in sorted(self.found.offsets.items())]
        parts, first = [], 0
        for number, ((_, piece, curve), own) in enumerate(zip(self.pieces, self.epochs, strict=True)):
            for i, epoch in enumerate(own):
                played = _play(
                    actuator,
                    piece,
                    epoch,
                    offsets[first + i],
                    self.drift * curve,
                    self.datum,
                    self.start,
                    self.record.lead,
                    self.measured[number],
                )
                parts.append((number, epoch, played))
            first += len(own)
        return parts


def compare(actuator: Actuator, record: Prepared, protocol: Protocol) -> Comparison:
    """Put a record beside a model: its constants, datum and drift by least squares, the model held fixed."""
    measured = record.delayed(0, protocol.delay)
    pieces = [(q, _path(actuator, piece, record.noise, protocol.stroke), drift) for q, piece, drift in measured]
    regression, model, epochs = _beside(actuator, record, pieces, (0,) if protocol.drifting else ())
    datum = protocol.datum
    if datum is None:
        datum = find_datum(regression, 0, protocol.stroke, given=model)
    regression = replace(regression, datum=np.array([datum]))
    base = float(actuator.spring.voltage[0])
    return Comparison(
        record, pieces, [piece for _, piece, _ in measured], epochs, regression, regression.nuisances_of(model), base
    )


def _beside(
    actuator: Actuator, record: Prepared, pieces: list[tuple[int, Record, Array]], drifting: tuple[int, ...]
) -> tuple[Any, Any, list[list[Epoch]]]:
    """The rows of a record, an actuator's coefficients on them, and the epochs of each piece."""
    rho, sigma = actuator.slip.breakaway, [record.noise] * len(pieces)
    if not actuator.wide:
        rows, epochs = collect(pieces, rho, sigma)
        every = np.ones(rho.size, dtype=bool)
        regression = Regression(rows, actuator.spring.displacement, 0.0, every, np.zeros(1), drifting)
        model = Coefficients(actuator.slip.stiffness, actuator.spring.slopes, {}, {}, None)  # type: ignore[arg-type]
        return regression, model, epochs
    grid = grid_of(actuator)
    rows, epochs = collect(pieces, rho, sigma, moved=lambda _, piece: moved_along(grid, piece, record.lead))
    floor = _LEAST * float(np.ptp(actuator.spring.voltage)) / float(np.ptp(grid.knots))
    return WideRegression(rows, grid, floor, np.zeros(1), drifting, (0,)), coefficients_of(actuator), epochs


def _path(actuator: Actuator, piece: Record, noise: float, stroke: float) -> Record:
    """What drives the elements of an actuator; plain ones take the measured displacement as it is."""
    return without_jitter(undone(piece, actuator.dynamics), noise, stroke) if actuator.wide else piece


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
    slope = float(np.median(regression.slope(found)))  # type: ignore[arg-type]
    offset = float(np.median(list(found.offsets.values()))) - compared.base
    return RecordErrors(
        record=record.name, role=protocol.role, samples=time.size, left_out=record.samples - time.size,
        largest=largest(trace.residual), rms=rms(trace.residual),
        largest_with_drift=largest(measured - with_drift), rms_with_drift=rms(measured - with_drift),
        stroke=protocol.stroke, offset=offset, datum=datum, drift=-compared.drift / slope,
    ), trace  # fmt: skip


def _play(
    actuator: Actuator,
    piece: Record,
    epoch: Epoch,
    offset: float,
    drift: Array,
    datum: float,
    strain: Array,
    lead: Record | None,
    measured: Record,
) -> tuple[Array, ...]:
    """Time, voltage, measured, simulated, and simulated with the drift left in, over an epoch."""
    rho = actuator.slip.breakaway
    before = piece.displacement[: epoch.start + 1]
    _, carts = stops(rho, np.full(rho.size, before[0]), np.ascontiguousarray(before))
    carts = np.where(2 * rho <= epoch.reach, carts, epoch.middle)
    carts = np.clip(carts, before[-1] - rho, before[-1] + rho)
    creep, smooth = _moved_to(actuator, piece, epoch.start, lead, strain)
    motion = (
        [] if actuator.dynamics is None else [measured.displacement[epoch.start], derivatives(measured)[0][epoch.start]]
    )
    state = State(float(before[-1]), carts, creep, motion, smooth).shifted(datum)
    span = slice(epoch.start, epoch.stop)
    time, tau = piece.time[span], actuator.transformer
    drive = (piece.voltage[span] if tau is None else tau(piece.voltage[span])) - offset

    def simulated(less: Array | float) -> Array:
        voltage = drive - less if tau is None else tau.inverse(drive - less)
        return actuator.simulate(voltage, time=time, state=state).displacement

    steady, drifting = simulated(drift[span]), simulated(float(drift[span].mean()))
    voltage = drive if tau is None else tau.inverse(drive)
    return time, voltage, measured.displacement[span] + datum, steady, drifting


def _moved_to(
    actuator: Actuator, piece: Record, sample: int, lead: Record | None, strain: Array
) -> tuple[Array, Array]:
    """Creep strains and smooth elongations [m] at a sample, `strain` [V] having been held as the record began."""
    grid = grid_of(actuator)
    creep, smooth, left = np.split(
        moved_along(grid, piece, lead)[sample], np.cumsum([grid.time_constants.size, grid.lengths.size])
    )
    if actuator.creep is not None and strain.size:
        c = actuator.creep.stiffness
        creep = creep + np.divide(strain * left, c, out=np.zeros_like(left), where=c > 0)
    return creep, smooth
