"""For authors of plug-ins: what every reader, rig, model, baseline and target of exports must do, as tests.

The suites are classes for pytest: a subclass gives a candidate, and runs as any class of tests. Instruments to test on:
`FakeInstrument`, the virtual actuators and `VirtualBench` of `dehyst.virtual`, and the emulated controller of
`dehyst.virtual.emulator`, whose `Rehearsal` has faults on its link.
"""

from dehyst.testing.instrument import FakeInstrument
from dehyst.testing.models import BaselineCandidate, BaselineContract, ModelCandidate, ModelContract
from dehyst.testing.rigs import RigCandidate, RigContract

__all__ = [
    "BaselineCandidate",
    "BaselineContract",
    "FakeInstrument",
    "ModelCandidate",
    "ModelContract",
    "RigCandidate",
    "RigContract",
]
