"""The virtual bench behind every emulator: amplifiers, wave generators, sensors and a recorder, without I/O."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import DeviceError
from dehyst._types import Array
from dehyst._validation import interval, vector
from dehyst.control import VoltageLimits
from dehyst.virtual.base import Sensor, VirtualActuator
from dehyst.virtual.stage import VirtualStage

# Duration of a voltage jump, as a share of a servo period; steps in which a ramp is played, as a share of the range.
_JUMP, _PART = 1e-3, 0.01
# A voltage put out up to this share of a servo period after a sample belongs to that sample.
_LATE = 0.1


@dataclass
class Extremes:
    """The extremes of all voltages that an amplifier has put out.

    `lowest`, `highest`: voltages [V]. `largest_step`: largest change from one voltage to the next [V]. `steepest`:
    largest slew rate [V/s]: this change over the device's time between the voltages, or over a servo period if that is
    longer. `refused`: number of refused requests, outside the limits.
    """

    lowest: float
    highest: float
    largest_step: float = 0.0
    steepest: float = 0.0
    refused: int = 0

    def update(self, voltage: Array, seconds: Array) -> None:
        """Include voltages (n + 1,) [V], the present voltage first, and the seconds (n,) between them."""
        steps = np.abs(np.diff(voltage))
        self.lowest = min(self.lowest, float(voltage.min()))
        self.highest = max(self.highest, float(voltage.max()))
        self.largest_step = max(self.largest_step, float(steps.max(initial=0.0)))
        self.steepest = max(self.steepest, float((steps / seconds).max(initial=0.0)))


class BenchAxis:
    """One axis of a `VirtualBench`: amplifier, wave generator and sensor. Its time is the bench's time.

    `limits`: lowest and highest voltage [V] of the amplifier. `voltage`, `target`: present output, and target voltage
    [V]. `log`: extremes of the output so far. `stroke`: stroke of the actuator [m]. `sensor_range`: lowest and highest
    displacement [m] of the sensor, which saturates beyond. `unplugged`: the reading of the sensor is constant. `servo`:
    a closed loop holds the voltage, and requests are refused. `stalled`: the wave generator stops playing, but does not
    report an end. `played`: number of samples of the present or last wave that were put out so far.
    """

    def __init__(
        self,
        stage: VirtualStage,
        index: int,
        limits: VoltageLimits,
        servo_period: float,
        sensor_range: tuple[float, float] | None,
        noise: float,
        seed: int,
    ) -> None:
        self._stage, self._index, self._limits, self._servo_period = stage, index, limits, servo_period
        self.limits, self.stroke = (limits.low, limits.high), float(stage.strokes[index])
        self.voltage = self.target = limits.nearest(0.0)
        self.log = Extremes(self.voltage, self.voltage)
        # Time of the present state, and of the last voltage that was put out [s].
        self._at = self._put_at = -servo_period
        stage.drive(index, np.array([0.0, self.voltage]), [-2 * servo_period, -servo_period])
        self.sensor_range = None if sensor_range is None else interval(sensor_range)
        self._sensor = Sensor(noise, seed)
        self.unplugged = self.stalled = self.servo = False
        self._wave, self.played, self._first, self._period = np.zeros(0), 0, 0.0, servo_period

    @property
    def planned(self) -> int:
        """Number of samples of the present or last wave; a stopped wave ends where it was stopped."""
        return self._wave.size

    @property
    def playing(self) -> bool:
        """Whether a wave is being played."""
        return self.played < self._wave.size

    def displacement(self) -> float:
        """Return the sensor's reading [m] at present; while a wave is played, at its latest sample."""
        return float(self.sensed(self._stage.present()[self._index : self._index + 1])[0])

    def set_voltage(self, voltage: float) -> bool:
        """Put out a `voltage` [V], at the slew rate; return False, and do nothing, if it is outside the limits.

        Raise `DeviceError` if the servo is on or a wave is played.
        """
        self._demand_open("set_voltage")
        if not self._allows(np.array([voltage])):
            return False
        self.target = float(voltage)
        if self._limits.slew_rate is None:
            self._put_out(np.array([self.target]), np.array([self._at]))
        return True

    def stop(self) -> None:
        """Stop the wave, or the moving output; the voltage stays."""
        self._wave, self.target = self._wave[: self.played], self.voltage

    def sensed(self, displacement: Array) -> Array:
        """Return the sensor's reading (n,) [m] of a `displacement` (n,) [m]."""
        low, high = self.sensor_range or (-math.inf, math.inf)
        if self.unplugged:
            return np.full(displacement.size, low if math.isfinite(low) else 0.0)
        return np.clip(self._sensor.read(displacement), low, high)

    def admitted(self, wave: ArrayLike, divider: int, most: int) -> Array:
        """Return the voltages (n,) [V] that `begin` would play; raise `DeviceError` if it cannot play them.

        `wave` (n,) [V]; `divider` as in `VirtualBench.start`; `most`: largest number of samples.
        """
        self._demand_open("start")
        v = vector(wave, "wave")
        if not 0 < v.size <= most or divider < 1:
            raise DeviceError(
                argument="start", got=f"{v.size} samples and divider {divider}", need=f"1 to {most} and 1 or more"
            )
        if not self._allows(v):
            raise DeviceError(argument="start", got=f"{v.min():.6g} to {v.max():.6g} V", need=self._limits.words)
        return v

    def begin(self, wave: Array, period: float) -> None:
        """Play an admitted `wave` (n,) [V] from now on, one voltage each `period` [s]."""
        self._wave, self.played, self._first, self._period = wave, 0, self._at, period

    def times(self, first: int, stop: int) -> Array:
        """Return the times (n,) [s] of samples of the wave, from `first` to the one before `stop`."""
        return np.asarray(self._first + self._period * np.arange(first, stop), dtype=np.float64)

    def advance(self, now: float) -> None:
        """Continue until `now` [s]: play the due samples of the wave, or let the actuator creep."""
        if self.playing and not self.stalled:
            # The margin keeps a sample that is due now in spite of rounding.
            due = min(self._wave.size, math.floor((now - self._first) / self._period + 1e-6) + 1)
            if due > self.played:
                self._follow(self._wave[self.played : due], self.times(self.played, due))
                self.played = due
        if self.playing or now <= self._at:
            return
        if self.voltage != self.target:
            self._ramp(now)
        if now > self._at:
            self._stage.drive(self._index, np.array([self.voltage]), [now])
            self._at = now

    def _demand_open(self, what: str) -> None:
        if self.servo:
            raise DeviceError(f"{what}: the servo is on, need it off")
        if self.playing:
            raise DeviceError(f"{what}: a wave is being played; stop it first")

    def _allows(self, voltage: Array) -> bool:
        """Return whether all voltages (n,) [V] are finite and within the limits; if not, count a refusal."""
        if bool(np.all((voltage >= self._limits.low) & (voltage <= self._limits.high))):
            return True
        self.log.refused += 1
        return False

    def _put_out(self, voltage: Array, at: Array) -> None:
        """Put out voltages (n,) [V] at times (n,) [s], in straight lines; every output goes through this method.

        Raise `DeviceError`, and put out nothing, if a voltage is outside the limits.
        """
        if not self._allows(voltage):
            raise DeviceError(f"amplifier: got {voltage.min():.6g} to {voltage.max():.6g} V, need {self._limits.words}")
        seconds = np.diff(at, prepend=self._put_at)
        # Rounding may make times that are one period apart a little closer.
        self.log.update(np.append(self.voltage, voltage), np.maximum(seconds, self._servo_period * (1 - 1e-6)))
        times = at.copy()
        times[0] = max(times[0], self._at + _JUMP * self._servo_period)
        self._stage.drive(self._index, voltage, times)
        self.voltage = self.target = float(voltage[-1])
        self._at, self._put_at = float(times[-1]), float(at[-1])

    def _follow(self, wave: Array, at: Array) -> None:
        """Put out a wave (n,) [V] at times (n,) [s], within the slew rate."""
        voltage = wave
        if self._limits.slew_rate is not None:
            largest = self._limits.slew_rate * np.diff(at, prepend=self._at)
            out, v = [], self.voltage
            for wanted, most in zip(wave.tolist(), largest.tolist(), strict=True):
                v = min(max(wanted, v - most), v + most)
                out.append(v)
            voltage = np.array(out)
        self._put_out(voltage, at)
        self.target = float(wave[-1])

    def _ramp(self, now: float) -> None:
        """Move the output towards its target at the slew rate, until `now` [s]."""
        target, start, begin = self.target, self.voltage, self._at
        arrival = begin + abs(target - start) / float(self._limits.slew_rate or math.inf)
        share = 1.0 if now >= arrival else (now - begin) / (arrival - begin)
        until, end = min(now, arrival), start + share * (target - start) if share < 1 else target
        parts = math.ceil(abs(end - start) / (_PART * (self._limits.high - self._limits.low)))
        part = np.linspace(0.0, 1.0, 1 + max(1, parts if until - begin > self._servo_period else 1))[1:]
        path = start + part * (end - start)
        path[-1] = end
        self._put_out(path, begin + part * (until - begin))
        self.target = target


