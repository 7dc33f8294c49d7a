"""Goldfarb and Celanovic's identification on records of their own electric circuit, integrated by SciPy."""

from functools import cache

import numpy as np
from electromechanical_oracle import branches, quasi_static
from paper_stacks import CONSTANTS, KEQ, T, assert_proportional, paper_stack

from dehyst import Record
from dehyst.model import Physical
from dehyst_rivals import GoldfarbCelanovic

STACK = paper_stack(linear=True)
REACH = STACK.friction / STACK.stiffness
RESISTANCES = np.array([1000.0, 250.0, 62.5])
TURNS = [0, 200, 0, 140, 30, 90, 60, 150, 0]


def instants(samples, peak=200.0):
    """Times of samples, with those at which dry elements break on the first rise, of one second, to the peak [V]."""
    force = KEQ * REACH + np.minimum.outer(REACH, REACH) @ STACK.stiffness
    times, _ = branches(TURNS, samples)
    return np.union1d(times, np.arccos(1 - 2 * force / T / peak) / np.pi)


@cache
def recorded(resistance, samples=500):
    """A record from the relaxed state, and its charges."""
    time, voltage = instants(samples), branches(TURNS, 1)[1]
    q, y = quasi_static(STACK, time, voltage, resistance)
    return Record(time, voltage(time), y, "circuit"), q


def identified(record):
    return GoldfarbCelanovic.fit(record, breakaway=np.interp(REACH, STACK.x, STACK.displacement(T * STACK.x)))


def test_stiffnesses_and_breakaway_forces_converge_to_the_truth():
    errors = []
    for resistance in RESISTANCES:
        paper = Physical.of(identified(recorded(resistance)[0]).actuator, **CONSTANTS)
        k = np.abs(paper.stiffness - STACK.stiffness).max() / STACK.stiffness.max()
        f = np.abs(paper.friction - STACK.friction).max() / STACK.friction.max()
        linear = np.abs(np.diff(paper.nonlinear)).max() / paper.parallel[-1]
        errors.append([k, f, linear])
    for kind in np.transpose(errors):
        assert_proportional(kind, RESISTANCES)
        assert kind[-1] < 5e-4


def test_the_fit_follows_the_published_method():
    """Slopes of force over deformation between break points of the first rise, the deformation being charge over T."""
    record, q = recorded(250.0)
    top = int(np.argmax(record.voltage))
    rise = slice(0, top + 1)
    places = np.concatenate([[0.0], REACH, [q[top] / T]])
    slopes = np.diff(np.interp(places, q[rise] / T, T * record.voltage[rise])) / np.diff(places)
    paper = Physical.of(identified(record).actuator, **CONSTANTS)
    np.testing.assert_allclose(paper.stiffness, -np.diff(slopes), rtol=1e-9)
    np.testing.assert_allclose(paper.friction, -np.diff(slopes) * REACH, rtol=1e-9)
    np.testing.assert_allclose(np.diff(paper.parallel) / np.diff(paper.deformation), slopes[-1], rtol=1e-9)


def test_the_loops_after_the_rise_are_predicted():
    errors = []
    for resistance in RESISTANCES:
        record, _ = recorded(resistance)
        found = identified(record)
        assert found.remarks == ()
        y = found.simulate(record.voltage).displacement
        errors.append(np.abs(y - record.displacement).max() / np.ptp(record.displacement))
    assert_proportional(errors, RESISTANCES)
    assert errors[-1] < 5e-5
