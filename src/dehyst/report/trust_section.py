"""The assessment of a model: sections of the report, or a page of its own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dehyst._io import PathLike, write_atomically
from dehyst._types import Array
from dehyst._views.html import escape
from dehyst.control import Homing
from dehyst.identification.diagnostics.identifiability import Identifiability
from dehyst.report.charts import Axis, Chart, Colour, Series, stems
from dehyst.report.html import (
    Charts,
    Part,
    Row,
    document,
    folded,
    length,
    length_unit,
    number,
    reproduction,
    table,
    words,
)
from dehyst.trust import Insight
from dehyst.trust.identifiability import SHARP
from dehyst.trust.precision import NOISE_BIAS
from dehyst.trust.prediction_band import ERRORS, MajorLoopWidth, PredictionBand
from dehyst.trust.turn_plane import TurnPlane

# Singular values below this are rounding; drawn at the foot of the scale.
_FOOT = 1e-5
_MOST_SENTENCES = 24
_FREE: Colour = "noise"
_NOISE: Colour = "simulated"
_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


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


def sections(found: Insight) -> list[Part]:
    """Return the page's sections, which the report can contain too: the answer first, single numbers folded."""
    return [
        _verdict(found),
        *_trajectory(found),
        *turned(found.turns, None if found.band is None else found.band.voltage),
        _next(found),
        *_state(found),
        "<details>\n<summary>Which numbers of the model the records determine</summary>",
        *_numbers(found),
        "</details>",
    ]


def _verdict(found: Insight) -> str:
    """Return the error to expect, then the warnings."""
    stroke, warnings = found.evidence.stroke, found.warnings()
    if found.band is not None:
        expected = (
            f"Expect an error of {number(100 * found.band.error / stroke, 2)} % of the range at most on this path."
        )
    else:
        promised = found.judgement.words(stroke)
        expected = f"Expect a path like the records {promised}." if promised else "The error to expect is not known."
    share = number(100 * found.misfit / stroke)
    lines = "".join(f"<li>{words(warning)}</li>" for warning in warnings)
    return (
        f'<div class="outcome {"amber" if warnings else "green"}" role="status">'
        f"<strong>{'Warning' if warnings else 'No warnings'}</strong>"
        f'<p class="first">{words(expected)}</p><p>The largest error of the model on these records is {share} % of '
        f"their range.</p>{f'<ul>{lines}</ul>' if lines else ''}</div>"
    )


def _trajectory(found: Insight) -> list[Part]:
    """Return the promise along a path; empty without one."""
    band = found.band
    if band is None:
        return []
    stroke = found.evidence.stroke
    rows: list[Row] = [
        (ERRORS[key], f"{number(100 * error / stroke)} %", length(error))
        for key, error in band.errors().items()
        if error or key != "clamped"
    ]
    beside = f"<div><h3>Largest error to expect</h3>\n{table(('From', 'of stroke', ''), rows, 1)}</div>"
    caption = "How far the displacement may be from the wanted path if the compensating voltage is played."
    caption = f"{caption} {band.sentence(stroke)}".strip()
    charts = _path_chart(band), band_chart(band, stroke)
    return [Charts("The promise along the path", caption, charts, beside=(beside,))]


def _path_chart(band: PredictionBand) -> Chart:
    factor, unit = length_unit(float(np.ptp(band.displacement)))
    sample = np.arange(band.wanted.size, dtype=np.float64)
    low, high = (edge * factor for edge in (band.lowest, band.highest))
    series = (
        Series("may be reached", sample, low, "measured", "area", opacity=0.25, top=high),
        Series("wanted", sample, band.wanted * factor, "measured", width=1.8),
    )
    axes = Axis("sample", ""), Axis("displacement", unit)
    return Chart("Path", "", "wanted path and where it may lead,", *axes, series)


