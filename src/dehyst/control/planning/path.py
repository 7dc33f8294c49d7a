"""Planning of a path from its possible starts: with a homing if the start matters, and the way to the path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._errors import ModelError, RecordError
from dehyst._native import EMPTY
from dehyst._types import Array, Mask
from dehyst._units import per_metre
from dehyst._validation import for_each, untimely, vector
from dehyst.control.compensator import Compensator
from dehyst.control.limits import unit_hint
from dehyst.control.planning.homing import (
    FASTEST_LEG,
    Homing,
    leg_seconds,
    played_homing,
    present_voltage,
    rows_of,
)
from dehyst.control.planning.start import PossibleStart, StartError, model_error
from dehyst.control.planning.states import time_dependence
from dehyst.control.stage_compensator import StageCompensator, axes_of, targets_and_clamped
from dehyst.control.trajectory import Command
from dehyst.model import (
    ANYWAY,
    Actuator,
    Promise,
    Stage,
    State,
    apply,
    promised,
    standing,
    state_at,
    temperature_columns,
    tested_temperatures,
)
from dehyst.waveforms import Excitation, Leg, Sampling

HOMING, WAY, PATH = 0, 1, 2
# Fewest samples of a leg at the path's sample rate, and samples of a leg where a path has no time.
_FEWEST, _TIMELESS = 25, 100
# Share of the range of the spring's knots that a homing in time must leave at most, if the model is better than that.
_TOLERANCE = 1e-3
# Creep on the way to the first sample changes the voltage there: so often the way is found again.
_ROUNDS = 3
# A larger file is more than 300 MB.
MOST_ROWS = 5_000_000
# Of the time before the path: rows of two axes that are closer are one.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class HomedPath:
    """The voltage of one axis for a path: homing if necessary, the way to the first sample, and the path itself.

    Attributes
    ----------
    time : (n,) array or None
        Time [s] from the first sample of the homing; None if the path has no time. Rows of a long homing are farther
        apart than rows of the path; between rows the voltage is linear.
    phase : (n,) array
        0 for the homing, 1 for the way to the path, 2 for the path.
    voltage : (n,) array
        Voltage [V], within limits and slew rate.
    displacement : (n,) array
        Wanted displacement of the axis [m, or `units`]; before the path, and for a given voltage, the model's
        displacement.
    expected : (n,) array
        Displacement of the model [m, or `units`]. It starts from the middle of the possible states; in a homing, where
        the true one is unknown, from a state after slow loops between the limits.
    state : State
        State of the actuator at the last sample.
    start : PossibleStart
        The possible states before the homing.
    homing : Homing or None
        The homing with its certificate; None if there is no homing.
    clamped : (n,) bool array
        Samples whose voltage was changed to keep limits and slew rate.
    followed : bool
        Whether the path is followed, see `Command.followed`; true for a given voltage.
    unhomed : StartError or None
        Error due to the unknown start without a homing, if this error is the reason for the homing.
    error : StartError
        Error along the path due to the unknown start, from simulations of the whole voltage from all possible states.
    promise : Promise or None
        Promised error of the path [m], in addition to that of clamped voltages and of the start; None if the model does
        not hold what its records tested.
    warnings : tuple of str
        Remarks on the homing, on clamped voltages, and on what the records do not test: voltages, speeds, temperatures.
    temperature : (n,) array or None
        Temperature [degC] of the actuator; before the path that of the first sample. None if it is not known.
    units : str
        Unit of `displacement`, `expected` and `error`, as in the compensator, by default "m". `state`, `start`,
        `homing` and `promise` are always in SI units.
    """

    time: Array | None
    phase: NDArray[np.int64]
    voltage: Array
    displacement: Array
    expected: Array
    state: State
    start: PossibleStart
    homing: Homing | None
    clamped: Mask
    followed: bool
    error: StartError
    promise: Promise | None
    warnings: tuple[str, ...]
    temperature: Array | None = None
    units: str = "m"
    unhomed: StartError | None = None

    @property
    def first(self) -> int:
        """Number of the first sample of the path."""
        return int(np.count_nonzero(self.phase != PATH))

    @property
    def left_open(self) -> StartError | None:
        """The error due to the start; None if the start is known."""
        return None if self.homing is None and self.start.known else self.error

    @property
    def seconds(self) -> float | None:
        """Time [s] from the first sample to the first sample of the path; None if the path has no time."""
        return None if self.time is None else float(self.time[self.first] - self.time[0])

    @property
    def certified(self) -> bool:
        """Whether there is no homing, or it is certified, or its error along the path is below the model's error."""
        return self.homing is None or self.homing.certified or not self.error.matters

    def in_units(self, units: str) -> HomedPath:
        """Return the path with its displacements converted from metres to `units`, such as "um"."""
        counts = per_metre(units)
        return replace(
            self,
            displacement=self.displacement * counts,
            expected=self.expected * counts,
            error=self.error.in_units(units),
            unhomed=self.unhomed and self.unhomed.in_units(units),
            units=units,
        )


