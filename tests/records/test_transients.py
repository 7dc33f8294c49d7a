"""Steps of the voltage that ring are named; what follows the voltage, creeps or jumps by itself is not."""

import numpy as np
import pytest

from dehyst import Record
from dehyst.records.cleaning import settled, transients, voltage_steps
from dehyst.records.glitches import spikes

RATE = 5000.0


def stepped(ring=0.0, frequency=1000.0, damping=0.09, *, after=0.0, noise=1e-8, creep=0.0):
    """A record at rest, a step by -87 V, what rings, then sines; displacements 0.1 um/V."""
    count = 6000
    time = np.arange(2 * count) / RATE
    since = time[count:] - time[count]
    voltage = np.where(time < time[count], after, after - 87.0)
    voltage[count:] += 60 * (1 - np.cos(2 * np.pi * since))
    omega = 2 * np.pi * frequency
    y = 1e-7 * voltage
    y[count:] += 8.7e-6 * ring * np.exp(-damping * omega * since) * np.cos(omega * np.sqrt(1 - damping**2) * since)
    y[count:] -= 8.7e-6 * creep * np.log10(1 + since / 0.001)
    return Record(time, voltage, y + np.random.default_rng(1).normal(0, noise, y.size))


@pytest.mark.parametrize("noise", [1e-9, 1e-8, 3e-8])
@pytest.mark.parametrize(("frequency", "damping"), [(1000.0, 0.09), (400.0, 0.03), (90.0, 0.1)])
def test_a_ring_is_named_with_its_frequency_and_damping(frequency, damping, noise):
    record = stepped(1.0, frequency, damping, noise=noise)
    (found,) = transients(record)
    assert (found.start, found.jump) == (5999, 6000)
    assert found.time == pytest.approx(1.2)
    assert found.voltages == pytest.approx((0, -87), abs=0.1)
    assert found.frequency == pytest.approx(frequency, rel=0.04)
    assert found.damping == pytest.approx(damping, rel=0.25)
    # What is left of it is hardly more than the noise.
    left = 8.7e-6 * np.exp(-damping * 2 * np.pi * frequency * found.duration)
    assert left < 3 * noise + 2e-3 * record.stroke


def test_an_overshoot_without_a_ring_is_named():
    (found,) = transients(stepped(0.3, 1.0, 0.9999))[:1] or (None,)
    assert found is None
    record = stepped()
    over = record.displacement.copy()
    over[6000:] -= 2e-6 * np.exp(-np.arange(6000) / 30)
    (found,) = transients(Record(record.time, record.voltage, over))
    assert found.frequency == 0
    assert 60 < found.stop - found.start < 400


@pytest.mark.parametrize("creep", [0.0, 0.02])
def test_a_displacement_that_follows_a_step_has_no_transient(creep):
    record = stepped(creep=creep)
    assert voltage_steps(record.voltage) == [(5999, 6000)]
    assert transients(record) == ()


def test_drives_without_steps_have_none():
    time = np.arange(4000) / RATE
    for voltage in (
        100 * np.sin(20 * time),
        100 * np.abs(2 * ((3 * time) % 1) - 1),
        np.where(time < 0.5, 100 * np.sin(6 * time), 100 * np.sin(3 + 900 * (time - 0.5))),
    ):
        assert voltage_steps(voltage) == []


def test_a_transient_is_no_spike_and_a_spike_no_transient():
    ring = stepped(1.0)
    assert not any("spike" in sentence for sentence in ring.problems())
    quiet = stepped()
    y = quiet.displacement.copy()
    y[[1000, 9000]] += 3e-6
    spiked = Record(quiet.time, quiet.voltage, y)
    assert transients(spiked) == ()
    assert np.flatnonzero(spikes(spiked.voltage, spiked.displacement)).tolist() == [1000, 9000]


def test_the_settled_path_leads_from_one_level_to_the_other():
    record = stepped(1.0)
    found = transients(record)
    path = settled(record, found)
    inside = slice(found[0].start, found[0].stop)
    assert path[inside].min() > -8.9e-6
    assert path[inside].max() < 0.1e-6
    outside = np.ones(len(record), dtype=bool)
    outside[inside] = False
    assert np.array_equal(path[outside], record.displacement[outside])


def test_a_step_of_several_samples_is_replaced_by_what_its_voltage_does():
    """From one level to the other in proportion to the voltage."""
    record = stepped(noise=1e-10)
    voltage = record.voltage.copy()
    voltage[6000] = -20.0
    over = 1e-7 * voltage
    over[6001:] -= 2e-6 * np.exp(-np.arange(5999) / 30)
    slow = Record(record.time, voltage, over)
    (found,) = transients(slow)
    assert (found.start, found.jump) == (5999, 6001)
    path = settled(slow, (found,))
    assert path[6001] == pytest.approx(-8.7e-6, abs=0.02 * 2e-6)
    share = (path[6000] - path[5999]) / (path[6001] - path[5999])
    assert share == pytest.approx(20 / 87, rel=1e-6)


@pytest.mark.parametrize("away", [-50e-6, 1e-3])
def test_transients_do_not_depend_on_the_zero_of_the_sensor(away):
    record = stepped()
    over = record.displacement.copy()
    over[6000:] -= 2e-6 * np.exp(-np.arange(6000) / 30)
    found = transients(Record(record.time, record.voltage, over))
    assert found
    shifted = Record(record.time, record.voltage, over + away)
    again = transients(shifted)
    assert [(one.start, one.jump, one.stop) for one in again] == [(one.start, one.jump, one.stop) for one in found]
    path = settled(Record(record.time, record.voltage, over), found)
    assert settled(shifted, again) == pytest.approx(path + away, abs=1e-12)
