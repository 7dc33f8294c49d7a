"""`dehyst excite KIND`: voltages that excite an actuator's loops, as files to play."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst.cli.common import (
    PATH,
    force_option,
    json_option,
    read_model,
    refuse_given,
    refuse_overwriting,
    write_output,
)
from dehyst.cli.output.terminal import echo, echo_json, note

if TYPE_CHECKING:
    from dehyst.waveforms import Excitation, Sampling

# A negative voltage is not an option.
_NEGATIVE = {"ignore_unknown_options": True}
# Cycles a second [Hz] that are tried, the longest time [s] that a recording may take, and the pace of a model's homing.
_FREQUENCIES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
_LONGEST, _HARDLY = 120.0, 1.25
_HOMING = 0.1
_WHY = (
    "Go slower (--frequency) if the sensor or the amplifier lags behind at this rate, faster if drift or creep adds to "
    "the loops; best is the rate at which the actuator will be used."
)


@click.group()
def excite() -> None:
    """Write the voltage of a protocol (KIND) to play: within limits and slew rate, from the present voltage on."""


def _play_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options that all kinds share."""
    pace = "frequency: every leg takes half a cycle; rate: only the highest leg does."
    for option in (
        click.option(
            "--pace", type=click.Choice(["frequency", "rate"]), default="frequency", show_default=True, help=pace
        ),
        click.option(
            "--shape",
            type=click.Choice(["cosine", "triangle"]),
            default="cosine",
            show_default=True,
            help="Shape of a leg.",
        ),
        click.option("--slew", type=float, metavar="V/S", help="Largest slew rate; steeper legs take longer."),
        click.option("--limits", type=(float, float), metavar="LOW HIGH", help="Voltages allowed."),
        click.option("--present", type=float, metavar="V", help="Present voltage: a ramp leads from it."),
        click.option("--base", type=float, default=0.0, show_default=True, help="Voltage to start from."),
        click.option("--sample-rate", type=float, metavar="HZ", help="Samples a second.  [default: 400 a cycle]"),
        click.option(
            "--frequency",
            type=float,
            metavar="HZ",
            help="Cycles a second.  [default: the slowest of 0.01, 0.02, 0.05 ... 1 that takes under two minutes]",
        ),
        click.option("-o", "--output", type=PATH, required=True, help="Write time and voltage here (CSV)."),
    ):
        command = option(command)
    return json_option(force_option(command))


@excite.command("raised-cosine", context_settings=_NEGATIVE)
@click.argument("peaks", nargs=-1, required=True, type=float)
@click.option("--cycles", type=int, default=1, show_default=True, help="Cycles to each peak.")
@_play_options
def raised_cosine(peaks: tuple[float, ...], cycles: int, **options: Any) -> None:
    """Write cycles from the base to each of the PEAKS [V] and back."""
    from dehyst.waveforms import standard

    _write(lambda drive: standard.raised_cosine(peaks, cycles=cycles, drive=drive), options)


@excite.command("descending-tops", context_settings=_NEGATIVE)
@click.argument("highest", type=float)
@click.option("--steps", type=int, default=10, show_default=True, help="Number of tops.")
@click.option("--majors", type=int, default=2, show_default=True, help="Cycles to the highest before them.")
@_play_options
def descending_tops(highest: float, steps: int, majors: int, **options: Any) -> None:
    """Write cycles to tops falling from HIGHEST [V] in equal steps: they determine all stiffnesses that loops can."""
    from dehyst.waveforms import standard

    _write(lambda drive: standard.descending_tops(highest, steps=steps, majors=majors, drive=drive), options)


@excite.command("reversal-curves", context_settings=_NEGATIVE)
@click.argument("highest", type=float)
@click.option("--lowest", type=float, help="Where the last curve turns [V].  [default: the base]")
@click.option("--count", type=int, default=10, show_default=True, help="Number of curves.")
@click.option("--majors", type=int, default=1, show_default=True, help="Cycles to the highest before them.")
@_play_options
def reversal_curves(highest: float, lowest: float | None, count: int, majors: int, **options: Any) -> None:
    """Write first-order reversal curves: from HIGHEST [V] down to ever lower voltages, and back up."""
    from dehyst.waveforms import standard

    _write(
        lambda drive: standard.reversal_curves(highest, lowest=lowest, count=count, majors=majors, drive=drive), options
    )


