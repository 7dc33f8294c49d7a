"""The command line: a skin. Exit status 0 done, 1 done but not good enough, 2 wrong input."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst.version import __version__

if TYPE_CHECKING:
    from dehyst.actuator import Actuator
    from dehyst.files import Table
    from dehyst.model import Fit, State
    from dehyst.record import Record

_PATH = click.Path(path_type=Path)


class Commands(click.Group):
    """Commands whose refusals are sentences on standard error and status 2, without a traceback."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run; turn dehyst's own exceptions into messages."""
        from dehyst._errors import DehystError

        try:
            return super().invoke(ctx)
        except DehystError as error:
            click.echo(f"dehyst: {error}", err=True)
            sys.exit(2)
        except MemoryError:
            click.echo("dehyst: not enough memory; resample the record or cut it", err=True)
            sys.exit(2)


class ManyToValidate(click.Command):
    """A command whose --validate takes every name up to the next option."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Say --validate before each of its names, as click wants it."""
        spread: list[str] = []
        inside = False
        for word in args:
            if inside and not word.startswith("-") and spread[-1] != "--validate":
                spread.append("--validate")
            inside = word == "--validate" or (inside and not word.startswith("-"))
            spread.append(word)
        return super().parse_args(ctx, spread)


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="dehyst")
def main() -> None:
    """Take the hysteresis out of piezoelectric actuators."""


def _columns(command: Callable[..., None]) -> Callable[..., None]:
    """Options that say which column of a file is what."""
    for name, text in (
        ("--displacement", "Column of the displacement, e.g. displacement_um."),
        ("--voltage", "Column of the voltage, e.g. drive_V."),
        ("--time", "Column of the time, e.g. time_s."),
    ):
        command = click.option(name, metavar="NAME", help=f"{text} [default: found by its name]")(command)
    return click.option("--sample-rate", type=float, metavar="HZ", help="Instead of a time column.")(command)


def _json_option(command: Callable[..., None]) -> Callable[..., None]:
    return click.option("--json", "as_json", is_flag=True, help="Print JSON for a program.")(command)


def _start_option(command: Callable[..., None]) -> Callable[..., None]:
    return click.option(
        "--start", type=click.Choice(["top", "bottom", "relaxed"]), default="top", show_default=True,
        help="State before the first sample: turned at the top or bottom of the identified range, or relaxed at 0 V.",
    )(command)  # fmt: skip


@main.command(cls=ManyToValidate)
@click.argument("records", nargs=-1, required=True, metavar="RECORD...", type=_PATH)
@click.option("-o", "--output", type=_PATH, help="Write the model here (JSON).")
@click.option(
    "--validate",
    multiple=True,
    type=_PATH,
    metavar="RECORD...",
    help="Simulate these records only, all named up to the next option.",
)
@click.option("--report", type=_PATH, help="Write a self-contained HTML report here.")
@click.option(
    "--method", type=click.Choice(["record", "breakpoints", "antisymmetric"]), default="record", show_default=True
)
@click.option(
    "--elements", type=int, metavar="N", help="Number of slip elements.  [default: 20; 10 for the paper's methods]"
)
@click.option("--norm", type=click.Choice(["l1", "l2", "linf"]), default="l1", show_default=True)
@click.option("--knots", type=int, metavar="M", help="Knots of the spring.  [default: N + 1]")
@click.option(
    "--slope-floor", type=float, default=0.2, show_default=True, help="Least slope of the spring / mean slope."
)
@click.option("--delay", type=float, metavar="SECONDS", help="Lag of the displacement.  [default: estimated]")
@click.option("--shared-datum", is_flag=True, help="No record zeroed its sensor anew.")
@click.option("--no-drift", is_flag=True, help="Do not set the drift of a record aside.")
@_columns
@_json_option
def identify(
    records: tuple[Path, ...], output: Path | None, validate: tuple[Path, ...], report: Path | None, method: Any,
    elements: int | None, norm: Any, knots: int | None, slope_floor: float, delay: float | None, shared_datum: bool,
    no_drift: bool, as_json: bool, **columns: Any,
) -> None:  # fmt: skip
    """Identify an actuator from RECORDs of voltage and displacement."""
    from dehyst.identify import identify as run

    _refuse_overwriting([*records, *validate], output, report)
    tell = _progress()
    tell("reading")
    fit = run(
        _read(records, columns), validate=_read(validate, columns), method=method, elements=elements, norm=norm,
        knots=knots, slope_floor=slope_floor, delay=delay, shared_datum=shared_datum, drift=not no_drift, throw=False,
        progress=tell,
    )  # fmt: skip
    if output is not None and fit.actuator is not None:
        fit.actuator.save(output)
    if report is not None:
        from dehyst.report import write_report

        tell("drawing the report")
        write_report(report, fit, command=shlex.join(["dehyst", *sys.argv[1:]]))
    tell("")
    if as_json:
        click.echo(json.dumps(_finite(fit.as_dict()), indent=1))
    else:
        _print_fit(fit, output, report)
    sys.exit(0 if fit.outcome.good else 1)


