"""Model files: an actuator comes back bit for bit, and nothing else than an actuator is taken for one."""

import copy
import pickle
from dataclasses import replace
from functools import reduce

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from summaries import anatomy

from dehyst import Compensator
from dehyst._errors import ModelError
from dehyst._io import read_json, write_json
from dehyst.model import (
    Actuator,
    Identification,
    MaxwellSlip,
    Outcome,
    Spring,
    Stage,
    State,
    Thermal,
    with_identification,
)
from dehyst.model.promise import Validity

# Wide enough for every exponent, narrow enough that no difference overflows.
numbers = st.floats(-1e300, 1e300)
texts = st.text(st.sampled_from('ab"\\\nµ\U0001f600'), max_size=5)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | numbers | texts,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=8,
)

rates = st.none() | st.floats(1e-30, 1e11)


@st.composite
def rising(draw, elements, size):
    return np.array(sorted(draw(st.lists(elements, min_size=size, max_size=size, unique=True))))


@st.composite
def climbing(draw, size):
    """Values whose steps are neither lost nor too steep for a slope."""
    start, steps = draw(st.floats(-1, 1)), st.floats(1e-6, 1e6)
    return np.cumsum([start, *draw(st.lists(steps, min_size=size - 1, max_size=size - 1))])


@st.composite
def actuators(draw):
    n, m, lags = draw(st.integers(0, 6)), draw(st.integers(2, 6)), st.sampled_from(["", "actuator", "sensor"])
    rho = draw(rising(st.floats(0, 1e30, exclude_min=True), n))
    kappa = draw(st.lists(st.floats(0, 1e20), min_size=n, max_size=n))
    y = draw(numbers)
    strained = draw(st.lists(st.floats(-1, 1), min_size=n, max_size=n))
    return Actuator(
        MaxwellSlip(rho, kappa),
        Spring(draw(climbing(m)), draw(climbing(m))),
        draw(st.sampled_from([None, State(y, y - rho * strained)])),
        limits=draw(st.none() | rising(numbers, 2).map(tuple)),
        delay=draw(st.floats(0, 1e30)),
        name=draw(texts),
        provenance=draw(st.dictionaries(texts, json_values, max_size=4)),
        identification=draw(st.none() | st.builds(Identification, lags, goal=rates, slew_rate=rates)),
    )


def through_a_file(actuator, path):
    """The model that comes back from a file, which is written again with the same bytes: JSON keeps each bit."""
    write_json(path, actuator.as_dict())
    back, written = Actuator.from_dict(read_json(path)), path.read_bytes()
    write_json(path, back.as_dict())
    assert path.read_bytes() == written
    return back


@given(actuators())
def test_a_file_restores_every_bit(tmp_path_factory, actuator):
    back = through_a_file(actuator, tmp_path_factory.mktemp("model") / "a.json")
    assert back == actuator and back.identification == actuator.identification
    assert back.slip.breakaway.tobytes() == actuator.slip.breakaway.tobytes()
    assert repr(dict(actuator.provenance)) == repr(dict(back.provenance))


TESTED = Validity(1e-9, 3e-9, 1e-9 / 3, 1e-5, (0.0, 100.0), [[0.0, 100.0]], lag_open=True, temperatures=(20, 25))


def made():
    return Actuator(
        MaxwellSlip([1e-7, 0.3e-6], [2e6, 1e6]),
        Spring([-1e-6, 0.0, 1.1e-5], [-9.0, 0.1, 95.0]),
        limits=(0.0, 100.0),
        delay=1 / 3000,
        name="stage X",
        provenance={"records": [{"file": "major.csv", "rms_percent": 0.1 + 0.2}], "note": "µm", "seed": None},
        identification=Identification("sensor", outcome=Outcome.IDENTIFIED, goal=0.5, validity=TESTED),
    )


def wide():
    more = {"limits": made().limits, "identification": made().identification}
    return replace(anatomy("all"), thermal=Thermal(1e-3, 2e-9, 25.0), **more)


@given(actuators())
def test_models_of_equal_numbers_are_equal(actuator):
    assert pickle.loads(pickle.dumps(actuator)) == actuator == copy.deepcopy(actuator)
    assert hash(copy.deepcopy(actuator)) == hash(actuator)
    assert actuator != replace(actuator, delay=0.5 * actuator.delay + 0.25) and actuator != "actuator"


def objects(data, place=()):
    """The places of all objects of a model file, but for what anybody may write there."""
    yield place
    for key, value in data.items():
        if isinstance(value, dict) and key != "provenance":
            yield from objects(value, (*place, key))


def within(data, place):
    return reduce(lambda part, key: part[key], place, data)


@pytest.mark.parametrize("make", [made, wide])
def test_a_missing_or_unknown_key_is_refused(make):
    for place in objects(make().as_dict()):
        for key in [*within(make().as_dict(), place), "extra"]:
            data = copy.deepcopy(make().as_dict())
            if key == "extra":
                within(data, place)[key] = 1
            else:
                del within(data, place)[key]
            with pytest.raises(ModelError):
                Actuator.from_dict(data)


@pytest.mark.parametrize("wide", [(0.0, 1000.0), (-50.0, 100.0), (0.0, 102.1), (200.0, 300.0)])
def test_limits_wider_than_the_records_are_refused(tmp_path, wide):
    tested = Validity(1e-8, 1e-7, 0.0, 1.1e-5, limits=(0.0, 100.0))
    actuator = with_identification(made(), validity=tested)
    for near in ((0.0, 100.0), (20.0, 30.0), (-2.0, 102.0)):
        assert through_a_file(replace(actuator, limits=near), tmp_path / "a.json").limits == near
    for make in (
        lambda: Actuator.from_dict(actuator.as_dict() | {"limits_V": list(wide)}),
        lambda: Stage.from_dict(
            Stage([actuator]).as_dict() | {"actuators": [actuator.as_dict() | {"limits_V": [*wide]}]}
        ),
        lambda: replace(actuator, limits=wide),
        lambda: with_identification(replace(made(), limits=wide), validity=tested),
    ):
        with pytest.raises(ModelError) as caught:
            make()
        assert caught.value.argument == "limits" and caught.value.got and caught.value.need and caught.value.hint
    # Whoever plans a voltage states wider limits.
    assert Compensator(actuator, wide).limits == wide
