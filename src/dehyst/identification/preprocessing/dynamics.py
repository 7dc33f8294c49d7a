"""Removal of the motion of the mass from records."""

from __future__ import annotations

from dataclasses import replace

from dehyst._types import Array
from dehyst.identification.preprocessing.local_polynomial import local_polynomial
from dehyst.model import Dynamics
from dehyst.records import Record

# Derivatives are those of a polynomial of fourth order through this many neighbours.
_WINDOW, _ORDER = 9, 4


def remove_dynamics(piece: Record, dynamics: Dynamics | None) -> Record:
    """Return a piece whose displacement is w, the input of the resonance: y + 2 zeta / omega y' + y'' / omega^2."""
    if dynamics is None:
        return piece
    velocity, acceleration = derivatives(piece)
    omega, zeta = dynamics.frequency, dynamics.damping
    return replace(piece, displacement=piece.displacement + 2 * zeta / omega * velocity + acceleration / omega**2)


def derivatives(piece: Record) -> tuple[Array, Array]:
    """Return velocity [m/s] and acceleration [m/s2] (n,) of the measured displacement."""
    y, step = piece.displacement, piece.sample_time
    first, second = (local_polynomial(y, _WINDOW, _ORDER, derivative, step) for derivative in (1, 2))
    return first, second
