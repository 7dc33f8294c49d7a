"""Record: what is refused, what is measured on it, and that its turning points are the right ones."""

import html
import pickle
import time

import numpy as np
import places
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dehyst._errors import RecordError
from dehyst.records import Record
from dehyst.records.signals import resolution, white_noise

DATA = places.DATA
rng = np.random.default_rng(885)


def lagging(n=2000, cycles=5, lag=0.2, noise=0.0, points=None):
    """A sine drive of 0-100 V from its minimum, and 10 um that lag behind by `lag` radians."""
    phase = 2 * np.pi * cycles * np.arange(n + 1) / n
    displacement = 5e-6 * (1 - np.cos(phase - lag)) + noise * np.random.default_rng(1).normal(size=n + 1)
    return Record(np.arange(n + 1) * 1e-3, 50 * (1 - np.cos(phase)), displacement, "made")


def with_displacement(record, displacement):
    return Record(record.time, record.voltage, displacement, record.name)


def p885(name):
    t, v, y = np.loadtxt(DATA / name, delimiter=",", skiprows=1, unpack=True)
    return Record(t, v, y * 1e-6, name)


def test_keeps_read_only_copies():
    v = [0, 1, 2]
    source = np.array([0.0, 1e-6, 2e-6])
    record = Record([0, 1, 2], v, source, meta={"source": "a.csv"})
    source[0] = 7
    assert record.displacement[0] == 0.0
    assert record.voltage.dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        record.time[0] = 3
    with pytest.raises(AttributeError):
        record.name = "other"
    again = pickle.loads(pickle.dumps(record))
    assert again.meta == {"source": "a.csv"}
    assert np.array_equal(again.voltage, record.voltage)


@pytest.mark.parametrize(
    "columns",
    [
        ([0, 1, 2], [0, 1], [0, 1, 2]),
        ([0, 1], [[0], [1]], [0, 1]),
        ([0], [0], [0]),
        ([0, 1], ["a", "b"], [0, 1]),
        ([0, 1, 2], [0, np.nan, np.nan], [0, 1, 2]),
        ([0, 1, 2], [0, 1, 2], [0, 1, -np.inf]),
        ([0, 0.1, 0.1], [0, 1, 2], [0, 1, 2]),
        ([0, 0.2, 0.1], [0, 1, 2], [0, 1, 2]),
    ],
)
def test_refuses_at_construction(columns):
    with pytest.raises(RecordError):
        Record(*columns)


@pytest.mark.parametrize(
    "ask",
    [
        lambda record: record.reversals("current"),
        lambda record: record.reversals(band=-1.0),
        lambda record: record[::2],
        lambda record: record[0],
        lambda record: record.between(7, 9),
        lambda record: record.resample(5.0),
        lambda record: record.resample(0.0),
        lambda record: record.resample(0.01, "cubic"),
        lambda record: record.delayed(float("nan")),
        lambda record: record.check_usable(min_cycles=6),
        lambda record: record[:200].check_usable(),
        lambda record: record[:11].check_usable(),
    ],
)
def test_what_a_record_cannot_be_asked(ask):
    with pytest.raises(RecordError):
        ask(lagging())


def test_tells_what_it_is():
    record = lagging()
    assert len(record) == 2001
    assert record.sample_time == pytest.approx(1e-3)
    assert record.voltage_range == pytest.approx((0, 100))
    assert record.displacement_range == pytest.approx((0, 1e-5), abs=1e-10)
    assert record.stroke == pytest.approx(1e-5, rel=1e-4)


def test_gaps():
    t = np.arange(100) * 0.01
    t[40:] += 0.5
    record = Record(t, np.sin(t), np.sin(t))
    assert record.gaps() == [(39, pytest.approx(0.51))]
    assert lagging().gaps() == []


