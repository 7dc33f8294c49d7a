"""Conversion of terminal coordinates to the paper's symbols."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import number
from dehyst._views.lines import brief
from dehyst.model.elements import MaxwellSlip

if TYPE_CHECKING:
    from dehyst.model.actuator import Actuator


@dataclass(frozen=True)
class Physical:
    """The paper's symbols (Table 1), from terminal coordinates and nominal T, km and ke.

    `equivalent_stiffness`: keq = ke km / (ke + km) [N/m]. `stiffness`, `friction`, `breakaway` (N,): k_i [N/m], f_i [N]
    and r_i = f_i / k_i [m of x]. `deformation`, `nonlinear`, `parallel` (M,): x [m] at the spring's knots; the
    nonlinear spring's force g(x) and h(x) = keq x + g(x) [N].
    """

    equivalent_stiffness: float
    stiffness: Array
    friction: Array
    breakaway: Array
    deformation: Array
    nonlinear: Array
    parallel: Array

    __repr__ = brief

    @classmethod
    def of(
        cls, actuator: Actuator, *, transformer_ratio: float, mechanical_stiffness: float, electrical_stiffness: float
    ) -> Physical:
        """Convert the numbers of an `actuator` to the paper's symbols (Table 1).

        With c = keq/km: k_i = kappa_i T c, r_i = rho_i / c, f_i = k_i r_i, h = T eta, g = h - keq x. Data of (v, y)
        determine x up to x(0): here x = 0 is where the spring alone holds 0 V.

        `transformer_ratio`: T [N/V]. `mechanical_stiffness`, `electrical_stiffness`: km and ke = T^2 / C [N/m]. Raise
        `ModelError` if one of them is not a positive number, elements are graded, or there is a transformer curve.
        """
        ratio, km, ke = transformer_ratio, mechanical_stiffness, electrical_stiffness
        slip, spring = actuator.slip, actuator.spring
        if not isinstance(slip, MaxwellSlip):
            raise ModelError("no physical units: graded elements have no single stiffness k_i")
        if actuator.transformer is not None:
            raise ModelError("no physical units: with a transformer curve, T v is not a force, and T x is not a charge")
        names = ("transformer_ratio", "mechanical_stiffness", "electrical_stiffness")
        for value, name in zip((ratio, km, ke), names, strict=True):
            if number(value, name) <= 0:
                raise ModelError(argument=name, got=value, need="a positive number")
        rest, equivalent = actuator._evaluator.core.spring_inverse(0.0), ke * km / (ke + km)
        c, h = equivalent / km, ratio * spring.voltage
        x = (spring.displacement - rest) / c
        elements = slip.stiffness * ratio * c, slip.friction * ratio, slip.breakaway / c
        return cls(equivalent, *elements, x, h - equivalent * x, h)
