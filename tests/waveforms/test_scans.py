"""Scans: exact amplitudes, limits kept, true derivatives, whole periods; every refusal says what is possible."""

import re
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dehyst._errors import RecordError
from dehyst.waveforms import Raster, ScanPath, Steps, Triangle
from dehyst.waveforms.scan import Step

UM = 1e-6
# Height of an edge without a straight part, over acceleration and the square of its time.
EDGE = 0.25
SCANS = {
    "triangle": Triangle(5 * UM, 45 * UM, 10, turns=0.2),
    "saw-tooth": Triangle(5 * UM, 45 * UM, 10, acceleration=1.0, rising=0.8),
    "staircase": Raster(5 * UM, 45 * UM, 10, 6),
    "steps": Steps((0, 10 * UM, 20 * UM, 5 * UM), 0.05, acceleration=0.1),
}


@st.composite
def triangles(draw):
    """Draw what a triangle is made of, without limits."""
    low = draw(st.floats(-1e-3, 1e-3))
    height = draw(st.floats(1e-7, 1e-3))
    frequency = draw(st.floats(0.1, 1e4))
    rising = draw(st.floats(0.1, 0.9))
    rate = frequency * draw(st.floats(60, 900))
    return {"low": low, "high": low + height, "frequency": frequency, "rising": rising, "sample_rate": rate}


def paths(scan):
    return [scan.path(axis) for axis in scan.axes]


def kept(path, speed, acceleration):
    """Whether the samples themselves, by differences, keep the limits; between samples rounding comes in."""
    y = np.append(path.displacement, path.displacement[0]) if path.periodic else path.displacement
    lost = 8 * np.finfo(float).eps * np.abs(y).max()
    steps = np.diff(y) * path.sample_rate
    return (
        np.abs(steps).max() <= speed * (1 + 1e-8) + lost * path.sample_rate
        and np.abs(np.diff(steps)).max() * path.sample_rate
        <= acceleration * (1 + 1e-8) + 4 * lost * path.sample_rate**2
    )


@given(triangles(), st.floats(0.02, 1.0))
def test_a_triangle_reaches_its_ends_and_is_straight_between_the_turns(parts, turns):
    scan = Triangle(**parts, turns=turns)
    path, (up, down) = scan.path(), scan.branches
    assert path.range == (scan.low, scan.high)
    assert path.displacement[0] == scan.low and path.displacement[up] == scan.high
    assert path.velocity[0] == 0 and path.velocity[up] == 0
    assert len(path) == scan.samples == up + down
    assert scan.period * scan.rate == pytest.approx(scan.samples) and 1 / scan.period <= scan.frequency * (1 + 1e-9)
    for branch, edge in zip((slice(0, up), slice(up, None)), scan.edges, strict=True):
        straight = 1 - 2 * edge.blend / edge.seconds
        assert straight == pytest.approx(1 - turns, abs=1e-9)
        at_speed = int(np.count_nonzero(path.velocity[branch] == edge.speed))
        assert abs(at_speed - straight * edge.seconds * scan.rate) <= 2


@given(triangles(), st.floats(1.001, 50))
def test_turns_keep_the_acceleration_and_are_the_shortest(parts, spare):
    height, seconds = parts["high"] - parts["low"], min(parts["rising"], 1 - parts["rising"]) / parts["frequency"]
    least = height / (EDGE * seconds**2)
    scan = Triangle(**parts, acceleration=spare * least)
    path = scan.path()
    assert np.abs(path.acceleration).max() <= scan.acceleration * (1 + 1e-9)
    assert kept(path, max(abs(edge.speed) for edge in scan.edges), scan.acceleration)
    assert path.range == (scan.low, scan.high)
    assert max(edge.acceleration for edge in scan.edges) == pytest.approx(scan.acceleration, rel=1e-9)


