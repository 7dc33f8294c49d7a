"""`paper`: the experiment of the paper on a virtual actuator."""

from __future__ import annotations

from pathlib import Path

from dehyst._io import made_folder
from dehyst.operations.command import FOLDER, command, output
from dehyst.operations.run import Result, Run
from dehyst.paper import run as experiment


@command("paper")
def paper(run: Run, output: Path = output("New or empty folder.", FOLDER, default="dehyst-paper")) -> Result:
    """Repeat the experiment of the paper on a virtual actuator: its tables and its figures of results, on one page."""
    made_folder(output)
    result = experiment.run(run.progress)
    written = experiment.write(result, output, run.progress)
    lines = [f"Written to {output}/: open index.html"]
    return Result({**result.as_dict(), "written": [str(path) for path in written]}, lines)
