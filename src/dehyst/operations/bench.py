"""`calibrate`: the whole experiment on an instrument, and the progress of operations on one."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

import numpy as np

from dehyst._errors import DehystError, RigError
from dehyst._io import demand_own_folder
from dehyst._views.lines import percent
from dehyst.calibration import Calibration, Plan
from dehyst.calibration import calibrate as run_calibration
from dehyst.calibration.plan import steps
from dehyst.calibration.session import ProgressListener
from dehyst.identification import Fit
from dehyst.instruments import AbstractRig, Samples, open_rig
from dehyst.operations.axes import OfAxes, limits_option, of_axes, slew_option
from dehyst.operations.command import CONTINUED, argument, command, flag, number, option, output
from dehyst.operations.paths import bounds_remarks
from dehyst.operations.run import Result, Run
from dehyst.report import write_report


class Steps(ProgressListener):
    """A listener of a calibration, for a with-statement: a note where a step begins and ends, progress in between."""

    def __init__(self, run: Run) -> None:
        self._run, self._name, self._seconds = run, "", 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._end("done in" if kind is None else "failed after")

    def step(self, name: str, seconds: float = 0.0) -> None:
        """End the present step and begin another; it plays for `seconds` [s], 0 if it computes."""
        self._end("done in")
        self._name, self._seconds, self._began = name, seconds, time.monotonic()
        self._count, self._first = 0, 0.0
        self._run.note(f"{name}: begins" + (f", {seconds:.1f} s" if seconds else ""))

    def samples(self, samples: Samples) -> None:
        """Show how much was received."""
        self._first = self._first if self._count else float(samples.time[0])
        self._count += samples.time.size
        # An instrument reads a little longer than it plays.
        played = min(float(samples.time[-1]) - self._first, self._seconds)
        self._run.progress(f"{self._name}: {played:.0f} of {self._seconds:.0f} s, {self._count} samples")

    def message(self, text: str) -> None:
        """Show the present activity of the step."""
        self._run.progress(f"{self._name}: {text}")

    def _end(self, how: str) -> None:
        if self._name:
            self._run.progress("")
            received = f", {self._count} samples" if self._count else ""
            self._run.note(f"{self._name}: {how} {time.monotonic() - self._began:.1f} s{received}")
        self._name = ""


def _names(rig: str, axes: str | None) -> list[str] | None:
    """Return the names of several axes; None for one."""
    last = rig.rpartition("/")[2]
    text = axes or (last if rig.lower().startswith("pi://") and "," in last else "")
    return [name.strip() for name in text.split(",")] if text else None


@command("calibrate")
def calibrate(
    run: Run,
    rig: str = argument(None),
    output: Path = output("Folder; an earlier calibration in it continues.", CONTINUED, default="dehyst-calibration"),
    axes: str | None = option("Calibrate these axes of one body together, as 1,2,3; default: one axis."),
    limits: OfAxes = limits_option("Range of the voltage [V]; default: the device's."),
    slew_rate: OfAxes = slew_option("Largest slew rate [V/s]; default: the device's."),
    frequency: float | None = number("Frequency [Hz] of the slowest loops; default: 0.1, or 1 for several axes."),
    goal: float = number("Largest error [% of the stroke] of a good calibration, on every axis.", default=1.0),
    dry_run: bool = flag("Print what would be sent, and send nothing."),
) -> Result:
    """Home, excite, record, identify, compensate and measure the actuator on RIG.

    RIG: pi://HOST:PORT, epics://PREFIX, sim://, or FILE.py:FUNCTION, which returns a rig of your own. Several axes
    of one rig: pi://HOST:PORT/1,2,3, or --axes 1,2,3.

    Ctrl-C brings the voltage to a safe value; the same command continues from the records on disk.
    """
    names = _names(rig, axes)
    every = names or [""]
    allowed, rates = of_axes("limits", limits, every), of_axes("slew_rate", slew_rate, every)
    steepest = [None if rate == math.inf else rate for rate in rates]
    plan = Plan(frequency=frequency, goal=goal)
    if not dry_run and not (output / "records").is_dir():
        demand_own_folder(output, "records", "", force=run.force)
    # A rig of one axis need not accept lists.
    asked: Any = [each if len({*each}) > 1 else each[0] for each in (allowed, steepest)]
    with _noting_records(output), open_rig(rig, names, limits=asked[0], slew_rate=asked[1]) as instrument:
        if len(instrument.axes) != len(every):
            raise RigError(f"{instrument.name}: has several axes; give --axes {','.join(instrument.axes)}")
        for part, wanted, rate in zip(instrument.rigs, allowed, steepest, strict=True):
            device = f"axis {part.axis} of the device" if names else "the device"
            for remark in bounds_remarks(wanted, rate, part.limits, f"{device} allows no more"):
                run.note(remark)
        if dry_run:
            return _planned(instrument, plan)
        calibration = _calibrated(run, instrument, output, plan)
        try:
            instrument.close()
        except RigError as error:
            # The voltage is at its safe value, and the results are written.
            run.note(str(error))
    if kept := calibration.kept:
        began = calibration.training.meta["started"]
        played = f"from records on disk, {began}, not played again: {', '.join(kept)}"
        run.remarks.append(f"{played}; give another -o to measure again")
    run.remarks += calibration.warnings()
    return Result(calibration.as_dict(), [*_lines(calibration, output)], good=calibration.good)


@contextmanager
def _noting_records(output: Path) -> Iterator[None]:
    """Add to the error that ends a calibration where its records are, and whether the same command continues."""
    try:
        yield
    except (DehystError, KeyboardInterrupt, SystemExit) as error:
        records = output / "records"
        if any(records.glob("*.csv")):
            # A full disk may have room later; a folder of another instrument never fits.
            temporary = isinstance(error, RigError) or isinstance(error.__cause__, OSError)
            continues = not isinstance(error, Exception) or temporary
            end = "; the same command continues from there" if continues else ""
            error.add_note(f"the records so far are in {records}{end}")
        raise


def _planned(rig: AbstractRig, plan: Plan) -> Result:
    """Return the voltages that would be sent, as JSON values and lines."""
    planned = [step.as_dict(rig) for step in steps(rig, plan)]
    allowed = {
        "axes": list(rig.axes),
        "limits_V": [[part.limits.low, part.limits.high] for part in rig.rigs],
        "slew_rate_V_per_s": [part.slew_rate for part in rig.rigs],
        "safe_V": [part.safe for part in rig.rigs],
    }
    bounds = "; ".join(f"axis {part.axis}: {part.limits.words}, at most {part.slew_rate:.6g} V/s" for part in rig.rigs)
    seconds = sum(entry["seconds"] for entry in planned)
    lines = [
        f"{rig.name}, {bounds}; nothing was sent",
        *map(_step_line, planned),
        f"up to {seconds:.0f} s of playing in all",
    ]
    return Result({"rig": rig.name, **allowed, "steps": planned}, lines)


def _step_line(planned: dict[str, Any]) -> str:
    low, high, most = (
        ", ".join(f"{value:.5g}" for value in np.atleast_1d(planned[name]))
        for name in ("lowest_V", "highest_V", "steepest_V_per_s")
    )
    size = f"{planned['seconds']:8.1f} s {planned['samples']:7d} samples"
    return f"  {planned['step']:12s}{size}, {low} to {high} V, up to {most} V/s; {planned['what']}"


def _calibrated(run: Run, rig: AbstractRig, output: Path, plan: Plan) -> Calibration:
    """Return the calibration of a rig, with its report."""
    with Steps(run) as watcher:
        calibration = run_calibration(rig, output, plan=plan, watcher=watcher)
        watcher.step("report")
        followed = {"nominal": calibration.nominal, "compensated": calibration.compensated}
        fit, found = calibration.fit, calibration.insight
        write_report(output / "report.html", fit, command=run.command, insight=found, followed=followed)
        return calibration


def _lines(calibration: Calibration, output: Path) -> Iterator[str]:
    """Yield the promise of the fit, the errors along a path, and where the files are."""
    fit, axes = calibration.fit, calibration.compensated.axes
    yield from fit.summary().split("\n") if not isinstance(fit, Fit) else [fit.summary().split("\n")[0]]
    what = "of all axes together, in % of the stroke of each" if axes else "of nine reversals, in % of the stroke"
    noise = percent(*max((recheck.noise, recheck.stroke) for recheck in calibration.checked))
    yield f"Measured minus wanted along a path {what}, with the sensor's offset and noise ({noise} RMS):"
    for name, path in (("nominal", calibration.nominal), ("compensated", calibration.compensated)):
        for axis, tracked in zip(axes or ("",), path.each, strict=True):
            word = f"axis {axis:6s} " if axis else ""
            yield f"  {name:12s} {word}largest {tracked.largest_percent:6.3f} %  RMS {tracked.rms_percent:6.3f} %"
    for axis, recheck in zip(axes or ("",), calibration.checked, strict=True):
        yield f"axis {axis}: {recheck.sentence}" if axis else recheck.sentence
    yield f"{'stage' if axes else 'model'}.json, report.html and records: {output}"
