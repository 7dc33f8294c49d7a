"""Model files: an actuator comes back bit for bit, and nothing else than an actuator is taken for one."""

import copy
import json
import struct
from dataclasses import replace
from functools import reduce

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dehyst._errors import DehystError, FileFormatError, ModelError
from dehyst._io import read_json, write_json
from dehyst.identification import Outcome
from dehyst.model import (
    Actuator,
    Creep,
    Dynamics,
    GradedSlip,
    Identification,
    MaxwellSlip,
    SmoothSlip,
    Spring,
    State,
    Transformer,
)

# Wide enough for every exponent, narrow enough that no difference overflows.
numbers = st.floats(-1e300, 1e300)
texts = st.text(st.sampled_from('ab"\\\nµ\U0001f600'), max_size=5)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | numbers | texts,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=8,
)


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
    n, m = draw(st.integers(0, 6)), draw(st.integers(2, 6))
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
        identification=draw(st.none() | st.builds(Identification, texts, texts, goal=st.none() | st.floats(0, 1e30))),
    )


def bits(value):
    return struct.pack("<d", value)


def through_a_file(actuator, path):
    write_json(path, actuator.as_dict())
    return Actuator.from_dict(read_json(path))


@given(actuators())
def test_comes_back_exactly(tmp_path_factory, actuator):
    folder = tmp_path_factory.mktemp("model")
    back = through_a_file(actuator, folder / "a.json")
    for one, two in (
        (actuator.slip.breakaway, back.slip.breakaway),
        (actuator.slip.stiffness, back.slip.stiffness),
        (actuator.spring.displacement, back.spring.displacement),
        (actuator.spring.voltage, back.spring.voltage),
        (actuator.state.carts, back.state.carts),
    ):
        assert one.dtype == two.dtype
        assert one.tobytes() == two.tobytes()
    assert bits(actuator.state.deformation) == bits(back.state.deformation)
    assert bits(actuator.delay) == bits(back.delay)
    assert (actuator.limits is None) == (back.limits is None)
    assert actuator.limits is None or [*map(bits, actuator.limits)] == [*map(bits, back.limits)]
    assert actuator.name == back.name
    assert actuator.identification == back.identification
    assert repr(dict(actuator.provenance)) == repr(dict(back.provenance))
    write_json(folder / "b.json", back.as_dict())
    assert (folder / "a.json").read_bytes() == (folder / "b.json").read_bytes()


def made():
    return Actuator(
        MaxwellSlip([1e-7, 0.3e-6], [2e6, 1e6]),
        Spring([-1e-6, 0.0, 1.1e-5], [-9.0, 0.1, 95.0]),
        limits=(0.0, 100.0),
        delay=1 / 3000,
        name="stage X",
        provenance={"records": [{"file": "major.csv", "rms_percent": 0.1 + 0.2}], "note": "µm", "seed": None},
        identification=Identification("record", "l1", outcome=Outcome.WIDER, largest_error=1e-8 / 3, goal=0.5),
    )


def wide():
    plain = made()
    return Actuator(
        GradedSlip(plain.slip.breakaway, [0.0, 4e-6, 1e-5], [[2e6, 2.5e6], [1e6, 0.3]]),
        plain.spring,
        State(1e-6, [0.95e-6, 0.8e-6], [1e-8, 0.0, -2e-9], [1.1e-6, 0.1 / 3], [1 / 3e6, -2e-6]),
        transformer=Transformer([0.0, 50.0, 100.0], [0.0, 1 / 3 + 51, 100.0]),
        creep=Creep([0.1, 1.0, 100.0], [1e5, 1 / 3, 0.0]),
        smooth=SmoothSlip([1e-6, 2e-6], [1.0, 2 / 3], [1e6 / 3, 0.0]),
        dynamics=Dynamics(2000 / 3, 0.01, 1e5 / 3),
        lag=1e-3 / 3,
        load_stiffness=1e7 / 3,
    )


