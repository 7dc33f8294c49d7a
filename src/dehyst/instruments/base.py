"""The base class of all rigs, which enforces limits, slew rate and retreat."""

from __future__ import annotations

import math
import time
import warnings
from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager
from types import TracebackType
from typing import Self, final

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import DeviceError, ModelError, RecordError, RigError
from dehyst._types import Array
from dehyst._validation import number
from dehyst.control import ClampWarning, VoltageLimits
from dehyst.control.ramps import ramp_step
from dehyst.instruments.driver_errors import arrivals, driver_errors, finite, pieces, reading_of
from dehyst.instruments.interrupts import retreated, retreating, shielded
from dehyst.instruments.limits import check_excitation, common_limits
from dehyst.instruments.samples import READBACK_TOLERANCE, Inspection, Listener, Reading, Samples
from dehyst.instruments.sensor_watch import SensorWatch
from dehyst.records import Record
from dehyst.waveforms import Excitation

__all__ = ["AbstractRig", "Listener", "Reading", "Samples"]

# The sensor watch refers to this share of the range at least: over a smaller excursion a reading may be constant.
LEAST_WATCHED = 0.25
# Seconds between two steps of a ramp; a host keeps no better time.
TICK = 0.01
# Least time [s] of a ramp through the whole range: its steps are then small enough for any actuator.
_GENTLE = 1.0


