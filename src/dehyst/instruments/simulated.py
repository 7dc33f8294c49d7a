"""A rig without an instrument: a virtual bench with its own clock, as fast as it computes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from dehyst._errors import DeviceError
from dehyst._types import Array
from dehyst.control import VoltageLimits
from dehyst.instruments.base import AbstractRig
from dehyst.instruments.waves import Reading, Samples
from dehyst.virtual import VirtualActuator, VirtualBench

# Batches of samples in one wave, so that progress can be shown.
_BATCHES = 100


class SimulatedRig(AbstractRig):
    """A virtual actuator behind a virtual amplifier, generator, recorder and sensor.

    The actuator is a `truth`, at rest at 0 V; its fingerprint identifies the rig. `limits` [V] and `slew_rate` [V/s]
    are those that the user allows, `device_limits` [V] the range of the amplifier, by default 0 V to the actuator's
    highest voltage. Other `options` are those of `VirtualBench`, which is the `instrument`.
    """

    def __init__(
        self,
        truth: VirtualActuator,
        *,
        limits: tuple[float, float] | None = None,
        slew_rate: float | None = None,
        device_limits: tuple[float, float] | None = None,
        **options: Any,
    ) -> None:
        self._time = 0.0
        self.instrument = VirtualBench(truth, limits=device_limits, clock=lambda: self._time, **options)
        longest = min(self.instrument.wave_points, self.instrument.record_points)
        super().__init__(
            f"simulated {type(truth).__name__}",
            VoltageLimits(*self.instrument.axis.limits),
            limits=limits,
            slew_rate=slew_rate,
            longest=longest,
            identity=f"simulated {self.instrument.serial}",
        )

    def nearest_rate(self, sample_rate: float) -> float:
        """Return the rate [Hz] nearest to `sample_rate` with a whole number of servo periods between samples."""
        period = self.instrument.servo_period
        return 1.0 / (max(1, round(1.0 / (sample_rate * period))) * period)

    def _read(self) -> Reading:
        bench = self.instrument
        return Reading(bench.now, bench.axis.voltage, bench.axis.displacement())

    def _put(self, voltage: float) -> None:
        axis = self.instrument.axis
        if not axis.set_voltage(voltage):
            raise DeviceError(f"{self.name}: refused {voltage:.6g} V; its limits are {axis.limits} V")

    def _wave(self, voltage: Array, rate: float) -> Iterator[Samples]:
        bench = self.instrument
        divider = round(1.0 / (rate * bench.servo_period))
        period = divider * bench.servo_period
        # The last sample of the wave before may have been taken at this instant.
        self._wait(period)
        bench.start(voltage, divider)
        batch = max(1, voltage.size // _BATCHES)
        count = 0
        while bench.playing or count < bench.recorded:
            yield Samples(*bench.samples(count))
            count = bench.recorded
            if bench.playing:
                self._wait(min(batch, voltage.size - count) * period)

    def _halt(self) -> None:
        self.instrument.stop()

    def _close(self) -> None:
        pass

    def _now(self) -> float:
        return self._time

    def _wait(self, seconds: float) -> None:
        self._time += seconds
