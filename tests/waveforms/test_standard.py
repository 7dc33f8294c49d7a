"""Excitations: they turn where they should, keep limits and slew rate, show what theory says, and what is refused."""

import math
import re
import tracemalloc
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dehyst import RecordError
from dehyst.records.signals import turning_points
from dehyst.waveforms import (
    Excitation,
    Sampling,
    descending_tops,
    excitation,
    homing,
    raised_cosine,
    recommended,
    staircase,
)
from examples import examples

KINDS = {
    "raised cosine": partial(raised_cosine, [200.0, 80.0], cycles=2),
    "descending tops": partial(descending_tops, 200.0),
    "recommended": partial(recommended, 200.0),
    "staircase": partial(staircase, 200.0),
    "homing": partial(homing, 200.0),
    "homing through turns": partial(homing, turns=[150.0, 30.0, 120.0]),
}
every_kind = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)


def log_uniform(low, high):
    return st.floats(math.log(low), math.log(high)).map(math.exp)


@st.composite
def drives(draw):
    """Any way to play voltages of some 100 V; a slew rate that stretches nothing, some branches, or a hundredfold."""
    frequency = draw(log_uniform(1e-4, 1e4))
    base = draw(st.sampled_from([0.0, -20.0]) | st.floats(-300, 300))
    return Sampling(
        frequency=frequency,
        sample_rate=draw(st.none() | log_uniform(8.001 * frequency, 300 * frequency)),
        base=base,
        present=draw(st.none() | st.just(base) | st.floats(-300, 300)),
        limits=draw(st.none() | st.just((-1000.0, 1000.0))),
        slew_rate=draw(st.none() | log_uniform(10 * frequency, 1e5 * frequency)),
    )


def make_cycles(draw, drive, top, n):
    peaks = [top, *draw(st.lists(st.floats(drive.base + 0.1, drive.base + 400), max_size=3))]
    return raised_cosine(peaks, cycles=n, drive=drive), [v for p in peaks for v in [p, drive.base] * n]


def make_tops(draw, drive, top, n):
    m, base = draw(st.integers(0, 2)), drive.base
    falling = [v for k in range(n, 0, -1) for v in (base + (top - base) * k / n, base)]
    return descending_tops(top, steps=n, majors=m, drive=drive), [top, base] * m + falling


def make_stairs(draw, drive, top, n):
    hold = draw(log_uniform(0.01, 3))
    return staircase(top, steps=n, hold=hold / drive.frequency, drive=drive), [top, drive.base]


def make_homing(draw, drive, top, n):
    return homing(top, drive=drive), [top, drive.base]


def make_turns(draw, drive, top, n):
    turns = [drive.base + 0.1 + 10 * k * (-1) ** k for k in range(1, n + 2)]
    return homing(turns=turns, drive=drive), turns


MAKERS = (make_cycles, make_tops, make_stairs, make_homing, make_turns)


@st.composite
def played(draw):
    """A drive, an excitation by it, and the turning points it should have from its start on."""
    drive, make = draw(drives()), draw(st.sampled_from(MAKERS))
    made, turns = make(draw, drive, draw(st.floats(drive.base + 0.1, drive.base + 400)), draw(st.integers(1, 6)))
    return drive, made, [drive.start, *([] if make is make_turns else [drive.base]), *turns]


def reversals_of(path):
    """The path's ends and the voltages at which it turns."""
    kept = path[:1]
    for v in path[1:]:
        if len(kept) > 1 and (v > kept[-1]) == (kept[-1] > kept[-2]):
            kept[-1] = v
        elif v != kept[-1]:
            kept.append(v)
    return kept


class TestLaws:
    @given(played())
    def test_an_excitation_has_exactly_its_turning_points(self, case):
        _, made, path = case
        np.testing.assert_allclose(made.turns, reversals_of(path), rtol=1e-13, atol=1e-13)
        assert made.voltage[-1] == path[-1]
        if made.name != "staircase":
            # By the record's own search, which takes a voltage that pauses for one that turns.
            found = turning_points(made.voltage, 0.0)
            np.testing.assert_array_equal(made.voltage[found], made.turns[1:-1])

    @given(played())
    def test_limits_slew_rate_and_uniform_time_are_kept(self, case):
        drive, made, _ = case
        check_laws(drive, made)

    @given(st.data())
    @examples(30, nightly=300)
    def test_any_accepted_numbers_keep_the_laws(self, data):
        """Numbers of any size: refused with a sentence, or played within the laws."""
        anything = st.floats() | log_uniform(1e-14, 1e14) | st.floats(-1e3, 1e3) | st.sampled_from([0.0, 1e6, 5e-324])
        options = {
            name: data.draw(anything)
            for name in ("frequency", "sample_rate", "slew_rate", "base", "present")
            if data.draw(st.booleans())
        }
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(excitation, "_MOST_SAMPLES", 100_000)
            try:
                drive = Sampling(**options)
                result = homing(turns=[data.draw(anything), data.draw(anything)], drive=drive)
            except RecordError:
                return
        check_laws(drive, result)

    @given(played())
    def test_without_a_slew_rate_each_branch_takes_half_a_period(self, case):
        drive, made, path = case
        assert not made.warnings or drive.slew_rate is not None
        if made.warnings or made.name == "staircase" or drive.start != drive.base:
            return
        branches = np.count_nonzero(np.diff(path))
        assert made.duration == pytest.approx(branches * drive.half, abs=branches * 0.5 / drive.rate)


