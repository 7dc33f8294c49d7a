"""The loop: what it sends is within limits, what it remembers is what was sent, and it goes on where it was stopped."""

import math
import pickle
import threading
from dataclasses import replace

import compiled_exports
import numpy as np
import plain_records
import pytest
import structured_records as wide
from hypothesis import given
from hypothesis import strategies as st

from dehyst import ClampWarning, Compensator, DisplacementCreep, Dynamics, ModelError, State
from dehyst.model import turned

# Clamped samples are counted.
pytestmark = pytest.mark.filterwarnings("ignore::dehyst.ClampWarning")
PLANT = plain_records.plant(10, seed=4)
PERIOD = 1 / wide.RATE
FREE = (-1e4, 1e4)
STRUCTURES = sorted(wide.STRUCTURES)
PLANTS = {name: wide.plant(wide.STRUCTURES[name], seed=3).actuator for name in STRUCTURES}
MOVING = {
    "inertia": {"dynamics": Dynamics(30, 0.03)},
    "series": {"dynamics": Dynamics(30, 0.03, 2e6)},
    "lag": {"lag": 5 * PERIOD},
    "creep": {"displacement_creep": DisplacementCreep([0.02, 0.3, 4.0], [0.02, 0.03, 0.04])},
    "all that moves": {
        "dynamics": Dynamics(30, 0.03, 2e6),
        "lag": 3 * PERIOD,
        "displacement_creep": DisplacementCreep([0.05, 5.0], [0.03, 0.03]),
    },
}
PLANTS |= {name: replace(PLANT, **parts) for name, parts in MOVING.items()}
# Other weights in the same shape.
OTHERS = {name: wide.plant(wide.STRUCTURES[name], seed=4).actuator for name in STRUCTURES}
OTHERS |= {name: replace(plain_records.plant(10, seed=5), **parts) for name, parts in MOVING.items()}


def wanted(seed, size=300):
    """Some of it lies beyond what the limits allow."""
    return plain_records.wild_path(seed, size, beyond=0.1, corners=(3, 15))


def started(actuator, seed):
    return turned(actuator, plain_records.STROKE * np.random.default_rng(seed).uniform(0.2, 0.8))


def replayed(actuator, start, voltage, period=PERIOD):
    """What the actuator does with voltages, the first one period after the state."""
    held = np.append(actuator.voltage(start), voltage)
    return actuator.simulate(held, time=np.arange(held.size) * period, state=start, stack=False)


def gap(first, other):
    """The largest difference [m] of two states."""
    differences = [
        np.abs(np.subtract(getattr(first, part), getattr(other, part))).max(initial=0.0)
        for part in ("carts", "displacement_creep", "smooth")
    ]
    return max(abs(first.deformation - other.deformation), *differences)


@given(st.sampled_from(STRUCTURES), st.integers(0, 10**6))
def test_a_path_without_clamps_is_followed(name, seed):
    actuator, path = PLANTS[name], wanted(seed)
    start = started(actuator, seed)
    compensator = Compensator(actuator, (30.0, 140.0), period=PERIOD, state=start)
    start = compensator.state
    clamped = np.zeros(path.size, dtype=bool)
    voltage = np.empty(path.size)
    for i, y in enumerate(path):
        before = compensator.clamps
        voltage[i] = compensator.step(y)
        clamped[i] = compensator.clamps != before
    reached = replayed(actuator, start, voltage).displacement[1:]
    assert np.abs(reached - path)[~clamped].max(initial=0.0) < 1e-11 * plain_records.STROKE
    assert compensator.clamps.limited == clamped.sum()
    assert compensator.clamps.slewed == 0


