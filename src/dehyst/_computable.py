"""Which numbers a model can be computed with: the one place of the rule.

The core multiplies, divides and adds a model's numbers; the results must stay numbers, with room to spare for motions
far beyond the records. So the rule is about size, in SI units, and is far wider than anything that is built:

- A coordinate, a stiffness, a ratio or a delay is 1e30 at most in magnitude.
- What is divided by lies between 1e-30 and 1e30: the distance of two knots, a length, a time constant, a frequency.
- A voltage limit, which is only compared, is 1e300 at most: the difference of two is then a number.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array

LEAST, MOST, MOST_ADDED = 1e-30, 1e30, 1e300
# The core's DEHYST_FARTHEST: no displacement lies farther away.
FARTHEST = float(np.finfo(np.float64).eps) ** -2
_LARGEST = float(np.finfo(np.float64).max)


def demand_magnitudes(values: ArrayLike, what: str, most: float = MOST) -> None:
    """Refuse numbers that are too large to compute with.

    Raises
    ------
    ModelError
        If a magnitude is above `most`.
    """
    _demand(values, what, -np.inf, most)


def demand_divisors(values: ArrayLike, what: str) -> None:
    """Refuse positive numbers that nothing can be divided by.

    Raises
    ------
    ModelError
        If one is not between 1e-30 and 1e30.
    """
    _demand(values, what, LEAST, MOST)


def demand_curve(knots: Array, values: Array, what: str) -> None:
    """Refuse a rising curve (M,) of which a slope or its inverse is no number to compute with.

    Raises
    ------
    ModelError
    """
    for numbers, axis in ((knots, "knots"), (values, "values")):
        demand_magnitudes(numbers, f"{what} {axis}")
        demand_divisors(np.diff(numbers), f"{what}: steps between {axis}")


def demand_result(values: Array, what: str, most: float = _LARGEST) -> None:
    """Refuse a result that is not finite, or is larger than `most`.

    Raises
    ------
    ModelError
    """
    if not values.size or (values.min() >= -most and values.max() <= most):
        return
    first = int(np.argmax(~(np.abs(values) <= most)))
    raise ModelError(
        f"{what}: value {first} would be {values[first]:.3g}, which cannot be computed with; check the units of what "
        "was given, and stay near the range of the model"
    )


def _demand(values: ArrayLike, what: str, least: float, most: float) -> None:
    magnitudes = np.abs(np.asarray(values, dtype=np.float64)).ravel()
    bad = np.flatnonzero(~((magnitudes >= least) & (magnitudes <= most)))
    if bad.size:
        needed = f"at most {most:g}" if least < 0 else f"{least:g} to {most:g}"
        raise ModelError(
            f"{what}: got {magnitudes[bad[0]]:.3g}, which cannot be computed with; need {needed} in magnitude, in SI "
            "units. Check the units, or whether the file is damaged"
        )
