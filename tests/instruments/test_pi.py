"""The PI rig on a fake controller in this process, odd ones too, and on those who are no controller."""

import re
import socket
import threading
import time
import warnings

import numpy as np
import pytest
from emulator import Controller
from fake_gcs import WAVES, FakeController
from faulty_link import PipeLink, QuickRig

from dehyst.instruments import DeviceError, LinkError, RigError
from dehyst.instruments.gcs_client import TcpLink
from dehyst.instruments.pi import PiRig
from dehyst.waveforms import Excitation


def quick(controller, **options):
    return QuickRig(PipeLink(controller), **options)


def triangle(low=0.0, high=80.0, count=401, rate=1000.0):
    half = np.linspace(low, high, count // 2 + 1)
    return Excitation("triangle", np.concatenate([half, half[-2::-1]]), rate)


def test_the_rig_reports_its_controller():
    controller = FakeController()
    rig = quick(controller, limits=(-5.0, 500.0), slew_rate=2000.0)
    assert rig.name == f"{controller.identity} at pipe:1"
    assert (rig.limits.low, rig.limits.high, rig.slew_rate, rig.axis, rig.longest) == (-5.0, 120.0, 2000.0, "1", 4096)


def test_two_readings_within_one_tick_have_two_times():
    rig = quick(FakeController())
    assert rig.read().time < rig.read().time


@pytest.mark.parametrize("rate", [20000.0, 12345.0, 999.9, 1.0])
def test_the_rate_is_the_nearest_divisor_of_the_servo_rate(rate):
    rig = quick(FakeController())
    near = rig.nearest_rate(rate)
    divider = round(20000 / near)
    assert near == pytest.approx(20000 / divider, rel=1e-12)
    for other in (max(1, divider - 1), divider + 1):
        assert abs(near - rate) <= abs(20000 / other - rate) + 1e-9


@pytest.mark.parametrize("send", [lambda rig: rig.set_voltage(1.0), lambda rig: rig.play(triangle())])
def test_the_first_voltage_switches_the_servo_off_with_a_warning(send):
    controller = FakeController()
    controller.bench.axis.servo = True
    rig = quick(controller)
    rig.read()
    assert controller.bench.axis.servo
    with pytest.warns(UserWarning, match="switched"):
        send(rig)
    assert not controller.bench.axis.servo


def test_a_servo_that_stays_on_is_reported():
    controller = FakeController(told={"SVO?": ["1=1"]})
    with pytest.warns(UserWarning, match="was on"), pytest.raises(DeviceError, match="does not go off"):
        quick(controller).set_voltage(1.0)
    assert not [line for line in controller.lines if line.startswith("SVA")]


@pytest.mark.parametrize("lacking", [["WAV"], ["DRR?"], ["HDR?"], WAVES])
def test_without_a_wave_generator_or_recorder_the_host_plays(lacking):
    # In real time: the host takes its times from its own clock.
    controller = FakeController(without=lacking, clock=time.monotonic)
    with pytest.warns(UserWarning, match=f"lacks the commands .*{lacking[0].replace('?', '.')}.*slowly"):
        rig = PiRig(PipeLink(controller), slew_rate=4000.0)
    assert rig.nearest_rate(1000.0) == 200.0
    record = rig.play(triangle(high=20.0, count=41, rate=200.0))
    assert (np.diff(record.time) > 0).all()
    assert record.voltage.size == 41
    assert controller.bench.axis.log.largest_step <= 40.0


@pytest.mark.parametrize(
    ("told", "why"),
    [
        ({"TNR?": ["1"]}, "recorder tables"),
        ({"HDR?": ["#RecordOptions", "2=Current Position"]}, "cannot record both"),
        ({"SPA?": None}, "does not report the parameters 0x0e000200"),
        ({"SPA?": lambda a: [f"1 {a[1]}=0"]}, "0x0e000200"),
    ],
)
def test_an_incomplete_recorder_is_not_used(told, why):
    with pytest.warns(UserWarning, match=why):
        quick(FakeController(told=told))


@pytest.mark.parametrize(
    ("told", "without", "options", "error", "why"),
    [
        ({"*IDN?": ["HTTP/1.1 400 Bad Request"]}, [], {}, LinkError, "port is 50000"),
        ({"*IDN?": ["SSH-2.0-OpenSSH_9"]}, [], {}, LinkError, "is it a GCS controller"),
        ({"*IDN?": None}, [], {}, LinkError, "got nothing in .*other client"),
        ({}, ["SVA"], {}, DeviceError, "lacks the commands SVA"),
        ({}, ["VMA?"], {}, DeviceError, "lacks the commands VMA.; give the allowed voltages"),
        ({"VMI?": ["1=200"]}, [], {}, LinkError, "need a range"),
        ({"SAI?": ["1", "2"]}, [], {}, RigError, "has the axes 1, 2; choose one"),
        ({}, [], {"axis": "7"}, RigError, "got the axis '7', it has 1"),
        ({}, [], {"limits": (200.0, 300.0)}, RigError, "limits: got 200 to 300 V"),
        ({"VOL?": ["1=nan"]}, [], {}, LinkError, "sent '\\[?.?VOL. 1.*got '1=nan'|need a finite number"),
    ],
)
def test_odd_controllers_are_refused_with_a_reason(told, without, options, error, why):
    controller = FakeController(told=told, without=without)
    with pytest.raises(error, match=why) as caught, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        quick(controller, **options).read()
    assert "pipe:1" in str(caught.value) or "limits" in str(caught.value)
    assert not [line for line in controller.lines if line.startswith("SVA")]


def test_without_limits_of_the_controller_those_of_the_user_are_used():
    rig = quick(FakeController(without=["VMI?"]), limits=(0.0, 50.0))
    assert (rig.limits.low, rig.limits.high) == (0.0, 50.0)


def test_narrower_limits_than_stated_are_a_device_error():
    controller = FakeController(limits=(-20.0, 60.0), told={"VMA?": ["1=120"]})
    rig = quick(controller)
    with pytest.raises(DeviceError, match=r"error 302: .*SVA 1") as caught:
        rig.set_voltage(100.0)
    assert caught.value.__notes__[0].safe
    assert controller.bench.axis.voltage == 0.0
    assert rig.set_voltage(10.0) == 10.0
    with pytest.raises(DeviceError, match="error"):
        rig.play(triangle(high=100.0))
    assert controller.bench.axis.log.highest <= 60.0


@pytest.mark.parametrize(
    ("playing", "error", "why"),
    [(0, DeviceError, "generator stopped; 3 of 401"), (1, LinkError, "no new sample .*3 of 401")],
)
def test_a_recorder_that_does_not_record_is_found(playing, error, why):
    controller = FakeController()
    rig = quick(controller)

    def three(tables):
        controller.bench.advance()
        return [f"{table}={min(3, controller.bench.recorded)}" for table in tables]

    def going(_):
        # Once it is looked for, and off when it has been told so.
        return [f"1={playing if controller.lines[-2] == 'DRL? 1 2' else 0}"]

    controller.told = {"DRL?": three, "WGO?": going}
    lots = []
    with pytest.raises(error, match=why):
        rig.play(triangle(), lots.append)
    assert sum(lot.time.size for lot in lots) == 3
    assert controller.bench.axis.voltage == 0.0


def test_a_wrong_sample_rate_is_a_device_error():
    controller = FakeController()
    controller.told["DRR?"] = lambda a: [
        line.rstrip().replace("# SAMPLE_TIME = 0.001", "# SAMPLE_TIME = 0.002")
        for line in Controller.answer(controller, " ".join(["DRR?", *a])).splitlines()
    ]
    with pytest.raises(DeviceError, match=r"records every 0\.002 s, need 0\.001 s"):
        quick(controller).play(triangle())


def test_a_generator_that_does_not_stop_is_reported():
    controller = FakeController(told={"WGO?": ["1=1"]})
    with pytest.raises(DeviceError, match="goes on"):
        quick(controller).retreat()


@pytest.mark.parametrize("answer", [["x!y z"], None, ["0", "1"]])
@pytest.mark.parametrize("spoilt", [("ERR?",), ("ERR?", "VOL?")])
def test_a_retreat_needs_only_the_answer_that_the_wave_has_stopped(spoilt, answer):
    controller = FakeController()
    rig = quick(controller, slew_rate=1000.0)
    rig.set_voltage(55.0)
    controller.told = dict.fromkeys(spoilt, answer)
    with pytest.raises(LinkError, match=re.escape("'ERR?'")) as caught:
        rig.set_voltage(60.0)
    (note,) = caught.value.__notes__
    assert controller.bench.axis.voltage == 0.0
    assert note.safe is ("VOL?" not in spoilt)
    assert note.safe or "0 V was sent last, and no answer confirms it" in note
    assert controller.bench.axis.log.highest <= 60.0


def test_a_stored_error_is_reported_with_its_number():
    controller = FakeController()
    rig = quick(controller)
    controller.told["ERR?"] = ["333"]
    with pytest.raises(DeviceError, match="error 333: its hardware"):
        rig.set_voltage(3.0)


def test_messages_are_short():
    controller = FakeController(told={"VOL?": ["1=" + "9" * 5000 + "x"]})
    rig = quick(controller)
    with pytest.raises(LinkError) as caught:
        rig.read()
    assert len(str(caught.value)) < 250
    assert "VOL? 1" in str(caught.value)


class Ear:
    """A server for one answer, whatever is asked."""

    def __init__(self, answer):
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        threading.Thread(target=self._serve, args=(answer,), daemon=True).start()

    def _serve(self, answer):
        while True:
            link, _ = self._server.accept()
            if answer is None:
                link.close()
                continue
            link.recv(99)
            link.sendall(answer)
            time.sleep(0.5)


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (b"", "got nothing in 0.1 s.*is it a GCS controller"),
        (None, "closed the connection|lost"),
        (b"HTTP/1.0 400 Bad Request\r\n", "port is 50000"),
        (b"\x00\x01\n", "printable ASCII"),
        (b"x" * 70000, "got b'x+.* in|too long"),
        (b"x", "got b'x' in"),
        (b"a,b \n" * 500000, "too long|printable|GCS controller"),
    ],
)
def test_other_devices_than_a_controller_are_refused(answer, why):
    ear = Ear(answer)
    with pytest.raises(LinkError, match=why) as caught:
        PiRig.connect("127.0.0.1", ear.port, timeout=0.1)
    assert f"127.0.0.1:{ear.port}" in str(caught.value)


def test_an_unreachable_controller_is_reported():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(LinkError, match=rf"127\.0\.0\.1:{port}"):
        PiRig.connect("127.0.0.1", port)
    with pytest.raises(LinkError, match=r"host 'no\.such\.host\.invalid'"):
        PiRig.connect("no.such.host.invalid", 1, timeout=1.0)
    with pytest.raises(LinkError, match="1 to 65535"):
        TcpLink("127.0.0.1", 99999)
