"""`calibrate`: the whole experiment on an instrument."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from dehyst._errors import DehystError, RigError
from dehyst._io import demand_own_folder
from dehyst.calibration import Calibration, Plan
from dehyst.calibration import calibrate as run_calibration
from dehyst.calibration.plan import read_voltage, steps
from dehyst.identification import Fit
from dehyst.instruments import AbstractRig, open_rig
from dehyst.operations.axes import limits_of, limits_option, numbers_of, slew_option
from dehyst.operations.command import CONTINUED, INPUT, Only, Values, command, number, option, output
from dehyst.operations.paths import bounds_remarks
from dehyst.operations.run import Result, Run
from dehyst.report import write_report

REPORT = "report.html"


def _names(given: Values) -> list[str] | None:
    """Return the names of several axes; None for one."""
    if given.get("axes") is not None:
        return [name.strip() for name in given["axes"].split(",")]
    last = str(given["rig"]).rpartition("/")[2]
    return last.split(",") if given["rig"].lower().startswith("pi://") and "," in last else None


_single = Only(lambda given: _names(given) is None, "with several axes")


@command("calibrate")
@click.argument("rig")
@output("Folder: new, empty, or an earlier calibration's, which goes on.", CONTINUED, default="dehyst-calibration")
@option("--axes", help="Calibrate these axes of one body together, as 1,2,3; default: one axis.")
@limits_option("Range of the voltage [V]; default: the device's.")
@slew_option("Largest slew rate [V/s]; default: the whole range in 0.1 s.")
@number("--frequency", help="Cycles per second [Hz] of the slowest loops; default: 0.1, and 1 for several axes.")
@option("--protocol", type=INPUT, multiple=True, only=_single, help="Record these voltages of dehyst excite instead.")
@number("--goal", default=1.0, help="Largest error [% of the stroke] of a good calibration, on every axis.")
@option("--dry-run", is_flag=True, help="Print what would be sent, and send nothing.")
def calibrate(
    run: Run,
    rig: str,
    output: Path,
    axes: str | None,
    limits: Sequence[tuple[str, float]],
    slew_rate: Sequence[str],
    frequency: float | None,
    protocol: tuple[Path, ...],
    goal: float,
    dry_run: bool,
) -> Result:
    """Home, excite, record, identify, compensate and measure the actuator on RIG.

    RIG: pi://HOST:PORT, epics://PREFIX, sim://, or FILE.py:FUNCTION, which returns a rig of your own. Several axes
    of one rig: pi://HOST:PORT/1,2,3, or --axes 1,2,3.

    Ctrl-C brings the voltage to a safe value; the same command continues from the records on disk.
    """
    names = _names({"rig": rig, "axes": axes})
    every = names or [""]
    allowed, rates = limits_of(every, limits), numbers_of(every, slew_rate, "slew_rate")
    steepest = [None if rate is None or rate == math.inf else rate for rate in rates]
    played = tuple(map(read_voltage, protocol))
    plan = Plan(protocol=played, frequency=frequency, goal=goal)
    if not dry_run and not (output / "records").is_dir():
        demand_own_folder(output, "records", "", force=run.force)
    # A rig of one axis need not know lists.
    several = len(every) > 1
    bounds, steep = allowed if several else allowed[0], steepest if several else steepest[0]
    with (
        _left(output),
        open_rig(rig, names, limits=bounds, slew_rate=steep) as instrument,
    ):
        if len(instrument.axes) != len(every):
            raise RigError(f"{instrument.name}: has several axes; give --axes {','.join(instrument.axes)}")
        for part, wanted, rate in zip(instrument.rigs, allowed, rates, strict=True):
            device = f"axis {part.axis} of the device" if names else "the device"
            for remark in bounds_remarks(wanted, rate, part.limits, f"{device} allows no more"):
                run.note(remark)
        if dry_run:
            return _planned(instrument, plan)
        calibration = _calibrated(run, instrument, output, plan)
    kept = calibration.kept
    warnings = []
    if kept:
        warnings.append(f"from records on disk, {calibration.since}, not played again: {', '.join(kept)}; {_ANEW}")
    fields = {**calibration.as_dict(), "output": str(output)}
    warnings += calibration.warnings()
    return Result(fields, [*_lines(calibration, output)], warnings=warnings, good=calibration.good)


_ANEW = "give another -o to measure anew"


@contextmanager
def _left(output: Path) -> Iterator[None]:
    """Add to the error that ends a calibration where its records are, and whether the same command continues."""
    try:
        yield
    except (DehystError, KeyboardInterrupt, SystemExit) as error:
        records = output / "records"
        if any(records.glob("*.csv")):
            # A full disk may have room later; a folder of another instrument remains one.
            temporary = isinstance(error, RigError) or isinstance(error.__cause__, OSError)
            continues = not isinstance(error, Exception) or temporary
            end = "; the same command goes on from there" if continues else ""
            error.add_note(f"the records so far are in {records}{end}")
        raise


def _planned(rig: AbstractRig, plan: Plan) -> Result:
    """Return the voltages that would be sent, as JSON values and lines."""
    planned, several = [step.as_dict(rig) for step in steps(rig, plan)], len(rig.axes) > 1
    columns: dict[str, list[Any]] = {
        "axes" if several else "axis": list(rig.axes),
        "limits_V": [[part.limits.low, part.limits.high] for part in rig.rigs],
        "slew_rate_V_per_s": [part.slew_rate for part in rig.rigs],
        "safe_V": [part.safe for part in rig.rigs],
    }
    allowed = columns if several else {name: values[0] for name, values in columns.items()}
    bounds = "; ".join(f"axis {part.axis}: {part.limits.words}, at most {part.slew_rate:.6g} V/s" for part in rig.rigs)
    seconds = sum(entry["seconds"] for entry in planned)
    lines = [
        f"{rig.name}, {bounds}; nothing was sent",
        *_step_lines(planned),
        f"up to {seconds:.0f} s of playing in all",
    ]
    return Result({"rig": rig.name, **allowed, "steps": planned}, lines)


def _step_lines(planned: Sequence[dict[str, Any]]) -> Iterator[str]:
    def joined(values: float | list[float], digits: int = 6) -> str:
        return ", ".join(f"{value:.{digits}g}" for value in (values if isinstance(values, list) else [values]))

    for entry in planned:
        yield (
            f"  {entry['step']:12s}{entry['seconds']:8.1f} s {entry['samples']:7d} samples, "
            f"{joined(entry['lowest_V'])} to {joined(entry['highest_V'])} V, "
            f"up to {joined(entry['steepest_V_per_s'], 4)} V/s; {entry['what']}"
        )


def _calibrated(run: Run, rig: AbstractRig, output: Path, plan: Plan) -> Calibration:
    if len(rig.axes) > 1:
        for line in _step_lines([step.as_dict(rig) for step in steps(rig, plan)]):
            run.note(line)
    with run.watch() as watcher:
        calibration = run_calibration(rig, output, plan=plan, watcher=watcher)
        watcher.step("report")
        followed = {"nominal": calibration.nominal, "compensated": calibration.compensated}
        fit, found = calibration.fit, calibration.insight
        write_report(output / REPORT, fit, command=run.command, insight=found, followed=followed)
        return calibration


def _lines(calibration: Calibration, output: Path) -> Iterator[str]:
    fit, several = calibration.fit, bool(calibration.compensated.axes)
    if isinstance(fit, Fit):
        yield fit.outcome.value
        for error in fit.errors:
            errors = f"largest {error.largest_percent:6.3f} %  RMS {error.rms_percent:6.3f} % of the stroke"
            yield f"  {error.record:12s} {error.role:12s} {errors}"
    else:
        yield from fit.summary().split("\n")
    what = "of all axes together, in % of the stroke of each" if several else "of nine reversals, in % of the stroke"
    yield f"Measured along a path {what}:"
    for name, path in (("nominal", calibration.nominal), ("compensated", calibration.compensated)):
        for axis, tracked in zip(path.axes or ("",), path.each, strict=True):
            word = f"axis {axis:6s} " if axis else ""
            yield f"  {name:12s} {word}largest {tracked.largest_percent:6.3f} %  RMS {tracked.rms_percent:6.3f} %"
    for axis, recheck in zip(path.axes or ("",), calibration.checked, strict=True):
        yield f"axis {axis}: {recheck.sentence}" if axis else recheck.sentence
    yield f"{'stage' if several else 'model'}.json, report.html and records: {output}"
