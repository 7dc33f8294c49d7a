"""What a PI controller says of itself: axis, limits, wave table and data recorder. Nothing is known by model."""

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
    """What a controller that plays waves and records has.

    Attributes
    ----------
    servo_period : float
        [s]; waves are played and recorded in multiples of it.
    longest : int
        Samples that both a wave table and two recorder tables hold.
    options : gcs_syntax.Options
        Record options of position and voltage.
    """

    servo_period: float
    longest: int
    options: gcs_syntax.Options


@dataclass(frozen=True)
class Traits:
    """What is needed to know of a controller.

    Attributes
    ----------
    axis : str
        Its name there.
    channel : str
        Name of its piezo channel.
    generator : str
        Number of its wave generator.
    limits : VoltageLimits
        Voltages [V] that the controller allows; a slew rate [V/s] if it tells one of open loop.
    waves : WaveTraits or None
        None if it cannot play and record by itself.
    missing : str
        What it lacks for that.
    """

    axis: str
    channel: str
    generator: str
    limits: VoltageLimits
    waves: WaveTraits | None
    missing: str = ""


def inquire(client: GcsClient, axis: str | None, limits: tuple[float, float] | None) -> Traits:
    """Ask a controller what it is.

    Parameters
    ----------
    client : GcsClient
    axis : str, optional
        Needed where there are several.
    limits : (float, float), optional
        Voltages [V] to take where the controller does not tell its own.

    Raises
    ------
    DeviceError
        If it cannot send a voltage and read a displacement, or does not tell its limits.
    RigError
        If it has no such axis.
    LinkError
        If an answer is none.
    """
    absent = [word for word in _FOR_VOLTAGES if word not in client.commands]
    if absent:
        raise DeviceError(
            f"{client.name}: does not know {', '.join(absent)}, need open-loop voltages and a position; use another one"
        )
    client.clear()
    name, number = _axis(client, axis)
    channel = _channel(client, name, number)
    _refuse_offline(client, channel)
    told = _limits(client, channel, limits)
    traits = Traits(name, channel, number, told, None)
    absent = [word for word in _FOR_WAVES if word not in client.commands]
    if absent:
        return replace(traits, missing=f"does not know {', '.join(absent)}")
    waves, missing = _waves(client)
    return replace(traits, waves=waves, missing=missing)


def _axis(client: GcsClient, wanted: str | None) -> tuple[str, str]:
    """The axis, and which one it is, from 1."""
    axes = client.ask("SAI?", gcs_syntax.names) if "SAI?" in client.commands else ["1"]
    if wanted is None and len(axes) > 1:
        raise RigError(f"{client.name}: has the axes {', '.join(axes)}; say which, as in pi://host:port/{axes[0]}")
    name = axes[0] if wanted is None else wanted
    if name not in axes:
        raise RigError(f"{client.name}: got the axis {name!r}, it has {', '.join(axes)}; give one of them")
    return name, str(axes.index(name) + 1)


def _channel(client: GcsClient, axis: str, number: str) -> str:
    """The axis' piezo channel: of its own name, else of its number."""
    channels = client.ask("VOL?", gcs_syntax.pairs)
    found = axis if axis in channels else number
    if found not in channels:
        raise DeviceError(f"{client.name}: has the channels {', '.join(channels)}, need one for the axis {axis}")
    return found


def _refuse_offline(client: GcsClient, channel: str) -> None:
    if "ONL?" in client.commands:
        (online,) = client.ask(gcs_syntax.command("ONL?", channel), lambda lines: gcs_syntax.counts(lines, [channel]))
        if not online:
            raise DeviceError(f"{client.name}: channel {channel} is offline; switch it on there (ONL {channel} 1)")


def _limits(client: GcsClient, channel: str, given: tuple[float, float] | None) -> VoltageLimits:
    slew_rate = _slew_rate(client)
    absent = [word for word in ("VMI?", "VMA?") if word not in client.commands]
    if absent and given is None:
        raise DeviceError(f"{client.name}: does not know {', '.join(absent)}; give the voltages it may have (limits=)")
    if absent and given is not None:
        return VoltageLimits(*given, slew_rate)
    low, high = (
        client.ask(gcs_syntax.command(word, channel), lambda lines: gcs_syntax.values(lines, [channel]))[0]
        for word in ("VMI?", "VMA?")
    )
    if not low < high:
        raise LinkError(f"{client.name}: says that {low:g} to {high:g} V are allowed; that is no range")
    return VoltageLimits(low, high, slew_rate)


def _slew_rate(client: GcsClient) -> float | None:
    """The largest abs(dv/dt) [V/s] in open loop, if the controller has a parameter that it calls so."""
    if not {"HPA?", "SPA?"} <= client.commands:
        return None
    listed = client.ask("HPA?", gcs_syntax.parameters)
    found = [number for number, said in listed.items() if "slew" in said.lower() and "open" in said.lower()]
    rate = _parameter(client, found[0]) if found else None
    return rate if rate is not None and rate > 0 else None


def _waves(client: GcsClient) -> tuple[WaveTraits | None, str]:
    """What the wave generator and the recorder have, or what is missing."""
    options = client.ask("HDR?", gcs_syntax.options)
    if options is None:
        return None, "cannot record both position and voltage (HDR?)"
    tables = client.ask("TNR?", lambda lines: gcs_syntax.integer(gcs_syntax.single(lines)))
    if tables < 2:
        return None, f"has {tables} recorder tables (TNR?), need 2"
    found = [_parameter(client, number) for number in (_SERVO_PERIOD, _WAVE_POINTS, _RECORD_POINTS)]
    absent = [f"{n:#010x}" for n, v in zip((_SERVO_PERIOD, _WAVE_POINTS, _RECORD_POINTS), found, strict=True) if not v]
    if absent:
        return None, f"does not tell the parameters {', '.join(absent)} (SPA?)"
    period, points, recorded = (value or 0.0 for value in found)
    longest = int(min(points, recorded // tables))
    if not (0 < period <= 1 and longest >= 2):
        return None, f"has a servo update time of {period:g} s and tables of {longest} points (SPA?)"
    return WaveTraits(period, longest, options), ""


def _parameter(client: GcsClient, number: int) -> float | None:
    """A parameter's value; None if the controller does not answer with one."""
    try:
        return client.ask(
            gcs_syntax.command("SPA?", 1, f"0x{number:08X}"), lambda lines: gcs_syntax.parameter(lines, "1", number)
        )
    except LinkError:
        # An unknown parameter is not answered.
        client.clear()
        return None
