"""Blocks for python-control: the same numbers as the methods they stand for, and functions in the strict sense."""

import re
import sys
import warnings
from dataclasses import replace

import numpy as np
import places
import plain_records
import pytest
import structured_records as wide

from dehyst import ClampWarning, Compensator, Dynamics, MissingExtraError, ModelError

control = pytest.importorskip("control", reason="python-control is not installed; pip install control")

ROOT = places.ROOT
PAGE = ROOT / "docs" / "how_to" / "control.md"
PERIOD = 1 / wide.RATE
ANY = (-1e4, 1e4)


def _creeping():
    return wide.plant(wide.STRUCTURES["creep"]).actuator


def _made(**parts):
    """An actuator that creeps, with more parts, at the foot of its loop."""
    made = replace(_creeping(), state=None, **parts)
    return replace(made, state=made.turned(0.0, rising=False))


def _of(structure):
    plant = wide.plant(wide.STRUCTURES[structure])
    return replace(plant.actuator, state=plant.actuator.turned(0.0, rising=False))


SWING = Dynamics(2 * np.pi * 30, 0.1, 1e6)
ACTUATORS = {
    "paper's": lambda: plain_records.plant(10),
    **{name: (lambda name=name: _of(name)) for name in wide.STRUCTURES},
    "dynamics": lambda: _made(dynamics=SWING),
    "lag": lambda: _made(lag=0.004),
    "dynamics, lag, delay": lambda: _made(dynamics=SWING, lag=0.004, delay=0.0125),
}


def wanted(size=600):
    return wide.wandering(legs=20)[1 : size + 1]


def play(block, given, x=None):
    """What a block makes of a path, by its functions alone."""
    x, out = block.start if x is None else x, []
    for one in given:
        u = np.array([one])
        out.append(block.outfcn(0.0, x, u, {})[0])
        x = block.updfcn(0.0, x, u, {})
    return np.array(out), x


def seen_by_simulate(actuator, voltage, *, stack):
    """From the voltage that holds the state: the first sample of a simulation has no step before it."""
    sent = np.append(actuator.voltage(), voltage)
    time = PERIOD * np.arange(sent.size)
    return actuator.simulate(sent, time=time, stack=stack).displacement[1:]


def tight(actuator, path, **options):
    """A compensator within limits and a slew rate that the path breaks."""
    v = Compensator(actuator, ANY, period=PERIOD, **options).run(path)
    fast = float(np.quantile(np.abs(np.diff(v)), 0.8)) / PERIOD
    return Compensator(actuator, tuple(np.quantile(v, [0.1, 0.8])), fast, period=PERIOD, **options)


@pytest.mark.parametrize("preview", [False, True])
@pytest.mark.parametrize("name", ACTUATORS)
@pytest.mark.filterwarnings("ignore::dehyst.control.compensator.ClampWarning")
def test_a_compensators_block_is_its_run_bit_for_bit(name, preview):
    actuator, path = ACTUATORS[name](), wanted()
    compensator = tight(actuator, path, preview=preview)
    block = compensator.to_control()
    voltage, _ = play(block, path)
    np.testing.assert_array_equal(voltage, compensator.run(path))
    assert compensator.clamps.limited > 0 and compensator.clamps.slewed > 0


@pytest.mark.parametrize("name", ACTUATORS)
def test_an_actuators_block_is_its_simulation(name):
    actuator = ACTUATORS[name]()
    voltage = np.interp(np.arange(600), np.arange(0, 600, 20), np.random.default_rng(3).uniform(-20, 220, 30))
    displacement, _ = play(actuator.to_control(period=PERIOD), voltage)
    for stack in (False, True):
        plain_records.assert_close(
            displacement, seen_by_simulate(actuator, voltage, stack=stack), 1e-12 * plain_records.STROKE
        )


@pytest.mark.parametrize("name", ["paper's", "plain", "graded", "transformer", "smooth"])
def test_without_time_an_actuators_block_is_its_simulation_bit_for_bit(name):
    actuator = ACTUATORS[name]()
    voltage = 100 + 100 * np.sin(np.arange(400) / 9) * np.linspace(1, 0.2, 400)
    displacement, _ = play(actuator.to_control(), voltage)
    np.testing.assert_array_equal(displacement, actuator.simulate(voltage, stack=False).displacement)


