"""Record: what is refused, what is measured on it, its turning points; records of several axes."""

import pickle

import coupled_stage
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dehyst._errors import FileFormatError, RecordError
from dehyst._units import per_metre
from dehyst._views.lines import ends
from dehyst.records import Record, read, reversals, write_record
from dehyst.records.record import columns_of
from dehyst.records.signals import beyond_noise, resolution, turning_points, white_noise

rng = np.random.default_rng(885)
AXES, _ = coupled_stage.excited(steps=2, cycles=3)
ARRAYS = "time", "voltage", "displacement"


def lagging(n=2000, cycles=5, lag=0.2, noise=0.0, points=None):
    """A sine drive of 0-100 V from its minimum, and 10 um that lag behind by `lag` radians."""
    phase = 2 * np.pi * cycles * np.arange(n + 1) / n
    displacement = 5e-6 * (1 - np.cos(phase - lag)) + noise * np.random.default_rng(1).normal(size=n + 1)
    return Record(np.arange(n + 1) * 1e-3, 50 * (1 - np.cos(phase)), displacement, "made")


def with_displacement(record, displacement):
    return Record(record.time, record.voltage, displacement, record.name)


def test_a_record_keeps_read_only_copies():
    source = np.array([0.0, 1e-6, 2e-6])
    view = source.view()
    view.flags.writeable = False
    record = Record([0, 1, 2], view, source, meta={"source": "a.csv"})
    source[0] = 7
    assert (record.voltage[0], record.displacement[0]) == (0.0, 0.0)
    assert np.shares_memory(record[1:].voltage, record.voltage)
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
        {"displacement": AXES.displacement[:, :1]},
        {"displacement": AXES.displacement * np.nan},
        {"axes": ("x",)},
        {"axes": ("x", "x")},
        {"time": AXES.time[::-1]},
        {"measured": AXES.time > 1},
    ],
)
def test_impossible_arrays_are_refused(columns):
    changed_ = columns if isinstance(columns, dict) else dict(zip(ARRAYS, columns, strict=True))
    with pytest.raises(RecordError):
        Record(**{name: getattr(AXES, name) for name in ARRAYS} | changed_)


@pytest.mark.parametrize(("peak", "samples"), [(0.0, 6), (1.0, 300), (3.0, 300), (3.0, 6), (12.0, 6)])
def test_an_error_beyond_noise_is_slightly_less_than_the_error(peak, samples):
    true = peak * np.exp(-((np.arange(-3000, 3000) / samples) ** 2))
    found = [beyond_noise(true + np.random.default_rng(k).normal(0, 1, true.size), 1.0) for k in range(50)]
    assert np.mean([largest_ > peak + 1 for largest_, _ in found]) <= 0.1
    assert np.median([largest_ for largest_, _ in found]) >= (0.5 * (peak - 0.5) if samples > 100 else peak - 2)
    assert all(rms_ <= largest_ for largest_, rms_ in found)
    assert beyond_noise(true, 0.0) == pytest.approx((peak, np.sqrt(np.mean(true**2))), rel=0.01)


def test_noise_is_estimated_of_smooth_quantised_and_spiky_data():
    y = np.sin(2 * np.pi * np.arange(5000) / 1000)
    assert white_noise(y) < 1e-6
    for levels in (8, 50, 1000, 65536):
        step = 2 / levels
        assert white_noise(step * np.round(y / step)) <= step
        dithered = step * np.round(y / step + np.random.default_rng(2).normal(size=5000))
        assert white_noise(dithered) == pytest.approx(step * np.sqrt(1 + 1 / 12), rel=0.2)
    spiky = y + 0.01 * np.random.default_rng(3).normal(size=5000) + 5 * (np.arange(5000) % 100 == 0)
    assert white_noise(spiky) == pytest.approx(0.01, rel=0.2)
    assert white_noise(np.array([0.0, 1.0, 0.0])) == 0.0


