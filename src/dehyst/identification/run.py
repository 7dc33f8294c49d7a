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
from dehyst.identification.deadline import Deadline
from dehyst.identification.diagnostics import messages
from dehyst.identification.diagnostics.assumptions import assumption_checks
from dehyst.identification.diagnostics.expectation import HeldOutErrors, expectation
from dehyst.identification.diagnostics.remaining_error import remaining_error
from dehyst.identification.diagnostics.residuals import residual_checks
from dehyst.identification.dynamics_search import SensedDynamics
from dehyst.identification.extrapolation import block_error
from dehyst.identification.path_error import disagreement, size_error
from dehyst.identification.preprocessing import cleaning
from dehyst.identification.preprocessing.preparation import Prepared
from dehyst.identification.regression import nuisances
from dehyst.identification.regression.coefficients import Coefficients
from dehyst.identification.regression.fold_sums import least_squares_of_sums
from dehyst.identification.regression.regression import Regression
from dehyst.identification.regression.streaming import Stream
from dehyst.identification.settings import Settings
from dehyst.identification.solvers.program import Norm
from dehyst.identification.structure_selection import StructureTrial
from dehyst.identification.training_data import COARSE, TrainingData
from dehyst.identification.validation import MOST_ROWS, Protocol, errors_of
from dehyst.model import Actuator, Fit, Outcome, RecordErrors, Structure, Trace
from dehyst.model.readiness import USELESS
from dehyst.model.structure import Grid
from dehyst.records import Record
from dehyst.records.metrics import rms
from dehyst.records.signals import resolution

_T = TypeVar("_T")
# Thresholds in half strokes that records whose loops grow are also tried with, and how far they must lower the error.
REACH, WORTH_OF_REACH = 1.25, 0.6
# Of the spring, by default.
_MOST_KNOTS = 41
# A delay is looked for in cycles of so many samples at most, and in so many samples in all, or in three cycles.
_SEARCH_CYCLE = 20_000
_SEARCH_SAMPLES = 1_000_000
# Of the first model.
_FIRST_ROWS = 4000


