"""Inertia and damping: the mechanical side of the actuator, its steps exact for an even push."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dehyst._computable import demand_divisors, demand_magnitudes
from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import number
from dehyst.model.elements import Spring

# Of Taylor's series at a norm of 1: 1/20! is below the last digit.
_TERMS = 21
# Radians in a step: squared as often as these ask for, the exponential keeps four digits.
_LONGEST = 2.0**40


@dataclass(frozen=True)
class Dynamics:
    """Mass, damping and the series spring between the electrical and the mechanical side (theory section 9).

    ``y'' + 2 zeta omega y' + omega^2 y = omega^2 (w + F_ext/kc)``, and the voltage holds ``beta (w - y)`` besides: the
    slip elements and the spring act on w, which is y when all is slow and free.

    Parameters
    ----------
    frequency : float
        omega [rad/s], the resonance at constant charge: sqrt((km + ke)/m). Under a voltage it is seen lower, at
        omega sqrt(K/(K + beta)), K the slope of voltage over w.
    damping : float
        zeta, 0 or more.
    series : float, optional
        beta = ke/T [V/m], 0 or more.

    Raises
    ------
    ModelError
        If a number is impossible or cannot be computed with (above 1e30 in magnitude).
    """

    frequency: float
    damping: float
    series: float = 0.0

    def __post_init__(self) -> None:
        if number(self.frequency, "frequency") <= 0:
            raise ModelError(
                f"frequency: got {self.frequency}, need a positive number of rad/s; leave Dynamics out else"
            )
        for name in ("damping", "series"):
            if number(getattr(self, name), name) < 0:
                raise ModelError(f"{name}: got {getattr(self, name)}, need 0 or more")
            demand_magnitudes(getattr(self, name), name)
        demand_divisors(self.frequency, "frequency [rad/s]")

    def share(self, spring: Spring) -> float:
        """Theta = beta/(K + beta), K the mean slope of the spring: what of the push of w follows y at once."""
        mean = float(np.ptp(spring.voltage) / np.ptp(spring.displacement))
        return self.series / (mean + self.series)

    def lead(self, velocity: Array, acceleration: Array) -> Array:
        """W less y (n,) [m] that moves the free mass so: 2 zeta/omega y' + y''/omega^2."""
        return (2 * self.damping * velocity + acceleration / self.frequency) / self.frequency

    def transitions(self, durations: Array, share: float) -> Array:
        """Steps (R, 8) of durations (R,) [s] for (y, y'/omega): phi row by row, then what q before and after adds.

        ``y'' + 2 zeta omega y' + omega^2 (1 - theta) y = omega^2 q``, ``q = w - theta y + F_ext/kc`` linear in time: by
        the exponential of the matrix that has q and its slope for states too.

        Raises
        ------
        ModelError
            If a step is so long beside the resonance that its exponential has no digits.
        """
        radians = max(1.0, 2 * self.damping) * self.frequency * float(durations.max(initial=0.0))
        if radians > _LONGEST:
            raise ModelError(
                f"time: a step of {durations.max():.3g} s is too long for a resonance at "
                f"{self.frequency / (2 * np.pi):.3g} Hz with a damping of {self.damping:.3g}; give shorter ones, or "
                "leave Dynamics out"
            )
        distinct, row = np.unique(durations * self.frequency, return_inverse=True)
        generator = np.zeros((distinct.size, 4, 4))
        generator[:, 0, 1] = distinct
        generator[:, 1, 0], generator[:, 1, 1] = -(1 - share) * distinct, -2 * self.damping * distinct
        generator[:, 1, 2] = distinct
        generator[:, 2, 3] = 1
        steps = exponential(generator)
        after = steps[:, :2, 3]
        table = np.concatenate([steps[:, :2, :2].reshape(-1, 4), steps[:, :2, 2] - after, after], axis=1)
        still = distinct == 0
        table[still] = [1, 0, 0, 1, 0, 0, 0, 0]
        return np.ascontiguousarray(table[row])


def exponential(matrices: Array) -> Array:
    """Exponentials of many small matrices (R, n, n) at once: Taylor's series of a halved matrix, squared again.

    As many halvings as each needs: one that is not needed costs a bit of a small matrix's digits.
    """
    size = np.abs(matrices).sum(axis=2).max(axis=1, initial=0.0)
    halvings = np.ceil(np.log2(np.maximum(size, 1.0))).astype(np.int64)
    found = np.empty_like(matrices)
    for count in np.unique(halvings):
        those = halvings == count
        part = matrices[those] / 2.0**count
        term = np.broadcast_to(np.eye(matrices.shape[1]), part.shape)
        total = term.copy()
        for k in range(1, _TERMS):
            term = term @ part / k
            total += term
        for _ in range(count):
            total = total @ total
        found[those] = total
    return found
