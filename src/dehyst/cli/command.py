"""Running a command on a terminal: its progress, its answer and its errors."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import click

from dehyst._errors import DecimalSignError, DehystError, DeviceError, LinkError, SensorError
from dehyst._text import escaped
from dehyst.cli.terminal import echo, echo_json, note, progress_line
from dehyst.operations.command import command_of, error_text
from dehyst.operations.run import Run, perform, terminable
from dehyst.records.columns import text_of
from dehyst.records.tables import ColumnsError, notes_on

_ENDING = b"dehyst: Ctrl-C: completing the best model so far; press it again to stop at once\n"


class TerminalRun(Run):
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
        """Report the end by the descriptor, because the stream may be in the middle of a line."""
        with suppress(OSError):
            os.write(2, ("\r\033[K" if sys.stderr.isatty() else "").encode() + _ENDING)


def run_command(ctx: click.Context) -> None:
    """Run the operation of a command; print its result or its error, and exit with its status."""
    as_json, details = (bool(ctx.params.get(name)) for name in ("as_json", "details"))
    run = TerminalRun(quiet=as_json)
    try:
        with terminable():
            result = perform(ctx, run)
    except DehystError as error:
        for remark in run.remarks:
            note(remark)
        _refuse(ctx, error, as_json, run.known)
        sys.exit(1 if isinstance(error, LinkError | DeviceError | SensorError) else 2)
    finally:
        run.progress("")
    if as_json:
        echo_json(result.fields)
    for line in (details and result.more) or result.lines:
        run.say(line)
    for line in ("", "Add --verbose for all that was found.") if result.more and not details else ():
        run.say(line)
    for remark in run.remarks:
        note(remark)
    sys.exit(0 if result.good else 1)


def _refuse(ctx: click.Context, error: DehystError, as_json: bool, known: Mapping[str, Any]) -> None:
    """Print an error, and commands with columns that may solve it; as JSON too, with the `known` values."""
    trials: list[str] = []
    if (columns := ctx.params.get("columns")) is not None:
        if isinstance(error, DecimalSignError):
            trials = [text_of({**columns.entries(), "decimal": word}) for word in ("point", "comma")]
        elif isinstance(error, ColumnsError) and error.proposal:
            trials, error.message = [error.proposal], error.reason
    note(sentence := error_text(ctx, error))
    for added in getattr(error, "__notes__", ()):
        note(added)
    commands = [command_of(ctx, columns=text) for text in trials]
    if commands:
        echo("To try:" if len(commands) == 1 else "See which numbers are right, with one of:", err=True)
    for command in commands:
        echo(f"  {command}", err=True)
    suggestion = trials[0] if len(trials) == 1 else ""
    for advice in notes_on(suggestion) if suggestion else ():
        echo(advice, err=True)
    if as_json:
        fields = {**error.as_dict(), "message": escaped(sentence), "suggestion": suggestion, "commands": commands}
        echo_json({**known, "error": fields})
