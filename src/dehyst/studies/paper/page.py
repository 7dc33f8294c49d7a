"""The paper's experiment on a virtual actuator as one self-contained HTML page."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from dehyst._views.html import escape
from dehyst.report.html import MINUS, Row, bullets, document, table
from dehyst.studies.paper.experiment import CYCLES, DRIVE, PEAKS, Experiment
from dehyst.studies.paper.figures import Plate
from dehyst.studies.paper.tables import (
    CONSTANTS,
    MODELS,
    Quantity,
    floors,
    limits,
    open_directions,
    physical,
    summary,
    table1,
)

_STYLE = """.plate svg{max-width:62rem}.plate.one svg{max-width:31rem}
.plate svg text,.plate svg tspan{font-family:"DejaVu Sans","Bitstream Vera Sans",Verdana,Arial,sans-serif!important}
.plate .files{font-size:.85rem;margin:.3rem 0}
th small{display:block;font-weight:400;color:#666}
td.text,th.text{min-width:9.5rem}
h3{margin-top:1rem}
"""
_TITLE = "The paper's experiment on a virtual actuator"
_SOURCE = (
    "T.-J. Yeh, S.-W. Lu, T.-Y. Wu, Modeling and Identification of Hysteresis in Piezoelectric Actuators, ASME J. Dyn. "
    "Syst. Meas. Control 128 (2006) 189–196, DOI 10.1115/1.2192819"
)


# By the paper's number.
_CAPTIONS = {
    1: "The voltage v acts as a force F = T v on a massless bar at x, held by km and ke in series, the nonlinear "
    "spring g and N slip elements: springs kᵢ on massless carts at xbᵢ, each with Coulomb friction up to fᵢ. Drawn "
    "anew after the paper's text and equations.",
    2: "(a) The physical model, Eqs. 1 and 2: the displacement drives the slip elements, whose forces return to the "
    "force balance. (b) The Preisach model as a sum: the voltage drives M relays with the switching values αᵢ, βᵢ.",
    3: "From the relaxed state. 0 V leads back to the residual displacement.",
    4: "(a) The loop and its image under a half-turn about its centre; break points of the descending (full) and the "
    "ascending branch (hollow). Lemma 2: without the nonlinear spring the two coincide. (b) Distance of the midpoints "
    "of pairs of break points from the centre, with and without the asymmetric map.",
    5: "The range from y(T₀) to y(T₀/2) in N equal parts. The paper's method uses only these points of the loop; its "
    "model is straight between a turning point and the first of them, the loop is not.",
    6: "(a) The same voltage from the relaxed state, and after a voltage that was applied and removed. (b) The "
    "difference, constant from the first peak on (Eq. 10), and the models' predictions of it.",
    7: "The major and the small loop were fitted, the medium one only simulated. Below: measured minus simulated in "
    "the last cycle.",
    8: "h = keq x + g rises everywhere: Assumption I holds. With the paper's constants g is strongly negative; only h "
    "matters.",
    9: "The medium loop, held out, where it turns. The model is straight until the first element slips.",
    10: "(a) Voltages for a raised cosine over the full range. (b) What inverse control adds to the nominal ratio.",
    11: "The path wanted, and the true displacement with the voltages of Fig. 10, after one cycle that makes the state "
    "known.",
    12: "Reached minus wanted. (c) is for an actuator that differs only in having no asymmetric map: the difference "
    "from (b) is due to the model class.",
}


def _differences(found: Experiment) -> dict[str, str]:
    """Return where the experiment differs from the paper, by heading."""
    p = physical(found, "breakpoints")
    minor = " and ".join(f"{peak:g}" for name, peak in PEAKS.items() if name != "major")
    return {
        "The grid": "Ten chords are wrong where the loop bends after its turning points, also on a parabola "
        "(Rayleigh's law). The paper's 0.2 % requires a sharper bend, or an error counted at break points only.",
        "The model class": "At mirrored displacements the branches of a Maxwell-slip model are equally far apart; "
        "those of this actuator are not, because an asymmetric map follows its loop.",
        "Open directions": open_directions(found.trials["record"]) + " Descending tops in the training close them.",
        "The constants": f"T/km = {1e9 * p.transformer_ratio / p.mechanical_stiffness:.0f} nm/V makes 6 µm of 200 V, "
        "not 16.152: keq x is much too stiff, and g comes out strongly negative. An element as long as half of the "
        "range, k₁₀, never slides over all of it and acts as part of the spring.",
        "Chosen here": f"Peaks of the minor loops ({minor} V), {CYCLES} cycles in one run with one zero of the sensor, "
        "errors in % of the major loop, and the share of plays that gives the paper's error of the nominal ratio.",
        "Not simulated": "Creep, lag, inertia, temperature. Tracking errors are against the truth, the paper's against "
        "its sensor.",
    }


def render(found: Experiment, symmetric: Experiment, plates: Sequence[Plate], files: Sequence[str]) -> str:
    """Return the text of the page; the same text for the same experiments.

    Parameters
    ----------
    found, symmetric : Experiment
        With the virtual E-280.10, and with the same without its asymmetric map.
    plates : sequence of Plate
    files : sequence of str
        Names of the files that lie beside the page.
    """
    parts = [
        f"<h1>{_TITLE}</h1>",
        f'<p class="muted">{escape(_SOURCE)}</p>',
        _facts(found),
        _summary("The paper's numbers and ours: the virtual E-280.10", found),
        _summary("The same actuator without its asymmetric map", symmetric),
        _limits({"Virtual E-280.10": found, "Without its asymmetric map": symmetric}),
        _table1(found),
        *(_plate(plate, _CAPTIONS[plate.number], files) for plate in plates),
        bullets(
            "Where this differs from the paper, and why",
            (f"<strong>{name}.</strong> {_typeset(text)}" for name, text in _differences(found).items()),
        ),
        _reproduce(files),
    ]
    return document(_TITLE, parts).replace("</style>", f"{_STYLE}</style>", 1)


def _facts(found: Experiment) -> str:
    truth = found.truth
    peaks = ", ".join(f"{peak:g}" for peak in PEAKS.values())
    facts = (
        f"{truth.plays} play operators of the voltage with an asymmetric map: not an instance of the model",
        f"{1e6 * truth.stroke:.3f} µm at {truth.highest:g} V",
        f"sensor noise {1e9 * truth.noise:g} nm",
        f"raised cosines of {peaks} V at {DRIVE.frequency:g} Hz, {CYCLES} cycles each, {DRIVE.rate:g} samples a second",
    )
    return f'<p class="muted">{escape(" · ".join(facts))}</p>'


def _summary(title: str, found: Experiment) -> str:
    head: Row = ("Quantity", "Paper", ("Measured", "no model"), *MODELS.values())
    rows: list[Row] = [
        (
            *(row.words, "–" if row.paper is None else f"{row.paper:g} {row.unit}", _value(row.actuator, row.unit)),
            *(_cell(row, key) for key in MODELS),
        )
        for row in summary(found)
    ]
    return (
        f"<h2>{escape(title)}</h2>\n"
        '<p class="muted">Largest errors in % of the range of the major loop, against the truth, which is known here; '
        "in small print: against the measurement with its noise. Simulated from the voltage alone, from the first peak "
        "on; no constant is fitted. The major and the small loop were fitted, the medium one was not.</p>\n"
        f"{table(head, rows, texts=1)}"
    )


def _cell(row: Quantity, key: str) -> str | tuple[str, str]:
    if key not in row.models:
        return "–"
    value = _value(row.models[key], row.unit)
    noisy = row.against_noise.get(key)
    return value if noisy is None else (value, _value(noisy, row.unit))


def _value(value: float | None, unit: str) -> str:
    if value is None:
        return "–"
    return f"{value:.{3 if unit == 'µm' else 2}f} {unit}".replace("-", MINUS)


def _limits(experiments: Mapping[str, Experiment]) -> str:
    loops = (f"{loop.capitalize()} loop" for loop in PEAKS)
    head: Row = ("Identification", "N", ("Residuals", "what is least"), *loops, "Tracking", "Outcome")
    tables = []
    for title, found in experiments.items():
        rows: list[Row] = [
            (
                row.words,
                str(row.plan.elements),
                row.norm,
                *(_value(error, "%") for error in row.errors.values()),
                row.outcome.replace("_", " ").lower(),
            )
            for row in limits(found)
        ]
        under = floors(found)
        chords = ", ".join(f"{under[f'chords_{n}']:.2f} % (N = {n})" for n in (10, 20, 40))
        note = (
            f"On the major loop, chords through N + 1 points of a branch are wrong by {chords}. The loop of every "
            "plain Maxwell-slip model is equally wide at mirrored places; such a model is wrong by at least "
            f"{under['symmetric_width']:.2f} %."
        )
        tables.append(f'<h3>{title}</h3>\n{table(head, rows, texts=1)}\n<p class="muted">{escape(note)}</p>')
    return "<h2>What limits the errors</h2>\n" + "\n".join(tables)


def _table1(found: Experiment) -> str:
    columns = table1(found)
    head: Row = (
        "i",
        "rᵢ (µm)",
        ("kᵢ (N/m)", "paper's method"),
        ("fᵢ (N)", "paper's method"),
        ("kᵢ (N/m)", "whole record"),
        ("fᵢ (N)", "whole record"),
    )
    formats = ("{:.0f}", "{:.2f}", "{:.0f}", "{:.4f}", "{:.0f}", "{:.4f}")
    numbers = zip(*columns.values(), strict=True)
    rows = [tuple(shape.format(x) for shape, x in zip(formats, row, strict=True)) for row in numbers]
    ratio, mechanical, electrical = CONSTANTS.values()
    note = (
        f"With the paper's T = {ratio:g} N/V, km = {mechanical:.3g} N/m and ke = {electrical:.3g} N/m. The paper's own "
        f"numbers are not in the readable text. {open_directions(found.trials['record_10'])} So single values, "
        "especially zeros, belong to one of many optima."
    )
    return (
        "<h2>Table 1: stiffness and breakaway friction, N = 10</h2>\n"
        f'<p class="muted">{escape(note, quote=False)}</p>\n{table(head, rows, texts=0)}'
    )


def _plate(plate: Plate, caption: str, files: Sequence[str]) -> str:
    own = [name for name in files if name.startswith(f"{plate.name}.") or name.startswith(f"{plate.name}-")]
    title = f"Fig. {plate.number}: {plate.title}"
    image = plate.drawing.inline.replace("<svg", f'<svg role="img" aria-label="{escape(title)}"', 1)
    links = " · ".join(f'<a href="{escape(name)}">{escape(name)}</a>' for name in own)
    return (
        f'<h2>{escape(title)}</h2>\n<figure class="plate {"two" if plate.wide else "one"}">\n{image}\n'
        f'<p class="files">{links}</p>\n<figcaption>{_typeset(caption)}</figcaption>\n</figure>'
    )


def _typeset(sentence: str) -> str:
    return re.sub(r"(?<![\w.-])-(?=\d)", MINUS, escape(sentence, quote=False))


def _reproduce(files: Sequence[str]) -> str:
    others = [name for name in files if not name.startswith("fig")]
    links = " · ".join(f'<a href="{escape(name)}">{escape(name)}</a>' for name in others)
    return (
        "<h2>How to reproduce</h2>\n<pre>dehyst paper -o DIR</pre>\n"
        '<p class="muted">Everything is seeded: the same numbers each time. All of them are in the files beside this '
        f"page: {links}</p>"
    )
