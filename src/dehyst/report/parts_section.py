"""The parts of a wider actuator, as a section of the report."""

from __future__ import annotations

import re

from dehyst.model import Actuator, Creep, GradedSlip, SmoothSlip
from dehyst.model.summary import parts_of
from dehyst.report import part_plots
from dehyst.report.html import Row, figure, number, panel, table


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


def _spelt(sentence: str) -> str:
    return re.sub(r"(?<=\d |V/)um\b", "µm", sentence).replace("tau(v)", "τ(v)")
