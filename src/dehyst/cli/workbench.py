"""`dehyst workbench`: the whole journey in a browser."""

from __future__ import annotations

import os
import signal
import sys
import threading
import webbrowser
from contextlib import suppress
from pathlib import Path

import click

from dehyst.operations.command import argument, command, integer, number, switch
from dehyst.operations.run import Result, Run
from dehyst.workbench import serve
from dehyst.workbench.serving import Door

_FOLDER = click.Path(path_type=Path)


@command("workbench", returns=False)
def workbench(
    run: Run,
    folder: Path = argument(_FOLDER, required=False, default="dehyst-workbench"),
    port: int | None = integer("0: any that is free; default: 8754, or any."),
    browser: bool = switch("--browser/--no-browser", "Open the page.", default=True),
    max_size: float = number("Largest file to receive [MB].", default=500.0),
) -> Result:
    """Open the workbench in a browser: drop a record, identify, draw a path, get the voltage.

    Everything is kept in FOLDER, with a script of the commands that would do the same. The page is served to this
    machine only; a printed link lets one browser in, once, within a minute; in a terminal, Enter prints another.
    Ctrl-C ends it.
    """

    def opened(door: Door) -> None:
        if door.remark:
            run.note(door.remark)
        run.say(f"Workbench of {folder}: {door.link()}")
        typed = sys.stdin is not None and sys.stdin.isatty()
        another = "Enter prints another, " if typed else ""
        run.say(f"The link lets one browser in, once, within a minute. {another}Ctrl-C ends the workbench.")
        if browser:
            threading.Thread(target=_open, args=(door,), daemon=True).start()
        if typed:
            # In the background, reading fails then, instead of stopping the server.
            signal.signal(signal.SIGTTIN, signal.SIG_IGN)
            threading.Thread(target=_print_links, args=(run, door, sys.stdin.fileno()), daemon=True).start()

    serve(folder, port=port, upload_limit=1e6 * max_size, opened=opened)
    return Result({}, [f"Everything is in {folder}; the same command goes on from there."])


def _open(door: Door) -> None:
    with suppress(OSError):
        webbrowser.open(door.page().as_uri())


def _print_links(run: Run, door: Door, terminal: int) -> None:
    """Print a link for each Enter."""
    with suppress(OSError):
        while os.read(terminal, 4096):
            run.say(door.link())
