"""`dehyst workbench`: the whole journey in a browser."""

from __future__ import annotations

import threading
from pathlib import Path

import click

from dehyst.cli.common import PATH
from dehyst.cli.output.terminal import echo
from dehyst.cli.record_files import size_option


@click.command()
@click.argument("folder", type=PATH, default=Path("dehyst-workbench"))
@click.option("--port", type=click.IntRange(0, 65535), help="0: any that is free.  [default: 8754, or any]")
@click.option("--browser/--no-browser", default=True, help="Open the page.  [default: browser]")
@size_option
def workbench(folder: Path, port: int | None, browser: bool, max_bytes: float) -> None:
    """Open the workbench in a browser: drop a record, identify, draw a path, get the voltage, drive a rig.

    Everything is kept in FOLDER, with a script of the commands that would do the same. The page is served to this
    machine only; the printed link lets one browser in. Ctrl-C ends it.
    """
    from dehyst.workbench import serve

    def opened(link: str) -> None:
        echo(f"Workbench of {folder}: {link}")
        echo("Ctrl-C ends it.")
        if browser:
            threading.Thread(target=_open, args=(link,), daemon=True).start()

    serve(folder, port=port, upload_limit=max_bytes, opened=opened)
    echo(f"Everything is in {folder}; the same command goes on from there.")


def _open(link: str) -> None:
    import webbrowser

    webbrowser.open(link)
