"""Identification of an actuator from records of voltage and displacement: the function and its steps in order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

from numpy.typing import ArrayLike

from dehyst import _validation
from dehyst._errors import IdentifyError
from dehyst._threads import one_thread
from dehyst._types import Progress
from dehyst.identification.creep_search import CreepSearch
from dehyst.identification.diagnostics import messages
from dehyst.identification.diagnostics.identifiability import identifiability, probed
from dehyst.identification.fit import Fit
from dehyst.identification.held_out import Dropped, drift_and_creep, followed_at_once, held_out_holds, unsupported
from dehyst.identification.preprocessing.denoising import left_of
from dehyst.identification.preprocessing.preparation import ENOUGH, Prepared, as_list, prepare
from dehyst.identification.regression.fold_sums import least_squares_of_sums
from dehyst.identification.rules import RULES
from dehyst.identification.run import IdentificationRun
from dehyst.identification.settings import Deadline, Settings
from dehyst.identification.solvers.program import Norm
from dehyst.identification.structure import Structure
from dehyst.identification.structure_selection import simplest
from dehyst.identification.structured_fit import StructuredFit
from dehyst.identification.temperature import TemperatureEffect, temperature_effect
from dehyst.identification.training_data import TrainingData
from dehyst.identification.validation import MOST_ROWS
from dehyst.model import Actuator, Outcome
from dehyst.records import Record, thinned

# Turns of a model at the reference temperature and the gain by it, and the change of the gain that ends them.
_TURNS, _SAME = 8, 0.002


def identify(
    records: Record | Sequence[Record],
    *,
    validate: Record | Sequence[Record] = (),
    elements: int | None = None,
    breakaway: ArrayLike | None = None,
    norm: Norm = "l1",
    knots: int | None = None,
    slope_floor: float = 0.2,
    delay: float | None = None,
    sensor_lag: float | None = None,
    shared_datum: bool = False,
    drift: bool = True,
    structure: Structure | Literal["auto", "maxwell_slip"] = "auto",
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
        Training records with at least one loop in total; minor loops improve the prediction of other motions.
    validate : Record or sequence of Record, optional
        Records that are only simulated. Each gets its own constant (and datum and drift), as training records do.
    elements : int, optional
        Number N of slip elements on the paper's uniform grid over the widest loop, rho_i = i range / (2 N);
        default 20.
    breakaway : (N,) array_like, optional
        Breakaway elongations [m] instead of the grid.
    norm : {"l1", "l2"}, optional
        Norm of the weighted residuals.
    knots : int, optional
        Number of knots of the spring; default: N + 1, at most 41.
    slope_floor : float, optional
        Least slope of the spring as a fraction of the mean slope of the widest loop (Assumption I with a margin).
    delay : float, optional
        Time by which the displacement lags the voltage [s]; default: estimated from the training records.
    sensor_lag : float, optional
        Time constant of the sensor's own filter [s], a low-pass of first order, 0 if it has none; default: unknown.
        Any other lag counts as the actuator's, because a record does not show whether the sensor or the actuator lags.
    shared_datum : bool, optional
        State that the sensor kept its zero in all records; default: the datum of each record is searched for.
    drift : bool, optional
        Whether a record may have a drift that is logarithmic in the time since its start, which is then removed.
    structure : {"auto", "maxwell_slip"} or Structure, optional
        Parts of the model. "auto": cross-validation selects them (more elements, a transformer, graded elements, creep,
        smooth elements, inertia). "maxwell_slip": slip elements and a spring, as in Yeh's paper. Or a given structure.
        Default: "auto", but "maxwell_slip" if one of its own options is given (elements, breakaway, knots).
    goal : float, optional
        Largest error [% of the stroke] with which the model is ready for use: see `Expectation`.
    throw : bool, optional
        Raise an error if the solver finds no optimum (default); otherwise return a Fit with `Outcome.FAILED`.
    progress : callable, optional
        Called with a short text at each step.
    time_limit : float or Deadline, optional
        Time [s] after which no further step of a search begins. Then the best model so far is completed, by least
        squares if the program in another norm is not solved yet, and `Fit.remarks` names it; this takes some more time.
        Another thread or a signal handler can end a `Deadline`.
    first_model : callable, optional
        Called once with a Maxwell-slip actuator, as soon as delay and sensor data are known. It is a least-squares fit
        of few samples and was not checked: its `identification` is `provisional`.

    Returns
    -------
    Fit

    Raises
    ------
    RecordError
        If a record cannot be used: no loop, columns swapped, a clipped sensor, too few samples or cycles.
    IdentifyError
        If an option is impossible, or no sample contains information on the elements.
    """
    settings = Settings(
        elements,
        breakaway,  # type: ignore[arg-type]
        norm,
        knots,
        slope_floor,
        delay,
        sensor_lag,
        shared_datum,
        drift,
    )
    _validation.between(goal, "goal", 1e-3, 100, "a part of the stroke in %")
    deadline = time_limit if isinstance(time_limit, Deadline) else Deadline(time_limit)
    report = deadline.watched(progress or (lambda _: None))
    training, held_out = ([thinned(record) for record in as_list(given)] for given in (records, validate))
    if not training:
        raise IdentifyError("got no records, need one loop of voltage and displacement at least")
    own = settings.of_maxwell_slip if structure == "auto" else []
    structure = _checked_structure(structure, settings)
    _refuse_copies([*training, *held_out])
    (effect, left_out), measured = temperature_effect(training), training
    if effect is not None:
        effect = _converged(effect, training, settings)
        training = [effect.at_reference(one, datum) for one, datum in zip(training, effect.datums, strict=True)]
        held_out = [effect.at_reference(one) for one in held_out]
    report("checking the records")
    # Other structures than Maxwell-slip take means of neighbouring samples; of long records Maxwell-slip does, too.
    most = sum(map(len, training)) / (MOST_ROWS if structure == "maxwell_slip" else ENOUGH)

    def prepared(record: Record, ringing: bool) -> Prepared:
        found = prepare(record, ringing=ringing).with_block(most)
        return found.reduced.without_lag(sensor_lag) if sensor_lag else found

    def run_of(*, ringing: bool) -> IdentificationRun:
        mine, others = ([prepared(one, ringing) for one in part] for part in (training, held_out))
        return IdentificationRun(settings, mine, others, report, goal, deadline, first_model, ringing=ringing)

    with one_thread():
        run = run_of(ringing=False)
        if any(item.record.set_aside for item in run.training):
            # Whether the hysteresis sees what rings, the samples after it show.
            run = min(run, run_of(ringing=True), key=IdentificationRun.maxwell_slip_error)
        if own:
            run.remarks.append(messages.NOT_SEARCHED.format(options=" and ".join(own)))
        fit = _identify_structure(run, structure)
    if fit.outcome is Outcome.FAILED and throw:
        raise IdentifyError(f"{fit.outcome.value} {fit.status}. Try another norm or fewer elements")
    if effect is not None and isinstance(fit.actuator, Actuator):
        effect = effect.refined(measured, fit.traces)
        found = replace(fit.actuator, thermal=effect.of(fit.actuator))
        fit = replace(fit, actuator=found, remarks=(effect.sentence, *fit.remarks))
    if left_out:
        if fit.expectation is None:
            fit = replace(fit, remarks=(f"{left_out[0].upper()}{left_out[1:]}.", *fit.remarks))
        else:
            fit = replace(fit, expectation=replace(fit.expectation, reasons=(*fit.expectation.reasons, left_out)))
    return fit


