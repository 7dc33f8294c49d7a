"""A bank gives each actuator the bits of its own compensator, whatever it is computed beside, and in."""

import re
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import SEEDS, make_actuator

from dehyst import Actuator, Bank, ClampWarning, Compensator, DisplacementCreep, ModelError
from dehyst.model import Transformer, voltages_of
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


PLAIN = mixed(4, 3, kinds=("plain",))


def paths(actuators, samples, seed, beyond=0.1):
    """Displacements over a little more than the reach of each actuator: jumps, rests, and small motions."""
    rng = np.random.default_rng([seed, 7])
    ends = np.array([actuator.spring.displacement[[0, -1]] for actuator in actuators])
    share = rng.uniform(-beyond, 1 + beyond, (samples, len(actuators)))
    near = 0.5 + 0.02 * np.cumsum(rng.normal(size=share.shape), axis=0)
    share = np.where(np.arange(samples)[:, None] // 20 % 2, share, near.clip(-beyond, 1 + beyond))
    share[5::11] = share[4::11][: share[5::11].shape[0]]
    return ends[:, 0] + share * np.ptp(ends, axis=1)


def slews(actuators, share):
    return [share * (actuator.limits[1] - actuator.limits[0]) / PERIOD for actuator in actuators]


@examples(8, nightly=50)
@given(SEEDS, st.integers(1, 40), st.sampled_from([0.05, 0.6, 5.0]))
def test_each_actuator_of_a_bank_has_the_bits_of_its_own_compensator(seed, count, share):
    actuators = mixed(seed, count)
    wanted, slew = paths(actuators, 80, seed), slews(actuators, share)
    bank = Bank(actuators, slew_rate=slew, period=PERIOD)
    voltage = np.vstack([bank.run(wanted[:40]), [bank.step(row) for row in wanted[40:]]])
    for i, actuator in enumerate(actuators):
        compensator = Compensator(actuator, slew_rate=slew[i], period=PERIOD)
        np.testing.assert_array_equal(voltage[:, i], compensator.run(wanted[:, i]))
        assert bank.clamps[i] == compensator.clamps
        assert bank.states[i].as_dict() == compensator.state.as_dict()


def test_each_kind_of_clamp_is_warned_of_once_and_counted():
    actuators = mixed(2, 12)
    bank = Bank(actuators, period=PERIOD, slew_rate=slews(actuators, 0.1))
    wanted = paths(actuators, 60, 2, beyond=0.2)
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
    ("actuators", "options", "message"),
    [
        (PLAIN, {"limits": (5, 1)}, "actuator 0: "),
        (PLAIN, {"slew_rate": 10.0}, "give the period"),
        (PLAIN, {"states": 5}, "actuator 0: state: got int"),
        (PLAIN, {"limits": 5}, "actuator 0: limits: got 5"),
        ([], {}, "one at least"),
        (PLAIN[0], {}, "actuators: got Actuator"),
        ([*PLAIN, "stage"], {"period": PERIOD}, r"actuator 3.*str.*Actuator"),
    ],
)
def test_arguments_of_the_wrong_size_are_refused(actuators, options, message):
    with pytest.raises(ModelError, match=message):
        Bank(actuators, **options)
