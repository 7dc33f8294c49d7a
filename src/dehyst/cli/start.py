"""The state in which a model starts, what an unknown one leaves open, and what a voltage file does not contain."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from dehyst._text import counted
from dehyst.cli.record_files import table_in

if TYPE_CHECKING:
    from dehyst.cli.models import AxesModel
    from dehyst.cli.slew import Slew
    from dehyst.control import HomedPath, PossibleStart, StartError
    from dehyst.model import Actuator, State
    from dehyst.records.formats.columns import Table
    from dehyst.trust import Judgement

# Least share of the stroke that is printed as a number [%].
_SMALL = 1e-3
# Of the displacements in an output of dehyst.
_COMPUTED = (
    "is an output of dehyst, whose displacements are computed, not measured: only its voltages determine the start; "
    "give a record for more"
)
# Before the file of a record whose beginning, not whose end, is the start.
_AS = "as:"
# Seconds of a homing from which on its duration is a warning.
_LONG = 60.0
_NAMES = ("top", "bottom", "relaxed", "homed")


class Request(NamedTuple):
    """The options of a command that computes voltages: the model, limits and slew rate, and the start.

    `start` is None if it is unknown. `home`: whether to home first; None: where the start matters.
    """

    actuator: Actuator
    limits: tuple[float, float] | None
    slew: Slew
    start: PossibleStart | None
    home: bool | None
    present: float | None
    as_json: bool


class StartFile(NamedTuple):
    """A file of what was played before: the start is the state at its end, or if `began` that in which it began."""

    path: Path
    began: bool

    def __str__(self) -> str:
        return f"{_AS if self.began else ''}{self.path}"


class _StartType(click.ParamType):  # type: ignore[type-arg]
    """The name of a state, or a file."""

    name = "start"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        return f"{'|'.join(_NAMES)}|FILE|{_AS}RECORD"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str | StartFile:
        if value in _NAMES:
            return str(value)
        began = not Path(value).exists() and str(value).startswith(_AS)
        file = StartFile(Path(str(value).removeprefix(_AS) if began else value), began)
        if not file.path.exists():
            needed = f"need {', '.join(_NAMES)}, a file of what was played before, or {_AS}RECORD"
            self.fail(f"got {value!r}, {needed}", param, ctx)
        return file


_STATES = (
    "turned at the top or bottom of the identified range; relaxed at 0 V; homed, as after 'dehyst excite homing "
    "--model' without other options; as at the end of FILE, a record, or only the voltages played before; or as "
    "RECORD began."
)


def start_option(command: Callable[..., None]) -> Callable[..., None]:
    """Add the option that selects the state in which a model starts; without it the state is unknown."""
    words = f"State before the first sample: {_STATES}  [default: unknown]"
    return click.option("--start", type=_StartType(), help=words)(command)


def path_start_option(command: Callable[..., None]) -> Callable[..., None]:
    """Add the option that selects the state before a trajectory; without it a rise through the limits leads to it."""
    words = f"State before the trajectory: {_STATES}  [default: the top of the limits, after a rise through them]"
    return click.option("--start", type=_StartType(), help=words)(command)


def start_or_top_option(command: Callable[..., None]) -> Callable[..., None]:
    """Add the option that selects the state in which a memory begins."""
    words = f"State in which memory begins: {_STATES}"
    return click.option("--start", type=_StartType(), default="top", show_default=True, help=words)(command)


def home_option(words: str) -> Callable[..., Any]:
    """Return the option that puts a homing before a path; --homing is its old name."""
    return click.option("--home/--no-home", "--homing", "home", default=None, help=words)


def given_starts(
    model: AxesModel,
    start: str | StartFile | None,
    limits: Sequence[tuple[float, float] | None],
    options: dict[str, Any],
    axes: str | None = None,
    *,
    rests: bool = True,
) -> tuple[list[PossibleStart | None], list[str]]:
    """Return the start of each axis, see `start_reader`, and remarks; None if none was given.

    `axes`: columns of several axes in a file of what was played before; by default those of the records.
    """
    if start is None:
        return [None] * len(model.axes), []
    starts = []
    columns = [{} if isinstance(start, str) else _columns(model, j, axes) for j in range(len(model.axes))]
    for j, (actuator, allowed) in enumerate(zip(model.actuators, limits, strict=True)):
        reader = start_reader(start, options, allowed, rests=rests, columns=columns, axis=j, targets=model.targets)
        begin = reader(actuator)
        starts.append(_played_within(actuator, begin, allowed) if model.stage and isinstance(start, str) else begin)
    return [*starts], model.prefixed(start.remarks for start in starts)


def _played_within(actuator: Actuator, start: PossibleStart, limits: tuple[float, float] | None) -> PossibleStart:
    """Return a named start, or if the limits do not reach it the one after loops between them, with a remark."""
    from dehyst.model.states import state_after_loops

    allowed = limits or actuator.limits
    state = start.state if allowed is None else state_after_loops(actuator, start.state, allowed)
    if allowed is None or state is start.state:
        return start
    remark = (
        f"the start {start.name} needs {actuator.voltage(start.state):.6g} V, outside the limits {allowed[0]:.6g} to "
        f"{allowed[1]:.6g} V: it begins at {actuator.voltage(state):.6g} V, after loops between the limits"
    )
    return replace(start, states=(state,), remarks=(remark,))


def _columns(model: AxesModel, j: int, axes: str | None) -> dict[str, str]:
    """Return the columns of axis `j` in a file of what was played before; of one axis they are found by their names."""
    from dehyst.records.tables import axis_columns

    if model.stage is None:
        return {}
    found = {one.name: one for one in axis_columns(model.stored_columns(axes if axes and ":" in axes else None) or "")}
    one = found.get(model.axes[j])
    computed = f"{model.axes[j]}_expected_um"
    return {} if one is None else {"voltage": one.voltage, "displacement": one.displacement, "computed": computed}


def start_reader(
    start: str | StartFile,
    options: dict[str, Any],
    limits: tuple[float, float] | None,
    *,
    rests: bool = True,
    columns: Sequence[Mapping[str, str]] = ({},),
    axis: int = 0,
    targets: Callable[[Any], Any] = lambda displacement: displacement,
) -> Callable[[Actuator], PossibleStart]:
    """Return what gives the start of an actuator that the option names, or that the file, read once, determines.

    Displacements that dehyst wrote are no measurement: of such a file only the voltages count. `rests`: whether the
    actuator rests at the voltage of the start, which is still applied: the file's last one, or its first if it is the
    beginning that counts. `columns`: the voltage, displacement and computed displacement of each axis, by default as
    one axis has them. `axis`: number of that of the actuator. `targets`: gives the displacements (n, axes) of the
    actuators for those of the axes.
    """
    import numpy as np

    from dehyst._errors import ModelError
    from dehyst._io import COMPUTED
    from dehyst.control import PossibleStart
    from dehyst.records import Record
    from dehyst.trust import start_of

    if isinstance(start, str):
        return lambda actuator: PossibleStart.named(actuator, start)  # type: ignore[arg-type]
    name, table = start.path.name, table_in(start.path, options)
    own = columns[axis].get("computed", COMPUTED) in table.names
    voltage = table.column("voltage", columns[axis].get("voltage"))
    measured = all(_has_displacement(table, one) for one in columns) and not own
    if start.began and not measured:
        raise ModelError(
            argument="start",
            got=f"{start}, without a measured displacement",
            need="a record with one: it determines the state in which the record began",
        )
    remarks = (f"{name}: {_COMPUTED}",) if own else ()

    def determined(actuator: Actuator) -> PossibleStart:
        time = table.column("time") if actuator.needs_time or measured else None
        if time is not None and measured:
            moved = np.column_stack([table.column("displacement", one.get("displacement")) for one in columns])
            record = Record(time, voltage, targets(moved)[:, axis], name)
            found = start_of(actuator, record, began=start.began, limits=limits)
        else:
            found = PossibleStart.after(actuator, voltage, time=time, limits=limits or actuator.limits, name=name)
        found = found.standing_at(actuator, float(voltage[0 if start.began else -1])) if rests else found
        return replace(found, remarks=(*found.remarks, *remarks))

    return determined


def _has_displacement(table: Table, columns: Mapping[str, str]) -> bool:
    return columns["displacement"] in table.names if "displacement" in columns else table.fitting("displacement") == 1


def start_words(actuator: Actuator, start: PossibleStart, state: State | None = None) -> str:
    """Describe the state before the first sample, in brackets; by default that of the start."""
    voltage = f"{actuator.voltage(start.within(actuator, None) if state is None else state):.4g} V"
    words = {
        "relaxed": f"(from rest, relaxed, at {voltage})",
        "homed": f"(homed, at {voltage})",
        "unknown": f"(from the middle of the possible starts, at {voltage})",
        "top": f"(coming from the top, {voltage})",
        "bottom": f"(coming from the bottom, {voltage})",
    }
    began = start.name.startswith(_AS)
    other = f"as {start.name.removeprefix(_AS)} began" if began else f"as at the end of {start.name}"
    return words.get(start.name, f"({other}, at {voltage})")


def homed_words(homed: HomedPath) -> str:
    """Describe the homing before a path, in brackets."""
    seconds = "" if homed.seconds is None else f", {homed.seconds:.4g} s"
    return f"(homed first, {counted(homed.first, 'sample')}{seconds})"


def error_line(name: str, error: StartError, *, homed: bool) -> str:
    """Describe what a start of this name leaves open, in one line."""
    largest, first, least = (_percent(error, length) for length in (error.largest, error.first, error.model_error))
    if homed:
        return f"unknown start: after the homing it leaves {largest} of the stroke open; the model's error is {least}"
    words = "unknown start: it leaves" if name == "unknown" else f"start after {name}: these voltages leave"
    line = f"{words} {largest} of the stroke open"
    if not error.matters:
        return f"{line}, the model's error is {least}"
    remedy = "give --start or --home" if name == "unknown" else "give --home instead of --start"
    line += f", {first} at the first sample"
    if error.settled is None:
        return f"{line}, and more than the model's error of {least} to the end: {remedy}"
    after = f"sample {error.settled}" if error.settled_seconds is None else f"{error.settled_seconds:.4g} s"
    return f"{line}, and less than the model's error of {least} after {after}: {remedy}"


def _percent(error: StartError, length: float) -> str:
    share = error.percent(length)
    return f"{share:.2g} %" if share >= _SMALL else f"less than {_SMALL} %"


def start_dict(name: str, error: StartError | None, homed: HomedPath | None = None) -> dict[str, Any]:
    """Return the start as JSON values."""
    return {
        "start": {"name": name, **({} if error is None else error.as_dict())},
        "homing_samples": 0 if homed is None else homed.first,
        "homing_s": 0.0 if homed is None else homed.seconds,
        "certified": None if homed is None else homed.certified,
    }


def lagging(displacement: Any, actuator: Actuator, time: dict[str, Any]) -> Any:
    """Return the displacement as a sensor shows it, late by the actuator's delay."""
    import numpy as np

    from dehyst._errors import FileFormatError

    if "time_s" not in time:
        raise FileFormatError(
            argument="lag", need="the time of each sample", hint="give a time column", change=("sample_rate",)
        )
    return np.interp(time["time_s"] - actuator.delay, time["time_s"], displacement)