@overload
def plan_path(
    compensator: Compensator,
    displacement: ArrayLike,
    *,
    time: ArrayLike | None = None,
    velocity: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    temperature: ArrayLike | None = None,
    start: PossibleStart | None = None,
    home: bool | None = None,
    present: float | None = None,
) -> HomedPath: ...
@overload
def plan_path(
    compensator: StageCompensator,
    displacement: ArrayLike,
    *,
    time: ArrayLike | None = None,
    temperature: ArrayLike | None = None,
    start: Sequence[PossibleStart] | None = None,
    home: bool | None = None,
    present: Sequence[float] | None = None,
) -> tuple[HomedPath, ...]: ...
def plan_path(
    compensator: Any,
    displacement: ArrayLike,
    *,
    time: ArrayLike | None = None,
    velocity: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    temperature: ArrayLike | None = None,
    start: Any = None,
    home: bool | None = None,
    present: Any = None,
) -> Any:
    """Compute the voltages of a path from its possible starts, with a homing before it if the start matters.

    Limits and slew rate hold from the present voltage to the last sample. Several axes are homed simultaneously: an
    axis with a shorter homing waits before it, at its present voltage.

    Parameters
    ----------
    compensator : Compensator or StageCompensator
        Source of actuators, limits, slew rates, units and `scaling`; its state has no effect.
    displacement : (n,) or (n, axes) array_like
        The path, as in `Compensator.trajectory`.
    time, velocity, acceleration
        As in `Compensator.trajectory`; velocity and acceleration only for one axis.
    temperature : float, (n,) or (n, axes) array_like, optional
        [degC] of the path, as in `Stage.simulate`; default: not known, and computed with the compensator's `scaling`.
        Without the part `thermal` it is only compared with that of the model's records.
    start : PossibleStart, or one an axis, optional
        The state before the path; default: unknown, at rest near the first sample.
    home : bool, optional
        True: a way to the first sample comes before the path, from a known start directly, otherwise with the shortest
        homing. False: no homing. Default: a homing if the error that an unknown start leaves along the path exceeds the
        model's error. With False and by default, a way leads from a given start or present voltage to a path that one
        step within the slew rate does not reach.
    present : float, or one an axis, optional
        Present voltage [V] of an unknown start: from there the homing begins, or without one the way to the first
        sample. Default 0 V or the nearest limit; without a homing: if none is given, at the first sample.

    Returns
    -------
    HomedPath, or a tuple of one an axis
        For several axes with the same rows in time: displacements are of the axes, with all coupling; states and errors
        are of the actuators.

    Raises
    ------
    ModelError
        As `trajectory` of the compensator does.
    RecordError
        If the path is empty, the present voltage lies outside of the limits, or there would be more than 5e6 rows.
    """
    plan = _Plan(compensator, displacement, "displacement", time, temperature, velocity, acceleration)
    given, now = plan.starts(start), plan.each(present, "present")
    if home:
        return plan.result(plan.led([one if one and one.known else None for one in given], now))
    if all(given):
        return plan.result(plan.begun(given))
    paths = plan.begun(None) if all(one is None for one in now) else plan.standing(now)
    if home is None and any(one.error.matters for one in paths):
        homed = plan.led(given, now)
        paths = [replace(one, unhomed=before.error) for one, before in zip(homed, paths, strict=True)]
    return plan.result(paths)


