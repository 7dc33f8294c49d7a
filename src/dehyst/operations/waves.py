"""`excite` and `scan`: voltages that show an actuator's loops, and paths for it to follow, as files to play."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np

from dehyst._errors import ModelError, RecordError
from dehyst.control import shortest_homing
from dehyst.control.planning.path import MOST_ROWS
from dehyst.model import temperatures_to_record, words_of
from dehyst.operations.declaration import Input, Kind, Only, Output, Parameter, merged, one_of, operation
from dehyst.operations.files import read_model, write_table
from dehyst.operations.run import Result, Run
from dehyst.waveforms import Excitation, Sampling, Scan, stage_excitation, standard
from dehyst.waveforms.scans import OPTIONS, SCANS, scan_of

EXCITATIONS: dict[str, Callable[..., Excitation]] = {
    "recommended": standard.recommended,
    "raised-cosine": standard.raised_cosine,
    "descending-tops": standard.descending_tops,
    "staircase": standard.staircase,
    "stage": stage_excitation,
    "homing": standard.homing,
}
# Cycles a second [Hz] that are tried, the longest time [s] that a recording may take, and the pace of a model's homing.
_FREQUENCIES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
_LONGEST, _RECOMMENDED, _HARDLY = 120.0, 240.0, 1.25
_HOMING = 0.1
_WHY = (
    "Go slower (--frequency) if the sensor or the amplifier lags behind at this rate, faster if drift or creep adds to "
    "the loops; best is the rate at which the actuator will be used."
)
_of_homing = Only(lambda given: given["kind"] == "homing", "on another kind than homing")
_not_homing = Only(lambda given: given["kind"] != "homing", "on a homing")
_holds = Only(lambda given: given["kind"] == "staircase" or "model" in given, "without a staircase or a --model")


@operation(
    Sampling,
    more=merged(EXCITATIONS, leave=("drive", "turns", "hold", "axes")),
    rare=("seed", "temperatures"),
)
def excite(
    run: Run,
    kind: Literal["recommended", "raised-cosine", "descending-tops", "staircase", "stage", "homing"],
    volts: tuple[float, ...] = (),
    *,
    output: Output,
    frequency: float | None = None,
    sample_rate: float | None = None,
    base: float = 0.0,
    present: float | None = None,
    limits: tuple[float, float] | None = None,
    slew_rate: float | None = None,
    hold: Annotated[float | None, _holds] = None,
    model: Annotated[Input | None, _of_homing] = None,
    axes: Annotated[str | None, Only(lambda given: given["kind"] == "stage", "without a stage")] = None,
    temperatures: Annotated[tuple[float, float] | None, _not_homing] = None,
    **options: Any,
) -> Result:
    """Write the voltage of an excitation, to play and record.

    KIND, with its VOLTS:

    recommended HIGHEST: all that identification needs, in one run of three minutes: major loops, falling tops, random
    turns at three speeds, two holds.
    raised-cosine PEAKS: cycles from the base to each of the peaks and back.
    descending-tops HIGHEST: cycles to tops that fall in equal steps; they determine all stiffnesses that loops can.
    staircase HIGHEST: steps up and down again with holds, which show creep.
    stage HIGHEST of each axis: one axis after the other, then all together.
    homing HIGHEST: up and back; with --model the shortest certified way to a known state.

    Parameters
    ----------
    output
        Write time and voltage here (CSV).
    frequency
        Cycles per second [Hz]; default: the slowest of 0.01, 0.02, 0.05 ... 1 that takes under two minutes, or four
        if it is the recommended one.
    hold
        Staircase: time at each voltage [s]; default 60. Homing of a model that creeps: time at either limit; default:
        as long as needed.
    model
        Model to home by the shortest waveform that is certified to end in a known state.
    axes
        Names of the axes of a stage, as x,y.
    temperatures
        Lowest and highest temperature in use [degC]; the answer says at which temperatures to record.
    """
    sampled: dict[str, Any] = {
        "sample_rate": sample_rate,
        "base": base,
        "present": present,
        "limits": limits,
        "slew_rate": slew_rate,
    }
    if hold is not None:
        options["hold"] = hold
    if model is not None:
        if volts:
            raise ModelError(argument="homing", need="either a highest voltage or --model, not both")
        return _home(run, model, output, hold, _HOMING if frequency is None else frequency, sampled)
    several = kind in ("raised-cosine", "stage")
    if len(volts) < (2 if kind == "stage" else 1) or not (several or len(volts) == 1):
        words = {"stage": "one for each of several axes", "raised-cosine": "one for each peak"}.get(kind, "one voltage")
        raise RecordError(argument="volts", got=f"{len(volts)} for {kind}", need=words)
    if limits is None and (highest := max(volts)) > 0:
        sampled["limits"] = (-highest, highest)
    if kind == "stage":
        options["axes"] = None if axes is None else axes.split(",")
    given = [volts] if several else volts

    longest = _RECOMMENDED if kind == "recommended" else _LONGEST * (len(volts) + 1 if kind == "stage" else 1)

    def made(slew_rate: float | None) -> tuple[Excitation, float]:
        def make(hertz: float) -> Excitation:
            return EXCITATIONS[kind](*given, drive=Sampling(hertz, **sampled | {"slew_rate": slew_rate}), **options)

        return _slow_enough(make, longest) if frequency is None else (make(frequency), frequency)

    found, hertz = made(slew_rate)
    free = found if slew_rate is None else made(None)[0]
    remarks: tuple[str, ...] = ()
    if not found.warnings and (_fastest(found) < _fastest(free) or found.duration > free.duration):
        remarks = (f"slower than without {slew_rate:g} V/s: {found.duration:.4g} s, not {free.duration:.4g} s",)
    warmth = temperatures_to_record(None, temperatures)
    if frequency is not None:
        return _written(found, output, warnings=remarks, temperatures=warmth)
    why = () if kind == "stage" else (_WHY,)
    return _written(found, output, f"{hertz:g} Hz by default", why, remarks, temperatures=warmth)


def _fastest(excitation: Excitation) -> float:
    """Return the largest abs(dv/dt) [V/s] of an excitation."""
    return excitation.sample_rate * float(np.abs(np.diff(excitation.voltage, axis=0)).max(initial=0.0))


def _slow_enough(make: Callable[[float], Excitation], longest: float) -> tuple[Excitation, float]:
    """Return the slowest excitation that is short enough; if there is none, one hardly longer than the fastest."""
    possible = [(make(frequency), frequency) for frequency in _FREQUENCIES]
    # With a warning the slew rate lengthens legs.
    possible = [one for one in possible if not one[0].warnings] or possible
    most = max(longest, _HARDLY * min(excitation.duration for excitation, _ in possible))
    return next(one for one in possible if one[0].duration <= most)


def _home(run: Run, model: Path, output: Path, hold: float | None, frequency: float, sampled: dict[str, Any]) -> Result:
    """Write the shortest homing of a model."""
    actuator = read_model(run, model)
    sampled["limits"] = sampled["limits"] or actuator.limits
    if sampled["limits"] is not None and not sampled["base"]:
        low, high = sampled["limits"]
        sampled["base"] = min(max(0.0, low), high)
    drive = Sampling(frequency, **sampled)
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
        what += f", from {first:.6g} to {last:.6g} V, at {_fastest(excitation):.4g} V/s at most"
    line = f"{excitation.name}: {size}, {what}{f'; {remark}' if remark else ''}: {output}"
    if temperatures:
        advice = (*advice, f"Record it at {words_of(temperatures)}, each with a column temperature_C.")
    return Result(fields, [line, *advice], warnings=fields["warnings"], good=good)


def refuse_cycles(made: Scan, cycles: int) -> None:
    """Raise an error for a number of cycles that is too large for a file."""
    if cycles < 0:
        raise RecordError(argument="cycles", got=cycles, need="a whole number, 0 or more")
    if made.samples > MOST_ROWS:
        raise RecordError(
            argument="scan",
            got=f"{made.samples} rows a period at {made.rate:g} Hz",
            need=f"at most {MOST_ROWS:g}",
            hint="try a lower sample rate, or a scan of fewer lines",
        )
    if cycles < 1:
        raise RecordError(argument="cycles", got=cycles, need="1 or more")
    if cycles * made.samples > MOST_ROWS:
        raise RecordError(
            argument="cycles",
            got=f"{cycles}, {cycles * made.samples:.4g} rows",
            need=f"at most {MOST_ROWS // made.samples} ({MOST_ROWS:g} rows)",
            hint="repeat one cycle instead",
        )


class Numbers(tuple[float, ...]):
    """Numbers separated by commas."""

    metavar = "UM,UM,..."

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the numbers in a text; raise ValueError if there are none."""
        return cls(map(float, text.split(",")))

    def __str__(self) -> str:
        """Return the text."""
        return ",".join(f"{one:.12g}" for one in self)


