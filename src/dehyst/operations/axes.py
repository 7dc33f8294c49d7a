"""Models of one axis or several: the axes over which an operation loops."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from dehyst._errors import FileFormatError, ModelError
from dehyst._types import Array
from dehyst.control import Compensator, PathPlan
from dehyst.model import Actuator, Stage
from dehyst.operations.command import NUMBER, Condition, Values, option
from dehyst.operations.files import AS_FOUND, RECORD, Columns, columns_in, is_model, numbers_in
from dehyst.operations.run import Run
from dehyst.records import Record, Table, read, read_table
from dehyst.records.columns import columns_of_axis
from dehyst.records.files import selected

Limits = tuple[float, float] | None


class _AxisNumber(click.ParamType):  # type: ignore[type-arg]
    """A number [AXIS=]NUMBER of an axis, or of all axes (named "") if none is named; "none" is infinite."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the axis and its number."""
        axis, _, text = value.rpartition("=")
        return axis, math.inf if text == "none" else NUMBER.convert(text, param, ctx)


# Values of an option by axis; "" stands for all axes.
OfAxes = dict[str, Any]


def of_axes(name: str, given: OfAxes, axes: Sequence[str]) -> list[Any]:
    """Return the value of each axis for the option of a `name`: its own, the common one, or None."""
    for axis in given:
        if axis and axis not in axes:
            known = f"one of {', '.join(axes)}" if any(axes) else "none, as there is one axis"
            raise ModelError(argument=name, got=f"the axis {axis}", need=known)
    return [given.get(axis, given.get("")) for axis in axes]


def axes_option(text: str, metavar: str, *only: Condition) -> Any:
    """Return the declaration of an option for a number of all axes or of one."""
    return option(text, _AxisNumber(), *only, multiple=True, metavar=metavar, callback=_of_axes)


def slew_option(text: str, *only: Condition) -> Any:
    """Return the declaration of an option for the slew rates of all axes or of one."""
    return axes_option(text, "[AXIS=]V/S|none", *only)


def limits_option(text: str, *only: Condition) -> Any:
    """Return the declaration of an option for the limits of all axes or of one."""
    return option(text, (_AxisNumber(), NUMBER), *only, multiple=True, metavar="[AXIS=]LOW HIGH", callback=_of_axes)


def _of_axes(ctx: click.Context, option: click.Parameter, given: Sequence[Any]) -> OfAxes:
    found: OfAxes = {}
    for each in given:
        axis, value = each if isinstance(each[0], str) else (each[0][0], (each[0][1], each[1]))
        if axis in found:
            raise click.BadParameter(f"got {axis or 'a value for all axes'} twice, need it once", ctx, option)
        found[axis] = value
    return found


def is_stage(path: Path) -> bool:
    """Return whether a file is a model of several axes, by its format alone."""
    return is_model(path, "dehyst-stage")


def of_one_axis(given: Values) -> str:
    """Return why an option has no effect on a model of several axes; empty for a model of one axis."""
    return "with a model of several axes" if is_stage(given["model"]) else ""


