"""What a record's samples tell of its origin: each fault by its own cause, an innocent twin without any; speed."""

import re

import numpy as np
import pytest
from truths import BoucWenActuator, PreisachActuator

from dehyst import Record, RecordError
from dehyst.records import cleaned, guesses, loops, recorded_slew_rate, signals
from dehyst.records.cleaning import spikes
from dehyst.records.signals import new_samples, sensor_noise
from dehyst.virtual import PlayActuator

RATE, NOISE = 50.0, 5e-9
TOPS = (100, 100, 80, 60, 40, 20, 90, 50, 100)


def triangles(rate=RATE, hold=0):
    """Voltages of triangles to each top at 50 V/s, with rests of some samples."""
    parts = [np.zeros(1)]
    for top in TOPS:
        up = np.linspace(0, top, round(top / 50 * rate) + 1)[1:]
        parts += [up, np.full(hold, top), up[::-1][1:], np.zeros(1 + hold)]
    return np.concatenate(parts)


def sines(tops=TOPS, samples=200):
    part = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(samples) / samples)
    return np.concatenate([*(top * part for top in tops), [0.0]])


def bent(v):
    part = PlayActuator(noise=0.0).play(v) * 1e5
    return 1e-5 * (0.4 * part + 0.3 * part**2)


def straight(v):
    return 1.2e-7 * v


MECHANISMS = {
    "plays": lambda v: PlayActuator(noise=0.0).play(v),
    "relays": lambda v: PreisachActuator(noise=0.0).play(v),
    "bouc-wen": lambda v: BoucWenActuator(noise=0.0).play(v, time=np.arange(v.size) / RATE),
    "bent": bent,
}
DRIVES = {"triangles": triangles(), "sines": sines(), "rests": triangles(hold=25)}
V = DRIVES["triangles"]
T = np.arange(V.size) / RATE
Y = MECHANISMS["plays"](V)


def noisy(y, noise=NOISE):
    return y + noise * np.random.default_rng(1).normal(size=y.size)


def record(v, y, rate=RATE):
    return Record(np.arange(v.size) / rate, v, y)


def late(v, samples):
    places = np.arange(v.size)
    return np.interp(places - samples, places, v)


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("mechanism", MECHANISMS)
def test_a_good_record_has_no_cause(mechanism, drive):
    v = DRIVES[drive]
    for shift in (0, 2):
        good = record(v, noisy(late(MECHANISMS[mechanism](v), shift)))
        good.check_usable()
        assert good.problems() == ()
        # A unit that is wrong by a thousand is asked about.
        assert [len(guesses(record(v, k * good.displacement))) for k in (1e-3, 1.0, 1e3)] == [1, 0, 1]
        assert [len(guesses(record(v, good.displacement, k * RATE))) for k in (1e-3, 1.0)] == [1, 0]
        assert loops.early_turns(good) == 0


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("mechanism", MECHANISMS)
def test_loops_in_the_wrong_direction_are_refused_with_their_cause(mechanism, drive):
    v = DRIVES[drive]
    y = noisy(MECHANISMS[mechanism](v))
    for word, other, made in (
        ("reversed", "swapped", record(v[::-1], y[::-1])),
        ("swapped", "reversed", record(y * 1e7, v * 1e-7)),
    ):
        said = loops.leading(made, made.cycles())
        assert word in said
        assert other not in said or "either" in said


@pytest.mark.parametrize("samples", [1, 2, 4])
@pytest.mark.parametrize("drive", ["triangles", "rests"])
@pytest.mark.parametrize("mechanism", MECHANISMS)
def test_the_lead_of_an_early_displacement_is_stated(mechanism, drive, samples):
    v = DRIVES[drive]
    early = record(v[:-samples], noisy(MECHANISMS[mechanism](v))[samples:])
    assert loops.early_turns(early) == samples
    assert "either" not in loops.leading(early, early.cycles())


def test_sorted_branches_are_found_and_a_sawtooth_is_accepted():
    up = np.linspace(0, 100, 101)
    y = MECHANISMS["plays"](np.concatenate([up, up[::-1], up, up[::-1], up, up[::-1]]))
    branches = [y[k : k + 101][:: -1 if k % 2 else 1] for k in range(0, y.size, 101)]
    made = record(np.tile(up, 6), noisy(np.concatenate(branches)))
    with pytest.raises(RecordError, match="sorted"):
        made.check_usable()
    saw = np.tile(up, 6)
    tooth = record(saw, noisy(bent(saw)))
    assert loops.leading(tooth, tooth.cycles()) == ""


