"""Models of one axis or several: the axes over which an operation loops."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from dehyst._errors import FileFormatError, ModelError
from dehyst._types import Array
from dehyst._units import quantity_of
from dehyst.control import Compensator, PathPlan, StageCompensator
from dehyst.model import Actuator, Stage
from dehyst.model.stage import apply
from dehyst.operations.files import MIDDLE, Columns, implausible_delay, is_model, read_model, values_of
from dehyst.operations.run import Run
from dehyst.records import Table
from dehyst.records.columns import Entry, columns_of_axis
from dehyst.records.formats.columns import GUESS, QUANTITIES, listed, plausible_unit
from dehyst.records.tables import ColumnError


@dataclass(frozen=True)
class Limit:
    """Allowed voltages [V] of the named axis, or without a name of all axes."""

    axis: str
    low: float
    high: float

    metavar: ClassVar[str] = "[AXIS=]LOW HIGH"
    word_count: ClassVar[int] = 2

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the limits in a text; raise ValueError that says what is needed."""
        axis, _, numbers = text.rpartition("=")
        try:
            low, high = map(float, numbers.split())
        except ValueError as error:
            raise ValueError(f"got {text!r}, need two voltages") from error
        return cls(axis, low, high)

    def __str__(self) -> str:
        """Return the text."""
        return f"{self.axis and f'{self.axis}='}{self.low:.12g} {self.high:.12g}"


