"""The voltages of a path, for `dehyst compensate`: from a known start, or with a homing before it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from dehyst.cli.start import Request, begin_within, delay_warnings, file_warnings, homed_words, start_words

if TYPE_CHECKING:
    from dehyst.control import Compensator, HomedPath, PossibleStart, StartError
    from dehyst.model import State

# Seconds of a homing from which on its duration is a warning.
_LONG = 60.0
# Wanted displacement [m], columns of time, and derivatives.
WantedPath = tuple[Any, dict[str, Any], dict[str, Any]]


@dataclass(frozen=True, eq=False)
class PathVoltages:
    """The voltages of a path: their columns, and what is known of their start."""

    columns: dict[str, Any]
    clamped: int
    followed: bool
    state: State
    start: PossibleStart
    words: str
    warnings: list[str]
    error: StartError | None
    homed: HomedPath | None = None

    @classmethod
    def of(cls, request: Request, compensator: Compensator, path: WantedPath) -> PathVoltages:
        """Return the voltages from the start that was given, or if it matters, with a homing before the path."""
        if request.home:
            return _homed(request, compensator, path)
        answer = _from_start(request, compensator, path)
        if request.start is None and request.home is None and answer.error is not None and answer.error.matters:
            homed = _homed(request, compensator, path)
            homed.warnings.extend(_of_long_homing(homed.homed, answer.error))
            return homed
        return answer


def _from_start(request: Request, compensator: Compensator, path: WantedPath) -> PathVoltages:
    """Return the voltages from the start, or from the middle of the possible ones."""
    from dehyst.control import PossibleStart, StartError, start_at
    from dehyst.control.reachable import state_at

    wanted, time, derivatives = path
    actuator, limits, slew, start, *_ = request
    if start is None:
        start = start_at(actuator, float(wanted[0]) if wanted.size else 0.0, compensator.limits)
    begin = begin_within(actuator, start, limits)
    # The user ramps slowly to the first sample, see `file_warnings`.
    first = state_at(actuator, begin, float(wanted[0])) if wanted.size and actuator.model.moves_on else begin
    when = time.get("time_s")
    command = compensator.trajectory(wanted, time=when, **derivatives, state=first)
    error = None
    if not start.known and wanted.size:
        states = start.states
        if start.name == "unknown":
            # Without a homing the actuator rests at the first voltage, however it was brought there.
            states = PossibleStart.unknown(actuator, float(command.voltage[0]), compensator.limits).states
        error = StartError.along(actuator, states, command.voltage, time=when)
    columns = {**time, **_columns(wanted, command.voltage, command.displacement)}
    unwritten = file_warnings(actuator, float(command.voltage[0]), start, begin, slew) if wanted.size else []
    words = start_words(actuator, start, begin)
    clamped = int(command.clamped.sum())
    warnings = [*command.warnings, *unwritten]
    return PathVoltages(columns, clamped, command.followed, command.state, start, words, warnings, error)


def _homed(request: Request, compensator: Compensator, path: WantedPath) -> PathVoltages:
    """Return the voltages with the shortest homing before them."""
    from dehyst.control import home_before

    wanted, time, derivatives = path
    homed = home_before(compensator, wanted, time=time.get("time_s"), **derivatives, present=request.present)
    columns = {
        **({} if homed.time is None else {"time_s": homed.time}),
        "phase": homed.phase,
        **_columns(homed.displacement, homed.voltage, homed.expected),
    }
    warnings = [*homed.warnings, *delay_warnings(request.actuator)]
    clamped, start, words = int(homed.clamped.sum()), homed.start, homed_words(homed)
    return PathVoltages(columns, clamped, homed.followed, homed.state, start, words, warnings, homed.error, homed)


def _of_long_homing(homed: HomedPath | None, without: StartError) -> list[str]:
    """Warn of a homing that nobody asked for and that takes long, with what it is for."""
    if homed is None or homed.seconds is None or homed.seconds < _LONG:
        return []
    return [
        f"the homing takes {homed.seconds:.4g} s; without it (--no-home) the unknown start leaves "
        f"{without.percent(without.largest):.2g} % of the stroke open. If what was played last is on file, --start "
        "FILE needs no homing"
    ]


def _columns(wanted: Any, voltage: Any, expected: Any) -> dict[str, Any]:
    return {"displacement_um": wanted * 1e6, "voltage_V": voltage, "expected_um": expected * 1e6}
