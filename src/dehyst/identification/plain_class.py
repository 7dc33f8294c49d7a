"""Plain actuators: from every sample of every record, or by the methods of the paper."""

from __future__ import annotations

from dataclasses import replace

from dehyst._types import Array
from dehyst.identification import paper_methods
from dehyst.identification.diagnostics import messages
from dehyst.identification.diagnostics.identifiability import identifiability
from dehyst.identification.regression import nuisances
from dehyst.identification.regression.coefficients import Coefficients
from dehyst.identification.regression.fold_sums import least_squares_of_sums
from dehyst.identification.regression.regression import Regression
from dehyst.identification.run import REACH, WORTH_OF_REACH, Run
from dehyst.model import Actuator, Fit


def identify_plain(run: Run) -> Fit:
    """Identify a plain actuator from every sample of every record."""
    run.report("estimating delay, datums and drifts")
    rho = run.thresholds()
    if run.settings.breakaway is None:
        run.remarks += messages.of_noise(float(rho[0]), max(item.noise for item in run.training))
    regression, found = _fit_plain(run, rho)
    if not found.solved.optimal:
        return run.failed(found.solved.status)
    actuator = run.actuator(regression, found)
    run.report("simulating every record")
    if run.settings.breakaway is None and run.data(run.delay).grows():
        plain = actuator, regression, found
        actuator, regression, found = run.deadline.attempt(
            lambda: _longer_plain(run, rho, *plain), plain, "the trial of longer elements"
        )
    directions = identifiability(run.on_axis(regression.datum), regression)
    outcome, remarks = messages.of_plain(directions, regression, found)
    run.remarks += remarks
    run.look_beyond(replace(run.data(run.delay), datum=regression.datum), regression, actuator)
    return run.finish(actuator, regression, outcome, found.solved.status, found.solved.gap)


def _fit_plain(run: Run, rho: Array) -> tuple[Regression, Coefficients]:
    """Fit plain elements of these thresholds."""
    stream = run.stream(rho, run.data(run.delay))
    regression = _with_drifts(run, run.with_datums(stream.regression))
    run.report(f"solving the {run.settings.norm} program for {len(stream.source)} samples")
    run.hand_over(regression)
    found = run.by_norm(replace(stream, regression=regression).fit_weighted, lambda: least_squares_of_sums(regression))
    return regression, found


def _longer_plain(
    run: Run, rho: Array, actuator: Actuator, regression: Regression, found: Coefficients
) -> tuple[Actuator, Regression, Coefficients]:
    """Return the plain actuator with elements beyond half the stroke, if it simulates the records better."""
    longer, more = _fit_plain(run, REACH * rho)
    other = run.actuator(longer, more) if more.solved.optimal else None
    worth = WORTH_OF_REACH * run.whole_error(actuator, regression)
    if other is None or run.whole_error(other, longer) >= worth:
        return actuator, regression, found
    run.remarks.append(messages.LONGER_ELEMENTS)
    return other, longer, more


def identify_at_breakpoints(run: Run) -> Fit:
    """Identify by the paper's own method, or by Remark 2's closed form."""
    settings = run.settings
    run.report("reading break points")
    records = [item.record.delayed(run.delay) if run.delay else item.record for item in run.training]
    loops = paper_methods.loops_of(records, settings.count)
    if settings.method == "antisymmetric":
        found = paper_methods.closed_form(loops, settings.count, settings.branch)
    else:
        found = paper_methods.linear_program(loops, settings.count, settings.slope_floor)
    if found.actuator is None:
        return run.failed(found.status)
    run.remarks.extend(found.remarks)
    actuator = replace(found.actuator, delay=run.delay, limits=run.limits(), provenance=run.provenance())
    regression = _with_drifts(run, run.stream(actuator.slip.breakaway, run.data(run.delay)).regression)
    return run.finish(actuator, regression, found.outcome, found.status, found.gap)


def _with_drifts(run: Run, regression: Regression) -> Regression:
    return replace(regression, drifting=nuisances.find_drifts(regression, run.can_drift()))
