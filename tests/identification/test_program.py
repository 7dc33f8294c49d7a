"""The program: known actuators come back, bounds hold, held-out time is predicted; its options and deadline."""

import signal
import time
from dataclasses import replace
from functools import cache
from itertools import pairwise, product

import moving_records as moved
import numpy as np
import plain_records
import pytest
import structured_records as wide
from hypothesis import given, settings
from hypothesis import strategies as st

from dehyst.identification import Deadline, Structure, search
from dehyst.identification.program import _alike, with_folds
from dehyst.identification.regressors import Rows, epochs
from dehyst.model import turned

STROKE, VOLTS = plain_records.STROKE, plain_records.VOLTS
NAMES = tuple(wide.STRUCTURES)


@cache
def known(name, seed=0):
    plant = wide.plant(wide.STRUCTURES[name], seed)
    return plant, wide.program(plant.grid, [plant.record()])


@cache
def noisy(name):
    plant, _ = known(name)
    return wide.program(plant.grid, [plant.record(noise=1e-3 * STROKE)])


@given(name=st.sampled_from(NAMES), seed=st.integers(0, 1000))
@settings(max_examples=15)
def test_true_coefficients_leave_no_residual(name, seed):
    plant, program = known(name, seed)
    assert len(program) > 0.8 * plant.path.size
    assert np.abs(program.residual(plant.solution(program))).max() < 1e-12 * STROKE