@given(triangles(), st.floats(1e-3, 0.99), st.floats(0.3, 3), st.booleans())
def test_the_frequency_and_height_that_a_refusal_suggests_are_possible(parts, share, pace, free):
    height, seconds = parts["high"] - parts["low"], min(parts["rising"], 1 - parts["rising"]) / parts["frequency"]
    parts.pop("sample_rate")  # 400 a cycle: branches of whole samples are nearly as asked
    limits = {
        "acceleration": share * height / (EDGE * seconds**2) / 1.2,
        "speed": pace * height / seconds,
        "turns": None if free else 0.5,
    }
    with pytest.raises(RecordError, match=r"got .* try .* Hz or less in place of .*, or .* um in place of") as refusal:
        Triangle(**parts, **limits)
    frequency, micro = re.search(r"try (\S+) Hz or less in place of \S+, or (\S+) um", str(refusal.value)).groups()
    Triangle(**{**parts, "frequency": float(frequency)}, **limits)
    Triangle(**{**parts, "high": parts["low"] + float(micro) * UM}, **limits)


@pytest.mark.parametrize("name", SCANS)
def test_velocity_and_acceleration_are_derivatives_of_the_displacement(name):
    for path in paths(SCANS[name]):
        rows = [np.append(row, row[0]) if path.periodic else row for row in path.rows]
        step = 1 / path.sample_rate
        for row, slope in pairwise(rows):
            # Simpson's rule on two steps; where the acceleration jumps or bends it errs by that much and no more.
            simpson = step / 3 * (slope[:-2] + 4 * slope[1:-1] + slope[2:])
            bends = np.abs(np.diff(rows[2], 2)) * (step if slope is rows[1] else 1.0)
            miss = np.abs(row[2:] - row[:-2] - simpson)
            assert np.all(miss <= 2 * step * bends + 2e-3 * step * np.abs(slope).max())


@pytest.mark.parametrize("name", SCANS)
def test_a_periodic_scan_ends_where_it_begins(name):
    for path in paths(SCANS[name]):
        twice = path.repeated(2)
        assert len(twice) == 2 * len(path) + 1 and not twice.periodic
        assert np.array_equal(twice.displacement[: len(path)], twice.displacement[len(path) : -1])
        # From the last sample to the first it does not go farther than its speed allows.
        assert abs(path.displacement[0] - path.displacement[-1]) <= np.abs(path.velocity).max() / path.sample_rate


def test_y_of_a_raster_is_constant_on_the_forward_line():
    scan = SCANS["staircase"]
    x, y, (forth, retrace) = scan.path("x"), scan.path("y"), scan.fast.branches
    for line, level in enumerate(np.linspace(5 * UM, 45 * UM, 6)):
        start = line * (forth + retrace)
        assert np.all(y.displacement[start : start + forth] == level)
        assert np.all(y.velocity[start : start + forth] == 0)
        assert (x.displacement[start], x.displacement[start + forth]) == (5 * UM, 45 * UM)
    assert y.range == (5 * UM, 45 * UM) and y.displacement[0] == 5 * UM
    assert np.abs(y.velocity).max() <= np.abs(x.velocity).max() * (1 + 1e-9)


def test_steps_are_of_least_jerk_and_as_short_as_the_limit_allows():
    scan = Steps((0.0, 10 * UM), 0.1, acceleration=0.1, sample_rate=1e5)
    path = scan.path()
    edge = path.displacement[10_000 : 10_000 + 2404]
    s = np.arange(edge.size) / 2403
    assert np.allclose(edge, 10 * UM * (10 * s**3 - 15 * s**4 + 6 * s**5), rtol=0, atol=1e-17)
    assert 0.999 * 0.1 < np.abs(path.acceleration).max() <= 0.1
    assert np.all(path.displacement[:10_000] == 0)


