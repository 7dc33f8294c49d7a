"""Readings, samples and waves of a rig: played in pieces, checked as they arrive, timed by the host if necessary."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import closing, contextmanager
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import DehystError, DeviceError, LinkError, ModelError, SensorError, Terminated
from dehyst._types import Array
from dehyst._validation import matrix, number, vector
from dehyst.instruments.interrupts import by_signal
from dehyst.waveforms import Excitation

if TYPE_CHECKING:
    from dehyst.instruments.base import AbstractRig

# Takes the displacement that was read before a sample [m]; returns the voltage to send [V].
StepFunction: TypeAlias = Callable[[float | None], float]

# Highest rate [Hz] that a host keeps with one round trip a sample.
HIGHEST_RATE = 200.0
# The watch of the sensor needs a motion over this part of the range: over a smaller one a reading may be constant.
_LEAST_WATCHED = 0.25
# Time [s] without a sample after which a wave has failed, in addition to twice its duration.
_PATIENCE = 5.0
# Seconds between two batches of samples that the host times.
_BATCH_SECONDS = 0.2
# A voltage that is late by less than this part of a period does not delay the next ones.
_ALLOWED_LATENESS = 0.5
# A voltage that is read back may differ from the sent one by this share of the range.
READBACK_TOLERANCE = 0.05
# Largest displacement of a piezo stage from the zero of its sensor [m].
_FARTHEST = 0.1
# A wave takes at least this part of its duration, minus this number of samples: clocks differ, and it may begin late.
_LEAST_PACE, _LATE_SAMPLES = 0.9, 20
# A clock of a device is wrong if it is ahead of the request by this time [s] and of the host's time by this factor.
_CLOCK_LEAD, _CLOCK_FACTOR = 10.0, 1.1
# A sensor is dead if its reading stays constant to the last digit while the voltage crosses this part of its range.
_DEAD_SENSOR_RANGE = 0.2


class Reading(NamedTuple):
    """One reading of an axis: `time` [s] of the rig's own clock, `voltage` [V], `displacement` [m]."""

    time: float
    voltage: float
    displacement: float


class Samples(NamedTuple):
    """Consecutive samples of a record: `time` (n,) [s], `voltage` [V] and `displacement` [m].

    Voltage and displacement are (n,) for one axis, (n, axes) for several. `others`: further channels (n,) by name with
    unit, such as "temperature_C": those of `AbstractRig.others`.
    """

    time: Array
    voltage: Array
    displacement: Array
    others: Mapping[str, Array] = MappingProxyType({})

    def axis(self, index: int) -> Samples:
        """Return the samples of the axis of an `index`, with arrays (n,)."""
        voltage, displacement = (columns_of(values)[index] for values in (self.voltage, self.displacement))
        return Samples(self.time, np.ascontiguousarray(voltage), np.ascontiguousarray(displacement), self.others)


Listener = Callable[[Samples], None]


def columns_of(values: Array) -> list[Array]:
    """Return the column (n,) of each axis of values (n,) or (n, axes)."""
    return [values] if values.ndim == 1 else list(values.T)


@contextmanager
def driver_errors(name: str, method: str) -> Iterator[None]:
    """Re-raise what a driver's `method` raises as DeviceError; errors of dehyst and of signals pass unchanged."""
    try:
        yield
    except (DehystError, KeyboardInterrupt, Terminated):
        raise
    # A driver, or its library, may raise anything, and SystemExit must not end the program before a retreat.
    except BaseException as error:
        if by_signal(error):
            raise
        raise DeviceError(
            f"{name}: {method} of the rig raised {type(error).__name__}: {error}; check its code, or the device"
        ) from error


