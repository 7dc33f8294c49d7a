"""`excite` and `scan`: voltages that show an actuator's loops, and paths for it to follow, as files to play."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import click
import numpy as np

from dehyst._errors import ModelError, RecordError
from dehyst.control import shortest_homing
from dehyst.control.planning.path import MOST_ROWS
from dehyst.model import legs, speeds_of, temperatures_to_record, words_of
from dehyst.operations.command import INPUT, NUMBER, Kinds, Parsed, beside, integer, number, option, output
from dehyst.operations.files import read_model, write_table
from dehyst.operations.run import Result, Run
from dehyst.waveforms import Excitation, Sampling, Scan, stage_excitation, standard
from dehyst.waveforms.scans import OPTIONS, SCANS, scan_of

# Cycles a second [Hz] that are tried, the longest time [s] that a recording may take, and the pace of a model's homing.
_FREQUENCIES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
_LONGEST, _RECOMMENDED, _HARDLY = 120.0, 240.0, 1.25
_HOMING = 0.1
_WHY = (
    "Go slower (--frequency) if the sensor or the amplifier lags behind at this rate, faster if drift or creep adds to "
    "the loops; best is the rate at which the actuator will be used."
)
# Options of every excitation, the last one first.
_DRIVEN = (
    number("--slew-rate", help="Largest abs(dv/dt) [V/s]; legs that would be steeper take longer, with a warning."),
    option("--limits", type=(NUMBER, NUMBER), metavar="LOW HIGH", help="Voltages allowed [V]; others are refused."),
    number("--present", help="Voltage [V] on the actuator now, if that is not the base: a ramp leads to the base."),
    number("--base", default=0.0, help="Voltage [V] at which a protocol starts and ends."),
    number("--sample-rate", help="Samples per second [Hz]; default: 400 samples a cycle."),
    number("--frequency", help="Cycles per second [Hz]; default: the slowest that takes two minutes, or four in all."),
    output("Write time and voltage here (CSV)."),
)
_temperatures = option(
    "--temperatures", type=(NUMBER, NUMBER), metavar="LOW HIGH", help="Range in use [degC], to say where to record."
)
_majors = integer("--majors", default=2, help="Number of cycles up to the highest voltage before the tops.")


def _driven(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of every excitation."""
    for each in _DRIVEN:
        function = each(function)
    return function


@click.group("excite", cls=Kinds)
def excite() -> None:
    """Write the voltage of an excitation, to play and record; each KIND has a help of its own."""


@excite.command("recommended")
@click.argument("highest", type=NUMBER)
@_driven
@_temperatures
def recommended(run: Run, highest: float, **options: Any) -> Result:
    """Write all that identification needs, in one run of three minutes.

    Major loops up to HIGHEST [V], falling tops, random turns at three speeds, and two holds.
    """
    return _excited(standard.recommended, [highest], longest=_RECOMMENDED, **options)


@excite.command("raised-cosine")
@click.argument("peaks", type=NUMBER, nargs=-1, required=True)
@_driven
@integer("--cycles", default=1, help="Number of cycles to each of the peaks.")
@_temperatures
def raised_cosine(run: Run, peaks: tuple[float, ...], cycles: int, **options: Any) -> Result:
    """Write cycles from the base to each of the PEAKS [V] and back."""
    return _excited(standard.raised_cosine, peaks, peaks, cycles=cycles, **options)


@excite.command("descending-tops")
@click.argument("highest", type=NUMBER)
@_driven
@integer("--steps", default=10, help="Number of tops; the first top is highest.")
@_majors
@_temperatures
def descending_tops(run: Run, highest: float, **options: Any) -> Result:
    """Write cycles to tops that fall from HIGHEST [V] in equal steps; they determine all stiffnesses that loops can."""
    return _excited(standard.descending_tops, [highest], **options)


