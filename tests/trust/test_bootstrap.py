"""Intervals from resampled cycles hold the truth as often as they say, and say nothing of open directions."""

import importlib.util
from dataclasses import replace
from functools import cache

import numpy as np
import places
import plain_records
import pytest

import dehyst
from dehyst import IdentifyError, Outcome
from dehyst.model import MaxwellSlip
from dehyst.trust.bootstrap import Intervals, resample
from dehyst.trust.evidence import Evidence
from dehyst.trust.feasible_set import feasible_set

TOPS = (1, 0, *(turn for top in (1, 0.8, 0.6, 0.4, 0.2) for turn in (top, 0, top, 0)))
MAJOR = (1, 0) * 5
NOISE = 1.25e-4
PLANT = plain_records.plant(5, seed=1)
TOP = PLANT.turned(plain_records.STROKE)
TRUTH = PLANT.slip.stiffness[:-1]


def recorded(turns=TOPS, *, noise=NOISE, seed=0, samples=60):
    voltage = PLANT.compensate(plain_records.path(turns, samples), state=TOP).voltage
    return plain_records.driven(PLANT, voltage, noise=noise * plain_records.STROKE, seed=seed, state=TOP)


def identified(record, norm="l2"):
    return dehyst.identify(
        record, breakaway=PLANT.slip.breakaway[:-1], norm=norm, delay=0.0, drift=False, knots=6, slope_floor=0.05
    ).actuator


@cache
def evidence(turns=TOPS, norm="l2", noise=NOISE, samples=60):
    record = recorded(turns, noise=noise, samples=samples)
    return Evidence.from_records(identified(record, norm), record)


@cache
def estimate(seed, norm="l2"):
    """Stiffnesses identified from another record of the same actuator."""
    return identified(recorded(seed=seed), norm).slip.stiffness


def widths(found):
    return np.diff(found.stiffness, axis=0)[0]


