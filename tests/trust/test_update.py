"""A model updated from one record: what changed, what could not be seen, and that it predicts better."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest

import dehyst
from dehyst import Actuator, DisplacementCreep, IdentifyError, MaxwellSlip, Spring, Structure
from dehyst._views.lines import percent
from dehyst.model import turned

TRAINED = (1, 0, 1, 0, 0.8, 0, 0.6, 0, 0.4, 0, 0.2, 0)
ONE_LOOP = (0, 1, 0, 1, 0)
TEST = (0, 1, 0, 0.9, 0.3, 0.7, 0.2, 0.8, 0.1, 0.6, 0.4, 1, 0)
TEN = Structure(elements=10, knots=11, smoothing=0.0)
TRUE = plain_records.plant(10, seed=4)


@pytest.fixture(scope="module")
def old():
    return dehyst.identify(driven(TRUE, TRAINED), structure=TEN).actuator


def aged(gain, width):
    slip, spring = TRUE.slip, TRUE.spring
    kappa = slip.stiffness * (1 + width) / (1 + gain)
    first = float(spring.voltage[0] + (kappa - slip.stiffness) @ slip.breakaway)
    return Actuator(
        MaxwellSlip(slip.breakaway, kappa), Spring.of_slopes(spring.displacement, spring.slopes / (1 + gain), first)
    )


def driven(stage, turns, **options):
    """The record of a voltage through turns, as parts of 0 to 200 V."""
    voltage = plain_records.VOLTS / plain_records.STROKE * plain_records.path(turns)
    start = turned(stage, 0.0, rising=False)
    return plain_records.driven(stage, voltage, noise=2e-9, state=start, **options)


def error(model, record):
    found = dehyst.check(model, record)
    return np.array([found.largest, found.rms]) / plain_records.STROKE


def test_one_loop_is_enough_for_gain_and_width(old):
    stage = aged(-0.07, 0.25)
    record = driven(stage, ONE_LOOP, seed=1)
    made = dehyst.update(old, record)
    test = driven(stage, TEST, seed=2)
    anew = dehyst.identify(driven(stage, TRAINED, seed=3), structure=TEN).actuator
    assert made.used
    assert np.all(error(made.actuator, test) < 0.2 * error(old, test))
    assert np.all(error(made.actuator, test) < np.maximum(1.3 * error(anew, test), 0.003))
    changes = {change.name: change for change in made.recheck.changes}
    reached = record.stroke / driven(TRUE, ONE_LOOP, seed=1).stroke
    assert changes["gain"].value == pytest.approx(reached - 1, abs=0.05)
    assert abs(changes["width"].value - 0.25) < 3 * changes["width"].error
    assert made.held_out[1] < 0.3 * made.before[1]
    assert made.after[1] < 0.3 * made.before[1]
    assert any("gain" in sentence for sentence in made.sentences())
    known = made.actuator.identification
    assert known.validity.anywhere.rms == made.promise.rms
    goal = 99 * made.promise.largest / made.recheck.stroke
    assert made.good and not replace(made, recheck=replace(made.recheck, goal=goal)).good
    assert known.validity.rms >= old.identification.validity.rms
    assert len(known.validity.branches) > len(old.identification.validity.branches)
    assert made.actuator.provenance["updated_from"] == old.name
    assert made.actuator.limits == old.limits


@pytest.mark.parametrize(("friction", "gain"), [(0.75, 1.0), (1.3, 1.0), (1.0, 1.08)])
def test_friction_or_a_gain_changes_all_thresholds(old, friction, gain):
    stage = replace(TRUE, slip=replace(TRUE.slip, breakaway=friction * TRUE.slip.breakaway), state=None)
    records = driven(stage, ONE_LOOP, seed=1), driven(stage, TEST, seed=2)
    record, test = (replace(record, displacement=gain * record.displacement) for record in records)
    made = dehyst.update(old, record)
    np.testing.assert_allclose(made.actuator.slip.breakaway / old.slip.breakaway, friction * gain, rtol=0.05)
    assert np.all(error(made.actuator, test) < [0.006, 0.0025])
    assert np.all(error(old, test) > [0.01, 0.005])


def test_one_loop_is_enough_with_creep():
    """What creeps from before the record could take the place of a change of gain, if it could be any size."""
    creep = DisplacementCreep([0.5, 5.0, 50.0], np.full(3, 0.02))
    model, stage = replace(TRUE, displacement_creep=creep), replace(aged(-0.07, 0.25), displacement_creep=creep)

    def played(turns, seed, samples):
        voltage = plain_records.VOLTS / plain_records.STROKE * plain_records.path(turns)
        time, start = 0.02 * np.arange(voltage.size), turned(stage, 0.0, rising=False)
        y = stage.simulate(voltage, time=time, state=start, extrapolate=True).displacement
        y = y + np.random.default_rng(seed).normal(0, 2e-9, y.size)
        return dehyst.Record(time[-samples:], voltage[-samples:], y[-samples:])

    made = dehyst.update(model, played((0, 1, 0, 1, 0, 1, 0), 1, 200))
    test = played(TEST, 2, 1201)
    assert made.used
    assert np.all(error(made.actuator, test) < [0.006, 0.0025])
    assert np.all(error(model, test) > 0.04)


def test_a_stage_that_has_not_changed_keeps_its_model(old):
    made = dehyst.update(old, driven(TRUE, ONE_LOOP, seed=1))
    assert not made.used
    assert made.recheck.kept and made.actuator is old
    # One verdict, with the number of a check, also where the model is not good enough.
    check = made.recheck
    poor = replace(made, recheck=replace(check, goal=1e-3))
    assert (made.good, poor.good) == (True, False) and poor.sentences() == made.sentences() == made.missing
    assert poor.sentence.startswith(made.sentence) and percent(check.without_noise, check.stroke) in made.sentence


@pytest.mark.parametrize("parts", [{}, {"thermal": dehyst.Thermal(2e-3, 0.0, 20.0)}])
def test_a_record_widens_the_promise_even_if_the_old_model_stays(old, parts):
    model, record = replace(old, **parts), driven(TRUE, (*ONE_LOOP, 0.5, 0), seed=1)
    record = replace(record, others={"temperature_C": np.full(len(record), 20.0)})
    bent = 0.03 * plain_records.STROKE * np.sin(np.linspace(0, 40, len(record)))
    made = dehyst.update(model, replace(record, displacement=record.displacement + bent))
    before, after = model.identification, made.actuator.identification
    assert not made.used
    assert made.promise.largest >= made.before[0] > before.validity.anywhere.largest
    assert made.promise.rms >= np.sqrt(made.before[1] ** 2 - made.recheck.noise**2)
    assert len(after.validity.branches) > len(before.validity.branches)
    assert after.largest_error == before.largest_error
    assert made.actuator.thermal == model.thermal
    assert made.actuator.slip is model.slip


def test_parts_that_a_record_does_not_show_stay_and_are_named(old):
    stage = aged(-0.07, 0.0)
    made = dehyst.update(old, driven(stage, (0, 0.5, 0, 0.5, 0, 0.5, 0), seed=1))
    assert any("not visited" in sentence for sentence in made.missing)
    assert made.as_dict()["missing"] == list(made.missing)


def test_the_zero_of_the_sensor_is_distinguished_from_the_stage(old):
    record = driven(aged(-0.07, 0.25), ONE_LOOP, seed=1)
    made = dehyst.update(old, replace(record, displacement=record.displacement - 5e-6))
    assert made.used
    assert made.zero == pytest.approx(-5e-6, abs=0.08 * plain_records.STROKE)


def test_another_actuator_is_refused(old):
    record = driven(TRUE, ONE_LOOP)
    with pytest.raises(IdentifyError, match="clearly not"):
        dehyst.update(old, replace(record, displacement=3 * record.displacement))


def test_parts_after_the_elements_do_not_change(old):
    creep, thermal = DisplacementCreep([0.5, 5.0], [0.02, 0.02]), dehyst.Thermal(2e-3, 0.0, 20.0)
    model, stage = (replace(own, displacement_creep=creep, thermal=thermal) for own in (old, aged(-0.07, 0.25)))
    made = driven(aged(-0.07, 0.25), ONE_LOOP, seed=1)
    degrees = np.full(len(made), 30.0)
    measured = stage.simulate(
        made.voltage, time=made.time, temperature=degrees, state=turned(stage, 0.0, rising=False)
    ).displacement
    record = dehyst.Record(made.time, made.voltage, measured, "warm", others={"temperature_C": degrees})
    found = dehyst.update(model, record)
    assert found.used
    assert (found.actuator.displacement_creep, found.actuator.thermal) == (creep, thermal)
    assert error(found.actuator, record)[0] < 0.3 * error(model, record)[0]
