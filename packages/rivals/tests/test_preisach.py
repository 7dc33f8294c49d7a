"""Preisach's model: against relays one by one, its laws, and both ways to identify it."""

from itertools import pairwise

import numpy as np
import plain_records
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import SEEDS
from truths import PreisachActuator

import dehyst
from dehyst import IdentifyError, ModelError, Record
from dehyst.records.signals import largest, rms
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, standard
from dehyst_rivals.preisach import Preisach, PreisachState

VOLTS = 100.0
STROKE = 1e-5
FINE = 6


def densities(seed, cells):
    """Displacement held by each cell: squares below the diagonal, reversible on it."""
    rng = np.random.default_rng(seed)
    held = np.tril(rng.exponential(size=(cells, cells)) * (rng.random((cells, cells)) > 0.3), -1)
    held = 0.4 * held / max(held.sum(), 1e-9)
    return STROKE * (held + np.diag(0.6 * rng.uniform(0.3, 1.0, cells) / cells))


def of(held, bottom=1e-6, low=0.0):
    """The model of such densities, its table summed cell by cell."""
    n = len(held)
    table = [[held[:i, j:].sum() for j in range(n + 1)] for i in range(n + 1)]
    return Preisach((low, low + VOLTS), table, bottom)


def by_relays(held, voltage, bottom=1e-6):
    """Displacement by switching FINE^2 relays in each cell one by one, from all down; the diagonal is a curve."""
    n = len(held)
    step = VOLTS / n
    offsets = (np.arange(FINE) + 0.5) / FINE
    i, j = np.tril_indices(n, -1)
    up = (step * (i[:, None, None] + offsets[None, :, None]) + 0 * offsets).ravel()
    down = (step * (j[:, None, None] + offsets[None, None, :]) + 0 * offsets[:, None]).ravel()
    weight = np.repeat(held[i, j] / FINE**2, FINE**2)
    on, out = np.zeros(up.size, dtype=bool), []
    curve = np.concatenate([[0], np.cumsum(np.diagonal(held))])
    for v in voltage:
        on = (on | (v >= up)) & ~(v <= down)
        out.append(bottom + weight[on].sum() + np.interp(v, step * np.arange(n + 1), curve))
    return np.array(out)


def path(seed, n, cells):
    """Voltages on the lines between relays, where the count of relays is the area itself."""
    rng = np.random.default_rng([seed, 1])
    return VOLTS / (cells * FINE) * rng.integers(0, cells * FINE + 1, n)


@given(SEEDS, st.integers(1, 9), st.integers(0, 60))
def test_the_model_equals_a_sum_of_single_relays(seed, cells, n):
    held = densities(seed, cells)
    voltage = path(seed, n, cells)
    np.testing.assert_allclose(
        of(held).simulate(voltage).displacement, by_relays(held, voltage), rtol=0, atol=1e-13 * STROKE
    )


@given(SEEDS, st.integers(1, 30))
def test_the_inverse_is_exact_within_and_beyond_the_plane(seed, cells):
    model = of(densities(seed, cells), low=-30.0)
    voltage = np.random.default_rng([seed, 2]).uniform(-60, 100, 80)
    motion = model.simulate(voltage)
    back = model.compensate(motion.displacement)
    np.testing.assert_allclose(back.voltage, voltage, atol=1e-11 * VOLTS)
    again = model.simulate(back.voltage)
    np.testing.assert_allclose(again.displacement, motion.displacement, atol=1e-13 * STROKE)


@given(SEEDS, st.integers(2, 12))
def test_minor_loops_between_the_same_voltages_are_congruent(seed, cells):
    model = of(densities(seed, cells))
    low, high = sorted(np.random.default_rng([seed, 3]).uniform(20, 80, 2))
    loop = np.concatenate([np.linspace(high, low, 20), np.linspace(low, high, 20)])
    first, second = (
        model.simulate(np.concatenate([start, [low], loop])).displacement[-40:]
        for start in ([0.0, 100.0], [100.0, 0.0, 85.0, 15.0])
    )
    np.testing.assert_allclose(first - first[0], second - second[0], rtol=0, atol=1e-13 * STROKE)


