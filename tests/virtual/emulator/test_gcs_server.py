"""The emulated controller over real sockets: framing, one client, rough treatment, and somebody else's client."""

import os
import re
import socket
import subprocess
import sys
import time
from contextlib import contextmanager, suppress

import numpy as np
import places
import pytest
from emulator import Controller, Fault, Rehearsal, Server
from emulator.faults import actual_limits

from dehyst._errors import ModelError
from dehyst.virtual import PlayActuator, VirtualBench

SOON = 60.0


class Line:
    """A connection that reads answers line by line."""

    def __init__(self, port):
        self.link = socket.create_connection(("127.0.0.1", port), timeout=SOON)
        self.link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.file = self.link.makefile("rb")

    def send(self, text):
        self.link.sendall(text if isinstance(text, bytes) else f"{text}\n".encode())

    def ask(self, text):
        self.send(text)
        lines = [self.file.readline()]
        while lines[-1].endswith(b" \n"):
            lines.append(self.file.readline())
        return b"".join(lines).decode("latin-1")

    def close(self):
        self.file.close()
        self.link.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()


@contextmanager
def served(*faults, speed=1.0, limits=(0.0, 120.0), **options):
    rehearsed = [Fault.parse(fault) for fault in faults]
    bench = VirtualBench(PlayActuator(plays=20), limits=actual_limits(limits, rehearsed), speed=speed, **options)
    with Server(Controller(bench, reported_limits=limits), port=0, rehearsal=Rehearsal(rehearsed)) as server:
        yield server


def connect(server):
    """A connection that is answered: one that was just left may not be free yet."""
    end = time.monotonic() + SOON
    while True:
        line = Line(server.port)
        with suppress(OSError):
            if line.ask("CSV?") == "2.0\n":
                return line
        line.close()
        assert time.monotonic() < end, "no connection was taken"


def gone(line):
    """Whether the other side closes the connection."""
    try:
        return line.link.recv(1) == b""
    except ConnectionError:
        return True


def start_wave(line, size=2000, divider=20):
    values = " ".join(f"{v:.4f}" for v in np.linspace(0, 100, size))
    for command in (f"WAV 1 X PNT 1 {size} {values}", "WSL 1 1", "WGC 1 1", f"WTR 1 {divider} 0", f"RTR {divider}"):
        line.send(command)
    assert line.ask("ERR?") == "0\n"
    line.send("WGO 1 1")


def test_it_sets_a_voltage_and_reads_it_and_the_position():
    with served() as server, connect(server) as line:
        line.send("SVA 1 50")
        assert line.ask("VOL? 1") == "1=50\n"
        assert 1 < float(line.ask("POS? 1").split("=")[1]) < 8
        assert server.controller.instrument.axis.log.highest == 50


def test_lines_come_in_pieces_together_with_any_end_and_with_single_bytes_between():
    with served() as server, connect(server) as line:
        line.send(b"SVA 1 ")
        time.sleep(0.05)
        line.send(b"7\r\nVOL? 1\r\n")
        assert line.file.readline() == b"1=7\n"
        line.send(b"SVA 1 8\nVOL? 1\n\x05VOL? 1\n\x07\x09")
        assert [line.file.readline() for _ in range(5)] == [b"1=8\n", b"0\n", b"1=8\n", b"\xb1\n", b"0\n"]


def test_a_second_client_is_turned_away_at_once_and_the_first_is_undisturbed():
    with served() as server, connect(server) as line:
        for _ in range(5):
            with Line(server.port) as second:
                assert gone(second)
            assert line.ask("ERR?") == "0\n"


def test_the_next_client_is_taken_when_the_first_has_gone_and_finds_things_as_they_were():
    with served() as server:
        with connect(server) as line:
            line.send("SVA 1 30")
            assert line.ask("ERR?") == "0\n"
            line.send(b"SVA 1 10")  # a line that never ends
        with connect(server) as line:
            assert line.ask("VOL?") == "1=30\n"


def test_a_wave_goes_on_when_its_client_has_gone():
    with served() as server:
        with connect(server) as line:
            start_wave(line, size=200)
        time.sleep(0.3)
        with connect(server) as line:
            assert line.ask("DRL? 1") == "1=200\n"


def struck(*faults, wait=0.3):
    """Play a wave through a fault; the server and its client, after it came."""

    @contextmanager
    def scene():
        with served(*faults) as server, connect(server) as line:
            start_wave(line)
            end = time.monotonic() + SOON
            while not server.rehearsal.occurred and time.monotonic() < end:
                time.sleep(0.01)
            yield server, line

    return scene()


