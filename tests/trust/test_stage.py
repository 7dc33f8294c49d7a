"""The check and the assessment of a stage: what is told of its coupling."""

import coupled_stage
import numpy as np
import pytest

import dehyst
from dehyst.trust import insight

TRAINING, _ = coupled_stage.excited()
CHANGED = np.array([[0.0, 0.02], [0.0, 0.0]])


@pytest.fixture(scope="module")
def stage():
    return dehyst.identify(TRAINING, structure="maxwell_slip").stage


@pytest.mark.parametrize("gains", [(1.0, 1.0), (1.06, 0.95)])
def test_only_a_changed_coupling_is_told(stage, gains):
    for coupling, count in ((coupled_stage.COUPLING, 0), (coupled_stage.COUPLING + CHANGED, 1)):
        record, _ = coupled_stage.excited(5, coupling=coupling * np.array(gains))
        found = dehyst.check(stage, record)
        assert len(found.changes) == count
        assert np.all(np.abs(found.coupling - coupling) <= 3 * found.uncertainty)


def test_axes_that_move_together_tell_nothing_of_the_coupling(stage):
    both = TRAINING.voltage[:, :1] * np.array([1.0, 1.2])
    found = dehyst.check(stage, coupled_stage.played(TRAINING.time, both))
    assert np.all(np.isinf(found.uncertainty)) and found.changes == ()


def test_the_intervals_hold_the_coupling(stage):
    found = insight(stage, TRAINING)
    assert np.all((found.low <= coupled_stage.COUPLING) & (found.high >= coupled_stage.COUPLING))
    assert np.all(found.high - found.low < 0.002)
    assert not any("coupling" in remark and "known to" in remark for remark in found.remarks)
