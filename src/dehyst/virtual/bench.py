"""The virtual bench behind every emulator: amplifier, wave generator, data recorder and sensor around an actuator."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import DeviceError
from dehyst._types import Array
from dehyst._validation import interval, vector
from dehyst.control import VoltageLimits
from dehyst.model import Actuator
from dehyst.virtual.amplifier import Amplifier, Extremes
from dehyst.virtual.base import Sensor, VirtualActuator
from dehyst.virtual.modelled import fingerprint

__all__ = ["Extremes", "VirtualBench"]

# Period of the servo [s], its time constant [s], and the most updates after a pause.
_UPDATE_PERIOD, _TIME_CONSTANT, _MOST_UPDATES = 1e-3, 0.02, 400
# The servo corrects this share of its error at once: no actuator's loop is twice as steep as its end points' line.
_CORRECTION = 0.5
# Share of the stroke within which a move has arrived.
_ARRIVED = 1e-3


class VirtualBench:
    """A piezo controller without a protocol: no input or output, no thread; its time is the clock's.

    Every method first brings the bench up to the present. It is not thread-safe: a server must hold a lock.

    Parameters
    ----------
    actuator : VirtualActuator or Actuator
        The connected actuator, at rest at 0 V.
    limits : (float, float), optional
        Lowest and highest voltage [V] that the amplifier puts out.
    slew_rate : float, optional
        Slew rate of the amplifier [V/s], for voltages and waves. Default: a voltage is reached at once.
    servo_period : float, optional
        [s]; samples of a wave are whole numbers of it apart.
    wave_points, record_points : int, optional
        Sizes of the wave generator's and of the recorder's memory.
    sensor_range : (float, float), optional
        Lowest and highest displacement [m] of the sensor; it saturates beyond them.
    clock : callable, optional
        Returns seconds, which never fall.
    speed : float, optional
        Seconds of the device in each second of the clock.
    noise, seed : float, int, optional
        Standard deviation [m] and seed of the sensor's noise; default: those of the actuator, or no noise.
    place : callable, optional
        Returns the present displacement [m] that the sensor looks at; default: the actuator's own.

    Attributes
    ----------
    log : Extremes
        Extremes of the output so far.
    unplugged : bool
        Whether the sensor's cable is disconnected: the reading is constant.
    stalled : bool
        Whether the wave generator has stalled: it plays nothing more, and does not end.
    stroke : float
        Stroke of the actuator [m].
    serial : str
        Serial number: the actuator's `fingerprint`, which depends on neither its name nor the server.

    Raises
    ------
    ModelError
        If the limits are no interval, or the slew rate is not positive.
    """

    def __init__(
        self,
        actuator: VirtualActuator | Actuator,
        *,
        limits: tuple[float, float] = (0.0, 200.0),
        slew_rate: float | None = None,
        servo_period: float = 5e-5,
        wave_points: int = 65536,
        record_points: int = 65536,
        sensor_range: tuple[float, float] | None = None,
        clock: Callable[[], float] = time.monotonic,
        speed: float = 1.0,
        noise: float | None = None,
        seed: int | None = None,
        place: Callable[[], float] | None = None,
    ) -> None:
        self._amplifier = Amplifier(actuator, VoltageLimits(*limits, slew_rate), servo_period)
        allowed = self._amplifier.limits
        self.limits, self.slew_rate, self.servo_period = (allowed.low, allowed.high), slew_rate, servo_period
        self.wave_points, self.record_points = wave_points, record_points
        self.sensor_range = None if sensor_range is None else interval(sensor_range)
        self.unplugged = self.stalled = False
        self.stroke, self.log = self._amplifier.stroke, self._amplifier.log
        self.serial = fingerprint(actuator)
        self._deviation = float(getattr(actuator, "noise", 0.0)) if noise is None else noise
        self._sensor = Sensor(self._deviation, int(getattr(actuator, "seed", 0)) if seed is None else seed)
        self._clock, self._speed, self._began = clock, speed, clock()
        self._place = place or (lambda: self._amplifier.position)
        self._servo, self._wanted, self._error = False, 0.0, 0.0
        self._wave, self._played, self._first, self._period = np.zeros(0), 0, 0.0, servo_period
        self._record, self._rows = np.zeros((3, 0)), 0

    @property
    def now(self) -> float:
        """The device's time [s]."""
        return (self._clock() - self._began) * self._speed

    @property
    def voltage(self) -> float:
        """Present output of the amplifier [V]."""
        self.advance()
        return self._amplifier.voltage

    @property
    def target(self) -> float:
        """Voltage that the output moves to [V]."""
        self.advance()
        return self._amplifier.target

    @property
    def playing(self) -> bool:
        """Whether a wave is being played."""
        self.advance()
        return self._busy

    @property
    def moving(self) -> bool:
        """Whether the output is moving, or the servo is off its target."""
        self.advance()
        return self._busy or self._amplifier.moving or not self.arrived

    @property
    def arrived(self) -> bool:
        """Whether the servo, if it is on, is at its target."""
        self.advance()
        return not self._servo or self._error <= max(_ARRIVED * self.stroke, 5 * self._deviation)

    @property
    def servo(self) -> bool:
        """Whether the loop is closed; closing it holds the displacement that the sensor reads."""
        return self._servo

    @servo.setter
    def servo(self, on: bool) -> None:
        self.advance()
        if on == self._servo:
            return
        if on and self._busy:
            raise DeviceError("servo: a wave is being played, which needs the servo off; stop it first")
        self._servo = on
        self._amplifier.rest()
        if on:
            self._wanted, self._error = self.displacement(), 0.0

    @property
    def recorded(self) -> int:
        """Samples recorded of the present or last wave."""
        self.advance()
        return self._rows

    @property
    def planned(self) -> int:
        """Samples of the present or last wave; a stopped one ends where it was stopped."""
        return self._wave.size

    def displacement(self) -> float:
        """Return the sensor's reading [m]: the present one, or while a wave is played that of the last sample."""
        self.advance()
        return self._reading()

    def set_voltage(self, voltage: float) -> bool:
        """Put out a `voltage` [V], at the slew rate; return False, and do nothing, if it is outside the limits.

        Raise `DeviceError` if the servo is on or a wave is played.
        """
        self.advance()
        self._demand_open("set_voltage")
        if not self._amplifier.allows(np.array([voltage])):
            return False
        self._amplifier.aim(float(voltage))
        return True

    def move(self, target: float) -> None:
        """Move to a displacement [m] of the sensor, and hold it against creep. `target` [m].

        Raise `DeviceError` if the servo is off, or the target is no number.
        """
        self.advance()
        if not self._servo or not math.isfinite(target):
            raise DeviceError(
                f"move: got {target} m with the servo {'on' if self._servo else 'off'}; need a number, and the servo on"
            )
        self._wanted, self._error = float(target), math.inf

    def start(self, wave: ArrayLike, divider: int = 1) -> None:
        """Play voltages (n,) [V]: sample k at the present + k divider servo_period, and recorded just after.

        `wave` (n,) [V]; the output moves in straight lines from one to the next, and to the first in a jump.
        `divider`: servo periods from one to the next. Raise `DeviceError` if one lies outside the limits, there are too
        many or none, another wave is played or the servo is on.
        """
        v = self.admitted(wave, divider)
        self._wave, self._played, self._first, self._period = v, 0, self._amplifier.at, divider * self.servo_period
        self._record, self._rows = np.zeros((3, min(v.size, self.record_points))), 0
        self.advance()

    def admitted(self, wave: ArrayLike, divider: int = 1) -> Array:
        """Return the voltages (n,) [V] that `start` would play; raises as it does, and plays nothing.

        `wave` and `divider` as of `start`.
        """
        self.advance()
        self._demand_open("start")
        v = vector(wave, "wave")
        if not 0 < v.size <= self.wave_points or divider < 1:
            raise DeviceError(
                argument="start",
                got=f"{v.size} samples and divider {divider}",
                need=f"1 to {self.wave_points} and 1 or more",
            )
        if not self._amplifier.allows(v):
            raise DeviceError(
                argument="start", got=f"{v.min():.6g} to {v.max():.6g} V", need=self._amplifier.limits.words
            )
        return v

    def stop(self) -> None:
        """Stop the wave, or the moving output; the voltage stays. A servo holds the present displacement."""
        self.advance()
        self._wave = self._wave[: self._played]
        self._amplifier.rest()
        if self._servo:
            self._wanted = self.displacement()

    def samples(self, first: int = 0, count: int | None = None) -> tuple[Array, Array, Array]:
        """Return time [s], voltage [V] and displacement [m], (n,) each, of the present or last wave.

        They begin with sample `first` and are those recorded so far, `count` at most.
        """
        self.advance()
        stop = self._rows if count is None else min(self._rows, first + count)
        time, voltage, displacement = self._record[:, max(first, 0) : max(stop, 0)].copy()
        return time, voltage, displacement

    def sensed(self, displacement: Array) -> Array:
        """Return the sensor's reading (n,) [m] of displacements: `displacement` (n,) [m]."""
        low, high = self.sensor_range or (-math.inf, math.inf)
        if self.unplugged:
            return np.full(displacement.size, low if math.isfinite(low) else 0.0)
        return np.clip(self._sensor.read(displacement), low, high)

    def advance(self) -> None:
        """Bring the bench up to now: play the due samples of the wave, fill the recorder, let the actuator creep."""
        now = self.now
        if self._busy:
            self._play(now)
        if self._busy or now <= self._amplifier.at:
            return
        if self._servo:
            self._hold(now)
        else:
            self._amplifier.pass_time(now)

    @property
    def _busy(self) -> bool:
        return self._played < self._wave.size

    def _demand_open(self, what: str) -> None:
        if self._servo:
            raise DeviceError(f"{what}: the servo is on, need it off")
        if self._busy:
            raise DeviceError(f"{what}: a wave is being played; stop it first")

    def _play(self, now: float) -> None:
        """Put out the samples that are due, and record them."""
        # Rounding must not lose a sample that is due now.
        due = min(self._wave.size, math.floor((now - self._first) / self._period + 1e-6) + 1)
        if due <= self._played or self.stalled:
            return
        at = np.asarray(self._first + self._period * np.arange(self._played, due), dtype=np.float64)
        voltage, displacement = self._amplifier.follow(self._wave[self._played : due], at)
        self._played = due
        rows = slice(self._rows, min(due, self._record.shape[1]))
        count = max(0, rows.stop - rows.start)
        self._record[:, rows] = np.stack([at, voltage, self.sensed(displacement)])[:, :count]
        self._rows += count

    def _hold(self, now: float) -> None:
        """Integrate the servo's error: in longer periods after a pause, so that an idle hour costs little."""
        amplifier = self._amplifier
        begin, span = amplifier.at, now - amplifier.at
        updates = min(_MOST_UPDATES, max(1, math.ceil(span / _UPDATE_PERIOD)))
        period = span / updates
        gain = _CORRECTION * -math.expm1(-period / _TIME_CONSTANT) / amplifier.gain
        most = (self.slew_rate or math.inf) * period
        for update in range(1, updates + 1):
            error = self._wanted - self._reading()
            voltage = amplifier.voltage + min(max(gain * error, -most), most)
            amplifier.play(np.array([amplifier.limits.nearest(voltage)]), np.array([begin + update * period]))
            self._error = abs(error)

    def _reading(self) -> float:
        return float(self.sensed(np.array([self._place()]))[0])
