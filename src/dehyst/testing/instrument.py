"""The least instrument, on which a rig is tested; and, before the suites are imported, what pytest needs for them."""

from __future__ import annotations

import numpy as np

from dehyst._errors import MissingExtraError, RigError
from dehyst._types import Array
from dehyst.virtual import Extremes

try:
    import pytest
except ImportError as error:
    raise MissingExtraError("dehyst.testing needs pytest, which is not installed. Try: pip install pytest") from error

# Failures show the values in the assertions of the suites.
pytest.register_assert_rewrite("dehyst.testing.rigs")
LOW, HIGH = -20.0, 100.0


class FakeInstrument:
    """The least instrument behind a rig under test: an amplifier of -20 to 100 V, and a sensor that is proportional.

    Parameters
    ----------
    limits : (float, float)
        Lowest and highest voltage of the amplifier [V].
    gain : float
        Displacement that the sensor reads for each volt [m/V]: that of the `RigCandidate`.

    Attributes
    ----------
    sent : list of float
        All voltages that it put out [V]; the last is `voltage`, the first is 0.
    now : float
        Its time [s], see `wait`.
    playing : bool
        Whether it plays a wave, which its owner sets.
    log : object
        Extremes of all voltages: `lowest`, `highest`, `largest_step` [V], and `refused`.
    """

    def __init__(self, limits: tuple[float, float] = (LOW, HIGH), gain: float = 1e-7) -> None:
        self.gain = gain
        self.limits, self.sent, self.now = limits, [0.0], 0.0
        self.log, self.playing = Extremes(0.0, 0.0), False

    @property
    def voltage(self) -> float:
        """What it puts out now [V]."""
        return self.sent[-1]

    def put(self, voltage: float) -> None:
        """Put out a `voltage` [V]; raise RigError if it is outside the limits."""
        if not self.limits[0] <= voltage <= self.limits[1]:
            self.log.refused += 1
            raise RigError(f"the rig sent {voltage} V to an instrument of {self.limits[0]} to {self.limits[1]} V")
        self.log.update(np.array([self.voltage, voltage]), np.array([1e-3]))
        self.sent.append(float(voltage))

    def displacement(self, voltage: Array) -> Array:
        """Return what the sensor reads [m] at each `voltage` [V]."""
        return self.gain * np.asarray(voltage)

    def wait(self, seconds: float) -> None:
        """Let `seconds` pass: for the rig's ``_wait``, so that a test takes no time."""
        self.now += seconds
