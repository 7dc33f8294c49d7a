"""A PI controller's axes and waves: what it has, all queried, and how its generators play and its recorder records."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from dehyst._errors import DeviceError, LinkError, RigError
from dehyst._types import Array
from dehyst.control import VoltageLimits
from dehyst.instruments import gcs_syntax
from dehyst.instruments.gcs_client import GcsClient
from dehyst.instruments.samples import Samples

# Controllers report positions in micrometres, timers in milliseconds.
METRES, _SECONDS = 1e-6, 1e-3
# Seconds between two polls of the recorder: less for a short wave, so that a dead sensor is detected in time.
SHORTEST_POLL, _POLL, _POLLS = 0.02, 0.1, 20
# Most numbers of one answer.
_NUMBERS = 4000
# A recorder without a new sample for this many sample periods has stopped.
_PATIENT_SAMPLES = 20
# Time [s] between two readings within one tick of a clock.
_TICK = 1e-9
# Parameters of the public list.
_SERVO_PERIOD, _WAVE_POINTS, _RECORD_POINTS = 0x0E000200, 0x13000004, 0x16000200
_FOR_WAVES = ("WAV", "WSL", "WGC", "WTR", "WGO", "WGO?", "DRC", "DRL?", "DRR?", "RTR", "SPA?", "TNR?", "HDR?")
_FOR_VOLTAGES = ("SVA", "VOL?", "POS?", "ERR?")


@dataclass(frozen=True)
class WaveTraits:
    """Properties of a controller that plays and records waves.

    `servo_period` [s]; waves are played and recorded in multiples of it. `longest`: samples that both a wave table and
    its recorder tables hold. `options`: record options of position and voltage. `tables`: number of recorder tables.
    """

    servo_period: float
    longest: int
    options: gcs_syntax.Options
    tables: int

    def divider(self, rate: float) -> int:
        """Return the number of servo periods a sample, for the rate nearest to `rate` [Hz]."""
        exact = 1 / (rate * self.servo_period)
        below = max(1, int(exact))
        return min((below, below + 1), key=lambda divider: abs(1 / (divider * self.servo_period) - rate))


@dataclass(frozen=True)
class Traits:
    """Properties of a controller.

    Attributes
    ----------
    axis : str
        Name of the axis.
    channel : str
        Name of its piezo channel.
    generator : str
        Number of its wave generator.
    limits : VoltageLimits
        Voltages [V] that the controller allows; a slew rate [V/s] if it reports one of open loop.
    waves : WaveTraits or None
        None if it cannot play and record by itself.
    missing : str
        What it lacks for that, as a sentence.
    """

    axis: str
    channel: str
    generator: str
    limits: VoltageLimits
    waves: WaveTraits | None
    missing: str = ""


def discover(client: GcsClient, axis: str | None, limits: tuple[float, float] | None) -> Traits:
    """Query the properties of a controller.

    Raise `DeviceError` if it cannot send a voltage and read a displacement, or does not report its limits. Raise
    `RigError` if it has no such axis. Raise `LinkError` if an answer is not valid.

    `axis`: needed if the controller has several. `limits`: voltages [V] to use if the controller does not report its
    own.
    """
    absent = [word for word in _FOR_VOLTAGES if word not in client.commands]
    if absent:
        raise DeviceError(
            f"{client.name}: lacks the commands {', '.join(absent)}, need open-loop voltages and a position; use "
            "another controller"
        )
    client.clear()
    name, number = _axis(client, axis)
    channel = _channel(client, name, number)
    _refuse_offline(client, channel)
    traits = Traits(name, channel, number, _limits(client, channel, limits), None)
    absent = [word for word in _FOR_WAVES if word not in client.commands]
    if absent:
        return replace(traits, missing=f"lacks the commands {', '.join(absent)}")
    waves, missing = _waves(client)
    return replace(traits, waves=waves, missing=missing)


def _axis(client: GcsClient, wanted: str | None) -> tuple[str, str]:
    """Return the name of the axis, and its number from 1."""
    axes = client.query("SAI?", gcs_syntax.names) if "SAI?" in client.commands else ["1"]
    if wanted is None and len(axes) > 1:
        raise RigError(f"{client.name}: has the axes {', '.join(axes)}; choose one, as in pi://host:port/{axes[0]}")
    name = axes[0] if wanted is None else wanted
    if name not in axes:
        raise RigError(f"{client.name}: got the axis {name!r}, it has {', '.join(axes)}; give one of them")
    return name, str(axes.index(name) + 1)


def _channel(client: GcsClient, axis: str, number: str) -> str:
    """Return the axis' piezo channel: by the name of the axis, else by its number."""
    channels = client.query("VOL?", gcs_syntax.pairs)
    channel = axis if axis in channels else number
    if channel not in channels:
        raise DeviceError(f"{client.name}: has the channels {', '.join(channels)}, need one for the axis {axis}")
    return channel


