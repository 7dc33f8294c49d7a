"""What every rig is: where a voltage meets an actuator. Limits, slew rate and retreat are kept here, for all rigs."""

from __future__ import annotations

import math
import time
import warnings
from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager, suppress
from types import TracebackType
from typing import Any, Self, TypeVar, final

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import DeviceError, ModelError, RecordError, RigError
from dehyst._types import Array
from dehyst._validation import number
from dehyst.control import ClampWarning, VoltageLimits
from dehyst.control.ramps import ramp_step
from dehyst.instruments.driver_errors import finite, leafs_own, reading_of
from dehyst.instruments.interrupts import shielded
from dehyst.instruments.limits import common, refuse
from dehyst.instruments.samples import ASTRAY, Inspection, Listener, Reading, Samples
from dehyst.instruments.sensor_watch import SensorWatch
from dehyst.records import Record
from dehyst.waveforms import Excitation

__all__ = ["AbstractRig", "Listener", "Reading", "Samples"]

# A sensor may stand still along a record that moves the voltage less than this part of the range.
_LEAST_WATCHED = 0.25
# Seconds from one step of a ramp to the next; a host keeps no better time.
_TICK = 0.01
# Seconds that a ramp takes for the whole range at least: its steps are small then, and no actuator is struck by them.
_GENTLE = 1.0
# How a note on an error begins that tells where the voltage was left.
_TOLD = "The voltage"

_Kind = TypeVar("_Kind", bound="np.generic[Any]")


