"""The outermost branches of an actuator: where it is after a long rise, or a long fall, with every cart dragged along.

No state at rest at a voltage lies beyond them. Creep, inertia and lag have come to rest on them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dehyst._types import Array
from dehyst.model import Actuator, GradedSlip
from dehyst.model.elements import on_curve

_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class MajorLoop:
    """Voltage over displacement on the outermost rising (side 1) and falling (side -1) branch.

    Attributes
    ----------
    actuator : Actuator
        Smooth elements hold their most all along.
    """

    actuator: Actuator

    @cached_property
    def friction(self) -> float:
        """What plain and smooth elements hold on both [V]."""
        slip, smooth = self.actuator.slip, self.actuator.smooth
        held = 0.0 if smooth is None else float(smooth.stiffness @ smooth.length)
        return held if isinstance(slip, GradedSlip) else held + float(slip.friction.sum())

    def voltage(self, displacement: float, side: int) -> float:
        """Voltage [V] at a displacement [m]."""
        if not isinstance(self.actuator.slip, GradedSlip):
            drive = float(self.actuator.spring(displacement)) + side * self.friction
        else:
            y, held = self._branch(side)
            drive = float(on_curve(y, held, displacement))
        tau = self.actuator.transformer
        return drive if tau is None else float(tau.inverse(drive))

    def displacement(self, voltage: float, side: int) -> float:
        """Displacement [m] at a voltage [V]: no state lies lower on side 1, nor higher on side -1."""
        tau = self.actuator.transformer
        drive = voltage if tau is None else float(tau(voltage))
        if not isinstance(self.actuator.slip, GradedSlip):
            return self.actuator.core.spring_inverse(drive - side * self.friction)
        y, held = self._branch(side)
        return float(on_curve(held, y, drive))

    def bends(self, side: int) -> Array:
        """Displacements [m] at which the slope of the branch changes, in order."""
        tau = self.actuator.transformer
        more = [] if tau is None else [self.displacement(float(v), side) for v in tau.voltage]
        return np.unique(np.concatenate([self._places(side), more]))

    def _places(self, side: int) -> Array:
        """Bends by the spring and the elements [m]; what differs by rounding is one place."""
        knots, slip = self.actuator.spring.displacement, self.actuator.slip
        if not isinstance(slip, GradedSlip):
            return knots
        y = np.unique(np.concatenate([knots, slip.knots, (slip.knots[:, None] + side * slip.breakaway).ravel()]))
        return np.asarray(y[np.diff(y, prepend=-np.inf) > _ROUNDING * np.ptp(y)])

    def _branch(self, side: int) -> tuple[Array, Array]:
        return self._rising if side > 0 else self._falling

    @cached_property
    def _rising(self) -> tuple[Array, Array]:
        return self._tabulated(1)

    @cached_property
    def _falling(self) -> tuple[Array, Array]:
        return self._tabulated(-1)

    def _tabulated(self, side: int) -> tuple[Array, Array]:
        """Bends of a branch of graded elements and a place beyond either end, and the drive there."""
        slip, y = self.actuator.slip, self._places(side)
        y = np.concatenate([[y[0] - np.ptp(y)], y, [y[-1] + np.ptp(y)]])
        held = self.actuator.spring(y) + side * self.friction
        if isinstance(slip, GradedSlip):
            held = held + (
                slip.internal_voltage(y[:, None]) - slip.internal_voltage(y[:, None] - side * slip.breakaway)
            ).sum(axis=1)
        return y, held
