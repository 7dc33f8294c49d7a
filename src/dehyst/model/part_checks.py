"""Checks of the arguments of an actuator that no part can make by itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from dehyst._computable import demand_divisors, demand_magnitudes
from dehyst._errors import ModelError
from dehyst._validation import number
from dehyst.model.creep import Creep, clock
from dehyst.model.dynamics import Dynamics
from dehyst.model.elements import GradedSlip, MaxwellSlip, Spring, Transformer
from dehyst.model.smooth_slip import SmoothSlip

if TYPE_CHECKING:
    from dehyst.model.actuator import Actuator

_KINDS: tuple[tuple[str, tuple[type, ...]], ...] = (
    ("slip", (MaxwellSlip, GradedSlip)),
    ("spring", (Spring,)),
    ("transformer", (Transformer, type(None))),
    ("creep", (Creep, type(None))),
    ("dynamics", (Dynamics, type(None))),
    ("smooth", (SmoothSlip, type(None))),
)
NO_LOAD_STIFFNESS = "load: the load stiffness of this actuator is not known; give load_stiffness= [N/m]"


def check_kinds(actuator: Actuator) -> None:
    """Raise `ModelError` if a part is not of its class."""
    for name, kinds in _KINDS:
        part = getattr(actuator, name)
        if not isinstance(part, kinds):
            needed = " or ".join(kind.__name__ for kind in kinds if kind is not type(None))
            raise ModelError(f"{name}: got {type(part).__name__}, need a {needed}")


def checked_lag(lag: float) -> float:
    """Return the amplifier's time constant [s]; raise `ModelError` if it is impossible."""
    seconds = number(lag, "lag")
    if seconds < 0:
        raise ModelError(f"lag: got {lag}, need 0 s or more")
    if seconds:
        demand_divisors(seconds, "lag [s]")
    return seconds


def checked_load_stiffness(load_stiffness: float | None) -> float | None:
    """Return the stiffness against a load [N/m]; raise `ModelError` if it is impossible."""
    if load_stiffness is None:
        return None
    stiffness = number(load_stiffness, "load_stiffness")
    if stiffness <= 0:
        raise ModelError(f"load_stiffness: got {load_stiffness}, need a positive number of N/m")
    demand_divisors(stiffness, "load_stiffness [N/m]")
    return stiffness


def checked_delay(delay: float) -> float:
    """Return the delay [s]; raise `ModelError` if it is impossible."""
    seconds = number(delay, "delay")
    if seconds < 0:
        raise ModelError(f"delay: got {delay}, need 0 or more: a displacement does not lead its voltage")
    demand_magnitudes(seconds, "delay [s]")
    return seconds


def check_plain_path(time: ArrayLike | None, load: ArrayLike | None, samples: int) -> None:
    """Raise `ModelError` if a path of a plain actuator comes with a load, or with times that do not fit."""
    if load is not None:
        raise ModelError(NO_LOAD_STIFFNESS)
    if time is not None:
        clock(time, samples)
