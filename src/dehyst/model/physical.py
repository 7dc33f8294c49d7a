"""Conversion of the terminals' numbers to the paper's symbols."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import number
from dehyst._views.lines import brief
from dehyst.model.elements import MaxwellSlip

if TYPE_CHECKING:
    from dehyst.model.actuator import Actuator


@dataclass(frozen=True)
class Physical:
    """The paper's symbols (Table 1), from the terminals' numbers and a nominal T, km and ke.

    `transformer_ratio` is T. `mechanical_stiffness` is km [N/m]. `electrical_stiffness` is ke [N/m].

    `stiffness`, `friction`, `breakaway` (N,): k_i [N/m], f_i [N] and r_i = f_i / k_i [m of x]. `deformation`,
    `nonlinear`, `parallel` (M,): x [m] at the spring's knots; the nonlinear spring's force g(x) and h(x) = keq x + g(x)
    [N].
    """

    transformer_ratio: float
    mechanical_stiffness: float
    electrical_stiffness: float
    stiffness: Array
    friction: Array
    breakaway: Array
    deformation: Array
    nonlinear: Array
    parallel: Array

    __repr__ = brief

    @property
    def equivalent_stiffness(self) -> float:
        """Keq = ke km / (ke + km) [N/m]."""
        return _in_series(self.electrical_stiffness, self.mechanical_stiffness)


def physical(actuator: Actuator, ratio: float, km: float, ke: float) -> Physical:
    """Convert to the paper's symbols, see `Actuator.physical`."""
    slip, spring = actuator.slip, actuator.spring
    if not isinstance(slip, MaxwellSlip):
        raise ModelError("no physical units: graded elements have no single stiffness k_i")
    at_rest = _rest_displacement(actuator)
    ratio, km, ke = _positive(ratio, km, ke)
    equivalent = _in_series(ke, km)
    c = equivalent / km
    x = (spring.displacement - at_rest) / c
    h = ratio * spring.voltage
    return Physical(
        transformer_ratio=ratio,
        mechanical_stiffness=km,
        electrical_stiffness=ke,
        stiffness=slip.stiffness * ratio * c,
        friction=slip.friction * ratio,
        breakaway=slip.breakaway / c,
        deformation=x,
        nonlinear=h - equivalent * x,
        parallel=h,
    )


def charge(actuator: Actuator, displacement: Array, ratio: float, km: float, ke: float) -> Array:
    """Return q = T x [C], with x = (y - y0) km / keq and y0 [m] where the spring alone holds 0 V."""
    at_rest = _rest_displacement(actuator)
    ratio, km, ke = _positive(ratio, km, ke)
    return np.asarray(ratio * (displacement - at_rest) * km / _in_series(ke, km))


def _rest_displacement(actuator: Actuator) -> float:
    """Return where the spring alone holds 0 V [m]; raise `ModelError` with a transformer curve."""
    if actuator.transformer is not None:
        raise ModelError("no physical units: with a transformer curve T v is no force, and T x no charge")
    return actuator.core.spring_inverse(0.0)


def _positive(ratio: float, km: float, ke: float) -> list[float]:
    checked = []
    names = ("transformer_ratio", "mechanical_stiffness", "electrical_stiffness")
    for value, name in zip((ratio, km, ke), names, strict=True):
        checked.append(number(value, name))
        if checked[-1] <= 0:
            raise ModelError(argument=name, got=value, need="a positive number")
    return checked


def _in_series(a: float, b: float) -> float:
    return a * b / (a + b)
