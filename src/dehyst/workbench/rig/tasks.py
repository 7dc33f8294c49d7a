"""What a rig does for the workbench: the plan of a calibration, the calibration, and a voltage that is played.

What a request asks for is checked completely before the task is handed back that sends the first voltage.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dehyst._errors import FileFormatError
from dehyst._version import __version__
from dehyst.instruments import AbstractRig, Samples
from dehyst.workbench.rig.live_feed import LiveFeed
from dehyst.workbench.rig.requests import Request, number, path

if TYPE_CHECKING:
    from dehyst.instruments.calibration import Plan
    from dehyst.instruments.voltage_file import WantedVoltage

REPORT = "report.html"
# Sends voltages; returns the result for the state.
Task = Callable[[], dict[str, Any]]


def plan_of(request: Request) -> Plan:
    """Return the plan that a `request` describes: frequency, hold, rounds and goal, all optional."""
    from dehyst.instruments.calibration import Plan

    plain = Plan()
    rounds = number(request, "rounds", float(plain.rounds))
    return Plan(
        frequency=number(request, "frequency") or plain.frequency,
        hold=number(request, "hold"),
        rounds=int(rounds) if rounds is not None and rounds.is_integer() else rounds,  # type: ignore[arg-type]
        goal=number(request, "goal") or plain.goal,
    )


def planned(rig: AbstractRig, request: Request) -> dict[str, Any]:
    """Return the steps of a calibration of `rig`, and their seconds in all; nothing is sent."""
    from dehyst.instruments.calibration.plan import entries

    steps = entries(rig, plan_of(request))
    return {"steps": steps, "seconds": sum(step.get("seconds", 0.0) for step in steps)}


def calibrating(rig: AbstractRig, address: str, request: Request, feed: LiveFeed) -> Task:
    """Return the calibration of `rig` into the folder of a `request`, as `dehyst calibrate` does it.

    `address`: of the rig, for the command in the report. `feed` receives the progress. Raise what `Plan` and
    `AbstractRig.check` raise; nothing was sent.
    """
    from dehyst.instruments.calibration.plan import steps

    plan, folder = plan_of(request), path(request, "folder")
    _refuse_foreign(folder)
    for step in steps(rig, plan):
        if step.excitation is not None:
            rig.check(step.excitation)

    def task() -> dict[str, Any]:
        from dehyst.instruments.calibration import calibrate
        from dehyst.report import write_calibration

        calibration = calibrate(rig, folder, plan=plan, watcher=feed)
        feed.step("report")
        command = command_of(rig, address, plan, folder)
        write_calibration(folder / REPORT, calibration, command=command)
        return {
            "kind": "calibration",
            "folder": str(folder),
            "good": calibration.good,
            "warnings": list(calibration.warnings()),
            "nominal_percent": calibration.nominal.largest_percent,
            "compensated_percent": calibration.compensated.largest_percent,
            "command": command,
        }

    return task


def command_of(rig: AbstractRig, address: str, plan: Plan, folder: Path) -> str:
    """Return the command that does the same: of `rig` at `address`, by this `plan`, into this `folder`."""
    words = ["dehyst", "calibrate", address, "-o", str(folder), "--limits", rig.limits.low, rig.limits.high]
    words += ["--slew", rig.slew_rate, "--frequency", plan.frequency, "--rounds", plan.rounds, "--goal", plan.goal]
    if plan.hold is not None:
        words += ["--hold", plan.hold]
    return shlex.join(map(str, words))


def playing(rig: AbstractRig, request: Request, feed: LiveFeed, *, first: bool) -> Task:
    """Return the playing of the file of a `request` on `rig`, recorded to its record.

    If it is the `first` since the connection, the voltage is brought to the safe one before: the wave of a process that
    was killed may still be playing. Every sample is on disk before `feed` receives it; the record of a wave that was
    stopped is marked incomplete. Raise `RecordError` or `FileFormatError` if the file cannot be played; nothing was
    sent.
    """
    from dehyst.instruments.voltage_file import read_voltage
    from dehyst.records.recording import demand_disk_space

    voltage, target = read_voltage(path(request, "file")), path(request, "record")
    rig.check(voltage.excitation)
    demand_disk_space(target.parent, len(voltage.excitation))

    def task() -> dict[str, Any]:
        with rig.safely():
            if first:
                rig.retreat()
            return _played(rig, voltage, target, feed)

    return task


def _played(rig: AbstractRig, voltage: WantedVoltage, target: Path, feed: LiveFeed) -> dict[str, Any]:
    from dehyst.records import Recording

    excitation, wanted = voltage
    rows = rig.rows(len(excitation))
    meta = {"identity": rig.identity, "axis": rig.axis, "excitation": excitation.name, "program": __version__}
    recording = Recording(target, meta=meta)
    try:
        with recording:

            def listen(samples: Samples) -> None:
                part = rows[recording.samples : recording.samples + samples.time.size]
                recording.add(samples)
                feed.samples(samples, None if wanted is None else wanted[part])

            feed.step(excitation.name, excitation.duration)
            recording.finish(rig.play(excitation, listen))
    except BaseException:
        if not recording.samples:
            target.unlink(missing_ok=True)
        raise
    return {"kind": "record", "file": str(target), "samples": recording.samples}


def _refuse_foreign(folder: Path) -> None:
    """Refuse a folder in which results would replace files of somebody else."""
    from dehyst._io.marks import format_of
    from dehyst.instruments.calibration.experiment import RESULTS
    from dehyst.instruments.calibration.session import FORMAT

    if format_of(folder / "campaign.json") != FORMAT:
        foreign = [name for name in (*RESULTS, REPORT) if (folder / name).exists()]
        if foreign:
            raise FileFormatError(
                f"{folder}: holds {', '.join(foreign)}, but no calibration; name another folder, nothing was sent"
            )
