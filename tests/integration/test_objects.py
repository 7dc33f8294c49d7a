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
def things():
    turns, path = plain_records.DESCENDING_TOPS, np.linspace(2e-6, 12e-6, 20)
    record = plain_records.loops(plain_records.plant(6), turns, samples=30, noise=5e-9, name=HOSTILE)
    fit = dehyst.identify(record, structure="maxwell_slip")
    actuator = fit.actuator
    motion, command = actuator.simulate([0.0, 20.0, 10.0]), plan_path(actuator, path, home=True)
    insight = dehyst.insight(actuator, record, plan=plan_path(actuator, path))
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


def test_a_mistyped_name_gets_a_suggestion(things):
    with pytest.raises(dehyst.ModelError, match="you mean 'residuals'"):
        things["fit"].plot("residual")
    with pytest.raises(AttributeError) as caught:
        _ = dehyst.identfy
    assert (caught.value.name, caught.value.obj) == ("identfy", dehyst)
