"""Actuators of the wider class: the structure that the records support, or one that is given."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

from dehyst.identification import output_error
from dehyst.identification.diagnostics import messages
from dehyst.identification.diagnostics.identifiability import probe_identifiability
from dehyst.identification.extrapolation import Dropped, unsupported
from dehyst.identification.plain_class import identify_plain
from dehyst.identification.run import REACH, WORTH_OF_REACH, Run
from dehyst.identification.structure_selection import simplest
from dehyst.identification.structured_fit import StructuredFit
from dehyst.identification.training_data import TrainingData
from dehyst.model import Actuator, Fit, Outcome, Structure


def identify_structure(run: Run, structure: Structure | Literal["auto"], refine: bool) -> Fit:
    """Identify an actuator of a structure that is given, or that the records support."""
    run.report("estimating delay and datums")
    data = run.data(run.delay)
    plain = run.with_datums(run.stream(run.thresholds(), data).regression)
    run.hand_over(plain)
    frame = replace(data, datum=plain.datum, denoised=True)
    if isinstance(structure, str):
        # Without loops within loops nothing that distinguishes structures can be held out.
        missing = messages.of_turns(probe_identifiability(run.on_axis(plain.datum), plain.rows, run.span))
        if missing:
            run.remarks += missing
            return identify_plain(run)
        frame, structure = _chosen(run, _with_delay(run, frame))
        if structure.plain and not frame.inertia.mass and not refine:
            run.delay = frame.inertia.delay
            return _plainly(run, frame, structure)
    else:
        frame = _with_delay(run, frame, structure)
    run.structure = structure
    run.report(f"solving the program for {structure.words}")
    wanted = structure
    made = run.by_norm(
        lambda norm: StructuredFit.solve(frame, wanted, norm), lambda: StructuredFit.solve_quickly(frame, wanted)
    )
    if structure.reach == 1 and made.found.solved.optimal and frame.grows():
        made = _attempt(run, lambda one: _longer(run, one), made, "the trial of longer elements")
    solution = made.found.solved
    if not solution.optimal:
        return run.failed(solution.status)
    if frame.inertia.mass:
        made = _attempt(run, lambda one: one.tune_dynamics(run.report), made, "the tuning of the resonance")
    refined = _refined(run, made) if refine else made.actuator
    run.delay = refined.delay
    actuator = run.named(refined)
    run.report("simulating every record")
    outcome = Outcome.WIDER if actuator.wide else Outcome.IDENTIFIED
    run.look_beyond(made.frame, made.regression, refined)
    return run.finish(actuator, made.regression, outcome, solution.status, solution.gap)


def _chosen(run: Run, still: TrainingData) -> tuple[TrainingData, Structure]:
    """Return the records with inertia if they have it, and the structure that they support."""
    run.report("looking for inertia")
    frame = run.deadline.attempt(lambda: still.with_inertia(run.deadline), still, "the search for inertia")
    structure, run.trials, remarks = frame.chosen(Structure(), run.report, deadline=run.deadline)
    run.remarks += remarks
    fixed: tuple[str, ...] = ()
    while dropped := _unsupported(run, frame, still, structure):
        run.remarks.append(messages.of_dropped(dropped.part, dropped.without, dropped.within, run.stroke))
        frame = still if dropped.part == "inertia" else frame
        if dropped.part == "creep":
            fixed, still, frame = ("creep",), replace(still, creepless=True), replace(frame, creepless=True)
        start = replace(structure, creep=0) if dropped.part == "creep" else structure
        again = _chosen_again(run, frame, start, fixed, dropped.part)
        structure = again or simplest(run.trials, creep="creep" not in fixed) or Structure()
    run.searched = structure
    return frame, structure


def _chosen_again(
    run: Run, frame: TrainingData, start: Structure, fixed: tuple[str, ...], part: str
) -> Structure | None:
    """Return the structure that the records support without a part, from a structure nearby; None without time."""
    again = run.deadline.attempt(
        lambda: frame.chosen(start, run.report, fixed, run.deadline),
        None,
        f"the search for a structure without {part}",
    )
    if again is None:
        return None
    run.trials += again[1]
    # With a part less, others may no longer be worth their parameters.
    return simplest(again[1] if part == "inertia" else run.trials, creep="creep" not in fixed) or again[0]


def _unsupported(run: Run, frame: TrainingData, still: TrainingData, structure: Structure) -> Dropped | None:
    """Return a part that does not predict; without time plain elements stand in for the rest of the structure."""
    if not (frame.inertia.mass or structure.creep):
        return None
    judged = run.deadline.attempt(
        lambda: (unsupported(frame, still, structure, run.report),),
        None,
        "the prediction of time that was not trained on (plain elements stood in for the rest of the structure)",
    )
    return judged[0] if judged else unsupported(frame, still, Structure(creep=structure.creep), run.report)


def _attempt(run: Run, step: Callable[[StructuredFit], StructuredFit], made: StructuredFit, name: str) -> StructuredFit:
    """Return what a step makes of a fit, or the fit if no time is left."""
    return run.deadline.attempt(lambda: step(made), made, name)


def _longer(run: Run, made: StructuredFit) -> StructuredFit:
    """Return the fit with elements beyond half the stroke, if it simulates the records better."""
    longer = StructuredFit.solve(made.frame, replace(made.structure, reach=REACH), run.settings.norm)
    if not longer.found.solved.optimal:
        return made
    before, after = (run.whole_error(one.actuator, one.regression) for one in (made, longer))
    if after >= WORTH_OF_REACH * before:
        return made
    run.structure = longer.structure
    run.remarks.append(messages.LONGER_ELEMENTS)
    return longer


def _with_delay(run: Run, frame: TrainingData, structure: Structure | None = None) -> TrainingData:
    """Only a delay that was not given can be mistaken."""
    return frame.with_checked_delay(structure) if run.settings.delay is None else frame


def _refined(run: Run, made: StructuredFit) -> Actuator:
    found = run.deadline.attempt(lambda: output_error.refine(made, run.report), None, "the refinement")
    if found is None:
        return made.actuator
    what = "kept" if found.kept else "not better, and left out"
    run.remarks.append(
        f"Refined by simulation: RMS error of cycles held out {found.after * 1e9:.4g} nm, without "
        f"{found.before * 1e9:.4g} nm; {what}."
    )
    return found.actuator


def _plainly(run: Run, frame: TrainingData, structure: Structure) -> Fit:
    """Identify a plain actuator on a grid of thresholds that was chosen."""
    rho = None if structure.spacing == 1 else structure.grid(run.span, frame.voltages, frame.times).breakaway
    elements = structure.elements if rho is None else None
    run.settings = replace(run.settings, elements=elements, breakaway=rho, knots=structure.knots)
    return identify_plain(run)