@pytest.mark.parametrize("name", sorted(PLANTS))
def test_a_start_beyond_the_limits_begins_at_the_nearest_limit(name):
    actuator = PLANTS[name]
    high = 0.5 * actuator.voltage(turned(actuator, 0.9 * plain_records.STROKE))
    compensator = Compensator(
        actuator, (0.0, high), 1e3, period=PERIOD, state=turned(actuator, 0.9 * plain_records.STROKE)
    )
    assert compensator.voltage == pytest.approx(high, abs=1e-12 * high)
    assert compensator.voltage <= high
    assert actuator.voltage(compensator.state) == pytest.approx(high, abs=1e-9 * high)
    if actuator.dynamics is not None:
        assert compensator.state.motion[0] == compensator.state.deformation
    assert high >= compensator.step(0.9 * plain_records.STROKE) > high - 1e3 * PERIOD - 1e-9
    with pytest.raises(ModelError, match="displacement: got nan"):
        compensator.step(math.nan)
    assert 0 <= compensator.voltage <= high


@pytest.mark.parametrize("volts", [-40.0, 3.4, 91.6])
def test_a_voltage_from_which_no_step_returns_to_the_limits_is_refused(volts):
    """A sample must be within the limits, and no farther than 1.5 V from the one before."""
    compensator = Compensator(PLANT, (5, 90), 1500.0, period=1e-3, warns=False)
    before = compensator.voltage
    with pytest.raises(ModelError) as caught:
        compensator.commit(volts)
    assert caught.value.argument == "voltage" and compensator.voltage == before
    for start, goal in ((3.6, 0.9 * plain_records.STROKE), (91.4, 0.0)):
        compensator.commit(start)
        voltage = compensator.step(goal)
        assert 5 <= voltage <= 90 and abs(voltage - start) <= 1.5 * (1 + 1e-9)


def test_a_slewed_step_names_the_previous_voltage():
    options = {"limits": (0.0, 200.0), "slew_rate": 1e3, "period": 1e-3}
    low, given = 0.2 * plain_records.STROKE, turned(PLANT, 0.9 * plain_records.STROKE)
    for state in (None, given):
        loop, copied = (Compensator(PLANT, **options, state=state) for _ in range(2))
        before = PLANT.voltage() if state is None else PLANT.voltage(given)
        for call, wanted_ in ((loop.step, low), (pickle.loads(pickle.dumps(copied)).run, np.full(3, low))):
            with pytest.warns(ClampWarning) as said:
                call(wanted_)
            assert [warning.message.before for warning in said] == [before]


def test_a_snapshot_of_another_loop_is_refused():
    kept = Compensator(PLANT, FREE, period=1e-3).snapshot()
    for other in (
        Compensator(plain_records.plant(12, seed=5), FREE, period=1e-3),
        Compensator(PLANT, FREE, period=2e-3),
        Compensator(replace(PLANT, delay=2e-3), FREE, period=1e-3, preview=True),
    ):
        with pytest.raises(ModelError, match="another shape"):
            other.restore(kept)
    wide, narrow = (Compensator(PLANT, (0, high)) for high in (200, 80))
    wide.step(12e-6)
    for bad in (wide.snapshot(), None, "loop.json"):
        with pytest.raises(ModelError, match="snapshot"):
            narrow.restore(bad)
    renamed = Compensator(replace(PLANT, name="the same under another name", limits=(0, 1)), FREE, period=1e-3)
    renamed.restore(kept)
    assert renamed.snapshot() == kept


@pytest.mark.parametrize("name", sorted(PLANTS))
def test_another_model_of_the_same_shape_continues_from_a_snapshot(name):
    """The voltage changes no faster than the slew rate."""
    actuator, path = PLANTS[name], wanted(11)
    other = OTHERS[name]
    make = lambda model: Compensator(  # noqa: E731
        model, (20, 140), 5e3, period=PERIOD, state=started(actuator, 1), preview=True, units="um"
    )
    first, second = make(actuator), make(other)
    sent = [first.run(1e6 * path[:150])]
    second.restore(first.snapshot())
    assert first.clamps == second.clamps
    assert gap(first.state, second.state) == 0
    sent.append(second.run(1e6 * path[150:]))
    assert np.abs(np.diff(np.concatenate(sent))).max() <= 5e3 * PERIOD * (1 + 1e-9)