class AbstractRig(ABC):
    """An amplifier and a sensor around one actuator.

    A driver opens its link in ``__init__``, calls ``super().__init__`` with what the device reports, and implements
    the methods whose names begin with an underscore; see ``docs/how_to/instruments.md``. All methods that send a
    voltage are final.

    Parameters
    ----------
    name : str
        Name of the instrument.
    device : VoltageLimits
        Limits of the device; its slew rate may be None.
    limits : (float, float), optional
        Voltages that the user allows [V]; they are narrowed to those of the device.
    slew_rate : float, optional
        Largest abs(dv/dt) [V/s] that the user allows; by default the device's, or the whole range in 0.1 s.
    longest : int, optional
        Most samples of one `_wave`; default any number.
    axis : str
        Of the device.
    identity : str, optional
        Identifies the instrument wherever it is connected; default its name.

    Attributes
    ----------
    limits, slew_rate : VoltageLimits, float
        The limits in force: never wider than the device's or the user's, always with a slew rate [V/s].
    safe : float
        The voltage [V] to retreat to: the one within the limits nearest to 0 V.

    Raises
    ------
    RigError
        If no voltage is allowed by both device and user.
    """

    def __init__(
        self,
        name: str,
        device: VoltageLimits,
        *,
        limits: tuple[float, float] | None = None,
        slew_rate: float | None = None,
        longest: int | None = None,
        axis: str = "1",
        identity: str | None = None,
    ) -> None:
        self.name, self.axis, self.longest, self.identity = name, axis, longest, identity or name
        self.limits = common_limits(device, limits, slew_rate)
        self.slew_rate = float(self.limits.slew_rate or math.inf)
        if longest is not None and longest < 2:
            raise RigError(f"{name}: takes waves of {longest} samples, need 2 at least; check its wave table")
        self.safe = self.limits.nearest(0.0)
        self._closed = False
        self._last_voltage: float | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        slew = f"{self.slew_rate:.6g} V/s"
        return f"<{type(self).__name__} '{self.name}', axis {self.axis}: {self.limits.words}, {slew}>"

    @final
    def set_voltage(self, voltage: float) -> float:
        """Ramp to a `voltage` [V] within the slew rate, the whole range in a second at least; return the voltage sent.

        A voltage outside the limits is clamped, with a `ClampWarning`.

        Raises
        ------
        RecordError
            If it is not a finite number; nothing was sent.
        RigError
            If the device fails; a retreat was attempted.
        """
        self._refuse_closed()
        try:
            requested = number(voltage, "voltage")
        except ModelError as error:
            raise RecordError(f"{error} of volts; nothing was sent") from error
        sent = self.limits.nearest(requested)
        if sent != requested:
            warnings.warn(
                f"{requested:.6g} V was requested and {sent:.6g} V sent: {self.limits.words} is allowed",
                ClampWarning,
                stacklevel=2,
            )
        with self.safely():
            self._ramp(sent)
        return sent

    @final
    def read(self) -> Reading:
        """Read the instrument once; raise `RigError` if there is no answer, or a number in it is not finite."""
        self._refuse_closed()
        return finite(self.name, self._reading())

    @final
    def play(self, excitation: Excitation, listen: Listener = lambda _: None) -> Record:
        """Ramp to the first voltage of an `excitation` and play it, at the device's rate nearest to the excitation's.

        Returns voltage and displacement as the device recorded them, in its own time. `listen` is called with each
        batch of `Samples` as it arrives. After any error, in `listen` too, and on Ctrl-C or SIGTERM, the wave is
        stopped and the voltage ramped to `safe`; `listen` has received all samples that arrived.

        Raises
        ------
        RecordError
            If the excitation leaves the limits or is too steep; nothing was sent.
        RigError
            If the device, its link or its sensor fails.
        """
        rate = self.check(excitation)
        batches: list[Samples] = []
        span, (low, high) = self.limits.high - self.limits.low, excitation.voltage_range
        inspection, sensor = Inspection(self.name, span), SensorWatch(max(high - low, LEAST_WATCHED * span))
        with self.safely():
            self._ramp(float(excitation.voltage[0]))
            for piece in pieces(excitation.voltage, self.longest):
                # Closed before the retreat: what a driver does at the end of a wave must not come after it.
                with closing(self._piece(piece, rate, inspection)) as arriving:
                    for samples in arriving:
                        batches.append(samples)
                        self._last_voltage = float(samples.voltage[-1])
                        listen(samples)
                        sensor.observe(samples.voltage, samples.displacement)
        times, voltage, displacement = (np.concatenate(columns) for columns in zip(*batches, strict=True))
        return Record(times, voltage, displacement, excitation.name, {"rig": self.name, "axis": self.axis})

    @final
    def check(self, excitation: Excitation) -> float:
        """Return the rate [Hz] at which `play` would play an `excitation`; raises its RecordError, sends nothing."""
        self._refuse_closed()
        with driver_errors(self.name, "nearest_rate"):
            rate = float(self.nearest_rate(excitation.sample_rate))
        check_excitation(excitation, rate, self.limits, self.name)
        return rate

    @final
    @contextmanager
    def safely(self) -> Iterator[None]:
        """Retreat after any error within, Ctrl-C too, and add a note on the voltage to the error."""
        with retreating(self):
            yield

    @final
    def retreat(self) -> float:
        """Stop the wave and ramp to the safe voltage [V], which is returned; Ctrl-C waits until it is reached.

        Raise `RigError` if the device fails.
        """
        self._refuse_closed()
        with shielded(defer=True):
            self._stop_wave()
            self._ramp(self.safe, self._last_voltage)
        return self.safe

    @final
    def close(self) -> None:
        """Close the link and leave the voltage where it is. May be called twice."""
        if not self._closed:
            self._closed = True
            self._close()

    @final
    def rows(self, count: int) -> NDArray[np.intp]:
        """Return which of `count` voltages each sample of a record belongs to; where pieces join, two share one."""
        return np.concatenate(list(pieces(np.arange(count), self.longest)))

    def nearest_rate(self, sample_rate: float) -> float:
        """Return the rate [Hz] nearest to `sample_rate` at which the device can play; by default `sample_rate`."""
        return sample_rate

    @abstractmethod
    def _read(self) -> Reading:
        """Read time, voltage and displacement once."""

    @abstractmethod
    def _put(self, voltage: float) -> None:
        """Send one voltage [V], at once; it is within the limits, and one small step from the last."""

    @abstractmethod
    def _wave(self, voltage: Array, rate: float) -> Iterator[Samples]:
        """Play voltages (n,) [V], n <= longest, at `rate` [Hz], from the present output; yield samples as they arrive.

        One sample of the record for each voltage. Times continue from one call to the next.
        """

    @abstractmethod
    def _halt(self) -> None:
        """Stop the wave, if one is playing; the voltage stays where it is."""

    @abstractmethod
    def _close(self) -> None:
        """Close the link; raises nothing."""

    def _wait(self, seconds: float) -> None:
        """Wait."""
        time.sleep(seconds)

    def _ramp(self, end: float, fallback: float | None = None) -> None:
        """Ramp as `_ramping` does."""
        for _ in self._ramping(end, fallback):
            self._wait(TICK)

    def _stop_wave(self) -> None:
        """Stop the wave, if one is playing; the voltage stays. Raise `DeviceError` if the device fails."""
        with driver_errors(self.name, "_halt"):
            self._halt()

    def _ramping(self, end: float, fallback: float | None = None) -> Iterator[None]:
        """Ramp from the voltage that is read to `end`, within the slew rate and in steps of a hundredth of the range.

        Yields before each step, so that the caller waits a tick. If the voltage cannot be read, from `fallback`: a
        retreat must not fail because a sensor did.
        """
        try:
            present = self._reading().voltage
            if not math.isfinite(present):
                raise DeviceError(f"{self.name}: read a voltage of {present} V, need a finite one; check the device")
        except DeviceError:
            if fallback is None:
                raise
            present = fallback
        present = self._within(present)
        low, high = self.limits.low, self.limits.high
        gentle = VoltageLimits(low, high, min(self.slew_rate, (high - low) / _GENTLE))
        while present != end:
            present = ramp_step(end, present, gentle, TICK)
            # Before the first step too: a wave may have been stopped just now.
            yield
            with driver_errors(self.name, "_put"):
                self._put(self.limits.nearest(present))
            self._last_voltage = present

    def _within(self, voltage: float) -> float:
        """Return a read voltage [V] as one within the limits; an error of the readback may put it slightly outside."""
        present = self.limits.nearest(voltage)
        if abs(voltage - present) > READBACK_TOLERANCE * (self.limits.high - self.limits.low):
            raise DeviceError(
                f"{self.name}: stands at {voltage:.6g} V, but {self.limits.words} is allowed; bring it there by hand, "
                "or widen the limits if device and actuator allow it"
            )
        return present

    def _reading(self) -> Reading:
        with driver_errors(self.name, "_read"):
            return reading_of(self.name, self._read())

    def _piece(self, voltage: Array, rate: float, inspection: Inspection) -> Generator[Samples, None, None]:
        """Play one piece and check its samples as they arrive."""
        inspection.begin(voltage)
        yield from arrivals(self.name, lambda: self._wave(voltage, rate), inspection.admit, inspection.compare)
        inspection.end()

    def _refuse_closed(self) -> None:
        if self._closed:
            raise RigError(f"{self.name}: is closed; open it again")

    def _retreated(self) -> str:
        """Retreat if the link still works, and return the outcome as a sentence."""
        return retreated(lambda: f"{self.retreat():.6g}", f"{self.safe:.6g}", self.close)