@pytest.mark.parametrize("kind", ["compensator", "actuator"])
@pytest.mark.filterwarnings("ignore::dehyst.control.compensator.ClampWarning")
def test_the_functions_depend_on_their_arguments_alone(kind):
    actuator, path = ACTUATORS["dynamics, lag, delay"](), wanted(200)
    compensator = tight(actuator, path, preview=True)
    block = compensator.to_control() if kind == "compensator" else actuator.to_control(period=PERIOD)
    given = path if kind == "compensator" else compensator.run(path)
    states = [block.start]
    for one in given:
        states.append(block.updfcn(0.0, states[-1], np.array([one]), {}))
    kept = [x.copy() for x in states]
    out = [block.outfcn(0.0, x, np.array([u]), {})[0] for x, u in zip(states, given, strict=False)]
    # In any order, as often as one likes, other inputs between.
    for k in np.random.default_rng(0).integers(0, path.size, 600):
        u = np.array([given[k]])
        block.outfcn(0.0, states[k], 0.9 * u, {})
        assert block.outfcn(0.0, states[k], u, {})[0] == out[k]
        np.testing.assert_array_equal(block.updfcn(0.0, states[k], u, {}), states[k + 1])
    for x, before in zip(states, kept, strict=True):
        np.testing.assert_array_equal(x, before)


@pytest.mark.parametrize("name", ACTUATORS)
def test_every_state_has_a_name(name):
    for block in (ACTUATORS[name]().to_control(period=PERIOD), tight(ACTUATORS[name](), wanted()).to_control()):
        assert (block.nstates, len(set(block.state_labels))) == (block.start.size, block.start.size)


def test_a_compensators_block_begins_where_the_compensator_is_and_leaves_it_there():
    actuator, path = ACTUATORS["dynamics, lag, delay"](), wanted()
    compensator = Compensator(actuator, ANY, period=PERIOD, preview=True)
    whole = Compensator(actuator, ANY, period=PERIOD, preview=True).run(path)
    compensator.run(path[:250])
    block = compensator.to_control()
    voltage, _ = play(block, path[250:])
    np.testing.assert_array_equal(voltage, whole[250:])
    np.testing.assert_array_equal(compensator.run(path[250:]), whole[250:])
    np.testing.assert_array_equal(play(block, path[250:])[0], voltage)


def test_an_actuators_block_begins_in_a_state():
    actuator = ACTUATORS["creep"]()
    state = actuator.simulate([0.0, 150.0, 90.0], time=[0.0, 1.0, 2.0]).state
    block = actuator.to_control(period=PERIOD, state=state)
    assert block.start[0] == state.deformation
    at_rest, _ = play(block, [actuator.voltage(state)])
    assert abs(at_rest[0] - state.deformation) < 0.02 * plain_records.STROKE


def test_a_loop_of_blocks_is_the_loop_written_out():
    """Integral feedback of the sample before, the wanted displacement added ahead of the compensator."""
    actuator = ACTUATORS["all"]()
    wrong = replace(actuator, spring=replace_slopes(actuator.spring, 1.1))
    compensator, path, gain = Compensator(wrong, ANY, period=PERIOD), wanted(250), 0.15
    integral = control.ss(1.0, gain, 1.0, 0.0, PERIOD, inputs="error", outputs="added", name="integral")
    blocks = compensator.to_control(), actuator.to_control(period=PERIOD)
    loop = control.interconnect(
        [
            integral,
            *blocks,
            control.summing_junction(["asked", "-displacement"], "error"),
            control.summing_junction(["asked", "added"], "wanted"),
        ],
        inputs="asked",
        outputs="displacement",
    )
    start = [0.0, *blocks[0].start, *blocks[1].start]
    found = control.input_output_response(loop, PERIOD * np.arange(path.size), path, start).outputs
    added, y, sent = 0.0, [], [actuator.voltage()]
    for one in path:
        sent.append(compensator.step(one + added))
        y.append(actuator.simulate(sent, time=PERIOD * np.arange(len(sent)), stack=False).displacement[-1])
        added += gain * (one - y[-1])
    plain_records.assert_close(found, np.array(y), 1e-11 * plain_records.STROKE)
    open_loop = seen_by_simulate(actuator, Compensator(wrong, ANY, period=PERIOD).run(path), stack=False)
    assert np.std(found - path) < np.std(open_loop - path)


def replace_slopes(spring, factor):
    from dehyst import Spring

    return Spring.of_slopes(spring.displacement, factor * spring.slopes, float(spring.voltage[0]))


def test_periods():
    actuator = plain_records.plant(10)
    assert actuator.to_control().dt is True
    assert actuator.to_control(period=0.01, name="stage").dt == 0.01
    assert actuator.to_control(name="stage").name == "stage"
    assert Compensator(actuator, ANY).to_control().dt is True
    assert Compensator(actuator, ANY, period=0.01).to_control(name="inverse").dt == 0.01


def test_a_clamp_is_said_once_of_each_kind():
    actuator = plain_records.plant(10)
    block = Compensator(actuator, (0, 100), 1e3, period=1e-3).to_control()
    path = plain_records.path((0.1, 1.0, 0.1), 50)
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        x = play(block, path)[1]
        play(block, path[::-1], x)
    # One of the limit, and one of the slew rate, which names the start.
    said = [one.message.assumed for one in heard if one.category is ClampWarning]
    assert [one for one in said if one] == [pytest.approx(100.0)]
    assert said.count(None) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        block.outfcn(0.0, block.start, path[:1], {})  # a look moves nothing and says nothing


