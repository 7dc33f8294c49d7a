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
    ("columns", "message"),
    [
        (([0, 1, 2], [0, 1], [0, 1, 2]), r"'bad': columns differ in length \(time 3, voltage 2, displacement 3\)"),
        (([0, 1], [[0], [1]], [0, 1]), r"'bad': voltage has shape \(2, 1\); .*ravel"),
        (([0], [0], [0]), r"'bad': 1 sample, at least 2"),
        (([0, 1], ["a", "b"], [0, 1]), "'bad': voltage is no array of numbers"),
        (
            ([0, 1, 2], [0, np.nan, np.nan], [0, 1, 2]),
            r"'bad': voltage holds 2 .* the first is voltage\[1\] = nan V",
        ),
        (([0, 1, 2], [0, 1, 2], [0, 1, -np.inf]), r"displacement holds 1 .* displacement\[2\] = -inf m"),
        (([0, 0.1, 0.1], [0, 1, 2], [0, 1, 2]), r"time\[2\] = 0.1 s follows time\[1\] = 0.1 s; sort"),
        (([0, 0.2, 0.1], [0, 1, 2], [0, 1, 2]), r"time\[2\] = 0.1 s follows time\[1\] = 0.2 s"),
    ],
)
def test_refuses_at_construction(columns, message):
    with pytest.raises(RecordError, match=message):
        Record(*columns, name="bad")


def test_tells_what_it_is():
    record = lagging()
    assert len(record) == 2001
    assert record.sample_time == pytest.approx(1e-3)
    assert record.voltage_range == pytest.approx((0, 100))
    assert record.displacement_range == pytest.approx((0, 1e-5), abs=1e-10)
    assert record.stroke == pytest.approx(1e-5, rel=1e-4)
    text = repr(record)
    assert "'made': 2001 samples, 2 s, 0 to 100 V" in text
    assert text.endswith(" um>")


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


def test_reversals_refuse():
    with pytest.raises(RecordError, match="no signal 'current'; try 'voltage'"):
        lagging().reversals("current")
    with pytest.raises(RecordError, match="number >= 0"):
        lagging().reversals(band=-1.0)


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
    with pytest.raises(RecordError, match="step 1"):
        record[::2]
    with pytest.raises(RecordError, match="step 1"):
        record[0]
    with pytest.raises(RecordError, match=r"0 samples"):
        record.between(7, 9)


@pytest.mark.parametrize("kind", ["linear", "pchip"])
def test_resample(kind):
    t = np.sort(rng.uniform(0, 1, 400))
    record = Record(t, 3 * t, 2e-6 * t, "line", {"a": 1}).resample(0.01, kind)
    assert np.diff(record.time) == pytest.approx(0.01)
    assert record.voltage == pytest.approx(3 * record.time)
    assert record.displacement == pytest.approx(2e-6 * record.time)
    assert record.meta == {"a": 1}


def test_resample_keeps_the_last_sample_and_refuses():
    record = lagging()
    assert len(record.resample(1e-3)) == len(record)
    with pytest.raises(RecordError, match=r"dt is 5\.0 s; give a step above 0"):
        record.resample(5.0)
    with pytest.raises(RecordError, match=r"dt is 0\.0 s"):
        record.resample(0.0)
    with pytest.raises(RecordError, match=r"'cubic'.*'linear'.*'pchip'"):
        record.resample(0.01, "cubic")


def test_delayed_moves_the_voltage():
    record = lagging()
    later = record.delayed(0.0123)
    assert later.voltage[0] == record.voltage[0]
    expected = 50 * (1 - np.cos(2 * np.pi * 2.5 * (record.time - 0.0123)))
    assert later.voltage[20:] == pytest.approx(expected[20:], abs=0.01)
    assert np.array_equal(record.delayed(0.0).voltage, record.voltage)
    assert np.array_equal(record.delayed(-9.0).voltage, np.full(len(record), record.voltage[-1]))
    assert np.array_equal(later.displacement, record.displacement)
    with pytest.raises(RecordError, match="delay is nan s"):
        record.delayed(float("nan"))


def test_delayed_does_not_overshoot():
    v = np.repeat([0.0, 1.0, 0.0], 20)
    later = Record(np.arange(60.0), v, v).delayed(0.4).voltage
    assert (later.min(), later.max()) == (0, 1)


def test_no_problems_in_good_data():
    assert lagging().problems() == ()


@pytest.mark.parametrize("digit", [2e-8, 1e-7])
def test_the_resolution_of_a_signal_is_its_last_digit(digit):
    smooth = 1e-5 * np.sin(np.linspace(0, 12, 20_000))
    step, share = resolution(digit * np.round(smooth / digit))
    assert step == pytest.approx(digit, rel=1e-6)
    assert share == pytest.approx(digit / 2e-5, rel=1e-2)
    assert resolution(smooth) == (0.0, 0.0)


def test_problems():
    record = lagging()
    t = record.time.copy()
    t[1000:] += 0.1
    assert (
        "1 gap in time, the first of 0.101 s after sample 999."
        in Record(t, record.voltage, record.displacement).problems()
    )
    uneven = np.cumsum(1e-3 * rng.uniform(0.9, 1.1, len(record)))
    assert "Sampling is uneven" in Record(uneven, record.voltage, record.displacement).problems()[0]
    coarse = lagging(n=100)
    assert coarse.problems()[0].startswith("Only 20 samples a cycle")
    folded = html.unescape(coarse._repr_html_()).partition("<summary>Problems")[2]
    assert coarse.problems()[0] in folded
    coarse = Record(record.time, 2 * np.round(record.voltage / 2), record.displacement).problems()
    assert coarse == ("The voltage moves in steps of 2 V, 2 % of its range: quantised.",)
    coarse = with_displacement(record, 1e-7 * np.round(record.displacement / 1e-7)).problems()
    assert coarse == ("The displacement moves in steps of 1e-07 m, 1 % of its range: quantised.",)
    for gain in (1e6, 1e-6):
        assert "the displacement's unit" in with_displacement(record, gain * record.displacement).problems()[0]


