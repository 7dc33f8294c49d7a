"""The rehearsal of a rig: what every driver must do before it moves hardware, as tests for pytest.

A subclass of `RigContract` gives a candidate, and runs as any class of tests. Instruments to test on: `FakeInstrument`,
the virtual actuator and `VirtualBench` of `dehyst.virtual`.
"""

from dehyst.testing.instrument import FakeInstrument
from dehyst.testing.rigs import RigCandidate, RigContract

__all__ = [
    "FakeInstrument",
    "RigCandidate",
    "RigContract",
]
