"""Records whose displacement is known at events only, how long a sample holds, and the counting of periodic signals."""

import re
import warnings
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from truths import BoucWenActuator

import dehyst
from dehyst import Record, RecordError
from dehyst.records import counting, guesses, rms
from dehyst.records.events import counted_events, record_of_periodic
from dehyst.records.record import columns_of
from dehyst.report.pictures import record_in_time
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, recommended
from examples import at_night

T = np.arange(601) * 0.01
V = 50 - 50 * np.cos(2 * np.pi * T / 2)
FULL = 1e-7 * V
EVENTS = np.arange(0.055, 6, 0.1)
PLACES = np.interp(EVENTS, T, 0.1 * V)
KNOWN = Record.from_events(T, V, EVENTS, PLACES, units="um", name="lines")


def test_a_held_voltage_is_stated():
    held = Record(T, V, FULL, hold="sample")
    assert len(held.problems()) == len(Record(T, V, FULL).problems()) + 1
    assert "held" in repr(held)
    assert "held" not in repr(Record(T, V, FULL))
    assert held.axis(0)[3:9].hold == "sample"


def test_events_are_moved_to_the_nearest_samples():
    assert np.count_nonzero(KNOWN.measured) == EVENTS.size
    assert KNOWN.displacement[KNOWN.measured] == pytest.approx(FULL[KNOWN.measured], abs=2e-9)
    # The nearest samples, half a step away, without the correction.
    assert np.abs(np.interp(EVENTS, T, FULL) - FULL[KNOWN.measured]).max() > 5e-8
    assert KNOWN.displacement == pytest.approx(np.interp(T, T[KNOWN.measured], KNOWN.displacement[KNOWN.measured]))
    assert KNOWN.noise < 1e-9
    assert "60 events" in repr(KNOWN)
    assert any("60 events" in words for words in KNOWN.problems())
    KNOWN.check_usable()


