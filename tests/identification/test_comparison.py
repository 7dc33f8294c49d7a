"""Wider actuators beside records: a model that made a record meets it, whatever had gone before; given structures."""

import itertools
from dataclasses import replace

import numpy as np
import plain_records
import pytest
import structured_records as wide
from hypothesis import given
from hypothesis import strategies as st

from dehyst import Dynamics, Record, identify
from dehyst._native import slip_elongations
from dehyst.identification.comparison import compare, errors_of, initial_state, state_after, without_offset
from dehyst.identification.preparation import block_of, prepare
from dehyst.identification.start_state import fit_start
from dehyst.model import MaxwellSlip
from dehyst.records.signals import bandwidth

EXACT = 1e-9


def compared(actuator, record, zero=0.0):
    """Errors and trace of a record that is simulated whole."""
    prepared = record if hasattr(record, "pieces") else prepare(record)
    return errors_of(actuator, compare(actuator, prepared, plain_records.STROKE, zero=zero), "validation")


def missed(actuator, record, **changes):
    """Largest error [% of the stroke]."""
    return compared(actuator, record, **changes)[0].largest_percent


@pytest.mark.parametrize("name", wide.STRUCTURES)
def test_an_actuator_simulates_its_own_record(name):
    plant = wide.plant(wide.STRUCTURES[name])
    error, trace = compared(plant.actuator, plant.record())
    # The carts and creep with which the record begins are fitted, smooth elements forget; afterwards all is known.
    assert error.largest_percent < 0.2
    assert 100 * np.abs(trace.residual[trace.residual.size // 2 :]).max() / error.stroke < EXACT
    assert abs(error.offset) < 1e-9 * plain_records.VOLTS
    assert error.samples + error.left_out == plant.path.size
    assert error.samples > 0.8 * plant.path.size
    # Far from the record if it is another's.
    other = wide.plant(wide.STRUCTURES[name], seed=1)
    assert missed(other.actuator, plant.record()) > 0.5
    np.testing.assert_array_equal(trace.time, plant.time[-error.samples :])


@pytest.mark.parametrize("closing", [1.0, 0.7])
@pytest.mark.parametrize("part", [-1.0, -0.6, 0.8])
def test_smooth_elements_that_are_strained_at_the_start_are_found(closing, part):
    plant = wide.plant(wide.STRUCTURES["smooth"])
    smooth = replace(plant.actuator.smooth, closing=np.full(len(plant.actuator.smooth), closing))
    actuator, strained = replace(plant.actuator, smooth=smooth), replace(plant.state, smooth=part * smooth.length)
    voltage = plant.record().voltage
    moved, unstrained = (
        actuator.simulate(voltage, state=replace(strained, smooth=elongation), extrapolate=True).displacement
        for elongation in (strained.smooth, 0 * smooth.length)
    )
    matters = 100 * np.ptp(moved - unstrained) / plain_records.STROKE
    assert missed(actuator, Record(plant.time, voltage, moved, "strained")) < 0.1 * matters


@pytest.mark.parametrize("name", ["smooth", "all"])
def test_the_samples_before_a_piece_determine_its_start(name):
    plant = wide.plant(wide.STRUCTURES[name])
    record = plant.record()
    prepared = prepare(record[20:])
    assert prepared.lead is None
    longer = replace(prepared, lead=record[:20])
    (_, with_lead), (_, alone) = (compared(plant.actuator, record) for record in (longer, prepared))
    half = with_lead.residual.size // 2
    assert 100 * np.abs(with_lead.residual[half:]).max() / plain_records.STROKE < EXACT
    # Alone, the smooth elements are taken to begin at none.
    assert 100 * np.abs(alone.residual).max() / plain_records.STROKE > 1e-4


def swung(resonance=300.0, delay=0):
    """A record of an actuator with inertia, driven at 50 Hz, so many samples late."""
    actuator = replace(plain_records.plant(20, seed=2), dynamics=Dynamics(resonance, 0.05))
    v = plain_records.falling_tops(12, 100)
    time = 1e-4 * np.arange(v.size)
    late = np.concatenate([np.full(delay, v[0]), v])[: v.size]
    start = actuator.relaxed()
    y = actuator.simulate(late, time=time, state=replace(start, motion=[start.deformation, 0.0])).displacement
    return actuator, Record(time, v, y, "swung")


@pytest.mark.parametrize("delay", [0, 2])
def test_an_actuator_with_inertia_simulates_its_own_record(delay):
    """Its motion at the first sample is read from the record: good to what derivatives at an end cost, for a while."""
    actuator, record = swung(delay=delay)
    actuator = replace(actuator, delay=1e-4 * delay)
    got = missed(actuator, record)
    assert got < 0.05
    _, trace = compared(actuator, record)
    assert 100 * np.abs(trace.residual[trace.residual.size // 2 :]).max() / plain_records.STROKE < 0.02
    assert missed(replace(actuator, dynamics=None), record) > 100 * got


@pytest.mark.parametrize("delay", [0, 40])
def test_an_oversampled_record_is_compared_by_means_of_its_samples(delay):
    """As without the means, but for the corner of each reversal; and the noise is less."""
    actuator = replace(plain_records.plant(20, seed=2), delay=1e-4 * delay)
    v = plain_records.VOLTS * (0.5 - 0.5 * np.cos(2 * np.pi * np.arange(40_000) / 10_000))
    late = np.concatenate([np.full(delay, v[0]), v])[: v.size]
    y = actuator.simulate(late).displacement
    noise = 1e-3 * plain_records.STROKE
    noisy = Record(1e-4 * np.arange(v.size), v, y + noise * np.random.default_rng(1).normal(size=y.size))
    whole, means = prepare(noisy), prepare(noisy).with_block(25)
    assert means.block == 25 and len(means.reduced.record) == v.size // 25
    assert means.reduced.noise == pytest.approx(noise / 5, rel=0.2)
    assert whole.reduced is whole
    (first, _), (other, _) = (compared(actuator, each) for each in (whole, means))
    assert other.offset == pytest.approx(first.offset, abs=1e-3 * plain_records.VOLTS)
    assert other.rms_percent < first.rms_percent * 1.01


def left_of(actuator, rest, state, offset):
    """The largest error of the rest of a record as a part of the stroke, from a state."""
    voltage = without_offset(actuator, rest.voltage, offset)
    again = actuator.simulate(voltage, time=rest.time, state=state).displacement
    return np.abs(again - rest.displacement).max() / plain_records.STROKE


@pytest.mark.parametrize("name", ["plain", "graded", "smooth", "all"])
def test_the_state_after_half_a_record_predicts_the_other_half(name):
    """Half a record of a known actuator, its voltages shifted: the other half is simulated as it was measured."""
    plant = wide.plant(wide.STRUCTURES[name])
    record = plant.record()
    half = len(record) // 2
    shift = 0.7 if plant.actuator.transformer is None else 0.0
    shifted = Record(record.time, record.voltage + shift, record.displacement, record.name)
    state, offset = state_after(plant.actuator, shifted[: half + 1])
    assert offset == pytest.approx(shift, abs=1e-6 * plain_records.VOLTS)
    rest = shifted[half:]
    assert left_of(plant.actuator, rest, state, offset) < 1e-4


@pytest.mark.parametrize("name", ["plain", "graded", "smooth"])
def test_the_state_at_the_beginning_predicts_the_record(name):
    """The second half of a record, whose first half brought the actuator into a state that no name describes."""
    plant = wide.plant(wide.STRUCTURES[name])
    record = plant.record()
    rest = record[len(record) // 3 :]
    state, offset = initial_state(plant.actuator, rest)
    assert left_of(plant.actuator, rest, state, offset) < 1e-2


@pytest.mark.parametrize("name", ["plain", "transformer"])
def test_a_record_of_less_than_a_cycle_gives_an_approximate_state(name):
    """The spring and the carts that were dragged along agree with the last voltage; the rest is as in the middle."""
    plant = wide.plant(wide.STRUCTURES[name])
    short = plant.record()[:30]
    state, offset = state_after(plant.actuator, short)
    assert state.deformation == short.displacement[-1]
    left = without_offset(plant.actuator, short.voltage[-1:], offset)
    assert plant.actuator.voltage(state) == pytest.approx(left[0], abs=1e-9)


STROKE, DELAY = plain_records.STROKE, 4e-3


def recorded(seconds, rate, seed, noise):
    """A record of branches of half a second between random turns, 4 ms late; the first two cycles are full."""
    turns = np.random.default_rng(seed).uniform([0.5, 0.0], [1.0, 0.4], (seconds - 2, 2)).ravel()
    v = plain_records.VOLTS / STROKE * plain_records.path([0, 1, 0, 1, 0, *turns], rate // 2)[:-1]
    time = np.arange(v.size) / rate
    late = plain_records.plant(4).simulate(np.interp(time - DELAY, time, v)).displacement
    return Record(time, v, late + noise * STROKE * np.random.default_rng(seed + 1).normal(size=time.size))


@pytest.mark.parametrize(("rate", "least", "most"), [(200, 1, 1), (1000, 2, 5), (10_000, 16, 50)])
def test_a_block_keeps_the_motion_and_enough_samples(rate, least, most):
    record = recorded(20, rate, 3, 0.003)
    block = block_of(record, len(record) / 4000)
    assert least <= block <= most
    assert block * record.sample_time <= 1 / 60
    # A mean would move an event.
    assert block_of(replace(record, measured=np.arange(len(record)) % 9 == 0), len(record) / 4000) == 1


def test_samples_of_steps_are_not_averaged():
    time = np.arange(20_000) * 1e-3
    steps = np.floor(time / 2) % 4
    assert block_of(Record(time, steps, 1e-6 * steps), 5) == 1
    assert bandwidth(np.sin(2 * np.pi * time), 1e-3, 1e-5) < 2


@pytest.mark.nightly
def test_a_higher_sample_rate_gives_the_same_model():
    unseen = recorded(12, 500, 40, 0.0)
    found = {}
    for rate in (200, 10_000):
        fit = identify(recorded(20, rate, 3, 0.003), structure="maxwell_slip")
        found[rate] = errors_of(fit.actuator, compare(fit.actuator, prepare(unseen), STROKE), "validation")[0]
        assert fit.actuator.delay == pytest.approx(DELAY, abs=1e-3)
        assert fit.errors[0].samples > 0.99 * 20 * rate
    assert found[10_000].rms < 0.0015 * STROKE
    assert found[10_000].rms < 1.2 * found[200].rms + 2e-4 * STROKE


COUNT = 12
RHO = np.arange(1.0, COUNT + 1) * 1e-6
NO_CREEP = np.zeros(0)


def growing(loops=8, largest=12e-6, samples=20):
    branches = [0.0]
    for size in np.linspace(largest / loops, largest, loops):
        branches += [size, -size]
    return np.concatenate([np.linspace(a, b, samples) for a, b in itertools.pairwise(branches)])


def carts_of(u, first):
    return first + np.cumsum(np.diff(RHO, prepend=0.0) * u)


@given(st.lists(st.floats(-1, 1), min_size=COUNT, max_size=COUNT))
def test_the_simulated_force_is_that_of_the_true_carts(u):
    """Some carts bear on no sample: the force is what must come back, and the carts that bear on it."""
    path, slip = growing(), MaxwellSlip(RHO, np.linspace(2e5, 1e5, COUNT))
    true, _ = slip_elongations(RHO, carts_of(np.array(u), path[0]), path)
    force = true @ slip.stiffness + 3.0
    start = fit_start(slip, path, force, np.zeros((path.size, 0)), NO_CREEP)
    found, _ = slip_elongations(RHO, start.carts, path)
    left = force - found @ slip.stiffness - start.constant
    assert np.sqrt(np.mean(left**2)) < 0.01 * np.ptp(force)
    assert np.all(np.abs(start.carts - path[0]) <= RHO * (1 + 1e-9))
