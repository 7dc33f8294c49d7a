"""`dehyst identify`: an actuator from records of voltage and displacement."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst.cli.axes.identify import identify_axes, neighbour_remarks
from dehyst.cli.axes.inputs import axes_option
from dehyst.cli.common import (
    PATH,
    ManyToValidate,
    command_line,
    force_option,
    json_option,
    refuse_overwriting,
    refuse_replacing,
)
from dehyst.cli.output.printing import print_fit
from dehyst.cli.output.terminal import echo_json, note, progress_line, worded
from dehyst.cli.record_files import COLUMNS, columns_options, read_records
from dehyst.cli.zero import zero_option, zeroed

if TYPE_CHECKING:
    from dehyst.identification import Deadline
    from dehyst.model import Actuator, Check

_WORDS = "dehyst: Ctrl-C: completing the best model so far; press it again to stop at once\n"


@click.command(cls=ManyToValidate)
@click.argument("records", nargs=-1, required=True, metavar="RECORD...", type=PATH)
@click.option("-o", "--output", type=PATH, help="Write the model here (JSON).")
@click.option(
    "--validate",
    multiple=True,
    type=PATH,
    metavar="RECORD...",
    help="Held-out records, simulated only; all names up to the next option.",
)
@click.option("--report", type=PATH, help="Write a self-contained HTML report here.")
@click.option(
    "--traces", type=PATH, metavar="FILE.npz", help="Write measured and simulated displacement of all records here."
)
@click.option(
    "--method", type=click.Choice(["record", "breakpoints", "antisymmetric"]), default="record", show_default=True
)
@click.option(
    "--elements",
    type=int,
    metavar="N",
    help="Number of slip elements.  [default: 20; 10 for breakpoints and antisymmetric]",
)
@click.option(
    "--structure",
    type=click.Choice(["auto", "paper"]),
    default="auto",
    show_default=True,
    help="auto: select the parts (transformer, graded elements, creep, ...) by cross-validation. paper: Maxwell-slip, "
    "plain (slip elements and a spring, as in Yeh's paper); --elements, --knots and another --method imply it.",
)
@click.option("--refine", is_flag=True, help="Minimise the simulation error in a second, slow step.")
@click.option("--norm", type=click.Choice(["l1", "l2", "linf"]), default="l1", show_default=True)
@click.option("--knots", type=int, metavar="M", help="Knots of the spring.  [default: N + 1, at most 41]")
@click.option(
    "--slope-floor",
    type=float,
    default=0.2,
    show_default=True,
    help="Least slope of the spring, as a part of its mean.",
)
@click.option("--delay", type=float, metavar="SECONDS", help="Lag of the displacement.  [default: estimated]")
@click.option(
    "--sensor-lag",
    type=float,
    metavar="SECONDS",
    help="Time constant of the sensor's filter, 0 if it has none.  [default: unknown; a lag is the actuator's]",
)
@click.option("--shared-datum", is_flag=True, help="All records share one sensor zero.")
@click.option(
    "--goal",
    type=float,
    default=1.0,
    show_default=True,
    metavar="PERCENT",
    help="Largest error, in % of the stroke, with which the model is ready for use.",
)
@click.option(
    "--time-limit",
    type=float,
    metavar="SECONDS",
    help="End the search for a structure then, and complete the best model so far.",
)
@click.option("--no-drift", is_flag=True, help="Do not estimate and remove the drift of a record.")
@axes_option()
@zero_option("Displacement that becomes 0: bottom, first sample or mean of the first RECORD.")
@force_option
@columns_options
@json_option
def identify(
    records: tuple[Path, ...],
    output: Path | None,
    validate: tuple[Path, ...],
    report: Path | None,
    traces: Path | None,
    time_limit: float | None,
    no_drift: bool,
    axes: str | None,
    zero: str | float | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Identify an actuator from RECORDs of voltage and displacement.

    Within about a second the output holds a first, provisional model. From then on Ctrl-C ends the search: the best
    model so far is completed and written, and the exit status is 1. A second Ctrl-C stops at once. With --axes there is
    no model before all axes are identified: Ctrl-C writes nothing.
    """
    if axes is not None:
        settings = {name: value for name, value in options.items() if name not in COLUMNS}
        settings |= {"drift": not no_drift, "time_limit": time_limit}
        _refuse_for_axes(traces, zero)
        identify_axes(records, validate, axes, (output, report), settings, options, as_json)
    from dehyst.identification import Deadline
    from dehyst.identification import identify as run
    from dehyst.uncertainty import insight as assess

    refuse_overwriting([*records, *validate], output, report, traces)
    deadline = Deadline(time_limit)
    best, progress = BestSoFar(deadline, output), progress_line()
    progress("reading")
    training, held_out = zeroed(read_records(records, options), read_records(validate, options), zero)
    settings = {name: value for name, value in options.items() if name not in COLUMNS}
    with best.ended_by_interrupt():
        fit = run(
            training,
            validate=held_out,
            drift=not no_drift,
            throw=False,
            progress=progress,
            time_limit=deadline,
            first_model=best.keep,
            **settings,
        )
    fit = replace(fit, remarks=(*fit.remarks, *neighbour_remarks(fit, records, options)))
    refuse_replacing(output, report, traces)
    fit = replace(fit, repairs=worded(fit.repairs), remarks=worded(fit.remarks), checks=_worded_checks(fit.checks))
    if output is not None and fit.actuator is not None:
        fit.actuator.save(output)
    if fit.actuator is None:
        best.remove()
    if traces is not None:
        from dehyst.model.trace_file import write_traces

        write_traces(traces, fit.traces)
    if report is not None:
        from dehyst.report import write_report

        progress("drawing the report")
        quick = fit.actuator is None or deadline.ended
        assessment = None if quick else assess(fit.actuator, training, repeats=0)
        write_report(report, fit, command=command_line(), insight=assessment)
    progress("")
    if as_json:
        echo_json(fit.as_dict())
    else:
        print_fit(fit, output, report)
    if deadline.ended:
        where = "was printed" if output is None or fit.actuator is None else f"is in {output}"
        note(f"stopped by Ctrl-C; the best model so far {where}")
    sys.exit(0 if fit.good and not deadline.ended else 1)