@pytest.mark.parametrize(
    ("corners", "band", "turns"),
    [
        ([0, 100, 20, 60, 0], 39.9, [100, 20, 60]),
        ([0, 100, 20, 60, 0], 40, [100]),
        ([0, 3, 3, 3, 0, 0, 2], 0.5, [3, 0]),
    ],
)
def test_turns_are_larger_than_the_band(corners, band, turns):
    v = np.array(corners, dtype=float)
    found = turning_points(v, band)
    assert v[found].tolist() == turns
    # The last sample of a hold.
    assert all(v[i + 1] != v[i] for i in found)


def zigzag(heights):
    """Alternate up and down by the heights, 40 samples a branch."""
    corners = np.concatenate([[0.0], np.cumsum(np.where(np.arange(len(heights)) % 2, -1, 1) * heights)])
    return np.interp(np.arange(40 * len(heights) + 1), 40 * np.arange(len(corners)), corners)


heights = st.lists(st.floats(1, 5), min_size=2, max_size=12).map(np.array)


@given(heights, st.floats(0.01, 100), st.booleans(), st.integers(0, 1000))
def test_turns_are_the_corners_for_any_noise_gain_and_sign(branches, gain, inverted, seed):
    v = zigzag(branches)
    assert turning_points((-gain if inverted else gain) * v, 0.5 * gain).tolist() == list(range(40, len(v) - 1, 40))
    noisy = v + np.random.default_rng(seed).uniform(-0.1, 0.1, len(v))
    turns = turning_points(noisy, 0.5)
    assert np.abs(v[turns] - v[40:-1:40]).max() <= 0.2 + 1e-9
    assert len(reversals(Record(np.arange(len(v)), noisy, v))) == len(branches) - 1


UP, DOWN = np.linspace(0, 100, 50), np.linspace(100, 5, 50)


@pytest.mark.parametrize(
    ("voltage", "cycles"),
    [
        (lagging(n=2000, cycles=5).voltage, [(400 * k, 400 * k + 401) for k in range(5)]),
        # Maxima are more than minima.
        (np.cos(2 * np.pi * np.arange(1001) / 200), [(200 * k, 200 * k + 201) for k in range(5)]),
        (np.concatenate([UP, DOWN]), [(0, 100)]),
        (np.concatenate([UP, DOWN / 2 + 50]), []),
        (UP, []),
    ],
)
def test_cycles_are_found(voltage, cycles):
    found = Record(np.arange(len(voltage)), voltage, voltage).cycles()
    assert [(cycle.start, cycle.stop) for cycle in found] == cycles


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
        (lambda: lagging(n=100), "20 samples a cycle"),
        (lambda: changed(voltage=lambda v: 2 * np.round(v / 2)), "steps of 2 V"),
        (lambda: changed(displacement=lambda y: 1e-7 * np.round(y / 1e-7)), "steps of 1e-07 m"),
        (lambda: changed(displacement=lambda y: 1e6 * y), "unit"),
        (lambda: changed(displacement=lambda y: 1e-6 * y), "unit"),
    ],
)
def test_problems_are_named(record, word):
    """Each is the first that is named."""
    assert word in record().problems()[0]
    assert lagging().problems() == ()


def still(n, noise):
    return with_displacement(lagging(n), 1e-6 + noise * np.random.default_rng(5).normal(size=n + 1))


def clipped(low, high, *, noise=0.0, step=None):
    y = lagging().displacement + noise * np.random.default_rng(4).normal(size=len(lagging()))
    return with_displacement(lagging(), np.clip(y if step is None else step * np.round(y / step), low, high))


def briefly_clipped():
    record = lagging(n=100_000, cycles=500)
    return with_displacement(record, np.minimum(record.displacement, 9e-6))


UNUSABLE = {
    "constant": [lambda: changed(voltage=lambda v: 5 + 1e-10 * v)]
    + [lambda n=n, noise=noise: still(n, noise) for n in (40, 2000, 100_000) for noise in (0.0, 1e-8)],
    "clipped": [briefly_clipped]
    + [
        lambda ends=ends, how=how: clipped(*ends, **how)
        for ends in ((-1, 9e-6), (1e-6, 1))
        for how in ({}, {"noise": 2e-8}, {"noise": 2e-8, "step": 2e-8})
    ],
}


