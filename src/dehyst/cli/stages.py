"""What commands do with several axes: `identify --axes`, and the others with a stage file."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from dehyst._text import counted
from dehyst.cli.common import command_line, conclude, echo_files, refuse_overwriting, refuse_replacing, write_output
from dehyst.cli.output.printing import print_insight
from dehyst.cli.output.terminal import echo, echo_json, note, progress_line, worded
from dehyst.cli.record_files import COLUMNS, table_of, time_of_table
from dehyst.cli.scans import named_scan
from dehyst.cli.start import error_line

if TYPE_CHECKING:
    from dehyst.control import StartError
    from dehyst.identification import Recheck
    from dehyst.model import Fit, State
    from dehyst.records.formats.columns import Table
    from dehyst.stages import Stage, StageCompensator, StageRecord, StageTrace
    from dehyst.stages.read import AxisColumns

_VOLTS = ("V", "mV", "kV")
_OWN_START = "the state of each actuator in the model: just risen to its highest voltage"
_TEXT = "Columns of several axes, e.g. 'vx_V:x_um vy_V:y_um'"


def axes_option(default: str = "") -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return the option that names voltage and displacement of several axes."""
    return click.option("--axes", metavar="COLUMNS", help=f"{_TEXT}.{default and f'  [default: {default}]'}")


def is_stage(path: Path) -> bool:
    """Return whether a file is a stage, by its format alone."""
    from dehyst._io.marks import format_of

    return path.is_file() and format_of(path) == "dehyst-stage"


def identify_axes(
    records: tuple[Path, ...],
    validate: tuple[Path, ...],
    axes: str,
    outputs: tuple[Path | None, Path | None],
    settings: dict[str, Any],
    columns: dict[str, Any],
    as_json: bool,
) -> None:
    """Identify a stage, write and print it, and exit."""
    from dehyst.stages import identify_stage

    output, report = outputs
    refuse_overwriting([*records, *validate], output, report)
    progress = progress_line()
    progress("reading")
    training, held_out = _read(records, axes, columns), _read(validate, axes, columns)
    try:
        fit = identify_stage(training, validate=held_out, progress=progress, **settings)
    except KeyboardInterrupt:
        progress("")
        note("Ctrl-C: several axes have no model before all are identified; nothing was written")
        raise
    refuse_replacing(output, report)
    if output is not None and fit.stage is not None:
        fit.stage.with_provenance(axes=training[0].meta["axes"]).save(output)
    if report is not None:
        from dehyst.stages import write_stage_report

        progress("drawing the report")
        write_stage_report(report, fit, [*training, *held_out], command=command_line())
    progress("")
    if as_json:
        echo_json(fit.as_dict())
    else:
        for line in fit.summary().split("\n"):
            echo(line)
        echo_files(Stage=output if fit.stage is not None else None, Report=report)
    sys.exit(0 if fit.good else 1)


def neighbour_remarks(fit: Fit, records: tuple[Path, ...], columns: dict[str, Any]) -> list[str]:
    """Return warnings of other voltages in the files of records that the residual of a single axis follows."""
    from dehyst.stages.neighbours import followed

    remarks = []
    for path, trace, error in zip(records, fit.traces, fit.errors, strict=False):
        if path.is_fifo() or columns["sample_rate"] is not None:
            continue
        table = table_of(path, columns)
        chosen = table.find("voltage", columns["voltage"])[0].name
        others = {c.name: c.data for c in table.columns if c.name != chosen and not c.fault and c.parts[1] in _VOLTS}
        if others:
            time = time_of_table(table, table.columns[0].data.size, columns).get("time_s")
            remarks += [] if time is None else [one.sentence for one in followed(trace, time, others, error.stroke)]
    return remarks


def simulate_axes(
    model: Path, voltage_file: Path, output: Path, axes: str | None, columns: dict[str, Any], as_json: bool
) -> None:
    """Write the displacements of all axes of a stage, and exit."""
    refuse_overwriting([model, voltage_file], output)
    stage = _load(model)
    table = table_of(voltage_file, columns)
    voltage = _columns(table, stage, axes, "voltage", columns)
    clock = time_of_table(table, len(voltage), columns)
    trace = stage.simulate(voltage, time=clock.get("time_s"), extrapolate=True)
    low, high = _limits(stage)
    outside = int(((voltage < low) | (voltage > high)).any(axis=1).sum())
    warnings = [f"{outside} samples lie outside of the identified voltages: extrapolated"] if outside else []
    refuse_replacing(output)
    write_output(output, {**clock, **_named(stage, voltage, "voltage"), **_named(stage, trace.displacement * 1e6)})
    lines = f"{counted(len(voltage), 'sample')} of {len(stage.axes)} axes, from {_OWN_START}: {output}"
    result = {"samples": len(voltage), "axes": list(stage.axes), "outside": outside, "warnings": warnings}
    conclude(as_json, {**result, "output": str(output)}, lines, warnings)
    sys.exit(0)


