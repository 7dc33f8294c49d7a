"""Metres and micrometres: what strays from a model is refused; quantities are refused, not stripped."""

from dataclasses import replace

import numpy as np
import pytest
import strategies as our
from hypothesis import given
from hypothesis import strategies as st

import dehyst
from dehyst import Actuator, ClampWarning, Compensator, MaxwellSlip, ModelError, RecordError, Spring, plan_path
from dehyst.model import voltages_of

# 3.6 V move it by 45 um, as the measured one, from -119 um on.
KNOTS = np.linspace(-119e-6, -74e-6, 10)
ACTUATOR = Actuator(
    MaxwellSlip([2e-6, 8e-6, 15e-6], [8e3, 6e3, 4e3]),
    Spring(KNOTS, np.linspace(0.15, 3.45, 10)),
    limits=(0.0, 3.6),
    load_stiffness=1e6,
    name="stage",
)
LOW, HIGH = ACTUATOR._plausible.low, ACTUATOR._plausible.high
STROKE = HIGH - LOW
PATH = np.linspace(-110e-6, -80e-6, 9)


class Quantity:
    """A look-alike of the quantities of pint, astropy and xarray: NumPy's own conversion strips the unit."""

    def __init__(self, data, **unit):
        self.data = data
        self.__dict__.update(unit)

    def __array__(self, dtype=None, copy=None):
        return np.asarray(self.data, dtype=dtype)


@pytest.mark.parametrize(
    ("given_as", "hint"), [([2, 12], "micrometres"), ([12e3], "nanometres"), ([2e-6, 12e-6], "zero")]
)
def test_a_displacement_in_another_unit_or_from_another_zero_is_refused(given_as, hint):
    with pytest.raises(ModelError, match=hint):
        ACTUATOR.compensate(given_as)


@given(our.actuators(1, 20), our.SEEDS, st.booleans())
def test_displacements_within_a_stroke_of_the_range_are_accepted(actuator, seed, limited):
    rng = np.random.default_rng(seed)
    if limited:
        low, high = voltages_of(actuator)
        ends = low + (high - low) * (np.sort(rng.uniform(0, 1, 2)) + np.array([0.0, 0.01]))
        actuator = Actuator(actuator.slip, actuator.spring, limits=tuple(ends.tolist()))
    low, high = actuator.reach
    stroke = high - low
    y = rng.uniform(low - 0.999 * stroke, high + 0.999 * stroke, 30)
    same = actuator.compensate(y, extrapolate=True).voltage
    np.testing.assert_array_equal(actuator.compensate(y).voltage, same)
    first, last = voltages_of(actuator)
    v = rng.uniform(first - 0.999 * (last - first), last + 0.999 * (last - first), 30)
    np.testing.assert_array_equal(
        actuator.simulate(v).displacement, actuator.simulate(v, extrapolate=True).displacement
    )
    widest = actuator._plausible.high - actuator._plausible.low
    beyond = last + 1.01 * (last - first)
    for refused in (
        lambda: actuator.compensate([actuator._plausible.high + 1.01 * widest]),
        lambda: actuator.simulate([first, beyond]),
        lambda: actuator.relaxed(beyond),
    ):
        with pytest.raises(ModelError, match=r"displacement|voltage"):
            refused()
    actuator.relaxed(beyond, extrapolate=True)


def test_limits_too_wide_for_computing_give_the_range_of_the_spring():
    wide = replace(ACTUATOR, limits=(-1e299, 1e299))
    np.testing.assert_array_equal(wide.compensate(PATH).voltage, ACTUATOR.compensate(PATH).voltage)
    assert np.isfinite([wide._plausible.low, wide._plausible.high]).all()


def test_a_load_shifts_the_reach():
    force = np.full(2, 100.0)
    y = np.array([HIGH, HIGH + 1.9 * STROKE])
    with pytest.raises(ModelError, match="displacement"):
        ACTUATOR.compensate(y)
    ACTUATOR.compensate(y, load=force)


def test_a_path_strokes_outside_is_refused_and_a_clamped_path_is_not():
    with pytest.raises(ModelError, match="in micrometres"):
        plan_path(ACTUATOR, [2, 12])
    assert plan_path(ACTUATOR, [LOW, HIGH + 0.9 * STROKE]).clamped.any()
    # Numbers within wider limits of its own can be meant.
    assert not plan_path(ACTUATOR, [HIGH + 1.5 * STROKE], limits=(0.0, 12.0)).clamped.any()
    # And what the model reaches can be meant under narrower ones.
    assert plan_path(ACTUATOR, [HIGH], limits=(0.0, 0.5), home=False).clamped.all()


@pytest.mark.parametrize("method", ["step", "offer"])
@pytest.mark.parametrize("slew", [None, 10.0])
def test_a_loop_warns_about_the_unit_and_does_not_raise(method, slew):
    compensator = Compensator(ACTUATOR, slew_rate=slew, period=1e-3)
    with pytest.warns(ClampWarning, match="micrometres"):
        voltage = getattr(compensator, method)(12.0)
    assert 0 <= voltage <= 3.6
    with pytest.warns(ClampWarning) as seen:
        Compensator(ACTUATOR).step(HIGH + 0.5 * STROKE)
    assert "micrometres" not in str(seen[0].message)
    with pytest.warns(ClampWarning, match="in micrometres"):
        assert np.all(np.abs(Compensator(ACTUATOR).run([2.0, 12.0])) <= 3.6)


NO_NUMBERS = {
    "a quantity": Quantity(PATH, units="metre"),
    "of another library": Quantity(PATH, unit="um"),
    "within another": Quantity(Quantity(PATH, units="metre")),
    "in a list": [*PATH[1:], Quantity(PATH[0], unit="m")],
    "masked": np.ma.array(PATH, mask=PATH > -90e-6),
    "masked in a list": [*PATH[:-1], np.ma.masked],
    "complex": PATH + 0j,
    "complex in a list": [*PATH[:-1], np.complex128(PATH[-1])],
}


@pytest.mark.parametrize("kind", NO_NUMBERS)
def test_quantities_and_complex_numbers_are_refused(kind):
    with pytest.raises(ModelError, match="displacement"):
        ACTUATOR.compensate(NO_NUMBERS[kind])
    with pytest.raises(RecordError, match="displacement"):
        dehyst.Record(np.arange(PATH.size), PATH * 1e5, NO_NUMBERS[kind])


@pytest.mark.parametrize(
    "given_as", [np.ma.array(PATH), np.array(PATH, dtype=object), np.array(PATH, dtype=object).tolist()]
)
def test_other_types_of_numeric_arrays_are_accepted(given_as):
    np.testing.assert_array_equal(ACTUATOR.compensate(given_as).voltage, ACTUATOR.compensate(PATH).voltage)
