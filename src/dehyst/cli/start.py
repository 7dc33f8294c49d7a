"""The state in which a model starts, what an unknown one leaves open, and what a voltage file does not contain."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from dehyst._text import counted

if TYPE_CHECKING:
    from dehyst.control import HomedPath, PossibleStart, StartError
    from dehyst.model import Actuator, State
    from dehyst.records import Record

# Voltages farther outside of a model's limits than this part of their range were not covered by its records.
_FAR = 0.1
# Least share of the stroke that is printed as a number [%].
_SMALL = 1e-3
# Of the displacements in an output of dehyst.
_COMPUTED = (
    "is an output of dehyst, whose displacements are computed, not measured: only its voltages determine the start; "
    "give a record for more"
)
_NAMES = ("top", "bottom", "relaxed", "homed")


class Request(NamedTuple):
    """The options of a command that computes voltages: the model, limits and slew rate, and the start.

    `start` is None if it is unknown. `home`: whether to home first; None: where the start matters.
    """

    actuator: Actuator
    limits: tuple[float, float] | None
    slew: float | None
    start: PossibleStart | None
    home: bool | None
    present: float | None
    as_json: bool


class _StartType(click.ParamType):  # type: ignore[type-arg]
    """The name of a state, or a file."""

    name = "start"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        return f"{'|'.join(_NAMES)}|FILE"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str | Path:
        if value in _NAMES:
            return str(value)
        path = Path(value)
        if not path.exists():
            self.fail(f"got {value!r}, need {', '.join(_NAMES)}, or a file of what was played before", param, ctx)
        return path


_STATES = (
    "turned at the top or bottom of the identified range; relaxed at 0 V; homed, as after 'dehyst excite homing "
    "--model' without other options; or as at the end of FILE, a record, or only the voltages played before."
)


def start_option(command: Callable[..., None]) -> Callable[..., None]:
    """Add the option that selects the state in which a model starts; without it the state is unknown."""
    words = f"State before the first sample: {_STATES}  [default: unknown]"
    return click.option("--start", type=_StartType(), help=words)(command)


def start_or_top_option(command: Callable[..., None]) -> Callable[..., None]:
    """Add the option that selects the state in which a memory begins."""
    words = f"State in which memory begins: {_STATES}"
    return click.option("--start", type=_StartType(), default="top", show_default=True, help=words)(command)


def home_option(words: str) -> Callable[..., Any]:
    """Return the option that puts a homing before a path; --homing is its old name."""
    return click.option("--home/--no-home", "--homing", "home", default=None, help=words)


def given_start(
    actuator: Actuator, start: str | Path, limits: tuple[float, float] | None, max_bytes: float
) -> tuple[PossibleStart, list[str]]:
    """Return the start that the option names or the file determines, and remarks on it.

    Displacements that dehyst wrote are no measurement: of such a file only the voltages count.
    """
    from dehyst._io.marks import written_by_dehyst
    from dehyst.control import PossibleStart
    from dehyst.records import Record, read_table

    if isinstance(start, str):
        return PossibleStart.named(actuator, start), []  # type: ignore[arg-type]
    table = read_table(start, max_bytes=max_bytes)
    own, voltage = written_by_dehyst(start), table.column("voltage")
    measured = table.has("displacement") and not own
    time = table.column("time") if actuator.needs_time or measured else None
    outside = _outside_words(actuator, start.name, voltage, limits)
    if own and table.has("displacement"):
        outside.append(f"{start.name}: {_COMPUTED}")
    if time is not None and measured:
        state, beside = _after_record(actuator, Record(time, voltage, table.column("displacement"), start.name))
        return state, [*outside, *beside]
    known = PossibleStart.after(actuator, voltage, time=time, limits=limits or actuator.limits, name=start.name)
    return known, outside


def _outside_words(actuator: Actuator, name: str, voltage: Any, limits: tuple[float, float] | None) -> list[str]:
    """Return a remark on earlier voltages outside the identified range; refuse those far outside of what is allowed."""
    from dehyst._errors import ModelError
    from dehyst.model.plausibility import Range, voltage_error

    if actuator.limits is None:
        return []
    identified = Range(*actuator.limits)
    far = identified.joined(*([] if limits is None else [limits])).far_ends(voltage)
    if far is not None:
        raise ModelError(f"{name}: {voltage_error(far, identified)}")
    return [f"{name}: {words}" for words in outside_warnings(actuator, voltage)[2]]


def _after_record(actuator: Actuator, record: Record) -> tuple[PossibleStart, list[str]]:
    """Return the state at the end of a record, and a remark if its voltages lie beside the model's."""
    import numpy as np

    from dehyst._errors import ModelError
    from dehyst.control import PossibleStart
    from dehyst.control.start_error import model_error
    from dehyst.identification import state_after
    from dehyst.model.plausibility import implausibility

    if reason := implausibility(actuator, record.displacement, None):
        raise ModelError(f"{record.name}: {reason}")
    state, offset = state_after(actuator, record)
    low, high = actuator.voltage_range
    share = abs(offset) / (high - low)
    if share * float(np.ptp(actuator.reach)) <= model_error(actuator):
        return PossibleStart(record.name, (state,)), []
    remark = (
        f"{record.name}: its voltages lie {offset:.4g} V beside those of the model, {100 * share:.2g} % of the range: "
        "expect displacements to lie beside the sensor's by as much"
    )
    return PossibleStart(record.name, (state,)), [remark]


