"""Records of events: what lies between events is filled over the voltage, and filled anew by a simulation."""

import re
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

import dehyst
from dehyst import Record
from dehyst.identification.events import filled, identified, refilled
from dehyst.records import largest, rms
from dehyst.records.events import record_of_periodic
from dehyst.report.sections import before_and_after
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, recommended

LEVELS = [0, 100, 0, 80, 20, 60, 30, 90, 5, 50, 10, 40, 0]
TURNS = np.cumsum([0, *(2 * np.abs(np.diff(LEVELS)))])
V = np.interp(np.arange(TURNS[-1] + 1), TURNS, LEVELS)
T = 0.01 * np.arange(V.size)


def motion(voltage):
    """Plays with weights that fall, and a spring that bends [m]."""
    widths, held, path = np.linspace(2, 50, 25), np.zeros(25), []
    weights = np.exp(-widths / 15)
    for v in voltage:
        held = np.clip(held, v - widths, v + widths)
        path.append(0.8 * v + 1e-3 * v**2 + 0.5 * weights @ held / weights.sum())
    return 1e-7 * np.array(path)


Y = motion(V)
STROKE = float(np.ptp(Y))


def events_of(displacement, lines, noise=0.0, voltage=V):
    """Return the record that passes lines, and the error of nothing but its noise."""
    known = np.append(False, np.diff(np.floor(lines * displacement / np.ptp(displacement) + 0.3)) != 0)
    y = displacement + noise * STROKE * np.random.default_rng(1).standard_normal(displacement.size)
    return Record(T, voltage, np.where(known, y, np.nan), measured=known)


def error(record, truth=Y):
    return np.abs(record.displacement - truth).max() / STROKE


@pytest.mark.parametrize("lines", [5, 15, 40])
def test_filling_keeps_events_and_makes_branches_monotone(lines):
    record = events_of(Y, lines)
    found = filled(record)
    assert np.array_equal(found.displacement[record.measured], record.displacement[record.measured])
    assert np.array_equal(found.measured, record.measured)
    for a, b in pairwise(TURNS.tolist()):
        assert (np.diff(found.displacement[a : b + 1]) * np.sign(V[b] - V[a]) >= -1e-9 * STROKE).all()


@pytest.mark.parametrize("voltage", [V, np.repeat(V[::10], 10)[: V.size]], ids=["even", "held"])
def test_filling_is_exact_for_a_linear_stage(voltage):
    found = filled(events_of(1e-7 * voltage + 3e-6, 9, voltage=voltage))
    assert found.displacement == pytest.approx(1e-7 * voltage + 3e-6, abs=1e-6 * STROKE)


@pytest.mark.parametrize(("lines", "most"), [(8, 0.015), (15, 0.008), (40, 0.005)])
def test_a_filled_record_is_near_the_truth(lines, most):
    record = events_of(Y, lines)
    assert error(filled(record)) < most < 0.3 * error(record)
    assert error(filled(events_of(Y, lines, noise=1e-3))) < most + 0.004


def test_filling_tolerates_noise_of_the_voltage():
    noisy = V + 0.2 * np.random.default_rng(2).standard_normal(V.size)
    assert error(filled(events_of(Y, 15, voltage=noisy))) < 0.015


@pytest.mark.parametrize("few", [0, 1, 2, 3])
def test_a_branch_with_few_events_is_filled_like_other_branches(few):
    record = events_of(Y, 15)
    a, b = TURNS[7:9]
    own = np.flatnonzero(record.measured[a : b + 1]) + a
    known = record.measured.copy()
    known[np.delete(own, np.linspace(0, own.size - 1, few).astype(int))] = False
    assert error(filled(Record(T, V, np.where(known, Y, np.nan), measured=known))) < 0.06


def test_four_events_are_enough():
    known = np.isin(np.arange(V.size), [40, 90, 260, 500])
    found = filled(Record(T, V, np.where(known, Y, np.nan), measured=known))
    assert np.ptp(found.displacement) < 2 * STROKE
    assert np.array_equal(found.displacement[known], Y[known])