def file_warnings(
    actuator: Actuator, first: float, start: PossibleStart, state: State, slew: float | None
) -> list[str]:
    """Warn of what the file does not contain: the ramp to its first voltage, earlier creep and the delay."""
    warnings = []
    present = actuator.voltage(state)
    if abs(first - present) > 0.01 * max(abs(value) for value in (present, *(actuator.limits or ()))):
        within = "slowly" if slew is None else "within the slew rate"
        warnings.append(
            f"the first voltage, {first:.6g} V, is {abs(first - present):.6g} V away from that of the start, "
            f"{present:.6g} V: ramp there {within} before you play the file"
        )
    if actuator.creep is not None and start.name in ("top", "bottom", "relaxed"):
        longest = float(actuator.creep.time_constants[-1])
        warnings.append(
            f"this model creeps, and --start {start.name} assumes that the actuator has rested there for much longer "
            f"than {longest:.3g} s; otherwise the displacement will be off: leave out --start, or play a homing "
            "(dehyst excite homing --model) and use --start homed"
        )
    return [*warnings, *delay_warnings(actuator)]


def delay_warnings(actuator: Actuator) -> list[str]:
    """Warn of the delay of the stage, if it has one."""
    if not actuator.delay:
        return []
    return [f"the measured displacement lagged by {actuator.delay * 1e3:.4g} ms: expect it that much later"]


