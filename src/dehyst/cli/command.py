"""The command of an operation: its options, its run, its answer and its errors."""

from __future__ import annotations

import os
import shlex
import signal
import sys
import warnings
from collections.abc import Mapping
from contextlib import AbstractContextManager, suppress
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import click

from dehyst._errors import DecimalSignError, DehystError, DeviceError, LinkError, SensorError
from dehyst._text import escaped
from dehyst.cli.terminal import INTERRUPTED, echo, echo_json, note, progress_line
from dehyst.operations.declaration import Kind, Operation, Parameter, flag
from dehyst.operations.files import Columns
from dehyst.operations.run import InterruptibleRun, perform, terminable
from dehyst.records.columns import text_of
from dehyst.records.tables import ColumnsError, notes_on

_ENDING = b"dehyst: Ctrl-C: completing the best model so far; press it again to stop at once\n"
# The key of --columns for an argument of the library.
_KEYS = {"time": "time=NAME", "sample_rate": "rate=HZ", "columns": "KEY=VALUE"}
# How columns are typed once.
_KEPT = "dehyst show FILE --columns TEXT --save FILE keeps them for --columns @FILE."


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


class TerminalRun(InterruptibleRun):
    """A run that shows its progress on standard error, and that Ctrl-C ends; `quiet`: nothing on standard output."""

    def __init__(self, *, quiet: bool = False) -> None:
        super().__init__()
        self._quiet, self._show = quiet, progress_line()

    def progress(self, words: str) -> None:
        """Show the present activity; an empty text ends this."""
        self._show(words)

    def note(self, sentence: object) -> None:
        """Print a warning on standard error."""
        note(sentence)

    def say(self, line: object) -> None:
        """Print a line on standard output."""
        if not self._quiet:
            echo(line)
            sys.stdout.flush()

    def ending(self) -> None:
        """Say that it ends; not through the stream, which may be in the middle of a line."""
        with suppress(OSError):
            os.write(2, ("\r\033[K" if sys.stderr.isatty() else "").encode() + _ENDING)

    def watch(self) -> AbstractContextManager[Any]:
        """Show the steps of a calibration."""
        from dehyst.cli.progress import Progress

        return Progress()


class OperationCommand(click.Command):
    """The command of an operation. An option that takes files takes all names up to the next option."""

    def __init__(self, operation: Operation) -> None:
        self.operation, self._kind = operation, ""
        params = [_click_parameter(one) for one in operation.parameters if not one.rare]
        if operation.rare:
            names = ", ".join(one.name for one in operation.rare)
            text = f"JSON or TOML with {names}: a file, or JSON itself; see below."
            params.append(click.Option(["--options"], metavar="FILE|JSON", help=text))
        if operation.writes:
            params.append(click.Option(["--force"], is_flag=True, help="Replace files that exist."))
        if operation.details:
            params.append(click.Option(["--verbose", "details"], is_flag=True, help="Print all that was found."))
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
                rare = [(f"{one.name} ({one.kind.metavar})", one.whole_help) for one in self.operation.rare]
                formatter.write_dl(rare)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options: of a kind that was given its own, without one those that every kind has."""
        choices = next((one for one in self.operation.parameters if one.positional and one.kind.choices), None)
        if choices is None:
            super().format_options(ctx, formatter)
            return
        given = {choices.name: self._kind}
        shown = {one.name: one.of_choice(given) for one in self.operation.parameters if not one.positional}
        records = []
        for param in self.get_params(ctx):
            one = shown.get(param.name or "", choices)
            if one is not None and isinstance(param, click.Option) and (record := param.get_help_record(ctx)):
                records.append((record[0], record[1] if one is choices else one.whole_help))
        with formatter.section(f"Options of {self._kind}" if self._kind else "Options of every kind"):
            formatter.write_dl(records)
        if not self._kind:
            formatter.write_text(f"{ctx.command_path} KIND --help shows the options of a kind.")

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Insert the option before each of its names, as click requires."""
        choices = {word for one in self.operation.parameters if one.positional for word in one.kind.choices}
        self._kind = next((word for word in args if word in choices), "")
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
        except DehystError as error:
            self._refuse(error, given, as_json, run.known)
            sys.exit(1 if isinstance(error, LinkError | DeviceError | SensorError) else 2)
        except (KeyboardInterrupt, SystemExit) as error:
            status = error.code if isinstance(error, SystemExit) else INTERRUPTED
            names = {128 + number: number.name for number in signal.Signals} | {INTERRUPTED: "Ctrl-C"}
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
                echo("Add --verbose for all that was found.")
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
            if one.rare:
                return f"{argument} in --options"
            off = one.kind.type is bool and given.get(argument, not one.default) is False
            return argument.upper() if one.positional else flag(argument, off=off)

        def way(argument: str) -> str:
            one = self.operation.parameter(argument)
            if one is not None:
                value = "" if one.kind.type is bool or one.positional else f" {one.kind.metavar}"
                return f"{named(argument)}{value}"
            key = _KEYS.get(argument)
            return f"--columns {key}" if key and self.operation.parameter("columns") is not None else ""

        return error.text(named, way)
