"""`dehyst calibrate`: the whole experiment on an instrument."""

from __future__ import annotations

import signal
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst.cli.common import (
    PATH,
    command_line,
    force_option,
    json_option,
    limits_option,
    refuse_replacing,
)
from dehyst.cli.record_files import size_option
from dehyst.cli.terminal import echo, echo_json, note

if TYPE_CHECKING:
    from dehyst.instruments import AbstractRig
    from dehyst.instruments.calibration import Calibration, Plan
    from dehyst.waveforms import Excitation


REPORT = "report.html"


@click.command()
@click.argument("rig", metavar="RIG")
@click.option(
    "-o",
    "--output",
    type=PATH,
    default=Path("dehyst-calibration"),
    show_default=True,
    help="Folder for records, model and report. Complete records in it are not played again, "
    "except one loop that must agree with them.",
)
@limits_option("the device's", "Range of the voltage.")
@click.option("--slew", type=float, metavar="V/S", help="Largest slew rate.  [default: the whole range in 0.1 s]")
@click.option("--frequency", type=float, default=1.0, show_default=True, metavar="HZ", help="Loops a second.")
@click.option("--hold", type=float, metavar="S", help="Hold at each step, for creep.  [default: three cycles]")
@click.option(
    "--protocol",
    type=PATH,
    multiple=True,
    metavar="FILE",
    help="Record this voltage (from dehyst excite) instead of suggested ones; may be repeated.",
)
@click.option(
    "--rounds", type=int, default=2, show_default=True, metavar="N", help="Rounds of further, suggested recordings."
)
@click.option(
    "--goal", type=float, default=1.0, show_default=True, metavar="PERCENT", help="Largest error allowed on the path."
)
@force_option
@click.option("--dry-run", is_flag=True, help="Print what would be sent, and send nothing.")
@size_option
@json_option
def calibrate(
    rig: str,
    output: Path,
    limits: tuple[float, float] | None,
    slew: float | None,
    dry_run: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Home, excite, record, identify, compensate and measure the actuator on RIG.

    RIG: pi://HOST:PORT, epics://PREFIX, sim://play, or FILE.py:FUNCTION, which returns a rig of your own.

    Ctrl-C brings the voltage to a safe value; the same command continues from the records on disk.
    """
    from dehyst.instruments import open_rig
    from dehyst.instruments.calibration import Plan

    max_bytes = options.pop("max_bytes")
    given = tuple(_excitation(path, max_bytes) for path in options.pop("protocol"))
    plan = Plan(protocol=given, **options)
    if not dry_run:
        _refuse_replacing(output)
    with _reported_errors(output), open_rig(rig, limits=limits, slew_rate=slew) as instrument:
        _note_narrower(instrument, limits, slew)
        if dry_run:
            _print_plan(instrument, plan, as_json)
            return
        calibration = _run(instrument, output, plan)
    _print(calibration, output, as_json)
    sys.exit(0 if calibration.good else 1)


def _refuse_replacing(folder: Path) -> None:
    """Refuse a folder in which results would replace foreign files."""
    from dehyst._io.marks import format_of
    from dehyst.instruments.calibration.experiment import RESULTS
    from dehyst.instruments.calibration.session import FORMAT

    if format_of(folder / "campaign.json") != FORMAT:
        refuse_replacing(*(folder / name for name in (*RESULTS, REPORT)))


def _excitation(path: Path, max_bytes: float) -> Excitation:
    """Read a voltage to play from a file with evenly spaced times."""
    import numpy as np

    from dehyst._errors import FileFormatError
    from dehyst.records import read_table
    from dehyst.records.files import time_of
    from dehyst.waveforms import Excitation

    table = read_table(path, max_bytes=max_bytes)
    voltage = table.column("voltage")
    time = time_of(table, voltage.size, None, None)
    steps = np.diff(time)
    if not steps.size or float(np.ptp(steps)) > 1e-3 * float(np.median(steps)):
        raise FileFormatError(f"{path}: the times are not evenly spaced; write it with dehyst excite, or resample it")
    return Excitation(path.stem, voltage, 1 / float(np.median(steps)))


def _note_narrower(rig: AbstractRig, limits: tuple[float, float] | None, slew: float | None) -> None:
    """Print where the device allows less than was requested."""
    allowed = rig.limits
    if limits is not None and (allowed.low, allowed.high) != limits:
        note(f"{limits[0]:g} to {limits[1]:g} V was given, the device allows {allowed.words}")
    if slew is not None and rig.slew_rate < slew:
        note(f"{slew:g} V/s was given, the device allows {rig.slew_rate:.6g} V/s")


def _print_plan(rig: AbstractRig, plan: Plan, as_json: bool) -> None:
    """Print what would be sent."""
    import numpy as np

    from dehyst.instruments.calibration.plan import steps

    entries = []
    for step in steps(rig, plan):
        entry: dict[str, Any] = {"step": step.name, "what": step.words}
        if (voltage := step.excitation) is not None:
            rate = rig.nearest_rate(voltage.sample_rate)
            low, high = voltage.voltage_range
            entry |= {
                "samples": len(voltage),
                "seconds": (len(voltage) - 1) / rate,
                "lowest_V": low,
                "highest_V": high,
                "steepest_V_per_s": float(np.abs(np.diff(voltage.voltage)).max()) * rate,
            }
        entries.append(entry)
    allowed = {
        "rig": rig.name,
        "axis": rig.axis,
        "limits_V": [rig.limits.low, rig.limits.high],
        "slew_rate_V_per_s": rig.slew_rate,
        "safe_V": rig.safe,
    }
    if as_json:
        echo_json({**allowed, "steps": entries})
        return
    echo(f"{rig.name}, axis {rig.axis}: {rig.limits.words}, at most {rig.slew_rate:.6g} V/s; nothing was sent")
    for entry in entries:
        numbers = ""
        if "samples" in entry:
            numbers = (
                f"{entry['seconds']:8.1f} s {entry['samples']:7d} samples, {entry['lowest_V']:.6g} to "
                f"{entry['highest_V']:.6g} V, up to {entry['steepest_V_per_s']:.4g} V/s; "
            )
        echo(f"  {entry['step']:12s}{numbers}{entry['what']}")
    seconds = sum(entry.get("seconds", 0.0) for entry in entries)
    echo(f"up to {seconds:.0f} s of playing in all, and further recordings that are suggested on the way")


def _run(rig: AbstractRig, output: Path, plan: Plan) -> Calibration:
    from dehyst.cli.live import display
    from dehyst.instruments.calibration import calibrate as run
    from dehyst.instruments.calibration.plan import STEPS
    from dehyst.report import write_calibration

    with display(STEPS) as live:
        calibration = run(rig, output, plan=plan, watcher=live)
        live.step("report")
        write_calibration(output / REPORT, calibration, command=command_line())
        return calibration


@contextmanager
def _reported_errors(output: Path) -> Iterator[None]:
    """Print what happened to voltage and samples, instead of a traceback, when an instrument or the user stops it."""
    from dehyst._errors import DehystError

    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_, **__: note(str(message))
        try:
            yield
        except (DehystError, KeyboardInterrupt, SystemExit) as error:
            reason = str(error) if isinstance(error, DehystError) else f"stopped by {_stopper(error)}"
            for line in (reason, *getattr(error, "__notes__", ()), *_left(output, error)):
                note(line)
            sys.exit(_status(error))


def _stopper(error: BaseException) -> str:
    """Name what stopped it: Ctrl-C, or a signal."""
    if isinstance(error, KeyboardInterrupt):
        return "Ctrl-C"
    try:
        return signal.Signals(_status(error) - 128).name
    except ValueError:
        return "a request to exit"


def _left(output: Path, error: BaseException) -> Iterator[str]:
    """Yield where samples are, and whether the same command continues, as sentences."""
    from dehyst._errors import RigError

    records = output / "records"
    if any(records.glob("*.h5*")):
        # A full disk may have room later; a folder of another instrument remains one.
        temporary = isinstance(error, RigError) or isinstance(error.__cause__, OSError)
        again = not isinstance(error, Exception) or temporary
        yield f"what was recorded is in {records}" + ("; the same command goes on from there" if again else "")


def _status(error: BaseException) -> int:
    from dehyst._errors import DeviceError, LinkError, SensorError

    if isinstance(error, KeyboardInterrupt):
        return 130
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else 1
    return 1 if isinstance(error, LinkError | DeviceError | SensorError) else 2


def _kept(calibration: Calibration) -> Iterator[str]:
    """Yield what was not measured now, as sentences."""
    if calibration.agreement is not None:
        yield calibration.agreement.words
    if calibration.kept and not calibration.played:
        yield (
            f"nothing else was played: all else is from records on disk, {calibration.since}; give another -o to "
            "measure anew"
        )
    elif calibration.kept:
        yield (
            f"from records on disk, {calibration.since}, not played again: {', '.join(calibration.kept)}; give "
            "another -o to measure anew"
        )


def _print(calibration: Calibration, output: Path, as_json: bool) -> None:
    if as_json:
        echo_json({**calibration.as_dict(), "output": str(output)})
        return
    for warning in (*_kept(calibration), *calibration.warnings()):
        note(warning)
    fit = calibration.fit
    echo(f"{fit.outcome.value}")
    for error in fit.errors:
        echo(
            f"  {error.record:12s} {error.role:12s} largest {error.largest_percent:6.3f} %  RMS "
            f"{error.rms_percent:6.3f} % of the stroke"
        )
    echo("Measured along a path of nine reversals, in % of the stroke:")
    for name, path in (("nominal", calibration.nominal), ("compensated", calibration.compensated)):
        echo(f"  {name:12s} largest {path.largest_percent:6.3f} %  RMS {path.rms_percent:6.3f} %")
    echo(f"model.json, report.html, calibration.json and records: {output}")