@excite.command("minor-loop", context_settings=_NEGATIVE)
@click.argument("low", type=float)
@click.argument("high", type=float)
@click.option("--highest", type=float, required=True, help="Top of the major cycles [V].")
@click.option("--cycles", type=int, default=1, show_default=True, help="Cycles of the minor loop.")
@click.option("--majors", type=int, default=2, show_default=True, help="Cycles to the highest before it.")
@_play_options
def minor_loop(low: float, high: float, highest: float, cycles: int, majors: int, **options: Any) -> None:
    """Write a minor loop between LOW and HIGH [V], with its approach, after major cycles."""
    from dehyst.waveforms import standard

    def make(drive: Sampling) -> Excitation:
        return standard.minor_loop(low, high, highest=highest, cycles=cycles, majors=majors, drive=drive)

    _write(make, options)


@excite.command("staircase", context_settings=_NEGATIVE)
@click.argument("highest", type=float)
@click.option("--steps", type=int, default=5, show_default=True, help="Steps up, and as many down.")
@click.option("--hold", type=float, default=60.0, show_default=True, metavar="S", help="Time at each voltage.")
@click.option("--ramp", type=float, metavar="S", help="Time between two voltages.  [default: half a cycle in all]")
@click.option("--back", is_flag=True, help="Each two steps followed by one back: inner loops at all levels.")
@_play_options
def staircase(highest: float, steps: int, hold: float, ramp: float | None, back: bool, **options: Any) -> None:
    """Write steps up to HIGHEST [V] and down again with holds: they show creep."""
    refuse_given("on steps, which are equal", "pace")
    from dehyst.waveforms import standard

    _write(
        lambda drive: standard.staircase(highest, steps=steps, hold=hold, ramp=ramp, back=back, drive=drive), options
    )


@excite.command("stage", context_settings=_NEGATIVE)
@click.argument("highest", nargs=-1, required=True, type=float)
@click.option("--names", metavar="X,Y", help="Names of the axes.  [default: x,y,z]")
@click.option("--steps", type=int, default=10, show_default=True, help="Tops of each axis alone.")
@click.option("--majors", type=int, default=2, show_default=True, help="Cycles to its highest before.")
@click.option("--cycles", type=int, default=12, show_default=True, help="Cycles of the first axis with the others.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the levels at which axes turn together.")
@_play_options
def stage(
    highest: tuple[float, ...], names: str | None, steps: int, majors: int, cycles: int, seed: int, **options: Any
) -> None:
    """Write voltages of a stage, its HIGHEST of each axis: one axis after the other, then all together."""
    from dehyst.waveforms import stage_excitation

    refuse_overwriting([], options["output"])

    def make(frequency: float) -> Excitation:
        return stage_excitation(
            highest,
            drive=_drive(options, frequency),
            steps=steps,
            majors=majors,
            cycles=cycles,
            axes=None if names is None else names.split(","),
            seed=seed,
        )

    given = options["frequency"]
    tried = [make(frequency) for frequency in ((given,) if given is not None else _FREQUENCIES)]
    found = next((one for one in tried if one.duration <= _LONGEST * (len(highest) + 1)), tried[-1])
    columns = {f"v{axis}_V": found.voltage[:, j] for j, axis in enumerate(found.axes)}
    write_output(options["output"], {"time_s": found.time, **columns})
    parts = ", ".join(f"{name} {(stop - first) / found.sample_rate:.4g} s" for name, first, stop in found.parts)
    if options["as_json"]:
        echo_json(
            {
                "kind": "stage",
                "samples": len(found),
                "seconds": found.duration,
                "sample_rate_Hz": found.sample_rate,
                "parts": [{"name": name, "first": first, "stop": stop} for name, first, stop in found.parts],
                "output": str(options["output"]),
            }
        )
        return
    size = f"{len(found)} samples, {found.duration:.6g} s at {found.sample_rate:.6g} Hz"
    echo(f"stage: {size}: {parts}: {options['output']}")
    echo("Play one cycle on all axes before, so that the record begins within the loops.")


