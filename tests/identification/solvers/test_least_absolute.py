"""Least absolute deviations: proven by duality, and against HiGHS on the same programs, hundreds of them."""

import re
import time
from dataclasses import replace

import numpy as np
import plain_records
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from dehyst._threads import one_thread
from dehyst.identification.preprocessing.regressors import collect
from dehyst.identification.regression.regression import Regression
from dehyst.identification.solvers import least_absolute
from dehyst.identification.solvers.highs import LinearSolution
from dehyst.identification.solvers.least_absolute import interior
from dehyst.identification.solvers.program import solve
from dehyst.identification.structure import Grid
from examples import at_night, examples

KINDS = ("random", "collinear", "noise-free", "tiny", "repeated rows", "rounded")


def table(kind, seed, rows, columns):
    """Rows, targets and the number of free columns of a random program."""
    rng = np.random.default_rng(seed)
    t = rng.uniform(0, 1, rows)
    a = rng.normal(size=(rows, columns))
    if kind == "collinear":
        # Neighbouring clipped ramps, as slip elements are, one of them twice.
        a = np.clip(t[:, None] - np.linspace(0, 1, columns, endpoint=False), 0, 0.3)
        a[:, -1] = a[:, 0]
    x = np.maximum(rng.normal(size=columns), 0)
    b = a @ x + (0.0 if kind == "noise-free" else 0.1) * rng.standard_t(2, rows)
    if kind == "tiny":
        a, b = a * 10.0 ** rng.uniform(-9, 0, columns), b * 1e-6
    if kind == "repeated rows":
        half = rows // 2
        a[half : 2 * half], b[half : 2 * half] = a[:half], b[:half]
    if kind == "rounded":
        b = np.round(b, 1)
    return a, b, int(rng.integers(0, min(columns, 3)))


def least(a, b, free, matrix=None, lower=None):
    """The least sum by HiGHS: the dual program, scaled to the order of one."""
    scale, unit = np.abs(a).max(axis=0), np.abs(b).max() or 1.0
    scale[scale == 0] = 1.0
    n, q = a.shape
    c = np.zeros((0, q)) if matrix is None else np.hstack([np.zeros((len(matrix), free)), matrix])
    low = np.zeros(0) if lower is None else lower
    bounds = [(-1, 1)] * n + [(0, None)] * len(c)
    both = (np.vstack([a, c]) / scale).T
    # The simplex gives up on some programs with ties.
    for method in ("highs-ds", "highs-ipm"):
        answer = linprog(
            -np.append(b, low) / unit, both[free:], np.zeros(q - free), both[:free], np.zeros(free), bounds, method
        )
        if answer.status == 0:
            return -answer.fun * unit
    raise AssertionError(answer.message)


@examples(40, nightly=400)
@given(st.sampled_from(KINDS), st.integers(0, 10**6), st.integers(20, 200), st.integers(1, 15))
def test_agrees_with_highs(kind, seed, rows, columns):
    a, b, free = table(kind, seed, rows, columns)
    found = solve(a[:, :free], a[:, free:], b, norm="l1")
    assert found.optimal, found.status
    assert np.all(found.nonnegative >= 0)
    assert np.abs(found.residual).sum() == pytest.approx(least(a, b, free), rel=1e-7, abs=1e-9 * np.abs(b).sum())
    assert abs(found.gap) < 1e-8


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(KINDS), st.integers(0, 10**6), st.integers(1, 8))
def test_a_reduced_program_has_the_optimum_of_all_rows(kind, seed, columns):
    a, b, free = table(kind, seed, 3000, columns)
    found = solve(a[:, :free], a[:, free:], b, norm="l1")
    assert found.optimal, found.status
    assert np.abs(found.residual).sum() == pytest.approx(least(a, b, free), rel=2e-6, abs=1e-9 * np.abs(b).sum())
    assert abs(found.gap) < 1e-6


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(KINDS), st.integers(0, 10**6), st.integers(2, 8))
def test_inequalities_are_kept_by_whole_and_reduced_programs(kind, seed, columns):
    rng = np.random.default_rng(seed)
    for rows in (100, 2000):
        a, b, _ = table(kind, seed, rows, columns)
        # What a coefficient would be that explains all; the targets may all be zero.
        size = (np.abs(b).max() or 1.0) / (np.abs(a).max(axis=0) + 1e-300)
        c = (rng.uniform(size=(12, columns)) < 0.5) / size
        low = rng.uniform(0, 2, 12) * np.any(c > 0, axis=1)
        found = solve(a[:, :0], a, b, norm="l1", constraints=(c, low))
        assert found.optimal, found.status
        assert np.all(c @ found.nonnegative >= low - 1e-7 * (1 + np.abs(found.nonnegative / size).max()))
        best = least(a, b, 0, c, low)
        assert np.abs(found.residual).sum() == pytest.approx(best, rel=2e-6, abs=1e-8 * np.abs(b).sum())


@pytest.mark.parametrize("seed", range(4))
def test_a_few_rows_that_outweigh_thousands_are_never_left_to_chance(seed):
    """They hold neighbouring coefficients alike, as hard as all other rows together pull them apart."""
    a, b, _ = table("random", seed, 20_000, 12)
    alike = 3000 * (np.eye(11, 12) - np.eye(11, 12, 1))
    a, b = np.vstack([a, alike]), np.append(b, np.zeros(11))
    found = solve(a[:, :0], a, b, norm="l1")
    assert found.optimal, found.status
    assert re.search(r"on \d+ of 20011 rows in round [12]\)", found.status), found.status
    assert np.abs(found.residual).sum() == pytest.approx(least(a, b, 0), rel=2e-6)