def admitted(rig: AbstractRig, batch: Any, sent: Array, count: int, after: float) -> Samples:
    """Return a copy of a `batch` of a driver.

    Raise `LinkError` if it cannot follow the `count` samples before, the last of which came at `after` [s]: too many
    for the `sent` voltages, not finite, or times that do not increase; `DeviceError` if it has other further channels.
    """
    name, read = rig.name, vector if sent.ndim == 1 else matrix
    with driver_errors(name, "_wave"):
        # These are copies: a driver may fill the same buffer again.
        times = vector(batch[0], f"{name}: time", error=LinkError)
        voltage = read(batch[1], f"{name}: voltage", error=LinkError)
        displacement = read(batch[2], f"{name}: displacement", error=LinkError)
        others = {
            column: vector(values, f"{name}: {column}", error=LinkError) for column, values in batch.others.items()
        }
    shapes = [column.shape for column in (times, voltage, displacement, *others.values())]
    whole = (times.size, *sent.shape[1:])
    if shapes[1:3] != [whole, whole] or {*shapes[3:]} - {times.shape}:
        raise LinkError(f"{name}: got columns of shapes {shapes}, need one length; check the link")
    if count + times.size > len(sent):
        raise LinkError(f"{name}: got {count + times.size} samples for {len(sent)} voltages; check the link")
    early = np.flatnonzero(np.diff(times, prepend=after) <= 0)
    if early.size:
        last = times[early[0] - 1] if early[0] else after
        raise LinkError(
            f"{name}: got a sample of {times[early[0]]:.9g} s after one of {last:.9g} s, need increasing times; check "
            "the link and the device's clock"
        )
    if times.size and set(others) != set(rig.others):
        found, need = (", ".join(names) or "none" for names in (others, rig.others))
        raise DeviceError(f"{name}: got further channels {found}, need {need}; check the rig's _wave")
    return Samples(times, voltage, displacement, others)


class SensorWatch:
    """A check of samples as they arrive: it raises when the sensor reads a constant while the actuator should move.

    `span`: range of the voltage [V]; at a constant reading, the voltage may cross a fifth of it. `name`: name of the
    sensor, for the message.
    """

    def __init__(self, span: float, name: str = "the sensor") -> None:
        self._enough, self._name = _DEAD_SENSOR_RANGE * span, name
        # The last reading, and the range of the voltage since the reading became constant.
        self._value, self._low, self._high = math.nan, 0.0, 0.0

    def observe(self, voltage: Array, displacement: Array) -> None:
        """Check samples (n,) [V], (n,) [m] that follow the ones before.

        Raise `SensorError` if the reading has not changed while the voltage crossed a fifth of its range.
        """
        if not displacement.size:
            return
        starts = np.concatenate([[0], np.flatnonzero(np.diff(displacement)) + 1])
        low, high = np.minimum.reduceat(voltage, starts), np.maximum.reduceat(voltage, starts)
        if displacement[0] == self._value:
            low[0], high[0] = min(low[0], self._low), max(high[0], self._high)
        stuck = np.flatnonzero(high - low > self._enough)
        if stuck.size:
            first = int(stuck[0])
            raise SensorError(
                f"{self._name} does not move: it stays at {1e6 * displacement[starts[first]]:.6g} um while the voltage "
                f"goes from {low[first]:.6g} to {high[first]:.6g} V; is it plugged in, the right channel, or saturated?"
            )
        self._value, self._low, self._high = float(displacement[-1]), float(low[-1]), float(high[-1])