def test_usable():
    for record in (lagging(), lagging(noise=1e-7), lagging(cycles=1), lagging(lag=0.0), lagging(lag=0.0, noise=1e-6)):
        assert record.check_usable() is None


def test_refuses_too_few_samples_and_cycles():
    with pytest.raises(RecordError, match="'made': 11 samples, 20 are needed"):
        lagging()[:11].check_usable()
    with pytest.raises(RecordError, match="voltage found, 6 needed"):
        lagging().check_usable(min_cycles=6)
    with pytest.raises(RecordError, match=r"0 full cycles"):
        lagging()[:200].check_usable()
    lagging()[:200].check_usable(min_cycles=0)


def test_refuses_a_constant_voltage():
    record = lagging()
    with pytest.raises(RecordError, match="constant at 5"):
        Record(record.time, 5 + 1e-10 * record.voltage, record.displacement).check_usable()


@pytest.mark.parametrize("n", [40, 2000, 100_000])
def test_refuses_a_constant_displacement(n):
    record = lagging(n)
    noise = 1e-8 * np.random.default_rng(5).normal(size=n + 1)
    for still in (np.full(n + 1, 1e-6), 1e-6 + noise):
        with pytest.raises(RecordError, match="displacement is constant"):
            with_displacement(record, still).check_usable()


@pytest.mark.parametrize("noise", [0, 1e-7])
def test_refuses_an_inverted_sensor(noise):
    record = lagging(noise=noise)
    with pytest.raises(RecordError, match="displacement_scale"):
        with_displacement(record, -record.displacement).check_usable()


@pytest.mark.parametrize("noise", [0, 1e-7, 5e-7])
def test_refuses_swapped_columns(noise):
    record = lagging(noise=noise)
    swapped = Record(record.time, record.displacement * 1e7, record.voltage * 1e-7)
    with pytest.raises(RecordError, match="look swapped"):
        swapped.check_usable()


@given(st.integers(0, 1000), st.floats(0, 2e-6))
def test_noise_alone_never_looks_swapped(seed, sigma):
    record = lagging(lag=0.01)
    noise = sigma * np.random.default_rng(seed).normal(size=len(record))
    with_displacement(record, record.displacement + noise).check_usable()


@pytest.mark.parametrize(("side", "limits"), [("maximum", (-1, 9e-6)), ("minimum", (1e-6, 1))])
def test_refuses_a_clipped_sensor(side, limits):
    record = lagging()
    noisy = record.displacement + 2e-8 * np.random.default_rng(4).normal(size=len(record))
    for y in (record.displacement, noisy, 2e-8 * np.round(noisy / 2e-8)):
        clipped = with_displacement(record, np.clip(y, *limits))
        with pytest.raises(
            RecordError, match=rf"clipped, or the amplifier: the displacement sits at its {side} .* over samples \d+"
        ):
            clipped.check_usable()


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
    assert Record(time, voltage, y).problems() == ()


def test_a_brief_clip_among_many_cycles_is_found():
    record = lagging(n=100_000, cycles=500)
    with pytest.raises(RecordError, match="clipped"):
        with_displacement(record, np.minimum(record.displacement, 9e-6)).check_usable()


def test_holds_steps_and_dead_zones_are_not_clipping():
    record = lagging()
    stairs = np.repeat(np.concatenate([np.arange(0, 11), np.arange(9, -1, -1)]), 50) * 10.0
    y = 1e-7 * np.concatenate([stairs[:1], stairs[:-1]])
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
    assert not any("jumps away" in said for said in clean.problems())
    y = clean.displacement.copy()
    y[200] += 3e-6
    said = " ".join(Record(clean.time, clean.voltage, y).problems())
    assert f"jumps away and back at 1 sample, the first at {made[200]:.6g} s" in said
    corners = np.abs((np.arange(200) % 20) - 10.0)  # a triangle of 20 samples a cycle turns round sharply
    sharp = Record(np.arange(200.0), corners, 1e-6 * np.roll(corners, 1))
    assert not any("jumps away" in said for said in sharp.problems())


@pytest.mark.parametrize("column", ["time", "voltage", "displacement"])
@pytest.mark.parametrize("large", [1e60, 1e200, 1e300])
def test_numbers_that_no_instrument_measures_make_no_loop(column, large):
    """Their squares are no floats: OverflowError came of them where a loop's area is doubted."""
    time = np.arange(200.0)
    columns = {"time": time, "voltage": 50 - 50 * np.cos(time / 8), "displacement": 1e-6 * np.cos(time / 8 - 0.1)}
    columns[column] = columns[column] * large
    with pytest.raises(RecordError, match=rf"{column}\[\d+\] = .* is no {column}; .*check the column's unit"):
        Record(**columns)


@pytest.mark.parametrize("column", ["voltage", "displacement"])
def test_a_lone_one_is_refused_with_its_row(column):
    time = np.arange(400.0)
    columns = {"voltage": 50 - 50 * np.cos(time / 8), "displacement": -1e-6 * np.cos(time / 8 - 0.1)}
    columns[column][77] = 1e200
    with pytest.raises(RecordError, match=rf"{column}\[77\] = 1e\+200 . is no {column}"):
        Record(time, **columns)


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
