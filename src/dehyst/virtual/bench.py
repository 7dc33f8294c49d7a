"""The virtual bench behind every emulator: amplifiers, wave generators, servos, sensors and a recorder, without I/O."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import DeviceError
from dehyst._types import Array
from dehyst._validation import interval, vector
from dehyst.control import VoltageLimits
from dehyst.model import Actuator
from dehyst.virtual.amplifier import Amplifier
from dehyst.virtual.base import Sensor, VirtualActuator
from dehyst.virtual.modelled import fingerprint
from dehyst.virtual.stage import AxisPort, VirtualStage

# Period of the servo [s], its time constant [s], and the most updates after a pause.
_UPDATE_PERIOD, _TIME_CONSTANT, _MOST_UPDATES = 1e-3, 0.02, 400
# The servo corrects this share of its error at once: no actuator's loop is twice as steep as its end points' line.
_CORRECTION = 0.5
# Share of the stroke within which a move has arrived.
_ARRIVED = 1e-3
# Share of a servo period by which a voltage may be late: what was put out just after a sample belongs to it.
_LATE = 0.1


class BenchAxis:
    """One axis of a `VirtualBench`: amplifier, wave generator, servo and sensor. Its time is that of the bench.

    Attributes
    ----------
    limits : (float, float)
        Lowest and highest voltage [V] of the amplifier.
    log : Extremes
        Extremes of the output so far.
    stroke : float
        Stroke of the actuator [m].
    sensor_range : (float, float) or None
        Lowest and highest displacement [m] of the sensor; it saturates beyond them.
    unplugged : bool
        Whether the sensor's cable is disconnected: the reading is constant.
    stalled : bool
        Whether the wave generator has stalled: it plays nothing more, and does not end.
    planned, played : int
        Samples of the present or last wave, which ends where it was stopped, and those put out so far.
    """

    def __init__(
        self,
        port: AxisPort,
        place: Callable[[], float],
        limits: VoltageLimits,
        servo_period: float,
        sensor_range: tuple[float, float] | None,
        noise: float,
        seed: int,
    ) -> None:
        self._amplifier, self._place = Amplifier(port, limits, servo_period), place
        self.limits, self.stroke, self.log = (limits.low, limits.high), self._amplifier.stroke, self._amplifier.log
        self.sensor_range = None if sensor_range is None else interval(sensor_range)
        self._deviation, self._sensor = noise, Sensor(noise, seed)
        self.unplugged = self.stalled = False
        self._servo, self._wanted, self._error = False, 0.0, 0.0
        self._wave, self.played, self._first, self._period = np.zeros(0), 0, 0.0, servo_period

    @property
    def voltage(self) -> float:
        """Present output of the amplifier [V]."""
        return self._amplifier.voltage

    @property
    def target(self) -> float:
        """Voltage that the output moves to [V]."""
        return self._amplifier.target

    @property
    def planned(self) -> int:
        """Samples of the present or last wave; a stopped one ends where it was stopped."""
        return self._wave.size

    @property
    def playing(self) -> bool:
        """Whether a wave is being played."""
        return self.played < self._wave.size

    @property
    def moving(self) -> bool:
        """Whether the output is moving, or the servo is off its target."""
        return self.playing or self._amplifier.moving or not self.arrived

    @property
    def arrived(self) -> bool:
        """Whether the servo, if it is on, is at its target."""
        return not self._servo or self._error <= max(_ARRIVED * self.stroke, 5 * self._deviation)

    @property
    def servo(self) -> bool:
        """Whether the loop is closed; closing it holds the displacement that the sensor reads."""
        return self._servo

    @servo.setter
    def servo(self, on: bool) -> None:
        if on == self._servo:
            return
        if on and self.playing:
            raise DeviceError("servo: a wave is being played, which needs the servo off; stop it first")
        self._servo = on
        self._amplifier.rest()
        if on:
            self._wanted, self._error = self.displacement(), 0.0

    def displacement(self) -> float:
        """Return the sensor's reading [m]: the present one, or while a wave is played that of the last sample."""
        return float(self.sensed(np.array([self._place()]))[0])

    def set_voltage(self, voltage: float) -> bool:
        """Put out a `voltage` [V], at the slew rate; return False, and do nothing, if it is outside the limits.

        Raise `DeviceError` if the servo is on or a wave is played.
        """
        self._demand_open("set_voltage")
        if not self._amplifier.allows(np.array([voltage])):
            return False
        self._amplifier.aim(float(voltage))
        return True

    def move(self, target: float) -> None:
        """Move to a displacement [m] of the sensor, and hold it against creep. `target` [m].

        Raise `DeviceError` if the servo is off, or the target is no number.
        """
        if not self._servo or not math.isfinite(target):
            raise DeviceError(
                f"move: got {target} m with the servo {'on' if self._servo else 'off'}; need a number, and the servo on"
            )
        self._wanted, self._error = float(target), math.inf

    def stop(self) -> None:
        """Stop the wave, or the moving output; the voltage stays. A servo holds the present displacement."""
        self._wave = self._wave[: self.played]
        self._amplifier.rest()
        if self._servo:
            self._wanted = self.displacement()

    def sensed(self, displacement: Array) -> Array:
        """Return the sensor's reading (n,) [m] of displacements: `displacement` (n,) [m]."""
        low, high = self.sensor_range or (-math.inf, math.inf)
        if self.unplugged:
            return np.full(displacement.size, low if math.isfinite(low) else 0.0)
        return np.clip(self._sensor.read(displacement), low, high)

    def admitted(self, wave: ArrayLike, divider: int, most: int) -> Array:
        """Return the voltages (n,) [V] that `begin` would play, `most` at most; raise `DeviceError` if it cannot.

        `wave` (n,) [V]; `divider` as of `VirtualBench.start`.
        """
        self._demand_open("start")
        v = vector(wave, "wave")
        if not 0 < v.size <= most or divider < 1:
            raise DeviceError(
                argument="start", got=f"{v.size} samples and divider {divider}", need=f"1 to {most} and 1 or more"
            )
        if not self._amplifier.allows(v):
            raise DeviceError(
                argument="start", got=f"{v.min():.6g} to {v.max():.6g} V", need=self._amplifier.limits.words
            )
        return v

    def begin(self, wave: Array, period: float) -> None:
        """Play an admitted `wave` (n,) [V] from now on, one voltage each `period` [s]."""
        self._wave, self.played, self._first, self._period = wave, 0, self._amplifier.at, period

    def times(self, first: int, stop: int) -> Array:
        """Return the times (n,) [s] of samples of the wave, from `first` to the one before `stop`."""
        return np.asarray(self._first + self._period * np.arange(first, stop), dtype=np.float64)

    def advance(self, now: float) -> None:
        """Continue until `now` [s]: play the due samples of the wave, or hold the servo, or let the actuator creep."""
        if self.playing and not self.stalled:
            # Rounding must not lose a sample that is due now.
            due = min(self._wave.size, math.floor((now - self._first) / self._period + 1e-6) + 1)
            if due > self.played:
                self._amplifier.follow(self._wave[self.played : due], self.times(self.played, due))
                self.played = due
        if self.playing or now <= self._amplifier.at:
            return
        if self._servo:
            self._hold(now)
        else:
            self._amplifier.pass_time(now)

    def _demand_open(self, what: str) -> None:
        if self._servo:
            raise DeviceError(f"{what}: the servo is on, need it off")
        if self.playing:
            raise DeviceError(f"{what}: a wave is being played; stop it first")

    def _hold(self, now: float) -> None:
        """Integrate the servo's error: in longer periods after a pause, so that an idle hour costs little."""
        amplifier = self._amplifier
        begin, span = amplifier.at, now - amplifier.at
        updates = min(_MOST_UPDATES, max(1, math.ceil(span / _UPDATE_PERIOD)))
        period = span / updates
        gain = _CORRECTION * -math.expm1(-period / _TIME_CONSTANT) / amplifier.gain
        most = (amplifier.limits.slew_rate or math.inf) * period
        for update in range(1, updates + 1):
            error = self._wanted - self.displacement()
            voltage = amplifier.voltage + min(max(gain * error, -most), most)
            amplifier.play(np.array([amplifier.limits.nearest(voltage)]), np.array([begin + update * period]))
            self._error = abs(error)


