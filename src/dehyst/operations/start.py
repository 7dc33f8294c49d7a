"""The initial state of a model: how it is given, its uncertainty, and what to do before a file is played."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from dehyst._io import COMPUTED
from dehyst._text import counted, digits
from dehyst._types import Array
from dehyst._views.lines import place
from dehyst.control import PathPlan, PossibleStart
from dehyst.control.planning.start import NAMES
from dehyst.model import Actuator, State, creep_times, needs_time, voltages_of
from dehyst.operations.axes import AxesModel, Limits
from dehyst.operations.command import FilePath, Role, option
from dehyst.operations.files import AS_FOUND, Columns, columns_in
from dehyst.records import read_table
from dehyst.records.columns import columns_of_axis
from dehyst.records.files import record_of
from dehyst.trust import start_of

_COMPUTED = (
    "is an output of dehyst, whose displacements are computed, not measured: only its voltages determine the start; "
    "give a record for more"
)


class _Start(FilePath):
    """A name of `PossibleStart`, or a file with the voltages played before."""

    def __init__(self) -> None:
        super().__init__(Role.INPUT)
        self.name = "start"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return a name as it is, or the path of a file."""
        if value in NAMES:
            return value
        if not Path(value).exists():
            need = f"{', '.join(NAMES)}, or a file of what was played before"
            self.fail(f"got {value!r}, need {need}", param, ctx)
        return super().convert(value, param, ctx)


_METAVAR = f"{'|'.join(NAMES)}|FILE"
START: Any = option("State before the first sample; default: unknown.", _Start(), metavar=_METAVAR)


def starts_of(
    model: AxesModel,
    start: str | Path | None,
    limits: Sequence[Limits],
    columns: Columns,
    present: Sequence[float | None] = (),
    *,
    rests: bool = True,
) -> tuple[list[PossibleStart | None], list[str]]:
    """Return the start of each axis (None if not given) and remarks.

    `present`: voltages [V] to which the actuators moved after it. `rests`: whether they still rest at the voltages of
    the start, the last ones of a file.
    """
    if start is None:
        return [None] * len(model.axes), []
    if isinstance(start, Path):
        found = _starts_in(model, start, limits, columns, rests=rests)
    else:
        found = [PossibleStart.named(actuator, start) for actuator in model.actuators]  # type: ignore[arg-type]
    for j, volts in enumerate(present):
        found[j] = found[j] if volts is None else found[j].standing_at(model.actuators[j], volts)
    return [*found], model.prefixed(begin.remarks for begin in found)


def _starts_in(
    model: AxesModel, path: Path, limits: Sequence[Limits], columns: Columns, *, rests: bool
) -> list[PossibleStart]:
    """Return the start of each axis from a file. Displacements written by dehyst are not measured, and not used."""
    table, name = read_table(path, columns), path.name
    own = {f"{axis}_{COMPUTED}" if axis else COMPUTED for axis in model.axes} <= set(table.names)
    # Given columns are those of the path; this file may have others, and dehyst's own file has the usual ones.
    if model.stage is not None:
        both = columns.axes and all(len(columns_of_axis(text)) == 2 for text in columns.axes.values())
        used = AS_FOUND if own else columns if both else replace(columns, axes=model.recorded())
    else:
        used = AS_FOUND if own else columns_in(columns, table)
    moved = [used.displacement] if model.stage is None else model.named("displacement", used).values()
    measured = not own and all(table.fitting("displacement", column) == 1 for column in moved)
    record = record_of(table, used, name) if measured else None
    time = table.column("time", used.time) if record is None and any(map(needs_time, model.actuators)) else None
    volts, starts = model.values(table, "voltage", used), []
    for j, (actuator, allowed) in enumerate(zip(model.actuators, limits, strict=True)):
        if record is None:
            before: dict[str, Any] = {"time": time, "limits": allowed or actuator.limits, "name": name}
            found = PossibleStart.after(actuator, volts[:, j], **before)
        else:
            alone = record if model.stage is None else model.stage.alone(record, j)
            found = start_of(actuator, alone, limits=allowed)
        found = found.standing_at(actuator, float(volts[-1, j])) if rests else found
        starts.append(replace(found, name=name, remarks=(*found.remarks, *[f"{name}: {_COMPUTED}"] * own)))
    return starts