def test_full_excursions_empty_the_memory():
    model = of(densities(4, 10))
    decay = 50 + 49 * np.linspace(1, 0, 41) * (-1.0) ** np.arange(41)
    state = model.simulate(decay).state
    assert len(state.turns) > 30
    assert len(model.simulate([-1.0], state=state).state.turns) == 1
    assert len(model.simulate([101.0], state=state).state.turns) == 1
    top = model.simulate([0.0, 100.0, 40.0]).state
    np.testing.assert_array_equal(top.turns, [[0.0, 1e-6], [100.0, 1e-6 + model.everett[-1, 0]]])


def recorded(model, tops):
    """Major loops, then cycles from the bottom with these tops, by the model itself."""
    turns = np.concatenate([[0.0], *[[top, 0.0] for top in (VOLTS, VOLTS, VOLTS, *tops)]])
    u = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, 201) / 200)
    branches = [a + (b - a) * u for a, b in pairwise(turns)]
    voltage = np.concatenate([[0.0], *branches])
    return Record(np.arange(voltage.size) / 100, voltage, model.simulate(voltage).displacement)


@pytest.mark.parametrize("seed", range(3))
def test_both_fits_recover_a_preisach_truth(seed):
    cells = 8
    truth = of(densities(seed, cells))
    record = recorded(truth, VOLTS * np.arange(cells - 1, 0, -1) / cells)
    floor = 1e-3
    fitted = Preisach.fit(record, cells=cells, smoothing=0, slope_floor=floor, delay=0.0)
    np.testing.assert_allclose(fitted.everett, truth.everett, atol=1e-9 * STROKE)
    assert fitted.bottom == pytest.approx(truth.bottom, abs=1e-9 * STROKE)
    read = Preisach.from_reversal_curves(record, cells=cells, slope_floor=floor, delay=0.0)
    # Curves are merged on 200 places: E between them is off by what a chord cuts off a corner.
    np.testing.assert_allclose(read.everett, truth.everett, atol=2e-3 * STROKE)
    assert fitted.parameters == read.parameters == 37


