"""The identification against actuators that are known: what records tell, what they leave open, what is refused."""

import itertools
import json
from dataclasses import replace

import numpy as np
import plain_records
import pytest

import dehyst
from dehyst import Actuator, IdentifyError, MaxwellSlip, Outcome, Record, RecordError, Spring
from dehyst.identification import Structure
from dehyst.identification.diagnostics import messages
from dehyst.identification.solvers import highs, least_absolute
from dehyst.identification.solvers.least_absolute import PrimalDual
from dehyst.identification.solvers.program import NORMS

PLANT = plain_records.plant(10)
TOPS = plain_records.loops(PLANT, plain_records.DESCENDING_TOPS, name="tops")
EXCITATIONS = {
    "tops": plain_records.DESCENDING_TOPS,
    "curves": plain_records.REVERSAL_CURVES,
    "three loops": plain_records.THREE_LOOPS,
}
MAJOR = plain_records.MAJOR


def assert_recovered(fit, plant, tolerance=1e-9):
    assert fit.outcome is Outcome.IDENTIFIED
    np.testing.assert_allclose(fit.actuator.slip.breakaway, plant.slip.breakaway, rtol=1e-9)
    assert plain_records.stiffness_error(fit.actuator, plant) < tolerance
    assert plain_records.spring_error(fit.actuator, plant) < tolerance
    # Before a cart is known it is fitted; afterwards nothing is left open.
    for error, trace in zip(fit.errors, fit.traces, strict=True):
        assert error.largest_percent < max(0.3, 100 * tolerance)
        if np.ptp(trace.measured) > 0.99 * error.stroke:
            assert np.abs(trace.residual[trace.residual.size // 2 :]).max() < tolerance * error.stroke


@pytest.mark.parametrize("norm", NORMS)
@pytest.mark.parametrize("name", EXCITATIONS)
def test_a_known_model_is_recovered(name, norm):
    plant = plain_records.plant(10, seed=3)
    fit = dehyst.identify(plain_records.loops(plant, EXCITATIONS[name]), elements=10, norm=norm)
    assert_recovered(fit, plant)
    assert fit.repairs == ()
    assert abs(fit.gap) < 1e-9
    np.testing.assert_allclose(fit.actuator.spring.voltage, plant.spring.voltage, atol=1e-7)


@pytest.mark.parametrize("seed", range(4))
def test_carts_that_stand_anywhere_at_the_start_do_not_matter(seed):
    y = plain_records.path((0.4, *plain_records.THREE_LOOPS))
    fit = dehyst.identify(
        plain_records.record(PLANT, y, state=plain_records.any_state(PLANT, float(y[0]), seed)), elements=10
    )
    assert_recovered(fit, PLANT)


@pytest.mark.parametrize("shared", [False, True])
def test_minor_loops_in_records_of_their_own_with_carts_anywhere(shared):
    records = [plain_records.loops(PLANT, MAJOR, name="major")]
    for seed, top in enumerate((0.3, 0.5, 0.7)):
        y = plain_records.path((0.1, top, 0, top, 0, top, 0))
        state = plain_records.any_state(PLANT, float(y[0]), seed)
        records.append(plain_records.record(PLANT, y, state=state, name=f"minor {top}"))
    fit = dehyst.identify(records, elements=10, shared_datum=shared)
    assert_recovered(fit, PLANT)
    assert [(e.record, e.role, e.datum) for e in fit.errors] == [(r.name, "training", 0.0) for r in records]
    assert fit.actuator.name == "major"


def test_the_fitted_actuator_predicts_a_path_it_never_saw():
    fit = dehyst.identify(TOPS, elements=10)
    path = plain_records.path(np.append(1.0, np.random.default_rng(1).uniform(0, 1, 30)))
    v = PLANT.compensate(path).voltage
    assert np.abs(fit.actuator.simulate(v).displacement - path).max() < 1e-9 * plain_records.STROKE


def test_the_major_loop_alone_is_undetermined_and_says_so():
    fit = dehyst.identify(plain_records.loops(PLANT, MAJOR), elements=10)
    assert fit.outcome is Outcome.UNDETERMINED
    assert fit.outcome.good
    # The sums k_m + k_(N-m) are what it does tell (theory, section 6).
    found, true = fit.actuator.slip.stiffness[:9], PLANT.slip.stiffness[:9]
    np.testing.assert_allclose(found + found[::-1], true + true[::-1], rtol=1e-8)
    assert plain_records.stiffness_error(fit.actuator, PLANT) > 0.1


def test_explicit_breakaway_elongations_take_the_place_of_the_grid():
    rho = PLANT.slip.breakaway
    fit = dehyst.identify(TOPS, breakaway=rho, knots=11)
    assert_recovered(fit, PLANT)
    some = dehyst.identify(TOPS, breakaway=rho[[0, 3, 7]].tolist())
    np.testing.assert_array_equal(some.actuator.slip.breakaway, rho[[0, 3, 7]])
    assert 1e-3 < some.errors[0].largest_percent < 5


def test_one_element():
    # On the grid it lets go at half the range: it never slides over the whole of it, and is one with the spring.
    grid = dehyst.identify(TOPS, elements=1)
    assert (grid.outcome, grid.actuator.slip.stiffness.tolist()) == (Outcome.INACCURATE, [0.0])
    y = plain_records.path(plain_records.THREE_LOOPS)
    single = dehyst.Actuator(dehyst.MaxwellSlip([2e-6], [4e6]), PLANT.spring)
    fit = dehyst.identify(plain_records.record(single, y), breakaway=[2e-6], knots=11)
    assert_recovered(fit, single)


def test_the_slope_floor_is_kept_and_reported():
    fit = dehyst.identify(TOPS, elements=10, slope_floor=0.6, delay=0.0, drift=False)
    floor = 0.6 * np.ptp(TOPS.voltage) / plain_records.STROKE
    assert fit.outcome is Outcome.FLOOR_ACTIVE
    assert fit.actuator.spring.slopes.min() == pytest.approx(floor, rel=1e-9)


def test_noise_of_2_nm_does_little_harm():
    noisy = plain_records.loops(PLANT, plain_records.DESCENDING_TOPS, samples=200, noise=2e-9)
    for norm in ("l1", "l2"):
        fit = dehyst.identify(noisy, elements=10, norm=norm)
        assert fit.outcome is Outcome.IDENTIFIED
        # rho_1 = 400 sigma; theory: 4 % at 33 to 100 sigma. The sensor alone errs by 4 sigma = 0.05 %.
        assert plain_records.stiffness_error(fit.actuator, PLANT) < 0.02
        assert fit.errors[0].rms_percent == pytest.approx(100 * 2e-9 / plain_records.STROKE, rel=0.5)
        assert fit.repairs == ()


@pytest.mark.nightly
def test_noise_makes_the_first_element_too_soft_until_it_is_removed_but_not_the_sum():
    slip = PLANT.slip
    ratios = []
    for sigmas in (100, 33, 28, 15):
        noisy = plain_records.loops(PLANT, plain_records.DESCENDING_TOPS, samples=200, noise=slip.breakaway[0] / sigmas)
        fit = dehyst.identify(noisy, elements=10)
        found = fit.actuator.slip
        ratios.append(found.stiffness[0] / slip.stiffness[0])
        assert found.friction.sum() == pytest.approx(slip.friction.sum(), rel=0.05)
        assert any("The first element slides at" in remark for remark in fit.remarks) == (sigmas == 28)
    assert 1 > ratios[0] > 0.95 > ratios[1] > ratios[2] > 0.8
    # Noise of 0.33 % of the stroke is taken out of the path.
    assert ratios[3] == pytest.approx(1, abs=0.05)


def test_stiffnesses_are_never_negative():
    rng = np.random.default_rng(0)
    for norm in NORMS:
        noisy = plain_records.loops(PLANT, plain_records.THREE_LOOPS, noise=rng.uniform(1e-8, 1e-7))
        fit = dehyst.identify(noisy, elements=25, norm=norm)
        assert fit.actuator.slip.stiffness.min() == 0
        assert np.all(fit.actuator.spring.slopes > 0)


def test_held_out_records_get_errors_of_their_own():
    y = plain_records.path((0.3, 0.8, 0.2, 0.65, 0.1, 0.9, 0.3, 0.8, 0.35, 0.75))
    state = plain_records.any_state(PLANT, float(y[0]), 5)
    held_out = plain_records.record(PLANT, y, state=state, name="check", datum=0.05 * plain_records.STROKE)
    alone, fit = dehyst.identify(TOPS, elements=10), dehyst.identify(TOPS, elements=10, validate=held_out)
    assert [(e.record, e.role) for e in fit.errors] == [("tops", "training"), ("check", "validation")]
    assert [(t.record, t.role) for t in fit.traces] == [("tops", "training"), ("check", "validation")]
    assert fit.actuator.slip.stiffness.tobytes() == alone.actuator.slip.stiffness.tobytes()
    check, trace = fit.errors[1], fit.traces[1]
    assert check.largest_percent < 1e-6
    assert check.datum == pytest.approx(0.05 * plain_records.STROKE, abs=1e-8 * plain_records.STROKE)
    assert (check.samples, check.samples + check.left_out) == (trace.residual.size, len(held_out))
    assert check.largest == pytest.approx(np.abs(trace.residual).max())


@pytest.mark.nightly
def test_the_same_call_gives_the_same_bits():
    noisy = plain_records.loops(PLANT, plain_records.DESCENDING_TOPS, noise=5e-9)
    for norm in NORMS:
        one, two = (dehyst.identify(noisy, elements=15, norm=norm) for _ in range(2))
        assert json.dumps(one.actuator.as_dict()) == json.dumps(two.actuator.as_dict())
        assert json.dumps(one.as_dict()) == json.dumps(two.as_dict())


def test_nonsense_that_is_a_loop_is_called_inaccurate():
    t = np.arange(4000) / 200
    y = 8e-6 * (1 - np.cos(0.5 * np.pi * t - 0.3)) + 3e-6 * np.sin(2 * np.pi * t / 1.37)
    fit = dehyst.identify(Record(t, 100 * (1 - np.cos(0.5 * np.pi * t)), y, "nonsense"))
    assert fit.outcome is Outcome.INACCURATE
    assert not fit.outcome.good
    assert fit.errors[0].largest_percent > 5


def break_solver(monkeypatch):
    """Let the interior point fail, and HiGHS say that it was stopped before it found the optimum."""
    solved = highs.minimum
    nothing = lambda problem, pull: PrimalDual(0 * pull, 0 * problem.goal, 0 * problem.lower, "")  # noqa: E731
    monkeypatch.setattr(least_absolute, "interior", nothing)

    def stopped(*arguments, **options):
        return replace(solved(*arguments, **options), optimal=False, status="HiGHS: time limit")

    monkeypatch.setattr(highs, "minimum", stopped)


def test_a_fit_is_json_without_nan(monkeypatch):
    fit = dehyst.identify(
        TOPS, elements=10, validate=plain_records.loops(PLANT, plain_records.THREE_LOOPS, name="loops")
    )
    assert json.loads(json.dumps(fit.as_dict(), allow_nan=False))["outcome"] == "IDENTIFIED"
    break_solver(monkeypatch)
    failed = dehyst.identify(TOPS, elements=10, throw=False)
    assert json.loads(json.dumps(failed.as_dict(), allow_nan=False))["good"] is False


@pytest.mark.parametrize("options", [{"elements": 10}, {"structure": Structure(elements=10, grades=4)}])
def test_a_solver_that_fails_raises_or_is_told(monkeypatch, options):
    break_solver(monkeypatch)
    with pytest.raises(IdentifyError):
        dehyst.identify(TOPS, **options)
    fit = dehyst.identify(TOPS, **options, throw=False)
    assert (fit.actuator, fit.outcome, fit.errors) == (None, Outcome.FAILED, ())
    assert "time limit" in fit.status


IMPOSSIBLE = [
    {"norm": "l3"},
    {"elements": 5, "breakaway": [1e-6]},
    {"breakaway": []},
    {"breakaway": [0.0, 1e-6]},
    {"breakaway": [2e-6, 1e-6]},
    {"breakaway": [np.nan]},
    {"elements": 0},
    {"elements": 501},
    {"elements": 10.5},
    {"knots": 1},
    {"knots": 501},
    {"knots": 5.5},
    {"slope_floor": 0.0},
    {"slope_floor": 1.0},
    {"slope_floor": np.nan},
    {"delay": np.inf},
    {"structure": "wide"},
    {"structure": None},
    {"structure": Structure(), "elements": 10},
    {"structure": Structure(), "breakaway": [1e-6]},
]


@pytest.mark.parametrize("options", IMPOSSIBLE, ids=str)
def test_impossible_options_are_refused(options):
    with pytest.raises(IdentifyError):
        dehyst.identify(TOPS, **options)


GROWING = plain_records.loops(
    PLANT, (0.5, 0.55, 0.44, 0.7, 0.2, 1.0), samples=16, state=PLANT.turned(0.5 * plain_records.STROKE)
)
COPY = Record(TOPS.time, TOPS.voltage, TOPS.displacement, "copy")


@pytest.mark.parametrize(
    "call",
    [
        lambda: dehyst.identify([]),
        lambda: dehyst.identify(plain_records.loops(PLANT, MAJOR[:4]), elements=400),
        lambda: dehyst.identify(GROWING),
        lambda: dehyst.identify([TOPS, COPY]),
        lambda: dehyst.identify(TOPS, validate=COPY),
    ],
)
def test_records_that_tell_nothing_new_are_refused(call):
    with pytest.raises((IdentifyError, RecordError)):
        call()


BROKEN = {
    "constant": lambda v, y: (0 * v, y),
    "still": lambda v, y: (v, 0 * y),
    "clipped": lambda v, y: (v, np.minimum(y, 0.8 * y.max())),
    "half a cycle": lambda v, y: (v[:90], y[:90]),
}


@pytest.mark.parametrize("name", BROKEN)
def test_unusable_records_are_refused_in_training_and_validation(name):
    v, y = BROKEN[name](TOPS.voltage, TOPS.displacement)
    broken = Record(np.arange(v.size) / 200, v, y, name)
    for options in ({"records": [TOPS, broken]}, {"records": TOPS, "validate": broken}):
        with pytest.raises(RecordError, match=f"'{name}'"):
            dehyst.identify(**options, elements=10)


@pytest.mark.parametrize(("turns", "grows"), [(np.linspace(0.06, 0.5, 8), True), (np.linspace(0.5, 0.06, 8), False)])
def test_elements_that_slide_once_are_found_where_loops_grow(turns, grows):
    """The longest of four elements is longer than half of the widest loop; begun relaxed."""
    half = 8e-6
    truth = Actuator(
        MaxwellSlip(np.array([0.1, 0.3, 0.6, 1.3]) * half, [3e6, 2e6, 2e6, 3e6]),
        Spring([-10e-6, 26e-6], [-50.0, 150.0]),
    )
    corners = 50 + 100 * np.array([0.0, *(side * turn for turn in turns for side in (1, -1))])
    leg = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, 31) / 30)
    voltage = np.concatenate([corners[:1], *(a + (b - a) * leg for a, b in itertools.pairwise(corners))])
    y = truth.simulate(voltage, state=truth.relaxed(), extrapolate=True).displacement
    y += np.random.default_rng(1).normal(0, 1e-9, y.size)
    record = Record(np.arange(y.size) * 0.02, voltage, y)
    fit = dehyst.identify(record, structure="maxwell_slip", norm="l2", delay=0.0, drift=False)
    assert (messages.LONGER_ELEMENTS in fit.remarks) == grows
    assert (fit.actuator.slip.breakaway.max() > 0.55 * np.ptp(y)) == grows
