"""Scans: exact amplitudes, limits kept, true derivatives, whole periods; every refusal says what is possible."""

import re
from itertools import pairwise
from math import pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dehyst._errors import RecordError
from dehyst.waveforms import Lissajous, Raster, ScanPath, Spiral, Steps, Triangle
from dehyst.waveforms.scan import Bridge, Edge, PathPoint, highest, least_blend, least_seconds

UM = 1e-6
ROUNDINGS = st.sampled_from(["parabola", "cosine"])
SCANS = {
    "triangle": Triangle(5 * UM, 45 * UM, 10, turns=0.2),
    "cosine": Triangle(5 * UM, 45 * UM, 10, turns=0.3, rounding="cosine"),
    "saw-tooth": Triangle(5 * UM, 45 * UM, 10, acceleration=1.0, rising=0.8),
    "staircase": Raster(5 * UM, 45 * UM, 10, 6),
    "ramp": Raster(5 * UM, 45 * UM, 10, 6, slow="ramp", y_low=0.0, y_high=10 * UM),
    "linear": Spiral(20 * UM, 4, 1, rounding="cosine", centre=(1 * UM, 2 * UM)),
    "angular": Spiral(20 * UM, 4, 1, constant="angular", rounding="cosine"),
    "lissajous": Lissajous((20 * UM, 10 * UM), 1, (3, 4)),
    "steps": Steps((0, 10 * UM, 20 * UM, 5 * UM), 0.05, acceleration=0.1),
    "trapezoid": Steps((0, 10 * UM, 5 * UM), 0.05, acceleration=0.1, speed=5e-4, shape="trapezoid"),
    "open": Steps((0, 10 * UM), 0.05, edge=0.1, closed=False),
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


@given(triangles(), st.floats(0.02, 1.0), ROUNDINGS)
def test_a_triangle_turns_exactly_and_is_straight_for_its_share(parts, turns, rounding):
    scan = Triangle(**parts, turns=turns, rounding=rounding)
    path, (up, down) = scan.path(), scan.legs
    assert path.range == (scan.low, scan.high)
    assert path.displacement[0] == scan.low and path.displacement[up] == scan.high
    assert path.velocity[0] == 0 and path.velocity[up] == 0
    assert len(path) == scan.samples == up + down
    assert scan.period * scan.rate == pytest.approx(scan.samples) and 1 / scan.period <= scan.frequency * (1 + 1e-9)
    for leg, edge in zip((slice(0, up), slice(up, None)), scan.edges, strict=True):
        straight = 1 - 2 * edge.blend / edge.seconds
        assert straight == pytest.approx(1 - turns, abs=1e-9)
        at_speed = int(np.count_nonzero(path.velocity[leg] == edge.speed))
        assert abs(at_speed - straight * edge.seconds * scan.rate) <= 2


@given(triangles(), st.floats(1.001, 50), ROUNDINGS)
def test_turns_within_an_acceleration_keep_it_and_are_the_shortest(parts, spare, rounding):
    height, seconds = parts["high"] - parts["low"], min(parts["rising"], 1 - parts["rising"]) / parts["frequency"]
    least = height / highest(seconds, None, 1.0, rounding)
    scan = Triangle(**parts, acceleration=spare * least, rounding=rounding)
    path = scan.path()
    assert np.abs(path.acceleration).max() <= scan.acceleration * (1 + 1e-9)
    assert kept(path, max(abs(edge.speed) for edge in scan.edges), scan.acceleration)
    assert path.range == (scan.low, scan.high)
    assert max(edge.acceleration for edge in scan.edges) == pytest.approx(scan.acceleration, rel=1e-9)


@given(st.floats(1e-8, 1e-3), st.floats(1e-4, 10), st.floats(0.1, 10), st.floats(0.1, 10), ROUNDINGS)
def test_least_seconds_and_highest_are_each_others_inverse(height, seconds, v, a, rounding):
    speed, acceleration = v * height / seconds, a * height / seconds**2
    least = least_seconds(height, speed, acceleration, rounding)
    assert highest(least, speed, acceleration, rounding) == pytest.approx(height, rel=1e-9)
    edge = Edge(0.0, height, least, least_blend(height, least, acceleration, rounding), rounding)
    assert edge.speed <= speed * (1 + 1e-7) and edge.acceleration <= acceleration * (1 + 1e-7)
    assert edge.speed >= speed * (1 - 1e-6) or edge.acceleration >= acceleration * (1 - 1e-6)


@given(triangles(), st.floats(1e-3, 0.99), st.floats(0.3, 3), st.booleans(), ROUNDINGS)
def test_what_a_refusal_says_is_possible_is(parts, share, pace, free, rounding):
    height, seconds = parts["high"] - parts["low"], min(parts["rising"], 1 - parts["rising"]) / parts["frequency"]
    parts.pop("sample_rate")  # 400 a cycle: legs of whole samples are nearly as asked
    limits = {
        "acceleration": share * height / highest(seconds, None, 1.0, rounding) / 1.2,
        "speed": pace * height / seconds,
        "turns": None if free else 0.5,
        "rounding": rounding,
    }
    with pytest.raises(RecordError, match=r"got .* try .* Hz or less in place of .*, or .* um in place of") as refusal:
        Triangle(**parts, **limits)
    frequency, micro = re.search(r"try (\S+) Hz or less in place of \S+, or (\S+) um", str(refusal.value)).groups()
    Triangle(**{**parts, "frequency": float(frequency)}, **limits)
    Triangle(**{**parts, "high": parts["low"] + float(micro) * UM}, **limits)


@pytest.mark.parametrize("name", SCANS)
def test_displacement_velocity_and_acceleration_belong_together(name):
    for path in paths(SCANS[name]):
        rows = [np.append(row, row[0]) if path.periodic else row for row in path.rows]
        step = 1 / path.sample_rate
        for row, slope in pairwise(rows):
            # Simpson's rule on two steps; where the acceleration jumps or bends it errs by that much and no more.
            simpson = step / 3 * (slope[:-2] + 4 * slope[1:-1] + slope[2:])
            bends = np.abs(np.diff(rows[2], 2)) * (step if slope is rows[1] else 1.0)
            miss = np.abs(row[2:] - row[:-2] - simpson)
            assert np.all(miss <= 2 * step * bends + 2e-3 * step * np.abs(slope).max())


@pytest.mark.parametrize("name", [name for name in SCANS if name != "open"])
def test_a_periodic_scan_goes_on_where_it_began(name):
    for path in paths(SCANS[name]):
        twice = path.repeated(2)
        assert len(twice) == 2 * len(path) + 1 and not twice.periodic
        assert np.array_equal(twice.displacement[: len(path)], twice.displacement[len(path) : -1])
        # From the last sample to the first it does not go farther than its speed allows.
        assert abs(path.displacement[0] - path.displacement[-1]) <= np.abs(path.velocity).max() / path.sample_rate


def test_a_raster_stands_still_along_y_on_the_way_forth():
    scan = SCANS["staircase"]
    x, y, (forth, retrace) = scan.path("x"), scan.path("y"), scan.fast.legs
    for line, level in enumerate(np.linspace(5 * UM, 45 * UM, 6)):
        start = line * (forth + retrace)
        assert np.all(y.displacement[start : start + forth] == level)
        assert np.all(y.velocity[start : start + forth] == 0)
        assert (x.displacement[start], x.displacement[start + forth]) == (5 * UM, 45 * UM)
    assert y.range == (5 * UM, 45 * UM) and y.displacement[0] == 5 * UM
    assert np.abs(y.velocity).max() <= np.abs(x.velocity).max() * (1 + 1e-9)


def test_a_ramp_is_straight_along_all_lines_and_comes_back_smoothly():
    scan = SCANS["ramp"]
    y, straight = scan.path("y"), scan.lines * scan.fast.samples
    assert np.ptp(y.velocity[:straight]) == 0
    assert np.allclose(np.diff(y.displacement[:straight]), y.velocity[0] / scan.rate, rtol=0, atol=1e-19)
    assert y.displacement[0] == 0 and y.displacement[straight] == 10 * UM
    assert abs(y.velocity[-1] - y.velocity[0]) <= np.abs(np.diff(y.velocity)).max()


@pytest.mark.parametrize("rounding", ["parabola", "cosine"])
def test_a_spiral_of_constant_linear_speed_goes_equal_ways_in_equal_times(rounding):
    scan = Spiral(20 * UM, 5, 2, rounding=rounding, sample_rate=2e5)
    x, y = paths(scan)
    speed = np.hypot(x.velocity, y.velocity)
    assert np.ptp(speed) <= 1e-12 * speed.mean()
    chords = np.hypot(np.diff(x.displacement), np.diff(y.displacement)) * scan.rate
    # A chord is shorter than its arc by the square of the angle through which it bends.
    bends = np.hypot(x.acceleration, y.acceleration)[:-1] / speed[:-1] / scan.rate
    assert np.all(np.abs(chords / speed.mean() - 1) <= bends**2 / 12 + 1e-9)


def test_a_spiral_of_constant_angular_speed_turns_evenly_on_even_tracks():
    scan = SCANS["angular"]
    x, y = paths(scan)
    out = slice(20, scan.samples // 2 - 200)
    angle = np.unwrap(np.arctan2(y.displacement, x.displacement)[out])
    turning = 2 * pi * (2 * 4 + 0.5) / scan.samples
    assert np.allclose(np.diff(angle), turning, rtol=0, atol=1e-12)
    r = np.hypot(x.displacement, y.displacement)
    # 4.25 tracks reach the rim, where a tenth of the angle turns back.
    pitch = 20 * UM / 4.25 / (1 - 0.1 * (0.5 - 2 / pi**2))
    assert np.allclose(np.diff(r[out]), pitch * turning / (2 * pi), rtol=1e-9)
    assert r.max() == pytest.approx(20 * UM, rel=1e-12)


def test_lissajous_figures_are_sines():
    x, y = paths(SCANS["lissajous"])
    t = x.time
    assert np.allclose(x.displacement, 20 * UM * np.sin(6 * pi * t), rtol=0, atol=1e-18)
    assert np.allclose(y.displacement, 10 * UM * np.sin(8 * pi * t), rtol=0, atol=1e-18)
    assert np.allclose(y.acceleration, -((8 * pi) ** 2) * y.displacement, rtol=1e-12)


def retraced(scan):
    """How far a figure gone round backwards lies from itself at least, over the amplitude, for any beginning."""
    points = np.array([path.displacement / UM for path in paths(scan)])
    backwards = points[:, ::-1]
    return min(np.abs(np.roll(backwards, k, axis=1) - points).max() for k in range(points.shape[1]))


@pytest.mark.parametrize("ratio", [(1, 1), (1, 2), (2, 1), (3, 4), (4, 3), (5, 6), (3, 5)])
def test_a_figure_does_not_come_back_on_its_own_line_unless_asked_to(ratio):
    figure = Lissajous((UM, UM), 1, ratio, sample_rate=120 * max(ratio) * ratio[0])
    apart = retraced(figure)
    assert apart > 0.1
    half = pi / ratio[0] / 2
    assert retraced(Lissajous((UM, UM), 1, ratio, figure.phase + half, sample_rate=figure.rate)) < 0.2 * apart
    # Widest: to either side it is no farther apart.
    for phase in (figure.phase - 0.3 * half, figure.phase + 0.3 * half):
        assert retraced(Lissajous((UM, UM), 1, ratio, phase, sample_rate=figure.rate)) < apart


def test_steps_are_of_least_jerk_and_as_short_as_the_limit_allows():
    scan = Steps((0.0, 10 * UM), 0.1, acceleration=0.1, sample_rate=1e5)
    path = scan.path()
    edge = path.displacement[10_000 : 10_000 + 2404]
    s = np.arange(edge.size) / 2403
    assert np.allclose(edge, 10 * UM * (10 * s**3 - 15 * s**4 + 6 * s**5), rtol=0, atol=1e-17)
    assert 0.999 * 0.1 < np.abs(path.acceleration).max() <= 0.1
    assert np.all(path.displacement[:10_000] == 0)


@given(
    st.lists(st.floats(-1e-4, 1e-4), min_size=2, max_size=5, unique=True),
    st.sampled_from(["minimum-jerk", "trapezoid"]),
    st.floats(1e-5, 1e-2),
    st.floats(1e-3, 10),
)
def test_steps_keep_their_limits(levels, shape, speed, acceleration):
    if min(abs(b - a) for a, b in pairwise([*levels, levels[0]])) < 1e-8:
        return
    path = Steps(levels, 1e-3, shape=shape, speed=speed, acceleration=acceleration).path()
    assert np.abs(path.velocity).max() <= speed * (1 + 1e-9)
    assert np.abs(path.acceleration).max() <= acceleration * (1 + 1e-9)
    assert path.range == (min(levels), max(levels))
    assert kept(path, speed, acceleration)


@given(st.lists(st.floats(-1, 1), min_size=6, max_size=6), st.floats(0.1, 10))
def test_a_bridge_joins_two_motions_and_knows_its_peaks(numbers, seconds):
    bridge = Bridge(PathPoint(*numbers[:3]), PathPoint(*numbers[3:]), seconds)
    travel = bridge.at(np.linspace(0, seconds, 4001))
    for row, first, last in zip(travel, numbers[:3], numbers[3:], strict=True):
        assert row[0] == pytest.approx(first, abs=1e-9) and row[-1] == pytest.approx(last, abs=1e-8)
    for peak, row in zip(bridge.peaks, travel[1:], strict=True):
        found = np.abs(row).max()
        assert found <= peak * (1 + 1e-9) and peak <= found + 1e-3 * (1 + peak)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Triangle(5 * UM, 5 * UM, 1),
        lambda: Triangle(5, 45, 1),
        lambda: Triangle(float("nan"), UM, 1),
        lambda: Triangle(0, UM, 0),
        lambda: Triangle(0, UM, 1, turns=1.5),
        lambda: Triangle(0, UM, 1, rounding="sharp"),
        lambda: Triangle(0, UM, 1, sample_rate=3),
        lambda: Triangle(0, UM, 1e-6, sample_rate=1e3),
        lambda: Triangle(0, UM, 1).path("y"),
        lambda: Raster(0, UM, 1, 1),
        lambda: Raster(0, UM, 1, 3, y_low=2e-6),
        lambda: Raster(0, UM, 1, 2, y_high=9e-5, speed=3e-6),
        lambda: Raster(0, UM, 1, 9, y_high=9e-5, speed=3e-6, slow="ramp"),
        lambda: Raster(0, UM, 10, 9, back=0, acceleration=2e-3, y_high=4e-6),
        lambda: Spiral(UM, 0, 1),
        lambda: Spiral(UM, 3, 1, speed=1e-6),
        lambda: Lissajous((UM, UM), 1, (2, 4)),
        lambda: Lissajous((UM, UM), 1, phase="x"),
        lambda: Lissajous((UM, UM), 9, acceleration=1e-3),
        lambda: Steps((0,), 1, edge=1),
        lambda: Steps((0, 0, UM), 1, edge=1),
        lambda: Steps((0, UM), 1),
        lambda: Steps((0, UM), 1, edge=1e-4, acceleration=1),
        lambda: SCANS["open"].path().repeated(2),
        lambda: SCANS["triangle"].path().repeated(1.5),
        lambda: ScanPath([0, 1], [0], [0, 0], 1),
        lambda: ScanPath([0, np.nan], [0, 0], [0, 0], 1),
    ],
)
def test_what_cannot_be_is_refused(make):
    with pytest.raises(RecordError):
        make()


