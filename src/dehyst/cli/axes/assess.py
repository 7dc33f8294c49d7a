"""`dehyst insight`, `check` and `show` with a stage file."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dehyst.cli.axes.inputs import load, read, stored
from dehyst.cli.output.printing import print_insight
from dehyst.cli.output.terminal import echo, echo_json, progress_line, worded

if TYPE_CHECKING:
    from dehyst.identification import Recheck
    from dehyst.stages import StageRecord


def insight_axes(model: Path, records: tuple[Path, ...], axes: str | None, options: dict[str, Any]) -> None:
    """Print how far to trust a stage."""
    from dehyst.stages import stage_insight

    stage, progress = load(model), progress_line()
    progress("assessing")
    names = ("level", "precision", "repeats", "limits", "seconds")
    settings = {name: options[name] for name in names if options.get(name) is not None}
    found = stage_insight(stage, read(records, axes or stored(stage), options), **settings)
    progress("")
    if options["as_json"]:
        echo_json(found.as_dict())
        return
    for line in worded(found.lines()):
        echo(line)
    for axis, one in zip(stage.axes, found.insights, strict=True):
        echo()
        echo(f"Axis {axis}")
        print_insight(one, None, None)


def check_axes(
    model: Path,
    record: Path,
    goal: float | None,
    axes: str | None,
    as_json: bool,
    columns: dict[str, Any],
    show: Callable[[Recheck], None],
) -> None:
    """Check a stage by a new record, and exit; `show` prints the check of an axis."""
    from dehyst.stages import check_stage

    stage = load(model)
    found = check_stage(stage, read((record,), axes or stored(stage), columns)[0], goal=goal)
    if as_json:
        echo_json(found.as_dict())
    else:
        for axis, one in zip(stage.axes, found.rechecks, strict=True):
            echo(f"Axis {axis}")
            show(one)
            echo()
        echo("Coupling: changed" if found.changes else "Coupling: as in the model")
        for sentence in found.changes:
            echo(f"  - {sentence}")
    sys.exit(0 if found.good else 1)


def show_axes(file: Path, axes: str, columns: dict[str, Any]) -> StageRecord:
    """Return the record of several axes in a file."""
    return read((file,), axes, columns)[0]


def show_stage(model: Path, as_json: bool) -> None:
    """Print a stage file."""
    from dehyst.stages.summary import matrix_lines

    stage = load(model)
    if as_json:
        echo_json(stage.as_dict())
        return
    echo(f"Stage '{stage.name}' of the axes {', '.join(stage.axes)}, condition {stage.condition:.4g}")
    for line in matrix_lines(stage.axes, stage.coupling):
        echo(line)
    for axis, one in zip(stage.axes, stage.actuators, strict=True):
        echo(f"Axis {axis}:")
        for line in one.summary().split("\n"):
            echo(f"  {line}")
