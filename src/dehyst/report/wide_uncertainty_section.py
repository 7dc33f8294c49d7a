"""The assessment of a wider model, as sections of a page."""

from __future__ import annotations

import numpy as np

from dehyst.report import uncertainty_plots
from dehyst.report.html import Row, escape, figure, length, number, panel, table
from dehyst.report.trust_section import state, trajectory, verdict
from dehyst.uncertainty.part_identifiability import SHARP
from dehyst.uncertainty.wide_insight import NOT_JUDGED, WideInsight


def wide_sections(found: WideInsight) -> list[str]:
    """Return the sections, which the report can contain too."""
    share = number(100 * found.misfit / found.evidence.stroke)
    good = f"The largest error of the model on these records is {share} % of their range, and there is no warning."
    parts = (
        verdict(found, "No warnings", good),
        _parts(found),
        _numbers(found),
        trajectory(found),
        f'<h2>Not judged</h2>\n<p class="muted">{escape(NOT_JUDGED)}</p>',
        state(found),
    )
    return [part for part in parts if part]


def _parts(found: WideInsight) -> str:
    rows: list[Row] = [
        (part.part.capitalize(), str(part.of), str(part.known), *_spread(part.deviations)) for part in found.parts
    ]
    head = ("Part", "Coefficients", "Combinations known", "Best known to (V)", "Half of them to (V)")
    caption = (
        f"The turning points of the records determine {found.identifiability.determined} of {found.identifiability.of} "
        "directions of plain elements; this shows whether there are enough inner loops. "
        "A combination of a part's coefficients, counted as the volts that they hold, is known if its standard "
        f"deviation is at most {100 * SHARP:g} % of the voltages, with all other parts free to compensate for it. "
        "A combination that is not known by itself may be accurate together with other parts: what counts for a motion "
        "is the band along it."
    )
    title = "What the records determine of each part"
    return f'<h2>{title}</h2>\n<p class="muted">{caption}</p>\n{table(head, rows, texts=1)}'


def _spread(deviations: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> tuple[str, str]:
    best, middle = float(deviations.min()), float(np.median(deviations))
    return tuple("nothing" if np.isinf(x) else number(x, 2) for x in (best, middle))  # type: ignore[return-value]


def _numbers(found: WideInsight) -> str:
    if found.intervals is None:
        return ""
    panels = []
    if found.loop is not None:
        panels.append(panel(("The major loop", ""), uncertainty_plots.loop_interval(found, name="loop-interval"), ""))
    if found.actuator.transformer is not None:
        panels.append(panel(("Transformer", ""), uncertainty_plots.drive_interval(found, name="drive-interval"), ""))
    if found.actuator.creep is not None:
        panels.append(panel(("Creep", ""), uncertainty_plots.creep_intervals(found, name="creep-interval"), ""))
    level = f"{100 * found.intervals.level:.0f} %"
    caption = (
        f"{level} intervals from {len(found.intervals.actuators)} identifications of resampled cycles (bootstrap) with "
        "the same structure. Their bias is removed, so an interval may not contain the model's own value. The largest "
        f"error on the records, {length(found.misfit)}, comes on top: this structure cannot follow it. Single "
        "stiffnesses and the spring compensate one another, and are accurate only together."
    )
    return figure("How accurate the numbers are", caption, panels)