@given(
    st.lists(st.floats(-1e-4, 1e-4), min_size=2, max_size=5, unique=True), st.floats(1e-5, 1e-2), st.floats(1e-3, 10)
)
def test_steps_keep_their_limits(levels, speed, acceleration):
    if min(abs(b - a) for a, b in pairwise([*levels, levels[0]])) < 1e-8:
        return
    path = Steps(levels, 1e-3, speed=speed, acceleration=acceleration).path()
    assert np.abs(path.velocity).max() <= speed * (1 + 1e-9)
    assert np.abs(path.acceleration).max() <= acceleration * (1 + 1e-9)
    assert path.range == (min(levels), max(levels))
    assert kept(path, speed, acceleration)


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.1, 10))
def test_a_step_begins_and_ends_at_rest_and_states_its_peaks(start, end, seconds):
    step = Step(start, end, seconds)
    travel = step.at(np.linspace(0, seconds, 4001))
    for row, ends in zip(travel, [(start, end), (0, 0), (0, 0)], strict=True):
        assert row[[0, -1]] == pytest.approx(ends, abs=1e-11)
    for peak, row in zip(step.peaks, travel[1:], strict=True):
        assert np.abs(row).max() == pytest.approx(peak, rel=1e-5, abs=1e-12)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Triangle(5 * UM, 5 * UM, 1),
        lambda: Triangle(5, 45, 1),
        lambda: Triangle(float("nan"), UM, 1),
        lambda: Triangle(0, UM, 0),
        lambda: Triangle(0, UM, 1, turns=1.5),
        lambda: Triangle(0, UM, 1, sample_rate=3),
        lambda: Triangle(0, UM, 1e-6, sample_rate=1e3),
        lambda: Triangle(0, UM, 1).path("y"),
        lambda: Raster(0, UM, 1, 1),
        lambda: Raster(0, UM, 1, 3, y_low=2e-6),
        lambda: Raster(0, UM, 1, 2, y_high=9e-5, speed=3e-6),
        lambda: Raster(0, 1e-8, 1e-3, 2, y_high=1e-2, acceleration=1e-9, turns=1.0),
        lambda: Steps((0,), 1, edge=1),
        lambda: Steps((0, 0, UM), 1, edge=1),
        lambda: Steps((0, UM), 1),
        lambda: Steps((0, UM), 1, edge=1e-4, acceleration=1),
        lambda: SCANS["triangle"].path().repeated(1.5),
        lambda: ScanPath([0, 1], [0], [0, 0], 1),
        lambda: ScanPath([0, np.nan], [0, 0], [0, 0], 1),
    ],
)
def test_impossible_scans_are_refused(make):
    with pytest.raises(RecordError):
        make()


def test_steps_are_possible_in_the_time_that_a_refusal_suggests():
    with pytest.raises(RecordError) as refusal:
        Steps((0, UM), 1, edge=0.01, acceleration=1e-3)
    Steps((0, UM), 1, edge=float(re.search(r"try (\S+) s", str(refusal.value))[1]), acceleration=1e-3)


@pytest.mark.parametrize("lines, acceleration", [(64, 0.2), (64, 1.0), (9000, 0.01), (9000, 0.002)])
def test_the_way_back_of_a_raster_takes_the_fewest_lines_that_its_limits_allow(lines, acceleration):
    raster = Raster(2 * UM, 3 * UM, 10, lines, y_high=5e-3, turns=0.7, speed=1.0, acceleration=acceleration)
    y = raster.path("y")

    def hardest(back):
        way = back * raster.fast.samples + raster.fast.branches[1]
        return 10 / np.sqrt(3) * (5e-3 - 2 * UM) / (way / raster.rate) ** 2

    assert 1 < raster.pause < 1000
    assert hardest(raster.pause) <= acceleration * (1 + 1e-8) < hardest(raster.pause - 1)
    way = raster.pause * raster.fast.samples + raster.fast.branches[1]
    assert np.abs(y.acceleration[-way:]).max() == pytest.approx(hardest(raster.pause), rel=1e-3)