def test_drop_loses_the_connection_in_mid_wave_and_takes_the_next():
    with struck("drop@300") as (server, line):
        assert gone(line)
        with connect(server) as again:
            assert 300 <= int(again.ask("DRL? 1").split("=")[1]) < 2000


def test_refuse_takes_no_more_connections():
    with struck("refuse@100") as (server, line):
        assert gone(line)
        with pytest.raises(ConnectionError):
            Line(server.port)


def test_silence_answers_no_more():
    with struck("silence@100") as (_, line):
        line.link.settimeout(0.3)
        with pytest.raises(TimeoutError):
            line.ask("ERR?")


def test_one_answer_is_cut_off_or_garbled_and_then_all_is_well():
    with struck("truncate@100") as (_, line):
        line.send("*IDN?")
        line.send("CSV?")
        assert re.fullmatch(rb"dehyst,[^\n]*2\.0\n", line.file.readline())
    with struck("garble@100") as (_, line):
        line.send("*IDN?")
        line.send("STP")
        line.send("CSV?")
        came = b""
        while not came.endswith(b"2.0\n"):
            came += line.file.readline()
        assert not came.startswith(b"dehyst,emulated piezo controller,")


def test_error_stops_the_wave_and_is_latched():
    with struck("error@100") as (_, line):
        assert line.ask("WGO?") == "1=0\n"
        assert line.ask("ERR?") == "215\n"


def test_narrow_tells_wider_limits_than_it_has():
    with served("narrow") as server, connect(server) as line:
        assert line.ask("VMA?") == "1=120\n"
        line.send("SVA 1 100")
        assert line.ask("ERR?") == "302\n"
        assert server.controller.instrument.axis.log.highest == 0


def test_the_sensor_saturates_or_is_unplugged():
    with struck("saturate@500") as (server, line):
        time.sleep(0.5)
        first = line.ask("POS?")
        time.sleep(0.2)
        assert line.ask("POS?") == first
    with served("unplug@0.1s") as server, connect(server) as line:
        line.send("SVA 1 100")
        time.sleep(0.3)
        assert server.rehearsal.occurred == ["unplug: the sensor is unplugged"]
        assert line.ask("POS?") == "1=0\n"


def test_stall_leaves_the_generator_hanging():
    with struck("stall@100") as (_, line):
        before = line.ask("DRL? 1")
        time.sleep(0.2)
        assert line.ask("DRL? 1") == before
        assert line.ask("WGO?") == "1=1\n"


@pytest.mark.parametrize("text", ["nose", "drop@", "drop@x", "narrow@5", "drop@5m", "@5", "", "drop@-1"])
def test_a_fault_that_is_none_is_refused(text):
    with pytest.raises(ModelError, match=rf"fault: got '{re.escape(text)}', need NAME, NAME@SAMPLES"):
        Fault.parse(text)


def test_a_fault_comes_in_the_middle_of_the_first_wave_unless_told():
    assert Fault.parse("drop@2.5s") == Fault("drop", seconds=2.5)
    assert Fault.parse("drop@250") == Fault("drop", samples=250)
    with struck("drop") as (server, _):
        assert 1000 <= server.controller.instrument.recorded < 1500


@contextmanager
def command(*options):
    """The emulator as a process, and its port."""
    process = subprocess.Popen(
        [sys.executable, places.SUPPORT / "serve_emulator.py", "--port", "0", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    try:
        ready = process.stdout.readline()
        found = re.fullmatch(r"serving \S+, .* V, on pi://127\.0\.0\.1:(\d+)\n", ready)
        assert found, ready
        yield process, int(found[1])
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def test_somebody_elses_client_identifies_sets_and_reads():
    pyvisa = pytest.importorskip("pyvisa")
    pytest.importorskip("pyvisa_py")
    instruments = pytest.importorskip("pymeasure.instruments")

    def value(got):
        return float(str(got).split("=")[1])

    class Piezo(instruments.Instrument):
        voltage = instruments.Instrument.control("VOL? 1", "SVA 1 %g", "voltage", get_process=value)
        position = instruments.Instrument.measurement("POS? 1", "position", get_process=value)

        def __init__(self, address):
            super().__init__(
                address,
                "emulated piezo",
                includeSCPI=False,
                visa_library="@py",
                read_termination="\n",
                write_termination="\n",
                timeout=3000,
            )

    assert pyvisa.__version__
    with served() as server:
        piezo = Piezo(f"TCPIP::127.0.0.1::{server.port}::SOCKET")
        assert piezo.ask("*IDN?").startswith("dehyst,emulated piezo controller")
        before = piezo.position
        piezo.voltage = 42.5
        assert piezo.voltage == 42.5
        assert piezo.position > before + 1
        piezo.adapter.close()
