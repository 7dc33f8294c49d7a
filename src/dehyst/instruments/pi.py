"""A rig on a PI piezo controller that speaks GCS 2.0: over TCP, or through a device object connected already."""

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
from dehyst.instruments.pi_discovery import WaveTraits, inquire

PORT = 50000
# Controllers tell positions in micrometres, timers in milliseconds.
_METRES, _SECONDS = 1e-6, 1e-3
# Wave table, and recorder tables of position and voltage.
_WAVE, _POSITION, _VOLTAGE = 1, "1", "2"
# Seconds between two looks at the recorder: less for a short wave, so that a dead sensor is seen in time.
_SHORTEST_POLL, _POLL, _LOOKS = 0.02, 0.1, 20
# Rows asked for at once.
_ROWS = 2000
# A recorder without a new sample for so long [s], and so many samples, has stopped.
_PATIENCE = 5.0
_PATIENT_SAMPLES = 20
_STEPS_TO_STOP = 20


class PiRig(AbstractRig):
    """A PI controller's axis in open loop.

    The wave generator plays and the data recorder records; the host only fills and reads tables. Where a controller
    has neither, voltages are sent one by one, at 200 Hz at most, and a warning says so.

    Parameters
    ----------
    link : AbstractGcsLink
        Usually from `connect` or `of_device`.
    axis : str, optional
        Needed where there are several.
    limits : (float, float), optional
        Voltages to allow [V]; the controller's own where they are narrower.
    slew_rate : float, optional
        Largest abs(dv/dt) [V/s].
    patience : float
        Seconds without a new sample after which a recorder has stopped.

    Raises
    ------
    LinkError
        If it does not answer as a controller does.
    DeviceError
        If it cannot send voltages in open loop, or does not tell its limits and none are given.
    RigError
        If it has no such axis, or nothing is left of the limits.

    Notes
    -----
    Positions are taken to be in micrometres. A servo that is on is switched off. No command is ever sent twice.
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
        traits = inquire(self._client, axis, limits)
        self._waves, self._channel, self._generator = traits.waves, traits.channel, traits.generator
        self._patience = patience
        self._born, self._late, self._latest, self._told = time.monotonic(), 0.0, -np.inf, -np.inf
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
                f"{self.name}: {traits.missing}; voltages are sent by the host instead, slowly ({HIGHEST_RATE:g} Hz) "
                "and with a host's jitter",
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
        """Connect to a controller by TCP; `timeout` [s] is how long it may leave a question open.

        Raises
        ------
        RigError
            As the class does.
        """
        return cls._on(TcpLink(host, port, timeout), axis, limits, slew_rate, patience)

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
        return cls._on(DeviceLink(device), axis, limits, slew_rate, patience)

    @classmethod
    def _on(
        cls,
        link: AbstractGcsLink,
        axis: str | None,
        limits: tuple[float, float] | None,
        slew_rate: float | None,
        patience: float,
    ) -> Self:
        try:
            return cls(link, axis=axis, limits=limits, slew_rate=slew_rate, patience=patience)
        except BaseException:
            link.close()
            raise

    def nearest_rate(self, sample_rate: float) -> float:
        """The rate [Hz] nearest to `sample_rate` of those that divide the servo's."""
        if self._waves is None:
            return min(sample_rate, HIGHEST_RATE)
        return 1 / (self._divider(self._waves, sample_rate) * self._waves.servo_period)

    def _read(self) -> Reading:
        now = self._now()
        (position,) = self._values("POS?", self.axis)
        # A stream that is one answer behind cannot pass for the voltage: this answer has no key.
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
        start = max(self._now(), self._latest + interval)
        self._client.set(gcs_syntax.command("WGO", self._generator, 1))
        for first, position, volts in self._recorded(voltage.size, interval):
            times: Array = start + interval * np.arange(first, first + volts.size, dtype=np.float64)
            self._latest = float(times[-1])
            yield Samples(times, volts, position * _METRES)
        # Or voltages are not taken.
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
        raise DeviceError(f"{self.name}: its wave generator was told to stop and goes on; switch it off by hand")

    def _close(self) -> None:
        with suppress(Exception):
            self._client.close()

    def _open_loop(self) -> None:
        """Switch the servo off before the first voltage, if there is one; who only looks leaves it on."""
        if self._opened or not {"SVO", "SVO?"} <= self._client.commands:
            return
        if self._count("SVO?", self.axis):
            warnings.warn(f"{self.name}: its servo was on and is switched off: open loop is needed", stacklevel=2)
            self._client.set(gcs_syntax.command("SVO", self.axis, 0))
        if self._count("SVO?", self.axis):
            raise DeviceError(f"{self.name}: its servo does not go off; switch it off by hand")
        self._opened = True

    def _prepare(self, voltage: Array, divider: int, waves: WaveTraits) -> None:
        """Fill the wave table and make everything ready to play it once and record it."""
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
            # Somebody's offset would be added to every voltage.
            self._client.set(gcs_syntax.command("WOS", generator, 0))
        self._client.set(gcs_syntax.command("RTR", divider))
        self._client.set(gcs_syntax.command("DRC", _POSITION, self.axis, waves.options.position))
        self._client.set(gcs_syntax.command("DRC", _VOLTAGE, self._channel, waves.options.voltage))
        if "DRT" in self._client.commands:
            # The default: a wave's start begins the record.
            self._client.set(gcs_syntax.command("DRT", 0, 0, 0))
        if "WAV?" in self._client.commands:
            self._refuse_length(voltage.size)

    def _refuse_length(self, needed: int) -> None:
        query = gcs_syntax.command("WAV?", _WAVE, 1)
        held = self._client.ask(query, lambda lines: gcs_syntax.parameter(lines, str(_WAVE), 1))
        if held != needed:
            raise DeviceError(f"{self.name}: its wave table holds {held:g} points, need {needed}; nothing was played")

    def _recorded(self, count: int, interval: float) -> Iterator[tuple[int, Array, Array]]:
        """Rows as they are recorded: the first one's number, positions [um] and voltages [V]."""
        have = 0
        poll = min(_POLL, max(_SHORTEST_POLL, count * interval / _LOOKS))
        patience = max(self._patience, _PATIENT_SAMPLES * interval)
        heard = time.monotonic()
        while have < count:
            self._client.set()
            ready = min(*self._counts("DRL?", _POSITION, _VOLTAGE), count)
            if ready > have:
                number = min(ready - have, _ROWS)
                yield have, *self._rows(have, number, interval)
                have, heard = have + number, time.monotonic()
            else:
                self._refuse_stopped(have, count, time.monotonic() - heard, patience)
            if have < ready or have == count:
                # More is there, or all.
                continue
            self._wait(poll)

    def _refuse_stopped(self, have: int, count: int, quiet: float, patience: float) -> None:
        if quiet <= patience:
            return
        if not self._playing():
            raise DeviceError(f"{self.name}: its wave generator stopped; {have} of {count} samples were recorded")
        raise LinkError(
            f"{self.name}: no new sample for {quiet:.3g} s, {have} of {count} came; check the data recorder and its "
            "trigger"
        )

    def _rows(self, first: int, number: int, interval: float) -> tuple[Array, Array]:
        query = gcs_syntax.command("DRR?", first + 1, number, _POSITION, _VOLTAGE)
        found = self._client.ask(query, lambda lines: table(lines, number, 2))
        if abs(found.sample_time / interval - 1) > 1e-3:
            raise DeviceError(
                f"{self.name}: records every {found.sample_time:g} s, need {interval:g} s; check its servo update time"
            )
        return position_and_voltage(found)

    def _now(self) -> float:
        """The controller's clock [s] if it has one, else the host's; it does not go back behind what was recorded."""
        timed = "TIM?" in self._client.commands
        now = self._client.ask("TIM?", gcs_syntax.timer) * _SECONDS if timed else time.monotonic() - self._born
        self._late = max(self._late, self._latest - now)
        # No two readings at one time.
        self._told = max(now + self._late, float(np.nextafter(self._told, np.inf)))
        return self._told

    def _playing(self) -> bool:
        return bool(self._count("WGO?", self._generator))

    def _divider(self, waves: WaveTraits, rate: float) -> int:
        """So many servo periods a sample."""
        exact = 1 / (rate * waves.servo_period)
        below = max(1, int(exact))
        return min((below, below + 1), key=lambda divider: abs(1 / (divider * waves.servo_period) - rate))

    def _count(self, word: str, key: str) -> int:
        return self._counts(word, key)[0]

    def _counts(self, word: str, *keys: str) -> list[int]:
        return self._client.ask(gcs_syntax.command(word, *keys), lambda lines: gcs_syntax.counts(lines, keys))

    def _values(self, word: str, *keys: str) -> list[float]:
        return self._client.ask(gcs_syntax.command(word, *keys), lambda lines: gcs_syntax.values(lines, keys))
