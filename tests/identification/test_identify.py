"""The identification against actuators that are known: what records tell, what they leave open, what is refused."""

import itertools
import json
import re
from dataclasses import replace

import numpy as np
import plain_records
import pytest

import dehyst
from dehyst import Actuator, IdentifyError, MaxwellSlip, Outcome, Record, RecordError, Spring
from dehyst.identification import Structure
from dehyst.identification.diagnostics import messages
from dehyst.identification.diagnostics.identifiability import projected
from dehyst.identification.preprocessing.regressors import collect
from dehyst.identification.regression.regression import Regression
from dehyst.identification.solvers import highs, least_absolute
from dehyst.identification.solvers.least_absolute import PrimalDual
from dehyst.identification.solvers.program import NORMS
from dehyst.identification.structure import Grid
from dehyst.identification.structure_selection import StructureTrial

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


# Theory, section 6: the table of what one record leaves open, N = 10; each minor loop is run twice.
TABLE = {
    MAJOR: 5,
    (*MAJOR, 0.3, 0, 0.3, 0): 6,
    (*MAJOR, 0.5, 0, 0.5, 0): 7,
    (*MAJOR, 0.7, 0, 0.7, 0): 8,
    (*MAJOR, 0.3, 0, 0.3, 0, 0.5, 0, 0.5, 0): 8,
    plain_records.THREE_LOOPS: 9,
    (1, 0, 1, 0, 0.6, 0, 0.35, 0): 9,
    (*MAJOR, 0.65, 0.35, 0.65, 0.35): 9,
    plain_records.DESCENDING_TOPS: 9,
    plain_records.REVERSAL_CURVES: 9,
}


@pytest.mark.parametrize("samples", [40, 100, 400])
@pytest.mark.parametrize(("turns", "determined"), TABLE.items())
def test_directions_that_an_excitation_determines(turns, determined, samples):
    record = plain_records.loops(PLANT, turns, samples=samples)
    rows, _ = collect([(0, record, np.zeros(len(record)))], PLANT.slip.breakaway, [0.0])
    movable = np.arange(10) < 9
    grid = Grid.maxwell_slip(PLANT.slip.breakaway, PLANT.spring.displacement, movable)
    values = np.linalg.svd(projected(Regression(rows, grid, 1.0, np.zeros(1))), compute_uv=False)
    assert np.count_nonzero(values > 1e-3 * values[0]) == determined


def test_the_major_loop_alone_is_undetermined_and_says_so():
    fit = dehyst.identify(plain_records.loops(PLANT, MAJOR), elements=10)
    assert fit.outcome is Outcome.UNDETERMINED
    assert fit.outcome.good
    assert "5 of 9 directions" in " ".join(fit.remarks)
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


@pytest.mark.parametrize("knots", [21, 41])
def test_more_knots_than_the_spring_has_change_nothing(knots):
    fit = dehyst.identify(TOPS, elements=10, knots=knots)
    assert fit.actuator.spring.displacement.size == knots
    assert plain_records.stiffness_error(fit.actuator, PLANT) < 1e-9
    np.testing.assert_allclose(fit.actuator.spring(PLANT.spring.displacement), PLANT.spring.voltage, atol=1e-7)


def test_the_slope_floor_is_kept_and_reported():
    fit = dehyst.identify(TOPS, elements=10, slope_floor=0.6, delay=0.0, drift=False)
    floor = 0.6 * np.ptp(TOPS.voltage) / plain_records.STROKE
    assert fit.outcome is Outcome.FLOOR_ACTIVE
    assert fit.actuator.spring.slopes.min() == pytest.approx(floor, rel=1e-9)
    assert any("slope lies" in remark for remark in fit.remarks)


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


def test_a_solver_that_fails_raises_or_is_told(monkeypatch):
    break_solver(monkeypatch)
    with pytest.raises(IdentifyError, match=r"Not identified: .* time limit"):
        dehyst.identify(TOPS, elements=10)
    fit = dehyst.identify(TOPS, elements=10, throw=False)
    assert (fit.actuator, fit.outcome, fit.errors) == (None, Outcome.FAILED, ())
    assert "time limit" in fit.status


def test_a_wider_program_that_fails_raises_or_is_told(monkeypatch):
    """What a solver leaves behind need not be an actuator."""
    solved = least_absolute.least_absolute_deviations

    def asleep(problem, pull, unit):
        found = solved(problem, pull, unit)
        return replace(found, x=np.full(found.x.size, -1.0), optimal=False, status="asleep")

    monkeypatch.setattr(least_absolute, "least_absolute_deviations", asleep)
    structure = Structure(elements=10, grades=4)
    with pytest.raises(IdentifyError, match=r"Not identified: .* asleep"):
        dehyst.identify(TOPS, structure=structure)
    fit = dehyst.identify(TOPS, structure=structure, throw=False)
    assert (fit.actuator, fit.outcome, fit.errors) == (None, Outcome.FAILED, ())
    assert "asleep" in fit.status


