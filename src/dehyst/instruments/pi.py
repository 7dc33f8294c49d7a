"""A rig on axes of a PI piezo controller with GCS 2.0 over TCP.

The properties of the controller are queried; its wave generators play, and its data recorder records.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple, Self

import numpy as np

from dehyst._errors import DeviceError, LinkError, RigError
from dehyst._types import Array
from dehyst.control import VoltageLimits
from dehyst.instruments import gcs_syntax
from dehyst.instruments.base import AbstractRig
from dehyst.instruments.gcs_client import GcsClient, TcpLink
from dehyst.instruments.gcs_syntax import command
from dehyst.instruments.output import AxisLimits, AxisSlewRates, bounds_of_axes
from dehyst.instruments.waves import HIGHEST_RATE, Reading, Samples

PORT = 50000
# A recorder without a new sample for this many sample periods, and for the `patience` of a rig, has stopped.
_PATIENT_SAMPLES = 20
_STEPS_TO_STOP = 20
# Controllers report positions in micrometres.
_METRES = 1e-6
# Seconds between two polls of the recorder: less for a short wave, so that a dead sensor is detected in time.
_SHORTEST_POLL, _POLL, _POLLS = 0.02, 0.1, 20
# Largest number of values in one answer.
_MOST_NUMBERS = 2000
# Time [s] between two readings within one tick of a clock.
_TICK = 1e-9
# Parameters of the public list.
_SERVO_PERIOD, _WAVE_POINTS, _RECORD_POINTS = 0x0E000200, 0x13000004, 0x16000200
_FOR_WAVES = ("WAV", "WSL", "WGC", "WTR", "WGO", "WGO?", "DRC", "DRL?", "DRR?", "RTR", "SPA?", "TNR?", "HDR?")
_FOR_VOLTAGES = ("SVA", "VOL?", "POS?", "ERR?")


class WaveTraits(NamedTuple):
    """Properties of a controller that plays and records waves.

    `servo_period` [s]; waves are played and recorded in multiples of it. `longest`: largest number of samples of a
    wave. `options`: numbers of DRC of position and voltage. `tables`: number of recorder tables.
    """

    servo_period: float
    longest: int
    options: tuple[int, int]
    tables: int

    def divider(self, rate: float) -> int:
        """Return the number of servo periods per sample for the rate nearest to `rate` [Hz]."""
        below = max(1, int(1 / (rate * self.servo_period)))
        return min((below, below + 1), key=lambda divider: abs(1 / (divider * self.servo_period) - rate))


class PiRig(AbstractRig):
    """Axes of a PI controller in open loop.

    The wave generators play and the data recorder records; the host only fills and reads tables. Without generators or
    recorder the host sends the voltages of one axis one by one, at 200 Hz at most, with a warning. Positions are
    assumed to be in micrometres. A servo that is on is switched off. No command is sent twice.

    Raise `LinkError` if the answers do not come from a GCS controller; `DeviceError` if it cannot send voltages in open
    loop, does not report its limits and none are given, or cannot play and record several axes together; `RigError` if
    it has no such axis, or its limits and the given ones have no voltage in common.

    Parameters
    ----------
    link : TcpLink or GcsClient
        Usually from `connect`; a client may be shared by the axes of a controller.
    axis : str or sequence of str, optional
        One name, or several axes that play together; needed if the controller has several.
    limits : (float, float) or sequence of (float, float), optional
        Allowed voltages [V], of all axes or of each; the controller's own where they are narrower.
    slew_rate : float or sequence of float, optional
        Largest abs(dv/dt) [V/s], of all axes or of each.
    """

    waves: WaveTraits | None
    patience = 5.0  # Seconds

    def __init__(
        self,
        link: TcpLink | GcsClient,
        *,
        axis: str | Sequence[str] | None = None,
        limits: AxisLimits = None,
        slew_rate: AxisSlewRates = None,
    ) -> None:
        self._client = link if isinstance(link, GcsClient) else GcsClient(link)
        self._opened, self._began, self._last = False, self._now(), -np.inf
        names = [axis] if axis is None or isinstance(axis, str) else list[str | None](axis)
        allowed = bounds_of_axes(limits, slew_rate, len(names))
        if len(names) == 1:
            self._pi_rigs = [self]
            self._open_axis(names[0], *allowed[0])
            return
        self._pi_rigs = [
            PiRig(self._client, axis=name, limits=bounds, slew_rate=rate)
            for name, (bounds, rate) in zip(names, allowed, strict=True)
        ]
        longest = min(rig.longest or 0 for rig in self._pi_rigs)
        super().__init__(self._client.name, self._pi_rigs, longest=longest or None, identity=self._client.identity)
        for rig in self._pi_rigs:
            if rig.waves is None or rig.waves.tables < 2 * len(names):
                raise DeviceError(
                    f"{self.name}: cannot play and record {len(names)} axes together; it needs a wave generator an "
                    f"axis and {2 * len(names)} recorder tables; calibrate one axis at a time"
                )
            rig._began = self._began
        self.waves = self._pi_rigs[0].waves

    def _open_axis(self, axis: str | None, limits: tuple[float, float] | None, slew_rate: float | None) -> None:
        """Query the properties of one axis, and set it up."""
        client = self._client
        absent = [word for word in _FOR_VOLTAGES if word not in client.commands]
        if absent:
            raise DeviceError(
                f"{client.name}: lacks the commands {', '.join(absent)}, need open-loop voltages and a position; use "
                "another controller"
            )
        client.clear()
        axes = client.query("SAI?", gcs_syntax.names) if "SAI?" in client.commands else ["1"]
        if axis is None and len(axes) > 1:
            raise RigError(f"{client.name}: has the axes {', '.join(axes)}; choose one, as in pi://host:port/{axes[0]}")
        name = axes[0] if axis is None else axis
        if name not in axes:
            raise RigError(f"{client.name}: got the axis {name!r}, it has {', '.join(axes)}; give one of them")
        self._generator = str(axes.index(name) + 1)
        channels = client.query("VOL?", gcs_syntax.pairs)
        # The piezo channel of an axis has its name, or else its number.
        self._channel = name if name in channels else self._generator
        if self._channel not in channels:
            raise DeviceError(f"{client.name}: has the channels {', '.join(channels)}, need one for the axis {name}")
        device = _device_limits(client, self._channel, limits)
        self.waves, missing = _wave_traits(client)
        super().__init__(
            client.name,
            device,
            limits=limits,
            slew_rate=slew_rate,
            axis=name,
            longest=self.waves.longest if self.waves else None,
            identity=client.identity,
        )
        if self.waves is None:
            warnings.warn(
                f"{self.name}: {missing}; the host sends the voltages instead, slowly ({HIGHEST_RATE:g} Hz) and with "
                "jitter",
                stacklevel=3,
            )

    @classmethod
    def connect(cls, host: str, port: int = PORT, *, timeout: float = 5.0, **options: Any) -> Self:
        """Connect to a controller by TCP; `timeout` [s] is the longest wait for an answer.

        `options`: options of `PiRig`, with the same errors.
        """
        link = TcpLink(host, port, timeout)
        try:
            return cls(link, **options)
        except BaseException:
            link.close()
            raise

    def nearest_rate(self, sample_rate: float) -> float:
        """Return the rate [Hz] nearest to `sample_rate` that divides the servo's rate."""
        if self.waves is None:
            return min(sample_rate, HIGHEST_RATE)
        return 1 / (self.waves.divider(sample_rate) * self.waves.servo_period)

    def _read(self) -> Reading:
        # The time of the host's clock, but later than the last sample: two readings may come within one tick.
        self._last = max(self._now() - self._began, self._last + _TICK)
        (position,) = self._client.numbers("POS?", self.axis)
        # The answer to this command has no key: a position that is one answer late cannot be taken for the voltage.
        self._client.set()
        return Reading(self._last, self._read_voltage(), position * _METRES)

    def _read_voltage(self) -> float:
        return self._client.numbers("VOL?", self._channel)[0]

    def _put(self, voltage: float) -> None:
        self._open_loop()
        self._client.set(command("SVA", self.axis, gcs_syntax.volts(voltage, self.limits.low, self.limits.high)))

    def _wave(self, voltage: Array, rate: float) -> Iterator[Samples]:
        if self.waves is None:
            yield from super()._wave(voltage, rate)
            return
        for rig in self._pi_rigs:
            rig._open_loop()
            rig._halt()
        divider = self.waves.divider(rate)
        interval = divider * self.waves.servo_period
        columns = voltage.reshape(len(voltage), len(self._pi_rigs))
        self._prepare(columns, divider, self.waves.options)
        start = max(self._now() - self._began, self._last + interval)
        self._client.set(command("WGO", *(word for rig in self._pi_rigs for word in (rig._generator, 1))))
        for first, positions, volts in self._recorded(len(voltage), interval):
            times: Array = start + interval * np.arange(first, first + len(volts), dtype=np.float64)
            self._last = float(times[-1])
            samples = Samples(times, volts, positions * _METRES)
            yield samples if len(self.axes) > 1 else samples.axis(0)
        # While its generator is on, the controller takes no voltages.
        for rig in self._pi_rigs:
            rig._halt()

    def _halt(self) -> None:
        if self.waves is None:
            return
        query, stop = command("WGO?", self._generator), [command("WGO", self._generator, 0)]
        for _ in range(_STEPS_TO_STOP):
            if self._client.query(query, partial(gcs_syntax.values, keys=[self._generator]), stop) == [0]:
                # Clear the error that reports the stop. After any answer, a ramp is possible.
                with suppress(LinkError):
                    self._client.clear()
                return
            stop = []
            self._wait(_SHORTEST_POLL)
        raise DeviceError(f"{self.name}: its wave generator was sent a stop and goes on; switch it off by hand")

    def _close(self) -> None:
        with suppress(Exception):
            self._client.close()

    def _open_loop(self) -> None:
        """Switch the servo off before the first voltage, if there is one; reading alone leaves it on."""
        if self._opened or not {"SVO", "SVO?"} <= self._client.commands:
            return
        if self._client.numbers("SVO?", self.axis) != [0]:
            warnings.warn(f"{self.name}: its servo was on and is switched off: open loop is needed", stacklevel=2)
            self._client.set(command("SVO", self.axis, 0))
        if self._client.numbers("SVO?", self.axis) != [0]:
            raise DeviceError(f"{self.name}: its servo does not go off; switch it off by hand")
        self._opened = True

    def _prepare(self, voltage: Array, divider: int, options: tuple[int, int]) -> None:
        """Fill the wave tables with voltages (n, axes) [V], and set generators and recorder to play and record once."""
        client = self._client
        # Each generator plays a wave table of its own, numbered from 1 on.
        numbered = list(enumerate(self._pi_rigs, 1))
        for (number, rig), column in zip(numbered, voltage.T, strict=True):
            points = [gcs_syntax.volts(value, rig.limits.low, rig.limits.high) for value in column.tolist()]
            for line in gcs_syntax.wave_points(number, points):
                client.set(line)
        for number, rig in numbered:
            client.set(command("WSL", rig._generator, number))
            client.set(command("WGC", rig._generator, 1))
            client.set(command("WTR", rig._generator, divider, 0))
            if "WOS" in client.commands:
                # An offset that is set would be added to every voltage.
                client.set(command("WOS", rig._generator, 0))
        client.set(command("RTR", divider))
        for number, rig in numbered:
            client.set(command("DRC", 2 * number - 1, rig.axis, options[0]))
            client.set(command("DRC", 2 * number, rig._channel, options[1]))
        if "DRT" in client.commands:
            # The default: the start of a wave starts the record.
            client.set(command("DRT", 0, 0, 0))
        for number, _ in numbered if "WAV?" in client.commands else ():
            length = client.query(command("WAV?", number, 1), partial(gcs_syntax.parameter, item=str(number), number=1))
            if length != len(voltage):
                raise DeviceError(
                    f"{client.name}: its wave table holds {length:g} points, need {len(voltage)}; nothing was played"
                )

    def _recorded(self, count: int, interval: float) -> Iterator[tuple[int, Array, Array]]:
        """Yield rows as they are recorded: number of the first row, positions [um] and voltages [V] (m, axes)."""
        client = self._client
        # The recorder's tables: position and voltage of each axis.
        keys = [str(number + 1) for number in range(2 * len(self._pi_rigs))]
        got, most = 0, max(1, _MOST_NUMBERS // len(keys))
        poll = min(_POLL, max(_SHORTEST_POLL, count * interval / _POLLS))
        patience = max(self.patience, _PATIENT_SAMPLES * interval)
        latest = time.monotonic()
        while got < count:
            client.set()
            ready = int(min(*client.numbers("DRL?", *keys), count))
            number, quiet = min(ready - got, most), time.monotonic() - latest
            if number > 0:
                query = command("DRR?", got + 1, number, *keys)
                period, columns = client.query(query, partial(gcs_syntax.table, rows=number, columns=len(keys)))
                if abs(period / interval - 1) > 1e-3:
                    raise DeviceError(
                        f"{client.name}: records every {period:g} s, need {interval:g} s; check its servo update time"
                    )
                yield got, columns[::2].T, columns[1::2].T
                got, latest = got + number, time.monotonic()
            elif quiet > patience and not any(client.numbers("WGO?", *(rig._generator for rig in self._pi_rigs))):
                raise DeviceError(f"{client.name}: its wave generator stopped; {got} of {count} samples were recorded")
            elif quiet > patience:
                raise LinkError(
                    f"{client.name}: no new sample for {quiet:.3g} s, {got} of {count} came; check the data recorder "
                    "and its trigger"
                )
            if got >= ready and got < count:
                self._pi_rigs[0]._wait(poll)


def _device_limits(client: GcsClient, channel: str, given: tuple[float, float] | None) -> VoltageLimits:
    """Return the limits that a controller reports of a channel, or else those `given`."""
    absent = [word for word in ("VMI?", "VMA?") if word not in client.commands]
    if absent:
        if given is None:
            lacks = f"{client.name}: lacks the commands {', '.join(absent)}"
            raise DeviceError(f"{lacks}; give the allowed voltages (limits)")
        return VoltageLimits(*given)
    low, high = (client.numbers(word, channel)[0] for word in ("VMI?", "VMA?"))
    if not low < high:
        raise LinkError(f"{client.name}: reports limits of {low:g} to {high:g} V, need a range; check its settings")
    return VoltageLimits(low, high)


def _wave_traits(client: GcsClient) -> tuple[WaveTraits | None, str]:
    """Return the properties of wave generator and recorder, or what is missing, as a part of a sentence."""
    absent = [word for word in _FOR_WAVES if word not in client.commands]
    if absent:
        return None, f"lacks the commands {', '.join(absent)}"
    options = client.query("HDR?", gcs_syntax.options)
    if options is None:
        return None, "cannot record both position and voltage (HDR?)"
    tables = client.query("TNR?", lambda lines: gcs_syntax.integer(gcs_syntax.single(lines)))
    if tables < 2:
        return None, f"has {tables} recorder tables (TNR?), need 2"
    values = {number: _parameter(client, number) for number in (_SERVO_PERIOD, _WAVE_POINTS, _RECORD_POINTS)}
    absent = [f"{number:#010x}" for number, value in values.items() if not value]
    if absent:
        return None, f"does not report the parameters {', '.join(absent)} (SPA?)"
    period, points, recorded = (value or 0.0 for value in values.values())
    longest = int(min(points, recorded // tables))
    if not (0 < period <= 1 and longest >= 2):
        return None, f"has a servo update time of {period:g} s and tables of {longest} points (SPA?)"
    return WaveTraits(period, longest, options, tables), ""


def _parameter(client: GcsClient, number: int) -> float | None:
    """Return a parameter's value; None if the controller does not answer with one."""
    try:
        query = command("SPA?", 1, f"0x{number:08X}")
        return client.query(query, partial(gcs_syntax.parameter, item="1", number=number))
    except LinkError:
        # A controller does not answer a query of an unknown parameter.
        client.clear()
        return None
