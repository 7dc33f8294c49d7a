"""What the commands share: options, reading, refusals and the printing of results."""

from __future__ import annotations

import io
import os
import shlex
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import click

from dehyst.cli.output.terminal import echo, echo_json, error_text, flag_of, guarded_streams, note, options_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from dehyst._errors import DehystError
    from dehyst.model import Actuator

PATH = click.Path(path_type=Path)

_INTERRUPTED = 130
# Name of what a refused command prints beside its error as JSON.
REFUSED = "dehyst.refused"
# Significant digits of a table: 0.1 nV of 100 V.
_DIGITS = 12


class Commands(click.Group):
    """Commands that report errors as sentences on standard error, with status 2 and without a traceback.

    Help lists them under headings: `journey` maps each heading to names of commands; others come last.
    """

    journey: Mapping[str, Sequence[str]] = MappingProxyType({})

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands in the order of the journey."""
        known = [name for names in self.journey.values() for name in names if name in self.commands]
        return known + sorted(set(self.commands) - set(known))

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands under their headings, each with the first sentence of its help."""
        names = self.list_commands(ctx)
        width = max(map(len, names), default=0)
        headings = {heading: [name for name in given if name in names] for heading, given in self.journey.items()}
        rest = [name for name in names if not any(name in given for given in headings.values())]
        headings["Commands" if not headings else "More"] = rest
        for heading, given in headings.items():
            short = formatter.width - 6 - width
            rows = [(name.ljust(width), self.commands[name].get_short_help_str(short)) for name in given]
            if rows:
                with formatter.section(heading):
                    formatter.write_dl(rows)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command; suggest the nearest name if there is none."""
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            near = get_close_matches(args[0], self.list_commands(ctx), 3)
            if not near or "Did you mean" in error.format_message():
                raise
            raise click.UsageError(f"{error.message} Did you mean {' or '.join(map(repr, near))}?", ctx) from error

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        **extra: Any,
    ) -> Any:
        """Run as a program, even with closed or full standard streams."""
        self._words = list(sys.argv[1:] if args is None else args)
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
                if "--json" in self._words:
                    echo_json({"error": {"kind": type(error).__name__, "message": error.format_message()}})
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
            self._report(command, error, ctx.meta.get(REFUSED, {}))
            sys.exit(2)
        except MemoryError:
            self._report(self, DehystError("not enough memory; resample the record or cut it"), {})
            sys.exit(2)
        except KeyboardInterrupt:
            note("stopped by Ctrl-C")
            sys.exit(_INTERRUPTED)

    def _report(self, command: Any, error: DehystError, known: Mapping[str, Any]) -> None:
        """Print an error, and commands with options that would mend it; with --json as JSON too, beside the known."""
        from dehyst._errors import DecimalSignError
        from dehyst._text import escaped
        from dehyst.records.tables import ColumnsError, notes_on

        options, trials = options_of(command), []
        suggestion: dict[str, str] = {}
        if isinstance(error, DecimalSignError) and "decimal" in options:
            trials = [{"--decimal": sign} for sign in (".", ",")]
        if isinstance(error, ColumnsError) and error.options and error.options.keys() <= options.keys():
            suggestion = error.options
            trials = [{flag_of(options[name]): value for name, value in suggestion.items()}]
            error.message = error.reason
        note(sentence := error_text(error, command))
        if trials:
            echo("To try:" if len(trials) == 1 else "See which numbers are right, with one of:", err=True)
        for trial in trials:
            echo(f"  {shlex.join(['dehyst', *_with_options(self._words, trial)])}", err=True)
        for advice in notes_on(suggestion) if suggestion else ():
            echo(advice, err=True)
        if "--json" in self._words:
            echo_json(
                {**known, "error": {**error.as_dict(), "message": escaped(sentence), "suggestion": dict(suggestion)}}
            )


def _with_options(words: list[str], given: dict[str, str]) -> list[str]:
    """Return a command with options in the place of those of the same name."""
    kept: list[str] = []
    skip = False
    for word in words:
        if not skip and word.split("=")[0] not in given:
            kept.append(word)
        skip = word in given
    return [*kept, *(part for option in given.items() for part in option)]


def leave_cleanly(context: click.Context) -> None:
    """End on SIGTERM as on an error, so that drafts and temporary folders are removed; until the context ends."""

    def leave(number: int, _: object) -> None:
        sys.exit(128 + number)

    if threading.current_thread() is threading.main_thread():
        before = signal.signal(signal.SIGTERM, leave)
        context.call_on_close(lambda: signal.signal(signal.SIGTERM, before))


class ManyToValidate(click.Command):
    """A command whose --validate takes every name up to the next option."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Insert --validate before each of its names, as click requires."""
        spread: list[str] = []
        inside = False
        for word in args:
            if inside and not word.startswith("-") and spread[-1] != "--validate":
                spread.append("--validate")
            inside = word == "--validate" or (inside and not word.startswith("-"))
            spread.append(word)
        return super().parse_args(ctx, spread)


def limits_option(default: str = "those of the records", words: str = "Voltages allowed.") -> Callable[..., Any]:
    """Return the option that sets the voltage limits."""
    text = f"{words}  [default: {default}]"
    return click.option("--limits", type=(float, float), metavar="LOW HIGH", help=text)


slew_option = click.option("--slew", type=float, metavar="V/S", help="Largest slew rate.")
report_option = click.option("--report", type=PATH, help="Write a self-contained HTML page here.")


