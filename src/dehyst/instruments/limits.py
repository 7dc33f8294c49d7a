"""Voltage limits of a rig: those that device and user both allow, and the check of an excitation against them."""

from __future__ import annotations

import numpy as np

from dehyst._errors import RecordError, RigError
from dehyst.control import VoltageLimits
from dehyst.waveforms import Excitation

# Seconds for the whole range, if neither device nor user gives a slew rate.
_SHORTEST_SWEEP = 0.1
# Relative slack for rates that a device rounds.
_SLACK = 1e-6


def common_limits(device: VoltageLimits, limits: tuple[float, float] | None, slew_rate: float | None) -> VoltageLimits:
    """Return the limits that device and user both allow, always with a slew rate.

    Raise `RigError` if they have no voltage in common. Raise `ModelError` if the user's limits are not valid.
    """
    given = VoltageLimits(*((device.low, device.high) if limits is None else limits), slew_rate)
    low, high = max(device.low, given.low), min(device.high, given.high)
    if not low < high:
        raise RigError(f"limits: got {given.words}, but the device has {device.words}; nothing is left, give others")
    rates = [rate for rate in (device.slew_rate, slew_rate) if rate is not None]
    return VoltageLimits(low, high, min(rates) if rates else (high - low) / _SHORTEST_SWEEP)


def check_excitation(excitation: Excitation, rate: float, limits: VoltageLimits, name: str) -> None:
    """Raise RecordError if an excitation at `rate` [Hz] exceeds the limits or the slew rate of the rig `name`."""
    low, high = excitation.voltage_range
    if low < limits.low or high > limits.high:
        raise RecordError(
            f"{excitation.name}: {low:.6g} to {high:.6g} V, but {name} may have {limits.words}; "
            "request less, or widen the limits if device and actuator allow it; nothing was sent"
        )
    steepest = float(np.abs(np.diff(excitation.voltage)).max()) * rate
    if limits.slew_rate is not None and steepest > limits.slew_rate * (1 + _SLACK):
        raise RecordError(
            f"{excitation.name}: is as steep as {steepest:.6g} V/s at {rate:.6g} Hz, but {name} may have "
            f"{limits.slew_rate:.6g} V/s; play it slower; nothing was sent"
        )