def played_once(block, x=None, u=(1e-6,)):
    block.updfcn(0.0, block.start if x is None else x, u, {})


def broken(block):
    x = block.start.copy()
    x[1] += 1.0
    return x


BLOCKS = [lambda: plain_records.plant(10).to_control(), lambda: Compensator(plain_records.plant(10), ANY).to_control()]


@pytest.mark.parametrize("make", BLOCKS, ids=["actuator", "compensator"])
@pytest.mark.parametrize(
    "use",
    [
        *(lambda block, u=u: played_once(block, u=u) for u in ([np.nan], [np.inf], [], [1.0, 2.0], None, "x")),
        *(lambda block, u=u: block.outfcn(0.0, block.start, u, {}) for u in ([np.nan], [], None, "x")),
        lambda block: played_once(block, block.start[:-1]),
        lambda block: played_once(block, broken(block)),
        lambda block: played_once(block, np.full(block.nstates, np.nan)),
        lambda block: played_once(block, ["x"]),
        lambda block: block.output(0, block.start, []),
        lambda block: control.linearize(block, block.start, [100.0], eps=1e-10),
        lambda block: control.linearize(block, 0, [100.0], eps=1e-10),
        lambda block: control.find_operating_point(block, block.start, [100.0]),
    ],
)
def test_what_a_block_cannot_be_asked(make, use):
    with pytest.raises(ModelError):
        use(make())


@pytest.mark.parametrize(
    "make",
    [
        lambda: _creeping().to_control(),
        *(lambda period=period: plain_records.plant(10).to_control(period=period) for period in (0.0, -1.0, np.nan)),
        lambda: _creeping().to_control(period=PERIOD, state=plain_records.plant(10).state),
        *(lambda name=name: plain_records.plant(10).to_control(name=name) for name in (5, None, "")),
        *(lambda name=name: Compensator(plain_records.plant(10), ANY).to_control(name=name) for name in (5, None, "")),
    ],
)
def test_what_makes_no_block(make):
    with pytest.raises(ModelError):
        make()


def test_without_python_control_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    for make in (plain_records.plant(10).to_control, Compensator(plain_records.plant(10), ANY).to_control):
        with pytest.raises(MissingExtraError, match=r"pip install 'dehyst\[control\]'"):
            make()


def test_the_code_on_its_page_runs(tmp_path, monkeypatch):
    actuator = replace(_of("all"), limits=(0.0, 250.0))
    actuator.save(tmp_path / "model.json")
    monkeypatch.chdir(tmp_path)
    names = {}
    for code in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL):
        exec(code, names)
    assert names["compensator"].clamps == (0, 0)
    time = 1e-3 * np.arange(names["sent"].size + 1)
    first = names["first"]
    y = actuator.simulate(np.append(first.voltage, names["sent"]), time=time, state=first.state).displacement[1:]
    plain_records.assert_close(y, names["wanted"], 1e-12 * plain_records.STROKE)
    # The loop of blocks has the true model: there is nothing for the integral to add.
    plain_records.assert_close(names["response"].outputs[0], names["wanted"], 1e-12 * plain_records.STROKE)
    plain_records.assert_close(names["response"].outputs[1], names["sent"], 1e-9)
    check_its_loop(names, actuator)
    check_its_device(names, actuator)


def check_its_loop(names, actuator):
    names["compensator"].reset()
    stage = Compensator(actuator, ANY, period=1e-3)
    reached = []

    def read():
        # A stage that falls short by a hundredth: the integral makes up for it.
        reached.append(0.99 * stage.displacement)
        return reached[-1]

    path = np.full(300, 8e-6)
    names["follow"](path, stage.commit, read, 0.05)
    assert abs(reached[0] - 8e-6) > 5e-8
    assert abs(reached[-1] - 8e-6) < 1e-10


def check_its_device(names, actuator):
    written = []

    def write(voltage):
        if len(written) == 1:
            written.append(None)
            raise OSError("the converter is asleep")
        written.append(voltage)

    compensator = Compensator(actuator, (0, 200), period=1e-3)
    device, other = names["Stage"](compensator, write), Compensator(actuator, (0, 200), period=1e-3)
    device.set(5e-6)
    with pytest.raises(OSError, match="asleep"):
        device.set(9e-6)
    device.set(6e-6)
    assert [written[0], written[2]] == [other.step(5e-6), other.step(6e-6)]
    assert device.read() == {"displacement": 6e-6, "voltage": written[2]}
