"""Temperature, drift, noise and vibration: parts are found where records show them, and only then."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest

import dehyst
from dehyst import Actuator
from dehyst.identification import Structure
from dehyst.identification.motion import temperatures_of
from dehyst.model import turned
from examples import at_night

STROKE = plain_records.STROKE
GAIN = -2.5e-3
TRUE = plain_records.plant(10, seed=4)
SETTINGS = {"structure": Structure(elements=10, knots=11, smoothing=0.0)}


def at(first, last, seed, *, name="record", gain=GAIN, offset=0.0, known=True):
    """A record of random turns while the temperature goes from `first` to `last`; 20 degrees Celsius is neutral."""
    random = np.random.default_rng(seed)
    voltage = plain_records.VOLTS / STROKE * plain_records.path((0, 1, 0, *random.uniform(0, 1, 12), 0), 60)
    made = plain_records.driven(
        TRUE, voltage, noise=2e-9, seed=seed, state=turned(TRUE, 0.0, rising=False), name=f"{name} {seed}"
    )
    temperature = np.linspace(first, last, len(made))
    y = (1 + gain * (temperature - 20)) * made.displacement + offset * (temperature - 20)
    shown = {"temperature_C": temperature + random.normal(0, 0.02, len(made))} if known else {}
    return dehyst.Record(made.time, made.voltage, y, made.name, others=shown)


def missed(actuator, record, **options):
    error = record.displacement - actuator.simulate(record.voltage, **options).displacement
    error = error[len(record) // 5 :]
    return np.abs(error - error.mean()).max() / STROKE


@pytest.fixture(scope="module")
def warm():
    return dehyst.identify([at(15, 16, 1), at(29, 31, 2), at(45, 44, 3)], **SETTINGS)


def test_the_gain_per_kelvin_is_found(warm):
    thermal = warm.actuator.thermal
    assert thermal.reference == pytest.approx(30, abs=1)
    assert thermal.gain == pytest.approx(GAIN / (1 + GAIN * (thermal.reference - 20)), rel=0.01)
    assert Actuator.from_dict(warm.actuator.as_dict()).thermal == thermal


@pytest.mark.parametrize(("seed", "gain"), [(1, GAIN), at_night(1, 0.0), at_night(11, GAIN), at_night(11, 0.0)])
def test_expansion_is_found_where_the_temperature_changes_within_records(seed, gain):
    turns = (15, 45, seed), (40, 18, seed + 1)
    thermal = dehyst.identify(
        [at(*turn, gain=gain, offset=4e-8) for turn in turns], **SETTINGS, drift=False
    ).actuator.thermal
    # The offset is that of a displacement of 0 at the reference.
    assert thermal.offset == pytest.approx(4e-8, rel=0.2)
    assert thermal.gain * STROKE == pytest.approx(gain * STROKE, abs=0.2 * abs(GAIN) * STROKE)


def test_temperatures_in_between_are_predicted_as_well_as_a_constant_one(warm):
    constant = dehyst.identify([at(20, 20, seed, known=False) for seed in (1, 2, 3)], **SETTINGS).actuator
    least = missed(constant, at(20, 20, 7, known=False))
    for degrees in (22, 38):
        record = at(degrees, degrees + 1, 7)
        found = missed(warm.actuator, record, temperature=record.temperature)
        assert found < 1.3 * least + 2e-4
        assert found < 0.2 * missed(warm.actuator, record)


@pytest.mark.nightly
def test_without_a_temperature_channel_the_promise_is_kept():
    fit = dehyst.identify([at(15, 16, 1, known=False), at(29, 31, 2, known=False), at(45, 44, 3, known=False)])
    assert fit.actuator.thermal is None
    for degrees in (22, 38):
        assert missed(fit.actuator, at(degrees, degrees, 7)) < fit.promise.largest / STROKE


def test_a_new_record_is_compared_at_the_reference(warm):
    record = at(38, 39, 7)
    assert dehyst.check(warm.actuator, record).good
    unaware = replace(warm.actuator, thermal=None)
    assert dehyst.check(unaware, record).rms > 3 * dehyst.check(warm.actuator, record).rms


def test_an_effect_that_records_do_not_show_is_left_out_with_a_reason():
    assert temperatures_of([at(20, 21, 1), at(20, 21, 2)]) == (None, "")
    incomplete, two = [at(15, 16, 1), at(44, 45, 2), at(30, 30, 3, known=False)], [at(20, 20, 1), at(35, 35, 2)]
    for records in (incomplete, two):
        found, reason = temperatures_of(records)
        assert found is None and reason
    fit = dehyst.identify(two, **SETTINGS)
    assert reason in fit.promise.reasons
    assert fit.actuator.thermal is None


def test_an_effect_that_the_time_limit_leaves_out_is_named():
    fit = dehyst.identify([at(15, 16, 1), at(29, 31, 2), at(45, 44, 3)], time_limit=1e-3)
    assert fit.actuator.thermal is None
    assert "the search ended before it" in " ".join(fit.promise.reasons)


def test_no_effect_is_found_without_an_effect():
    none = [at(first, first + 1, seed, gain=0.0) for seed, first in ((1, 15), (2, 30), (3, 44))]
    assert temperatures_of(none)[0] is not None
    fit = dehyst.identify(none, **SETTINGS)
    assert fit.actuator.thermal is None
    assert any("degC" in reason for reason in fit.promise.reasons)


def test_expansion_between_records_is_found_where_they_share_a_zero():
    records = [at(*ends, seed, offset=5e-8) for seed, ends in enumerate(((15, 16), (29, 31), (45, 44)))]
    thermal = dehyst.identify(records, **SETTINGS, shared_zero=True).actuator.thermal
    assert thermal.offset == pytest.approx(5e-8, rel=0.2)
    assert thermal.gain == pytest.approx(GAIN, rel=0.05)


def test_a_record_without_temperature_is_remarked(warm):
    remarks = dehyst.check(warm.actuator, at(38, 39, 7, known=False)).remarks
    assert sum("temperature" in remark for remark in remarks) == 1


def test_the_range_of_temperatures_is_known_to_the_model(warm):
    low, high = warm.actuator.identification.validity.temperatures
    assert (low, high) == (pytest.approx(15, abs=0.2), pytest.approx(45, abs=0.2))


def test_a_check_at_an_untested_temperature_says_so_and_has_a_wider_promise(warm):
    tested, hot = (dehyst.check(warm.actuator, at(first, first + 1, 7)) for first in (38, 60))
    assert hot.promise.parts["temperature"] > 0.03 * STROKE
    assert "temperature" not in tested.promise.parts
    assert not any("not tested" in remark for remark in tested.remarks)
    assert any("not tested" in remark for remark in hot.remarks)
