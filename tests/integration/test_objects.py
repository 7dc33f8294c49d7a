"""How results show themselves: one line each, tables, and summaries as the commands print them."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest

import dehyst
from dehyst import Actuator, MaxwellSlip, Spring
from dehyst.control import plan_path

HOSTILE = "<script>alert(\"1\")</script> & 'x' $\\frac{1}$\n\u202e"


@pytest.fixture(scope="module")
def plant():
    return plain_records.plant(6)


@pytest.fixture(scope="module")
def record(plant):
    return plain_records.loops(plant, plain_records.DESCENDING_TOPS, samples=30, noise=5e-9, name=HOSTILE)


@pytest.fixture(scope="module")
def fit(record):
    return dehyst.identify(record, structure="maxwell_slip")


@pytest.fixture(scope="module")
def insight(fit, record):
    path = np.linspace(2e-6, 12e-6, 20)
    return dehyst.insight(fit.actuator, record, plan=plan_path(dehyst.Compensator(fit.actuator), path))


@pytest.fixture(scope="module")
def things(record, fit, insight):
    actuator = fit.actuator
    motion = actuator.simulate([0.0, 20.0, 10.0])
    command = dehyst.plan_path(actuator, np.linspace(2e-6, 12e-6, 20), home=True)
    hostile = replace(actuator, name=HOSTILE)
    return {
        "record": record,
        "actuator": hostile,
        "fit": fit,
        "expectation": fit.promise,
        "errors": fit.errors[0],
        "trace": fit.traces[0],
        "insight": replace(insight, actuator=hostile),
        "motion": motion,
        "plan": command,
        "state": motion.state,
        "slip": actuator.slip,
        "spring": actuator.spring,
    }


def test_repr_and_print_are_one_printable_line_without_arrays(things):
    for thing in things.values():
        for text in (repr(thing), str(thing)):
            assert text.isprintable()
            assert "array" not in text
        assert repr(thing).startswith(f"<{type(thing).__name__}")
        assert 10 < len(repr(thing)) < 260


def test_an_actuator_whose_loops_cannot_be_computed_can_be_printed():
    actuator = Actuator(MaxwellSlip([1e-30], [1e30]), Spring([0, 1e30], [0, 1e30]))
    assert "1 slip element" in repr(actuator)


def test_a_mistyped_name_gets_a_suggestion(fit):
    with pytest.raises(dehyst.ModelError, match="you mean 'residuals'"):
        fit.plot("residual")
    with pytest.raises(AttributeError) as caught:
        _ = dehyst.identfy
    assert (caught.value.name, caught.value.obj) == ("identfy", dehyst)
