"""How much model: the greedy search by its rule, its folds, and what it keeps on actuators that are known."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest
import structured_records as wide

from dehyst.identification import Structure, structure_selection
from dehyst.identification.regression.fold_sums import FoldSums, blocks
from dehyst.identification.run import IdentificationRun
from dehyst.identification.settings import Settings
from dehyst.identification.structure_selection import PARTS, StructureTrial, Tried, select

START = Structure()


def errors_by(monkeypatch, error):
    """Let trials have a held-out error that is a function of the structure."""

    def trial(build, structure, progress, before=None):
        return Tried(StructureTrial(structure, error(structure), 0.0, 0.0))

    monkeypatch.setattr(structure_selection, "try_structure", trial)


def test_parts_are_added_while_one_is_worth_it(monkeypatch):
    def error(one):
        return 1.0 - 0.5 * bool(one.transformer) - 0.2 * (one.grades > 1) - 0.001 * one.smooth

    errors_by(monkeypatch, error)
    best, trials = select(None, START, None)
    assert best == replace(START, transformer=20, grades=8)
    # One by itself, five parts, the four left, the three left, none of them worth it, and what is tuned.
    assert len(trials) == 1 + 5 + 4 + 3 + 3
    assert trials[0].structure == START
    assert len({trial.structure for trial in trials}) == len(trials)


@pytest.mark.parametrize(("gain", "kept"), [(0.15, False), (0.25, True)])
def test_a_transformer_beside_grades_must_be_worth_twenty_percent(monkeypatch, gain, kept):
    """Whichever of the two came first."""
    for graded in (0.1, 0.5):
        errors_by(monkeypatch, lambda one, g=graded: (1 - g * (one.grades > 1)) * (1 - gain * bool(one.transformer)))
        best, _ = select(None, START, None)
        assert best.grades > 1
        assert bool(best.transformer) is kept


@pytest.mark.parametrize(("gain", "taken"), [(0.029, False), (0.031, True)])
def test_a_part_must_be_worth_three_percent(monkeypatch, gain, taken):
    errors_by(monkeypatch, lambda one: 1.0 - gain * bool(one.creep))
    best, _ = select(None, START, None)
    assert bool(best.creep) is taken


def test_what_cannot_be_told_apart_is_not_added(monkeypatch):
    """A held-out error that is no number is worse than any."""
    errors_by(monkeypatch, lambda one: float("nan") if one != START else 1.0)
    assert select(None, START, None)[0] == START


def test_every_part_can_be_added(monkeypatch):
    def error(one):
        return 0.5 ** sum([one.elements == 40, one.transformer > 0, one.grades > 1, one.creep > 0, one.smooth])

    errors_by(monkeypatch, error)
    best, trials = select(None, START, None)
    assert len(trials) == 1 + 5 + 4 + 3 + 2 + 1 + 1 + 3
    assert best == Structure(elements=40, spacing=2.0, knots=41, transformer=20, grades=8, creep=9, smooth=True)
    assert best == Structure(**{key: value for change in PARTS for key, value in change.items()})


def test_what_was_found_is_tuned(monkeypatch):
    """Smoothing goes one way only, and plain elements get no finer grades."""
    errors_by(monkeypatch, lambda one: 1.0 - 0.1 * (one.grades == 8) - one.smoothing)
    best, trials = select(None, START, None, without=("creep",))
    assert best == replace(START, grades=8, smoothing=3e-3)
    assert all(not trial.structure.creep for trial in trials)
    errors_by(monkeypatch, lambda one: 1.0 - 0.1 * (one.grades > 1) - 0.1 * (one.grades == 16) - 10 * one.smoothing)
    best, trials = select(None, START, None)
    assert best == replace(START, grades=16, smoothing=1e-2)
    assert len({trial.structure for trial in trials}) == len(trials)
    errors_by(monkeypatch, lambda one: 1.0)
    assert {trial.structure.grades for trial in select(None, START, None)[1]} == {1, 8}


def regression():
    plant = wide.plant(wide.STRUCTURES["graded"])
    return wide.regression(plant.grid, [plant.record(noise=1e-3 * plain_records.STROKE)])


def test_a_held_out_error_is_that_of_a_fit_without_its_block():
    """A second way, block by block: no row of a fold enters its own prediction."""
    whole = regression()
    weights = np.ones(len(whole.rows))
    errors = FoldSums(whole, weights, folds=3).held_out_errors()
    fold = blocks(whole.rows.voltage, whole.rows.epoch) % 3
    for k in range(3):
        spoilt = np.where(fold == k, 1000.0, 0.0)
        other = replace(whole, rows=replace(whole.rows, voltage=whole.rows.voltage + spoilt))
        found = replace(other, rows=other.rows.chosen(fold != k)).fit("l2")
        out = replace(whole, rows=whole.rows.chosen(fold == k))
        np.testing.assert_allclose(errors[fold == k], out.residual(found) / out.slope(found), rtol=1e-6, atol=1e-15)
    found = whole.fit("l2", weights)
    assert errors.std() > (whole.residual(found) / whole.slope(found)).std()


def test_blocks_are_cycles_and_long_legs_are_cut():
    rows = wide.regression(
        wide.plant(wide.STRUCTURES["plain"]).grid, [plain_records.loops(plain_records.plant(8), (1, 0) * 40)]
    ).rows
    number = blocks(rows.voltage, rows.epoch)
    assert np.all(np.diff(number) >= 0)
    starts = np.flatnonzero(np.diff(number)) + 1
    # Cycles of 200 samples, each from a maximum or each from a minimum.
    assert np.unique(np.diff(starts)).tolist() == [200]
    slow = wide.regression(
        wide.plant(wide.STRUCTURES["plain"]).grid,
        [plain_records.loops(plain_records.plant(8), (1, 0, 1, 0), samples=600)],
    )
    counts = np.bincount(blocks(slow.rows.voltage, slow.rows.epoch))
    assert counts.max() <= len(slow.rows) // 12 + 1
    assert np.count_nonzero(counts) >= 12


def test_epochs_are_not_mixed():
    """Blocks begin anew where an epoch does: each has a constant of its own."""
    plant = wide.plant(wide.STRUCTURES["plain"])
    records = [plant.record(), plant.record()]
    rows = wide.regression(plant.grid, records).rows
    number = blocks(rows.voltage, rows.epoch)
    first, second = (set(number[rows.record == q].tolist()) for q in (0, 1))
    assert not first & second


@pytest.mark.parametrize("noise", [2e-4, 1e-3])
def test_a_plain_actuator_keeps_the_plain_structure(noise):
    plant = plain_records.plant(20, seed=3)
    records = [
        plain_records.loops(plant, plain_records.DESCENDING_TOPS, noise=noise * plain_records.STROKE),
        plain_records.loops(plant, plain_records.THREE_LOOPS, noise=noise * plain_records.STROKE, seed=1, name="loops"),
    ]
    frame = wide.frame(records)
    run = IdentificationRun(Settings(), list(frame.training), [], lambda _: None)
    best, _ = run.search(frame, Structure())
    assert replace(best, smoothing=START.smoothing) == START
