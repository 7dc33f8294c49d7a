"""Entries of a workbench: records, models and voltages, which results of operations fill in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dehyst.model import needs_time, voltages_of
from dehyst.operations.axes import AxesModel
from dehyst.operations.run import Run
from dehyst.workbench.jobs import Finished

_MICRO = 1e6


@dataclass
class RecordEntry:
    """A record: an uploaded `source`, and the `file` in which it is in SI units once it is ready.

    `file_columns`: name, unit and range of the file's columns; empty if it is not a table. `columns`: text
    with which it was read. `hint`: text of columns that may help to read it. `axes`: names of several coupled axes.
    """

    id: str
    name: str
    source: str
    file: str = ""
    status: str = "reading"
    error: str | None = None
    hint: str = ""
    file_columns: list[dict[str, Any]] = field(default_factory=list)
    columns: str = ""
    axes: list[str] = field(default_factory=list)
    samples: int = 0
    seconds: float = 0.0
    rate_hz: float = 0.0
    voltage: list[float] = field(default_factory=list)
    displacement_um: list[float] = field(default_factory=list)
    others: dict[str, list[float]] = field(default_factory=dict)
    words: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    usable: bool = True

    @property
    def reading(self) -> dict[str, str]:
        """The columns with which operations read `file`."""
        pairs = (f"{axis}=v{axis}_V:{axis}_m" for axis in self.axes)
        return {"columns": ", ".join(pairs)} if self.axes else {}

    def fill(self, result: Mapping[str, Any]) -> None:
        """Fill in the result of `show`."""
        self.axes = list(result.get("axes", ()))
        parts = list(result.get("axes", {"": result}).values())
        first = parts[0]
        self.status, self.words, self.problems = "ready", [], []
        self.usable = all(part["usable"] for part in parts)
        self.samples, self.seconds = int(first["samples"]), float(first["duration_s"])
        self.rate_hz = float(first["sample_rate_Hz"])
        self.others = dict(first["others"])
        for name, key in (("voltage", "voltage_V"), ("displacement_um", "displacement_um")):
            setattr(self, name, [min(part[key][0] for part in parts), max(part[key][1] for part in parts)])
        for axis, part in zip(self.axes or [""], parts, strict=True):
            scales = {name: f", {scale}" for name, scale in part["scales"].items()}
            prefix = f"{axis}: " if axis else ""
            self.words += [
                f"{prefix}{name} from '{column}'{scales.get(name, '')}" for name, column in part["columns"].items()
            ]
            self.problems += [f"{prefix}{words}" for words in part["problems"]]


@dataclass
class ModelEntry:
    """A model: its records, and its results.

    `origin`: a sentence on where an updated model comes from, which has no `seconds`. `check`: the last check by a new
    record. `axes`: one entry for each of several coupled axes: name, range_v, range_um and slew_v_per_s; the model's
    own ranges cover all axes, and its verdict is the verdict of the worst axis. `coupling`: the matrix, and each
    verdict. `fastest_v_per_s`: mean speed of the fastest branch of its records. `timed`: an export needs a period.
    """

    id: str
    name: str
    file: str
    train: list[str] = field(default_factory=list)
    validate: list[str] = field(default_factory=list)
    report: str = ""
    options: dict[str, Any] = field(default_factory=dict)
    status: str = "identifying"
    progress: str = ""
    seconds: float | None = 0.0
    early: bool = False
    error: str | None = None
    verdict: dict[str, Any] | None = None
    axes: list[dict[str, Any]] = field(default_factory=list)
    coupling: dict[str, Any] | None = None
    range_v: list[float] = field(default_factory=list)
    range_um: list[float] = field(default_factory=list)
    slew_v_per_s: float | None = None
    fastest_v_per_s: float | None = None
    timed: bool = True
    insight: dict[str, Any] | None = None
    origin: str = ""
    check: dict[str, Any] | None = None

    def fill(self, finished: Finished) -> None:
        """Fill in the result of `identify`, or the reason why there is no model."""
        fit = finished.result
        if fit is None:
            stopped = self.early or finished.stopped
            self.status = "cancelled" if stopped else "failed"
            self.error = "the identification was ended before there was a model" if stopped else finished.words
            return
        several = "fits" in fit
        fits = fit["fits"] if several else {"": fit}
        found = {axis: axis_fit["verdict"] for axis, axis_fit in fits.items()}
        verdicts = {
            axis: verdict_of(own["promise"], own["readiness"], own["basis"], own["goal_percent"], own["reasons"])
            for axis, own in found.items()
        }
        remarks = [f"{axis}: {remark}" if axis else remark for axis, own in fits.items() for remark in own["remarks"]]
        self.status, self.error = "ready", None
        self.verdict = {**worst(verdicts), "remarks": remarks}
        if several:
            self.coupling = {"matrix": fit["coupling"], "verdicts": verdicts}
            self.verdict["why"] = [fit["verdict"]]
            if not fit["good"]:
                self.verdict["readiness"] = "NOT_USABLE"

    def fill_ranges(self, file: Path) -> None:
        """Fill in voltages [V] and speed [V/s] of the records of a model, and its reach [um]."""
        known = AxesModel.read(Run(), file)
        each: list[dict[str, Any]] = [
            {
                "name": axis,
                "range_v": list(voltages_of(actuator)),
                "range_um": [end * _MICRO for end in actuator.reach],
                "slew_v_per_s": actuator.identification.slew_rate,
            }
            for axis, actuator in zip(known.axes, known.actuators, strict=True)
        ]
        self.axes = each if known.several else []
        for name in ("range_v", "range_um"):
            setattr(self, name, [min(axis[name][0] for axis in each), max(axis[name][1] for axis in each)])
        self.slew_v_per_s = min((axis["slew_v_per_s"] for axis in each if axis["slew_v_per_s"]), default=None)
        tested = [own.identification.validity for own in known.actuators]
        self.fastest_v_per_s = min((v.speeds[1] for v in tested if v and v.speeds[1]), default=self.slew_v_per_s)
        self.timed = any(map(needs_time, known.actuators)) or any(known.slews({}))


def verdict_of(
    promise: Mapping[str, Any], readiness: str, basis: str, goal: float, why: Sequence[str]
) -> dict[str, Any]:
    """Return a promise with its verdict, as the page shows it."""
    return {**shown(promise), "readiness": readiness, "basis": basis, "goal": goal, "why": list(why)}


def shown(promise: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parts of a promise that the page shows."""
    parts = {name: promise[name] for name in ("largest_percent", "rms_percent", "apart")}
    return {**parts, "largest_um": promise["largest_m"] * _MICRO}


