"""Readings and samples of a rig, and what is checked of them as they arrive from a driver."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import DehystError, DeviceError, LinkError, ModelError, SensorError
from dehyst._types import Array
from dehyst._units import plain

# A voltage that is read back may differ from the sent one by this share of the range.
READBACK_TOLERANCE = 0.05
# A reading that is constant to the last digit while the voltage crosses this share of its range is not a piezo's.
_DEAD = 0.2

_Kind = TypeVar("_Kind", bound="np.generic[Any]")


class Reading(NamedTuple):
    """One reading of an axis: `time` [s] of the rig's own clock, `voltage` [V], `displacement` [m]."""

    time: float
    voltage: float
    displacement: float


class Samples(NamedTuple):
    """Consecutive samples of a record: `time` (n,) [s], `voltage` [V] and `displacement` [m].

    Voltage and displacement are (n,) of one axis, (n, axes) of several.
    """

    time: Array
    voltage: Array
    displacement: Array

    def axis(self, index: int) -> Samples:
        """Return the samples of the axis of an `index`, with arrays (n,)."""
        columns = (columns_of(values)[index] for values in (self.voltage, self.displacement))
        return Samples(self.time, *map(np.ascontiguousarray, columns))


Listener = Callable[[Samples], None]


def columns_of(values: Array) -> list[Array]:
    """Return the column (n,) of each axis of values (n,) or (n, axes)."""
    return [values] if values.ndim == 1 else list(values.T)


class Inspection:
    """A check of the samples of one record, piece by piece.

    `name`: the instrument, for messages. `spans`: range of the voltage of each axis [V]. `axes`: their names, where
    there are several.
    """

    def __init__(self, name: str, spans: float | list[float], axes: tuple[str, ...] = ()) -> None:
        self._name, self._spans, self._axes, self._last = name, np.asarray(spans, dtype=np.float64), axes, -math.inf

    def begin(self, voltage: Array) -> None:
        """Begin a piece whose voltages (n,) or (n, axes) [V] are sent."""
        self._sent, self._count = voltage, 0
        # A recorder may be a sample or two late.
        steepest = np.abs(np.diff(voltage, axis=0)).max(axis=0, initial=0.0)
        self._slack = np.maximum(READBACK_TOLERANCE * self._spans, 2 * steepest)

    def admit(self, samples: Samples) -> Samples:
        """Return the samples as arrays.

        Raise `LinkError` if they cannot follow the samples before: too many, not finite, or times that do not increase.
        """
        time, voltage, displacement = (self._column(*column) for column in zip(samples, Samples._fields, strict=True))
        shapes = {time.shape + self._sent.shape[1:], voltage.shape, displacement.shape}
        if len(shapes) > 1 or time.ndim != 1:
            raise LinkError(f"{self._name}: got columns of shapes {shapes}, need one length; check the link")
        if self._count + time.size > len(self._sent):
            raise LinkError(
                f"{self._name}: got {self._count + time.size} samples for {len(self._sent)} voltages; check the link"
            )
        if not all(bool(np.isfinite(column).all()) for column in (time, voltage, displacement)):
            raise LinkError(f"{self._name}: got samples that are not finite; check the link and the sensor")
        times = np.concatenate([[self._last], time])
        if (np.diff(times) <= 0).any():
            first = int(np.argmax(np.diff(times) <= 0))
            raise LinkError(
                f"{self._name}: got a sample of {times[first + 1]:.9g} s after one of {times[first]:.9g} s, need "
                "increasing times; check the link and the device's clock"
            )
        self._last = float(times[-1])
        return Samples(time, voltage, displacement)

    def compare(self, samples: Samples) -> None:
        """Compare recorded with sent voltages; raises DeviceError."""
        sent = self._sent[self._count : self._count + samples.time.size]
        self._count += samples.time.size
        differences = np.abs(samples.voltage - sent).max(axis=0, initial=0.0)
        if (differences > self._slack).any():
            worst = int(np.argmax(differences - self._slack))
            name = f"{self._name}, axis {self._axes[worst]}" if self._axes else self._name
            raise DeviceError(
                f"{name}: its output is {np.ravel(differences)[worst]:.4g} V away from what was sent; is the amplifier "
                "on, the servo off and the channel the right one?"
            )

    def end(self) -> None:
        """End the piece; raises DeviceError if samples are missing."""
        if self._count < len(self._sent):
            raise DeviceError(
                f"{self._name}: recorded {self._count} of {len(self._sent)} samples; check its data recorder"
            )

    def _column(self, values: Array, what: str) -> Array:
        try:
            return np.asarray(plain(values, what), dtype=np.float64)
        except ModelError as error:
            raise LinkError(f"{self._name}: {error}; check the driver") from error


