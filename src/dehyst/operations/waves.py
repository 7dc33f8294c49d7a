"""`excite` and `scan`: voltages that show an actuator's loops, and paths for it to follow, as files to play."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np

from dehyst._errors import RecordError
from dehyst.control.planning.ways import MOST_ROWS
from dehyst.operations.command import NUMBER, argument, command, flag, kinds, number, option, output, pair
from dehyst.operations.files import GAIN, write_table
from dehyst.operations.run import Result, Run
from dehyst.waveforms import Excitation, Sampling, stage_excitation, standard
from dehyst.waveforms.excitation import voltages
from dehyst.waveforms.scans import OPTIONS, SCANS, scan_of

_BEFORE = "Before recording, play one cycle on all axes, so that the record begins within the loops."


def numbers(text: str) -> tuple[float, ...]:
    """Return the numbers in a text, with commas between them."""
    return tuple(map(float, text.split(",")))


# Options of every excitation.
_DRIVEN: dict[str, Any] = {
    "output": output("Write time and voltage here (CSV)."),
    "frequency": number("Cycles per second [Hz], for recommended the slowest ones; as in later use.", default=0.1),
    "sample_rate": number("Samples per second [Hz]; default: 400 samples a cycle, for recommended 1000."),
    "base": number("Voltage [V] at which a protocol starts and ends.", default=0.0),
    "present": number("Voltage [V] on the actuator now, if that is not the base: a ramp leads to the base."),
    "limits": pair("Allowed voltages [V]; default: up to the highest given one, of either sign."),
    "slew_rate": number("Largest abs(dv/dt) [V/s]; a low one makes the excitation longer."),
    "gain": GAIN,
}
_VOLTAGE, _VOLTAGES = {"highest": argument(NUMBER)}, {"highest": argument(NUMBER, nargs=-1)}

excite = kinds(
    "excite", help="Write the voltage of an excitation, to play and record; each KIND has a help of its own."
)
scan = kinds(
    "scan",
    help="Write the path of a scan: time and displacement of each axis; compensate computes its voltages.\n\n"
    "KIND: triangle or steps of one axis; raster of two. Each has a help of its own.",
)


def _add_excitation(kind: str, text: str, protocol: Callable[..., Excitation], **options: Any) -> None:
    """Add the command of a kind of excitation, with the `options` of its protocol."""

    def written(run: Run, output: Path, frequency: float, gain: float | None, **given: Any) -> Result:
        (name,) = {"highest", "peaks"} & {*given}
        if given.get("axes"):
            given["axes"] = given["axes"].split(",")
        if kind == "stage" and len(given[name]) < 2:
            raise RecordError(argument=name, got=f"{len(given[name])} voltage", need="one for each of several axes")
        sampled = {key: given.pop(key) for key in ("sample_rate", "base", "present", "limits", "slew_rate")}
        top = float(voltages(np.ravel(given[name]), name).max())
        if sampled["limits"] is None and top > 0:
            sampled["limits"] = -top, top
        excitation = protocol(given.pop(name), drive=Sampling(frequency, **sampled), **given)
        names = [f"v{axis}_V" for axis in excitation.axes] or ["voltage_V"]
        rate, (low, high) = excitation.sample_rate, excitation.voltage_range
        columns = dict(zip(names, excitation.voltage.reshape(len(excitation), -1).T, strict=True))
        write_table(output, {"time_s": excitation.time, **columns}, gain)
        first, last = (excitation.voltage[k].tolist() for k in (0, -1))
        steepest = rate * float(np.abs(np.diff(excitation.voltage, axis=0)).max(initial=0.0))
        fields = {
            "kind": excitation.name,
            "samples": len(excitation),
            "seconds": excitation.duration,
            "sample_rate_Hz": rate,
            "lowest_V": low,
            "highest_V": high,
            "slew_rate_V_per_s": steepest,
            "first_V": first,
            "last_V": last,
            **({} if excitation.axes else {"turns_V": excitation.turns.tolist()}),
            "parts": [{"name": name, "first": begin, "stop": stop} for name, begin, stop in excitation.parts],
        }
        size = f"{len(excitation)} samples, {excitation.duration:.6g} s at {rate:.6g} Hz"
        if excitation.axes:
            what = ", ".join(f"{name} {(stop - begin) / rate:.4g} s" for name, begin, stop in excitation.parts)
        else:
            what = f"{low:.6g} to {high:.6g} V, from {first:.6g} to {last:.6g} V, {steepest:.4g} V/s at its steepest"
        run.remarks += excitation.warnings
        return Result(fields, [f"{excitation.name}: {size}, {what}: {output}", *[_BEFORE] * bool(excitation.axes)])

    written.__doc__ = text
    command(kind, {**options, **_DRIVEN}, excite)(written)


_add_excitation(
    "recommended",
    "Write all that identification needs, in one run of three minutes, or longer at a low slew rate.\n\n"
    "Major loops up to HIGHEST [V], falling tops, random turns at three speeds, and two holds.",
    standard.recommended,
    **_VOLTAGE,
)
_add_excitation(
    "raised-cosine",
    "Write cycles from the base to each of the PEAKS [V] and back.",
    standard.raised_cosine,
    peaks=argument(NUMBER, nargs=-1),
    cycles=option("Number of cycles to each of the peaks.", int, default=1),
)
_add_excitation(
    "staircase",
    "Write a staircase up to HIGHEST [V] and down again, whose holds show creep.",
    standard.staircase,
    **_VOLTAGE,
    hold=number("Time at each voltage [s].", default=60.0),
    steps=option("Number of steps in each direction.", int, default=5),
    back=flag("Step back once after every two steps, for inner loops at all levels."),
)


_add_excitation(
    "stage",
    "Move several axes to their HIGHEST [V]: one axis after the other, then all together.",
    stage_excitation,
    **_VOLTAGES,
    axes=option("Names of the axes, as x,y."),
    steps=option("Number of falling tops of each axis alone.", int, default=10),
    cycles=option("Cycles of the first axis when all move together; 0: none.", int, default=12),
)


def _add_scan(kind: str, text: str) -> None:
    """Add the command of a kind of scan, with the options that it takes."""

    def written(run: Run, output: Path, sample_rate: float | None, cycles: int, **options: Any) -> Result:
        made = scan_of(kind, {name: value for name, value in options.items() if value is not None}, sample_rate)
        if not 1 <= cycles <= MOST_ROWS // made.samples:
            need = f"1 or more, with {MOST_ROWS:g} rows at most in all, of {made.samples} a cycle"
            hint = "repeat one cycle, or lower the sample rate"
            raise RecordError(argument="cycles", got=cycles, need=need, hint=hint)
        names = [f"{axis}_um" for axis in made.axes] if len(made.axes) > 1 else ["displacement_um"]
        paths = dict(zip(names, (made.path(axis).repeated(cycles) for axis in made.axes), strict=True))
        time = next(iter(paths.values())).time
        write_table(output, {"time_s": time, **{name: 1e6 * path.displacement for name, path in paths.items()}})
        ranges = {name: [1e6 * end for end in path.range] for name, path in paths.items()}
        fields = {
            "kind": kind,
            "samples": time.size,
            "seconds": time.size / made.rate,
            "sample_rate_Hz": made.rate,
            "period_s": made.period,
            "ranges_um": ranges,
        }
        words = ", ".join(f"{name} {low:.6g} to {high:.6g}" for name, (low, high) in ranges.items())
        line = f"{kind}: {time.size} samples, {fields['seconds']:.6g} s at {made.rate:.6g} Hz, {words}: {output}"
        run.remarks += made.warnings
        return Result(fields, [line])

    written.__doc__ = text
    options: dict[str, Any] = {
        "output": output("Write time and displacement here (CSV)."),
        "sample_rate": number("Samples per second [Hz]; default: from the scan."),
        "cycles": option("Cycles of the scan.", int, default=1),
    }
    values: dict[Any, Any] = {"numbers": numbers, float: NUMBER}
    for name in SCANS[kind].takes:
        own, choices = OPTIONS[name], OPTIONS[name].kind
        default = own.default or (choices[0] if isinstance(choices, tuple) else "")
        commas = ", with commas between them" if choices == "numbers" else ""
        words = f"{own.help}{commas}{f' [{own.unit}]' if own.unit else ''}{default and f'; default: {default}'}."
        of = click.Choice(choices) if isinstance(choices, tuple) else values.get(choices, choices)
        options[name] = option(words, of, required=name in SCANS[kind].needs)
    command(kind, options, scan)(written)


_add_scan("triangle", "A path up and down between two displacements.")
_add_scan("raster", "Lines along x at places along y.")
_add_scan("steps", "Levels with holds between edges.")
