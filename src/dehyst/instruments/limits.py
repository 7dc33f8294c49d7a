"""What may be sent: what device and user both allow, and the refusal of an excitation that is beyond."""

from __future__ import annotations

import numpy as np

from dehyst._errors import RecordError, RigError
from dehyst.control import VoltageLimits
from dehyst.waveforms import Excitation

# A rig that nobody gave a slew rate takes this part of a second for its whole range.
_SHORTEST_SWEEP = 0.1
# Rates that a device rounds, and rounding.
_SLACK = 1e-6


def common(device: VoltageLimits, limits: tuple[float, float] | None, slew_rate: float | None) -> VoltageLimits:
    """What device and user both allow, always with a slew rate.

    Raises
    ------
    RigError
        If nothing is left.
    ModelError
        If the user's are no limits.
    """
    asked = VoltageLimits(*((device.low, device.high) if limits is None else limits), slew_rate)
    low, high = max(device.low, asked.low), min(device.high, asked.high)
    if not low < high:
        raise RigError(f"limits: got {asked.words}, but the device has {device.words}; nothing is left, give others")
    rates = [rate for rate in (device.slew_rate, slew_rate) if rate is not None]
    return VoltageLimits(low, high, min(rates) if rates else (high - low) / _SHORTEST_SWEEP)


def refuse(excitation: Excitation, rate: float, limits: VoltageLimits, name: str) -> None:
    """Raise RecordError if an excitation played at `rate` [Hz] leaves limits or slew rate; `name` is the rig's."""
    low, high = excitation.voltage_range
    if low < limits.low or high > limits.high:
        raise RecordError(
            f"{excitation.name}: {low:.6g} to {high:.6g} V, but {name} may have {limits.words}; "
            "ask for less, or widen the limits if device and actuator allow it; nothing was sent"
        )
    steepest = float(np.abs(np.diff(excitation.voltage)).max()) * rate
    if limits.slew_rate is not None and steepest > limits.slew_rate * (1 + _SLACK):
        raise RecordError(
            f"{excitation.name}: is as steep as {steepest:.6g} V/s at {rate:.6g} Hz, but {name} may have "
            f"{limits.slew_rate:.6g} V/s; play it slower; nothing was sent"
        )
