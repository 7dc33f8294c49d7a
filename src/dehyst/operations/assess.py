"""`insight` and `check`: how far to trust a model, what to record next, and whether the model is still true."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

from dehyst._errors import FileFormatError, ModelError
from dehyst._io import demand_alike
from dehyst._text import escaped
from dehyst._types import Array
from dehyst.control.planning.path import needed_slew_rate, speed_remark
from dehyst.operations.axes import AxesModel, is_stage
from dehyst.operations.declaration import Folder, Input, Only, Output, Values, operation
from dehyst.operations.files import AS_FOUND, RECORD, Columns, write_table
from dehyst.operations.paths import Zero, reach_remarks, temperature_of, zero_of_path
from dehyst.operations.run import Result, Run, files
from dehyst.operations.start import Start, start_reader
from dehyst.report import write_check_history, write_insight
from dehyst.trust import CheckHistory, Insight, Recheck, StageInsight, check_stage, stage_insight
from dehyst.trust import check as check_one
from dehyst.trust import insight as insight_one
from dehyst.trust.history import ControlChart, demand_folder

# Checks of a history that are printed.
_SHOWN = 10


def _single(given: Values) -> bool:
    return not is_stage(given["model"])


_of_one = Only(_single, "with a model of several axes")
_of_path = Only(lambda given: _single(given) and "trajectory" in given, "without --trajectory, on a model of one axis")


@operation(insight_one, rare=("seconds", "temperatures"), details=True)
def insight(
    run: Run,
    model: Input,
    records: tuple[Input, ...],
    *,
    trajectory: Annotated[Input | None, _of_one] = None,
    zero: Annotated[Zero | None, _of_path] = None,
    start: Annotated[Start | None, _of_path] = None,
    limits: tuple[float, float] | None = None,
    temperatures: tuple[float, float] | None = None,
    seconds: float | None = None,
    output: Annotated[Output | None, _of_path] = None,
    report: Output | None = None,
    columns: Columns = AS_FOUND,
) -> Result:
    """Assess a MODEL by the RECORDS that it was identified from: what they determine, and what to record next.

    The status is 1 if there is a warning.

    Parameters
    ----------
    trajectory
        Predict the error along this path: a file with a displacement.
    zero
        Displacement from which the trajectory is counted, as in compensate; default: the sensor's zero.
    start
        State before the trajectory, as in compensate; default: the top of the limits, after a rise through them.
    output
        Write the trajectory with the promise along it here (CSV).
    report
        Write a self-contained HTML page here.
    """
    known = AxesModel.read(run, model)
    keys = RECORD if trajectory is None else (*RECORD, "wanted", "temperature")
    (columns.demand if known.stage is None else columns.demand_axes)(keys, "on records")
    training = columns.records(records, axes=known.pairs(columns), several=trajectory is not None)
    asked: dict[str, Any] = {
        "limits": limits,
        "seconds": seconds,
        "temperatures": temperatures,
        "progress": run.progress,
    }
    if known.stage is not None:
        whole = stage_insight(known.stage, training, **asked)
        assessed: Insight | StageInsight = whole
        found, fields, head = whole.insights, whole.as_dict(), list(whole.lines())
    else:
        actuator = known.actuators[0]
        time: dict[str, Array] = {}
        if trajectory is not None:
            path, time, warmth = _path(known, trajectory, columns, limits, zero, run)
            asked |= {"trajectory": path, "time": time.get("time_s"), "temperature": warmth}
        if start is not None:
            asked["start"] = start_reader(known, start, columns)(0, actuator, limits)
        one = insight_one(actuator, training, **asked)
        assessed, found, fields, head = one, (one,), one.as_dict(), []
        if output is not None and one.band is not None:
            write_table(output, {**time, **one.band.columns()})
    if report is not None:
        run.progress("drawing the page")
        write_insight(report, assessed, command=run.command)

    def lines(*, full: bool) -> list[str]:
        parts = zip(known.axes, found, strict=True)
        each = [[*(["", f"Axis {axis}"] if axis else []), *one.summary(full).split("\n")] for axis, one in parts]
        return [*head, *(line for own in each for line in own), *files(Band=output, Report=report)]

    good = not any(one.warnings() for one in found)
    return Result(fields, lines(full=False), lines(full=True), good=good)


def _path(
    known: AxesModel,
    trajectory: Path,
    columns: Columns,
    limits: tuple[float, float] | None,
    zero: Zero | None,
    run: Run,
) -> tuple[Array, dict[str, Array], float | Array | None]:
    """Return the displacement (n,) [m] of a trajectory on the model's axis, its time column, and its temperature."""
    (actuator,) = known.actuators
    table = columns.plain_table(trajectory)
    try:
        path = table.column("displacement", columns.wanted)
    except FileFormatError as error:
        # The displacement in --columns is that of the records here.
        change = ["wanted" if name == "displacement" else name for name in error.change]
        raise FileFormatError(error.message, hint=error.hint, change=change) from error
    time = AS_FOUND.clock(table, path.size)
    if actuator.needs_time and not time:
        raise ModelError(
            argument=str(trajectory), got="no time column", need="one: this model depends on time", hint="add time_s"
        )
    path = path + zero_of_path(actuator, limits, zero)
    warmth = temperature_of(known, None, columns, table, path.size, remark=run.note)
    followed = known.targets(path[:, None], warmth)[:, 0]
    for warning in reach_remarks(actuator, path, limits, zero, warmth, refuse=False):
        run.note(warning)
    allowed = limits or actuator.voltage_range
    if time and path.size > 1:
        needed = needed_slew_rate(actuator, followed, time["time_s"], allowed)
        for remark in speed_remark(actuator, needed):
            run.note(f"{remark}; it is judged as wanted here, while compensate holds it back without --slew-rate none")
    return path, time, warmth