def benchmark():
    path = places.BENCHMARKS / "coverage.py"
    spec = importlib.util.spec_from_file_location("coverage_benchmark", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.nightly
@pytest.mark.parametrize(("norm", "repeats"), [("l2", 200), ("l1", 60)])
def test_ninety_percent_intervals_hold_the_truth_85_to_95_times_in_a_hundred(norm, repeats):
    # The benchmark repeats both 200 times.
    found = benchmark().coverage(5, norm, NOISE, repeats=repeats, resamples=50, samples=60)
    for name in ("stiffness", "spring", "prediction"):
        assert 0.85 <= found[name]["share"] <= 0.95, (name, found)


def test_intervals_are_as_wide_as_estimates_scatter():
    # The second way: a hundred other records of the same actuator.
    other = [estimate(seed) for seed in range(1, 101)]
    resampled = np.array([one.slip.stiffness for one in resample(evidence(), repeats=200).actuators])
    # Standard deviations of 100 and 200 numbers are good to 7 and 5 %, the residuals of one record to some more.
    assert resampled.std(axis=0) == pytest.approx(np.std(other, axis=0), rel=0.3)
    bias = np.mean(other, axis=0) - TRUTH
    again = resampled.mean(axis=0) - evidence().actuator.slip.stiffness
    assert again == pytest.approx(bias, abs=0.5 * np.std(other, axis=0).max())


def test_a_seed_makes_them_again():
    first, again, other = (resample(evidence(), repeats=20, seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(first.stiffness, again.stiffness)
    assert np.array_equal(first.spring, again.spring)
    assert not np.array_equal(first.stiffness, other.stiffness)


def test_intervals_are_the_basic_ones_of_their_actuators():
    found = resample(evidence(), repeats=40, level=0.8)
    model = evidence().actuator
    every = np.array([one.slip.stiffness for one in found.actuators])
    assert found.spread == 1
    # Nine blocks of one cycle's length, 80 %: Student's 1.397 of eight degrees of freedom over the normal 1.282.
    assert found.few == pytest.approx(1.397 / 1.282, rel=1e-3)

    def basic(centre, every):
        tails = np.quantile(every, (0.9, 0.1), axis=0) - np.mean(every, axis=0)
        return 2 * centre - np.mean(every, axis=0) - found.few * tails

    assert found.stiffness == pytest.approx(basic(model.slip.stiffness, every), rel=1e-9)
    slopes = [one.spring.slopes for one in found.actuators]
    assert found.slopes == pytest.approx(basic(model.spring.slopes, slopes), rel=1e-9)


def test_a_wider_level_gives_wider_intervals():
    found = resample(evidence(), repeats=40)
    voltage = evidence().comparisons[0].record.record.voltage
    last = None
    for level in (0.5, 0.8, 0.9, 0.99):
        one = Intervals(found.actuator, found.actuators, level, found.spread)
        bands = [one.stiffness, one.slopes, one.spring, one.prediction(voltage, lambda model: model.state)]
        if last is not None:
            for wide, narrow in zip(bands, last, strict=True):
                assert (wide[0] <= narrow[0]).all()
                assert (narrow[1] <= wide[1]).all()
                assert np.diff(wide, axis=0).sum() > np.diff(narrow, axis=0).sum()
        last = bands


def test_a_stiffness_is_never_said_to_be_negative():
    found = resample(evidence(), repeats=20)
    small = replace(found, spread=1e6)
    assert small.stiffness.min() == 0


def test_widths_grow_with_the_noise():
    quiet, loud = (widths(resample(evidence(noise=noise), repeats=100)) for noise in (0.25 * NOISE, NOISE))
    # Noise counts by its extremes, too, and in the carts that they drag, so not quite in proportion.
    assert loud / quiet == pytest.approx(np.full(4, 4.0), rel=0.35)


def test_without_noise_intervals_are_a_point():
    found = resample(evidence(noise=0.0), repeats=20)
    assert widths(found).max() < 1e-6 * TRUTH.max()
    assert found.stiffness == pytest.approx(np.tile(TRUTH, (2, 1)), rel=1e-6)


@pytest.mark.parametrize("records", [40, pytest.param(80, marks=pytest.mark.nightly)])
def test_the_spread_is_how_much_more_least_absolute_deviations_scatter(records):
    # The second way: the same other records, identified by both norms. Of white noise alone it would be sqrt(pi / 2).
    scatter = {norm: np.std([estimate(seed + 1, norm) for seed in range(records)], axis=0) for norm in ("l1", "l2")}
    ratio = np.sqrt(np.mean((scatter["l1"] / scatter["l2"]) ** 2))
    assert resample(evidence(norm="l1"), repeats=20).spread == pytest.approx(ratio, rel=0.15)
    assert resample(evidence(norm="l2"), repeats=20).spread == 1


def test_another_method_is_not_widened():
    one = evidence(norm="l1")
    paper = one.actuator.with_identification(method="breakpoints")
    record = one.comparisons[0].record.record
    assert resample(Evidence.from_records(paper, record), repeats=20).spread == 1


def test_open_directions_keep_the_models_values():
    # Of the true stiffnesses none is at its bound, which would leave the known ones no way but across.
    record = recorded(MAJOR)
    truth = replace(identified(record), slip=MaxwellSlip(PLANT.slip.breakaway[:-1], TRUTH), spring=PLANT.spring)
    one = Evidence.from_records(truth, record)
    assert (one.identifiability.determined, one.identifiability.of) == (2, 4)
    found = resample(one, repeats=60)
    # k_1 + k_4 and k_2 + k_3 may move, k_1 - k_4 and k_2 - k_3 (in volts of breakaway orthogonal to those told) not.
    rho = truth.slip.breakaway
    still = one.identifiability.vectors[one.identifiability.determined :] * rho
    moved = np.array([a.slip.stiffness - TRUTH for a in found.actuators])
    assert np.abs(moved @ still.T).max() < 1e-6 * (TRUTH @ rho)
    assert np.abs(moved).max() > 1e-4 * TRUTH.max()


def test_noise_says_nothing_of_open_directions_but_latitude_does():
    one = evidence(MAJOR)
    found, free = resample(one, repeats=60), feasible_set(one).stiffness
    assert (free[0] <= TRUTH).all()
    assert (free[1] >= TRUTH).all()
    assert (widths(found) < 0.2 * np.diff(free, axis=0)[0]).all()
    low, high = found.stiffness
    assert not ((low <= TRUTH) & (high >= TRUTH)).all()


def test_what_is_known_of_a_major_loop_is_held():
    found = resample(evidence(MAJOR), repeats=60)
    sums = np.array(
        [
            [a.slip.stiffness[0] + a.slip.stiffness[3], a.slip.stiffness[1] + a.slip.stiffness[2]]
            for a in found.actuators
        ]
    )
    centre = evidence(MAJOR).actuator.slip.stiffness
    true, model = (np.array([k[0] + k[3], k[1] + k[2]]) for k in (TRUTH, centre))
    assert np.abs(true - (2 * model - sums.mean(axis=0))).max() < 4 * sums.std(axis=0).max()


def test_many_records_are_resampled_each_by_itself():
    records = [recorded(seed=1), recorded((1, 0, 1, 0, 0.5, 0, 0.5, 0), seed=2)]
    fit = dehyst.identify(
        records, breakaway=PLANT.slip.breakaway[:-1], norm="l2", delay=0.0, drift=False, knots=6, slope_floor=0.05
    )
    assert fit.outcome is Outcome.IDENTIFIED
    found = resample(Evidence.from_records(fit.actuator, records), repeats=60)
    assert (np.abs(found.stiffness.mean(axis=0) - TRUTH) < 2 * widths(found)).all()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"level": 0.0}, "got level 0.0 and 100 repeats"),
        ({"level": 1.0}, "got level 1.0 and 100 repeats"),
        ({"level": 90}, "got level 90 and 100 repeats"),
        ({"level": float("nan")}, "need a level between 0 and 1"),
        ({"repeats": 19}, "got level 0.9 and 19 repeats, need a level between 0 and 1 and at least 20 repeats"),
    ],
)
def test_refusals(options, said):
    with pytest.raises(IdentifyError, match=said):
        resample(evidence(), **options)


def test_progress_is_told():
    said = []
    resample(evidence(), repeats=20, progress=said.append)
    assert said == ["identifying resampled cycles, 0 of 20", "identifying resampled cycles, 10 of 20"]


def test_a_stiffness_at_its_bound_may_be_larger():
    one = evidence(MAJOR)
    found, bound = resample(one, repeats=40), one.actuator.slip.stiffness == 0
    assert bound.any()
    assert (found.stiffness[0, bound] == 0).all()
    every = np.array([a.slip.stiffness[bound] for a in found.actuators])
    assert (found.stiffness[1, bound] >= np.quantile(every, 0.95, axis=0)).all()