REFUSED = [
    ({"norm": "l3"}, "norm: got 'l3', need 'l1' or 'l2'"),
    ({"elements": 5, "breakaway": [1e-6]}, "got both elements and breakaway"),
    ({"breakaway": []}, "breakaway: need .*positive, strictly increasing"),
    ({"breakaway": [0.0, 1e-6]}, "breakaway: need .*positive, strictly increasing"),
    ({"breakaway": [2e-6, 1e-6]}, "breakaway: need .*positive, strictly increasing"),
    ({"breakaway": [np.nan]}, "breakaway"),
    ({"elements": 0}, "elements: got 0, need a whole number from 1 to 500"),
    ({"elements": 501}, "elements: got 501, need a whole number from 1 to 500"),
    ({"elements": 10.5}, "elements: got 10.5, need"),
    ({"knots": 1}, "knots: got 1, need a whole number from 2 to 500"),
    ({"knots": 501}, "knots: got 501, need a whole number from 2 to 500"),
    ({"knots": 5.5}, "knots: got 5.5, need"),
    ({"slope_floor": 0.0}, "slope_floor: got 0.0, need a fraction"),
    ({"slope_floor": 1.0}, "slope_floor: got 1.0, need a fraction"),
    ({"slope_floor": np.nan}, "slope_floor: got nan, need a fraction"),
    ({"delay": np.inf}, "delay: got inf, need .*seconds"),
]


@pytest.mark.parametrize(("options", "message"), REFUSED, ids=[str(options) for options, _ in REFUSED])
def test_impossible_options_are_refused(options, message):
    with pytest.raises(IdentifyError, match=message):
        dehyst.identify(TOPS, **options)


def test_records_that_tell_nothing_are_refused():
    with pytest.raises(IdentifyError, match="got no records"):
        dehyst.identify([])
    with pytest.raises(IdentifyError, match="count for 400 elements"):
        dehyst.identify(plain_records.loops(PLANT, MAJOR[:4]), elements=400)
    growing = plain_records.loops(
        PLANT, (0.5, 0.55, 0.44, 0.7, 0.2, 1.0), samples=16, state=PLANT.turned(0.5 * plain_records.STROKE)
    )
    with pytest.raises((IdentifyError, RecordError)):
        dehyst.identify(growing)


BROKEN = {
    "constant": (lambda v, y: (0 * v, y), "the voltage is constant"),
    "still": (lambda v, y: (v, 0 * y), "the displacement is constant"),
    "swapped": (lambda v, y: (y * 1e6, v * 1e-7), "look swapped"),
    "inverted": (lambda v, y: (v, -y), "inverted"),
    "clipped": (lambda v, y: (v, np.minimum(y, 0.8 * y.max())), "clipped"),
    "short": (lambda v, y: (v[:15], y[:15]), "15 samples, 20 are needed"),
    "half a cycle": (lambda v, y: (v[:90], y[:90]), "full cycle"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_unusable_records_are_refused_in_training_and_validation(name):
    change, message = BROKEN[name]
    v, y = change(TOPS.voltage, TOPS.displacement)
    broken = Record(np.arange(v.size) / 200, v, y, name)
    with pytest.raises(RecordError, match=message) as caught:
        dehyst.identify([TOPS, broken], elements=10)
    assert re.search(f"'{name}'", str(caught.value))
    with pytest.raises(RecordError, match=message):
        dehyst.identify(TOPS, elements=10, validate=broken)


def test_a_record_given_twice_is_refused():
    again = Record(TOPS.time, TOPS.voltage, TOPS.displacement, "copy")
    for options in ({"records": [TOPS, again]}, {"records": TOPS, "validate": again}):
        with pytest.raises(IdentifyError, match=f"copy: has the same samples as {TOPS.name}; give each record once"):
            dehyst.identify(**options)


def test_a_model_file_tells_how_its_identification_ended(tmp_path):
    fit = dehyst.identify(TOPS, structure="maxwell_slip")
    fit.actuator.save(tmp_path / "model.json")
    assert dehyst.Actuator.load(tmp_path / "model.json").identification.outcome is fit.outcome


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


def test_the_summary_marks_the_structure_that_was_chosen():
    fit = dehyst.identify(plain_records.loops(PLANT, MAJOR), elements=10)
    chosen, other = Structure(elements=10), Structure(elements=10, creep=3)
    trials = tuple(StructureTrial(one, error, 0.0, 0.0) for one, error in ((other, 1e-9), (chosen, 2e-9)))
    fit = replace(fit, trials=trials, options={**fit.options, "structure": chosen.as_dict()})
    (line,) = (line for line in fit.summary(full=True).splitlines() if line.endswith("(chosen)"))
    assert "2.0 nm" in line