def compensate_axes(
    model: Path, trajectory: Path | None, output: Path, scan: str | None, axes: str | None, options: dict[str, Any]
) -> None:
    """Write the voltages with which all axes of a stage follow a file or a scan on two of them, and exit."""
    from dehyst._errors import ModelError
    from dehyst.stages import StageCompensator

    refuse_overwriting([model, *([trajectory] if trajectory is not None else [])], output)
    stage, as_json = _load(model), options["as_json"]
    for name in ("present", "cycle", "zero", "axis"):
        if options.get(name) is not None:
            raise ModelError(f"--{name}: got it with a stage, which does not take it; leave it out")
    if options["start"] is not None and options["home"]:
        raise ModelError("--start: got it with --home, which determines the state; leave one out")
    if scan is None:
        table = table_of(trajectory or Path(), options)
        wanted = _columns(table, stage, axes, "displacement", options)
        clock = time_of_table(table, len(wanted), options)
    else:
        wanted, clock = _scanned(stage, scan, options)
    count, limits, slew = len(stage.axes), options["limits"], options["slew"]
    states, remarks = (None, []) if options["start"] is None else starts_of(stage, options["start"], limits)
    compensator = StageCompensator(
        stage,
        limits=None if limits is None else [limits] * count,
        slew_rate=None if slew is None else [slew] * count,
        period=_period(clock),
        states=states,
    )
    followed = _homed(compensator, wanted, clock) if states is None and options["home"] is not False else None
    if followed is None:
        named = None if options["start"] is None else str(options["start"])
        followed = _unhomed(compensator, wanted, clock, named)
    trace = followed.trace
    remarks += trace.warnings
    refuse_replacing(output)
    write_output(output, followed.columns)
    words = [
        f"{axis} {trace.voltage[:, j].min():.6g} to {trace.voltage[:, j].max():.6g} V"
        for j, axis in enumerate(stage.axes)
    ]
    result = {
        "samples": len(wanted),
        "clamped": {axis: int(trace.clamped[:, j].sum()) for j, axis in enumerate(stage.axes)},
        "missed_um": {axis: float(trace.missed[j] * 1e6) for j, axis in enumerate(stage.axes)},
        "start": followed.words,
        "start_errors": {axis: error.as_dict() for axis, error in followed.errors.items()},
        "lowest_V": trace.voltage.min(axis=0).tolist(),
        "highest_V": trace.voltage.max(axis=0).tolist(),
        "warnings": remarks,
        "output": str(output),
    }
    lines = [f"{counted(len(wanted), 'sample')}, {', '.join(words)}, {followed.words}: {output}"]
    lines += [f"{axis}: {error_line('unknown', error, homed=True)}" for axis, error in followed.errors.items()]
    conclude(as_json, result, lines, remarks)
    sys.exit(0 if trace.followed and (followed.certified or not options["home"]) else 1)


def starts_of(stage: Stage, start: str | Path, limits: tuple[float, float] | None) -> tuple[list[State], list[str]]:
    """Return the named state of each actuator, or where limits [V] do not reach it one that they do, and remarks."""
    from dehyst._errors import ModelError
    from dehyst.control import PossibleStart
    from dehyst.stages.starts import start_within

    if not isinstance(start, str):
        raise ModelError(f"--start {start}: a stage begins in a named state; give top, bottom or the like")
    states, remarks = [], []
    for axis, one in zip(stage.axes, stage.actuators, strict=True):
        allowed, state = limits or one.limits, PossibleStart.named(one, start).state  # type: ignore[arg-type]
        states.append(state if allowed is None else start_within(one, state, allowed))
        if allowed is not None and states[-1] is not state:
            low, high = allowed
            remarks.append(
                f"axis {axis}: the start {start} needs {one.voltage(state):.6g} V, outside the limits {low:.6g} to "
                f"{high:.6g} V: it begins at {one.voltage(states[-1]):.6g} V, after loops between the limits"
            )
    return states, remarks


class _Followed(NamedTuple):
    """A path with its voltages: where it begins in words, the columns to write, and what the start leaves open."""

    trace: StageTrace
    words: str
    columns: dict[str, Any]
    errors: dict[str, StartError]
    certified: bool = True


