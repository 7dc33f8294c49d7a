"""`dehyst show`: what a file is understood as."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst._text import counted
from dehyst.cli.axes.assess import show_axes, show_stage
from dehyst.cli.axes.inputs import axes_option, is_stage
from dehyst.cli.common import (
    PATH,
    command_line,
    echo_files,
    force_option,
    json_option,
    refuse_overwriting,
    refuse_replacing,
    report_option,
)
from dehyst.cli.output.terminal import echo, echo_json, worded
from dehyst.cli.record_files import columns_options, record_in, table_of

if TYPE_CHECKING:
    from dehyst.records import Record
    from dehyst.records.formats.columns import Table

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
    refuse_overwriting([file], output, report)
    if is_stage(file):
        show_stage(file, as_json)
        return
    if axes is not None:
        _show_axes(file, axes, options, as_json)
        return
    table = table_of(file, options)
    if not as_json:
        _print_columns(table)
    record = record_in(table, file.stem, options)
    rows = _understood(record, options)
    if output is not None:
        from dehyst.records import write_record

        refuse_replacing(output)
        write_record(output, record)
    if report is not None:
        from dehyst.report import write_record_page

        refuse_replacing(report)
        write_record_page(report, record, rows, command=command_line())
    if as_json:
        echo_json(_numbers(record, table))
        return
    echo()
    width = max(len(row[1]) for row in rows)
    for quantity, column, words in rows:
        echo(f"{quantity + ':':<14}{column:<{width}}  {words}")
    problems = worded([*_unusable(record), *record.problems()])
    echo()
    echo("Notes:" if problems else "No problems found.")
    for sentence in problems:
        echo(f"  - {sentence}")
    echo()
    for line in _plot(record.voltage, record.displacement * 1e6, "voltage (V)", "displacement (um)"):
        echo(line)
    echo_files(Record=output, Report=report)


def _show_axes(file: Path, axes: str, options: dict[str, Any], as_json: bool) -> None:
    """Print what each axis of a file is understood as."""
    record = show_axes(file, axes, options)
    if as_json:
        echo_json({axis: _numbers(record.axis(j), table_of(file, options)) for j, axis in enumerate(record.axes)})
        return
    _print_columns(table_of(file, options))
    for j, axis in enumerate(record.axes):
        echo()
        echo(f"Axis {axis}")
        for quantity, _, words in _understood(record.axis(j), options):
            echo(f"  {quantity + ':':<14}{words}")
        for sentence in worded(record.axis(j).problems()):
            echo(f"  - {sentence}")


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
        return f"'{columns.get(quantity, quantity)}'{scale}"

    (v0, v1), (y0, y1) = record.voltage_range, record.displacement_range
    times = f"{record.time[0]:.6g} to {record.time[-1]:.6g} s, {1 / record.sample_time:.6g} Hz"
    volts = f"{v0:.5g} to {v1:.5g} V, {counted(len(record.cycles()), 'cycle')}"
    lengths = f"{y0 * 1e6:.5g} to {y1 * 1e6:.5g} um: {record.stroke * 1e6:.4g} um, noise {record.noise * 1e9:.2g} nm"
    named = {"time": times, "voltage": volts, "displacement": lengths}
    return [(quantity, origin(quantity), words) for quantity, words in named.items()]


def _numbers(record: Record, table: Table) -> dict[str, Any]:
    return {
        "name": record.name,
        "file_columns": [{"name": column.name, "unit": column.parts[1]} for column in table.columns],
        "columns": record.meta.get("columns", {}),
        "scales": record.meta.get("scales", {}),
        "samples": len(record),
        "sample_rate_Hz": 1 / record.sample_time,
        "duration_s": float(record.time[-1] - record.time[0]),
        "voltage_V": list(record.voltage_range),
        "displacement_um": [1e6 * value for value in record.displacement_range],
        "noise_nm": 1e9 * record.noise,
        "cycles": len(record.cycles()),
        "problems": list(worded([*_unusable(record), *record.problems()])),
    }


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
