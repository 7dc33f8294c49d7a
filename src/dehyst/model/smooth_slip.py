"""Smooth elements: friction that yields gradually, after Dahl, and after Bouc and Wen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dehyst._computable import demand_divisors, demand_magnitudes
from dehyst._errors import ModelError
from dehyst._native import smooth_elongations
from dehyst._types import Array
from dehyst._validation import keep, vector
from dehyst._views.lines import brief


@dataclass(frozen=True, eq=False)
class SmoothSlip:
    """L elements in parallel whose friction grows gradually.

    Element l holds ``k_l q_l``; its elongation q follows the displacement y as
    ``dq = dy (1 - |q / length| (closing sgn(q dy) + 1 - closing))`` and tends to the length on a long motion. With
    closing 1 it is P. R. Dahl's element ("A solid friction model", Aerospace Corp. TOR-0158(3107-18)-1, 1968); with 1/2
    it returns on a straight line. Y.-K. Wen's model (J. Eng. Mech. Div. ASCE 102(2), 1976, 249-263) has both. Unlike
    Maxwell-slip elements they do not return to the point at which an inner loop began.

    Parameters
    ----------
    length : (L,) array_like
        Largest elongations [m], positive.
    closing : (L,) array_like
        1/2 to 1.
    stiffness : (L,) array_like
        k_l [V/m] at elongation 0, not negative.

    Raises
    ------
    ModelError
        If lengths differ, or a value is impossible or too large to compute with (magnitude over 1e30).
    """

    length: Array
    closing: Array
    stiffness: Array

    __repr__ = brief

    def __init__(self, length: ArrayLike, closing: ArrayLike, stiffness: ArrayLike) -> None:
        given = {"length": length, "closing": closing, "stiffness": stiffness}
        columns = {name: vector(values, f"smooth elements: {name}") for name, values in given.items()}
        keep(self, **columns)
        if len({column.size for column in columns.values()}) > 1:
            sizes = ", ".join(f"{column.size} of {name}" for name, column in columns.items())
            raise ModelError(f"smooth elements: got {sizes}; need one of each for an element")
        if np.any(self.length <= 0) or np.any(self.stiffness < 0):
            raise ModelError("smooth elements: need lengths above 0 and stiffnesses of 0 or more")
        demand_divisors(self.length, "smooth elements: length [m]")
        demand_magnitudes(self.stiffness, "smooth elements: stiffness [V/m]")
        if np.any((self.closing < 0.5) | (self.closing > 1)):
            raise ModelError(f"smooth elements: closing must be 1/2 to 1, got {self.closing}")

    def __len__(self) -> int:
        return self.length.size

    def elongations(self, displacement: ArrayLike) -> Array:
        """Return q_l (n, L) [m] along a `displacement` (n,) [m], 0 at the first sample; exact for any steps."""
        return smooth_elongations(self.length, self.closing, vector(displacement, "displacement"))
