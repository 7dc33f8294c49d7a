"""A stage: several actuators and the matrix by which each moves every axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._io.drafts import PathLike
from dehyst._io.json_files import read_json, write_json
from dehyst._types import Array
from dehyst._validation import keep, matrix
from dehyst.model import Actuator, State
from dehyst.model.serialization import demand_keys, numbers
from dehyst.stages.decoupling import apply, checked_coupling, inverse
from dehyst.stages.record import DEFAULT_AXES, axis_names
from dehyst.stages.stage_trace import StageTrace

FORMAT = "dehyst-stage"
VERSION = 1
_KEYS = {"format", "version", "name", "axes", "coupling", "actuators", "provenance"}

Limits = Sequence[tuple[float, float] | None] | None
SlewRates = Sequence[float | None] | None


@dataclass(frozen=True, eq=False, repr=False)
class Stage:
    """Several coupled actuators, ``y = coupling @ h(v)`` with h_j the hysteresis of actuator j.

    Parameters
    ----------
    actuators : sequence of Actuator
        One an axis.
    coupling : (axes, axes) array_like, optional
        Displacement of axis i for each metre that actuator j moves; 1 on the diagonal. Default: no coupling.
    axes : sequence of str, optional
        Names of the axes; default: x, y, z.
    name : str, optional
    provenance : Mapping, optional
        Source of the numbers; JSON values only.

    Raises
    ------
    ModelError
        If the numbers of actuators, rows and names differ, the diagonal is not 1, or the matrix is nearly singular.
    """

    actuators: tuple[Actuator, ...]
    coupling: Array = None  # type: ignore[assignment]
    axes: tuple[str, ...] = DEFAULT_AXES
    name: str = "stage"
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        actuators = tuple(self.actuators)
        if not actuators or not all(isinstance(one, Actuator) for one in actuators):
            raise ModelError("actuators: need one Actuator for each axis")
        count = len(actuators)
        table = np.eye(count) if self.coupling is None else self.coupling
        keep(self, actuators=actuators, coupling=checked_coupling(table, count))
        axes = self.axes[:count] if self.axes == DEFAULT_AXES else self.axes
        keep(self, axes=axis_names(axes, count, "stage"))

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

    @property
    def condition(self) -> float:
        """Condition number of the coupling matrix."""
        return float(np.linalg.cond(self.coupling))

    @property
    def states(self) -> tuple[State, ...]:
        """The state of each actuator from which it starts by default."""
        return tuple(one.state for one in self.actuators)

    @property
    def needs_time(self) -> bool:
        """Whether `simulate` and `compensate` need the time of each sample."""
        return any(one.needs_time for one in self.actuators)

    def axis_index(self, axis: str | int) -> int:
        """Return the index of an `axis`, given by its name or index; raise `ModelError` if there is none."""
        names: list[Any] = [*self.axes]
        if axis in names:
            return names.index(axis)
        if isinstance(axis, int) and 0 <= axis < len(names):
            return axis
        raise ModelError(f"axis: got {axis!r}, need one of {', '.join(self.axes)}")

    def simulate(
        self,
        voltage: ArrayLike,
        *,
        time: ArrayLike | None = None,
        states: Sequence[State | None] | None = None,
        extrapolate: bool = False,
    ) -> StageTrace:
        """Return the displacements that voltages cause.

        Parameters
        ----------
        voltage : (n, axes) array_like
            [V].
        time : (n,) array_like, optional
            [s]; needed if an actuator needs it.
        states : sequence of State, optional
            Start of each actuator; default: its own.
        extrapolate : bool, optional
            As in `Actuator.simulate`.

        Raises
        ------
        ModelError
            As `Actuator.simulate`, the axis named, or if the columns do not fit the axes.
        """
        v = self.columns(voltage, "voltage", "V")
        moved, reached = np.empty_like(v), []
        for j, (actuator, state) in enumerate(zip(self.actuators, self._starts(states), strict=True)):
            try:
                motion = actuator.simulate(
                    v[:, j], time=self._time(actuator, time), state=state, extrapolate=extrapolate
                )
            except ModelError as error:
                raise ModelError(f"axis {self.axes[j]}: {error}") from error
            moved[:, j] = motion.displacement
            reached.append(motion.state)
        return StageTrace(
            v, apply(self.coupling, moved), tuple(reached), np.zeros(v.shape, dtype=bool), np.zeros(v.shape[1])
        )

    def compensate(
        self,
        displacement: ArrayLike,
        *,
        time: ArrayLike | None = None,
        states: Sequence[State | None] | None = None,
        limits: Limits = None,
        slew_rate: SlewRates = None,
        extrapolate: bool = False,
    ) -> StageTrace:
        """Return the voltages with which all axes follow their displacements, ``v = h^-1(coupling^-1 y)``.

        Parameters
        ----------
        displacement : (n, axes) array_like
            Wanted displacements [m].
        time, states, extrapolate
            As in `simulate`.
        limits : sequence of (float, float), optional
            Lowest and highest voltage [V] of each axis. With limits or slew rates, voltages are clamped and the free
            axes corrected, see `StageCompensator`; by default voltages are not limited.
        slew_rate : sequence of float, optional
            Largest abs(dv/dt) [V/s] of each axis; needs `time`.

        Returns
        -------
        StageTrace
            With `voltage` (n, axes) [V].

        Raises
        ------
        ModelError
            As `Actuator.compensate`, the axis named, or if the columns do not fit the axes.
        """
        if limits is not None or slew_rate is not None:
            from dehyst.stages.compensator import StageCompensator

            compensator = StageCompensator(self, limits=limits, slew_rate=slew_rate, states=states)
            return compensator.trajectory(displacement, time=time, extrapolate=extrapolate)
        y = self.columns(displacement, "displacement", "m")
        wanted, v, reached = apply(self.decoupling, y), np.empty_like(y), []
        for j, (actuator, state) in enumerate(zip(self.actuators, self._starts(states), strict=True)):
            try:
                motion = actuator.compensate(
                    wanted[:, j], time=self._time(actuator, time), state=state, extrapolate=extrapolate
                )
            except ModelError as error:
                raise ModelError(f"axis {self.axes[j]}: {error}") from error
            v[:, j] = motion.voltage
            reached.append(motion.state)
        return StageTrace(v, y, tuple(reached), np.zeros(v.shape, dtype=bool), np.zeros(v.shape[1]))

    def permuted(self, order: Sequence[int]) -> Stage:
        """Return the same stage with its axes in another `order`."""
        rows = list(order)
        return replace(
            self,
            actuators=tuple(self.actuators[j] for j in rows),
            coupling=self.coupling[np.ix_(rows, rows)],
            axes=tuple(self.axes[j] for j in rows),
        )

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values in SI units; `from_dict` reads them back without loss."""
        return {
            "format": FORMAT,
            "version": VERSION,
            "name": self.name,
            "axes": list(self.axes),
            "coupling": self.coupling.tolist(),
            "actuators": [one.as_dict() for one in self.actuators],
            "provenance": dict(self.provenance),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Stage:
        """Rebuild from `as_dict`, strictly. `data` is what `as_dict` returns.

        Raise `ModelError` if the format or version differs, a key is unknown or missing, or a number is impossible.
        """
        version = data.get("version")
        if data.get("format") != FORMAT or type(version) is not int or version != VERSION:
            raise ModelError(
                f"got format {data.get('format')!r} version {version!r}, need {FORMAT!r} version {VERSION}"
            )
        demand_keys(data, _KEYS, "stage")
        lists = all(isinstance(data[key], list) for key in ("axes", "coupling", "actuators"))
        if not lists or not all(isinstance(one, Mapping) for one in data["actuators"]):
            raise ModelError("stage: axes, coupling and actuators must be lists, and each actuator an object")
        if not isinstance(data["name"], str) or not isinstance(data["provenance"], Mapping):
            raise ModelError("stage: name must be text and provenance an object")
        rows = [numbers(row, f"coupling[{i}]") for i, row in enumerate(data["coupling"])]
        if len({row.size for row in rows}) > 1:
            raise ModelError(f"coupling: got rows of {[row.size for row in rows]} numbers, need rows of one length")
        actuators = tuple(Actuator.from_dict(one) for one in data["actuators"])
        return cls(actuators, np.array(rows), tuple(data["axes"]), data["name"], data["provenance"])

    def save(self, path: PathLike) -> None:
        """Write the stage file (JSON) to `path`, completely or not at all.

        Raise `FileFormatError` if it cannot be written.
        """
        write_json(path, self.as_dict())

    @classmethod
    def load(cls, path: PathLike) -> Stage:
        """Read a stage file, strictly. `path` is the file's.

        Raises
        ------
        FileFormatError
            If the file cannot be read or is no JSON.
        ModelError
            If it is not a stage of this version, or holds impossible numbers.
        """
        data = read_json(path)
        try:
            return cls.from_dict(data)
        except ModelError as error:
            raise ModelError(f"{path}: {error}") from error

    def with_provenance(self, **entries: Any) -> Stage:
        """Return a copy whose provenance also holds `entries`."""
        return replace(self, provenance={**self.provenance, **entries})

    def columns(self, values: ArrayLike, what: str, unit: str) -> Array:
        """Return `values` (n, axes) in `unit` as an array; raise `ModelError` that names `what` if they are not."""
        table = matrix(values, what, unit)
        if table.shape[1] != len(self.actuators):
            raise ModelError(
                f"{what}: got {table.shape[1]} columns, need {len(self.actuators)}, one for each of the axes "
                f"{', '.join(self.axes)}"
            )
        return table

    def _starts(self, states: Sequence[State | None] | None) -> Sequence[State | None]:
        if states is None:
            return [None] * len(self.actuators)
        if len(states) != len(self.actuators):
            raise ModelError(f"states: got {len(states)}, need {len(self.actuators)}, one an axis")
        return states

    @staticmethod
    def _time(actuator: Actuator, time: ArrayLike | None) -> ArrayLike | None:
        return time if actuator.needs_time else None
