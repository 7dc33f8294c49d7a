"""The notebook keeps its word: its code runs, and the stored output is of this code."""

import ast

import places
import pytest

pytest.importorskip("matplotlib")
nbformat = pytest.importorskip("nbformat")

NOTEBOOK = places.EXAMPLES / "first_steps.ipynb"


@pytest.fixture(scope="module")
def executed():
    import notebooks

    return notebooks.run(NOTEBOOK)


def kinds(cell):
    return [sorted(output.get("data", {output.output_type: None})) for output in cell.get("outputs", [])]


@pytest.mark.nightly
def test_the_notebook_runs_and_its_stored_output_is_of_these_cells(executed):
    stored = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(stored)
    assert [kinds(cell) for cell in executed.cells] == [kinds(cell) for cell in stored.cells]
    assert sum("image/png" in kind for cell in stored.cells for shown in kinds(cell) for kind in shown) >= 4


def test_no_cell_converts_a_length_by_hand_but_where_the_library_is_in_metres():
    source = "\n".join(cell.source for cell in nbformat.read(NOTEBOOK, as_version=4).cells if cell.cell_type == "code")
    numbers = [node.value for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Constant)]
    assert 1e-6 not in numbers
