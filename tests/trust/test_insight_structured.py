"""What records tell of wider models."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import plain_records
import pytest
import structured_records

from dehyst import Record, Structure, identify
from dehyst.control import Compensator, plan_path
from dehyst.model import turned, with_identification
from dehyst.report import write_report
from dehyst.report.pages import render
from dehyst.trust import insight

STRUCTURES = {
    "graded, transformer": Structure(elements=6, grades=3, knots=7, transformer=5),
    "plain": Structure(elements=8, knots=7),
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
    state = replace(turned(made, float(plant.path[0])), smooth=smooth)
    return replace(plant, actuator=replace(made, limits=None), state=state)


def fitted(name):
    record = truth(name).record(noise=NOISE)
    return identify(record, structure=STRUCTURES[name], delay=0.0), record


@cache
def looked(name):
    fit, record = fitted(name)
    path, time = trajectory()
    return insight(fit.actuator, record, plan=plan_path(Compensator(fit.actuator), path, time=time)), fit, record


def trajectory():
    path = plain_records.path([1, 0, 1, 0.3, 0.8, 0.1, 0.5, 0.2, 0.9, 0.4, 0.7, 0.2, 0.6, 0.05, 0.5], 40)
    return path, np.arange(path.size) / structured_records.RATE


def test_a_single_loop_has_a_warning():
    plant = truth("graded, transformer")
    short = structured_records.wandering(branches=0, samples=200)
    lone, whole = replace(plant, path=short).record(noise=NOISE), plant.record(noise=NOISE)
    model = with_identification(replace(plant.actuator, limits=(0.0, plain_records.VOLTS)), validity=None)
    found = insight(model, lone)
    # As the table of identifiability has it: a major loop tells five of ten directions, the last is never told.
    assert (found.identifiability.determined, found.identifiability.of) == (5, 9)
    assert "4 of 9 directions" in found.warnings()[0]
    assert model.promise() is None and len(found.record_next) == 1
    found = insight(model, whole).identifiability
    assert found.determined == found.of


@pytest.mark.parametrize("name", STRUCTURES)
def test_insight_works_for_every_structure(name, tmp_path):
    found, fit, _ = looked(name)
    told_ = json.loads(json.dumps(found.as_dict()))
    assert told_["promise"] == found.plan.promise.as_dict()
    assert found.promise.largest == pytest.approx(sum(found.promise.parts.values()))
    write_report(tmp_path / "page.html", found)
    text = (tmp_path / "page.html").read_text()
    for words in ("What the turning points determine", "The promise along the path", "Where the records turned"):
        assert words in text
    assert "records determine" in render(fit, insight=found)


@pytest.mark.parametrize(("gain", "told"), [(1.0, False), (0.8, True), (0.2, True)])
def test_records_of_another_model_have_a_warning(gain, told):
    _, fit, record = looked("plain")
    found = insight(fit.actuator, Record(record.time, record.voltage, gain * record.displacement, "other"))
    assert (bool(found._of_others()), found.warnings() == (found._of_others(),)) == (told, told)
    assert not (told and (found.record_next or found.few_samples))
    assert (next(iter(found.summary().split("\n"))) == found.promise.sentence) == (not told)
