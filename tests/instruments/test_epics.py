"""The EPICS rig against a real IOC over real Channel Access, faults among them."""

import signal
import sys
import time
import warnings
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("softioc", reason="softioc is not installed: there is no EPICS server to test against")
pytest.importorskip("aioca", reason="aioca is not installed: there is no Channel Access client")
from fake_rig import beyond
from hand_clock import Hand
from ioc_process import IocProcess

from dehyst._errors import MissingExtraError
from dehyst.instruments import DeviceError, LinkError, RigError
from dehyst.instruments.epics import ChannelAccess, EpicsRig, PvNames
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Excitation


@pytest.fixture(scope="module")
def ioc():
    with IocProcess() as process:
        yield process


@pytest.fixture
def rig(ioc):
    with EpicsRig.connect(ioc.prefix) as found:
        found.retreat()
        yield found


@pytest.fixture
def doomed():
    """An IOC of this test's own, to be maltreated."""
    with IocProcess() as process:
        yield process


def cosine(samples=1000, rate=200.0, top=100.0):
    return Excitation("cosine", top / 2 * (1 - np.cos(np.linspace(0, 4 * np.pi, samples))), rate)


def test_the_rig_has_the_limits_of_the_device(rig, ioc):
    assert (rig.limits.low, rig.limits.high, rig.longest) == (0.0, 200.0, None)
    assert f"epics://{ioc.prefix}" in rig.name
    assert "dehyst" in rig.name


def test_a_record_is_the_motion_of_the_actuator_within_the_slew_rate(doomed):
    """Never steeper than the slew rate, however long each answer takes."""
    excitation = cosine(120, 200.0, 20.0)
    slew = 1.02 * 200.0 * np.abs(np.diff(excitation.voltage)).max()
    with EpicsRig.connect(doomed.prefix, slew_rate=slew) as rig:
        assert (rig.nearest_rate(1000.0), rig.nearest_rate(20.0)) == (200.0, 20.0)
        record = rig.play(excitation)
    assert np.array_equal(record.voltage, excitation.voltage)
    truth = PlayActuator(noise=0.0).play(excitation.voltage)
    assert np.abs(record.displacement - truth).max() < 1e-11
    assert np.all(np.diff(record.time) > 0)
    assert doomed.log()["steepest"] <= slew * (1 + 1e-9)


def test_other_names_of_variables_are_possible(ioc):
    names = PvNames(identity=None)
    front, _, rest = ioc.prefix.partition(":")
    names = replace(names, voltage=f"{rest}:VOLTAGE", readback=f"{rest}:VOLTAGE:RBV", position=f"{rest}:POSITION")
    with EpicsRig.connect(f"{front}:", names=names) as rig:
        rig.set_voltage(7.0)
        first, second = rig.read(), rig.read()
    assert first.voltage == 7.0
    assert second.time > first.time


def test_missing_variables_are_named(ioc):
    names = PvNames(position="POS", identity="NAME")
    with pytest.raises(LinkError, match=f"{ioc.prefix}:POS: no answer"):
        EpicsRig.connect(ioc.prefix, names=names, timeout=0.5)


def test_an_unreachable_ioc_is_reported():
    began = time.monotonic()
    with pytest.raises(LinkError, match=r"NOBODY:VOLTAGE: .* EPICS_CA_ADDR_LIST"):
        EpicsRig.connect("NOBODY", timeout=0.5)
    assert time.monotonic() - began < 4 * 0.5  # they are waited for together


def test_a_position_in_volts_is_refused(ioc):
    with pytest.raises(LinkError, match="unit is 'V'"):
        EpicsRig.connect(ioc.prefix, names=PvNames(position="VOLTAGE:RBV"))


def test_a_text_in_place_of_a_number_is_refused(ioc):
    with pytest.raises(LinkError, match="need a number"):
        ChannelAccess(f"{ioc.prefix}:", 1.0).numbers("IDN")