def worst(verdicts: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the verdict of the axis with the largest error."""
    return max(verdicts.values(), key=lambda verdict: float(verdict["largest_percent"]))


@dataclass
class ExcitationEntry:
    """A voltage to play and record, and remarks on it in `words`; `asked`: the values of its form."""

    id: str
    name: str
    file: str
    asked: dict[str, Any] = field(default_factory=dict)
    samples: int = 0
    seconds: float = 0.0
    range_v: list[float] = field(default_factory=list)
    words: list[str] = field(default_factory=list)

    def fill(self, result: Mapping[str, Any]) -> None:
        """Fill in the result of `excite`."""
        self.samples, self.seconds = int(result["samples"]), float(result["seconds"])
        self.range_v = [float(result["lowest_V"]), float(result["highest_V"])]
        self.words = [str(warning) for warning in result["warnings"]]


@dataclass
class VoltageEntry:
    """A voltage that follows a path with a model, and remarks on it in `words`.

    `asked`: its path (a scan, points or a file), limits, slew rate and sample rate.
    `promises`: the promise of each axis, None if it is not known.
    """

    id: str
    name: str
    file: str
    model: str
    asked: dict[str, Any] = field(default_factory=dict)
    axes: list[str] = field(default_factory=list)
    samples: int = 0
    seconds: float = 0.0
    range_v: list[float] = field(default_factory=list)
    clamped: int = 0
    promises: list[dict[str, Any] | None] = field(default_factory=list)
    words: list[str] = field(default_factory=list)

    def fill(self, result: Mapping[str, Any], rate: float) -> None:
        """Fill in the result of `compensate`, for a path with `rate` samples a second."""
        several = isinstance(result["lowest_V"], Mapping)

        def each(name: str) -> list[Any]:
            return list(result[name].values()) if several else [result[name]]

        self.axes = list(result["lowest_V"]) if several else []
        self.clamped, self.range_v = sum(map(int, each("clamped"))), [min(each("lowest_V")), max(each("highest_V"))]
        self.promises = [promise and shown(promise) for promise in each("promise")]
        self.words = [str(warning) for warning in result["warnings"]]
        if max(each("homing_samples")):
            home = max(homing or 0.0 for homing in each("homing_s"))
            self.words.insert(0, f"the first {home:.4g} s home the actuator: play the whole file, each row at its time")
        self.samples = int(result["samples"])
        self.seconds = max(seconds or self.samples / rate for seconds in each("seconds"))
