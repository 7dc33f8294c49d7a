"""A path planned from what is known of its start: with a homing before it where that matters, and the way to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._errors import ModelError, RecordError
from dehyst._types import Array, Mask
from dehyst._units import per_metre
from dehyst._validation import interval, number, untimely, vector
from dehyst.control.compensator import Compensator
from dehyst.control.limits import VoltageLimits, unit_hint
from dehyst.control.planning.bounds import moves_on
from dehyst.control.planning.homing import FASTEST_LEG, Homing, played_homing, present_voltage, rows_of
from dehyst.control.planning.start import PossibleStart, StartError, model_error
from dehyst.control.planning.timed_homing import leg_seconds
from dehyst.model import Actuator, State
from dehyst.model.states import state_at
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


@dataclass(frozen=True, eq=False)
class HomedPath:
    """A voltage that homes the actuator if need be, leads to the first sample of a path, and follows it.

    Attributes
    ----------
    time : (n,) array or None
        [s] from the first sample of the homing; None if the path has no time. A long homing has rows farther apart
        than the path; between rows the voltage is linear.
    phase : (n,) array
        0 for the homing, 1 for the way to the path, 2 for the path.
    voltage : (n,) array
        [V], within limits and slew rate.
    displacement : (n,) array
        Wanted displacement [m, or `units`]; before the path, and with a given voltage, that of the model.
    expected : (n,) array
        Displacement of the model [m, or `units`], before the path from the middle of the possible states.
    state : State
        At the last sample.
    start : PossibleStart
        The possible states before the homing.
    homing : Homing or None
        With its certificate; None if the state was given.
    clamped : (n,) bool array
        Samples whose voltage was changed to keep limits and slew rate.
    followed : bool
        As that of a `Command`; true if the voltage was given.
    unhomed : StartError or None
        What the start would leave open without the homing, if that is why there is one.
    error : StartError
        What the unknown start leaves open along the path, by playing the whole voltage from all possible states.
    warnings : tuple of str
        Remarks on the homing, and on what was clamped.
    units : str
        Of `displacement`, `expected` and `error`: those of the compensator, "m" by default. `state`, `start` and
        `homing` are in SI units always.
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
    warnings: tuple[str, ...]
    units: str = "m"
    unhomed: StartError | None = None

    def in_units(self, units: str) -> HomedPath:
        """Return the path with its displacements, now in metres, in `units`, such as "um"."""
        counts = per_metre(units)
        return replace(
            self,
            displacement=self.displacement * counts,
            expected=self.expected * counts,
            error=self.error.in_units(units),
            units=units,
        )

    @property
    def first(self) -> int:
        """The first sample of the path."""
        return int(np.count_nonzero(self.phase != PATH))

    @property
    def seconds(self) -> float | None:
        """Time from the first sample to the first one of the path [s]; None if the path has no time."""
        return None if self.time is None else float(self.time[self.first] - self.time[0])

    @property
    def certified(self) -> bool:
        """Whether the state is known: given, or the homing certified or leaves less than the model's error here."""
        return self.homing is None or self.homing.certified or not self.error.matters


def start_at(actuator: Actuator, displacement: float, limits: tuple[float, float] | None = None) -> PossibleStart:
    """Return the unknown start of an actuator that stands at about a displacement.

    `actuator`: the model. `displacement` [m]. `limits` [V]: those of all earlier voltages, by default the actuator's
    `voltage_range`. Raise `ModelError` if the displacement is not finite, or the limits are no interval.
    """
    y = number(displacement, "displacement")
    held = actuator.voltage(State(y, np.full(len(actuator.slip), y)))
    low, high = interval(actuator.voltage_range if limits is None else limits)
    return PossibleStart.unknown(actuator, min(max(held, low), high), (low, high))


