"""`demo`: the whole workflow on a virtual actuator that is not an instance of the model."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from dehyst._io import made_folder
from dehyst._types import Array, Progress
from dehyst.control import plan_path
from dehyst.identification import Fit, identify
from dehyst.operations.command import FOLDER, command, output
from dehyst.operations.run import Result, Run
from dehyst.records import Record, largest, percent, rms, write_columns, write_record
from dehyst.report import write_report
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, raised_cosine, recommended, wanted_path

_SAMPLES = 400
_RATE = 0.01 * _SAMPLES
_IDENTIFIED = "dehyst identify loops.csv --validate other-loops.csv -o model.json --report report.html"


def record_loops(truth: PlayActuator) -> tuple[Record, Record]:
    """Record the recommended excitation for training, loops of other heights for validation."""
    drive = Sampling(sample_rate=_RATE)
    tops = recommended(truth.highest, drive=drive)
    others = raised_cosine([0.75 * truth.highest, 0.45 * truth.highest], cycles=2, drive=drive)
    return (
        Record(tops.time, tops.voltage, truth.play(tops.voltage), name="loops"),
        Record(others.time, others.voltage, truth.play(others.voltage), name="other-loops"),
    )


def journey(progress: Progress = lambda _: None) -> tuple[tuple[Record, Record], Fit, dict[str, Array]]:
    """Run the whole workflow, seeded: return records, fit, and the columns of a path that is followed twice."""
    truth = PlayActuator()
    progress("recording loops of a virtual actuator")
    records = record_loops(truth)
    fit = identify(records[0], validate=records[1], progress=progress)
    progress("playing the compensating voltage into the virtual actuator")
    wanted = wanted_path(truth.stroke)
    # Up to the highest voltage and down to 0 V: after it the state is known.
    homing = np.concatenate([np.linspace(0, truth.highest, _SAMPLES), np.linspace(truth.highest, 0, _SAMPLES)])
    homed = fit.actuator.simulate(homing, time=np.arange(homing.size) / _RATE).state
    time, limits = np.arange(wanted.size) / _RATE, (0.0, truth.highest)
    plan = plan_path(fit.actuator, wanted, time=time, limits=limits, start=homed)
    path = {"time_s": time, "wanted_um": 1e6 * wanted, "voltage_V": plan.voltage[plan.first :]}
    for kind, voltage in (("compensated", path["voltage_V"]), ("linear", wanted * truth.highest / truth.stroke)):
        truth.play(homing)
        path[f"{kind}_um"] = 1e6 * truth.play(voltage, measured=False)
    return records, fit, path


def errors_of(path: Mapping[str, Array], kind: str) -> dict[str, float]:
    """Return the errors along the path of the journey, "linear" or "compensated", in % of the stroke."""
    error, stroke = path[f"{kind}_um"] - path["wanted_um"], 1e6 * PlayActuator().stroke
    return {f"{of.__name__}_percent": percent(of(error), stroke) for of in (largest, rms)}


@command("demo")
def demo(run: Run, output: Path = output("New or empty folder.", FOLDER, default="dehyst-demo")) -> Result:
    """Record, identify, compensate and verify on an embedded virtual actuator."""
    target = made_folder(output)
    records, fit, path = journey(run.progress)
    run.progress("writing")
    for record in records:
        write_record(target / f"{record.name}.csv", record)
    fit.actuator.save(target / "model.json")
    write_columns(target / "tracking.csv", path, digits=12)
    write_report(target / "report.html", fit, command=_IDENTIFIED)
    names = ["loops.csv", "other-loops.csv", "model.json", "tracking.csv", "report.html"]
    lines = [fit.summary().split("\n")[0], "", "A path with nine reversals, largest error in % of the stroke"]
    errors = {kind: errors_of(path, kind) for kind in ("linear", "compensated")}
    for name, error in zip(("linear feedforward (end-point ratio)", "dehyst"), errors.values(), strict=True):
        lines.append(f"  {name:<38}{error['largest_percent']:7.2f} %   RMS {error['rms_percent']:5.2f} %")
    fields = {**errors, "fit": fit.as_dict(), "written": [str(target / name) for name in names]}
    return Result(fields, [*lines, "", f"Written to {output}/: {', '.join(names)}"])