def test_a_refused_write_is_reported(ioc):
    with pytest.raises(DeviceError, match="POSITION: Channel write"):
        ChannelAccess(f"{ioc.prefix}:", 1.0).put("POSITION", 1.0)


def test_a_missing_library_is_reported(monkeypatch):
    monkeypatch.setitem(sys.modules, "aioca", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'dehyst\[bench\]'"):
        EpicsRig.connect("BENCH")


def test_a_device_with_narrower_limits_than_stated_is_reported(doomed, monkeypatch):
    """Refused by the device, and the voltage brought back."""
    rig, clock = EpicsRig.connect(doomed.prefix), Hand()
    monkeypatch.setattr(rig, "_now", clock)
    monkeypatch.setattr(rig, "_wait", clock.wait)
    doomed.do("instrument.axis._limits = VoltageLimits(0, 80)")
    # The range of 200 V takes a second, and a step 10 ms.
    with pytest.raises(DeviceError, match="took 80 V when 82 V") as caught:
        rig.set_voltage(150.0)
    assert caught.value.__notes__[0].safe
    assert doomed.log()["highest"] <= 80.0
    assert rig.read().voltage == 0.0


def test_without_limits_in_the_epics_record_those_of_the_user_are_used(ioc):
    link = ChannelAccess(f"{ioc.prefix}:", 1.0)
    link.put("VOLTAGE.DRVH", 0.0)
    try:
        with pytest.raises(RigError, match="DRVL and DRVH"):
            EpicsRig.connect(ioc.prefix)
        with EpicsRig.connect(ioc.prefix, limits=(0.0, 50.0)) as rig:
            assert (rig.limits.low, rig.limits.high) == (0.0, 50.0)
    finally:
        link.put("VOLTAGE.DRVH", 200.0)


STALE = """
import emulator.epics_ioc as served; ioc = served._running[0]; refresh = ioc._refresh; ioc._refresh = lambda: None;
threading.Timer(1.4, lambda: vars(ioc).pop("_refresh")).start()
"""


def test_a_reading_that_is_older_than_the_command_contradicts_nothing(doomed):
    """Of an IOC that is so busy that it reads its amplifier over a second later."""
    rig = EpicsRig.connect(doomed.prefix)
    doomed.do(" ".join(STALE.split()))
    assert rig.set_voltage(60.0) == 60.0
    assert rig.read().voltage == 60.0


def test_an_ioc_killed_during_a_wave_is_reported(doomed):
    rig = EpicsRig.connect(doomed.prefix, timeout=1.0)
    with pytest.raises(LinkError, match="no answer within") as caught:
        rig.play(cosine(2000), beyond(1.0, doomed.kill))
    assert not caught.value.__notes__[0].safe
    with pytest.raises(RigError, match="is closed"):
        rig.read()


@pytest.mark.nightly
def test_a_restarted_ioc_is_used_again(doomed):
    rig = EpicsRig.connect(doomed.prefix, timeout=20.0)
    rig.set_voltage(10.0)
    doomed.kill()
    with IocProcess(at=doomed.port):
        assert rig.set_voltage(20.0) == 20.0


def test_an_ioc_that_hangs_during_a_wave_is_reported(doomed):
    """Connected, but silent; when it wakes up, the rig can be told to retreat."""
    rig = EpicsRig.connect(doomed.prefix, timeout=1.0)
    with pytest.raises(LinkError, match="no answer within 1 s") as caught:
        rig.play(cosine(2000), beyond(1.0, lambda: doomed.process.send_signal(signal.SIGSTOP)))
    assert not caught.value.__notes__[0].safe
    doomed.process.send_signal(signal.SIGCONT)
    again = EpicsRig.connect(doomed.prefix)
    assert again.retreat() == 0.0
    assert again.read().voltage == 0.0


def test_two_rigs_share_an_ioc(rig, ioc):
    """Closing one leaves the other."""
    EpicsRig.connect(ioc.prefix).close()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert rig.set_voltage(3.0) == 3.0
