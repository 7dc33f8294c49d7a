"""Actuators that age: gain, width and zero change as requested, and nothing before."""

import numpy as np
import pytest
from truths import AgeingActuator, AgeingCourse, PreisachActuator

from dehyst import ModelError
from dehyst.virtual import PlayActuator

SWING = np.concatenate([np.linspace(0, 200, 101), np.linspace(198, 0, 100)] * 2)


def loop(actuator, begin):
    """Return stroke, relative width and lowest displacement of the second loop."""
    y = actuator.play(SWING, time=begin + 1e-3 * np.arange(SWING.size), measured=False)[201:]
    stroke = y.max() - y[-1]
    return stroke, (y[150] - y[50]) / stroke, y[-1]


@pytest.mark.parametrize("kind", [PlayActuator, PreisachActuator])
def test_an_aged_actuator_has_changed_as_requested(kind):
    aged = AgeingActuator(kind(), AgeingCourse(gain=-7, width=25, offset=2, seconds=100))
    new, old = loop(aged, 1e-3), loop(aged, 200)
    assert loop(kind(), 1e-3) == pytest.approx(new, rel=1e-3, abs=1e-8)
    assert old[0] / new[0] == pytest.approx(0.93, rel=0.005)
    assert old[1] / new[1] == pytest.approx(1.25, rel=0.03)
    assert old[2] - new[2] == pytest.approx(0.02 * aged.stroke, rel=0.02)


def test_it_is_new_again_after_relaxing_and_needs_time():
    aged = AgeingActuator(PlayActuator(), AgeingCourse(gain=-50, seconds=1))
    assert loop(aged, 100)[0] == pytest.approx(0.5 * aged.stroke, rel=0.01)
    aged.relax()
    assert loop(aged, 1e-6)[0] == pytest.approx(aged.stroke, rel=0.3)
    with pytest.raises(ModelError, match="time"):
        aged.play(SWING)
