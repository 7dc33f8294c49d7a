"""What commands read and write of several axes: their records, their stage, and the columns of a path."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst.cli.output.terminal import note
from dehyst.cli.record_files import COLUMNS

if TYPE_CHECKING:
    from dehyst.records.formats.columns import Table
    from dehyst.stages import Stage, StageRecord
    from dehyst.stages.read import AxisColumns

# Where a path begins, unless something else is asked for.
OWN_START = "the state of each actuator in the model: just risen to its highest voltage"
_TEXT = "Columns of several axes, e.g. 'vx_V:x_um vy_V:y_um'"


def axes_option(default: str = "") -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return the option that names voltage and displacement of several axes."""
    return click.option("--axes", metavar="COLUMNS", help=f"{_TEXT}.{default and f'  [default: {default}]'}")


def axis_bounds_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add limits and slew rates of single axes of several."""
    limits = click.option(
        "--axis-limits",
        type=(str, float, float),
        multiple=True,
        metavar="AXIS LOW HIGH",
        help="Of several axes, voltages allowed for this one; may be repeated.",
    )
    slew = click.option(
        "--axis-slew",
        type=(str, float),
        multiple=True,
        metavar="AXIS V/S",
        help="Of several axes, largest slew rate of this one; may be repeated.",
    )
    return limits(slew(command))


def refuse_axis_bounds(options: dict[str, Any]) -> None:
    """Remove limits and slew rates of single axes from options; refuse them, for there is one axis only."""
    for name, plain in (("axis_limits", "--limits"), ("axis_slew", "--slew")):
        if options.pop(name):
            raise click.UsageError(f"--{name.replace('_', '-')}: is for several axes; give {plain}")


def bounds_of(axes: Sequence[str], options: dict[str, Any]) -> tuple[list[Any], list[Any]]:
    """Return limits [V] and slew rate [V/s] of each axis: its own, or those of all, or None."""
    tables = []
    for own, common in (("axis_limits", options["limits"]), ("axis_slew", options["slew"])):
        table = dict.fromkeys(axes, common)
        for axis, *values in options[own]:
            if axis not in table:
                raise click.UsageError(f"--{own.replace('_', '-')}: got the axis {axis}, need one of {', '.join(axes)}")
            table[axis] = tuple(values) if len(values) > 1 else values[0]
        tables.append(list(table.values()))
    return tables[0], tables[1]


def is_stage(path: Path) -> bool:
    """Return whether a file is a stage, by its format alone."""
    from dehyst._io.marks import format_of

    return path.is_file() and format_of(path) == "dehyst-stage"


def load(path: Path) -> Stage:
    """Return the stage in a file, with a note if its coupling was more than a matrix."""
    from dehyst.stages import Stage

    stage = Stage.load(path)
    if stage.provenance.get("is_matrix") is False:
        note(f"{path}: when this stage was identified, its coupling was more than a matrix")
    return stage


def read(paths: tuple[Path, ...], axes: str, options: dict[str, Any]) -> list[StageRecord]:
    """Return the records of several axes in files, by the options of their columns."""
    from dehyst.stages import read_stage

    names = [name for name in COLUMNS if name not in ("voltage", "displacement")]
    return [read_stage(path, axes, **{name: options.get(name) for name in names}) for path in paths]


def stored(stage: Stage) -> str:
    """Return the columns that the stage was identified from."""
    from dehyst._errors import FileFormatError

    stored = stage.provenance.get("axes")
    if not isinstance(stored, list):
        raise FileFormatError("axes: the stage does not name its columns; give them, as 'vx_V:x_um vy_V:y_um'")
    return " ".join(map(str, stored))


def columns_of(table: Table, stage: Stage, axes: str | None, quantity: str, options: dict[str, Any]) -> Any:
    """Return the columns (n, axes) of a quantity: those of --axes, by their names, or those of the records."""
    import numpy as np

    from dehyst._errors import FileFormatError
    from dehyst.stages.read import axis_columns

    if axes is not None and ":" not in axes:
        names = _bare(axes.replace(",", " ").split(), stage, quantity)
    else:
        written = [
            f"{'v' if quantity == 'voltage' else ''}{axis}_{'V' if quantity == 'voltage' else 'um'}"
            for axis in stage.axes
        ]
        found = axis_columns(axes or stored(stage)) if axes or "axes" in stage.provenance else ()
        names = [getattr(one, quantity) for one in _in_order(found, stage)] or written
        if not axes and not set(names) <= set(table.names):
            names = written
    if len(names) != len(stage.axes):
        raise FileFormatError(f"axes: got {len(names)} columns, need one for each of {', '.join(stage.axes)}")
    scale = options.get(f"{quantity}_scale")
    return np.column_stack([table.column(quantity, name, scale) for name in names])


def _bare(entries: Sequence[str], stage: Stage, quantity: str) -> list[str]:
    """Return columns that are given as 'x_um', or 'x=b_um' with the name of the axis, in the order of the stage."""
    from dehyst._errors import FileFormatError

    named = {}
    for entry in entries:
        axis, _, column = entry.rpartition("=")
        word = column.rsplit("/", 1)[-1].rsplit("_", 1)[0]
        if quantity == "voltage" and not axis and word not in stage.axes:
            word = word.removeprefix("v")
        named[axis or word] = column
    if len(named) != len(entries) or set(named) != set(stage.axes):
        example = entries[0].rpartition("=")[2] if entries else "COLUMN"
        raise FileFormatError(
            f"axes: got {', '.join(entries)}, need a column for each of the axes {', '.join(stage.axes)}; name the "
            f"axis of each column, as '{stage.axes[0]}={example}'"
        )
    return [named[axis] for axis in stage.axes]


def _in_order(found: Sequence[AxisColumns], stage: Stage) -> list[AxisColumns]:
    """Return columns of axes in the order of those of a stage; raise `FileFormatError` if they have other names."""
    from dehyst._errors import FileFormatError

    named = {one.name: one for one in found}
    if found and set(named) != set(stage.axes):
        raise FileFormatError(
            f"axes: got {', '.join(named)}, the stage has {', '.join(stage.axes)}; name each axis, as "
            f"'{stage.axes[0]}=VOLTAGE:DISPLACEMENT'"
        )
    return [named[axis] for axis in stage.axes] if found else []


def named(stage: Stage, values: Any, quantity: str = "displacement") -> dict[str, Any]:
    """Return values (n, axes) [V] or [um] as the columns that a command writes."""
    before, after = ("v", "_V") if quantity == "voltage" else ("", "_um")
    return {f"{before}{axis}{after}": values[:, j] for j, axis in enumerate(stage.axes)}
