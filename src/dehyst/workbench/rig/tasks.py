"""Live data: samples as they arrive, thinned to ten messages a second."""

from __future__ import annotations

import shlex
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import FileFormatError
from dehyst._types import Array
from dehyst._version import __version__
from dehyst.instruments import AbstractRig, Reading, Samples
from dehyst.workbench.rig.messages import Request, number, path

if TYPE_CHECKING:
    from dehyst.calibration import Plan
    from dehyst.calibration.plan import WantedVoltage

# Seconds between two messages, and between two changes of the state.
_PERIOD, _STATE_PERIOD = 0.1, 1.0
# Most samples of one message.
MOST = 200
# Digits of a number: a microvolt and less than a picometre.
_DIGITS = 6


class LiveFeed:
    """A listener of waves and calibrations, which sends live data and progress and stops them if necessary.

    Parameters
    ----------
    live : callable
        Takes a message of live data.
    state : callable
        Takes changed fields of the state, as keywords.
    check : callable
        Called after each batch of samples is on disk; it raises an error to stop the wave.

    Attributes
    ----------
    status : str
        Sent with each message.
    last : Reading or None
        The last sample.
    seen_at : float
        Time of the last sample [s of time.monotonic].
    count : int
        Samples of the present step.
    """

    def __init__(
        self, live: Callable[[dict[str, Any]], None], state: Callable[..., None], check: Callable[[], None]
    ) -> None:
        self._live, self._state, self._check = live, state, check
        self.status, self.seen_at, self.count = "none", 0.0, 0
        self.last: Reading | None = None
        self._step: str | None = None
        self._first: float | None = None
        self._share: float | None = None
        self._seconds = 0.0
        self._batches: list[tuple[Array, Array, Array, Array]] = []
        self._sent_at = self._state_at = -np.inf

    def step(self, name: str, seconds: float = 0.0) -> None:
        """Begin the step `name`, which plays for `seconds` [s]; 0 for one that computes."""
        self.flush()
        self._check()
        self._step, self._seconds, self._first, self.count = name, seconds, None, 0
        self._share = 0.0 if seconds else None
        self._state(step=name, progress=self._share, words=[])

    def message(self, text: str) -> None:
        """Send a `text` on the present activity of the step."""
        self._check()
        self._state(words=[text])

    def samples(self, samples: Samples, expected: Array | None = None, stroke: float | None = None) -> None:
        """Send `samples` that are on disk; `expected` (n,) [m] is their wanted displacement."""
        if samples.time.size:
            wanted = np.full(samples.time.size, np.nan) if expected is None else np.asarray(expected, dtype=np.float64)
            self._batches.append((*samples, wanted))
            self.last = last = Reading(*(float(column[-1]) for column in samples))
            self.seen_at = time.monotonic()
            self.count += samples.time.size
            self._first = float(samples.time[0]) if self._first is None else self._first
            if self._seconds:
                self._share = min(1.0, (last.time - self._first) / self._seconds)
            if self.seen_at - self._sent_at >= _PERIOD:
                self.flush()
        self._check()

    def reading(self, reading: Reading) -> None:
        """Send one `reading` of a rig at rest."""
        self.samples(Samples(*(np.array([value]) for value in reading)))

    def end(self) -> None:
        """End the last step."""
        self.flush()
        self._step, self._share, self._seconds = None, None, 0.0
        self._state(step=None, progress=None, **self._present())

    def flush(self) -> None:
        """Send the samples since the last message."""
        if not self._batches:
            return
        time_, voltage, displacement, wanted = (np.concatenate(column) for column in zip(*self._batches, strict=True))
        self._batches, self._sent_at = [], time.monotonic()
        rows = thinned(voltage)
        self._live(
            {
                "kind": "live",
                "t": _numbers(time_[rows]),
                "v": _numbers(voltage[rows]),
                "y": _numbers(1e6 * displacement[rows]),
                "expected": _numbers(1e6 * wanted[rows]),
                "step": self._step,
                "share": self._share,
                "status": self.status,
            }
        )
        if self._sent_at - self._state_at >= _STATE_PERIOD:
            self._state_at = self._sent_at
            self._state(progress=self._share, **self._present())

    def _present(self) -> dict[str, Any]:
        if self.last is None:
            return {}
        return {"voltage": self.last.voltage, "displacement_um": 1e6 * self.last.displacement}


