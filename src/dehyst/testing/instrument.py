"""The simplest instrument on which a rig is tested, and the set-up of pytest before the suites are imported."""

from __future__ import annotations

import numpy as np

from dehyst._errors import MissingExtraError, RigError
from dehyst._types import Array
from dehyst.virtual import Extremes

try:
    import pytest
except ImportError as error:
    raise MissingExtraError("dehyst.testing needs pytest, which is not installed. Try: pip install pytest") from error

# A failure then shows the values in the assertion.
pytest.register_assert_rewrite("dehyst.testing.rigs")
LOW, HIGH = -20.0, 100.0


class FakeInstrument:
    """The simplest instrument behind a rig under test: an amplifier of -20 to 100 V and a proportional sensor.

    Parameters
    ----------
    limits : (float, float)
        Lowest and highest voltage of the amplifier [V].
    gain : float
        Reading of the sensor per volt [m/V], equal to the gain of the `RigCandidate`.

    Attributes
    ----------
    sent : list of float
        All voltages that were put out [V]; the first is 0, the last is `voltage`.
    now : float
        Time of the instrument [s], see `wait`.
    playing : bool
        Whether a wave is played; the owner of the instrument sets it.
    log : object
        Extremes of all voltages: `lowest`, `highest`, `largest_step` [V], and `refused`.
    """

    def __init__(self, limits: tuple[float, float] = (LOW, HIGH), gain: float = 1e-7) -> None:
        self.gain = gain
        self.limits, self.sent, self.now = limits, [0.0], 0.0
        self.log, self.playing = Extremes(0.0, 0.0), False

    @property
    def voltage(self) -> float:
        """Present output [V]."""
        return self.sent[-1]

    def put(self, voltage: float) -> None:
        """Put out a `voltage` [V]; raise RigError if it is outside the limits."""
        if not self.limits[0] <= voltage <= self.limits[1]:
            self.log.refused += 1
            raise RigError(f"the rig sent {voltage} V to an instrument of {self.limits[0]} to {self.limits[1]} V")
        self.log.update(np.array([self.voltage, voltage]), np.array([1e-3]))
        self.sent.append(float(voltage))

    def displacement(self, voltage: Array) -> Array:
        """Return the sensor's reading [m] at each `voltage` [V]."""
        return self.gain * np.asarray(voltage)

    def wait(self, seconds: float) -> None:
        """Advance the time by `seconds`; it replaces the ``_wait`` of the rig, so that a test takes no time."""
        self.now += seconds