@given(st.integers(50, 400), st.floats(0, 6.2))
def test_smooth_data_have_no_noise(points, phase):
    y = 3e-6 * np.sin(phase + 2 * np.pi * np.arange(4 * points) / points)
    assert white_noise(y) <= 1e-6 * np.ptp(y)


@given(st.floats(1e-9, 1e-6), st.integers(0, 1000))
def test_noise_is_recovered(sigma, seed):
    y = 5e-6 * np.sin(2 * np.pi * np.arange(4000) / 200) + sigma * np.random.default_rng(seed).normal(size=4000)
    assert white_noise(y) == pytest.approx(sigma, rel=0.2)


@pytest.mark.parametrize("levels", [8, 50, 1000, 65536])
def test_noise_of_quantised_data_is_below_a_step(levels):
    y = np.sin(2 * np.pi * np.arange(5000) / 1000)
    step = 2 / levels
    assert white_noise(step * np.round(y / step)) <= step
    dithered = y + step * np.random.default_rng(2).normal(size=5000)
    assert white_noise(step * np.round(dithered / step)) == pytest.approx(step * np.sqrt(1 + 1 / 12), rel=0.2)


def test_noise_ignores_outliers_and_short_records():
    y = np.sin(np.arange(1000) / 50) + 0.01 * np.random.default_rng(3).normal(size=1000)
    y[::100] += 5
    assert white_noise(y) == pytest.approx(0.01, rel=0.2)
    assert white_noise(np.array([0.0, 1.0, 0.0])) == 0.0


def test_reversals_of_a_triangle():
    v = np.concatenate([np.arange(0, 100), np.arange(100, 20, -1), np.arange(20, 60), np.arange(60, -1, -1)])
    record = Record(np.arange(len(v)), v, v * 1e-8)
    assert v[record.reversals()].tolist() == [100, 20, 60]
    assert v[record.reversals(band=39.9)].tolist() == [100, 20, 60]
    assert v[record.reversals(band=40)].tolist() == [100]
    assert record.reversals("displacement").tolist() == record.reversals().tolist()


def test_reversals_take_the_last_sample_of_a_hold():
    v = np.array([0, 0, 1, 2, 3, 3, 3, 2, 1, 0, 0, 1, 2], dtype=float)
    assert Record(np.arange(13), v, v).reversals(band=0.5).tolist() == [6, 10]


def zigzag(heights):
    """Alternate up and down by the heights, 40 samples a leg."""
    corners = np.concatenate([[0.0], np.cumsum(np.where(np.arange(len(heights)) % 2, -1, 1) * heights)])
    return np.interp(np.arange(40 * len(heights) + 1), 40 * np.arange(len(corners)), corners)


heights = st.lists(st.floats(1, 5), min_size=2, max_size=12).map(np.array)


@given(heights)
def test_reversals_are_the_corners(legs):
    v = zigzag(legs)
    assert Record(np.arange(len(v)), v, v).reversals(band=0.5).tolist() == list(range(40, len(v) - 1, 40))


@given(heights, st.integers(0, 1000))
def test_reversals_withstand_noise(legs, seed):
    v = zigzag(legs)
    noisy = v + np.random.default_rng(seed).uniform(-0.1, 0.1, len(v))
    turns = Record(np.arange(len(v)), noisy, v).reversals(band=0.5)
    expected = np.arange(40, len(v) - 1, 40)
    assert len(turns) == len(expected)
    assert np.all(np.abs(v[turns] - v[expected]) <= 0.2 + 1e-9)


@given(heights, st.integers(2, 5))
def test_reversals_follow_a_stretched_time(legs, factor):
    v = zigzag(legs)
    fine = np.interp(np.arange(factor * (len(v) - 1) + 1) / factor, np.arange(len(v)), v)
    turns = Record(np.arange(len(v)), v, v).reversals(band=0.5)
    stretched = Record(np.arange(len(fine)) * 7.0, fine, fine).reversals(band=0.5)
    assert stretched.tolist() == (factor * turns).tolist()


