"""`dehyst show`: what a file is understood as."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst._errors import DehystError
from dehyst._text import counted
from dehyst.cli.common import (
    PATH,
    REFUSED,
    command_line,
    echo_files,
    force_option,
    json_option,
    refuse_overwriting,
    refuse_unused,
    report_option,
)
from dehyst.cli.models import AxesModel, axes_option, is_stage
from dehyst.cli.output.terminal import echo, echo_json
from dehyst.cli.record_files import AXES_COLUMNS, COLUMNS, columns_options, record_in, table_of

if TYPE_CHECKING:
    from dehyst.records import Record
    from dehyst.records.formats.columns import Table

# What a guess is marked with, and the factor and unit in which values of a quantity are shown.
_GUESSED = "guessed, verify"
_SHOWN = {"time": (1.0, "s"), "voltage": (1.0, "V"), "displacement": (1e6, "um")}
# Columns of a file that are listed.
_MOST = 40
# Characters of the drawing.
_WIDTH, _HEIGHT = 60, 16


@click.command()
@click.argument("file", type=PATH)
@click.option("-o", "--output", type=PATH, help="Write the record here, in s, V and um (.csv) or m (.npz).")
@report_option
@axes_option()
@force_option
@columns_options
@json_option
def show(file: Path, output: Path | None, report: Path | None, axes: str | None, as_json: bool, **options: Any) -> None:
    """Print what a FILE is understood as: columns, units, sample rate, cycles and problems; and draw its loop.

    The status is 2 if it is no record; the message holds the options that may make it one.
    """
    if is_stage(file):
        refuse_unused("with a stage")
        _show_model(AxesModel.read(file), as_json)
        return
    taken = AXES_COLUMNS if axes is not None else COLUMNS
    refuse_unused("with --axes", "output", "report", "force", "axes", *taken)
    from dehyst.records.tables import axis_columns

    refuse_overwriting([file], output, report)
    table = table_of(file, options)
    if not as_json:
        _print_columns(table)
    try:
        record = record_in(table, file.stem, options, axes)
    except DehystError:
        if as_json:
            # The columns among which to choose.
            click.get_current_context().meta[REFUSED] = {"file_columns": _columns(table)}
        raise
    chosen = [options] if axes is None else [{**options, **one._asdict()} for one in axis_columns(axes)]
    parts = record.by_axis()
    rows = [_understood(part, own) for part, own in zip(parts, chosen, strict=True)]
    if output is not None:
        from dehyst.records import write_record

        write_record(output, record)
    if report is not None:
        from dehyst.report import write_record_page

        write_record_page(report, record, [row for own in rows for row in own], command=command_line())
    if as_json:
        numbers = [_numbers(part, table) for part in parts]
        echo_json(numbers[0] if axes is None else dict(zip(record.axes, numbers, strict=True)))
        return
    for axis, part, own, words in zip(record.axes or ("",), parts, chosen, rows, strict=True):
        echo()
        if axis:
            echo(f"Axis {axis}")
        _print_axis(part, table, own, words)
    echo_files(Record=output, Report=report)


def _show_model(model: AxesModel, as_json: bool) -> None:
    """Print a stage file."""
    stage = model.stage
    if stage is None:
        return
    if as_json:
        echo_json(stage.as_dict())
    else:
        for line in stage.summary().split("\n"):
            echo(line)


def _print_axis(record: Record, table: Table, options: dict[str, Any], rows: list[tuple[str, str, str]]) -> None:
    """Print what the columns of an axis are understood as, what is suspicious, and the loop."""
    width = max(len(row[1]) for row in rows)
    for quantity, column, words in rows:
        echo(f"{quantity + ':':<14}{column:<{width}}  {words}")
    echo()
    echo("First and last value, as written and as understood:")
    for end in _ends(record, table, options):
        (first, last), (a, b) = end["written"], end["understood"]
        echo(f"  {end['column']}: {first} ... {last} -> {a:.6g} ... {b:.6g} {end['unit']}{end['mark']}")
    problems = [*_unusable(record), *record.problems()]
    echo()
    echo("Notes:" if problems else "No problems found.")
    for sentence in problems:
        echo(f"  - {sentence}")
    echo()
    for line in _plot(record.voltage, record.displacement * 1e6, "voltage (V)", "displacement (um)"):
        echo(line)


def _print_columns(table: Table) -> None:
    """Print the columns of a file, as the file has them."""
    samples = max((column.data.size for column in table.columns), default=0)
    echo(f"{table.source}: {counted(samples, 'sample')} of {counted(len(table.columns), 'column')}")
    shown = table.columns[:_MOST]
    width = max(6, *(min(len(column.name), 60) for column in shown))
    echo(f"  {'column':<{width}}  {'unit':<8}range")
    for column in shown:
        unit = column.parts[1] or "-"
        words = (
            column.fault
            or f"{column.data.min(initial=float('inf')):.6g} to {column.data.max(initial=-float('inf')):.6g}"
        )
        echo(f"  {column.name[:60]:<{width}}  {unit[:7]:<8}{words}")
    if len(table.columns) > _MOST:
        echo(f"  and {len(table.columns) - _MOST} more")


def _understood(record: Record, options: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Return quantity, column and range of each quantity, in words."""
    columns = record.meta.get("columns", {})
    scales = {name: options[f"{name}_scale"] for name in ("voltage", "displacement") if options[f"{name}_scale"]}

    def origin(quantity: str) -> str:
        scale = f", {scales[quantity]}" if quantity in scales else ""
        mark = f" ({_GUESSED})" if _guessed(record, quantity, options) else ""
        return f"'{columns.get(quantity) or options.get(quantity) or quantity}'{scale}{mark}"

    (v0, v1), (y0, y1) = record.voltage_range, record.displacement_range
    times = f"{record.time[0]:.6g} to {record.time[-1]:.6g} s, {1 / record.sample_time:.6g} Hz"
    volts = f"{v0:.5g} to {v1:.5g} V, {counted(len(record.cycles()), 'cycle')}"
    lengths = f"{y0 * 1e6:.5g} to {y1 * 1e6:.5g} um: {record.stroke * 1e6:.4g} um, noise {record.noise * 1e9:.2g} nm"
    named = {"time": times, "voltage": volts, "displacement": lengths}
    for one in record.others:
        unit = one.unit.replace("degC", "°C")
        named[one.name] = f"{one.values.min():.5g} to {one.values.max():.5g} {unit}"
    return [(quantity, origin(quantity), words) for quantity, words in named.items()]