def test_wider_parts_come_back_exactly(tmp_path):
    actuator = wide()
    back = through_a_file(actuator, tmp_path / "a.json")
    for part, fields in (
        ("slip", ("breakaway", "knots", "stiffness")),
        ("transformer", ("voltage", "drive")),
        ("creep", ("time_constants", "stiffness")),
        ("smooth", ("length", "closing", "stiffness")),
        ("state", ("carts", "creep", "smooth", "motion")),
    ):
        for name in fields:
            one, two = (getattr(getattr(a, part), name) for a in (actuator, back))
            assert one.shape == two.shape
            assert one.tobytes() == two.tobytes()
    assert (actuator.dynamics, actuator.lag, actuator.load_stiffness) == (back.dynamics, back.lag, back.load_stiffness)
    write_json(tmp_path / "b.json", back.as_dict())
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


@pytest.mark.parametrize("limits", [None, (0.0, 100.0)])
@pytest.mark.parametrize("speed", [None, 100 / 3])
def test_the_speed_of_the_records_comes_back(tmp_path, limits, speed):
    plain = made()
    actuator = Actuator(plain.slip, plain.spring, limits=limits, recorded_slew_rate=speed)
    back = through_a_file(actuator, tmp_path / "a.json")
    assert (back.limits, back.recorded_slew_rate) == (limits, speed)
    assert ("recorded_slew_rate_V_per_s" in (back.as_dict()["limits"] or {})) == (speed is not None)
    for wrong in (0.0, -1.0, np.inf, "fast"):
        with pytest.raises(ModelError, match="recorded_slew_rate"):
            Actuator(plain.slip, plain.spring, recorded_slew_rate=wrong)


@pytest.mark.parametrize(
    ("where", "value", "message"),
    [
        ("slip.stiffness_V_per_m", [[1.0, 2.0]], "slip.stiffness_V_per_m: need a list of 2 lists of numbers"),
        ("slip.stiffness_V_per_m", [[1.0], [2.0]], r"got rows of \[1, 1\] numbers, need 2 in each"),
        ("slip.stiffness_V_per_m", [[1.0, 1.0], [2.0, -1.0]], "stiffness 1, 1 is -1 V/m"),
        ("slip.stiffness_V_per_m", [[1e9, 1.0], [2.0, 1.0]], "does not rise with the displacement on the rising"),
        ("slip.knots_m", [0.0, 0.0, 1.0], "grade knots must strictly increase"),
        ("transformer.drive_V", [0.0, 2.0, 1.0], "transformer drives must strictly increase"),
        ("transformer.drive_V", [0.0, 2.0], "got 3 transformer knots and 2 drives"),
        ("transformer", 1.0, r"model: transformer must be an object with keys \['drive_V', 'voltage_V'\], got float"),
        ("creep.stiffness_V_per_m", [1.0, -1.0, 1.0], "creep stiffness 1 is -1 V/m"),
        ("creep.time_constants_s", [0.0, 1.0, 2.0], "creep time constants must be positive"),
        ("creep.time_constants_s", [1.0], "got 1 creep time constants and 3 stiffnesses"),
        ("smooth.closing", [1.0, 0.4], "smooth elements: closing must be 1/2 to 1"),
        ("smooth.length_m", [1e-6], "smooth elements: got 1 of length, 2 of closing, 2 of stiffness"),
        ("smooth", [], r"model: smooth must be an object with keys \['closing', 'length_m', 'stiffness_V_per_m'\]"),
        ("state.smooth_m", [1e-9], "state: got 1 smooth elongations, this actuator has 2 smooth elements"),
        ("state.smooth_m", [2e-6, 0.0], "state: smooth element 0 is elongated by 2e-06 m, its length is 1e-06 m"),
        ("dynamics.damping", -1.0, "damping: got -1.0, need 0 or more"),
        ("dynamics.frequency_rad_per_s", "1", r"dynamics.frequency_rad_per_s: got '1', need a finite number"),
        ("dynamics", {"damping": 1.0}, r"dynamics: missing keys \['frequency_rad_per_s', 'series_V_per_m'\]"),
        ("lag_s", None, "lag_s: got None, need a finite number"),
        ("load_stiffness_N_per_m", 0.0, "load_stiffness: got 0.0, need a positive number"),
        ("state.motion", [1.0, 2.0], r"model: motion must be an object"),
        ("state.creep_m", [1.0], "state: got 1 creep strains, this actuator has 3 creep branches"),
    ],
)
def test_refuses_wider_parts(tmp_path, where, value, message):
    data = wide().as_dict()
    *parents, last = where.split(".")
    reduce(lambda part, key: part[key], parents, data)[last] = value
    refused(tmp_path, data, message)