@given(heights, st.floats(0.01, 100), st.booleans(), st.floats(-10, 10))
def test_reversals_do_not_depend_on_gain_and_offset(legs, gain, inverted, offset):
    v = zigzag(legs)
    scaled = (-gain if inverted else gain) * v + offset
    expected = Record(np.arange(len(v)), v, v).reversals(band=0.5)
    assert Record(np.arange(len(v)), scaled, v).reversals(band=0.5 * gain).tolist() == expected.tolist()
    assert len(Record(np.arange(len(v)), scaled, v).reversals()) == len(legs) - 1


def test_reversals_of_a_million_noisy_samples():
    n = 1_000_000
    y = np.sin(2 * np.pi * 10 * np.arange(n) / n) + 0.02 * rng.normal(size=n)
    record = Record(np.arange(n), y, y)
    began = time.process_time()
    turns = record.reversals("displacement")
    assert len(turns) == 20
    assert time.process_time() - began < 2.0  # of this process alone; 0.2 s here


def test_cycles_between_minima():
    cycles = lagging(n=2000, cycles=5).cycles()
    assert [(c.start, c.stop) for c in cycles] == [(400 * k, 400 * k + 401) for k in range(5)]


def test_cycles_between_maxima_when_these_are_more():
    t = np.arange(1001)
    v = np.cos(2 * np.pi * t / 200)
    assert [(c.start, c.stop) for c in Record(t, v, v).cycles()] == [(200 * k, 200 * k + 201) for k in range(5)]


def test_cycles_of_one_excursion():
    up, down = np.linspace(0, 100, 50), np.linspace(100, 5, 50)
    v = np.concatenate([up, down])
    assert len(Record(np.arange(100), v, v).cycles()) == 1
    half = np.concatenate([up, np.linspace(100, 50, 50)])
    assert Record(np.arange(100), half, half).cycles() == []
    assert Record(np.arange(50), up, up).cycles() == []


def test_parts_keep_name_and_meta():
    record = Record([0, 1, 2, 3], [0, 1, 2, 3], [0, 1, 2, 3], "whole", {"source": "a"})
    for part in (record[1:3], record.slice(1, 3), record.slice(-3, -1), record.between(0.5, 2)):
        assert part.voltage.tolist() == [1, 2]
        assert (part.name, part.meta) == ("whole", {"source": "a"})
    assert record.with_name("b").name == "b"
    assert record.with_name("b").meta == {"source": "a"}


@pytest.mark.parametrize("kind", ["linear", "pchip"])
def test_resample(kind):
    t = np.sort(rng.uniform(0, 1, 400))
    record = Record(t, 3 * t, 2e-6 * t, "line", {"a": 1}).resample(0.01, kind)
    assert np.diff(record.time) == pytest.approx(0.01)
    assert record.voltage == pytest.approx(3 * record.time)
    assert record.displacement == pytest.approx(2e-6 * record.time)
    assert record.meta == {"a": 1}


def test_resample_keeps_the_last_sample():
    assert len(lagging().resample(1e-3)) == len(lagging())


def test_delayed_moves_the_voltage():
    record = lagging()
    later = record.delayed(0.0123)
    assert later.voltage[0] == record.voltage[0]
    expected = 50 * (1 - np.cos(2 * np.pi * 2.5 * (record.time - 0.0123)))
    assert later.voltage[20:] == pytest.approx(expected[20:], abs=0.01)
    assert np.array_equal(record.delayed(0.0).voltage, record.voltage)
    assert np.array_equal(record.delayed(-9.0).voltage, np.full(len(record), record.voltage[-1]))
    assert np.array_equal(later.displacement, record.displacement)


@pytest.mark.parametrize("digit", [2e-8, 1e-7])
def test_the_resolution_of_a_signal_is_its_last_digit(digit):
    smooth = 1e-5 * np.sin(np.linspace(0, 12, 20_000))
    step, share = resolution(digit * np.round(smooth / digit))
    assert step == pytest.approx(digit, rel=1e-6)
    assert share == pytest.approx(digit / 2e-5, rel=1e-2)
    assert resolution(smooth) == (0.0, 0.0)


