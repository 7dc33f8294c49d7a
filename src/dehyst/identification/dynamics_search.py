"""Search for delay, damping and inertia: an outer search over three numbers around the convex program."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dehyst._types import Array
from dehyst.model import Actuator, Dynamics

# Inertia must reduce the RMS residual to this share, or it is left out.
_WORTH = 0.8
_EVALUATIONS = 90
# Least delay or lag, as a part of a sample, that has an effect in a record.
_SIGNIFICANT = 0.01


@dataclass(frozen=True)
class SensedDynamics:
    """Dynamics between w, the output of the hysteresis, and y: w(t - delay) = y + damping y' + mass y''.

    Attributes
    ----------
    delay : float
        [s].
    damping : float
        2 zeta / omega [s].
    mass : float
        1 / omega^2 [s2].
    lag : float
        Time constant of the amplifier [s].
    """

    delay: float
    damping: float
    mass: float
    lag: float = 0.0

    @classmethod
    def of(cls, actuator: Actuator) -> SensedDynamics:
        """Return the dynamics of an actuator."""
        dynamics = actuator.dynamics
        if dynamics is None:
            return cls(actuator.delay, 0.0, 0.0, actuator.lag)
        omega = dynamics.frequency
        return cls(actuator.delay, 2 * dynamics.damping / omega, 1 / omega**2, actuator.lag)

    @property
    def dynamics(self) -> Dynamics | None:
        """The dynamics as a part of an actuator; None without inertia."""
        if not self.mass:
            return None
        omega = 1 / np.sqrt(self.mass)
        return Dynamics(float(omega), float(0.5 * self.damping * omega))


def significant_delay(seconds: float, sample_time: float) -> float:
    """Return a delay or lag [s] from a search; 0 below a hundredth of a sample, as a search rarely ends at 0."""
    return seconds if seconds >= _SIGNIFICANT * sample_time else 0.0


def find_dynamics(
    error: Callable[[SensedDynamics], float], delay: float, sample_time: float, fastest: float
) -> SensedDynamics:
    """Minimise the RMS residual over delay, damping and mass; without mass if the gain is small.

    Parameters
    ----------
    error : callable
        Dynamics -> RMS residual [m] of a fit of few rows.
    delay : float
        Delay without inertia [s]: the start of the search.
    sample_time : float
        [s].
    fastest : float
        Least duration of a cycle of the excitation [s].
    """
    from scipy.optimize import minimize

    none = SensedDynamics(delay, 0.0, 0.0)
    best, cost = none, error(none)
    # Dynamics slower than a tenth of the fastest cycle would show as a resonance in it; dynamics faster than the
    # sampling have no effect.
    scale = max(sample_time, 0.02 * fastest)

    def dynamics_at(x: Array) -> SensedDynamics:
        delay_, damping, root = np.abs(x) * scale
        return SensedDynamics(float(delay_), float(damping), float(root**2))

    simplex = np.array(
        [
            [delay / scale, 0.1, 0.5],
            [delay / scale, 0.1, 1.5],
            [0.5 * delay / scale, 0.3, 1.0],
            [delay / scale + 0.3, 0.0, 0.8],
        ]
    )
    options: Any = {"maxfev": _EVALUATIONS, "initial_simplex": simplex, "xatol": 1e-3, "fatol": 0}
    least: Any = minimize
    optimum = least(lambda x: error(dynamics_at(x)), simplex[0], method="Nelder-Mead", options=options)
    if optimum.fun >= _WORTH * cost:
        return best
    best = dynamics_at(optimum.x)
    return replace(best, delay=significant_delay(best.delay, sample_time))