def begin_within(actuator: Actuator, start: PossibleStart, limits: tuple[float, float] | None) -> State:
    """Return the state of a start, or the nearest one within the limits."""
    from dehyst.control.reachable import state_within_limits

    allowed = limits or actuator.limits
    return start.state if allowed is None else state_within_limits(actuator, start.state, allowed)


def start_words(actuator: Actuator, start: PossibleStart, state: State | None = None) -> str:
    """Describe the state before the first sample, in brackets; by default that of the start."""
    voltage = f"{actuator.voltage(begin_within(actuator, start, None) if state is None else state):.4g} V"
    words = {
        "relaxed": f"(from rest, relaxed, at {voltage})",
        "homed": f"(homed, at {voltage})",
        "unknown": f"(from the middle of the possible starts, at {voltage})",
        "top": f"(coming from the top, {voltage})",
        "bottom": f"(coming from the bottom, {voltage})",
    }
    return words.get(start.name, f"(as at the end of {start.name}, at {voltage})")


def homed_words(homed: HomedPath) -> str:
    """Describe the homing before a path, in brackets."""
    seconds = "" if homed.seconds is None else f", {homed.seconds:.4g} s"
    return f"(homed first, {counted(homed.first, 'sample')}{seconds})"


def start_error(
    actuator: Actuator,
    start: PossibleStart,
    voltage: Any,
    limits: tuple[float, float] | None,
    *,
    time: Any = None,
    first: int = 0,
) -> StartError | None:
    """Return what a start leaves open of the motion by a voltage [V] from sample `first` on; None if it is known.

    An actuator of unknown history rests at the first voltage, however it was brought there.
    """
    from dehyst.control import PossibleStart, StartError

    if start.known or not voltage.size:
        return None
    states = start.states
    if start.name == "unknown":
        states = PossibleStart.unknown(actuator, float(voltage[0]), limits).states
    return StartError.along(actuator, states, voltage, time=time, first=first)


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
        raise FileFormatError("--lag needs the time of each sample: a time column, or --sample-rate")
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


def outside_warnings(actuator: Actuator, voltage: Any) -> tuple[int, bool, list[str]]:
    """Count the voltages [V] outside the identified range; return whether one lies far outside, and warnings.

    Far is more than a tenth of the range away: there the model is a straight line without any measurement behind it.
    """
    import numpy as np

    if actuator.limits is None:
        return 0, False, []
    low, high = actuator.limits
    beyond = np.maximum(low - voltage, voltage - high)
    count = int(np.count_nonzero(beyond > 0))
    if not count:
        return 0, False, []
    warning = (
        f"{count} of {voltage.size} voltages lie outside the identified range {low:.6g} to {high:.6g} V: extrapolated"
    )
    far = float(beyond.max()) > _FAR * (high - low)
    if far:
        warning += (
            f", and far: {float(voltage[int(np.argmax(beyond))]):.6g} V lies {float(beyond.max()):.6g} V beyond, "
            f"more than {100 * _FAR:.0f} % of the range. Nothing was measured there: record these voltages and "
            "identify again"
        )
    return count, far, [warning]
