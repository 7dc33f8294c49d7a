"""Tracking: a path, its voltages with and without a model, and the reached displacement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import cycle, islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._types import Array
from dehyst.calibration.plan import Excitations
from dehyst.control import plan_path
from dehyst.model import Actuator, Stage, State, apply, beginning
from dehyst.records import Record, largest, percent, rms
from dehyst.waveforms import TURNS, Excitation, wanted_path

# Share of every actuator's range that a path of several axes uses, and number of turning points by which an axis begins
# later than the axis before.
_RANGE_SHARE, _TURNS_LATER = 0.96, 3


@dataclass(frozen=True, eq=False)
class PlannedRun:
    """A path to follow after a homing, and a voltage for it.

    `wanted`: readings of the sensor [m] at each sample of the `excitation`, (n,) or (n, axes); NaN during the homing.
    `begin`: first sample of the path, after the homing and the way to the path. `stroke`: stroke of the major loop of
    each axis [m]. `warnings`: sentences on voltages that could not follow.
    """

    wanted: Array
    begin: int
    excitation: Excitation
    stroke: Any
    warnings: tuple[str, ...] = ()


class _Homed(NamedTuple):
    """The result of simulating the next homing, as sensor readings [m] of each axis (axes,).

    `low`: with all axes at their lowest voltage. `stroke`: of the major loop. `wanted`: way to the path, and path
    (n, axes). `states` of the actuators, and zeros of the sensors, `zero`.
    """

    low: Array
    stroke: Array
    wanted: Array
    states: tuple[State, ...]
    zero: Array


@dataclass(frozen=True, eq=False)
class PathPlanner:
    """A planner of a path through most of the stroke after a homing, for one axis or several that move together.

    Homing, limits and the samples between turning points are those of the `excitations`. For models that depend on
    temperature, the temperature of the last record goes on drifting.
    """

    excitations: Excitations

    @cached_property
    def homing(self) -> Excitation:
        """Two major cycles, from and to the lowest voltage: after them the state is known."""
        return self.excitations.homing()

    def nominal(self, model: Actuator | Stage, before: Sequence[Record]) -> PlannedRun:
        """Plan the run with a constant ratio of voltage to displacement, without coupling.

        The `model` determines the place of the path after all records so far, `before`.
        """
        homed, limits = self._homed(model, before), self.excitations.limits
        bottom, top = (np.array([getattr(bounds, key) for bounds in limits]) for key in ("low", "high"))
        voltage = bottom + (homed.wanted - homed.low) * (top - bottom) / homed.stroke
        return self._run("nominal", homed, np.clip(voltage, bottom, top))

    def compensated(self, model: Actuator | Stage, before: Sequence[Record]) -> PlannedRun:
        """Plan the run with a `model`; its state follows from all earlier records, its zero from the last.

        `before`: all records so far, in order; the last one is the nominal run, whose path corrects for the history
        before the records and for the drift of the sensor.
        """
        homed, limits = self._homed(model, before), self.excitations.limits
        time = np.arange(len(homed.wanted)) / self.homing.sample_rate
        bounds, rates = [(bound.low, bound.high) for bound in limits], [bound.slew_rate for bound in limits]
        several = isinstance(model, Stage)
        given: dict[str, Any] = {
            "limits": bounds if several else bounds[0],
            "slew_rate": rates if several else rates[0],
            # The temperature goes on drifting after the last record.
            "temperature": later_temperature(model, before[-1], self.homing.duration + time),
        }
        given |= {"start": homed.states, "present": self.homing.voltage[-1], "home": False, "on_time": True}
        path = homed.wanted - homed.zero
        plan = plan_path(model, path if several else path[:, 0], time=time, **given)
        return self._run("compensated", homed, plan.voltage[plan.first :].reshape(path.shape), plan.warnings)

    def _homed(self, model: Actuator | Stage, before: Sequence[Record]) -> _Homed:
        """Simulate the next homing after the records `before`."""
        stage = model if isinstance(model, Stage) else Stage((model,))
        time, voltage, displacement, warmth = _joined(before)
        starts = [beginning(actuator, voltage[:, j]) for j, actuator in enumerate(stage.actuators)]
        later, branch = later_temperature(model, before[-1], self.homing.time), self.excitations.branches[0]
        options: dict[str, Any] = {"temperature": None if later is None else warmth, "extrapolate": True}
        played = stage.simulate(voltage, time=time, states=starts, **options)
        late = (len(TURNS) - 1) * branch if len(stage.axes) == 1 else len(before[-1]) // 2
        zero = np.array([column.mean() for column in (displacement - played.displacement)[-late:].T.copy()])
        homing = self.homing
        rows = homing.voltage.reshape(len(homing), -1)
        homed = stage.simulate(rows, time=homing.time, states=played.state, temperature=later, extrapolate=True)
        start = homed.displacement[-1] + zero
        # Each actuator alone at the ends of its major loop.
        moved = apply(stage.decoupling, homed.displacement)[len(homing) // 2 :]
        bottom, top = moved.min(axis=0), moved.max(axis=0)
        stroke = top - bottom
        # The largest share with which no actuator leaves its range for any motion of the other axes.
        share = _RANGE_SHARE * float((stroke / (np.abs(stage.decoupling) @ stroke)).min())
        middle = apply(stage.coupling, (0.5 * (bottom + top))[None])[0] + zero
        low = apply(stage.coupling, bottom[None])[0] + zero
        wanted = self._wanted(middle - 0.5 * share * stroke, share * stroke, start)
        return _Homed(low, stroke, wanted, homed.state, zero)

    def _wanted(self, origin: Array, reach: Array, start: Array) -> Array:
        """Return the way from the `start` [m] after the homing to the path (n, axes) [m], and the path."""
        branches = self.excitations.branches
        # As many samples as the slowest axis needs for all its turning points.
        count = (len(TURNS) - 1) * max(branches) + 1
        paths = []
        for j, branch in enumerate(branches):
            later = islice(cycle(TURNS[1:]), _TURNS_LATER * j, _TURNS_LATER * j + count // branch + 2)
            turns = TURNS if len(branches) == 1 else tuple(later)
            paths.append(wanted_path(1.0, turns, branch=branch)[:count])
        path = origin + reach * np.column_stack(paths)
        way = [wanted_path(1.0, ends, branch=branches[0]) for ends in np.column_stack([start, path[0]]).tolist()]
        return np.vstack([np.column_stack(way)[1:], path[1:]])

    def _run(self, name: str, homed: _Homed, voltage: Array, warnings: tuple[str, ...] = ()) -> PlannedRun:
        home, several = self.homing, self.homing.voltage.ndim > 1
        shape = (-1, len(self.excitations.limits)) if several else (-1,)
        excitation = Excitation(name, np.concatenate([home.voltage, voltage.reshape(shape)]), home.sample_rate)
        shown = np.concatenate([np.full(home.voltage.shape, np.nan), homed.wanted.reshape(shape)])
        stroke = homed.stroke if several else float(homed.stroke[0])
        return PlannedRun(shown, len(home) + self.excitations.branches[0] - 1, excitation, stroke, warnings)


def later_temperature(model: Actuator | Stage, record: Record, seconds: ArrayLike) -> Array | None:
    """Return the temperatures [degC] to expect some `seconds` (n,) [s] after a record; None if none has an effect.

    The drift of the record's second half goes on, for no longer than the record lasted.
    """
    actuators = model.actuators if isinstance(model, Stage) else (model,)
    values, time, late = record.temperature, record.time - record.time[-1], slice(len(record) // 2, None)
    if values is None or all(actuator.thermal is None for actuator in actuators):
        return None
    drift, last = np.polyfit(time[late], values[late], 1)
    return np.asarray(last + drift * np.minimum(seconds, -time[0]))


def _joined(records: Sequence[Record]) -> tuple[Array, Array, Array, Array | None]:
    """Return time (n,), voltage and displacement (n, axes), known temperature (n,), as far back as times increase."""
    kept = [records[-1]]
    for record in records[-2::-1]:
        if record.time[-1] >= kept[0].time[0]:
            break
        kept.insert(0, record)
    time, voltage, displacement = (
        np.concatenate([getattr(record, column) for record in kept]) for column in ("time", "voltage", "displacement")
    )
    warmth = [record.temperature for record in kept if record.temperature is not None]
    known = np.concatenate(warmth) if len(warmth) == len(kept) else None
    return time, voltage.reshape(time.size, -1), displacement.reshape(time.size, -1), known


@dataclass(frozen=True, eq=False)
class TrackedPath:
    """A measured path of one axis or several.

    `time` (n,) [s], `wanted` and `reached` displacement (n,) or (n, axes) [m], `stroke` [m] of each axis; `axes`: names
    of several axes.
    """

    time: Array
    wanted: Array
    reached: Array
    stroke: Any
    axes: tuple[str, ...] = ()

    @classmethod
    def of(cls, played: PlannedRun, record: Record, rows: NDArray[np.intp]) -> TrackedPath:
        """Compare the `record` of a run `played` with its path; `rows` maps samples of the record to the excitation."""
        along = rows >= played.begin
        time = record.time[along] - record.time[along][0]
        return cls(time, played.wanted[rows[along]], record.displacement[along], played.stroke, record.axes)

    @property
    def error(self) -> Array:
        """Reached minus wanted displacement (n,) or (n, axes) [m]."""
        return self.reached - self.wanted

    @property
    def largest_percent(self) -> float:
        """Largest error [% of the stroke] of a single axis."""
        return percent(largest(self.error), self.stroke)

    @property
    def rms_percent(self) -> float:
        """RMS error [% of the stroke] of a single axis."""
        return percent(rms(self.error), self.stroke)

    @property
    def words(self) -> str:
        """The errors of each axis as text, in % of its stroke."""
        named = zip(self.axes or ("",), self.each, strict=True)
        errors = (
            (axis, f"largest error {path.largest_percent:.3f} %, RMS {path.rms_percent:.3f} %") for axis, path in named
        )
        return "; ".join(f"{axis}: {error}" if axis else error for axis, error in errors)

    @property
    def each(self) -> tuple[TrackedPath, ...]:
        """The path of each axis."""
        if not self.axes:
            return (self,)
        columns = zip(self.wanted.T, self.reached.T, self.stroke.tolist(), strict=True)
        return tuple(TrackedPath(self.time, wanted, reached, stroke) for wanted, reached, stroke in columns)

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values; for several axes, by the name of the axis."""
        if self.axes:
            return {axis: path.as_dict() for axis, path in zip(self.axes, self.each, strict=True)}
        return {
            "largest_percent": self.largest_percent,
            "rms_percent": self.rms_percent,
            "mean_percent": percent(float(self.error.mean()), self.stroke),
            "largest_m": largest(self.error),
            "stroke_m": self.stroke,
        }
