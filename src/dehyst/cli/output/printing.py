"""Printed results: a fit, an assessment of a model, the experiment of the paper."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from dehyst.cli.common import echo_files
from dehyst.cli.output.terminal import echo

if TYPE_CHECKING:
    from dehyst.identification import Fit, StageFit
    from dehyst.studies.paper import Paper
    from dehyst.trust import Insight


def print_fit(fit: Fit | StageFit, output: Path | None, report: Path | None, *, verbose: bool) -> None:
    """Print the result of an identification, the error to expect first."""
    _print_summary(fit, verbose, "errors, structures, parts, repairs and all remarks")
    echo_files(Model=output, Report=report)


def print_insight(found: Insight, output: Path | None, report: Path | None, *, verbose: bool) -> None:
    """Print an assessment of a model, the error to expect first."""
    _print_summary(found, verbose, "what is known of each number, and when the state becomes known")
    echo_files(Band=output, Report=report)


def _print_summary(found: Fit | StageFit | Insight, verbose: bool, more: str) -> None:
    """Print a summary, and by which option there is more of it."""
    for line in found.summary(verbose).split("\n"):
        echo(line)
    if not verbose:
        echo()
        echo(f"Add --verbose for {more}.")


def print_paper(found: Paper, output: Path) -> None:
    """Print the paper's numbers beside those of this package, for both virtual actuators."""
    from dehyst.studies.paper.tables import summary

    titles = {
        "asymmetric": "Virtual E-280.10",
        "symmetric": "The same without its asymmetric map: the errors are those of the method, not of the model class",
    }
    for key, experiment in found.experiments.items():
        echo(f"{titles[key]} (errors against the truth)")
        echo(f"  {'':<42}{'paper':>9}{'ours, by':>12}{'ours, whole':>13}{'with more':>12}{'Goldfarb,':>12}")
        echo(f"  {'':<42}{'':>9}{'its method':>12}{'record':>13}{'loops':>12}{'relaxed':>12}")
        for row in summary(experiment):
            cells = [row.models.get(name) for name in ("breakpoints", "record", "record_tops", "goldfarb")]
            if row.actuator is not None:
                cells = [row.actuator, None, None, None] if not row.models else cells
            cells_written = [("" if value is None else f"{value:.3f}") for value in (row.paper, *cells)]
            unit = "um" if row.unit == "µm" else row.unit
            echo(
                f"  {row.words + ', ' + unit:<42}"
                + "".join(f"{text:>{width}}" for text, width in zip(cells_written, (9, 12, 13, 12, 12), strict=True))
            )
        echo()
    echo(f"Written to {output}/: open index.html")