def _converged(effect: TemperatureEffect, records: list[Record], settings: Settings) -> TemperatureEffect:
    """Return the effect of temperature by Maxwell-slip models of records at the reference, in turn with the gain."""
    for _ in range(_TURNS):
        at_once = [replace(effect.at_reference(*pair), others=()) for pair in zip(records, effect.datums, strict=True)]
        fit = identify(at_once, structure="maxwell_slip", norm="l2", drift=settings.drift, throw=False)
        if not isinstance(fit.actuator, Actuator):
            break
        before, effect = effect, effect.refined(records, fit.traces)
        if abs(effect.gain - before.gain) < _SAME * abs(effect.gain):
            break
    return effect


def _refuse_copies(records: list[Record]) -> None:
    """Reject duplicate records: their held-out cycles would not be unseen."""
    seen: dict[bytes, str] = {}
    for one in records:
        key = one.displacement.tobytes() + one.voltage.tobytes()
        if key in seen:
            raise IdentifyError(
                f"{one.name}: has the same samples as {seen[key]}; give each record once, and another one to validate"
            )
        seen[key] = one.name


def _checked_structure(
    structure: Structure | Literal["auto", "maxwell_slip"], settings: Settings
) -> Structure | Literal["auto", "maxwell_slip"]:
    """Return the structure, with options of Maxwell-slip only "maxwell_slip" for "auto"; reject options in conflict."""
    own = settings.of_maxwell_slip
    if structure == "auto" and own:
        structure = "maxwell_slip"
    elif structure not in ("auto", "maxwell_slip") and not isinstance(structure, Structure):
        raise IdentifyError(
            argument="structure", got=repr(structure), need="'auto', 'maxwell_slip' or a dehyst.Structure"
        )
    elif own and structure != "maxwell_slip":
        raise IdentifyError("structure: it has elements and knots of its own; leave elements, breakaway and knots out")
    return structure