def plan_path(
    compensator: Compensator,
    displacement: ArrayLike,
    *,
    time: ArrayLike | None = None,
    velocity: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    start: PossibleStart | None = None,
    home: bool | None = None,
    present: float | None = None,
) -> HomedPath:
    """Compute the voltages of a path from what is known of its start, with a homing before it where that matters.

    Limits and slew rate hold from the present voltage to the last sample.

    Parameters
    ----------
    compensator : Compensator
        Its actuator, limits, slew rate and units; its state does not count.
    displacement, time, velocity, acceleration
        The path, as in `Compensator.trajectory`.
    start : PossibleStart, optional
        The state before the path; default: unknown, at rest near the first sample.
    home : bool, optional
        Whether a way to the first sample comes before the path: from a known start directly, otherwise with the
        shortest homing. Default: from a known start, if one step within the slew rate does not lead there; from an
        unknown one, if it leaves more open along the path than the model's error.
    present : float, optional
        Present voltage [V] before a homing; default 0 V or the nearest limit.

    Raises
    ------
    ModelError
        As `Compensator.trajectory` does.
    RecordError
        If the path is empty, the present voltage lies outside of the limits, or there would be more than 5e6 rows.
    """
    wanted, actuator, limits = compensator.in_metres(displacement), compensator.actuator, compensator.limits
    path: dict[str, Any] = {"time": time, "velocity": velocity, "acceleration": acceleration}
    when = _time(compensator, time, wanted.size)
    if home:
        return _led(compensator, wanted, path, present, start if start is not None and start.known else None)
    begin = start_at(actuator, float(wanted[0]), limits) if start is None else start
    first = state = begin.within(actuator, limits)
    if actuator.model.moves_on or start is None:
        # It stands at the first sample, or is brought there slowly.
        first = state_at(actuator, state, float(wanted[0]))
    held = None if start is None else VoltageLimits(*limits).nearest(actuator.voltage(state))
    command = compensator.trajectory(displacement, **path, state=first, present=held)
    if start is not None and compensator.slew_rate is not None and command.clamped[:1].any():
        led = _led(compensator, wanted, path, None, PossibleStart(start.name, (state,)))
        error = start.error_along(actuator, led.voltage, limits, time=led.time, first=led.first)
        return replace(led, start=start, error=error.in_units(compensator.units))
    planned = HomedPath(
        time=when,
        phase=np.full(wanted.size, PATH),
        voltage=command.voltage,
        displacement=wanted * per_metre(compensator.units),
        expected=command.displacement,
        state=command.state,
        start=begin,
        homing=None,
        clamped=command.clamped,
        followed=command.followed,
        error=begin.error_along(actuator, command.voltage, limits, time=when).in_units(compensator.units),
        warnings=command.warnings,
        units=compensator.units,
    )
    if start is None and home is None and planned.error.matters:
        return replace(_led(compensator, wanted, path, present, None), unhomed=planned.error)
    return planned


def _led(
    compensator: Compensator, wanted: Array, path: dict[str, Any], present: float | None, start: PossibleStart | None
) -> HomedPath:
    """Return the voltages of a path [m] with the way to it before it: from a known start, or by the shortest homing."""
    actuator, when = compensator.actuator, _time(compensator, path["time"], wanted.size)

    def first_state(state: State) -> State:
        return state_at(actuator, state, float(wanted[0]))

    way = _Way.found(
        compensator, when, wanted.size, present, lambda begun: actuator.voltage(first_state(begun)), start=start
    )
    rates: dict[str, Any] = {
        name: None if path[name] is None else compensator.in_metres(path[name], name, per)
        for name, per in (("velocity", "/s"), ("acceleration", "/s**2"))
    }
    # A mass moves with the path from its first sample on.
    state = first_state(way.state) if actuator.model.moves_on else way.state
    command = way.follower.trajectory(wanted, time=when, **rates, state=state, present=way.last)
    played = way.then(command.voltage, when)
    unit = unit_hint(compensator.units, compensator.reach, wanted * per_metre(compensator.units))
    return replace(
        played,
        displacement=np.concatenate([played.expected[: way.size], wanted]),
        expected=np.concatenate([played.expected[: way.size], command.displacement]),
        state=command.state,
        clamped=np.concatenate([played.clamped[: way.size], command.clamped]),
        followed=command.followed,
        warnings=(*played.warnings, *command.warnings, *unit),
    ).in_units(compensator.units)


