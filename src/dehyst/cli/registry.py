"""The program `dehyst`: all commands. Exit status 0 done, 1 done but not good enough, 2 wrong input."""

from __future__ import annotations

import click

from dehyst._version import __version__
from dehyst.cli.calibrate import calibrate
from dehyst.cli.check import check
from dehyst.cli.common import Commands, leave_cleanly
from dehyst.cli.compare import compare
from dehyst.cli.compensate import compensate
from dehyst.cli.excite import excite
from dehyst.cli.export import export
from dehyst.cli.identify import identify
from dehyst.cli.insight import insight
from dehyst.cli.rig import rig
from dehyst.cli.show import show
from dehyst.cli.simulate import simulate
from dehyst.cli.studies import demo, paper


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="dehyst")
@click.pass_context
def main(context: click.Context) -> None:
    """Take the hysteresis out of piezoelectric actuators."""
    leave_cleanly(context)


for command in (
    calibrate,
    check,
    compare,
    compensate,
    excite,
    export,
    rig,
    identify,
    show,
    simulate,
    demo,
    insight,
    paper,
):
    main.add_command(command)
