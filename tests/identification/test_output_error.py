"""Gauss and Newton's steps: to the truth from thresholds that are off, and left out where they only follow noise."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest
import structured_records as wide

import dehyst
from dehyst import IdentifyError
from dehyst.identification import Structure
from dehyst.identification.structured_fit import StructuredFit, _after_steps, _Iterate, refine
from dehyst.records.signals import rms

NAMES = ["plain", "graded", "transformer", "creep", "smooth"]


def made(name, noise=0.0, off=0.0):
    """A solved structure on records of an actuator whose thresholds lie elsewhere by parts of themselves."""
    structure = wide.STRUCTURES[name]
    plant = wide.plant(structure)
    slip = plant.actuator.slip
    shift = 1 + off * np.cos(3.0 * np.arange(len(slip)))
    carts = plant.path[0] - (plant.path[0] - plant.state.carts) * shift
    state = replace(plant.state, carts=carts)
    actuator = replace(plant.actuator, slip=replace(slip, breakaway=slip.breakaway * shift), state=state)
    moved = replace(plant, actuator=actuator, state=state)
    return StructuredFit.solve(
        wide.frame([moved.record(noise=noise * plain_records.STROKE)]), structure, "l2"
    ), actuator


@pytest.mark.parametrize("name", NAMES)
def test_the_unknowns_make_the_actuator_again(name):
    solved, _ = made(name)
    point = _Iterate.of(solved)
    again = point.actuator
    np.testing.assert_allclose(again.slip.stiffness, solved.actuator.slip.stiffness, rtol=1e-9, atol=1e-3)
    np.testing.assert_allclose(again.spring.voltage, solved.actuator.spring.voltage, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(point.errors(), solved.playback().errors(solved.actuator), atol=1e-15)


@pytest.mark.parametrize("name", NAMES)
def test_slopes_tell_what_a_small_change_does(name):
    """A random small change of every coefficient: the linearised simulation against the simulation."""
    point, rng = _Iterate.of(made(name, noise=1e-4)[0]), np.random.default_rng(3)
    errors, rows = point.errors(), np.arange(point.errors().size)
    by_x, by_rho = point._slopes(errors, rows)
    change = 1e-4 * point._sizes() * rng.uniform(0, 1, point.x.size)
    predicted = errors - by_x @ change
    found = replace(point, x=point.x + change).errors()
    assert rms(found - predicted) < 0.05 * rms(found - errors)
    moves = 1e-4 * rng.uniform(-1, 1, point.breakaway.size) * point.regression.grid.movable
    found = replace(point, breakaway=point.breakaway * (1 + moves)).errors()
    assert rms(found - (errors - by_rho @ moves)) < 0.1 * rms(found - errors)


def test_thresholds_that_are_off_are_moved():
    """The right grid is found from a wrong one, and simulation is better for it on cycles that were not seen."""
    solved, truth = made("plain", noise=2e-5, off=0.04)
    found = refine(solved, lambda _: None)
    assert found.kept
    assert found.after < 0.8 * found.before
    before, after = (
        np.abs(one.slip.breakaway[:5] - truth.slip.breakaway[:5]) for one in (solved.actuator, found.actuator)
    )
    assert after.mean() < 0.7 * before.mean()


def test_what_only_follows_noise_is_left_out():
    solved, _ = made("plain", noise=1e-3)
    found = refine(solved, lambda _: None)
    assert not found.kept
    assert found.actuator is solved.actuator
    # The steps did lower the error of the cycles that they saw.
    point = _Iterate.of(solved)
    seen = np.ones(point.errors().size, dtype=bool)
    assert rms(_after_steps(point, seen).errors()) < rms(point.errors())


def test_thresholds_keep_their_order():
    point = _Iterate.of(made("plain")[0])
    for moves in (np.full(point.breakaway.size, 5.0), np.resize([9.0, -9.0], point.breakaway.size)):
        rho = point.step(point.x, moves, 1.0).breakaway
        assert np.all(np.diff(rho, prepend=0.0) > 0)


def test_identify_says_what_came_of_it():
    plant = wide.plant(wide.STRUCTURES["plain"])
    fit = dehyst.identify(
        plant.record(noise=1e-4 * plain_records.STROKE), structure=Structure(8, knots=7), refine=True, delay=0.0
    )
    assert any(remark.startswith("Refined by simulation: RMS error of cycles held out") for remark in fit.remarks)
    with pytest.raises(IdentifyError) as refused:
        dehyst.identify(plant.record(), elements=10, refine=True)
    assert (refused.value.argument, "elements" in refused.value.hint, "auto" in refused.value.hint) == (
        "refine",
        True,
        False,
    )


def test_inequalities_of_the_program_have_a_column_for_each_unknown_of_the_refinement():
    """Tau and graded elements have them; a simulation's errors have other free columns than the program's rows."""
    structure = wide.STRUCTURES["all"]
    frame = wide.frame([wide.plant(structure).record(noise=1e-4 * plain_records.STROKE)])
    found = refine(StructuredFit.solve(frame, structure, "l2"), lambda _: None)
    assert found.after > 0
