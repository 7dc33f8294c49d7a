"""The base class of all rigs of one or several axes, which enforces limits, slew rate and retreat."""

from __future__ import annotations

import math
import time
import warnings
from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from typing import Any, Self, final

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import DehystError, DeviceError, LinkError, RecordError, RigError, SensorError
from dehyst._types import Array
from dehyst._validation import number
from dehyst.control import ClampWarning, VoltageLimits
from dehyst.instruments.interrupts import Shield
from dehyst.instruments.output import Output, ReadbackError, VoltageNote, common_limits
from dehyst.instruments.waves import (
    HIGHEST_RATE,
    Listener,
    Reading,
    Samples,
    StepFunction,
    arriving,
    columns_of,
    driver_errors,
    host_timed,
    pieces,
    played_rate,
)
from dehyst.records import Record
from dehyst.waveforms import Excitation

# Relative slack for rates that a device rounds.
_SLACK = 1e-6


class AbstractRig(ABC):
    """An amplifier and a sensor around an actuator, or around each of several that move together.

    A driver opens its link in ``__init__``, calls ``super().__init__`` with the limits that the device reports, and
    implements the methods whose names begin with an underscore; see ``docs/how_to/instruments.md``. All methods that
    send a voltage are final. A rig of several axes contains a rig for each axis and uses its limits, readings, ramps
    and stops; it implements only `_wave`, which plays all axes from one instant, and `_close`. Raise `RigError` if no
    voltage is allowed by both device and user, or two axes have the same name. A class that replaces a method of limits
    or retreat, or inherits a replacement, raises TypeError when it is defined.

    Parameters
    ----------
    name : str
        Name of the instrument.
    device : VoltageLimits or sequence of AbstractRig
        Limits of the device, whose slew rate may be None; for several axes, the rigs of the axes.
    limits : (float, float), optional
        Voltages that the user allows [V]; they are narrowed to those of the device.
    slew_rate : float, optional
        Largest abs(dv/dt) [V/s] that the user allows; by default the device's, or the whole range in 0.1 s.
    longest : int, optional
        Largest number of samples of one `_wave`; default: any number.
    axis : str
        Name of the only axis. The attribute `axes` has all names, and `axis` joins them by commas.
    identity : str, optional
        Identifies the instrument wherever it is connected; default its name.
    others : sequence of str, optional
        Names with units of further channels in the `Samples` of `_wave`, such as "temperature_C"; records have them.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        """Refuse a driver that replaces a method of limits, ramps or retreat; `typing.final` would show it too late."""
        super().__init_subclass__(**options)
        if replaced := [name for name in _OWN + _SPECIAL if getattr(cls, name) is not getattr(AbstractRig, name)]:
            drivers = ", ".join(_DRIVERS)
            raise TypeError(
                f"{cls.__name__}: replaces {', '.join(replaced)} of AbstractRig; a driver defines only {drivers}"
            )

    def __init__(
        self,
        name: str,
        device: VoltageLimits | Sequence[AbstractRig],
        *,
        limits: tuple[float, float] | None = None,
        slew_rate: float | None = None,
        longest: int | None = None,
        axis: str = "1",
        identity: str | None = None,
        others: Sequence[str] = (),
    ) -> None:
        self.others = tuple(others)
        self.name, self.longest, self.identity = name, longest, identity or name
        self._limits: VoltageLimits | None = None
        self._parts: tuple[AbstractRig, ...] = ()
        if isinstance(device, VoltageLimits):
            self._limits = common_limits(device, limits, slew_rate)
            self._output = Output(self)
        else:
            self._parts = tuple(device)
        self.axes: tuple[str, ...] = tuple(rig.axis for rig in self._parts) or (axis,)
        self.axis: str = ",".join(self.axes)
        if not self._limits and (len(self.axes) < 2 or len(set(self.axes)) < len(self.axes)):
            raise RigError(
                argument=name, got=f"the axes {', '.join(self.axes) or 'none'}", need="two or more, each once"
            )
        if longest is not None and longest < 2:
            raise RigError(f"{name}: takes waves of {longest} samples, need 2 at least; check its wave table")
        self._closed = False

    @property
    def rigs(self) -> tuple[AbstractRig, ...]:
        """The rig of each axis."""
        return self._parts or (self,)

    @property
    def limits(self) -> VoltageLimits:
        """Effective limits of the only axis: never wider than the device's or the user's, always with a slew rate.

        Raise `RigError` if there are several axes: each of `rigs` has its own.
        """
        self._refuse_several()
        return self._limits  # type: ignore[return-value]

    @property
    def slew_rate(self) -> float:
        """Largest abs(dv/dt) [V/s] in force, of the only axis."""
        return float(self.limits.slew_rate or math.inf)

    @property
    def safe(self) -> float:
        """Voltage [V] for a retreat of the only axis: the voltage within the limits that is nearest to 0 V."""
        return self.limits.nearest(0.0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        try:
            self.close()
        except DehystError as failed:
            if error is None:
                raise
            error.add_note(str(failed))

    def __repr__(self) -> str:
        bounds = "; ".join(f"axis {rig.axis}: {rig.limits.words}, {rig.slew_rate:.6g} V/s" for rig in self.rigs)
        return f"<{type(self).__name__} '{self.name}', {bounds}>"

    @final
    def set_voltage(self, voltage: float) -> float:
        """Ramp to a `voltage` [V] within the slew rate, at most the range per second; return the voltage sent.

        The ramp begins at the last voltage sent, or at the voltage that is read if none was sent. A voltage outside the
        limits is clamped, with a `ClampWarning`. Raise `RecordError` if it is not a finite number: nothing was sent;
        `RigError` if the device fails, or its reading differs from the sent voltage by over 5 % of the range: a retreat
        was attempted.
        """
        self._refuse_closed()
        requested = number(voltage, "voltage", error=RecordError)
        sent = self.limits.nearest(requested)
        if sent != requested:
            warnings.warn(
                f"{requested:.6g} V was requested and {sent:.6g} V sent: {self.limits.words} is allowed",
                ClampWarning,
                stacklevel=2,
            )
        with self.safely():
            self._ramp([self._output.ramp(sent)])
        return sent

    @final
    def read(self) -> Reading:
        """Read the instrument once; raise `RigError` if there is no answer, or a number in it is not finite.

        With several axes, read each of `rigs`.
        """
        self._refuse_closed()
        self._refuse_several()
        reading = self._reading()
        if not all(map(math.isfinite, reading)):
            raise LinkError(f"{self.name}: read {reading}, need finite numbers; check the device and its sensor")
        return reading

    @final
    def play(
        self, excitation: Excitation, listen: Listener = lambda _: None, *, step: StepFunction | None = None
    ) -> Record:
        """Ramp to the first voltage of an `excitation` and play it, at the device's rate nearest to the excitation's.

        Return voltage and displacement as recorded by the device, with its time; several axes have a column each.
        `listen` is called with each batch of `Samples` that arrives. After any error, Ctrl-C or SIGTERM the wave is
        stopped and all voltages are ramped to their safe values. Raise `RecordError` if the excitation does not have a
        voltage for each axis, leaves the limits or is too steep: nothing was sent; `RigError` if device or link fails.

        `step`: called before each sample of a single axis with the displacement [m] of the reading before, or None; it
        returns the voltage to send, within limits and slew rate. This computer sends it, as the default `_wave` does.
        """
        rate, axes = self.check(excitation), self.axes if self._parts else ()
        if step is not None:
            self._refuse_several()
        with self.safely():
            starts = np.ravel(excitation.voltage[0]).tolist()
            self._ramp([rig._output.ramp(start) for rig, start in zip(self.rigs, starts, strict=True)])
            batches = list(arriving(self, excitation, rate, listen, step))
        times, voltages, displacements = (np.concatenate([batch[k] for batch in batches]) for k in range(3))
        others: Any = {column: np.concatenate([batch.others[column] for batch in batches]) for column in self.others}
        meta = {"rig": self.name, "axis": self.axis}
        return Record(times, voltages, displacements, excitation.name, meta, axes=axes, others=others)

    @final
    def check(self, excitation: Excitation) -> float:
        """Return the rate [Hz] at which `play` would play an `excitation`; raise its `RecordError`. Nothing is sent."""
        self._refuse_closed()
        columns = columns_of(excitation.voltage)
        if len(columns) != len(self.axes) or (excitation.voltage.ndim > 1) != bool(self._parts):
            raise RecordError(
                f"{excitation.name}: got {len(columns)} columns of voltage, need {len(self.axes)}, one per axis; "
                "nothing was sent"
            )
        rate = played_rate(self, excitation.sample_rate)
        for rig, column in zip(self.rigs, columns, strict=True):
            name, limits = f"{excitation.name}, axis {rig.axis}" if self._parts else excitation.name, rig.limits
            low, high = float(column.min()), float(column.max())
            if low < limits.low or high > limits.high:
                raise RecordError(
                    f"{name}: {low:.6g} to {high:.6g} V, but {rig.name} allows {limits.words}; "
                    "request less, or widen the limits if device and actuator allow it; nothing was sent"
                )
            steepest = float(np.abs(np.diff(column)).max()) * rate
            if steepest > rig.slew_rate * (1 + _SLACK):
                raise RecordError(
                    f"{name}: is as steep as {steepest:.6g} V/s at {rate:.6g} Hz, but {rig.name} allows "
                    f"{rig.slew_rate:.6g} V/s; play it slower; nothing was sent"
                )
        return rate

    @final
    @contextmanager
    def safely(self) -> Iterator[None]:
        """Retreat after any error in the block, also Ctrl-C, and add a note on the voltage to the error."""
        with Shield() as shield:
            try:
                # There are two blocks: a signal may come between an error and the line that defers signals.
                try:
                    yield
                except BaseException:
                    shield.deferring = True
                    raise
            except BaseException as error:
                if not any(isinstance(note, VoltageNote) for note in getattr(error, "__notes__", ())):
                    error.add_note(self._retreated(error))
                raise

    @final
    def retreat(self) -> Any:
        """Stop the wave and ramp to the safe voltage [V], which is returned; Ctrl-C waits until it is reached.

        The ramp begins at the sent voltage, whatever is read, and its last voltage is sent in any case. Several axes
        ramp simultaneously, and their voltages (axes,) are returned; if one axis fails, the others still ramp. Raise
        `RigError` if the device fails, or the safe voltage was sent and a reading contradicts what was sent.
        """
        self._refuse_closed()
        try:
            return self._retreat()
        except Exception as error:
            error.add_note(self._note(error, error))
            raise

    def _retreat(self) -> Any:
        """Stop the waves of all axes, and ramp to the safe voltages, which are returned."""
        errors: list[Exception] = []
        ramps = []
        with Shield(defer=True):
            for rig in self.rigs:
                try:
                    try:
                        rig._halt()
                    except LinkError:
                        rig._halt()
                except DehystError as error:
                    # The driver cannot stop the wave: this axis does not ramp, the other axes do.
                    errors.append(error)
                    continue
                except BaseException as error:
                    # A ramp is the best action even after a mistake in the driver's code.
                    what = f"{rig.name}: _halt of the rig raised {type(error).__name__}: {error}; a wave may go on"
                    errors.append(DeviceError(what))
                ramps.append(rig._output.retreat(rig.safe))
            self._ramp(ramps, errors, retreating=True)
        return np.array([rig.safe for rig in self._parts]) if self._parts else self.safe

    @final
    def close(self) -> None:
        """Close the link and leave the voltage unchanged. May be called twice. Raise `RigError` if closing fails."""
        if not self._closed:
            self._closed = True
            with ExitStack() as stack:
                stack.enter_context(driver_errors(self.name, "_close"))
                stack.callback(self._close)
                for rig in reversed(self._parts):
                    stack.callback(rig.close)

    @final
    def rows(self, count: int) -> NDArray[np.intp]:
        """Return, for each sample, the number of its voltage (of `count`); where pieces join, two samples share it."""
        return np.concatenate(list(pieces(np.arange(count), self.longest)))

    def nearest_rate(self, sample_rate: float) -> float:
        """Return the rate [Hz] nearest to `sample_rate` at which `_wave` can play; by default `sample_rate`."""
        if self._parts:
            return self._parts[0].nearest_rate(sample_rate)
        return min(sample_rate, HIGHEST_RATE) if type(self)._wave is AbstractRig._wave else sample_rate

    @abstractmethod
    def _read(self) -> Reading:
        """Read time, voltage and displacement once."""

    @abstractmethod
    def _put(self, voltage: float) -> None:
        """Send one voltage [V], at once; it is within the limits, and one small step from the last."""

    def _wave(self, voltage: Array, rate: float) -> Iterator[Samples]:
        """Play voltages (n,) [V], n <= longest, at `rate` [Hz], from the present output; yield samples as they arrive.

        The record has a sample for each voltage. Times continue from one call to the next. With several axes, voltages
        are (n, axes) and begin simultaneously. By default this computer sends each voltage, at `HIGHEST_RATE` at most,
        never faster than the slew rate, with uneven steps, and reads in the middle of each hold: `Record.hold` "line".
        """
        return host_timed(self, voltage, rate)

    @abstractmethod
    def _halt(self) -> None:
        """Stop the wave, if one is playing; the voltage stays where it is."""

    @abstractmethod
    def _close(self) -> None:
        """Close the link; the voltage stays where it is."""

    def _now(self) -> float:
        """Return the time [s] by which this computer waits; a virtual device may have its own."""
        return time.monotonic()

    def _wait(self, seconds: float) -> None:
        """Wait."""
        time.sleep(seconds)

    def _read_voltage(self) -> float:
        """Read the voltage [V] alone; by default that of `_read`."""
        return self._reading().voltage

    def _ramp(
        self,
        ramps: Sequence[Generator[float, float, None]],
        errors: Sequence[Exception] = (),
        *,
        retreating: bool = False,
    ) -> None:
        """Ramp axes simultaneously; raise the first error when all axes that can ramp have ramped.

        When `retreating`, the ramp goes on after an error of `_wait`.
        """
        found, going, waited = list(errors), list(ramps), None
        while going:
            waits = {}
            for ramp in going:
                try:
                    waits[ramp] = next(ramp) if waited is None else ramp.send(waited)
                except StopIteration:
                    pass
                except Exception as error:  # of a driver's library: the other axes go on
                    found.append(error)
            going = list(waits)
            if going:
                waited = max(waits.values())
                try:
                    with driver_errors(self.name, "_wait"):
                        self.rigs[0]._wait(waited)
                except DehystError:
                    if not retreating:
                        raise
                    time.sleep(waited)
        if found:
            # After a `ReadbackError` alone, the last voltage of each ramp was sent: other errors come first.
            raise next((error for error in found if not isinstance(error, ReadbackError)), found[0])

    def _voltage_read(self) -> float:
        """Return the voltage that is read [V]; raise `RigError` if it cannot be read."""
        with driver_errors(self.name, "_read_voltage"):
            read: Any = self._read_voltage()
        with suppress(TypeError, ValueError):
            if math.isfinite(voltage := float(read)):
                return voltage
        raise DeviceError(f"{self.name}: read {read!r} as the voltage, need a finite number of V; check the device")

    def _reading(self) -> Reading:
        """Read once; numbers may not be finite."""
        with driver_errors(self.name, "_read"):
            values: Any = self._read()
            try:
                time_, voltage, displacement = map(float, values)
            except (TypeError, ValueError) as error:
                raise DeviceError(
                    f"{self.name}: read {values!r}, need time, voltage and displacement; check the rig's _read"
                ) from error
        return Reading(time_, voltage, displacement)

    def _refuse_several(self) -> None:
        if self._parts:
            raise RigError(f"{self.name}: has the axes {', '.join(self.axes)}, need one; see the rig of each in rigs")

    def _refuse_closed(self) -> None:
        if self._closed:
            raise RigError(f"{self.name}: is closed; open it again")

    def _retreated(self, cause: BaseException) -> VoltageNote:
        """Retreat after a `cause` if the link still works, else close it; return the outcome."""
        failed: Exception | None = None
        try:
            self._retreat()
        except Exception as error:  # a driver's library may raise anything; the first error is the one to report
            failed = error
            with suppress(Exception):
                self.close()
        return self._note(cause, failed)

    def _note(self, cause: BaseException, failed: Exception | None) -> VoltageNote:
        """Return where the voltage is after a `cause`, and a retreat that may have `failed`."""
        of, to = (f" {word} the axes {', '.join(self.axes)}" if self._parts else "" for word in ("of", "to"))
        safe = ", ".join(f"{rig.safe:.6g}" for rig in self.rigs)
        said = f"The voltage{of} was brought to {safe} V."
        if isinstance(failed, ReadbackError):
            wrong = f"the readback gave {failed.read:.6g} V where {failed.sent:.6g} V had been sent"
            said = f"{safe} V was sent{to}, but {wrong}; check it by hand."
        elif failed is not None:
            # The cause of the first error may prevent the retreat too: the note does not repeat it.
            why = "" if str(failed) == str(cause) else f" ({failed})"
            known = "; ".join(f"{rig.axis + ': ' if self._parts else ''}{rig._output.words}" for rig in self.rigs)
            holds = "the device holds its voltage, or plays its wave to the end; check it by hand"
            said = f"The voltage{of} could not be brought to {safe} V{why}; {known}: {holds}."
        elif any(math.isnan(rig._output.read) for rig in self.rigs):
            said = f"{safe} V was sent{to}, and the voltage could not be read."
        elif not all(rig._output.reached(rig.safe) for rig in self.rigs):
            said = f"{safe} V was sent{to}, and {', '.join(f'{rig._output.read:.6g}' for rig in self.rigs)} V is read."
        elif isinstance(cause, SensorError):
            said = f"{safe} V was sent{to} and is read, but the sensor does not confirm it; check it by hand."
        return VoltageNote(said, safe=failed is None, voltages=[rig._output.likely for rig in self.rigs])


# Methods that a driver may define; those of the base class alone; and special methods that no driver may have.
_DRIVERS = ("nearest_rate", "_read", "_read_voltage", "_put", "_wave", "_halt", "_close", "_now", "_wait")
_OWN = tuple(
    name
    for name, value in vars(AbstractRig).items()
    if (callable(value) or isinstance(value, property)) and name not in _DRIVERS and not name.startswith("__")
)
_SPECIAL = ("__enter__", "__exit__", "__getattribute__")
