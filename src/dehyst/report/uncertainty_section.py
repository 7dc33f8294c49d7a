"""The assessment of a model, as a section of the report or as a page of its own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dehyst._io.drafts import PathLike, write_atomically
from dehyst.control import Homing
from dehyst.report import uncertainty_plots
from dehyst.report.html import Row, document, escape, figure, length, number, panel, reproduction, spelled, table
from dehyst.uncertainty import Insight
from dehyst.uncertainty.part_identifiability import SHARP
from dehyst.uncertainty.precision import NOISE_BIAS
from dehyst.uncertainty.prediction_band import ERRORS

_MOST_SENTENCES = 24


def write_insight(path: PathLike, found: Insight, *, command: str | None = None) -> None:
    """Write an assessment to one HTML file that loads nothing from outside.

    `path`, `command` and errors are as in `write_report`; `found` is the assessment.
    """
    name = escape(found.actuator.name)
    records = ", ".join(escape(one.record.name) for one in found.evidence.comparisons)
    parts = [
        f"<h1>{name}: how far to trust the model</h1>",
        f'<p class="muted">Records: {records} · stroke {escape(length(found.evidence.stroke))}</p>',
        *sections(found),
        reproduction(command),
    ]
    write_atomically(path, document(f"{found.actuator.name}: insight", parts))


def sections(found: Insight) -> list[str]:
    """Return the page's sections, which the report can contain too."""
    share = number(100 * found.misfit / found.evidence.stroke)
    if found.structured:
        good = f"The largest error of the model on these records is {share} % of their range, and there is no warning."
        good = f"{good} {_known(found)}".strip()
        parts = (
            _verdict(found, "No warnings", good),
            _parts(found),
            _part_intervals(found),
            _trajectory(found),
            f'<h2>Not judged</h2>\n<p class="muted">{escape(found.not_judged)}</p>',
            _state(found),
        )
    else:
        parts = (
            _verdict(found, *_good(found)),
            _directions(found),
            _intervals(found),
            _trajectory(found),
            _next(found),
            _state(found),
        )
    return [part for part in parts if part]


def _good(found: Insight) -> tuple[str, str]:
    """Return the good verdict on a plain model, a word and a sentence."""
    if found.precision is not None:
        return "Known", _known(found)
    determined = "The records determine every direction of the stiffnesses that loops can."
    return "Determined", f"{determined} How precisely was not judged: there are no intervals."


def _known(found: Insight) -> str:
    return "" if found.precision is None else found.precision.sentence


def _directions(found: Insight) -> str:
    directions = found.identifiability
    sentences = directions.sentences()
    items = [escape(spelled(_subscripts(sentence))) for sentence in sentences[:_MOST_SENTENCES]]
    if len(sentences) > _MOST_SENTENCES:
        items.append(f"and {len(sentences) - _MOST_SENTENCES} more")
    listed = "\n".join(f"<li>{item}</li>" for item in items)
    caption = (
        f"The turning points of the records determine {directions.determined} of {directions.of} directions of the "
        "stiffnesses, with the spring and each record's constant free. A singular value is the RMS voltage that one "
        "volt of breakaway voltages in its direction causes and no spring can cancel; hollow ones are open."
    )
    drawn = panel(("Singular values", ""), uncertainty_plots.singular_values(directions, name="singular"), "")
    body = f'<div class="panel"><h3>In words</h3>\n<ul>\n{listed}\n</ul></div>'
    return figure("What the records determine of the stiffnesses", caption, [drawn, body])


def _subscripts(sentence: str) -> str:
    """Write k_12 as k₁₂."""
    digits = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
    words = sentence.split(" ")
    return " ".join("k" + word[2:].translate(digits) if word.startswith("k_") else word for word in words)


def _intervals(found: Insight) -> str:
    if found.intervals is None or found.feasible_set is None or found.precision is None:
        return ""
    stiffness = panel(("Stiffnesses", ""), uncertainty_plots.stiffness_intervals(found, name="stiffnesses"), "")
    spring = panel(("Parallel spring", ""), uncertainty_plots.spring_intervals(found, name="spring-interval"), "")
    slip = found.actuator.slip
    rows: list[Row] = [
        (str(i), number(rho * 1e6, 4), number(kappa * 1e-6, 4), *_ranges(found, i - 1))
        for i, (rho, kappa) in enumerate(zip(slip.breakaway, slip.stiffness, strict=True), 1)
    ]
    level = f"{100 * found.intervals.level:.0f} %"
    head = ("i", "ρᵢ (µm)", "κᵢ (V/µm)", f"{level} by noise", "compatible", "verdict")
    caption = (
        f"By noise: {level} intervals from {len(found.intervals.actuators)} identifications of resampled cycles "
        f"(bootstrap). {_bias(found)}An open stiffness "
        "is not determined by itself, whatever the noise. Compatible: the least and the largest value among all models "
        "that agree with the records nearly as well as this one. A stiffness may be uncertain while a sum of "
        f"neighbours is accurate; what counts for a motion is the band along its trajectory. {found.precision.rule}"
    )
    numbers = (
        f"<details>\n<summary>The intervals' numbers</summary>\n<div>{table(head, rows, texts=0)}</div>\n</details>"
    )
    return figure("How accurate the numbers are", caption, [stiffness, spring]) + "\n" + numbers


def _bias(found: Insight) -> str:
    """Return why intervals by noise exclude estimates, where some do."""
    parts = () if found.precision is None else found.precision.parts
    return f"{NOISE_BIAS} " if any(any(part.biased) for part in parts) else ""