def band_chart(band: PredictionBand, stroke: float) -> Chart:
    """Return the error to expect along a path, part by part [% of a stroke in m]."""
    sample = np.arange(band.displacement.size, dtype=np.float64)

    def area(name: str, edges: Sequence[Array] | Array | None, colour: Colour, opacity: float) -> list[Series]:
        if edges is None:
            return []
        low, high = (100 * (edge - band.wanted) / stroke for edge in edges)
        return [Series(name, sample, low, colour, "area", opacity=opacity, top=high)]

    series = (
        *area("all", (band.lowest, band.highest), "noise", 0.3),
        *area(f"{100 * band.level:g} %", band.likely, "measured", 0.35),
        *area("compatible with the records", band.open, "without", 0.6),
        *area("noise", band.noise, "simulated", 0.8),
    )
    axes = Axis("sample", ""), Axis("error", "% of stroke")
    return Chart("Error", "", "error to expect along the path,", *axes, series, zero=True)


def turned(plane: TurnPlane | None, voltage: Array | None = None) -> list[Part]:
    """Return where the records turned, how fast and how long they held, and where a `voltage` [V] turns."""
    if plane is None:
        return []
    caption = (
        "Between which voltages the records turned (dots). Shaded: loops whose rising and falling branch begin where "
        "a record turned, and do not go beyond it; there the model is tested, elsewhere it is not. "
        f"{'' if voltage is None else plane.sentence(voltage)}"
    )
    rows: list[Row] = [
        (
            record,
            str(sum(turn.times for turn in own)),
            f"{number(min(turn.speed for turn in own))} to {number(max(turn.speed for turn in own))}",
            number(held) if (held := max(turn.held for turn in own)) else "none",
        )
        for record in dict.fromkeys(turn.record for turn in plane.turns)
        for own in [[turn for turn in plane.turns if turn.record == record]]
    ]
    head = ("Record", "Rises and falls", "Speed (V/s)", "Longest hold (s)")
    beside = f"<div><h3>How fast, and how long they held</h3>\n{table(head, rows, 1)}</div>"
    return [Charts("Where the records turned", caption.strip(), (turns_chart(plane, voltage),), beside=(beside,))]


def turns_chart(plane: TurnPlane, voltage: Array | None = None) -> Chart:
    """Return the plane of turning points with the tested cells, and where a `voltage` [V] turns."""
    ends = plane.edges[[0, -1]]
    lower, upper = np.sort([(turn.begin, turn.end) for turn in plane.turns]).T
    tested = 0.5 * plane.rising + 0.5 * plane.falling
    names = tuple(turn.words for turn in plane.turns)
    series = [
        Series("", plane.edges, plane.edges, "tested", "cells", values=tested),
        Series("", ends, ends, "without", width=1),
        Series("records", lower, upper, "measured", "points", 5, names=names),
    ]
    if voltage is not None:
        lower, upper = np.sort(plane.legs(voltage)).T
        series.append(Series("this path", lower, upper, "simulated", "points", 8))
    edge = 0.03 * float(np.ptp(ends))
    shown = float(ends[0]) - edge, float(ends[1]) + edge
    x, y = (Axis(f"{which} turning point", "V", shown) for which in ("lower", "upper"))
    notes = (("tested, paler: one branch of the loop only", "tested"),)
    return Chart("Turning points", "", "plane of turning points,", x, y, tuple(series), notes=notes)


def _next(found: Insight) -> str:
    title = "<h2>What to record next</h2>"
    if not found.advice:
        directions = found.identifiability
        if directions.determined < directions.of:
            return ""
        sentence = "Nothing: no loop determines more directions."
        if found.precision is not None and not found.precision.all_known:
            sentence = f"No loop determines more directions. {found.precision.next}"
        return f'{title}\n<p class="muted">{escape(sentence)}</p>'
    rows: list[Row] = [
        (
            (advice.words, advice.command),
            f"{advice.determined} of {advice.of}",
            number(advice.weakest, 2),
            f"{advice.seconds:.4g} s",
        )
        for advice in found.advice[:6]
    ]
    return f"{title}\n{table(('Excitation', 'Known with it', 'Weakest (V/V)', 'Time'), rows, texts=1)}"