# Wanted displacement [m], columns of time, and derivatives.
WantedPath = tuple[Any, dict[str, Any], dict[str, Any]]


def planned(model: AxesModel, requests: Sequence[Request], path: WantedPath) -> list[HomedPath]:
    """Return the voltages of each axis along a path: from its start, or if that matters, after a homing."""
    from dehyst.control import Compensator, StageCompensator, plan_path

    first, (wanted, time, derivatives), when = requests[0], path, path[1].get("time_s")
    if model.stage is None:
        one = Compensator(first.actuator, first.limits, first.slew.bound)
        options: dict[str, Any] = {"start": first.start, "home": first.home, "present": first.present}
        return [plan_path(one, wanted[:, 0], time=when, **derivatives, **options)]
    limits, slews = [each.limits for each in requests], [each.slew.bound for each in requests]
    several = StageCompensator(model.stage, limits=limits, slew_rate=slews, period=period_of(time))
    starts = [each.start for each in requests if each.start is not None]
    present = None if first.present is None else [first.present] * len(requests)
    return [*plan_path(several, wanted, time=when, start=starts or None, home=first.home, present=present)]


def period_of(clock: dict[str, Any]) -> float | None:
    """Return the mean time between samples, by which the compensator of a stage checks its slew rate."""
    times = clock.get("time_s")
    return None if times is None or len(times) < 2 else float((times[-1] - times[0]) / (len(times) - 1))