@main.command()
@click.argument("model", type=_PATH)
@click.argument("voltage_file", metavar="VOLTAGE", type=_PATH)
@click.option("-o", "--output", type=_PATH, required=True, help="Write time, voltage and displacement here (CSV).")
@click.option("--lag", is_flag=True, help="Let the displacement lag the voltage as it was measured to do.")
@_start_option
@_columns
@_json_option
def simulate(
    model: Path, voltage_file: Path, output: Path, lag: bool, start: str, as_json: bool, **columns: Any
) -> None:
    """Displacement that a VOLTAGE file causes; adds displacement_um."""
    from dehyst.actuator import Actuator
    from dehyst.files import read_table, write_columns

    _refuse_overwriting([model, voltage_file], output)
    actuator = Actuator.load(model)
    table = read_table(voltage_file)
    voltage = table.column("voltage", columns["voltage"])
    time = _time(table, voltage.size, columns)
    motion = actuator.simulate(voltage, state=_start(actuator, start))
    displacement = _lagging(motion.displacement, actuator, time) if lag else motion.displacement
    write_columns(output, {**time, "voltage_V": voltage, "displacement_um": displacement * 1e6})
    outside = _outside(actuator, voltage)
    said = [f"{outside} voltages lie outside the identified range {_range(actuator)}: extrapolated"] if outside else []
    if actuator.delay and not lag:
        said.append(f"the displacement was measured to lag by {actuator.delay * 1e3:.4g} ms; --lag puts that in")
    result = {"samples": voltage.size, "warnings": said, "state": _state(motion.state), "output": str(output)}
    _conclude(as_json, result, f"{voltage.size} samples {_came_from(actuator, start)}: {output}", said)


@main.command()
@click.argument("model", type=_PATH)
@click.argument("trajectory", type=_PATH)
@click.option("-o", "--output", type=_PATH, required=True, help="Write time, displacement and voltage here (CSV).")
@click.option(
    "--limits", type=(float, float), metavar="LOW HIGH", help="Voltages allowed.  [default: those of the records]"
)
@click.option("--slew", type=float, metavar="V/S", help="Largest slew rate.")
@_start_option
@_columns
@_json_option
def compensate(
    model: Path, trajectory: Path, output: Path, limits: tuple[float, float] | None, slew: float | None, start: str,
    as_json: bool, **columns: Any,
) -> None:  # fmt: skip
    """Voltage that makes the actuator follow a TRAJECTORY; adds voltage_V, within limits."""
    from dehyst.actuator import Actuator
    from dehyst.compensator import Compensator
    from dehyst.files import read_table, write_columns

    _refuse_overwriting([model, trajectory], output)
    actuator = Actuator.load(model)
    table = read_table(trajectory)
    wanted = table.column("displacement", columns["displacement"])
    time = _time(table, wanted.size, columns)
    command = Compensator(actuator, limits, slew).trajectory(
        wanted, time=time.get("time_s"), state=_start(actuator, start)
    )
    write_columns(output, {**time, "displacement_um": wanted * 1e6, "voltage_V": command.voltage,
                           "expected_um": command.displacement * 1e6})  # fmt: skip
    low, high = float(command.voltage.min()), float(command.voltage.max())
    said = [*command.warnings, *_before_and_after(actuator, float(command.voltage[0]), start, slew)]
    result = {"samples": wanted.size, "clamped": int(command.clamped.sum()), "lowest_V": low, "highest_V": high,
              "warnings": said, "state": _state(command.state), "output": str(output)}  # fmt: skip
    line = f"{wanted.size} samples, {low:.6g} to {high:.6g} V {_came_from(actuator, start)}: {output}"
    _conclude(as_json, result, line, said)
    sys.exit(1 if command.clamped.any() else 0)