def _state(found: Insight) -> list[Part]:
    """Return a table of when the state becomes known, and the homing."""

    def moment(seconds: float | None) -> str:
        return "never" if seconds is None else f"{number(seconds)} s"

    rows: list[Row] = [
        (known.record, moment(known.by_displacement), moment(known.by_voltage) if known.judged else "not judged")
        for known in found.knowledge
    ]
    head = ("Record", "from the measured displacement", "from the voltage alone")
    homing = [] if found.homing is None else [_homing(found.homing, creeps=found.actuator.creep is not None)]
    return [f"<h2>When the state becomes known</h2>\n{table(head, rows, texts=1)}", *homing]


def _homing(homing: Homing, *, creeps: bool) -> str:
    turns = ", ".join(number(v, 6) for v in homing.turns)
    word = "certified" if homing.certified else "not certified"
    if homing.played is None:
        ends = f"{word}: every state at rest ends in one" if homing.certified else word
        remarks = " ".join(f"{words(one[:1].upper() + one[1:])}." for one in homing.remarks)
        return f"<p>Shortest homing: {escape(turns)} V ({ends}). {remarks}</p>"
    held = ", with holds at both limits" if creeps else ""
    sentence = (
        f"Homing: {turns} V in {number(homing.played.duration)} s{held} ({word}): after any history within the limits, "
        f"it makes the displacement known to {length(homing.error)}."
    )
    items = "\n".join(f"<li>{words(remark)}</li>" for remark in homing.remarks)
    return f"<p>{escape(sentence)}</p>\n<ul>\n{items}\n</ul>"


def _numbers(found: Insight) -> list[Part]:
    """Return what is known of single numbers, for those who ask."""
    precision = found.precision
    known = "How precisely its numbers are known was not judged: there are no intervals."
    parts: list[Part] = [f"<p>{words(known if precision is None else precision.sentence)}</p>"]
    parts += [*_directions(found), _parts(found), *_part_intervals(found), *_intervals(found)]
    if found.not_judged:
        parts.append(f'<h3>Not judged</h3>\n<p class="muted">{escape(found.not_judged)}</p>')
    return parts


def _directions(found: Insight) -> list[Part]:
    directions = found.identifiability
    said = () if found.actuator.wide else directions.sentences()
    items = [words(_subscripts(sentence)) for sentence in said[:_MOST_SENTENCES]]
    if len(said) > _MOST_SENTENCES:
        items.append(f"and {len(said) - _MOST_SENTENCES} more")
    listed = "\n".join(f"<li>{item}</li>" for item in items)
    of = "ten plain elements" if found.actuator.wide else "the stiffnesses"
    caption = (
        f"The turning points of the records determine {directions.determined} of {directions.of} directions of "
        f"{of}, with the spring and each record's constant free. A singular value is the RMS voltage that one "
        "volt of breakaway voltages in its direction causes and no spring can cancel; hollow ones are open."
    )
    body = (f"<div><h3>In words</h3>\n<ul>\n{listed}\n</ul></div>",) if items else ()
    charts = Charts("", caption, (directions_chart(directions),), beside=body)
    return ["<h3>What the turning points determine</h3>", charts]


def directions_chart(found: Identifiability) -> Chart:
    """Return the singular value of each direction, filled if the records determine it, hollow if not."""
    values = np.maximum(found.values, _FOOT)
    order, known = np.arange(1.0, values.size + 1), np.arange(values.size) < found.determined
    series = (
        Series("determined", order[known], values[known], "measured", "points", 7),
        Series("open", order[~known], values[~known], "measured", "points", 7, hollow=True),
    )
    x = Axis("direction", "", (0.5, values.size + 0.5))
    y = Axis("singular value", "V/V", (0.8 * _FOOT, 2 * max(float(values.max()), _FOOT)), log=True)
    shown = tuple(one for one in series if one.x.size)
    return Chart("Singular values", "", "singular value of each direction,", x, y, shown)


