"""`demo` and `paper`: studies on virtual actuators."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from dehyst.operations.declaration import operation
from dehyst.operations.run import Result, Run
from dehyst.studies import demo as demonstration
from dehyst.studies.paper import Paper
from dehyst.studies.paper import run as experiment
from dehyst.studies.paper.tables import summary

_TITLES = {
    "asymmetric": "Virtual E-280.10",
    "symmetric": "The same without its asymmetric map: these errors come from the method, not from the model class",
}
_WIDTHS = (9, 12, 13, 12, 12)
_HEADS = (
    ("paper", "ours, by", "ours, whole", "with more", "Goldfarb,"),
    ("", "its method", "record", "loops", "relaxed"),
)


@operation()
def demo(run: Run, *, output: Path = Path("dehyst-demo"), report: bool = True) -> Result:
    """Record, identify, compensate and verify on an embedded virtual actuator.

    Parameters
    ----------
    output
        Folder for the files: new, empty, or an earlier demo's.
    report
        Draw the report.
    """
    demonstration.demand_folder(output)
    result = demonstration.run(run.progress)
    run.progress("writing")
    written = demonstration.write(result, output, report=report)
    numbers = result.as_dict()
    lines = [*result.fit.summary().split("\n"), ""]
    lines.append("Tracking a path with nine reversals, largest error in % of the stroke")
    for name, key in (("linear feedforward (end-point ratio)", "linear"), ("dehyst", "compensated")):
        largest, rms = numbers[key]["largest_percent"], numbers[key]["rms_percent"]
        paper = numbers["paper"][f"{key}_largest_percent"]
        lines.append(f"  {name:<38}{largest:7.2f} %   RMS {rms:5.2f} %   (paper {paper:5.2f} %)")
    lines += ["", f"Written to {output}/: {', '.join(path.name for path in written)}"]
    return Result({**numbers, "written": [str(path) for path in written]}, lines)


@operation()
def paper(run: Run, *, output: Path = Path("dehyst-paper")) -> Result:
    """Repeat the experiment of the paper on a virtual actuator: its tables and its figures of results.

    Parameters
    ----------
    output
        Folder for the files: new, empty, or one of an earlier run.
    """
    experiment.demand_folder(output)
    result = experiment.run(run.progress)
    written = experiment.write(result, output, run.progress)
    lines = [*_table(result), f"Written to {output}/: open index.html"]
    return Result({**result.as_dict(), "written": [str(path) for path in written]}, lines)


def _table(found: Paper) -> list[str]:
    """Return the numbers of the paper and of this package for both virtual actuators."""
    lines = []
    for key, one in found.experiments.items():
        lines.append(f"{_TITLES[key]} (errors against the truth)")
        lines += [f"  {'':<42}{_cells(head)}" for head in _HEADS]
        for row in summary(one):
            cells = [row.models.get(name) for name in ("breakpoints", "record", "record_tops", "goldfarb")]
            if row.actuator is not None:
                cells = [row.actuator, None, None, None] if not row.models else cells
            texts = ("" if value is None else f"{value:.3f}" for value in (row.paper, *cells))
            unit = "um" if row.unit == "µm" else row.unit
            lines.append(f"  {row.words + ', ' + unit:<42}{_cells(texts)}")
        lines.append("")
    return lines


def _cells(texts: Iterable[str]) -> str:
    return "".join(f"{text:>{width}}" for text, width in zip(texts, _WIDTHS, strict=True))
