"""The rehearsal of a rig: pytest tests that every driver must pass before it moves hardware.

A subclass of `RigContract` gives a candidate, and runs like any class of tests. Instruments for tests are
`FakeInstrument`, and the virtual actuator and `VirtualBench` of `dehyst.virtual`.
"""

from dehyst.testing.instrument import FakeInstrument
from dehyst.testing.rigs import RigCandidate, RigContract

__all__ = [
    "FakeInstrument",
    "RigCandidate",
    "RigContract",
]
