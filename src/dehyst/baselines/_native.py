"""The only door to the compiled steppers of the baselines. Equations: the headers in `core/baselines`."""

from __future__ import annotations

from typing import Any

import dehyst._rivals as compiled
from dehyst._errors import ModelError
from dehyst._rivals import bouc_wen, coleman_hodgdon, preisach, preisach_weights
from dehyst._types import Array

__all__ = ["PlayCore", "bouc_wen", "coleman_hodgdon", "play_outputs", "preisach", "preisach_weights"]


class PlayCore:
    """Plays, curves on them and low-passes in C. Equations and names: `core/baselines/plays.h`.

    `tables` are, in this order:

    `thresholds` (N,): r_i [V]. `first` (N + 1,): where the knots of curve i begin. `knots`, `values` (first[N],): of
    the curves, one after another: [V], [m]. `slopes` (first[N] + N,): of the curves [m/V]: below the first knot,
    between knots, beyond the last. `times`, `shares` (K,): of the low-passes: [s], [m/V]. `offset`: [m].
    """

    __slots__ = ("_core",)

    def __init__(self, *tables: Any) -> None:
        self._core = compiled.Plays(*tables)

    def simulate(self, v: Array, steps: Array, start: float, plays: Array, passed: Array) -> tuple[Array, Array, Array]:
        """Return displacements [m] for voltages [V], `steps` [s] apart, and the plays and low-passes at the end."""
        y, _, _, plays, passed = self._core.simulate(v, steps, start, plays, passed)
        return y, plays, passed

    def compensate(
        self, y: Array, steps: Array, start: float, plays: Array, passed: Array
    ) -> tuple[Array, Array, Array]:
        """Return voltages [V] for displacements [m], and the plays and low-passes at the end.

        Raise `ModelError` if a displacement is beyond what the model can reach.
        """
        v, reached, _, plays, passed = self._core.compensate(y, steps, start, plays, passed)
        if reached < y.size:
            raise ModelError(
                f"displacement: {y[reached] * 1e6:.6g} um at index {reached} is beyond what this model reaches at any "
                "voltage; stay within the range of the records it was fitted to"
            )
        return v, plays, passed


def play_outputs(thresholds: Array, start: Array, v: Array) -> Array:
    """Return the outputs (n, N) of plays of `thresholds` driven by v (n,), from `start` (N,); all [V]."""
    return compiled.play_outputs(thresholds, start, v)
