"""The assessment of a model: figures, and a section of the report or a page of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from dehyst._io import PathLike, write_atomically
from dehyst._types import Array
from dehyst.control import Homing
from dehyst.identification.diagnostics.identifiability import Identifiability
from dehyst.report.html import (
    Row,
    document,
    escape,
    figure,
    folded,
    length,
    number,
    panel,
    reproduction,
    spelled,
    table,
)
from dehyst.report.plots import FALLING, INK, MEASURED, RISING, SIMULATED, length_unit
from dehyst.trust import Insight
from dehyst.trust.bootstrap import Intervals
from dehyst.trust.identifiability import SHARP
from dehyst.trust.precision import NOISE_BIAS
from dehyst.trust.prediction_band import ERRORS, PredictionBand

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FREE = "#BBBBBB"
# Singular values below this are rounding; drawn at the foot of the scale.
_FOOT = 1e-5


def _by_noise(noise: Intervals) -> str:
    return f"{100 * noise.level:.0f} % by noise"


def draw_singular_values(ax: Axes, identifiability: Identifiability) -> None:
    """Draw the singular value of each direction, filled if the records determine it, hollow if not."""
    values = identifiability.values
    number, known = np.arange(1, values.size + 1), np.arange(values.size) < identifiability.determined
    shown = np.maximum(values, _FOOT)
    for some, face, label in ((known, MEASURED, "determined"), (~known, "white", "open")):
        if some.any():
            style: dict[str, Any] = {"ls": "none", "marker": "o", "ms": 4.5, "mfc": face, "mec": MEASURED}
            ax.plot(number[some], shown[some], label=label, clip_on=False, **style)
    ax.set(yscale="log", xlabel="direction", ylabel="singular value (V/V)")
    ax.set_ylim(bottom=min(_FOOT, float(shown.min())))
    ax.set_xlim(0.5, values.size + 0.5)
    ax.locator_params(axis="x", integer=True)
    ax.legend(loc="lower left")


def draw_stiffness_intervals(ax: Axes, found: Insight) -> None:
    """Draw each stiffness with its interval by noise, and behind it its range among compatible models."""
    slip, noise, free, alone = found.actuator.slip, found.intervals, found.feasible_set, found.identifiability.alone
    factor, unit = length_unit(float(slip.breakaway[-1]))
    rho = slip.breakaway * factor
    if free is not None:
        ax.vlines(rho, *free.stiffness * 1e-6, color=_FREE, lw=5, label="compatible")
    if noise is not None and alone.any():
        low, high = noise.stiffness[:, alone] * 1e-6
        ax.vlines(rho[alone], low, high, color=SIMULATED, lw=1.6, label=_by_noise(noise))
    ax.plot(rho, slip.stiffness * 1e-6, ls="none", marker="o", ms=3, color=INK, label="model", clip_on=False)
    ax.set(xlabel=f"breakaway elongation ({unit})", ylabel="stiffness (V/µm)")
    ax.set_xlim(0, 1.05 * float(rho[-1]))
    ax.set_ylim(bottom=0)
    ax.legend(loc="upper right")


def draw_spring_interval(ax: Axes, found: Insight) -> None:
    """Draw the uncertainty of the spring's voltage at its knots, by noise and among compatible models."""
    spring, noise, free = found.actuator.spring, found.intervals, found.feasible_set
    factor, unit = length_unit(float(np.ptp(spring.displacement)))
    centre, y = spring.voltage - spring.voltage[0], spring.displacement * factor
    if free is not None:
        ax.fill_between(y, free.spring[0] - centre, free.spring[1] - centre, color=_FREE, lw=0, label="compatible")
    if noise is not None:
        low, high = (end - centre for end in noise.spring)
        ax.fill_between(y, low, high, color=SIMULATED, alpha=0.6, lw=0, label=_by_noise(noise))
    ax.axhline(0, color=INK, lw=0.8)
    ax.set(xlabel=f"displacement ({unit})", ylabel="spring voltage, off the model's (V)")
    ax.legend(loc="upper left")


