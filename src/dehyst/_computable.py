"""The range of numbers that a model can be computed with.

The core multiplies, divides and adds the numbers of a model. The results must stay finite, also for motions far beyond
the records. The rule limits magnitudes, in SI units, and is far wider than any device needs:

- A coordinate, a stiffness, a ratio or a delay is 1e30 at most in magnitude.
- A divisor is between 1e-30 and 1e30: the distance of two knots, a length, a time constant, a frequency.
- A voltage limit, which is only compared, is 1e300 at most: the difference of two limits is then finite.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import DehystError, ModelError
from dehyst._types import Array

LEAST, MOST, MOST_ADDED = 1e-30, 1e30, 1e300
# The core's DEHYST_FARTHEST: no displacement lies farther away.
FARTHEST = float(np.finfo(np.float64).eps) ** -2
_LARGEST = float(np.finfo(np.float64).max)


def demand_magnitudes(
    values: ArrayLike, what: str, most: float = MOST, *, error: type[DehystError] = ModelError
) -> None:
    """Refuse numbers that are too large to compute with.

    Raises
    ------
    error
        If a magnitude is above `most`.
    """
    _demand(values, what, -np.inf, most, error)


def demand_divisors(values: ArrayLike, what: str) -> None:
    """Refuse numbers that are too small or too large to divide by.

    Raise `ModelError` if a magnitude is not between 1e-30 and 1e30.
    """
    _demand(values, what, LEAST, MOST)


def demand_curve(knots: Array, values: Array, what: str) -> None:
    """Refuse a rising curve (M,) that has a slope, or an inverse of a slope, too large to compute with.

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
        f"{what}: value {first} would be {values[first]:.3g}, which cannot be computed with; check the units of the "
        "input, and stay near the range of the model"
    )


def _demand(values: ArrayLike, what: str, least: float, most: float, error: type[DehystError] = ModelError) -> None:
    magnitudes = np.abs(np.asarray(values, dtype=np.float64)).ravel()
    bad = np.flatnonzero(~((magnitudes >= least) & (magnitudes <= most)))
    if bad.size:
        needed = f"at most {most:g}" if least < 0 else f"{least:g} to {most:g}"
        raise error(
            f"{what}: got {magnitudes[bad[0]]:.3g}, which cannot be computed with; need {needed} in magnitude, in SI "
            "units. Check the units, or whether the file is damaged"
        )
