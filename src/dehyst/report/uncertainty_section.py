"""The assessment of a model, as a section of the report or as a page of its own."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike

import numpy as np

from dehyst._io.drafts import write_atomically
from dehyst.report import uncertainty_plots
from dehyst.report.html import Row, document, escape, figure, length, number, panel, table
from dehyst.report.trust_section import state, trajectory, verdict
from dehyst.report.wide_uncertainty_section import wide_sections
from dehyst.uncertainty import Insight
from dehyst.uncertainty.wide_insight import WideInsight

_MOST_SENTENCES = 24


def write_insight(path: str | PathLike[str], found: Insight | WideInsight, *, command: str | None = None) -> None:
    """Write an assessment to one HTML file that loads nothing from outside.

    Parameters
    ----------
    path : path-like
        Replaced if it exists; never left half written.
    found : Insight or WideInsight
    command : str, optional
        The command line to show.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    FileFormatError
        If the file cannot be written.
    """
    name = escape(found.actuator.name)
    records = ", ".join(escape(item.record.name) for item in found.evidence.comparisons)
    parts = [
        f"<h1>{name}: how far to trust the model</h1>",
        f'<p class="muted">Records: {records} · stroke {escape(length(found.evidence.stroke))}</p>',
        *sections(found),
        f"<h2>How to reproduce</h2>\n<pre>{escape(command)}</pre>" if command else "",
    ]
    write_atomically(path, document(f"{found.actuator.name}: insight", parts))


def sections(found: Insight | WideInsight) -> list[str]:
    """Return the page's sections, which the report can contain too."""
    if isinstance(found, WideInsight):
        return wide_sections(found)
    good = "The records determine every direction of the stiffnesses that loops can determine."
    parts = (
        verdict(found, "Determined", good),
        _directions(found),
        _numbers(found),
        trajectory(found),
        _next(found),
        state(found),
    )
    return [part for part in parts if part]


def _directions(found: Insight) -> str:
    identifiability = found.identifiability
    sentences = identifiability.sentences()
    items = [escape(_subscripts(sentence)) for sentence in sentences[:_MOST_SENTENCES]]
    if len(sentences) > _MOST_SENTENCES:
        items.append(f"and {len(sentences) - _MOST_SENTENCES} more")
    listed = "\n".join(f"<li>{item}</li>" for item in items)
    caption = (
        f"The turning points of the records determine {identifiability.determined} of {identifiability.of} directions "
        "of the stiffnesses, with the spring and each record's constant free. A singular value is the RMS voltage that "
        "one volt of breakaway voltages in its direction causes and no spring can cancel; hollow ones are open."
    )
    drawn = panel(("Singular values", ""), uncertainty_plots.singular_values(identifiability, name="singular"), "")
    body = f'<div class="panel"><h3>In words</h3>\n<ul>\n{listed}\n</ul></div>'
    return figure("What the records determine of the stiffnesses", caption, [drawn, body])


def _subscripts(sentence: str) -> str:
    """Write k_12 as k₁₂."""
    digits = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
    words = sentence.split(" ")
    return " ".join("k" + word[2:].translate(digits) if word.startswith("k_") else word for word in words)


def _numbers(found: Insight) -> str:
    if found.intervals is None or found.feasible_set is None:
        return ""
    stiffness = panel(("Stiffnesses", ""), uncertainty_plots.stiffness_intervals(found, name="stiffnesses"), "")
    spring = panel(("Parallel spring", ""), uncertainty_plots.spring_intervals(found, name="spring-interval"), "")
    slip = found.actuator.slip
    rows: list[Row] = [
        (str(i), number(rho * 1e6, 4), number(kappa * 1e-6, 4), *_ranges(found, i - 1))
        for i, (rho, kappa) in enumerate(zip(slip.breakaway, slip.stiffness, strict=True), 1)
    ]
    level = f"{100 * found.intervals.level:.0f} %"
    head = ("i", "ρᵢ (µm)", "κᵢ (V/µm)", f"{level} by noise", "compatible")
    caption = (
        f"By noise: {level} intervals from {len(found.intervals.actuators)} identifications of resampled cycles "
        "(bootstrap). Their bias is removed, so an interval may not contain the model's own value. An open stiffness "
        "is not determined by itself, whatever the noise. Compatible: the least and the largest value among all models "
        "that agree with the records nearly as well as this one. A stiffness may be uncertain while a sum of "
        "neighbours is accurate; what counts for a motion is the band along its trajectory."
    )
    numbers = (
        f"<details>\n<summary>The intervals' numbers</summary>\n<div>{table(head, rows, texts=0)}</div>\n</details>"
    )
    return figure("How accurate the numbers are", caption, [stiffness, spring]) + "\n" + numbers


def _ranges(found: Insight, i: int) -> tuple[str, str]:
    """Return an element's interval by noise, and its range among compatible models."""
    assert found.intervals is not None
    assert found.feasible_set is not None
    if not found.identifiability.movable[i]:
        return "", "never slides"
    noise = _pair(found.intervals.stiffness[:, i] * 1e-6) if found.identifiability.alone[i] else "open"
    return noise, _pair(found.feasible_set.stiffness[:, i] * 1e-6)


def _pair(ends: Sequence[float] | np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    return f"{number(float(ends[0]))} to {number(float(ends[1]))}"


def _next(found: Insight) -> str:
    if not found.advice:
        identifiability = found.identifiability
        if identifiability.determined < identifiability.of:
            return ""
        return '<h2>What to record next</h2>\n<p class="muted">Nothing: no loop determines more directions.</p>'
    rows: list[Row] = [
        (
            (advice.words, advice.command),
            f"{advice.determined} of {advice.of}",
            f"{number(advice.weakest, 2)}",
            f"{advice.seconds:.4g} s",
        )
        for advice in found.advice[:6]
    ]
    head = ("Excitation", "Known with it", "Weakest (V/V)", "Time")
    return f"<h2>What to record next</h2>\n{table(head, rows, texts=1)}"
