"""The regression of wider actuators: its rows a second way, known coefficients, inequalities and starts of creep."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import plain_records
import pytest
import structured_records as wide
from hypothesis import given, settings
from hypothesis import strategies as st

from dehyst import IdentifyError, ModelError, State
from dehyst.identification import Structure
from dehyst.identification.preprocessing.regressors import epochs
from dehyst.identification.regression import regression as program
from dehyst.identification.regression.coefficients import Coefficients
from dehyst.identification.structure import Grid

NAMES = tuple(wide.STRUCTURES)


@cache
def known(name, seed=0):
    return wide.plant(wide.STRUCTURES[name], seed)


@cache
def rows_of(name, seed=0):
    plant = known(name, seed)
    return wide.regression(plant.grid, [plant.record()])


@given(name=st.sampled_from(NAMES), seed=st.integers(0, 1000))
@settings(max_examples=25)
def test_every_row_says_what_compensate_says(name, seed):
    plant, regression = known(name, seed), rows_of(name, seed)
    left = regression.residual(plant.coefficients(regression))
    assert len(left) > 0.8 * plant.path.size
    assert np.abs(left).max() < 1e-11 * plain_records.VOLTS


@given(name=st.sampled_from(NAMES), seed=st.integers(0, 1000))
@settings(max_examples=15)
def test_the_slope_of_a_row_is_the_slope_of_compensate(name, seed):
    """Tau's change over a small step ahead, from the state that the record has reached; creep holds as a spring."""
    plant, regression = known(name, seed), rows_of(name, seed)
    slope = regression.slope(plant.coefficients(regression))
    samples = np.concatenate([np.arange(one.start, one.stop) for one in epochs(plant.record())])
    # Major loops go through knots, and their ends; just after a turn smooth elements are taken to go on.
    inside = (samples > 125) & (samples < plant.path.size - 1) & ~regression.rows.stuck[:, 0]
    actuator, step = plant.actuator, 1e-6 * plain_records.STROKE
    for row in np.random.default_rng(seed).choice(np.flatnonzero(inside), 8).tolist():
        k = samples[row]
        state = actuator.compensate(plant.path[: k + 1], time=plant.time[: k + 1], state=plant.state).state
        ahead = step * np.sign(plant.path[k] - plant.path[k - 1])
        v = actuator.compensate([plant.path[k], plant.path[k] + ahead], time=[0, 1e-12], state=state).voltage
        tau = v if actuator.transformer is None else actuator.transformer(v)
        assert np.diff(tau)[0] / ahead == pytest.approx(slope[row], rel=1e-3)


def told(grid, found):
    """Coefficients without what no record tells: the stiffness on a segment that the element's cart never enters.

    There only the displacement itself moves within the segment, as it does in the spring's; a cart that is always
    above it adds a constant.
    """
    stiffness, slopes, offset = np.array(found.stiffness), np.array(found.slopes), np.array([*found.offsets.values()])
    lowest, highest = grid.breakaway, grid.grades[-1] - grid.breakaway
    for m, (a, b) in enumerate(pairwise(grid.grades)):
        never = (highest <= a * (1 + 1e-9)) | (lowest >= b * (1 - 1e-9))
        inside = (grid.knots[:-1] >= a * (1 - 1e-9)) & (grid.knots[1:] <= b * (1 + 1e-9))
        slopes[inside] += stiffness[never, m].sum()
        offset -= stiffness[never & (lowest >= b * (1 - 1e-9)), m].sum() * (b - a)
        stiffness[never, m] = 0
    return stiffness, slopes, found.internal, found.transformer, offset


@pytest.mark.parametrize("norm", ["l1", "l2"])
@pytest.mark.parametrize("name", NAMES)
def test_known_coefficients_come_back(name, norm):
    plant, regression = known(name), rows_of(name)
    found, true = regression.fit(norm), plant.coefficients(regression)
    assert found.solution.optimal
    assert abs(found.solution.gap) < 1e-9
    assert np.abs(regression.residual(found)).max() < 1e-9 * plain_records.VOLTS
    for got, expected in zip(told(plant.grid, found), told(plant.grid, true), strict=True):
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-8 * np.abs(expected).max(initial=0.0))


