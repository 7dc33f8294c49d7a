"""The initial state of a model: how it is given, and what to do before a file is played."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dehyst._errors import ModelError
from dehyst._io import COMPUTED
from dehyst._text import counted, digits
from dehyst._views.lines import place
from dehyst.control import PathPlan, PossibleStart
from dehyst.control.planning.start import NAMES
from dehyst.model import Actuator, creep_times, needs_time, voltages_of
from dehyst.operations.axes import AxesModel, Limits
from dehyst.operations.command import INPUT, option
from dehyst.operations.files import AS_FOUND, Columns, columns_in
from dehyst.records import read_table
from dehyst.records.columns import columns_of_axis
from dehyst.records.files import record_of
from dehyst.trust import start_of

_COMPUTED = (
    "is an output of dehyst, whose displacements are computed, not measured: only its voltages determine the start; "
    "give a record for more"
)


_METAVAR = f"{'|'.join(NAMES)}|FILE"
START: Any = option("State before the first sample; default: unknown.", INPUT, metavar=_METAVAR)


def starts_of(
    known: AxesModel,
    start: Path | None,
    limits: Sequence[Limits],
    columns: Columns,
    present: Sequence[float | None] = (),
    *,
    rests: bool = True,
) -> list[PossibleStart | None]:
    """Return the start of each axis; None if it is not given.

    `present`: voltages [V] to which the actuators moved after it. `rests`: whether they still rest at the voltages of
    the start, the last ones of a file.
    """
    if start is None:
        return [None] * len(known.axes)
    if str(start) in NAMES:
        found = [PossibleStart.named(actuator, str(start)) for actuator in known.actuators]  # type: ignore[arg-type]
    elif start.exists():
        found = _starts_in(known, start, limits, columns, rests=rests)
    else:
        raise ModelError(argument="start", got=str(start), need=f"{', '.join(NAMES)}, or a file of what was played")
    known.remark(begin.remarks for begin in found)
    for j, volts in enumerate(present):
        if volts is not None:
            last = _volts(known.actuators[j], known.actuators[j].voltage(found[j].state))
            known.run.remarks.append(f"{found[j].name} ends at {last}; a motion from there to {volts:.4g} V is assumed")
            found[j] = found[j].standing_at(known.actuators[j], volts)
    return [*found]


def _starts_in(
    known: AxesModel, path: Path, limits: Sequence[Limits], columns: Columns, *, rests: bool
) -> list[PossibleStart]:
    """Return the start of each axis from a file. Displacements written by dehyst are not measured, and not used."""
    table, name = read_table(path, columns), path.name
    own = {f"{axis}_{COMPUTED}" if axis else COMPUTED for axis in known.axes} <= set(table.names)
    used = AS_FOUND
    if known.several and not own:
        both = columns.axes and all(len(columns_of_axis(text)) == 2 for text in columns.axes.values())
        used = columns if both else replace(columns, axes=known.recorded())
    elif not own:
        # Given columns are those of the path, and this file may have others.
        used = columns_in(columns, table)
    moved = known.named("displacement", used).values() if known.several else [used.displacement]
    measured = not own and all(table.fitting("displacement", column) == 1 for column in moved)
    record = record_of(table, used, name) if measured else None
    time = table.column("time", used.time) if record is None and any(map(needs_time, known.actuators)) else None
    volts, starts = known.values(table, "voltage", used), []
    for j, (actuator, allowed) in enumerate(zip(known.actuators, limits, strict=True)):
        if record is None:
            before: dict[str, Any] = {"time": time, "limits": allowed or actuator.limits, "name": name}
            found = PossibleStart.after(actuator, volts[:, j], **before)
        else:
            found = start_of(actuator, known.stage.alone(record, j) if known.several else record, limits=allowed)
        found = found.standing_at(actuator, float(volts[-1, j])) if rests else found
        starts.append(replace(found, name=name, remarks=(*found.remarks, *[f"{name}: {_COMPUTED}"] * own)))
    return starts


def _volts(actuator: Actuator, voltage: float) -> str:
    """Return a voltage [V] of an actuator as text, with significant digits only."""
    return f"{place(voltage, float(np.ptp(voltages_of(actuator))))} V"


def begin_words(plan: PathPlan) -> str:
    """Describe what comes before a path, or the state before its first sample, in brackets."""
    if plan.homing is None:
        return f"(start: {plan.start.name})"
    seconds = "" if plan.time is None else f" in {plan.homing.played.duration:.4g} s"
    begins = f"the path begins after {counted(plan.first, 'sample')}"
    begins += "" if plan.seconds is None else f", at {plan.seconds:.4g} s"
    return f"(homed first from {plan.homing.turns[0]:.4g} V{seconds}; {begins})"


def open_start(plan: PathPlan) -> list[str]:
    """Return a remark on the error of an unknown start along a path, if it matters and there is no homing."""
    error = plan.left_open
    if error is None or plan.homing is not None or not error.matters:
        return []
    largest, first = (f"{digits(error.percent(length))} %" for length in (error.largest, float(error.difference[0])))
    remedy = "give --start" if plan.start.name == "unknown" else "home the actuator first"
    return [f"the start is uncertain by {largest} of the stroke, {first} at the first sample: {remedy}"]


def start_fields(plan: PathPlan) -> dict[str, Any]:
    """Return the start of a path as JSON values."""
    return {"name": plan.start.name, **({} if plan.left_open is None else plan.left_open.as_dict())}


def before_path(actuator: Actuator, plan: PathPlan, limits: Limits, given: float | None) -> Iterator[str]:
    """Yield what to do before a path without a homing: a ramp to its first voltage, and a rest of a model that creeps.

    `given`: the present voltage [V], from which the plan begins. Without it and a start, 0 V is assumed.
    """
    if plan.homing is not None:
        return
    first, unknown = float(plan.voltage[0]), plan.start.name == "unknown"
    longest = creep_times(actuator).max(initial=0.0)
    present = 0.0 if unknown else actuator.voltage(plan.start.within(actuator, limits))
    if given is None and abs(first - present) > 0.01 * max(abs(value) for value in (present, *voltages_of(actuator))):
        origin, hint = ("", "; --present V puts the ramp into the file") if unknown else ("that of the start, ", "")
        yield (
            f"the first voltage, {_volts(actuator, first)}, is {_volts(actuator, abs(first - present))} away from "
            f"{origin}{_volts(actuator, present)}: ramp there slowly before you play the file{hint}"
        )
    if longest and plan.start.name in ("top", "bottom", "relaxed"):
        yield (
            f"this model creeps, and --start {plan.start.name} assumes that the actuator has rested there for much "
            f"longer than {longest:.3g} s; otherwise the displacement has an error: leave out --start"
        )