def _identify_structure(run: IdentificationRun, structure: Structure | Literal["auto", "maxwell_slip"]) -> Fit:
    """Identify an actuator of a structure that is given, or that the records support."""
    run.report("estimating delay and datums")
    data = run.data(run.delay)
    if structure == "maxwell_slip":
        return _maxwell_slip(run, data)
    plain = run.with_datums(run.regression(run.thresholds(), data))
    run.publish_first_model(plain)
    frame = replace(data, lagging=run.lagging, datum=plain.datum, denoised=True)
    if isinstance(structure, str):
        # Without loops within loops nothing that distinguishes structures can be held out.
        missing = messages.of_turns(probed(run.on_axis(plain.datum), run.span), run.drive)
        if missing:
            run.remarks += missing
            return _maxwell_slip(run, data)
        if frame.drifting:
            untried = True, False
            predicts, creep_too = run.deadline.attempt(lambda: drift_and_creep(frame), untried, "the trial of creep")
            if not predicts:
                frame = replace(frame, can_drift=())
            elif creep_too:
                run.remarks.append(messages.DRIFT_OR_CREEP.format(hold=messages.hold(run.drive)))
        frame = run.deadline.attempt(partial(_before_creep, run, frame), frame, "the search for creep in displacement")
        frame, structure = _chosen(run, frame)
        moves = frame.lagging.dynamics is not None or frame.lagging.lag
        if structure.is_maxwell_slip and not (moves or run.creep):
            rho = None if structure.spacing == 1 else structure.grid(run.span, frame.voltages, frame.times).breakaway
            elements = structure.elements if rho is None else None
            run.settings = replace(run.settings, elements=elements, breakaway=rho, knots=structure.knots)
            return _maxwell_slip(run, run.data(run.delay))
    return _structured(run, frame, structure)


def _before_creep(run: IdentificationRun, frame: TrainingData) -> TrainingData:
    """Return the records before their creep in displacement, if held-out holds have that form of creep."""
    search = None if frame.creepless else CreepSearch.of(frame)
    if search is None:
        return frame
    run.report("looking for creep in displacement")
    part = search.find()
    if part is None or not search.flattens(part) or frame.followed_at_once(part.gains, part.time_constants):
        return frame
    run.report("predicting holds that were not trained on")
    run.holds = held_out_holds(frame, search)
    if run.holds is None or not run.holds.in_displacement:
        return frame
    run.creep = part
    return frame.without_creep(part)


def _structured(run: IdentificationRun, frame: TrainingData, structure: Structure) -> Fit:
    """Solve the convex program of a structure, on means of samples."""
    run.structure = structure

    def solve(reach: float = 1.0) -> StructuredFit:
        wanted = replace(structure, reach=max(reach, structure.reach))
        run.report(f"solving the program for {wanted.words}")
        return run.solve_with_fallback(
            lambda norm: StructuredFit.solve(frame, wanted, norm), lambda: StructuredFit.solve_quickly(frame, wanted)
        )

    return _completed(
        run,
        solve,
        lambda made: Outcome.WIDER if made.actuator.wide else Outcome.IDENTIFIED,
        longer=structure.reach == 1 and frame.grows(),
    )


def _maxwell_slip(run: IdentificationRun, data: TrainingData) -> Fit:
    """Solve the convex program of Maxwell-slip: every sample as it is, any grid, no regularisation."""
    rho, given = run.thresholds(), run.settings.breakaway is not None
    noise = left_of(max(item.noise for item in run.training), run.stroke)
    if not given and rho[0] < RULES.first_element_noise * noise:
        first, least = float(rho[0]), RULES.first_element_noise
        run.remarks.append(messages.NOISE.format(first=first * 1e6, ratio=first / noise, least=least))

    def solve(reach: float = 1.0) -> StructuredFit:
        regression = run.with_drifts(run.with_datums(run.regression(reach * rho, data)))
        run.report(f"solving the {run.settings.norm} program for {len(regression)} samples")
        run.publish_first_model(regression)
        found = run.solve_with_fallback(regression.fit_weighted, lambda: least_squares_of_sums(regression))
        structure = Structure(elements=rho.size, knots=regression.grid.knots.size, smoothing=0.0, reach=reach)
        frame = replace(data, datum=regression.datum)
        return StructuredFit(frame, structure, run.settings.norm, regression, found)

    def judge(made: StructuredFit) -> Outcome:
        directions = identifiability(run.on_axis(made.regression.datum), made.regression.grid)
        outcome, remarks = messages.of_plain(directions, made.regression, made.found)
        run.remarks += remarks
        return outcome

    return _completed(run, solve, judge, longer=not given and data.grows())


