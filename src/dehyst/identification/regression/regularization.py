"""How unlike neighbours are: rows that hold alike what the data leave free, as a program's columns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.model.structure import Grid


def regularization_rows(grid: Grid, slope: float) -> Array:
    """Differences between neighbours (p, q) [m]: of elements, spring and transformer, in the order of the unknowns.

    ``rho_i sqrt(M) (kappa_i,m+1 - kappa_im) / slope`` along the stroke,
    ``rho_i drho_i+1 (kappa_i+1,m / drho_i+1 - kappa_im / drho_i) / slope`` from one threshold to the next, and second
    differences of the slopes of the spring and of tau over a segment. They do not depend on how many rows there are;
    what creeps or yields gradually lies too far apart to have neighbours.

    Parameters
    ----------
    grid : Grid
    slope : float
        Volts for a metre [V/m], which make forces elongations.
    """
    rho = grid.breakaway[grid.movable]
    elements, spring, drive = rho.size * grid.segments, grid.knots.size - 1, max(grid.drive.size - 2, 0)
    size = elements + spring + grid.moved + drive
    stiffness = np.arange(elements).reshape(rho.size, grid.segments)
    segment = float(np.ptp(grid.knots)) / spring
    rows = [
        _placed(_along(rho, grid.segments) / slope, stiffness.ravel(), size),
        _placed(_across(rho, grid.segments) / slope, stiffness.ravel(), size),
        _placed(_curvature(spring) * segment / slope, elements + np.arange(spring), size),
    ]
    if drive:
        length = float(np.ptp(grid.drive)) / (drive + 1)
        rows.append(_placed(_curvature(drive) * length / slope, size - drive + np.arange(drive), size))
    return np.vstack(rows)


def _along(rho: Array, segments: int) -> Array:
    """Of each element from one grade to the next."""
    one = np.diff(np.eye(segments), axis=0) * np.sqrt(segments)
    return np.asarray(np.kron(np.diag(rho), one))


def _across(rho: Array, segments: int) -> Array:
    """Of the density of stiffness from one threshold to the next, on each grade."""
    density = np.diag(1 / np.diff(rho, prepend=0.0))
    steps = np.diff(density, axis=0) * (rho[:-1] * np.diff(rho))[:, None]
    return np.asarray(np.kron(steps, np.eye(segments)))


def _curvature(count: int) -> Array:
    return np.asarray(np.diff(np.eye(count), n=2, axis=0))


def _placed(rows: Array, columns: NDArray[np.intp], size: int) -> Array:
    found = np.zeros((len(rows), size))
    found[:, columns] = rows
    return found
