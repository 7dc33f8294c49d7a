"""Clamped voltages: their counts, and the warnings about them."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst.control.limits import VoltageLimits
from dehyst.model import Actuator


class ClampWarning(UserWarning):
    """A wanted displacement was not followed: its voltage was cut at a limit or held back by the slew rate."""


class Clamps(NamedTuple):
    """Number of samples whose voltage was cut at a limit, and held back by the slew rate."""

    limited: int
    slewed: int


def warn_of_sample(
    actuator: Actuator, limits: VoltageLimits, slewed: bool, displacement: float, voltage: float
) -> None:
    """Warn the caller of `Compensator.step` or `offer` that the voltage [V] of a displacement [m] is clamped."""
    reason = "the slew rate allows no more" if slewed else "that is a limit"
    reason += _after_stop(stray_sentence(actuator, limits, np.array([displacement])))
    warnings.warn(f"CLAMPED: {displacement * 1e6:.6g} um wanted, {voltage:.6g} V to be sent: {reason}", ClampWarning, 3)


def warn_of_run(actuator: Actuator, limits: VoltageLimits, clamps: Clamps, displacement: Array) -> None:
    """Warn the caller of `Compensator.run` that some of the voltages are clamped."""
    reason = f"{clamps.limited} at the limits {limits.words}, {clamps.slewed} by the slew rate"
    reason += _after_stop(stray_sentence(actuator, limits, displacement))
    warnings.warn(f"{sum(clamps)} of {displacement.size} voltages clamped: {reason}", ClampWarning, 3)


def stray_sentence(
    actuator: Actuator, limits: VoltageLimits, displacement: Array, load: ArrayLike | None = None
) -> str:
    """Return why displacements (n,) [m] are implausible; those in reach of the limits are not."""
    sentence = actuator.implausibility(displacement, load)
    if not sentence or (limits.low, limits.high) == actuator.limits:
        return sentence
    try:
        return actuator.implausibility(displacement, load, actuator.major_loop((limits.low, limits.high)))
    except ModelError:
        return sentence


def _after_stop(sentence: str) -> str:
    return f". {sentence}" if sentence else ""