class VirtualBench:
    """A piezo controller without a protocol: no input or output, no thread; its time is the clock's.

    Every method and property of the bench first brings it up to the present. Between them time stands still: what is
    done on several of its `axes` happens at one instant. It is not thread-safe: a server must hold a lock.

    Parameters
    ----------
    device : VirtualActuator, Actuator or VirtualStage
        The connected actuator, or the body with one an axis, at rest at 0 V.
    limits : (float, float) or sequence of (float, float), optional
        Lowest and highest voltage [V] of the amplifiers, for all axes or for each; default: 0 V to its actuator's
        highest.
    slew_rate : float, optional
        Slew rate of the amplifiers [V/s], for voltages and waves. Default: a voltage is reached at once.
    servo_period : float, optional
        [s]; samples of a wave are whole numbers of it apart.
    wave_points, record_points : int, optional
        Sizes of the memories of each wave generator and of the recorder, for each axis.
    sensor_range : (float, float), optional
        Lowest and highest displacement [m] of each sensor.
    clock : callable, optional
        Returns seconds, which never fall.
    speed : float, optional
        Seconds of the device in each second of the clock.
    noise, seed : float, int, optional
        Standard deviation [m] and seed of the sensors' noise; default: those of the device, or no noise.

    Attributes
    ----------
    axes : tuple of BenchAxis
    stage : VirtualStage
        The body.
    serial : str
        Serial number: the device's `fingerprint`, which depends on neither its name nor the server.

    Raises
    ------
    ModelError
        If limits are no interval, or the slew rate is not positive.
    """

    def __init__(
        self,
        device: VirtualActuator | Actuator | VirtualStage,
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
        self.serial = device.serial if isinstance(device, VirtualStage) else fingerprint(device)
        self.stage = device if isinstance(device, VirtualStage) else VirtualStage.of_one(device)
        self.slew_rate, self.servo_period = slew_rate, servo_period
        self.wave_points, self.record_points = wave_points, record_points
        ranges = [(0.0, top) for top in self.stage.highest.tolist()] if limits is None else limits
        pairs = np.broadcast_to(np.asarray(ranges, dtype=np.float64), (len(self.stage), 2)).tolist()
        self.axes = tuple(
            BenchAxis(
                port,
                lambda j=j: float(self.stage.present()[j]),  # type: ignore[misc]
                VoltageLimits(low, high, slew_rate),
                servo_period,
                sensor_range,
                self.stage.noise if noise is None else noise,
                (self.stage.seed if seed is None else seed) + j,
            )
            for j, (port, (low, high)) in enumerate(zip(self.stage.ports, pairs, strict=True))
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
        """The first axis, and the only one of a single actuator."""
        self.advance()
        return self.axes[0]

    @property
    def playing(self) -> bool:
        """Whether a wave is being played on any axis."""
        self.advance()
        return any(axis.playing for axis in self.axes)

    @property
    def recorded(self) -> int:
        """Samples recorded of the present or last waves."""
        self.advance()
        return self._recorded

    @property
    def planned(self) -> int:
        """Samples of the longest of the present or last waves; a stopped one ends where it was stopped."""
        return 0 if self._lead is None else self._lead.planned

    def start(self, waves: ArrayLike | Mapping[int, ArrayLike], divider: int = 1) -> None:
        """Play waves on some axes from this instant, and record all axes.

        `waves`: voltages (n,) [V] of the first axis, or by axis (0, 1, ...): sample k is put out at the present + k
        divider servo_period, and recorded just after; the output moves in straight lines from one to the next, and to
        the first in a jump. `divider`: servo periods from one to the next. Raise `DeviceError` if one lies outside its
        limits, there are too many or none, a wave is played or a servo is on; if one wave is refused, none is played.
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
        """Stop the waves and the moving outputs of all axes; the voltages stay. Servos hold the displacements."""
        self.advance()
        for axis in self.axes:
            axis.stop()

    def samples(self, first: int = 0, count: int | None = None, *, axis: int = 0) -> tuple[Array, Array, Array]:
        """Return time [s], voltage [V] and displacement [m], (n,) each, of one `axis` (0, 1, ...) as recorded.

        They begin with sample `first` and are those recorded so far, `count` at most.
        """
        stop = self.recorded if count is None else min(self.recorded, first + count)
        rows = slice(max(first, 0), max(stop, 0))
        return self._times[rows].copy(), self._columns[0, axis, rows].copy(), self._columns[1, axis, rows].copy()

    def advance(self) -> None:
        """Bring all axes up to the clock's time, and record."""
        self._now = max(self._now, (self._clock() - self._began) * self._speed)
        for axis in self.axes:
            axis.advance(self._now)
        self._record()

    def _record(self) -> None:
        """Record what the axes did at the samples of the longest wave."""
        motions = [port.take() for port in self.stage.ports]
        span = slice(self._recorded, 0 if self._lead is None else min(self._lead.played, self._times.size))
        if self._lead is None or span.stop <= span.start:
            return
        self._times[span] = at = self._lead.times(span.start, span.stop)
        late = at + _LATE * self.servo_period
        rows = [np.searchsorted(motion.time, late, side="right") - 1 for motion in motions]
        y = self.stage.joined(
            [motion.own[row] for motion, row in zip(motions, rows, strict=True)],
            [motion.second[row] for motion, row in zip(motions, rows, strict=True)],
        )
        for j, (axis, motion, row) in enumerate(zip(self.axes, motions, rows, strict=True)):
            self._columns[0, j, span] = motion.voltage[row]
            self._columns[1, j, span] = axis.sensed(y[:, j])
        self._recorded = span.stop