@given(name=st.sampled_from(NAMES), seed=st.integers(0, 1000))
@settings(max_examples=10)
def test_the_slope_of_a_row_is_the_slope_of_compensate(name, seed):
    """Tau's change over a small step ahead, from the state that the record has reached."""
    plant, program = known(name, seed)
    slope = program.slope(plant.solution(program))
    samples = np.concatenate([np.arange(epoch.start, epoch.stop) for epoch in epochs(plant.record())])
    # Major loops go through knots, and their ends; just after a turn smooth elements are taken to go on.
    inside = (samples > 125) & (samples < plant.path.size - 1) & ~program.rows.stuck[:, 0]
    actuator, step = plant.actuator, 1e-6 * STROKE
    for row in np.random.default_rng(seed).choice(np.flatnonzero(inside), 8).tolist():
        k = samples[row]
        state = actuator.compensate(plant.path[: k + 1], state=plant.state).state
        ahead = step * np.sign(plant.path[k] - plant.path[k - 1])
        v = actuator.compensate([plant.path[k], plant.path[k] + ahead], state=state).voltage
        tau = v if actuator.transformer is None else actuator.transformer(v)
        assert np.diff(tau)[0] / ahead == pytest.approx(slope[row], rel=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_a_known_actuator_is_recovered(name):
    plant, program = known(name)
    found, true = program.solved(), plant.solution(program)
    assert np.abs(program.residual(found)).max() < 1e-9 * STROKE
    if plant.grid.segments == 1:
        for got, expected in ((found.stiffness, true.stiffness), (found.slopes, true.slopes)):
            np.testing.assert_allclose(got, expected, rtol=0, atol=1e-8 * expected.max())
        np.testing.assert_allclose(found.smooth, true.smooth, rtol=0, atol=1e-7 * true.smooth.max(initial=0.0))
        np.testing.assert_allclose(found.transformer, true.transformer, rtol=1e-8)
    # No record shows the stiffness on a segment that an element's cart never enters: there paths decide.
    actuator = found.to_actuator(plant.grid, found.offsets[0])
    voltage = actuator.compensate(plant.path, state=plant.state).voltage
    assert np.abs(voltage - plant.record().voltage).max() < 1e-7 * VOLTS


MOVING = {
    "delay": (lambda: [moved.delayed(3)], {}, 3, lambda at: at.delay, 3 * moved.STEP),
    "lead": (lambda: [moved.delayed(-0.5)], {}, 3, lambda at: at.delay, -0.5 * moved.STEP),
    "drift": (lambda: [moved.drifting(0.02)], {}, 12, lambda at: at.drift[0], 0.02 * STROKE),
    "inertia": (lambda: [moved.swinging()], {}, 3, lambda at: at.dynamics.frequency, moved.DYNAMICS.frequency),
    "damping": (lambda: [moved.swinging()], {}, 3, lambda at: at.dynamics.damping, moved.DYNAMICS.damping),
    "creep": (
        lambda: [moved.creeping()],
        {"time_constants": moved.CREEP.time_constants, "gains": np.zeros(3), "creep_before": np.zeros((1, 3))},
        30,
        lambda at: at.gains.sum(),
        moved.CREEP.gains.sum(),
    ),
    "zero": (lambda: moved.shifted(0.1 * STROKE), {"zero": [0, 0.09 * STROKE]}, 30, lambda at: at.zero[1], 1.6e-6),
    **{
        f"thermal {name}": (
            lambda: [moved.warmed(15, 45), moved.warmed(40, 18)],
            {"reference": 30.0},
            12,
            lambda at, name=name: getattr(at.thermal, name),
            getattr(moved.THERMAL, name),
        )
        for name in ("gain", "offset")
    },
}
WARMS = "thermal", "expansion"
PARTS = {"lead": ("delay",), "damping": ("inertia",), "thermal gain": WARMS, "thermal offset": WARMS}


@pytest.mark.parametrize("name", MOVING)
def test_the_numbers_of_parts_that_depend_on_time_are_recovered(name):
    records, start, turns, number, true = MOVING[name]
    start = {key: np.asarray(value) if key == "zero" else value for key, value in start.items()}
    made = search.fitted(wide.frame(records(), **start), moved.STRUCTURE, 4000, PARTS.get(name, (name,)), turns)
    assert number(made.frame.motion) == pytest.approx(true, rel=0.03)
    assert made.rms < 2e-4 * STROKE


def test_gains_of_creep_are_not_negative():
    record = moved.still(hold=20)
    backwards = moved.seen(record, moved.CREEP.removed(record.time, record.displacement))
    motion = {"time_constants": moved.CREEP.time_constants, "gains": np.zeros(3), "creep_before": np.zeros((1, 3))}
    made = search.fitted(wide.frame([backwards], **motion), moved.STRUCTURE, 4000, ("creep",), 2)
    assert made.frame.motion.gains.min() == 0


@pytest.mark.parametrize("name", ["plain", "dense", "smooth"])
@pytest.mark.parametrize("smoothing", [0.0, 1e-2])
def test_the_conditions_of_karush_kuhn_and_tucker_hold(name, smoothing):
    """Of the sum of squares, written out: no gradient along what is free, none downwards along what is at its bound."""
    program = replace(noisy(name), smoothing=smoothing, floor=0.7 * wide.SLOPE)
    (columns, free), x = program.columns, program.solved().unknowns
    gradient = columns.T @ (columns @ x - program.target) + len(program) * program.regularization @ x
    size = np.linalg.norm(columns, axis=0) * np.linalg.norm(program.target)
    bound = (x == 0) & (np.arange(x.size) >= free)
    assert bound.any() and x[free:].min() >= 0
    assert np.all(gradient[bound] > -1e-8 * size[bound])
    assert np.all(np.abs(gradient[~bound]) < 1e-8 * size[~bound])


@pytest.mark.parametrize("name", ["plain", "dense", "transformer"])
def test_the_difference_of_sums_leaves_out_a_fold(name):
    program = noisy(name)
    fold = np.arange(len(program)) // 100 % 3
    folded, whole = with_folds(program, fold), program.solved()
    np.testing.assert_allclose(folded.solved().unknowns, whole.unknowns, atol=1e-7 * np.abs(whole.unknowns).max())
    for k in range(3):
        rest = replace(program, rows=Rows(**{name: column[fold != k] for name, column in vars(program.rows).items()}))
        got, expected = folded.solved(whole, without=k).unknowns, rest.solved().unknowns
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_reweighting_makes_the_solution_robust():
    plant, program = known("plain")
    voltage = program.rows.voltage.copy()
    voltage[::50] += 0.2 * VOLTS * np.random.default_rng(0).uniform(0, 1, voltage[::50].size)
    outliers = replace(program, rows=replace(program.rows, voltage=voltage))
    squares = outliers.solved()
    robust = outliers.reweighted(squares)[1]
    errors = [np.abs(found.stiffness - plant.actuator.slip.stiffness[:, None]).max() for found in (squares, robust)]
    assert errors[1] < 0.2 * errors[0]


def test_an_element_without_stiffness_is_left_out():
    plant, program = known("smooth")
    found = program.solved()
    kept = found.smooth * (np.arange(found.smooth.size) % 2)
    assert len(replace(found, smooth=kept).to_actuator(plant.grid, 0.0).smooth) == np.count_nonzero(kept)
    assert replace(found, smooth=0 * kept).to_actuator(plant.grid, 0.0).smooth is None


def test_tau_keeps_the_ends_of_the_voltage_range():
    """Rows that no tau of this kind explains: its ends stay, and no slope falls below a fifth."""
    plant, program = known("transformer")
    v, (low, high) = program.rows.voltage, plant.grid.drive[[0, -1]]
    share = np.clip((v - low) / (high - low), 0, 1)
    for power in (10.0, 0.1):
        twisted = low + (high - low) * share**power
        found = replace(program, rows=replace(program.rows, voltage=twisted)).solved()
        tau = found.to_actuator(plant.grid, 0.0).transformer
        np.testing.assert_allclose(tau.drive[[0, -1]], [low, high], rtol=1e-9, atol=1e-9 * high)
        assert found.transformer.min() >= 0.2 * (1 - 1e-9)
    assert found.transformer.min() == pytest.approx(0.2, rel=1e-6)


def test_slopes_of_the_spring_keep_the_floor():
    _, program = known("plain")
    high = replace(program, floor=0.7 * wide.SLOPE)
    free, held = program.solved(), high.solved()
    assert free.slopes.min() < 0.69 * wide.SLOPE
    assert held.slopes.min() == pytest.approx(0.7 * wide.SLOPE, rel=1e-9)
    assert high.residual(held).std() > 100 * program.residual(free).std()


def test_no_branch_falls(monkeypatch):
    """A graded actuator would have a falling branch: no record shows such voltages, but noise can come close."""
    plant, program = known("graded")
    true = plant.solution(program)
    elements = (true.stiffness * [1.0, 3.0, 0.1])[plant.grid.movable].ravel()
    wrong = program.scale * program.static(np.concatenate([elements, np.full(true.slopes.size, 0.15 * wide.SLOPE)]))
    program = replace(program, rows=replace(program.rows, voltage=wrong))
    found = program.solved()
    monkeypatch.setattr("dehyst.identification.program._ADDED", 0)
    softer = program.solved()
    assert program.residual(found).std() < program.residual(softer).std()
    y = np.linspace(0, STROKE, 2001)
    for held, (path, rising) in product(
        (solution.to_actuator(plant.grid, 0.0) for solution in (found, softer)), ((y, True), (y[::-1], False))
    ):
        v = held.compensate(path, state=turned(held, float(path[0]), rising=rising)).voltage
        assert (np.diff(v) / np.diff(path)).min() > program.floor * (1 - 1e-3)


def grid(**changes):
    return Structure(**{"elements": 6, "knots": 5, "grades": 3, "transformer": 6, **changes}).grid(
        (0.0, STROKE), (0.0, VOLTS)
    )


@pytest.mark.parametrize("spacing", [1.0, 2.0])
def test_rows_of_the_smoothing_are_differences_of_neighbours(spacing):
    own, rng = grid(spacing=spacing), np.random.default_rng(5)
    rho = own.breakaway[own.movable]
    kappa, slopes, drive = rng.random((rho.size, 3)), rng.random(4), rng.random(5)
    unknowns = np.concatenate([kappa.ravel(), slopes, drive])
    width = np.diff(rho, prepend=0.0)
    density = kappa / width[:, None]
    expected = [r * np.sqrt(3) * (b - a) for r, row in zip(rho, kappa, strict=True) for a, b in pairwise(row)]
    expected += [
        rho[i] * width[i + 1] * (density[i + 1, m] - density[i, m]) for i in range(rho.size - 1) for m in range(3)
    ]
    expected += (STROKE / 4 * np.diff(slopes, 2)).tolist() + (VOLTS / 6 * np.diff(drive, 2)).tolist()
    assert unknowns @ _alike(own) @ unknowns == pytest.approx(np.square(expected).sum(), rel=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_held_out_time_of_an_exact_model_is_predicted(name):
    made = search.fitted(wide.frame([wide.plant(wide.STRUCTURES[name]).record()]), wide.STRUCTURES[name], 4000)
    assert made.held_out < 1e-6 * STROKE


def test_time_constants_lie_between_the_finest_step_and_the_longest_record():
    records = [plain_records.loops(plain_records.plant(10), plain_records.MAJOR, rate=rate) for rate in (200.0, 50.0)]
    assert wide.frame(records).times == pytest.approx((1 / 200, float(np.ptp(records[1].time))))


def test_no_step_begins_after_the_time_limit():
    endless, deadline = Deadline(), Deadline(1e-9)
    assert (endless.left, endless.passed, endless.attempt(lambda: 1, 2, "a step")) == (np.inf, False, 1)
    assert deadline.passed and deadline.left == 0
    assert deadline.attempt(pytest.fail, 2, "the search") == 2
    assert deadline.attempt(pytest.fail, None, "the tuning") is None
    assert deadline.cut == ["the search", "the tuning"]
    assert (len(endless.remarks("one")), len(deadline.remarks("one"))) == (0, 1)


def test_a_step_that_checks_the_deadline_is_ended():
    deadline, said = Deadline(), []
    report = deadline.watched(said.append)

    def step():
        report("begins")
        deadline.end("Ctrl-C")
        report("goes on")

    deadline.check()
    assert deadline.attempt(step, "so far", "the step") == "so far"
    assert said == ["begins"]
    # Outside of a step progress is only reported.
    report("finishing")
    assert said == ["begins", "finishing"]


def test_a_signal_handler_ends_a_step_that_does_not_check_the_deadline():
    deadline = Deadline()
    before = signal.signal(signal.SIGINT, lambda *_: deadline.end("Ctrl-C", leave_step=True))
    try:

        def step():
            signal.raise_signal(signal.SIGINT)
            time.sleep(0)
            pytest.fail("the step went on")

        assert deadline.attempt(step, 7, "a step") == 7
    finally:
        signal.signal(signal.SIGINT, before)


def test_folds_are_sixths_of_the_time_of_each_record():
    made = search.fitted(wide.frame([moved.still(), replace(moved.still(), name="other")]), moved.STRUCTURE, 10**6)
    fold, rows = made.program.fold, made.program.rows
    for q in range(2):
        own = rows.record == q
        record = made.frame.training[q].record
        sixth = 6 * (rows.time[own] - record.time[0]) / np.ptp(record.time)
        for k in range(3):
            expected = ((sixth >= k) & (sixth < k + 1)) | ((sixth >= k + 3) & (sixth < k + 4 + 1e-9 * (k == 2)))
            np.testing.assert_array_equal(fold[own] == k, expected)