def _refuse_for_axes(traces: Path | None, zero: str | float | None) -> None:
    """Refuse options that records of several axes do not have."""
    from dehyst._errors import IdentifyError

    for flag, value in {"--traces": traces, "--zero": zero}.items():
        if value is not None:
            raise IdentifyError(f"{flag}: got it with --axes, which does not take it; leave it out")


def _worded_checks(checks: tuple[Check, ...]) -> tuple[Check, ...]:
    sentences = worded(check.sentence for check in checks)
    return tuple(replace(check, sentence=sentence) for check, sentence in zip(checks, sentences, strict=True))


class BestSoFar:
    """The best model so far of one identification.

    Parameters
    ----------
    deadline : Deadline
        Of the identification; the first Ctrl-C after the first model ends it.
    output : Path, optional
        Where the model will be written. A finished model that is there already stays until the new one is finished.
    """

    def __init__(self, deadline: Deadline, output: Path | None) -> None:
        self._deadline = deadline
        self._output = output
        self._usable = self._written = False

    def keep(self, actuator: Actuator) -> None:
        """Write the first model; from here on Ctrl-C ends the search only."""
        self._usable = True
        output = self._output
        if output is not None and (not os.path.lexists(output) or _is_provisional(output)):
            refuse_replacing(output)
            actuator.save(output)
            self._written = True

    def remove(self) -> None:
        """Remove the first model, because there will be no final one."""
        if self._written and self._output is not None:
            self._output.unlink(missing_ok=True)

    @contextmanager
    def ended_by_interrupt(self) -> Iterator[None]:
        """Let the first Ctrl-C end the search once there is a model; if an error does, remove the model."""
        before = signal.getsignal(signal.SIGINT)
        # A program in the background ignores Ctrl-C.
        handles = threading.current_thread() is threading.main_thread() and before is signal.default_int_handler
        if handles:
            signal.signal(signal.SIGINT, self._end)
        try:
            yield
        except Exception:
            self.remove()
            raise
        finally:
            if handles:
                signal.signal(signal.SIGINT, before)

    def _end(self, *_: Any) -> None:
        if not self._usable:
            raise KeyboardInterrupt
        signal.signal(signal.SIGINT, signal.default_int_handler)
        # Not through the stream, which may be in the middle of a line.
        with suppress(OSError):
            os.write(2, ("\r\033[K" if sys.stderr.isatty() else "").encode() + _WORDS.encode())
        self._deadline.end("Ctrl-C", leave_step=True)


def _is_provisional(path: Path) -> bool:
    """Whether a file is the first model of an identification that did not end."""
    from dehyst._errors import DehystError
    from dehyst.model import Actuator

    with suppress(DehystError):
        return Actuator.load(path).provenance.get("provisional") is True
    return False
