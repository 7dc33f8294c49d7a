"""The search: parts that move are found where they are and only there, and what structures leave open shows."""

from dataclasses import replace
from functools import cache

import moving_records as moved
import numpy as np
import plain_records
import pytest
import structured_records as wide

from dehyst import Dynamics, Record
from dehyst.identification import Structure, search
from dehyst.identification.cleaning import remove_dynamics
from dehyst.identification.motion import creep_times
from examples import at_night, spanning

STROKE, STEP = plain_records.STROKE, moved.STEP
NOISE = 1e-4 * STROKE
PLANT = plain_records.plant(20, seed=2)
FAST, PERIOD = 1e-4, 0.02


def found(records, lag=True, drift=True, more=True):
    """The motion that a search finds, and the names of its parts."""
    frame, names, trials = search.moving(wide.frame(records), lambda _: None, lag=lag, drift=drift, more=more)
    assert all(trial.held_out > 0 for trial in trials)
    return frame.motion, set(names) - {"creep_before"}


def tops(seed=0, noise=NOISE):
    return plain_records.loops(PLANT, plain_records.DESCENDING_TOPS, noise=noise, seed=seed)


@pytest.mark.parametrize(
    ("seed", "turns"), spanning(range(3), [plain_records.DESCENDING_TOPS, plain_records.REVERSAL_CURVES])
)
def test_no_part_is_found_in_static_records_with_noise(seed, turns):
    motion, names = found([plain_records.loops(PLANT, turns, noise=NOISE, seed=seed)])
    assert names == set()
    assert (motion.delay, motion.lag, motion.mass, motion.creep, motion.drift.any()) == (0, 0, 0, None, False)


def test_a_vibration_is_no_part_of_the_model():
    record = tops()
    y = record.displacement + 0.005 * STROKE * np.sin(2 * np.pi * 3.1 * record.time)
    motion, names = found([replace(record, displacement=y)])
    assert not {"inertia", "creep"} & names and motion.delay < 0.2 * STEP


@pytest.mark.parametrize("samples", [3, 0.5, -0.5, -0.25, -1.0, -1.5])
def test_a_delay_is_found_and_a_lead_of_at_most_half_a_sample(samples):
    motion, names = found([moved.delayed(samples, NOISE)], more=False)
    assert ("delay" in names) is (samples in (3, 0.5, -0.5))
    assert motion.delay == (pytest.approx(samples * STEP, abs=0.05 * STEP) if "delay" in names else 0)


@pytest.mark.parametrize("which", ["lag", "drift", "more"])
def test_parts_that_are_switched_off_are_not_found(which):
    record = {"lag": moved.delayed(3), "drift": moved.drifting(0.02), "more": driven(DYNAMICS)}[which]
    _, names = found([record], **{which: False})
    assert not names & {"lag": {"delay"}, "drift": {"drift"}, "more": {"creep", "inertia"}}[which]


DYNAMICS = Dynamics(300.0, 0.05)


@cache
def driven(dynamics=None, *, delay=0, noise=NOISE):
    """Descending tops at 50 Hz behind a resonance, the displacement so many samples late."""
    v = plain_records.falling_tops(12, round(PERIOD / FAST / 2))
    time = np.arange(v.size) * FAST
    late = np.concatenate([np.full(delay, v[0]), v])[: v.size]
    actuator = replace(PLANT, dynamics=dynamics)
    state = actuator.relaxed()
    if dynamics is not None:
        state = replace(state, motion=[state.deformation, 0.0])
    y = actuator.simulate(late, time=time, state=state).displacement
    return Record(time, v, y + noise * np.random.default_rng(1).normal(size=y.size), "driven")


@pytest.mark.parametrize(
    ("resonance", "damping", "delay"), [(300.0, 0.03, 2), at_night(300.0, 0.1, 0), at_night(200.0, 0.05, 1)]
)
def test_a_resonance_is_found(resonance, damping, delay):
    """Excited far below the resonance: a lag by delay is hard to tell from one by damping."""
    dynamics = Dynamics(resonance, damping)
    motion, names = found([driven(dynamics, delay=delay)])
    assert "inertia" in names
    assert motion.dynamics.frequency == pytest.approx(resonance, rel=0.05)
    lags = delay * FAST + 2 * damping / dynamics.omega
    assert motion.delay + motion.damping == pytest.approx(lags, abs=0.5 * FAST)