def draw_loop_interval(ax: Axes, found: Insight) -> None:
    """Draw the uncertainty of the displacement by noise on the rise and the fall through the limits."""
    loop = found.loop
    if loop is None:
        return
    low, high = (loop.noise - loop.displacement) * 1e9
    top = int(np.argmax(loop.voltage))
    for branch, colour, label in ((slice(0, top + 1), RISING, "rising"), (slice(top, None), FALLING, "falling")):
        ax.fill_between(loop.voltage[branch], low[branch], high[branch], color=colour, alpha=0.5, lw=0, label=label)
    ax.axhline(0, color=INK, lw=0.8)
    ax.set(xlabel="voltage (V)", ylabel="displacement, off the model's (nm)")
    bottom, upper = ax.get_ylim()
    ax.set_ylim(bottom, upper + 0.25 * (upper - bottom))
    ax.legend(loc="upper left", ncols=2)


def draw_drive_interval(ax: Axes, found: Insight) -> None:
    """Draw the uncertainty of tau at its knots by noise."""
    tau, noise = found.actuator.transformer, found.intervals
    if tau is not None and noise is not None and noise.drive is not None:
        low, high = noise.drive - tau.drive
        ax.fill_between(tau.voltage, low, high, color=SIMULATED, alpha=0.6, lw=0, label=_by_noise(noise))
    ax.axhline(0, color=INK, lw=0.8)
    ax.set(xlabel="voltage (V)", ylabel="tau, off the model's (V)")
    ax.legend(loc="upper left")


def draw_creep_intervals(ax: Axes, found: Insight) -> None:
    """Draw the stiffness of each creep branch with its interval by noise."""
    creep, noise = found.actuator.creep, found.intervals
    if creep is None:
        return
    if noise is not None and noise.creep is not None:
        low, high = noise.creep * 1e-6
        ax.vlines(creep.time_constants, low, high, color=SIMULATED, lw=1.6, label=_by_noise(noise))
    ax.plot(creep.time_constants, creep.stiffness * 1e-6, ls="none", marker="o", ms=3, color=INK, label="model")
    ax.set(xscale="log", xlabel="time constant (s)", ylabel="stiffness (V/µm)")
    low, high = ax.get_ylim()
    ax.set_ylim(0, 1.3 * high)
    ax.legend(loc="upper left", ncols=2)


def _draw_trajectory(upper: Axes, lower: Axes, found: PredictionBand, stroke: float) -> None:
    """Draw the error to expect along a trajectory, part by part, and the trajectory above."""
    factor, unit = length_unit(float(np.ptp(found.displacement)))
    upper.plot(np.arange(found.displacement.size), found.wanted * factor, color=MEASURED, lw=1)
    upper.set_ylabel(f"displacement ({unit})")
    draw_band(lower, found, stroke)


def draw_band(ax: Axes, found: PredictionBand, stroke: float) -> None:
    """Draw the error to expect along a trajectory, part by part [% of a stroke in m], on axes."""
    sample = np.arange(found.displacement.size)

    def fill(low: Array, high: Array, colour: str, label: str) -> None:
        low, high = (100 * (edge - found.wanted) / stroke for edge in (low, high))
        ax.fill_between(sample, low, high, color=colour, lw=0, label=label)

    fill(found.lowest, found.highest, "#E5E5E5", "all")
    if found.likely is not None:
        fill(found.likely[0], found.likely[1], "#CFD8E6", f"{100 * found.level:g} %")
    if found.open is not None:
        fill(found.open[0], found.open[1], "#AAAAAA", "compatible with the records")
    fill(found.noise[0], found.noise[1], SIMULATED, "noise")
    ax.axhline(0, color=FALLING, lw=0.6)
    low, high = ax.get_ylim()
    ax.set_ylim(low, high + 0.35 * (high - low))
    ax.set(xlabel="sample", ylabel="error (% of stroke)")
    ax.legend(loc="upper left", ncols=4)


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
    beside = f'<h2>Not judged</h2>\n<p class="muted">{escape(found.not_judged)}</p>' if found.not_judged else ""
    parts = (
        _verdict(found),
        _directions(found),
        _parts(found),
        _part_intervals(found),
        _intervals(found),
        _trajectory(found),
        _next(found),
        beside,
        _state(found),
    )
    return [part for part in parts if part]


