"""What every command shares: options, reading, refusing, progress and printing."""

from __future__ import annotations

import io
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst.cli.option_words import in_words_of
from dehyst.cli.terminal import echo, echo_json, guarded_streams, note, worded
from dehyst.records.formats.file_content import MOST

if TYPE_CHECKING:
    from dehyst.model import Actuator, State
    from dehyst.records import Record
    from dehyst.records.formats.columns import Table

PATH = click.Path(path_type=Path)
# Voltages farther outside of a model's limits than this part of their range have nothing to do with its records.
_FAR = 0.1

_FORCE = "dehyst.force"
_INTERRUPTED = 130


class Commands(click.Group):
    """Commands whose refusals are sentences on standard error and status 2, without a traceback."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        **extra: Any,
    ) -> Any:
        """Run as a program, whatever its standard streams are."""
        if not standalone_mode:
            return super().main(args, prog_name, complete_var, standalone_mode=False, **extra)
        with guarded_streams():
            try:
                sys.exit(super().main(args, prog_name, complete_var, standalone_mode=False, **extra))
            except click.ClickException as error:
                shown = io.StringIO()
                error.show(shown)
                for line in shown.getvalue().removesuffix("\n").split("\n"):
                    echo(line, err=True)
                sys.exit(error.exit_code)
            except click.Abort:
                sys.exit(_INTERRUPTED)

    def invoke(self, ctx: click.Context) -> Any:
        """Run; turn dehyst's own exceptions into messages."""
        from dehyst._errors import DehystError

        try:
            return super().invoke(ctx)
        except DehystError as error:
            command = self.get_command(ctx, ctx.invoked_subcommand or "") or self
            note(*in_words_of(command, [str(error)]))
            sys.exit(2)
        except MemoryError:
            note("not enough memory; resample the record or cut it")
            sys.exit(2)
        except KeyboardInterrupt:
            note("stopped by Ctrl-C")
            sys.exit(_INTERRUPTED)


def leave_cleanly(context: click.Context) -> None:
    """Leave on SIGTERM as on an error, so that drafts and temporary folders go; until the context ends."""

    def leave(number: int, _: object) -> None:
        sys.exit(128 + number)

    if threading.current_thread() is threading.main_thread():
        before = signal.signal(signal.SIGTERM, leave)
        context.call_on_close(lambda: signal.signal(signal.SIGTERM, before))


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


def columns_options(command: Callable[..., None]) -> Callable[..., None]:
    """Options that say which column of a file is what."""
    for name, text in (
        ("--displacement", "Column of the displacement, e.g. displacement_um."),
        ("--voltage", "Column of the voltage, e.g. drive_V."),
        ("--time", "Column of the time, e.g. time_s."),
    ):
        command = click.option(name, metavar="NAME", help=f"{text} [default: found by its name]")(command)
    command = size_option(command)
    return click.option("--sample-rate", type=float, metavar="HZ", help="Instead of a time column.")(command)


def size_option(command: Callable[..., None]) -> Callable[..., None]:
    """The option that lets large files in; its value in bytes."""
    return click.option(
        "--max-size",
        "max_bytes",
        type=float,
        metavar="MB",
        default=MOST / 1e6,
        show_default=f"{MOST / 1e6:g}",
        callback=lambda _context, _option, size: size * 1e6,
        help="Largest file that is read, and most memory for its numbers.",
    )(command)


def json_option(command: Callable[..., None]) -> Callable[..., None]:
    """The switch to JSON."""
    return click.option("--json", "as_json", is_flag=True, help="Print JSON for a program.")(command)


def start_option(command: Callable[..., None]) -> Callable[..., None]:
    """The option that says in what state a model starts."""
    return click.option(
        "--start",
        type=click.Choice(["top", "bottom", "relaxed", "homed"]),
        default="top",
        show_default=True,
        help="State before the first sample: turned at the top or bottom of the identified range, relaxed at 0 V, or "
        "as 'dehyst excite homing --model' leaves it without other options: another --base or --hold ends elsewhere.",
    )(command)


def read_records(paths: tuple[Path, ...], columns: dict[str, Any]) -> list[Record]:
    """Read records from files."""
    from dehyst.records import read

    return [read(path, **columns) for path in paths]