def plan_voltage(
    compensator: Compensator,
    voltage: ArrayLike,
    *,
    time: ArrayLike | None = None,
    start: PossibleStart | None = None,
    home: bool = False,
    present: float | None = None,
) -> HomedPath:
    """Return the displacement that a voltage causes from what is known of its start, perhaps with a homing before it.

    Parameters
    ----------
    compensator : Compensator
        Its actuator, limits and slew rate, which the homing keeps.
    voltage : (n,) array_like
        [V]; played as it is.
    time, present
        As in `plan_path`.
    start : PossibleStart, optional
        The state before the voltage; default: unknown, at rest at the first one.
    home : bool, optional
        Whether the shortest homing comes first.

    Raises
    ------
    ModelError
        As `Actuator.simulate` does.
    RecordError
        As `plan_path` does.
    """
    given, actuator = vector(voltage, "voltage"), compensator.actuator
    when = _time(compensator, time, given.size)
    if not home:
        start = start or PossibleStart.unknown(actuator, float(given[0]), compensator.limits)
        clock = when if actuator.needs_time else None
        motion = actuator.simulate(given, time=clock, state=start.state, extrapolate=True)
        return HomedPath(
            time=when,
            phase=np.full(given.size, PATH),
            voltage=given,
            displacement=motion.displacement,
            expected=motion.displacement,
            state=motion.state,
            start=start,
            homing=None,
            clamped=np.zeros(given.size, dtype=bool),
            followed=True,
            error=StartError.along(actuator, start.states, given, time=when),
            warnings=(),
        ).in_units(compensator.units)
    way = _Way.found(compensator, when, given.size, present, lambda _: float(given[0]))
    return way.then(given, when).in_units(compensator.units)


def _time(compensator: Compensator, time: ArrayLike | None, size: int) -> Array | None:
    """Return the time of a path [s], None if it has none; raise if it is empty or the time does not fit."""
    if not size:
        raise RecordError(argument="path", got="no samples", need="one at least")
    if time is None:
        period = compensator.period
        return None if period is None else period * np.arange(size, dtype=np.float64)
    when = vector(time, "time")
    if when.size != size or np.any(np.diff(when) <= 0):
        raise ModelError(untimely(when, size))
    return when