def check_laws(drive, excitation):
    v = excitation.voltage
    assert np.isfinite(v).all()
    assert v[0] == drive.start
    low, high = drive.limits or (-1e6, 1e6)
    assert low <= v.min() <= v.max() <= high
    assert excitation.sample_rate == drive.rate
    np.testing.assert_array_equal(excitation.time, np.arange(len(v)) / drive.rate)
    assert excitation.time[-1] == excitation.duration
    if drive.slew_rate is not None:
        assert np.abs(np.diff(v)).max() * drive.rate <= drive.slew_rate * (1 + 1e-9)


class TestKinds:
    def test_the_raised_cosine_is_that_of_the_paper(self):
        """v = v0/2 - v0/2 cos(2 pi t / T0), 200 V at 0.01 Hz."""
        made = raised_cosine(200.0, cycles=3)
        assert len(made) == 1201
        assert made.duration == 300.0
        np.testing.assert_allclose(made.voltage, 100 - 100 * np.cos(2 * np.pi * 0.01 * made.time), atol=1e-12)
        np.testing.assert_array_equal(made.voltage[:401:200], [0, 200, 0])
        np.testing.assert_array_equal(made.voltage[401:801], made.voltage[1:401])

    def test_staircase_holds_every_level(self):
        made = staircase(200.0, steps=4, hold=30.0)
        levels = [0, 50, 100, 150, 200, 150, 100, 50, 0]
        assert made.duration == 100 + 8 * 30
        v = made.voltage
        start = np.flatnonzero(np.diff(v, prepend=np.nan) != 0)
        runs = np.diff([*start, len(v)])
        np.testing.assert_array_equal(v[start][runs > 1], levels[1:])
        # A hold of 30 s and the sample that reaches the level.
        np.testing.assert_array_equal(runs[runs > 1], 121)
        assert made.turns.tolist() == [0, 200, 0]

    def test_a_staircase_can_have_steps_back(self):
        made = staircase(200.0, steps=4, hold=30.0, back=True)
        held = made.voltage[1:][np.diff(made.voltage) == 0]
        levels = held[np.concatenate([[True], np.diff(held) != 0])]
        assert levels == pytest.approx([100, 50, 150, 100, 200, 100, 150, 50, 100, 0])

    @pytest.mark.parametrize("slew_rate", [None, 50.0])
    def test_recommended_has_random_turns_at_three_speeds_and_two_holds(self, slew_rate):
        made = recommended(100.0, drive=Sampling(0.1, slew_rate=slew_rate))
        assert made.duration <= 240 and made.warnings == ()
        held = np.flatnonzero(np.diff(made.voltage) == 0)
        starts = held[np.diff(held, prepend=-9) > 1]
        # A hold of 30 s at the top, and one within the turning points.
        assert np.count_nonzero(np.diff(np.flatnonzero(np.diff(made.voltage) == 0)) > 1) == 1
        assert made.voltage[starts[0]] == 100 and 70 < made.voltage[starts[1]] < 75
        speeds = np.abs(np.diff(made.voltage)) * made.sample_rate
        slow, fast = speeds[: starts[1]].max(), speeds[held[-1] :].max()
        assert fast > (10 if slew_rate is None else 1.2) * slow

    def test_recommended_is_slower_if_the_sample_rate_is_low(self):
        made = recommended(100.0, drive=Sampling(0.1, sample_rate=4.0))
        assert np.abs(np.diff(made.voltage)).max() < 60 and made.turns.size > 55 and len(made.warnings) == 1

    def test_a_slew_rate_states_the_duration_without_it(self):
        made = recommended(120.0, drive=Sampling(0.1, sample_rate=100.0, slew_rate=20.0))
        now, free = re.search(r"([\d.]+) s instead of ([\d.]+) s in all", made.warnings[0]).groups()
        assert float(now) == pytest.approx(made.duration, abs=0.011)
        assert float(free) == recommended(120.0, drive=Sampling(0.1, sample_rate=100.0)).duration


