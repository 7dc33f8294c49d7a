"""The promise: what it grows with, what it names as not tested, and that a file keeps it."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dehyst import ModelError
from dehyst.model import DisplacementCreep, Thermal, Validity
from dehyst.model.branches import branches_of, distances
from dehyst.model.promise import promise
from dehyst.model.temperatures import to_record
from dehyst.report.sections import _PARTS as WORDS

SPAN, STROKE = 100.0, 1e-5


def motion(*turns, branch=1.0, hold=0.0):
    """Voltage with straight branches of a second, held at the end."""
    voltage = np.concatenate([[turns[0]], *(np.linspace(a, b, 101)[1:] for a, b in pairwise(turns))])
    time = 0.01 * branch * np.arange(voltage.size)
    return np.append(time, time[-1] + hold) if hold else time, np.append(voltage, voltage[-1]) if hold else voltage


def known(*turns, **numbers):
    numbers_ = {"rms": 1e-8, "largest": 0.0, "disagreement": 2e-8, "stroke": STROKE, **numbers}
    return Validity.by_records([motion(*turns)], **numbers_)


TOPS = known(0, 100, 0, 80, 0, 60, 0, 40, 0)
TIME, VOLTAGE = motion(0, 100, 0, 80, 0, 60, 0, 40, 0)


def test_similar_branches_have_a_small_distance():
    _, voltage = motion(0, 100, 30, 70)
    np.testing.assert_allclose(voltage[branches_of(voltage, SPAN)], [[0, 100], [100, 30], [30, 70]])
    known = np.array([[0.0, 1.0], [1.0, 0.0]])
    # Shorter ones that begin alike were passed; one begins 0.3 later; one goes on beyond the end by 0.1.
    path = np.array([[0.0, 0.5], [0.7, 0.2], [1.0, -0.1]])
    np.testing.assert_allclose(distances(path, known), [0.0, 0.3, 0.1])
    # A branch is at most its own height away, and the other way does not help.
    np.testing.assert_allclose(distances(np.array([[0.5, 0.55]]), known[1:]), [0.05])


def test_a_path_like_the_records_has_a_smaller_bound_than_one_with_new_turns():
    alike, other = (promise(TOPS, motion(*turns)[1]) for turns in ((0, 80, 0, 60, 0), (0, 80, 45, 70, 45, 75, 40)))
    assert alike.largest < other.largest and alike.rms < other.rms
    assert (alike.untested, len(other.untested)) == ((), 1)
    # Along the path the promise is wider only where it turns elsewhere.
    assert other.half[250] > 1.2 * other.half[0]


def test_random_turning_points_make_the_bound_smaller():
    turns = [0, 100, *np.random.default_rng(0).uniform(0, 100, 60)]
    assert known(*turns, new=(0.08, 0.08)).anywhere.largest < known(*turns).anywhere.largest


def test_speeds_holds_and_voltages_beyond_the_records_are_named():
    usual = motion(0, 100, 0)
    assert promise(TOPS, usual[1], usual[0]).untested == ()
    fast, held, beyond = motion(0, 100, 0, branch=0.3), motion(0, 100, hold=10), motion(0, 110, 0)
    assert all(len(promise(TOPS, voltage, time).untested) == 1 for time, voltage in (fast, held, beyond))
    assert promise(TOPS, beyond[1], beyond[0]).parts["voltages"] == pytest.approx(0.1 * TOPS.stroke)
    # A slow branch stays long at each voltage as well.
    assert len(promise(TOPS, *motion(0, 40, 0, branch=3)[::-1]).untested) == 2


def test_a_lag_from_records_of_one_speed_adds_an_error_on_faster_paths():
    time, voltage = motion(0, 100, 0, 50, 10)
    one_pace, open_ = (known(0, 100, 0, 100, 0, lag=0.01, lag_open=open_) for open_ in (False, True))
    assert (one_pace.lag_error, known(0, 100, 0, lag=0.01, lag_error=0.0).lag_error) == (pytest.approx(0.01), 0.0)
    late = [promise(one_pace, voltage, time / times).parts.get("lag", 0.0) for times in (1, 5, 20)]
    # It moves the path by the lag's error times the speed, which is 100 V/s at the pace of the records.
    assert late[0] == 0 and np.all(late[1:] > np.array([4, 19]) * 0.01 * STROKE * 1.5)
    stepped = 0.9 * voltage + 8 * ((time > 0.5) & (time < 1.5))
    assert promise(one_pace, stepped, time).parts["lag"] > 0.02 * STROKE
    apart = promise(open_, voltage, time / 5)
    assert (apart.delay, promise(one_pace, voltage, time / 5).delay) == (0.01, 0.0)
    assert 0 < apart.parts["lag"] < late[1]


def test_a_promise_grows_steadily_with_the_speed_beyond_that_of_the_records():
    time, voltage = motion(0, 100, 0, 50, 10)
    found = [promise(TOPS, voltage, time / times) for times in (1, 1.1, 2, 5, 10)]
    assert np.all(np.diff([(promise.largest, promise.rms) for promise in found], axis=0) > 0)
    assert found[1].largest < 1.1 * found[0].largest and found[-1].largest > 2 * found[0].largest
    asked = [[gap.command for gap in each.untested if gap.what == "speed"] for each in found]
    assert [len(commands) for commands in asked] == [0, 0, 1, 1, 1] and all(all(commands) for commands in asked)


def test_a_path_longer_than_the_records_adds_an_error_of_creep():
    creep = DisplacementCreep([0.1, 10.0], [0.02, 0.02])
    short, ten, hundred = (promise(TOPS, VOLTAGE, factor * TIME, creep=creep) for factor in (0.5, 10.0, 100.0))
    assert "creep" not in short.parts and ten.parts["creep"] > 0.002 * STROKE
    assert hundred.parts["creep"] == pytest.approx(2 * ten.parts["creep"])
    assert min(ten.rms, hundred.rms) > short.rms


def test_a_hidden_creep_adds_an_error_on_slow_paths():
    hiding = replace(TOPS, creep_open=0.02)
    costs = [promise(hiding, VOLTAGE, factor * TIME / TIME[-1]).parts.get("creep", 0.0) for factor in (1, 10, 100)]
    assert costs[0] == 0 < costs[1] == pytest.approx(0.5 * costs[2])
    assert hiding.anywhere.largest > TOPS.anywhere.largest and hiding.anywhere.offset > TOPS.anywhere.offset
    # A creep in the model is known for as long as the records last.
    assert "creep" not in promise(hiding, VOLTAGE, TIME, creep=DisplacementCreep([0.1], [0.02])).parts


def test_a_removed_drift_is_named_if_it_exceeds_the_goal():
    drifting = known(0, 100, 0, 80, 0, 60, 0, 40, 0, drift=1e-7)
    assert [gap.what for gap in promise(drifting, VOLTAGE, TIME).untested] == ["drift"]
    assert promise(drifting, VOLTAGE[:101], TIME[:101]).untested == promise(TOPS, VOLTAGE, TIME).untested == ()


def test_the_report_describes_every_part_of_a_promise():
    known_ = known(0, 100, 0, lag=0.01, lag_error=0.01, temperatures=(20.0, 20.0))
    time, voltage = motion(0, 120, 0, branch=0.1, hold=1e4)
    parts = {"thermal": Thermal(20.0, 1e-3), "creep": DisplacementCreep([1.0], [0.01]), "temperature": 30.0}
    found = promise(known_, voltage, time, **parts, opened=np.full(time.size, 1e-8), missed=np.full(time.size, 1e-8))
    assert set(found.parts) == set(WORDS)


@pytest.mark.parametrize("growth", [0.0, 5e-8])
def test_more_turns_per_second_than_in_the_records_are_named_and_widen_the_promise(growth):
    often, seldom = (motion(*[50, 55] * 8, branch=branch) for branch in (0.05, 0.8))
    usual, fast = (promise(replace(TOPS, growth=growth), voltage, time) for time, voltage in (seldom, often))
    assert fast.largest > 1.5 * usual.largest and fast.rms > 1.5 * usual.rms
    asked, named = ({gap.what for gap in found.untested} & {"speed", "rate"} for found in (fast, usual))
    assert (asked, named) == ({"rate"}, {"speed"})  # The slow one has a branch that is too slow.
    assert promise(replace(TOPS, growth=5e-8), *seldom[::-1]).largest >= usual.largest


@given(st.lists(st.floats(0, 100), min_size=2, max_size=12), st.floats(0, 1e-7), st.floats(0, 1e-7))
def test_a_promise_is_positive_and_does_not_fall_when_errors_grow(turns, rms, more):
    _, voltage = motion(*turns)
    less, greater = (promise(known(0, 100, 0, rms=size), voltage) for size in (rms, rms + more))
    assert 0 < less.rms <= greater.rms < greater.largest
    assert less.half.shape == voltage.shape and np.all(less.half <= greater.half)


def test_an_untested_or_unknown_temperature_adds_an_error():
    warm, part = replace(TOPS, temperatures=(15.0, 45.0)), Thermal(-2.5e-3, 5e-9, 30.0)
    kelvin = 2.5e-3 * STROKE + 5e-9
    assert part.per_kelvin(STROKE) == pytest.approx(kelvin)
    time, voltage = motion(0, 100, 0, 80, 0)
    tested = promise(warm, voltage, time, thermal=part, temperature=40.0)
    assert "temperature" not in tested.parts and tested.largest == promise(warm, voltage, time).largest
    for temperature, off in ((55.0, 10), (np.linspace(40, 5, time.size), 10), (None, 15)):
        found = promise(warm, voltage, time, thermal=part, temperature=temperature)
        assert found.parts["temperature"] == pytest.approx(off * kelvin)
        assert found.largest == pytest.approx(tested.largest + off * kelvin)
        assert found.rms == pytest.approx(tested.rms + 0.5 * off * kelvin)
        assert len(found.untested) == len(tested.untested) + 1
        assert found.half.max() == pytest.approx(tested.half.max() + off * kelvin)
    # Without the part nobody knows the amount.
    found = promise(warm, voltage, time, temperature=60.0)
    assert ("temperature" in found.parts, len(found.untested)) == (False, len(tested.untested) + 1)
    assert not promise(warm, voltage, time, temperature=46.0).untested


@pytest.mark.parametrize(
    ("tested", "used", "thermal", "needed"),
    [
        ((15.0, 45.0), (20.0, 40.0), True, ()),
        ((15.0, 45.0), (10.0, 60.0), True, (10.0, 60.0)),
        ((20.0, 21.0), (19.0, 22.5), False, ()),
        ((20.0, 21.0), (20.0, 40.0), False, (30.0, 40.0)),
    ],
)
def test_temperatures_to_record_cover_the_temperatures_in_use(tested, used, thermal, needed):
    part = Thermal(gain=1e-3, offset=0.0, reference=30.0) if thermal else None
    assert to_record(part, tested, used) == needed


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("rms_m", -1.0),
        ("speeds_V_per_s", [5.0, 1.0]),
        ("speeds_V_per_s", [-1.0, 5.0]),
        ("limits_V", [1, 0]),
        ("branches_V", [[1.0], [1.0, 2.0]]),
        ("rates_per_s", [0.0, 5e-324]),
        ("temperatures_degC", [45.0, 15.0]),
    ],
)
def test_impossible_values_are_refused(key, value):
    with pytest.raises(ModelError):
        Validity.from_dict({**TOPS.as_dict(), key: value})