@pytest.mark.parametrize(
    ("displacement", "echoes"),
    [
        (straight(V), True),
        (np.round(straight(V), 9), True),
        (np.array([float(f"{y:.6g}") for y in straight(V)]), True),
        (np.round(0.1234e-6 * V, 9), True),
        (np.concatenate([np.zeros(2), straight(V)[:-2]]), True),
        (np.concatenate([np.zeros(7), np.round(0.1234e-6 * V, 9)[:-7]]), True),
        (noisy(straight(V), 1e-10), False),
        (np.round(noisy(straight(V), 1e-9), 9), False),
        (2e-8 * np.round(noisy(0.1234e-6 * V, 4e-9) / 2e-8), False),
        (Y, False),
        (np.round(Y, 8), False),
        (straight(V) * (1 + 1e-5 * V), False),
    ],
)
def test_an_echo_of_the_command_is_refused(displacement, echoes):
    assert bool(loops.echo(record(V, displacement))) == echoes
    if echoes:
        with pytest.raises(RecordError, match="set-point"):
            record(V, displacement).check_usable()


UNEVEN = np.sort(np.random.default_rng(2).choice(V.size - 1, V.size // 6, replace=False))
HELD = {
    "every 5th": np.arange(V.size) // 5 * 5,
    "every 10th": np.arange(V.size) // 10 * 10,
    "uneven": np.concatenate([[0], UNEVEN])[np.searchsorted(UNEVEN, np.arange(V.size), side="right")],
}


@pytest.mark.parametrize("held", HELD)
def test_repeated_samples_of_a_polled_sensor_are_found(held):
    polled = record(V, noisy(Y)[HELD[held]])
    found = new_samples(polled.voltage, polled.displacement)
    assert np.count_nonzero(found) == np.unique(HELD[held]).size
    assert polled.noise == pytest.approx(NOISE, rel=0.3)
    assert not any("quantised" in sentence for sentence in polled.problems())
    taken = cleaned(polled).record
    assert len(taken) == np.unique(HELD[held]).size
    taken.check_usable()


def test_a_displacement_with_too_few_new_samples_is_refused():
    with pytest.raises(RecordError, match="every 25th sample"):
        record(V, noisy(Y)[np.arange(V.size) // 25 * 25]).check_usable()


@pytest.mark.parametrize("step", [3e-8, 1e-7, 1e-6])
def test_a_coarse_converter_is_not_taken_for_repeated_samples(step):
    coarse = record(V, step * np.round(noisy(Y) / step))
    assert new_samples(coarse.voltage, coarse.displacement) is None
    assert any("quantised" in sentence for sentence in record(V, 1e-6 * np.round(noisy(Y) / 1e-6)).problems())
    stairs = np.repeat(V[::20], 20)
    assert new_samples(stairs, MECHANISMS["plays"](stairs)) is None


@pytest.mark.parametrize("seed", range(3))
def test_uneven_time_steps_are_not_taken_for_noise(seed):
    rng = np.random.default_rng(seed)
    time = np.cumsum(0.02 * rng.gamma(4, 0.25, V.size))
    v = np.interp(time, T, V)
    assert sensor_noise(time, v, noisy(MECHANISMS["plays"](v))) == pytest.approx(NOISE, rel=0.2)


@pytest.mark.parametrize(
    ("time", "told"),
    [
        (-T, "sign"),
        (T[::-1], "wrong sign"),
        (np.floor(T / 0.05) * 0.05, 50),
        (np.floor(T / 0.03) * 0.03, 50),
        (np.concatenate([T[:500], T[:400], T[: V.size - 900]]), "sample 500 of"),
        (T - 8.0 * (T > 10), 50),
        ((T + 86390) % 86400, 50),
        (T[np.arange(T.size) // 2], 100),
        # The loops show the cause.
        ((T[::-1], V[::-1], Y[::-1]), "reverse order"),
        (tuple(column[np.arange(V.size) // 2] for column in (T, V, Y)), "written twice"),
    ],
)
def test_a_time_that_does_not_rise_is_refused_with_its_cause(time, told):
    """Told is a word, or the sample rate to give."""
    with pytest.raises(RecordError, match=told if isinstance(told, str) else "rate=") as caught:
        Record(*(time if isinstance(time, tuple) else (time, V, Y)))
    assert "drop" not in str(caught.value)
    assert ("sort the samples" in str(caught.value)) == ("set back" in str(caught.value))
    if not isinstance(told, str):
        assert float(re.search(r"rate=([\d.]+)", str(caught.value))[1]) == pytest.approx(told, rel=2e-3)


@pytest.mark.parametrize("drive", ["triangles", "sines"])
def test_a_closed_servo_loop_is_found_by_its_lag_without_hysteresis(drive):
    v = DRIVES[drive]
    for lag in (0, 1.5, 3):
        (sentence,) = record(v, noisy(straight(late(v, lag)))).problems()
        assert "servo" in sentence
        assert not lag or f" {1e3 * lag / RATE:.3g}"[:-1] in sentence


@pytest.mark.parametrize(("low", "high"), [(0, 85), (0, 94), (8, 100)])
@pytest.mark.parametrize("drive", DRIVES)
def test_a_clamped_amplifier_is_reported_with_its_voltage(drive, low, high):
    v = DRIVES[drive]
    (sentence,) = record(v, noisy(MECHANISMS["plays"](np.clip(v, low, high)))).problems()
    (volts,) = [number for number in (low, high) if number not in (0, 100)]
    assert any(f" {volts + away:.4g} V" in sentence for away in (-1, -0.5, 0, 0.5, 1))


def test_a_displacement_that_slips_is_not_taken_for_a_drift():
    v = sines((100, 100, 30, 90, 40, 20, 90, 50))
    y, travel = MECHANISMS["plays"](v), np.cumsum(np.abs(np.diff(v, prepend=0.0)))
    (sentence,) = record(v, noisy(y + 1e-9 * travel)).problems()
    assert "slips" in sentence
    assert record(v, noisy(y + 1e-7 * np.arange(v.size) / RATE)).problems() == ()


@pytest.mark.parametrize("count", [4, 10, 18, 36])
def test_fringes_are_found_and_noise_is_not_taken_for_fringes(count):
    phase = 2 * np.pi * count * Y / np.ptp(Y)
    fringes = record(V, noisy(0.5e-6 * (1 + np.cos(phase)), 1e-8))
    with pytest.raises(RecordError, match="fringes"):
        fringes.check_usable()
    with pytest.raises(RecordError, match="constant"):
        record(V, noisy(0 * V, 1e-6)).check_usable()


@pytest.mark.parametrize(("volts", "micrometres", "refused"), [(1, 190, False), (1, 1e3, True), (20, 1e3, False)])
def test_a_stroke_that_no_stage_has_with_such_voltages_is_a_wrong_unit(volts, micrometres, refused):
    """As nm that are read as um; a spike is none."""
    y = noisy(Y * micrometres)
    y[300] = 0.05
    found = record(V * volts, y)
    if not refused:
        found.check_usable()
        return
    with pytest.raises(RecordError) as caught:
        found.check_usable()
    assert (caught.value.argument, caught.value.need) == ("displacement", "at most 5 mm")
    assert "unit" in caught.value.hint


def test_overload_readings_are_left_out_before_the_loops_are_judged():
    y = noisy(Y)
    y[[300, 301, 302]], y[700] = 9999.999e-6, -1e-3
    overloaded = record(V, y)
    overloaded.check_usable()
    assert guesses(overloaded) == ()
    assert np.flatnonzero(spikes(V, y)).tolist() == [300, 301, 302, 700]
    found = cleaned(overloaded)
    assert found.record.stroke == pytest.approx(np.ptp(Y), rel=0.01)
    assert len(found.sentences) == len(overloaded.problems()) == 1


# Butterfly loops

COERCIVE = 60.0


def butterfly(low, high, noise=0.0, sign=1):
    """A ferroelectric whose polarisation P follows the voltage by a play of tanh: strain d P v + Q P^2."""
    t = np.arange(4001) / 1000
    v = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(2 * np.pi * t)
    polarisation, now = np.empty_like(v), -1.0 if low < -COERCIVE else 1.0
    for i, volts in enumerate(v):
        now = min(max(now, np.tanh((volts - COERCIVE) / 8)), np.tanh((volts + COERCIVE) / 8))
        polarisation[i] = now
    y = 1e-8 * polarisation * v + 5e-7 * polarisation**2
    return Record(t, v, sign * (y + noise * np.random.default_rng(0).normal(size=y.size)))


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("noise", [0.0, 1e-8, 1e-7])
@pytest.mark.parametrize(("low", "high"), [(-200, 200), (-100, 300), (-140, 260), (-70, 170), (-70, 70), (-200, 120)])
def test_a_butterfly_is_refused_with_the_voltages_to_record(low, high, noise, sign):
    record = butterfly(low, high, noise, sign)
    with pytest.raises(RecordError, match="rising voltage: a butterfly"):
        record.check_usable()
    _, _, turn = loops.butterfly(record.voltage, record.displacement)
    assert -COERCIVE < turn < COERCIVE
    if sign > 0:
        # And above it is a loop like any other.
        butterfly(turn, high, noise or 1e-9).check_usable()


@pytest.mark.parametrize("noise", [0.0, 1e-7])
def test_loops_within_the_coercive_field_are_not_taken_for_butterfly_loops(noise):
    butterfly(-40, 120, noise).check_usable()
    # With an inverted sensor; poled the other way and kept there: the whole displacement falls.
    for falling, words in (
        (butterfly(-40, 120, noise, -1), "the sensor's sign"),
        (butterfly(-160, 40, noise), "poled"),
    ):
        with pytest.raises(RecordError, match=words):
            falling.check_usable()


@pytest.mark.parametrize("samples", [0, 20, 100, 200])
def test_a_lag_is_not_taken_for_a_butterfly_loop(samples):
    """A phase lag makes the displacement fall at the beginning of each rise, but rise at the beginning of each fall."""
    v = 100 - 100 * np.cos(2 * np.pi * np.arange(4001) / 1000)
    assert loops.butterfly(v[200:], straight(v[200 - samples : v.size - samples])) is None


@pytest.mark.parametrize("drift", [-0.5, 0.0, 0.5])
@pytest.mark.parametrize("mechanism", MECHANISMS)
@pytest.mark.parametrize("drive", DRIVES)
def test_a_drift_is_not_taken_for_a_butterfly_loop(mechanism, drive, drift):
    y = MECHANISMS[mechanism](DRIVES[drive])
    assert loops.butterfly(DRIVES[drive], y + drift * np.ptp(y) * np.linspace(0, 1, y.size)) is None


TIME = np.arange(8000) * 2.5e-3
TRIANGLE = 50 + 50 * (4 * np.abs((TIME / 4) % 1 - 0.5) - 1)
SINE = 50 + 50 * np.sin(2 * np.pi * TIME)
RNG = np.random.default_rng(3)


JUMPS = TRIANGLE + 30.0 * (TIME > 1)
JUMPS[[500, 2000, 2001]] -= 90
JUMPS[4000:4006] = np.linspace(0, 100, 6)


@pytest.mark.parametrize(
    ("parts", "least", "most"),
    [
        *(
            ([(TIME, voltage + noise * RNG.normal(size=TIME.size))], speed, 1.15 * speed)
            for voltage, speed in ((TRIANGLE, 50.0), (SINE, 100 * np.pi))
            for noise in (0.0, 0.01, 0.2)
        ),
        ([(TIME, JUMPS)], 51.45, 53.55),
        # The fastest of several records.
        ([(TIME, TRIANGLE), (TIME, SINE)], 94 * np.pi, 106 * np.pi),
        ([(2 * TIME, TRIANGLE), (10 * TIME, TRIANGLE)], 23.5, 26.5),
        # Steps and rests alone give no speed.
        *(([(TIME, voltage)], None, None) for voltage in (np.where(TIME % 1 < 0.5, 0.0, 100.0), np.full(8000, 3.0))),
        ([(TIME[:3], TRIANGLE[:3])], None, None),
        ([], None, None),
    ],
)
def test_the_recorded_speed_is_that_of_the_fastest_branches(parts, least, most):
    found = recorded_slew_rate(parts)
    assert found is None if least is None else least <= found <= most


def test_parts_of_a_long_signal_give_the_same_result(monkeypatch):
    rng = np.random.default_rng(0)
    values = np.sin(np.arange(40_000) / 300) + 1e-3 * rng.normal(size=40_000)
    noise = signals.white_noise(values)
    monkeypatch.setattr(signals, "_STRETCH", 1000)
    assert signals.white_noise(values) == pytest.approx(noise, rel=0.05)
    assert signals.white_noise(values) != noise
    assert len(signals.turning_points(values, 0.1)) == round(40_000 / 300 / np.pi)


@pytest.mark.parametrize("samples", [10, 16, 24])
def test_few_samples_per_cycle_are_not_taken_for_noise(samples):
    v = triangles(samples / 4)
    few = record(v, noisy(MECHANISMS["plays"](v)), samples / 4)
    assert few.noise == pytest.approx(NOISE, rel=0.4)
