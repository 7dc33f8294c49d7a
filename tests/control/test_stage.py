"""A stage: simulation and compensation of coupled axes, and its file."""

from dataclasses import replace

import numpy as np
import pytest

import dehyst
from dehyst import Actuator, Compensator, MaxwellSlip, Spring, Stage
from dehyst.control import PossibleStart, plan_path
from dehyst.control.planning.path import plan_voltage
from dehyst.model import turned

pytestmark = pytest.mark.filterwarnings("ignore::dehyst.ClampWarning")


def actuator(scale=1.0, **options):
    rho = np.array([0.3e-6, 1e-6, 2.5e-6]) * scale
    kappa = np.array([4e5, 2e6, 3e6]) / scale
    spring = Spring(np.array([0.0, 5e-6, 12e-6]) * scale, np.array([0.0, 35.0, 95.0]))
    return Actuator(MaxwellSlip(rho, kappa), spring, limits=(-150.0, 200.0), **options)


COUPLING = np.array([[1.0, 0.04, -0.02], [0.03, 1.0, 0.05], [-0.025, 0.06, 1.0]])


def stage(coupling=COUPLING):
    return Stage((actuator(), actuator(1.3), actuator(0.8)), coupling)


def path(rng, n=300, size=3):
    t = np.linspace(0, 1, n)[:, None]
    turns = rng.uniform(1, 5, size)
    return 1e-6 * (3.5 + 2.5 * np.sin(2 * np.pi * turns * t + rng.uniform(0, 6, size)))


def test_a_stage_without_coupling_equals_its_actuators_bit_for_bit():
    wanted, model = path(np.random.default_rng(1)), stage(np.eye(3))
    loop = Compensator(model, slew_rate=[2e4] * 3, period=1e-3)
    stepped = np.array([loop.step(row) for row in wanted])
    trace = model.simulate(stepped)
    for j, actuator in enumerate(model.actuators):
        single = dehyst.Compensator(actuator, slew_rate=2e4, period=1e-3)
        assert np.array_equal(stepped[:, j], single.run(wanted[:, j]))
        assert np.array_equal(trace.displacement[:, j], actuator.simulate(stepped[:, j]).displacement)
        assert np.array_equal(model.compensate(wanted).voltage[:, j], actuator.compensate(wanted[:, j]).voltage)


def random_loop(rng, most=0.15):
    """Limits and slew rates so narrow that every axis is clamped now and then, and couplings of up to `most`."""
    size = int(rng.integers(2, 5))
    coupling = rng.uniform(-most, most, (size, size))
    np.fill_diagonal(coupling, 1)
    model = Stage(tuple(actuator(scale) for scale in rng.uniform(0.7, 1.4, size)), coupling, tuple("abcd"[:size]))
    limits = [(-150.0, high) for high in rng.uniform(15, 60, size)]
    return Compensator(model, period=1e-3, limits=limits, slew_rate=rng.uniform(100, 2000, size).tolist())


@pytest.mark.parametrize("seed", range(5))
def test_a_whole_path_with_all_axes_clamped_equals_its_steps(seed):
    rng = np.random.default_rng(seed)
    loop = random_loop(rng)
    wanted = path(rng, 200, len(loop.stage.axes))
    starts = [PossibleStart("known", (state,)) for state in loop.state]
    plan, ran, voltage, clamped = plan_path(loop, wanted, start=starts), loop._clone().run(wanted), [], []
    for row in wanted:
        before = np.sum(loop.clamps, axis=1)
        voltage.append(loop.step(row))
        clamped.append(np.sum(loop.clamps, axis=1) > before)
    assert np.array_equal(ran, voltage)
    first = plan.first
    for j, part in enumerate(plan.each if not first else ()):
        held = np.array(clamped)[:, j]
        assert held.any() and np.array_equal(part.clamped, held)
        assert np.allclose(part.voltage, np.array(voltage)[:, j], rtol=0, atol=1e-10)
        alone = ~np.any(clamped, axis=1)
        assert np.abs(part.expected - wanted[:, j])[alone].max(initial=0) < 1e-15