def changed(time=lambda t: t, voltage=lambda v: v, displacement=lambda y: y):
    record = lagging()
    return Record(time(record.time), voltage(record.voltage), displacement(record.displacement))


@pytest.mark.parametrize(
    ("record", "word"),
    [
        (lambda: changed(time=lambda t: t + 0.1 * (np.arange(t.size) >= 1000)), "gap"),
        (lambda: changed(time=lambda t: np.cumsum(1e-3 * rng.uniform(0.9, 1.1, t.size))), "uneven"),
        (lambda: lagging(n=100), "20 samples a cycle"),
        (lambda: changed(voltage=lambda v: 2 * np.round(v / 2)), "steps of 2 V"),
        (lambda: changed(displacement=lambda y: 1e-7 * np.round(y / 1e-7)), "steps of 1e-07 m"),
        (lambda: changed(displacement=lambda y: 1e6 * y), "unit"),
        (lambda: changed(displacement=lambda y: 1e-6 * y), "unit"),
    ],
)
def test_problems(record, word):
    """Each is the first that is named, and shown where a notebook shows the record."""
    made = record()
    said = made.problems()[0]
    assert word in said
    assert said in html.unescape(made._repr_html_())
    assert lagging().problems() == ()


def test_usable():
    for record in (lagging(), lagging(noise=1e-7), lagging(cycles=1), lagging(lag=0.0, noise=1e-9)):
        assert record.check_usable() is None
    lagging()[:200].check_usable(min_cycles=0)


def still(n, noise):
    return with_displacement(lagging(n), 1e-6 + noise * np.random.default_rng(5).normal(size=n + 1))


def inverted(noise):
    return changed(displacement=lambda y: -y + noise * np.random.default_rng(1).normal(size=y.size))


def swapped(noise):
    record = lagging(noise=noise)
    return Record(record.time, record.displacement * 1e7, record.voltage * 1e-7)


def clipped(low, high, *, noise=0.0, step=None):
    y = lagging().displacement + noise * np.random.default_rng(4).normal(size=len(lagging()))
    return with_displacement(lagging(), np.clip(y if step is None else step * np.round(y / step), low, high))


def briefly_clipped():
    record = lagging(n=100_000, cycles=500)
    return with_displacement(record, np.minimum(record.displacement, 9e-6))


UNUSABLE = {
    "constant": [lambda: changed(voltage=lambda v: 5 + 1e-10 * v)]
    + [lambda n=n, noise=noise: still(n, noise) for n in (40, 2000, 100_000) for noise in (0.0, 1e-8)],
    "inverted": [lambda noise=noise: inverted(noise) for noise in (0, 1e-7)],
    "swapped": [lambda noise=noise: swapped(noise) for noise in (0, 1e-7, 5e-7)],
    "clipped": [briefly_clipped]
    + [
        lambda ends=ends, how=how: clipped(*ends, **how)
        for ends in ((-1, 9e-6), (1e-6, 1))
        for how in ({}, {"noise": 2e-8}, {"noise": 2e-8, "step": 2e-8})
    ],
}


@pytest.mark.parametrize("word", UNUSABLE)
def test_unusable_records_are_refused_for_their_fault(word):
    for make in UNUSABLE[word]:
        with pytest.raises(RecordError, match=word):
            make().check_usable()


@given(st.integers(0, 1000), st.floats(0, 2e-6))
def test_noise_alone_never_looks_swapped(seed, sigma):
    record = lagging(lag=0.01)
    noise = sigma * np.random.default_rng(seed).normal(size=len(record))
    with_displacement(record, record.displacement + noise).check_usable()


