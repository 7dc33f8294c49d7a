"""The coefficients of an actuator on the grids of its parts, and the only maker of actuators from them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dehyst._types import Array
from dehyst.identification.solvers.program import Solution
from dehyst.model import Actuator, Creep, GradedSlip, MaxwellSlip, SmoothSlip, Spring, Transformer
from dehyst.model.structure import Grid

# A branch or smooth element that holds less of the voltage than this over the whole range is left out.
_NOTHING = 1e-9


@dataclass(frozen=True, eq=False)
class Coefficients:
    """Coefficients of a regression.

    Attributes
    ----------
    stiffness : (N, M) array
        kappa_im [V/m]; M = 1 for plain elements.
    slopes : (K - 1,) array
        Slopes of the spring [V/m].
    internal : (J + L,) array
        Stiffnesses of creep branches, then of smooth elements [V/m].
    transformer : (T,) array
        Slopes of tau; empty without one.
    offsets, drifts : dict
        Constants by epoch and drifts by record [V of tau].
    solution : Solution or None
        The program's answer; None for those of a given actuator.
    starts : dict
        p_j (J,) by record [V of tau].
    """

    stiffness: Array
    slopes: Array
    internal: Array
    transformer: Array
    offsets: dict[int, float] = field(default_factory=dict)
    drifts: dict[int, float] = field(default_factory=dict)
    solution: Solution | None = None
    starts: dict[int, Array] = field(default_factory=dict)

    @classmethod
    def from_actuator(cls, actuator: Actuator) -> Coefficients:
        """Return an actuator's numbers as coefficients, without constants."""
        tau, stiffness = actuator.transformer, actuator.slip.stiffness
        internal = [np.zeros(0) if part is None else part.stiffness for part in (actuator.creep, actuator.smooth)]
        return cls(
            stiffness=stiffness if stiffness.ndim == 2 else stiffness[:, None],
            slopes=actuator.spring.slopes,
            internal=np.concatenate(internal),
            transformer=np.zeros(0) if tau is None else np.diff(tau.drive) / np.diff(tau.voltage),
        )

    @property
    def solved(self) -> Solution:
        """The program's answer.

        Raises
        ------
        ValueError
            If these are the coefficients of a given actuator.
        """
        if self.solution is None:
            raise ValueError("these coefficients are those of an actuator; fit a regression for an answer")
        return self.solution

    def to_actuator(self, grid: Grid, first: float, *, least: float | None = _NOTHING, **others: Any) -> Actuator:
        """Return the actuator that has these coefficients on a grid.

        Parameters
        ----------
        grid : Grid
        first : float
            The spring's voltage at its first knot [V].
        least : float or None
            Creep branches and smooth elements that hold no more than this part of the voltage are left out; None: all
            stay, negative stiffnesses as zero.
        **others
            Further arguments of `Actuator`.
        """
        branches = grid.time_constants.size
        internal = np.maximum(self.internal, 0.0) if least is None else self.internal
        if least is None:
            kept = np.ones(internal.size, dtype=bool)
        else:
            kept = internal > least * float(self.slopes @ np.diff(grid.knots)) / float(np.ptp(grid.knots))
        creep, smooth = kept[:branches], kept[branches:]
        tau = grid.drive[:1] + np.concatenate([[0.0], np.cumsum(self.transformer * np.diff(grid.drive))])
        return Actuator(
            slip=GradedSlip(grid.breakaway, grid.grades, self.stiffness)
            if grid.graded
            else MaxwellSlip(grid.breakaway, self.stiffness[:, 0]),
            spring=Spring.of_slopes(grid.knots, self.slopes, first),
            transformer=Transformer(grid.drive, tau) if grid.drive.size else None,
            creep=Creep(grid.time_constants[creep], internal[:branches][creep]) if creep.any() else None,
            smooth=SmoothSlip(grid.lengths[smooth], grid.closings[smooth], internal[branches:][smooth])
            if smooth.any()
            else None,
            **others,
        )
