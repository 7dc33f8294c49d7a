"""The base class of all rigs of one or several axes, which enforces limits, slew rate and retreat."""

from __future__ import annotations

import math
import time
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from functools import partial
from types import TracebackType
from typing import Any, Self, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import DeviceError, ModelError, RecordError, RigError
from dehyst._types import Array
from dehyst._validation import number
from dehyst.control import ClampWarning, VoltageLimits
from dehyst.instruments.interrupts import retreated, retreating, shielded
from dehyst.instruments.samples import (
    READBACK_TOLERANCE,
    Inspection,
    Listener,
    Reading,
    Samples,
    SensorWatch,
    arrivals,
    columns_of,
    driver_errors,
    finite,
    pieces,
    reading_of,
)
from dehyst.records import Record
from dehyst.waveforms import Excitation

# Of all axes, or of each; None for an axis: those of the device.
AxisLimits: TypeAlias = Sequence[tuple[float, float] | None] | tuple[float, float] | None
AxisSlewRates: TypeAlias = Sequence[float | None] | float | None

# Highest rate [Hz] that a host keeps with one round trip a sample.
HIGHEST_RATE = 200.0
# The sensor watch refers to this share of the range at least: over a smaller excursion a reading may be constant.
_LEAST_WATCHED = 0.25
# Seconds between two steps of a ramp; a host keeps no better time.
TICK = 0.01
# Least time [s] of a ramp through the whole range: its steps are then small enough for any actuator.
_GENTLE = 1.0
# Seconds between two batches of samples that the host times.
_BATCH_SECONDS = 0.2
# Seconds for the whole range, if neither device nor user gives a slew rate.
_SHORTEST_SWEEP = 0.1
# Least range [V], and longest ramp through it [s].
_LEAST_RANGE, _LONGEST_RAMP = 1e-3, 3600.0
# Relative slack for rates that a device rounds.
_SLACK = 1e-6


