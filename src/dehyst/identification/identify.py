"""Identification of an actuator from records of voltage and displacement: the function and its steps in order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, cast

import numpy as np

from dehyst._threads import one_thread
from dehyst._types import Progress
from dehyst._version import __version__
from dehyst._views.lines import percent
from dehyst.identification import events, messages, search
from dehyst.identification.checks import remaining_error, residual_checks
from dehyst.identification.comparison import compare, earlier, errors_of, zero_by_voltages
from dehyst.identification.coupling import identify_axes
from dehyst.identification.expectation import HeldOutErrors, expectation, validity_of
from dehyst.identification.fit import Fit
from dehyst.identification.frame import Frame
from dehyst.identification.identifiability import probed
from dehyst.identification.motion import Motion, temperatures_of
from dehyst.identification.preparation import ENOUGH, Prepared, after_loops, as_list, demand_short, distinct, prepare
from dehyst.identification.results import RecordErrors, Trace
from dehyst.identification.rules import RULES
from dehyst.identification.search import Fitted, Trial
from dehyst.identification.settings import Deadline, Settings
from dehyst.identification.structure import Structure
from dehyst.model import Actuator, Identification, Outcome, with_identification
from dehyst.records import Record, guesses, recorded_slew_rate, resolution, rms

# An offset of a record is significant from this part of the voltage range and this ratio of errors without and with it.
_OFFSET, _TIMES = 0.02, 3.0
PLAIN = Structure(elements=20, knots=21, smoothing=0.0)


def identify(
    records: Record | Sequence[Record],
    *,
    validate: Record | Sequence[Record] = (),
    delay: float | None = None,
    sensor_lag: float | None = None,
    lag_of: Literal["actuator", "sensor"] | None = None,
    shared_zero: bool = False,
    drift: bool = True,
    structure: Structure | Literal["auto", "maxwell_slip"] = "auto",
    goal: float = 1.0,
    progress: Progress | None = None,
    time_limit: float | Deadline | None = None,
) -> Fit:
    """Identify an actuator from records of loops; for several axes, return a `StageFit` with their coupling matrix.

    Parameters
    ----------
    records : Record or sequence of Record
        Training records, from any state, with a loop in total; minor loops improve the prediction of other motions.
    validate : Record or sequence of Record, optional
        Records that are only simulated. A constant (and zero and drift) is fitted to each, as to training records.
    delay : float, optional
        Time by which the displacement lags the voltage [s]; default: estimated from the training records.
    sensor_lag : float, optional
        Time constant [s] of the low-pass in the sensor, 0 without one. If given, any other lag is the actuator's.
    lag_of : {"actuator", "sensor"}, optional
        Cause of the lag that the records show; default: not known, and the promise has two numbers. The voltage of a
        planned path compensates a lag of the actuator, but not a lag of the sensor.
    shared_zero : bool, optional
        True if the sensor kept its zero in all records; default: the zero of each record is estimated.
    drift : bool, optional
        Whether to remove a drift from each record that is logarithmic in the time since its start.
    structure : {"auto", "maxwell_slip"} or Structure, optional
        Static parts of the model. "auto": graded and smooth elements with the smoothing of the least held-out error.
        "maxwell_slip": slip elements and a spring, as in Yeh's paper. Or a given structure.
    goal : float, optional
        Largest allowed error [% of the stroke] of a model that is ready for use: see `Expectation`.
    progress : callable, optional
        Called with a short text at each step.
    time_limit : float or Deadline, optional
        Time [s] after which no further step of a search begins. Then the best model so far is completed, and
        `Fit.remarks` names it. Another thread or a signal handler can end a `Deadline`.

    Raises
    ------
    RecordError
        If a record cannot be used: no loop, columns swapped, a clipped sensor, too few samples or cycles.
    IdentifyError
        If an option is impossible, or no sample contains information on the elements.
    """
    deadline = time_limit if isinstance(time_limit, Deadline) else Deadline(time_limit)
    settings = Settings(delay, sensor_lag, lag_of, shared_zero, drift, structure, goal)
    alone = partial(_alone, settings, deadline)
    report = deadline.watched(progress or (lambda _: None))
    training, held_out = distinct(records, validate)
    if training[0].axes:
        return cast("Fit", identify_axes(training, held_out, alone, report))
    return alone(training, held_out, report)


def _alone(
    settings: Settings, deadline: Deadline, training: Sequence[Record], held_out: Sequence[Record], report: Progress
) -> Fit:
    """Identify the actuator of one axis."""

    def fit(some: list[Record], others: list[Record]) -> Fit:
        return _Run(settings, after_loops(some), others, report, deadline).fit()

    with one_thread():
        return events.identified(as_list(training), as_list(held_out), fit)


@dataclass(eq=False)
class _Run:
    """One identification: its records, and the remarks on them so far."""

    settings: Settings
    records: list[Record]
    others: list[Record]
    report: Progress
    deadline: Deadline
    remarks: list[str] = field(default_factory=list)
    trials: list[Trial] = field(default_factory=list)
    lead: float = 0.0

    def prepared(self, *, ringing: bool) -> None:
        """Prepare all records; `ringing`: whether samples in which the displacement rings drive the elements."""
        most = sum(map(len, self.records)) / ENOUGH

        def ready(record: Record) -> Prepared:
            return prepare(record, ringing=ringing).with_block(most).without_lag(self.settings.sensor_lag or 0.0)

        self.ringing = ringing
        self.training, self.held_out = ([ready(record) for record in part] for part in (self.records, self.others))
        spans = [item.span() for item in self.training]
        self.widest = int(np.argmax([high - low for low, high in spans]))
        self.stroke = spans[self.widest][1] - spans[self.widest][0]
        ranges = np.array([piece.voltage_range for item in self.training for piece in item.pieces])
        # Only the used voltages count, without glitches and without samples that a gap cuts off.
        self.limits = float(ranges[:, 0].min()), float(ranges[:, 1].max())
        motion = replace(Motion.none(len(self.training)), delay=self.settings.delay or 0.0)
        items = [item.reduced for item in self.training]
        self.frame = Frame(items, motion, self.limits, self.widest, self.stroke)
        self.noise = max(item.noise for item in self.items)

    def fit(self) -> Fit:
        """Identify an actuator, and compute its expected error."""
        settings = self.settings
        self.report("checking the records")
        self.prepared(ringing=False)
        if any(item.record.set_aside for item in self.training):
            self.remarks.append(messages.STEPS)
            # The error in the samples after the ringing shows whether the hysteresis follows the ringing.
            still = search.fitted(self.frame, PLAIN, search.FEW).rms
            self.prepared(ringing=True)
            if search.fitted(self.frame, PLAIN, search.FEW).rms > still:
                self.prepared(ringing=False)
        demand_short(settings.delay or 0.0, "delay", min(item.cycle for item in self.items))
        self.temperatures, self.left_out = temperatures_of(self.records)
        if (found := self.temperatures) is not None:
            # The gain is fitted first: a moved zero could explain a part of it.
            warm = self.frame.with_motion(reference=found.reference, lowest=self.frame.span[0])
            step = partial(search.warmed, warm)
            self.frame = self.deadline.attempt(step, self.frame, "the search for an effect of temperature")
        if len(self.training) > 1 and not settings.shared_zero:
            step = partial(search.with_zeros, self.frame, self.report)
            self.frame = self.deadline.attempt(step, self.frame, "the search for the zeros of the sensor")
        plain = settings.structure == "maxwell_slip"
        names = self._moving(plain=plain)
        made = self._static(names, plain=plain)
        if (found := self.temperatures) is not None and made.frame.motion.thermal is None:
            cause = "the search ended before it" if self.deadline.cut else "the held-out error does not show its effect"
            self.left_out = f"{found.left_out}: {cause}"
        return self.finish(made)

    @property
    def items(self) -> list[Prepared]:
        """All records, training first."""
        return [*self.training, *self.held_out]

    def _moving(self, *, plain: bool) -> tuple[str, ...]:
        """Find the parts that move in time, and their numbers."""
        step = partial(
            search.moving,
            self.frame,
            self.report,
            lag=self.settings.delay is None,
            drift=self.settings.drift and any(item.can_drift for item in self.training),
            more=not plain,
        )
        nothing: tuple[Frame, tuple[str, ...], list[Trial]] = self.frame.with_motion(reference=None), (), []
        self.frame, names, trials = self.deadline.attempt(step, nothing, "the search for delay, creep and resonance")
        self.trials += trials
        steady = self.frame.training[0].steady
        self.training, self.held_out = (
            [replace(item, steady=steady) for item in some] for some in (self.training, self.held_out)
        )
        if self.frame.motion.delay < 0:
            self._lead(-self.frame.motion.delay)
            names = tuple(name for name in names if name != "delay")
        return names

    def _lead(self, seconds: float) -> None:
        """Move the voltages of all records earlier, as the displacement leads them; set the delay to 0."""
        self.records, self.others = ([earlier(item, seconds) for item in part] for part in (self.records, self.others))
        self.lead, motion = seconds, self.frame.with_motion(delay=0.0).motion
        self.prepared(ringing=self.ringing)
        self.frame = replace(self.frame, motion=motion)
        self.remarks.append(messages.LEADS.format(seconds=1e3 * seconds))

    def _static(self, names: tuple[str, ...], *, plain: bool) -> Fitted:
        """Solve the program of the structure with the least held-out error."""
        given, self.determined = self.settings.structure, True
        structures: Sequence[Structure] = [PLAIN] if plain else [given] if isinstance(given, Structure) else search.WIDE
        if given == "auto":
            pieces = [path for _, _, path in self.frame.paths]
            probe = probed(pieces, self.frame.span)
            self.determined = probe.determined == probe.of
            if not self.determined:
                structures = search.OPEN
        step = partial(search.static, self.frame, structures, names, self.report)
        found = self.deadline.attempt(step, None, "the choice of a smoothing")
        if found is None:
            first = search.with_parts(self.frame, structures[0], names)
            found = first, [], [first]
        made, trials, self.alternatives = found
        self.trials += trials
        return made

    def named(self, actuator: Actuator, structure: Structure | None = None) -> Actuator:
        """Return an actuator with its name, and the voltages, slew rate and identification of the used records."""
        settings = self.settings
        known = Identification(
            lag_of=settings.lags or "",
            shared_zero=settings.shared_zero,
            drift=settings.drift,
            sensor_lag=settings.sensor_lag or 0.0,
            lead=self.lead,
            ringing=self.ringing,
            slew_rate=recorded_slew_rate([(p.time, p.voltage) for item in self.training for p in item.pieces]),
        )
        return replace(
            actuator,
            limits=self.limits,
            identification=known,
            provenance=self.provenance(structure),
            name=self.training[self.widest].record.name,
        )

    def provenance(self, structure: Structure | None) -> dict[str, Any]:
        """Return program, options and records as JSON values."""
        return {
            "program": f"dehyst {__version__}",
            **self.settings.as_dict(),
            **({} if structure is None else {"structure": structure.as_dict()}),
            "records": [item.source() for item in self.training],
            "validation": [item.source() for item in self.held_out],
        }

    def simulated(self, actuator: Actuator, drift: Any) -> tuple[list[RecordErrors], list[Trace], list[RecordErrors]]:
        """Simulate whole records, the training records first; return errors, traces, and errors for the verdict.

        If a record needs an offset of its voltages, like a record of another stage, the error without it counts.
        """
        errors, traces, judged = [], [], []
        drifts = self.settings.drift and bool(np.any(drift))
        thermal = actuator.thermal
        for q, measured in enumerate(self.items):
            item = measured if thermal is None else measured.at_reference(thermal)
            trained = q < len(self.training)
            zero = float(self.frame.motion.zero[q]) if trained else 0.0 if self.settings.shared_zero else None
            drifting = bool(drift[q]) if trained else drifts and item.can_drift
            compared = compare(actuator, item, self.stroke, zero=zero, drifting=drifting)
            role = "training" if trained else "validation"
            error, trace = errors_of(actuator, compared, role)
            errors.append(error)
            traces.append(trace)
            judged.append(error)
            if len([*self.records, *self.others]) > 1 and abs(error.offset) > _OFFSET * np.ptp(self.limits):
                zero = zero_by_voltages(actuator, item, self.stroke)
                compared = compare(actuator, item, self.stroke, zero=zero, drifting=drifting)
                alone = errors_of(actuator, compared, role)[0]
                if alone.settled_largest > max(0.01 * RULES.apart * self.stroke, _TIMES * error.settled_largest):
                    judged[q] = alone
        return errors, traces, judged

    def _warms(self, made: Fitted) -> str:
        """Return the sentence about the effect of temperature."""
        assert self.temperatures is not None
        names = [name for name in ("thermal", "expansion") if name in made.names]
        by_words = {trial.words: trial.held_out for trial in self.trials}
        better = by_words[f"moves: {' and '.join(names)}"] / by_words["moves: nothing"]
        return self.temperatures.sentence(made.frame.motion, {name: made.spread(name) for name in names}, better)

    def caveats(self, actuator: Actuator, missed: float) -> tuple[list[str], bool]:
        """Return reasons for care, and True if the records do not show whether actuator or sensor lags."""
        caveats = [self.left_out] if self.left_out else []
        step = max(resolution(item.record.voltage)[1] for item in self.training)
        if step > RULES.coarse_voltage:
            caveats.append(f"the voltage is recorded in steps of {100 * step:.2g} % of its range")
        lag, items = actuator.delay + actuator.lag, [item.reduced.record for item in self.training]
        moved = lag * max(rms(np.diff(record.displacement)) / record.sample_time for record in items)
        if lag_open := self.settings.lags is None and moved > missed:
            caveats.append(f"the records leave open whether the actuator or the sensor lags by {1e3 * lag:.3g} ms")
        return caveats, lag_open

    def outcome(self, errors: Sequence[RecordErrors]) -> Outcome:
        """Return the outcome of the identification from the errors of all records."""
        missed = {error.role for error in errors if error.settled_largest > 0.01 * RULES.useless * self.stroke}
        if not missed:
            return Outcome.IDENTIFIED if self.determined else Outcome.UNDETERMINED
        return Outcome.INACCURATE if "training" in missed else Outcome.VALIDATION_MISSED

    def finish(self, made: Fitted) -> Fit:
        """Simulate all whole records, and compute the expected error of the actuator."""
        self.report("simulating the records")
        self.frame = made.frame
        actuator = self.named(made.actuator, made.structure)
        errors, traces, judged = self.simulated(actuator, made.frame.motion.drift)
        outcome, checked = self.outcome(errors), residual_checks(traces, self.stroke)
        remaining = tuple(map(remaining_error, traces))
        apart = [(error, alone) for error, alone in zip(errors, judged, strict=True) if alone is not error]
        caveats, lag_open = self.caveats(actuator, made.held_out)
        caveats[:0] = [messages.of_offset(alone, error.offset) for error, alone in apart]
        lag, hidden = actuator.delay + actuator.lag, made.frame.motion.hidden
        known: dict[str, Any] = {"lag": lag, "lag_open": lag_open, "creep_open": hidden}
        known |= {} if self.settings.delay is None else {"lag_error": 0.0}
        validated = outcome is not Outcome.INACCURATE and not apart
        records, noise = [item.record for item in self.items], max(item.noise for item in self.frame.training)
        disagreement = search.disagreement(actuator, self.alternatives, made, self.frame)
        held_out = HeldOutErrors(made.held_out, disagreement, noise, search.new_in_time(self.frame))
        validity = validity_of(records, judged, remaining, traces, held_out, self.noise, validated=validated, **known)
        expected = expectation(outcome, errors, checked, validity, self.noise, self.settings.goal, caveats)
        trained = errors[: len(self.training)]
        worst = max(error.largest for error in trained)
        actuator = with_identification(
            actuator, outcome=outcome, largest_error=worst, goal=self.settings.goal, validity=validity
        )
        self.remark(made, actuator, trained)
        used = {"delay_s": lag, "stroke_m": self.stroke, "cut": [*self.deadline.cut]}
        return Fit(
            actuator,
            outcome,
            expected,
            tuple(errors),
            self.repairs(actuator, errors),
            tuple(self.remarks),
            tuple(traces),
            options={**self.provenance(made.structure), **used},
            checks=checked,
            trials=tuple(self.trials),
            remaining=remaining,
        )

    def remark(self, made: Fitted, actuator: Actuator, trained: Sequence[RecordErrors]) -> None:
        """Add the remarks on an actuator, the most important first."""
        words = f"{made.structure.words}, with a held-out error of {percent(made.held_out, self.stroke)}"
        first = self.deadline.remarks(words) + messages.of_moved_zeros(trained)
        if self.temperatures is not None and made.frame.motion.thermal is not None:
            first.append(self._warms(made))
        first += dict.fromkeys(sentence for item in self.items for sentence in guesses(item.record))
        first += [messages.NO_LAG] * bool(self.settings.lag_of and not actuator.delay + actuator.lag)
        self.remarks = first + self.remarks + messages.of_rare_voltages(self.training, self.limits)
        for item in self.held_out:
            played = actuator.promise(item.record.voltage)
            gaps = () if played is None else played.untested
            self.remarks += [f"{item.name}: {gap.sentence}" for gap in gaps if gap.what == "voltages"]

    def repairs(self, actuator: Actuator, errors: Sequence[RecordErrors]) -> tuple[str, ...]:
        """Return sentences about data that were left out, shifted or removed."""
        sample, given = self.training[self.widest].record.sample_time, self.settings.delay is not None
        delay = actuator.delay + actuator.lag
        moved = messages.repaired(errors, delay, sample, given=given, low_pass=actuator.lag)
        repaired = (
            words for item in self.items for words in item.sentences if not words.endswith(guesses(item.record))
        )
        return *repaired, *moved