class VirtualBench:
    """A piezo controller without a protocol, without input and output, and without threads; a clock gives its time.

    Every method and property of the bench first advances it to the present. Between calls its time stands still, so
    that actions on several of its `axes` happen at one instant. It is not thread-safe: a server must hold a lock.

    Raise `ModelError` if the limits are not an interval, or the slew rate is not positive.

    Parameters
    ----------
    device : VirtualActuator or VirtualStage
        The connected actuator, or a body with one actuator for each axis, at rest at 0 V; its fingerprint is the
        `serial` number.
    limits : (float, float) or sequence of (float, float), optional
        Limits of the amplifiers [V], for all axes or for each; default: 0 V to the highest voltage of the actuator.
    slew_rate : float, optional
        Slew rate of the amplifiers [V/s], for voltages and waves; default: a voltage is reached at once.
    servo_period : float, optional
        Period of the servo [s]; the time between samples of a wave is a whole number of periods.
    wave_points, record_points : int, optional
        Sizes of the memories of each wave generator and of the recorder, for each axis.
    sensor_range : (float, float), optional
        Lowest and highest displacement [m] of each sensor.
    clock : callable, optional
        Function that returns the time [s], which never decreases.
    speed : float, optional
        Seconds of the device for each second of the clock.
    noise, seed : float, int, optional
        Standard deviation [m] and seed of the sensors' noise; default: those of the device, or no noise.
    """

    def __init__(
        self,
        device: VirtualActuator | VirtualStage,
        *,
        limits: tuple[float, float] | Sequence[tuple[float, float]] | None = None,
        slew_rate: float | None = None,
        servo_period: float = 5e-5,
        wave_points: int = 65536,
        record_points: int = 65536,
        sensor_range: tuple[float, float] | None = None,
        clock: Callable[[], float] = time.monotonic,
        speed: float = 1.0,
        noise: float | None = None,
        seed: int | None = None,
    ) -> None:
        self._stage = stage = device if isinstance(device, VirtualStage) else VirtualStage.of_one(device)
        self.serial = stage.serial
        self.slew_rate, self.servo_period = slew_rate, servo_period
        self.wave_points, self.record_points = wave_points, record_points
        ranges = [(0.0, top) for top in stage.highest.tolist()] if limits is None else limits
        pairs = np.broadcast_to(np.asarray(ranges, dtype=np.float64), (len(stage), 2)).tolist()
        deviation, first_seed = stage.noise if noise is None else noise, stage.seed if seed is None else seed
        self.axes = tuple(
            BenchAxis(
                stage, j, VoltageLimits(low, high, slew_rate), servo_period, sensor_range, deviation, first_seed + j
            )
            for j, (low, high) in enumerate(pairs)
        )
        self._clock, self._speed, self._began, self._now = clock, speed, clock(), 0.0
        self._lead: BenchAxis | None = None
        self._times, self._columns, self._recorded = np.zeros(0), np.zeros((2, len(self.axes), 0)), 0

    @property
    def now(self) -> float:
        """The device's time [s]."""
        self.advance()
        return self._now

    @property
    def axis(self) -> BenchAxis:
        """The first axis; a single actuator has no other."""
        self.advance()
        return self.axes[0]

    @property
    def playing(self) -> bool:
        """Whether a wave is being played on any axis."""
        self.advance()
        return any(axis.playing for axis in self.axes)

    @property
    def recorded(self) -> int:
        """Number of recorded samples of the present or last waves."""
        self.advance()
        return self._recorded

    @property
    def planned(self) -> int:
        """Number of samples of the longest present or last wave; a stopped wave ends where it was stopped."""
        return 0 if self._lead is None else self._lead.planned

    def start(self, waves: ArrayLike | Mapping[int, ArrayLike], divider: int = 1) -> None:
        """Play waves on some axes from this instant, and record all axes.

        `waves`: voltages (n,) [V] of the first axis, or by axis (0, 1, ...). Sample k is put out at the present time +
        k divider servo_period, and recorded just after. The output jumps to the first sample and then moves in straight
        lines between samples. `divider`: number of servo periods between samples. Raise `DeviceError`, and play no
        wave, if a voltage lies outside its limits, there are no samples or too many, a wave is played or a servo is on.
        """
        self.advance()
        given = waves if isinstance(waves, Mapping) else {0: waves}
        admitted = {axis: self.axes[axis].admitted(wave, divider, self.wave_points) for axis, wave in given.items()}
        if any(axis.playing for axis in self.axes):
            raise DeviceError("start: a wave is being played; stop it first")
        for axis, wave in admitted.items():
            self.axes[axis].begin(wave, divider * self.servo_period)
        self._lead = max((self.axes[axis] for axis in admitted), key=lambda axis: axis.planned)
        rows = min(self._lead.planned, self.record_points)
        self._times, self._columns, self._recorded = np.zeros(rows), np.zeros((2, len(self.axes), rows)), 0
        self.advance()

    def stop(self) -> None:
        """Stop the waves and the moving outputs of all axes; the voltages stay."""
        self.advance()
        for axis in self.axes:
            axis.stop()

    def samples(self, first: int = 0, count: int | None = None, *, axis: int = 0) -> tuple[Array, Array, Array]:
        """Return recorded time [s], voltage [V] and displacement [m], (n,) each, of one `axis` (0, 1, ...).

        They hold the samples recorded so far, from `first` on, at most `count`.
        """
        stop = self.recorded if count is None else min(self.recorded, first + count)
        rows = slice(max(first, 0), max(stop, 0))
        return self._times[rows].copy(), self._columns[0, axis, rows].copy(), self._columns[1, axis, rows].copy()

    def advance(self) -> None:
        """Advance all axes to the time of the clock, and record them at the samples of the longest wave."""
        self._now = max(self._now, (self._clock() - self._began) * self._speed)
        for axis in self.axes:
            axis.advance(self._now)
        motions = self._stage.take()
        span = slice(self._recorded, 0 if self._lead is None else min(self._lead.played, self._times.size))
        if self._lead is None or span.stop <= span.start:
            return
        self._times[span] = at = self._lead.times(span.start, span.stop)
        late = at + _LATE * self.servo_period
        sampled = [motion[:, np.searchsorted(motion[0], late, side="right") - 1] for motion in motions]
        y = self._stage.joined(sampled)
        for j, (axis, motion) in enumerate(zip(self.axes, sampled, strict=True)):
            self._columns[0, j, span] = motion[1]
            self._columns[1, j, span] = axis.sensed(y[:, j])
        self._recorded = span.stop
