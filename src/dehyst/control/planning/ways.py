"""The voltages before a path: a homing if the start matters, and the way to the first sample."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import RecordError
from dehyst._native import EMPTY
from dehyst._types import Array
from dehyst.control.axis import Axis
from dehyst.control.limits import VoltageLimits
from dehyst.control.planning.homing import FASTEST_BRANCH, Homing, branch_seconds, shortest_homing
from dehyst.control.planning.plan import HOMING, WAY
from dehyst.control.planning.start import PossibleStart, model_error
from dehyst.model import Actuator, State, major_loop, state_at, voltages_of
from dehyst.waveforms import Branch, Excitation, Sampling, volts

# Least number of samples of a branch at the path's sample rate; number of samples of a branch if a path has no time.
_FEWEST, _TIMELESS = 25, 100
# Part of the range of the spring's knots: the error that a homing may leave if the model has a smaller one; and the
# largest error of a path that counts as followed without a promise.
TOLERANCE = 1e-3
# Creep on the way to the first sample changes its voltage: therefore the way is computed this number of times.
_ROUNDS = 3
# Relative differences of times below this are rounding.
_ROUNDING = 1e-9
# A homing with more samples has longer steps: numbers of samples of a branch, and of a period of a resonance. Largest
# voltage between two of its rows, as a part of its range, so that fringes can be counted at these rows.
_EVEN_SAMPLES, _BRANCH_SAMPLES, _RESONANCE_SAMPLES, _ROW_STEP = 100_000, 200, 10, 1e-3
# A file with more rows is larger than 300 MB.
MOST_ROWS = 5_000_000


class Way(NamedTuple):
    """How an actuator stands before a path, or its homing and way to the first sample, excluding this sample.

    `start`: the possible states before; `origin`: the state from which the way is simulated; `state`: at the end.
    `remarks`: on the homing, in sentences. `voltage` (k,) [V] at `time` (k,) [s]. `goal` [V]: voltage at the first
    sample of the path, `seconds` after the first row. `last` [V]: voltage `step` [s] before this sample; None if the
    actuator stands there. `waits`: time [s] at the first voltage, for the homings of other axes.
    """

    start: PossibleStart
    origin: State
    state: State
    homing: Homing | None = None
    remarks: tuple[str, ...] = ()
    time: Array = EMPTY
    phase: NDArray[np.int8] = EMPTY.astype(np.int8)
    voltage: Array = EMPTY
    seconds: float = 0.0
    goal: float = 0.0
    last: float | None = None
    step: float | None = None
    waits: float = 0.0


def past_of(loop: Axis, wanted: Array) -> tuple[float, float]:
    """Return the range of the voltages [V] before a path (n,) [m]: that of the records, if it suffices for the path.

    Limits beyond the records have an effect only where the path needs them.
    """
    (low, high), recorded = loop.limits, voltages_of(loop.actuator)
    usual = max(low, recorded.low), min(high, recorded.high)
    least, most = major_loop(loop.actuator, usual) if usual[0] < usual[1] else (np.inf, -np.inf)
    return usual if least <= wanted.min() and wanted.max() <= most else (low, high)


def stand(loop: Axis, past: Any, known: PossibleStart | None, present: Any, first: float, *, near: bool) -> Way:
    """Return how an actuator stands: as given, or unknown at a voltage [V], or `near` the first sample [m]."""
    actuator, volts = loop.actuator, None
    remarks: tuple[str, ...] = ()
    if known is not None:
        start, state = known, known.within(actuator, loop.limits)
        volts = loop.held(state) if present is None else present_voltage(loop.bounds, present)
    elif near:
        held = actuator.voltage(State(first, np.full(len(actuator.slip), first)))
        start = PossibleStart.unknown(actuator, min(max(held, past[0]), past[1]), past)
        state = start.within(actuator, loop.limits)
    else:
        volts = present_voltage(loop.bounds, present)
        start = PossibleStart.unknown(actuator, volts, past)
        state = start.within(actuator, (volts, volts))
        if present is None and volts:
            words = f"the homing begins at {volts:.6g} V, the limit next to 0 V: ramp there first"
            remarks = (f"{words}, or give the present voltage",)
    return Way(start, state, state, remarks=remarks, last=volts)


def usual_step(time: Array | None) -> float:
    """Return the usual step [s] of a path at `time` (n,) [s]; 1 if the path has no time."""
    if time is None:
        return 1.0
    return float(np.median(np.diff(time))) if time.size > 1 else FASTEST_BRANCH / _FEWEST


def way_to(
    loop: Axis, before: Way, first: float, time: Array | None, *, past: Any, home: bool, within: float | None, rows: int
) -> Way:
    """Return the shortest homing of an axis, if it is to `home`, and the way from its end to a path.

    `before`: how the actuator stands; `past`: the voltages before [V]. `first` [m]: the first sample of the path of the
    model, at `time` (n,) [s] of `rows` samples. `within` [s]: the longest time of homing and way.
    """
    actuator, step = loop.actuator, usual_step(time)
    now, rate = loop.held(before.state) if before.last is None else before.last, 1 / step
    branch = max(FASTEST_BRANCH, _FEWEST * step)
    branch = float(_TIMELESS) if time is None else max(branch, branch_seconds(actuator, branch))
    drive = Sampling(0.5 / branch, rate, base=now, present=now, limits=loop.limits, slew_rate=pace(loop))
    way = before._replace(last=now, step=step)
    if not home:
        ramp, goal, reached = _ramp(actuator, drive, past, before.state, first)
        return _before_path(way._replace(state=reached, goal=goal), ramp, rate, rows)
    least = max(model_error(actuator), TOLERANCE * float(np.ptp(actuator.spring.displacement)))
    homing = played_homing(actuator, drive, past, least, within)
    ramp, goal, reached = _ramp(actuator, drive, past, homing.state, first)
    if within is not None and homing.played.duration + ramp.size * step > within + step:
        # The way is part of the time that is allowed.
        homing = played_homing(actuator, drive, past, least, max(within - ramp.size * step, step))
        ramp, goal, reached = _ramp(actuator, drive, past, homing.state, first)
        if (seconds := homing.played.duration + ramp.size * step) > within + 2 / homing.played.sample_rate:
            # A little more, because the message rounds the number.
            need = f"{1.001 * seconds:.4g} s at least, by the slew rate or the sample rate"
            raise RecordError(argument="home_within", got=f"{within:g} s", need=need)
    remarks = (*before.remarks, *homing.remarks)
    way = way._replace(origin=way.start.state, state=reached, homing=homing, remarks=remarks, goal=goal)
    if len(homing.turns) > 1:
        ahead, volts = _rows(homing.played, step)
        way = way._replace(time=ahead, voltage=volts, seconds=homing.played.duration)
    return _before_path(way, ramp, rate, rows)


def simultaneous(ways: list[Way]) -> list[Way]:
    """Return ways that begin and end simultaneously: a shorter way first waits at its first voltage."""
    ahead = np.unique(np.concatenate([way.time - way.seconds for way in ways]))
    # Rows of two axes at one time may differ by rounding.
    ahead = ahead[np.diff(ahead, append=0.0) > _ROUNDING * np.abs(ahead).max(initial=0.0)]
    if not ahead.size:
        return ways
    homed = [(way.time - way.seconds)[way.phase == WAY] for way in ways]
    ends = max(own[0] if own.size else 0.0 for own in homed)
    homes, seconds = any(way.homing is not None for way in ways), -float(ahead[0])
    phase, merged = np.where(homes & (ahead < ends), HOMING, WAY).astype(np.int8), []
    for way in ways:
        own, values = np.append(way.time - way.seconds, 0.0), np.append(way.voltage, way.goal)
        volts = np.interp(ahead, own, values)
        columns = way._replace(time=ahead - ahead[0], phase=phase, voltage=volts, last=float(volts[-1]))
        merged.append(columns._replace(seconds=seconds, waits=seconds - way.seconds))
    return merged


def _before_path(homed: Way, ramp: Array, rate: float, rows: int) -> Way:
    """Return a homing with the voltages [V] of the way after it, before the `rows` of a path."""
    if homed.voltage.size + ramp.size + rows > MOST_ROWS:
        raise RecordError(
            argument="homing",
            got=f"{homed.voltage.size + ramp.size} samples before the path, {homed.seconds:.4g} s at {rate:g} Hz",
            need=f"at most {MOST_ROWS:g} with it",
            hint="try a lower sample rate, or give the start",
        )
    voltage = np.concatenate([homed.voltage, ramp])
    return homed._replace(
        time=np.concatenate([homed.time, homed.seconds + np.arange(ramp.size) / rate]),
        phase=np.repeat(np.array([HOMING, WAY], dtype=np.int8), [homed.voltage.size, ramp.size]),
        voltage=voltage,
        seconds=homed.seconds + ramp.size / rate,
        last=float(voltage[-1]) if voltage.size else homed.last,
    )


def _rows(played: Excitation, step: float) -> list[Array]:
    """Return time [s] and voltage [V] of a homing without its last sample.

    Where the voltage moves, further rows lie on straight lines between the samples, `step` [s] apart or farther.
    """
    moves = np.abs(np.diff(played.voltage))
    most = min(moves.max() / (_ROW_STEP * np.ptp(played.voltage)), 1 / (played.sample_rate * step))
    samples = np.append(0, np.cumsum(np.where(moves > 0, math.ceil(most - _ROUNDING), 1)))
    return [np.interp(np.arange(samples[-1]), samples, values) for values in (played.time, played.voltage)]


def _ramp(
    actuator: Actuator, drive: Sampling, past: tuple[float, float], state: State, first: float
) -> tuple[Array, float, State]:
    """Return the voltages [V] before the first sample [m] of a path, the voltage at it, and the state before it.

    The way is as fast as a branch through the `past` [V], or slower, so that a mass and an amplifier can follow.
    """
    low, high = drive.limits or (-np.inf, np.inf)
    still = replace(actuator, displacement_creep=None, state=None)  # type: ignore[arg-type]
    begin, end, reached, ramp = drive.start, 0.0, state, EMPTY
    for _ in range(_ROUNDS):
        end = min(max(actuator.voltage(state_at(actuator, reached, first)), low), high)
        if end == begin:
            return EMPTY, end, state
        seconds = max(drive.half * abs(end - begin) / (past[1] - past[0]), branch_seconds(still, 0.0))
        voltage = drive.play("way", [Branch(begin, end, seconds, requested=False)]).voltage
        time = np.arange(voltage.size) / drive.rate
        reached = actuator.simulate(voltage, time=time, state=state, extrapolate=True).state
        ramp = voltage[:-1]
    return ramp, end, reached


def present_voltage(bounds: VoltageLimits, present: float | None) -> float:
    """Return the present voltage [V], by default 0 or the nearest limit; raise `RecordError` outside the limits."""
    if present is None:
        return bounds.nearest(0.0)
    return bounds.within(volts(present, "present"), "present", error=RecordError)


def played_homing(actuator: Actuator, drive: Sampling, past: Any, tolerance: float, within: float | None) -> Homing:
    """Return the shortest homing at the sample rate of a path or a lower one.

    `drive`: speed and shape, with the sample rate of the path, the present voltage and limits. `past`, `tolerance`,
    `within`: as in `shortest_homing`.
    """
    rate = drive.rate
    # A long homing has a lower sample rate: that of the path, divided by a whole number.
    needed = 2 * _BRANCH_SAMPLES * max(drive.frequency, 0.0 if within is None else 2 / max(within, 1 / rate))
    if actuator.dynamics is not None:
        needed = max(needed, _RESONANCE_SAMPLES * actuator.dynamics.frequency)
    drive = replace(drive, sample_rate=rate / max(1, int(rate / needed)))
    given: dict[str, Any] = {"limits": drive.limits, "present": drive.start, "tolerance": tolerance, "within": within}
    homing = shortest_homing(actuator, drive=drive, past=past, **given)
    if len(homing.turns) > 1 and homing.played.duration * rate <= _EVEN_SAMPLES and drive.sample_rate != rate:
        homing = shortest_homing(actuator, drive=replace(drive, sample_rate=rate), past=past, **given)
    return homing


def pace(axis: Axis) -> float | None:
    """Return the largest slew rate [V/s] of jumps, homings and ways: no more than the records of the model have."""
    rates = (axis.slew_rate, axis.actuator.identification.slew_rate)
    return min((rate for rate in rates if rate is not None), default=None)