@pytest.mark.parametrize(
    ("where", "value"),
    [
        ("slip.stiffness_V_per_m", [[1.0, 1e30], [1.0, 1.0]]),
        ("creep.stiffness_V_per_m", [1.0, 1e30, 1.0]),
        ("smooth.stiffness_V_per_m", [1.0, 1e21]),
        ("dynamics.series_V_per_m", 1e30),
        ("load_stiffness_N_per_m", 1e29),
        ("limits", {"voltage_V": [0.0, 100.0], "recorded_slew_rate_V_per_s": 1e12}),
        ("thermal", {"gain_per_K": 1e9, "offset_m_per_K": 0.0, "reference_degC": 20.0}),
        ("thermal", {"gain_per_K": 1e-3, "offset_m_per_K": -1.0, "reference_degC": 20.0}),
        ("thermal", {"gain_per_K": 1e-3, "offset_m_per_K": 0.0, "reference_degC": 3e5}),
    ],
)
def test_refuses_numbers_of_no_piezo_actuator(where, value):
    data = wide().as_dict()
    *parents, last = where.split(".")
    reduce(lambda part, key: part[key], parents, data)[last] = value
    with pytest.raises(ModelError) as caught:
        Actuator.from_dict(data)
    assert caught.value.argument.startswith(where) and caught.value.got and caught.value.need


def test_runs_the_same_afterwards(tmp_path):
    actuator = made()
    back = through_a_file(actuator, tmp_path / "a.json")
    wanted = 5e-6 * (1 - np.cos(np.linspace(0, 20, 500)) * np.linspace(1, 0, 500))
    one, two = actuator.compensate(wanted), back.compensate(wanted)
    assert one.voltage.tobytes() == two.voltage.tobytes()
    assert one.state.carts.tobytes() == two.state.carts.tobytes()
    assert actuator.simulate(one.voltage).displacement.tobytes() == back.simulate(one.voltage).displacement.tobytes()


def test_a_state_reached_comes_back(tmp_path):
    actuator = made()
    reached = actuator.simulate([0.0, 80.0, 20.0, 55.5]).state
    parked = Actuator(actuator.slip, actuator.spring, reached)
    back = through_a_file(parked, tmp_path / "a.json")
    assert bits(back.state.deformation) == bits(reached.deformation)
    assert back.state.carts.tobytes() == reached.carts.tobytes()


def test_keys_state_their_units(tmp_path):
    write_json(tmp_path / "a.json", made().as_dict())
    data = json.loads((tmp_path / "a.json").read_text(encoding="ascii"))
    assert list(data) == [
        "format",
        "version",
        "name",
        "slip",
        "spring",
        "transformer",
        "creep",
        "smooth",
        "displacement_creep",
        "thermal",
        "dynamics",
        "load_stiffness_N_per_m",
        "lag_s",
        "state",
        "limits",
        "delay_s",
        "identification",
        "provenance",
    ]
    assert list(data["slip"]) == ["breakaway_m", "stiffness_V_per_m"]
    assert list(data["spring"]) == ["displacement_m", "voltage_V"]
    assert list(data["state"]) == ["deformation_m", "carts_m", "creep_m", "smooth_m", "displacement_creep_m", "motion"]
    assert list(data["limits"]) == ["voltage_V"]


def refused(tmp_path, data, message, error=ModelError):
    """The data, written as they are, are refused with the message."""
    path = tmp_path / "a.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(error, match=message) as caught:
        Actuator.from_dict(read_json(path))
    assert isinstance(caught.value, DehystError)


def changed(where, value):
    """The dictionary of an actuator with the value at a dotted place."""
    data = copy.deepcopy(made().as_dict())
    *parents, last = where.split(".")
    reduce(lambda part, key: part[key], parents, data)[last] = value
    return data