def test_a_gap_over_all_rows_is_never_below_the_true_one():
    a, b, _ = table("random", 3, 4000, 5)
    found = solve(a[:, :0], a, b, norm="l1")
    true = np.abs(found.residual).sum() - least(a, b, 0)
    assert "of 4000 rows" in found.status
    assert found.gap * np.abs(b).sum() >= true - 1e-9


def test_more_wrong_signs_than_there_is_room_for_still_end_in_the_optimum(monkeypatch):
    a, b, _ = table("random", 8, 6000, 6)
    best = least(a, b, 0)
    monkeypatch.setattr(least_absolute, "_MOST_NUMBERS", 6 * 900)
    found = solve(a[:, :0], a, b, norm="l1")
    assert found.optimal, found.status
    assert np.abs(found.residual).sum() == pytest.approx(best, rel=1e-5)


def of_a_noisy_epoch(seed, rows=9000, noisy=700):
    """Two epochs with a constant each; the few rows of the second are missed a thousand times as far."""
    a, b, _ = table("random", seed, rows, 12)
    second = np.arange(rows) >= rows - noisy
    noise = np.random.default_rng(seed).normal(size=rows) * np.where(second, 10.0, 0.01)
    return np.column_stack([~second, second]).astype(float), a, b + noise


@pytest.mark.parametrize("seed", range(4))
def test_an_epoch_that_is_missed_by_far_keeps_its_share_of_the_rows(seed):
    """Were none of its rows in the program, nothing there would hold its constant against the sum of the others."""
    free, a, b = of_a_noisy_epoch(seed)
    whole = solve(free, a, b, norm="l1")
    assert whole.optimal, whole.status
    assert np.abs(whole.residual).sum() == pytest.approx(least(np.hstack([free, a]), b, 2), rel=1e-6)


def bound(a, seed, count=20, depth=0.3):
    """Inequalities of random directions; all coefficients one half keep them, the best ones of these rows do not."""
    c = np.random.default_rng(seed).normal(size=(count, a.shape[1]))
    return c, c.sum(axis=1) / 2 - depth * np.abs(np.random.default_rng(seed + 1).normal(size=count))


@pytest.mark.parametrize("rows", [150, 3000])
@pytest.mark.parametrize("inequalities", [False, True])
def test_where_the_interior_point_fails_highs_takes_over(monkeypatch, rows, inequalities):
    a, b, _ = table("random", 1, rows, 5)
    limits = bound(a, 3) if inequalities else None
    monkeypatch.setattr(least_absolute, "interior", lambda p, pull: replace(interior(p, pull), y=np.zeros(p.goal.size)))
    found = solve(a[:, :0], a, b, norm="l1", constraints=limits)
    assert found.status.startswith("optimal (HiGHS")
    assert np.abs(found.residual).sum() == pytest.approx(least(a, b, 0, *(limits or ())), rel=1e-7)
    assert abs(found.gap) < 1e-6
    if limits is not None:
        assert np.all(limits[0] @ found.nonnegative >= limits[1] - 1e-8)


def test_a_gap_that_is_too_wide_is_no_optimum(monkeypatch):
    """Neither solver has a dual point: what was found is handed back as what it is."""
    a, b, _ = table("random", 1, 150, 5)
    monkeypatch.setattr(least_absolute, "interior", lambda p, pull: replace(interior(p, pull), y=np.zeros(p.goal.size)))
    monkeypatch.setattr(least_absolute.highs, "minimum", lambda *_, **__: LinearSolution(b, b, False, "HiGHS: asleep"))
    found = solve(a[:, :0], a, b, norm="l1")
    assert not found.optimal
    assert "asleep" in found.status


@pytest.mark.parametrize("noise", [1e-3, 1.0])
def test_inequalities_that_pull_hard_need_no_help(noise):
    """They hold the coefficients far from what the rows ask for: a start near the limits would never leave them."""
    rng = np.random.default_rng(5)
    a = rng.normal(size=(3000, 30))
    b = a @ rng.uniform(0, 1, 30) + noise * rng.normal(size=3000)
    limits = bound(a, 7, 60)
    found = solve(a[:, :0], a, b, norm="l1", constraints=limits)
    assert found.status.startswith("optimal (interior point")
    assert np.abs(found.residual).sum() == pytest.approx(least(a, b, 0, *limits), rel=1e-7)


def test_the_program_of_a_record():
    actuator = plain_records.plant(20)
    record = plain_records.loops(actuator, plain_records.THREE_LOOPS, samples=150, noise=2e-9)
    rows, _ = collect([(0, record, np.zeros(len(record)))], actuator.slip.breakaway, [2e-9])
    movable = 2 * actuator.slip.breakaway < plain_records.STROKE
    regression = Regression(
        rows,
        Grid.maxwell_slip(actuator.slip.breakaway, np.linspace(0, plain_records.STROKE, 21), movable),
        1e5,
        np.zeros(1),
    )
    found = regression.fit("l1")
    spring = regression.spring_parts
    a = np.hstack([regression.nuisances(), rows.elongation[:, movable], spring])
    best = least(a, rows.voltage - 1e5 * spring.sum(axis=1), regression.nuisances().shape[1])
    assert np.abs(found.solution.residual).sum() == pytest.approx(best, rel=1e-7)
    assert abs(found.solution.gap) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize(("columns", "inequalities"), [at_night(60, 0), (100, 200)])
def test_a_hundred_thousand_rows_take_seconds_not_minutes(columns, inequalities):
    a, b, _ = table("random", 2, 100_000, columns)
    limits = bound(a[:, 1:], 3, inequalities) if inequalities else None
    with one_thread():
        begun = time.process_time()
        found = solve(a[:, :1], a[:, 1:], b, norm="l1", constraints=limits)
        spent = time.process_time() - begun
    assert found.status.startswith("optimal (interior point")
    assert found.gap < 1e-6
    assert spent < 6