def _completed(
    run: IdentificationRun,
    solve: Callable[..., StructuredFit],
    judge: Callable[[StructuredFit], Outcome],
    *,
    longer: bool,
) -> Fit:
    """Solve a program, tune what is not convex, and judge the actuator.

    `solve`: longest threshold in half strokes -> solution. `longer`: whether thresholds beyond 1 are tried.
    """
    made = solve()
    solution = made.found.solved
    if not solution.optimal:
        return run.failed(solution.status)
    if longer:
        made = run.deadline.attempt(partial(_longer, run, solve, made), made, "the trial of longer elements")
    if made.frame.lagging.dynamics is not None:
        made = run.deadline.attempt(partial(made.tune_dynamics, run.report), made, "the tuning of the resonance")
    run.delay = made.actuator.delay + made.actuator.lag
    actuator = run.named(made.actuator)
    run.report("simulating every record")
    outcome, solution = judge(made), made.found.solved
    run.estimate_heldout_errors(made.frame, made.regression, made.actuator)
    return run.finish(actuator, made.regression, outcome, solution.status, solution.gap)


def _longer(run: IdentificationRun, solve: Callable[..., StructuredFit], made: StructuredFit) -> StructuredFit:
    """Return the fit with thresholds beyond half the stroke, if it simulates the records better."""
    longer = solve(RULES.longer_reach)
    if not longer.found.solved.optimal:
        return made
    before, after = (run.whole_error(one.actuator, one.regression) for one in (made, longer))
    if after >= RULES.longer_gain * before:
        return made
    if run.structure is not None:
        run.structure = longer.structure
    run.remarks.append(messages.LONGER_ELEMENTS)
    return longer


def _chosen(run: IdentificationRun, still: TrainingData) -> tuple[TrainingData, Structure]:
    """Return the records with inertia if they have it, and the structure that they support."""
    run.report("looking for inertia")
    frame = run.deadline.attempt(lambda: still.with_inertia(run.deadline), still, "the search for inertia")
    fixed: tuple[str, ...] = ("creep",) if run.creep else ()
    structure, run.trials = run.search(frame, Structure(), fixed)
    if (followed := followed_at_once(frame, structure)) and frame.lagging.dynamics is None:
        run.remarks.append(messages.FALSE_CREEP.format(percent=100 * followed))
        found = run.lagging if run.settings.delay is not None else run.lag_of(replace(run.data(0.0), creepless=True))
        still = frame = replace(still, creepless=True, lagging=found)
        structure = _chosen_again(run, frame, replace(structure, creep=0), ("creep",), "creep") or Structure()
    frame = run.deadline.attempt(partial(_tuned, run, frame, structure), frame, "the tuning of the resonance")
    while dropped := _unsupported(run, frame, still, structure):
        run.remarks.append(messages.of_dropped(dropped.part, dropped.without, dropped.within, run.stroke, run.drive))
        frame = still if dropped.part == "inertia" else frame
        if dropped.part == "creep":
            fixed, still, frame = ("creep",), replace(still, creepless=True), replace(frame, creepless=True)
        start = replace(structure, creep=0) if dropped.part == "creep" else structure
        again = _chosen_again(run, frame, start, fixed, dropped.part)
        structure = again or simplest(run.trials, creep="creep" not in fixed) or Structure()
    run.searched = structure
    return frame, structure


def _tuned(run: IdentificationRun, frame: TrainingData, structure: Structure) -> TrainingData:
    """Return the records with their resonance tuned behind a structure: a coarse one hides what other parts predict."""
    if frame.lagging.dynamics is None:
        return frame
    return StructuredFit.solve_quickly(frame, structure).tune_dynamics(run.report).frame


def _chosen_again(
    run: IdentificationRun, frame: TrainingData, start: Structure, fixed: tuple[str, ...], part: str
) -> Structure | None:
    """Return the structure that the records support without a part, from a structure nearby; None without time."""
    again = run.deadline.attempt(
        lambda: run.search(frame, start, fixed), None, f"the search for a structure without {part}"
    )
    if again is None:
        return None
    run.trials += again[1]
    # Without that part, another part may no longer improve the fit enough for its parameters.
    return simplest(again[1] if part == "inertia" else run.trials, creep="creep" not in fixed) or again[0]


def _unsupported(
    run: IdentificationRun, frame: TrainingData, still: TrainingData, structure: Structure
) -> Dropped | None:
    """Return a part that does not predict; without time Maxwell-slip elements stand in for the other parts."""
    if frame.lagging.dynamics is None and not structure.creep:
        return None
    judged = run.deadline.attempt(
        lambda: (unsupported(frame, still, structure, run.report),),
        None,
        "the prediction of time that was not trained on (plain elements stood in for the rest of the structure)",
    )
    return judged[0] if judged else unsupported(frame, still, Structure(creep=structure.creep), run.report)
