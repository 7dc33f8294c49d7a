"""The commands of `dehyst`, made of the operations: options, messages, exit status. Each is loaded when it is used."""

from __future__ import annotations

import io
import shlex
import signal
import sys
import warnings
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import Any

import click

from dehyst._errors import DecimalSignError, DehystError, DeviceError, LinkError, SensorError
from dehyst._text import escaped
from dehyst._version import __version__
from dehyst.cli.terminal import TerminalRun, echo, echo_json, guarded_streams, note
from dehyst.operations.declaration import Kind, Operation, Parameter, flag
from dehyst.operations.files import Columns
from dehyst.operations.registry import JOURNEY, find
from dehyst.operations.run import perform, terminable
from dehyst.records.columns import text_of
from dehyst.records.tables import ColumnsError, notes_on

_INTERRUPTED = 130
_FIRST_STEPS = """\
dehyst demo                                     see it work on a virtual actuator
dehyst workbench                                all of it on a page in the browser
dehyst identify loops.csv -o model.json         fit a model to your loops
dehyst compensate model.json path.csv -o v.csv  the voltages for a path
dehyst --help                                   all commands, in the order of work"""
# The key of --columns for an argument of the library.
_KEYS = {"time": "time=NAME", "sample_rate": "rate=HZ", "columns": "KEY=VALUE"}
# How columns are typed once.
_KEPT = "dehyst show FILE --columns TEXT --save FILE keeps them for --columns @FILE."
# Commands of this room, beside the operations: where they are, under which heading, and in a few words.
_OWN = {"workbench": ("dehyst.cli.workbench", "Try it", "All steps in a browser, with your records")}


