"""What is left out of a record and only that: glitches of the voltage, spikes of the displacement, transients."""

import json
from dataclasses import replace

import numpy as np
import plain_records
import pytest
from command_line import run
from hypothesis import given
from hypothesis import strategies as st

import dehyst
from dehyst import Record, plan_path
from dehyst.identification.preparation import prepare
from dehyst.model import turned
from dehyst.records import write_columns
from dehyst.records.cleaning import glitches, settled, spikes, transients, voltage_steps, zero_jumps

PLANTS = [plain_records.plant(10, share=share, seed=i) for i, share in enumerate((0.1, 0.4, 0.7))]
CLEAN = plain_records.loops(plain_records.plant(10), plain_records.THREE_LOOPS, noise=5e-9, name="loops")
SMOOTH = ("sine", "triangle", "descending", "random")
KINDS = (*SMOOTH, "sawtooth", "staircase", "square", "walk")


def with_voltage(record, samples, volts):
    """A record with other voltages at some samples."""
    voltage = record.voltage.copy()
    voltage[samples] = volts
    return replace(record, voltage=voltage)


def fitted(record, **options):
    return dehyst.identify(record, structure="maxwell_slip", **options)


@pytest.fixture(scope="module")
def clean_fit():
    return fitted(CLEAN)


def excited(rng, kind, cycle, size):
    """A voltage of 0 to 200 V; `cycle` samples a cycle."""
    t = np.arange(size) / cycle + rng.uniform()
    triangle = np.abs(2 * (t % 1) - 1)
    stairs = max(2, min(10, cycle // 6))
    spectrum = rng.normal(size=(2, size // 2 + 1)) @ np.eye(size // 2 + 1)
    spectrum[:, size // cycle + 2 :] = 0
    shapes = {
        "sine": lambda: 0.5 - 0.5 * np.cos(2 * np.pi * t),
        "triangle": lambda: triangle,
        "descending": lambda: triangle * (1 - 0.8 * np.linspace(0, 1, size)),
        "random": lambda: np.fft.irfft(spectrum[0] + 1j * spectrum[1], size),
        "sawtooth": lambda: t % 1,
        "staircase": lambda: np.round(triangle * stairs),
        "square": lambda: (t % 1 < 0.4).astype(float),
        "walk": lambda: np.cumsum(rng.normal(size=size)),
    }
    shape = shapes[kind]()
    return 200 * (shape - shape.min()) / np.ptp(shape)


def measured(rng, kind, cycle, size, lag):
    """Voltage and displacement that comes `lag` samples late, whole or not."""
    v = excited(rng, kind, cycle, size)
    plant = PLANTS[rng.integers(len(PLANTS))]
    y = plant.simulate(v, state=turned(plant, 0.0)).displacement
    return v, np.interp(np.arange(size) - lag, np.arange(size), y)


def spoiled(rng, values, noise, digits):
    """With noise, and rounded to digits; both parts of the range."""
    span = np.ptp(values)
    values = values + noise * span * rng.normal(size=values.size)
    return digits * span * np.round(values / (digits * span)) if digits else values


def samples_of(found):
    return set(np.flatnonzero(found).tolist())


NOISES = st.sampled_from([0.0, 1e-4, 1e-3, 1e-2, 5e-2])
DIGITS = st.sampled_from([0.0, 1e-4, 1e-2, 6e-2])


@given(
    seed=st.integers(0, 2**32 - 1),
    kind=st.sampled_from(KINDS),
    cycle=st.integers(10, 500),
    cycles=st.floats(3, 8),
    lag=st.sampled_from([0, 0.5, 1, 3.3]),
    noise=NOISES,
    digits=DIGITS,
    sensor=st.sampled_from([0.0, 1e-4, 1e-2]),
    sensor_digits=st.sampled_from([0.0, 1e-4, 1e-2]),
)
def test_a_record_without_glitches_loses_nothing(seed, kind, cycle, cycles, lag, noise, digits, sensor, sensor_digits):
    rng = np.random.default_rng(seed)
    size = max(80, int(cycle * cycles))
    v, y = measured(rng, kind, cycle, size, lag)
    v, y = spoiled(rng, v, noise, digits), spoiled(rng, y, sensor, sensor_digits)
    assert not glitches(v, y).any() and not zero_jumps(Record(np.arange(v.size), v, y))


@given(
    seed=st.integers(0, 2**32 - 1),
    kind=st.sampled_from((*SMOOTH, "staircase", "square")),
    cycle=st.integers(40, 500),
    lag=st.sampled_from([0, 0.5, 1, 3.3]),
    count=st.integers(1, 4),
    noise=st.sampled_from([0.0, 1e-4, 1e-3]),
    width=st.integers(1, 3),
    sensor=st.sampled_from([0.0, 1e-4, 1e-3]),
)
def test_only_glitches_above_slew_and_noise_are_found(seed, kind, cycle, lag, count, noise, width, sensor):
    rng = np.random.default_rng(seed)
    # A value that fills 2 % of a record is usual there, and no glitch.
    size = max(6 * cycle + 200, 60 * count * width)
    v, y = measured(rng, kind, cycle, size, lag)
    v, y = spoiled(rng, v, noise, 0), spoiled(rng, y, sensor, 0)
    steps = np.abs(np.diff(v))
    slew = float(np.quantile(steps, 0.9) if kind in SMOOTH else steps.max())
    width = width if kind in SMOOTH else 1
    places = 20 * rng.choice(np.arange(1, size // 20 - 1), count, replace=False) + rng.integers(0, 10)
    bad, hit = v.copy(), set()
    for start in places.tolist():
        least = 1.25 * (width + 1) * slew + 0.05 * 200
        bad[start : start + width] += rng.choice([-1, 1]) * least * rng.uniform(1, 10)
        hit |= set(range(start, start + width))
    assert samples_of(glitches(bad, y)) == hit


@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(SMOOTH), cycle=st.integers(40, 500), last=st.booleans())
def test_a_glitch_at_an_end_of_the_record_is_found(seed, kind, cycle, last):
    rng = np.random.default_rng(seed)
    v, y = (column[cycle:] for column in measured(rng, kind, cycle, 7 * cycle, 0))
    bad, place = v.copy(), 6 * cycle - 1 if last else 0
    bad[place] += rng.choice([-1, 1]) * (5 * np.abs(np.diff(v)).max() + 10) * rng.uniform(1, 10)
    assert samples_of(glitches(bad, y)) == {place}


@pytest.mark.parametrize("lag", [0, 1, 2.5])
@pytest.mark.parametrize("width", [1, 2, 3])
@pytest.mark.parametrize(("first", "pulse"), [(650, 60.0), (650, -60.0), (0, 60.0)])
def test_a_pulse_that_the_displacement_follows_is_no_glitch(first, pulse, width, lag):
    v = 100 - 100 * np.cos(2 * np.pi * np.arange(1200) / 200)
    plant = plain_records.plant(10)
    still = plant.simulate(v, state=turned(plant, 0.0)).displacement
    v[first : first + width] += pulse
    y = plant.simulate(v, state=turned(plant, 0.0)).displacement
    # A pulse within the record may be later than one at its start.
    late = np.interp(np.arange(1200) - (lag if first else min(lag, 1)), np.arange(1200), y)
    assert not glitches(v, late).any()
    assert samples_of(glitches(v, still)) == set(range(first, first + width))


@pytest.mark.parametrize("samples", [[0], [200], [600, 700, 1400]], ids=["first", "turn counted", "three apart"])
def test_a_glitch_does_not_change_limits_and_fit(samples, clean_fit):
    fit = fitted(with_voltage(CLEAN, samples, 500.0))
    assert fit.actuator.limits == clean_fit.actuator.limits == (0.0, 200.0)
    (error,), (clean,) = fit.errors, clean_fit.errors
    assert error.rms == pytest.approx(clean.rms, rel=0.01)
    assert error.largest == pytest.approx(clean.largest, rel=0.15)
    assert error.samples + error.left_out == len(CLEAN)
    assert plain_records.stiffness_error(fit.actuator, clean_fit.actuator) < 0.01
    assert fit.remarks == clean_fit.remarks and not any("Few samples" in said for said in fit.remarks)
    assert sum("voltage glitch at sample" in said and "500 V" in said for said in fit.repairs) >= 1
    assert not any("gap" in said for said in fit.repairs)
    plan = plan_path(fit.actuator, np.linspace(0, 30e-6, 400), home=False)
    assert plan.voltage.max() == 200.0 and plan.clamped.any()


@pytest.mark.parametrize("voltage", [500.0, -300.0])
@pytest.mark.parametrize(("first", "width"), [(1100, 6), (820, 10), (1000, 20), (1330, 20)])
def test_a_channel_that_drops_out_for_longer_is_a_glitch(first, width, voltage):
    samples = list(range(first, first + width))
    record = with_voltage(CLEAN, samples, voltage)
    assert samples_of(glitches(record.voltage, record.displacement)) == set(samples)


def test_a_glitch_among_few_samples_a_cycle_cuts_the_record_only_where_a_reversal_is_lost():
    turns = np.array([0, 1] * 8 + [0])
    y = plain_records.STROKE * np.interp(np.arange(161), 10 * np.arange(17), turns)
    coarse = plain_records.record(plain_records.plant(10), y)
    assert len(prepare(with_voltage(coarse, [75], 900.0)).pieces) == 1
    first, second = prepare(with_voltage(coarse, [70], 900.0)).pieces
    assert (first.time[-1], second.time[0]) == (coarse.time[69], coarse.time[71])


def test_samples_cut_off_at_a_gap_do_not_widen_the_limits():
    """Twelve samples at another voltage, cut off by a gap, are in no piece and count nowhere."""
    time = np.concatenate([CLEAN.time, CLEAN.time[-1] + 10 + 0.005 * np.arange(12)])
    volts = np.concatenate([CLEAN.voltage, np.full(12, 290.0)])
    y = np.concatenate([CLEAN.displacement, np.full(12, 20e-6)])
    fit = fitted(Record(time, volts, y, "cut"))
    assert fit.actuator.limits == (0.0, 200.0)


def rare(samples, cycle=200):
    """Loops to 150 V; one of them goes to 200 V for some samples, and the displacement with it."""
    v = 75 - 75 * np.cos(2 * np.pi * np.arange(10 * cycle) / cycle)
    middle = 5 * cycle // 2
    v[middle - samples // 2 : middle - samples // 2 + samples] = 200.0
    plant = plain_records.plant(10)
    return plain_records.driven(plant, np.concatenate([v, v[: 2 * cycle]]), state=turned(plant, 0.0))


@pytest.mark.parametrize("samples", [2, 8])
def test_a_range_that_few_samples_reach_is_reported(samples):
    fit = fitted(rare(samples))
    assert fit.actuator.limits == (0.0, 200.0)
    assert any(said.startswith("Few samples lie above 180 V") for said in fit.remarks)


@pytest.mark.parametrize(("volts", "far"), [([0, 219, -19], False), ([-21, 50, 205], True)])
def test_simulate_far_beyond_the_records_warns_and_ends_with_status_1(volts, far, tmp_path, clean_fit):
    clean_fit.actuator.save(tmp_path / "model.json")
    write_columns(tmp_path / "v.csv", {"voltage_V": volts})
    got, out, _ = run("simulate", "model.json", "v.csv", "-o", "y.csv", "--json", cwd=tmp_path)
    result = json.loads(out)
    assert (got, result["outside"], result["far_outside"]) == (far, 2, far)
    assert result["warnings"] and (tmp_path / "y.csv").exists()


N = 4000
TIME = np.arange(N) * 1e-3


def triangle(frequency=2.0):
    phase = TIME * frequency % 1
    return 100 * (1 - np.abs(2 * phase - 1))


def test_spikes_of_one_to_three_samples_are_found_and_nothing_else():
    rng = np.random.default_rng(1)
    v = triangle()
    y = 1e-7 * v + 2e-8 * rng.normal(size=N)
    expected = np.zeros(N, dtype=bool)
    for start, size, height in [(100, 1, 1e-6), (777, 2, -2e-6), (1500, 3, 1e-6), (1508, 1, -8e-7), (3000, 1, 9e-7)]:
        y[start : start + size] += height
        expected[start : start + size] = True
    np.testing.assert_array_equal(spikes(v, y), expected)


PULSE = triangle() + 40.0 * np.isin(np.arange(N), [1000, 1001])


@pytest.mark.parametrize(
    ("voltage", "displacement"),
    [
        pytest.param(triangle(), 1e-7 * triangle(40.0), id="corners"),
        pytest.param(triangle(), 1e-5 * (np.floor(TIME / 0.2) % 3), id="steps"),
        pytest.param(
            triangle(), 1e-5 * (1 - np.exp(-20 * (TIME % 0.5)) * np.cos(2 * np.pi * 180 * (TIME % 0.5))), id="ringing"
        ),
        pytest.param(triangle(), 1e-6 * np.random.default_rng(0).normal(size=N), id="noise"),
        pytest.param(triangle(), np.zeros(N), id="nothing"),
        pytest.param(PULSE, 1e-7 * PULSE, id="what the voltage does"),
        pytest.param(triangle(), 1e-7 * triangle() + 2e-6 * (np.arange(N) % 9 == 0), id="too many"),
    ],
)
def test_fast_motion_is_not_taken_for_spikes(voltage, displacement):
    assert not spikes(voltage, displacement).any()


RATE = 5000.0


def stepped(ring=0.0, frequency=1000.0, damping=0.09, *, after=0.0, noise=1e-8, creep=0.0):
    """A record at rest, a step by -87 V, what rings, then sines; displacements 0.1 um/V."""
    count = 6000
    time = np.arange(2 * count) / RATE
    since = time[count:] - time[count]
    voltage = np.where(time < time[count], after, after - 87.0)
    voltage[count:] += 60 * (1 - np.cos(2 * np.pi * since))
    omega = 2 * np.pi * frequency
    y = 1e-7 * voltage
    y[count:] += 8.7e-6 * ring * np.exp(-damping * omega * since) * np.cos(omega * np.sqrt(1 - damping**2) * since)
    y[count:] -= 8.7e-6 * creep * np.log10(1 + since / 0.001)
    return Record(time, voltage, y + np.random.default_rng(1).normal(0, noise, y.size))


@pytest.mark.parametrize("noise", [1e-9, 1e-8, 3e-8])
@pytest.mark.parametrize(("frequency", "damping"), [(1000.0, 0.09), (400.0, 0.03), (90.0, 0.1)])
def test_ringing_is_left_out_until_it_is_near_the_noise(frequency, damping, noise):
    record = stepped(1.0, frequency, damping, noise=noise)
    ((start, jump, stop),) = transients(record)
    assert (start, jump) == (5999, 6000)
    left = 8.7e-6 * np.exp(-damping * 2 * np.pi * frequency * (stop - 1 - jump) / RATE)
    assert left < 3 * noise + 2e-3 * record.stroke


def test_an_overshoot_without_a_ring_is_found():
    assert transients(stepped(0.3, 1.0, 0.9999)) == []
    record = stepped()
    over = record.displacement.copy()
    over[6000:] -= 2e-6 * np.exp(-np.arange(6000) / 30)
    ((start, _, stop),) = transients(Record(record.time, record.voltage, over))
    assert 60 < stop - start < 400


@pytest.mark.parametrize("creep", [0.0, 0.02])
def test_a_displacement_that_follows_a_step_has_no_transient(creep):
    record = stepped(creep=creep)
    assert voltage_steps(record.voltage) == [(5999, 6000)]
    assert transients(record) == []


def test_transients_and_spikes_are_distinguished():
    ring = stepped(1.0)
    assert not any("spike" in sentence for sentence in ring.problems())
    quiet = stepped()
    y = quiet.displacement.copy()
    y[[1000, 9000]] += 3e-6
    spiked = Record(quiet.time, quiet.voltage, y)
    assert transients(spiked) == []
    assert np.flatnonzero(spikes(spiked.voltage, spiked.displacement)).tolist() == [1000, 9000]


def test_a_repaired_step_follows_its_voltage():
    """From one level to the other in proportion to the voltage."""
    record = stepped(noise=1e-10)
    voltage = record.voltage.copy()
    voltage[6000] = -20.0
    over = 1e-7 * voltage
    over[6001:] -= 2e-6 * np.exp(-np.arange(5999) / 30)
    slow = Record(record.time, voltage, over)
    found = transients(slow)
    assert found[0][:2] == (5999, 6001)
    path = settled(slow, found)
    assert path[6001] == pytest.approx(-8.7e-6, abs=0.02 * 2e-6)
    share = (path[6000] - path[5999]) / (path[6001] - path[5999])
    assert share == pytest.approx(20 / 87, rel=1e-6)