def _directions(found: Insight) -> str:
    directions = found.identifiability
    sentences = () if found.actuator.wide else directions.sentences()
    items = [escape(spelled(_subscripts(sentence))) for sentence in sentences[:_MOST_SENTENCES]]
    if len(sentences) > _MOST_SENTENCES:
        items.append(f"and {len(sentences) - _MOST_SENTENCES} more")
    listed = "\n".join(f"<li>{item}</li>" for item in items)
    of = "ten plain elements" if found.actuator.wide else "the stiffnesses"
    caption = (
        f"The turning points of the records determine {directions.determined} of {directions.of} directions of "
        f"{of}, with the spring and each record's constant free. A singular value is the RMS voltage that one "
        "volt of breakaway voltages in its direction causes and no spring can cancel; hollow ones are open."
    )
    drawn = panel("Singular values", "singular", draw_singular_values, directions)
    body = f'<div class="panel"><h3>In words</h3>\n<ul>\n{listed}\n</ul></div>'
    return figure("What the turning points determine", caption, [drawn, body] if items else [drawn])


def _subscripts(sentence: str) -> str:
    """Write k_12 as k₁₂."""
    digits = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
    words = sentence.split(" ")
    return " ".join("k" + word[2:].translate(digits) if word.startswith("k_") else word for word in words)


def _intervals(found: Insight) -> str:
    if found.intervals is None or found.feasible_set is None or found.precision is None:
        return ""
    stiffness = panel("Stiffnesses", "stiffnesses", draw_stiffness_intervals, found)
    spring = panel("Parallel spring", "spring-interval", draw_spring_interval, found)
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
    numbers = folded("The intervals' numbers", {"": table(head, rows, texts=0)})
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
        panels.append(panel("The major loop", "loop-interval", draw_loop_interval, found))
    if found.actuator.transformer is not None:
        panels.append(panel("Transformer", "drive-interval", draw_drive_interval, found))
    if found.actuator.creep is not None:
        panels.append(panel("Creep", "creep-interval", draw_creep_intervals, found))
    level = f"{100 * found.intervals.level:.0f} %"
    caption = (
        f"{level} intervals from {len(found.intervals.actuators)} identifications of resampled cycles (bootstrap) with "
        f"the same structure. {_bias(found)}The largest "
        f"error on the records, {length(found.misfit)}, comes on top: this structure cannot follow it. Single "
        "stiffnesses and the spring compensate one another: together they are more accurate."
    )
    return figure("How accurate the parts are", caption, panels)


def _verdict(found: Insight) -> str:
    """Return the warnings, or the good verdict if there are none."""
    warnings = found.warnings()
    if warnings:
        lines = "<br>".join(escape(spelled(warning)) for warning in warnings)
        return f'<p class="outcome amber"><strong>Warning</strong> {lines}</p>'
    share = number(100 * found.misfit / found.evidence.stroke)
    word, known = "No warnings", "How precisely its numbers are known was not judged: there are no intervals."
    if found.precision is not None:
        word, known = "Known" if found.precision.all_known else "No warnings", found.precision.sentence
    return (
        f'<p class="outcome green"><strong>{word}</strong> {known} The largest error of the model on these records is '
        f"{share} % of their range.</p>"
    )


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
    drawn = panel("Along the trajectory", "band", _draw_trajectory, found.band, stroke, rows=2, height=4.4)
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
