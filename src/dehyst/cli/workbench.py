"""`dehyst workbench`: the whole journey in a browser."""

from __future__ import annotations

import threading
import webbrowser
from contextlib import suppress
from pathlib import Path

import click

from dehyst.operations.command import argument, command, option
from dehyst.operations.run import Result, Run
from dehyst.workbench import serve
from dehyst.workbench.serving import Door

_FOLDER = click.Path(path_type=Path)


@command("workbench", returns=False)
def workbench(
    run: Run,
    folder: Path = argument(_FOLDER, required=False, default="dehyst-workbench"),
    port: int | None = option("0: any free port; default: 8754, or any free one.", click.IntRange(0, 65535)),
    browser: bool = option("Open the page.", words="--browser/--no-browser", default=True),
) -> Result:
    """Open the workbench in a browser: drop a record, identify, draw a path, get the voltage.

    Everything is kept in FOLDER, with a script of the commands that do the same. Only this machine
    can reach the page, by the printed link. Ctrl-C ends it.
    """

    def opened(door: Door) -> None:
        if door.remark:
            run.note(door.remark)
        run.say(f"Workbench of {folder}: {door.link}")
        run.say("Ctrl-C ends it.")
        if browser:
            threading.Thread(target=_open, args=(door,), daemon=True).start()

    serve(folder, port=port, opened=opened)
    return Result({}, [f"Everything is in {folder}; the same command continues from there."])


def _open(door: Door) -> None:
    with suppress(OSError):
        webbrowser.open(door.page.as_uri())
