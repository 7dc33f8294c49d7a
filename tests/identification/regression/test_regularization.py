"""Rows that hold neighbours alike: nothing for smooth parts, the differences for others, whatever the grid's size."""

from itertools import pairwise

import numpy as np
import pytest

from dehyst.identification import Structure
from dehyst.identification.regression.coefficients import regularization_rows

STROKE, HIGHEST = 16e-6, 200.0
SLOPE = HIGHEST / STROKE


def grid(**changes):
    return Structure(**{"elements": 6, "knots": 5, "grades": 3, "transformer": 6, "creep": 2, **changes}).grid(
        (0.0, STROKE), (0.0, HIGHEST), (0.01, 100.0)
    )


def columns(own, density, spring, drive):
    """Unknowns in the program's order: stiffnesses of a density over threshold and place, slopes, moved, tau."""
    rho = own.breakaway[own.movable]
    places = np.arange(own.segments)
    kappa = density(rho[:, None], places[None, :]) * np.diff(rho, prepend=0.0)[:, None]
    return np.concatenate(
        [
            kappa.ravel(),
            spring(np.arange(own.knots.size - 1)),
            np.full(own.moved, 7.0),
            drive(np.arange(own.drive.size - 2)),
        ]
    )


@pytest.mark.parametrize("spacing", [1.0, 2.0])
def test_even_densities_and_straight_slopes_are_smooth(spacing):
    own = grid(spacing=spacing)
    even = columns(own, lambda rho, place: 0 * rho + 0 * place + 3.0, lambda j: 2 + 0.5 * j, lambda j: 1 - 0.1 * j)
    np.testing.assert_allclose(regularization_rows(own, SLOPE) @ even, 0, atol=1e-12 / SLOPE)


def test_differences_by_hand():
    own, rng = grid(creep=0), np.random.default_rng(5)
    rho = own.breakaway[own.movable]
    kappa, slopes, drive = rng.random((rho.size, 3)), rng.random(4), rng.random(5)
    found = regularization_rows(own, SLOPE) @ np.concatenate([kappa.ravel(), slopes, drive])
    width = np.diff(rho, prepend=0.0)
    expected = [r * np.sqrt(3) * (b - a) for r, row in zip(rho, kappa, strict=True) for a, b in pairwise(row)]
    density = kappa / width[:, None]
    expected += [
        rho[i] * width[i + 1] * (density[i + 1, m] - density[i, m]) for i in range(rho.size - 1) for m in range(3)
    ]
    expected += [STROKE / 4 * (a - 2 * b + c) for a, b, c in zip(slopes, slopes[1:], slopes[2:], strict=False)]
    expected += [HIGHEST / 6 * (a - 2 * b + c) for a, b, c in zip(drive, drive[1:], drive[2:], strict=False)]
    np.testing.assert_allclose(found * SLOPE, expected, rtol=1e-9, atol=1e-15)


def test_finer_grades_of_the_same_density_are_about_as_rough():
    """A density that changes along the stroke: its roughness, squared and summed, does not grow with the grades."""

    def sum_of_squares(grades):
        own = grid(grades=grades)
        slanted = columns(own, lambda rho, place: 1 + 0 * rho + place / grades, lambda j: 0.0 * j, lambda j: 0.0 * j)
        return float(np.sum((regularization_rows(own, SLOPE) @ slanted) ** 2))

    assert sum_of_squares(16) == pytest.approx(sum_of_squares(8), rel=0.1)
