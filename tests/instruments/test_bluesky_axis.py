"""The compensated axis: bluesky plans over a real IOC, the memory kept true, and an example as it is printed."""

import asyncio
import re
import subprocess
import sys
import time
from dataclasses import replace
from threading import Timer
from types import SimpleNamespace

import numpy as np
import places
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("softioc", reason="softioc is not installed: there is no EPICS server to test against")
pytest.importorskip("aioca", reason="aioca is not installed: there is no Channel Access client")
pytest.importorskip("ophyd_async", reason="ophyd-async is not installed: there is no bluesky device to test")
pytest.importorskip("bluesky", reason="bluesky is not installed: there are no plans to run")
import bluesky.plan_stubs as bps
import bluesky.plans as bp
from bluesky import RunEngine
from bluesky.utils import FailedStatus, RunEngineInterrupted
from ioc_process import IocProcess
from ophyd_async.core import init_devices
from plain_records import STROKE, VOLTS, plant

from dehyst import Compensator, Creep, MissingExtraError, ModelError
from dehyst.control import VoltageLimits, shortest_homing
from dehyst.control.planning.homing import homing_steps
from dehyst.instruments import DeviceError, RigError
from dehyst.instruments.bluesky_axis import CompensatedAxis, homing
from dehyst.instruments.channel_access import ChannelAccess

EXAMPLE = places.EXAMPLES / "bluesky_scan.py"
# Of the stroke [um]: what is left where the model is the actuator, and Channel Access carries doubles.
EXACT = 1e-9 * STROKE * 1e6


@pytest.fixture(scope="module")
def engine():
    return RunEngine({})


@pytest.fixture(scope="module")
def actuator():
    return plant()


@pytest.fixture(scope="module")
def ioc(actuator, tmp_path_factory):
    """An IOC around an actuator that is the model itself: what is missed is the axis's fault."""
    path = tmp_path_factory.mktemp("model") / "model.json"
    actuator.save(path)
    with IocProcess(model=str(path), limits=(0.0, VOLTS)) as process:
        yield process


def made(ioc, actuator, **options):
    with init_devices():
        # By its name in here it is found and connected.
        axis = CompensatedAxis(ioc.prefix, actuator, **{"slew_rate": 2000.0, "settle": 0.0, "name": "axis", **options})
    return axis  # noqa: RET504


@pytest.fixture
def axis(ioc, actuator):
    return made(ioc, actuator, limits=(0.0, VOLTS))


@pytest.fixture
def homed(axis, engine):
    engine(homing(axis))
    return axis


def measured(engine, axis):
    """Where the sensor sees it [um]."""
    found = []
    engine(read_into(axis, found))
    return found[0]["axis-position"]["value"]


def run(engine, act):
    """Run a coroutine function on the engine's loop, beside its plans."""

    def plan():
        (task,) = yield from bps.wait_for([act])
        task.result()

    engine(plan())


def read_into(axis, found):
    found.append((yield from bps.read(axis)))


@given(
    wish=st.floats(-50, 250),
    present=st.floats(0, 200),
    slew=st.floats(1, 1e4),
    period=st.floats(1e-3, 1.0),
)
def test_a_step_keeps_limits_and_slew_rate(wish, present, slew, period):
    limits = VoltageLimits(0.0, 200.0, slew)
    step = limits.towards(wish, present, period)
    assert 0.0 <= step <= 200.0
    assert abs(step - present) <= slew * period * (1 + 1e-9)
    assert abs(step - limits.nearest(wish)) <= abs(present - limits.nearest(wish))


@given(present=st.floats(0, 200), slew=st.floats(20, 1e4), period=st.floats(1e-2, 0.1))
def test_a_homing_in_steps_is_that_homing(present, slew, period):
    limits = VoltageLimits(0.0, 200.0, slew)
    found = shortest_homing(plant(), limits=(0, 200), present=present)
    steps = np.array([(present, period), *homing_steps(found, limits, period)])
    assert np.abs(np.diff(steps[:, 0])).max(initial=0.0) <= slew * period * (1 + 1e-9)
    assert np.all(steps[:, 1] >= period)
    assert set(found.turns) <= set(steps[:, 0])
    assert np.abs(np.diff(steps[:, 0])).sum() == pytest.approx(found.travel, abs=1e-6)


def creeping():
    """A plant with creep of a third of a second, slower than its steps and quicker than a test."""
    plain = plant()
    return replace(plain, creep=Creep([0.3], [0.1 * VOLTS / STROKE]), name="creeping")