@pytest.mark.parametrize("name", NAMES)
def test_parts_of_found_coefficients_make_the_actuator(name):
    plant, regression = known(name), rows_of(name)
    found = regression.fit("l2")
    actuator = found.to_actuator(plant.grid, found.offsets[0])
    v = actuator.compensate(plant.path, time=plant.time, state=plant.state).voltage
    assert np.abs(v - plant.record().voltage).max() < 1e-8 * plain_records.VOLTS
    again, grid = Coefficients.from_actuator(actuator), Grid.of_actuator(actuator)
    for got, expected in (
        (again.stiffness, found.stiffness),
        (again.slopes, found.slopes),
        (again.transformer, found.transformer),
    ):
        np.testing.assert_allclose(got, expected, rtol=1e-9)
    for field in ("breakaway", "knots", "drive"):
        np.testing.assert_array_equal(getattr(grid, field), getattr(plant.grid, field))
    kept = found.internal > 1e-9 * wide.SLOPE
    np.testing.assert_array_equal(again.internal, found.internal[kept])


def test_a_branch_that_holds_nothing_is_left_out():
    plant = known("creep")
    found = rows_of("creep").fit("l2")
    without = replace(found, internal=found.internal * [1, 0, 1, 0])
    creep = without.to_actuator(plant.grid, 0.0).creep
    np.testing.assert_array_equal(creep.time_constants, plant.grid.time_constants[[0, 2]])
    assert replace(found, internal=0 * found.internal).to_actuator(plant.grid, 0.0).creep is None


def test_tau_keeps_the_ends_of_the_voltages_whatever_is_found():
    """Rows that no tau of this kind explains: its ends stay, and no slope falls below a fifth."""
    plant, regression = known("transformer"), rows_of("transformer")
    v = regression.rows.voltage
    low, high = plant.grid.drive[[0, -1]]
    share = np.clip((v - low) / (high - low), 0, 1)
    for power in (10.0, 0.1):
        twisted = low + (high - low) * share**power
        found = replace(regression, rows=replace(regression.rows, voltage=twisted)).fit("l2")
        tau = found.to_actuator(plant.grid, 0.0).transformer
        np.testing.assert_allclose(tau.drive[[0, -1]], [low, high], rtol=1e-9, atol=1e-9 * high)
        assert found.transformer.min() >= 0.2 * (1 - 1e-9)
    assert found.transformer.min() == pytest.approx(0.2, rel=1e-6)


def test_the_springs_slopes_keep_the_floor():
    regression = rows_of("plain")
    high = replace(regression, floor=0.7 * wide.SLOPE)
    free, held = regression.fit("l2"), high.fit("l2")
    assert free.slopes.min() < 0.69 * wide.SLOPE
    assert held.slopes.min() == pytest.approx(0.7 * wide.SLOPE, rel=1e-9)
    assert high.residual(held).std() > 100 * regression.residual(free).std()


def falling():
    """Rows of a graded actuator of which a branch falls: no record has them, but noise can come close."""
    plant = known("graded")
    regression = wide.regression(plant.grid, [plant.record()])
    true = plant.coefficients(regression)
    stiffness = true.stiffness * [1.0, 3.0, 0.1]
    wrong = replace(true, stiffness=stiffness, slopes=0 * true.slopes + 0.15 * wide.SLOPE, offsets={0: 0.0})
    # Without a transformer a residual with voltages of naught is the right-hand side.
    naught = replace(regression, rows=replace(regression.rows, voltage=0 * regression.rows.voltage))
    return plant, replace(regression, rows=replace(regression.rows, voltage=naught.residual(wrong)))


@pytest.mark.parametrize("norm", ["l1", "l2"])
def test_no_branch_falls(norm, monkeypatch):
    plant, regression = falling()
    found = regression.fit(norm)
    assert found.solution.optimal
    held = found.to_actuator(plant.grid, 0.0)
    monkeypatch.setattr(program, "violated", lambda grid, x, floor: np.zeros((0, grid.outermost.shape[1])))
    free = regression.fit(norm)
    with pytest.raises(ModelError, match="rising outermost"):
        free.to_actuator(plant.grid, 0.0)
    # The price, and the floor on every branch as long motions from the ends go over it.
    assert (
        np.abs(regression.residual(free)).max() < 1e-9 * plain_records.VOLTS < np.abs(regression.residual(found)).max()
    )
    y = np.linspace(0, plain_records.STROKE, 2001)
    for path, rising in ((y, True), (y[::-1], False)):
        v = held.compensate(path, state=held.turned(float(path[0]), rising=rising)).voltage
        assert (np.diff(v) / np.diff(path)).min() > regression.floor * (1 - 1e-3)


