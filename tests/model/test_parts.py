"""The laws of every part: its numbers are kept, come back from a file, and are refused where they are impossible."""

import copy
from dataclasses import fields, replace

import numpy as np
import pytest

from dehyst import Actuator, Compensator, DisplacementCreep, Dynamics, MaxwellSlip, ModelError, Spring, State, Thermal
from dehyst._native import CoreState
from dehyst._validation import FARTHEST, MOST
from dehyst.model import GradedSlip, Identification, Physical, SmoothSlip, Transformer, evaluator_of, turned

pytestmark = pytest.mark.filterwarnings("ignore::dehyst.ClampWarning")

SLIP, SPRING = MaxwellSlip([1e-6, 2e-6], [1e6, 2e6]), Spring([0, 4e-6, 1e-5], [0, 30, 100])
PARTS = {
    "slip": SLIP,
    "graded": GradedSlip([1e-6, 2e-6], [0, 5e-6, 1e-5], [[1e6, 2e6], [2e6, 3e6]]),
    "spring": SPRING,
    "transformer": Transformer([0, 50, 100], [0, 60, 100]),
    "smooth": SmoothSlip([1e-6, 3e-6], [1, 0.7], [4e6, 2e6]),
    "displacement_creep": DisplacementCreep([0.1, 1.0], [0.1, 0.2]),
    "thermal": Thermal(1e-3, 2e-9, 25.0),
    "dynamics": Dynamics(1000, 0.1, 3e6),
}
FIELD = {"graded": "slip"}
OPTIONAL = ("transformer", "smooth", "displacement_creep", "thermal", "dynamics")
# Each entry, its key in a file, what its numbers must be, and the largest magnitude in a file.
ENTRIES = {
    "slip.breakaway": ("breakaway_m", "positive rising", np.inf),
    "slip.stiffness": ("stiffness_V_per_m", "not_negative", 1e20),
    "graded.breakaway": ("breakaway_m", "positive rising", np.inf),
    "graded.knots": ("knots_m", "rising steps", np.inf),
    "graded.stiffness": ("stiffness_V_per_m", "not_negative", 1e20),
    "spring.displacement": ("displacement_m", "rising steps", np.inf),
    "spring.voltage": ("voltage_V", "rising steps", np.inf),
    "transformer.voltage": ("voltage_V", "rising steps", np.inf),
    "transformer.drive": ("drive_V", "rising steps", np.inf),
    "smooth.length": ("length_m", "positive divides", np.inf),
    "smooth.closing": ("closing", "half_to_one", np.inf),
    "smooth.stiffness": ("stiffness_V_per_m", "not_negative", 1e20),
    "displacement_creep.time_constants": ("time_constants_s", "positive divides", np.inf),
    "displacement_creep.gains": ("gains", "not_negative", np.inf),
    "thermal.gain": ("gain_per_K", "", 1.0),
    "thermal.offset": ("offset_m_per_K", "", 1e-3),
    "thermal.reference": ("reference_degC", "", 1e3),
    "dynamics.frequency": ("frequency_Hz", "positive divides", np.inf),
    "dynamics.damping": ("damping", "not_negative", np.inf),
    "dynamics.series": ("series_V_per_m", "not_negative", 1e20),
    "actuator.delay": ("delay_s", "not_negative", np.inf),
    "actuator.lag": ("lag_s", "not_negative divides", np.inf),
    "actuator.load_stiffness": ("load_stiffness_N_per_m", "positive divides", 1e15),
    "identification.sensor_lag": ("sensor_lag_s", "not_negative", np.inf),
    "identification.largest_error": ("largest_error_m", "not_negative", np.inf),
    "identification.goal": ("goal_percent", "not_negative", np.inf),
    "identification.slew_rate": ("slew_rate_V_per_s", "positive", 1e11),
}
# Values that break a law when they replace one number.
TINY = (5e-324, 1e-200, 0.99e-30)
BROKEN = {"positive": (0.0, -1.0), "not_negative": (-1e-9,), "half_to_one": (0.499, 1.001), "divides": TINY}
NEVER = (np.nan, np.inf, -np.inf, 1.7e308, -1.7e308, 1.01e30)


def actuator_with(part):
    """An actuator that has a part, by name."""
    if part in ("actuator", "identification"):
        return Actuator(SLIP, SPRING, lag=1e-3, load_stiffness=1e7, identification=Identification(slew_rate=1.0))
    return replace(Actuator(SLIP, SPRING), **{FIELD.get(part, part): PARTS[part]})


def owner_of(part):
    owners = {"actuator": actuator_with("actuator"), "identification": actuator_with("actuator").identification}
    return owners.get(part) or PARTS[part]


def impossible(value, laws):
    """Values in the place of an entry that break its laws."""
    bad = [part for law in laws for part in BROKEN.get(law, ())] + [*NEVER]
    if not isinstance(value, np.ndarray):
        yield from (*bad, "1", [1.0], {}, True)
        return
    for number in bad:
        for place in (0, -1):
            spoilt = value.copy()
            spoilt.flat[place] = number
            yield spoilt
    yield from (value[:-1], np.append(value, value[-1:], axis=0), value[None], "ab", value.astype(str), 1.0, None)
    if "rising" in laws:
        yield from (value[::-1], np.full_like(value, value[-1]))
    if "steps" in laws:
        yield from (np.concatenate([[0.0, step], 1.0 + np.arange(value.size - 2)]) for step in TINY)