def _subscripts(sentence: str) -> str:
    """Write k_12 as k₁₂."""
    each = sentence.split(" ")
    return " ".join("k" + word[2:].translate(_SUBSCRIPTS) if word.startswith("k_") else word for word in each)


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
    counts = ""
    if found.precision is not None:
        numbers: list[Row] = [
            (part.several.capitalize(), str(part.of_all), str(part.known), str(sum(map(abs, part.biased))))
            for part in found.precision.parts
        ]
        counts = table(("Number by number", "Coefficients", "Known", "Biased by noise"), numbers, texts=1)
        counts += f'\n<p class="muted">{escape(found.precision.rule)}</p>'
    title = "<h3>What the records determine of each part</h3>"
    return f'{title}\n<p class="muted">{caption}</p>\n{table(head, rows, texts=1)}\n{counts}'


def _spread(deviations: Array) -> list[str]:
    each = float(deviations.min()), float(np.median(deviations))
    return ["nothing" if np.isinf(x) else number(x, 2) for x in each]


def _part_intervals(found: Insight) -> list[Part]:
    if found.intervals is None:
        return []
    charts = () if found.loop is None else (loop_chart(found.loop),)
    caption = (
        f"{_level(found)} intervals from {len(found.intervals.actuators)} identifications of resampled cycles "
        f"(bootstrap) with the same structure. {_bias(found)}The largest error on the records, {length(found.misfit)}, "
        "comes on top: this structure cannot follow it. Single stiffnesses and the spring compensate one another: "
        "together they are more accurate."
    )
    charts = (*charts, *_drive_interval(found), *_creep_intervals(found))
    return ["<h3>How accurate the parts are</h3>", Charts("", caption, charts)]


def _level(found: Insight) -> str:
    return f"{100 * (found.intervals.level if found.intervals else 0):.0f} %"


def _bias(found: Insight) -> str:
    """Return why intervals by noise exclude estimates, where some do."""
    parts = () if found.precision is None else found.precision.parts
    return f"{NOISE_BIAS} " if any(any(part.biased) for part in parts) else ""


def loop_chart(loop: MajorLoopWidth) -> Chart:
    """Return the uncertainty of the displacement by noise on the rise and the fall through the limits."""
    low, high = (loop.noise - loop.displacement) * 1e9
    top = int(np.argmax(loop.voltage))
    branches: tuple[tuple[slice, Colour], ...] = ((slice(0, top + 1), "rising"), (slice(top, None), "falling"))
    series = tuple(
        Series(colour, loop.voltage[at], low[at], colour, "area", opacity=0.5, top=high[at]) for at, colour in branches
    )
    y = Axis("displacement, off the model's", "nm")
    return Chart("The major loop", "", "uncertainty of", Axis("voltage", "V"), y, series, zero=True)


def _drive_interval(found: Insight) -> list[Chart]:
    """Return the uncertainty of tau at its knots by noise."""
    tau, noise = found.actuator.transformer, found.intervals
    if tau is None or noise is None or noise.drive is None:
        return []
    low, high = noise.drive - tau.drive
    area = Series(f"{_level(found)} by noise", tau.voltage, low, "simulated", "area", opacity=0.6, top=high)
    axes = Axis("voltage", "V"), Axis("tau, off the model's", "V")
    return [Chart("Transformer", "", "uncertainty of", *axes, (area,), zero=True)]


