"""Virtual actuators for demo, rehearsals and tests, and a virtual bench for them.

A virtual actuator shares no code with the models of the package, and is not an instance of them. It is the limit of
Kuhnen's model with more and more plays and segments, if it has no creep.

It has a `stroke` [m] at its `highest` voltage [V] on the major loop. `play(voltage, *, time=None, measured=True)`
continues from the state that the last call reached; `relax` resets the state.
"""

from dehyst.virtual.base import VirtualActuator
from dehyst.virtual.bench import Extremes, VirtualBench
from dehyst.virtual.plays import PlayActuator
from dehyst.virtual.stage import VirtualStage

__all__ = [
    "PlayActuator",
    "VirtualBench",
    "VirtualStage",
]
