"""What records tell of wider models."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import plain_records
import pytest
import structured_records

from dehyst import ModelError, Record, identify
from dehyst.identification import Structure
from dehyst.report.html import document
from dehyst.report.report import render
from dehyst.report.trust_section import sections
from dehyst.trust import insight

STRUCTURES = {
    "graded, transformer": Structure(elements=6, grades=3, knots=7, transformer=5),
    "creep": Structure(elements=8, knots=7, creep=3),
    "smooth": Structure(elements=8, knots=7, smooth=True),
}
NOISE = 5e-9


@cache
def truth(name):
    """An actuator of the class whose neighbours are as alike as its structure holds them: one identified itself."""
    plant = structured_records.plant(STRUCTURES[name], seed=100)
    made = identify(plant.record(), structure=STRUCTURES[name], delay=0.0).actuator
    # As a record is taken to begin: smooth elements at none.
    smooth = np.zeros(0 if made.smooth is None else len(made.smooth))
    state = replace(made.turned(float(plant.path[0])), creep=plant.state.creep, smooth=smooth)
    return replace(plant, actuator=replace(made, limits=None), state=state)


def fitted(name, seed=0, noise=NOISE, norm="l1"):
    record = truth(name).record(noise=noise, seed=seed)
    return identify(record, structure=STRUCTURES[name], delay=0.0, norm=norm), record


@cache
def looked(name):
    fit, record = fitted(name)
    path, time = trajectory()
    return insight(fit.actuator, record, trajectory=path, time=time), fit, record


def trajectory():
    path = plain_records.path([1, 0, 1, 0.3, 0.8, 0.1, 0.5, 0.2, 0.9, 0.4, 0.7, 0.2, 0.6, 0.05, 0.5], 40)
    return path, np.arange(path.size) / structured_records.RATE


def test_a_lone_loop_is_something_to_beware_of():
    plant = truth("graded, transformer")
    short = structured_records.wandering(legs=0, samples=200)
    lone, whole = replace(plant, path=short).record(noise=NOISE), plant.record(noise=NOISE)
    model = replace(plant.actuator, limits=(0.0, plain_records.VOLTS))
    found = insight(model, lone)
    # As the table of identifiability has it: a major loop tells five of ten directions, the last is never told.
    assert (found.identifiability.determined, found.identifiability.of) == (5, 9)
    assert not found.trustworthy
    assert "4 of 9 directions" in found.warnings()[0]
    assert f"Add {found.advice[0].words}" in found.warnings()[0]
    assert found.advice[0].determined == 9
    assert insight(model, whole).trustworthy


@pytest.mark.parametrize("name", STRUCTURES)
def test_a_look_at_a_wider_model(name):
    found, fit, _ = looked(name)
    told_ = json.loads(json.dumps(found.as_dict()))
    assert told_["homing"]["certified"] == found.homing.certified
    assert set(found.band.errors()) == {"misfit", "clamped"}
    assert found.knowledge[0].by_displacement is not None
    assert found.knowledge[0].judged == (name == "graded, transformer")
    text = document("", sections(found, found.turns))
    for words in (
        "What the turning points determine",
        "The promise along the path",
        "Where the records turned",
        "When the state becomes known",
    ):
        assert words in text
    assert "records determine" in render(fit, insight=found)


def test_the_state_is_known_from_the_voltage_as_from_two_simulations():
    found, fit, record = looked("graded, transformer")
    when = found.knowledge[0].by_voltage
    first = round(when / record.sample_time) + 1
    ends = [fit.actuator.turned(y, rising=up, extrapolate=True) for y, up in ((1e-3, False), (-1e-3, True))]
    reached = [
        fit.actuator.simulate(record.voltage[:first], state=one, extrapolate=True).displacement[-1] for one in ends
    ]
    assert abs(reached[1] - reached[0]) < 1e-9 * plain_records.STROKE


def test_another_actuators_record_is_told():
    _, fit, record = looked("creep")
    other = Record(record.time, record.voltage, 0.8 * record.displacement, "other")
    found = insight(fit.actuator, other)
    assert "another actuator" in found.warnings()[0]


def test_limits_beyond_the_records_are_told():
    _, fit, record = looked("creep")
    low, high = fit.actuator.limits
    found = insight(fit.actuator, record, limits=(low, high + 40))
    assert "extrapolated" in found.warnings()[0]


def test_a_creeping_model_asks_for_the_time_of_a_trajectory():
    _, fit, record = looked("creep")
    with pytest.raises(ModelError, match="answer depends") as refused:
        insight(fit.actuator, record, trajectory=trajectory()[0])
    assert "time" in refused.value.change