class AbstractRig(ABC):
    """An amplifier and a sensor around an actuator, or around each of several that move together.

    A driver opens its link in ``__init__``, calls ``super().__init__`` with what the device reports, and implements
    the methods whose names begin with an underscore; see ``docs/how_to/instruments.md``. All methods that send a
    voltage are final. A rig of several axes is made of a rig of each axis, whose limits, readings, ramps and stops are
    used; its own are `_wave`, which plays all axes from one instant, and `_close`.

    Parameters
    ----------
    name : str
        Name of the instrument.
    device : VoltageLimits or sequence of AbstractRig
        Limits of the device, whose slew rate may be None; of several axes, the rigs of the axes.
    limits : (float, float), optional
        Voltages that the user allows [V]; they are narrowed to those of the device.
    slew_rate : float, optional
        Largest abs(dv/dt) [V/s] that the user allows; by default the device's, or the whole range in 0.1 s.
    longest : int, optional
        Most samples of one `_wave`; default any number.
    axis : str
        Of the device; of several axes their names, joined by commas.
    identity : str, optional
        Identifies the instrument wherever it is connected; default its name.

    Attributes
    ----------
    axes : tuple of str
        Names of the axes.
    rigs : tuple of AbstractRig
        The rig of each axis; of one axis, the rig itself.

    Raises
    ------
    RigError
        If no voltage is allowed by both device and user, or two axes have one name.
    """

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
    ) -> None:
        self.name, self.longest, self.identity = name, longest, identity or name
        self._limits: VoltageLimits | None = None
        self._parts: tuple[AbstractRig, ...] = ()
        if isinstance(device, VoltageLimits):
            self._limits = common_limits(device, limits, slew_rate)
        else:
            self._parts = tuple(device)
        self.axes: tuple[str, ...] = tuple(one.axis for one in self._parts) or (axis,)
        self.axis: str = ",".join(self.axes)
        if not self._limits and (len(self.axes) < 2 or len(set(self.axes)) < len(self.axes)):
            raise RigError(
                argument=name, got=f"the axes {', '.join(self.axes) or 'none'}", need="two or more, each once"
            )
        if longest is not None and longest < 2:
            raise RigError(f"{name}: takes waves of {longest} samples, need 2 at least; check its wave table")
        self._closed = False
        self._last_voltage: float | None = None

    @property
    def rigs(self) -> tuple[AbstractRig, ...]:
        """The rig of each axis."""
        return self._parts or (self,)

    @property
    def limits(self) -> VoltageLimits:
        """Limits in force of the only axis: never wider than the device's or the user's, always with a slew rate.

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
        """The voltage [V] to retreat to, of the only axis: the one within the limits nearest to 0 V."""
        return self.limits.nearest(0.0)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        bounds = "; ".join(f"axis {one.axis}: {one.limits.words}, {one.slew_rate:.6g} V/s" for one in self.rigs)
        return f"<{type(self).__name__} '{self.name}', {bounds}>"

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
            self._ramp([sent])
        return sent

    @final
    def read(self) -> Reading:
        """Read the instrument once; raise `RigError` if there is no answer, or a number in it is not finite.

        Of several axes, each of `rigs` is read.
        """
        self._refuse_closed()
        self._refuse_several()
        return finite(self.name, self._reading())

    @final
    def play(self, excitation: Excitation, listen: Listener = lambda _: None) -> Record:
        """Ramp to the first voltage of an `excitation` and play it, at the device's rate nearest to the excitation's.

        Returns voltage and displacement as the device recorded them, in its own time; several axes play together, a
        column each. `listen` is called with each batch of `Samples` as it arrives. After any error, in `listen` too,
        and on Ctrl-C or SIGTERM, the wave is stopped and all voltages ramped to the safe ones; `listen` has received
        all samples that arrived.

        Raises
        ------
        RecordError
            If the excitation has not one voltage for each axis, leaves the limits or is too steep; nothing was sent.
        RigError
            If the device, its link or its sensor fails.
        """
        rate = self.check(excitation)
        several = self.axes if self._parts else ()
        spans = [one.limits.high - one.limits.low for one in self.rigs]
        inspection = Inspection(self.name, spans if several else spans[0], several)
        names = [f"the sensor of axis {axis}" for axis in several] or ["the sensor"]
        sensors = [
            SensorWatch(max(float(np.ptp(column)), _LEAST_WATCHED * span), name)
            for column, span, name in zip(columns_of(excitation.voltage), spans, names, strict=True)
        ]
        batches: list[Samples] = []
        with self.safely():
            self._ramp(np.ravel(excitation.voltage[0]).tolist())
            for piece in pieces(excitation.voltage, self.longest):
                inspection.begin(piece)
                # Closed before the retreat: what a driver does at the end of a wave must not come after it.
                with closing(arrivals(self.name, partial(self._wave, piece, rate), inspection)) as arriving:
                    for samples in arriving:
                        batches.append(samples)
                        for one, last in zip(self.rigs, np.ravel(samples.voltage[-1]).tolist(), strict=True):
                            one._last_voltage = last
                        listen(samples)
                        for j, sensor in enumerate(sensors):
                            sensor.observe(columns_of(samples.voltage)[j], columns_of(samples.displacement)[j])
        times, voltage, displacement = (np.concatenate(columns) for columns in zip(*batches, strict=True))
        meta = {"rig": self.name, "axis": self.axis}
        return Record(times, voltage, displacement, excitation.name, meta, axes=several)

    @final
    def check(self, excitation: Excitation) -> float:
        """Return the rate [Hz] at which `play` would play an `excitation`; raises its RecordError, sends nothing."""
        self._refuse_closed()
        columns = columns_of(excitation.voltage)
        if len(columns) != len(self.axes) or (excitation.voltage.ndim > 1) != bool(self._parts):
            raise RecordError(
                f"{excitation.name}: got {len(columns)} columns of voltage, need {len(self.axes)}, one an axis; "
                "nothing was sent"
            )
        rates = set()
        for one, column in zip(self.rigs, columns, strict=True):
            with driver_errors(self.name, "nearest_rate"):
                rates.add(float(one.nearest_rate(excitation.sample_rate)))
            name = f"{excitation.name}, axis {one.axis}" if self._parts else excitation.name
            _check_voltage(column, max(rates), one, name)
        if len(rates) > 1:
            raise RigError(f"{self.name}: its axes play at {sorted(rates)} Hz, need one rate")
        return rates.pop()

    @final
    @contextmanager
    def safely(self) -> Iterator[None]:
        """Retreat after any error within, Ctrl-C too, and add a note on the voltage to the error."""
        with retreating(self):
            yield

    @final
    def retreat(self) -> Any:
        """Stop the wave and ramp to the safe voltage [V], which is returned; Ctrl-C waits until it is reached.

        Several axes ramp side by side, and their voltages (axes,) are returned; one that fails does not keep the others
        from it. Raise `RigError` if the device fails.
        """
        self._refuse_closed()
        errors: list[Exception] = []
        ramps = []
        with shielded(defer=True):
            for one in self.rigs:
                try:
                    with driver_errors(one.name, "_halt"):
                        one._halt()
                    ramps.append(one._ramping(one.safe, one._last_voltage))
                except Exception as error:  # the other axes go on
                    errors.append(error)
            errors += self._ramped(ramps)
        if errors:
            raise errors[0]
        return np.array([one.safe for one in self._parts]) if self._parts else self.safe

    @final
    def close(self) -> None:
        """Close the link and leave the voltage where it is. May be called twice."""
        if not self._closed:
            self._closed = True
            for one in self._parts:
                one.close()
            self._close()

    @final
    def rows(self, count: int) -> NDArray[np.intp]:
        """Return which of `count` voltages each sample of a record belongs to; where pieces join, two share one."""
        return np.concatenate(list(pieces(np.arange(count), self.longest)))

    def nearest_rate(self, sample_rate: float) -> float:
        """Return the rate [Hz] nearest to `sample_rate` at which the device can play; by default `sample_rate`."""
        return self._parts[0].nearest_rate(sample_rate) if self._parts else sample_rate

    @abstractmethod
    def _read(self) -> Reading:
        """Read time, voltage and displacement once."""

    @abstractmethod
    def _put(self, voltage: float) -> None:
        """Send one voltage [V], at once; it is within the limits, and one small step from the last."""

    @abstractmethod
    def _wave(self, voltage: Array, rate: float) -> Iterator[Samples]:
        """Play voltages (n,) [V], n <= longest, at `rate` [Hz], from the present output; yield samples as they arrive.

        One sample of the record for each voltage. Times continue from one call to the next. Of several axes, voltages
        are (n, axes) and begin at one instant.
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

    def _ramp(self, ends: Sequence[float]) -> None:
        """Ramp all axes to their voltages [V]."""
        errors = self._ramped([one._ramping(end) for one, end in zip(self.rigs, ends, strict=True)])
        if errors:
            raise errors[0]

    def _ramped(self, ramps: Sequence[Iterator[None]]) -> list[Exception]:
        """Ramp axes side by side, a step of each in a tick; return the errors of those that failed."""
        errors: list[Exception] = []
        going = list(ramps)
        while going:
            left = []
            for ramp in going:
                try:
                    if next(ramp, "done") is None:
                        left.append(ramp)
                except Exception as error:  # of a driver's library: the other axes go on
                    errors.append(error)
            going = left
            if going:
                self.rigs[0]._wait(TICK)
        return errors

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
        low, high, read = self.limits.low, self.limits.high, present
        # An error of the readback may put it slightly outside of the limits.
        present = self.limits.nearest(read)
        if abs(read - present) > READBACK_TOLERANCE * (high - low):
            raise DeviceError(
                f"{self.name}: stands at {read:.6g} V, but {self.limits.words} is allowed; bring it there by hand, "
                "or widen the limits if device and actuator allow it"
            )
        gentle = VoltageLimits(low, high, min(self.slew_rate, (high - low) / _GENTLE))
        while present != end:
            present = gentle.towards(end, present, TICK)
            # Before the first step too: a wave may have been stopped just now.
            yield
            with driver_errors(self.name, "_put"):
                self._put(self.limits.nearest(present))
            self._last_voltage = present

    def _reading(self) -> Reading:
        with driver_errors(self.name, "_read"):
            return reading_of(self.name, self._read())

    def _refuse_several(self) -> None:
        if self._parts:
            raise RigError(f"{self.name}: has the axes {', '.join(self.axes)}, need one; see the rig of each in rigs")

    def _refuse_closed(self) -> None:
        if self._closed:
            raise RigError(f"{self.name}: is closed; open it again")

    def _retreated(self) -> str:
        """Retreat if the link still works, and return the outcome as a sentence."""
        words = ", ".join(f"{one.safe:.6g}" for one in self.rigs)
        return retreated(self.retreat, words, self.close, f" of the axes {', '.join(self.axes)}" if self._parts else "")


