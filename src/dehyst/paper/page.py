"""The paper's experiment on a virtual actuator as one self-contained HTML page."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from dehyst._views.html import escape
from dehyst.paper import tables
from dehyst.paper.experiment import CYCLES, DRIVE, PEAKS, Experiment, PaperTrial
from dehyst.paper.figures import Plate
from dehyst.report import MINUS, Row, bullets, document, table

_STYLE = """.plate svg{max-width:62rem}.plate.one svg{max-width:31rem}
.plate svg text,.plate svg tspan{font-family:"DejaVu Sans","Bitstream Vera Sans",Verdana,Arial,sans-serif!important}
.plate .files{font-size:.85rem;margin:.3rem 0}
th small{display:block;font-weight:400;color:#666}
td.text,th.text{min-width:9.5rem}
h3{margin-top:1rem}
"""
_NORMS = {"l1": "absolute sum", "l2": "sum of squares"}
_TITLE = "The paper's experiment on a virtual actuator"
_SOURCE = (
    "T.-J. Yeh, S.-W. Lu, T.-Y. Wu, Modeling and Identification of Hysteresis in Piezoelectric Actuators, ASME J. Dyn. "
    "Syst. Meas. Control 128 (2006) 189–196, DOI 10.1115/1.2192819"
)


def render(found: Experiment, symmetric: Experiment, plates: Sequence[Plate], files: Sequence[str]) -> str:
    """Return the text of the page; the same text for the same experiments.

    `found`, `symmetric`: with the virtual E-280.10, and with the same without its asymmetric map. `files`: names of the
    files in the page's folder.
    """
    others = [name for name in files if not name.startswith("fig")]
    reproduce = (
        "<h2>How to reproduce</h2>\n<pre>dehyst paper -o DIR</pre>\n"
        '<p class="muted">Everything is seeded: the same numbers each time. All of them are in the files beside this '
        f"page: {_links(others)}</p>"
    )
    parts = [
        f"<h1>{_TITLE}</h1>",
        _muted(_SOURCE),
        _facts(found),
        _summary("The paper's numbers and ours: the virtual E-280.10", found),
        _summary("The same actuator without its asymmetric map", symmetric),
        _limits({"Virtual E-280.10": found, "Without its asymmetric map": symmetric}),
        _table1(found),
        *(_figure(plate, files) for plate in plates),
        bullets(
            "Where this differs from the paper, and why",
            (f"<strong>{name}.</strong> {_typeset(text)}" for name, text in _differences(found).items()),
        ),
        reproduce,
    ]
    return document(_TITLE, parts).replace("</style>", f"{_STYLE}</style>", 1)


def _muted(text: str) -> str:
    return f'<p class="muted">{escape(text, quote=False)}</p>'


def _facts(found: Experiment) -> str:
    truth = found.truth
    peaks = ", ".join(f"{peak:g}" for peak in PEAKS.values())
    facts = (
        f"{truth.plays} play operators of the voltage with an asymmetric map: not an instance of the model",
        f"{1e6 * truth.stroke:.3f} µm at {truth.highest:g} V",
        f"sensor noise {1e9 * truth.noise:g} nm",
        f"raised cosines of {peaks} V at {DRIVE.frequency:g} Hz, {CYCLES} cycles each, {DRIVE.rate:g} samples a second",
    )
    return _muted(" · ".join(facts))


def _summary(title: str, found: Experiment) -> str:
    head: Row = ("Quantity", "Paper", ("Measured", "no model"), *tables.MODELS.values())
    rows = []
    for row in tables.summary(found):
        paper = "–" if row.paper is None else f"{row.paper:g} {row.unit}"
        cells: list[str | tuple[str, str]] = [row.words, paper, _value(row.actuator, row.unit)]
        for key in tables.MODELS:
            value, noisy = _value(row.models.get(key), row.unit), row.against_noise.get(key)
            cells.append(value if noisy is None else (value, _value(noisy, row.unit)))
        rows.append(cells)
    note = _muted(
        "Largest errors in % of the range of the major loop, against the truth, which is known here; in small print: "
        "against the measurement with its noise. Simulated from the voltage alone, from the first peak on; no constant "
        "is fitted. The major and the small loop were fitted, the medium one was not."
    )
    return f"<h2>{escape(title)}</h2>\n{note}\n{table(head, rows, texts=1)}"


def _value(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{value:.{3 if unit == 'µm' else 2}f} {unit}".replace("-", MINUS)


def _limits(experiments: Mapping[str, Experiment]) -> str:
    loops = (f"{loop.capitalize()} loop" for loop in PEAKS)
    head: Row = ("Identification", "N", ("Residuals", "what is least"), *loops, "Tracking", "Outcome")
    parts = ["<h2>What limits the errors</h2>"]
    for title, found in experiments.items():
        rows: list[Row] = []
        for row in tables.limits(found):
            method = "The paper's method" if not row["whole"] else "Whole record"
            given = "descending tops added" if row["descending_tops"] else ""
            given = "perfect sensor" if row["perfect_sensor"] else given
            errors = (_value(row[key], "%") for key in (*PEAKS, "tracking"))
            outcome = row["outcome"].replace("_", " ").lower()
            rows.append(((method, given), str(row["elements"]), _NORMS[row["norm"]], *errors, outcome))
        under = tables.floors(found)
        chords = ", ".join(f"{under[f'chords_{n}']:.2f} % (N = {n})" for n in (10, 20, 40))
        note = (
            f"On the major loop, chords through N + 1 points of a branch are wrong by {chords}. The loop of every "
            "plain Maxwell-slip model is equally wide at mirrored places; such a model is wrong by at least "
            f"{under['symmetric_width']:.2f} %."
        )
        parts.append(f"<h3>{title}</h3>\n{table(head, rows, texts=1)}\n{_muted(note)}")
    return "\n".join(parts)


def _table1(found: Experiment) -> str:
    columns = tables.table1(found)
    names = ("kᵢ (N/m)", "fᵢ (N)")
    methods = ((name, method) for method in ("paper's method", "whole record") for name in names)
    formats = ("{:.0f}", "{:.2f}", "{:.0f}", "{:.4f}", "{:.0f}", "{:.4f}")
    numbers = zip(*columns.values(), strict=True)
    rows = [tuple(shape.format(x) for shape, x in zip(formats, row, strict=True)) for row in numbers]
    ratio, mechanical, electrical = tables.CONSTANTS.values()
    note = (
        f"With the paper's T = {ratio:g} N/V, km = {mechanical:.3g} N/m and ke = {electrical:.3g} N/m. The paper's own "
        f"numbers are not in the readable text. {_open_directions(found.trials['record_10'])} So single values, "
        "especially zeros, belong to one of many optima."
    )
    title = "<h2>Table 1: stiffness and breakaway friction, N = 10</h2>"
    return f"{title}\n{_muted(note)}\n{table(('i', 'rᵢ (µm)', *methods), rows, texts=0)}"


def _open_directions(trial: PaperTrial) -> str:
    """Return the identification's sentence about directions that its records leave open; empty if there are none."""
    return next((f"{remark.split(';')[0]}." for remark in trial.remarks if "directions" in remark), "")


def _figure(plate: Plate, files: Sequence[str]) -> str:
    own = [name for name in files if name.startswith(f"{plate.name}.") or name.startswith(f"{plate.name}-")]
    title = escape(f"Fig. {plate.number}: {plate.title}")
    image = plate.drawing.inline.replace("<svg", f'<svg role="img" aria-label="{title}"', 1)
    return (
        f'<h2>{title}</h2>\n<figure class="plate {"two" if plate.wide else "one"}">\n{image}\n'
        f'<p class="files">{_links(own)}</p>\n<figcaption>{_typeset(plate.caption)}</figcaption>\n</figure>'
    )


def _links(files: Sequence[str]) -> str:
    return " · ".join(f'<a href="{escape(name)}">{escape(name)}</a>' for name in files)


def _typeset(sentence: str) -> str:
    return re.sub(r"(?<![\w.-])-(?=\d)", MINUS, escape(sentence, quote=False))


def _differences(found: Experiment) -> dict[str, str]:
    """Return where the experiment differs from the paper, by heading."""
    p = tables.physical(found, "breakpoints")
    minor = " and ".join(f"{peak:g}" for name, peak in PEAKS.items() if name != "major")
    return {
        "The grid": "Ten chords are wrong where the loop bends after its turning points, also on a parabola "
        "(Rayleigh's law). The paper's 0.2 % requires a sharper bend, or an error counted at break points only.",
        "The model class": "At mirrored displacements the branches of a Maxwell-slip model are equally far apart; "
        "those of this actuator are not, because an asymmetric map follows its loop.",
        "Open directions": _open_directions(found.trials["record"]) + " Descending tops in the training close them.",
        "The constants": f"T/km = {1e9 * p.transformer_ratio / p.mechanical_stiffness:.0f} nm/V makes 6 µm of 200 V, "
        "not 16.152: keq x is much too stiff, and g comes out strongly negative. An element as long as half of the "
        "range, k₁₀, never slides over all of it and acts as part of the spring.",
        "Chosen here": f"Peaks of the minor loops ({minor} V), {CYCLES} cycles in one run with one zero of the sensor, "
        "errors in % of the major loop, and the share of plays that gives the paper's error of the nominal ratio.",
        "Not simulated": "Creep, lag, inertia, temperature. Tracking errors are against the truth, the paper's against "
        "its sensor.",
    }