def _refuse_offline(client: GcsClient, channel: str) -> None:
    if "ONL?" in client.commands:
        (online,) = client.query(gcs_syntax.command("ONL?", channel), lambda lines: gcs_syntax.counts(lines, [channel]))
        if not online:
            raise DeviceError(f"{client.name}: channel {channel} is offline; switch it on there (ONL {channel} 1)")


def _limits(client: GcsClient, channel: str, given: tuple[float, float] | None) -> VoltageLimits:
    slew_rate = _slew_rate(client)
    absent = [word for word in ("VMI?", "VMA?") if word not in client.commands]
    if absent and given is None:
        raise DeviceError(f"{client.name}: lacks the commands {', '.join(absent)}; give the allowed voltages (limits)")
    if absent and given is not None:
        return VoltageLimits(*given, slew_rate)
    low, high = (
        client.query(gcs_syntax.command(word, channel), lambda lines: gcs_syntax.values(lines, [channel]))[0]
        for word in ("VMI?", "VMA?")
    )
    if not low < high:
        raise LinkError(f"{client.name}: reports limits of {low:g} to {high:g} V, need a range; check its settings")
    return VoltageLimits(low, high, slew_rate)


def _slew_rate(client: GcsClient) -> float | None:
    """Return the largest abs(dv/dt) [V/s] in open loop, if the controller has a parameter with such a description."""
    if not {"HPA?", "SPA?"} <= client.commands:
        return None
    listed = client.query("HPA?", gcs_syntax.parameters)
    numbers = [number for number, text in listed.items() if "slew" in text.lower() and "open" in text.lower()]
    rate = _parameter(client, numbers[0]) if numbers else None
    return rate if rate is not None and rate > 0 else None


def _waves(client: GcsClient) -> tuple[WaveTraits | None, str]:
    """Return the properties of wave generator and recorder, or what is missing."""
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
        return client.query(
            gcs_syntax.command("SPA?", 1, f"0x{number:08X}"), lambda lines: gcs_syntax.parameter(lines, "1", number)
        )
    except LinkError:
        # A controller does not answer a query of an unknown parameter.
        client.clear()
        return None


class WaveAxis(NamedTuple):
    """An axis that plays: names of `axis` and `channel`, number of its `generator`, lowest and highest voltage [V]."""

    axis: str
    channel: str
    generator: str
    low: float
    high: float


class PiClock:
    """The time of a controller [s] by its own clock, else by the host's; it never falls behind the last sample."""

    def __init__(self, client: GcsClient) -> None:
        self._client, self._began, self._shift, self._last = client, time.monotonic(), 0.0, -np.inf
        self.last_sample = -np.inf

    def now(self) -> float:
        """Return the time [s]; no two readings have the same time."""
        timed = "TIM?" in self._client.commands
        now = self._client.query("TIM?", gcs_syntax.timer) * _SECONDS if timed else time.monotonic() - self._began
        self._shift = max(self._shift, self.last_sample - now)
        # A clock's ticks may be longer than the time between two readings.
        self._last = max(now + self._shift, self._last + _TICK)
        return self._last


