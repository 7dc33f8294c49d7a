"""Records without the motion of the mass."""

from __future__ import annotations

from dataclasses import replace

from dehyst._types import Array
from dehyst.model import Dynamics
from dehyst.records import Record

# Derivatives are those of the fourth-order polynomial through this many neighbours.
_WINDOW, _ORDER = 9, 4


def remove_dynamics(piece: Record, dynamics: Dynamics | None) -> Record:
    """A piece whose displacement is w, what the resonance had to follow: y + 2 zeta / omega y' + y'' / omega^2."""
    if dynamics is None:
        return piece
    velocity, acceleration = derivatives(piece)
    omega, zeta = dynamics.frequency, dynamics.damping
    return replace(piece, displacement=piece.displacement + 2 * zeta / omega * velocity + acceleration / omega**2)


def derivatives(piece: Record) -> tuple[Array, Array]:
    """Velocity [m/s] and acceleration [m/s2] (n,) of the measured displacement."""
    from scipy.signal import savgol_filter

    first, second = (
        savgol_filter(piece.displacement, _WINDOW, _ORDER, deriv=k, delta=piece.sample_time) for k in (1, 2)
    )
    return first, second
