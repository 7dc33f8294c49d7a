"""`demo`: the whole workflow on a virtual actuator that is not an instance of the model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dehyst._io import PathLike, demand_own_folder, made_folder, write_json
from dehyst._types import Array, Progress
from dehyst.control import plan_path
from dehyst.identification import Fit, identify
from dehyst.operations.command import CONTINUED, command, output, switch
from dehyst.operations.run import Result, Run
from dehyst.records import Record, largest, percent, rms, write_columns, write_record
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, raised_cosine, recommended, wanted_path

_SAMPLES = 400
_RATE = 0.01 * _SAMPLES
# A folder with this file is the demo's.
OWN = ("demo.json", "dehyst-demo")
_IDENTIFIED = "loops.csv --validate other-loops.csv -o model.json"
# The paper: Sec. 4.3 and Fig. 12.
_PAPER = {"linear": 13.63, "compensated": 0.76}


@dataclass(frozen=True, eq=False)
class Demo:
    """Result of the demo: records, fit, and a path [m] at `time` [s]: wanted, and reached by two kinds of voltage."""

    records: tuple[Record, Record]
    fit: Fit
    time: Array
    wanted: Array
    linear: Array
    compensated: Array
    voltage: Array
    stroke: float

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values; errors in % of the stroke, with those of the paper."""
        errors = {kind: getattr(self, kind) - self.wanted for kind in _PAPER}
        return {
            "stroke_um": self.stroke * 1e6,
            **{kind: {**self._percents(error), "largest_um": 1e6 * largest(error)} for kind, error in errors.items()},
            "paper": {f"{kind}_largest_percent": value for kind, value in _PAPER.items()},
            "fit": self.fit.as_dict(),
        }

    def _percents(self, error: Array) -> dict[str, float]:
        return {f"{name}_percent": percent(of(error), self.stroke) for name, of in (("largest", largest), ("rms", rms))}


def record_loops(truth: PlayActuator) -> tuple[Record, Record]:
    """Record the recommended excitation for training, loops of other heights for validation."""
    drive = Sampling(sample_rate=_RATE)
    tops = recommended(truth.highest, drive=drive)
    others = raised_cosine([0.75 * truth.highest, 0.45 * truth.highest], cycles=2, drive=drive)
    return (
        Record(tops.time, tops.voltage, truth.play(tops.voltage), name="loops"),
        Record(others.time, others.voltage, truth.play(others.voltage), name="other-loops"),
    )


def journey(progress: Progress = lambda _: None) -> Demo:
    """Run the whole workflow; seeded and thus reproducible."""
    truth = PlayActuator()
    progress("recording loops of a virtual actuator")
    records = record_loops(truth)
    fit = identify(records[0], validate=records[1], progress=progress)
    progress("playing the compensating voltage into the virtual actuator")
    wanted = wanted_path(truth.stroke)
    # Up to the highest voltage and down to 0 V: after it the state is known.
    homing = np.concatenate([np.linspace(0, truth.highest, _SAMPLES), np.linspace(truth.highest, 0, _SAMPLES)])
    actuator = fit.actuator
    homed = actuator.simulate(homing, time=np.arange(homing.size) / _RATE).state
    time, limits = np.arange(wanted.size) / _RATE, (0.0, truth.highest)
    plan = plan_path(actuator, wanted, time=time, limits=limits, start=homed)
    voltage = plan.voltage[plan.first :]
    truth.play(homing)
    compensated = truth.play(voltage, measured=False)
    truth.play(homing)
    linear = truth.play(wanted * truth.highest / truth.stroke, measured=False)
    return Demo(records, fit, time, wanted, linear, compensated, voltage, truth.stroke)


def write(demo: Demo, folder: PathLike, *, report: bool = True) -> list[Path]:
    """Write the records, the model, the path, the numbers and the report to a folder; return the paths."""
    target = made_folder(folder)
    # First, so that the folder counts as the demo's even if it is not finished.
    write_json(target / OWN[0], {"format": OWN[1], "version": 1, **demo.as_dict()})
    for record in demo.records:
        write_record(target / f"{record.name}.csv", record)
    demo.fit.actuator.save(target / "model.json")
    wanted = {"time_s": demo.time, "wanted_um": demo.wanted * 1e6, "voltage_V": demo.voltage}
    reached = {"compensated_um": demo.compensated * 1e6, "linear_um": demo.linear * 1e6}
    write_columns(target / "tracking.csv", wanted | reached, digits=12)
    names = ["loops.csv", "other-loops.csv", "model.json", "tracking.csv", OWN[0]]
    if report:
        from dehyst.report import write_report

        write_report(target / "report.html", demo.fit, command=f"dehyst identify {_IDENTIFIED} --report report.html")
        names.append("report.html")
    return [target / name for name in names]


@command("demo")
def demo(
    run: Run,
    output: Path = output("Folder: new, empty, or an earlier demo's.", CONTINUED, default="dehyst-demo"),
    report: bool = switch("--report/--no-report", "Draw the report.", default=True),
) -> Result:
    """Record, identify, compensate and verify on an embedded virtual actuator."""
    demand_own_folder(output, *OWN, force=run.force)
    result = journey(run.progress)
    run.progress("writing")
    written = write(result, output, report=report)
    numbers = result.as_dict()
    lines = [result.fit.summary().split("\n")[0], "", "A path with nine reversals, largest error in % of the stroke"]
    for name, key in (("linear feedforward (end-point ratio)", "linear"), ("dehyst", "compensated")):
        largest, rms = numbers[key]["largest_percent"], numbers[key]["rms_percent"]
        lines.append(f"  {name:<38}{largest:7.2f} %   RMS {rms:5.2f} %")
    lines += ["", f"Written to {output}/: {', '.join(path.name for path in written)}"]
    return Result({**numbers, "written": [str(path) for path in written]}, lines)
