"""A rig on a PI piezo controller with GCS 2.0: over TCP, or through a connected device object."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, Self

from dehyst._errors import DeviceError
from dehyst._types import Array
from dehyst.instruments import gcs_syntax
from dehyst.instruments.base import AbstractRig, Reading, Samples
from dehyst.instruments.gcs_client import GcsClient
from dehyst.instruments.gcs_errors import STOPPED
from dehyst.instruments.gcs_link import AbstractGcsLink, DeviceLink, TcpLink
from dehyst.instruments.host_timed import HIGHEST_RATE, host_timed
from dehyst.instruments.pi_discovery import WaveTraits, discover
from dehyst.instruments.pi_waves import METRES, SHORTEST_POLL, PiClock, PiWaves, WaveAxis

PORT = 50000
# A recorder without a new sample for this time [s] has stopped.
PATIENCE = 5.0
_STEPS_TO_STOP = 20


class PiRig(AbstractRig):
    """A PI controller's axis in open loop.

    The wave generator plays and the data recorder records; the host only fills and reads tables. Without them the host
    sends voltages one by one, at 200 Hz at most, with a warning. Raise `LinkError` if the answers are not those of a
    controller. Raise `DeviceError` if it cannot send voltages in open loop, or does not report its limits and none are
    given. Raise `RigError` if it has no such axis, or its limits and the given ones have no voltage in common.

    Parameters
    ----------
    link : AbstractGcsLink or GcsClient
        Usually from `connect` or `of_device`; a client may be shared by the axes of a controller.
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
        link: AbstractGcsLink | GcsClient,
        *,
        axis: str | None = None,
        limits: tuple[float, float] | None = None,
        slew_rate: float | None = None,
        patience: float = PATIENCE,
    ) -> None:
        self._client = link if isinstance(link, GcsClient) else GcsClient(link)
        traits = discover(self._client, axis, limits)
        self._waves, self._channel, self._generator = traits.waves, traits.channel, traits.generator
        self._patience = patience
        self._clock = PiClock(self._client)
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
        axis: str | None = None,
        limits: tuple[float, float] | None = None,
        slew_rate: float | None = None,
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

    @property
    def waves(self) -> WaveTraits | None:
        """How the controller plays and records waves; None if it cannot."""
        return self._waves

    @property
    def wave_axis(self) -> WaveAxis:
        """The axis as its wave generator needs it."""
        return WaveAxis(self.axis, self._channel, self._generator, self.limits.low, self.limits.high)

    def share(self, clock: PiClock) -> None:
        """Read the time from the `clock` of several axes."""
        self._clock = clock

    def make_ready(self) -> None:
        """Switch the servo off and stop the wave generator, before a wave."""
        self._open_loop()
        self._halt()

    def nearest_rate(self, sample_rate: float) -> float:
        """Return the rate [Hz] nearest to `sample_rate` of those that divide the servo's."""
        if self._waves is None:
            return min(sample_rate, HIGHEST_RATE)
        return 1 / (self._waves.divider(sample_rate) * self._waves.servo_period)

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
        if self._waves is None:
            yield from host_timed(self, voltage, rate)
            return
        self.make_ready()
        player = PiWaves(
            self._client,
            self._waves,
            [self.wave_axis],
            clock=self._clock,
            patience=self._patience,
            wait=self._wait,
        )
        for times, volts, displacement in player.play(voltage[:, None], rate):
            yield Samples(times, volts[:, 0], displacement[:, 0])
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

    def _playing(self) -> bool:
        return bool(self._count("WGO?", self._generator))

    def _count(self, word: str, key: str) -> int:
        return self._counts(word, key)[0]

    def _counts(self, word: str, *keys: str) -> list[int]:
        return self._client.query(gcs_syntax.command(word, *keys), lambda lines: gcs_syntax.counts(lines, keys))

    def _values(self, word: str, *keys: str) -> list[float]:
        return self._client.query(gcs_syntax.command(word, *keys), lambda lines: gcs_syntax.values(lines, keys))
