"""Virtual actuators that no model of this package is an instance of: for the demo, tests, benchmarks and emulators.

They share no code with the models. Two are limits of rivals, and so hard ground for ours: `PlayActuator` without creep
is what Kuhnen's model becomes with ever more plays and segments, `PreisachActuator` what Preisach's,
Krasnosel'skii's and plays times ramps (Krejci's form of Preisach's operator) become on ever finer grids.

Each has a `stroke` [m] at its `highest` voltage [V] on the major loop, and is driven by
`drive(voltage, *, time=None, measured=True)`, which goes on from where the last one ended; `relax` forgets.
"""

from dehyst.virtual.base import VirtualActuator
from dehyst.virtual.bench import VirtualBench
from dehyst.virtual.bouc_wen import BoucWenActuator
from dehyst.virtual.modelled import ModelledActuator
from dehyst.virtual.plays import PlayActuator
from dehyst.virtual.preisach import PreisachActuator

__all__ = ["BoucWenActuator", "ModelledActuator", "PlayActuator", "PreisachActuator", "VirtualActuator", "VirtualBench"]