def host_timed(rig: AbstractRig, voltage: Array, rate: float) -> Iterator[Samples]:
    """Send each `voltage` (n,) [V] to `rig` at `rate` [Hz] or slower, never faster, and read the instrument after each.

    For the `AbstractRig._wave` of a driver without a wave table, whose `nearest_rate` returns at most `HIGHEST_RATE`:
    slow, with uneven steps. The samples have the times at which they were read, by the device's clock.
    """
    period, readings, yielded = 1 / rate, [], time.monotonic()
    for v in voltage:
        rig._put(float(v))
        # The period starts when the voltage is out: by the slew rate the next step may come late, but not early.
        sent = time.monotonic()
        readings.append(rig._read())
        now = time.monotonic()
        if now - yielded >= _BATCH_SECONDS:
            yield Samples(*np.array(readings, dtype=np.float64).T)
            readings, yielded = [], now
        rig._wait(max(0.0, sent + period - time.monotonic()))
    if readings:
        yield Samples(*np.array(readings, dtype=np.float64).T)


def common_limits(device: VoltageLimits, limits: tuple[float, float] | None, slew_rate: float | None) -> VoltageLimits:
    """Return the limits that device and user both allow, always with a slew rate.

    Raise `RigError` if they have less than a millivolt in common, or a ramp through them takes more than an hour. Raise
    `ModelError` if the user's limits are not valid.
    """
    given = VoltageLimits(*((device.low, device.high) if limits is None else limits), slew_rate)
    low, high = max(device.low, given.low), min(device.high, given.high)
    if not low < high:
        raise RigError(
            f"got {given.words}, but the device has {device.words}",
            argument="limits",
            hint="nothing is left, give others",
        )
    if high - low < _LEAST_RANGE:
        raise RigError(
            argument="limits",
            got=f"{low:g} to {high:g} V",
            need=f"a range of {_LEAST_RANGE:g} V at least",
            hint="widen them",
        )
    rates = [rate for rate in (device.slew_rate, slew_rate) if rate is not None]
    rate = min(rates) if rates else (high - low) / _SHORTEST_SWEEP
    if high - low > _LONGEST_RAMP * rate:
        least = (high - low) / _LONGEST_RAMP
        raise RigError(
            f"slew rate: {rate:g} V/s takes more than an hour from {low:g} to {high:g} V, so that a stop would too; "
            f"give {least:.3g} V/s at least, or narrower limits"
        )
    return VoltageLimits(low, high, rate)