@pytest.mark.parametrize("ask", ["offer", "restore"])
def test_two_threads_cannot_share_a_loop(ask):
    """To begin it anew would free the memory that the run works in."""
    compensator, path = Compensator(PLANT, (-1e3, 1e3)), np.tile(wanted(4), 10_000)
    given = 5e-6 if ask == "offer" else compensator.snapshot()
    running, refused = threading.Thread(target=compensator.run, args=(path,)), 0
    running.start()
    while running.is_alive():
        try:
            getattr(compensator, ask)(given)
        except RuntimeError as error:
            assert "another thread" in str(error)
            refused += 1
    assert refused
    alone = Compensator(PLANT, (-1e3, 1e3))
    alone.run(path)
    # When the run has ended, before its thread has, a snapshot may be restored.
    assert ask == "restore" or gap(alone.state, compensator.state) == 0


@pytest.mark.parametrize("period", [1e-12, 1e-300])
def test_a_period_too_short_for_the_preview_is_refused(period):
    for parts in ({"delay": 1e-3}, {"dynamics": Dynamics(15.9, 0.1)}):
        with pytest.raises(ModelError, match="look ahead"):
            Compensator(replace(PLANT, **parts), FREE, period=period, preview=True).step(0.0)
    with pytest.raises(ModelError, match="no change"):
        Compensator(PLANT, FREE, 1e-300, period=1e-300).step(0.0)


def test_a_reset_begins_again():
    compensator = Compensator(PLANT, (0, 100), state=turned(PLANT, 5e-6))
    path = wanted(3)
    voltage = compensator.run(path)
    compensator.reset()
    assert compensator.clamps == (0, 0)
    np.testing.assert_array_equal(compensator.run(path), voltage)
    compensator.reset(PLANT.relaxed(0.0))
    assert compensator.voltage == pytest.approx(0.0, abs=1e-9)


def smooth_path(time, frequency=3.0):
    """Rests, then swings with continuous acceleration."""
    swing = np.clip(time - 0.5, 0, None)
    return plain_records.STROKE * (0.5 - 0.4 * np.sin(2 * np.pi * frequency * swing) * -np.expm1(-((swing * 3) ** 3)))


@pytest.mark.parametrize("parts", ["inertia", "series", "all that moves"])
@pytest.mark.parametrize("delay", [0.0, 3.0, 2.4])
def test_preview_compensates_delay_and_inertia(parts, delay):
    """The error falls with the period squared or more; without preview it is what inertia and delay make of it."""
    errors = []
    for period in (PERIOD, PERIOD / 2):
        actuator = replace(PLANTS[parts], lag=0.0, delay=delay * period)
        time = np.arange(round(2.5 / period)) * period
        start = turned(actuator, plain_records.STROKE / 2)
        compensator = Compensator(actuator, FREE, period=period, state=start, preview=True)
        ahead = compensator.samples_ahead
        voltage = compensator.run(smooth_path(time + (ahead + 1) * period))
        seen = replayed(actuator, start, voltage, period).displacement[1:]
        # The voltage of now is seen `delay` later.
        errors.append(np.abs(seen - smooth_path(time + period + actuator.delay)).max() / plain_records.STROKE)
    plain = Compensator(actuator, FREE, period=period, state=start).run(smooth_path(time + period))
    lazy = replayed(actuator, start, plain, period).displacement[1:] - smooth_path(time + period + actuator.delay)
    assert errors[1] < 0.3 * errors[0] or errors[1] < 1e-6
    assert errors[1] < 0.05 * np.abs(lazy).max() / plain_records.STROKE


