"""How much model: what a structure is, where its parts lie, and what it refuses."""

import json
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dehyst import IdentifyError
from dehyst.identification import Structure

SPAN, VOLTS = (-1e-6, 15e-6), (-20.0, 120.0)
STRUCTURES = st.builds(
    Structure,
    elements=st.integers(1, 60),
    spacing=st.floats(0.5, 4),
    grades=st.integers(1, 12),
    knots=st.integers(2, 60),
    transformer=st.sampled_from([0, 2, 3, 20]),
    smooth=st.booleans(),
    smoothing=st.sampled_from([0.0, 1e-3, 1.0]),
)


@given(STRUCTURES)
def test_the_grid_covers_exactly_the_loops(structure):
    grid = structure.grid(SPAN, VOLTS)
    stroke = SPAN[1] - SPAN[0]
    assert grid.breakaway.size == structure.elements
    assert grid.breakaway[-1] == pytest.approx(stroke / 2)
    for knots, count in ((grid.grades, structure.grades), (grid.knots, structure.knots - 1)):
        assert knots.size == count + 1
        np.testing.assert_allclose(knots[[0, -1]], SPAN)
    assert grid.segments == structure.grades
    assert grid.drive.size == (structure.transformer + 1 if structure.transformer else 0)
    if structure.transformer:
        np.testing.assert_allclose(grid.drive[[0, -1]], VOLTS)
    for values in (grid.breakaway, grid.grades, grid.knots, grid.drive):
        assert np.all(np.diff(values) > 0)
    # Every element but the last can slide both ways within the stroke.
    assert grid.movable.tolist() == [True] * (structure.elements - 1) + [False]


@given(STRUCTURES)
def test_json_values_restore_the_structure(structure):
    assert Structure(**json.loads(json.dumps(structure.as_dict()))) == structure
    assert {field.name for field in fields(structure)} == set(structure.as_dict())


@given(structure=STRUCTURES, scale=st.floats(1e-3, 1e3))
def test_the_grid_scales_with_the_units(structure, scale):
    grid = structure.grid(SPAN, VOLTS)
    scaled = structure.grid((scale * SPAN[0], scale * SPAN[1]), (scale * VOLTS[0], scale * VOLTS[1]))
    for name in ("breakaway", "grades", "knots", "drive", "lengths"):
        np.testing.assert_allclose(getattr(scaled, name), scale * getattr(grid, name), rtol=1e-9, atol=1e-20 * scale)
    np.testing.assert_array_equal(scaled.closings, grid.closings)


@pytest.mark.parametrize(
    "options",
    [
        {"elements": 0},
        {"elements": 501},
        {"elements": 2.5},
        {"grades": 0},
        {"grades": True},
        {"knots": 1},
        {"transformer": -1},
        {"transformer": 1},
        {"transformer": 201},
        {"knots": "9"},
        {"smoothing": 1.5},
        {"smoothing": -1e-3},
        {"spacing": 0.4},
        {"spacing": float("nan")},
        {"spacing": "dense"},
        {"smooth": "no"},
    ],
    ids=str,
)
def test_impossible_numbers_are_refused(options):
    with pytest.raises(IdentifyError, match=next(iter(options))):
        Structure(**options)


def test_spacing_makes_the_grid_dense_where_loops_are_small():
    grid = Structure(elements=10, spacing=2.0).grid((0.0, 2.0), VOLTS)
    np.testing.assert_allclose(grid.breakaway, (np.arange(1, 11) / 10) ** 2)


def test_smooth_elements_have_each_length_with_both_closings():
    grid = Structure(smooth=True).grid((0.0, 1.0), VOLTS)
    assert sorted(zip(grid.lengths.tolist(), grid.closings.tolist(), strict=True)) == [
        (length, closing) for length in (0.02, 0.05, 0.1, 0.2, 0.5) for closing in (0.5, 1.0)
    ]