@overload
def plan_voltage(
    compensator: Compensator,
    voltage: ArrayLike,
    *,
    time: ArrayLike | None = None,
    temperature: ArrayLike | None = None,
    start: PossibleStart | None = None,
    home: bool = False,
    present: float | None = None,
) -> HomedPath: ...
@overload
def plan_voltage(
    compensator: StageCompensator,
    voltage: ArrayLike,
    *,
    time: ArrayLike | None = None,
    temperature: ArrayLike | None = None,
    start: Sequence[PossibleStart | None] | None = None,
    home: bool = False,
    present: Sequence[float] | None = None,
) -> tuple[HomedPath, ...]: ...
def plan_voltage(
    compensator: Any,
    voltage: ArrayLike,
    *,
    time: ArrayLike | None = None,
    temperature: ArrayLike | None = None,
    start: Any = None,
    home: bool = False,
    present: Any = None,
) -> Any:
    """Return the displacement that a voltage causes from its possible starts, optionally with a homing before it.

    Parameters
    ----------
    compensator : Compensator or StageCompensator
        Source of actuators and `scaling`, and of limits and slew rates for the homing.
    voltage : (n,) or (n, axes) array_like
        Voltages [V], which are not changed.
    time, temperature, present
        As in `plan_path`.
    start : PossibleStart, or one an axis, optional
        The state before the voltage; default: unknown, at rest at the first voltage.
    home : bool, optional
        Whether the shortest homing comes first.

    Returns
    -------
    HomedPath, or a tuple of one an axis

    Raises
    ------
    ModelError
        As `Actuator.simulate` does.
    RecordError
        As `plan_path` does.
    """
    plan = _Plan(compensator, voltage, "voltage", time, temperature)
    given = plan.starts(start)
    if home:
        ways = plan.ways([None] * len(given), plan.each(present, "present"))
    else:
        starts = [
            known or PossibleStart.unknown(one.actuator, volts, one.limits)
            for known, one, volts in zip(given, plan.loops, plan.firsts, strict=True)
        ]
        ways = [_Way(known, known.state) for known in starts]
    size = ways[0].voltage.size
    moved, states = plan.motion(ways, plan.rows)
    commands = [
        Command(volts, y, np.zeros(y.size, dtype=bool), state, (), 0.0, True)
        for volts, y, state in zip(plan.rows.T, moved[size:].T, states, strict=True)
    ]
    return plan.result(plan.joined(ways, plan.lead(ways) if home else moved[:size], commands, moved[size:]))


class _Way(NamedTuple):
    """The homing of an axis and the way to the first sample of a path, excluding this sample.

    `state`: state at the end, simulated from the middle of the possible states. `voltage` (k,) [V] at `time` (k,) [s].
    `goal` [V]: voltage at the first sample of the path, `seconds` after the first row. `last` [V]: voltage `step` [s]
    before this sample. `waits`: time [s] at the first voltage, for the homings of other axes.
    """

    start: PossibleStart
    state: State
    homing: Homing | None = None
    warnings: tuple[str, ...] = ()
    time: Array = EMPTY
    phase: NDArray[np.int64] = EMPTY.astype(np.int64)
    voltage: Array = EMPTY
    seconds: float = 0.0
    goal: float = 0.0
    last: float = 0.0
    step: float = 0.0
    waits: float = 0.0


