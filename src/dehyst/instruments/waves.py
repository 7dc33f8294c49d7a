"""Readings, samples and waves of a rig: played in pieces, checked as they arrive, timed by the host where need be."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import closing, contextmanager
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import DehystError, DeviceError, LinkError, ModelError, SensorError, Terminated
from dehyst._types import Array
from dehyst._validation import number, plain
from dehyst.instruments.interrupts import by_signal
from dehyst.waveforms import Excitation

if TYPE_CHECKING:
    from dehyst.instruments.base import AbstractRig

# Takes the displacement that was read before a sample [m]; returns the voltage to send [V].
StepFunction: TypeAlias = Callable[[float | None], float]
_Kind = TypeVar("_Kind", bound="np.generic[Any]")

# Highest rate [Hz] that a host keeps with one round trip a sample.
HIGHEST_RATE = 200.0
# The sensor watch refers to this share of the range at least: over a smaller excursion a reading may be constant.
_LEAST_WATCHED = 0.25
# Time [s] that a wave may take without a sample, beside twice its own.
_PATIENCE = 5.0
# Seconds between two batches of samples that the host times.
_BATCH_SECONDS = 0.2
# A voltage that is read back may differ from the sent one by this share of the range.
READBACK_TOLERANCE = 0.05
# A wave may not be faster than was asked by more than this factor, from so many samples on: clocks differ a little.
_PACE, _PACED_FROM = 0.9, 20
# A reading that is constant to the last digit while the voltage crosses this share of its range is not a piezo's.
_DEAD = 0.2


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


def inspected(
    rig: AbstractRig, wave: Callable[[], Iterator[Samples]], sent: Array, *, spans: Array, after: float, patience: float
) -> Generator[Samples, None, None]:
    """Yield each batch of a `wave` that is not empty, admitted, and compared with the `sent` voltages after its use.

    Raise `LinkError` if samples cannot follow the previous ones, of which the last came at `after` [s], or batches are
    empty for longer than `patience` [s]. Raise `DeviceError` if they do not belong to the sent voltages, or some are
    missing; each axis has a range in `spans` [V].
    Whatever the driver raises is re-raised as `DeviceError`; its generator is closed.
    """
    name = rig.name
    # A recorder may be a sample or two late.
    steepest = np.abs(np.diff(sent, axis=0)).max(axis=0, initial=0.0)
    slack = np.maximum(READBACK_TOLERANCE * spans, 2 * steepest)
    with driver_errors(name, "_wave"):
        batches = iter(wave())
    count, latest = 0, time.monotonic()
    try:
        while True:
            with driver_errors(name, "_wave"):
                batch = next(batches, None)
                if batch is None:
                    break
                samples = admitted(name, batch, sent, count, after)
            if not samples.time.size:
                if time.monotonic() - latest > patience:
                    raise LinkError(
                        f"{name}: got empty batches for {patience:.3g} s after {count} samples, need {len(sent)}; "
                        "check the rig's _wave, and the device's data recorder"
                    )
                continue
            if set(samples.others) != set(rig.others):
                found, need = (", ".join(others) or "none" for others in (samples.others, rig.others))
                raise DeviceError(f"{name}: got further channels {found}, need {need}; check the rig's _wave")
            yield samples
            latest = time.monotonic()
            count, after = count + samples.time.size, float(samples.time[-1])
            differences = np.abs(samples.voltage - sent[count - samples.time.size : count]).max(axis=0)
            if (differences > slack).any():
                worst = int(np.argmax(differences - slack))
                where = f"{name}, axis {rig.axes[worst]}" if len(rig.axes) > 1 else name
                raise DeviceError(
                    f"{where}: its output is {np.ravel(differences)[worst]:.4g} V away from what was sent; is the "
                    "amplifier on, the servo off and the channel the right one?"
                )
    finally:
        if isinstance(batches, Generator):
            with driver_errors(name, "_wave"):
                batches.close()
    if count < len(sent):
        raise DeviceError(f"{name}: recorded {count} of {len(sent)} samples; check its data recorder")


def admitted(name: str, samples: Samples, sent: Array, count: int, after: float) -> Samples:
    """Return samples of a driver as arrays.

    Raise `LinkError` if they cannot follow the `count` samples before, the last of which came at `after` [s]: too many
    for the `sent` voltages, not finite, or times that do not increase.
    """
    try:
        columns = [plain(values, what) for values, what in zip(samples[:3], Samples._fields, strict=False)]
    except ModelError as error:
        raise LinkError(f"{name}: {error}; check the driver") from error
    # Copied: a driver may fill the same buffer again.
    times, voltage, displacement = (np.array(column, dtype=np.float64) for column in columns)
    shapes = {times.shape + sent.shape[1:], voltage.shape, displacement.shape}
    if len(shapes) > 1 or times.ndim != 1:
        raise LinkError(f"{name}: got columns of shapes {shapes}, need one length; check the link")
    if count + times.size > len(sent):
        raise LinkError(f"{name}: got {count + times.size} samples for {len(sent)} voltages; check the link")
    if not all(bool(np.isfinite(column).all()) for column in (times, voltage, displacement)):
        raise LinkError(f"{name}: got samples that are not finite; check the link and the sensor")
    rising = np.concatenate([[after], times])
    if (np.diff(rising) <= 0).any():
        first = int(np.argmax(np.diff(rising) <= 0))
        raise LinkError(
            f"{name}: got a sample of {rising[first + 1]:.9g} s after one of {rising[first]:.9g} s, need increasing "
            "times; check the link and the device's clock"
        )
    others = {}
    for column, values in samples.others.items():
        others[column] = channel = np.array(plain(values, column, error=LinkError), dtype=np.float64)
        if channel.shape != times.shape or not np.isfinite(channel).all():
            raise LinkError(f"{name}: {column}: got {channel.shape} values, need one finite number a sample")
    return Samples(times, voltage, displacement, others)


class SensorWatch:
    """A check of samples as they arrive: it raises when the reading is constant while the voltage moves.

    `span`: range of the voltage [V]. `name`: of the sensor, in messages.
    """

    def __init__(self, span: float, name: str = "the sensor") -> None:
        self._enough, self._name = _DEAD * span, name
        # The last reading, the range of the voltage since it is constant, and whether there was another one before.
        self._value, self._low, self._high, self._moved = math.nan, 0.0, 0.0, False

    def observe(self, voltage: Array, displacement: Array) -> None:
        """Check samples (n,) [V], (n,) [m] that follow the ones before.

        Raise `SensorError` if the reading has not changed while the voltage crossed a fifth of its range; the message
        depends on whether the reading moved before.
        """
        if not displacement.size:
            return
        starts = np.concatenate([[0], np.flatnonzero(np.diff(displacement)) + 1])
        low, high = np.minimum.reduceat(voltage, starts), np.maximum.reduceat(voltage, starts)
        if displacement[0] == self._value:
            low[0], high[0] = min(low[0], self._low), max(high[0], self._high)
        else:
            self._moved = self._moved or not math.isnan(self._value)
        stuck = np.flatnonzero(high - low > self._enough)
        if stuck.size:
            first = int(stuck[0])
            what = f"stays at {1e6 * displacement[starts[first]]:.6g} um while the voltage goes from "
            what += f"{low[first]:.6g} to {high[first]:.6g} V"
            does, hint = "does not move", "is it plugged in, switched on, the right channel?"
            if self._moved or first:
                does = "hangs or is saturated"
                hint = "shift its range, use less voltage (--limits), or look at its cable"
            raise SensorError(f"{self._name} {does}: it {what}; {hint}")
        self._moved = self._moved or starts.size > 1
        self._value, self._low, self._high = float(displacement[-1]), float(low[-1]), float(high[-1])


class PaceWatch:
    """A check of times as they arrive: it raises when a rig `name` plays a wave faster than at its `rate` [Hz].

    `rows`: for each sample, the number of its voltage. Late samples are allowed, and ones that make up for a delay.
    """

    def __init__(self, name: str, rate: float, rows: NDArray[np.intp]) -> None:
        self._name, self._rate, self._rows = name, rate, rows
        # The earliest time at which the wave can have begun, by its first samples, of which some may be late.
        self._count, self._begin, self._first = 0, math.inf, math.nan

    def observe(self, time: Array) -> None:
        """Check times (n,) [s] that follow the ones before; raise `DeviceError` if they are too early."""
        rows = self._rows[self._count : self._count + time.size]
        if not self._count:
            self._first = float(time[0])
        self._count += time.size
        due = rows / self._rate
        first = rows < _PACED_FROM
        self._begin = min(self._begin, float((time - due)[first].min(initial=math.inf)))
        early = np.flatnonzero(~first & (time - self._begin < _PACE * due))
        if early.size:
            row, passed = int(rows[early[0]]), float(time[early[0]] - self._first)
            raise DeviceError(
                f"{self._name}: plays faster than the {self._rate:.6g} Hz that were asked for: by its times, sample "
                f"{row} came {passed:.4g} s after the first, need {row / self._rate:.4g} s; check the rig's _wave and "
                "nearest_rate, and the device's clock"
            )


def arriving(
    rig: AbstractRig, excitation: Excitation, rate: float, listen: Listener, step: StepFunction | None
) -> Iterator[Samples]:
    """Play an `excitation` at a `rate` [Hz] from the present output; yield each batch when `listen` has received it.

    `step`: as of `AbstractRig.play`. Raise `RigError` if the device, its link, its sensor or its clock fails.
    """
    spans = np.array([one.limits.high - one.limits.low for one in rig.rigs])
    sensors = [
        SensorWatch(
            max(float(np.ptp(column)), _LEAST_WATCHED * span),
            f"the sensor of axis {one.axis}" if len(rig.axes) > 1 else "the sensor",
        )
        for one, column, span in zip(rig.rigs, columns_of(excitation.voltage), spans.tolist(), strict=True)
    ]
    pace = PaceWatch(rig.name, rate, rig.rows(len(excitation)))
    outputs, after = [one._output for one in rig.rigs], -math.inf
    waves = rig._wave if step is None else partial(host_timed, rig, step=step)
    for piece in pieces(excitation.voltage, rig.longest) if step is None else [excitation.voltage.copy()]:
        count, rig._host_paced = 0, False
        for output, column in zip(outputs, columns_of(piece), strict=True):
            output.plays(column, rate, rig._device_speed)
        wave, patience = partial(waves, piece, rate), _PATIENCE + 2 * len(piece) / rate
        # Closed before the retreat: what a driver does at the end of a wave must not come after it.
        with closing(inspected(rig, wave, piece, spans=spans, after=after, patience=patience)) as batches:
            for samples in batches:
                count += samples.time.size
                for output in outputs if not rig._host_paced else ():
                    output.observe(count)
                listen(samples)
                columns = zip(columns_of(samples.voltage), columns_of(samples.displacement), strict=True)
                for sensor, (voltage, displacement) in zip(sensors, columns, strict=True):
                    sensor.observe(voltage, displacement)
                pace.observe(samples.time)
                after = float(samples.time[-1])
                rig._watch_clock(after, samples.time.size / rate)
                yield samples


def host_timed(rig: AbstractRig, voltage: Array, rate: float, step: StepFunction | None = None) -> Iterator[Samples]:
    """Send each `voltage` (n,) [V] to `rig` at `rate` [Hz] or slower, never faster, and read the instrument after each.

    For the `AbstractRig._wave` of a driver without a wave table, whose `nearest_rate` returns at most `HIGHEST_RATE`:
    slow, with uneven steps. Readings have the device's time, just after each voltage: `hold` is "line". `step`: as of
    `AbstractRig.play`; it replaces the voltages after the first.
    """
    rig._host_paced = True
    period, readings, yielded, read = 1 / rate, [], rig._now(), None
    for k in range(len(voltage)):
        if step is not None:
            voltage[k] = rig.limits.towards(step(read), float(voltage[max(k - 1, 0)]), period)
        v = float(voltage[k])
        rig._put(v)
        # From here a retreat begins if the reading fails: samples come later than voltages.
        rig._output.puts(v)
        # The period starts when the voltage is out: by the slew rate the next step may come late, but not early.
        sent = rig._now()
        readings.append(rig._read())
        read = readings[-1][2]
        now = rig._now()
        if now - yielded >= _BATCH_SECONDS:
            yield Samples(*np.array(readings, dtype=np.float64).T)
            readings, yielded = [], now
        rig._wait(max(0.0, sent + period - rig._now()))
    if readings:
        yield Samples(*np.array(readings, dtype=np.float64).T)


def pieces(values: NDArray[_Kind], longest: int | None) -> Iterator[NDArray[_Kind]]:
    """Yield rows (n, ...) in pieces of `longest` at most, each beginning where the one before ended."""
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
