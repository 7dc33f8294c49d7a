"""Records of voltage and displacement to an identified actuator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from dehyst import breakpoints, repairs
from dehyst._errors import IdentifyError
from dehyst._native import Array, vector
from dehyst.actuator import Actuator
from dehyst.elements import MaxwellSlip, Spring
from dehyst.model import Fit, Outcome, RecordErrors, Trace
from dehyst.program import NORMS, Norm, one_thread
from dehyst.record import Record
from dehyst.regression import Coefficients, Regression
from dehyst.rows import collect, epochs
from dehyst.verify import errors_of
from dehyst.version import __version__

Method = Literal["record", "breakpoints", "antisymmetric"]
Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Prepared:
    """A record after its start-up transient was left out and it was cut at gaps; voltages not yet delayed."""

    record: Record
    pieces: tuple[Record, ...]
    start: float
    noise: float
    can_drift: bool

    def span(self) -> tuple[float, float]:
        """Lowest and highest displacement [m] among the samples that count."""
        counted = [
            np.append(piece.displacement[epoch.start : epoch.stop], piece.displacement[epoch.turn])
            for piece in self.pieces
            for epoch in epochs(piece, self.noise)
        ]
        if not counted:
            raise IdentifyError(
                f"{self.record.name}: no sample counts, for the voltage never comes back into the range it has been in. "
                "Record one full cycle at least, better two"
            )
        return min(float(y.min()) for y in counted), max(float(y.max()) for y in counted)

    def delayed(self, number: int, delay: float) -> list[tuple[int, Record, Array]]:
        """(record number, piece, drift curve) of each piece, for `rows.collect`."""
        pieces = [piece.delayed(delay) if delay else piece for piece in self.pieces]
        whole = repairs.drift_curve(self.record, self.start)
        return [(number, piece, np.interp(piece.time, self.record.time, whole)) for piece in pieces]


@dataclass(frozen=True)
class Settings:
    """What an identification was asked for."""

    elements: int
    breakaway: Array | None
    norm: Norm
    knots: int | None
    slope_floor: float
    delay: float | None
    shared_datum: bool
    drift: bool


def identify(
    records: Record | Sequence[Record],
    *,
    validate: Record | Sequence[Record] = (),
    method: Method = "record",
    elements: int | None = None,
    breakaway: ArrayLike | None = None,
    norm: Norm = "l1",
    knots: int | None = None,
    slope_floor: float = 0.2,
    delay: float | None = None,
    shared_datum: bool = False,
    drift: bool = True,
    branch: Literal["descending", "ascending"] = "descending",
    throw: bool = True,
    progress: Progress | None = None,
) -> Fit:
    """Identify an actuator from records of major and minor loops; none needs to start relaxed.

    Parameters
    ----------
    records : Record or sequence of Record
        Training records, together with one loop at least; minor loops decide how well other motions are predicted.
    validate : Record or sequence of Record, optional
        Records that are only simulated. Each gets its own constant (and datum and drift), as training records do.
    method : {"record", "breakpoints", "antisymmetric"}
        Every sample of every record (default); the paper's linear program on break points (Sec. 4.1); Remark 2's
        closed form, without a nonlinear spring.
    elements : int, optional
        Number N of slip elements on the paper's uniform grid over the widest loop, rho_i = i range / (2 N);
        default 20 (10 for the paper's methods).
    breakaway : (N,) array_like, optional
        Breakaway elongations [m] in place of the grid; "record" only.
    norm : {"l1", "l2", "linf"}, optional
        Of the weighted residuals; "record" only.
    knots : int, optional
        Knots of the spring; default N + 1. "record" only.
    slope_floor : float, optional
        Least slope of the spring as a fraction of the mean slope of the widest loop (Assumption I with a margin).
    delay : float, optional
        Seconds by which the displacement lags the voltage; default: estimated from the training records.
    shared_datum : bool, optional
        Say that no record zeroed its sensor anew; default: each record's datum is looked for.
    drift : bool, optional
        Whether a record may creep by a logarithm of the time since its start, which is then set aside.
    branch : {"descending", "ascending"}, optional
        "antisymmetric" only.
    throw : bool, optional
        Raise if the solver finds no optimum (default), or return a Fit with `Outcome.FAILED`.
    progress : callable, optional
        Called with a few words at each step.

    Returns
    -------
    Fit

    Raises
    ------
    RecordError
        If a record cannot be used: no loop, columns swapped, a clipped sensor, too few samples or cycles.
    IdentifyError
        If an option is impossible, or no sample says anything about the elements.
    """
    tell = progress or (lambda _: None)
    settings = _settings(method, elements, breakaway, norm, knots, slope_floor, delay, shared_datum, drift)
    training, held_out = _as_list(records), _as_list(validate)
    if not training:
        raise IdentifyError("got no records, need one loop of voltage and displacement at least")
    tell("checking the records")
    said: list[str] = []
    prepared = [_prepare(record, said) for record in training]
    checks = [_prepare(record, said) for record in held_out]
    with one_thread():
        job = _Job(settings, prepared, checks, said, tell)
        fit = job.by_records() if method == "record" else job.by_breakpoints(method, branch)
    if fit.outcome is Outcome.FAILED and throw:
        raise IdentifyError(f"{fit.outcome.value} {fit.status}. Try another norm or fewer elements")
    return fit


def _settings(method: str, elements: int | None, breakaway: ArrayLike | None, norm: Norm, knots: int | None,
              slope_floor: float, delay: float | None, shared_datum: bool, drift: bool) -> Settings:  # fmt: skip
    if method not in ("record", "breakpoints", "antisymmetric"):
        raise IdentifyError(f"method: got {method!r}, need 'record', 'breakpoints' or 'antisymmetric'")
    if norm not in NORMS:
        raise IdentifyError(f"norm: got {norm!r}, need one of {', '.join(NORMS)}")
    rho = None if breakaway is None else vector(breakaway, "breakaway")
    if rho is not None and elements is not None:
        raise IdentifyError("got both elements and breakaway, need one of them")
    if rho is not None and method != "record":
        raise IdentifyError(f"breakaway: method {method!r} needs the uniform grid; give elements, or method='record'")
    if rho is not None and (rho.size == 0 or rho[0] <= 0 or np.any(np.diff(rho) <= 0)):
        raise IdentifyError("breakaway: need positive, strictly increasing elongations in metres")
    count = rho.size if rho is not None else elements if elements is not None else 20 if method == "record" else 10
    if not 1 <= count <= 500:
        raise IdentifyError(f"elements: got {count}, need 1 to 500")
    if knots is not None and not 2 <= knots <= 500:
        raise IdentifyError(f"knots: got {knots}, need 2 to 500")
    if not 0 < slope_floor < 1:
        raise IdentifyError(f"slope_floor: got {slope_floor}, need a fraction between 0 and 1")
    if delay is not None and not np.isfinite(delay):
        raise IdentifyError(f"delay: got {delay}, need seconds")
    return Settings(int(count), rho, norm, knots, slope_floor, delay, shared_datum, drift)


def _as_list(records: Record | Sequence[Record]) -> list[Record]:
    return [records] if isinstance(records, Record) else list(records)


def _prepare(record: Record, said: list[str]) -> Prepared:
    record.check_usable()
    said.extend(f"{record.name}: {problem}" if record.name not in problem else problem
                for problem in record.problems() if "gap" not in problem)  # fmt: skip
    dropped = repairs.transient(record)
    kept = record.slice(dropped, len(record)) if dropped else record
    if dropped:
        until = float(record.time[dropped] - record.time[0])
        said.append(
            f"{record.name}: the first {until:.4g} s ({dropped} samples) lie outside the loops that follow, a start-up "
            "transient or a rise from an unknown state; left out"
        )
    pieces, gaps = repairs.split_at_gaps(kept)
    said.extend(gaps)
    return Prepared(kept, tuple(pieces), float(record.time[0]), record.noise, len(record.cycles()) >= 3)


class _Job:
    """One identification: its records, and what was said of them so far."""

    def __init__(self, settings: Settings, training: list[Prepared], held_out: list[Prepared], said: list[str],
                 tell: Progress) -> None:  # fmt: skip
        self.settings, self.training, self.held_out = settings, training, held_out
        self.said, self.tell, self.remarks = said, tell, list[str]()
        spans = [item.span() for item in training]
        self.widest = int(np.argmax([high - low for low, high in spans]))
        self.span = spans[self.widest]
        self.stroke = self.span[1] - self.span[0]
        self.delay = 0.0

    def by_records(self) -> Fit:
        """Every sample of every record."""
        self.tell("estimating delay, datums and drifts")
        rho = self._thresholds()
        self.delay = self._delay()
        regression = self._nuisances(self._regression(rho, self.delay))
        self.tell(f"solving the {self.settings.norm} program for {len(regression.rows)} samples")
        found = regression.fit_weighted(self.settings.norm)
        if not found.solution.optimal:
            return Fit(None, Outcome.FAILED, status=found.solution.status, repairs=tuple(self.said))
        self._say_nuisances(regression, found)
        actuator = self._actuator(rho, regression, found)
        self.tell("simulating every record")
        determined, of = regression.determined()
        if determined < of:
            self.remarks.append(
                f"the records determine {determined} of {of} directions of the stiffnesses; minor loops with other "
                "turning points determine more"
            )
        outcome = self._outcome(regression, found, determined, of)
        return self._finish(actuator, regression, outcome, found.solution.status, found.solution.gap)

    def by_breakpoints(self, method: str, branch: str) -> Fit:
        """The paper's own method, or Remark 2's closed form."""
        settings = self.settings
        self.delay = self._delay()
        records = [replace(item, record=item.record.delayed(self.delay)) if self.delay else item for item in self.training]
        self.tell("reading break points")
        loops = breakpoints.loops_of([item.record for item in records], settings.elements)
        if method == "antisymmetric":
            found = breakpoints.closed_form(loops, settings.elements, branch)
        else:
            found = breakpoints.linear_program(loops, settings.elements, settings.slope_floor)
        if found.actuator is None:
            return Fit(None, Outcome.FAILED, status=found.status, repairs=tuple(self.said))
        self._say_delay()
        self.remarks.extend(found.remarks)
        actuator = replace(found.actuator, delay=self.delay, limits=self._limits(), provenance=self._provenance(method))
        regression = self._nuisances(self._regression(actuator.slip.breakaway, self.delay), spring=actuator.spring)
        return self._finish(actuator, regression, found.outcome, found.status, found.gap)

    def _thresholds(self) -> Array:
        if self.settings.breakaway is not None:
            return self.settings.breakaway
        n = self.settings.elements
        noise = max(item.noise for item in self.training)
        first = self.stroke / (2 * n)
        if first < 30 * noise:
            self.remarks.append(
                f"the first element lets go at {first * 1e6:.4g} um, {first / noise:.3g} times the sensor's noise; below "
                "30 times its stiffness comes out too small"
            )
        return first * np.arange(1, n + 1)

    def _delay(self) -> float:
        if self.settings.delay is not None:
            return self.settings.delay
        longest = 0.05 * min(repairs.cycle_time(item.record) for item in self.training)
        sample = min(item.record.sample_time for item in self.training)
        # Too few elements would round the turning points as a delay does.
        grid = self.stroke / 60 * np.arange(1, 31)
        return repairs.find_delay(lambda delay: self._regression(grid, delay), longest, sample)

    def _regression(self, rho: Array, delay: float) -> Regression:
        pieces = [piece for q, item in enumerate(self.training) for piece in item.delayed(q, delay)]
        noise = [self.training[q].noise for q, _, _ in pieces]
        rows, _ = collect(pieces, rho, noise)
        if len(rows) < 2 * rho.size:
            raise IdentifyError(
                f"{len(rows)} samples count for {rho.size} elements: only those after the range of a record has been seen "
                "once say something. Record two cycles at least, or use fewer elements"
            )
        low, high = self.span
        count = self.settings.knots or min(rho.size + 1, 41)
        floor = self.settings.slope_floor * float(np.ptp(self.training[self.widest].record.voltage)) / self.stroke
        movable = 2 * rho < self.stroke * (1 - 1e-9)
        if not movable.any():
            raise IdentifyError(
                f"breakaway: even the least elongation, {rho[0]:.4g} m, is more than half of the range {self.stroke:.4g} m: "
                "no element would ever slide"
            )
        return Regression(rows, np.linspace(low, high, count), floor, movable, np.zeros(len(self.training)))

    def _nuisances(self, regression: Regression, spring: Spring | None = None) -> Regression:
        """Add the datums and drifts that are worth it."""
        others = [q for q in range(len(self.training)) if q != self.widest]
        if not self.settings.shared_datum and spring is None:
            for q in others:
                datum = regression.datum.copy()
                datum[q] = repairs.find_datum(regression, q, self.stroke)
                regression = replace(regression, datum=datum)
        if self.settings.drift:
            can = [q for q, item in enumerate(self.training) if item.can_drift]
            regression = replace(regression, drifting=repairs.find_drifts(regression, can))
        return regression

    def _say_delay(self) -> None:
        if self.delay:
            sample = self.training[self.widest].record.sample_time
            how = "estimated" if self.settings.delay is None else "given"
            self.said.append(
                f"the displacement lags the voltage by {self.delay * 1e3:.4g} ms ({self.delay / sample:.3g} samples, {how}); "
                "voltages were delayed by it"
            )

    def _say_nuisances(self, regression: Regression, found: Coefficients) -> None:
        self._say_delay()
        slope = float(np.median(regression.slope(found)))
        for q, item in enumerate(self.training):
            name = item.record.name
            if regression.datum[q]:
                self.said.append(f"{name}: its sensor's zero differs by {regression.datum[q] * 1e6:.4g} um; shifted by that")
            if q in found.drifts:
                part = -100 * found.drifts[q] / slope / self.stroke
                self.said.append(f"{name}: creeps by {part:.3g} % of the range a decade of time since its start; set aside")

    def _actuator(self, rho: Array, regression: Regression, found: Coefficients) -> Actuator:
        reference = regression.rows.epoch[regression.rows.record == self.widest].max()
        values = found.offsets[int(reference)] + np.concatenate([[0.0], np.cumsum(found.slopes * np.diff(regression.knots))])
        return Actuator(
            MaxwellSlip(rho, found.stiffness),
            Spring(regression.knots, values),
            limits=self._limits(),
            delay=self.delay,
            name=self.training[self.widest].record.name,
            provenance=self._provenance("record"),
        )

    def _limits(self) -> tuple[float, float]:
        ranges = np.array([item.record.voltage_range for item in self.training])
        return float(ranges[:, 0].min()), float(ranges[:, 1].max())

    def _provenance(self, method: str) -> dict[str, Any]:
        return {
            "program": f"dehyst {__version__}",
            "method": method,
            "norm": self.settings.norm,
            "elements": self.settings.elements,
            "slope_floor": self.settings.slope_floor,
            "records": [{"name": item.record.name, **{k: item.record.meta[k] for k in ("source", "sha256") if k in item.record.meta}}
                        for item in self.training],
        }  # fmt: skip

    def _outcome(self, regression: Regression, found: Coefficients, determined: int, of: int) -> Outcome:
        low = np.flatnonzero(found.slopes <= regression.floor * (1 + 1e-6))
        if low.size:
            places = ", ".join(f"{regression.knots[j] * 1e6:.4g} to {regression.knots[j + 1] * 1e6:.4g} um" for j in low[:4])
            self.remarks.append(f"the spring's slope lies on its floor at {places}{' and elsewhere' if low.size > 4 else ''}")
            return Outcome.FLOOR_ACTIVE
        return Outcome.UNDETERMINED if determined < of else Outcome.IDENTIFIED

    def _finish(self, actuator: Actuator, regression: Regression, outcome: Outcome, status: str, gap: float) -> Fit:
        traces: list[Trace] = []
        errors: list[RecordErrors] = []
        for role, items in (("training", self.training), ("validation", self.held_out)):
            for q, item in enumerate(items):
                drifting = q in regression.drifting if role == "training" else self.settings.drift and item.can_drift
                datum = float(regression.datum[q]) if role == "training" else None
                datum = 0.0 if self.settings.shared_datum else datum
                pieces = [(piece, curve) for _, piece, curve in item.delayed(q, self.delay)]
                error, trace = errors_of(actuator, item.record, pieces, item.noise, role, datum, drifting, self.stroke)
                errors.append(error)
                traces.append(trace)
        if max(error.largest_percent for error in errors if error.role == "training") > 5:
            outcome = Outcome.INACCURATE
        return Fit(actuator, outcome, tuple(errors), tuple(self.said), tuple(self.remarks), tuple(traces), status, gap,
                   {**self._provenance(outcome.name), "delay_s": self.delay, "stroke_m": self.stroke})  # fmt: skip