class _Typed(click.ParamType):  # type: ignore[type-arg]
    """A kind of an operation's parameter."""

    def __init__(self, kind: Kind) -> None:
        self.kind, self.name = kind, kind.metavar.lower()

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the value of one word or several."""
        try:
            return self.kind.parse_words([value] if isinstance(value, str) else value)
        except (ValueError, DehystError) as error:
            self.fail(str(error), param, ctx)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
        """Offer the words to choose from."""
        return [click.shell_completion.CompletionItem(one) for one in self.kind.choices if one.startswith(incomplete)]


class _Pair(_Typed, click.types.CompositeParamType):  # type: ignore[type-arg]
    """A kind whose values are two words."""

    @property
    def arity(self) -> int:  # type: ignore[override]
        """The number of words of a value."""
        return self.kind.count


def _click_parameter(one: Parameter) -> click.Parameter:
    """Return a parameter for click."""
    kind = one.kind
    typed: Any = click.Path(path_type=Path) if kind.type is Path else (_Pair if kind.count > 1 else _Typed)(kind)
    if one.positional:
        metavar = one.name.upper() if one.required else f"[{one.name.upper()}]"
        return click.Argument(
            [one.name],
            type=typed,
            nargs=-1 if kind.several else 1,
            required=one.required,
            metavar=f"{metavar}..." if kind.several else metavar,
        )
    if kind.type is bool:
        both = one.default is None
        names = f"{flag(one.name)}/{flag(one.name, off=True)}" if both or one.default else flag(one.name)
        return click.Option([names, one.name], default=None if both else one.default, help=one.whole_help, is_flag=True)
    short = ["-o"] if one.name == "output" else []
    return click.Option(
        [*short, flag(one.name), one.name],
        type=typed,
        multiple=kind.several,
        required=one.required,
        metavar=kind.metavar,
        help=one.whole_help,
    )


class OperationCommand(click.Command):
    """The command of an operation. An option that takes files takes all names up to the next option."""

    def __init__(self, operation: Operation) -> None:
        self.operation = operation
        params = [_click_parameter(one) for one in operation.parameters if not one.rare]
        if operation.rare:
            names = ", ".join(one.name for one in operation.rare)
            text = f"JSON or TOML with {names}: a file, or JSON itself; see below."
            params.append(click.Option(["--options"], metavar="FILE|JSON", help=text))
        if operation.writes:
            params.append(click.Option(["--force"], is_flag=True, help="Replace files that exist."))
        if operation.details:
            params.append(click.Option(["--all", "details"], is_flag=True, help="Print all that was found."))
        if operation.returns:
            params.append(click.Option(["--json", "as_json"], is_flag=True, help="Print JSON for a program."))
        numbers = any(one.positional and one.kind.type is float for one in operation.parameters)
        super().__init__(
            operation.name,
            params=params,
            help=f"{operation.summary}\n\n{operation.help}",
            context_settings={"ignore_unknown_options": numbers},
        )

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the parameters of a file of options."""
        if self.operation.rare:
            with formatter.section("In a file of --options"):
                formatter.write_dl(
                    [(f"{one.name} ({one.kind.metavar})", one.whole_help) for one in self.operation.rare]
                )

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Insert the option before each of its names, as click requires."""
        many = {
            flag(one.name)
            for one in self.operation.parameters
            if one.kind.several and one.kind.role and not one.positional
        }
        known = {name for each in self.get_params(ctx) for name in (*each.opts, *each.secondary_opts)}
        spread, inside = list[str](), ""
        for word in args:
            # Click leaves unknown options to the numbers, which may be negative.
            option = word.partition("=")[0]
            if option.startswith("--") and option not in known | {"--"}:
                rare = any(flag(one.name) == option for one in self.operation.rare)
                words = f"{option} belongs into a file of --options." if rare else None
                raise click.NoSuchOption(option, words, get_close_matches(option, known, cutoff=0.75), ctx)
            if inside and not word.startswith("-") and spread[-1] != inside:
                spread.append(inside)
            inside = word if word in many else inside if not word.startswith("-") else ""
            spread.append(word)
        return super().parse_args(ctx, spread)

    def invoke(self, ctx: click.Context) -> None:
        """Run the operation; print its result or its error, and exit with its status."""
        defaults = (click.core.ParameterSource.DEFAULT, click.core.ParameterSource.DEFAULT_MAP)
        given = {name: value for name, value in ctx.params.items() if ctx.get_parameter_source(name) not in defaults}
        force, as_json, details = (bool(given.pop(name, False)) for name in ("force", "as_json", "details"))
        run = TerminalRun(quiet=as_json)
        try:
            with terminable(), warnings.catch_warnings():
                warnings.showwarning = lambda message, *_, **__: note(message)
                given |= self.operation.options_in(given.pop("options")) if "options" in given else {}
                result = perform(self.operation, given, run, force=force)
        except MemoryError:
            self._refuse(DehystError("not enough memory; resample the record or cut it"), given, as_json, {})
            sys.exit(2)
        except DehystError as error:
            self._refuse(error, given, as_json, run.known)
            sys.exit(1 if isinstance(error, LinkError | DeviceError | SensorError) else 2)
        except (KeyboardInterrupt, SystemExit) as error:
            status = error.code if isinstance(error, SystemExit) else _INTERRUPTED
            names = {128 + number: number.name for number in signal.Signals} | {_INTERRUPTED: "Ctrl-C"}
            by = names.get(status)  # type: ignore[arg-type]
            for sentence in (f"stopped by {by}", *getattr(error, "__notes__", ())) if by else ():
                note(sentence)
            sys.exit(status)
        finally:
            run.progress("")
        for warning in result.warnings:
            note(warning)
        if as_json:
            echo_json(result.as_dict())
        else:
            for line in (result.more or result.lines) if details else result.lines:
                echo(line)
            if result.more and not details:
                echo()
                echo("Add --all for all that was found.")
        sys.exit(0 if result.good else 1)

    def _refuse(self, error: DehystError, given: dict[str, Any], as_json: bool, known: Mapping[str, Any]) -> None:
        """Print an error, and commands with columns that would mend it; as JSON too, beside what is known."""
        trials: list[str] = []
        columns = given.get("columns") or Columns()
        if self.operation.parameter("columns") is not None:
            if isinstance(error, DecimalSignError):
                trials = [text_of({**columns.entries(), "decimal": word}) for word in ("point", "comma")]
            elif isinstance(error, ColumnsError) and error.proposal:
                trials, error.message = [error.proposal], error.reason
        note(sentence := self.text(error, given))
        for added in getattr(error, "__notes__", ()):
            note(added)
        commands = [shlex.join(self.operation.command({**given, "columns": text})) for text in trials]
        if commands:
            echo("To try:" if len(commands) == 1 else "See which numbers are right, with one of:", err=True)
        for command in commands:
            echo(f"  {command}", err=True)
        suggestion = trials[0] if len(trials) == 1 else ""
        for advice in (*notes_on(suggestion), _KEPT) if suggestion else ():
            echo(advice, err=True)
        if as_json:
            fields = {
                **error.as_dict(),
                "message": escaped(sentence),
                "suggestion": suggestion,
                "commands": commands,
            }
            echo_json({**known, "error": fields})

    def text(self, error: DehystError, given: Mapping[str, Any] = {}) -> str:
        """Return the message of an error with options in the place of the library's arguments."""

        def named(argument: str) -> str:
            one = self.operation.parameter(argument)
            if one is None:
                return flag(argument) if argument in ("force", "options") else argument
            off = one.kind.type is bool and given.get(argument, not one.default) is False
            return (
                f"{argument} in --options"
                if one.rare
                else argument.upper()
                if one.positional
                else flag(argument, off=off)
            )

        def way(argument: str) -> str:
            one = self.operation.parameter(argument)
            if one is not None:
                value = "" if one.kind.type is bool or one.positional else f" {one.kind.metavar}"
                return f"{named(argument)}{value}"
            key = _KEYS.get(argument)
            return f"--columns {key}" if key and self.operation.parameter("columns") is not None else ""

        return error.text(named, way)