@excite.command("homing", context_settings=_NEGATIVE)
@click.argument("highest", type=float, required=False)
@click.option(
    "--model", type=PATH, help="Write the shortest waveform that is certified to end in a known state of this model."
)
@click.option(
    "--hold",
    type=float,
    metavar="S",
    help="With a model that creeps: time at either limit.  [default: as long as needed]",
)
@_play_options
def homing(highest: float | None, model: Path | None, hold: float | None, **options: Any) -> None:
    """Write a homing: up to HIGHEST [V] and back, or with --model the shortest certified way to a known state."""
    from dehyst._errors import ModelError
    from dehyst.waveforms import standard

    if (highest is None) == (model is None):
        raise ModelError(argument="homing", need="either a highest voltage or --model, not both")
    if model is None:
        refuse_given("without --model", "hold", "pace")
        _write(lambda drive: standard.homing(highest, drive=drive), options)
        return
    from dehyst.control import shortest_homing

    refuse_overwriting([model], options["output"])
    actuator = read_model(model)
    if not actuator.needs_time:
        refuse_given("with a model that does not creep", "hold")
    options["limits"] = options["limits"] or actuator.limits
    given = click.get_current_context().get_parameter_source("base")
    if options["limits"] is not None and given is not click.core.ParameterSource.COMMANDLINE:
        low, high = options["limits"]
        options["base"] = min(max(options["base"], low), high)
    drive = _drive(options, options["frequency"] or _HOMING)
    ends = {"present": drive.start, "end": options["base"]}
    way = shortest_homing(actuator, limits=options["limits"], **ends, stiff_only=True, drive=drive, hold=hold)
    if not way.certified or way.played is not None:
        for remark in way.remarks:
            note(remark)
    if len(way.turns) < 2:
        echo("homing: the state is known already, nothing to play and nothing written")
        return
    if way.played is None:
        remark = "certified to end in a known state" if way.certified else "NOT certified: the state stays unknown"
        excitation = standard.homing(turns=way.turns, drive=drive)
    else:
        excitation, certificate = way.played, "certified" if way.certified else "NOT certified"
        remark = f"{certificate}: the displacement is known to {way.error * 1e6:.3g} um after it"
    _save(excitation, options, remark)
    sys.exit(0 if way.certified else 1)


def _write(make: Callable[[Sampling], Excitation], options: dict[str, Any]) -> None:
    refuse_overwriting([], options["output"])
    if options["frequency"] is not None:
        _save(make(_drive(options, options["frequency"])), options, "")
        return
    slow, frequency = _slow_enough(make, options)
    _save(slow, options, f"{frequency:g} Hz by default")
    if not options["as_json"]:
        echo(_WHY)


def _slow_enough(make: Callable[[Sampling], Excitation], options: dict[str, Any]) -> tuple[Excitation, float]:
    """Return the slowest excitation that takes under two minutes or, if none does, hardly longer than the fastest."""
    possible = [(make(_drive(options, frequency)), frequency) for frequency in _FREQUENCIES]
    # With a warning the slew rate lengthens legs.
    possible = [one for one in possible if not one[0].warnings] or possible
    longest = max(_LONGEST, _HARDLY * min(excitation.duration for excitation, _ in possible))
    return next(one for one in possible if one[0].duration <= longest)


def _drive(options: dict[str, Any], frequency: float) -> Sampling:
    from dehyst.waveforms import Sampling

    same = ("sample_rate", "base", "present", "limits", "shape", "pace")
    return Sampling(frequency, slew_rate=options["slew"], **{name: options[name] for name in same})


def _save(excitation: Excitation, options: dict[str, Any], remark: str) -> None:
    output = options["output"]
    write_output(output, {"time_s": excitation.time, "voltage_V": excitation.voltage})
    for warning in excitation.warnings:
        note(warning)
    low, high = excitation.voltage_range
    if options["as_json"]:
        echo_json(
            {
                "kind": excitation.name,
                "samples": len(excitation),
                "seconds": excitation.duration,
                "sample_rate_Hz": excitation.sample_rate,
                "lowest_V": low,
                "highest_V": high,
                "first_V": float(excitation.voltage[0]),
                "last_V": float(excitation.voltage[-1]),
                "turns_V": excitation.turns.tolist(),
                "warnings": list(excitation.warnings),
                "output": str(output),
            }
        )
        return
    first, last = excitation.voltage[[0, -1]]
    echo(
        f"{excitation.name}: {len(excitation)} samples, {excitation.duration:.6g} s at {excitation.sample_rate:.6g} "
        f"Hz, {low:.6g} to {high:.6g} V, from {first:.6g} to {last:.6g} V{f'; {remark}' if remark else ''}: {output}"
    )