@pytest.mark.parametrize("late", [0.0, 0.5])
def test_events_of_a_fast_motion_keep_their_displacement(late):
    # 12 um in 12 samples, with three fringes in some of them.
    time, fine = np.arange(240.0), np.linspace(0, 239, 239 * 256 + 1)
    moved = 6e-6 * (1 - np.cos(np.pi * (fine - late) / 12))
    (at,) = np.nonzero(np.diff(moved // FRINGE))
    place = FRINGE * np.round(moved[at] / FRINGE)
    record = Record.from_events(time, 50 - 50 * np.cos(np.pi * time / 12), fine[at] + 0.5 / 256, place, units="m")
    missed = (record.displacement - moved[::256])[record.measured]
    assert rms(missed) < 1e-8 and np.abs(missed).max() < 5e-8


@pytest.mark.parametrize("noise", [2e-9, 2e-8])
def test_events_have_the_noise_of_their_positions(noise):
    places = 1e-6 * PLACES + noise * np.random.default_rng(1).normal(size=PLACES.size)
    assert Record.from_events(T, V, EVENTS, places, units="m").noise == pytest.approx(noise, rel=0.35)
    few = Record.from_events(T, V, EVENTS[:12], places[:12], units="m")
    assert few.noise == 0.0


def test_fits_and_errors_use_only_events():
    aside = replace(KNOWN, set_aside=((0.0, 2.0),))
    assert np.array_equal(counting(KNOWN), KNOWN.measured)
    assert np.array_equal(counting(aside), KNOWN.measured & (T > 2.0))
    assert np.array_equal(np.isnan(columns_of(KNOWN)["displacement_um"]), ~KNOWN.measured)


def blank(rows):
    return np.where(rows, FULL, np.nan)


@pytest.mark.parametrize("rows", [np.arange(T.size) % 3 == 0, np.arange(T.size) % 25 == 0])
def test_mostly_blank_cells_are_events(tmp_path, rows):
    dehyst.records.write_columns(
        tmp_path / "a.csv", {"time_s": T, "voltage_V": V, "displacement_um": 1e6 * blank(rows)}
    )
    record = dehyst.read(tmp_path / "a.csv")
    assert np.array_equal(record.measured, rows)
    assert record.displacement[rows] == pytest.approx(FULL[rows], abs=1e-20)


@pytest.mark.parametrize(
    "make",
    [
        # Few blank cells, few numbers, none.
        lambda: Record(T, V, blank(np.arange(T.size) != 300)),
        lambda: Record(T, V, blank(np.arange(T.size) % 2 == 0)),
        lambda: Record(T, V, blank(np.arange(T.size) % 50 == 0)),
        lambda: Record(T, np.where(T > 1, np.nan, V), FULL),
        lambda: Record(T, V, blank(T > 1), measured=T > 0.5),
        lambda: Record(T, V, FULL, measured=T[1:] > 1),
        lambda: Record(T, V, FULL, measured=T),
        lambda: Record(T, V, FULL, hold="step"),
        lambda: Record.from_events(T, V, EVENTS[:3], PLACES[:3], units="um"),
        lambda: Record.from_events(T, V, EVENTS[1:], PLACES, units="um"),
        lambda: Record.from_events(T, V, EVENTS + 1, PLACES, units="um"),
        lambda: Record.from_events(T, V, EVENTS[::-1], PLACES, units="um"),
        lambda: Record.from_events(T, V, EVENTS, np.where(EVENTS > 3, np.nan, PLACES), units="um"),
        lambda: Record.from_events(T, V, EVENTS, 1e2 * PLACES, units="mm"),
        lambda: Record.from_events(T, V, EVENTS, PLACES, units="inch"),
    ],
)
def test_impossible_records_of_events_are_refused(make):
    with pytest.raises(RecordError):
        make()


FRINGE, LINE = 316.4e-9, 3e-6


def driven(rng, shape):
    """Turning voltages of a record from 0 V."""
    if shape == "random":
        return [0, 100, 0, 100, 0, *rng.uniform(0, 100, 16), 0]
    if shape == "falling":
        return [0, 100, 0] + [turn for top in np.linspace(100, 30, rng.integers(4, 9)) for turn in (top, 0)]
    return [0, *[100, float(rng.choice([0, -20]))] * int(rng.integers(3, 7))]


def periodic(seed, kind, fault=""):
    """Return time, voltage, displacement in periods, signal, and the times of the fault."""
    rng = np.random.default_rng(seed)
    periods = np.exp(rng.uniform(np.log(3), np.log(60))) if kind == "fringe" else rng.uniform(13.5, 16.5)
    shape = ("triangle", "sine", "falling", "random")[seed % 4]
    turns, rate = driven(rng, shape), rng.uniform(12, 45)
    smooth = shape == "sine" or (shape in ("falling", "random") and rng.random() < 0.5)
    parts = [np.zeros(1)]
    for a, b in pairwise(turns):
        s = np.linspace(0, 1, max(12, int(max(150, rate * periods) * abs(b - a) / 100)) + 1)[1:]
        parts.append(a + (b - a) * (0.5 - 0.5 * np.cos(np.pi * s) if smooth else s))
    v = np.concatenate(parts)
    t = 0.01 * np.arange(v.size)
    truth = (
        PlayActuator(stroke=1.0, highest=100.0, width=rng.uniform(0.2, 0.6), asymmetry=rng.uniform(-0.1, 0.12), noise=0)
        if rng.random() < 0.5
        else BoucWenActuator(
            stroke=1.0, highest=100.0, lag=rng.uniform(0.04, 0.09), resonance=2e3, delay=0, damping=0.5, noise=0
        )
    )
    y = periods * truth.play(v, time=t)
    phase, drift = y + rng.uniform(), 0.5 - 0.5 * np.cos(rng.uniform(1, 4) * t / t[-1])
    if kind == "fringe":
        wave = np.cos(2 * np.pi * phase)
    else:
        share, edge = rng.uniform(0.3, 0.7), rng.uniform(0.02, 0.08)
        wave = np.tanh((0.5 * share - np.abs((phase + 0.5) % 1 - 0.5)) / edge)
    signal = 2 + (1 - 0.2 * drift) * wave + 0.1 * t / t[-1]
    first, span = int(rng.uniform(0.2, 0.75) * t.size), rng.uniform(1.2, 6)
    last = int(np.searchsorted(np.cumsum(np.abs(np.diff(y))), np.abs(np.diff(y))[:first].sum() + span))
    last = min(last, t.size - 2)
    kept = np.ones(t.size, dtype=bool)
    if fault == "blocked":
        signal[first:last] = rng.choice([0.0, 2.0])
    elif fault == "slow":
        # A sample or two a period.
        kept[first:last] = np.arange(last - first) % int(0.7 * (last - first) / span) == 0
    signal += 0.02 * rng.normal(size=t.size)
    return t[kept], v[kept], y[kept], signal[kept], t[[first, last]]


def misses(kind, t, v, y, signal):
    """Return by how many periods events miss the truth, up to one constant."""
    when, where = counted_events(t, v, signal, 1.0, kind)
    error = where - np.interp(when, t, y)
    return np.abs(error - np.median(error))


def outcomes(kind, count, fault):
    """Return how many counts are right, refused with a time beside the fault, refused elsewhere, and wrong."""
    right = named = elsewhere = wrong = 0
    for seed in range(count):
        *arrays, (first, last) = periodic(seed, kind, fault)
        try:
            wrong += (missed := misses(kind, *arrays).max()) >= 0.3
            right += missed < 0.3
        except RecordError as error:
            times = [float(word) for word in str(error).replace(",", " ").split() if word.replace(".", "").isdigit()]
            margin = 0.1 * arrays[0][-1]
            near = any(first - margin <= time <= last + margin for time in times)
            named, elsewhere = named + near, elsewhere + (not near)
    return right, named, elsewhere, wrong


@pytest.mark.parametrize("kind", ["fringe", "grating"])
@pytest.mark.parametrize("seeds", [range(4), at_night(range(4, 100))])
def test_fringes_are_counted_correctly(kind, seeds):
    assert all(misses(kind, *periodic(seed, kind)[:-1]).max() < (0.2 if seed < 8 else 0.3) for seed in seeds)


@pytest.mark.parametrize("count", [8, at_night(100)])
@pytest.mark.parametrize("fault", [at_night("slow"), "blocked"])
@pytest.mark.parametrize(("kind", "wrong"), [("fringe", 0), ("grating", 1)])
def test_a_lost_fringe_is_refused(kind, fault, wrong, count):
    found = outcomes(kind, count, fault)
    assert found[0] <= max(1, count // 20) and found[3] <= wrong
    # A closed loop is looked at last: its cycle holds the lost count.
    assert found[1] >= 0.9 * (found[1] + found[2])


@pytest.mark.parametrize("creep", [0.0, 0.01, 0.02])
@pytest.mark.parametrize("phase", [0.0, 0.4])
def test_a_stage_is_counted_while_it_is_held_and_creeps(creep, phase):
    played = recommended(100, drive=Sampling(0.1, sample_rate=100, slew_rate=20.0))
    stage = PlayActuator(stroke=60.0, highest=100.0, width=0.6, creep=creep, noise=0)
    y = stage.play(played.voltage, time=played.time)
    signal = np.cos(2 * np.pi * (y + phase)) + 0.02 * np.random.default_rng(1).normal(size=y.size)
    assert misses("fringe", played.time, played.voltage, y, signal).max() < 0.2


def test_a_signal_is_counted_at_the_rate_that_its_refusal_advises():
    def recorded(rate):
        played = recommended(100, drive=Sampling(0.1, sample_rate=rate, slew_rate=60.0))
        y = PlayActuator(stroke=12e-6, highest=100.0, noise=0).play(played.voltage, time=played.time)
        signal = np.cos(2 * np.pi * y / FRINGE)
        return record_of_periodic(played.time, played.voltage, signal, FRINGE, kind="fringe", name="a")

    with pytest.raises(RecordError, match="too few samples") as refused:
        recorded(30)
    rate = float(re.search(r"sample at ([\d.]+) Hz", str(refused.value))[1])
    assert 53.0 / rate <= recorded(rate).meta["step_V"] < 53.0 / 30


def clean(**how):
    t, v, y, signal, _ = periodic(1, "fringe")
    return how.get("t", lambda t: t)(t), how.get("v", lambda v: v)(v), how.get("s", lambda s, _: s)(signal, y)


@pytest.mark.parametrize(
    "change",
    [
        {"s": lambda s, _: np.random.default_rng(1).normal(size=s.size)},
        {"s": lambda s, _: np.full(s.size, 2.0)},
        # No period, one in all, too few a branch.
        {"s": lambda _, y: y},
        {"s": lambda _, y: np.cos(2 * np.pi * y / np.ptp(y))},
        {"s": lambda _, y: np.cos(1.3 * np.pi * y / np.ptp(y) + 1)},
        {"s": lambda s, _: np.where(np.arange(s.size) == 7, np.nan, s)},
        {"v": lambda v: np.where(np.arange(v.size) % 2, v, v + 30)},
        {"v": lambda v: 0 * v},
    ],
)
def test_a_signal_that_cannot_be_counted_is_refused(change):
    with pytest.raises(RecordError), warnings.catch_warnings():
        warnings.simplefilter("error")
        record_of_periodic(*clean(**change), FRINGE, kind="fringe", name="a")


@pytest.mark.parametrize(("period", "kind"), [(0, "fringe"), (-1, "fringe"), (np.nan, "fringe"), (FRINGE, "grid")])
def test_an_impossible_period_or_kind_is_refused(period, kind):
    with pytest.raises(RecordError):
        record_of_periodic(*clean(), period, kind=kind, name="a")


@pytest.mark.parametrize(("kind", "period"), [("fringe", FRINGE), ("grating", LINE)])
def test_a_file_of_a_periodic_signal_is_a_record_of_events(tmp_path, kind, period):
    t, v, y, signal, _ = periodic(2, kind)
    path = tmp_path / "a.csv"
    dehyst.records.write_columns(path, {"time_s": t, "voltage_V": v, "photodiode_V": signal})
    columns = f"time=time_s, voltage=voltage_V, displacement=photodiode_V*{kind} {1e9 * period:.6g} nm"
    record = dehyst.read(path, columns)
    error = record.displacement[record.measured] / period - y[record.measured]
    assert np.abs(error - np.median(error)).max() < 0.2
    assert [(channel.name, channel.unit) for channel in record.others] == [("signal", "V")]
    assert len(record) == t.size
    assert sum(f"{1e9 * period:.7g} nm of travel" in words for words in record.problems()) == 1
    *_, chart = record_in_time(record)
    assert (chart.y.quantity, len(chart.series[-1].x)) == ("signal", np.count_nonzero(record.measured))


@pytest.mark.parametrize(("period", "doubtful"), [(633e-9, 1), (1550e-9, 1), (316.4e-9, 0), (775e-9, 0)])
def test_a_period_of_a_whole_wavelength_is_doubted(period, doubtful):
    record = record_of_periodic(*clean(), period, kind="fringe", name="a")
    assert sum("a laser wavelength" in words for words in guesses(record)) == doubtful
