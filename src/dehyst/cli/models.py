"""The model that a command reads, of one axis or several, and the columns of its axes in files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst.cli.common import read_model
from dehyst.cli.output.terminal import note
from dehyst.cli.record_files import column_of

if TYPE_CHECKING:
    from dehyst.model import Actuator, Stage
    from dehyst.records.formats.columns import Table

_TEXT = "Columns of several axes, e.g. 'vx_V:x_um vy_V:y_um'"
# Parameters of limits and slew rates of single axes.
AXIS_BOUNDS = ("axis_limits", "axis_slew")


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
    from dehyst._io import format_of

    return path.is_file() and format_of(path) == "dehyst-stage"


@dataclass(frozen=True, eq=False)
class AxesModel:
    """A model of one axis or several, over whose axes a command loops.

    Attributes
    ----------
    stage : Stage or None
        None for the model of one axis.
    actuators : tuple of Actuator
    axes : tuple of str
        Names of the axes; empty text for the only one.
    """

    stage: Stage | None
    actuators: tuple[Actuator, ...]
    axes: tuple[str, ...]

    @classmethod
    def read(cls, path: Path) -> AxesModel:
        """Read a model, with a note if its identification was not usable, or its coupling more than a matrix."""
        if not is_stage(path):
            return cls(None, (read_model(path),), ("",))
        from dehyst.model import Stage

        stage = Stage.load(path)
        if not stage.is_matrix:
            note(f"{path}: when this stage was identified, its coupling was more than a matrix")
        return cls(stage, stage.actuators, stage.axes)

    @property
    def needs_time(self) -> bool:
        """Whether an actuator needs the time of each sample."""
        return any(one.needs_time for one in self.actuators)

    def by_axis(self, values: Iterable[Any]) -> Any:
        """Return the value of the only axis, or those of several by their names, for JSON."""
        found = list(values)
        return found[0] if self.stage is None else dict(zip(self.axes, found, strict=True))

    def merged(self, tables: Sequence[dict[str, Any]]) -> dict[str, Any]:
        """Return JSON values of each axis under the keys that they share."""
        return {key: self.by_axis(table[key] for table in tables) for key in tables[0]}

    def prefixed(self, sentences: Iterable[Iterable[str]]) -> list[str]:
        """Return the sentences of each axis, with its name if there are several."""
        return [each for axis, own in zip(self.axes, sentences, strict=True) for each in self.prefixed_one(axis, own)]

    @staticmethod
    def prefixed_one(axis: str, sentences: Iterable[str]) -> list[str]:
        """Return sentences on an axis, with its name if there are several."""
        return [f"{axis}: {sentence}" if axis else sentence for sentence in sentences]

    def targets(self, displacement: Any) -> Any:
        """Return the displacement (n, axes) of each actuator for that of the axes."""
        from dehyst.model.stage import apply

        return displacement if self.stage is None else apply(self.stage.decoupling, displacement)

    def moved(self, targets: Any) -> Any:
        """Return the displacement (n, axes) of the axes for that of each actuator."""
        from dehyst.model.stage import apply

        return targets if self.stage is None else apply(self.stage.coupling, targets)

    def columns(self, quantity: str, values: Any, name: str | None = None) -> dict[str, Any]:
        """Return values (n, axes) [V or um] as the columns that a command writes; `name`: in place of the quantity."""
        if self.stage is None:
            return {f"{name or quantity}_{'V' if quantity == 'voltage' else 'um'}": values[:, 0]}
        before, after = ("v", "_V") if quantity == "voltage" else ("", "_um")
        if name is not None:
            after = f"_{name}{after}"
        return {f"{before}{axis}{after}": values[:, j] for j, axis in enumerate(self.axes)}

    def stored_columns(self, axes: str | None) -> str | None:
        """Return --axes, or the columns of several axes that the model was identified from; None for one axis."""
        from dehyst._errors import FileFormatError

        if self.stage is None or axes:
            return axes
        if not self.stage.recorded_columns:
            raise FileFormatError(
                "the stage does not name its columns", argument="axes", hint="give them, as 'vx_V:x_um vy_V:y_um'"
            )
        return " ".join(self.stage.recorded_columns)

    def values_in(self, table: Table, quantity: str, axes: str | None, options: dict[str, Any]) -> Any:
        """Return a quantity (n, axes) in a table: the columns of --axes, by their names, or those of the records."""
        import numpy as np

        from dehyst._errors import FileFormatError
        from dehyst.records.tables import axis_columns

        if self.stage is None:
            return column_of(table, quantity, options)[:, None]
        if axes is not None and ":" not in axes:
            names = self._bare(axes.replace(",", " ").split(), quantity)
        else:
            before, after = ("v", "_V") if quantity == "voltage" else ("", "_um")
            names = written = [f"{before}{axis}{after}" for axis in self.axes]
            if axes or self.stage.recorded_columns:
                found = {one.name: one for one in axis_columns(self.stored_columns(axes) or "")}
                if set(found) != set(self.axes):
                    raise FileFormatError(
                        f"got {', '.join(found)}, the stage has {', '.join(self.axes)}",
                        argument="axes",
                        hint=f"name each axis, as '{self.axes[0]}=VOLTAGE:DISPLACEMENT'",
                    )
                names = [getattr(found[axis], quantity) for axis in self.axes]
            if not axes and not set(names) <= set(table.names):
                names = written
        scale = options.get(f"{quantity}_scale")
        return np.column_stack([table.column(quantity, name, scale) for name in names])

    def _bare(self, entries: Sequence[str], quantity: str) -> list[str]:
        """Return columns given as 'x_um', or 'x=b_um' with the name of the axis, in the order of the axes."""
        from dehyst._errors import FileFormatError

        named = {}
        for entry in entries:
            axis, _, column = entry.rpartition("=")
            word = column.rsplit("/", 1)[-1].rsplit("_", 1)[0]
            if quantity == "voltage" and not axis and word not in self.axes:
                word = word.removeprefix("v")
            named[axis or word] = column
        if len(named) != len(entries) or set(named) != set(self.axes):
            example = entries[0].rpartition("=")[2] if entries else "COLUMN"
            raise FileFormatError(
                argument="axes",
                got=", ".join(entries),
                need=f"a column for each of the axes {', '.join(self.axes)}",
                hint=f"name the axis of each column, as '{self.axes[0]}={example}'",
            )
        return [named[axis] for axis in self.axes]
