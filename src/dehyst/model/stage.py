"""A stage: several actuators and the coupling matrix by which each actuator moves every axis."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError, of_part
from dehyst._io import VERSION
from dehyst._types import Array
from dehyst._validation import DEFAULT_AXES, axis_names, keep, matrix
from dehyst.model.actuator import Actuator
from dehyst.model.base import Motion, State
from dehyst.model.entries import JsonFile, Numbers, entry, instance, mapping, text, texts
from dehyst.model.temperatures import demand_thermal, temperature_columns
from dehyst.records import Record

# Largest condition number of the coupling matrix of a usable stage.
_WORST_CONDITION = 1e3
FORMAT = "dehyst-stage"


def inverse(coupling: Array) -> Array:
    """Return the inverse (axes, axes) of a coupling matrix."""
    return np.ascontiguousarray(np.linalg.inv(coupling))


def apply(table: Array, columns: Array) -> Array:
    """Return ``columns @ table.T`` (n, axes), summed from first to last axis; the identity matrix changes no bit."""
    result = np.empty_like(columns)
    for i, row in enumerate(table):
        total = row[0] * columns[:, 0]
        for j in range(1, len(row)):
            total = total + row[j] * columns[:, j]
        result[:, i] = total
    return result


def dot(row: Sequence[float], values: Sequence[float]) -> float:
    """Return the sum of products, from the first to the last."""
    total = row[0] * values[0]
    for j in range(1, len(row)):
        total += row[j] * values[j]
    return total


_ACTUATOR = instance(Actuator)


def _actuators(value: Sequence[Any], where: str) -> tuple[Actuator, ...]:
    if not isinstance(value, list | tuple) or not value:
        raise ModelError(argument=where, got=type(value).__name__, need="one Actuator for each axis")
    return tuple(_ACTUATOR(actuator, where) for actuator in value)


@dataclass(frozen=True, eq=False, repr=False)
class Stage(JsonFile):
    """Several coupled actuators, ``y = coupling @ h(v)`` where h_j is the hysteresis of actuator j.

    Parameters
    ----------
    actuators : sequence of Actuator
        One for each axis.
    coupling : (axes, axes) array_like, optional
        Displacement of axis i for each metre that actuator j moves; 1 on the diagonal. Default: no coupling.
    axes : sequence of str, optional
        Names of the axes; default: x, y, z.
    name : str, optional
    provenance : Mapping, optional
        Source of the numbers, for people; JSON values only. It has no effect on any result.
    recorded_columns : tuple of str, optional
        Columns of the records that the stage was identified from, such as "vx_V:x_um", one entry for each axis;
        default: not known.

    Raises
    ------
    ModelError
        If the numbers of actuators, rows and names differ, the diagonal is not 1, or the matrix is nearly singular.
    """

    _head = MappingProxyType({"format": FORMAT, "version": VERSION})
    _order = "name axes coupling actuators recorded_columns provenance"
    actuators: tuple[Actuator, ...] = entry("actuators", _actuators)
    coupling: Array = entry("coupling", Numbers(2, largest=inf, optional=True), None)
    axes: tuple[str, ...] = entry("axes", texts, DEFAULT_AXES)
    name: str = entry("name", text, "stage")
    provenance: Mapping[str, Any] = entry("provenance", mapping, factory=dict)
    recorded_columns: tuple[str, ...] = entry("recorded_columns", texts, ())

    def _demand_together(self) -> None:
        """Complete coupling and axes; raise `ModelError` if they do not fit the actuators."""
        count = len(self.actuators)
        table = np.eye(count) if self.coupling is None else self.coupling
        if table.shape != (count, count):
            got = f"{table.shape[0]} x {table.shape[1]} numbers for {count} axes"
            raise ModelError(argument="coupling", got=got, need="one per pair")
        if np.any(np.diag(table) != 1):
            got = f"the diagonal {np.diag(table).tolist()}"
            raise ModelError(argument="coupling", got=got, need="1 for each axis itself")
        axes = self.axes[:count] if self.axes == DEFAULT_AXES else self.axes
        keep(self, coupling=table, axes=axis_names(axes, count, "stage"))
        if not self.condition < _WORST_CONDITION:
            got = f"a matrix of condition {self.condition:.3g}"
            need = f"one below {_WORST_CONDITION:g}: its axes cannot be distinguished"
            raise ModelError(argument="coupling", got=got, need=need)

    def __repr__(self) -> str:
        off = self.coupling - np.eye(len(self.axes))
        return (
            f"<Stage '{self.name}': axes {', '.join(self.axes)}, coupling up to {100 * np.abs(off).max():.2g} %, "
            f"condition {self.condition:.4g}>"
        )

    @cached_property
    def decoupling(self) -> Array:
        """Inverse of `coupling` (axes, axes)."""
        return inverse(self.coupling)

    def alone(self, record: Record, j: int) -> Record:
        """Return a `record` of all axes as a record of actuator `j` alone, without the motion due to coupling."""
        return replace(record.axis(j), displacement=apply(self.decoupling, record.displacement)[:, j])

    @property
    def condition(self) -> float:
        """Condition number of the coupling matrix."""
        return float(np.linalg.cond(self.coupling))

    def summary(self) -> str:
        """Return the coupling matrix and the summary of each actuator, in lines."""
        lines = [f"Stage '{self.name}' of the axes {', '.join(self.axes)}, condition {self.condition:.4g}"]
        lines += matrix_lines(self.axes, self.coupling)
        for axis, actuator in zip(self.axes, self.actuators, strict=True):
            lines += [f"Axis {axis}:", *(f"  {line}" for line in actuator.summary().split("\n"))]
        return "\n".join(lines)

    def simulate(
        self,
        voltage: ArrayLike,
        *,
        time: ArrayLike | None = None,
        temperature: ArrayLike | None = None,
        states: Sequence[State | None] | None = None,
        extrapolate: bool = False,
    ) -> Motion:
        """Return the displacements (n, axes) [m] that voltages cause.

        Parameters
        ----------
        voltage : (n, axes) array_like
            Voltages [V].
        time : (n,) array_like, optional
            [s]; needed if an actuator needs it.
        temperature : float, (n,) or (n, axes) array_like, optional
            [degC], of all actuators or of each; those without the part `thermal` ignore it. Default: their reference.
        states : sequence of State, optional
            Start of each actuator; default: the state of the actuator.
        extrapolate : bool, optional
            As in `Actuator.simulate`.

        Returns
        -------
        Motion
            With one column for each axis; its `state` is a tuple with the state of each actuator.

        Raises
        ------
        ModelError
            As `Actuator.simulate`, with the name of the axis; or if the columns do not fit the axes.
        """
        v = self.columns(voltage, "voltage")
        motions = self._each("simulate", v, time, temperature, states, extrapolate)
        moved = np.column_stack([motion.displacement for motion in motions])
        return Motion(v, apply(self.coupling, moved), tuple(motion.state for motion in motions))

    def compensate(
        self,
        displacement: ArrayLike,
        *,
        time: ArrayLike | None = None,
        temperature: ArrayLike | None = None,
        states: Sequence[State | None] | None = None,
        extrapolate: bool = False,
    ) -> Motion:
        """Return the voltages with which all axes follow their displacements, ``v = h^-1(coupling^-1 y)``.

        They are not limited: see `Compensator`.

        Parameters
        ----------
        displacement : (n, axes) array_like
            Wanted displacements [m].
        time, temperature, states, extrapolate
            As in `simulate`.

        Returns
        -------
        Motion
            As `simulate`, with `voltage` (n, axes) [V].

        Raises
        ------
        ModelError
            As `Actuator.compensate`, with the name of the axis; or if the columns do not fit the axes.
        """
        y = self.columns(displacement, "displacement")
        motions = self._each("compensate", apply(self.decoupling, y), time, temperature, states, extrapolate)
        return Motion(np.column_stack([each.voltage for each in motions]), y, tuple(each.state for each in motions))

    def _each(
        self,
        call: str,
        given: Array,
        time: ArrayLike | None,
        temperature: ArrayLike | None,
        states: Sequence[State | None] | None,
        extrapolate: bool,
    ) -> list[Motion]:
        """Call the actuator of each axis with its column of `given` (n, axes)."""
        count, motions = len(self.actuators), []
        if states is not None and len(states) != count:
            raise ModelError(f"states: got {len(states)}, need {count}, one per axis")
        columns = given.T, self.temperatures(temperature, len(given)), states or [None] * count
        for axis, actuator, column, degrees, state in zip(self.axes, self.actuators, *columns, strict=True):
            options = {"time": time, "temperature": degrees, "state": state}
            try:
                motions.append(getattr(actuator, call)(column, **options, extrapolate=extrapolate))
            except ModelError as error:
                raise of_part(error, f"axis {axis}") from error.__cause__
        return motions

    def temperatures(self, temperature: ArrayLike | None, samples: int) -> list[Array | None]:
        """Return the temperature (samples,) [degC] of each actuator; None for an actuator without the part `thermal`.

        `temperature`: as in `simulate`, for a number of `samples`; None: not known.

        Raise `ModelError` if it has another shape, or no actuator has the part `thermal`.
        """
        if temperature is None:
            return [None] * len(self.actuators)
        demand_thermal(*(actuator.thermal for actuator in self.actuators))
        table = temperature_columns(temperature, samples, len(self.actuators))
        return [column if actuator.thermal else None for actuator, column in zip(self.actuators, table.T, strict=True)]

    def columns(self, values: ArrayLike, what: str) -> Array:
        """Return `values` (n, axes) as an array; raise `ModelError` with the name `what` if the shape differs."""
        table = matrix(values, what)
        if table.shape[1] != len(self.actuators):
            need = f"{len(self.actuators)}, one for each of the axes {', '.join(self.axes)}"
            raise ModelError(argument=what, got=f"{table.shape[1]} columns", need=need)
        return table


def by_axis(axes: Sequence[str], results: Sequence[Any]) -> dict[str, Any]:
    """Return the JSON values of results, one for each axis, by its name."""
    return {axis: result.as_dict() for axis, result in zip(axes, results, strict=True)}


def matrix_lines(axes: tuple[str, ...], matrix: Array, uncertainty: Array | None = None) -> Iterator[str]:
    """Yield a matrix as a table, each entry with its standard error."""
    width = max(18, *(len(axis) + 2 for axis in axes))
    yield " " * 8 + "".join(f"{axis:>{width}}" for axis in axes)
    for i, axis in enumerate(axes):
        cells = [
            f"{matrix[i, j]:.5f}" if i == j or uncertainty is None else f"{matrix[i, j]:+.5f} ±{uncertainty[i, j]:.5f}"
            for j in range(len(axes))
        ]
        yield f"{axis:<8}" + "".join(f"{cell:>{width}}" for cell in cells)