@dataclass(frozen=True, eq=False)
class _Way:
    """The homing and the way to the first sample of a path, without that sample."""

    compensator: Compensator
    homing: Homing | None
    start: PossibleStart
    present: float
    time: Array
    phase: NDArray[np.int64]
    voltage: Array
    seconds: float
    step: float
    state: State
    warnings: tuple[str, ...]

    @property
    def size(self) -> int:
        return self.voltage.size

    @property
    def last(self) -> float:
        """The voltage [V] before the first sample of the path."""
        return float(self.voltage[-1]) if self.size else self.present

    @property
    def follower(self) -> Compensator:
        """The compensator of the path, in metres: its first sample comes a step after the last one of the way."""
        one = self.compensator
        period = None if one.slew_rate is None else self.step
        return Compensator(one.actuator, one.limits, one.slew_rate, period=period)

    @classmethod
    def found(
        cls,
        compensator: Compensator,
        time: Array | None,
        size: int,
        present: float | None,
        goal: Callable[[State], float],
        start: PossibleStart | None = None,
    ) -> _Way:
        """Find the shortest homing, and the way from its end to the voltage [V] of the path's first sample.

        No homing from a known `start`.
        """
        actuator, limits = compensator.actuator, compensator.limits
        if start is not None and present is None:
            present = VoltageLimits(*limits).nearest(actuator.voltage(start.state))
        now, rate, leg = present_voltage(limits, present), *_pace(actuator, time)
        least = max(model_error(actuator), _TOLERANCE * float(np.ptp(actuator.spring.displacement)))
        tolerance = least if moves_on(actuator) else None
        drive = Sampling(frequency=0.5 / leg, sample_rate=rate)
        excitation: Excitation | None = None
        homing: Homing | None = None
        remarks: tuple[str, ...] = ()
        if start is None:
            excitation, homing, remarks = played_homing(
                compensator, rate, leg, present=now, drive=drive, tolerance=tolerance
            )
            start = PossibleStart.unknown(actuator, now, limits)
        begin = start.state if homing is None else homing.state
        rows = np.zeros(0, dtype=np.int64) if excitation is None else rows_of(excitation.voltage[:-1])
        homed = np.zeros(0) if excitation is None else excitation.voltage[rows]
        seconds = 0.0 if excitation is None else excitation.duration
        drive = replace(drive, base=now, present=now, limits=limits, slew_rate=compensator.slew_rate)
        way, state = _ramp(actuator, drive, begin, goal)
        if rows.size + way.size + size > MOST_ROWS:
            raise RecordError(
                argument="homing",
                got=f"{rows.size + way.size} samples before the path, {seconds:.4g} s at {rate:g} Hz",
                need=f"at most {MOST_ROWS:g} with it",
                hint="try a lower sample rate, or give the start",
            )
        when = rows / (1.0 if excitation is None else excitation.sample_rate)
        return cls(
            compensator,
            homing,
            start,
            now,
            np.concatenate([when, seconds + np.arange(way.size) / rate]),
            np.repeat([HOMING, WAY], [rows.size, way.size]),
            np.concatenate([homed, way]),
            seconds + way.size / rate,
            1 / rate,
            state,
            remarks,
        )

    def then(self, voltage: Array, time: Array | None) -> HomedPath:
        """Return the way with the voltage of a path after it."""
        actuator = self.compensator.actuator
        whole = np.concatenate([self.voltage, voltage])
        when = None if time is None else np.concatenate([self.time, self.seconds + time - time[0]])
        start = self.start
        clock = when if actuator.needs_time else None
        motion = actuator.simulate(whole, time=clock, state=start.state, extrapolate=True)
        return HomedPath(
            when,
            np.concatenate([self.phase, np.full(voltage.size, PATH)]),
            whole,
            motion.displacement,
            motion.displacement,
            motion.state,
            start,
            self.homing,
            np.zeros(whole.size, dtype=bool),
            True,
            StartError.along(actuator, start.states, whole, time=when, first=self.size),
            self.warnings,
        )


def _pace(actuator: Actuator, time: Array | None) -> tuple[float, float]:
    """Return the sample rate [Hz] of a homing before a path, and the duration of its legs [s]."""
    if time is None:
        return 1.0, float(_TIMELESS)
    step = float(np.median(np.diff(time))) if time.size > 1 else FASTEST_LEG / _FEWEST
    leg = max(FASTEST_LEG, _FEWEST * step)
    return 1 / step, max(leg, leg_seconds(actuator, leg))


def _ramp(actuator: Actuator, drive: Sampling, state: State, goal: Callable[[State], float]) -> tuple[Array, State]:
    """Return the voltages [V] from the end of a homing to the first sample of a path, without it, and the state there.

    The way takes a share of a leg's time, but lets a mass and an amplifier follow.
    """
    low, high = drive.limits or (-np.inf, np.inf)
    still = replace(actuator, creep=None, state=None)  # type: ignore[arg-type]
    begin, reached, way = drive.start, state, np.zeros(0)
    for _ in range(_ROUNDS if actuator.needs_time else 1):
        end = min(max(goal(reached), low), high)
        if end == begin:
            return np.zeros(0), state
        share = abs(end - begin) / (high - low)
        seconds = max(drive.half * share, leg_seconds(still, 0.0))
        voltage = drive.play("way", [Leg(begin, end, seconds, requested=False)]).voltage
        time = np.arange(voltage.size) / drive.rate if actuator.needs_time else None
        reached = actuator.simulate(voltage, time=time, state=state, extrapolate=True).state
        way = voltage[:-1]
    return way, reached