def test_refilling_adds_the_interpolated_error_to_the_simulation():
    record = filled(events_of(Y, 15))
    late = slice(100, 900)
    found = refilled(record, T[late], Y[late] + 1e-6)
    assert found.displacement[late] == pytest.approx(Y[late], abs=1e-6 * STROKE)
    outside = np.ones(V.size, dtype=bool)
    outside[late] = False
    assert np.array_equal(found.displacement[outside], record.displacement[outside])
    known = record.measured
    wrong = refilled(record, T, Y + 1e-7 * np.sin(T))
    assert np.array_equal(wrong.displacement[known], record.displacement[known])
    # A simulation leaves out the drift that was subtracted.
    there = (T < 4) | (T > 6)
    found = refilled(record, T[there], Y[there])
    assert np.array_equal(found.displacement[~there], record.displacement[~there])


@pytest.mark.parametrize(("shift", "calls"), [(0.0, 1), (0.1, 2)])
def test_fits_are_repeated_until_they_converge(shift, calls):
    seen = []

    def identify(records, held_out):
        seen.append(records)
        return SimpleNamespace(
            traces=[SimpleNamespace(time=T, simulated=Y + shift * STROKE * np.sin(2 * T))], number=len(seen)
        )

    whole = Record(T, V, Y)
    record = events_of(Y, 15)
    assert identified([record], [], identify).number == calls
    assert len(seen) == calls
    known = seen[0][0].measured
    assert known[record.measured].all() and known[TURNS].all()
    assert np.count_nonzero(known) <= np.count_nonzero(record.measured) + TURNS.size
    assert identified([record], [], identify, rounds=0).number == calls + 1
    assert filled(whole) is whole and refilled(whole, T, Y) is whole
    assert identified([whole], [], identify).number == calls + 2
    assert seen[-1][0] is whole


@pytest.fixture(scope="module")
def fitted():
    """A model of fringes of a stage that creeps a little, which the model cannot explain."""
    played = recommended(100.0, drive=Sampling(0.5, sample_rate=1000, slew_rate=100.0))
    y = PlayActuator(stroke=12e-6, highest=100.0, creep=0.002, noise=0).play(played.voltage, time=played.time)
    signal = np.cos(2 * np.pi * y / 316.4e-9)
    record = record_of_periodic(played.time, played.voltage, signal, 316.4e-9, kind="fringe", name="a")
    return dehyst.identify(record), record


def test_a_record_has_one_count_of_events_and_samples(fitted):
    fit, record = fitted
    told = "\n".join([*record.problems(), *fit.repairs, *dehyst.check(fit.actuator, record).remarks])
    counts = {(int(events), int(samples)) for events, samples in re.findall(r"(\d+) events of (\d+) samples", told)}
    assert counts == {(np.count_nonzero(record.measured), len(record))} and len(record) > 20_000
    left = [(float(s), int(n)) for s, n in re.findall(r"([\d.]+) s \((\d+) samples", told)]
    assert left and all(n / s == pytest.approx(1000, rel=0.1) for s, n in left)


def test_errors_are_those_of_the_events(fitted):
    fit, _ = fitted
    (trace,), (error,) = fit.traces, fit.errors
    counted = trace.counted
    assert counted.time.size == error.samples < 0.5 * trace.time.size
    assert largest(counted.residual) == largest(trace.residual) == error.largest
    assert rms(counted.residual) == error.rms == pytest.approx(fit.remaining[0].rms, rel=0.05)
    settled = trace.settled.counted.residual
    # The report draws and states the same error.
    drawn = before_and_after(fit)
    stated = [float(number) for number in re.findall(r"([\d.]+) %", drawn.caption)]
    assert stated[-1] == pytest.approx(100 * largest(settled) / error.stroke, rel=0.01)
    assert np.nanmax(np.abs(drawn.charts[0].series[1].y)) == pytest.approx(stated[-1], rel=0.1)


def test_filling_keeps_the_times_that_are_left_out():
    record = replace(events_of(Y, 15), set_aside=((2.0, 3.0),))
    assert filled(record).set_aside == record.set_aside
