"""Readings and samples of a rig, and the check of samples as they arrive."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dehyst._errors import DeviceError, LinkError, ModelError
from dehyst._types import Array
from dehyst._units import plain

# A voltage that is read back may differ from the sent one by this share of the range.
READBACK_TOLERANCE = 0.05


class Reading(NamedTuple):
    """One reading of a rig: `time` [s] of its own clock, `voltage` [V], `displacement` [m]."""

    time: float
    voltage: float
    displacement: float


class Samples(NamedTuple):
    """Consecutive samples of a record: `time` (n,) [s], `voltage` (n,) [V], `displacement` (n,) [m]."""

    time: Array
    voltage: Array
    displacement: Array


Listener = Callable[[Samples], None]


class Inspection:
    """A check of the samples of one record, piece by piece.

    `name`: the instrument, for messages. `span`: range of the voltage [V].
    """

    def __init__(self, name: str, span: float) -> None:
        self._name, self._span, self._last = name, span, -math.inf

    def begin(self, voltage: Array) -> None:
        """Begin a piece whose voltages (n,) [V] are sent."""
        self._sent, self._count = voltage, 0
        # A recorder may be a sample or two late.
        self._slack = max(READBACK_TOLERANCE * self._span, 2 * float(np.abs(np.diff(voltage)).max(initial=0.0)))

    def admit(self, samples: Samples) -> Samples:
        """Return the samples as arrays.

        Raise `LinkError` if they cannot follow the samples before: too many, not finite, or times that do not increase.
        """
        time, voltage, displacement = (self._column(*column) for column in zip(samples, Samples._fields, strict=True))
        sizes = {column.shape for column in (time, voltage, displacement)}
        if len(sizes) > 1 or time.ndim != 1:
            raise LinkError(f"{self._name}: got columns of shapes {sizes}, need one length; check the link")
        if self._count + time.size > self._sent.size:
            raise LinkError(
                f"{self._name}: got {self._count + time.size} samples for {self._sent.size} voltages; check the link"
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

    def _column(self, values: Array, what: str) -> Array:
        try:
            return np.asarray(plain(values, what), dtype=np.float64)
        except ModelError as error:
            raise LinkError(f"{self._name}: {error}; check the driver") from error

    def compare(self, samples: Samples) -> None:
        """Compare recorded with sent voltages; raises DeviceError."""
        sent = self._sent[self._count : self._count + samples.time.size]
        self._count += samples.time.size
        difference = float(np.abs(samples.voltage - sent).max(initial=0.0))
        if difference > self._slack:
            raise DeviceError(
                f"{self._name}: its output is {difference:.4g} V away from what was sent; is the amplifier on, the "
                "servo off and the channel the right one?"
            )

    def end(self) -> None:
        """End the piece; raises DeviceError if samples are missing."""
        if self._count < self._sent.size:
            raise DeviceError(
                f"{self._name}: recorded {self._count} of {self._sent.size} samples; check its data recorder"
            )