@excite.command("staircase")
@click.argument("highest", type=NUMBER)
@_driven
@number("--hold", default=60.0, help="Time at each voltage [s].")
@integer("--steps", default=5, help="Number of steps up, and down.")
@option("--back", is_flag=True, help="Let one step back follow each two steps: inner loops at all levels.")
@_temperatures
def staircase(run: Run, highest: float, **options: Any) -> Result:
    """Write a staircase up to HIGHEST [V] and down again, whose holds show creep."""
    return _excited(standard.staircase, [highest], **options)


@excite.command("stage")
@click.argument("highest", type=NUMBER, nargs=-1, required=True)
@_driven
@option("--axes", help="Names of the axes, as x,y.")
@integer("--steps", default=10, help="Number of falling tops of each axis alone.")
@_majors
@integer("--cycles", default=12, help="Cycles of the first axis when all move together; 0: none.")
@_temperatures
def stage(run: Run, highest: tuple[float, ...], axes: str | None, **options: Any) -> Result:
    """Move several axes to their HIGHEST [V]: one axis after the other, then all together."""
    if len(highest) < 2:
        raise RecordError(argument="highest", got=f"{len(highest)} for a stage", need="one for each of several axes")
    names, longest = None if axes is None else axes.split(","), _LONGEST * (len(highest) + 1)
    return _excited(stage_excitation, highest, highest, longest=longest, advice=(), axes=names, **options)


@excite.command("homing")
@click.argument("highest", type=NUMBER, required=False)
@_driven
@option("--model", type=INPUT, help="Model to home by the shortest certified waveform, instead of HIGHEST.")
@number("--hold", only=beside("model"), help="Time at either limit [s] with creep; default: as long as needed.")
def homing(
    run: Run, highest: float | None, model: Path | None, hold: float | None, output: Path, **options: Any
) -> Result:
    """Home by a way up to HIGHEST [V] and back, or with --model the shortest way to a known state."""
    if (highest is None) == (model is None):
        raise ModelError(argument="highest", need="either a highest voltage or --model")
    if model is None:
        return _excited(standard.homing, [highest], output=output, **options)
    return _home(run, model, output, hold, **options)


def _excited(
    protocol: Callable[..., Excitation],
    volts: Sequence[Any],
    *given: Any,
    output: Path,
    frequency: float | None,
    slew_rate: float | None,
    base: float,
    present: float | None,
    limits: tuple[float, float] | None,
    sample_rate: float | None,
    temperatures: tuple[float, float] | None = None,
    longest: float = _LONGEST,
    advice: tuple[str, ...] = (_WHY,),
    **options: Any,
) -> Result:
    """Write an excitation to voltages; `given`: arguments of its protocol if they are not the only voltage.

    Without a `frequency`, it takes at most the `longest` time [s], if it can, and the advice is given.
    """
    if limits is None and (highest := max(volts)) > 0:
        limits = -highest, highest
    sampled: dict[str, Any] = {"sample_rate": sample_rate, "base": base, "present": present, "limits": limits}

    def make(hertz: float) -> Excitation:
        return protocol(*(given or volts), drive=Sampling(hertz, slew_rate=slew_rate, **sampled), **options)

    warmth = temperatures_to_record(None, temperatures)
    if frequency is not None:
        return _written(make(frequency), output, temperatures=warmth)
    found, hertz = _slow_enough(make, longest)
    return _written(found, output, f"{hertz:g} Hz by default", advice, temperatures=warmth)


def _fastest(excitation: Excitation) -> float:
    """Return the largest abs(dv/dt) [V/s] of an excitation."""
    return excitation.sample_rate * float(np.abs(np.diff(excitation.voltage, axis=0)).max(initial=0.0))


def _slow_enough(make: Callable[[float], Excitation], longest: float) -> tuple[Excitation, float]:
    """Return the slowest excitation that is short enough; if there is none, one hardly longer than the fastest."""
    possible = [(make(frequency), frequency) for frequency in _FREQUENCIES]
    # With a warning the slew rate lengthens legs.
    possible = [each for each in possible if not each[0].warnings] or possible
    most = max(longest, _HARDLY * min(excitation.duration for excitation, _ in possible))
    return next(each for each in possible if each[0].duration <= most)


