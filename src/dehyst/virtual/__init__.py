"""Virtual actuators for the demo, tests, benchmarks and emulators; they are not instances of the package's models.

They share no code with the models. Two of them are limits of baseline models, and so hard for ours: with ever more
plays and segments Kuhnen's model approaches `PlayActuator` without creep; on ever finer grids the models of Preisach
and of Krasnosel'skii, and plays times ramps (Krejci's form of Preisach's operator), approach `PreisachActuator`.

Each has a `stroke` [m] at its `highest` voltage [V] on the major loop. `play(voltage, *, time=None, measured=True)`
continues from the state that the last call reached; `relax` resets the state.
"""

from dehyst.virtual.ageing import AgeingActuator, AgeingCourse
from dehyst.virtual.base import VirtualActuator
from dehyst.virtual.bench import Extremes, VirtualBench
from dehyst.virtual.bouc_wen import BoucWenActuator
from dehyst.virtual.modelled import virtual_actuator
from dehyst.virtual.plays import PlayActuator
from dehyst.virtual.preisach import PreisachActuator
from dehyst.virtual.stage import VirtualStage

__all__ = [
    "AgeingActuator",
    "AgeingCourse",
    "BoucWenActuator",
    "PlayActuator",
    "PreisachActuator",
    "VirtualBench",
    "VirtualStage",
]