class Commands(click.Group):
    """All commands under the headings of the journey.

    Errors of a command line are sentences on standard error, with status 2 and without a traceback.
    """

    def __init__(self, name: str, **extra: Any) -> None:
        super().__init__(name, **extra)
        self.journey: dict[str, dict[str, str]] = {heading: {} for heading in JOURNEY}
        for heading, entries in JOURNEY.items():
            self.journey[heading] |= {full: entry.words for full, entry in entries.items()}
        for own, (_, heading, words) in _OWN.items():
            self.journey[heading][own] = words

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands in the order of the journey."""
        return [name for entries in self.journey.values() for name in entries]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a command, which is loaded now; None if there is none."""
        if cmd_name in _OWN:
            return OperationCommand(import_module(_OWN[cmd_name][0]).workbench)
        return OperationCommand(find(cmd_name)) if cmd_name in self.list_commands(ctx) else None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands under their headings, each with a few words."""
        width = max(map(len, self.list_commands(ctx)))
        for heading, entries in self.journey.items():
            with formatter.section(heading):
                formatter.write_dl([(name.ljust(width), words) for name, words in entries.items()])

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
        words = list(sys.argv[1:] if args is None else args)
        if not standalone_mode:
            return super().main(args, prog_name or "dehyst", complete_var, standalone_mode=False, **extra)
        with guarded_streams():
            try:
                sys.exit(super().main(args, prog_name or "dehyst", complete_var, standalone_mode=False, **extra))
            except click.ClickException as error:
                shown = io.StringIO()
                error.show(shown)
                for line in shown.getvalue().removesuffix("\n").split("\n"):
                    echo(line, err=True)
                if "--json" in words:
                    echo_json({"error": {"kind": type(error).__name__, "message": error.format_message()}})
                sys.exit(error.exit_code)
            except click.Abort:
                sys.exit(_INTERRUPTED)


@click.group(
    cls=Commands,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)
@click.option("--version", is_flag=True, help="Show the version and exit.")
@click.pass_context
def main(context: click.Context, version: bool) -> None:
    """Take the hysteresis out of piezoelectric actuators."""
    if version:
        echo(f"dehyst, version {__version__}")
        context.exit()
    if context.invoked_subcommand is None:
        for line in _FIRST_STEPS.split("\n"):
            echo(line)