class AbstractRig(ABC):
    """An amplifier and a sensor around one actuator.

    A leaf opens its link in ``__init__``, calls ``super().__init__`` with what the device says of itself, and writes
    the methods whose names begin with an underscore; see ``docs/rigs.md``. All that sends a voltage is final here.

    Parameters
    ----------
    name : str
        What the instrument says it is.
    device : VoltageLimits
        What the device allows; its slew rate may be None.
    limits : (float, float), optional
        Voltages that the user allows [V]; what the device does not allow is left out.
    slew_rate : float, optional
        Largest abs(dv/dt) [V/s] that the user allows; by default the device's, or the whole range in 0.1 s.
    longest : int, optional
        Samples that one `_wave` takes; default any number.
    axis : str
        Of the device.
    identity : str, optional
        What tells the instrument from others wherever it is connected; default its name.

    Attributes
    ----------
    limits, slew_rate : VoltageLimits, float
        What is kept to: never wider than the device's nor than the user's, always with a slew rate [V/s].
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
        self.limits = common(device, limits, slew_rate)
        self.slew_rate = float(self.limits.slew_rate or math.inf)
        if longest is not None and longest < 2:
            raise RigError(f"{name}: takes waves of {longest} samples, need 2 at least; check its wave table")
        self.safe = self.limits.nearest(0.0)
        self._closed = False
        self._stood: float | None = None

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
        """Ramp to a voltage [V] within the slew rate, the whole range in a second at least; returns the one sent.

        What lies outside of the limits is clamped, with a `ClampWarning`.

        Raises
        ------
        RecordError
            If it is not a finite number; nothing was sent.
        RigError
            If the device does not do it; a retreat was tried.
        """
        self._refuse_closed()
        try:
            asked = number(voltage, "voltage")
        except ModelError as error:
            raise RecordError(f"{error} of volts; nothing was sent") from error
        sent = self.limits.nearest(asked)
        if sent != asked:
            warnings.warn(
                f"{asked:.6g} V was asked for and {sent:.6g} V sent: {self.limits.words} is allowed",
                ClampWarning,
                stacklevel=2,
            )
        with self.safely():
            self._ramp(sent)
        return sent

    @final
    def read(self) -> Reading:
        """Read the instrument once.

        Raises
        ------
        RigError
            If there is no answer, or none that is finite.
        """
        self._refuse_closed()
        return finite(self.name, self._reading())

    @final
    def play(self, excitation: Excitation, listen: Listener = lambda _: None) -> Record:
        """Ramp to the first voltage of an excitation and play it, at the rate of the device nearest to its own.

        Returns voltage and displacement as the device recorded them, in its own time. `listen` is called with each lot
        of `Samples` as it comes. Whatever goes wrong, in `listen` too, and on Ctrl-C or SIGTERM, the wave is stopped
        and the voltage brought to `safe`; `listen` has had all samples that came.

        Raises
        ------
        RecordError
            If the excitation leaves the limits or is too steep; nothing was sent.
        RigError
            If the device, its link or its sensor fails.
        """
        rate = self.check(excitation)
        came: list[Samples] = []
        span, (low, high) = self.limits.high - self.limits.low, excitation.voltage_range
        look, watch = Inspection(self.name, span), SensorWatch(max(high - low, _LEAST_WATCHED * span))
        with self.safely():
            self._ramp(float(excitation.voltage[0]))
            for piece in self._pieces(excitation.voltage):
                # Closed before the retreat: what a leaf does at the end of a wave may not come after it.
                with closing(self._piece(piece, rate, look)) as lots:
                    for samples in lots:
                        came.append(samples)
                        self._stood = float(samples.voltage[-1])
                        listen(samples)
                        watch.see(samples.voltage, samples.displacement)
        time_, voltage, displacement = (np.concatenate(columns) for columns in zip(*came, strict=True))
        return Record(time_, voltage, displacement, excitation.name, {"rig": self.name, "axis": self.axis})

    @final
    def check(self, excitation: Excitation) -> float:
        """The rate [Hz] at which an excitation would be played; raises RecordError as `play` does. Sends nothing."""
        self._refuse_closed()
        with leafs_own(self.name, "nearest_rate"):
            rate = float(self.nearest_rate(excitation.sample_rate))
        refuse(excitation, rate, self.limits, self.name)
        return rate

    @final
    @contextmanager
    def safely(self) -> Iterator[None]:
        """Retreat when anything goes wrong within, Ctrl-C too; the error has a note of what became of the voltage."""
        with shielded() as shield:
            try:
                # Twice: a signal may come between an error and the line that makes it wait.
                try:
                    yield
                except BaseException:
                    shield.held = True
                    raise
            except BaseException as error:
                if not any(note.startswith(_TOLD) for note in getattr(error, "__notes__", ())):
                    # What stopped it may forbid the retreat, too.
                    error.add_note(self._retreated().replace(f" ({error})", ""))
                raise

    @final
    def retreat(self) -> float:
        """Stop what is played and ramp to the safe voltage [V], which is returned; Ctrl-C waits until it is there.

        Raises
        ------
        RigError
            If the device does not do it.
        """
        self._refuse_closed()
        with shielded(held=True):
            with leafs_own(self.name, "_halt"):
                self._halt()
            self._ramp(self.safe, self._stood)
        return self.safe

    @final
    def close(self) -> None:
        """Let the instrument go, at the voltage where it is. May be called twice."""
        if not self._closed:
            self._closed = True
            self._close()

    @final
    def rows(self, count: int) -> NDArray[np.intp]:
        """Which of `count` voltages each sample of a record belongs to: where pieces join, two have the same."""
        return np.concatenate(list(self._pieces(np.arange(count))))

    def nearest_rate(self, sample_rate: float) -> float:
        """The rate [Hz] nearest to `sample_rate` at which the device can play; by default that itself."""
        return sample_rate

    @abstractmethod
    def _read(self) -> Reading:
        """Read time, voltage and displacement once."""

    @abstractmethod
    def _put(self, voltage: float) -> None:
        """Send one voltage [V], at once; it is within the limits, and one small step from the last."""

    @abstractmethod
    def _wave(self, voltage: Array, rate: float) -> Iterator[Samples]:
        """Play voltages (n,) [V], n <= longest, at `rate` [Hz], beginning where the output is; yield samples early.

        One sample of the record for each voltage. Times go on from one call to the next.
        """

    @abstractmethod
    def _halt(self) -> None:
        """Stop what is being played, if anything is; the voltage stays where it is."""

    @abstractmethod
    def _close(self) -> None:
        """Let the link go; raises nothing."""

    def _wait(self, seconds: float) -> None:
        """Let time pass."""
        time.sleep(seconds)

    def _ramp(self, end: float, otherwise: float | None = None) -> None:
        """Go from the voltage that is read to `end`, within the slew rate and in steps of a hundredth of the range.

        Where it cannot be read, from `otherwise`: a retreat must not fail because a sensor did.
        """
        try:
            present = self._reading().voltage
            if not math.isfinite(present):
                raise DeviceError(f"{self.name}: read a voltage of {present} V, need a finite one; check the device")
        except DeviceError:
            if otherwise is None:
                raise
            present = otherwise
        present = self._within(present)
        low, high = self.limits.low, self.limits.high
        gently = VoltageLimits(low, high, min(self.slew_rate, (high - low) / _GENTLE))
        while present != end:
            present = ramp_step(end, present, gently, _TICK)
            # First, too: a wave may have been stopped just now.
            self._wait(_TICK)
            with leafs_own(self.name, "_put"):
                self._put(self.limits.nearest(present))
            self._stood = present

    def _within(self, voltage: float) -> float:
        """The voltage [V] that a device stands at; a readback's error may put it a little outside of the limits."""
        present = self.limits.nearest(voltage)
        if abs(voltage - present) > ASTRAY * (self.limits.high - self.limits.low):
            raise DeviceError(
                f"{self.name}: stands at {voltage:.6g} V, but {self.limits.words} is allowed; bring it there by hand, "
                "or widen the limits if device and actuator allow it"
            )
        return present

    def _reading(self) -> Reading:
        with leafs_own(self.name, "_read"):
            return reading_of(self.name, self._read())

    def _pieces(self, voltage: NDArray[_Kind]) -> Iterator[NDArray[_Kind]]:
        """The voltages (n,) in pieces that the device takes, each beginning where the one before ended."""
        longest = self.longest or voltage.size
        for start in range(0, max(1, voltage.size - 1), longest - 1):
            yield voltage[start : start + longest]

    def _piece(self, voltage: Array, rate: float, look: Inspection) -> Generator[Samples, None, None]:
        """Play one piece; what comes is looked at before it is believed."""
        look.begin(voltage)
        with leafs_own(self.name, "_wave"):
            wave = iter(self._wave(voltage, rate))
        try:
            while True:
                with leafs_own(self.name, "_wave"):
                    samples = next(wave, None)
                    if samples is None:
                        break
                    admitted = look.admit(samples)
                if admitted.time.size:
                    yield admitted
                    look.judge(admitted)
        finally:
            if isinstance(wave, Generator):
                wave.close()
        look.end()

    def _refuse_closed(self) -> None:
        if self._closed:
            raise RigError(f"{self.name}: is closed; open it again")

    def _retreated(self) -> str:
        """Retreat if the link still lives; what became of it, as a sentence."""
        try:
            return f"{_TOLD} was brought to {self.retreat():.6g} V."
        except Exception as error:  # a leaf's library may raise anything; the first error is the one to be told
            with suppress(Exception):
                self.close()
            told = f"{_TOLD} could not be brought to {self.safe:.6g} V ({error})"
            return f"{told}: the device holds, or plays to its end, what it has; see to it by hand."