def test_a_homing_in_time_takes_its_time():
    limits, period = VoltageLimits(0.0, 200.0, 1e4), 0.02
    found = shortest_homing(creeping(), limits=(0, 200), present=0.0)
    steps = np.array(list(homing_steps(found, limits, period)))
    assert found.played.duration <= steps[:, 1].sum() <= 1.5 * found.played.duration + 10 * period
    assert (steps[:, 0].min(), steps[:, 0].max()) == (found.played.voltage.min(), found.played.voltage.max())
    assert steps[-1, 0] == found.played.voltage[-1]


def test_it_must_be_homed_first(axis, engine, ioc):
    before = ioc.log()
    with pytest.raises(FailedStatus) as caught:
        engine(bps.mv(axis, 5.0))
    assert isinstance(caught.value.__cause__, RigError)
    assert "not homed yet; home it first" in str(caught.value.__cause__)
    assert ioc.log() == before


def test_it_goes_where_it_is_told(homed, engine, ioc, actuator):
    """Up, down and into minor loops; the actuator is the model, so nothing is missed."""
    low, high = homed.reach
    assert (low, high) == pytest.approx(tuple(1e6 * y for y in Compensator(actuator, (0, VOLTS)).reach))
    for share in (0.5, 0.9, 0.2, 0.6, 0.4, 0.55, 1.0, 0.0):
        wanted = low + share * (high - low)
        engine(bps.mv(homed, wanted))
        assert measured(engine, homed) == pytest.approx(wanted, abs=EXACT)
    log = ioc.log()
    assert log["lowest"] >= 0
    assert log["highest"] <= VOLTS
    assert log["largest_step"] <= 2000.0 * 0.02 * (1 + 1e-9)


def test_it_is_a_motor_in_a_scan(homed, engine):
    """`bp.scan` finds wanted displacement, voltage and measured displacement in every event."""
    events, described = [], []
    engine(
        bp.scan([], homed, 2.0, 12.0, 6),
        lambda kind, document: {"event": events, "descriptor": described}.get(kind, []).append(document),
    )
    assert [event["data"]["axis-wanted"] for event in events] == pytest.approx(np.linspace(2, 12, 6))
    assert [event["data"]["axis-position"] for event in events] == pytest.approx(np.linspace(2, 12, 6), abs=EXACT)
    assert np.all(np.diff([event["data"]["axis-voltage"] for event in events]) > 0)
    keys = described[0]["data_keys"]
    assert {name: keys[name]["units"] for name in keys} == {
        "axis-wanted": "um",
        "axis-voltage": "V",
        "axis-position": "um",
    }
    assert described[0]["hints"]["axis"]["fields"] == ["axis-position"]


def test_it_says_where_it_is(homed, engine):
    engine(bps.mv(homed, 4.0))
    engine(bps.mvr(homed, 1.5))

    async def look():
        found = await homed.locate()
        assert found["setpoint"] == 5.5
        assert found["readback"] == pytest.approx(5.5, abs=EXACT)

    run(engine, look)


@pytest.mark.parametrize("share", [-0.1, 1.1, 100.0])
def test_what_is_out_of_reach_is_refused_before_anything_moves(homed, engine, ioc, share):
    engine(bps.mv(homed, 5.0))
    before, (low, high) = ioc.log(), homed.reach
    with pytest.raises(FailedStatus) as caught:
        engine(bps.mv(homed, low + share * (high - low)))
    assert isinstance(caught.value.__cause__, ModelError)
    assert re.search("0 to 200 V is allowed", str(caught.value.__cause__))
    assert ioc.log() == before
    engine(bps.mv(homed, 6.0))
    assert measured(engine, homed) == pytest.approx(6.0, abs=EXACT)


@pytest.mark.parametrize("value", [np.nan, np.inf, "far"])
def test_no_displacement_is_refused(homed, engine, ioc, value):
    before = ioc.log()
    with pytest.raises(FailedStatus) as caught:
        engine(bps.mv(homed, value))
    assert isinstance(caught.value.__cause__, ModelError)
    assert ioc.log() == before


