"""All commands of `dehyst` under the headings of the journey. Each is loaded when it is used, `--help` loads none."""

from __future__ import annotations

import io
import os
import signal
import sys
from collections.abc import Sequence
from difflib import get_close_matches
from typing import Any

try:
    import click

    from dehyst._version import __version__
    from dehyst.cli.terminal import INTERRUPTED, echo, echo_json, guarded_streams, note
    from dehyst.operations.command import argument_of, hint_of
    from dehyst.operations.registry import JOURNEY, find
except KeyboardInterrupt:
    os.write(2, b"dehyst: stopped by Ctrl-C\n")
    sys.exit(130)


class Commands(click.Group):
    """All commands under the headings of the journey.

    Errors of a command line are sentences on standard error, with status 2 and without a traceback.
    """

    def __init__(self, name: str, **extra: Any) -> None:
        super().__init__(name, **extra)
        self.journey: dict[str, dict[str, str]] = {
            heading: {name: words for name, (_, words) in entries.items()} for heading, entries in JOURNEY.items()
        }
        # The only command of this room; the others are operations.
        self.journey["Try it"]["workbench"] = "All steps in a browser, with your records"

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands in the order of the journey."""
        return [name for entries in self.journey.values() for name in entries]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a command, which is loaded now; None if there is none."""
        if cmd_name == "workbench":
            from dehyst.cli.workbench import workbench

            return workbench
        return find(cmd_name) if cmd_name in self.list_commands(ctx) else None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands under their headings, each with a few words."""
        width = max(map(len, self.list_commands(ctx)))
        for heading, entries in self.journey.items():
            with formatter.section(heading):
                formatter.write_dl([(name.ljust(width), words) for name, words in entries.items()])

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """Find the command; suggest the nearest ones if there is none."""
        names = self.list_commands(ctx)
        if args[0] not in names and (near := get_close_matches(args[0], names)):
            ctx.fail(f"No such command {args[0]!r}. Did you mean {' or '.join(map(repr, near))}?")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Load and run a command; say by which signal it was stopped, and where this left the voltage."""
        try:
            return super().invoke(ctx)
        except (KeyboardInterrupt, SystemExit) as error:
            status = error.code if isinstance(error, SystemExit) else INTERRUPTED
            names = {128 + number: number.name for number in signal.Signals} | {INTERRUPTED: "Ctrl-C"}
            by = names.get(status)  # type: ignore[arg-type]
            for sentence in (f"stopped by {by}", *getattr(error, "__notes__", ())) if by else ():
                note(sentence)
            sys.exit(status)

    def main(  # type: ignore[override]
        self, args: Sequence[str] | None = None, prog_name: str | None = None, **extra: Any
    ) -> Any:
        """Run as a program, even with closed or full standard streams."""
        words = list(sys.argv[1:] if args is None else args)
        if not extra.pop("standalone_mode", True):
            return super().main(args, prog_name or "dehyst", standalone_mode=False, **extra)
        with guarded_streams():
            try:
                sys.exit(super().main(args, prog_name or "dehyst", standalone_mode=False, **extra))
            except click.ClickException as error:
                shown = io.StringIO()
                error.show(shown)
                hint, lines = hint_of(error), shown.getvalue().removesuffix("\n").split("\n")
                for line in [*lines, *[f"To try: {hint}"] * (hint not in lines)]:
                    echo(line, err=True)
                if "--json" in words:
                    argument = argument_of(error) if isinstance(error, click.UsageError) else ""
                    fields = {"kind": type(error).__name__, "message": error.format_message(), "argument": argument}
                    echo_json({"error": {**fields, "hint": hint}})
                sys.exit(error.exit_code)
            except click.Abort:
                sys.exit(INTERRUPTED)


@click.group(
    "dehyst",
    cls=Commands,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)
@click.version_option(__version__, message="dehyst, version %(version)s")
@click.pass_context
def main(context: click.Context) -> None:
    """Take the hysteresis out of piezoelectric actuators. First: dehyst demo, or dehyst workbench."""
    context.obj = _run
    if context.invoked_subcommand is None:
        for line in context.get_help().split("\n"):
            echo(line)


def _run(context: click.Context) -> None:
    """Run a command; its modules are loaded here, so that `--help` does not load them."""
    from dehyst.cli.command import run_command

    run_command(context)
