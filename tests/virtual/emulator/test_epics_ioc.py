"""The IOC, seen by a client that knows nothing of this package: names, units, limits, waves, refusals."""

import asyncio
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("softioc", reason="softioc is not installed: there is no EPICS server to test")
aioca = pytest.importorskip("aioca", reason="aioca is not installed: there is no Channel Access client")
from emulator.epics_ioc import serve_ioc  # noqa: E402
from ioc_process import IocProcess  # noqa: E402

from dehyst.instruments import RigError  # noqa: E402
from dehyst.virtual import PlayActuator, VirtualBench  # noqa: E402

LOOP = asyncio.new_event_loop()


@pytest.fixture(scope="module")
def ioc():
    with IocProcess(wave_points=6000, record_points=6000) as process:
        yield process


@pytest.fixture
def at_rest(ioc):
    """At 0 V, without errors."""
    put(ioc, "ERROR", "", datatype=aioca.DBR_CHAR_STR)
    put(ioc, "WAVE:STOP", 1)
    put(ioc, "VOLTAGE", 0.0)
    return ioc


def get(ioc, name, **options):
    return LOOP.run_until_complete(aioca.caget(f"{ioc.prefix}:{name}", **options))


def put(ioc, name, value, **options):
    return LOOP.run_until_complete(aioca.caput(f"{ioc.prefix}:{name}", value, wait=True, **options))


def text(ioc, name):
    return get(ioc, name, datatype=aioca.DBR_CHAR_STR)


def played(ioc, wave, period=1e-3):
    """Play a wave to its end; returns time, voltage, position."""
    put(ioc, "WAVE:VOLTAGE", wave)
    put(ioc, "WAVE:PERIOD", period)
    put(ioc, "WAVE:START", 1)
    while get(ioc, "WAVE:BUSY"):
        time.sleep(0.02)
    return tuple(np.array(get(ioc, f"REC:{column}")) for column in ("TIME", "VOLTAGE", "POSITION"))


@pytest.mark.parametrize(
    ("name", "unit", "low", "high"),
    [
        ("VOLTAGE", "V", 0.0, 200.0),
        ("VOLTAGE:RBV", "V", 0.0, 0.0),
        ("POSITION", "um", 0.0, 0.0),
        ("TIME", "s", 0.0, 0.0),
        ("LIMIT:LOW", "V", 0.0, 0.0),
        ("LIMIT:HIGH", "V", 0.0, 0.0),
        ("SLEW", "V/s", 0.0, 0.0),
        ("WAVE:PERIOD", "s", 0.0, 0.0),
        ("WAVE:VOLTAGE", "V", 0.0, 0.0),
        ("REC:TIME", "s", 0.0, 0.0),
        ("REC:VOLTAGE", "V", 0.0, 0.0),
        ("REC:POSITION", "um", 0.0, 0.0),
    ],
)
def test_numbers_have_units_digits_and_limits(ioc, name, unit, low, high):
    value = get(ioc, name, format=aioca.FORMAT_CTRL)
    assert value.units == unit
    assert value.precision >= 4
    assert (value.lower_ctrl_limit, value.upper_ctrl_limit) == (low, high)


def test_it_says_what_it_is_and_may(ioc):
    assert "dehyst" in text(ioc, "IDN")
    assert (get(ioc, "LIMIT:LOW"), get(ioc, "LIMIT:HIGH"), get(ioc, "SLEW")) == (0.0, 200.0, 0.0)


def test_a_put_comes_back_when_it_is_done(at_rest):
    """With the callback the read-only variables are of after it."""
    times = []
    for voltage in (50.0, 120.0, 30.0, 80.0, 80.0):
        put(at_rest, "VOLTAGE", voltage)
        assert get(at_rest, "VOLTAGE:RBV") == voltage
        times.append(get(at_rest, "TIME"))
    assert np.all(np.diff(times) > 0)


def test_the_position_is_the_actuators():
    """From rest, through voltages and a wave, as if the actuator were driven directly."""
    truth = PlayActuator(noise=0.0)
    wave = 60 + 40 * np.sin(np.linspace(0, 9, 300))
    with IocProcess() as fresh:
        for voltage in (90.0, 10.0, float(wave[0])):
            put(fresh, "VOLTAGE", voltage)
        _, sent, position = played(fresh, wave)
        expected = truth.play(np.concatenate([[90.0, 10.0, wave[0]], wave]))[3:]
    assert np.array_equal(sent, wave)
    assert np.abs(1e-6 * position - expected).max() < 1e-15


def test_what_is_beyond_the_limits_is_never_put_out(at_rest):
    put(at_rest, "VOLTAGE", 250.0)
    assert get(at_rest, "VOLTAGE:RBV") == 200.0
    put(at_rest, "VOLTAGE", -50.0)
    assert get(at_rest, "VOLTAGE:RBV") == 0.0
    log = at_rest.log()
    assert (log["lowest"], log["highest"]) == (0.0, 200.0)


def test_no_number_is_refused_and_the_error_stays(at_rest):
    put(at_rest, "VOLTAGE", 20.0)
    put(at_rest, "VOLTAGE", np.nan)
    assert text(at_rest, "ERROR") == "VOLTAGE: got nan V, which is outside the amplifier's range; nothing was sent"
    assert (get(at_rest, "VOLTAGE"), get(at_rest, "VOLTAGE:RBV")) == (20.0, 20.0)
    put(at_rest, "VOLTAGE", 25.0)
    assert text(at_rest, "ERROR")
    put(at_rest, "ERROR", "", datatype=aioca.DBR_CHAR_STR)
    assert not text(at_rest, "ERROR")


