"""From coefficients of the wider regression to an actuator's parts, and back."""

from __future__ import annotations

from typing import Any

import numpy as np

from dehyst.identification.regression.wide_regression import WideCoefficients
from dehyst.model import Actuator, Creep, GradedSlip, MaxwellSlip, SmoothSlip, Spring, Transformer
from dehyst.model.structure import Grid

# A branch or smooth element that holds less of the voltage than this over the whole range is left out.
_NOTHING = 1e-9


def parts(grid: Grid, found: WideCoefficients, first: float, nothing: float = _NOTHING) -> dict[str, Any]:
    """Arguments of `Actuator` from coefficients; `first` is the spring's voltage at its first knot [V].

    Branches and smooth elements that hold no more than `nothing` of the voltage are left out.
    """
    branches = grid.time_constants.size
    least = nothing * float(found.slopes @ np.diff(grid.knots)) / float(np.ptp(grid.knots))
    creep, smooth = found.moved[:branches] > least, found.moved[branches:] > least
    plain = grid.segments == 1
    slip = (
        MaxwellSlip(grid.breakaway, found.stiffness[:, 0])
        if plain
        else GradedSlip(grid.breakaway, grid.grades, found.stiffness)
    )
    drive = grid.drive[:1] + np.concatenate([[0.0], np.cumsum(found.drive * np.diff(grid.drive))])
    return {
        "slip": slip,
        "spring": Spring.of_slopes(grid.knots, found.slopes, first),
        "transformer": Transformer(grid.drive, drive) if grid.drive.size else None,
        "creep": Creep(grid.time_constants[creep], found.moved[:branches][creep]) if creep.any() else None,
        "smooth": SmoothSlip(grid.lengths[smooth], grid.closings[smooth], found.moved[branches:][smooth])
        if smooth.any()
        else None,
    }


def grid_of(actuator: Actuator) -> Grid:
    """The grids on which an actuator's parts lie."""
    slip, knots, none = actuator.slip, actuator.spring.displacement, np.zeros(0)
    smooth = actuator.smooth
    return Grid(
        slip.breakaway,
        slip.knots if isinstance(slip, GradedSlip) else knots[[0, -1]],
        knots,
        none if actuator.transformer is None else actuator.transformer.voltage,
        none if actuator.creep is None else actuator.creep.time_constants,
        none if smooth is None else smooth.length,
        none if smooth is None else smooth.closing,
    )


def coefficients_of(actuator: Actuator) -> WideCoefficients:
    """An actuator's numbers as coefficients, without constants."""
    tau, none = actuator.transformer, np.zeros(0)
    stiffness = actuator.slip.stiffness
    moved = [none if part is None else part.stiffness for part in (actuator.creep, actuator.smooth)]
    return WideCoefficients(
        stiffness=stiffness if stiffness.ndim == 2 else stiffness[:, None],
        slopes=actuator.spring.slopes,
        moved=np.concatenate(moved),
        drive=none if tau is None else np.diff(tau.drive) / np.diff(tau.voltage),
        offsets={},
        drifts={},
        solution=None,  # type: ignore[arg-type]
    )