@dataclass(eq=False)
class Run:
    """One identification: its records, and the remarks on them so far."""

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

    def __post_init__(self) -> None:
        self.repairs += [sentence for item in (*self.training, *self.held_out) for sentence in item.sentences]
        spans = [item.span() for item in self.training]
        self.widest = int(np.argmax([high - low for low, high in spans]))
        self.span = spans[self.widest]
        self.stroke = self.span[1] - self.span[0]

    def by_norm(self, solve: Callable[[Norm], _T], quickly: Callable[[], _T]) -> _T:
        """Solve the final program in the norm that was asked for; by least squares of fewer rows without time."""
        norm = self.settings.norm
        found = self.deadline.attempt(
            lambda: solve(norm), None, f"the {norm} program of all samples (least squares of fewer instead)"
        )
        if found is not None:
            return found
        self.settings = replace(self.settings, norm="l2")
        return quickly()

    def hand_over(self, regression: Regression) -> None:
        """Give the caller a first plain actuator, once."""
        first_model, self.first_model = self.first_model, None
        if first_model is None:
            return
        few = regression.thinned(_FIRST_ROWS)
        found = least_squares_of_sums(few)
        if found.solved.optimal:
            first_model(self.actuator(few, found).with_provenance(norm="l2", provisional=True))

    def whole_error(self, actuator: Actuator, regression: Regression) -> float:
        """RMS error of the training records, simulated whole [m]."""
        errors, _ = self.simulated(actuator, regression, self.training)
        return float(np.sqrt(np.average([one.rms**2 for one in errors], weights=[one.samples for one in errors])))

    def on_axis(self, datum: Array) -> list[Record]:
        """All pieces, displacements on the model's axis."""
        return [
            replace(piece, displacement=piece.displacement + datum[q])
            for q, item in enumerate(self.training)
            for piece in item.pieces
        ]

    def thresholds(self) -> Array:
        """Return the breakaway elongations of a plain actuator (N,) [m]: those given, or a uniform grid."""
        if self.settings.breakaway is not None:
            return self.settings.breakaway
        first = self.stroke / (2 * self.settings.count)
        return np.asarray(first * np.arange(1, self.settings.count + 1), dtype=np.float64)

    @cached_property
    def delay(self) -> float:
        """Seconds by which the displacement lags the voltage."""
        if self.settings.delay is not None:
            cycle = min(cleaning.cycle_time(item.record) for item in (*self.training, *self.held_out))
            if abs(self.settings.delay) > 0.25 * cycle:
                raise IdentifyError(
                    f"delay: got {self.settings.delay:g} s, need less than a quarter of a cycle of {cycle:.4g} s"
                )
            return self.settings.delay
        longest = 0.05 * min(cleaning.cycle_time(item.record) for item in self.training)
        sample = min(item.reduced.record.sample_time for item in self.training)
        # Too few elements or knots would round the turning points as a delay does, and creep would open the loop.
        grid = self.stroke / 60 * np.arange(1.0, 31.0)
        drifting = tuple(self.can_drift())

        data = self._data_of(0.0)
        few = [item.reduced.coarser(_SEARCH_CYCLE, _SEARCH_SAMPLES) for item in self.training]
        data = replace(data, training=few, floor=data.floor / self.settings.slope_floor * 0.01)

        def build(delay: float) -> Regression:
            late = replace(data, inertia=SensedDynamics(delay, 0.0, 0.0))
            return replace(self.stream(grid, late, knots=31).regression, drifting=drifting)

        return nuisances.find_delay(build, longest, sample)

    def can_drift(self) -> list[int]:
        """Return the training records that may drift."""
        return [q for q, item in enumerate(self.training) if item.can_drift and self.settings.drift]

    def data(self, delay: float) -> TrainingData:
        """Return the training records as plain elements need them: displacements as measured, each on its own axis."""
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
            SensedDynamics(delay, 0.0, 0.0),
            self.span,
            self.limits(),
            mean_slope * self.settings.slope_floor,
            np.zeros(len(self.training)),
            self.widest,
            tuple(self.can_drift()),
            denoised=False,
        )

    def stream(self, rho: Array, data: TrainingData, knots: int | None = None) -> Stream:
        """All rows of plain elements with these thresholds."""
        places = np.linspace(*self.span, knots or self.settings.knots or min(rho.size + 1, _MOST_KNOTS))
        beyond = bool(rho[-1] > 0.5 * self.stroke * (1 + 1e-9)) and self.settings.breakaway is None
        sliding = np.ones(rho.size, dtype=bool) if beyond else None
        stream = data.on_grid(Grid.plain(rho, places, sliding), MOST_ROWS)
        if len(stream.source) < 2 * rho.size:
            raise IdentifyError(
                f"{len(stream.source)} samples count for {rho.size} elements: only those after the range of a record "
                "has been seen once count. Record two cycles at least, or use fewer elements"
            )
        return stream

    def with_datums(self, regression: Regression) -> Regression:
        """Return a regression with the datum of each record that was zeroed anew."""
        others = [q for q in range(len(self.training)) if q != self.widest and not self.settings.shared_datum]
        return nuisances.with_datums(regression, others, self.stroke)

    def actuator(self, regression: Regression, found: Coefficients) -> Actuator:
        """Return the actuator of coefficients, named."""
        return self.named(self._data_of(self.delay).actuator_of(regression, found))

    def named(self, actuator: Actuator) -> Actuator:
        """Return an actuator with its limits, name and provenance."""
        name = self.training[self.widest].record.name
        return replace(actuator, limits=self.limits(), name=name, provenance=self.provenance())

    def limits(self) -> tuple[float, float]:
        """Voltages that were used: what glitches show, or what a gap cuts off, was not."""
        ranges = np.array([piece.voltage_range for item in self.training for piece in item.pieces])
        return float(ranges[:, 0].min()), float(ranges[:, 1].max())

    def provenance(self) -> dict[str, Any]:
        """Return program, options and records as JSON values."""
        return {
            "program": f"dehyst {__version__}",
            **self.settings.as_dict(),
            **({} if self.structure is None else {"structure": self.structure.as_dict()}),
            "records": [item.source() for item in self.training],
            "validation": [item.source() for item in self.held_out],
        }

    def failed(self, status: str) -> Fit:
        """Return the result of a program without an optimum."""
        return Fit(
            None,
            Outcome.FAILED,
            (),
            tuple(self.repairs),
            tuple(self.remarks),
            (),
            status,
            float("nan"),
            self.provenance(),
        )

    def simulated(
        self, actuator: Actuator, regression: Regression, records: Sequence[Prepared]
    ) -> tuple[list[RecordErrors], list[Trace]]:
        """Simulate records whole, the training records first."""
        errors, traces = [], []
        drifts = self.settings.drift and actuator.creep is None
        for q, item in enumerate(records):
            trained = q < len(self.training)
            # The paper's methods put every record on one axis; a held-out record's datum is looked for.
            datum = float(regression.datum[q]) if trained else 0.0 if self.settings.shared_datum else None
            drifting = q in regression.drifting if trained else drifts and item.can_drift
            protocol = Protocol("training" if trained else "validation", actuator.delay, datum, drifting, self.stroke)
            error, trace = errors_of(actuator, item, protocol)
            errors.append(error)
            traces.append(trace)
        return errors, traces

    def look_beyond(self, frame: TrainingData, regression: Regression, actuator: Actuator) -> None:
        """Find how far the actuator misses what it was not trained on."""
        self.remarks += messages.of_one_ended_loops([item.record.voltage for item in (*self.training, *self.held_out)])
        self.held_out_errors = HeldOutErrors(
            block_error(frame, regression),
            size_error(regression),
            disagreement(frame, actuator, self.limits(), self.trials),
            max(item.noise for item in frame.training),
        )

    def doubts(self, actuator: Actuator) -> list[str]:
        """Return reasons for care: a coarse voltage, and a lag whose cause the records do not show."""
        step = max(resolution(item.record.voltage)[1] for item in self.training)
        doubts = [f"the voltage is recorded in steps of {100 * step:.2g} % of its range"] if step > COARSE else []
        lag = actuator.delay + actuator.lag
        if self.settings.sensor_lag is not None or self.settings.delay is not None or not lag:
            return doubts
        items = [item.reduced.record for item in self.training]
        moved = lag * max(rms(np.diff(one.displacement)) / one.sample_time for one in items)
        if moved <= max(self.held_out_errors.in_time, self.held_out_errors.by_size):
            return doubts
        self.remarks.append(messages.of_lag(lag, moved, self.stroke))
        return [*doubts, f"the records do not show whether the sensor or the actuator lags by {1e3 * lag:.3g} ms"]

    def best_words(self, actuator: Actuator) -> str:
        """Describe the structure of the result and, if it was tried, its held-out error."""
        structure = self.structure or self.searched
        if structure is None:
            return f"{actuator.slip.breakaway.size} elements"
        errors = [trial.held_out for trial in self.trials if trial.structure == replace(structure, reach=1.0)]
        if not errors:
            return structure.words
        return f"{structure.words}, which miss held-out cycles by {100 * errors[-1] / self.stroke:.2g} % of the range"

    def finish(self, actuator: Actuator, regression: Regression, outcome: Outcome, status: str, gap: float) -> Fit:
        """Simulate all records whole, and judge the actuator."""
        records = (*self.training, *self.held_out)
        errors, traces = self.simulated(actuator, regression, records)
        missed = max(error.largest for error in errors[: len(self.training)])
        actuator = actuator.with_provenance(largest_error_m=missed, goal_percent=self.goal)
        imposed = outcome is Outcome.ASSUMPTION_I_IMPOSED
        floor = regression.floor if self.settings.method == "record" or imposed else None
        if actuator.wide:
            checked = residual_checks(actuator, traces, errors)
        else:
            checked = assumption_checks(actuator, records, errors, floor=floor, imposed=imposed)
        if max(error.largest_percent for error in errors) > USELESS:
            outcome = Outcome.VALIDATION_MISSED
        if max(error.largest_percent for error in errors if error.role == "training") > USELESS:
            outcome = Outcome.INACCURATE
        actuator = replace(actuator, provenance={**actuator.provenance, "outcome": outcome.name})
        self.remarks[:0] = self.deadline.remarks(self.best_words(actuator))
        self.remarks += messages.of_rare_voltages(self.training, self.limits())
        self.remarks += messages.of_held_out(self.held_out, self.limits(), errors)
        sample = self.training[self.widest].record.sample_time
        repaired = messages.repaired(errors, self.delay, sample, given=self.settings.delay is not None)
        remaining = tuple(remaining_error(trace) for trace in traces)
        noise, doubts = max(item.noise for item in records), self.doubts(actuator)
        options = {**self.provenance(), "delay_s": self.delay, "stroke_m": self.stroke}
        return Fit(
            actuator,
            outcome,
            tuple(errors),
            (*self.repairs, *repaired),
            tuple(self.remarks),
            tuple(traces),
            status,
            gap,
            options,
            checked,
            self.trials,
            expectation(outcome, errors, checked, self.held_out_errors, remaining, noise, self.goal, doubts),
            remaining,
        )
