"""A data acquisition card of National Instruments as a rig. Not tried on hardware: tested with a fake of `nidaqmx`."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any, Self
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from dehyst._errors import DeviceError, LinkError, MissingExtraError, RigError
from dehyst._types import Array
from dehyst.control import VoltageLimits
from dehyst.instruments.base import AbstractRig
from dehyst.instruments.samples import Reading, Samples

# Seconds between two polls, and without a new sample until the card counts as silent.
_POLL, _PATIENCE = 0.05, 5.0
# Samples of one task; older cards count no further.
_LONGEST = 2**24 - 2
_FORM = "ni://Dev1/ao0,ai0?gain=10&scale=5 (gain in V/V, scale in um/V; also monitor=ai1&monitor_gain=10)"
_NOT_TRIED = "not tried on hardware"
_NUMBERS = ("gain", "scale", "monitor_gain")


class NiRig(AbstractRig):
    """An analog output before an amplifier, and a sensor on an analog input, of one card.

    NOT TRIED ON HARDWARE: written from the documentation of NI-DAQmx, and tested with a fake of it. Check the output
    with an oscilloscope, without an actuator connected, before you trust it.

    The hardware's clock, which the inputs share, times a wave; the wave is not repeated. An input is read at the edge
    that changes the output, so the sample of a voltage is taken at the next edge, at the end of that voltage. Raise
    `RigError` if the card or channel does not exist, has no hardware-timed output, or the output cannot be read back.

    Parameters
    ----------
    output, sensor : str
        Channels, e.g. "Dev1/ao0" and "Dev1/ai0".
    gain : float
        Of the amplifier [V/V], above 0. The card's range times it is the device's limits.
    scale : float
        Of the sensor [um/V]; negative if its sign is inverted.
    monitor : str, optional
        The input wired to the amplifier's monitor output, which shows the voltage at the actuator. By default the
        card's readback of its own output, ``Dev1/_ao0_vs_aognd``, which not every card has.
    monitor_gain : float, optional
        Volts on the actuator for each volt of the monitor; default `gain`.
    limits, slew_rate, longest
        As of `AbstractRig`; `clock` returns seconds of the host.
    """

    def __init__(
        self,
        output: str,
        sensor: str,
        *,
        gain: float,
        scale: float,
        monitor: str | None = None,
        monitor_gain: float | None = None,
        limits: tuple[float, float] | None = None,
        slew_rate: float | None = None,
        longest: int = _LONGEST,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        try:
            for module in ("constants", "errors", "system"):
                importlib.import_module(f"nidaqmx.{module}")
            self._ni: Any = importlib.import_module("nidaqmx")
        except ImportError as error:
            raise MissingExtraError.of("nidaqmx", "ni", "A card of National Instruments") from error
        if not (0 < gain < np.inf and np.isfinite(scale) and scale != 0):
            raise RigError(
                argument="gain, scale",
                got=f"{gain} V/V and {scale} um/V",
                need="a gain above 0 and a scale that is not 0",
            )
        card, _, channel = output.strip("/").partition("/")
        self._card, self._output = card, f"{card}/{channel}"
        self._inputs = [sensor.strip("/"), (monitor or f"{card}/_{channel}_vs_aognd").strip("/")]
        self._gain, self._scale, self._monitor_gain = gain, 1e-6 * scale, monitor_gain or gain
        self._clock, self._last, self._tasks = clock, 0.0, ExitStack()
        self._began = clock()
        self._label = self._output
        with self._driver_errors():
            device = self._ni.system.Device(card)
            self._label = f"{device.product_type} {self._output} ({_NOT_TRIED})"
            if not device.ao_samp_clk_supported:
                raise RigError(f"{self._label}: has no hardware-timed output, which waves need; use another card")
            # A flat list: low, high, low, high, ... [V].
            pairs = list(zip(device.ao_voltage_rngs[::2], device.ao_voltage_rngs[1::2], strict=True))
            low, high = max(pairs, key=lambda pair: pair[1] - pair[0])
            self._rates = (
                max(device.ao_min_rate, device.ai_min_rate),
                min(device.ao_max_rate, device.ai_max_multi_chan_rate / len(self._inputs)),
            )
        super().__init__(
            self._label,
            VoltageLimits(gain * low, gain * high),
            limits=limits,
            slew_rate=slew_rate,
            longest=longest,
            axis=channel,
        )
        try:
            self._read()
        except DeviceError as error:
            raise RigError(
                f"{error}; both {self._inputs[0]} and {self._inputs[1]} must be readable, as the output voltage must "
                "be known; wire the amplifier's monitor to an input and give it as monitor"
            ) from error

    @classmethod
    def from_address(
        cls, address: str, *, limits: tuple[float, float] | None = None, slew_rate: float | None = None
    ) -> Self:
        """Open the card at an address such as ``ni://Dev1/ao0,ai0?gain=10&scale=5``; raises RigError."""
        parts = urlsplit(address)
        channels = parts.path.strip("/").split(",")
        query = dict(parse_qsl(parts.query))
        if not parts.netloc or len(channels) != 2 or not {"gain", "scale"} <= set(query) <= set(_NUMBERS) | {"monitor"}:
            raise RigError(f"{address}: need {_FORM}")
        try:
            options: dict[str, Any] = {name: float(query[name]) for name in _NUMBERS if name in query}
        except ValueError as error:
            raise RigError(f"{address}: {error}; need {_FORM}") from error
        if "monitor" in query:
            options["monitor"] = f"{parts.netloc}/{query['monitor']}"
        output, sensor = (f"{parts.netloc}/{channel.strip()}" for channel in channels)
        return cls(output, sensor, limits=limits, slew_rate=slew_rate, **options)

    def nearest_rate(self, sample_rate: float) -> float:
        """Return the rate [Hz] to which the card rounds `sample_rate`: a whole fraction of its time base."""
        with self._driver_errors(), self._ni.Task() as task:
            self._add_output(task)
            lowest, highest = self._rates
            task.timing.cfg_samp_clk_timing(
                min(max(sample_rate, lowest), highest), sample_mode=self._finite, samps_per_chan=2
            )
            return float(task.timing.samp_clk_rate)

    def _read(self) -> Reading:
        with self._driver_errors(), self._ni.Task() as task:
            self._add_inputs(task)
            sensor, monitor = task.read()
        return Reading(self._now(), self._monitor_gain * monitor, self._scale * sensor)

    def _put(self, voltage: float) -> None:
        with self._driver_errors(), self._ni.Task() as task:
            self._add_output(task)
            task.write(voltage / self._gain, auto_start=True)

    def _wave(self, voltage: Array, rate: float) -> Iterator[Samples]:
        # The last voltage stays for one more edge, at which its sample is taken.
        sent = np.append(voltage, voltage[-1]) / self._gain
        clock = {"sample_mode": self._finite, "samps_per_chan": sent.size}
        try:
            with self._driver_errors():
                generation, inputs = (self._tasks.enter_context(self._ni.Task()) for _ in range(2))
                self._add_output(generation)
                generation.timing.cfg_samp_clk_timing(rate, **clock)
                generation.out_stream.regen_mode = self._ni.constants.RegenerationMode.DONT_ALLOW_REGENERATION
                self._add_inputs(inputs)
                inputs.timing.cfg_samp_clk_timing(rate, source=f"/{self._card}/ao/SampleClock", **clock)
                generation.write(sent, auto_start=False)
                # The inputs wait for the output's clock.
                inputs.start()
                begin = max(self._now(), self._last)
                generation.start()
            yield from self._collect(inputs, sent.size, begin, rate)
            with self._driver_errors():
                generation.wait_until_done(timeout=_PATIENCE)
        finally:
            self._close()

    def _halt(self) -> None:
        # The output of a task stays when the task ends.
        tasks, self._tasks = self._tasks, ExitStack()
        with self._driver_errors():
            tasks.close()

    def _close(self) -> None:
        with suppress(Exception):
            self._halt()

    def _collect(self, inputs: Any, count: int, begin: float, rate: float) -> Iterator[Samples]:
        """Yield samples as they arrive, without the first, which was taken before the wave."""
        got, latest = 0, self._clock()
        while got < count:
            with self._driver_errors():
                ready = min(inputs.in_stream.avail_samp_per_chan, count - got)
                batch = inputs.read(number_of_samples_per_channel=ready, timeout=_PATIENCE) if ready else [[], []]
            sensor, monitor = (np.asarray(column, dtype=np.float64) for column in batch)
            if sensor.size:
                edges, latest = np.arange(got, got + sensor.size), self._clock()
                got += sensor.size
                kept = slice(int(edges[0] == 0), None)
                times = begin + edges[kept] / rate
                self._last = float(times[-1]) if times.size else self._last
                yield Samples(times, self._monitor_gain * monitor[kept], self._scale * sensor[kept])
            elif self._clock() - latest > max(_PATIENCE, 5 / rate):
                raise LinkError(
                    f"{self.name}: no sample for {self._clock() - latest:.3g} s, after {max(0, got - 1)} of "
                    f"{count - 1}; does the output's clock reach the inputs?"
                )
            if got < count:
                self._wait(_POLL)

    def _add_output(self, task: Any) -> None:
        # NI's driver, too, refuses voltages outside the limits.
        task.ao_channels.add_ao_voltage_chan(
            self._output, min_val=self.limits.low / self._gain, max_val=self.limits.high / self._gain
        )

    def _add_inputs(self, task: Any) -> None:
        for channel in self._inputs:
            task.ai_channels.add_ai_voltage_chan(channel, min_val=-10.0, max_val=10.0)

    def _now(self) -> float:
        """Return the seconds since the rig was opened; records never overlap, though the card has another clock."""
        self._last = max(self._last, self._clock() - self._began)
        return self._last

    @property
    def _finite(self) -> Any:
        return self._ni.constants.AcquisitionType.FINITE

    @contextmanager
    def _driver_errors(self) -> Iterator[None]:
        """Re-raise errors of NI's driver as DeviceError."""
        try:
            yield
        except self._ni.errors.Error as error:
            message = " ".join(str(error).split())
            raise DeviceError(f"{self._label}: {message}") from error