class PiWaves:
    """Waves on axes of one controller, which begin together.

    Parameters
    ----------
    client : GcsClient
    traits : WaveTraits
    axes : sequence of WaveAxis
    clock : PiClock
    patience : float
        Seconds without a new sample after which a recorder has stopped.
    wait : callable
        Waits a number of seconds.
    """

    def __init__(
        self,
        client: GcsClient,
        traits: WaveTraits,
        axes: Sequence[WaveAxis],
        *,
        clock: PiClock,
        patience: float,
        wait: Callable[[float], None],
    ) -> None:
        self._client, self._traits, self._axes = client, traits, axes
        self._clock, self._patience, self._wait = clock, patience, wait
        self._positions = [str(2 * j + 1) for j in range(len(axes))]
        self._voltages = [str(2 * j + 2) for j in range(len(axes))]
        self._generators = [axis.generator for axis in axes]

    def play(self, voltage: Array, rate: float) -> Iterator[Samples]:
        """Play voltages (n, axes) [V] at `rate` [Hz]; yield the samples of all axes.

        The servos are off, and no wave is played.
        """
        divider = self._traits.divider(rate)
        interval = divider * self._traits.servo_period
        self._prepare(voltage, divider)
        start = max(self._clock.now(), self._clock.last_sample + interval)
        started = (word for generator in self._generators for word in (generator, 1))
        self._client.set(gcs_syntax.command("WGO", *started))
        for first, position, volts in self._recorded(len(voltage), interval):
            times: Array = start + interval * np.arange(first, first + len(volts), dtype=np.float64)
            self._clock.last_sample = float(times[-1])
            yield Samples(times, volts, position * METRES)

    def playing(self) -> bool:
        """Return whether one of the wave generators is playing."""
        return any(self._counts("WGO?", self._generators))

    def _prepare(self, voltage: Array, divider: int) -> None:
        """Fill the wave tables, and set up generators and recorder to play and record them once."""
        client, command = self._client, gcs_syntax.command
        # Each generator plays a wave table of its own, numbered from 1 on.
        tables = range(1, len(self._axes) + 1)
        for number, axis, column in zip(tables, self._axes, voltage.T, strict=True):
            points = [gcs_syntax.volts(value, axis.low, axis.high) for value in column.tolist()]
            for line in gcs_syntax.wave_points(number, points):
                client.set(line)
        for number, generator in zip(tables, self._generators, strict=True):
            client.set(command("WSL", generator, number))
            client.set(command("WGC", generator, 1))
            client.set(command("WTR", generator, divider, 0))
            if "WOS" in client.commands:
                # An offset that is set would be added to every voltage.
                client.set(command("WOS", generator, 0))
        client.set(command("RTR", divider))
        options = self._traits.options
        for axis, position, volts in zip(self._axes, self._positions, self._voltages, strict=True):
            client.set(command("DRC", position, axis.axis, options.position))
            client.set(command("DRC", volts, axis.channel, options.voltage))
        if "DRT" in client.commands:
            # The default: the start of a wave starts the record.
            client.set(command("DRT", 0, 0, 0))
        if "WAV?" in client.commands:
            for number in tables:
                self._refuse_length(number, len(voltage))

    def _refuse_length(self, number: int, needed: int) -> None:
        query = gcs_syntax.command("WAV?", number, 1)
        length = self._client.query(query, lambda lines: gcs_syntax.parameter(lines, str(number), 1))
        if length != needed:
            raise DeviceError(
                f"{self._client.name}: its wave table holds {length:g} points, need {needed}; nothing was played"
            )

    def _recorded(self, count: int, interval: float) -> Iterator[tuple[int, Array, Array]]:
        """Yield rows as they are recorded: the first one's number, positions [um] and voltages [V] (m, axes)."""
        got, most = 0, max(1, _NUMBERS // (2 * len(self._axes)))
        poll = min(_POLL, max(SHORTEST_POLL, count * interval / _POLLS))
        patience = max(self._patience, _PATIENT_SAMPLES * interval)
        latest = time.monotonic()
        while got < count:
            self._client.set()
            ready = min(*self._counts("DRL?", [*self._keys]), count)
            if ready > got:
                number = min(ready - got, most)
                yield got, *self._rows(got, number, interval)
                got, latest = got + number, time.monotonic()
            else:
                self._refuse_stopped(got, count, time.monotonic() - latest, patience)
            if got < ready or got == count:
                # More rows are ready, or all are read.
                continue
            self._wait(poll)

    @property
    def _keys(self) -> list[str]:
        """Numbers of the recorder's tables: position and voltage of each axis."""
        return [key for pair in zip(self._positions, self._voltages, strict=True) for key in pair]

    def _refuse_stopped(self, got: int, count: int, quiet: float, patience: float) -> None:
        if quiet <= patience:
            return
        if not self.playing():
            raise DeviceError(
                f"{self._client.name}: its wave generator stopped; {got} of {count} samples were recorded"
            )
        raise LinkError(
            f"{self._client.name}: no new sample for {quiet:.3g} s, {got} of {count} came; check the data recorder "
            "and its trigger"
        )

    def _rows(self, first: int, number: int, interval: float) -> tuple[Array, Array]:
        query = gcs_syntax.command("DRR?", first + 1, number, *self._keys)
        array = self._client.query(query, lambda lines: gcs_syntax.table(lines, number, 2 * len(self._axes)))
        if abs(array.sample_time / interval - 1) > 1e-3:
            raise DeviceError(
                f"{self._client.name}: records every {array.sample_time:g} s, need {interval:g} s; check its servo "
                "update time"
            )
        return gcs_syntax.positions_and_voltages(array)

    def _counts(self, word: str, keys: Sequence[str]) -> list[int]:
        return self._client.query(gcs_syntax.command(word, *keys), lambda lines: gcs_syntax.counts(lines, keys))