def test_a_curve_that_turns_early_gives_e_only_along_its_way():
    """A fall from the top that ends half-way, as in a staircase, leaves the rest to the falls that go on."""
    cells = 8
    truth = of(densities(1, cells))
    record = recorded(truth, VOLTS * np.arange(cells - 1, 0, -1) / cells)
    short = standard.raised_cosine([VOLTS, VOLTS], cycles=1, drive=Sampling(sample_rate=4.0)).voltage
    down = VOLTS * (0.75 + 0.25 * np.cos(np.pi * np.arange(1, 101) / 100))
    voltage = np.concatenate([short, short[: short.size // 4 + 1], down, down[::-1], down])
    stairs = Record(np.arange(voltage.size) / 100, voltage, truth.simulate(voltage).displacement)
    options = {"cells": cells, "slope_floor": 1e-3, "delay": 0.0}
    alone, both = (Preisach.from_reversal_curves(records, **options) for records in (record, [record, stairs]))
    np.testing.assert_allclose(both.everett, alone.everett, atol=2e-3 * STROKE)


def test_only_slow_curves_are_used_if_others_are_fast():
    """The same curves, driven ten times as fast and swollen as by a resonance, leave the table alone."""
    truth = of(densities(2, 8))
    slow = recorded(truth, VOLTS * np.arange(7, 0, -1) / 8)
    fast = Record(slow.time / 10, slow.voltage, 1.05 * slow.displacement)
    options = {"cells": 8, "slope_floor": 1e-3, "delay": 0.0}
    alone, both = (Preisach.from_reversal_curves(records, **options) for records in (slow, [slow, fast]))
    np.testing.assert_allclose(both.everett, alone.everett, atol=1e-12 * STROKE)


@pytest.fixture(scope="module")
def plays():
    truth = PlayActuator(seed=1)
    tops = standard.descending_tops(truth.highest, drive=Sampling(sample_rate=4.0))
    others = standard.raised_cosine([200, 150, 90, 120], cycles=2, drive=Sampling(sample_rate=4.0))
    return (Record(tops.time, tops.voltage, truth.play(tops.voltage)), others, truth)


@pytest.mark.parametrize(("fit", "most"), [(Preisach.fit, 0.3), (Preisach.from_reversal_curves, 0.6)])
@pytest.mark.nightly
def test_errors_on_plays_and_relays_are_those_of_the_literature(plays, fit, most):
    for truth in (plays[2], PreisachActuator()):
        tops = plays[0].voltage
        truth.relax()
        model = fit(Record(plays[0].time, tops, truth.play(tops)))
        voltage = plays[1].voltage
        miss = (truth.play(voltage, measured=False) - model.simulate(voltage).displacement)[400:]
        assert 100 * largest(miss) / truth.stroke < most
        assert 100 * rms(miss) / truth.stroke < most / 3


@pytest.mark.nightly
def test_smoothing_determines_what_descending_tops_leave_open(plays):
    voltage = plays[1].voltage
    plays[2].relax()
    true = plays[2].play(voltage, measured=False)[400:]
    bare, smooth = (Preisach.fit(plays[0], smoothing=s).simulate(voltage).displacement[400:] for s in (0, 1e-5))
    assert rms(true - smooth) < 0.5 * rms(true - bare)


def test_impossible_arguments_are_refused():
    table = of(densities(0, 4)).everett
    with pytest.raises(ModelError, match="finite nodes"):
        Preisach((0, 1), table[:3])
    with pytest.raises(ModelError, match="would fall"):
        Preisach((0, 1), np.zeros((3, 3)))
    with pytest.raises(ModelError, match="would fall"):
        Preisach((0, 1), table - 0.9 * np.outer(np.arange(5) == 4, np.arange(5) == 0) * table[4, 0])
    with pytest.raises(ModelError, match="lower one"):
        Preisach((1, 0), table)
    with pytest.raises(ModelError, match="need a PreisachState"):
        Preisach((0, 1), table).simulate([0.5], state=dehyst.State(0.0, []))
    with pytest.raises(ModelError, match="need a PreisachState"):
        Preisach((0, 1), table).simulate([0.5], state=PreisachState(0.5, 0.0, np.zeros((0, 2))))
    for turns in (
        [[0, 0], [0.4, 0], [0.6, 0]],
        [[0, 0], [2, 0]],
        [[0, 0], [np.nan, 0]],
        [[0.1, 0]],
        [[0, 0], [0.4, 0]],
    ):
        with pytest.raises(ModelError, match="model returned"):
            Preisach((0, 1), table).compensate([0.5], state=PreisachState(0.5, 0.0, np.array(turns)))
    record = plain_records.loops(plain_records.plant(), plain_records.MAJOR)
    for options, said in (
        ({"cells": 1}, "cells: got 1"),
        ({"cells": 2.5}, "cells: got 2.5"),
        ({"smoothing": -1}, "smoothing: got -1"),
        ({"slope_floor": 0}, "slope_floor: got 0"),
        ({"delay": 1e3}, "delay: got 1000.0"),
    ):
        with pytest.raises(IdentifyError, match=said):
            Preisach.fit(record, **options)
    with pytest.raises(IdentifyError, match="need records"):
        Preisach.fit(np.zeros(3))
    with pytest.raises(IdentifyError, match="got no records"):
        Preisach.fit([])
    with pytest.raises(IdentifyError, match="first-order reversal"):
        Preisach.from_reversal_curves(record)
