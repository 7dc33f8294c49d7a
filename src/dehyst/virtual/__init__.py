"""A virtual actuator for demo, rehearsals and tests, which is not an instance of the package's models; and its bench.

It shares no code with the models, and is hard for them as a limit of one of them: with ever more plays and segments
Kuhnen's model approaches `PlayActuator` without creep.

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
