"""The plane of turning points: which branches of loops the records test and how fast they went."""

import itertools

import numpy as np
import pytest

from dehyst.model import branches_of, paces_of
from dehyst.model.branches import are_tested
from dehyst.trust.turn_plane import turn_plane

RATE = 100.0


def played(*ends, speed=10.0, hold=0.0):
    """Ramps between voltages, each end held for some seconds."""
    parts = []
    for begin, end in itertools.pairwise(ends):
        samples = round(abs(end - begin) / speed * RATE)
        parts += [np.linspace(begin, end, samples, endpoint=False), np.full(round(hold * RATE), float(end))]
    voltage = np.concatenate([*parts, [float(ends[-1])]])
    return np.arange(voltage.size) / RATE, voltage


def plane(*ends, **options):
    return turn_plane([("loops", *played(*ends, **options))], (0.0, 100.0))


def branch(found, begin, end):
    """Whether a rise or fall between two voltages is tested, as the promise has it."""
    return are_tested(np.array([[begin, end]]), found.rising, found.falling, found.edges)[0]


def test_loops_from_the_bottom_test_only_rises_from_the_bottom():
    found = plane(0, 100, 0, 80, 0, 60, 0, 40, 0, 20, 0)
    for upper in (100, 80, 60, 40):
        assert branch(found, 0, upper)
        assert branch(found, upper, 0) and branch(found, upper, upper / 2)
    assert not branch(found, 30, 70)
    assert not branch(found, 50, 90)
    assert all(branch(found, turn.begin, turn.end) for turn in found.path(played(0, 100, 0, 60, 0)[1]))
    path = found.path(played(0, 100, 40, 80, 40, 100)[1])
    assert sum(not branch(found, turn.begin, turn.end) for turn in path) == 2 and sum(turn.times for turn in path) == 5


def test_a_branch_is_tested_as_far_as_a_record_went():
    found = plane(0, 100, 50, 70, 0)
    assert branch(found, 50, 70) and not branch(found, 50, 95)
    # Within 5 % of the range.
    assert branch(found, 52, 71)


def test_the_first_rise_from_an_unknown_start_is_no_turn():
    found = plane(50, 100, 0)
    assert [(turn.begin, turn.end) for turn in found.turns] == [(100.0, 0.0)]
    assert not branch(found, 50, 90)


def test_speeds_and_turns_are_counted():
    found = plane(*[0, 100] * 5, 0, speed=20.0, hold=3.0)
    assert sorted(turn.times for turn in found.turns) == [5, 5]
    assert [turn.speed for turn in found.turns] == pytest.approx([20.0, 20.0], rel=1e-3)
    assert all("5 times" in turn.words for turn in found.turns)


def test_a_path_has_the_speeds_of_the_promise():
    found = plane(0, 100, 0, 100, 0, speed=20.0, hold=3.0)
    time, voltage = played(0, 100, 0, speed=30.0, hold=6.0)
    path = found.path(voltage, time)
    speeds = paces_of(time, voltage, branches_of(voltage, 100.0))[:, 0]
    assert [turn.speed for turn in path] == pytest.approx(speeds, rel=1e-9)
    assert all(np.isnan(turn.speed) for turn in found.path(voltage))


def test_a_constant_voltage_has_no_turn_plane():
    for limits in ((), ((0.0, 100.0),)):
        assert turn_plane([("rest", np.arange(10.0), np.zeros(10))], *limits) is None


def test_a_long_record_is_evaluated_in_steps():
    time = np.linspace(0, 10, 1_000_000)
    found = turn_plane([("long", time, 50 - 50 * np.cos(2 * np.pi * time))])
    assert {round(turn.end, 1) for turn in found.turns} == {0.0, 100.0}
