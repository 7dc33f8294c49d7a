"""`dehyst paper`: the experiment of the paper on a virtual actuator, with every figure and table."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dehyst._io import PathLike, demand_own_folder, make_own_folder, write_atomically, write_json
from dehyst._types import Progress
from dehyst.records import write_columns
from dehyst.studies.paper import experiment, tables
from dehyst.studies.paper.experiment import Experiment
from dehyst.studies.paper.tables import MODELS, PAPER

if TYPE_CHECKING:
    from dehyst.studies.paper.figures import Plate

# A folder with this file is one of the paper's.
_OWN = ("results.json", "dehyst-paper")
_FIGURES = 12
_ACTUATORS = {"asymmetric": "virtual E-280.10", "symmetric": "without its asymmetric map"}


@dataclass(frozen=True, eq=False)
class Paper:
    """The result of the experiment.

    `asymmetric`: on the virtual E-280.10. `symmetric`: on the same without its asymmetric map: the difference between
    the two is due to the model class.
    """

    asymmetric: Experiment
    symmetric: Experiment

    @property
    def experiments(self) -> dict[str, Experiment]:
        """Both by name."""
        return {name: getattr(self, name) for name in _ACTUATORS}

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values: errors in % of the range of the major loop, lengths in um."""
        experiments = {name: tables.as_dict(result) for name, result in self.experiments.items()}
        return {"paper": dict(PAPER), "protocol": tables.protocol(), **experiments}


def run(progress: Progress = lambda _: None) -> Paper:
    """Run the paper's protocol, identify and track; seeded and thus reproducible."""

    def of(name: str) -> Experiment:
        truth = experiment.virtual_actuator(asymmetric=name == "asymmetric")
        return experiment.run(truth, lambda words: progress(f"{_ACTUATORS[name]}: {words}"))

    return Paper(of("asymmetric"), of("symmetric"))


def demand_folder(folder: PathLike) -> None:
    """Refuse a folder that is neither new, nor empty, nor one of an earlier run, with FileFormatError."""
    demand_own_folder(folder, *_OWN)


def write(result: Paper, folder: PathLike, progress: Progress = lambda _: None) -> list[Path]:
    """Write every figure (SVG, PNG, CSV), the tables, the numbers and a page to a folder; return the paths.

    Files are index.html, results.json, summary.csv, limits.csv, table1.csv, and figNN.svg, .png and, but for the
    schematics of Figs. 1 and 2, .csv. Each is written wholly or not at all, the page last, and none if a figure cannot
    be drawn. Each figure is reported to `progress` before it is drawn. Raise `FileFormatError` if the folder cannot be
    made or written to, or holds files that are not of this experiment. Raise `MissingExtraError` if matplotlib is not
    installed.
    """
    from dehyst.studies.paper.page import render

    target = make_own_folder(folder, *_OWN)
    drawn, written = _drawn(result, progress), []
    progress("writing")
    # First, so that the folder counts as the paper's even if it is not finished.
    write_json(target / _OWN[0], {"format": _OWN[1], "version": 1, **result.as_dict()})
    for plate in drawn:
        written += plate.drawing.save(target / plate.name)
        for suffix, columns in plate.data.items():
            written.append(target / f"{plate.name}{suffix}.csv")
            write_columns(written[-1], columns)
    write_columns(target / "table1.csv", tables.table1(result.asymmetric))
    for name, rows in (("summary.csv", _summary(result)), ("limits.csv", _limits(result))):
        write_atomically(target / name, _csv(rows))
    written += [target / name for name in ("results.json", "table1.csv", "summary.csv", "limits.csv")]
    page = render(result.asymmetric, result.symmetric, drawn, [path.name for path in written])
    write_atomically(target / "index.html", page)
    return [target / "index.html", *written]


def _drawn(result: Paper, progress: Progress) -> list[Plate]:
    """Draw Figs. 1 to 12."""
    from dehyst.studies.paper.figures import plates
    from dehyst.studies.paper.schematics import schematics

    drawn: list[Plate] = []
    progress(f"drawing Fig. 1 of {_FIGURES}")
    for plate in chain(schematics(), plates(result.asymmetric, result.symmetric)):
        drawn.append(plate)
        if plate.number < _FIGURES:
            progress(f"drawing Fig. {plate.number + 1} of {_FIGURES}")
    return drawn


def _summary(result: Paper) -> Iterator[list[Any]]:
    yield ["actuator", "quantity", "unit", "paper", "measured", *MODELS, *(f"{key}_against_noise" for key in MODELS)]
    for name, found in result.experiments.items():
        for row in tables.summary(found):
            models = [row.models.get(key) for key in MODELS] + [row.against_noise.get(key) for key in MODELS]
            yield [name, row.key, row.unit.replace("µ", "u"), row.paper, row.actuator, *models]


def _limits(result: Paper) -> Iterator[list[Any]]:
    first = True
    for name, found in result.experiments.items():
        for row in tables.limits(found):
            entries = row.as_dict()
            if first:
                yield ["actuator", *entries]
                first = False
            yield [name, *entries.values()]


def _csv(rows: Iterator[list[Any]]) -> str:
    """Write rows as CSV, with numbers at full precision and empty cells for None."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()
