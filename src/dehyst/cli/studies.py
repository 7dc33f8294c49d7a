"""`dehyst demo` and `dehyst paper`: studies on virtual actuators."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from dehyst.cli.common import PATH, json_option
from dehyst.cli.output.printing import print_paper
from dehyst.cli.output.terminal import echo, echo_json, progress_line


def _folder_option(name: str, last: str) -> Callable[..., Any]:
    text = f"Folder for the files: new, empty, or {last}."
    return click.option("-o", "--output", type=PATH, default=Path(name), show_default=True, help=text)


@click.command()
@_folder_option("dehyst-demo", "an earlier demo's")
@click.option("--report/--no-report", default=True, help="Draw the report.")
@json_option
def demo(output: Path, report: bool, as_json: bool) -> None:
    """Record, identify, compensate and verify on an embedded virtual actuator."""
    from dehyst.studies import demo as study

    study.demand_folder(output)
    progress = progress_line()
    result = study.run(progress)
    progress("writing")
    written = study.write(result, output, report=report)
    progress("")
    numbers = result.as_dict()
    if as_json:
        echo_json({**numbers, "written": [str(path) for path in written]})
        return
    for line in result.fit.summary().split("\n"):
        echo(line)
    echo()
    echo("Tracking a path with nine reversals, largest error in % of the stroke")
    for name, key in (("linear feedforward (end-point ratio)", "linear"), ("dehyst", "compensated")):
        largest, rms = numbers[key]["largest_percent"], numbers[key]["rms_percent"]
        paper = numbers["paper"][f"{key}_largest_percent"]
        echo(f"  {name:<38}{largest:7.2f} %   RMS {rms:5.2f} %   (paper {paper:5.2f} %)")
    echo()
    echo(f"Written to {output}/: {', '.join(path.name for path in written)}")


@click.command()
@_folder_option("dehyst-paper", "one of an earlier run")
@json_option
def paper(output: Path, as_json: bool) -> None:
    """Repeat the experiment of the paper on a virtual actuator: its tables and its figures of results."""
    from dehyst.studies.paper import run as study

    study.demand_folder(output)
    progress = progress_line()
    result = study.run(progress)
    written = study.write(result, output, progress)
    progress("")
    if as_json:
        echo_json({**result.as_dict(), "written": [str(path) for path in written]})
        return
    print_paper(result, output)
