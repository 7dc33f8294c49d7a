"""Creep: viscous branches in parallel with the spring, and their steps in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._computable import demand_divisors, demand_magnitudes, demand_result
from dehyst._errors import ModelError
from dehyst._native import steps, strains
from dehyst._types import Array
from dehyst._validation import keep, untimely, vector
from dehyst._views.lines import brief


@dataclass(frozen=True, eq=False)
class Creep:
    """J viscous branches in parallel: springs in series with dashpots (theory section 8).

    Branch j holds ``c_j d_j``; d_j is the displacement less its low-pass of time constant tau_j, for a displacement
    linear in time ``d_j <- a d_j + (1 - a) tau_j / dt * dy`` with ``a = exp(-dt / tau_j)``.

    `time_constants` (J,): tau_j [s], positive. `stiffness` (J,): c_j [V/m], not negative. Raise `ModelError` if lengths
    differ, or a value is impossible or too large to compute with (magnitude over 1e30).
    """

    time_constants: Array
    stiffness: Array

    __repr__ = brief

    def __init__(self, time_constants: ArrayLike, stiffness: ArrayLike) -> None:
        tau, c = vector(time_constants, "creep time constants"), vector(stiffness, "creep stiffnesses")
        if tau.size != c.size:
            raise ModelError(
                f"got {tau.size} creep time constants and {c.size} stiffnesses, need one of each for a branch"
            )
        if np.any(tau <= 0):
            raise ModelError(f"creep time constants must be positive, got {tau}")
        if np.any(c < 0):
            raise ModelError(
                f"creep stiffness {int(np.argmin(c))} is {c.min():g} V/m; a negative one never comes to rest"
            )
        demand_divisors(tau, "creep time constants [s]")
        demand_magnitudes(c, "creep stiffnesses [V/m]")
        keep(self, time_constants=tau, stiffness=c)

    def __len__(self) -> int:
        return self.time_constants.size

    def tables(self, durations: Array) -> tuple[Array, Array]:
        """Return decays exp(-dt/tau_j) and gains (1 - decay) tau_j/dt, (R, J), of steps (R,) [s]; both 1 at 0 s.

        `durations` holds the steps.
        """
        with np.errstate(over="ignore"):
            x = durations[:, None] / self.time_constants
        return np.exp(-x), np.divide(-np.expm1(-x), x, out=np.ones_like(x), where=x > 0)

    def strains(self, time: ArrayLike, displacement: ArrayLike) -> Array:
        """Return strains d_j (n, J) [m] along a `displacement` (n,) [m] with `time` (n,) [s], 0 at the first sample.

        Raise `ModelError` if time and displacement do not fit.
        """
        y = vector(displacement, "displacement")
        bounds, durations = clock(time, y.size)
        return strains(y, bounds, *self.tables(durations), np.zeros(len(self)))


def clock(time: ArrayLike, samples: int) -> tuple[NDArray[np.int64], Array]:
    """Cut samples into runs of equal steps, see `_native.steps`.

    Raise `ModelError` if `time` [s] has another length than the samples or does not strictly increase.
    """
    t = vector(time, "time")
    bounds, durations = steps(t)
    if t.size != samples or np.any(durations[1:] <= 0):
        raise ModelError(untimely(t, samples))
    demand_result(durations, "time: steps [s]")
    return bounds, durations
