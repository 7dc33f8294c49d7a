"""A rig on several axes of a PI piezo controller with GCS 2.0, over one connection."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Self

import numpy as np

from dehyst._errors import DeviceError
from dehyst._types import Array
from dehyst.instruments.gcs_client import GcsClient
from dehyst.instruments.gcs_link import AbstractGcsLink, TcpLink
from dehyst.instruments.pi import PATIENCE, PORT, PiRig
from dehyst.instruments.pi_discovery import WaveTraits
from dehyst.instruments.pi_waves import PiClock, PiWaves
from dehyst.instruments.stage import (
    AbstractStageRig,
    AxisLimits,
    AxisSlewRates,
    StageSamples,
    limits_of_axes,
    slew_rates_of_axes,
)


class PiStageRig(AbstractStageRig):
    """Axes of a PI controller in open loop, each with a wave generator, and one data recorder.

    Each axis is a `PiRig`. Raise `DeviceError` if the controller cannot play and record by itself, or has too few
    recorder tables. Raise `RigError` as `PiRig`.

    Parameters
    ----------
    link : AbstractGcsLink
        Usually from `connect`.
    axes : sequence of str
        Names of the axes.
    limits : (float, float) or sequence of (float, float), optional
        Allowed voltages [V], of all axes or of each; the controller's own where they are narrower.
    slew_rate : float or sequence of float, optional
        Largest abs(dv/dt) [V/s], of all axes or of each.
    patience : float
        Seconds without a new sample after which a recorder has stopped.
    """

    def __init__(
        self,
        link: AbstractGcsLink,
        axes: Sequence[str],
        *,
        limits: AxisLimits = None,
        slew_rate: AxisSlewRates = None,
        patience: float = PATIENCE,
    ) -> None:
        client = GcsClient(link)
        rigs = [
            PiRig(client, axis=axis, limits=allowed, slew_rate=steepest, patience=patience)
            for axis, allowed, steepest in zip(
                axes, limits_of_axes(limits, len(axes)), slew_rates_of_axes(slew_rate, len(axes)), strict=True
            )
        ]
        super().__init__(
            client.name, rigs, longest=min((rig.longest or 0 for rig in rigs), default=0), identity=client.identity
        )
        self._pi_rigs = rigs
        traits = [rig.waves for rig in rigs]
        if not all(one is not None and one.tables >= 2 * len(rigs) for one in traits) or traits[0] is None:
            raise DeviceError(
                f"{self.name}: cannot play and record {len(rigs)} axes together; it needs a wave generator an axis and "
                f"{2 * len(rigs)} recorder tables; calibrate one axis at a time"
            )
        self._traits: WaveTraits = traits[0]
        clock = PiClock(client)
        for rig in rigs:
            rig.share(clock)
        ports = [rig.wave_axis for rig in rigs]
        self._player = PiWaves(client, self._traits, ports, clock=clock, patience=patience, wait=rigs[0]._wait)

    @classmethod
    def connect(
        cls,
        host: str,
        port: int = PORT,
        *,
        axes: Sequence[str],
        limits: AxisLimits = None,
        slew_rate: AxisSlewRates = None,
        timeout: float = 5.0,
        patience: float = PATIENCE,
    ) -> Self:
        """Connect to a controller by TCP; `timeout` [s] is the longest wait for an answer.

        Raise `RigError` as the class does.
        """
        link = TcpLink(host, port, timeout)
        try:
            return cls(link, axes, limits=limits, slew_rate=slew_rate, patience=patience)
        except BaseException:
            link.close()
            raise

    def _wave(self, voltage: Array, rate: float) -> Iterator[StageSamples]:
        for rig in self._pi_rigs:
            rig.make_ready()
        for samples in self._player.play(np.ascontiguousarray(voltage), rate):
            yield StageSamples(*samples)
        # Otherwise the controller takes no voltages.
        for rig in self._pi_rigs:
            rig._halt()
