"""A rig on a PI piezo controller with GCS 2.0: over TCP, or through a connected device object."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, Self

import numpy as np

from dehyst._errors import DeviceError, LinkError
from dehyst._types import Array
from dehyst.instruments import gcs_syntax
from dehyst.instruments.base import AbstractRig, Reading, Samples
from dehyst.instruments.gcs_array import position_and_voltage, table
from dehyst.instruments.gcs_client import GcsClient
from dehyst.instruments.gcs_errors import STOPPED
from dehyst.instruments.gcs_link import AbstractGcsLink, DeviceLink, TcpLink
from dehyst.instruments.host_timed import HIGHEST_RATE, host_timed
from dehyst.instruments.pi_discovery import WaveTraits, discover

PORT = 50000
# Controllers report positions in micrometres, timers in milliseconds.
_METRES, _SECONDS = 1e-6, 1e-3
# Wave table, and recorder tables of position and voltage.
_WAVE, _POSITION, _VOLTAGE = 1, "1", "2"
# Seconds between two polls of the recorder: less for a short wave, so that a dead sensor is detected in time.
_SHORTEST_POLL, _POLL, _POLLS = 0.02, 0.1, 20
# Most rows of one answer.
_ROWS = 2000
# A recorder without a new sample for this time [s], and for this many sample periods, has stopped.
_PATIENCE = 5.0
_PATIENT_SAMPLES = 20
_STEPS_TO_STOP = 20
# Time [s] between two readings within one tick of a clock.
_TICK = 1e-9


class PiRig(AbstractRig):
    """A PI controller's axis in open loop.

    The wave generator plays and the data recorder records; the host only fills and reads tables. Without them the host
    sends voltages one by one, at 200 Hz at most, with a warning. Raise `LinkError` if the answers are not those of a
    controller. Raise `DeviceError` if it cannot send voltages in open loop, or does not report its limits and none are
    given. Raise `RigError` if it has no such axis, or its limits and the given ones have no voltage in common.

    Parameters
    ----------
    link : AbstractGcsLink
        Usually from `connect` or `of_device`.
    axis : str, optional
        Needed if the controller has several.
    limits : (float, float), optional
        Allowed voltages [V]; the controller's own where they are narrower.
    slew_rate : float, optional
        Largest abs(dv/dt) [V/s].
    patience : float
        Seconds without a new sample after which a recorder has stopped.

    Notes
    -----
    Positions are assumed to be in micrometres. A servo that is on is switched off. No command is sent twice.
    """

    def __init__(
        self,
        link: AbstractGcsLink,
        *,
        axis: str | None = None,
        limits: tuple[float, float] | None = None,
        slew_rate: float | None = None,
        patience: float = _PATIENCE,
    ) -> None:
        self._client = GcsClient(link)
        traits = discover(self._client, axis, limits)
        self._waves, self._channel, self._generator = traits.waves, traits.channel, traits.generator
        self._patience = patience
        self._began, self._shift, self._last_sample, self._last_time = time.monotonic(), 0.0, -np.inf, -np.inf
        super().__init__(
            self._client.name,
            traits.limits,
            limits=limits,
            slew_rate=slew_rate,
            axis=traits.axis,
            longest=traits.waves.longest if traits.waves else None,
            identity=self._client.identity,
        )
        self._opened = False
        if traits.waves is None:
            warnings.warn(
                f"{self.name}: {traits.missing}; the host sends the voltages instead, slowly ({HIGHEST_RATE:g} Hz) and "
                "with jitter",
                stacklevel=2,
            )

    @classmethod
    def connect(
        cls,
        host: str,
        port: int = PORT,
        *,
        axis: str | None = None,
        limits: tuple[float, float] | None = None,
        slew_rate: float | None = None,
        timeout: float = 5.0,
        patience: float = _PATIENCE,
    ) -> Self:
        """Connect to a controller by TCP; `timeout` [s] is the longest wait for an answer.

        Raise `RigError` as the class does.
        """
        link = TcpLink(host, port, timeout)
        return cls._open(link, axis=axis, limits=limits, slew_rate=slew_rate, patience=patience)

    @classmethod
    def of_device(
        cls,
        device: Any,
        *,
        axis: str | None = None,
        limits: tuple[float, float] | None = None,
        slew_rate: float | None = None,
        patience: float = _PATIENCE,
    ) -> Self:
        """Make a rig of a connected object that has `ReadGCSCommand` and `GcsCommandset`; `close` leaves it open."""
        return cls._open(DeviceLink(device), axis=axis, limits=limits, slew_rate=slew_rate, patience=patience)

    @classmethod
    def _open(cls, link: AbstractGcsLink, **options: Any) -> Self:
        try:
            return cls(link, **options)
        except BaseException:
            link.close()
            raise

    def nearest_rate(self, sample_rate: float) -> float:
        """Return the rate [Hz] nearest to `sample_rate` of those that divide the servo's."""
        if self._waves is None:
            return min(sample_rate, HIGHEST_RATE)
        return 1 / (self._divider(self._waves, sample_rate) * self._waves.servo_period)

    def _read(self) -> Reading:
        now = self._now()
        (position,) = self._values("POS?", self.axis)
        # An answer without a key, so that a position that is one answer late cannot be taken for the voltage.
        self._client.set()
        (voltage,) = self._values("VOL?", self._channel)
        return Reading(now, voltage, position * _METRES)

    def _put(self, voltage: float) -> None:
        self._open_loop()
        self._client.set(
            gcs_syntax.command("SVA", self.axis, gcs_syntax.volts(voltage, self.limits.low, self.limits.high))
        )

    def _wave(self, voltage: Array, rate: float) -> Iterator[Samples]:
        if self._waves is None:
            yield from host_timed(self, voltage, rate)
            return
        divider = self._divider(self._waves, rate)
        interval = divider * self._waves.servo_period
        self._prepare(voltage, divider, self._waves)
        start = max(self._now(), self._last_sample + interval)
        self._client.set(gcs_syntax.command("WGO", self._generator, 1))
        for first, position, volts in self._recorded(voltage.size, interval):
            times: Array = start + interval * np.arange(first, first + volts.size, dtype=np.float64)
            self._last_sample = float(times[-1])
            yield Samples(times, volts, position * _METRES)
        # Otherwise the controller takes no voltages.
        self._halt()

    def _halt(self) -> None:
        if self._waves is None:
            return
        self._client.clear()
        self._client.set(gcs_syntax.command("WGO", self._generator, 0), expect=frozenset({STOPPED}))
        for _ in range(_STEPS_TO_STOP):
            if not self._playing():
                return
            self._wait(_SHORTEST_POLL)
        raise DeviceError(f"{self.name}: its wave generator was sent a stop and goes on; switch it off by hand")

    def _close(self) -> None:
        with suppress(Exception):
            self._client.close()

    def _open_loop(self) -> None:
        """Switch the servo off before the first voltage, if there is one; reading alone leaves it on."""
        if self._opened or not {"SVO", "SVO?"} <= self._client.commands:
            return
        if self._count("SVO?", self.axis):
            warnings.warn(f"{self.name}: its servo was on and is switched off: open loop is needed", stacklevel=2)
            self._client.set(gcs_syntax.command("SVO", self.axis, 0))
        if self._count("SVO?", self.axis):
            raise DeviceError(f"{self.name}: its servo does not go off; switch it off by hand")
        self._opened = True

    def _prepare(self, voltage: Array, divider: int, waves: WaveTraits) -> None:
        """Fill the wave table, and set up generator and recorder to play and record it once."""
        self._open_loop()
        self._halt()
        points = [gcs_syntax.volts(float(value), self.limits.low, self.limits.high) for value in voltage]
        for line in gcs_syntax.wave_points(_WAVE, points):
            self._client.set(line)
        generator = self._generator
        self._client.set(gcs_syntax.command("WSL", generator, _WAVE))
        self._client.set(gcs_syntax.command("WGC", generator, 1))
        self._client.set(gcs_syntax.command("WTR", generator, divider, 0))
        if "WOS" in self._client.commands:
            # An offset that is set would be added to every voltage.
            self._client.set(gcs_syntax.command("WOS", generator, 0))
        self._client.set(gcs_syntax.command("RTR", divider))
        self._client.set(gcs_syntax.command("DRC", _POSITION, self.axis, waves.options.position))
        self._client.set(gcs_syntax.command("DRC", _VOLTAGE, self._channel, waves.options.voltage))
        if "DRT" in self._client.commands:
            # The default: the start of a wave starts the record.
            self._client.set(gcs_syntax.command("DRT", 0, 0, 0))
        if "WAV?" in self._client.commands:
            self._refuse_length(voltage.size)

    def _refuse_length(self, needed: int) -> None:
        query = gcs_syntax.command("WAV?", _WAVE, 1)
        length = self._client.query(query, lambda lines: gcs_syntax.parameter(lines, str(_WAVE), 1))
        if length != needed:
            raise DeviceError(f"{self.name}: its wave table holds {length:g} points, need {needed}; nothing was played")

    def _recorded(self, count: int, interval: float) -> Iterator[tuple[int, Array, Array]]:
        """Yield rows as they are recorded: the first one's number, positions [um] and voltages [V]."""
        got = 0
        poll = min(_POLL, max(_SHORTEST_POLL, count * interval / _POLLS))
        patience = max(self._patience, _PATIENT_SAMPLES * interval)
        latest = time.monotonic()
        while got < count:
            self._client.set()
            ready = min(*self._counts("DRL?", _POSITION, _VOLTAGE), count)
            if ready > got:
                number = min(ready - got, _ROWS)
                yield got, *self._rows(got, number, interval)
                got, latest = got + number, time.monotonic()
            else:
                self._refuse_stopped(got, count, time.monotonic() - latest, patience)
            if got < ready or got == count:
                # More rows are ready, or all are read.
                continue
            self._wait(poll)

    def _refuse_stopped(self, got: int, count: int, quiet: float, patience: float) -> None:
        if quiet <= patience:
            return
        if not self._playing():
            raise DeviceError(f"{self.name}: its wave generator stopped; {got} of {count} samples were recorded")
        raise LinkError(
            f"{self.name}: no new sample for {quiet:.3g} s, {got} of {count} came; check the data recorder and its "
            "trigger"
        )

    def _rows(self, first: int, number: int, interval: float) -> tuple[Array, Array]:
        query = gcs_syntax.command("DRR?", first + 1, number, _POSITION, _VOLTAGE)
        array = self._client.query(query, lambda lines: table(lines, number, 2))
        if abs(array.sample_time / interval - 1) > 1e-3:
            raise DeviceError(
                f"{self.name}: records every {array.sample_time:g} s, need {interval:g} s; check its servo update time"
            )
        return position_and_voltage(array)

    def _now(self) -> float:
        """Return the time [s] of the controller's clock, else of the host's; it never falls behind the last sample."""
        timed = "TIM?" in self._client.commands
        now = self._client.query("TIM?", gcs_syntax.timer) * _SECONDS if timed else time.monotonic() - self._began
        self._shift = max(self._shift, self._last_sample - now)
        # No two readings have the same time, though a clock's ticks may be longer than the time between them.
        self._last_time = max(now + self._shift, self._last_time + _TICK)
        return self._last_time

    def _playing(self) -> bool:
        return bool(self._count("WGO?", self._generator))

    def _divider(self, waves: WaveTraits, rate: float) -> int:
        """Return the number of servo periods a sample."""
        exact = 1 / (rate * waves.servo_period)
        below = max(1, int(exact))
        return min((below, below + 1), key=lambda divider: abs(1 / (divider * waves.servo_period) - rate))

    def _count(self, word: str, key: str) -> int:
        return self._counts(word, key)[0]

    def _counts(self, word: str, *keys: str) -> list[int]:
        return self._client.query(gcs_syntax.command(word, *keys), lambda lines: gcs_syntax.counts(lines, keys))

    def _values(self, word: str, *keys: str) -> list[float]:
        return self._client.query(gcs_syntax.command(word, *keys), lambda lines: gcs_syntax.values(lines, keys))