@main.command()
@click.option(
    "-o", "--output", type=_PATH, default=Path("dehyst-demo"), show_default=True, help="Folder for the files."
)
@click.option("--report/--no-report", default=True, help="Draw the report (needs matplotlib).")
@_json_option
def demo(output: Path, report: bool, as_json: bool) -> None:
    """Record, identify, compensate and verify on an embedded virtual actuator."""
    from dehyst import demo as journey

    tell = _progress()
    result = journey.run(tell)
    tell("writing")
    written = journey.write(result, output, report=report)
    tell("")
    numbers = result.as_dict()
    if as_json:
        click.echo(json.dumps(_finite({**numbers, "written": [str(path) for path in written]}), indent=1))
        return
    _print_fit(result.fit, None, None)
    click.echo("\nTracking a path with nine reversals, largest error in % of the stroke")
    for name, key in (("linear feedforward (end-point ratio)", "linear"), ("dehyst", "compensated")):
        largest, rms = numbers[key]["largest_percent"], numbers[key]["rms_percent"]
        paper = numbers["paper"][f"{key}_largest_percent"]
        click.echo(f"  {name:<38}{largest:7.2f} %   RMS {rms:5.2f} %   (paper {paper:5.2f} %)")
    click.echo(f"\nWritten to {output}/: {', '.join(path.name for path in written)}")


def _read(paths: tuple[Path, ...], columns: dict[str, Any]) -> list[Record]:
    from dehyst.files import read

    return [read(path, **columns) for path in paths]


def _refuse_overwriting(inputs: list[Path], *outputs: Path | None) -> None:
    """An output that is also an input would be lost: refuse before anything is read."""
    from dehyst._errors import FileFormatError

    taken = {path.resolve() for path in inputs}
    named = [output.resolve() for output in outputs if output is not None]
    if len(set(named)) < len(named):
        raise FileFormatError(f"{outputs[0]}: is the name of two outputs; give each its own")
    for output in outputs:
        if output is not None and output.resolve() in taken:
            raise FileFormatError(f"{output}: is an input of this command too; give another name for the output")
        if output is not None and not output.resolve().parent.is_dir():
            raise FileFormatError(f"{output}: the folder {output.parent} does not exist; create it first")


def _time(table: Table, size: int, columns: dict[str, Any]) -> dict[str, Any]:
    """The time column, if the file has one or a rate was given."""
    from dehyst.files import time_of

    if columns["time"] is None and columns["sample_rate"] is None and not table.has("time"):
        return {}
    return {"time_s": time_of(table, size, columns["time"], columns["sample_rate"])}


def _start(actuator: Actuator, start: str) -> State:
    knots = actuator.spring.displacement
    if start == "relaxed":
        return actuator.relaxed()
    return actuator.turned(float(knots[-1])) if start == "top" else actuator.turned(float(knots[0]), rising=False)


def _came_from(actuator: Actuator, start: str) -> str:
    """What the first sample takes for granted."""
    voltage = f"{actuator.voltage(_start(actuator, start)):.4g} V"
    return f"(from rest, relaxed, at {voltage})" if start == "relaxed" else f"(coming from the {start}, {voltage})"