def force_option(command: Callable[..., None]) -> Callable[..., None]:
    """The switch that lets outputs replace files of others; `refuse_overwriting` looks at it."""

    def keep(ctx: click.Context, _: click.Parameter, value: bool) -> None:
        ctx.meta[_FORCE] = value

    return click.option(
        "--force", is_flag=True, expose_value=False, callback=keep, help="Replace files that dehyst did not write."
    )(command)


def refuse_overwriting(inputs: list[Path], *outputs: Path | None) -> None:
    """Refuse outputs that are inputs, or files of others unless there is --force, before anything is read."""
    from dehyst._errors import FileFormatError

    named = [output for output in outputs if output is not None]
    if len({os.path.realpath(output) for output in named}) < len(named):
        raise FileFormatError(f"{outputs[0]}: is the name of two outputs; give each its own")
    for output in named:
        if any(_same(output, path) for path in inputs):
            raise FileFormatError(f"{output}: is an input of this command too; give another name for the output")
        refuse_replacing(output)
        if output.is_dir():
            raise FileFormatError(f"{output}: is a folder; give the name of a file in it")
        if not Path(os.path.realpath(output)).parent.is_dir():
            raise FileFormatError(f"{output}: the folder {output.parent} does not exist; create it first")


def refuse_replacing(*outputs: Path | None) -> None:
    """Refuse to write over files of others unless there is --force: at first, and again when all is computed."""
    from dehyst._io.marks import demand_replaceable

    context = click.get_current_context()
    # An export takes its own as an argument.
    force = bool(context.meta.get(_FORCE) or context.params.get("force"))
    for output in outputs:
        if output is not None:
            demand_replaceable(output, force=force)


def _same(one: Path, other: Path) -> bool:
    """Whether two names are of one file."""
    try:
        return one.samefile(other)
    except OSError:
        return os.path.realpath(one) == os.path.realpath(other)


def time_of_table(table: Table, size: int, columns: dict[str, Any]) -> dict[str, Any]:
    """The time column, if the file has one or a rate was given."""
    from dehyst.records.files import time_of

    if columns["time"] is None and columns["sample_rate"] is None and not table.has("time"):
        return {}
    return {"time_s": time_of(table, size, columns["time"], columns["sample_rate"])}


def path_of(trajectory: Path, wanted: str | None, max_bytes: float = MOST) -> tuple[Any, dict[str, Any]]:
    """Displacement of a trajectory file and, if it has one, its time column."""
    from dehyst._errors import FileFormatError
    from dehyst.records import read_table

    table = read_table(trajectory, max_bytes=max_bytes)
    try:
        path = table.column("displacement", wanted)
    except FileFormatError as error:
        # --displacement is the records' column here.
        raise FileFormatError(str(error).replace("displacement=", "wanted=")) from error
    return path, time_of_table(table, path.size, {"time": None, "sample_rate": None})


def read_model(path: Path) -> Actuator:
    """Read a model, and warn of one that was not found to be of use."""
    from dehyst.model import Actuator, Outcome

    actuator = Actuator.load(path)
    outcome = getattr(Outcome, str(actuator.provenance.get("outcome")), None)
    if isinstance(outcome, Outcome) and not outcome.good:
        note(f"{path}: when this model was identified: {outcome.value}")
    return actuator


def start_within(actuator: Actuator, start: str, limits: tuple[float, float] | None) -> State:
    """Return the state that the word of the option means, or the nearest that the limits let the actuator have."""
    from dehyst.control.reachable import state_within_limits

    state, allowed = start_state(actuator, start), limits or actuator.limits
    return state if allowed is None else state_within_limits(actuator, state, allowed)


def start_state(actuator: Actuator, start: str) -> State:
    """Return the state that the word of the option means."""
    knots = actuator.spring.displacement
    if start == "relaxed":
        return actuator.relaxed()
    if start == "homed":
        return _homed(actuator)
    return actuator.turned(float(knots[-1])) if start == "top" else actuator.turned(float(knots[0]), rising=False)


def _homed(actuator: Actuator) -> State:
    """The state that the homing's own voltage, played as the command makes it by default, leads to."""
    from dehyst.control import shortest_homing
    from dehyst.waveforms import Sampling

    low, high = actuator.limits or (0.0, 0.0)
    end = min(max(0.0, low), high)
    return shortest_homing(actuator, present=end, stiff_only=True, drive=Sampling()).state


