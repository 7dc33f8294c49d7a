"""Figures and numbers of a fit, as sections of the report: loops, residuals, slip elements and spring."""

from __future__ import annotations

import math

import numpy as np

from dehyst._types import Array
from dehyst.model import Actuator, Fit, GradedSlip, MaxwellSlip, Trace
from dehyst.report import plots
from dehyst.report.html import MINUS, figure, panel, table

MOST_RECORDS = 6


def _shown(fit: Fit) -> list[tuple[Trace, float]]:
    """Return the traces to draw, each with the stroke to which its percentages refer."""
    traces = [trace for trace in fit.traces if trace.time.size > 1]
    widest = max((float(np.ptp(trace.measured)) for trace in traces), default=0.0)
    stroke = fit.errors[0].stroke if fit.errors else widest
    return [(trace, stroke) for trace in traces[:MOST_RECORDS]]


def _only(fit: Fit) -> str:
    if len(fit.traces) <= MOST_RECORDS:
        return ""
    return f" The first {MOST_RECORDS} of {len(fit.traces)} records are drawn; the table above lists all."


def loops(fit: Fit) -> str:
    """Return the loops of the records, measured and simulated."""
    panels = [panel(_whose(t), plots.loop(t, name=f"loop{i}"), "Loop of") for i, (t, _) in enumerate(_shown(fit))]
    caption = (
        "Where the thin line (simulated) leaves the broad one (measured), the model is wrong; look at the turning "
        "points and at the minor loops." + _only(fit)
    )
    return figure("Loops", caption, panels)


def residuals(fit: Fit) -> str:
    """Return the residuals of the records, in time and over displacement."""
    shown = _shown(fit)
    if not shown:
        return ""
    worst = max(float(np.abs(100 * trace.residual / stroke).max()) for trace, stroke in shown)
    limit = 1.3 * worst or 1.0
    panels = []
    for i, (trace, stroke) in enumerate(shown):
        time = plots.residual_in_time(trace, stroke, limit, name=f"time{i}")
        place = plots.residual_in_displacement(trace, stroke, limit, name=f"place{i}")
        panels.append(panel(_whose(trace), time, "Residual against time of"))
        panels.append(panel(_whose(trace), place, "Residual against displacement of"))
    caption = (
        "A slow trend in time is drift or creep. A pattern in displacement, or a distance between rising and falling "
        "branches, is a limit of the model. An even band is the sensor's noise. The circle marks the largest residual; "
        "all panels share one scale." + _only(fit)
    )
    if any(trace.time.size > plots.MOST_BRANCH_POINTS for trace, _ in shown):
        caption += f" Against displacement, {plots.MOST_BRANCH_POINTS} samples of a longer record are drawn."
    return figure("Residuals: measured minus simulated", caption, panels)


def slip_and_spring(actuator: Actuator) -> str:
    """Return figures of the slip elements and of the spring."""
    slip = panel(("Slip elements", ""), plots.slip_elements(_plain_slip(actuator), name="slip"), "")
    spring = panel(("Parallel spring", ""), plots.parallel_spring(actuator.spring, name="spring"), "")
    caption = (
        "Among the slip elements, single large values between zeros (hollow circles) show that the records determine "
        "sums of stiffnesses better than single ones. The spring rises everywhere (Assumption I)."
    )
    if isinstance(actuator.slip, GradedSlip):
        caption += " These elements are graded: each is shown with its largest stiffness."
    return figure("Its slip elements and spring" if actuator.wide else "The model", caption, [slip, spring])


def _plain_slip(actuator: Actuator) -> MaxwellSlip:
    return actuator.slip if isinstance(actuator.slip, MaxwellSlip) else actuator.slip.stiffest()


def _whose(trace: Trace) -> tuple[str, str]:
    return trace.record, trace.role


def numbers(actuator: Actuator) -> str:
    """Return tables of the slip elements and of the knots of the spring."""
    slip, spring = _plain_slip(actuator), actuator.spring
    each = [str(i) for i in range(1, len(slip) + 1)]
    columns = (slip.breakaway * 1e6, slip.stiffness * 1e-6, slip.friction)
    elements = zip(each, *map(_column, columns), strict=True)
    each = [str(i) for i in range(1, spring.voltage.size + 1)]
    knots = zip(each, _column(spring.displacement * 1e6), _column(spring.voltage), strict=True)
    first = table(("i", "ρᵢ (µm)", "κᵢ (V/µm)", "fᵢ = κᵢ ρᵢ (V)"), elements, texts=0)
    second = table(("Knot", "y (µm)", "η (V)"), knots, texts=0)
    return (
        "<details>\n<summary>The model's numbers</summary>\n"
        f'<div class="panels tables">\n<div><h3>Slip elements</h3>\n{first}'
        f"</div>\n<div><h3>Knots of the parallel spring</h3>\n{second}</div>\n</div>\n</details>"
    )


def _column(values: Array) -> list[str]:
    """Write a column with the decimals that give its largest value six digits."""
    largest = float(np.abs(values).max())
    decimals = min(12, max(0, 5 - math.floor(math.log10(largest)))) if largest > 0 else 0
    return [f"{float(value):.{decimals}f}".replace("-", MINUS) if value else "0" for value in values]