def _state(state: State) -> dict[str, Any]:
    return {"displacement_m": state.displacement, "carts_m": state.carts.tolist()}


def _lagging(displacement: Any, actuator: Actuator, time: dict[str, Any]) -> Any:
    """The displacement as a sensor shows it, which lags by the actuator's delay."""
    import numpy as np

    from dehyst._errors import FileFormatError

    if "time_s" not in time:
        raise FileFormatError("--lag needs the time of each sample: a time column, or --sample-rate")
    return np.interp(time["time_s"] - actuator.delay, time["time_s"], displacement)


def _before_and_after(actuator: Actuator, first: float, start: str, slew: float | None) -> list[str]:
    """What the file cannot hold: the way to its first voltage, and the lag of the stage."""
    said = []
    present = actuator.voltage(_start(actuator, start))
    if slew is not None and abs(first - present) > 0.01 * abs(present):
        said.append(
            f"the first voltage, {first:.6g} V, is {abs(first - present):.6g} V away from that of the start, "
            f"{present:.6g} V: ramp there within the slew rate before you play the file"
        )
    if actuator.delay:
        said.append(f"the displacement was measured to lag by {actuator.delay * 1e3:.4g} ms: expect it that much later")
    return said


def _outside(actuator: Actuator, voltage: Any) -> int:
    return (
        0 if actuator.limits is None else int(((voltage < actuator.limits[0]) | (voltage > actuator.limits[1])).sum())
    )


def _range(actuator: Actuator) -> str:
    low, high = actuator.limits or (0.0, 0.0)
    return f"{low:.6g} to {high:.6g} V"


def _progress() -> Callable[[str], None]:
    """One line on a terminal that is overwritten; nothing in a file or a pipe."""
    if not sys.stderr.isatty():
        return lambda _: None

    def tell(words: str) -> None:
        click.echo(f"\r\033[K{words}{' ...' if words else ''}", err=True, nl=False)

    return tell


def _conclude(as_json: bool, result: dict[str, Any], line: str, warnings: Any) -> None:
    for warning in warnings:
        click.echo(f"dehyst: {warning}", err=True)
    click.echo(json.dumps(_finite(result), indent=1) if as_json else line)


def _finite(value: Any) -> Any:
    """The same with null for numbers that JSON has not."""
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not abs(value) <= sys.float_info.max else value


def _print_fit(fit: Fit, output: Path | None, report: Path | None) -> None:
    click.echo(fit.outcome.value)
    if fit.errors:
        width = max(6, *(len(error.record) for error in fit.errors))
        click.echo(
            f"\n{'':<{width}}  {'':<10} {'':>8} {'':>8}  {'of the stroke':^18}  {'':^18}  {'with its drift':^18}"
        )
        click.echo(
            f"{'record':<{width}}  {'role':<10} {'samples':>8} {'left out':>8}" + 3 * f"  {'largest':>9}{'RMS':>9}"
        )
    for error in fit.errors:
        drift, rms = 100 * error.largest_with_drift / error.stroke, 100 * error.rms_with_drift / error.stroke
        click.echo(
            f"{error.record:<{width}}  {error.role:<10} {error.samples:>8} {error.left_out:>8}"
            f"  {error.largest_percent:>7.3f} %{error.rms_percent:>7.3f} %"
            f"  {error.largest * 1e9:>6.0f} nm{error.rms * 1e9:>6.0f} nm  {drift:>7.3f} %{rms:>7.3f} %"
        )
    for title, sentences in (("Repaired or left out", fit.repairs), ("To know", fit.remarks)):
        if sentences:
            click.echo(f"\n{title}:")
            for sentence in sentences:
                click.echo(f"  - {sentence}")
    click.echo(f"\nSolver: {fit.status}, duality gap {fit.gap:.1g}")
    for name, path in (("Model", output if fit.actuator is not None else None), ("Report", report)):
        if path is not None:
            click.echo(f"{name}: {path}")
