"""A voltage that a command writes, the displacement that it causes, and what is known of its start."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from dehyst.cli.start import (
    Request,
    begin_within,
    delay_warnings,
    error_line,
    file_warnings,
    homed_words,
    start_dict,
    start_error,
    start_words,
)

if TYPE_CHECKING:
    from dehyst.control import Compensator, HomedPath, PossibleStart, StartError
    from dehyst.model import State

# Seconds of a homing from which on its duration is a warning.
_LONG = 60.0
# Wanted displacement [m], columns of time, and derivatives.
WantedPath = tuple[Any, dict[str, Any], dict[str, Any]]


@dataclass(frozen=True, eq=False)
class PlayedVoltage:
    """A voltage with its displacement, from a start or after a homing.

    Attributes
    ----------
    clock : dict
        The columns time_s, if there is a time, and phase, if there is a homing.
    voltage, displacement, expected : (n,) array
        Voltage [V], wanted displacement and that of the model [m]; both are the same if the voltage was given.
    state : State
        At the last sample.
    start : PossibleStart
    words : str
        The start, in brackets.
    error : StartError or None
        What the start leaves open; None if it is known.
    warnings : list of str
    clamped : int
        Number of samples whose voltage was changed.
    followed : bool
        As that of a `Command`.
    homed : HomedPath or None
        The homing, if there is one.
    """

    clock: dict[str, Any]
    voltage: Any
    displacement: Any
    expected: Any
    state: State
    start: PossibleStart
    words: str
    error: StartError | None
    warnings: list[str] = field(default_factory=list)
    clamped: int = 0
    followed: bool = True
    homed: HomedPath | None = None

    @classmethod
    def after_homing(cls, homed: HomedPath) -> PlayedVoltage:
        """Return the voltage of a path with its homing."""
        return cls(
            clock={**({} if homed.time is None else {"time_s": homed.time}), "phase": homed.phase},
            voltage=homed.voltage,
            displacement=homed.displacement,
            expected=homed.expected,
            state=homed.state,
            start=homed.start,
            words=homed_words(homed),
            error=homed.error,
            warnings=[*homed.warnings],
            clamped=int(homed.clamped.sum()),
            followed=homed.followed,
            homed=homed,
        )

    @property
    def certified(self) -> bool:
        """Whether the homing, if there is one, makes the state known."""
        return self.homed is None or self.homed.certified

    def start_dict(self) -> dict[str, Any]:
        """Return the start as JSON values."""
        return start_dict(self.start.name, self.error, self.homed)

    def error_lines(self) -> list[str]:
        """Return a line on what the start leaves open; none if it is known."""
        if self.error is None:
            return []
        return [error_line(self.start.name, self.error, homed=self.homed is not None)]


def path_columns(part: Any) -> dict[str, Any]:
    """Return the columns of a wanted displacement, its voltage and the displacement to expect."""
    return {"displacement_um": part.displacement * 1e6, "voltage_V": part.voltage, "expected_um": part.expected * 1e6}


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