def _ranges(found: Insight, i: int) -> tuple[str, str, str]:
    """Return an element's interval by noise, its range among compatible models, and the verdict."""
    assert found.intervals is not None
    assert found.feasible_set is not None
    assert found.precision is not None
    movable = found.identifiability.movable
    if not movable[i]:
        return "", "never slides", "part of the spring"
    verdict = found.precision.parts[0].words(int(movable[:i].sum())).replace("um", "µm")
    noise = _pair(found.intervals.stiffness[:, i] * 1e-6) if found.identifiability.alone[i] else "open"
    return noise, _pair(found.feasible_set.stiffness[:, i] * 1e-6), verdict


def _pair(ends: Sequence[float] | np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    return f"{number(float(ends[0]))} to {number(float(ends[1]))}"


def _next(found: Insight) -> str:
    if not found.advice:
        directions = found.identifiability
        if directions.determined < directions.of:
            return ""
        sentence = "Nothing: no loop determines more directions."
        if found.precision is not None and not found.precision.all_known:
            sentence = f"No loop determines more directions. {found.precision.next}"
        return f'<h2>What to record next</h2>\n<p class="muted">{escape(sentence)}</p>'
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


def _parts(found: Insight) -> str:
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
    title = "<h2>What the records determine of each part</h2>"
    return f'{title}\n<p class="muted">{caption}</p>\n{table(head, rows, texts=1)}\n{_counts(found)}'


def _counts(found: Insight) -> str:
    """Return how many numbers of each part are known to the precision."""
    if found.precision is None:
        return ""
    rows: list[Row] = [
        (part.several.capitalize(), str(part.of_all), str(part.known), str(sum(map(abs, part.biased))))
        for part in found.precision.parts
    ]
    head = ("Number by number", "Coefficients", "Known", "Biased by noise")
    return f'{table(head, rows, texts=1)}\n<p class="muted">{escape(found.precision.rule)}</p>'


def _spread(deviations: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> tuple[str, str]:
    best, middle = float(deviations.min()), float(np.median(deviations))
    return tuple("nothing" if np.isinf(x) else number(x, 2) for x in (best, middle))  # type: ignore[return-value]


def _part_intervals(found: Insight) -> str:
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
        f"the same structure. {_bias(found)}The largest "
        f"error on the records, {length(found.misfit)}, comes on top: this structure cannot follow it. Single "
        "stiffnesses and the spring compensate one another, and are accurate only together."
    )
    return figure("How accurate the numbers are", caption, panels)


def _verdict(found: Insight, word: str, good: str) -> str:
    """Return the warnings, or the good verdict if there are none."""
    warnings = found.warnings()
    if not warnings:
        return f'<p class="outcome green"><strong>{word}</strong> {good}</p>'
    lines = "<br>".join(escape(spelled(warning)) for warning in warnings)
    return f'<p class="outcome amber"><strong>Warning</strong> {lines}</p>'


def _trajectory(found: Insight) -> str:
    """Return the prediction band along a trajectory; empty without one."""
    if found.band is None:
        return ""
    stroke, errors = found.evidence.stroke, found.band.errors()
    rows: list[Row] = [
        (ERRORS[key], f"{number(100 * error / stroke)} %", length(error))
        for key, error in errors.items()
        if error or key != "clamped"
    ]
    drawn = panel(("Along the trajectory", ""), uncertainty_plots.band(found.band, stroke, name="band"), "")
    body = f'<div class="panel"><h3>Largest error to expect</h3>\n{table(("From", "of stroke", ""), rows, 1)}</div>'
    caption = "How far the displacement may be from the wanted path if the compensating voltage is played."
    caption = f"{caption} {found.band.sentence(stroke)}".strip()
    return figure("The trajectory", caption, [drawn, body])


def _state(found: Insight) -> str:
    """Return a table of when the state becomes known, and the homing."""

    def moment(seconds: float | None) -> str:
        return "never" if seconds is None else f"{number(seconds)} s"

    rows: list[Row] = [
        (known.record, moment(known.by_displacement), moment(known.by_voltage) if known.judged else "not judged")
        for known in found.knowledge
    ]
    head = ("Record", "from the measured displacement", "from the voltage alone")
    parts = ["<h2>When the state becomes known</h2>", table(head, rows, texts=1)]
    if found.homing is not None:
        parts.append(_homing(found.homing, creeps=found.actuator.creep is not None))
    return "\n".join(parts)


def _homing(homing: Homing, *, creeps: bool) -> str:
    turns = ", ".join(number(v, 6) for v in homing.turns)
    remarks = " ".join(f"{escape(spelled(one[:1].upper() + one[1:]))}." for one in homing.remarks)
    if homing.played is None:
        word = "certified: every state at rest ends in one" if homing.certified else "not certified"
        return f"<p>Shortest homing: {escape(turns)} V ({word}). {remarks}</p>"
    word = "certified" if homing.certified else "not certified"
    way = ", ".join(f"{v:.6g}" for v in homing.turns)
    sentence = escape(
        f"{way} V in {number(homing.played.duration)} s{', with holds at both limits' if creeps else ''} ({word}): "
        f"after any history within the limits, it makes the displacement known to {length(homing.error)}."
    )
    items = "\n".join(f"<li>{escape(spelled(remark))}</li>" for remark in homing.remarks)
    return f"<p>Homing: {sentence}</p>\n<ul>\n{items}\n</ul>"