@pytest.mark.parametrize("name", sorted(PLANTS))
def test_slow_loops_turn_at_the_reach(name):
    actuator = PLANTS[name]
    compensator = Compensator(actuator, (20, 140), period=PERIOD)
    low, high = compensator.reach
    assert low < high
    slow = replace(actuator, dynamics=None, lag=0.0)
    voltage = np.tile([20.0, 140.0], 100)
    # Long holds, in which creep comes to rest step by step.
    held = np.repeat(voltage, 30)
    start = State(slow.state.deformation, slow.state.carts)
    moved = slow.simulate(held, time=np.arange(held.size) * 10.0, state=start).displacement[29::30]
    np.testing.assert_allclose(moved[-2:], [low, high], atol=1e-6 * plain_records.STROKE)


IMPOSSIBLE = {
    "limits": (None, (1, 0), (0, math.nan), 5),
    "slew_rate": (0.0,),
    "period": (0.0, "1"),
    "preview": (True,),
    "state": (1, State(0.0, [])),
    "model": ("model.json",),
}


@pytest.mark.parametrize(("name", "bad"), [(name, bad) for name, each in IMPOSSIBLE.items() for bad in each])
def test_impossible_loops_are_refused(name, bad):
    with pytest.raises(ModelError) as caught:
        Compensator(**{"model": PLANT, "limits": (0, 100), name: bad})
    # A preview needs the period.
    named = "period" if name == "preview" else name
    assert named in {*caught.value.argument.split(), *caught.value.change}


@pytest.mark.parametrize("kind", ["plain", "graded", "creep", "moving"])
@pytest.mark.parametrize("slew", [None, 300.0])
def test_a_long_run_agrees_with_steps_to_rounding(kind, slew):
    """Blocks on the stack of reversals, and steps where a voltage is clamped; the memory goes on."""
    actuator = compiled_exports.KINDS[kind]().actuator
    low, high = Compensator(actuator, (20, 80), period=PERIOD).reach
    t = np.arange(20_000) / 3000
    path = low + (high - low) * (0.5 + 0.35 * np.sin(2 * np.pi * t) * np.cos(t) + 0.1 * np.sin(40 * t))
    path[9000:9050] = high + 0.2 * (high - low)
    long, steps = (Compensator(actuator, (20, 80), slew, period=PERIOD, warns=False) for _ in range(2))
    for driven in (long, steps):
        driven.scale(1.01, 1e-9)
    ran = np.concatenate([long.run(path[:15_000]), long.run(path[15_000:])])
    expected = np.array([steps.step(y) for y in path.tolist()])
    np.testing.assert_allclose(ran, expected, rtol=0, atol=1e-8)
    assert long.clamps == steps.clamps and sum(long.clamps) > 0
    assert long.step(path[0]) == pytest.approx(steps.step(path[0]), abs=1e-8)


@pytest.mark.parametrize("elements", [3, 6, 10, 20])
def test_a_state_at_0_volts_begins_with_0_volts(elements):
    """Not by what rounding leaves of them; a small voltage is kept."""
    actuator = replace(plain_records.plant(elements), limits=(0.0, 200.0))
    for seed in range(20):
        turns = np.random.default_rng(seed).uniform(0, 200, 40)
        for last in (0.0, 1e-9):
            state = actuator.simulate([*turns, last], state=turned(actuator, 0.0, rising=False)).state
            assert actuator.voltage(state) == pytest.approx(last, rel=1e-3, abs=0)
            assert Compensator(actuator)._axes[0].held(state) == pytest.approx(last, rel=1e-3, abs=0)


@pytest.mark.parametrize("far", [4.0, 1e40])
def test_the_memory_of_creep_is_right_after_a_clamped_step_with_preview(far):
    creeping = replace(PLANT, delay=9e-5, displacement_creep=DisplacementCreep([0.1, 10.0], [0.01, 0.02]))
    loop = Compensator(creeping, (0, 200), period=2e-4, preview=True, warns=False)
    loop.run([3e-6, far, *[3e-6] * 5000])
    loop.restore(loop.snapshot())
    assert loop.clamps.limited < 10 and np.abs(loop.state.displacement_creep).max() < np.ptp(PLANT.reach)
