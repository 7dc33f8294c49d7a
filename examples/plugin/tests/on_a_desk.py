"""What the plug-ins are tested on: a device that speaks the lines of the rig, and an interpreter of Structured Text."""

import re
import socketserver
import threading
from contextlib import contextmanager

import numpy as np
from dehyst_example.line_rig import LineRig

from dehyst.testing import FakeInstrument

BATCH = 50


class Desk(socketserver.ThreadingTCPServer):
    """The device, whose time passes when a wave plays, or when the rig waits."""

    daemon_threads = allow_reuse_address = True

    def __init__(self):
        super().__init__(("127.0.0.1", 0), Lines)
        self.instrument, self.wave, self.rate = FakeInstrument(), [], 1.0

    def answer(self, word, *numbers):
        instrument = self.instrument
        if word == "LIMITS":
            return "{} {}".format(*instrument.limits)
        if word == "READ":
            v = instrument.voltage
            return f"{instrument.now!r} {v!r} {float(instrument.displacement(np.array(v)))!r}"
        if word == "NEXT":
            return self.played() if self.wave else "end"
        if word == "PUT":
            instrument.put(numbers[0])
        elif word == "WAVE":
            self.rate, *self.wave = numbers
        elif word == "HALT":
            self.wave = []
        instrument.playing = bool(self.wave)
        return "ok"

    def played(self):
        answers, self.wave, rest = [], self.wave[:BATCH], self.wave[BATCH:]
        for v in self.wave:
            self.instrument.put(v)
            self.instrument.wait(1 / self.rate)
            answers.append(self.answer("READ"))
        self.wave, self.instrument.playing = rest, bool(rest)
        return " ".join(answers)


class Lines(socketserver.StreamRequestHandler):
    def handle(self):
        for line in self.rfile:
            word, *numbers = line.decode().split()
            try:
                answer = self.server.answer(word, *map(float, numbers))
            except Exception as error:
                answer = f"ERROR {error}"
            self.wfile.write(f"{answer}\n".encode())


@contextmanager
def desk(longest=None, **options):
    """Yield the rig, connected to a device, and the instrument in it."""
    with Desk() as device:
        threading.Thread(target=device.serve_forever, args=(0.01,), daemon=True).start()
        with LineRig("{}:{}".format(*device.server_address), **options) as rig:
            rig._wait = device.instrument.wait
            rig.longest = longest or rig.longest
            yield rig, device.instrument
        device.shutdown()


def run_block(path, wanted):
    """Return the voltages of a function block, read as Python."""
    declared, body = re.split(r"\n(?=low := )", path.read_text())
    memory = {"MAX": max, "MIN": min, "LIMIT": lambda low, value, high: min(max(low, value), high), "wanted": 0.0}
    for name, value in re.findall(r"(\w+) : [^;]*?:= ([^;]+);", declared):
        memory[name] = [None, *eval(value)] if value.startswith("[") else eval(value)
    body = re.sub(r"\(\*.*?\*\)|END_\w+;?|;", "", body)
    body = re.sub(r"FOR (\w+) := (.+) TO (.+) DO", r"for \1 in range(\2, \3 + 1):", body)
    body = re.sub(r"IF (.+) THEN", r"if \1:", body).replace(" k = 0 ", " k == 0 ")
    for st, python in {":=": "=", "ELSE": "else:", "EXIT": "break", " AND ": " and ", " OR ": " or "}.items():
        body = body.replace(st, python)
    code, voltages = compile(body, path, "exec"), []
    for memory["wanted"] in wanted.tolist():
        exec(code, memory)
        voltages.append(memory["voltage"])
    return np.array(voltages)