def described(request: Request, answer: HomedPath) -> tuple[str, list[str]]:
    """Return the start of a path in brackets, and warnings of what the file does not contain."""
    actuator, warnings = request.actuator, [*answer.warnings]
    if answer.homing is not None:
        return homed_words(answer), [*warnings, *delay_warnings(actuator), *_of_long_homing(answer)]
    begin, first = answer.start.within(actuator, request.limits), float(answer.voltage[0])
    if answer.first:
        warnings.insert(
            0,
            f"the first {counted(answer.first, 'sample')} lead from {first:.6g} V to the first one of the path within "
            "the slew rate: play the whole file",
        )
    warnings += file_warnings(actuator, first, answer.start, begin, request.slew.bound)
    if request.present is not None and request.start is None:
        warnings.append("--present: has no effect, because the start does not matter and no homing is needed")
    return start_words(actuator, answer.start, begin), warnings


def _of_long_homing(homed: HomedPath) -> list[str]:
    """Warn of a homing that the user did not request and that takes long, with its purpose."""
    without = homed.unhomed
    if without is None or homed.seconds is None or homed.seconds < _LONG:
        return []
    return [
        f"the homing takes {homed.seconds:.4g} s; without it (--no-home) the unknown start leaves "
        f"{without.percent(without.largest):.2g} % of the stroke open. If what was played last is on file, --start "
        "FILE needs no homing"
    ]


def clock_columns(path: HomedPath, time: dict[str, Any]) -> dict[str, Any]:
    """Return the columns time_s, if there is a `time`, and phase, if something comes before the path."""
    if path.homing is None and not path.first:
        return time
    return {**({} if path.time is None else {"time_s": path.time}), "phase": path.phase}


def left_open(path: HomedPath) -> StartError | None:
    """Return what the start of a path leaves open; None if it is known."""
    return None if path.homing is None and path.start.known else path.error


def error_lines(path: HomedPath) -> list[str]:
    """Return a line on what the start of a path leaves open; none if it is known."""
    error = left_open(path)
    return [] if error is None else [error_line(path.start.name, error, homed=path.homing is not None)]


def promise_lines(request: Request, judged: Judgement) -> list[str]:
    """Return a line on the error that the identification promised of a path like the records, if it is known."""
    words = judged.words(float(request.actuator.reach[1] - request.actuator.reach[0]))
    return [f"expect a path like the records {words}"] if words else []


def path_start_dict(path: HomedPath) -> dict[str, Any]:
    """Return the start of a path as JSON values."""
    return start_dict(path.start.name, left_open(path), None if path.homing is None else path)


def path_columns(part: Any) -> dict[str, Any]:
    """Return the columns of a wanted displacement, its voltage and the displacement to expect."""
    return {"displacement_um": part.displacement * 1e6, "voltage_V": part.voltage, "expected_um": part.expected * 1e6}