@dataclass(frozen=True, eq=False)
class AxesModel:
    """A model of one axis or several; operations loop over its axes.

    Attributes
    ----------
    run : Run
        Receives the remarks.
    model : Actuator or Stage
    stage : Stage
        The model; for a single axis, a stage of this axis alone.
    axes : tuple of str
        Names of the axes; an empty text for a single axis.
    """

    run: Run
    model: Actuator | Stage
    stage: Stage
    axes: tuple[str, ...]

    @classmethod
    def read(cls, run: Run, path: Path) -> AxesModel:
        """Read a model; remark that its identification was not usable."""
        if is_stage(path):
            stage = Stage.load(path)
            return cls(run, stage, stage, stage.axes)
        actuator = Actuator.load(path)
        outcome = actuator.identification.outcome
        if outcome and not outcome.good:
            run.remarks.append(f"{path}: when this model was identified: {outcome.value}")
        return cls(run, actuator, Stage((actuator,)), ("",))

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """The actuator of each axis."""
        return self.stage.actuators

    @property
    def several(self) -> bool:
        """Whether arrays have a column for each axis, as those of a stage."""
        return self.model is self.stage

    def of(self, name: str, given: OfAxes) -> list[Any]:
        """Return the value of each axis for the option of a `name`, see `of_axes`."""
        return of_axes(name, given, self.axes)

    def slews(self, given: OfAxes) -> list[float | None]:
        """Return the largest slew rate [V/s] of each axis: the given one, else that of the model, with a remark.

        None: a path has its own speed.
        """
        rates = self.of("slew_rate", given)
        kept = [actuator.identification.allowed_slew_rate for actuator in self.actuators]
        words = "slew rate: at most {:.4g} V/s, which the model keeps; --slew-rate sets another"
        used = [own if rate is None else None for own, rate in zip(kept, rates, strict=True)]
        self.remark([words.format(own)] if own else [] for own in used)
        return [own or (None if rate == math.inf else rate) for own, rate in zip(used, rates, strict=True)]

    def planned(
        self,
        plan: Callable[..., PathPlan],
        rows: Array,
        limits: Sequence[Limits],
        slew_rates: Sequence[float | None],
        **options: Any,
    ) -> PathPlan:
        """Return the plan, by `plan_path` or `plan_voltage`, for `rows` (n, axes) [m] or [V]."""
        return plan(Compensator(self.model, limits, slew_rates), rows if self.several else rows[:, 0], **options)

    def by_axis(self, values: Iterable[Any]) -> Any:
        """Return the value of a single axis, or the values of several axes by name, for JSON."""
        found = dict(zip(self.axes, values, strict=True))
        return found if self.several else found[""]

    def merged(self, tables: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Return the JSON values of all axes under their common keys."""
        return {key: self.by_axis(table[key] for table in tables) for key in tables[0]}

    def prefixed(self, sentences: Iterable[Iterable[str]]) -> list[str]:
        """Return the sentences on each axis, with its name if there are several."""
        pairs = zip(self.axes, sentences, strict=True)
        return [f"{axis}: {sentence}" if axis else sentence for axis, own in pairs for sentence in own]

    def headed(self, blocks: Iterable[Iterable[str]]) -> list[str]:
        """Return the lines on each axis, below its name if there are several."""
        pairs = zip(self.axes, blocks, strict=True)
        return [line for axis, own in pairs for line in (*([f"Axis {axis}"] if axis else []), *own)]

    def remark(self, sentences: Iterable[Iterable[str]]) -> None:
        """Add remarks on each axis to those of the run."""
        self.run.remarks += self.prefixed(sentences)

    def name(self, quantity: str, axis: str, what: str = "") -> str:
        """Return the column name of a quantity of an axis; `what`: such as "expected" for the expected displacement."""
        if not axis:
            return f"{what or quantity}_{'V' if quantity == 'voltage' else 'um'}"
        return f"v{axis}_V" if quantity == "voltage" else f"{axis}{what and f'_{what}'}_um"

    def columns(self, quantity: str, each: Iterable[Array], what: str = "") -> dict[str, Array]:
        """Return values (n,) [V or um] of each axis as the columns that an operation writes."""
        return {self.name(quantity, axis, what): values for axis, values in zip(self.axes, each, strict=True)}

    def table(self, parts: Sequence[Any], *, wanted: bool = True) -> dict[str, Array]:
        """Return the columns of wanted displacement, voltage, expected displacement and temperature of planned axes."""
        columns = self.columns("displacement", (1e6 * part.displacement for part in parts)) if wanted else {}
        columns |= self.columns("voltage", (part.voltage for part in parts))
        columns |= self.columns("displacement", (1e6 * part.expected for part in parts), "expected")
        warmth = getattr(parts[0], "temperature", None)
        return columns if warmth is None else {**columns, "temperature_C": warmth}

    def record(self, path: Path, columns: Columns) -> Record:
        """Read a record: by the given columns, else by those of the model's own records, else by the usual names."""
        columns.demand(RECORD, "on a record", axes=self.several)
        if self.several:
            return read(path, columns if columns.axes else replace(columns, axes=self.recorded()))
        known = self.actuators[0].identification.columns
        if columns != AS_FOUND or not known:
            return read(path, columns)
        kept = Columns.parse(known)
        if columns_in(kept, read_table(path, kept)) != kept:
            return read(path, columns)
        words = f"{path.name}: read by the columns of the model's own records, {known}; --columns sets others"
        self.run.remarks.append(words)
        return read(path, kept)

    def recorded(self) -> dict[str, str]:
        """Return the columns of the records of a stage by axis, the usual ones if it does not name them."""
        usual = {axis: f"{self.name('voltage', axis)}:{self.name('displacement', axis)}" for axis in self.axes}
        return usual | dict(text.partition("=")[::2] for text in self.stage.recorded_columns)

    def named(self, quantity: str, columns: Columns) -> dict[str, str]:
        """Return the column of each of several axes: the given one, or the usual one."""
        if columns.axes and set(columns.axes) != set(self.axes):
            need = f"a column for each of the axes {', '.join(self.axes)}"
            raise FileFormatError(argument="axes", got=", ".join(columns.axes), need=need)
        at = -1 if quantity == "displacement" else 0
        given = {axis: columns_of_axis(text)[at] for axis, text in columns.axes.items()}
        return {axis: given.get(axis) or self.name(quantity, axis) for axis in self.axes}

    def values(self, table: Table, quantity: str, columns: Columns) -> Array:
        """Return a quantity (n, axes) of a table: from the given columns, or by the usual names."""
        names = self.named(quantity, columns) if self.several else {"": getattr(columns, quantity)}
        found = []
        for axis, name in names.items():
            own: dict[str, Any] = {"axes": {}, quantity: name}
            chosen = selected(table, replace(columns, **own), axis, (quantity,))[quantity]
            found.append(numbers_in(table, quantity, chosen.values))
        return np.column_stack(found)
