"""A prior from a fleet: its shape, fitted by gain and width to records with few or noisy data."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from dehyst._errors import DehystError, IdentifyError
from dehyst._types import Array
from dehyst._version import __version__
from dehyst.fleet.table import Fleet
from dehyst.identification import RULES, Fit, Outcome, RecordErrors, compare, errors_of, identify, prepare
from dehyst.model import Actuator, Identification, MaxwellSlip, Spring
from dehyst.records import Record, rms

# Models that make a prior, at least; part by which their grids may differ.
_FEWEST, _SAME = 5, 1e-3
# A record is tried with the prior if its noise exceeds this part of the stroke, or it has fewer cycles or samples.
_NOISY, _CYCLES, _SAMPLES = 1e-3, 4, 600
# Least width of a loop, of that of the prior, and how close to a level spring the width may bring its steepest part.
_NARROWEST, _STEEPEST = 0.2, 0.95
# The prior's held-out error must be smaller than the own model's by this factor, so that noise does not choose.
_GAIN = 0.98
_COLUMNS = ("breakaway", "stiffness", "knots", "spring")


@dataclass(frozen=True, eq=False)
class Shape:
    """Normalised coefficients of a plain actuator: displacements in strokes, forces in volts.

    `breakaway`, `stiffness` (N,): thresholds, and stiffness times the stroke. `knots`, `spring` (M,): knots and
    voltages of the spring. `delay` [s]. `records`: number of models of which this is the median.
    """

    breakaway: Array
    stiffness: Array
    knots: Array
    spring: Array
    delay: float
    records: int

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Shape:
        """Rebuild from `as_dict`."""
        columns = {name: np.array(data[name], dtype=np.float64) for name in _COLUMNS}
        return cls(**columns, delay=float(data["delay_s"]), records=int(data["records"]))

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        columns = {name: getattr(self, name).tolist() for name in _COLUMNS}
        return {**columns, "delay_s": self.delay, "records": self.records}

    @property
    def widest(self) -> float:
        """The largest width at which the spring still rises everywhere."""
        slope = float((np.diff(self.spring) / np.diff(self.knots)).min())
        return 1 + _STEEPEST * slope / (2 * float(self.stiffness @ self.breakaway))

    def actuator(self, stroke: float, width: float, **more: Any) -> Actuator:
        """Return the actuator with a stroke [m] and a relative width of its loop (1: the prior's); its ends stay."""
        tilt = (width - 1) * float(self.stiffness @ self.breakaway) * (1 - 2 * self.knots)
        return Actuator(
            MaxwellSlip(self.breakaway * stroke, width * self.stiffness / stroke),
            Spring(self.knots * stroke, self.spring + tilt),
            delay=self.delay,
            **more,
        )


def shape_of(fleet: Fleet) -> Shape:
    """Return the median shape of a fleet's Maxwell-slip models; raise `IdentifyError` if there are too few."""
    groups: dict[tuple[int, int], list[Array]] = defaultdict(list)
    delays = []
    for _, actuator in fleet.models():
        slip, spring = actuator.slip, actuator.spring
        if not actuator.wide:
            x, stroke = spring.displacement, float(np.ptp(spring.displacement))
            parts = slip.breakaway / stroke, slip.stiffness * stroke, (x - float(x[0])) / stroke, spring.voltage
            coefficients = np.concatenate(parts)
            groups[len(slip), coefficients.size].append(coefficients)
            delays.append(actuator.delay)
    (count, _), rows = max(groups.items(), key=lambda one: len(one[1]), default=((0, 0), []))
    # Longer elements are another grid.
    same = [row for row in rows if np.allclose(row[:count], np.median(rows, axis=0)[:count], rtol=_SAME, atol=0)]
    if len(same) < _FEWEST:
        raise IdentifyError(
            f"{fleet.path}: has {len(same)} plain models of one grid, a prior needs {_FEWEST}; identify more records "
            "with --structure maxwell_slip"
        )
    middle = np.median(same, axis=0)
    breakaway, stiffness, knots, volts = np.split(middle, [count, 2 * count, count + middle.size // 2])
    return Shape(breakaway, stiffness, knots, volts, float(np.median(delays)), len(same))


def identified_with_prior(
    record: Record, shape: Shape, options: Mapping[str, Any]
) -> tuple[Fit, dict[str, str | float | None]]:
    """Return the record's own fit, or the fit of the prior's shape if it predicts held-out parts better.

    Also return fields of the row: which fit was kept, and both held-out errors. `options`: arguments of `identify`.
    """
    refusal: DehystError | None = None
    own: Fit | None = None
    try:
        own = identify(record, throw=False, **options)
    except DehystError as error:
        refusal = error
    own = None if own is None or own.actuator is None else own
    weak = len(record) < _SAMPLES or len(record.cycles()) < _CYCLES or record.noise > _NOISY * record.stroke
    if own is not None and not weak:
        return own, {"prior": "not tried"}
    try:
        ours, theirs = _held_out(record, shape, options)
    except Exception:  # a failed comparison is no fault of the record: it is refused for its own identification only
        ours = theirs = None
    row = {"held_out_own_percent": ours, "held_out_prior_percent": theirs}
    limit = RULES.useless if own is None else -np.inf if ours is None else _GAIN * ours
    if theirs is not None and theirs < limit:
        with suppress(DehystError):
            return _fit(record, shape), {**row, "prior": "kept"}
    if own is None:
        raise refusal or IdentifyError(f"{record.name}: neither an own model nor the fleet's shape explains it")
    return own, {**row, "prior": "not kept"}


def _held_out(record: Record, shape: Shape, options: Mapping[str, Any]) -> tuple[float | None, float | None]:
    """Return the held-out RMS errors [% of the stroke] of the own and the prior's models.

    About the first and the last quarter of the record are held out in turn. The comparison needs both errors.
    """
    own: list[float] = []
    prior: list[float] = []
    for trained, held in _folds(record):
        with suppress(DehystError):
            prior.append(_errors(fitted(trained, shape), held, record.stroke, "validation").rms)
            own.append(_errors(identify(trained, **options).actuator, held, record.stroke, "validation").rms)
    if not prior:
        return None, None
    percent = 100 / record.stroke
    ours = percent * rms(np.array(own)) if len(own) == len(prior) else None
    return ours, percent * rms(np.array(prior))


def _folds(record: Record) -> Iterator[tuple[Record, Record]]:
    """Yield training and held-out parts, each with at least one cycle."""
    size = len(record)
    # No record has one sample: what lies beyond a cycle that ends with the record cannot be sliced.
    ends = np.array([cycle.stop - 1 for cycle in record.cycles() if cycle.stop < size])
    for first in (True, False):
        for end in ends[np.argsort(np.abs(ends - (0.25 if first else 0.75) * size), kind="stable")].tolist():
            parts = record.slice(0, end + 1), record.slice(end, size)
            if all(part.cycles() for part in parts):
                yield parts[::-1] if first else parts
                break


def _errors(actuator: Actuator, record: Record, stroke: float, role: str) -> RecordErrors:
    return errors_of(actuator, compare(actuator, prepare(record), stroke), role)[0]


def _fit(record: Record, shape: Shape) -> Fit:
    """Return the fit of the prior's shape to the whole record."""
    actuator = fitted(record, shape)
    error = _errors(actuator, record, float(np.ptp(actuator.spring.displacement)), "training")
    outcome = Outcome.IDENTIFIED if error.largest_percent <= RULES.useless else Outcome.INACCURATE
    return Fit(actuator.with_identification(outcome=outcome), outcome, (error,))


def fitted(record: Record, shape: Shape) -> Actuator:
    """Return the actuator of the prior's shape that fits a record best, by its gain, width and zero.

    It is simulated from below, and compared after the record has been through its whole range, so that noise of the
    displacement causes no bias. Raise `IdentifyError` if the displacement does not follow the voltage.
    """
    from scipy.optimize import minimize_scalar

    piece = record.delayed(shape.delay) if shape.delay else record
    begin = max(int(np.argmax(piece.voltage)), int(np.argmin(piece.voltage)))
    counted = slice(begin if begin < len(piece) // 2 else 0, None)
    y = piece.displacement[counted]

    def fit(width: float) -> tuple[float, float]:
        """Return the RMS error and the stroke at a width."""
        model = shape.actuator(1.0, width)
        start = model.turned(0.0, rising=False, extrapolate=True)
        u = model.simulate(piece.voltage, state=start, extrapolate=True).displacement[counted]
        # y = stroke u + zero
        (stroke, zero), *_ = np.linalg.lstsq(np.column_stack([u, np.ones_like(u)]), y, rcond=None)
        return float(np.sqrt(np.mean((y - stroke * u - zero) ** 2))), float(stroke)

    scale = float(np.ptp(record.displacement)) or 1.0
    best = minimize_scalar(
        lambda width: fit(width)[0] / scale,
        bounds=(_NARROWEST, shape.widest),
        method="bounded",
        options={"xatol": 1e-4},
    )
    width = float(best.x)
    _, stroke = fit(width)
    if not stroke > 0:
        raise IdentifyError(f"{record.name}: the displacement does not follow the voltage as the fleet's shape does")
    origin = {"prior_records": shape.records, "stroke_m": stroke, "width": width}
    return shape.actuator(
        stroke,
        width,
        limits=record.voltage_range,
        name=record.name,
        provenance={"program": f"dehyst {__version__}", **origin},
        identification=Identification(method="fleet"),
    )
