"""The one judgement: of a path by the promise, without what the records tested by the numbers of the identification."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest

from dehyst.control import Compensator, PossibleStart, StartError, plan_path
from dehyst.model import Validity, promise
from dehyst.trust import insight, judge, judge_planned

PLANT = plain_records.plant(4, seed=1)
STROKE, VOLTS = plain_records.STROKE, plain_records.VOLTS


def known_of(record, **more):
    numbers = {"rms": 1e-8, "largest": 2e-8, "disagreement": 1e-8, "stroke": STROKE, **more}
    return Validity.by_records([(record.time, record.voltage)], **numbers)


def test_nothing_is_known_of_a_model_made_by_hand():
    found = judge(PLANT)
    assert (found.rms, found.largest, found.untested) == (None, None, ())
    assert (found.parts, found.start, found.validated) == ({}, 0.0, False)


def test_the_promise_wins_over_the_training_error():
    trained = PLANT.with_identification(largest_error=2e-8)
    assert judge(trained).largest == 2e-8
    promised = trained.with_identification(expected_rms=1e-8, expected_largest=5e-8, validated=True)
    found = judge(promised)
    assert (found.rms, found.largest, found.validated, found.parts) == (1e-8, 5e-8, True, {"training": 2e-8})


def test_a_path_is_judged_by_where_it_turns():
    record = plain_records.loops(PLANT, plain_records.DESCENDING_TOPS)
    known = known_of(record)
    model = PLANT.with_identification(validity=known)
    assert judge(model).largest == known.anywhere.largest
    path = np.linspace(0.2, 0.8, 50) * STROKE
    command = Compensator(model, (0.0, VOLTS)).trajectory(path)
    assert command.promise.largest == promise(known, command.voltage).largest
    assert judge(model, promised=command.promise).largest == command.promise.largest
    assert Compensator(PLANT, (0.0, VOLTS)).trajectory(path).promise is None


def test_insight_gives_the_same_promise_and_a_band_along_the_path():
    record = plain_records.loops(PLANT, plain_records.DESCENDING_TOPS)
    model = PLANT.with_identification(validity=known_of(record))
    path = np.linspace(0.2, 0.8, 50) * STROKE
    found = insight(model, record, trajectory=path, limits=(0.0, VOLTS))
    judged, band = found.judgement, found.band
    missed = band.displacement - band.wanted
    assert judged.largest == pytest.approx(band.promise.largest + np.abs(missed).max())
    assert judged.rms == pytest.approx(np.hypot(band.promise.rms, np.sqrt(np.mean(missed**2))))
    assert judged.parts == band.errors()
    np.testing.assert_array_equal(band.highest, band.displacement + band.promise.half)
    np.testing.assert_array_equal(band.lowest, band.displacement - band.promise.half)
    assert found.as_dict()["judgement"] == judged.as_dict()
    start = PossibleStart.named(model, "bottom")
    below = insight(model, record, trajectory=path, limits=(0.0, VOLTS), start=start)
    assert (judged.begins, below.judgement.begins) == ("top", "bottom")
    assert judged.words(1e-6) != replace(judged, begins="bottom").words(1e-6)
    assert insight(model, record).judgement.begins == ""


def test_an_unknown_start_is_what_it_leaves_open():
    states = PossibleStart.unknown(PLANT, 50.0, (0.0, VOLTS)).states
    start = StartError.along(PLANT, states, np.linspace(50.0, 60.0, 20))
    assert judge(PLANT, path=start).start == start.largest > 0


@pytest.mark.parametrize(("home", "begins"), [(True, "homed"), (False, "unknown")])
def test_a_planned_path_is_judged_from_its_start(home, begins):
    actuator = replace(plain_records.plant(6), limits=(-40.0, 260.0))
    actuator = actuator.with_identification(expected_rms=1e-8, expected_largest=5e-8)
    wanted = plain_records.STROKE * (0.5 - 0.3 * np.cos(np.linspace(0, 2 * np.pi, 200)))
    path = plan_path(Compensator(actuator), wanted, time=np.arange(200.0), home=home)
    found = judge_planned(actuator, path)
    assert found.begins == begins
    assert (found.rms, found.largest) == (1e-8, 5e-8)
    assert (found.start > 1e-9) == (not home)
    assert found.as_dict()["begins"] == begins
    assert found.bounds == pytest.approx((np.hypot(1e-8, found.start), 5e-8 + found.start))