def _scan_options() -> list[Parameter]:
    """Return the options of all named scans; each option affects only its own scan."""
    found = []
    for name, option in OPTIONS.items():
        takes = [one for one, scan in SCANS.items() if name in scan.takes]
        condition = one_of("kind", takes)
        choices = isinstance(option.kind, tuple)
        default = option.default or (option.kind[0] if isinstance(option.kind, tuple) else "")
        text = f"{option.help}{f' [{option.unit}]' if option.unit else ''}{default and f'; default: {default}'}."
        kind = Literal[option.kind] if choices else Numbers if option.kind == "numbers" else option.kind
        found.append(Parameter(name, Kind.of(kind), None, text, conditions=(condition,)))
    return found


@operation(more=_scan_options(), rare=("rising", "edge"))
def scan(
    run: Run,
    kind: Literal["triangle", "raster", "steps"],
    *,
    output: Output,
    sample_rate: float | None = None,
    cycles: int = 1,
    **options: Any,
) -> Result:
    """Write the path of a scan: time and displacement of each axis.

    KIND: triangle or steps of one axis; raster of two. compensate computes the voltages for this path.

    Parameters
    ----------
    output
        Write time and displacement here (CSV).
    sample_rate
        Samples per second [Hz]; default: from the scan.
    cycles
        Cycles of the scan.
    """
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