def thinned(voltage: Array) -> NDArray[np.intp]:
    """Return the rows of at most 200 of voltages (n,) [V]: the last, and the two extremes of each equal stretch."""
    if voltage.size <= MOST:
        return np.arange(voltage.size, dtype=np.intp)
    stretches = np.array_split(np.arange(voltage.size - 1, dtype=np.intp), MOST // 2 - 1)
    extremes = [stretch[[function(voltage[stretch])]] for stretch in stretches for function in (np.argmin, np.argmax)]
    return np.unique(np.concatenate([*extremes, [voltage.size - 1]]))


def _numbers(values: Array) -> list[float | None]:
    return [round(value, _DIGITS) if np.isfinite(value) else None for value in values.tolist()]


REPORT = "report.html"
# Sends voltages; returns the result for the state.
Task = Callable[[], dict[str, Any]]


def plan_of(request: Request) -> Plan:
    """Return the plan that a `request` describes: frequency, hold, rounds and goal, all optional."""
    from dehyst.calibration import Plan

    plain = Plan()
    rounds = number(request, "rounds", float(plain.rounds))
    return Plan(
        frequency=_given(request, "frequency", plain.frequency),
        hold=number(request, "hold"),
        rounds=int(rounds) if rounds is not None and rounds.is_integer() else rounds,  # type: ignore[arg-type]
        goal=_given(request, "goal", plain.goal),
    )


def _given(request: Request, name: str, default: float) -> float:
    value = number(request, name)
    return default if value is None else value


def planned(rig: AbstractRig, request: Request) -> dict[str, Any]:
    """Return the steps of a calibration of `rig`, and their seconds in all; nothing is sent."""
    from dehyst.calibration.plan import entries

    steps = entries(rig, plan_of(request))
    return {"steps": steps, "seconds": sum(step.get("seconds", 0.0) for step in steps)}


def calibrating(rig: AbstractRig, address: str, request: Request, feed: LiveFeed) -> Task:
    """Return the calibration of `rig` into the folder of a `request`, as `dehyst calibrate` does it.

    `address`: of the rig, for the command in the report. `feed` receives the progress. Raise what `Plan` and
    `AbstractRig.check` raise; nothing was sent.
    """
    from dehyst.calibration.plan import steps

    plan, folder = plan_of(request), path(request, "folder")
    _refuse_foreign(folder)
    steps(rig, plan)

    def task() -> dict[str, Any]:
        from dehyst.calibration import calibrate
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
    from dehyst.operations.registry import find

    asked = {name: getattr(plan, name) for name in ("frequency", "hold", "rounds", "goal")}
    bounds = {"limits": [[rig.limits.low, rig.limits.high]], "slew_rate": [rig.slew_rate]}
    operation = find("calibrate")
    return shlex.join(operation.command(operation.of_json({"rig": address, "output": str(folder), **bounds, **asked})))


def playing(rig: AbstractRig, request: Request, feed: LiveFeed, *, first: bool) -> Task:
    """Return a function that plays the file of a `request` on `rig` and writes its record.

    If it is the `first` one since the connection, the voltage is brought to the safe value before, because the wave of
    a killed process may still be playing. Every sample is on disk before `feed` receives it; the record of a stopped
    wave is marked incomplete. Raise `RecordError` or `FileFormatError` if the file cannot be played; nothing was sent.
    """
    from dehyst.calibration.plan import read_voltage
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
    from dehyst._io import format_of
    from dehyst.calibration.experiment import RESULTS
    from dehyst.calibration.session import FORMAT

    if format_of(folder / "campaign.json") != FORMAT:
        foreign = [name for name in (*RESULTS, REPORT) if (folder / name).exists()]
        if foreign:
            raise FileFormatError(
                f"{folder}: holds {', '.join(foreign)}, but no calibration; name another folder, nothing was sent"
            )