class WaveWatch:
    """All checks of the samples of an excitation that a `rig` plays at a `rate` [Hz], after `listen` received them."""

    def __init__(self, rig: AbstractRig, excitation: Excitation, rate: float) -> None:
        self._rig, self._rate = rig, rate
        self._spans = np.array([each.limits.high - each.limits.low for each in rig.rigs])
        ranges = np.maximum([np.ptp(column) for column in columns_of(excitation.voltage)], _LEAST_WATCHED * self._spans)
        names = [f"the sensor of axis {axis}" for axis in rig.axes] if len(rig.axes) > 1 else ["the sensor"]
        self._sensors = [SensorWatch(float(span), name) for span, name in zip(ranges, names, strict=True)]
        self._rows, self._count = rig.rows(len(excitation)), 0
        # The times by the host's clock and by the samples, when the wave began.
        self._began, self._first = rig.rigs[0]._now(), math.nan

    def observe(self, samples: Samples, sent: Array, steepest: Array) -> None:
        """Check samples by their `sent` voltages (n,) or (n, axes) [V], of a wave with `steepest` steps [V] an axis.

        Raise `DeviceError` or `SensorError`.
        """
        rig = self._rig
        # A recorder may be a sample or two late.
        slack = np.maximum(READBACK_TOLERANCE * self._spans, 2 * steepest)
        if np.abs(samples.displacement).max() > _FARTHEST:
            got = f"a displacement of {np.abs(samples.displacement).max():.4g} m"
            raise DeviceError(
                f"{rig.name}: read {got}, need metres of a piezo stage; check the unit in the rig's _read"
            )
        differences = np.atleast_1d(np.abs(samples.voltage - sent).max(axis=0))
        if (differences > slack).any():
            worst = int(np.argmax(differences - slack))
            where = f"{rig.name}, axis {rig.axes[worst]}" if len(rig.axes) > 1 else rig.name
            raise DeviceError(
                f"{where}: its output is {differences[worst]:.4g} V away from what was sent; is the amplifier on, the "
                "servo off and the channel the right one?"
            )
        columns = zip(columns_of(samples.voltage), columns_of(samples.displacement), strict=True)
        for sensor, (voltage, displacement) in zip(self._sensors, columns, strict=True):
            sensor.observe(voltage, displacement)
        self._first = self._first if self._count else float(samples.time[0])
        self._count += samples.time.size
        due, passed = float(self._rows[self._count - 1]) / self._rate, float(samples.time[-1]) - self._first
        most = due + _CLOCK_FACTOR * (rig.rigs[0]._now() - self._began) + _CLOCK_LEAD
        if not _LEAST_PACE * due - _LATE_SAMPLES / self._rate <= passed <= most:
            raise DeviceError(
                f"{rig.name}: its clock does not agree with the requested {self._rate:.6g} Hz: by its times, "
                f"{passed:.6g} s passed, need {due:.6g} s; check the rig's _wave and nearest_rate, and its clock"
            )


def arriving(
    rig: AbstractRig, excitation: Excitation, rate: float, listen: Listener, step: StepFunction | None
) -> Iterator[Samples]:
    """Play an `excitation` at a `rate` [Hz] from the present output; yield each batch when `listen` has received it.

    `step`: see `AbstractRig.play`. Raise `RigError` if the device, its link, its sensor or its clock fails.
    """
    watch, after = WaveWatch(rig, excitation, rate), -math.inf
    waves = rig._wave if step is None else partial(host_timed, rig, step=step)
    for sent in pieces(excitation.voltage, rig.longest) if step is None else [excitation.voltage.copy()]:
        count, outputs = 0, [each._output for each in rig.rigs]
        for output, column in zip(outputs, columns_of(sent), strict=True):
            output.plays(column, rate)
        steepest = np.abs(np.diff(sent, axis=0)).max(axis=0, initial=0.0)
        # Close the batches before the retreat: the actions of a driver at the end of a wave must not follow it.
        with closing(_batches(rig, partial(waves, sent, rate), _PATIENCE + 2 * len(sent) / rate)) as batches:
            for batch in batches:
                samples = admitted(rig, batch, sent, count, after)
                if not samples.time.size:
                    continue
                count, after = count + samples.time.size, float(samples.time[-1])
                for output in outputs:
                    output.observe(count)
                listen(samples)
                watch.observe(samples, sent[count - samples.time.size : count], steepest)
                yield samples
        if count < len(sent):
            raise DeviceError(f"{rig.name}: recorded {count} of {len(sent)} samples; check its data recorder")


