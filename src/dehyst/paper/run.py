"""`dehyst paper`: the experiment of the paper on a virtual actuator, with its figures of results and its tables."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dehyst._io import PathLike, demand_own_folder, make_own_folder, write_atomically, write_json
from dehyst._types import Progress
from dehyst.paper import experiment, tables
from dehyst.paper.experiment import Experiment
from dehyst.records import write_columns

# A folder with this file is one of the paper's.
_OWN = ("results.json", "dehyst-paper")
_ACTUATORS = {"asymmetric": "virtual E-280.10", "symmetric": "without its asymmetric map"}


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
        return {"paper": dict(tables.PAPER), "protocol": tables.protocol(), **experiments}


def run(progress: Progress = lambda _: None) -> Paper:
    """Run the paper's protocol, identify and track; seeded and thus reproducible."""

    def of(name: str) -> Experiment:
        truth = experiment.virtual_actuator(asymmetric=name == "asymmetric")
        return experiment.run(truth, lambda words: progress(f"{_ACTUATORS[name]}: {words}"))

    return Paper(of("asymmetric"), of("symmetric"))


def demand_folder(folder: PathLike) -> None:
    """Raise FileFormatError if a folder is neither new, nor empty, nor of an earlier run."""
    demand_own_folder(folder, *_OWN)


def write(result: Paper, folder: PathLike, progress: Progress = lambda _: None) -> list[Path]:
    """Write every figure (SVG, PNG, CSV), the numbers and a page to a folder; return the paths.

    Files are index.html, results.json with the numbers of all tables, and figNN.svg, .png and .csv. Each is written
    wholly or not at all, the page last, and none if a figure cannot be drawn. Each figure is reported to `progress`
    before it is drawn. Raise `FileFormatError` if the folder cannot be made or written to, or holds files that are not
    of this experiment. Raise `MissingExtraError` if matplotlib is not installed.
    """
    from dehyst.paper.figures import plates
    from dehyst.paper.page import render

    target = make_own_folder(folder, *_OWN)
    drawn, written = list(plates(result.asymmetric, result.symmetric, progress)), list[Path]()
    progress("writing")
    # First, so that the folder counts as the paper's even if it is not finished.
    write_json(target / _OWN[0], {"format": _OWN[1], "version": 1, **result.as_dict()})
    for plate in drawn:
        written += plate.drawing.save(target / plate.name)
        for suffix, columns in plate.data.items():
            written.append(target / f"{plate.name}{suffix}.csv")
            write_columns(written[-1], columns)
    written.append(target / "results.json")
    page = render(result.asymmetric, result.symmetric, drawn, [path.name for path in written])
    write_atomically(target / "index.html", page)
    return [target / "index.html", *written]