def bounds_of_axes(
    limits: AxisLimits, slew_rate: AxisSlewRates, count: int
) -> list[tuple[tuple[float, float] | None, float | None]]:
    """Return limits [V] and slew rate [V/s] that the user allows of each of `count` axes, given once or for each.

    Raise `RigError` if there is another number of them.
    """
    several = Sequence, np.ndarray
    pairs: list[Any] = [None] if limits is None else list(limits)
    if len(pairs) == 2 and not any(one is None or isinstance(one, several) for one in pairs):
        pairs = [pairs]
    rates: list[Any] = list(slew_rate) if isinstance(slew_rate, several) else [slew_rate]
    for name, given, what in (("limits", pairs, "pairs"), ("slew_rate", rates, "numbers")):
        if len(given) not in (1, count):
            raise RigError(argument=name, got=f"{len(given)} {what} for {count} axes", need="one, or one for each")
    return [
        (None if pair is None else (float(pair[0]), float(pair[1])), None if rate is None else float(rate))
        for pair, rate in zip(*((given * count)[:count] for given in (pairs, rates)), strict=True)
    ]


def _check_voltage(voltage: Array, rate: float, rig: AbstractRig, name: str) -> None:
    """Raise RecordError if a voltage (n,) [V] at `rate` [Hz] exceeds limits or slew rate of a rig of one axis."""
    low, high, limits = float(voltage.min()), float(voltage.max()), rig.limits
    if low < limits.low or high > limits.high:
        raise RecordError(
            f"{name}: {low:.6g} to {high:.6g} V, but {rig.name} may have {limits.words}; "
            "request less, or widen the limits if device and actuator allow it; nothing was sent"
        )
    steepest = float(np.abs(np.diff(voltage)).max()) * rate
    if steepest > rig.slew_rate * (1 + _SLACK):
        raise RecordError(
            f"{name}: is as steep as {steepest:.6g} V/s at {rate:.6g} Hz, but {rig.name} may have "
            f"{rig.slew_rate:.6g} V/s; play it slower; nothing was sent"
        )