@pytest.mark.parametrize("name", ["VOLTAGE:RBV", "POSITION", "TIME", "LIMIT:HIGH", "REC:COUNT", "WAVE:BUSY"])
def test_what_is_read_only_cannot_be_written(ioc, name):
    with pytest.raises(aioca.CANothing, match="request failed"):
        put(ioc, name, 1)


def test_a_wave_of_five_thousand_points(at_rest):
    wave = 100 - 100 * np.cos(np.linspace(0, 2 * np.pi, 5000))
    at, sent, position = played(at_rest, wave, 1.03e-4)
    assert get(at_rest, "WAVE:PERIOD") == pytest.approx(1e-4)
    assert get(at_rest, "REC:COUNT") == 5000
    assert np.array_equal(sent, wave)
    assert np.allclose(np.diff(at), 1e-4, rtol=1e-6)
    assert position.argmax() == pytest.approx(wave.argmax(), abs=2)


def test_a_new_wave_counts_anew_before_its_start_comes_back(at_rest):
    played(at_rest, np.zeros(2000))
    put(at_rest, "WAVE:VOLTAGE", np.zeros(3000))
    put(at_rest, "WAVE:PERIOD", 0.01)
    put(at_rest, "WAVE:START", 1)
    assert get(at_rest, "REC:COUNT") < 100
    assert get(at_rest, "WAVE:BUSY")


def test_a_stopped_wave_holds_its_voltage(at_rest):
    put(at_rest, "WAVE:VOLTAGE", np.linspace(0, 100, 3000))
    put(at_rest, "WAVE:PERIOD", 1e-3)
    put(at_rest, "WAVE:START", 1)
    time.sleep(0.3)
    put(at_rest, "WAVE:STOP", 1)
    assert not get(at_rest, "WAVE:BUSY")
    held = get(at_rest, "VOLTAGE:RBV")
    assert 5 < held < 95
    time.sleep(0.2)
    assert get(at_rest, "VOLTAGE:RBV") == held
    assert get(at_rest, "REC:COUNT") == len(get(at_rest, "REC:VOLTAGE")) < 3000


@pytest.mark.parametrize("wave", [[0.0, 10.0, 200.5], [0.0, -0.5], [0.0, np.nan]])
def test_a_wave_beyond_the_limits_is_refused(at_rest, wave):
    before = at_rest.log()
    put(at_rest, "WAVE:VOLTAGE", np.array(wave))
    put(at_rest, "WAVE:START", 1)
    assert text(at_rest, "ERROR")
    assert not get(at_rest, "WAVE:BUSY")
    assert get(at_rest, "VOLTAGE:RBV") == 0.0
    assert {**at_rest.log(), "refused": 0} == {**before, "refused": 0}


@pytest.mark.parametrize("period", [0.0, -1.0, np.nan, np.inf])
def test_no_period_is_refused(at_rest, period):
    put(at_rest, "WAVE:PERIOD", period)
    assert "positive number" in text(at_rest, "ERROR")
    assert get(at_rest, "WAVE:PERIOD") > 0


def test_a_voltage_in_mid_wave_is_refused(at_rest):
    put(at_rest, "WAVE:VOLTAGE", np.zeros(3000))
    put(at_rest, "WAVE:PERIOD", 0.01)
    put(at_rest, "WAVE:START", 1)
    put(at_rest, "VOLTAGE", 50.0)
    assert "a wave is being played" in text(at_rest, "ERROR")
    assert get(at_rest, "VOLTAGE:RBV") == 0.0


def test_a_wave_leaves_its_last_voltage_as_the_one_asked_for(at_rest):
    """Processed without a new value, the record must not jump back."""
    played(at_rest, np.linspace(0, 40, 100))
    assert get(at_rest, "VOLTAGE") == 40.0
    put(at_rest, "VOLTAGE.PROC", 1)
    assert get(at_rest, "VOLTAGE:RBV") == 40.0


def test_garbage_leaves_it_serving(at_rest):
    """Texts for numbers, and arrays that are too long; nothing is done."""
    played(at_rest, np.linspace(0, 40, 100))
    for name, value in (("VOLTAGE", "fast"), ("WAVE:VOLTAGE", np.zeros(9000)), ("WAVE:START", "perhaps")):
        assert not put(at_rest, name, value, throw=False).ok
        assert (get(at_rest, "WAVE:BUSY"), get(at_rest, "VOLTAGE:RBV")) == (0, 40.0)
    put(at_rest, "VOLTAGE", 12.0)
    assert (get(at_rest, "VOLTAGE:RBV"), text(at_rest, "ERROR")) == (12.0, "")


def test_the_network_does_not_see_it(ioc):
    """All of its sockets are bound to the loopback interface."""
    if not Path("/proc/net/tcp").exists():
        pytest.skip("there is no /proc/net/tcp to look at")
    bound = []
    for kind in ("tcp", "udp"):
        for line in Path(f"/proc/{ioc.process.pid}/net/{kind}").read_text().splitlines()[1:]:
            address, port = line.split()[1].split(":")
            if int(port, 16) == ioc.port:
                bound.append(address)
    assert bound
    assert set(bound) == {"0100007F"}


@pytest.mark.parametrize("prefix", ["", "A B", "X" * 41, "Ä", 'B"'])
def test_a_prefix_that_is_none_is_refused(prefix):
    with pytest.raises(RigError, match=r"prefix: got .* need 1 to 40 letters"):
        serve_ioc(VirtualBench(PlayActuator()), prefix, None)


def test_a_process_serves_one(ioc):
    said, _ = ioc.do("answer = said(lambda: serve_ioc(instrument, 'SECOND', lock))")
    assert said == f"SECOND: this process serves {ioc.prefix} already, and EPICS allows one; start another"