@pytest.mark.parametrize("word", UNUSABLE)
def test_unusable_records_are_refused_with_their_fault(word):
    for make in UNUSABLE[word]:
        with pytest.raises(RecordError, match=word):
            make().check_usable()


def test_holds_and_steps_are_not_clipping():
    record = lagging()
    stairs = np.repeat(np.concatenate([np.arange(0, 11), np.arange(9, -1, -1)]), 50) * 10.0
    y = 1e-7 * np.concatenate([stairs[:1], stairs[:-1]]) + 1e-9 * np.random.default_rng(4).normal(size=stairs.size)
    Record(np.arange(len(stairs)), stairs, y).check_usable()
    for step in (1e-7, 3e-7, 1e-6):
        with_displacement(record, step * np.round(record.displacement / step)).check_usable()


# Units

WAVE = np.array([1.0, 2.0, 3.5, 2.5, 1.2])


@pytest.mark.parametrize(("units", "factor"), [("m", 1.0), ("mm", 1e3), ("um", 1e6), ("µm", 1e6), ("nm", 1e9)])
def test_arrays_in_a_unit_are_converted(units, factor):
    made = Record.from_arrays(range(5), WAVE, WAVE * 1e-6 * factor, units=units, name="stage")
    np.testing.assert_allclose(made.displacement, WAVE * 1e-6, rtol=1e-15)
    assert (made.name, per_metre(units)) == ("stage", factor)


@pytest.mark.parametrize(
    ("units", "displacement"), [("inch", WAVE), ("um", ["a"] * 5), ("m", WAVE), ("um", WAVE * 1e-6)]
)
def test_arrays_in_another_unit_are_refused(units, displacement):
    with pytest.raises(RecordError):
        Record.from_arrays(range(5), WAVE, displacement, units=units)


@pytest.mark.parametrize(("column", "factor"), [("time", 1e9), ("time", 1e-6), ("voltage", 1e4), ("displacement", 1e6)])
def test_impossible_values_are_refused(column, factor, tmp_path):
    """The error says what was got and what is needed; a file of such times is refused as it is read."""
    record = changed(**{column: lambda values: factor * values})
    with pytest.raises(RecordError, match=f"(?s)got .*, need .*{column}"):
        record.check_usable()
    write_record(tmp_path / "a.csv", record)
    if column == "time":
        with pytest.raises(FileFormatError, match=r"got .*, need .*time"):
            read(tmp_path / "a.csv")
        assert len(read(tmp_path / "a.csv", "rate=1000")) == len(record)


def test_a_range_is_written_alike_from_numbers_of_numpy_and_python():
    assert ends(np.float64(0), np.float64(167.65)) == ends(0.0, 167.65) == "0 to 167.7"


def test_the_channels_of_a_record_have_names_units_and_roles():
    roles = [(c.name, c.unit, c.role, c.axis) for c in AXES.channels]
    assert roles[:2] == [("vx", "V", "drive", "x"), ("x", "m", "displacement", "x")]
    assert [*columns_of(AXES)] == ["time_s", "vx_V", "x_um", "vy_V", "y_um"]
    single = AXES.axis("y")
    assert [(c.name, c.role) for c in single.channels] == [("voltage", "drive"), ("displacement", "displacement")]
    assert (single.axes, single.axis(0)) == ((), single)


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda: lagging()[::2], "slices"),
        (lambda: lagging()[0], "slices"),
        (lambda: lagging()[3000:], "samples"),
        (lagging()[:200].check_usable, "cycle"),
        (lagging()[:11].check_usable, "samples"),
        # Several axes.
        (lambda: AXES.stroke, "axes"),
        (AXES.cycles, "axes"),
        (AXES.check_usable, "axes"),
        (AXES.problems, "axes"),
        (lambda: AXES.axis("z"), "axis"),
        (lambda: Record(AXES.time, AXES.voltage[:, 0], AXES.displacement[:, 0], axes=("x",)), "axes"),
    ],
)
def test_what_a_record_cannot_answer_is_refused(ask, words):
    with pytest.raises(RecordError, match=words):
        ask()
