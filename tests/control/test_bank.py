"""A bank gives each actuator the bits of its own compensator, whatever it is computed beside, and in."""

import re
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import SEEDS, make_actuator

from dehyst import (
    Actuator,
    Bank,
    ClampWarning,
    Compensator,
    DisplacementCreep,
    Dynamics,
    MaxwellSlip,
    ModelError,
    Spring,
)
from dehyst.model import GradedSlip, SmoothSlip, Transformer, voltages_of
from examples import examples

PERIOD = 1e-3
# Clamped samples are counted and compared.
pytestmark = pytest.mark.filterwarnings("ignore::dehyst.ClampWarning")


def mixed(seed, count, kinds=("plain", "creep", "tau", "both")):
    """Actuators of many sizes and kinds, with limits that some paths exceed."""
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(count):
        seed = int(rng.integers(2**32))
        plant = make_actuator(seed, int(rng.integers(0, 23)), int(rng.integers(2, 30)), uniform=bool(rng.integers(2)))
        low, high = voltages_of(plant)
        kind = kinds[int(rng.integers(len(kinds)))]
        parts = {}
        if kind in ("creep", "both"):
            parts["displacement_creep"] = DisplacementCreep([3e-3, 0.1, 10.0], 0.1 * rng.random(3))
        if kind in ("tau", "both"):
            volts = np.linspace(low, high, 7)
            parts["transformer"] = Transformer(volts, volts + 0.02 * (high - low) * np.sin(np.arange(7)))
        made.append(Actuator(plant.slip, plant.spring, limits=(low, high), **parts))
    return made


def paths(actuators, samples, seed, beyond=0.1):
    """Displacements over a little more than the reach of each actuator: jumps, rests, and small motions."""
    rng = np.random.default_rng([seed, 7])
    ends = np.array([actuator.spring.displacement[[0, -1]] for actuator in actuators])
    share = rng.uniform(-beyond, 1 + beyond, (samples, len(actuators)))
    near = 0.5 + 0.02 * np.cumsum(rng.normal(size=share.shape), axis=0)
    share = np.where(np.arange(samples)[:, None] // 20 % 2, share, near.clip(-beyond, 1 + beyond))
    share[5::11] = share[4::11][: share[5::11].shape[0]]
    return ends[:, 0] + share * np.ptp(ends, axis=1)


def alone(actuator, path, slew):
    compensator = Compensator(actuator, slew_rate=slew, period=PERIOD)
    return compensator.run(path), compensator


def slews(actuators, share):
    return [share * (actuator.limits[1] - actuator.limits[0]) / PERIOD for actuator in actuators]


@examples(8, nightly=50)
@given(SEEDS, st.integers(1, 40), st.sampled_from([0.05, 0.6, 5.0]))
def test_it_gives_each_the_bits_of_its_own_compensator(seed, count, share):
    actuators = mixed(seed, count)
    wanted = paths(actuators, 80, seed)
    assert_bits_of_each(actuators, wanted, slews(actuators, share))


def assert_bits_of_each(actuators, wanted, slew):
    bank, half = Bank(actuators, slew_rate=slew, period=PERIOD), len(wanted) // 2
    voltage = np.vstack([bank.run(wanted[:half]), [bank.step(row) for row in wanted[half:]]])
    for i, actuator in enumerate(actuators):
        expected, compensator = alone(actuator, wanted[:, i], slew[i])
        np.testing.assert_array_equal(voltage[:, i], expected)
        assert bank.clamps[i] == compensator.clamps
        assert bank.states[i].as_dict() == compensator.state.as_dict()


def classes():
    """One actuator of every class, and two plain ones beside them."""
    spring = Spring([0.0, 4e-6, 1e-5], [0.0, 40.0, 110.0])
    slip = MaxwellSlip([5e-7, 1e-6, 2e-6], [4e6, 2e6, 1e6])
    graded = GradedSlip([5e-7, 1e-6], [0.0, 5e-6, 1e-5], [[4e6, 3e6], [2e6, 3e6]])
    low_high = (0.0, 120.0)
    return [
        Actuator(slip, spring, limits=low_high),
        Actuator(graded, spring, limits=low_high),
        Actuator(slip, spring, limits=low_high, smooth=SmoothSlip([3e-7], [0.8], [2e6])),
        Actuator(slip, spring, limits=low_high, displacement_creep=DisplacementCreep([0.1, 2.0], [0.04, 0.03])),
        Actuator(slip, spring, limits=low_high, dynamics=Dynamics(79.6, 0.05)),
        Actuator(slip, spring, limits=low_high, lag=2e-3),
        Actuator(slip, spring, limits=low_high),
    ]


def along_sines(actuators, samples):
    return 5e-6 + 4e-6 * np.sin(np.arange(samples)[:, None] / 20 + np.arange(len(actuators)))


def test_every_class_has_the_bits_of_its_own_compensator():
    actuators = classes()
    assert_bits_of_each(actuators, along_sines(actuators, 300), [None] * len(actuators))


@pytest.mark.parametrize(("actuators", "share"), [(mixed(2, 12), 0.1), (classes(), 0.3)])
def test_clamping_is_said_once_of_a_kind_and_counted(actuators, share):
    bank = Bank(actuators, period=PERIOD, slew_rate=slews(actuators, share))
    wanted = paths(bank.actuators, 60, 2, beyond=0.2)
    with pytest.warns(ClampWarning, match=r"actuator \d+") as said:
        bank.run(wanted)
    counts = [int(re.search(r"(-?\d+) of", str(each.message))[1]) for each in said]
    clamped = np.sum(bank.clamps, axis=0)
    assert counts == clamped[clamped > 0].tolist()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        bank.run(wanted)
    assert all((np.sum(bank.clamps, axis=0) > clamped)[clamped > 0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"limits": (5, 1)}, "actuator 0: "),
        ({"slew_rate": 10.0}, "give the period"),
        ({"states": 5}, "actuator 0: state: got int"),
        ({"limits": 5}, "actuator 0: limits: got 5"),
    ],
)
def test_what_does_not_fit_is_refused(options, message):
    with pytest.raises(ModelError, match=message):
        Bank(mixed(4, 3, kinds=("plain",)), **options)


def test_no_actuators_and_wrong_ones_are_refused():
    with pytest.raises(ModelError, match="one at least"):
        Bank([])
    with pytest.raises(ModelError, match="actuators: got Actuator"):
        Bank(mixed(4, 1)[0])
    with pytest.raises(ModelError, match=r"actuator 1.*str.*Actuator"):
        Bank([*mixed(4, 1), "stage"], period=PERIOD)


def test_wrong_displacements_are_told_with_their_place():
    bank = Bank(mixed(4, 3, kinds=("plain",)))
    good = paths(bank.actuators, 4, 4, beyond=0)
    bad = good.copy()
    bad[2, 1] = np.nan
    for values, message in [
        (good[:, :2], r"got the shape \(4, 2\), need a column for each of 3 actuators"),
        (good[0], "need two dimensions"),
        (bad, "first at index 7"),
        (good * 1e6, "actuator 0: .*micrometres"),
    ]:
        with pytest.raises(ModelError, match=message):
            bank.run(values)
    with pytest.raises(ModelError, match="actuator 1"):
        bank.step([1e-6, 1e300, 1e-6])
