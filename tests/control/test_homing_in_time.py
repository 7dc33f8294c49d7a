"""A homing of a wider actuator homes from wherever its voltages can have led, as far as it says."""

import re
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import plain_records
import pytest
import structured_records
from hypothesis import given
from hypothesis import strategies as st

from dehyst import Actuator, DisplacementCreep, Dynamics, MaxwellSlip, Spring
from dehyst.control import shortest_homing
from dehyst.control.planning.homing import possible_states
from dehyst.model import SmoothSlip, turned
from dehyst.waveforms import Sampling
from examples import examples

LIMITS = -40.0, 260.0
DRIVE = Sampling(frequency=0.01, sample_rate=2.0)
ORDERED = {
    name: replace(structured_records.plant(structured_records.STRUCTURES[name]).actuator, limits=LIMITS)
    for name in ("graded", "transformer", "graded, transformer")
}
PLAIN = replace(plain_records.plant(6), limits=LIMITS)
CREEPING = replace(PLAIN, displacement_creep=DisplacementCreep([2.0, 30.0, 200.0], [0.01, 0.02, 0.02]))
BRANCHES = DisplacementCreep([3.0, 60.0], [0.02, 0.02])
TIMED = {
    "creep": CREEPING,
    "all but smooth": replace(ORDERED["graded, transformer"], displacement_creep=BRANCHES, lag=0.5),
    "inertia": replace(PLAIN, dynamics=Dynamics(9.55, 0.05)),
    "inertia and a series spring": replace(CREEPING, dynamics=Dynamics(9.55, 0.05, 3e6)),
    "smooth": replace(PLAIN, smooth=SmoothSlip([1e-6, 5e-6], [1.0, 0.5], [2e6, 1e6])),
    "smooth and creep": replace(CREEPING, smooth=SmoothSlip([1e-6, 5e-6], [1.0, 0.5], [2e6, 1e6])),
}


def past(actuator, seed, present):
    """The state at a voltage that any voltages within the limits may have led to, at rest but for creep."""
    rng = np.random.default_rng(seed)
    still = replace(actuator, dynamics=None, lag=0.0)
    turns = rng.uniform(*LIMITS, 12)
    turns[rng.integers(0, 12, 4)] = rng.choice(LIMITS, 4)
    time = np.cumsum(rng.choice([0.1, 5.0, 1e4], 13))
    start = turned(still, float(rng.uniform(0, plain_records.STROKE)), rising=bool(rng.integers(2)))
    # The long first rest lets creep forget what no voltage led to.
    voltage = np.concatenate([turns[:1], turns[:-1], [present]])
    state = still.simulate(voltage, time=time, state=start).state
    return replace_motion(state) if actuator.dynamics else state


def replace_motion(state):
    return replace(state, motion=[state.deformation, 0.0])


@pytest.mark.parametrize("name", ["plain", *ORDERED])
@pytest.mark.parametrize("side", [1, -1])
def test_the_bounding_states_are_the_ends_of_long_motions(name, side):
    actuator = {**ORDERED, "plain": PLAIN}[name]
    for v in np.linspace(*LIMITS, 9).tolist():
        y = possible_states(actuator, v)[side < 0].deformation
        start = turned(actuator, y - 100 * side * plain_records.STROKE, rising=side > 0)
        reached = actuator.simulate([v], state=start, extrapolate=True)
        assert reached.displacement[0] == pytest.approx(y, abs=1e-11 * plain_records.STROKE)


@pytest.mark.parametrize("name", TIMED)
@examples(8, nightly=60)
@given(seed=st.integers(0, 10**6))
def test_after_a_homing_every_past_is_within_the_stated_spread(name, seed):
    actuator, found, slack = TIMED[name], _timed(name), 1e-12 * plain_records.STROKE

    def moved(played, state):
        return actuator.simulate(played.voltage, time=played.time, state=state, extrapolate=True)

    reached = moved(found.played, past(actuator, seed, 0.0)).state
    assert abs(reached.deformation - found.state.deformation) <= found.spread + slack
    further = DRIVE.play("", DRIVE.branches([0.0, 150.0, 20.0, 260.0, -40.0, 0.0]))
    apart = np.abs(moved(further, reached).displacement - moved(further, found.state).displacement).max()
    # A mass may overshoot by as much as it was off.
    assert apart <= (2 if actuator.dynamics else 1) * found.spread + slack


@cache
def _timed(name):
    return shortest_homing(TIMED[name], present=0.0, drive=DRIVE)


def test_a_smaller_tolerance_needs_a_longer_homing():
    needed = [shortest_homing(CREEPING, drive=DRIVE, tolerance=least) for least in (1e-7, 1e-8, 1e-9)]
    assert all(homing.certified for homing in needed)
    seconds = [homing.played.duration for homing in needed]
    assert all(b > 1.2 * a for a, b in pairwise(seconds))
    short = shortest_homing(CREEPING, drive=DRIVE, tolerance=1e-9, within=0.7 * seconds[-1])
    assert not short.certified and short.spread > 1e-9 and short.played.duration < 0.71 * seconds[-1]
    assert re.search(r"holds of \S+ s at both limits instead of \S+ s would suffice", short.remarks[0])


def test_a_homing_of_smooth_elements_is_remarked_as_not_proven():
    assert re.search(r"\b18\b.* not proven", _timed("smooth").remarks[-1])
    assert not any("not proven" in said for said in _timed("creep").remarks)


def test_without_elements_a_homing_waits_for_creep():
    creep = DisplacementCreep([5.0], [0.1])
    actuator = Actuator(MaxwellSlip([], []), Spring([0, 1e-5], [0, 100]), displacement_creep=creep, limits=(0, 100))
    assert shortest_homing(actuator).certified


@pytest.mark.parametrize("damping", [0.05, 2.0])
def test_a_mass_comes_to_rest_at_the_limits(damping):
    """Twelve time constants of its slower root."""
    dynamics = Dynamics(9.55, damping)
    found = shortest_homing(replace(PLAIN, dynamics=dynamics), present=0.0)
    voltage, time = found.played.voltage, found.played.time
    ends = np.flatnonzero(np.diff(voltage, prepend=np.nan, append=np.nan))
    longest = max(time[stop - 1] - time[first] for first, stop in pairwise(ends))
    roots = np.roots([1.0, 2 * damping * dynamics.omega, dynamics.omega**2])
    assert longest == pytest.approx(12 / np.abs(roots.real).min(), rel=0.02, abs=np.diff(time).max())