@pytest.mark.parametrize("name", ENTRIES)
def test_impossible_numbers_are_refused_from_python_and_from_a_file(name):
    part, entry = name.split(".")
    key, laws, _ = ENTRIES[name]
    owner, whole = owner_of(part), actuator_with(part).as_dict()
    field = None if part == "actuator" else FIELD.get(part, part)
    for bad in impossible(getattr(owner, entry), laws.split()):
        with pytest.raises(ModelError) as caught:
            replace(owner, **{entry: bad})
        assert entry in str(caught.value) or FIELD.get(part, part) in str(caught.value)
        data = copy.deepcopy(whole)
        (data if field is None else data[field])[key] = bad.tolist() if isinstance(bad, np.ndarray) else bad
        with pytest.raises(ModelError):
            Actuator.from_dict(data)


@pytest.mark.parametrize("name", [name for name, (_, _, most) in ENTRIES.items() if most < np.inf])
def test_implausible_numbers_in_a_file_are_refused(name):
    part, entry = name.split(".")
    key, laws, most = ENTRIES[name]
    value = getattr(owner_of(part), entry)
    field = None if part == "actuator" else FIELD.get(part, part)
    for size in (1.01 * most, *(() if laws else (-1.01 * most,))):
        data = copy.deepcopy(actuator_with(part).as_dict())
        array = np.where(np.arange(value.size).reshape(value.shape), value, size) if np.ndim(value) else None
        (data if field is None else data[field])[key] = size if array is None else array.tolist()
        with pytest.raises(ModelError) as caught:
            Actuator.from_dict(data)
        assert caught.value.argument == f"{field}.{key}".removeprefix("None.")
        assert caught.value.got and caught.value.need


@pytest.mark.parametrize("part", PARTS)
def test_a_part_copies_the_given_arrays(part):
    for field in fields(PARTS[part]):
        kept = getattr(PARTS[part], field.name)
        given = np.array(kept)
        if not given.ndim:
            continue
        made = getattr(replace(PARTS[part], **{field.name: given}), field.name)
        given[...] = -1
        np.testing.assert_array_equal(made, kept)
        with pytest.raises(ValueError, match="read-only"):
            made[...] = 0


@pytest.mark.parametrize("part", PARTS)
def test_a_part_is_restored_from_a_file_and_other_objects_are_refused(part):
    field, actuator = FIELD.get(part, part), actuator_with(part)
    back = getattr(Actuator.from_dict(actuator.as_dict()), field)
    assert type(back) is type(PARTS[part]) and back.as_dict() == PARTS[part].as_dict()
    for other in (3, "part", State(0.0, []), *(part for name, part in PARTS.items() if FIELD.get(name, name) != field)):
        with pytest.raises(ModelError):
            replace(actuator, **{field: other})
    data = actuator.as_dict() | {field: None}
    if part in OPTIONAL:
        assert getattr(Actuator.from_dict(data), field) is None
    else:
        with pytest.raises(ModelError):
            Actuator.from_dict(data)


TIME = {"time": [0.0, 1.0]}
CONSTANTS = {"transformer_ratio": 0.042, "mechanical_stiffness": 1.4e6, "electrical_stiffness": 8.82e4}


@pytest.mark.parametrize("run", ["simulate", "compensate"])
@pytest.mark.parametrize(
    ("part", "given"),
    [
        ("displacement_creep", {**TIME, "temperature": 30.0}),
        ("dynamics", {**TIME, "load": [1.0, 1.0]}),
        ("thermal", {"temperature": [20.0, 21.0, 22.0]}),
        ("thermal", {"temperature": "warm"}),
        ("slip", {"load": [1.0, 1.0]}),
        ("slip", {"state": State(0.0, [0.0])}),
        ("slip", {"state": State(0.0, [0.0, 3e-6])}),
        ("slip", {"state": State(0.0, [0.0, 0.0], displacement_creep=[1e-9])}),
        ("slip", {"state": State(0.0, [0.0, 0.0], smooth=[0.0])}),
        ("slip", {"state": State(0.0, [0.0, 0.0], motion=[0.0, 0.0])}),
        ("slip", {"state": "top"}),
        ("smooth", {"state": State(0.0, [0.0, 0.0], smooth=[1e-6])}),
        ("smooth", {"state": State(0.0, [0.0, 0.0], smooth=[0.0, -3.1e-6])}),
        ("actuator", {**TIME, "load": [1.0]}),
        ("actuator", {**TIME, "load": [1.0, np.nan]}),
    ],
)
def test_arguments_that_do_not_fit_the_parts_are_refused(run, part, given):
    actuator = actuator_with(part)
    with pytest.raises(ModelError):
        getattr(actuator, run)([0.0, 1e-6], **given)
    if "state" in given:
        with pytest.raises(ModelError):
            replace(actuator, state=given["state"])