@pytest.mark.parametrize("timed", [True, False])
def test_after_a_homing_the_earlier_state_has_no_effect(timed):
    wanted, model = path(np.random.default_rng(8)), stage()
    time = 1e-2 * np.arange(len(wanted)) if timed else None
    options = {"limits": [(-60.0, 120.0)] * 3} | ({"slew_rate": [400.0] * 3, "period": 1e-2} if timed else {})
    homed = plan_path(Compensator(model, **options), wanted, time=time, home=True)
    voltage, first, time = homed.voltage, homed.first, homed.time
    assert homed.certified and voltage.min() >= -60.0 and voltage.max() <= 120.0
    if timed:
        assert (np.abs(np.diff(voltage, axis=0)) / np.diff(time)[:, None]).max() <= 400.0 * (1 + 1e-9)
        assert np.allclose(np.diff(time[first:]), 1e-2)
    for before in ([0.0], [-60.0, 120.0, 30.0], [100.0, -20.0]):
        states = [actuator.simulate(before).state for actuator in model.actuators]
        reached = model.simulate(voltage, time=time, states=states).displacement[first:]
        assert np.abs(reached - wanted).max() < 1e-13


def test_a_refusal_by_one_axis_changes_no_axis():
    model = stage()
    loop = Compensator(model)
    loop.step(path(np.random.default_rng(9))[0])
    before, snapshot = loop.voltage, loop.snapshot()
    other = Compensator(stage(np.eye(3))).snapshot()
    for refused in (
        lambda: loop.commit([1.0, 2.0, 1e9]),
        lambda: loop.reset([None, None, 5]),
        lambda: loop.restore([other[0], other[1], 5]),
        lambda: loop.restore(snapshot[:2]),
        lambda: loop.restore(None),
        lambda: plan_path(loop, np.zeros((9, 3)), start="top"),
        lambda: Compensator(model, period=1e-3, preview=True),
    ):
        with pytest.raises(dehyst.ModelError):
            refused()
        assert np.array_equal(loop.voltage, before)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": "dehyst-actuator"}, "need 'dehyst-stage'"),
        ({"recorded_columns": "x_um"}, "recorded_columns: got 'x_um'"),
        ({"extra": 1}, "unknown entries"),
        ({"axes": ["x", "x", "z"]}, "different names"),
        ({"coupling": [[1, 0], [0, 1]]}, "got 2 x 2 numbers for 3 axes"),
        ({"coupling": [[1, 0, 0], [0, 1, 0], [0, 0, 2]]}, "need 1 for each axis"),
        ({"coupling": [[1, 1, 0], [1, 1, 0], [0, 0, 1]]}, "condition"),
        ({"actuators": []}, "need one Actuator"),
    ],
)
def test_a_wrong_stage_file_is_refused(change, words):
    with pytest.raises(dehyst.ModelError, match=words):
        Stage.from_dict({**stage().as_dict(), **change})


@pytest.mark.parametrize("kind", ["stage", "bank"])
def test_limits_slew_rate_and_state_are_given_once_or_per_axis(kind):
    model = Stage((actuator(), actuator()))

    def made(**options):
        if kind == "stage":
            return Compensator(model, period=1e-3, **options)._axes
        return dehyst.Bank(model.actuators, period=1e-3, **options)._axes

    word = "state" if kind == "stage" else "states"
    pair, state = (0.0, 100.0), turned(model.actuators[0], 3e-6)
    for limits in (pair, list(pair), np.array(pair), [pair], [pair, pair], np.array([pair, pair])):
        assert [compensator.limits for compensator in made(limits=limits)] == [pair] * 2
    assert [compensator.limits for compensator in made(limits=[pair, None])] == [pair, (-150.0, 200.0)]
    for rate, expected in ((5.0, [5.0, 5.0]), ([5.0], [5.0, 5.0]), ([5.0, None], [5.0, None]), (None, [None] * 2)):
        assert [compensator.slew_rate for compensator in made(slew_rate=rate)] == expected
    for states in (state, [state, state]):
        assert [compensator.state.deformation for compensator in made(**{word: states})] == [3e-6] * 2
    for name, wrong in {"limits": [pair] * 3, "slew_rate": [1.0] * 3, word: [state] * 3}.items():
        with pytest.raises(dehyst.ModelError) as caught:
            made(**{name: wrong})
        assert caught.value.argument == name
    for wrong in (5.0, "0,100", [0.0, 50.0, 100.0]):
        with pytest.raises(dehyst.ModelError, match="limits"):
            made(limits=wrong)


