"""`dehyst paper`: the experiment on two virtual actuators, its figures, and its tables on one self-contained page."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dehyst._io import PathLike, made_folder, write_atomically, write_json
from dehyst._text import escape
from dehyst._types import Progress
from dehyst.paper import experiment, tables
from dehyst.paper.experiment import Experiment
from dehyst.report import MINUS, Row, document, table

if TYPE_CHECKING:
    from dehyst.paper.figures import Plate

_ACTUATORS = {"asymmetric": "virtual E-280.10", "symmetric": "without its asymmetric map"}
_TITLE = "The paper's experiment on a virtual actuator"
_SOURCE = (
    "T.-J. Yeh, S.-W. Lu, T.-Y. Wu, Modeling and Identification of Hysteresis in Piezoelectric Actuators, ASME J. Dyn. "
    "Syst. Meas. Control 128 (2006) 189-196, DOI 10.1115/1.2192819. Everything is seeded."
)
_OF_SUMMARY = (
    "Largest errors against the truth, in % of the range of the major loop, from the first peak on. The models are "
    "simulated from the voltage alone; no constant is fitted. Ten straight segments miss the loop after its "
    "turning points by about 1 %: the paper's 0.2 % needs a sharper bend."
)
_OF_TABLE1 = (
    "With the paper's T, km and ke; the paper's values are not legible in its text. T/km gives 6 µm at 200 V, not "
    "16.152: keq x is much too stiff, and g becomes strongly negative. The loops do not determine all combinations of "
    "stiffnesses: single values, especially zeros and k₁₀, belong to one of many optima."
)
_STYLE = """.plate svg{max-width:62rem}.plate.one svg{max-width:31rem}
.plate svg text,.plate svg tspan{font-family:"DejaVu Sans","Bitstream Vera Sans",Verdana,Arial,sans-serif!important}
th small{display:block;font-weight:400;color:#666}
"""


@dataclass(frozen=True, eq=False)
class Paper:
    """The result of the experiment.

    `asymmetric`: with the virtual E-280.10. `symmetric`: with the same actuator without its asymmetric map. The
    difference between the two is due to the model class.
    """

    asymmetric: Experiment
    symmetric: Experiment

    @property
    def experiments(self) -> dict[str, Experiment]:
        """Both experiments by name."""
        return {name: getattr(self, name) for name in _ACTUATORS}

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values: errors in % of the range of the major loop, lengths in um."""
        experiments = {name: tables.as_dict(result) for name, result in self.experiments.items()}
        return {"paper": dict(tables.PAPER), "constants": dict(tables.CONSTANTS), **experiments}


def run(progress: Progress = lambda _: None) -> Paper:
    """Run the paper's protocol, identify and track; seeds make the result reproducible."""

    def of(name: str) -> Experiment:
        truth = experiment.virtual_actuator(asymmetric=name == "asymmetric")
        return experiment.run(truth, lambda words: progress(f"{_ACTUATORS[name]}: {words}"))

    return Paper(of("asymmetric"), of("symmetric"))


def write(result: Paper, folder: PathLike, progress: Progress = lambda _: None) -> list[Path]:
    """Write every figure (SVG, PNG), the numbers and a page to a folder; return the paths.

    Files are index.html, results.json with the numbers of all tables, and figNN.svg and .png. Each file is written
    whole, the page last; if a figure cannot be drawn, no file is written. `progress` reports each figure before it is
    drawn. Raise `FileFormatError` if the folder cannot be made or written to, `MissingExtraError` without matplotlib.
    """
    from dehyst.paper.figures import plates

    target = made_folder(folder)
    drawn = list(plates(result.asymmetric, result.symmetric, progress))
    progress("writing")
    numbers = target / "results.json"
    write_json(numbers, {"format": "dehyst-paper", "version": 1, **result.as_dict()})
    written = [path for plate in drawn for path in plate.drawing.save(target / plate.name)]
    write_atomically(target / "index.html", page(result, drawn))
    return [target / "index.html", *written, numbers]


def page(result: Paper, plates: Sequence[Plate]) -> str:
    """Return the text of the page; equal experiments give equal text."""
    parts = [f"<h1>{_TITLE}</h1>", _muted(_SOURCE), *_tables(result), *map(_figure, plates)]
    return document(_TITLE, parts).replace("</style>", f"{_STYLE}</style>", 1)


def _tables(result: Paper) -> Iterator[str]:
    """Yield the summary of both actuators, and Table 1."""
    for name, found in result.experiments.items():
        yield f"<h2>{_ACTUATORS[name].capitalize()}</h2>\n{_muted(_OF_SUMMARY)}"
        yield table(("Quantity", "Paper", ("Measured", "no model"), *tables.MODELS.values()), _summary(found), texts=1)
    yield f"<h2>Table 1: stiffness and breakaway friction, N = 10</h2>\n{_muted(_OF_TABLE1)}"
    numbers = zip(*tables.table1(result.asymmetric).values(), strict=True)
    rows = [(f"{i:.0f}", f"{r:.2f}", f"{k:.0f}", f"{f:.4f}") for i, r, k, f in numbers]
    yield table(("i", "rᵢ (µm)", "kᵢ (N/m)", "fᵢ (N)"), rows, texts=0)


def _summary(found: Experiment) -> Iterator[Row]:
    for row in tables.summary(found):
        unit, paper = row["unit"], row["paper"]
        values = (_value(row[key], unit) for key in ("actuator", *tables.MODELS))
        yield (row["quantity"], "–" if paper is None else f"{paper:g} {unit}", *values)


def _value(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{value:.{3 if unit == 'µm' else 2}f} {unit}".replace("-", MINUS)


def _figure(plate: Plate) -> str:
    title = escape(f"Fig. {plate.number}: {plate.title}")
    image = plate.drawing.inline.replace("<svg", f'<svg role="img" aria-label="{title}"', 1)
    caption = re.sub(r"(?<![\w.-])-(?=\d)", MINUS, escape(plate.caption, quote=False))
    figure = f'<figure class="plate {"two" if plate.wide else "one"}">\n{image}\n<figcaption>{caption}</figcaption>'
    return f"<h2>{title}</h2>\n{figure}\n</figure>"


def _muted(text: str) -> str:
    return f'<p class="muted">{escape(text, quote=False)}</p>'
