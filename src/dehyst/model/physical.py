"""The paper's symbols from the terminals' numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import number
from dehyst.model.elements import MaxwellSlip, Spring


@dataclass(frozen=True)
class Physical:
    """The paper's symbols (Table 1), from the terminals' numbers and a nominal T, km and ke.

    Attributes
    ----------
    stiffness, friction, breakaway : (N,) array
        k_i [N/m], f_i [N] and r_i = f_i / k_i [m of x].
    deformation, nonlinear, parallel : (M,) array
        x [m] at the spring's knots; the nonlinear spring's force g(x) and h(x) = keq x + g(x) [N].
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

    @property
    def equivalent_stiffness(self) -> float:
        """Keq = ke km / (ke + km) [N/m]."""
        return _in_series(self.electrical_stiffness, self.mechanical_stiffness)


def physical(
    slip: MaxwellSlip,
    spring: Spring,
    *,
    at_rest: float,
    transformer_ratio: float,
    mechanical_stiffness: float,
    electrical_stiffness: float,
) -> Physical:
    """Convert; `at_rest` [m] is where the spring alone holds 0 V. See `Actuator.physical`."""
    given = {
        "transformer_ratio": transformer_ratio,
        "mechanical_stiffness": mechanical_stiffness,
        "electrical_stiffness": electrical_stiffness,
    }
    given = {name: _positive(value, name) for name, value in given.items()}
    transformer_ratio, mechanical_stiffness, electrical_stiffness = given.values()
    equivalent = _in_series(electrical_stiffness, mechanical_stiffness)
    c = equivalent / mechanical_stiffness
    x = (spring.displacement - at_rest) / c
    h = transformer_ratio * spring.voltage
    return Physical(
        **given,
        stiffness=slip.stiffness * transformer_ratio * c,
        friction=slip.friction * transformer_ratio,
        breakaway=slip.breakaway / c,
        deformation=x,
        nonlinear=h - equivalent * x,
        parallel=h,
    )


def charge(
    displacement: Array, *, at_rest: float, transformer_ratio: float, mechanical: float, electrical: float
) -> Array:
    """Return q = T x [C], x = (y - at_rest) km / keq."""
    ratio, km = _positive(transformer_ratio, "transformer_ratio"), _positive(mechanical, "mechanical_stiffness")
    ke = _positive(electrical, "electrical_stiffness")
    return np.asarray(ratio * (displacement - at_rest) * km / _in_series(ke, km))


def _positive(value: float, name: str) -> float:
    found = number(value, name)
    if found <= 0:
        raise ModelError(f"{name}: got {value}, need a positive number")
    return found


def _in_series(a: float, b: float) -> float:
    return a * b / (a + b)
