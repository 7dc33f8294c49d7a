"""A rig on axes of a PI piezo controller with GCS 2.0: over TCP, or through a connected device object."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any, Self

import numpy as np

from dehyst._errors import DeviceError
from dehyst._types import Array
from dehyst.instruments import gcs_syntax
from dehyst.instruments.base import HIGHEST_RATE, AbstractRig, AxisLimits, AxisSlewRates, bounds_of_axes, host_timed
from dehyst.instruments.gcs_client import AbstractGcsLink, DeviceLink, GcsClient, TcpLink
from dehyst.instruments.gcs_syntax import STOPPED
from dehyst.instruments.pi_waves import METRES, SHORTEST_POLL, PiClock, PiWaves, WaveAxis, WaveTraits, discover
from dehyst.instruments.samples import Reading, Samples

PORT = 50000
# A recorder without a new sample for this time [s] has stopped.
PATIENCE = 5.0
_STEPS_TO_STOP = 20


class PiRig(AbstractRig):
    """Axes of a PI controller in open loop.

    The wave generators play and the data recorder records; the host only fills and reads tables. Without them the host
    sends voltages of one axis one by one, at 200 Hz at most, with a warning. Raise `LinkError` if the answers are not
    those of a controller. Raise `DeviceError` if it cannot send voltages in open loop, does not report its limits and
    none are given, or cannot play and record several axes together. Raise `RigError` if it has no such axis, or its
    limits and the given ones have no voltage in common.

    Parameters
    ----------
    link : AbstractGcsLink or GcsClient
        Usually from `connect` or `of_device`; a client may be shared by the axes of a controller.
    axis : str or sequence of str, optional
        One name, or several axes that play together; needed if the controller has several.
    limits : (float, float) or sequence of (float, float), optional
        Allowed voltages [V], of all axes or of each; the controller's own where they are narrower.
    slew_rate : float or sequence of float, optional
        Largest abs(dv/dt) [V/s], of all axes or of each.
    patience : float
        Seconds without a new sample after which a recorder has stopped.

    Notes
    -----
    Positions are assumed to be in micrometres. A servo that is on is switched off. No command is sent twice.
    """

    waves: WaveTraits | None

    def __init__(
        self,
        link: AbstractGcsLink | GcsClient,
        *,
        axis: str | Sequence[str] | None = None,
        limits: AxisLimits = None,
        slew_rate: AxisSlewRates = None,
        patience: float = PATIENCE,
    ) -> None:
        self._client = link if isinstance(link, GcsClient) else GcsClient(link)
        self._patience, self._clock, self._opened = patience, PiClock(self._client), False
        names = [axis] if axis is None or isinstance(axis, str) else list[str | None](axis)
        allowed = bounds_of_axes(limits, slew_rate, len(names))
        if len(names) == 1:
            self._open_axis(names[0], *allowed[0])
            return
        self._pi_rigs = [
            PiRig(self._client, axis=name, limits=bounds, slew_rate=rate, patience=patience)
            for name, (bounds, rate) in zip(names, allowed, strict=True)
        ]
        longest = min(one.longest or 0 for one in self._pi_rigs)
        super().__init__(self._client.name, self._pi_rigs, longest=longest or None, identity=self._client.identity)
        traits = [one.waves for one in self._pi_rigs]
        if not all(one is not None and one.tables >= 2 * len(names) for one in traits):
            raise DeviceError(
                f"{self.name}: cannot play and record {len(names)} axes together; it needs a wave generator an axis "
                f"and {2 * len(names)} recorder tables; calibrate one axis at a time"
            )
        self.waves = traits[0]
        for one in self._pi_rigs:
            one._clock = self._clock

    def _open_axis(self, axis: str | None, limits: tuple[float, float] | None, slew_rate: float | None) -> None:
        """Query the properties of one axis, and set it up."""
        traits = discover(self._client, axis, limits)
        self._pi_rigs, self.waves = [], traits.waves
        self._channel, self._generator = traits.channel, traits.generator
        super().__init__(
            self._client.name,
            traits.limits,
            limits=limits,
            slew_rate=slew_rate,
            axis=traits.axis,
            longest=traits.waves.longest if traits.waves else None,
            identity=self._client.identity,
        )
        if traits.waves is None:
            warnings.warn(
                f"{self.name}: {traits.missing}; the host sends the voltages instead, slowly ({HIGHEST_RATE:g} Hz) and "
                "with jitter",
                stacklevel=3,
            )

    @classmethod
    def connect(
        cls,
        host: str,
        port: int = PORT,
        *,
        axis: str | Sequence[str] | None = None,
        limits: AxisLimits = None,
        slew_rate: AxisSlewRates = None,
        timeout: float = 5.0,
        patience: float = PATIENCE,
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
        axis: str | Sequence[str] | None = None,
        limits: AxisLimits = None,
        slew_rate: AxisSlewRates = None,
        patience: float = PATIENCE,
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
        if self.waves is None:
            return min(sample_rate, HIGHEST_RATE)
        return 1 / (self.waves.divider(sample_rate) * self.waves.servo_period)

    def _read(self) -> Reading:
        now = self._clock.now()
        (position,) = self._values("POS?", self.axis)
        # An answer without a key, so that a position that is one answer late cannot be taken for the voltage.
        self._client.set()
        (voltage,) = self._values("VOL?", self._channel)
        return Reading(now, voltage, position * METRES)

    def _put(self, voltage: float) -> None:
        self._open_loop()
        self._client.set(
            gcs_syntax.command("SVA", self.axis, gcs_syntax.volts(voltage, self.limits.low, self.limits.high))
        )

    def _wave(self, voltage: Array, rate: float) -> Iterator[Samples]:
        if self.waves is None:
            yield from host_timed(self, voltage, rate)
            return
        rigs = self._pi_rigs or [self]
        for one in rigs:
            one._open_loop()
            one._halt()
        axes = [WaveAxis(one.axis, one._channel, one._generator, one.limits.low, one.limits.high) for one in rigs]
        player = PiWaves(self._client, self.waves, axes, clock=self._clock, patience=self._patience, wait=rigs[0]._wait)
        for samples in player.play(np.ascontiguousarray(voltage.reshape(len(voltage), len(rigs))), rate):
            yield samples if self._pi_rigs else samples.axis(0)
        # Otherwise the controller takes no voltages.
        for one in rigs:
            one._halt()

    def _halt(self) -> None:
        if self.waves is None:
            return
        self._client.clear()
        self._client.set(gcs_syntax.command("WGO", self._generator, 0), expect=frozenset({STOPPED}))
        for _ in range(_STEPS_TO_STOP):
            if not self._count("WGO?", self._generator):
                return
            self._wait(SHORTEST_POLL)
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

    def _count(self, word: str, key: str) -> int:
        return self._client.query(gcs_syntax.command(word, key), lambda lines: gcs_syntax.counts(lines, [key]))[0]

    def _values(self, word: str, *keys: str) -> list[float]:
        return self._client.query(gcs_syntax.command(word, *keys), lambda lines: gcs_syntax.values(lines, keys))
