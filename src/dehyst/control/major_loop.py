"""The major loop of an actuator: its displacement after a long rise or a long fall, with every cart dragged along.

No state at rest lies outside it. Creep, inertia and lag are at rest on it.
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
    """Voltage over displacement on the rising (side 1) and the falling (side -1) branch of the major loop.

    `actuator`: its smooth elements bear their largest force everywhere.
    """

    actuator: Actuator

    @cached_property
    def friction(self) -> float:
        """The voltage [V] that plain and smooth elements bear on both branches."""
        slip, smooth = self.actuator.slip, self.actuator.smooth
        borne = 0.0 if smooth is None else float(smooth.stiffness @ smooth.length)
        return borne if isinstance(slip, GradedSlip) else borne + float(slip.friction.sum())

    def voltage(self, displacement: float, side: int) -> float:
        """Return the voltage [V] at a displacement [m]."""
        if not isinstance(self.actuator.slip, GradedSlip):
            internal = float(self.actuator.spring(displacement)) + side * self.friction
        else:
            y, borne = self._branch(side)
            internal = float(on_curve(y, borne, displacement))
        tau = self.actuator.transformer
        return internal if tau is None else float(tau.inverse(internal))

    def displacement(self, voltage: float, side: int) -> float:
        """Return the displacement [m] at a voltage [V]: no state lies lower on side 1, nor higher on side -1."""
        tau = self.actuator.transformer
        internal = voltage if tau is None else float(tau(voltage))
        if not isinstance(self.actuator.slip, GradedSlip):
            return self.actuator.core.spring_inverse(internal - side * self.friction)
        y, borne = self._branch(side)
        return float(on_curve(borne, y, internal))

    def bends(self, side: int) -> Array:
        """Return the displacements [m] at which the slope of the branch changes, in order."""
        tau = self.actuator.transformer
        more = [] if tau is None else [self.displacement(float(v), side) for v in tau.voltage]
        return np.unique(np.concatenate([self._element_bends(side), more]))

    def _element_bends(self, side: int) -> Array:
        """Return the bends [m] of spring and elements; those that differ by rounding are merged."""
        knots, slip = self.actuator.spring.displacement, self.actuator.slip
        if not isinstance(slip, GradedSlip):
            return knots
        y = np.unique(np.concatenate([knots, slip.knots, (slip.knots[:, None] + side * slip.breakaway).ravel()]))
        return np.asarray(y[np.diff(y, prepend=-np.inf) > _ROUNDING * np.ptp(y)])

    def _branch(self, side: int) -> tuple[Array, Array]:
        return self._branches[side]

    @cached_property
    def _branches(self) -> dict[int, tuple[Array, Array]]:
        return {side: self._tabulated(side) for side in (1, -1)}

    def _tabulated(self, side: int) -> tuple[Array, Array]:
        """Return the bends of a branch of graded elements, with a point beyond either end, and tau(v) [V] there."""
        slip, y = self.actuator.slip, self._element_bends(side)
        y = np.concatenate([[y[0] - np.ptp(y)], y, [y[-1] + np.ptp(y)]])
        borne = self.actuator.spring(y) + side * self.friction
        if isinstance(slip, GradedSlip):
            carts = y[:, None] - side * slip.breakaway
            borne = borne + (slip.internal_voltage(y[:, None]) - slip.internal_voltage(carts)).sum(axis=1)
        return y, borne