class TestRamps:
    @every_kind
    def test_an_excitation_begins_with_a_ramp_from_the_present_voltage(self, kind):
        plain, ramped = kind(), kind(drive=Sampling(present=-40.0))
        assert ramped.voltage[0] == -40
        if "turns" in kind.keywords:
            return
        begin = len(ramped) - len(plain)
        np.testing.assert_array_equal(ramped.voltage[begin:], plain.voltage)
        assert np.all(np.diff(ramped.voltage[: begin + 1]) > 0)
        # As steep on average as the highest branch, of 200 V in 50 s.
        assert ramped.time[begin] == pytest.approx(10)


class TestSlewRate:
    def test_a_branch_with_exactly_the_slew_rate_does_not_change(self):
        cosine = raised_cosine(200.0, drive=Sampling(slew_rate=2 * math.pi))
        assert (cosine.warnings, cosine.duration) == ((), 100.0)

    def test_only_branches_that_are_too_steep_take_longer(self):
        made = raised_cosine([200.0, 50.0], drive=Sampling(slew_rate=math.pi))
        assert made.duration == pytest.approx(300.0, abs=0.5)
        assert len(made.warnings) == 1
        assert np.abs(np.diff(made.voltage[-401:])).max() == pytest.approx(0.25 * math.pi / 2, rel=1e-3)


class TestLimits:
    @every_kind
    def test_an_excitation_beyond_the_limits_is_refused(self, kind):
        with pytest.raises(RecordError):
            kind(drive=Sampling(limits=(-10.0, 100.0)))
        assert kind(drive=Sampling(limits=(0.0, 200.0))).voltage.min() >= 0


@pytest.mark.parametrize(
    "options",
    [
        {"frequency": 0},
        {"frequency": math.nan},
        {"frequency": None},
        {"sample_rate": -1.0},
        {"sample_rate": 0.07},
        {"slew_rate": 0.0},
        {"slew_rate": True},
        {"base": "0"},
        {"base": 2e6},
        {"present": math.inf},
        {"present": 201.0, "limits": (0, 200)},
        {"base": -1.0, "limits": (0, 200)},
        {"limits": (200, 0)},
        {"limits": 200.0},
        {"limits": (0, 1, 2)},
        {"limits": (0, math.nan)},
        {"limits": "ab"},
    ],
)
def test_impossible_samplings_are_refused(options):
    with pytest.raises(RecordError):
        Sampling(**options)


PEAKS = ([], [0.0], -5.0, [10.0, 0.0], [10.0, math.nan], math.inf, "200", [[1.0, 2.0]], None, [True])


@pytest.mark.parametrize(
    "make",
    [
        *(lambda peaks=peaks: raised_cosine(peaks) for peaks in PEAKS),
        lambda: raised_cosine(1.0, cycles=0),
        lambda: raised_cosine(1.0, cycles=10**12),
        lambda: raised_cosine(np.ones(10_000), cycles=1000),
        lambda: raised_cosine(200.0, drive=Sampling(slew_rate=1e-10, sample_rate=1e6)),
        lambda: descending_tops(1.0, steps=2.0),
        lambda: descending_tops(1.0, majors=-1),
        lambda: descending_tops(0.0),
        lambda: descending_tops(math.nan),
        lambda: descending_tops(1e-323, steps=10),
        lambda: recommended(0.0),
        lambda: staircase(1.0, hold=0),
        lambda: staircase(1.0, steps=0),
        homing,
        lambda: homing(5.0, turns=[1.0]),
        lambda: homing(turns=[]),
        lambda: homing(turns=[0.0]),
        lambda: homing(turns=[3.0, 3.0]),
        lambda: homing(turns=["a"]),
        lambda: Excitation("mine", [1.0], 1.0),
        lambda: Excitation("mine", [1.0, 2.0], 0.0),
    ],
)
def test_impossible_excitations_are_refused(make):
    with pytest.raises(RecordError):
        make()


@pytest.mark.parametrize(
    "make",
    [
        lambda: raised_cosine(1.0, cycles=10_000, drive=Sampling(sample_rate=1000.0)),
        lambda: raised_cosine(1.0, drive=Sampling(frequency=1e-12, sample_rate=1e12)),
        lambda: raised_cosine(200.0, drive=Sampling(slew_rate=1e-6)),
        lambda: staircase(1.0, hold=1e12),
    ],
)
def test_a_too_long_excitation_is_refused_before_memory_is_allocated(make):
    tracemalloc.start()
    try:
        with pytest.raises(RecordError):
            make()
        assert tracemalloc.get_traced_memory()[1] < 10e6
    finally:
        tracemalloc.stop()


def test_voltages_cannot_be_changed_afterwards():
    made = raised_cosine(10.0)
    with pytest.raises(ValueError, match="read-only"):
        made.voltage[0] = 1.0
    assert repr(made) == "<Excitation 'raised-cosine': 401 samples, 100 s, 0 to 10 V>"


def test_an_excitation_copies_the_given_voltage():
    given_away = np.array([0.0, 1.0, 0.5])
    own = Excitation("own", given_away, 4)
    given_away[1] = 9.0
    assert own.turns.tolist() == [0, 1, 0.5]