def _home(run: Run, model: Path, output: Path, hold: float | None, frequency: float | None, **sampled: Any) -> Result:
    """Write the shortest homing of a model."""
    actuator = read_model(run, model)
    sampled["limits"] = sampled["limits"] or actuator.limits
    if sampled["limits"] is not None and not sampled["base"]:
        low, high = sampled["limits"]
        sampled["base"] = min(max(0.0, low), high)
    drive = Sampling(_HOMING if frequency is None else frequency, **sampled)
    ends = {"present": drive.start, "end": drive.base}
    way = shortest_homing(actuator, limits=drive.limits, **ends, drive=drive, hold=hold)
    remarks = way.remarks
    if len(way.turns) < 2:
        words = "homing: the state is already known; nothing to play, nothing written"
        return Result({"kind": "homing", "samples": 0, "warnings": list(remarks)}, [words], warnings=remarks)
    certificate = "certified" if way.certified else "NOT certified"
    remark = f"{certificate}: the displacement is known to {way.spread * 1e6:.3g} um after it"
    return _written(way.played, output, remark, warnings=remarks, good=way.certified)


def _written(
    excitation: Excitation,
    output: Path,
    remark: str = "",
    advice: tuple[str, ...] = (),
    warnings: tuple[str, ...] = (),
    good: bool = True,
    temperatures: Sequence[float] = (),
) -> Result:
    """Write an excitation of one axis or several."""
    names = [f"v{axis}_V" for axis in excitation.axes] or ["voltage_V"]
    voltages = dict(zip(names, excitation.voltage.reshape(len(excitation), -1).T, strict=True))
    write_table(output, {"time_s": excitation.time, **voltages})
    low, high = excitation.voltage_range
    first, last = (excitation.voltage[k].tolist() for k in (0, -1))
    fields = {
        "kind": excitation.name,
        "samples": len(excitation),
        "seconds": excitation.duration,
        "sample_rate_Hz": excitation.sample_rate,
        "lowest_V": low,
        "highest_V": high,
        "slew_rate_V_per_s": _fastest(excitation),
        "first_V": first,
        "last_V": last,
        **({} if excitation.axes else {"turns_V": excitation.turns.tolist()}),
        "parts": [{"name": name, "first": begin, "stop": stop} for name, begin, stop in excitation.parts],
        "record_at_degC": list(temperatures),
        "warnings": [*warnings, *excitation.warnings],
        "output": str(output),
    }
    size = f"{len(excitation)} samples, {excitation.duration:.6g} s at {excitation.sample_rate:.6g} Hz"
    what = f"{low:.6g} to {high:.6g} V"
    if excitation.axes:
        parts = (f"{name} {(stop - begin) / excitation.sample_rate:.4g} s" for name, begin, stop in excitation.parts)
        what, advice = (
            ", ".join(parts),
            ("Before recording, play one cycle on all axes, so that the record begins within the loops.",),
        )
    else:
        time, voltage = excitation.time, excitation.voltage
        branches = speeds_of(time, voltage, legs(voltage, high - low))
        what += f", from {first:.6g} to {last:.6g} V, at {_fastest(excitation):.4g} V/s at most"
        what += f" (its fastest branch takes {branches.max(initial=0.0):.3g} V/s on average)"
    line = f"{excitation.name}: {size}, {what}{f'; {remark}' if remark else ''}: {output}"
    if temperatures:
        advice = (*advice, f"Record it at {words_of(temperatures)}, each with a column temperature_C.")
    return Result(fields, [line, *advice], warnings=fields["warnings"], good=good)