@pytest.mark.parametrize(("bounds", "more"), [((-1, 80), 1), ((20, 101), 1), ((-1, 101), 0)], ids=str)
def test_a_cut_voltage_is_remarked_on(bounds, more):
    record = lagging()
    y = record.displacement + 2e-9 * np.random.default_rng(4).normal(size=len(record))
    cut = Record(record.time, np.clip(record.voltage, *bounds), y)
    cut.check_usable()
    assert len(cut.problems()) - len(with_displacement(record, y).problems()) == more


@pytest.mark.parametrize("creeps", [0.0, 0.2])
def test_a_displacement_that_creeps_in_holds_shows_no_cut_voltage(creeps):
    time = 0.05 * np.arange(2400)
    voltage = np.interp(time % 60, [0, 10, 30, 40, 60], [0, 100, 100, 0, 0])
    late = np.zeros(time.size)
    for i in range(1, time.size):
        late[i] = late[i - 1] + 0.05 / 4 * (voltage[i] - late[i - 1])
    y = 1e-7 * (voltage + creeps * late) + 2e-9 * np.random.default_rng(4).normal(size=time.size)
    assert [sentence for sentence in Record(time, voltage, y).problems() if "hysteresis" not in sentence] == []


def test_holds_steps_and_dead_zones_are_not_clipping():
    record = lagging()
    stairs = np.repeat(np.concatenate([np.arange(0, 11), np.arange(9, -1, -1)]), 50) * 10.0
    y = 1e-7 * np.concatenate([stairs[:1], stairs[:-1]]) + 1e-9 * np.random.default_rng(4).normal(size=stairs.size)
    Record(np.arange(len(stairs)), stairs, y).check_usable()
    for step in (1e-7, 3e-7, 1e-6):
        with_displacement(record, step * np.round(record.displacement / step)).check_usable()
    play = record.voltage.copy()
    for i in range(1, len(play)):
        play[i] = min(max(play[i - 1], record.voltage[i] - 10), record.voltage[i] + 10)
    with_displacement(record, 1e-7 * play).check_usable()


@pytest.mark.parametrize(("name", "turns", "cycles"), [("major.csv", 80, 39), ("ramps.csv", 61, 30)])
def test_measured_data(name, turns, cycles):
    record = p885(name)
    record.check_usable()
    assert record.problems() == ()
    assert record.noise == pytest.approx(0.067e-6, rel=0.2)
    assert len(record.reversals()) == len(record.reversals("displacement")) == turns
    assert len(record.cycles()) == cycles
    swapped = Record(record.time, record.displacement, record.voltage * 1e-6)
    with pytest.raises(RecordError, match="swapped"):
        swapped.check_usable()


def test_a_spike_is_told_and_only_a_spike():
    made = np.linspace(0, 6 * np.pi, 600)
    clean = Record(made, 50 - 50 * np.cos(made), 5e-6 * (1 - np.cos(made - 0.2)))
    assert not any("spike" in said for said in clean.problems())
    y = clean.displacement.copy()
    y[200] += 3e-6
    (said,) = [said for said in Record(clean.time, clean.voltage, y).problems() if "spike" in said]
    assert f"{made[200]:.6g} s, up to 2.998 um" in said
    corners = np.abs((np.arange(200) % 20) - 10.0)  # a triangle of 20 samples a cycle turns round sharply
    sharp = Record(np.arange(200.0), corners, 1e-6 * np.roll(corners, 1))
    assert not any("spike" in said for said in sharp.problems())


def test_a_record_is_not_copied_by_its_slices_but_its_maker_may_go_on_writing():
    y = np.arange(100.0)
    record = Record(np.arange(100.0), y, y)
    y[3] = -1
    assert record.voltage[3] == 3
    assert np.shares_memory(record.slice(10, 50).voltage, record.voltage)
    view = y.view()
    view.flags.writeable = False
    other = Record(np.arange(100.0), view, view)
    y[4] = -1
    assert other.voltage[4] == 4
