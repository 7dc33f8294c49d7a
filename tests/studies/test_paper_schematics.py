"""Figs. 1 and 2 of the paper: every symbol is there, and nothing hides another."""

from itertools import combinations

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="matplotlib is not installed; pip install 'dehyst[report]'")

from dehyst.report import plots
from dehyst.studies.paper import schematics

SYMBOLS = {
    "model": {"km", "ke", "g(x)", "y", "x", "F=Tv", "k1", "k2", "kN", "f1", "f2", "fN", "xb1", "xb2", "xbN"},
    "physical_blocks": {"v", "T", "F", "1keq", "g(x)", "x", "Σ", "+", "−", "FH1", "FH2", "FHN"}
    | {f"k{i},f{i}" for i in "12N"},
    "preisach_blocks": {"v", "x", "Σ"} | {f"γα{i},β{i}" for i in "12M"} | {f"μ(α{i},β{i})" for i in "12M"},
}
SHAPES = sorted(SYMBOLS)


def plain(text):
    """A label without the commands of its typesetting."""
    for command, letter in (("alpha", "α"), ("beta", "β"), ("gamma", "γ"), ("mu", "μ")):
        text = text.replace(f"\\{command}", letter)
    return "".join(
        c for c in text.replace(r"\dfrac", "").replace(r"\mathrm", "").replace("\\,", "") if c not in "${}_ "
    )


@pytest.fixture(scope="module")
def drawn():
    """Each part drawn in a column's width: its labels, the lines and the outlines of its blocks, in pixels."""
    parts = {}

    def draw(name, ax):
        getattr(schematics, f"draw_{name}")(ax)
        ax.figure.draw_without_rendering()
        labels = [(text.get_text(), text.get_window_extent()) for text in ax.texts if text.get_text()]
        lines = [
            line.get_path().transformed(line.get_transform()) for line in ax.lines if line.get_linestyle() != "None"
        ]
        outlines = [patch.get_path().transformed(patch.get_transform()) for patch in ax.patches]
        parts[name] = labels, lines, outlines, ax.get_window_extent()

    for name in SHAPES:
        plots.drawing(name, lambda ax, name=name: draw(name, ax), size=(plots.COLUMN, 3.0))
    return parts


@pytest.mark.parametrize("name", SHAPES)
def test_every_symbol_is_there(drawn, name):
    assert {plain(text) for text, _ in drawn[name][0]} == SYMBOLS[name]


@pytest.mark.parametrize("name", SHAPES)
def test_no_label_hides_another_or_lies_on_a_line(drawn, name):
    labels, lines, outlines, whole = drawn[name]
    for (one, box), (other, at) in combinations(labels, 2):
        assert not box.overlaps(at), (one, other)
    for text, box in labels:
        assert not any(line.intersects_bbox(box, filled=False) for line in lines), text
        assert not any(outline.intersects_bbox(box, filled=False) for outline in outlines), text
        assert whole.containsx(box.x0) and whole.containsx(box.x1), text
        assert whole.containsy(box.y0) and whole.containsy(box.y1), text


@pytest.mark.parametrize("name", SHAPES)
def test_blocks_stand_apart(drawn, name):
    boxes = [outline.get_extents() for outline in drawn[name][2]]
    assert len(boxes) >= 3
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))


def test_both_have_the_size_of_a_journal_and_no_data():
    model, blocks = schematics.schematics()
    assert [plate.name for plate in (model, blocks)] == ["fig01", "fig02"]
    assert not model.data and not blocks.data
    assert blocks.wide and not model.wide
    assert np.all([plate.drawing.png[:4] == b"\x89PNG" for plate in (model, blocks)])