class _Plan:
    """A path [m] or a voltage [V] of one axis or several, as `rows` (n, axes) at `time` (n,) [s] or None.

    `targets` (axes, n): voltage [V] or displacement [m] of each actuator's model, without gain and offset. `firsts`:
    the first of these. `temperature` (n, axes) [degC]: of the actuators; `warmth`: those that have an effect.
    """

    def __init__(
        self,
        compensator: Compensator | StageCompensator,
        rows: ArrayLike,
        what: str,
        time: ArrayLike | None,
        temperature: ArrayLike | None,
        velocity: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
    ) -> None:
        self.compensator, self.loops, self.voltage = compensator, axes_of(compensator), what == "voltage"
        self.single = compensator if isinstance(compensator, Compensator) else None
        if isinstance(compensator, Compensator):
            self.stage = Stage((compensator.actuator,))
            self.rows = (vector(rows, what) if self.voltage else compensator.in_metres(rows))[:, None]
        else:
            self.stage = compensator.stage
            self.rows = self.stage.columns(rows, what)
        size, period = len(self.rows), compensator.period
        if not size:
            raise RecordError(argument="path", got="no samples", need="one at least")
        actuators = self.stage.actuators
        self.temperature: Array | None = None
        self.warmth: list[Array | None] = [None] * len(actuators)
        if temperature is not None:
            self.temperature = temperature_columns(temperature, size, len(actuators))
            if any(one.thermal for one in actuators) or not any(map(tested_temperatures, actuators)):
                self.warmth = self.stage.temperatures(self.temperature, size)
        self.targets, self.firsts = self.rows.T, self.rows[0].tolist()
        if not self.voltage:
            moved = apply(self.stage.decoupling, self.rows).T
            scales = [one.scaling_at(degrees, size) for one, degrees in zip(self.loops, self.warmth, strict=True)]
            self.targets = np.array([(y - offset) / gain for y, (gain, offset) in zip(moved, scales, strict=True)])
            strays = "" if self.single is None else self.single.straying(self.targets[0])
            if strays:
                raise ModelError(f"{strays}; {ANYWAY}")
            self.firsts = self.firsts_within(scales)
        self.time = None if period is None else period * np.arange(size, dtype=np.float64)
        if time is not None:
            self.time = vector(time, "time")
            if self.time.size != size or np.any(np.diff(self.time) <= 0):
                raise ModelError(untimely(self.time, size))
        given = {"velocity": velocity, "acceleration": acceleration}
        self.rates = {
            name: self.loops[0].in_metres(values, name) for name, values in given.items() if values is not None
        }
        if self.rates and self.single is None:
            raise ModelError(argument=min(self.rates), got="it for several axes", need="a path of one axis")

    def firsts_within(self, scales: Sequence[tuple[Any, Any]]) -> list[float]:
        """Return the `firsts` if axes within reach are corrected by what the others miss, as in each step.

        `scales`: gains and offsets [m] of the axes.
        """
        gains, offsets = ([float(np.ravel(values)[0]) for values in column] for column in zip(*scales, strict=True))

        def nearest(j: int, target: float) -> float | None:
            one = self.loops[j]
            low, high = (offsets[j] + gains[j] * end for end in one.actuator.major_loop(one.limits))
            return None if low <= target <= high else min(max(target, low), high)

        targets, _ = targets_and_clamped(self.stage.decoupling.tolist(), self.rows[0].tolist(), nearest)
        return [(target - offset) / gain for target, gain, offset in zip(targets, gains, offsets, strict=True)]

    def each(self, values: Any, what: str) -> list[Any]:
        """Return one entry for each axis."""
        return for_each(values, len(self.loops), what)

    def starts(self, given: Any) -> list[Any]:
        """Return the start of each axis, None if none was given."""
        starts = self.each(given, "start")
        for one in starts:
            if one is not None and not isinstance(one, PossibleStart):
                hint = 'PossibleStart.named(actuator, "top") makes one'
                raise ModelError(argument="start", got=repr(one), need="a PossibleStart", hint=hint)
        return starts

    def result(self, paths: list[HomedPath]) -> Any:
        """Return the paths of several axes, or the path of the only axis, in the units of its compensator."""
        if self.single is None:
            return tuple(paths)
        units = self.single.units
        hint = unit_hint(units, self.single.reach, self.rows[:, 0] * per_metre(units))
        return replace(paths[0], warnings=(*paths[0].warnings, *hint)).in_units(units)

    def degrees(self, temperature: Array | None, before: int, size: int) -> Array | None:
        """Return a temperature (n,) [degC] for `before` rows and `size` samples after them; before, it is the first."""
        return None if temperature is None else np.concatenate([np.full(before, temperature[0]), temperature[:size]])

    def standing(self, present: Sequence[float | None]) -> list[HomedPath]:
        """Return the voltages of the path from unknown starts at present voltages [V], with a way as in `begun`."""
        held = [present_voltage(one.bounds, now) for one, now in zip(self.loops, present, strict=True)]
        pairs = list(zip(self.loops, held, strict=True))
        return self.begun([PossibleStart.unknown(one.actuator, now, one.limits) for one, now in pairs], held)

    def begun(self, given: list[PossibleStart] | None, present: list[float] | None = None) -> list[HomedPath]:
        """Return the voltages of the path, with a way before it if its first step would exceed the slew rate.

        `present` [V]: of given starts; by default as their states.
        """
        starts = given or [
            PossibleStart.unknown_near(one.actuator, y, one.limits)
            for one, y in zip(self.loops, self.firsts, strict=True)
        ]
        places = [one.limits for one in self.loops] if present is None else [(now, now) for now in present]
        states = [
            start.within(one.actuator, place) for start, one, place in zip(starts, self.loops, places, strict=True)
        ]
        # An actuator stands at the first sample, or is brought there slowly.
        begins = [
            state_at(one.actuator, state, y) if given is None or one.actuator.model.has_dynamics else state
            for one, state, y in zip(self.loops, states, self.firsts, strict=True)
        ]
        held = present or [one.held(state) for one, state in zip(self.loops, states, strict=True)]
        commands = self.follow(begins, None if given is None else held, self.compensator.period)
        jumps = [one.slew_rate and command.clamped[0] for one, command in zip(self.loops, commands, strict=True)]
        if given is not None and any(jumps):
            known = [PossibleStart(start.name, (state,)) for start, state in zip(starts, states, strict=True)]
            return self.led(known, held, given)
        ways = [_Way(start, start.state) for start in starts]
        return self.joined(ways, np.zeros((0, len(starts))), commands, self.rows)

    def led(
        self,
        known: Sequence[PossibleStart | None],
        present: Sequence[float | None],
        starts: list[PossibleStart] | None = None,
    ) -> list[HomedPath]:
        """Return the voltages of the path after a way from known starts, or after the shortest homing.

        `starts`: start of each axis, if `known` has only the middle of its possible states.
        """
        ways = self.ways(known, present)
        # A mass moves with the path from its first sample on.
        begins = [
            state_at(one.actuator, way.state, y) if one.actuator.model.has_dynamics else way.state
            for one, way, y in zip(self.loops, ways, self.firsts, strict=True)
        ]
        commands = self.follow(begins, [way.last for way in ways], ways[0].step)
        before = self.lead(ways)
        if starts:
            ways = [way._replace(start=start) for way, start in zip(ways, starts, strict=True)]
        return self.joined(ways, before, commands, self.rows)

    def follow(self, states: list[State], present: list[float] | None, period: float | None) -> Sequence[Command]:
        """Return the voltages of the path from given states; it begins one `period` after the present voltages."""
        if self.single is not None:
            one = Compensator(self.single.actuator, self.single.limits, self.single.slew_rate, period=period)
            self.scale((one,))
            options: dict[str, Any] = {"time": self.time, "temperature": self.warmth[0], **self.rates}
            begin = None if present is None else present[0]
            return [one.trajectory(self.rows[:, 0], state=states[0], present=begin, **options)]
        limits, slews = [one.limits for one in self.loops], [one.slew_rate for one in self.loops]
        several = StageCompensator(self.stage, period=period, limits=limits, slew_rate=slews, states=states)
        self.scale(several.compensators)
        warm = self.temperature if any(degrees is not None for degrees in self.warmth) else None
        return several.trajectory(self.rows, time=self.time, temperature=warm, present=present)

    def scale(self, others: Sequence[Compensator]) -> None:
        """Set in compensators in metres the gain and offset that those of the axes have."""
        for one, other in zip(self.loops, others, strict=True):
            if one.scaling != (1.0, 0.0):
                other.scale(*one.scaling_at(None, 1))

    def ways(self, starts: Sequence[PossibleStart | None], present: Sequence[float | None]) -> list[_Way]:
        """Return the ways to the first sample, which begin and end simultaneously: an axis with a shorter way waits.

        It waits at its present voltage, so that its homing, which makes the state known, ends with the way to the path.
        """
        ways = [
            self.way(one, start, now, first)
            for one, start, now, first in zip(self.loops, starts, present, self.firsts, strict=True)
        ]
        ahead = np.unique(np.concatenate([one.time - one.seconds for one in ways]))
        # Rows of two axes at one time may differ by rounding.
        ahead = ahead[np.diff(ahead, append=0.0) > _ROUNDING * np.abs(ahead).max(initial=0.0)]
        if self.single is not None or not ahead.size:
            return ways
        homed = [(one.time - one.seconds)[one.phase == WAY] for one in ways]
        ends = max(own[0] if own.size else 0.0 for own in homed)
        homes = any(one.homing is not None for one in ways)
        phase = np.where(homes & (ahead < ends), HOMING, WAY)
        merged = []
        for one in ways:
            own, values = np.append(one.time - one.seconds, 0.0), np.append(one.voltage, one.goal)
            voltage = np.interp(ahead, own, values)
            merged.append(one._replace(time=ahead - ahead[0], phase=phase, voltage=voltage, last=float(voltage[-1])))
        states = self.motion(merged)[1]
        seconds = -float(ahead[0])
        return [
            one._replace(seconds=seconds, state=state, waits=seconds - one.seconds)
            for one, state in zip(merged, states, strict=True)
        ]

    def way(self, one: Compensator, start: PossibleStart | None, present: float | None, first: float) -> _Way:
        """Return the shortest homing of an axis (none from a known start), and the way from its end to the path."""
        actuator, limits = one.actuator, one.limits
        now = present_voltage(one.bounds, one.held(start.state) if start and present is None else present)
        rate, leg = self.pace(actuator)
        drive = Sampling(frequency=0.5 / leg, sample_rate=rate)
        played: Excitation | None = None
        homing: Homing | None = None
        remarks: tuple[str, ...] = ()
        if start is None:
            least = max(model_error(actuator), _TOLERANCE * float(np.ptp(actuator.spring.displacement)))
            tolerance = least if time_dependence(actuator) else None
            played, homing, remarks = played_homing(one, rate, leg, present=now, drive=drive, tolerance=tolerance)
            start = PossibleStart.unknown(actuator, now, limits)
        rows = rows_of(EMPTY if played is None else played.voltage[:-1])
        seconds = 0.0 if played is None else played.duration
        drive = replace(drive, base=now, present=now, limits=limits, slew_rate=one.slew_rate)
        state = start.state if homing is None else homing.state
        ramp, goal, state = self.ramp(actuator, drive, state, first)
        if rows.size + ramp.size + len(self.rows) > MOST_ROWS:
            raise RecordError(
                argument="homing",
                got=f"{rows.size + ramp.size} samples before the path, {seconds:.4g} s at {rate:g} Hz",
                need=f"at most {MOST_ROWS:g} with it",
                hint="try a lower sample rate, or give the start",
            )
        homed, when = (EMPTY, EMPTY) if played is None else (played.voltage[rows], rows / played.sample_rate)
        voltage = np.concatenate([homed, ramp])
        return _Way(
            start,
            state,
            homing,
            remarks,
            np.concatenate([when, seconds + np.arange(ramp.size) / rate]),
            np.repeat([HOMING, WAY], [rows.size, ramp.size]),
            voltage,
            seconds + ramp.size / rate,
            goal,
            last=float(voltage[-1]) if voltage.size else now,
            step=1 / rate,
        )

    def pace(self, actuator: Actuator) -> tuple[float, float]:
        """Return the sample rate [Hz] of a homing before the path, and the duration of its legs [s]."""
        if self.time is None:
            return 1.0, float(_TIMELESS)
        step = float(np.median(np.diff(self.time))) if self.time.size > 1 else FASTEST_LEG / _FEWEST
        leg = max(FASTEST_LEG, _FEWEST * step)
        return 1 / step, max(leg, leg_seconds(actuator, leg))

    def ramp(self, actuator: Actuator, drive: Sampling, state: State, first: float) -> tuple[Array, float, State]:
        """Return the voltages [V] before the first sample of the path, its own voltage, and the state before it.

        The way takes a share of a leg's duration, but at least enough time for a mass and an amplifier to follow.
        """
        low, high = drive.limits or (-np.inf, np.inf)
        still = replace(actuator, creep=None, displacement_creep=None, state=None)  # type: ignore[arg-type]
        begin, end, reached, ramp = drive.start, 0.0, state, EMPTY
        for _ in range(_ROUNDS if actuator.needs_time else 1):
            end = first if self.voltage else actuator.voltage(state_at(actuator, reached, first))
            end = min(max(end, low), high)
            if end == begin:
                return EMPTY, end, state
            seconds = max(drive.half * abs(end - begin) / (high - low), leg_seconds(still, 0.0))
            voltage = drive.play("way", [Leg(begin, end, seconds, requested=False)]).voltage
            time = np.arange(voltage.size) / drive.rate if actuator.needs_time else None
            reached = actuator.simulate(voltage, time=time, state=state, extrapolate=True).state
            ramp = voltage[:-1]
        return ramp, end, reached

    def time_of(self, way: _Way, size: int) -> Array | None:
        """Return the time [s] of the rows of a way and of `size` samples after it; None if the path has no time."""
        if self.time is None:
            return None
        return np.concatenate([way.time, way.seconds + (self.time - self.time[0])[:size]])

    def motion(self, ways: Sequence[_Way], rows: Array | None = None) -> tuple[Array, list[State]]:
        """Return the displacement (k, axes) [m] along ways and then voltages (n, axes) [V], and the last states."""
        after = np.zeros((0, len(ways))) if rows is None else rows
        time = self.time_of(ways[0], len(after))
        moved, states = [], []
        for one, way, volts, warmth in zip(self.loops, ways, after.T, self.warmth, strict=True):
            voltage, clock = np.concatenate([way.voltage, volts]), time if one.actuator.needs_time else None
            motion = one.actuator.simulate(voltage, time=clock, state=way.start.state, extrapolate=True)
            gain, offset = one.scaling_at(self.degrees(warmth, way.voltage.size, volts.size), voltage.size)
            moved.append(offset + gain * motion.displacement)
            states.append(motion.state)
        return apply(self.stage.coupling, np.column_stack(moved)), states

    def lead(self, ways: Sequence[_Way]) -> Array:
        """Return the displacement (k, axes) [m] along ways, from a state within the limits if the start is unknown."""
        begun = []
        for one, way in zip(self.loops, ways, strict=True):
            start = way.start
            if not start.known and way.voltage.size:
                start = replace(start, states=(standing(one.actuator, float(way.voltage[0]), one.limits),))
            begun.append(way._replace(start=start))
        return self.motion(begun)[0]

    def joined(
        self, ways: Sequence[_Way], before: Array, commands: Sequence[Command], wanted: Array
    ) -> list[HomedPath]:
        """Return the path of each axis: its way, with displacements `before` (k, axes) [m], then its command."""
        size, first = len(wanted), ways[0].voltage.size
        time, phase = self.time_of(ways[0], size), np.concatenate([ways[0].phase, np.full(size, PATH)])
        temperatures = [None] * len(ways) if self.temperature is None else list(self.temperature.T)
        columns = self.loops, ways, commands, before.T, wanted.T, self.warmth, temperatures
        paths = []
        for j, (one, way, command, led, path, warmth, temperature) in enumerate(zip(*columns, strict=True)):
            voltage = np.concatenate([way.voltage, command.voltage])
            error = way.start.error_along(one.actuator, voltage, one.limits, time=time, first=first)
            gain, offset = one.scaling_at(warmth, size)
            error = replace(error, lowest=offset + gain * error.lowest, highest=offset + gain * error.highest)
            promise, untested = promised(one.actuator, command.voltage, self.time, temperature, way.waits)
            speeds = () if self.voltage else self.speeds(j, command)
            paths.append(
                HomedPath(
                    time,
                    phase,
                    voltage,
                    displacement=np.concatenate([led, path]),
                    expected=np.concatenate([led, command.displacement]),
                    state=command.state,
                    start=way.start,
                    homing=way.homing,
                    clamped=np.concatenate([np.zeros(first, dtype=bool), command.clamped]),
                    followed=command.followed,
                    error=error,
                    promise=promise,
                    warnings=(*way.warnings, *command.warnings, *speeds, *untested),
                    temperature=self.degrees(temperature, first, size),
                )
            )
        return paths

    def speeds(self, j: int, command: Command) -> tuple[str, ...]:
        """Return a remark if the path of an axis needs more than its slew rate, or than the speed of the records."""
        one, voltage = self.loops[j], command.voltage
        if self.time is None or self.time.size < 2:
            return ()
        if not command.clamped.any():
            # Nothing was held back.
            return speed_remark(one.actuator, float(np.abs(np.diff(voltage) / np.diff(self.time)).max()))
        gain = one.scaling_at(self.warmth[j], len(self.rows))[0]
        rates = {name: values / gain for name, values in self.rates.items()}
        needed = needed_slew_rate(one.actuator, self.targets[j], self.time, one.limits, **rates)
        return speed_remark(one.actuator, needed, one.slew_rate)


