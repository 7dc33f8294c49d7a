"""Real EPICS controllers for tests, each a process with its own port on the loopback interface.

The tests' own Channel Access looks at these ports only: no test disturbs another, or the network.
"""

import atexit
import json
import os
import socket
import subprocess
import sys
from contextlib import ExitStack, suppress

import places

PREFIX = "BENCH:"
_PROGRAM = """
import json, sys, threading
sys.path.insert(0, sys.argv[3])
from dehyst import VoltageLimits
from dehyst.virtual import PlayActuator, VirtualBench
from emulator.epics_ioc import serve_ioc
prefix, options = sys.argv[1], json.loads(sys.argv[2])
truth = PlayActuator(**{"noise": 0.0, **options.pop("actuator", {})})
instrument, lock = VirtualBench(truth, **options), threading.Lock()
serve_ioc(instrument, prefix, lock)

print("ready", flush=True)
for line in sys.stdin:
    with lock:
        answer = None
        exec(line)
        print(json.dumps({"answer": answer, "log": vars(instrument.axis.log)}), flush=True)
"""


# Tests may run in several processes at once: each process takes the ports with another remainder.
_WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
_WORKERS = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))


def _free_ports(count):
    """Ports that are free for UDP and TCP; each stays open until all are found, so that none occurs twice."""
    ports = []
    with ExitStack() as held:
        while len(ports) < count:
            tcp = held.enter_context(socket.create_server(("127.0.0.1", 0)))
            udp, port = held.enter_context(socket.socket(type=socket.SOCK_DGRAM)), tcp.getsockname()[1]
            # Linux gives only ports of one parity to a program that asks for any port.
            if port // 2 % _WORKERS == _WORKER:
                with suppress(OSError):
                    udp.bind(("127.0.0.1", port))
                    ports.append(port)
    return ports


# Channel Access reads its addresses once in a process, so all ports are chosen before the first use.
_PORTS = _free_ports(64)
ENVIRONMENT = {
    "EPICS_CA_ADDR_LIST": " ".join(f"127.0.0.1:{port}" for port in _PORTS[1:]),
    "EPICS_CA_AUTO_ADDR_LIST": "NO",
    "EPICS_CA_REPEATER_PORT": str(_PORTS[0]),
    "EPICS_CAS_INTF_ADDR_LIST": "127.0.0.1",
    "EPICS_CAS_BEACON_ADDR_LIST": "127.0.0.1",
    "EPICS_CAS_AUTO_BEACON_ADDR_LIST": "NO",
}
os.environ.update(ENVIRONMENT)
_left = _PORTS[1:]


def port():
    """A port for a server that the tests' Channel Access searches."""
    return _left.pop(0)


class IocProcess:
    """An IOC with a virtual instrument and its options; ``actuator=``: options of a play actuator."""

    def __init__(self, at=None, **options):
        self.port = port() if at is None else at
        self.prefix = f"{PREFIX}{self.port}"
        self.process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM, self.prefix, json.dumps(options), str(places.SUPPORT)],
            env={**os.environ, "EPICS_CAS_SERVER_PORT": str(self.port)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        atexit.register(self.kill)
        said = self._line("ready")
        assert said == "ready", self.process.stderr.read()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.kill()

    def do(self, statement):
        """Run code with the `instrument`, unseen by its clients; return the `answer`, and the log."""
        self.process.stdin.write(f"{statement}\n")
        self.process.stdin.flush()
        reply = json.loads(self._line("{"))
        return reply["answer"], reply["log"]

    def log(self):
        """The log of all output of the instrument, as a mapping."""
        return self.do("pass")[1]

    def kill(self):
        """End the process at once, if it has not ended."""
        atexit.unregister(self.kill)
        self.process.kill()
        self.process.wait()
        for stream in (self.process.stdin, self.process.stdout, self.process.stderr):
            stream.close()

    def _line(self, start):
        """The next line with this beginning; EPICS prints other lines too."""
        for line in self.process.stdout:
            if line.startswith(start):
                return line.strip()
        return ""
