"""The parts of an actuator, as sections of the report: figures, and tables of their numbers."""

from __future__ import annotations

import math

import numpy as np

from dehyst._types import Array
from dehyst.model import Actuator, Creep, GradedSlip, MaxwellSlip, SmoothSlip
from dehyst.model.summary import parts_of
from dehyst.report import part_plots, plots
from dehyst.report.html import MINUS, Row, figure, number, panel, spelled, table


def made_of(actuator: Actuator) -> str:
    """Return the section; empty for a plain actuator, which two other figures show completely.

    Raise `MissingExtraError` if matplotlib is not installed.
    """
    if not actuator.wide:
        return ""
    rows: list[Row] = [
        (part.name, _spelt(part.sentence), "–" if part.holds is None else f"{number(part.holds)} V")
        for part in parts_of(actuator)
    ]
    drawn = figure("", _CAPTION, _panels(actuator)).replace("<h2></h2>\n", "") if _panels(actuator) else ""
    head = ("Part", "What it does", "Holds at most")
    return "\n".join(
        part
        for part in (f"<h2>What the model is made of</h2>\n{table(head, rows, texts=2)}", drawn, _tables(actuator))
        if part
    )


_CAPTION = (
    "The parts beyond a plain Maxwell-slip model. In a plain model this line of tau is zero, elements are even "
    "stripes, and there is no creep."
)


def _panels(actuator: Actuator) -> list[str]:
    found, slip = [], actuator.slip
    if actuator.transformer is not None:
        found.append(panel(("Transformer", ""), part_plots.transformer(actuator.transformer, name="tau"), ""))
    if actuator.creep is not None:
        found.append(panel(("Creep after a sudden rise", ""), part_plots.creep(actuator, name="creep"), ""))
    if isinstance(slip, GradedSlip):
        found.append(panel(("Graded elements", ""), part_plots.graded(slip, name="graded"), ""))
        drawn = part_plots.slopes(slip, actuator.spring, name="slopes")
        found.append(panel(("Stiffness along the stroke", ""), drawn, ""))
    if actuator.smooth is not None:
        found.append(panel(("Smooth elements", ""), part_plots.smooth(actuator.smooth, name="smooth"), ""))
    return found


def _tables(actuator: Actuator) -> str:
    tables = []
    if actuator.creep is not None:
        tables.append(f"<div><h3>Creep branches</h3>\n{_branches(actuator.creep)}</div>")
    if actuator.smooth is not None:
        tables.append(f"<div><h3>Smooth elements</h3>\n{_lengths(actuator.smooth)}</div>")
    if not tables:
        return ""
    body = "\n".join(tables)
    return f'<details>\n<summary>The parts\' numbers</summary>\n<div class="panels tables">\n{body}\n</div>\n</details>'


def _branches(creep: Creep) -> str:
    total = float(creep.stiffness.sum()) or 1.0
    rows: list[Row] = [
        (number(tau), number(c * 1e-6), f"{number(100 * c / total)} %")
        for tau, c in zip(creep.time_constants, creep.stiffness, strict=True)
    ]
    return table(("Time constant (s)", "cⱼ (V/µm)", "of all"), rows, texts=0)


def _lengths(smooth: SmoothSlip) -> str:
    rows: list[Row] = [
        (number(length * 1e6), number(closing), number(k * 1e-6), number(k * length))
        for length, closing, k in zip(smooth.length, smooth.closing, smooth.stiffness, strict=True)
    ]
    return table(("Length (µm)", "Closing", "k (V/µm)", "Holds (V)"), rows, texts=0)


def _spelt(words: str) -> str:
    return spelled(words).replace("tau(v)", "τ(v)")


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
