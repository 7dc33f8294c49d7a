"""`paper`: the experiment of the paper on a virtual actuator."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from dehyst._io import made_folder
from dehyst.operations.command import FOLDER, command, output
from dehyst.operations.run import Result, Run
from dehyst.paper import Paper
from dehyst.paper import run as experiment
from dehyst.paper.tables import summary

_TITLES = {
    "asymmetric": "Virtual E-280.10",
    "symmetric": "The same without its asymmetric map: these errors come from the method, not from the model class",
}
_ROW = "  {:<48}{:>9}{:>12}{:>15}"


@command("paper")
def paper(
    run: Run,
    output: Path = output("New or empty folder.", FOLDER, default="dehyst-paper"),
) -> Result:
    """Repeat the experiment of the paper on a virtual actuator: its tables and its figures of results."""
    made_folder(output)
    result = experiment.run(run.progress)
    written = experiment.write(result, output, run.progress)
    lines = [*_table(result), f"Written to {output}/: open index.html"]
    return Result({**result.as_dict(), "written": [str(path) for path in written]}, lines)


def _table(found: Paper) -> Iterator[str]:
    """Yield the numbers of the paper and of this package for both virtual actuators."""
    for key, repeated in found.experiments.items():
        yield f"{_TITLES[key]} (errors against the truth)"
        yield _ROW.format("", "paper", "its method", "whole records")
        for row in summary(repeated):
            first = row["actuator"] if row["breakpoints"] is None else row["breakpoints"]
            texts = ("" if x is None else f"{x:.3f}" for x in (row["paper"], first, row["record"]))
            yield _ROW.format(f"{row['quantity']}, {row['unit'].replace('µ', 'u')}", *texts)
        yield ""
