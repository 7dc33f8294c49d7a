"""The motion of a stage: voltages and displacements that belong together."""

from __future__ import annotations

from dataclasses import dataclass

from dehyst._text import counted
from dehyst._types import Array, Mask
from dehyst.model import State


@dataclass(frozen=True, eq=False)
class StageTrace:
    """Voltages and displacements of a stage that belong together.

    Attributes
    ----------
    voltage, displacement : (n, axes) array
        [V] and [m].
    states : tuple of State
        State of each actuator after the last sample.
    clamped : (n, axes) bool array
        Samples whose voltage was changed by limits or slew rate.
    missed : (axes,) array
        Largest distance [m] of the displacement of each axis from the wanted path; 0 for a simulation.
    warnings : tuple of str
        What was clamped, in sentences.
    followed : bool
        Whether nothing was clamped and no axis misses its path for another reason.
    """

    voltage: Array
    displacement: Array
    states: tuple[State, ...]
    clamped: Mask
    missed: Array
    warnings: tuple[str, ...] = ()
    followed: bool = True

    def __repr__(self) -> str:
        count = int(self.clamped.any(axis=1).sum())
        clamps = f"{count} clamped" if count else "nothing clamped"
        return f"<StageTrace: {counted(len(self.voltage), 'sample')} of {self.voltage.shape[1]} axes, {clamps}>"