def refuse_cycles(made: Scan, cycles: int) -> None:
    """Raise an error for a number of cycles that is too large for a file."""
    most = MOST_ROWS // made.samples
    if not most:
        got, hint = f"{made.samples} rows a period at {made.rate:g} Hz", "try a lower sample rate, or fewer lines"
        raise RecordError(argument="scan", got=got, need=f"at most {MOST_ROWS:g}", hint=hint)
    if not 1 <= cycles <= most:
        need = f"1 to {most}, of {made.samples} rows each ({MOST_ROWS:g} rows in all)"
        raise RecordError(argument="cycles", got=cycles, need=need, hint="repeat one cycle instead")


class Numbers(tuple[float, ...]):
    """Numbers separated by commas."""

    metavar = "UM,UM,..."

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the numbers in a text; raise ValueError if there are none."""
        return cls(map(float, text.split(",")))


@click.group("scan", cls=Kinds)
def scan() -> None:
    """Write the path of a scan: time and displacement of each axis; compensate computes its voltages.

    KIND: triangle or steps of one axis; raster of two. Each has a help of its own.
    """


def _add_scan(kind: str, text: str) -> None:
    """Add the command of a kind of scan, with the options that it takes."""

    def written(run: Run, output: Path, sample_rate: float | None, cycles: int, **options: Any) -> Result:
        given = {name: value for name, value in options.items() if value is not None}
        return _scanned(kind, given, output, sample_rate, cycles)

    written.__doc__ = text
    options = [
        output("Write time and displacement here (CSV)."),
        number("--sample-rate", help="Samples per second [Hz]; default: from the scan."),
        integer("--cycles", default=1, help="Cycles of the scan."),
    ]
    for name in SCANS[kind].takes:
        own, choices = OPTIONS[name], OPTIONS[name].kind
        default = own.default or (choices[0] if isinstance(choices, tuple) else "")
        words = f"{own.help}{f' [{own.unit}]' if own.unit else ''}{default and f'; default: {default}'}."
        kinds: dict[Any, Any] = {"numbers": Parsed(Numbers), float: NUMBER}
        of = click.Choice(choices) if isinstance(choices, tuple) else kinds.get(choices, choices)
        flag = f"--{name.replace('_', '-')}"
        options.append(option(flag, type=of, required=name in SCANS[kind].needs, help=words))
    function: Callable[..., Any] = written
    for each in reversed(options):
        function = each(function)
    scan.command(kind)(function)


_add_scan("triangle", "A path up and down between two displacements.")
_add_scan("raster", "Lines along x at places along y.")
_add_scan("steps", "Levels with holds between edges.")


def _scanned(kind: str, options: Mapping[str, Any], output: Path, sample_rate: float | None, cycles: int) -> Result:
    """Write the path of a scan."""
    made = scan_of(kind, options, sample_rate)
    refuse_cycles(made, cycles)
    paths = {axis: made.path(axis).repeated(cycles) for axis in made.axes}
    time = next(iter(paths.values())).time
    names = {axis: "displacement_um" if len(paths) == 1 else f"{axis}_um" for axis in paths}
    declared = {"kind": kind, **options, "sample_rate": sample_rate, "cycles": cycles}
    moved = {names[axis]: 1e6 * path.displacement for axis, path in paths.items()}
    write_table(output, {"time_s": time, **moved}, declared)
    ranges = {names[axis]: [1e6 * end for end in path.range] for axis, path in paths.items()}
    fields = {
        "kind": kind,
        "samples": time.size,
        "seconds": time.size / made.rate,
        "sample_rate_Hz": made.rate,
        "period_s": made.period,
        "ranges_um": ranges,
        "warnings": list(made.warnings),
        "output": str(output),
    }
    words = ", ".join(f"{name} {low:.6g} to {high:.6g}" for name, (low, high) in ranges.items())
    line = f"{kind}: {time.size} samples, {fields['seconds']:.6g} s at {made.rate:.6g} Hz, {words}: {output}"
    return Result(fields, [line], warnings=made.warnings)