@pytest.mark.parametrize("dynamics", [Dynamics(8000.0, 0.05), Dynamics(300.0, 0.9)])
def test_above_the_nyquist_frequency_or_overdamped_there_is_no_resonance(dynamics):
    motion, names = found([driven(dynamics)])
    assert ("inertia" in names, motion.dynamics) == (False, None)


@pytest.mark.nightly
def test_a_low_pass_as_slow_as_the_cycles_is_a_lag():
    motion, _ = found([driven(Dynamics(300.0, 4.0))])
    assert motion.lag == pytest.approx(2 * 4.0 / (2 * np.pi * 300.0), rel=0.15)


def test_slow_cycles_show_no_resonance():
    """A thousand samples a cycle: what has a mass then is the sensor's noise."""
    v = plain_records.falling_tops(3, 600)
    y = PLANT.simulate(v, state=PLANT.relaxed()).displacement
    _, names = found([Record(np.arange(v.size) * FAST, v, y)])
    assert "inertia" not in names


def test_the_path_before_a_resonance_is_recovered():
    """A second way: the same actuator without its mass moves so. Corners of its motion are rounded a little."""
    made, expected = driven(DYNAMICS, noise=0.0), driven(noise=0.0).displacement
    seen, left = (
        np.abs(y - expected)[10:-10].max() / np.ptp(expected)
        for y in (made.displacement, remove_dynamics(made, DYNAMICS).displacement)
    )
    assert seen > 0.04
    assert left < 1e-3
    assert remove_dynamics(made, None) is made


def test_equally_good_structures_that_differ_give_a_disagreement():
    frame = wide.frame([tops(noise=0.1 * NOISE)])
    chosen, same, other = (
        search.fitted(frame, structure, 4000)
        for structure in (Structure(grades=8), Structure(grades=8, smoothing=1e-2), Structure(elements=5))
    )
    for trial in (same, other):
        trial.__dict__["held_out"] = chosen.held_out
    none, near, far, both = (
        search.disagreement(chosen.actuator, others, chosen, frame)
        for others in ([chosen], [chosen, same], [other], [same, other])
    )
    assert (none, near < 0.3 * far, near < both < far) == (chosen.held_out, True, True)
    # A structure that explains the records worse counts less.
    other.__dict__["held_out"] = 2 * chosen.held_out
    assert near < search.disagreement(chosen.actuator, [same, other], chosen, frame) < both


def test_the_smoothing_with_the_least_held_out_error_is_chosen():
    structures = [Structure(smoothing=smoothing) for smoothing in (1e-3, 1.0, 1e-2)]
    made, trials, every = search.static(wide.frame([tops()]), structures, (), lambda _: None)
    assert [trial.structure for trial in trials] == structures == [trial.structure for trial in every]
    best = min(trials, key=lambda trial: trial.held_out)
    assert (made.structure, made.held_out) == (best.structure, best.held_out)


def test_repeated_loops_have_no_new_turning_points():
    again = plain_records.loops(PLANT, (1, 0) * 12)
    random = plain_records.loops(PLANT, (0, 1, 0, *np.random.default_rng(0).uniform(0, 1, 20)))
    assert search.new_in_time(wide.frame([again])) == pytest.approx((0, 0), abs=1e-9)
    assert min(search.new_in_time(wide.frame([random]))) > 0.02


@pytest.mark.parametrize(("fastest", "longest"), [(0.01, 50.0), (1.0, 2.0)])
def test_time_constants_of_creep_reach_from_the_fastest_branch_to_the_longest_record(fastest, longest):
    tau = creep_times(fastest, longest)
    np.testing.assert_allclose(tau[[0, -1]], [fastest, longest])
    np.testing.assert_allclose(np.diff(np.log(tau), 2), 0, atol=1e-12)
    assert tau.size == max(2, round(2 * np.log10(longest / fastest)) + 1)