def json_option(command: Callable[..., None]) -> Callable[..., None]:
    """Add the switch to JSON."""
    return click.option("--json", "as_json", is_flag=True, help="Print JSON for a program.")(command)


def verbose_option(command: Callable[..., None]) -> Callable[..., None]:
    """Add the switch to all of a printed result."""
    return click.option("--verbose", is_flag=True, help="Print all that was found, not only what to expect.")(command)


def command_line() -> str:
    """Return the running command as it was typed."""
    return shlex.join(["dehyst", *sys.argv[1:]])


def given(*names: str) -> list[str]:
    """Return those of the running command's parameters, by default all, that were given and are no defaults."""
    context = click.get_current_context()
    names = names or tuple(one.name for one in context.command.params if one.name is not None)
    defaults = (click.core.ParameterSource.DEFAULT, click.core.ParameterSource.DEFAULT_MAP)
    return [name for name in names if context.get_parameter_source(name) not in defaults]


def refuse_unused(beside: str, *takes: str) -> None:
    """Refuse each option that was given and has no effect on the input at hand, before anything is read or written.

    `beside`: the input, as "with a stage". `takes`: the parameters that have an effect. An option that is added to a
    command is refused until its name is here.
    """
    refuse_given(beside, *(name for name in given() if name not in (*takes, "as_json", "verbose")))


def refuse_given(beside: str, *names: str) -> None:
    """Refuse those of some options that were given: they have no effect on the input at hand."""
    context = click.get_current_context()
    unused = given(*names) if names else []
    for option in context.command.params:
        if isinstance(option, click.Option) and option.name in unused:
            flag = (option.opts, option.secondary_opts)[context.params.get(option.name) is False][-1]
            raise click.UsageError(f"{flag}: has no effect {beside}; leave it out")


def echo_files(**paths: Path | None) -> None:
    """Print the files that were written, each with its name."""
    for name, path in paths.items():
        if path is not None:
            echo(f"{name}: {path}")


def force_option(command: Callable[..., None]) -> Callable[..., None]:
    """Add the switch that lets outputs replace files that do not begin as they do."""

    def protect(ctx: click.Context, _: click.Parameter, value: bool) -> bool:
        from dehyst._io import protecting

        ctx.with_resource(protecting(force=value))
        return value

    return click.option(
        "--force", is_flag=True, expose_value=False, callback=protect, help="Replace files of another kind too."
    )(command)


def refuse_overwriting(inputs: list[Path], *outputs: Path | None) -> None:
    """Refuse outputs that are inputs or, without --force, replace other files, before anything is read."""
    from dehyst._errors import FileFormatError
    from dehyst._io import demand_alike

    named = [output for output in outputs if output is not None]
    if not named and given("force"):
        raise click.UsageError("--force: has no effect without an output; leave it out")
    joined = click.get_current_context().params.get("join")
    inputs = inputs if joined is None else [*inputs, joined]
    if len({os.path.realpath(output) for output in named}) < len(named):
        raise FileFormatError(f"{outputs[0]}: is the name of two outputs; give each its own name")
    for output in named:
        if str(output) == "-":
            raise FileFormatError("-: is no name of a file, and standard output holds the summary; name a file")
        if any(_same(output, path) for path in inputs):
            raise FileFormatError(f"{output}: is also an input of this command; give another name for the output")
        demand_alike(output)
        if output.is_dir():
            raise FileFormatError(f"{output}: is a folder; give the name of a file in it")
        if not Path(os.path.realpath(output)).parent.is_dir():
            raise FileFormatError(f"{output}: the folder {output.parent} does not exist; create it first")


def _same(first: Path, second: Path) -> bool:
    """Return whether two names are of one file."""
    try:
        return first.samefile(second)
    except OSError:
        return os.path.realpath(first) == os.path.realpath(second)


def write_output(path: Path, columns: Mapping[str, ArrayLike]) -> None:
    """Write a table as `write_columns` does, without the tails of rounding errors."""
    from dehyst.records import write_columns

    write_columns(path, columns, digits=_DIGITS)


def read_model(path: Path) -> Actuator:
    """Read a model, and warn if its identification was not usable."""
    from dehyst._errors import FileFormatError
    from dehyst.model import Actuator

    try:
        actuator = Actuator.load(path)
    except FileFormatError as error:
        if (model := _other_model(path)) is None:
            raise
        raise FileFormatError(f"{path}: is no model, but {model} is one; give MODEL first, then {path}") from error
    known = actuator.identification
    if known is not None and known.outcome is not None and not known.outcome.good:
        note(f"{path}: when this model was identified: {known.outcome.value}")
    if known is not None and known.provisional:
        note(f"{path}: is provisional, because its identification did not end; it was not checked. Identify again")
    return actuator


def _other_model(path: Path) -> Path | None:
    """Return another argument of the running command, if that one is a model."""
    from dehyst._io import format_of
    from dehyst.model.serialization import FORMAT

    context = click.get_current_context()
    given = [context.params.get(one.name or "") for one in context.command.params if isinstance(one, click.Argument)]
    files = [each for value in given for each in (value if isinstance(value, tuple) else (value,))]
    return next((f for f in files if isinstance(f, Path) and f != path and format_of(f) == FORMAT), None)


def conclude(as_json: bool, result: dict[str, Any], lines: str | Iterable[str], warnings: Iterable[str]) -> None:
    """Print warnings, then the result as one or more lines or as JSON."""
    for warning in warnings:
        note(warning)
    if as_json:
        echo_json(result)
        return
    for line in [lines] if isinstance(lines, str) else lines:
        echo(line)