@dataclass(frozen=True)
class AxisNumber:
    """A number for the named axis, or without a name for all axes."""

    axis: str
    number: float | None

    metavar: ClassVar[str]
    needed: ClassVar[str]
    none: ClassVar[bool] = False

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the number in a text; raise ValueError that says what is needed."""
        axis, _, number = text.rpartition("=")
        try:
            return cls(axis, None if cls.none and number == "none" else float(number))
        except ValueError as error:
            raise ValueError(f"got {text!r}, need {cls.needed}") from error

    def __str__(self) -> str:
        """Return the text."""
        return f"{self.axis and f'{self.axis}='}{'none' if self.number is None else f'{self.number:.12g}'}"


class Slew(AxisNumber):
    """The largest slew rate [V/s]; None: not limited."""

    metavar = "[AXIS=]V/S|none"
    needed = "a number of V/s, or none"
    none = True


class Present(AxisNumber):
    """The present voltage [V]."""

    metavar = "[AXIS=]V"
    needed = "a number of V"


def limits_of(axes: Sequence[str], given: Iterable[Limit]) -> list[tuple[float, float] | None]:
    """Return the limits [V] of each axis: its own, the common ones, or None."""
    return [None if one is None else (one.low, one.high) for one in _by_axis(axes, given, "limits")]


def slews_of(axes: Sequence[str], given: Iterable[Slew]) -> list[Slew | None]:
    """Return the slew rate of each axis: its own, the common one, or None if none was given."""
    return _by_axis(axes, given, "slew_rate")


def numbers_of(axes: Sequence[str], given: Iterable[AxisNumber], name: str) -> list[float | None]:
    """Return the number of each axis: its own, the common one, or None. `name`: the parameter, for errors."""
    return [None if one is None else one.number for one in _by_axis(axes, given, name)]


def _by_axis(axes: Sequence[str], given: Iterable[Any], name: str) -> list[Any]:
    found: dict[str, Any] = {}
    for one in given:
        if one.axis in found:
            raise ModelError(argument=name, got=f"{one.axis or 'one for all axes'} twice", need="one")
        if one.axis and one.axis not in axes:
            known = f"one of {', '.join(axes)}" if any(axes) else "none, as there is one axis"
            raise ModelError(argument=name, got=f"the axis {one.axis}", need=known)
        found[one.axis] = one
    return [found.get(axis, found.get("")) for axis in axes]


def is_stage(path: Path) -> bool:
    """Return whether a file is a model of several axes, by its format alone."""
    return is_model(path, "dehyst-stage")


@dataclass(frozen=True, eq=False)
class AxesModel:
    """A model of one axis or several; operations loop over its axes.

    Attributes
    ----------
    stage : Stage or None
        None for the model of one axis.
    actuators : tuple of Actuator
    axes : tuple of str
        Names of the axes; an empty text for a single axis.
    """

    stage: Stage | None
    actuators: tuple[Actuator, ...]
    axes: tuple[str, ...]

    @classmethod
    def read(cls, run: Run, path: Path) -> AxesModel:
        """Read a model; warn if its identification was not usable."""
        if not is_stage(path):
            return cls(None, (read_model(run, path),), ("",))
        stage = Stage.load(path)
        for axis, actuator in zip(stage.axes, stage.actuators, strict=True):
            if sentence := implausible_delay(actuator):
                run.note(f"{path}: {axis}: {sentence}")
        return cls(stage, stage.actuators, stage.axes)

    def planned(
        self,
        plan: Callable[..., Any],
        rows: Array,
        limits: Sequence[tuple[float, float] | None],
        slew_rates: Sequence[float | None],
        options: Mapping[str, Any],
        **by_axis: Sequence[Any],
    ) -> list[PathPlan]:
        """Return the planned path of each axis for displacements or voltages `rows` (n, axes).

        `plan`: `plan_path` or `plan_voltage`. `by_axis`: options with one entry for each axis.
        """
        if self.stage is None:
            own = {name: values[0] for name, values in by_axis.items()}
            return [plan(Compensator(self.actuators[0], limits[0], slew_rates[0]), rows[:, 0], **options, **own)]
        several = StageCompensator(self.stage, limits=limits, slew_rate=slew_rates)
        return [*plan(several, rows, **options, **by_axis).each]

    def by_axis(self, values: Iterable[Any]) -> Any:
        """Return the value of a single axis, or the values of several axes by name, for JSON."""
        found = list(values)
        return found[0] if self.stage is None else dict(zip(self.axes, found, strict=True))

    def merged(self, tables: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Return the JSON values of all axes under their common keys."""
        return {key: self.by_axis(table[key] for table in tables) for key in tables[0]}

    def prefixed(self, sentences: Iterable[Iterable[str]]) -> list[str]:
        """Return the sentences on each axis, with its name if there are several."""
        pairs = zip(self.axes, sentences, strict=True)
        return [f"{axis}: {sentence}" if axis else sentence for axis, own in pairs for sentence in own]

    def targets(self, displacement: Array, temperature: float | Array | None = None) -> Array:
        """Return the displacement (n, axes) [m] of each actuator for a displacement of the axes.

        `temperature` (n,) or a number [degC]: of the displacement; the result is at the reference of each actuator.
        """
        moved = displacement if self.stage is None else apply(self.stage.decoupling, displacement)
        if temperature is None:
            return moved
        pairs = zip(self.actuators, moved.T, strict=True)
        return np.column_stack([one.thermal.at_reference(y, temperature) if one.thermal else y for one, y in pairs])

    def moved(self, targets: Array) -> Array:
        """Return the displacement (n, axes) of the axes for a displacement of each actuator."""
        return targets if self.stage is None else apply(self.stage.coupling, targets)

    def name(self, quantity: str, axis: str, what: str = "") -> str:
        """Return the column name of a quantity of an axis; `what`: such as "expected" for the expected displacement."""
        if not axis:
            return f"{what or quantity}_{'V' if quantity == 'voltage' else 'um'}"
        return f"v{axis}_V" if quantity == "voltage" else f"{axis}{what and f'_{what}'}_um"

    def columns(self, quantity: str, values: Array, what: str = "") -> dict[str, Array]:
        """Return values (n, axes) [V or um] as the columns that an operation writes."""
        return {self.name(quantity, axis, what): values[:, j] for j, axis in enumerate(self.axes)}

    def demand(self, columns: Columns, keys: Sequence[str], words: str) -> None:
        """Raise an error for keys of columns that have no effect, see `Columns.demand`."""
        columns.demand(keys, words, axes=self.stage is not None)

    def of_records(self, columns: Columns) -> Columns:
        """Return the columns of records: with those of each axis that were given, or else of the model's records."""
        if self.stage is None or columns.axes:
            return columns
        if not self.stage.recorded_columns:
            raise FileFormatError(
                "the model does not name its columns", argument="axes", hint="give those of each axis"
            )
        return replace(columns, axes=self._recorded())

    def _recorded(self) -> dict[str, str]:
        """Return the columns of the records of a stage by axis; none if it does not name them."""
        known = () if self.stage is None else self.stage.recorded_columns
        return dict(text.partition("=")[::2] for text in known)

    def named(self, table: Table, quantity: str, columns: Columns, *, record: bool = False) -> dict[str, str]:
        """Return the column of each of several axes, as in `Columns`.

        They are the given ones, those of the records if a table has them, or the usual ones. `record`: whether the
        table is a record, of which both columns of an axis are given. The scales of the records are not those of paths
        and voltages: there, columns of the records that have one are not used.
        """
        if columns.axes and set(columns.axes) != set(self.axes):
            need = f"a column for each of the axes {', '.join(self.axes)}"
            raise FileFormatError(argument="axes", got=", ".join(columns.axes), need=need)
        at = -1 if quantity == "displacement" else 0
        parts = {axis: columns_of_axis(text) for axis, text in columns.axes.items()}
        if parts and (not record or all(len(one) == 2 for one in parts.values())):
            return {axis: one[at] for axis, one in parts.items()}
        names = {axis: columns_of_axis(text)[at] for axis, text in self._recorded().items()}
        used = names and all(
            table.fitting(quantity, name) == 1 and (record or Entry.of(name).scale is None) for name in names.values()
        )
        return names if used else {axis: self.name(quantity, axis) for axis in self.axes}

    def column(self, table: Table, quantity: str, axis: str, named: str) -> Array:
        """Return a quantity (n,) of one of several axes from the column of this axis."""
        try:
            return table.column(quantity, named)
        except ColumnError as error:
            hint = f'{error.hint}. Give the column as "{axis}=NAME"'
            raise FileFormatError(f"axis {axis}: {error.message}", hint=hint, change=("columns",)) from error

    def values(self, table: Table, quantity: str, columns: Columns) -> Array:
        """Return a quantity (n, axes) of a table: from the given columns, by the usual names, or as in the records."""
        if self.stage is None:
            return values_of(table, quantity, columns)[:, None]
        names = self.named(table, quantity, columns)
        if columns.axes:
            own = [name for name in names.values() if name != MIDDLE]
            if len(set(own)) < len(own):
                got = ", ".join(f"{axis}={name}" for axis, name in names.items())
                raise FileFormatError(argument="axes", got=got, need="a column of its own for each axis")
        else:
            self._demand_named(table, quantity, names)
        middle = self.moved(np.array([[0.5 * sum(one.reach) for one in self.actuators]]))[0]
        return np.column_stack(
            [
                np.full(table.rows, middle[j])
                if names[axis] == MIDDLE
                else self.column(table, quantity, axis, names[axis])
                for j, axis in enumerate(self.axes)
            ]
        )

    def _demand_named(self, table: Table, quantity: str, names: Mapping[str, str]) -> None:
        """Raise an error that proposes columns if a table lacks one of these columns of the axes."""
        missing = [axis for axis in self.axes if not table.fitting(quantity, names[axis])]
        if not missing:
            return
        fits = [*dict.fromkeys(one.name for one in table.columns if quantity_of(one.parts[1]) == quantity)]
        clocks = {*QUANTITIES["time"].words.split(", ")}
        bare = [one for one in table.columns if not one.parts[1] and not one.words & clocks]
        fits += [f"{one.name}:{unit}{GUESS}" for one in bare if (unit := plausible_unit(quantity, one.data))]
        fits += [f"NAME:{'V' if quantity == 'voltage' else 'um'}"] * len(self.axes)
        proposal = ", ".join(f"{axis}={fit}" for axis, fit in zip(self.axes, fits, strict=False))
        raise FileFormatError(
            f"{table.source}: no column '{names[missing[0]]}' for the {quantity} of the axis {missing[0]}",
            hint=f'the file holds {listed(table.names)}. Name the column of each axis, as --columns "{proposal}"',
        )
