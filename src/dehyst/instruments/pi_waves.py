"""Waves on a PI controller: its wave generators play, its data recorder records, on one axis or several together."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from dehyst._errors import DeviceError, LinkError
from dehyst._types import Array
from dehyst.instruments import gcs_syntax
from dehyst.instruments.gcs_array import positions_and_voltages, table
from dehyst.instruments.gcs_client import GcsClient
from dehyst.instruments.pi_discovery import WaveTraits

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
        Waits so many seconds.
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

    def play(self, voltage: Array, rate: float) -> Iterator[tuple[Array, Array, Array]]:
        """Play voltages (n, axes) [V] at `rate` [Hz]; yield times (m,) [s], voltages and displacements (m, axes).

        The servos are off, and no wave is played.
        """
        divider = self._traits.divider(rate)
        interval = divider * self._traits.servo_period
        self._prepare(voltage, divider)
        start = max(self._clock.now(), self._clock.last_sample + interval)
        self._client.set(gcs_syntax.command("WGO", *self._pairs([1] * len(self._axes))))
        for first, position, volts in self._recorded(len(voltage), interval):
            times: Array = start + interval * np.arange(first, first + len(volts), dtype=np.float64)
            self._clock.last_sample = float(times[-1])
            yield times, volts, position * METRES

    def playing(self) -> bool:
        """Return whether one of the wave generators is playing."""
        return any(self._counts("WGO?", self._generators))

    def _pairs(self, values: Sequence[object]) -> list[object]:
        return [word for pair in zip(self._generators, values, strict=True) for word in pair]

    def _prepare(self, voltage: Array, divider: int) -> None:
        """Fill the wave tables, and set up generators and recorder to play and record them once."""
        client, command = self._client, gcs_syntax.command
        # Each generator plays the table of its own number, of which there are as many.
        tables = self._tables
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

    @property
    def _tables(self) -> list[int]:
        """Numbers of the wave tables: from 1 on."""
        return list(range(1, len(self._axes) + 1))

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
        array = self._client.query(query, lambda lines: table(lines, number, 2 * len(self._axes)))
        if abs(array.sample_time / interval - 1) > 1e-3:
            raise DeviceError(
                f"{self._client.name}: records every {array.sample_time:g} s, need {interval:g} s; check its servo "
                "update time"
            )
        return positions_and_voltages(array)

    def _counts(self, word: str, keys: Sequence[str]) -> list[int]:
        return self._client.query(gcs_syntax.command(word, *keys), lambda lines: gcs_syntax.counts(lines, keys))
