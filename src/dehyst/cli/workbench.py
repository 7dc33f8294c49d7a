"""`dehyst workbench`: the whole journey in a browser."""

from __future__ import annotations

import os
import signal
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dehyst.cli.common import PATH
from dehyst.cli.output.terminal import echo
from dehyst.cli.record_files import size_option

if TYPE_CHECKING:
    from dehyst.workbench.serving import Door


@click.command()
@click.argument("folder", type=PATH, default=Path("dehyst-workbench"))
@click.option("--port", type=click.IntRange(0, 65535), help="0: any that is free.  [default: 8754, or any]")
@click.option("--browser/--no-browser", default=True, help="Open the page.  [default: browser]")
@size_option
def workbench(folder: Path, port: int | None, browser: bool, max_bytes: float) -> None:
    """Open the workbench in a browser: drop a record, identify, draw a path, get the voltage, drive a rig.

    Everything is kept in FOLDER, with a script of the commands that would do the same. The page is served to this
    machine only; a printed link lets one browser in, once, within a minute, and Enter prints another. Ctrl-C ends it.
    """
    from dehyst.workbench import serve

    def opened(door: Door) -> None:
        if door.remark:
            echo(door.remark, err=True)
        echo(f"Workbench of {folder}: {door.link()}")
        echo("The link lets one browser in, once, within a minute. Enter prints another, Ctrl-C ends the workbench.")
        if browser:
            threading.Thread(target=_open, args=(door,), daemon=True).start()
        if sys.stdin is not None and sys.stdin.isatty():
            # In the background, reading fails then, instead of stopping the server.
            signal.signal(signal.SIGTTIN, signal.SIG_IGN)
            threading.Thread(target=_print_links, args=(door, sys.stdin.fileno()), daemon=True).start()

    serve(folder, port=port, upload_limit=max_bytes, opened=opened)
    echo(f"Everything is in {folder}; the same command goes on from there.")


def _open(door: Door) -> None:
    import webbrowser

    # The printed link is there too.
    with suppress(OSError):
        webbrowser.open(door.page().as_uri())


def _print_links(door: Door, terminal: int) -> None:
    """Print a link for each Enter."""
    with suppress(OSError):
        while os.read(terminal, 4096):
            echo(door.link())