@pytest.mark.parametrize("success", [True, False])
def test_a_stop_holds_and_the_memory_stays_true(ioc, actuator, engine, success):
    """Stopped on its way, and sent on: no error is left behind."""
    axis = made(ioc, actuator, slew_rate=100.0)
    engine(homing(axis))

    async def stopped():
        status = axis.set(14.0)
        while await axis.readback.get_value() < 20:
            await asyncio.sleep(0.05)
        await axis.stop(success=success)
        await asyncio.wait([status.task])
        held = await axis.readback.get_value()
        await asyncio.sleep(0.2)
        assert held == await axis.readback.get_value()
        assert 10 < held < 150
        assert status.success == success
        if not success:
            assert "was stopped on its way" in str(status.exception())
        assert await axis.wanted.get_value() == pytest.approx(await axis.position.get_value(), abs=EXACT)

    run(engine, stopped)
    engine(bps.mv(axis, 3.0))
    assert measured(engine, axis) == pytest.approx(3.0, abs=EXACT)


def test_a_cancelled_move_remembers_what_it_sent(ioc, actuator, engine):
    axis = made(ioc, actuator, slew_rate=100.0)
    engine(homing(axis))

    async def broken_off():
        status = axis.set(14.0)
        await asyncio.sleep(0.33)
        status.task.cancel()

    run(engine, broken_off)
    engine(bps.mv(axis, 2.0))
    assert measured(engine, axis) == pytest.approx(2.0, abs=EXACT)


def test_a_plan_that_is_broken_off_stops_its_homing(ioc, actuator, engine):
    axis = made(ioc, actuator, slew_rate=50.0)

    Timer(0.5, lambda: engine.request_pause(defer=False)).start()
    with pytest.raises(RunEngineInterrupted):
        engine(homing(axis))
    engine.abort()
    time.sleep(0.1)
    before = ChannelAccess(f"{ioc.prefix}:", 5.0).numbers("VOLTAGE:RBV")
    time.sleep(0.2)
    assert ChannelAccess(f"{ioc.prefix}:", 5.0).numbers("VOLTAGE:RBV") == before
    with pytest.raises(FailedStatus) as caught:
        engine(bps.mv(axis, 5.0))
    assert "homing was broken" in str(caught.value.__cause__)


def test_a_voltage_from_elsewhere_must_be_homed_away(homed, engine):
    engine(bps.mv(homed, 5.0))
    engine(bps.mv(homed.voltage, 60.0))
    with pytest.raises(FailedStatus) as caught:
        engine(bps.mv(homed, 6.0))
    assert "has sent 60" in str(caught.value.__cause__)
    engine(homing(homed))
    engine(bps.mv(homed, 6.0))
    assert measured(engine, homed) == pytest.approx(6.0, abs=EXACT)


def test_limits_narrower_than_told(actuator, engine, tmp_path):
    actuator.save(tmp_path / "model.json")
    with IocProcess(model=str(tmp_path / "model.json")) as doomed:
        axis = made(doomed, actuator)
        engine(homing(axis))
        doomed.do("instrument.axis._limits = VoltageLimits(0, 80)")
        with pytest.raises(FailedStatus) as caught:
            engine(bps.mv(axis, 15.0))
        assert isinstance(caught.value.__cause__, DeviceError)
        assert "narrower than it reports" in str(caught.value.__cause__)
        # What was taken is remembered: it may go on within what is left.
        engine(bps.mv(axis, 1.0))
        assert measured(engine, axis) == pytest.approx(1.0, abs=EXACT)


@pytest.mark.nightly
def test_an_ioc_that_dies(actuator, engine, tmp_path):
    """The move fails, as does all that follows."""
    actuator.save(tmp_path / "model.json")
    with IocProcess(model=str(tmp_path / "model.json")) as doomed:
        axis = made(doomed, actuator, slew_rate=100.0, timeout=1.0)
        engine(homing(axis))

        async def dies():
            status = axis.set(14.0)
            await asyncio.sleep(0.3)
            doomed.process.kill()
            await asyncio.wait([status.task])
            assert not status.success

        run(engine, dies)
        with pytest.raises(FailedStatus):
            engine(bps.mv(axis, 2.0))


def test_a_step_that_may_have_been_done_is_not_repeated(homed, engine, ioc, monkeypatch):
    """The answer to a put is lost: where the actuator stands is not known any more."""
    engine(bps.mv(homed, 5.0))
    backend = homed.voltage._connector.backend
    put = backend.put

    async def lost(voltage):
        await put(voltage)
        raise TimeoutError("lost")

    monkeypatch.setattr(backend, "put", lost)
    with pytest.raises(FailedStatus):
        engine(bps.mv(homed, 9.0))
    monkeypatch.undo()
    before = ioc.log()
    with pytest.raises(FailedStatus) as caught:
        engine(bps.mv(homed, 9.0))
    assert "a voltage may have been sent, or not (TimeoutError" in str(caught.value.__cause__)
    assert ioc.log() == before
    engine(homing(homed))
    engine(bps.mv(homed, 9.0))
    assert measured(engine, homed) == pytest.approx(9.0, abs=EXACT)


