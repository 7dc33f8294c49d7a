"""`dehyst compensate` with a stage file: voltages with which all axes follow a path or a scan."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from dehyst._text import counted
from dehyst.cli.axes.inputs import OWN_START, bounds_of, columns_of, load, named
from dehyst.cli.common import conclude, refuse_overwriting, refuse_replacing, write_output
from dehyst.cli.record_files import table_of, time_of_table
from dehyst.cli.scans import named_scan
from dehyst.cli.start import error_line

if TYPE_CHECKING:
    from dehyst.control import StartError
    from dehyst.model import State
    from dehyst.stages import Stage, StageCompensator, StageTrace


def compensate_axes(
    model: Path, trajectory: Path | None, output: Path, scan: str | None, axes: str | None, options: dict[str, Any]
) -> None:
    """Write the voltages with which all axes of a stage follow a file or a scan on two of them, and exit."""
    refuse_overwriting([model, *([trajectory] if trajectory is not None else [])], output)
    stage = load(model)
    _refuse_unused(options)
    if scan is None:
        table = table_of(trajectory or Path(), options)
        wanted = columns_of(table, stage, axes, "displacement", options)
        clock = time_of_table(table, len(wanted), options)
    else:
        wanted, clock = _scanned(stage, scan, options)
    compensator, remarks = _compensator(stage, clock, options)
    if options["start"] is None and options["home"] is not False:
        followed = _homed(compensator, wanted, clock)
    else:
        followed = _unhomed(compensator, wanted, clock, options["start"])
    refuse_replacing(output)
    write_output(output, followed.columns)
    _print(stage, followed, remarks + list(followed.trace.warnings), output, options["as_json"])
    sys.exit(0 if followed.trace.followed and (followed.certified or not options["home"]) else 1)


def _refuse_unused(options: dict[str, Any]) -> None:
    from dehyst._errors import ModelError

    for name in ("present", "cycle", "zero", "axis"):
        if options.get(name) is not None:
            raise ModelError(f"--{name}: got it with a stage, which does not take it; leave it out")
    if options["start"] is not None and options["home"]:
        raise ModelError("--start: got it with --home, which determines the state; leave one out")


def _compensator(stage: Stage, clock: dict[str, Any], options: dict[str, Any]) -> tuple[StageCompensator, list[str]]:
    """Return the compensator with the limits, slew rate and start of the options, and remarks on the start."""
    from dehyst.stages import StageCompensator

    limits, slew = bounds_of(stage.axes, options)
    start = options["start"]
    states, remarks = (None, []) if start is None else starts_of(stage, start, limits)
    compensator = StageCompensator(stage, limits=limits, slew_rate=slew, period=_period(clock), states=states)
    return compensator, remarks


def _print(stage: Stage, followed: _Followed, warnings: list[str], output: Path, as_json: bool) -> None:
    trace = followed.trace
    words = [
        f"{axis} {trace.voltage[:, j].min():.6g} to {trace.voltage[:, j].max():.6g} V"
        for j, axis in enumerate(stage.axes)
    ]
    samples = len(trace.voltage)
    result = {
        "samples": samples,
        "clamped": {axis: int(trace.clamped[:, j].sum()) for j, axis in enumerate(stage.axes)},
        "missed_um": {axis: float(trace.missed[j] * 1e6) for j, axis in enumerate(stage.axes)},
        "start": followed.words,
        "start_errors": {axis: error.as_dict() for axis, error in followed.errors.items()},
        "lowest_V": trace.voltage.min(axis=0).tolist(),
        "highest_V": trace.voltage.max(axis=0).tolist(),
        "warnings": warnings,
        "output": str(output),
    }
    lines = [f"{counted(samples, 'sample')}, {', '.join(words)}, {followed.words}: {output}"]
    lines += [f"{axis}: {error_line('unknown', error, homed=True)}" for axis, error in followed.errors.items()]
    conclude(as_json, result, lines, warnings)


def starts_of(
    stage: Stage, start: str | Path, limits: Sequence[tuple[float, float] | None]
) -> tuple[list[State], list[str]]:
    """Return the named state of each actuator, or if its limits [V] do not reach it one that they do; and remarks."""
    from dehyst._errors import ModelError
    from dehyst.control import PossibleStart
    from dehyst.stages.starts import start_within

    if not isinstance(start, str):
        raise ModelError(f"--start {start}: a stage begins in a named state; give top, bottom or the like")
    states, remarks = [], []
    for axis, one, given in zip(stage.axes, stage.actuators, limits, strict=True):
        allowed, state = given or one.limits, PossibleStart.named(one, start).state  # type: ignore[arg-type]
        states.append(state if allowed is None else start_within(one, state, allowed))
        if allowed is not None and states[-1] is not state:
            low, high = allowed
            remarks.append(
                f"axis {axis}: the start {start} needs {one.voltage(state):.6g} V, outside the limits {low:.6g} to "
                f"{high:.6g} V: it begins at {one.voltage(states[-1]):.6g} V, after loops between the limits"
            )
    return states, remarks


class _Followed(NamedTuple):
    """A path with its voltages: where it begins in words, the columns to write, and what the start leaves open."""

    trace: StageTrace
    words: str
    columns: dict[str, Any]
    errors: dict[str, StartError]
    certified: bool = True


def _unhomed(compensator: StageCompensator, wanted: Any, clock: dict[str, Any], start: str | Path | None) -> _Followed:
    """Return a path from the states of the compensator, which are those of a `start` or of the model."""
    stage = compensator.stage
    begins = ", ".join(f"{axis} {v:.4g} V" for axis, v in zip(stage.axes, compensator.voltage.tolist(), strict=True))
    words = f"from {OWN_START} ({begins})" if start is None else f"from the start {start} of all axes ({begins})"
    trace = compensator.trajectory(wanted, time=clock.get("time_s"))
    columns = {**clock, **named(stage, trace.voltage, "voltage"), **named(stage, trace.displacement * 1e6)}
    return _Followed(trace, words, columns, {})


def _homed(compensator: StageCompensator, wanted: Any, clock: dict[str, Any]) -> _Followed:
    """Return a path with a homing of all axes before it."""
    import numpy as np

    from dehyst.stages import home_stage_before

    stage = compensator.stage
    homed = home_stage_before(compensator, wanted, time=clock.get("time_s"))
    rows = len(homed.voltage)
    voltage = np.vstack([homed.voltage, homed.path.voltage])
    displacement = np.vstack([homed.expected, homed.path.displacement])
    phase = {"phase": (np.arange(len(voltage)) >= rows) * 2.0}
    when = {} if homed.time is None else {"time_s": homed.time}
    seconds = "" if homed.time is None else f", {homed.time[rows]:.4g} s"
    words = f"after a homing of all axes, {rows} rows{seconds}"
    trace = replace(homed.path, warnings=homed.warnings)
    columns = {**when, **phase, **named(stage, voltage, "voltage"), **named(stage, displacement * 1e6)}
    return _Followed(trace, words, columns, dict(zip(stage.axes, homed.errors, strict=True)), homed.certified)


def _scanned(stage: Stage, scan: str, options: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """Return the wanted displacements: the scan on the axes x and y, or the first two, the others in their middle."""
    import numpy as np

    from dehyst._errors import ModelError

    if len(stage.axes) < 2:
        raise ModelError("--scan: needs a stage of two axes at least")
    path = named_scan(scan, options["sample_rate"], options)
    parts = [path.path("x"), path.path("y")]
    cycles = options.get("cycles") or 1
    if cycles != 1 or parts[0].periodic:
        parts = [part.repeated(cycles) for part in parts]
    middle = stage.coupling @ np.array([0.5 * sum(one.reach) for one in stage.actuators])
    wanted = np.tile(middle, (len(parts[0].time), 1))
    moved = [stage.axes.index(axis) if {"x", "y"} <= set(stage.axes) else k for k, axis in enumerate("xy")]
    for k, part in zip(moved, parts, strict=True):
        wanted[:, k] = part.displacement
    return wanted, {"time_s": parts[0].time}


def _period(clock: dict[str, Any]) -> float | None:
    """Return the time between samples, if they are evenly spaced: the compensator checks its slew rate by it."""
    times = clock.get("time_s")
    return None if times is None or len(times) < 2 else float((times[-1] - times[0]) / (len(times) - 1))
