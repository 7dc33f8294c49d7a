"""`dehyst check`: whether a model is still true of its actuator, by a new record."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst._text import escaped
from dehyst.cli.common import PATH, echo_files, force_option, json_option, refuse_unused
from dehyst.cli.models import AxesModel, axes_option, is_stage
from dehyst.cli.output.terminal import echo, echo_json, note
from dehyst.cli.record_files import AXES_COLUMNS, COLUMNS, columns_options, read_records

if TYPE_CHECKING:
    from dehyst.records import Record
    from dehyst.trust import CheckHistory, Recheck
    from dehyst.trust.history import ControlChart

# Checks of a history that are printed.
_SHOWN = 10


@click.command()
@click.argument("model", type=PATH)
@click.argument("records", nargs=1, metavar="RECORD", type=PATH)
@click.option(
    "--goal",
    type=float,
    metavar="PERCENT",
    help="Largest error, in % of the stroke, with which the model is still true.  [default: the model's, or 1]",
)
@click.option(
    "--history",
    type=PATH,
    metavar="FOLDER",
    help="Keep the check here, print the earlier ones of this model, and draw them (history.html, or one an axis).",
)
@axes_option("those of the records")
@force_option
@columns_options
@json_option
def check(
    model: Path,
    records: Path,
    goal: float | None,
    history: Path | None,
    axes: str | None,
    as_json: bool,
    **columns: Any,
) -> None:
    """Check whether a MODEL is still true of its actuator, by a new RECORD: the error now, and what has changed.

    The status is 0 if the model is still true, 1 if not.
    """
    several = is_stage(model)
    kept = () if history is None else ("history", "force")
    beside = "with a stage" if several else "with the model of one axis" if kept else "without --history"
    refuse_unused(beside, "goal", *kept, *(("axes", *AXES_COLUMNS) if several else COLUMNS))
    from dehyst._io import demand_alike
    from dehyst.trust import CheckHistory
    from dehyst.trust.history import demand_folder

    known = AxesModel.read(model)
    pictures = [None if history is None else history / f"history{axis and '-'}{axis}.html" for axis in known.axes]
    if history is not None:
        demand_folder(history)
        for drawing in filter(None, pictures):
            demand_alike(drawing)
    (record,) = read_records((records,), columns, axes=known.stored_columns(axes))
    rechecks, coupling, good = _checked(known, record, goal)
    results = []
    for axis, recheck, picture in zip(known.axes, rechecks, pictures, strict=True):
        if recheck.mismatch:
            unkept = "" if history is None else f". It is not kept in {history}"
            note(*known.prefixed_one(axis, [f"{recheck.mismatch}{unkept}"]))
        past = None if history is None or recheck.mismatch else CheckHistory.keep(history, recheck)
        for sentence in known.prefixed_one(axis, () if past is None else past.damaged):
            note(sentence)
        drawn = None if past is None or picture is None else _drawn(past, picture)
        results.append(recheck.as_dict() if past is None else {**recheck.as_dict(), "history": past.as_dict()})
        if as_json:
            continue
        if axis:
            echo(f"Axis {axis}")
        print_check(recheck)
        if past is not None:
            print_history(past)
        echo_files(Picture=drawn)
        if axis:
            echo()
    if as_json:
        echo_json(results[0] if coupling is None else {**coupling, "axes": known.by_axis(results)})
    elif coupling is not None:
        echo("Coupling: changed" if coupling["changes"] else "Coupling: as in the model")
        for sentence in coupling["changes"]:
            echo(f"  - {sentence}")
    sys.exit(0 if good else 1)


def _checked(known: AxesModel, record: Record, goal: float | None) -> tuple[list[Recheck], dict[str, Any] | None, bool]:
    """Return the check of each axis, that of the coupling of several as JSON values, and whether the model is true."""
    from dehyst.trust import check as run

    if known.stage is None:
        found = [run(known.actuators[0], record, goal=goal)]
        coupling, good = None, found[0].good
    else:
        from dehyst.trust import check_stage

        stage = check_stage(known.stage, record, goal=goal)
        found, coupling, good = [*stage.rechecks], stage.as_dict(), stage.good
    return found, coupling, good


def _drawn(history: CheckHistory, picture: Path) -> Path | None:
    """Draw a history into its folder, if that is possible: a check does not depend on its picture."""
    from dehyst._errors import FileFormatError
    from dehyst.report import write_check_history

    try:
        write_check_history(picture, history)
    except FileFormatError as error:
        note(error)
        return None
    return picture


def print_check(recheck: Recheck) -> None:
    """Print the judgement, what may have changed, and the remarks."""
    echo(recheck.sentence)
    for sentence in recheck.change_sentences():
        echo(sentence)
    echo()
    echo(f"{'change':<8}{'now less then':>38}{'effect, % of the stroke':>26}")
    for change in recheck.changes:
        sign = "-" if change.value < 0 else "+"
        effect = f"{100 * change.effect / recheck.stroke:+.3f}"
        counts = "  counts" if change.counts else ""
        echo(f"{change.name:<8}{sign + change.amount(recheck.stroke):>38}{effect:>26}{counts}")
    echo("  (A change counts if it exceeds three standard errors, and its effect a quarter of the goal.)")
    if recheck.remarks:
        echo()
        for remark in recheck.remarks:
            echo(f"  - {remark}")


def print_history(history: CheckHistory) -> None:
    """Print the last checks with the averages of the scores, then what has left its limits."""
    charts, count = history.charts(), len(history.checks)
    width = max(6, *(len(escaped(one.record)) for one in history.checks[-_SHOWN:]))
    echo()
    echo(f"Checks of this model in {history.folder}: {count}; moving averages (EWMA) and cumulative sums (CUSUM) of")
    echo("changes in standard deviations, of which three count:")
    echo(f"{'day':<11}{'record':<{width}}{'error, %':>10}" + "".join(f"{chart.name:>17}" for chart in charts))
    averages = {chart.name: dict(zip(chart.places.tolist(), _cells(chart), strict=True)) for chart in charts}
    for k, one in list(enumerate(history.checks))[-_SHOWN:]:
        cells = "".join(f"{averages[chart.name].get(k, '-'):>17}" for chart in charts)
        echo(f"{one.checked:%Y-%m-%d} {escaped(one.record):<{width}}{one.error:>10.3f}{cells}")
    for sentence in history.sentences():
        echo(sentence)
    if history.others:
        echo(f"The folder also holds {history.others} of other models, which are not compared.")


def _cells(chart: ControlChart) -> list[str]:
    """Return average and larger sum of each check, an exclamation mark where one is outside of its limits."""
    columns = (chart.average, chart.above, chart.below, chart.alarms)
    return [
        f"{average:+.2f} {max(up, down):6.2f}{'!' if alarm else ' '}"
        for average, up, down, alarm in zip(*(column.tolist() for column in columns), strict=True)
    ]
