"""The assessment of a model: sections of the report, or a separate page."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from dehyst._io import PathLike, write_atomically
from dehyst._types import Array
from dehyst.control import Homing
from dehyst.identification import Identifiability
from dehyst.report import html
from dehyst.report.charts import Axis, Chart, Colour, Series, stems
from dehyst.report.html import Charts, Part, Row, escape, length, length_unit, number, words
from dehyst.trust import (
    ERRORS,
    NOISE_BIAS,
    SHARP,
    Insight,
    MajorLoopWidth,
    PredictionBand,
    StageInsight,
    Turn,
    TurnPlane,
)

# Singular values below this are rounding; drawn at the foot of the scale.
_FOOT = 1e-5
_MOST_SENTENCES = 24
_INDEX, _SUBSCRIPTS = re.compile(r"\bk_(\d+)"), str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
# What models that the records do not contradict leave open, and what noise does.
_FREE: Colour = "noise"
_NOISE: Colour = "simulated"


def write_insight(path: PathLike, found: Insight | StageInsight, *, command: str | None = None) -> None:
    """Write an assessment to a self-contained HTML file.

    `path`, `command` and errors are as in `write_report`; `found` is the assessment, of one axis or of several.
    """
    if not isinstance(found, Insight):
        _write_stage_insight(path, found, command)
        return
    name = escape(found.actuator.name)
    records = ", ".join(escape(one.record.name) for one in found.evidence.comparisons)
    parts = [
        f"<h1>{name}: how far to trust the model</h1>",
        f'<p class="muted">Records: {records} · stroke {escape(length(found.evidence.stroke))}</p>',
        *sections(found, found.turns),
        html.reproduction(command),
    ]
    write_atomically(path, html.document(f"{found.actuator.name}: insight", parts))


def _write_stage_insight(path: PathLike, found: StageInsight, command: str | None) -> None:
    """Write the coupling with its intervals, and the sections of each axis."""
    half = (found.high - found.low) / 2
    matrix: list[Row] = [
        (axis, *("1" if i == j else f"{found.coupling[i, j]:+.5f} ± {half[i, j]:.5f}" for j in range(len(found.axes))))
        for i, axis in enumerate(found.axes)
    ]
    caption = (
        "Displacement of each axis (row) for each metre that an actuator (column) moves, with half the interval that "
        f"the records allow ({100 * found.level:g} %)."
    )
    parts: list[Part] = [
        "<h1>Coupled axes: how far to trust the model</h1>",
        f"<h2>Coupling</h2><p>{escape(caption)}</p>{html.table(('axis', *found.axes), matrix, 1)}",
        html.bullets("Remarks", map(words, found.remarks)),
    ]
    for axis, one in zip(found.axes, found.insights, strict=True):
        parts += [f"<h2>Axis {escape(axis)}</h2>", *sections(one, one.turns)]
    write_atomically(path, html.document("Coupled axes: insight", [*parts, html.reproduction(command)]))


def sections(found: Insight, plane: TurnPlane | None) -> list[Part]:
    """Return the sections of a page or of the report: the answer first, single numbers folded.

    `plane`: plane of the records' turning points, shown if given.
    """
    band = found.band
    return [
        _verdict(found),
        *_trajectory(found),
        *turned(plane, () if plane is None or band is None else plane.path(band.voltage, band.time)),
        _next(found),
        _state(found),
        "<details>\n<summary>Which numbers of the model the records determine</summary>",
        *_numbers(found),
        "</details>",
    ]


def _verdict(found: Insight) -> str:
    """Return the error to expect, then the warnings."""
    stroke, warnings = found.evidence.stroke, found.warnings()
    promised, path = found.judgement.words(stroke), "any path" if found.band is None else "this path"
    expected = f"Expect {path} {promised}." if promised else "The error to expect is not known."
    untested = found.judgement.untested
    expected = " ".join([expected, *untested])
    # Of a path that nobody has asked for it is said, and no more.
    new = bool(untested) and found.band is not None
    title = "Warning" if warnings else "In part not tested" if new else "No warnings"
    share = number(100 * found.misfit / stroke)
    lines = "".join(f"<li>{words(warning)}</li>" for warning in warnings)
    return (
        f'<div class="outcome {"amber" if warnings or new else "green"}" role="status">'
        f"<strong>{title}</strong>"
        f'<p class="first">{words(expected)}</p><p>The largest error of the model on these records is {share} % of '
        f"the stroke.</p>{f'<ul>{lines}</ul>' if lines else ''}</div>"
    )


def _trajectory(found: Insight) -> list[Part]:
    """Return the promise along a path; empty without one."""
    band, stroke = found.band, found.evidence.stroke
    if band is None:
        return []
    rows: list[Row] = [
        (ERRORS[key], f"{number(100 * error / stroke)} %", length(error))
        for key, error in band.errors().items()
        if error or key != "clamped"
    ]
    beside = f"<div><h3>Causes of the error</h3>\n{html.table(('From', 'of stroke', ''), rows, 1)}</div>"
    caption = "The promise: how far the displacement may be from the wanted path if the compensating voltage is played."
    factor, unit = length_unit(float(np.ptp(band.displacement)))
    axis, x = _clock(band)
    path = [
        _area("may be reached", x, (band.lowest * factor, band.highest * factor), "measured", 0.25),
        Series("wanted", x, band.wanted * factor, "ink", width=1.8),
    ]
    charts = Chart("Path", axis, Axis("displacement", unit), path), band_chart(band, stroke)
    return [Charts("The promise along the path", caption, charts, beside=(beside,))]


def _clock(band: PredictionBand) -> tuple[Axis, Array]:
    """Return time, or the number of the sample where no time was given."""
    if band.time is None:
        return Axis("sample"), np.arange(band.wanted.size, dtype=np.float64)
    return Axis("time", "s"), band.time


def _area(name: str, x: Array, edges: Sequence[Array] | Array, colour: Colour, opacity: float = 0.6) -> Series:
    low, high = edges
    return Series(name, x, low, colour, "area", opacity=opacity, top=high)


def band_chart(band: PredictionBand, stroke: float) -> Chart:
    """Return the error to expect along a path, part by part [% of a stroke in m]."""
    axis, x = _clock(band)
    kinds: tuple[tuple[str, Sequence[Array] | Array | None, Colour, float], ...] = (
        ("promise", (band.lowest, band.highest), "measured", 0.3),
        ("compatible with the records", band.open, "without", 0.6),
        ("noise", band.noise, _NOISE, 0.8),
    )
    series = [
        _area(name, x, [100 * (edge - band.wanted) / stroke for edge in edges], colour, opacity)
        for name, edges, colour, opacity in kinds
        if edges is not None
    ]
    return Chart("Error", axis, Axis("error", "% of stroke"), series, zero=True)


def turned(plane: TurnPlane | None, path: Sequence[Turn] = ()) -> list[Part]:
    """Return where the records turned, how fast and how long they held, and the same of a path."""
    if plane is None:
        return []
    caption = (
        "Dots: voltages between which the records turned. Rings: the voltage was held there. Shaded: loops on which "
        "the model is tested, because both branches begin where a record turned and do not go beyond it."
    )
    rows: list[Row] = []
    turns = [*plane.turns, *path]
    for name in dict.fromkeys(turn.record for turn in turns):
        own = [turn for turn in turns if turn.record == name]
        speeds, held = [turn.speed for turn in own], max(turn.held for turn in own)
        speed = f"{number(min(speeds))} to {number(max(speeds))}" if np.isfinite(speeds).all() else "not known"
        rows.append((name, str(sum(turn.times for turn in own)), speed, number(held) if held else "none"))
    head = ("Record", "Branches", "Speed (V/s)", "Hold (s)")
    beside = f"<div><h3>How fast, and how long they held</h3>\n{html.table(head, rows, 1)}</div>"
    return [Charts("Where the records turned", caption, [_turns_chart(plane, path)], beside=(beside,))]


def _turns_chart(plane: TurnPlane, path: Sequence[Turn]) -> Chart:
    """Return the plane of turning points with the tested cells, and where a path turns."""
    ends, cells = plane.edges[[0, -1]], plane.cells.astype(np.float64)
    series = [
        Series("", plane.edges, plane.edges, "tested", "cells", values=cells, darkest=3.0, exact=True),
        Series("", ends, ends, "without", width=1),
        *_dots("records", plane.turns, "measured", 5),
        *_dots("this path", path, "simulated", 8),
    ]
    edge = 0.03 * float(np.ptp(ends))
    shown = float(ends[0]) - edge, float(ends[1]) + edge
    x, y = (Axis(f"{which} turning point", "V", shown) for which in ("lower", "upper"))
    notes = [("tested, paler: one branch of the loop only", "tested")]
    about = {"fastest": plane.speeds[1], "held": plane.longest_hold_at_turn}
    return Chart("Turning points", x, y, series, notes=notes, about=about)


def _dots(name: str, turns: Sequence[Turn], colour: Colour, width: float) -> list[Series]:
    """Return a dot for each turn, and a ring where the voltage was held."""
    series = []
    for held in (False, True):
        some = [turn for turn in turns if turn.held > 0 or not held]
        if some:
            lower, upper = np.sort([(turn.begin, turn.end) for turn in some]).T
            words = tuple(turn.words for turn in some)
            size = width + 4 if held else width
            series.append(Series(name, lower, upper, colour, "points", size, names=words, hollow=held))
    return series[::-1]


def _next(found: Insight) -> str:
    title, directions = "<h2>What to record next</h2>", found.identifiability
    if not found.advice:
        if directions.determined < directions.of:
            return ""
        sentence = "Nothing: no loop determines more directions."
        if found.precision is not None and not found.precision.all_known:
            sentence = f"No loop determines more directions. {found.precision.next}"
        return f'{title}\n<p class="muted">{escape(sentence)}</p>'
    rows: list[Row] = [
        ((one.words, one.command), f"{one.determined} of {one.of}", number(one.weakest, 2), f"{one.seconds:.4g} s")
        for one in found.advice[:6]
    ]
    return f"{title}\n{html.table(('Excitation', 'Known with it', 'Weakest (V/V)', 'Time'), rows, texts=1)}"


def _state(found: Insight) -> str:
    """Return a table of when the state becomes known, and the homing."""

    def moment(seconds: float | None) -> str:
        return "never" if seconds is None else f"{number(seconds)} s"

    rows: list[Row] = [
        (known.record, moment(known.by_displacement), moment(known.by_voltage) if known.judged else "not judged")
        for known in found.knowledge
    ]
    head = ("Record", "from the measured displacement", "from the voltage alone")
    homing = "" if found.homing is None else _homing(found.homing, creeps=found.actuator.creep_times.size > 0)
    return f"<h2>When the state becomes known</h2>\n{html.table(head, rows, texts=1)}\n{homing}"


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
    known = "The precision of its numbers was not judged, because there are no intervals."
    return [
        f"<p>{words(known if precision is None else precision.sentence)}</p>",
        *_directions(found),
        _parts(found),
        *_part_intervals(found),
        *_intervals(found),
        f'<h3>Not judged</h3>\n<p class="muted">{escape(found.not_judged)}</p>' if found.not_judged else "",
    ]


def _directions(found: Insight) -> list[Part]:
    directions, said = found.identifiability, found.identifiability.sentences()
    # k_12 is written as k₁₂.
    each = [
        [w.translate(_SUBSCRIPTS).replace("_", "") if w.startswith("k_") else w for w in s.split(" ")] for s in said
    ]
    items = [words(" ".join(sentence)) for sentence in each[:_MOST_SENTENCES]]
    if len(said) > _MOST_SENTENCES:
        items.append(f"and {len(said) - _MOST_SENTENCES} more")
    listed = "\n".join(f"<li>{item}</li>" for item in items)
    caption = (
        f"The turning points of the records determine {directions.determined} of {directions.of} directions of "
        f"{directions.subject}, with the spring and each record's constant free. A singular value is the RMS voltage "
        "that one volt of breakaway voltages in its direction causes, without the part that a spring can cancel. "
        "Hollow: open."
    )
    body = (f"<div><h3>In words</h3>\n<ul>\n{listed}\n</ul></div>",) if items else ()
    charts = Charts("", caption, [directions_chart(directions)], beside=body)
    return ["<h3>What the turning points determine</h3>", charts]


def directions_chart(found: Identifiability) -> Chart:
    """Return the singular value of each direction, filled if the records determine it, hollow if not."""
    values = np.maximum(found.values, _FOOT)
    order, known = np.arange(1.0, values.size + 1), np.arange(values.size) < found.determined
    series = [
        Series("determined", order[known], values[known], "measured", "points", 7),
        Series("open", order[~known], values[~known], "measured", "points", 7, hollow=True),
    ]
    x = Axis("direction", "", (0.5, values.size + 0.5))
    y = Axis("singular value", "V/V", (0.8 * _FOOT, 2 * max(float(values.max()), _FOOT)), log=True)
    return Chart("Singular values", x, y, [one for one in series if one.x.size])


def _parts(found: Insight) -> str:
    rows: list[Row] = []
    for part in found.parts:
        spread = float(part.deviations.min()), float(np.median(part.deviations))
        best = ("nothing" if np.isinf(x) else number(x, 2) for x in spread)
        rows.append((part.part.capitalize(), str(part.of), str(part.known), *best))
    head = ("Part", "Coefficients", "Combinations known", "Best known to (V)", "Half of them to (V)")
    caption = (
        "A combination of a part's coefficients, counted as the volts that they hold, is known if its standard "
        f"deviation is at most {100 * SHARP:g} % of the voltages, with all other parts free to compensate for it. "
        "A combination that is not known by itself may be accurate together with other parts. For a motion, only the "
        "band along it counts."
    )
    counts = ""
    if found.precision is not None:
        numbers: list[Row] = [
            (part.several.capitalize(), str(part.of_all), str(part.known), str(sum(map(abs, part.biased))))
            for part in found.precision.parts
        ]
        counts = html.table(("Number by number", "Coefficients", "Known", "Biased by noise"), numbers, texts=1)
        counts += f'\n<p class="muted">{escape(found.precision.rule)}</p>'
    title = "<h3>What the records determine of each part</h3>"
    return f'{title}\n<p class="muted">{caption}</p>\n{html.table(head, rows, texts=1)}\n{counts}'


def _part_intervals(found: Insight) -> list[Part]:
    noise, tau, creep = found.intervals, found.actuator.transformer, found.actuator.creep
    if noise is None:
        return []
    charts = [] if found.loop is None else [loop_chart(found.loop)]
    by_noise = f"{100 * noise.level:.0f} % by noise"
    if tau is not None and noise.drive is not None:
        area = _area(by_noise, tau.voltage, noise.drive - tau.drive, _NOISE)
        charts.append(Chart("Transformer", Axis("voltage", "V"), Axis("tau, off the model's", "V"), [area], zero=True))
    if creep is not None and noise.creep is not None:
        low, high = noise.creep * 1e-6
        bars = stems(by_noise, creep.time_constants, high, _NOISE, base=low, width=2.4)
        model = Series("model", creep.time_constants, creep.stiffness * 1e-6, "ink", "points", 5)
        axes = Axis("time constant", "s", log=True), Axis("stiffness", "V/µm", (0.0, 1.2 * float(high.max())))
        charts.append(Chart("Creep", *axes, [*bars, model]))
    caption = (
        f"{100 * noise.level:.0f} % intervals from {len(noise.actuators)} identifications of resampled cycles "
        f"(bootstrap) with the same structure. {_bias(found)}The largest error on the records, {length(found.misfit)}, "
        "adds to this: this structure cannot follow it. Errors of single stiffnesses and of the spring compensate one "
        "another; the whole model is more accurate than its parts."
    )
    return ["<h3>How accurate the parts are</h3>", Charts("", caption, charts)]


def _bias(found: Insight) -> str:
    """Return why intervals by noise exclude estimates, where some do."""
    parts = () if found.precision is None else found.precision.parts
    return f"{NOISE_BIAS} " if any(any(part.biased) for part in parts) else ""


def loop_chart(loop: MajorLoopWidth) -> Chart:
    """Return the uncertainty of the displacement by noise on the rise and the fall through the limits."""
    off = (loop.noise - loop.displacement) * 1e9
    top = int(np.argmax(loop.voltage))
    branches: tuple[tuple[slice, Colour], ...] = ((slice(0, top + 1), "rising"), (slice(top, None), "falling"))
    series = [_area(colour, loop.voltage[at], off[:, at], colour, 0.5) for at, colour in branches]
    return Chart("The major loop", Axis("voltage", "V"), Axis("displacement, off the model's", "nm"), series, zero=True)


def _intervals(found: Insight) -> list[Part]:
    noise, free, precision = found.intervals, found.feasible_set, found.precision
    if noise is None or free is None or precision is None:
        return []
    slip, level = found.actuator.slip, f"{100 * noise.level:.0f} %"
    movable, alone = found.identifiability.movable, found.identifiability.alone
    rows: list[Row] = []
    for i, (rho, kappa) in enumerate(zip(slip.breakaway, slip.stiffness, strict=True)):
        known = "", "never slides", "part of the spring"
        if movable[i]:
            verdict = precision.parts[0].words(int(movable[:i].sum())).replace("um", "µm")
            own, other = (" to ".join(number(float(end) * 1e-6) for end in of.stiffness[:, i]) for of in (noise, free))
            known = own if alone[i] else "open", other, verdict
        rows.append((str(i + 1), number(rho * 1e6, 4), number(kappa * 1e-6, 4), *known))
    head = ("i", "ρᵢ (µm)", "κᵢ (V/µm)", f"{level} by noise", "compatible", "verdict")
    caption = (
        f"By noise: {level} intervals from {len(noise.actuators)} identifications of resampled cycles "
        f"(bootstrap). {_bias(found)}An open stiffness "
        "is not determined by itself, whatever the noise. Compatible: the least and the largest value among all models "
        "that agree with the records nearly as well as this one. A stiffness may be uncertain while a sum of "
        f"neighbours is accurate; what counts for a motion is the band along its trajectory. {precision.rule}"
    )
    spring = found.actuator.spring
    factor, unit = length_unit(float(np.ptp(spring.displacement)))
    centre, y = spring.voltage - spring.voltage[0], spring.displacement * factor
    areas = (
        _area("compatible", y, free.spring - centre, _FREE),
        _area(f"{level} by noise", y, noise.spring - centre, _NOISE),
    )
    axes = Axis("displacement", unit), Axis("spring voltage, off the model's", "V")
    return [
        "<h3>How accurate the numbers are</h3>",
        Charts("", caption, [stiffness_chart(found), Chart("Parallel spring", *axes, areas, zero=True)]),
        html.folded("The intervals' numbers", {"": html.table(head, rows, texts=0)}),
    ]


def stiffness_chart(found: Insight) -> Chart:
    """Return each stiffness with its interval by noise, and behind it its range among compatible models."""
    slip, noise, free = found.actuator.slip.stiffest(), found.intervals, found.feasible_set
    alone = found.identifiability.alone
    factor, unit = length_unit(float(slip.breakaway[-1]))
    rho = slip.breakaway * factor
    series: list[Series] = []
    if free is not None:
        low, high = free.stiffness * 1e-6
        series += stems("compatible", rho, high, _FREE, base=low, width=6)
    if noise is not None and alone.any():
        low, high = noise.stiffness[:, alone] * 1e-6
        series += stems(f"{100 * noise.level:.0f} % by noise", rho[alone], high, _NOISE, base=low, width=2.4)
    series.append(Series("model", rho, slip.stiffness * 1e-6, "ink", "points", 5))
    axes = Axis("breakaway elongation", unit, (0.0, 1.05 * float(rho[-1]))), Axis("stiffness", "V/µm")
    return Chart("Stiffnesses", *axes, series)
