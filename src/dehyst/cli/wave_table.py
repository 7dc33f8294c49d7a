"""The steady cycle of a scan as a wave table, for `dehyst compensate --cycle`."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dehyst._text import counted
from dehyst.cli.common import conclude, write_output
from dehyst.cli.output.terminal import note, progress_line
from dehyst.cli.start import (
    Request,
    delay_warnings,
    error_line,
    file_warnings,
    path_columns,
    promise_lines,
    start_dict,
)

if TYPE_CHECKING:
    from dehyst.control import PossibleStart, WaveTable
    from dehyst.waveforms import Scan


def tabulate(
    request: Request,
    scan: Scan,
    axis: str,
    cycles: int,
    outputs: tuple[Path, Path],
    options: dict[str, Any],
    remarks: Iterable[str] = (),
) -> None:
    """Write the wave table of a scan with its homing and start-up, and exit."""
    from dehyst.trust import judge

    refuse_cycles(scan, cycles)
    start, progress = _start(request, scan, axis), progress_line()
    table = _table(request, start, scan, axis, options)
    _note_duration(table, cycles)
    progress(f"writing {table.rows(cycles)} rows")
    played, cycle = table.played(cycles), table.cycle
    write_output(outputs[0], {"time_s": played.time, "phase": played.phase, **path_columns(played)})
    write_output(outputs[1], {"time_s": cycle.time, **path_columns(cycle)})
    progress("")
    actuator, first = request.actuator, table.homing_rows.size
    limits, path = request.limits or actuator.voltage_range, scan.path(axis)
    rates = {"velocity": path.velocity, "acceleration": path.acceleration}
    speed = request.slew.remarks(actuator, limits, path.displacement, path.time, **rates)
    warnings = [*table.warnings, *remarks, *speed, *_unwritten_warnings(request, start, table)]
    error = None
    if not start.known:
        error = start.error_along(actuator, played.voltage, limits, time=played.time, first=first)
    low, high = float(played.voltage.min()), float(played.voltage.max())
    judged = judge(actuator, path=error)
    result = {
        "samples": played.voltage.size,
        **_table_dict(table, scan, start_dict(start.name, error)),
        "lowest_V": low,
        "highest_V": high,
        **request.slew.as_dict(),
        "judgement": judged.as_dict(),
        "warnings": warnings,
        "state": table.state.as_dict(),
        "output": str(outputs[0]),
        "table": str(outputs[1]),
    }
    start_up = f"{counted(table.cycles, 'cycle')} of start-up, to {table.error * 1e6:.3g} um"
    if table.clamped:
        missed = float(abs(cycle.expected - cycle.displacement).max())
        start_up += request.slew.missed_words(limits, cycle.voltage, missed)
    lines = [
        f"{counted(played.voltage.size, 'sample')}, {low:.6g} to {high:.6g} V, the steady table after {start_up}: "
        f"{outputs[0]}; {counted(len(cycle), 'sample')} a cycle: {outputs[1]}"
    ]
    lines.append(request.slew.words)
    if error is not None:
        lines.append(error_line(start.name, error, homed=_homes(request)))
    conclude(request.as_json, result, [*lines, *promise_lines(request, judged)], warnings)
    sys.exit(0 if table.settled and table.certified and not table.clamped else 1)


def _table(request: Request, start: PossibleStart, scan: Scan, axis: str, options: dict[str, Any]) -> WaveTable:
    """Compute the wave table, after a homing unless the start was given or --no-home was."""
    from dehyst._errors import RecordError
    from dehyst.control import wave_table

    tolerance, progress = options["tolerance"], progress_line()
    if tolerance is not None and not tolerance > 0:
        raise RecordError(argument="tolerance", got=f"{tolerance:g}", need="a length above 0 in um")
    progress("homing, and the steady cycle")
    try:
        return wave_table(
            request.actuator,
            scan,
            axis=axis,
            limits=request.limits,
            slew_rate=request.slew.bound,
            state=None if _homes(request) else start.within(request.actuator, request.limits),
            present=request.present,
            approach=options["approach"],
            cycles=options["start_up"],
            tolerance=None if tolerance is None else tolerance * 1e-6,
        )
    finally:
        progress("")


def _homes(request: Request) -> bool:
    """Whether a homing comes first."""
    return request.start is None and request.home is not False


def _table_dict(table: WaveTable, scan: Scan, start: dict[str, Any]) -> dict[str, Any]:
    """Return a table and its `start` as JSON values."""
    return {
        "sample_rate_Hz": table.sample_rate,
        "frequency_Hz": 1 / scan.period,
        "start_up_samples": len(table.start_up),
        "start_up_cycles": table.cycles,
        "cycle_samples": len(table.cycle),
        "error_um": table.error * 1e6,
        "unknown_um": table.unknown * 1e6,
        **start,
        "homing_samples": table.homing_rows.size,
        "homing_s": _homing_seconds(table),
        "certified": table.certified,
        "settled": table.settled,
        "clamped": table.clamped,
    }


def _start(request: Request, scan: Scan, axis: str) -> PossibleStart:
    """Return the start that was given, or the unknown one at the first sample."""
    from dehyst.control import PossibleStart

    if request.start is not None:
        return request.start
    first, limits = float(scan.path(axis).displacement[0]), request.limits or request.actuator.limits
    return PossibleStart.unknown_near(request.actuator, first, limits)


def _unwritten_warnings(request: Request, start: PossibleStart, table: WaveTable) -> list[str]:
    """Warn of what the file does not contain."""
    actuator = request.actuator
    if table.homing is not None:
        return delay_warnings(actuator)
    begin = start.within(actuator, request.limits)
    return file_warnings(actuator, float(table.start_up.voltage[0]), start, begin, request.slew.bound)


def _homing_seconds(table: WaveTable) -> float:
    return 0.0 if table.homing is None else table.homing.duration


def refuse_cycles(scan: Scan, cycles: int) -> None:
    """Refuse a number of cycles that no file should hold."""
    from dehyst._errors import RecordError
    from dehyst.control.planning.path import MOST_ROWS

    if cycles < 0:
        raise RecordError(argument="--cycles", got=cycles, need="a whole number, 0 or more")
    if scan.samples > MOST_ROWS:
        raise RecordError(
            argument="scan",
            got=f"{scan.samples} rows a period at {scan.rate:g} Hz",
            need=f"at most {MOST_ROWS:g}",
            hint="try a lower --sample-rate, or a scan of fewer lines",
        )
    if cycles * scan.samples > MOST_ROWS:
        raise RecordError(
            argument="--cycles",
            got=f"{cycles}, {cycles * scan.samples:.4g} rows",
            need=f"at most {MOST_ROWS // scan.samples} ({MOST_ROWS:g} rows)",
            hint="repeat one cycle instead",
        )


def _note_duration(table: WaveTable, cycles: int) -> None:
    """Print how long the written voltage plays; raises RecordError if a file should not hold so many rows."""
    from dehyst._errors import RecordError
    from dehyst.control.planning.path import MOST_ROWS

    rows, rate = table.rows(cycles), table.sample_rate
    parts = (
        (_homing_seconds(table), "homing"),
        (len(table.start_up) / rate, "start-up"),
        (cycles * len(table.cycle) / rate, "cycles"),
    )
    durations = ", ".join(f"{seconds:.4g} s of {name}" for seconds, name in parts if seconds)
    if rows > MOST_ROWS:
        raise RecordError(
            argument="--output",
            got=f"{durations}, {rows} rows at {rate:g} Hz",
            need=f"at most {MOST_ROWS:g} rows",
            hint="try a lower --sample-rate, fewer --cycles or --start-up, or --start where the actuator stands",
        )
    note(f"{durations}: {rows} rows")
    homing = table.homing
    if homing is not None and table.homing_rows.size < homing.duration * rate - 0.5:
        note(
            f"the homing has {table.homing_rows.size} rows, {1 / homing.sample_rate:.3g} s or more apart: play it "
            "by its time column, straight from row to row"
        )