def _unhomed(compensator: StageCompensator, wanted: Any, clock: dict[str, Any], start: str | None) -> _Followed:
    """Return a path from the states of the compensator, which are those of a `start` or of the model."""
    stage = compensator.stage
    begins = ", ".join(f"{axis} {v:.4g} V" for axis, v in zip(stage.axes, compensator.voltage.tolist(), strict=True))
    words = f"from {_OWN_START} ({begins})" if start is None else f"from the start {start} of all axes ({begins})"
    trace = compensator.trajectory(wanted, time=clock.get("time_s"))
    columns = {**clock, **_named(stage, trace.voltage, "voltage"), **_named(stage, trace.displacement * 1e6)}
    return _Followed(trace, words, columns, {})


def _homed(compensator: StageCompensator, wanted: Any, clock: dict[str, Any]) -> _Followed:
    """Return a path with a homing of all axes before it."""
    import numpy as np

    from dehyst.stages import home_stage_before

    stage = compensator.stage
    homed = home_stage_before(compensator, wanted, time=clock.get("time_s"))
    rows = len(homed.voltage)
    voltage = np.vstack([homed.voltage, homed.path.voltage])
    displacement = np.vstack([homed.expected, homed.path.displacement])
    phase = {"phase": (np.arange(len(voltage)) >= rows) * 2.0}
    when = {} if homed.time is None else {"time_s": homed.time}
    seconds = "" if homed.time is None else f", {homed.time[rows]:.4g} s"
    words = f"after a homing of all axes, {rows} rows{seconds}"
    trace = replace(homed.path, warnings=homed.warnings)
    columns = {**when, **phase, **_named(stage, voltage, "voltage"), **_named(stage, displacement * 1e6)}
    return _Followed(trace, words, columns, dict(zip(stage.axes, homed.errors, strict=True)), homed.certified)


def insight_axes(model: Path, records: tuple[Path, ...], axes: str | None, options: dict[str, Any]) -> None:
    """Print how far to trust a stage."""
    from dehyst.stages import stage_insight

    stage, progress = _load(model), progress_line()
    progress("assessing")
    names = ("level", "precision", "repeats", "limits", "seconds")
    settings = {name: options[name] for name in names if options.get(name) is not None}
    found = stage_insight(stage, _read(records, axes or _stored(stage), options), **settings)
    progress("")
    if options["as_json"]:
        echo_json(found.as_dict())
        return
    for line in worded(found.lines()):
        echo(line)
    for axis, one in zip(stage.axes, found.insights, strict=True):
        echo()
        echo(f"Axis {axis}")
        print_insight(one, None, None)


def check_axes(
    model: Path,
    record: Path,
    goal: float | None,
    axes: str | None,
    as_json: bool,
    columns: dict[str, Any],
    show: Callable[[Recheck], None],
) -> None:
    """Check a stage by a new record, and exit; `show` prints the check of an axis."""
    from dehyst.stages import check_stage

    stage = _load(model)
    found = check_stage(stage, _read((record,), axes or _stored(stage), columns)[0], goal=goal)
    if as_json:
        echo_json(found.as_dict())
    else:
        for axis, one in zip(stage.axes, found.rechecks, strict=True):
            echo(f"Axis {axis}")
            show(one)
            echo()
        echo("Coupling: changed" if found.changes else "Coupling: as in the model")
        for sentence in found.changes:
            echo(f"  - {sentence}")
    sys.exit(0 if found.good else 1)


def show_axes(file: Path, axes: str, columns: dict[str, Any]) -> StageRecord:
    """Return the record of several axes in a file."""
    return _read((file,), axes, columns)[0]


def show_stage(model: Path, as_json: bool) -> None:
    """Print a stage file."""
    from dehyst.stages.summary import matrix_lines

    stage = _load(model)
    if as_json:
        echo_json(stage.as_dict())
        return
    echo(f"Stage '{stage.name}' of the axes {', '.join(stage.axes)}, condition {stage.condition:.4g}")
    for line in matrix_lines(stage.axes, stage.coupling):
        echo(line)
    for axis, one in zip(stage.axes, stage.actuators, strict=True):
        echo(f"Axis {axis}:")
        for line in one.summary().split("\n"):
            echo(f"  {line}")


def _load(path: Path) -> Stage:
    from dehyst.stages import Stage

    stage = Stage.load(path)
    if stage.provenance.get("is_matrix") is False:
        note(f"{path}: when this stage was identified, its coupling was more than a matrix")
    return stage


def _read(paths: tuple[Path, ...], axes: str, options: dict[str, Any]) -> list[StageRecord]:
    from dehyst.stages import read_stage

    names = [name for name in COLUMNS if name not in ("voltage", "displacement")]
    return [read_stage(path, axes, **{name: options.get(name) for name in names}) for path in paths]


