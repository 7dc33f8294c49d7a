"""A voltage that a command writes, the displacement that it causes, and what is known of its start."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from dehyst.cli.start import error_line, homed_words, start_dict

if TYPE_CHECKING:
    from dehyst.control import HomedPath, PossibleStart, StartError
    from dehyst.model import State


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
