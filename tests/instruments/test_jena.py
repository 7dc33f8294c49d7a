"""The rig on an NV200/D by the maker's library, with an emulator of ours; the contract is tested with all rigs."""

import socket
import sys
import threading

import numpy as np
import pytest
from nv200_on_emulator import amplifier

from dehyst._errors import DeviceError, LinkError, MissingExtraError, RigError
from dehyst.instruments import open_rig
from dehyst.instruments.jena import JenaRig
from dehyst.waveforms import Excitation


def test_without_the_library_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "nv200", None)
    for name in ("nv200.serial_protocol", "nv200.telnet_protocol"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingExtraError, match=r"3\.12 and 3\.13.*dehyst\[jena\]"):
        open_rig("jena://192.0.2.1")
    with pytest.raises(RigError, match="jena:///dev/ttyUSB0"):
        open_rig("jena://")


def test_what_it_says_of_itself():
    with amplifier(sr="0.5") as device, open_rig(f"jena://{device.port}", limits=(-10, 60)) as rig:
        assert rig.name == "NV200/D with PA 16 SG #1234 (not tried on hardware)"
        # 0.5 % of 120 V in a millisecond.
        assert (rig.limits.low, rig.limits.high, rig.slew_rate) == (-10, 60, pytest.approx(600))
        assert 1 < rig.nearest_rate(1e6) == rig.nearest_rate(1e5) < 1e4
        assert rig.nearest_rate(1.0) == 1.0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"acmeasure": "0"}, "no position sensor"),
        ({"cl": "1"}, "its loop is closed"),
        ({"modsrc": "3"}, "comes from elsewhere"),
        ({"unitcl": "mrad"}, "the unit 'mrad'"),
        ({"avmax": "much"}, "got 'much' to 'avmax'"),
    ],
)
def test_an_amplifier_that_cannot_be_used_is_refused(settings, message):
    with amplifier(**settings) as device, pytest.raises(RigError, match=message):
        open_rig(f"jena://{device.port}")
    assert device.bench.axis.log.largest_step == 0


@pytest.mark.parametrize("unit", ["um", "\xb5m", "μm".encode().decode("latin1"), "µm".encode().decode("latin1")])
def test_micrometres_however_they_are_written(unit):
    with amplifier(unitcl=unit) as device, open_rig(f"jena://{device.port}") as rig:
        assert rig.set_voltage(50.0) == 50.0
        assert 1e-6 < rig.read().displacement < 2e-5


@pytest.mark.parametrize(
    ("spoil", "kind"),
    [
        (lambda _: "error,8", DeviceError),
        (lambda _: "something else", LinkError),
        (lambda _: None, LinkError),
    ],
    ids=["refused", "another answer", "no answer"],
)
def test_a_failure_in_a_wave_brings_the_voltage_back(spoil, kind):
    with amplifier() as device, open_rig(f"jena://{device.port}") as rig:
        spoiled = []

        def spoiling(command, answer):
            if command.startswith("set,2") and not spoiled:
                spoiled.append(command)
                return spoil(answer)
            return answer

        device.spoil = spoiling
        with pytest.raises(kind) as caught:
            rig.play(Excitation("up", np.linspace(0, 50, 26), rig.nearest_rate(100)))
        assert spoiled
        assert caught.value.__notes__ == ["The voltage was brought to 0 V."]
        assert device.bench.axis.voltage == 0


def test_over_ethernet():
    with amplifier() as device, socket.create_server(("127.0.0.1", 0)) as server:
        from nv200.telnet_protocol import TelnetProtocol

        def serve():
            connection, _ = server.accept()
            with connection:
                device.serve(connection.fileno())

        threading.Thread(target=serve, daemon=True).start()
        # The emulator has no Ethernet module whose flow control could be set.
        transport = TelnetProtocol(host="127.0.0.1", port=server.getsockname()[1])
        with JenaRig(transport, limits=(0, 50), adjust=False) as rig:
            assert rig.set_voltage(5.0) == 5.0
            assert rig.read().voltage == pytest.approx(5.0)


def test_nothing_answers():
    pytest.importorskip("nv200")
    with pytest.raises(LinkError, match="its connection failed"):
        open_rig("jena:///dev/no-such-port")