def _batches(
    rig: AbstractRig, wave: Callable[[], Iterator[Samples]], patience: float
) -> Generator[Samples, None, None]:
    """Yield the batches of a driver's `wave`; its generator is closed.

    Raise `LinkError` if they are empty for longer than `patience` [s], `DeviceError` for whatever the driver raises.
    """
    with driver_errors(rig.name, "_wave"):
        batches = iter(wave())
    latest = time.monotonic()
    try:
        while True:
            with driver_errors(rig.name, "_wave"):
                batch = next(batches, None)
            if batch is None:
                return
            yield batch
            if len(batch[0]):
                latest = time.monotonic()
            elif time.monotonic() - latest > patience:
                raise LinkError(
                    f"{rig.name}: got empty batches for {patience:.3g} s; check the rig's _wave, and the device's data "
                    "recorder"
                )
    finally:
        if isinstance(batches, Generator):
            with driver_errors(rig.name, "_wave"):
                batches.close()


def host_timed(rig: AbstractRig, voltage: Array, rate: float, step: StepFunction | None = None) -> Iterator[Samples]:
    """Send each `voltage` (n,) [V] to `rig` at `rate` [Hz], slower if a call takes longer; read in the middle of holds.

    At every rate, the displacement there is that of straight lines between the voltages, with the actuator's lag.
    Readings have the device's time. `step` replaces the given voltages, see `AbstractRig.play`.
    """
    period, readings, read, answer = 1 / rate, list[Reading](), None, 0.0
    sent = yielded = rig._now()
    # A ramp has just ended at the first voltage of a wave; a loop has another first voltage, one period later.
    due, before = sent + period * (step is not None), float(voltage[0])
    rig._output.puts(before)
    for k in range(len(voltage)):
        rig._wait(max(0.0, due - rig._now()))
        if step is not None:
            voltage[k] = rig.limits.towards(step(read), before, period)
        v = float(voltage[k])
        # Wait until the slew rate allows the step from the last voltage.
        rig._wait(max(0.0, sent + abs(v - before) / rig.slew_rate - rig._now()))
        began = rig._now()
        with driver_errors(rig.name, "_put"):
            rig._put(v)
        # A retreat begins at this voltage if the reading fails: samples come later than voltages.
        rig._output.puts(v)
        before, sent = v, rig._now()
        # A wait that took too long does not delay the later voltages; a call that took too long does.
        due = due + period if began - due < _ALLOWED_LATENESS * period else began + period
        rig._wait(max(0.0, 0.5 * (began + sent + period - answer) - rig._now()))
        asked = rig._now()
        readings.append(rig.read())
        read, answer = readings[-1].displacement, (now := rig._now()) - asked
        if now - yielded >= _BATCH_SECONDS or k == len(voltage) - 1:
            yield Samples(*np.array(readings, dtype=np.float64).T)
            readings, yielded = [], now


def pieces(values: NDArray[Any], longest: int | None) -> Iterator[NDArray[Any]]:
    """Yield rows (n, ...) in pieces of `longest` at most; each piece begins with the last row of the piece before."""
    size = len(values)
    step = longest or size
    for start in range(0, max(1, size - 1), step - 1):
        yield values[start : start + step]


def played_rate(rig: AbstractRig, sample_rate: float) -> float:
    """Return the `nearest_rate` [Hz] of a rig; raise `DeviceError` if it fails or is not a positive number."""
    with driver_errors(rig.name, "nearest_rate"):
        nearest = rig.nearest_rate(sample_rate)
        try:
            rate = number(nearest, "rate")
        except ModelError:
            rate = math.nan
        if not rate > 0:
            raise DeviceError(
                f"{rig.name}: nearest_rate of {sample_rate:.6g} Hz is {nearest!r}, need a positive number; check the "
                "rig's nearest_rate, or the device; nothing was sent"
            )
    return rate
