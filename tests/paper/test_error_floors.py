"""Floors under the error: against models that attain them, and against a second way to the same number."""

from dataclasses import replace

import numpy as np
import pytest

from dehyst import identify
from dehyst.paper.experiment import (
    ClosedLoop,
    chord_error,
    parabola_chord_error,
    symmetric_width_floor,
    virtual_actuator,
)
from dehyst.records import Record


def loop_of(rising, falling):
    """The loop whose branches are the two functions of displacement (0 to 1)."""
    y = np.linspace(0, 1, 4001)
    return ClosedLoop(np.vstack([y, rising(y)]), np.vstack([y, falling(y)]))


def bulge(y):
    return 4 * y * (1 - y)


def test_a_loop_of_symmetric_width_has_no_floor_however_its_middle_bends():
    for middle in (lambda y: y, lambda y: y**2, lambda y: y + 0.1 * np.sin(5 * y)):
        loop = loop_of(lambda y, m=middle: 100 * m(y) + 9 * bulge(y), lambda y, m=middle: 100 * m(y) - 9 * bulge(y))
        assert symmetric_width_floor(loop) < 2e-3


def test_a_loop_that_leans_has_the_floor_of_its_lean():
    # Width w (1 + b (1 - 2y)): mirrored places differ by 2 w b (1 - 2y). With slopes of 100 V an error e changes the
    # width by 200 e at both, so that e is the largest w b (1 - 2y) / 200, or less where the centre moves.
    lean = 0.2

    def half(y):
        return 5 * bulge(y) * (1 + lean * (1 - 2 * y))

    floor = symmetric_width_floor(loop_of(lambda y: 100 * y + half(y), lambda y: 100 * y - half(y)))
    y = np.linspace(0, 1, 4001)
    simple = 100 * np.max(2 * 5 * bulge(y) * lean * np.abs(1 - 2 * y)) / 200
    assert 0.5 * simple < floor <= 1.05 * simple


@pytest.mark.parametrize(("asymmetric", "least"), [(True, 0.2), (False, 0.0)])
@pytest.mark.parametrize("norm", ["l1", "l2"])
def test_no_identified_model_comes_below_the_floor(asymmetric, least, norm):
    truth = replace(virtual_actuator(asymmetric=asymmetric), noise=0.0)
    floor = symmetric_width_floor(ClosedLoop.of(truth))
    assert floor >= least
    t = np.arange(1201)
    voltage = 100 - 100 * np.cos(2 * np.pi * t / 400)
    y = truth.play(voltage)
    fit = identify(
        Record(t / 4, voltage, y, "major"), elements=60, norm=norm, shared_datum=True, delay=0.0, drift=False
    )
    error = 100 * np.abs(fit.actuator.simulate(voltage).displacement - y)[200:].max() / truth.stroke
    assert error > floor


def test_chords_of_a_parabola_by_the_closed_form():
    for nominal in (3.0, 13.63, 20.0):
        bend = 4 * nominal / 100
        y = np.linspace(0, 1, 20001)
        u = (-(1 - bend) + np.sqrt((1 - bend) ** 2 + 4 * bend * y)) / (2 * bend)
        branch = np.vstack([y, 200 * u])
        for elements in (5, 10, 40):
            expected = chord_error(ClosedLoop(branch, branch), elements)
            assert parabola_chord_error(nominal, elements) == pytest.approx(expected, rel=1e-4)


def test_chords_get_better_with_their_number_and_the_loop_spans_the_stroke():
    loop = ClosedLoop.of(virtual_actuator())
    assert loop.range == pytest.approx(16.152e-6, rel=1e-9)
    errors = [chord_error(loop, n) for n in (5, 10, 20, 40, 80)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.06
