"""Results of commands, as the entries that the page shows."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from dehyst._types import Array
from dehyst.model import Actuator
from dehyst.model.trace_file import read_traces
from dehyst.records import read, read_table
from dehyst.workbench.command import Finished
from dehyst.workbench.entries import ModelEntry, RecordEntry, VoltageEntry

_MICRO = 1e6
_CANCELLED = "it was ended before there was a model"


def fill_record(entry: RecordEntry, result: dict[str, Any]) -> None:
    """Fill in what `dehyst show --json` printed."""
    entry.status = "ready"
    entry.samples, entry.seconds = int(result["samples"]), float(result["duration_s"])
    entry.rate_hz, entry.noise_nm = float(result["sample_rate_Hz"]), float(result["noise_nm"])
    entry.voltage, entry.displacement_um = list(result["voltage_V"]), list(result["displacement_um"])
    columns, scales = result["columns"], result["scales"]
    entry.words = [
        f"{quantity} from '{column}'{f', {scales[quantity]}' if quantity in scales else ''}"
        for quantity, column in columns.items()
    ]
    entry.words.extend(result["problems"])


def fill_model(entry: ModelEntry, finished: Finished) -> None:
    """Fill in what `dehyst identify --json` printed, or why there is no model."""
    fit = finished.result
    if fit is None:
        stopped = entry.early or finished.stopped
        entry.status, entry.error = ("cancelled", _CANCELLED) if stopped else ("failed", finished.error)
        return
    verdict = fit.get("verdict")
    if verdict is None:
        entry.status, entry.error = "failed", str(fit["sentence"])
        return
    entry.status, entry.error = "ready", None
    entry.verdict = {
        "readiness": verdict["readiness"],
        "sentence": verdict["sentence"],
        "largest_percent": verdict["largest_percent"],
        "rms_percent": verdict["rms_percent"],
        "largest_um": verdict["largest_m"] * _MICRO,
        "noise_um": verdict["noise_m"] * _MICRO,
        "basis": verdict["basis"],
        "goal": verdict["goal_percent"],
        "why": verdict["reasons"],
        "remarks": fit["remarks"],
    }
    entry.band_percent = verdict["largest_percent"]
    names = ("record", "role", "samples", "left_out", "largest_percent", "rms_percent")
    entry.table = [{name: error[name] for name in names} for error in fit["errors"]]
    entry.summary = [fit["sentence"], *fit["repairs"]]


def brief_insight(result: dict[str, Any]) -> dict[str, Any]:
    """Return what the page shows of what `dehyst insight --json` printed."""
    known, directions = result.get("known") or {}, result.get("directions") or {}
    parts = ("part", "unit", "known", "of", "estimate", "interval", "words")
    kept = ("warnings", "not_judged", "advice", "suggested", "state", "homing", "level", "stroke_m", "misfit_m")
    return {
        **{name: result.get(name) for name in kept},
        "known": {name: known.get(name) for name in ("all", "sentence", "others", "next", "rule")},
        "parts": [{name: part.get(name) for name in parts} for part in known.get("parts", ())],
        "directions": {name: directions.get(name) for name in ("determined", "of", "sentences")},
    }


def fill_voltage(entry: VoltageEntry, finished: Finished, file: Path) -> None:
    """Fill in what `dehyst compensate --json` printed."""
    result: dict[str, Any] = finished.result or {}
    entry.clamped = int(result.get("clamped", 0))
    entry.range_v = [float(result["lowest_V"]), float(result["highest_V"])] if "lowest_V" in result else []
    entry.words = [str(one) for one in result.get("warnings", ())]
    if result.get("homing_samples"):
        entry.words.insert(0, f"the first {result['homing_s']:.4g} s home the actuator: play the whole file")
    columns = voltage_columns(file)
    entry.samples, entry.seconds = columns[0].size, float(columns[0][-1] - columns[0][0]) if columns[0].size else 0.0


def ranges(file: Path) -> tuple[list[float], list[float]]:
    """Return the voltages [V] that a model is known for, and the displacements [um] that it reaches with them."""
    actuator = Actuator.load(file)
    return list(actuator.voltage_range), [end * _MICRO for end in actuator.reach]


def wasm(file: Path, period: float | None) -> bytes:
    """Return a model as a WebAssembly module with a `period` [s], for a model that depends on time."""
    from dehyst.control import Compensator
    from dehyst.exports import wasm_module

    actuator = Actuator.load(file)
    return wasm_module(Compensator(actuator, period=period if actuator.needs_time else None))


def record_columns(file: Path) -> tuple[Array, ...]:
    """Return time [s], voltage [V] and displacement [um] of a record's file."""
    record = read(file)
    return record.time - record.time[0], record.voltage, record.displacement * _MICRO


def voltage_columns(file: Path) -> tuple[Array, ...]:
    """Return time [s], voltage [V], wanted and expected displacement [um] of an output of `dehyst compensate`."""
    table = read_table(file)
    columns = {column.name: column.data for column in table.columns}
    voltage = columns["voltage_V"]
    time = columns.get("time_s", np.arange(voltage.size, dtype=np.float64))
    wanted = columns["displacement_um"]
    return time, voltage, wanted, columns.get("expected_um", wanted)


def trace_heads(file: Path) -> list[dict[str, Any]]:
    """Return name, role, samples and gaps [s] of each record of a file of traces; none if there is no file."""
    if not file.exists():
        return []
    return [
        {
            "name": trace.record,
            "role": trace.role,
            "samples": int(trace.time.size),
            "shaded": list(_gaps(trace.time, trace.began)),
        }
        for trace in read_traces(file)
    ]


def trace_columns(file: Path, number: int) -> tuple[Array, ...]:
    """Return time [s], voltage [V], measured and simulated displacement [um] of a trace; IndexError if none."""
    trace = list(read_traces(file))[number]
    return trace.time - trace.began, trace.voltage, trace.measured * _MICRO, trace.simulated * _MICRO


def packed(columns: tuple[Array, ...]) -> bytes:
    """Return columns one after the other as little-endian 32-bit floats."""
    return b"".join(column.astype("<f4").tobytes() for column in columns)


def fit_numbers(file: Path) -> Any:
    """Return the numbers of a fit."""
    return json.loads(file.read_text(encoding="utf-8"))


def _gaps(time: Array, began: float) -> Iterator[list[float]]:
    """Yield begin and end [s] of what was set aside, from the record's first sample."""
    if not time.size:
        return
    if began < time[0]:
        yield [0.0, float(time[0] - began)]
    steps = np.diff(time)
    for k in np.flatnonzero(steps > 3 * np.median(steps)) if steps.size else ():
        yield [float(time[k] - began), float(time[k + 1] - began)]
