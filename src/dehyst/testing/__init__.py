"""For authors of plug-ins: what every rig and every model must do, as tests.

The suites are classes for pytest: a subclass gives a candidate, and runs as any class of tests. Instruments to test on:
`FakeInstrument`, the virtual actuators and `VirtualBench` of `dehyst.virtual`, and the emulated controller of
`dehyst.virtual.emulator`, whose `Rehearsal` has faults on its link.
"""

from dehyst.testing.instrument import FakeInstrument
from dehyst.testing.models import ModelCandidate, ModelContract
from dehyst.testing.rigs import RigCandidate, RigContract

__all__ = [
    "FakeInstrument",
    "ModelCandidate",
    "ModelContract",
    "RigCandidate",
    "RigContract",
]
