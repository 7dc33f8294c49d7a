"""Records of voltage and displacement to an identified actuator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from dehyst import _validation
from dehyst._errors import IdentifyError
from dehyst._threads import one_thread
from dehyst._types import Array, Progress
from dehyst._version import __version__
from dehyst.identification import output_error, paper_methods
from dehyst.identification.deadline import Deadline
from dehyst.identification.diagnostics import messages
from dehyst.identification.diagnostics.assumptions import assumption_checks
from dehyst.identification.diagnostics.expectation import expectation
from dehyst.identification.diagnostics.identifiability import identifiability, probe_identifiability
from dehyst.identification.diagnostics.remaining_error import remaining_error
from dehyst.identification.diagnostics.residuals import residual_checks
from dehyst.identification.dynamics_search import SensedDynamics
from dehyst.identification.extrapolation import Dropped, block_error, unsupported
from dehyst.identification.preprocessing import cleaning
from dehyst.identification.preprocessing.preparation import Prepared, as_list, prepare
from dehyst.identification.regression import nuisances
from dehyst.identification.regression.coefficients import Coefficients
from dehyst.identification.regression.fold_sums import least_squares_of_sums
from dehyst.identification.regression.regression import Regression
from dehyst.identification.regression.streaming import Stream
from dehyst.identification.settings import Direction, Method, Settings
from dehyst.identification.solvers.program import Norm
from dehyst.identification.structure_selection import StructureTrial, simplest
from dehyst.identification.structured_fit import StructuredFit
from dehyst.identification.training_data import TrainingData
from dehyst.identification.validation import MOST_ROWS, Protocol, errors_of
from dehyst.model import Actuator, Fit, Outcome, RecordErrors, Structure, Trace
from dehyst.model.readiness import USELESS
from dehyst.model.structure import Grid
from dehyst.records import Record

_T = TypeVar("_T")
# Thresholds in half strokes that records whose loops grow are also tried with, and how far they must lower the error.
_REACH, _WORTH_OF_REACH = 1.25, 0.6
# Of the spring, by default.
_MOST_KNOTS = 41
# A delay is looked for in cycles of so many samples at most, and in so many samples in all, or in three cycles.
_SEARCH_CYCLE = 20_000
_SEARCH_SAMPLES = 1_000_000
# Of the first model.
_FIRST_ROWS = 4000


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
    branch: Direction = "descending",
    structure: Structure | Literal["auto", "paper"] = "auto",
    refine: bool = False,
    goal: float = 1.0,
    throw: bool = True,
    progress: Progress | None = None,
    time_limit: float | Deadline | None = None,
    first_model: Callable[[Actuator], None] | None = None,
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
        Knots of the spring; default N + 1, 41 at most. "record" only.
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
    structure : {"auto", "paper"} or Structure, optional
        How much model: what cycles held out in turn ask for (default: more elements, a transformer, graded elements,
        creep, smooth elements, inertia), the paper's class, or a class that is given. What only the paper's class knows
        (elements, breakaway, knots, another method) asks for that class.
    refine : bool, optional
        Try Gauss-Newton steps that make the error of simulation small, thresholds free, and keep them if they are
        better on cycles held out; not for the paper's class ("paper").
    goal : float, optional
        Largest error [% of the stroke] with which the model is ready for use: see `Expectation`.
    throw : bool, optional
        Raise if the solver finds no optimum (default), or return a Fit with `Outcome.FAILED`.
    progress : callable, optional
        Called with a few words at each step.
    time_limit : float or Deadline, optional
        Seconds after which no further step of a search begins; the best model so far is completed, by least squares if
        the program in another norm is not solved by then, and `Fit.remarks` names it. That takes some time more.
        Another thread or a signal handler can end a `Deadline`.
    first_model : callable, optional
        Called once with a plain actuator, as soon as delay and sensor data are known; "record" only. It is a
        least-squares fit of few samples and was not checked: its provenance has `"provisional": True`.

    Returns
    -------
    Fit

    Raises
    ------
    RecordError
        If a record cannot be used: no loop, columns swapped, a clipped sensor, too few samples or cycles.
    IdentifyError
        If an option is impossible, or no sample determines anything of the elements.
    """
    settings = Settings(method, elements, breakaway, norm, knots, slope_floor, delay, shared_datum, drift, branch)  # type: ignore[arg-type]
    _validation.between(goal, "goal", 1e-3, 100, "a part of the stroke in %")
    deadline = time_limit if isinstance(time_limit, Deadline) else Deadline(time_limit)
    report = deadline.watched(progress or (lambda _: None))
    training, held_out = as_list(records), as_list(validate)
    if not training:
        raise IdentifyError("got no records, need one loop of voltage and displacement at least")
    counted = elements is not None or knots is not None or settings.breakaway is not None
    if structure == "auto" and (counted or method != "record"):
        structure = "paper"
    _refuse_structure(structure, settings, counted)
    _refuse_copies([*training, *held_out])
    if refine and structure == "paper":
        raise IdentifyError("refine: the paper's class is fitted as it is; leave refine out, or try structure='auto'")
    report("checking the records")
    with one_thread():
        job = _Identification(
            settings,
            [prepare(record) for record in training],
            [prepare(record) for record in held_out],
            report,
            goal,
            deadline,
            first_model,
        )
        if structure != "paper":
            fit = job.by_structure(structure, refine)
        else:
            fit = job.by_records() if method == "record" else job.by_breakpoints()
    if fit.outcome is Outcome.FAILED and throw:
        raise IdentifyError(f"{fit.outcome.value} {fit.status}. Try another norm or fewer elements")
    return fit


