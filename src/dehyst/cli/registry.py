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
from dehyst.cli.fleet import fleet
from dehyst.cli.identify import identify
from dehyst.cli.insight import insight
from dehyst.cli.output.terminal import echo
from dehyst.cli.rig import rig
from dehyst.cli.show import show
from dehyst.cli.simulate import simulate
from dehyst.cli.studies import demo, paper
from dehyst.cli.workbench import workbench

# What to do first, for `dehyst` alone.
_FIRST_STEPS = """\
dehyst demo                                     see it work on a virtual actuator
dehyst workbench                                all of it on a page in the browser
dehyst identify loops.csv -o model.json         fit a model to your loops
dehyst compensate model.json path.csv -o v.csv  the voltages for a path
dehyst --help                                   all commands, in the order of work"""
_JOURNEY = {
    "Try it": {
        "demo": "The whole way on a virtual actuator",
        "workbench": "The whole way in a browser, with your records or an instrument",
        "paper": "Repeat the paper's experiment on a virtual actuator",
    },
    "Record": {
        "show": "What a file is understood as, and a drawing",
        "excite": "Write the voltage of an excitation to play",
        "calibrate": "Do the whole experiment on an instrument",
        "rig": "Serve an emulated instrument",
    },
    "Identify and assess": {
        "identify": "Fit a model to recorded loops",
        "insight": "How far to trust a model, and what to record next",
        "check": "Whether a model is still true, by a new record",
        "fleet": "Thousands of records at once: identify, report, drift",
        "compare": "Compare with other published models on your records",
    },
    "Use the model": {
        "compensate": "The voltage that follows a path or a scan",
        "simulate": "The displacement that a voltage causes",
        "export": "C source for a microcontroller, or an FMU",
    },
}


@click.group(
    cls=Commands,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)
@click.version_option(__version__, prog_name="dehyst")
@click.pass_context
def main(context: click.Context) -> None:
    """Take the hysteresis out of piezoelectric actuators."""
    leave_cleanly(context)
    if context.invoked_subcommand is None:
        for line in _FIRST_STEPS.split("\n"):
            echo(line)


main.journey = {heading: tuple(commands) for heading, commands in _JOURNEY.items()}

for command in (
    calibrate,
    check,
    compare,
    compensate,
    excite,
    export,
    fleet,
    rig,
    identify,
    show,
    simulate,
    demo,
    insight,
    paper,
    workbench,
):
    main.add_command(command)
for heading in _JOURNEY.values():
    for name, words in heading.items():
        main.commands[name].short_help = words