def needed_slew_rate(
    actuator: Actuator,
    displacement: Array,
    time: Array,
    limits: tuple[float, float],
    *,
    temperature: ArrayLike | None = None,
    **rates: Array,
) -> float:
    """Return the slew rate [V/s] that a path (n,) [m] at `time` (n,) [s] needs within `limits` [V], n at least 2.

    `temperature`, and `rates`, a velocity and an acceleration: as in `Actuator.compensate`.
    """
    first = displacement[:1]
    if actuator.thermal is not None and temperature is not None:
        first = actuator.thermal.at_reference(displacement, temperature)[:1]
    options: dict[str, Any] = {"time": time, "temperature": temperature, **rates}
    state = state_at(actuator, actuator.state, float(first[0]))
    voltage = actuator.compensate(displacement, **options, state=state, extrapolate=True).voltage
    return float(np.abs(np.diff(np.clip(voltage, *limits)) / np.diff(time)).max())


def speed_remark(actuator: Actuator, needed: float, slew_rate: float | None = None) -> tuple[str, ...]:
    """Return a remark if a path needs more V/s than its `slew_rate`, or than the records of its model have; or none."""
    recorded, words = actuator.recorded_slew_rate, f"the path needs up to {needed:.4g} V/s"
    held = slew_rate is not None and needed > slew_rate
    if recorded is not None and needed > recorded:
        margin = f"with a margin of 5 % ({recorded:.4g} V/s)"
        words += f", {needed / recorded:.3g} times the speed of the model's records {margin}"
    elif not held:
        return ()
    return (f"{words}: held back to {slew_rate:.4g} V/s" if held else words,)