def _refuse_copies(records: list[Record]) -> None:
    """Refuse a record given twice: cycles held out would not be unseen, nor would be a record that is."""
    seen: dict[bytes, str] = {}
    for one in records:
        key = one.displacement.tobytes() + one.voltage.tobytes()
        if key in seen:
            raise IdentifyError(
                f"{one.name}: has the same samples as {seen[key]}; give each record once, and another one to validate"
            )
        seen[key] = one.name


def _refuse_structure(structure: object, settings: Settings, counted: bool) -> None:
    """Refuse what is no structure, and options that have no meaning beside one."""
    if structure == "paper":
        return
    if structure != "auto" and not isinstance(structure, Structure):
        raise IdentifyError(f"structure: got {structure!r}, need 'auto', 'paper' or a dehyst.model.structure.Structure")
    if settings.method != "record":
        raise IdentifyError(f"structure: method {settings.method!r} knows the paper's class only; leave one out")
    if counted:
        raise IdentifyError("structure: it has elements and knots of its own; leave elements, breakaway and knots out")


@dataclass(eq=False)
class _Identification:
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
    held_out_error: float = 0.0
    searched: Structure | None = None

    def __post_init__(self) -> None:
        self.repairs += [sentence for item in (*self.training, *self.held_out) for sentence in item.sentences]
        spans = [item.span() for item in self.training]
        self.widest = int(np.argmax([high - low for low, high in spans]))
        self.span = spans[self.widest]
        self.stroke = self.span[1] - self.span[0]

    def by_records(self) -> Fit:
        """Identify a plain actuator from every sample of every record."""
        self.report("estimating delay, datums and drifts")
        rho = self._thresholds()
        if self.settings.breakaway is None:
            self.remarks += messages.of_noise(float(rho[0]), max(item.noise for item in self.training))
        regression, found = self._fit_plain(rho)
        if not found.solved.optimal:
            return self._failed(found.solved.status)
        actuator = self._actuator(regression, found)
        self.report("simulating every record")
        if self.settings.breakaway is None and self._data(self.delay).grows():
            plain = actuator, regression, found
            actuator, regression, found = self.deadline.attempt(
                lambda: self._longer_plain(rho, *plain), plain, "the trial of longer elements"
            )
        directions = identifiability(self._on_axis(regression.datum), regression)
        outcome, remarks = messages.of_plain(directions, regression, found)
        self.remarks += remarks
        self.held_out_error = block_error(replace(self._data(self.delay), datum=regression.datum), regression)
        return self._finish(actuator, regression, outcome, found.solved.status, found.solved.gap)

    def _fit_plain(self, rho: Array) -> tuple[Regression, Coefficients]:
        """Fit plain elements of these thresholds."""
        stream = self._stream(rho, self._data(self.delay))
        regression = self._with_drifts(self._with_datums(stream.regression))
        self.report(f"solving the {self.settings.norm} program for {len(stream.source)} samples")
        self._hand_over(regression)
        found = self._by_norm(
            replace(stream, regression=regression).fit_weighted, lambda: least_squares_of_sums(regression)
        )
        return regression, found

    def _longer_plain(
        self, rho: Array, actuator: Actuator, regression: Regression, found: Coefficients
    ) -> tuple[Actuator, Regression, Coefficients]:
        """Return the plain actuator with elements beyond half the stroke, if it simulates the records better."""
        longer, more = self._fit_plain(_REACH * rho)
        other = self._actuator(longer, more) if more.solved.optimal else None
        worth = _WORTH_OF_REACH * self._whole_error(actuator, regression)
        if other is None or self._whole_error(other, longer) >= worth:
            return actuator, regression, found
        self.remarks.append(messages.LONGER_ELEMENTS)
        return other, longer, more

    def _by_norm(self, solve: Callable[[Norm], _T], quickly: Callable[[], _T]) -> _T:
        """Solve the final program in the norm that was asked for; by least squares of fewer rows without time."""
        norm = self.settings.norm
        found = self.deadline.attempt(
            lambda: solve(norm), None, f"the {norm} program of all samples (least squares of fewer instead)"
        )
        if found is not None:
            return found
        self.settings = replace(self.settings, norm="l2")
        return quickly()

    def _hand_over(self, regression: Regression) -> None:
        """Give the caller a first plain actuator, once."""
        first_model, self.first_model = self.first_model, None
        if first_model is None:
            return
        few = regression.thinned(_FIRST_ROWS)
        found = least_squares_of_sums(few)
        if found.solved.optimal:
            first_model(self._actuator(few, found).with_provenance(norm="l2", provisional=True))

    def _whole_error(self, actuator: Actuator, regression: Regression) -> float:
        """RMS error of the training records, simulated whole [m]."""
        errors, _ = self._simulated(actuator, regression, self.training)
        return float(np.sqrt(np.average([one.rms**2 for one in errors], weights=[one.samples for one in errors])))

    def by_structure(self, structure: Structure | Literal["auto"], refine: bool) -> Fit:
        """Identify an actuator of a structure that is given, or that the records support."""
        self.report("estimating delay and datums")
        data = self._data(self.delay)
        plain = self._with_datums(self._stream(self._thresholds(), data).regression)
        self._hand_over(plain)
        frame = replace(data, datum=plain.datum, denoised=True)
        if isinstance(structure, str):
            # Without loops within loops nothing that distinguishes structures can be held out.
            missing = messages.of_turns(probe_identifiability(self._on_axis(plain.datum), plain.rows, self.span))
            if missing:
                self.remarks += missing
                return self.by_records()
            frame, structure = self._chosen(self._with_delay(frame))
            if structure.plain and not frame.inertia.mass and not refine:
                self.delay = frame.inertia.delay
                return self._plainly(frame, structure)
        else:
            frame = self._with_delay(frame, structure)
        self.structure = structure
        self.report(f"solving the program for {structure.words}")
        wanted = structure
        made = self._by_norm(
            lambda norm: StructuredFit.solve(frame, wanted, norm), lambda: StructuredFit.solve_quickly(frame, wanted)
        )
        if structure.reach == 1 and made.found.solved.optimal and frame.grows():
            made = self._attempt(self._longer, made, "the trial of longer elements")
        solution = made.found.solved
        if not solution.optimal:
            return self._failed(solution.status)
        if frame.inertia.mass:
            made = self._attempt(lambda one: one.tune_dynamics(self.report), made, "the tuning of the resonance")
        refined = self._refined(made) if refine else made.actuator
        self.delay = refined.delay
        actuator = self._named(refined)
        self.report("simulating every record")
        outcome = Outcome.WIDER if actuator.wide else Outcome.IDENTIFIED
        self.held_out_error = block_error(made.frame, made.regression)
        return self._finish(actuator, made.regression, outcome, solution.status, solution.gap)

    def _chosen(self, still: TrainingData) -> tuple[TrainingData, Structure]:
        """Return the records with inertia if they have it, and the structure that they support."""
        self.report("looking for inertia")
        frame = self.deadline.attempt(lambda: still.with_inertia(self.deadline), still, "the search for inertia")
        structure, self.trials, remarks = frame.chosen(Structure(), self.report, deadline=self.deadline)
        self.remarks += remarks
        fixed: tuple[str, ...] = ()
        while dropped := self._unsupported(frame, still, structure):
            self.remarks.append(messages.of_dropped(dropped.part, dropped.without, dropped.within, self.stroke))
            frame = still if dropped.part == "inertia" else frame
            if dropped.part == "creep":
                fixed, still, frame = ("creep",), replace(still, creepless=True), replace(frame, creepless=True)
            again = self._chosen_again(frame, fixed, dropped.part)
            structure = again or simplest(self.trials, creep="creep" not in fixed) or Structure()
        self.searched = structure
        return frame, structure

    def _chosen_again(self, frame: TrainingData, fixed: tuple[str, ...], part: str) -> Structure | None:
        """Return the structure that the records support without a part; None if no time is left."""
        again = self.deadline.attempt(
            lambda: frame.chosen(Structure(), self.report, fixed, self.deadline),
            None,
            f"the search for a structure without {part}",
        )
        self.trials += () if again is None else again[1]
        return None if again is None else again[0]

    def _unsupported(self, frame: TrainingData, still: TrainingData, structure: Structure) -> Dropped | None:
        """Return a part that does not predict; without time plain elements stand in for the rest of the structure."""
        if not (frame.inertia.mass or structure.creep):
            return None
        judged = self.deadline.attempt(
            lambda: (unsupported(frame, still, structure, self.report),),
            None,
            "the prediction of time that was not trained on (plain elements stood in for the rest of the structure)",
        )
        return judged[0] if judged else unsupported(frame, still, Structure(creep=structure.creep), self.report)

    def _attempt(self, step: Callable[[StructuredFit], StructuredFit], made: StructuredFit, name: str) -> StructuredFit:
        """Return what a step makes of a fit, or the fit if no time is left."""
        return self.deadline.attempt(lambda: step(made), made, name)

    def _longer(self, made: StructuredFit) -> StructuredFit:
        """Return the fit with elements beyond half the stroke, if it simulates the records better."""
        longer = StructuredFit.solve(made.frame, replace(made.structure, reach=_REACH), self.settings.norm)
        if not longer.found.solved.optimal:
            return made
        before, after = (self._whole_error(one.actuator, one.regression) for one in (made, longer))
        if after >= _WORTH_OF_REACH * before:
            return made
        self.structure = longer.structure
        self.remarks.append(messages.LONGER_ELEMENTS)
        return longer

    def _with_delay(self, frame: TrainingData, structure: Structure | None = None) -> TrainingData:
        """Only a delay that was not given can be mistaken."""
        return frame.with_checked_delay(structure) if self.settings.delay is None else frame

    def _on_axis(self, datum: Array) -> list[Record]:
        """All pieces, displacements on the model's axis."""
        return [
            replace(piece, displacement=piece.displacement + datum[q])
            for q, item in enumerate(self.training)
            for piece in item.pieces
        ]

    def _refined(self, made: StructuredFit) -> Actuator:
        found = self.deadline.attempt(lambda: output_error.refine(made, self.report), None, "the refinement")
        if found is None:
            return made.actuator
        what = "kept" if found.kept else "not better, and left out"
        self.remarks.append(
            f"Refined by simulation: RMS error of cycles held out {found.after * 1e9:.4g} nm, without "
            f"{found.before * 1e9:.4g} nm; {what}."
        )
        return found.actuator

    def _plainly(self, frame: TrainingData, structure: Structure) -> Fit:
        """Identify a plain actuator on a grid of thresholds that was chosen."""
        rho = None if structure.spacing == 1 else structure.grid(self.span, frame.voltages, frame.times).breakaway
        elements = structure.elements if rho is None else None
        self.settings = replace(self.settings, elements=elements, breakaway=rho, knots=structure.knots)
        return self.by_records()

    def by_breakpoints(self) -> Fit:
        """Identify by the paper's own method, or by Remark 2's closed form."""
        settings = self.settings
        self.report("reading break points")
        records = [item.record.delayed(self.delay) if self.delay else item.record for item in self.training]
        loops = paper_methods.loops_of(records, settings.count)
        if settings.method == "antisymmetric":
            found = paper_methods.closed_form(loops, settings.count, settings.branch)
        else:
            found = paper_methods.linear_program(loops, settings.count, settings.slope_floor)
        if found.actuator is None:
            return self._failed(found.status)
        self.remarks.extend(found.remarks)
        actuator = replace(found.actuator, delay=self.delay, limits=self._limits(), provenance=self._provenance())
        regression = self._with_drifts(self._stream(actuator.slip.breakaway, self._data(self.delay)).regression)
        return self._finish(actuator, regression, found.outcome, found.status, found.gap)

    def _thresholds(self) -> Array:
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
        sample = min(item.record.sample_time for item in self.training)
        # Too few elements or knots would round the turning points as a delay does, and creep would open the loop.
        grid = self.stroke / 60 * np.arange(1.0, 31.0)
        drifting = tuple(self._can_drift())

        data = self._data_of(0.0)
        few = [item.coarser(_SEARCH_CYCLE, _SEARCH_SAMPLES) for item in self.training]
        data = replace(data, training=few, floor=data.floor / self.settings.slope_floor * 0.01)

        def build(delay: float) -> Regression:
            late = replace(data, inertia=SensedDynamics(delay, 0.0, 0.0))
            return replace(self._stream(grid, late, knots=31).regression, drifting=drifting)

        return nuisances.find_delay(build, longest, sample)

    def _can_drift(self) -> list[int]:
        return [q for q, item in enumerate(self.training) if item.can_drift and self.settings.drift]

    def _data(self, delay: float) -> TrainingData:
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
            self.training,
            SensedDynamics(delay, 0.0, 0.0),
            self.span,
            self._limits(),
            mean_slope * self.settings.slope_floor,
            np.zeros(len(self.training)),
            self.widest,
            tuple(self._can_drift()),
            denoised=False,
        )

    def _stream(self, rho: Array, data: TrainingData, knots: int | None = None) -> Stream:
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

    def _with_datums(self, regression: Regression) -> Regression:
        others = [q for q in range(len(self.training)) if q != self.widest and not self.settings.shared_datum]
        return nuisances.with_datums(regression, others, self.stroke)

    def _with_drifts(self, regression: Regression) -> Regression:
        return replace(regression, drifting=nuisances.find_drifts(regression, self._can_drift()))

    def _actuator(self, regression: Regression, found: Coefficients) -> Actuator:
        """Return the actuator of coefficients, with its limits, name and provenance."""
        return self._named(self._data_of(self.delay).actuator_of(regression, found))

    def _named(self, actuator: Actuator) -> Actuator:
        name = self.training[self.widest].record.name
        return replace(actuator, limits=self._limits(), name=name, provenance=self._provenance())

    def _limits(self) -> tuple[float, float]:
        """Voltages that were used: what glitches show, or what a gap cuts off, was not."""
        ranges = np.array([piece.voltage_range for item in self.training for piece in item.pieces])
        return float(ranges[:, 0].min()), float(ranges[:, 1].max())

    def _provenance(self) -> dict[str, Any]:
        return {
            "program": f"dehyst {__version__}",
            **self.settings.as_dict(),
            **({} if self.structure is None else {"structure": self.structure.as_dict()}),
            "records": [item.source() for item in self.training],
            "validation": [item.source() for item in self.held_out],
        }

    def _failed(self, status: str) -> Fit:
        return Fit(
            None,
            Outcome.FAILED,
            (),
            tuple(self.repairs),
            tuple(self.remarks),
            (),
            status,
            float("nan"),
            self._provenance(),
        )

    def _simulated(
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

    def _best_words(self, actuator: Actuator) -> str:
        """Describe the structure of the result and, if it was tried, its held-out error."""
        structure = self.structure or self.searched
        if structure is None:
            return f"{actuator.slip.breakaway.size} elements"
        errors = [trial.held_out for trial in self.trials if trial.structure == replace(structure, reach=1.0)]
        if not errors:
            return structure.words
        return f"{structure.words}, which miss held-out cycles by {100 * errors[-1] / self.stroke:.2g} % of the range"

    def _finish(self, actuator: Actuator, regression: Regression, outcome: Outcome, status: str, gap: float) -> Fit:
        records = (*self.training, *self.held_out)
        errors, traces = self._simulated(actuator, regression, records)
        missed = max(error.largest for error in errors[: len(self.training)])
        actuator = replace(actuator, provenance={**actuator.provenance, "largest_error_m": missed})
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
        self.remarks[:0] = self.deadline.remarks(self._best_words(actuator))
        self.remarks += messages.of_rare_voltages(self.training, self._limits())
        self.remarks += messages.of_held_out(self.held_out, self._limits(), errors)
        sample = self.training[self.widest].record.sample_time
        repaired = messages.repaired(errors, self.delay, sample, given=self.settings.delay is not None)
        options = {**self._provenance(), "delay_s": self.delay, "stroke_m": self.stroke}
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
            expectation(outcome, errors, checked, self.held_out_error, max(item.noise for item in records), self.goal),
            tuple(remaining_error(trace) for trace in traces),
        )
