"""What records tell of a wider model, as sections of a page."""

from __future__ import annotations

import numpy as np

from dehyst.report import uncertainty_plots
from dehyst.report.html import Row, escape, figure, length, number, panel, table
from dehyst.report.trust_section import state, trajectory, verdict
from dehyst.uncertainty.part_identifiability import SHARP
from dehyst.uncertainty.wide_insight import NOT_JUDGED, WideInsight


def wide_sections(found: WideInsight) -> list[str]:
    """The sections, to stand in the report too."""
    share = number(100 * found.misfit / found.evidence.stroke)
    good = f"The model misses these records by {share} % of their range at most, and nothing speaks against its use."
    parts = (
        verdict(found, "Nothing to beware of", good),
        _told(found),
        _numbers(found),
        trajectory(found),
        f'<h2>What was not judged</h2>\n<p class="muted">{escape(NOT_JUDGED)}</p>',
        state(found),
    )
    return [part for part in parts if part]


def _told(found: WideInsight) -> str:
    rows: list[Row] = [
        (one.part.capitalize(), str(one.of), str(one.known), *_spread(one.deviations)) for one in found.parts
    ]
    head = ("Part", "Coefficients", "Combinations known", "Best known to (V)", "Half of them to (V)")
    said = (
        f"The turning points of the records determine {found.identifiability.determined} of {found.identifiability.of} "
        "directions of plain "
        "elements: whether there are inner loops enough. "
        "A combination of a part's coefficients, counted as the volts that they hold, is known if its standard "
        f"deviation is {100 * SHARP:g} % of the voltages at most, all other parts being free to make up for it. "
        "What is not known by itself may be sharp together with other parts: what counts for a motion is the band "
        "along it."
    )
    return f'<h2>What the records tell of each part</h2>\n<p class="muted">{said}</p>\n{table(head, rows, texts=1)}'


def _spread(deviations: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> tuple[str, str]:
    best, middle = float(deviations.min()), float(np.median(deviations))
    return tuple("nothing" if np.isinf(one) else number(one, 2) for one in (best, middle))  # type: ignore[return-value]


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
        f"{level} intervals from {len(found.intervals.actuators)} identifications of resampled cycles under the same "
        "structure, their bias taken off, so that an interval need not hold the model's own value. The largest error "
        f"on the records, {length(found.misfit)}, comes on top: it is what this structure cannot follow. Single "
        "stiffnesses and the spring trade with one another, and are sharp only together."
    )
    return figure("How sharp the numbers are", caption, panels)
