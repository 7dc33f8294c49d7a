"""A measured record of several axes: all voltages sent and all displacements measured over one time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dehyst._errors import ModelError, RecordError
from dehyst._text import escaped
from dehyst._types import Array
from dehyst._validation import keep, matrix, vector
from dehyst.records import Record

DEFAULT_AXES = ("x", "y", "z")


@dataclass(frozen=True, eq=False, repr=False)
class StageRecord:
    """One measurement of a stage; wrong input is refused at construction.

    Parameters
    ----------
    time : (n,) array_like
        [s], strictly rising.
    voltage, displacement : (n, axes) array_like
        Volts and metres, a column an axis, in the order of `axes`.
    axes : sequence of str, optional
        Names of the axes; default: x, y, z, as many as there are columns.
    name : str
        Used in messages.
    meta : mapping
        Origin of the record.

    Raises
    ------
    RecordError
        If the arrays do not fit, hold numbers that `Record` refuses, or the axes are no different names.
    """

    time: Array
    voltage: Array
    displacement: Array
    axes: tuple[str, ...] = DEFAULT_AXES
    name: str = "record"
    meta: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        try:
            keep(self, time=vector(self.time, "time", "s"))
            keep(self, voltage=matrix(self.voltage, "voltage", "V"))
            keep(self, displacement=matrix(self.displacement, "displacement", "m"))
        except ModelError as error:
            raise RecordError(f"record '{self.name}': {error}") from error
        shape = self.voltage.shape
        if self.displacement.shape != shape or shape[0] != self.time.size:
            raise RecordError(
                f"record '{self.name}': got {self.time.size} times, voltages {shape} and displacements "
                f"{self.displacement.shape}; need one row a sample and one column an axis in both"
            )
        axes = self.axes[: shape[1]] if self.axes == DEFAULT_AXES else self.axes
        keep(self, axes=axis_names(axes, shape[1], f"record '{self.name}'", RecordError), meta=dict(self.meta))
        for j in range(shape[1]):
            self.axis(j)  # raises as Record does

    def __len__(self) -> int:
        return self.time.size

    def __repr__(self) -> str:
        return (
            f"<StageRecord '{escaped(self.name)}': {len(self)} samples, {self.time[-1] - self.time[0]:.6g} s, axes "
            f"{', '.join(self.axes)}>"
        )

    def axis(self, j: int) -> Record:
        """Return voltage and displacement of axis `j` (0, 1, ...) as a record of one actuator."""
        return self.with_displacement(j, self.displacement[:, j])

    def with_displacement(self, j: int, displacement: Array) -> Record:
        """Return the voltage of axis `j` and another `displacement` (n,) [m] as a record of one actuator."""
        return Record(self.time, self.voltage[:, j], displacement, f"{self.name} ({self.axes[j]})", self.meta)

    def part(self, start: int, stop: int, name: str | None = None) -> StageRecord:
        """Return the samples `start` to `stop` - 1 as a record, by default of the same `name`."""
        rows = slice(start, stop)
        return StageRecord(
            self.time[rows], self.voltage[rows], self.displacement[rows], self.axes, name or self.name, self.meta
        )

    def permuted(self, order: Sequence[int]) -> StageRecord:
        """Return the same record with its axes in another `order`."""
        columns = list(order)
        names = tuple(self.axes[j] for j in columns)
        return StageRecord(
            self.time, self.voltage[:, columns], self.displacement[:, columns], names, self.name, self.meta
        )

    @property
    def strokes(self) -> Array:
        """Range (axes,) [m] of each displacement."""
        return np.asarray(np.ptp(self.displacement, axis=0))


def axis_names(axes: Sequence[str], count: int, what: str, error: type[Exception] = ModelError) -> tuple[str, ...]:
    """Return names of `count` axes; raise `error` unless they are so many different names, without blanks."""
    names = tuple(axes)
    good = all(isinstance(name, str) and name and not set(name) & set(" \t\n,;:\"'") for name in names)
    if isinstance(axes, str) or len(names) != count or not good or len(set(names)) < count or not count:
        raise error(f"{what}: axes: got {axes!r}, need {count} different names without blanks, such as {('x', 'y')}")
    return names