def test_the_iocs_slew_rate_is_kept(actuator, engine, tmp_path):
    actuator.save(tmp_path / "model.json")
    with IocProcess(model=str(tmp_path / "model.json"), slew_rate=400.0) as slow:
        axis = made(slow, actuator, slew_rate=4000.0)
        began = time.monotonic()
        engine(homing(axis))
        assert time.monotonic() - began > 2 * VOLTS / 400.0
        engine(bps.mv(axis, 8.0))
        time.sleep(0.1)
        assert measured(engine, axis) == pytest.approx(8.0, abs=EXACT)


class SimulatedClock:
    """The time of an IOC and of the axis that talks to it; a step begins `overhead` seconds later than it should."""

    def __init__(self, ioc, overhead):
        self.ioc, self.now, self.overhead, self.late = ioc, 0.0, overhead, 0.0

    def monotonic(self):
        late, self.late = self.late, 0.0
        self.wait(late)
        return self.now

    def wait(self, seconds):
        self.now += seconds
        self.ioc.do(f"clock.now = {self.now!r}")

    async def sleep(self, seconds):
        self.wait(seconds)
        self.late = self.overhead

    def shown(self):
        """Wait until the IOC's position is that of now; it is read at intervals."""
        channels = ChannelAccess(f"{self.ioc.prefix}:", 5.0)
        while channels.numbers("TIME")[0] < self.now - 1e-3:
            time.sleep(0.01)


@pytest.mark.parametrize("overhead", [0.0, 0.017, 0.2])
def test_an_actuator_that_creeps(engine, tmp_path, monkeypatch, overhead):
    """Homed in time; pauses between two moves and slow steps are part of its memory."""
    actuator = creeping()
    actuator.save(tmp_path / "model.json")
    with IocProcess(model=str(tmp_path / "model.json"), simulated_clock=True) as process:
        axis = made(process, actuator, slew_rate=1000.0)
        clock = SimulatedClock(process, overhead)
        monkeypatch.setattr("dehyst.instruments.bluesky_axis.time", clock)
        monkeypatch.setattr(
            "dehyst.instruments.bluesky_axis.asyncio", SimpleNamespace(**{**vars(asyncio), "sleep": clock.sleep})
        )
        engine(homing(axis))
        low, high = axis.reach
        for share, pause in ((0.3, 0.0), (0.8, 1.0), (0.4, 0.3), (0.6, 0.0)):
            wanted = low + share * (high - low)
            engine(bps.mv(axis, wanted))
            clock.shown()
            assert measured(engine, axis) == pytest.approx(wanted, abs=0.01 * (high - low))
            clock.wait(pause)


def test_no_limits_in_common(ioc, actuator, engine):
    axis = made(ioc, actuator, limits=(300.0, 400.0))
    with pytest.raises(RigError, match="one is 300 V, their smallest"):
        engine(homing(axis))


@pytest.mark.parametrize("options", [{"period": 0.0}, {"settle": -1.0}, {"slew_rate": 0.0}, {"limits": (5.0, 1.0)}])
def test_impossible_numbers_are_refused(actuator, options):
    with pytest.raises(ModelError):
        CompensatedAxis("BENCH", actuator, **options)


def test_without_ophyd(monkeypatch):
    monkeypatch.setitem(sys.modules, "ophyd_async.core", None)
    monkeypatch.delitem(sys.modules, "dehyst.instruments.bluesky_axis")
    with pytest.raises(MissingExtraError, match=r"pip install 'dehyst\[bluesky\]'"):
        import dehyst.instruments.bluesky_axis  # noqa: F401


@pytest.mark.nightly
def test_the_example_as_it_is():
    """Loops recorded and identified through the IOC; then the scan, without hysteresis and with it."""
    with IocProcess(actuator={"noise": 2e-9}) as process:
        command = [sys.executable, str(EXAMPLE), process.prefix]
        done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
        log = process.log()
    assert done.returncode == 0, done.stderr
    errors = {name: float(value) for name, value in re.findall(r"(\w+): largest error ([\d.]+) %", done.stdout)}
    assert errors["compensated"] < 0.5
    assert errors["proportional"] > 10 * errors["compensated"]
    assert (log["lowest"], log["highest"], log["refused"]) == (0.0, VOLTS, 0)