class SensorWatch:
    """A check of samples as they arrive: it raises when the reading is constant while the voltage moves.

    `span`: range of the voltage [V]. `name`: of the sensor, in messages.
    """

    def __init__(self, span: float, name: str = "the sensor") -> None:
        self._enough, self._name = _DEAD * span, name
        self._value: float | None = None
        self._low = self._high = 0.0
        self._moved = False

    def observe(self, voltage: Array, displacement: Array) -> None:
        """Check samples (n,) [V], (n,) [m] that follow the ones before.

        Raise `SensorError` if the reading has not changed while the voltage crossed a fifth of its range; the message
        depends on whether it moved before.
        """
        if not displacement.size:
            return
        starts = np.flatnonzero(np.concatenate([[displacement[0] != self._value], np.diff(displacement) != 0]))
        for first, stop in zip([0, *starts], [*starts, displacement.size], strict=True):
            if first == stop:
                continue
            self._extend(float(displacement[first]), voltage[first:stop])

    def _extend(self, value: float, voltage: Array) -> None:
        low, high = float(voltage.min()), float(voltage.max())
        if value == self._value:
            low, high = min(low, self._low), max(high, self._high)
        else:
            self._moved = self._moved or self._value is not None
        self._value, self._low, self._high = value, low, high
        if high - low > self._enough:
            self._refuse()

    def _refuse(self) -> None:
        what = f"stays at {1e6 * (self._value or 0.0):.6g} um while the voltage goes from {self._low:.6g} to "
        what += f"{self._high:.6g} V"
        if self._moved:
            raise SensorError(
                f"{self._name} hangs or is saturated: it {what}; shift its range, use less voltage (--limits), or look "
                "at its cable"
            )
        raise SensorError(f"{self._name} does not move: it {what}; is it plugged in, switched on, the right channel?")


@contextmanager
def driver_errors(name: str, method: str) -> Iterator[None]:
    """Re-raise what a driver's `method` raises as DeviceError; errors of dehyst pass unchanged."""
    try:
        yield
    except DehystError:
        raise
    # A driver, or its library, may raise anything.
    except Exception as error:
        raise DeviceError(
            f"{name}: {method} of the rig raised {type(error).__name__}: {error}; check its code, or the device"
        ) from error


def reading_of(name: str, values: object) -> Reading:
    """Return three numbers as a reading, finite or not; raise `DeviceError` if `values` are not three numbers."""
    try:
        time, voltage, displacement = map(float, values)  # type: ignore[call-overload]
    except (TypeError, ValueError) as error:
        raise DeviceError(
            f"{name}: read {values!r}, need time, voltage and displacement; check the rig's _read"
        ) from error
    return Reading(time, voltage, displacement)


def finite(name: str, reading: Reading) -> Reading:
    """Return the reading; raises LinkError if a number is not finite."""
    if not all(map(math.isfinite, reading)):
        raise LinkError(f"{name}: read {reading}, need finite numbers; check the device and its sensor")
    return reading


def pieces(values: NDArray[_Kind], longest: int | None) -> Iterator[NDArray[_Kind]]:
    """Yield rows (n, ...) in pieces of `longest` at most, each beginning where the one before ended."""
    size = len(values)
    step = longest or size
    for start in range(0, max(1, size - 1), step - 1):
        yield values[start : start + step]


def arrivals(
    name: str, wave: Callable[[], Iterator[Samples]], inspection: Inspection
) -> Generator[Samples, None, None]:
    """Yield each batch of a `wave` that is not empty: admitted by an `inspection`, and compared after its use.

    Whatever the driver raises is re-raised as `DeviceError` of the rig `name`; the driver's generator is closed.
    """
    with driver_errors(name, "_wave"):
        batches = iter(wave())
    try:
        while True:
            with driver_errors(name, "_wave"):
                batch = next(batches, None)
                if batch is None:
                    break
                admitted = inspection.admit(batch)
            if admitted.time.size:
                yield admitted
                inspection.compare(admitted)
    finally:
        if isinstance(batches, Generator):
            batches.close()
    inspection.end()
