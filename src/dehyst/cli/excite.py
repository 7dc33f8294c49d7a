"""`dehyst excite KIND`: voltages that make an actuator show its loops, as files to play."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst.cli.common import PATH, force_option, json_option, read_model, refuse_overwriting, refuse_replacing
from dehyst.cli.terminal import echo, echo_json, note, worded

if TYPE_CHECKING:
    from dehyst.waveforms import Excitation, Sampling

# A negative voltage is no option.
_NEGATIVE = {"ignore_unknown_options": True}


@click.group()
def excite() -> None:
    """Voltage of a protocol (KIND) to play: within limits and slew rate, from the present voltage on."""


def _play_options(command: Callable[..., None]) -> Callable[..., None]:
    """Options that all kinds share."""
    for flags, options in (
        (
            ("--pace",),
            {
                "type": click.Choice(["frequency", "rate"]),
                "default": "frequency",
                "show_default": True,
                "help": "Every leg takes half a cycle, or only the highest one.",
            },
        ),
        (
            ("--shape",),
            {
                "type": click.Choice(["cosine", "triangle"]),
                "default": "cosine",
                "show_default": True,
                "help": "Of a leg.",
            },
        ),
        (("--slew",), {"type": float, "metavar": "V/S", "help": "Largest slew rate; steeper legs take longer."}),
        (("--limits",), {"type": (float, float), "metavar": "LOW HIGH", "help": "Voltages allowed."}),
        (("--present",), {"type": float, "metavar": "V", "help": "Voltage now: a ramp leads from it."}),
        (("--base",), {"type": float, "default": 0.0, "show_default": True, "help": "Voltage to start from."}),
        (("--sample-rate",), {"type": float, "metavar": "HZ", "help": "Samples a second.  [default: 400 a cycle]"}),
        (("--frequency",), {"type": float, "default": 0.01, "show_default": True, "help": "Cycles a second."}),
        (("-o", "--output"), {"type": PATH, "required": True, "help": "Write time and voltage here (CSV)."}),
    ):
        command = click.option(*flags, **options)(command)
    return json_option(force_option(command))


@excite.command("raised-cosine", context_settings=_NEGATIVE)
@click.argument("peaks", nargs=-1, required=True, type=float)
@click.option("--cycles", type=int, default=1, show_default=True, help="Of each peak.")
@_play_options
def raised_cosine(peaks: tuple[float, ...], cycles: int, **options: Any) -> None:
    """Cycles from the base to each of the PEAKS [V] and back."""
    from dehyst.waveforms import standard

    _write(lambda drive: standard.raised_cosine(peaks, cycles=cycles, drive=drive), options)


@excite.command("descending-tops", context_settings=_NEGATIVE)
@click.argument("highest", type=float)
@click.option("--steps", type=int, default=10, show_default=True, help="Number of tops.")
@click.option("--majors", type=int, default=2, show_default=True, help="Cycles to the highest before them.")
@_play_options
def descending_tops(highest: float, steps: int, majors: int, **options: Any) -> None:
    """Cycles to tops falling from HIGHEST [V] in equal steps: tells every stiffness that loops can tell."""
    from dehyst.waveforms import standard

    _write(lambda drive: standard.descending_tops(highest, steps=steps, majors=majors, drive=drive), options)


@excite.command("reversal-curves", context_settings=_NEGATIVE)
@click.argument("highest", type=float)
@click.option("--lowest", type=float, help="Where the last curve turns [V].  [default: the base]")
@click.option("--count", type=int, default=10, show_default=True, help="Number of curves.")
@click.option("--majors", type=int, default=1, show_default=True, help="Cycles to the highest before them.")
@_play_options
def reversal_curves(highest: float, lowest: float | None, count: int, majors: int, **options: Any) -> None:
    """First-order reversal curves: HIGHEST [V] down to ever lower voltages, and back up."""
    from dehyst.waveforms import standard

    _write(
        lambda drive: standard.reversal_curves(highest, lowest=lowest, count=count, majors=majors, drive=drive), options
    )


@excite.command("minor-loop", context_settings=_NEGATIVE)
@click.argument("low", type=float)
@click.argument("high", type=float)
@click.option("--highest", type=float, required=True, help="Top of the major cycles [V].")
@click.option("--cycles", type=int, default=1, show_default=True, help="Of the minor loop.")
@click.option("--majors", type=int, default=2, show_default=True, help="Cycles to the highest before it.")
@_play_options
def minor_loop(low: float, high: float, highest: float, cycles: int, majors: int, **options: Any) -> None:
    """A minor loop between LOW and HIGH [V], with its approach, after major cycles."""
    from dehyst.waveforms import standard

    def make(drive: Sampling) -> Excitation:
        return standard.minor_loop(low, high, highest=highest, cycles=cycles, majors=majors, drive=drive)

    _write(make, options)


@excite.command("staircase", context_settings=_NEGATIVE)
@click.argument("highest", type=float)
@click.option("--steps", type=int, default=5, show_default=True, help="Up, and as many down.")
@click.option("--hold", type=float, default=60.0, show_default=True, metavar="S", help="Time at each voltage.")
@click.option("--ramp", type=float, metavar="S", help="Time between two voltages.  [default: half a cycle in all]")
@click.option("--back", is_flag=True, help="Each two steps followed by one back: inner loops at all levels.")
@_play_options
def staircase(highest: float, steps: int, hold: float, ramp: float | None, back: bool, **options: Any) -> None:
    """Steps up to HIGHEST [V] and down again with holds: shows creep."""
    from dehyst.waveforms import standard

    _write(
        lambda drive: standard.staircase(highest, steps=steps, hold=hold, ramp=ramp, back=back, drive=drive), options
    )


@excite.command("homing", context_settings=_NEGATIVE)
@click.argument("highest", type=float, required=False)
@click.option(
    "--model", type=PATH, help="The shortest waveform that is certified to end in a known state of this model."
)
@click.option(
    "--hold",
    type=float,
    metavar="S",
    help="With a model that creeps: time at either limit.  [default: what is needed]",
)
@_play_options
def homing(highest: float | None, model: Path | None, hold: float | None, **options: Any) -> None:
    """Up to HIGHEST [V] and back; or, with --model, the shortest certified way to a known state."""
    from dehyst._errors import ModelError
    from dehyst.waveforms import standard

    if (highest is None) == (model is None):
        raise ModelError("homing: need either a highest voltage or --model, and not both")
    if model is None:
        _write(lambda drive: standard.homing(highest, drive=drive), options)
        return
    from dehyst.control import shortest_homing

    refuse_overwriting([model], options["output"])
    actuator = read_model(model)
    options["limits"] = options["limits"] or actuator.limits
    given = click.get_current_context().get_parameter_source("base")
    if options["limits"] is not None and given is not click.core.ParameterSource.COMMANDLINE:
        low, high = options["limits"]
        options["base"] = min(max(options["base"], low), high)
    drive = _drive(options)
    way = shortest_homing(
        actuator,
        limits=options["limits"],
        present=drive.start,
        end=options["base"],
        stiff_only=True,
        drive=drive,
        hold=hold,
    )
    if not way.certified or way.played is not None:
        for remark in way.remarks:
            note(remark)
    if len(way.turns) < 2:
        echo("homing: the state is known already, nothing to play and nothing written")
        return
    if way.played is None:
        word = "certified to end in a known state" if way.certified else "NOT certified: the state stays unknown"
        made = standard.homing(turns=way.turns, drive=drive)
    else:
        made, sure = way.played, "certified" if way.certified else "NOT certified"
        word = f"{sure}: the displacement is known to {way.error * 1e6:.3g} um after it"
    _save(made, options, word)
    sys.exit(0 if way.certified else 1)


def _write(make: Callable[[Sampling], Excitation], options: dict[str, Any]) -> None:
    refuse_overwriting([], options["output"])
    _save(make(_drive(options)), options, "")


def _drive(options: dict[str, Any]) -> Sampling:
    from dehyst.waveforms import Sampling

    return Sampling(
        frequency=options["frequency"],
        sample_rate=options["sample_rate"],
        base=options["base"],
        present=options["present"],
        limits=options["limits"],
        slew_rate=options["slew"],
        shape=options["shape"],
        pace=options["pace"],
    )


def _save(made: Excitation, options: dict[str, Any], word: str) -> None:
    from dehyst.records import write_columns

    output = options["output"]
    refuse_replacing(output)
    write_columns(output, {"time_s": made.time, "voltage_V": made.voltage})
    for warning in made.warnings:
        note(warning)
    low, high = made.voltage_range
    if options["as_json"]:
        echo_json(
            {
                "kind": made.name,
                "samples": len(made),
                "seconds": made.duration,
                "sample_rate_Hz": made.sample_rate,
                "lowest_V": low,
                "highest_V": high,
                "first_V": float(made.voltage[0]),
                "last_V": float(made.voltage[-1]),
                "turns_V": made.turns.tolist(),
                "warnings": list(worded(made.warnings)),
                "output": str(output),
            }
        )
        return
    echo(
        f"{made.name}: {len(made)} samples, {made.duration:.6g} s at {made.sample_rate:.6g} Hz, {low:.6g} to "
        f"{high:.6g} V, from {made.voltage[0]:.6g} to {made.voltage[-1]:.6g} V{f'; {word}' if word else ''}: {output}"
    )