def _guessed(record: Record, quantity: str, options: dict[str, Any]) -> bool:
    """Return whether a quantity of a record, or of the axis that has the `name` in the options, is guessed."""
    guesses = record.meta.get("guesses", {})
    return quantity in guesses or f"{quantity} of {options.get('name')}" in guesses


def _ends(record: Record, table: Table, options: dict[str, Any]) -> list[dict[str, Any]]:
    """Return first and last value of each column that is used, as the file has them and as the record does."""
    ends = []
    timed = ("time",) if options["sample_rate"] is None else ()
    for quantity in (*timed, "voltage", "displacement"):
        column = table.select(quantity, options[quantity]).column
        # Joining cuts and interpolates rows.
        cells = ("", "") if options["join"] else column.ends
        written = [cell or f"{value:.9g}" for cell, value in zip(cells, column.data[[0, -1]], strict=True)]
        stated = column.parts[1]
        values, factor, unit = getattr(record, quantity)[[0, -1]], *_SHOWN[quantity]
        ends.append(
            {
                "column": column.name if not stated or stated in column.name else f"{column.name} [{stated}]",
                "quantity": quantity,
                "written": written,
                "understood": [float(value) * factor for value in values],
                "unit": unit,
                "mark": f" ({_GUESSED})" if _guessed(record, quantity, options) else "",
            }
        )
    return ends


def _numbers(record: Record, table: Table) -> dict[str, Any]:
    return {
        "name": record.name,
        "file_columns": _columns(table),
        "columns": record.meta.get("columns", {}),
        "scales": record.meta.get("scales", {}),
        "guesses": record.meta.get("guesses", {}),
        "samples": len(record),
        "sample_rate_Hz": 1 / record.sample_time,
        "duration_s": float(record.time[-1] - record.time[0]),
        "voltage_V": list(record.voltage_range),
        "displacement_um": [1e6 * value for value in record.displacement_range],
        "others": {one.column: [float(one.values.min()), float(one.values.max())] for one in record.others},
        "noise_nm": 1e9 * record.noise,
        "cycles": len(record.cycles()),
        "problems": [*_unusable(record), *record.problems()],
    }


def _columns(table: Table) -> list[dict[str, str]]:
    return [{"name": column.name, "unit": column.parts[1]} for column in table.columns]


def _unusable(record: Record) -> list[str]:
    """Return why no loop can be identified from a record; nothing if one can."""
    from dehyst._errors import RecordError

    try:
        record.check_usable()
    except RecordError as error:
        return [f"Not usable for an identification: {error}."]
    return []


def _plot(x: Any, y: Any, x_label: str, y_label: str) -> list[str]:
    """Return the lines of a plot of finite arrays (n,), with the ends of both ranges at its axes."""
    import numpy as np

    cells = np.full((_HEIGHT, _WIDTH), " ")
    cells[_HEIGHT - 1 - _places(y, _HEIGHT), _places(x, _WIDTH)] = "*"
    ends = [f"{value:.4g}" for value in (float(np.max(y)), float(np.min(y)))]
    margin = max(map(len, ends))
    marks = {0: ends[0], _HEIGHT - 1: ends[1]}
    rows = [f"{marks.get(k, ''):>{margin}} |{''.join(row)}".rstrip() for k, row in enumerate(cells)]
    low, high = f"{float(np.min(x)):.4g}", f"{float(np.max(x)):.4g}"
    below = f"{low}{x_label:^{_WIDTH - len(low) - len(high)}}{high}"
    return [f"{'':>{margin}}  {y_label}", *rows, f"{'':>{margin}} +{'-' * _WIDTH}", f"{'':>{margin}}  {below}"]


def _places(values: Any, count: int) -> Any:
    """Return the cell of each value, 0 to count - 1."""
    import numpy as np

    low, span = float(np.min(values)), float(np.ptp(values))
    if span == 0:
        return np.zeros(len(values), dtype=np.intp)
    return np.minimum(((np.asarray(values) - low) / span * count).astype(np.intp), count - 1)