def came_from(actuator: Actuator, start: str, state: State | None = None) -> str:
    """What the first sample takes for granted: the state that the word means, or the one that was made of it."""
    voltage = f"{actuator.voltage(start_within(actuator, start, None) if state is None else state):.4g} V"
    said = {"relaxed": f"(from rest, relaxed, at {voltage})", "homed": f"(homed, at {voltage})"}
    return said.get(start, f"(coming from the {start}, {voltage})")


def state_dict(state: State) -> dict[str, Any]:
    """Return a state as JSON values."""
    more = {"creep_m": state.creep, "motion_m_and_m_per_s": state.motion}
    return {
        "displacement_m": state.displacement,
        "carts_m": state.carts.tolist(),
        **{name: values.tolist() for name, values in more.items() if values.size},
    }


def lagging(displacement: Any, actuator: Actuator, time: dict[str, Any]) -> Any:
    """The displacement as a sensor shows it, which lags by the actuator's delay."""
    import numpy as np

    from dehyst._errors import FileFormatError

    if "time_s" not in time:
        raise FileFormatError("--lag needs the time of each sample: a time column, or --sample-rate")
    return np.interp(time["time_s"] - actuator.delay, time["time_s"], displacement)


def before_and_after(actuator: Actuator, first: float, start: str, state: State, slew: float | None) -> list[str]:
    """What the file cannot hold: the way from the state to its first voltage, and the lag of the stage."""
    said = []
    present = actuator.voltage(state)
    if abs(first - present) > 0.01 * max(abs(value) for value in (present, *(actuator.limits or ()))):
        within = "slowly" if slew is None else "within the slew rate"
        said.append(
            f"the first voltage, {first:.6g} V, is {abs(first - present):.6g} V away from that of the start, "
            f"{present:.6g} V: ramp there {within} before you play the file"
        )
    if actuator.creep is not None and start != "homed":
        longest = float(actuator.creep.time_constants[-1])
        said.append(
            f"this model creeps, and --start {start} takes it to have stood there for long, beside {longest:.3g} s; if "
            "it has not, it will be off: make a homing (dehyst excite homing --model) and use --start homed"
        )
    return [*said, *late_words(actuator)]


def late_words(actuator: Actuator) -> list[str]:
    """What is to be said of the lag of the stage."""
    if not actuator.delay:
        return []
    return [f"the displacement was measured to lag by {actuator.delay * 1e3:.4g} ms: expect it that much later"]


def outside_words(actuator: Actuator, voltage: Any) -> tuple[int, bool, list[str]]:
    """How many voltages [V] lie outside the identified range, whether one lies far outside, and a warning if so.

    Far is more than a tenth of the range away: there the model is a straight line that nothing was measured of.
    """
    import numpy as np

    if actuator.limits is None:
        return 0, False, []
    low, high = actuator.limits
    beyond = np.maximum(low - voltage, voltage - high)
    count = int(np.count_nonzero(beyond > 0))
    if not count:
        return 0, False, []
    said = f"{count} of {voltage.size} voltages lie outside the identified range {range_words(actuator)}: extrapolated"
    far = float(beyond.max()) > _FAR * (high - low)
    if far:
        said += (
            f", and far: {float(voltage[int(np.argmax(beyond))]):.6g} V lies {float(beyond.max()):.6g} V beyond, "
            f"more than {100 * _FAR:.0f} % of the range. Nothing was measured there: record these voltages and "
            "identify again"
        )
    return count, far, [said]


def range_words(actuator: Actuator) -> str:
    """Write the identified range."""
    low, high = actuator.limits or (0.0, 0.0)
    return f"{low:.6g} to {high:.6g} V"


def conclude(as_json: bool, result: dict[str, Any], lines: str | Iterable[str], warnings: Iterable[str]) -> None:
    """Print warnings, then the result as one or more lines or as JSON."""
    warnings = worded(warnings)
    result = {**result, "warnings": list(warnings)} if "warnings" in result else result
    for warning in warnings:
        note(warning)
    if as_json:
        echo_json(result)
        return
    for line in [lines] if isinstance(lines, str) else lines:
        echo(line)
