"""Discovery of a PI controller: axis, limits, wave table and data recorder, all queried, none by its model number."""

from __future__ import annotations

from dataclasses import dataclass, replace

from dehyst._errors import DeviceError, LinkError, RigError
from dehyst.control import VoltageLimits
from dehyst.instruments import gcs_syntax
from dehyst.instruments.gcs_client import GcsClient

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
        raise DeviceError(f"{client.name}: lacks the commands {', '.join(absent)}; give the allowed voltages (limits=)")
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
