"""The steady cycle of a scan as a wave table, for `dehyst compensate --cycle`."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dehyst._text import counted
from dehyst.cli.common import conclude, refuse_replacing, write_output
from dehyst.cli.scans import in_options
from dehyst.cli.start import (
    Request,
    begin_within,
    delay_warnings,
    error_line,
    file_warnings,
    start_dict,
)
from dehyst.cli.terminal import note, progress_line

if TYPE_CHECKING:
    from dehyst.control import PossibleStart, StartError, WaveTable
    from dehyst.control.wave_table import Played
    from dehyst.waveforms import Scan

# A larger file is more than 300 MB.
_MOST_ROWS = 5_000_000


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
    from dehyst._errors import RecordError
    from dehyst.control import wave_table

    refuse_cycles(scan, cycles)
    actuator, limits, slew = request.actuator, request.limits, request.slew
    start, home = _start(request, scan, axis), request.start is None and request.home is not False
    tolerance, progress = options["tolerance"], progress_line()
    if tolerance is not None and not tolerance > 0:
        raise RecordError(f"--tolerance: got {tolerance:g}, need a length above 0 in um")
    progress("homing, and the steady cycle")
    try:
        table = wave_table(
            actuator,
            scan,
            axis=axis,
            limits=limits,
            slew_rate=slew,
            state=None if home else begin_within(actuator, start, limits),
            present=request.present,
            approach=options["approach"],
            cycles=options["start_up"],
            tolerance=None if tolerance is None else tolerance * 1e-6,
        )
    finally:
        progress("")
    _note_duration(table, cycles)
    progress(f"writing {table.rows(cycles)} rows")
    played, cycle = table.played(cycles), table.cycle
    refuse_replacing(*outputs)
    write_output(outputs[0], {"time_s": played.time, "phase": played.phase, **_columns(played)})
    write_output(outputs[1], {"time_s": cycle.time, **_columns(cycle)})
    progress("")
    warnings = [*map(in_options, table.warnings), *remarks, *_unwritten_warnings(request, start, table)]
    error = _start_error(request, start, table, played)
    low, high = float(played.voltage.min()), float(played.voltage.max())
    result = {
        "samples": played.voltage.size,
        "sample_rate_Hz": table.sample_rate,
        "frequency_Hz": 1 / scan.period,
        "start_up_samples": len(table.start_up),
        "start_up_cycles": table.cycles,
        "cycle_samples": len(cycle),
        "error_um": table.error * 1e6,
        "unknown_um": table.unknown * 1e6,
        **start_dict(start.name, error),
        "homing_samples": table.homing_rows.size,
        "homing_s": _homing_seconds(table),
        "certified": table.certified,
        "settled": table.settled,
        "clamped": table.clamped,
        "lowest_V": low,
        "highest_V": high,
        "warnings": warnings,
        "state": table.state.as_dict(),
        "output": str(outputs[0]),
        "table": str(outputs[1]),
    }
    cycles_of = f"{table.cycles} cycle{'s' * (table.cycles != 1)} of start-up, to {table.error * 1e6:.3g} um"
    line = (
        f"{counted(played.voltage.size, 'sample')}, {low:.6g} to {high:.6g} V, the steady table after {cycles_of}: "
        f"{outputs[0]}; {counted(len(cycle), 'sample')} a cycle: {outputs[1]}"
    )
    lines = [line]
    if error is not None:
        lines.append(error_line(start.name, error, homed=home))
    conclude(request.as_json, result, lines, warnings)
    sys.exit(0 if table.settled and table.certified and not table.clamped else 1)


def _columns(part: Any) -> dict[str, Any]:
    return {"displacement_um": part.displacement * 1e6, "voltage_V": part.voltage, "expected_um": part.expected * 1e6}


def _start(request: Request, scan: Scan, axis: str) -> PossibleStart:
    """Return the start that was given, or the unknown one at the first sample."""
    from dehyst.control import start_at

    if request.start is not None:
        return request.start
    return start_at(request.actuator, float(scan.path(axis).displacement[0]), request.limits or request.actuator.limits)


def _start_error(request: Request, start: PossibleStart, table: WaveTable, played: Played) -> StartError | None:
    """Return what the start leaves open after the homing; None if it was given, and is known."""
    from dehyst.control import PossibleStart, StartError

    if start.known:
        return None
    states, limits = start.states, request.limits or request.actuator.limits
    if start.name == "unknown":
        states = PossibleStart.unknown(request.actuator, float(played.voltage[0]), limits).states
    first = table.homing_rows.size
    return StartError.along(request.actuator, states, played.voltage, time=played.time, first=first)


def _unwritten_warnings(request: Request, start: PossibleStart, table: WaveTable) -> list[str]:
    """Warn of what the file does not contain."""
    actuator = request.actuator
    if table.homing is not None:
        return delay_warnings(actuator)
    begin = begin_within(actuator, start, request.limits)
    return file_warnings(actuator, float(table.start_up.voltage[0]), start, begin, request.slew)


def _homing_seconds(table: WaveTable) -> float:
    return 0.0 if table.homing is None else table.homing.duration


def refuse_cycles(scan: Scan, cycles: int) -> None:
    """Refuse a number of cycles that no file should hold."""
    from dehyst._errors import RecordError

    if cycles < 0:
        raise RecordError(f"--cycles: got {cycles}, need a whole number, 0 or more")
    if scan.samples > _MOST_ROWS:
        raise RecordError(
            f"--scan: got {scan.samples} rows a period at {scan.rate:g} Hz, need at most {_MOST_ROWS:g}; try a lower "
            "--sample-rate, or a scan of fewer lines"
        )
    if cycles * scan.samples > _MOST_ROWS:
        raise RecordError(
            f"--cycles: got {cycles}, {cycles * scan.samples:.4g} rows, need at most {_MOST_ROWS // scan.samples} "
            f"({_MOST_ROWS:g} rows); repeat one cycle instead"
        )


def _note_duration(table: WaveTable, cycles: int) -> None:
    """Print how long the written voltage plays; raises RecordError if a file should not hold so many rows."""
    from dehyst._errors import RecordError

    rows, rate = table.rows(cycles), table.sample_rate
    parts = (
        (_homing_seconds(table), "homing"),
        (len(table.start_up) / rate, "start-up"),
        (cycles * len(table.cycle) / rate, "cycles"),
    )
    durations = ", ".join(f"{seconds:.4g} s of {name}" for seconds, name in parts if seconds)
    if rows > _MOST_ROWS:
        raise RecordError(
            f"--output: got {durations}, {rows} rows at {rate:g} Hz, need at most {_MOST_ROWS:g} rows; try a lower "
            "--sample-rate, fewer --cycles or --start-up, or --start where the actuator stands"
        )
    note(f"{durations}: {rows} rows")
    homing = table.homing
    if homing is not None and table.homing_rows.size < homing.duration * rate - 0.5:
        note(
            f"the homing has {table.homing_rows.size} rows, {1 / homing.sample_rate:.3g} s or more apart: play it "
            "by its time column, straight from row to row"
        )
