"""One identification under way: its records, its options, and what was remarked so far."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from dehyst._errors import IdentifyError
from dehyst._types import Array, Progress
from dehyst._version import __version__
from dehyst.identification.diagnostics import messages
from dehyst.identification.diagnostics.checks import model_checks
from dehyst.identification.expectation import HeldOutErrors, expectation, validity_of
from dehyst.identification.fit import Fit
from dehyst.identification.held_out import block_error, disagreement, new_in_time
from dehyst.identification.lag_search import find_lag
from dehyst.identification.preprocessing.cleaning import cycle_time
from dehyst.identification.preprocessing.denoising import disturbs
from dehyst.identification.preprocessing.preparation import ENOUGH, Prepared
from dehyst.identification.regression import nuisances
from dehyst.identification.regression.fold_sums import least_squares_of_sums, training_errors
from dehyst.identification.regression.regression import Regression
from dehyst.identification.results import HeldOutHolds, RecordErrors, Trace, remaining_error
from dehyst.identification.rules import RULES
from dehyst.identification.settings import Deadline, Settings
from dehyst.identification.solvers.program import Norm
from dehyst.identification.structure import Grid, Structure
from dehyst.identification.structure_selection import StructureTrial, select
from dehyst.identification.training_data import FEW_ROWS, Lagging, TrainingData, longest_standstill
from dehyst.identification.validation import MOST_ROWS, compare, errors_of
from dehyst.model import Actuator, DisplacementCreep, Identification, Outcome
from dehyst.records import Record, guesses, recorded_slew_rate, resolution, rms
from dehyst.waveforms import Sampling

_T = TypeVar("_T")
# Of the spring, by default.
_MOST_KNOTS = 41
# Least slope of the spring in the search for a lag, as a part of the mean slope.
_LEAST_FLOOR = 0.01
# Most samples of a cycle, and of all cycles, in which a lag is searched; three cycles are used in any case.
_SEARCH_CYCLE, _SEARCH_SAMPLES = 20_000, 1_000_000
# Of the first model.
_FIRST_ROWS = 4000


@dataclass(eq=False)
class IdentificationRun:
    """One identification: its records, and the remarks on them so far.

    `searched`: the structure that was selected; `structure`: the one that is fitted, None for Maxwell-slip. `creep`:
    in displacement; what is fitted are the displacements before it. `holds`: by which it was chosen or not.
    """

    settings: Settings
    training: list[Prepared]
    held_out: list[Prepared]
    report: Progress
    goal: float = 1.0
    deadline: Deadline = field(default_factory=Deadline)
    first_model: Callable[[Actuator], None] | None = None
    repairs: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    structure: Structure | None = None
    trials: tuple[StructureTrial, ...] = ()
    steady: bool | None = None
    held_out_errors: HeldOutErrors = field(default_factory=HeldOutErrors)
    searched: Structure | None = None
    ringing: bool = False
    creep: DisplacementCreep | None = None
    holds: HeldOutHolds | None = None

    def __post_init__(self) -> None:
        self.repairs += [sentence for item in (*self.training, *self.held_out) for sentence in item.sentences]
        self.remarks += [messages.STEPS] if any(item.record.set_aside for item in self.training) else []
        spans = [item.span() for item in self.training]
        self.widest = int(np.argmax([high - low for low, high in spans]))
        self.span = spans[self.widest]
        self.stroke = self.span[1] - self.span[0]
        ranges = np.array([piece.voltage_range for item in self.training for piece in item.pieces])
        # Voltages that were used: what glitches show, or what a gap cuts off, was not.
        self.limits = float(ranges[:, 0].min()), float(ranges[:, 1].max())

    @property
    def drive(self) -> Sampling:
        """Sampling for a voltage to record, like the sampling of the records."""
        return messages.drive_like(self.limits, self.training)

    @cached_property
    def delay(self) -> float:
        """Seconds by which the displacement lags the voltage in all."""
        given = self.settings.delay
        if given is None:
            return self.lagging.delay + self.lagging.lag
        cycle = min(cycle_time(item.record) for item in (*self.training, *self.held_out))
        if abs(given) > 0.25 * cycle:
            raise IdentifyError(
                argument="delay", got=f"{given:g} s", need=f"less than a quarter of a cycle of {cycle:.4g} s"
            )
        return given

    @cached_property
    def lagging(self) -> Lagging:
        """Delay and first-order lag of the records, as given or as found."""
        return self.lag_of(self._data_of(0.0)) if self.settings.delay is None else Lagging(self.delay)

    def lag_of(self, data: TrainingData) -> Lagging:
        """Return delay and lag of records without them."""
        cycle = min(cycle_time(item.record) for item in self.training)
        # White noise of single samples hides a lag: means show it, even where a class takes every sample as it is.
        most = sum(len(item.record) for item in self.training) / ENOUGH
        means = [item.with_block(most).reduced for item in self.training]
        few = [item.coarser(_SEARCH_CYCLE, _SEARCH_SAMPLES) for item in means]
        # A floor would round the turning points as a delay does.
        floor = data.floor / self.settings.slope_floor * _LEAST_FLOOR
        return find_lag(replace(data, training=few, floor=floor, denoised=True), RULES.longest_lag * cycle, cycle)

    def can_drift(self) -> list[int]:
        """Return the training records that may drift."""
        return [q for q, item in enumerate(self.training) if item.can_drift and self.settings.drift]

    def data(self, delay: float) -> TrainingData:
        """Return the training records as Maxwell-slip takes them: displacements as measured, each on its own axis."""
        if self.steady is None:
            self.steady = self._data_of(delay).drifts_steadily()
            self.training, self.held_out = (
                [replace(item, steady=self.steady) for item in items] for items in (self.training, self.held_out)
            )
        return self._data_of(delay)

    def _data_of(self, delay: float) -> TrainingData:
        mean_slope = float(np.ptp(self.training[self.widest].record.voltage)) / self.stroke
        return TrainingData(
            [item.reduced for item in self.training],
            Lagging(delay),
            self.span,
            self.limits,
            mean_slope * self.settings.slope_floor,
            np.zeros(len(self.training)),
            self.widest,
            tuple(self.can_drift()),
            denoised=any(disturbs(item.reduced.noise, self.stroke) for item in self.training),
        )

    def maxwell_slip_error(self) -> float:
        """RMS residual of Maxwell-slip elements in few rows of the training records [m]."""
        rho = self.stroke / 60 * np.arange(1.0, 31.0)
        return training_errors()(self.regression(rho, self._data_of(0.0), knots=31).thinned(_FIRST_ROWS))

    def thresholds(self) -> Array:
        """Return the breakaway elongations of a Maxwell-slip actuator (N,) [m]: those given, or a uniform grid."""
        if self.settings.breakaway is not None:
            return self.settings.breakaway
        first = self.stroke / (2 * self.settings.count)
        return np.asarray(first * np.arange(1, self.settings.count + 1), dtype=np.float64)

    def regression(self, rho: Array, data: TrainingData, knots: int | None = None) -> Regression:
        """Return the regression of Maxwell-slip elements with these thresholds."""
        places = np.linspace(*self.span, knots or self.settings.knots or min(rho.size + 1, _MOST_KNOTS))
        beyond = bool(rho[-1] > 0.5 * self.stroke * (1 + 1e-9)) and self.settings.breakaway is None
        sliding = np.ones(rho.size, dtype=bool) if beyond else None
        regression = data.on_grid(Grid.maxwell_slip(rho, places, sliding), MOST_ROWS)
        if len(regression) < 2 * rho.size:
            raise IdentifyError(
                f"{len(regression)} samples count for {rho.size} elements: only those after the range of a record "
                "has been seen once count. Record two cycles at least, or use fewer elements"
            )
        return regression

    def with_datums(self, regression: Regression) -> Regression:
        """Return a regression with the datum of each record that was zeroed anew."""
        others = [q for q in range(len(self.training)) if q != self.widest and not self.settings.shared_datum]
        return nuisances.with_datums(regression, others, self.stroke)

    def with_drifts(self, regression: Regression) -> Regression:
        """Return a regression with a drift of each record in which it is significant."""
        return replace(regression, drifting=nuisances.find_drifts(regression, self.can_drift()))

    def on_axis(self, datum: Array) -> list[Record]:
        """All pieces, displacements on the model's axis."""
        return [
            replace(piece, displacement=piece.displacement + datum[q])
            for q, item in enumerate(self.training)
            for piece in item.pieces
        ]

    def publish_first_model(self, regression: Regression) -> None:
        """Give the caller a first Maxwell-slip actuator, once."""
        first_model, self.first_model = self.first_model, None
        if first_model is None:
            return
        few = regression.thinned(_FIRST_ROWS)
        found = least_squares_of_sums(few)
        if found.solved.optimal:
            actuator = self.named(self._data_of(self.delay).actuator_of(few, found))
            first_model(actuator.with_identification(norm="l2", provisional=True))

    def search(
        self, frame: TrainingData, start: Structure, without: tuple[str, ...] = ()
    ) -> tuple[Structure, tuple[StructureTrial, ...]]:
        """Return the structure that the records support, and the trials; fields in `without` do not change."""
        if not frame.supports_creep() and not without:
            without = ("creep",)
            longest, needed = max(map(longest_standstill, frame.training), key=lambda one: one[0] - one[1])
            drive = messages.drive_like(frame.voltages, frame.training)
            remark = messages.of_creep_not_tried(longest, needed, drive)
            self.remarks += [] if remark in self.remarks else [remark]

        def build(structure: Structure) -> Regression:
            return frame.regression(structure, FEW_ROWS)

        return select(build, start, self.report, without=without, stroke=frame.stroke, deadline=self.deadline)

    def solve_with_fallback(self, solve: Callable[[Norm], _T], quickly: Callable[[], _T]) -> _T:
        """Solve the final program in the norm that was asked for; by least squares of fewer rows without time."""
        norm = self.settings.norm
        found = self.deadline.attempt(
            lambda: solve(norm), None, f"the {norm} program of all samples (least squares of fewer instead)"
        )
        if found is not None:
            return found
        self.settings = replace(self.settings, norm="l2")
        return quickly()

    def named(self, actuator: Actuator) -> Actuator:
        """Return an actuator with its name, creep in displacement, and what is recorded of it."""
        return replace(self.creeping(actuator), **self.recorded(), name=self.training[self.widest].record.name)

    def creeping(self, actuator: Actuator) -> Actuator:
        """Return an actuator that was fitted before creep in displacement with that creep."""
        return actuator if self.creep is None else replace(actuator, displacement_creep=self.creep)

    def recorded(self) -> dict[str, Any]:
        """Return voltages, slew rate and identification of the used records as arguments of `Actuator`."""
        settings = self.settings
        known = Identification(
            norm=settings.norm,
            slope_floor=settings.slope_floor,
            shared_datum=settings.shared_datum,
            drift=settings.drift,
            sensor_lag=settings.sensor_lag or 0.0,
            ringing=self.ringing,
            smoothing=None if self.structure is None else self.structure.smoothing,
        )
        pieces = [(piece.time, piece.voltage) for item in self.training for piece in item.pieces]
        return {
            "limits": self.limits,
            "recorded_slew_rate": recorded_slew_rate(pieces),
            "identification": known,
            "provenance": self.provenance({"elements": settings.count}),
        }

    def provenance(self, options: dict[str, Any]) -> dict[str, Any]:
        """Return program, options and records as JSON values."""
        return {
            "program": f"dehyst {__version__}",
            **options,
            **({} if self.structure is None else {"structure": self.structure.as_dict()}),
            "records": [item.source() for item in self.training],
            "validation": [item.source() for item in self.held_out],
        }

    def failed(self, status: str) -> Fit:
        """Return the result of a program without an optimum."""
        repairs, remarks = tuple(self.repairs), tuple(self.remarks)
        options = self.provenance(self.settings.as_dict())
        return Fit(None, Outcome.FAILED, repairs=repairs, remarks=remarks, status=status, options=options)

    def simulated(
        self, actuator: Actuator, regression: Regression, records: Sequence[Prepared]
    ) -> tuple[list[RecordErrors], list[Trace]]:
        """Simulate records whole, the training records first."""
        errors, traces = [], []
        drifts = self.settings.drift and actuator.creep is None
        for q, item in enumerate(records):
            trained = q < len(self.training)
            datum = float(regression.datum[q]) if trained else 0.0 if self.settings.shared_datum else None
            drifting = q in regression.drifting if trained and self.creep is None else drifts and item.can_drift
            compared = compare(actuator, item, self.stroke, datum=datum, drifting=drifting)
            error, trace = errors_of(actuator, compared, "training" if trained else "validation")
            errors.append(error)
            traces.append(trace)
        return errors, traces

    def whole_error(self, actuator: Actuator, regression: Regression) -> float:
        """RMS error of the training records, simulated whole [m]."""
        errors, _ = self.simulated(self.creeping(actuator), regression, self.training)
        return float(np.sqrt(np.average([one.rms**2 for one in errors], weights=[one.samples for one in errors])))

    def estimate_heldout_errors(self, frame: TrainingData, regression: Regression, actuator: Actuator) -> None:
        """Estimate the actuator's error on held-out data."""
        voltages = [item.record.voltage for item in (*self.training, *self.held_out)]
        self.remarks += messages.of_one_ended_loops(voltages, self.drive)
        grows = 1.0 if self.creep is None else self.creep.at_rest
        self.held_out_errors = HeldOutErrors(
            grows * block_error(frame, regression),
            grows * disagreement(frame, actuator, self.limits, self.trials),
            max(item.noise for item in frame.training),
            new_in_time(frame),
        )

    def caveats(self, actuator: Actuator) -> tuple[list[str], float]:
        """Return reasons for care, and the lag [s] in the records that may be the sensor's."""
        caveats, step = [], max(resolution(item.record.voltage)[1] for item in self.training)
        if step > RULES.coarse_voltage:
            caveats.append(f"the voltage is recorded in steps of {100 * step:.2g} % of its range")
        lag = actuator.delay + actuator.lag
        if self.settings.sensor_lag is not None or self.settings.delay is not None or not lag:
            return caveats, 0.0
        items = [item.reduced.record for item in self.training]
        moved = lag * max(rms(np.diff(one.displacement)) / one.sample_time for one in items)
        if moved <= self.held_out_errors.in_time:
            return caveats, 0.0
        self.remarks.append(messages.of_lag(actuator.delay, actuator.lag, moved, self.stroke))
        caveats.append(f"the records do not show whether the sensor or the actuator lags by {1e3 * lag:.3g} ms")
        return caveats, lag

    def describe_result(self, actuator: Actuator) -> str:
        """Describe the structure of the result and, if it was tried, its held-out error."""
        structure = self.structure or self.searched
        if structure is None:
            return f"{actuator.slip.breakaway.size} elements"
        errors = [trial.held_out for trial in self.trials if trial.structure == replace(structure, reach=1.0)]
        if not errors:
            return structure.words
        return f"{structure.words}, which miss held-out cycles by {100 * errors[-1] / self.stroke:.2g} % of the stroke"

    def finish(self, actuator: Actuator, regression: Regression, outcome: Outcome, status: str, gap: float) -> Fit:
        """Simulate all records whole, and judge the actuator."""
        records = (*self.training, *self.held_out)
        errors, traces = self.simulated(actuator, regression, records)
        trained = errors[: len(self.training)]
        checked = model_checks(actuator, records, traces, errors, floor=regression.floor)
        useless = 0.01 * RULES.useless * self.stroke
        if max(error.settled_largest for error in errors) > useless:
            outcome = Outcome.VALIDATION_MISSED
        if max(error.settled_largest for error in trained) > useless:
            outcome = Outcome.INACCURATE
        guessed = dict.fromkeys(sentence for item in records for sentence in guesses(item.record))
        first = [" ".join(guessed)] if guessed else []
        self.remarks[:0] = first + self.deadline.remarks(self.describe_result(actuator))
        self.remarks += messages.of_rare_voltages(self.training, self.limits, self.drive)
        self.remarks += messages.of_held_out(self.held_out, self.limits, errors)
        sample, given = self.training[self.widest].record.sample_time, self.settings.delay is not None
        repaired = messages.repaired(errors, self.delay, sample, given=given, low_pass=actuator.lag)
        remaining = tuple(remaining_error(trace) for trace in traces)
        noise, (caveats, lag) = max(item.noise for item in records), self.caveats(actuator)
        validity = validity_of(
            [item.record for item in records],
            errors,
            remaining,
            self.held_out_errors,
            noise,
            lag,
            validated=outcome is not Outcome.INACCURATE,
        )
        expected = expectation(outcome, errors, checked, validity, noise, self.goal, caveats)
        actuator = actuator.with_identification(
            outcome=outcome,
            largest_error=max(error.largest for error in trained),
            goal=self.goal,
            expected_rms=expected.rms,
            expected_largest=expected.largest,
            validated=expected.tested,
            validity=validity,
        )
        options = self.provenance(self.settings.as_dict())
        return Fit(
            actuator,
            outcome,
            tuple(errors),
            (*self.repairs, *repaired),
            tuple(self.remarks),
            tuple(traces),
            status,
            gap,
            {**options, "delay_s": self.delay, "stroke_m": self.stroke},
            checked,
            self.trials,
            expected,
            remaining,
            self.holds,
        )
