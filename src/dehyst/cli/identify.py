"""`dehyst identify`: an actuator from records of voltage and displacement."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst.cli.common import (
    PATH,
    ManyToValidate,
    command_line,
    force_option,
    given,
    json_option,
    refuse_given,
    refuse_overwriting,
    refuse_unused,
    verbose_option,
)
from dehyst.cli.models import axes_option
from dehyst.cli.output.printing import print_fit
from dehyst.cli.output.terminal import echo_json, note, progress_line
from dehyst.cli.record_files import COLUMNS, columns_options, read_records, table_of, time_of_table
from dehyst.cli.zero import zero_option, zeroed

if TYPE_CHECKING:
    from dehyst.identification import Deadline, Fit, StageFit
    from dehyst.model import Actuator, Stage
    from dehyst.records import Record

_VOLTS = ("V", "mV", "kV")
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
    type=click.Choice(["auto", "maxwell_slip"]),
    default="auto",
    show_default=True,
    help="auto: select the parts (transformer, graded elements, creep, ...) by cross-validation. "
    "maxwell_slip: slip elements and a spring, as in Yeh's paper; --elements, --knots and another --method imply it.",
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
@verbose_option
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
    verbose: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Identify an actuator from RECORDs of voltage and displacement.

    Within about a second the output holds a first, provisional model. From then on Ctrl-C ends the search: the best
    model so far is completed and written, and the exit status is 1. A second Ctrl-C stops at once. With --axes there is
    no model before all axes are identified: Ctrl-C writes nothing.
    """
    if options["structure"] == "auto" and given("elements", "knots", "method"):
        refuse_given("with --elements, --knots or --method, which imply maxwell_slip", "structure")
    if len(records) + len(validate) < 2:
        refuse_given("on one record", "shared_datum")
    if axes is not None:
        always = ("axes", "output", "force", "validate", "report", "traces", "zero", "time_limit", "no_drift")
        refuse_unused("with --axes", *always, *(name for name in options if name not in ("voltage", "displacement")))
    from dehyst.identification import Deadline

    refuse_overwriting([*records, *validate], output, report, traces)
    deadline = Deadline(time_limit)
    best, progress = BestSoFar(deadline, output), progress_line()
    progress("reading")
    training, held_out = zeroed(
        read_records(records, options, axes=axes), read_records(validate, options, axes=axes), zero
    )
    settings = {name: value for name, value in options.items() if name not in COLUMNS}
    settings |= {"validate": held_out, "drift": not no_drift, "progress": progress}
    fit: Fit | StageFit
    with best.ended_by_interrupt():
        if axes is None:
            from dehyst.identification import identify as run

            found = run(training, throw=False, time_limit=deadline, first_model=best.keep, **settings)
            found = replace(found, remarks=(*neighbour_remarks(found, records, options), *found.remarks))
            fit = found
            model: Actuator | Stage | None = fit.actuator
            every = fit.traces
        else:
            fit = _of_axes(training, time_limit=time_limit, **settings)
            model, every = fit.stage, tuple(trace for one in fit.fits for trace in one.traces)
    if output is not None and model is not None:
        model.save(output)
    if model is None:
        best.remove()
    if traces is not None:
        from dehyst.identification.results import write_traces

        write_traces(traces, every)
    if report is not None:
        progress("drawing the report")
        _report(report, fit, training, held_out, quick=deadline.ended)
    progress("")
    if as_json:
        echo_json(fit.as_dict())
    else:
        print_fit(fit, None if model is None else output, report, verbose=verbose)
    if deadline.ended:
        where = "was printed" if output is None or model is None else f"is in {output}"
        note(f"stopped by Ctrl-C; the best model so far {where}")
    sys.exit(0 if fit.good and not deadline.ended else 1)


def _of_axes(training: list[Record], *, progress: Callable[[str], None], **settings: Any) -> StageFit:
    """Identify a stage, of which there is no model before all axes are identified."""
    from dehyst.identification import identify_stage

    try:
        return identify_stage(training, **settings, progress=progress)
    except KeyboardInterrupt:
        progress("")
        note("Ctrl-C: several axes have no model before all are identified; nothing was written")
        raise


def _report(path: Path, fit: Fit | StageFit, training: list[Record], held_out: list[Record], *, quick: bool) -> None:
    """Write the report of a fit, with an assessment of a model of one axis unless it is to be quick."""
    from dehyst.identification import Fit

    if not isinstance(fit, Fit):
        from dehyst.report import write_stage_report

        write_stage_report(path, fit, [*training, *held_out], command=command_line())
        return
    from dehyst.report import write_report
    from dehyst.trust import insight

    found = None if quick or fit.actuator is None else insight(fit.actuator, training, repeats=0)
    write_report(path, fit, command=command_line(), insight=found)


def neighbour_remarks(fit: Fit, records: tuple[Path, ...], columns: dict[str, Any]) -> list[str]:
    """Return warnings of other voltages in the files of records that the residual of a single axis follows."""
    from dehyst.identification.coupling.cross_talk import followed

    remarks = []
    for path, trace, error in zip(records, fit.traces, fit.errors, strict=False):
        if path.is_fifo() or columns["sample_rate"] is not None:
            continue
        table = table_of(path, columns)
        chosen = table.select("voltage", columns["voltage"]).column.name
        others = {c.name: c.data for c in table.columns if c.name != chosen and not c.fault and c.parts[1] in _VOLTS}
        if others:
            time = time_of_table(table, table.columns[0].data.size, columns).get("time_s")
            remarks += [] if time is None else [one.sentence for one in followed(trace, time, others, error.stroke)]
    return remarks


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
        known = Actuator.load(path).identification
        return known is not None and known.provisional
    return False