def _creep_intervals(found: Insight) -> list[Chart]:
    """Return the stiffness of each creep branch with its interval by noise."""
    creep, noise = found.actuator.creep, found.intervals
    if creep is None or noise is None or noise.creep is None:
        return []
    low, high = noise.creep * 1e-6
    bars = stems(f"{_level(found)} by noise", creep.time_constants, high, "simulated", base=low, width=2.4)
    model = Series("model", creep.time_constants, creep.stiffness * 1e-6, "ink", "points", 5)
    x, y = Axis("time constant", "s", log=True), Axis("stiffness", "V/µm", (0.0, 1.2 * float(high.max())))
    return [Chart("Creep", "", "stiffness of each branch,", x, y, (*bars, model))]


def _intervals(found: Insight) -> list[Part]:
    noise, free, precision = found.intervals, found.feasible_set, found.precision
    if noise is None or free is None or precision is None:
        return []
    slip, level = found.actuator.slip, _level(found)
    movable, alone = found.identifiability.movable, found.identifiability.alone
    rows: list[Row] = []
    for i, (rho, kappa) in enumerate(zip(slip.breakaway, slip.stiffness, strict=True)):
        known = "", "never slides", "part of the spring"
        if movable[i]:
            verdict = precision.parts[0].words(int(movable[:i].sum())).replace("um", "µm")
            own = _pair(noise.stiffness[:, i] * 1e-6) if alone[i] else "open"
            known = own, _pair(free.stiffness[:, i] * 1e-6), verdict
        rows.append((str(i + 1), number(rho * 1e6, 4), number(kappa * 1e-6, 4), *known))
    head = ("i", "ρᵢ (µm)", "κᵢ (V/µm)", f"{level} by noise", "compatible", "verdict")
    caption = (
        f"By noise: {level} intervals from {len(noise.actuators)} identifications of resampled cycles "
        f"(bootstrap). {_bias(found)}An open stiffness "
        "is not determined by itself, whatever the noise. Compatible: the least and the largest value among all models "
        "that agree with the records nearly as well as this one. A stiffness may be uncertain while a sum of "
        f"neighbours is accurate; what counts for a motion is the band along its trajectory. {precision.rule}"
    )
    spring, (factor, unit) = found.actuator.spring, length_unit(float(np.ptp(found.actuator.spring.displacement)))
    centre, y = spring.voltage - spring.voltage[0], spring.displacement * factor
    areas = tuple(
        Series(name, y, ends[0] - centre, colour, "area", opacity=0.6, top=ends[1] - centre)
        for name, ends, colour in (
            ("compatible", free.spring, _FREE),
            (f"{level} by noise", noise.spring, _NOISE),
        )
    )
    axes = Axis("displacement", unit), Axis("spring voltage, off the model's", "V")
    return [
        "<h3>How accurate the numbers are</h3>",
        Charts(
            "",
            caption,
            (stiffness_chart(found), Chart("Parallel spring", "", "uncertainty of", *axes, areas, zero=True)),
        ),
        folded("The intervals' numbers", {"": table(head, rows, texts=0)}),
    ]


def stiffness_chart(found: Insight) -> Chart:
    """Return each stiffness with its interval by noise, and behind it its range among compatible models."""
    slip, noise, free, alone = found.actuator.slip, found.intervals, found.feasible_set, found.identifiability.alone
    factor, unit = length_unit(float(slip.breakaway[-1]))
    rho = slip.breakaway * factor
    series: list[Series] = []
    if free is not None:
        low, high = free.stiffness * 1e-6
        series += stems("compatible", rho, high, _FREE, base=low, width=6)
    if noise is not None and alone.any():
        low, high = noise.stiffness[:, alone] * 1e-6
        series += stems(f"{_level(found)} by noise", rho[alone], high, _NOISE, base=low, width=2.4)
    series.append(Series("model", rho, slip.stiffness * 1e-6, "ink", "points", 5))
    axes = Axis("breakaway elongation", unit, (0.0, 1.05 * float(rho[-1]))), Axis("stiffness", "V/µm")
    return Chart("Stiffnesses", "", "stiffness of each element,", *axes, tuple(series))


def _pair(ends: Sequence[float] | Array) -> str:
    return f"{number(float(ends[0]))} to {number(float(ends[1]))}"