def start_words(actuator: Actuator, start: PossibleStart, state: State | None = None) -> str:
    """Describe the state before the first sample, in brackets; by default the state of the start."""
    volts = actuator.voltage(start.within(actuator, None) if state is None else state)
    return f"(start: {start.name}, at {_volts(actuator, volts)})"


def _volts(actuator: Actuator, voltage: float) -> str:
    """Return a voltage [V] of an actuator as text, with significant digits only."""
    return f"{place(voltage, float(np.ptp(voltages_of(actuator))))} V"


def begin_words(actuator: Actuator, path: PathPlan, limits: Limits, present: float | None) -> str:
    """Describe what comes before a path, or the state before its first sample, in brackets."""
    if path.homing is None:
        place = limits if present is None else (present, present)
        return start_words(actuator, path.start, path.start.within(actuator, place))
    seconds = "" if path.time is None else f" in {path.homing.played.duration:.4g} s"
    begins = f"the path begins after {counted(path.first, 'sample')}"
    begins += "" if path.seconds is None else f", at {path.seconds:.4g} s"
    return f"(homed first from {_volts(actuator, path.homing.turns[0])}{seconds}; {begins})"


def open_start(path: PathPlan) -> list[str]:
    """Return a line on the error of an unknown start along a path, if it matters and there is no homing."""
    error = path.left_open
    if error is None or path.homing is not None or not error.matters:
        return []
    largest, first = (f"{digits(error.percent(length))} %" for length in (error.largest, float(error.difference[0])))
    remedy = "give --start" if path.start.name == "unknown" else "home the actuator first"
    return [f"the start is uncertain by {largest} of the stroke, {first} at the first sample: {remedy}"]


def start_fields(path: PathPlan) -> dict[str, Any]:
    """Return the start of a path as JSON values."""
    return {"name": path.start.name, **({} if path.left_open is None else path.left_open.as_dict())}


def before_path(
    actuator: Actuator, path: PathPlan, limits: Limits, slew: float | None, given: float | None
) -> Iterator[str]:
    """Yield what to do before a path without a homing: a ramp to its first voltage, and a rest of a model that creeps.

    `given`: the present voltage [V], from which the plan begins. Without it and a start, 0 V is assumed.
    """
    if path.homing is not None:
        return
    first, unknown = float(path.voltage[0]), path.start.name == "unknown"
    longest = creep_times(actuator).max(initial=0.0)
    present = 0.0 if unknown else actuator.voltage(path.start.within(actuator, limits))
    if given is None and abs(first - present) > 0.01 * max(abs(value) for value in (present, *voltages_of(actuator))):
        origin, hint = ("", "; --present V puts the ramp into the file") if unknown else ("that of the start, ", "")
        yield (
            f"the first voltage, {_volts(actuator, first)}, is {_volts(actuator, abs(first - present))} away from "
            f"{origin}{_volts(actuator, present)}: "
            f"ramp there {'slowly' if slew is None else 'within the slew rate'} before you play the file{hint}"
        )
    if longest and path.start.name in ("top", "bottom", "relaxed"):
        yield (
            f"this model creeps, and --start {path.start.name} assumes that the actuator has rested there for much "
            f"longer than {longest:.3g} s; otherwise the displacement has an error: leave out --start"
        )


def clock_columns(path: PathPlan, time: Mapping[str, Array]) -> dict[str, Any]:
    """Return the columns time_s, if there is a `time`, and phase, if something comes before the path."""
    if path.homing is None and not path.first:
        return dict(time)
    return {**({} if path.time is None else {"time_s": path.time}), "phase": path.phase}