THERMALS = dehyst.Thermal(-2.5e-3, 4e-9, 30.0), None, dehyst.Thermal(1.5e-3, 0.0, 20.0)


def warm_stage():
    cold = stage()
    pairs = zip(cold.actuators, THERMALS, strict=True)
    return replace(cold, actuators=tuple(replace(actuator, thermal=part) for actuator, part in pairs))


@pytest.mark.parametrize("shape", [(), (300,), (300, 3)])
def test_a_temperature_reaches_each_actuator_that_depends_on_it(shape):
    """Of steps, of a path in one call, and of a planned path, without clamped voltages and with them."""
    rng = np.random.default_rng(3)
    wanted, degrees, model = path(rng), rng.uniform(15.0, 45.0, shape), warm_stage()
    command = model.compensate(wanted, temperature=degrees)
    moved = model.simulate(command.voltage, temperature=degrees, extrapolate=True).displacement
    assert np.abs(moved - wanted).max() < 1e-15
    assert np.abs(model.simulate(command.voltage, extrapolate=True).displacement - wanted).max() > 1e-8
    for limits in (None, [(-150.0, 35.0), None, None]):
        loop = Compensator(model, limits=limits)
        starts = [PossibleStart("known", (state,)) for state in loop.state]
        planned = plan_path(loop, wanted, time=np.arange(300.0), temperature=degrees, start=starts)
        voltage = planned.voltage
        reached = model.simulate(voltage, temperature=degrees, states=loop.state, extrapolate=True).displacement
        np.testing.assert_allclose(planned.expected, reached, atol=1e-13)
        # Actuators that are not clamped follow, whatever the temperature of the others.
        assert np.abs((reached - wanted) @ model.decoupling.T)[:, 1:].max() < 1e-13
        assert (np.abs(reached - wanted)[:, 0].max() > 1e-7) == (limits is not None)
        each = np.broadcast_to(degrees[:, None] if degrees.ndim == 1 else degrees, wanted.shape)
        stepped = np.array([loop.step(y, now) for y, now in zip(wanted, each, strict=True)])
        np.testing.assert_allclose(stepped, voltage, atol=1e-9)
        np.testing.assert_allclose(loop.displacement, reached[-1], atol=1e-13)
        seen = plan_voltage(loop, voltage, time=np.arange(300.0), temperature=degrees, start=starts)
        for first, other in zip(planned.each, seen.each, strict=True):
            np.testing.assert_allclose(first.expected, other.expected, atol=1e-13)
            assert np.all(other.error.lowest <= other.error.highest)
        assert planned.temperature.tolist() == each.tolist()


def test_a_wrong_number_of_temperatures_is_refused_and_changes_nothing():
    loop = Compensator(warm_stage())
    loop.scale(temperature=25.0)
    before = loop.scale()
    for wrong in ([20.0, 20.0], [20.0, 20.0, 900.0, 20.0], [25.0, 20.0, -900.0], np.nan):
        with pytest.raises(dehyst.ModelError, match="temperature"):
            loop.scale(temperature=wrong)
    assert loop.scale() == before
    with pytest.raises(dehyst.ModelError, match="temperature"):
        Compensator(stage()).scale(temperature=25.0)


def test_narrow_limits_have_a_start_within_them():
    """A start of the model beyond the limits is replaced by that of loops within them, whatever was before."""
    model, limits = stage(), (-40.0, 30.0)
    loop = Compensator(model, limits=[limits] * 3)
    for actuator, axis in zip(model.actuators, loop._axes, strict=True):
        for before in ([-100.0], [60.0, -10.0]):
            played = actuator.simulate([*before, *np.tile(limits, 10)]).state
            assert axis.state.deformation == pytest.approx(played.deformation, abs=1e-15)
            assert np.allclose(axis.state.carts, played.carts, rtol=0, atol=1e-15)
        assert axis.voltage == 30.0
        assert axis.state.deformation < dehyst.Compensator(actuator, limits).state.deformation - 1e-8