PLACES = [
    f"{part}.{key}"
    for part, inner in made().as_dict().items()
    if part not in ("provenance", "name")
    for key in (inner if isinstance(inner, dict) else ())
]


@pytest.mark.parametrize("key", [key for key in made().as_dict() if key not in ("format", "version")])
def test_a_missing_key(tmp_path, key):
    data = made().as_dict()
    del data[key]
    refused(
        tmp_path,
        data,
        rf"model: missing keys \['{key}'\], unknown keys \[\]; need exactly \['creep', 'delay_s', 'displ",
    )


@pytest.mark.parametrize("place", PLACES)
def test_a_missing_key_inside(tmp_path, place):
    part, key = place.split(".")
    data = made().as_dict()
    del data[part][key]
    refused(tmp_path, data, rf"{part}: missing keys \['{key}'\], unknown keys \[\]; need exactly")


@pytest.mark.parametrize("part", ["slip", "spring", "state", "limits", "identification"])
def test_an_unknown_key_inside(tmp_path, part):
    refused(
        tmp_path, changed(f"{part}.extra", 1), rf"{part}: missing keys \[\], unknown keys \['extra'\]; need exactly"
    )


def test_an_unknown_key(tmp_path):
    refused(tmp_path, changed("extra", 1), r"model: missing keys \[\], unknown keys \['extra'\]; need exactly")


def test_a_misspelt_key_is_named_twice(tmp_path):
    data = made().as_dict()
    data["delay"] = data.pop("delay_s")
    refused(tmp_path, data, r"model: missing keys \['delay_s'\], unknown keys \['delay'\]")


@pytest.mark.parametrize("name", ["dehyst-fit", "", None, 1])
def test_another_format(tmp_path, name):
    refused(tmp_path, changed("format", name), r"got format .* version 1, need 'dehyst-actuator' version 1")


@pytest.mark.parametrize("key", ["format", "version"])
def test_a_missing_format_or_version(tmp_path, key):
    data = made().as_dict()
    del data[key]
    refused(tmp_path, data, rf"got .*{key} None.*, need 'dehyst-actuator' version 1")


@pytest.mark.parametrize("place", [*PLACES, "delay_s"])
@pytest.mark.parametrize(("value", "word"), [(float("nan"), "NaN"), (float("inf"), "Infinity")])
def test_not_finite_in_text(tmp_path, place, value, word):
    refused(tmp_path, changed(place, [value, 1.0]), rf"a\.json: holds {word}, but every number", FileFormatError)