@operation(check_one)
def check(
    run: Run,
    model: Input,
    record: Input,
    *,
    goal: float | None = None,
    history: Folder | None = None,
    columns: Columns = AS_FOUND,
) -> Result:
    """Check whether a MODEL is still true by a new RECORD of its actuator: its present error, and what has changed.

    The status is 0 if the model is still true, 1 if not.

    Parameters
    ----------
    goal
        Largest error [% of the stroke] with which the model is still true; default: the model's, or 1.
    history
        Keep the check in this folder, print all earlier checks of this model, and draw them there.
    """
    known = AxesModel.read(run, model)
    (columns.demand if known.stage is None else columns.demand_axes)(RECORD, "on a record")
    pictures = [None if history is None else history / f"history{axis and '-'}{axis}.html" for axis in known.axes]
    if history is not None:
        demand_folder(history)
        for drawing in filter(None, pictures):
            demand_alike(drawing)
    (measured,) = columns.records((record,), axes=known.pairs(columns))
    if known.stage is None:
        found = [check_one(known.actuators[0], measured, goal=goal)]
        coupling, good = None, found[0].good
    else:
        stage = check_stage(known.stage, measured, goal=goal)
        found, coupling, good = [*stage.rechecks], stage.as_dict(), stage.good
    results, lines, warnings = [], [], []
    for axis, recheck, picture in zip(known.axes, found, pictures, strict=True):
        unkept = "" if history is None else f". It is not kept in {history}"
        said = [f"{recheck.mismatch}{unkept}"] if recheck.mismatch else []
        past = None if history is None or recheck.mismatch else CheckHistory.keep(history, recheck)
        said += [] if past is None else past.damaged
        drawn = None if past is None or picture is None else _drawn(run, past, picture)
        warnings += [f"{axis}: {one}" if axis else one for one in said]
        results.append(recheck.as_dict() if past is None else {**recheck.as_dict(), "history": past.as_dict()})
        lines += [f"Axis {axis}"] if axis else []
        lines += [*_check_lines(recheck), *(() if past is None else _history_lines(past)), *files(Picture=drawn)]
        lines += [""] if axis else []
    if coupling is None:
        return Result(results[0], lines, warnings=warnings, good=good)
    lines.append("Coupling: changed" if coupling["changes"] else "Coupling: as in the model")
    lines += [f"  - {sentence}" for sentence in coupling["changes"]]
    return Result({**coupling, "axes": known.by_axis(results)}, lines, warnings=warnings, good=good)


def _drawn(run: Run, history: CheckHistory, picture: Path) -> Path | None:
    """Draw a history into its folder if possible; the check does not depend on this picture."""
    try:
        write_check_history(picture, history)
    except FileFormatError as error:
        run.note(error)
        return None
    return picture


def _check_lines(recheck: Recheck) -> Iterator[str]:
    """Yield the judgement, possible changes, and the remarks."""
    yield recheck.sentence
    if recheck.mismatch:
        return
    yield from recheck.change_sentences()
    yield ""
    yield f"{'change':<8}{'now less then':>38}{'effect, % of the stroke':>26}"
    for change in recheck.changes:
        sign = "-" if change.value < 0 else "+"
        effect = f"{100 * change.effect / recheck.stroke:+.3f}"
        counts = "  counts" if change.counts else ""
        yield f"{change.name:<8}{sign + change.amount(recheck.stroke):>38}{effect:>26}{counts}"
    yield "  (A change counts if it exceeds three standard errors, and its effect a quarter of the goal.)"
    if recheck.remarks:
        yield ""
        yield from (f"  - {remark}" for remark in recheck.remarks)


def _history_lines(history: CheckHistory) -> Iterator[str]:
    """Yield the last checks with the averages of the scores, then the changes that are outside of their limits."""
    charts, count = history.charts(), len(history.checks)
    width = max(6, *(len(escaped(one.record)) for one in history.checks[-_SHOWN:]))
    yield ""
    yield f"Checks of this model in {history.folder}: {count}; moving averages (EWMA) and cumulative sums (CUSUM) of"
    yield "changes in standard deviations, of which three count:"
    yield f"{'day':<11}{'record':<{width}}{'error, %':>10}" + "".join(f"{chart.name:>17}" for chart in charts)
    averages = {chart.name: dict(zip(chart.places.tolist(), _cells(chart), strict=True)) for chart in charts}
    for k, one in list(enumerate(history.checks))[-_SHOWN:]:
        cells = "".join(f"{averages[chart.name].get(k, '-'):>17}" for chart in charts)
        yield f"{one.checked:%Y-%m-%d} {escaped(one.record):<{width}}{one.error:>10.3f}{cells}"
    yield from history.sentences()
    if history.others:
        yield f"The folder also holds checks of other models ({history.others}), which are not compared."


def _cells(chart: ControlChart) -> Sequence[str]:
    """Return average and larger sum of each check, an exclamation mark where one is outside of its limits."""
    columns = (chart.average, chart.above, chart.below, chart.alarms)
    return [
        f"{average:+.2f} {max(up, down):6.2f}{'!' if alarm else ' '}"
        for average, up, down, alarm in zip(*(column.tolist() for column in columns), strict=True)
    ]