def test_a_spiral_and_a_figure_can_be_had_at_the_frequency_that_is_said():
    for make in (
        lambda f: Spiral(20 * UM, 3, f, acceleration=0.05),
        lambda f: Lissajous((UM, UM), f, (3, 4), acceleration=1e-3),
        lambda f: Steps((0, UM), 1, edge=1 / f, acceleration=1e-3),
    ):
        with pytest.raises(RecordError) as refusal:
            make(30.0)
        number, unit = re.search(r"try (\S+) (Hz|s)", str(refusal.value)).groups()
        make(float(number) if unit == "Hz" else 1 / float(number))


@pytest.mark.parametrize("slow", ["staircase", "ramp"])
@pytest.mark.parametrize("lines, acceleration", [(64, 0.2), (64, 1.0), (9000, 0.01), (9000, 0.002)])
def test_a_raster_goes_back_in_as_few_lines_as_its_limits_allow(slow, lines, acceleration):
    given = {"y_high": 5e-3, "slow": slow, "turns": 0.7}
    raster = Raster(2 * UM, 3 * UM, 10, lines, **given, speed=1.0, acceleration=acceleration)

    def hardest(back):
        free = Raster(2 * UM, 3 * UM, 10, lines, **given, back=back)
        way = back * free.fast.samples + (free.fast.legs[1] if slow == "staircase" else 0)
        return np.abs(free.path("y").acceleration[-way:]).max()

    assert 1 < raster.pause < 1000
    assert hardest(raster.pause) <= acceleration * (1 + 1e-8) < hardest(raster.pause - 1)