def _stored(stage: Stage) -> str:
    """Return the columns that the stage was identified from."""
    from dehyst._errors import FileFormatError

    stored = stage.provenance.get("axes")
    if not isinstance(stored, list):
        raise FileFormatError("axes: the stage does not name its columns; give them, as 'vx_V:x_um vy_V:y_um'")
    return " ".join(map(str, stored))


def _columns(table: Table, stage: Stage, axes: str | None, quantity: str, options: dict[str, Any]) -> Any:
    """Return the columns (n, axes) of a quantity: those of --axes, by their names, or those of the records."""
    import numpy as np

    from dehyst._errors import FileFormatError
    from dehyst.stages.read import axis_columns

    if axes is not None and ":" not in axes:
        names = _bare(axes.replace(",", " ").split(), stage, quantity)
    else:
        written = [
            f"{'v' if quantity == 'voltage' else ''}{axis}_{'V' if quantity == 'voltage' else 'um'}"
            for axis in stage.axes
        ]
        found = axis_columns(axes or _stored(stage)) if axes or "axes" in stage.provenance else ()
        names = [getattr(one, quantity) for one in _in_order(found, stage)] or written
        if not axes and not set(names) <= set(table.names):
            names = written
    if len(names) != len(stage.axes):
        raise FileFormatError(f"axes: got {len(names)} columns, need one for each of {', '.join(stage.axes)}")
    scale = options.get(f"{quantity}_scale")
    return np.column_stack([table.column(quantity, name, scale) for name in names])


def _bare(entries: Sequence[str], stage: Stage, quantity: str) -> list[str]:
    """Return columns that are given as 'x_um', or 'x=b_um' with the name of the axis, in the order of the stage."""
    from dehyst._errors import FileFormatError

    named = {}
    for entry in entries:
        axis, _, column = entry.rpartition("=")
        word = column.rsplit("/", 1)[-1].rsplit("_", 1)[0]
        if quantity == "voltage" and not axis and word not in stage.axes:
            word = word.removeprefix("v")
        named[axis or word] = column
    if len(named) != len(entries) or set(named) != set(stage.axes):
        example = entries[0].rpartition("=")[2] if entries else "COLUMN"
        raise FileFormatError(
            f"axes: got {', '.join(entries)}, need a column for each of the axes {', '.join(stage.axes)}; name the "
            f"axis of each column, as '{stage.axes[0]}={example}'"
        )
    return [named[axis] for axis in stage.axes]


def _in_order(found: Sequence[AxisColumns], stage: Stage) -> list[AxisColumns]:
    """Return columns of axes in the order of those of a stage; raise `FileFormatError` if they have other names."""
    from dehyst._errors import FileFormatError

    named = {one.name: one for one in found}
    if found and set(named) != set(stage.axes):
        raise FileFormatError(
            f"axes: got {', '.join(named)}, the stage has {', '.join(stage.axes)}; name each axis, as "
            f"'{stage.axes[0]}=VOLTAGE:DISPLACEMENT'"
        )
    return [named[axis] for axis in stage.axes] if found else []


def _scanned(stage: Stage, scan: str, options: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """Return the wanted displacements: the scan on the axes x and y, or the first two, the others in their middle."""
    import numpy as np

    from dehyst._errors import ModelError

    if len(stage.axes) < 2:
        raise ModelError("--scan: needs a stage of two axes at least")
    path = named_scan(scan, options["sample_rate"], options)
    parts = [path.path("x"), path.path("y")]
    cycles = options.get("cycles") or 1
    if cycles != 1 or parts[0].periodic:
        parts = [part.repeated(cycles) for part in parts]
    middle = stage.coupling @ np.array([0.5 * sum(one.reach) for one in stage.actuators])
    wanted = np.tile(middle, (len(parts[0].time), 1))
    moved = [stage.axes.index(axis) if {"x", "y"} <= set(stage.axes) else k for k, axis in enumerate("xy")]
    for k, part in zip(moved, parts, strict=True):
        wanted[:, k] = part.displacement
    return wanted, {"time_s": parts[0].time}


def _named(stage: Stage, values: Any, quantity: str = "displacement") -> dict[str, Any]:
    before, after = ("v", "_V") if quantity == "voltage" else ("", "_um")
    return {f"{before}{axis}{after}": values[:, j] for j, axis in enumerate(stage.axes)}


def _limits(stage: Stage) -> tuple[Any, Any]:
    import numpy as np

    pairs = [one.limits or (-np.inf, np.inf) for one in stage.actuators]
    return np.array([low for low, _ in pairs]), np.array([high for _, high in pairs])


def _period(clock: dict[str, Any]) -> float | None:
    """Return the time between samples, if they are evenly spaced: the compensator checks its slew rate by it."""
    times = clock.get("time_s")
    return None if times is None or len(times) < 2 else float((times[-1] - times[0]) / (len(times) - 1))
