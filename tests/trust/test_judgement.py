"""The one judgement: the band wins over the promise of the identification, and that over the training error."""

import numpy as np
import plain_records
import pytest

from dehyst.control import PossibleStart, StartError
from dehyst.trust import insight, judge

PLANT = plain_records.plant(4, seed=1)


def test_nothing_is_known_of_a_model_made_by_hand():
    found = judge(PLANT)
    assert (found.rms, found.largest, found.half_width, found.coverage) == (None, None, None, None)
    assert (found.parts, found.start, found.tested) == ({}, 0.0, False)


def test_the_promise_wins_over_the_training_error():
    trained = PLANT.with_identification(largest_error=2e-8)
    assert judge(trained).largest == 2e-8
    promised = trained.with_identification(expected_rms=1e-8, expected_largest=5e-8, tested=True)
    found = judge(promised)
    assert (found.rms, found.largest, found.tested, found.parts) == (1e-8, 5e-8, True, {"training": 2e-8})


def test_the_band_of_the_path_wins_over_the_promise():
    record = plain_records.loops(PLANT, plain_records.DESCENDING_TOPS)
    model = PLANT.with_identification(expected_rms=1e-8, expected_largest=5e-8)
    path = np.linspace(0.2, 0.8, 50) * plain_records.STROKE
    found = insight(model, record, trajectory=path, limits=(0.0, plain_records.VOLTS), repeats=20)
    judged = found.judgement
    assert judged.largest == found.band.error
    assert judged.coverage == found.band.level == 0.9
    assert judged.half_width == pytest.approx(0.5 * np.mean(found.band.likely[1] - found.band.likely[0]))
    assert judged.parts == {name: error for name, error in found.band.errors().items() if name != "all"}
    assert found.as_dict()["judgement"] == judged.as_dict()


def test_an_unknown_start_is_what_it_leaves_open():
    states = PossibleStart.unknown(PLANT, 50.0, (0.0, plain_records.VOLTS)).states
    start = StartError.along(PLANT, states, np.linspace(50.0, 60.0, 20))
    assert judge(PLANT, path=start).start == start.largest > 0
