"""The voltages of a path, for `dehyst compensate`: from a known start, or with a homing before it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dehyst.cli.played_voltage import PlayedVoltage
from dehyst.cli.start import Request, begin_within, delay_warnings, file_warnings, start_error, start_words

if TYPE_CHECKING:
    from dehyst.control import Compensator, HomedPath, StartError

# Seconds of a homing from which on its duration is a warning.
_LONG = 60.0
# Wanted displacement [m], columns of time, and derivatives.
WantedPath = tuple[Any, dict[str, Any], dict[str, Any]]


def path_voltages(request: Request, compensator: Compensator, path: WantedPath) -> PlayedVoltage:
    """Return the voltages from the start that was given, or if it matters, with a homing before the path."""
    if request.home:
        return _homed(request, compensator, path)
    answer = _from_start(request, compensator, path)
    if request.start is None and request.home is None and answer.error is not None and answer.error.matters:
        homed = _homed(request, compensator, path)
        homed.warnings.extend(_of_long_homing(homed.homed, answer.error))
        return homed
    return answer


def _from_start(request: Request, compensator: Compensator, path: WantedPath) -> PlayedVoltage:
    """Return the voltages from the start, or from the middle of the possible ones."""
    from dehyst.control import start_at
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
    unwritten = file_warnings(actuator, float(command.voltage[0]), start, begin, slew) if wanted.size else []
    return PlayedVoltage(
        clock=time,
        voltage=command.voltage,
        displacement=wanted,
        expected=command.displacement,
        state=command.state,
        start=start,
        words=start_words(actuator, start, begin),
        error=start_error(actuator, start, command.voltage, compensator.limits, time=when),
        warnings=[*command.warnings, *unwritten],
        clamped=int(command.clamped.sum()),
        followed=command.followed,
    )


def _homed(request: Request, compensator: Compensator, path: WantedPath) -> PlayedVoltage:
    """Return the voltages with the shortest homing before them."""
    from dehyst.control import home_before

    wanted, time, derivatives = path
    homed = home_before(compensator, wanted, time=time.get("time_s"), **derivatives, present=request.present)
    answer = PlayedVoltage.after_homing(homed)
    answer.warnings.extend(delay_warnings(request.actuator))
    return answer


def _of_long_homing(homed: HomedPath | None, without: StartError) -> list[str]:
    """Warn of a homing that the user did not request and that takes long, with its purpose."""
    if homed is None or homed.seconds is None or homed.seconds < _LONG:
        return []
    return [
        f"the homing takes {homed.seconds:.4g} s; without it (--no-home) the unknown start leaves "
        f"{without.percent(without.largest):.2g} % of the stroke open. If what was played last is on file, --start "
        "FILE needs no homing"
    ]
