"""An NV200/D that answers as the maker's library `nv200` expects, at the other end of a pseudo-terminal."""

import os
import pty
import runpy
import threading
import tty
from contextlib import contextmanager

import places
import pytest
from pi_on_emulator import Locked

from dehyst.virtual import PlayActuator, VirtualBench

LOW, HIGH = -20.0, 100.0
XOFF, XON = "\x13", "\x11"
# Source of the recorder's samples: `recsrc`.
POSITION, VOLTAGE = "0", "2"


class Amplifier:
    """The amplifier; `settings`: answers to queries; `spoil` may change an answer."""

    def __init__(self, bench):
        self.bench, self.lock, self.spoil = bench, threading.Lock(), lambda _, answer: answer
        low, high = bench.axis.limits
        self.settings = {"desc": "PA 16 SG", "acserno": "1234", "acmeasure": "1", "cl": "0", "modsrc": "0"}
        self.settings |= {"avmin": f"{low:.3f}", "avmax": f"{high:.3f}", "sr": "2000.0", "unitcl": "\xb5m  "}
        self.sources, self.recorded = ["", ""], [0.0, 0.0]
        self.master, slave = pty.openpty()
        tty.setraw(slave)
        self.port, self.slave = os.ttyname(slave), slave

    def serve(self, link):
        """Answer the lines of a terminal or socket until it is closed."""
        left = b""
        while True:
            try:
                received = os.read(link, 4096)
            except OSError:
                return
            if not received:
                return
            left += received
            *lines, left = left.split(b"\r\n")
            for line in lines:
                command = line.decode("latin1")
                with self.lock:
                    answer = self.spoil(command, self.answer(*command.split(",")))
                if answer is not None:
                    os.write(link, f"{XOFF}{answer}\r\n{XON}".encode("latin1"))

    def answer(self, name, *given):
        axis = self.bench.axis
        if not name:
            return "NV200/D_NET>"
        if name == "set":
            return "" if axis.set_voltage(float(given[0])) else "error,4"
        if name == "recsrc" and len(given) == 2:
            self.sources[int(given[0])] = given[1]
        elif name == "recrun":
            seen = {POSITION: 1e6 * axis.displacement(), VOLTAGE: axis.voltage}
            self.recorded = [seen.get(source, 0.0) for source in self.sources]
        elif name == "recout":
            return f"recout,{given[0]},{given[1]},{self.recorded[int(given[0])]:.6f}"
        elif name in self.settings and not given:
            return f"{name},{self.settings[name]}"
        elif name not in ("recast", "recstr", "reclen"):
            return "error,2"
        return ""

    def close(self):
        os.close(self.slave)
        os.close(self.master)


@contextmanager
def amplifier(**settings):
    """Serve an amplifier with some given settings."""
    pytest.importorskip("nv200", reason="nv200 is not installed, which needs Python 3.12: no amplifier can be used")
    bench = VirtualBench(PlayActuator(highest=HIGH, noise=1e-10), limits=(LOW, HIGH))
    device = Amplifier(bench)
    device.settings |= settings
    threading.Thread(target=device.serve, args=(device.master,), daemon=True).start()
    try:
        yield device
    finally:
        device.close()


def rig_of(device, **options):
    """Open the rig in `examples/instruments` at the port of an amplifier."""
    make = runpy.run_path(str(places.EXAMPLES / "instruments" / "jena.py"))["JenaRig"]
    make.__init__.__globals__["ADDRESS"] = device.port
    return make(**options)


@contextmanager
def by_library(longest=None, **options):
    """Open the rig, whose waves have any length, by the maker's library."""
    with amplifier() as device, rig_of(device, **options) as rig:
        yield rig, Locked(device.bench, device.lock)