UNIFORM = MaxwellSlip([3e-7, 6e-7, 9e-7], [1.7e6, 2.9e6, 3.2e6])
NARROW = Spring([-1e-6, 0.0, 4e-7, 6e-7], [-10.0, -4.3, -1.9, 0.3])
PLAIN = Actuator(UNIFORM, NARROW, limits=(-10.0, 0.3))
CREEPING = replace(PLAIN, displacement_creep=DisplacementCreep([1.0], [0.01]))
LOADED = replace(PLAIN, load_stiffness=1e-20)
FAR = replace(PLAIN.relaxed(), deformation=1e305, carts=PLAIN.relaxed().carts + 1e305)


def swinging(damping):
    return replace(PLAIN, dynamics=Dynamics(1.6e3, damping))


def at_rest(motion):
    core = evaluator_of(actuator_with("smooth")).core
    return core.voltage(CoreState(0.0, np.zeros(2), motion, np.zeros(0)))


def loop(part="displacement_creep"):
    return Compensator(actuator_with(part), (0, 100), period=1e-3)


@pytest.mark.parametrize(
    "call",
    [
        # Other shapes and types.
        lambda: Spring([0], [0]),
        lambda: Transformer([0], [0]),
        lambda: GradedSlip([1, 2], [0], [[], []]),
        lambda: GradedSlip([1, 2], [0, 1], [[1], [1], [1]]),
        lambda: State("far", [0]),
        lambda: State(np.nan, [0]),
        lambda: State(0, [np.nan]),
        lambda: State(0, [[0]]),
        lambda: State(0, [0], motion=[1]),
        lambda: Actuator(MaxwellSlip([1e200], [1e200]), SPRING),
        lambda: Actuator(SLIP, SPRING, State(0, [0])),
        *(lambda limits=limits: Actuator(SLIP, SPRING, limits=limits) for limits in ((5, 5), ("a", "b"), (1,), 3)),
        *(lambda place=place: turned(Actuator(SLIP, SPRING), place) for place in ("far", np.nan)),
        lambda: Actuator(SLIP, SPRING).relaxed("off"),
        lambda: actuator_with("dynamics").compensate([0.0, 1e-6], **TIME, velocity=[1.0]),
        lambda: actuator_with("dynamics").compensate([0.0, 1e-6], **TIME, acceleration=[1.0]),
        *(lambda part=part: Physical.of(actuator_with(part), **CONSTANTS) for part in ("graded", "transformer")),
        lambda: Physical.of(actuator_with("slip"), **CONSTANTS | {"transformer_ratio": 0}),
        # The motion of an actuator without a mass.
        *(lambda motion=motion: at_rest(np.array(motion)) for motion in ([0.0], [1.0, 1.0])),
        *(lambda scale=scale: loop().scale(*scale) for scale in ((0.0,), (-1.0,), (np.nan,), (1.0, np.nan))),
        lambda: loop().step(5e-6, 30.0),
        *(lambda degrees=degrees: loop("thermal").step(5e-6, degrees) for degrees in (-300.0, "warm")),
        # Numbers out of range.
        lambda: Actuator(UNIFORM, NARROW, limits=(-1e308, 1e308)),
        lambda: CREEPING.simulate([0.0, -1.0], time=[-1.7e308, 1.7e308]),
        lambda: swinging(0.1).simulate([0.0, -1.0], time=[0.0, 1e20]),
        lambda: swinging(1e25).simulate([0.0, -1.0], time=[0.0, 1e-3]),
        lambda: LOADED.simulate([0.0, -1.0], load=[0.0, 1e300]),
        lambda: PLAIN.simulate([0.0, 1e281, 0.0], extrapolate=True),
        lambda: PLAIN.compensate([0.0, 1e305], extrapolate=True),
        lambda: PLAIN.voltage(FAR),
        lambda: Compensator(PLAIN, state=FAR),
    ],
)
def test_impossible_arguments_are_refused(call):
    with pytest.raises(ModelError):
        call()


def test_the_largest_displacement_has_a_finite_voltage():
    """A model that is refused nowhere computes finite voltages at the farthest place."""
    actuator = Actuator(UNIFORM, Spring([0.0, 1.0], [0.0, MOST]))
    assert np.isfinite(actuator.compensate([0.5 * FARTHEST, -0.5 * FARTHEST], extrapolate=True).voltage).all()


def test_bends_that_coincide_but_for_rounding_have_no_branch_between_them():
    slip = GradedSlip([0.1e-6], [0.0, 0.3e-6, 1e-6], [[1e6, 5e6]])

    def actuator(bend):
        return Actuator(slip, Spring([0.0, bend, 1e-6], [0.0, bend * 1e6, bend * 1e6 + (1e-6 - bend) * 1e7]))

    assert actuator(float(np.nextafter(0.3e-6 - 0.1e-6, 1))).slip is slip
    with pytest.raises(ModelError, match="does not rise"):
        actuator(0.21e-6)