def begun(name="creep", share=0.05):
    """A record that begins with creep branches strained, and the strains."""
    plant = known(name)
    strains = share * plain_records.STROKE * np.array([0.5, -0.3, 0.8, 1.0])[: plant.grid.time_constants.size]
    record = plant.record(state=State(plant.state.deformation, plant.state.carts, strains, smooth=plant.state.smooth))
    return plant, record, strains


def test_what_creep_held_at_the_start_comes_back():
    plant, record, strains = begun()
    without, told_so = (wide.regression(plant.grid, [record], strained=which) for which in ((), (0,)))
    found = told_so.fit("l2")
    # The first rows that count come so late that the fastest branch has forgotten, and gets no column.
    begin = float(record.time[len(record) - len(told_so.rows)])
    lasting = np.exp(-begin / plant.grid.time_constants) > 0.01
    assert lasting.tolist() == [False, True, True, True]
    expected = np.where(lasting, found.internal * strains, 0.0)
    np.testing.assert_allclose(found.starts[0], expected, atol=1e-4 * np.abs(expected).max())
    left, better = without.residual(without.fit("l2")).std(), told_so.residual(found).std()
    assert better < 0.01 * left
    true = plant.coefficients(told_so).internal
    assert np.abs(found.internal - true).max() < 0.1 * np.abs(without.fit("l2").internal - true).max()


def test_no_branch_begins_with_more_than_it_can_hold():
    plant, record, _ = begun(share=5.0)
    regression = wide.regression(plant.grid, [record], strained=(0,))
    found = regression.fit("l2")
    limit = found.internal * np.ptp(plant.grid.knots)
    assert np.all(np.abs(found.starts[0]) <= limit * (1 + 1e-6))
    assert np.any(np.abs(found.starts[0]) > 0.99 * limit)


def test_a_given_model_gets_only_constants_and_starts():
    plant, record, strains = begun()
    regression = wide.regression(plant.grid, [record], strained=(0,))
    true = Coefficients.from_actuator(plant.actuator)
    found = regression.fit_nuisances(true)
    assert found.stiffness is true.stiffness
    assert np.abs(regression.residual(found)).max() < 2e-3 * plain_records.VOLTS
    assert found.offsets[0] == pytest.approx(float(plant.actuator.spring.voltage[0]), abs=1e-3 * plain_records.VOLTS)
    np.testing.assert_allclose(found.starts[0][2:], (true.internal * strains)[2:], rtol=0.02)


def test_fewer_rows_are_the_same_rows():
    regression = rows_of("all")
    thin = regression.thinned(300)
    every = len(regression.rows) // 300
    np.testing.assert_array_equal(thin.bounded, regression.bounded[::every])
    np.testing.assert_array_equal(thin.target, regression.target[::every])
    some = np.arange(len(regression.rows)) % 7 == 2
    found = regression.at(np.linspace(1, 2, regression.bounded.shape[1]))
    np.testing.assert_array_equal(regression.slope(found, some), regression.slope(found)[some])


@pytest.mark.parametrize("structure", [Structure(elements=1), Structure(elements=1, grades=3, smooth=True)])
def test_without_a_movable_element_the_rest_is_found(structure):
    plant = wide.plant(replace(structure, knots=7))
    regression = wide.regression(plant.grid, [plant.record()])
    found = regression.fit("l2")
    assert found.stiffness.shape == (1, structure.grades)
    assert np.abs(regression.residual(found)).max() < 1e-9 * plain_records.VOLTS


def test_too_few_rows_are_refused():
    with pytest.raises(IdentifyError, match=r"got 0 rows for \d+ unknowns"):
        replace(rows_of("all"), rows=rows_of("all").rows.chosen(slice(0))).fit("l2")