@pytest.mark.parametrize(
    ("where", "value", "message"),
    [
        ("slip.stiffness_V_per_m", [1.0], "got 2 breakaway elongations and 1 stiffnesses, need one of each"),
        ("slip.breakaway_m", [1e-7], "got 1 breakaway elongations and 2 stiffnesses, need one of each"),
        ("spring.voltage_V", [0.0, 1.0], "got 3 spring knots and 2 voltages, need the same number, at least two"),
        ("spring.displacement_m", [0.0], "got 1 spring knots and 3 voltages"),
        ("state.carts_m", [0.0], "state: got 1 carts, this actuator has 2 elements"),
        ("slip.stiffness_V_per_m", [2e6, -1e-9], "stiffness 1 is -1e-09 V/m; a negative one grows without bound"),
        ("slip.breakaway_m", [0.0, 1e-6], "breakaway elongations must be positive and strictly increasing"),
        ("slip.breakaway_m", [1e-6, 1e-6], "breakaway elongations must be positive and strictly increasing"),
        ("slip.breakaway_m", [[1e-7], [1e-6]], r"slip.breakaway_m\[0\]: got \[1e-07\], need a finite number"),
        ("slip.breakaway_m", ["1e-7", "1e-6"], r"slip.breakaway_m\[0\]: got '1e-7', need a finite number"),
        ("slip.stiffness_V_per_m", [True, False], r"slip.stiffness_V_per_m\[0\]: got True, need a finite number"),
        ("slip.stiffness_V_per_m", 3.0, "slip.stiffness_V_per_m: got float, need a list of numbers"),
        ("spring.voltage_V", [0.0, 2.0, 1.0], r"must strictly increase \(Assumption I\); .* between knots 1 and 2"),
        ("spring.voltage_V", [0.0, 0.0, 1.0], r"must strictly increase \(Assumption I\); .* between knots 0 and 1"),
        ("spring.displacement_m", [0.0, 2e-6, 1e-6], "spring knots must strictly increase"),
        ("state.carts_m", [1.1e-5, 1.2e-5], r"state: cart 1 is 7e-07 m farther .* breakaway elongation 3e-07 m"),
        ("state.deformation_m", 2e-5, r"state: cart \d is .* m farther from the displacement than its breakaway"),
        ("state.deformation_m", "0", r"state\.deformation_m: got '0', need a finite number"),
        ("state.deformation_m", True, r"state\.deformation_m: got True, need a finite number"),
        ("state.deformation_m", None, r"state\.deformation_m: got None, need a finite number"),
        ("limits.voltage_V", [100.0, 0.0], r"limits: got \(100\.0, 0\.0\), need two finite voltages, the lower one"),
        ("limits.voltage_V", [5.0, 5.0], r"limits: got \(5\.0, 5\.0\), need two finite voltages"),
        ("limits.voltage_V", [1.0], r"limits\.voltage_V: got \[1\.0\], need two numbers"),
        ("limits.voltage_V", [0.0, 1.0, 2.0], r"limits\.voltage_V: got \[0\.0, 1\.0, 2\.0\], need two numbers"),
        ("limits.voltage_V", ["0", "1"], r"limits\.voltage_V: got '0', need a finite number"),
        ("limits.voltage_V", 5, r"limits\.voltage_V: got 5, need two numbers"),
        ("limits", [0.0, 100.0], r"model: limits must be an object with keys \['voltage_V'\], got list"),
        ("slip", [], "model: slip must be an object with keys .*, got list"),
        ("spring", None, "model: spring must be an object with keys .*, got NoneType"),
        ("state", 0.0, "model: state must be an object with keys .*, got float"),
        ("delay_s", None, "delay_s: got None, need a finite number"),
        ("delay_s", "1", "delay_s: got '1', need a finite number"),
        ("identification", [], "model: identification must be an object with keys .*, got list"),
        ("identification.goal_percent", -1.0, "goal: got -1.0, need a finite number of 0 or more"),
        ("identification.drift", 1, "drift: got 1, need true or false"),
        ("identification.norm", None, "norm: got None, need text"),
        ("identification.outcome", "FINE", "outcome: got 'FINE', need one of IDENTIFIED, .*, or null"),
        ("name", 7, "model: name must be text and provenance an object"),
        ("provenance", [], "model: name must be text and provenance an object"),
    ],
)
def test_refuses(tmp_path, where, value, message):
    refused(tmp_path, changed(where, value), message)


@pytest.mark.parametrize("data", [[], [{}], "model", 1, None])
def test_something_else_than_an_object(tmp_path, data):
    refused(tmp_path, data, r"a\.json: holds a JSON .*, but an object", FileFormatError)


def test_a_key_that_is_there_twice(tmp_path):
    write_json(tmp_path / "a.json", made().as_dict())
    text = (tmp_path / "a.json").read_text()
    (tmp_path / "a.json").write_text(text.replace(' "delay_s"', ' "delay_s": 0.0,\n "delay_s"'))
    with pytest.raises(FileFormatError, match="the key 'delay_s'"):
        read_json(tmp_path / "a.json")


def test_every_truncated_file(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, made().as_dict())
    whole = path.read_bytes().rstrip()
    for length in range(len(whole)):
        path.write_bytes(whole[:length])
        with pytest.raises(FileFormatError, match=r"a\.json: line \d+, column \d+: no valid JSON .* cut off"):
            read_json(path)


def test_provenance_that_is_no_json_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, made().as_dict())
    before = path.read_bytes()
    with pytest.raises(FileFormatError, match="written as JSON"):
        write_json(path, replace(made(), provenance={"gap": float("nan")}).as_dict())
    assert path.read_bytes() == before
