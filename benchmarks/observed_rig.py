"""An emulated controller whose every voltage is logged with its time, and a rig process that drives it over TCP."""

import contextlib
import json
import os
import queue
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from dehyst import DehystError, read
from dehyst.records import write_columns
from dehyst.records.recording import salvage
from dehyst.virtual import PlayActuator, VirtualBench
from dehyst.virtual.emulator import Controller, Fault, Rehearsal, Server

LIMITS, SLEW = (0.0, 100.0), 100.0
# The wave: a triangle between these voltages [V], a little less steep than allowed, of so many samples a second.
LOWEST, HIGHEST, STEEPNESS, RATE, SECONDS = 10.0, 90.0, 90.0, 1000.0, 9.0
ORIGIN = "http://127.0.0.1:8123"
# Seconds after which something hangs, on however busy a machine; and between two signs of life.
PATIENCE, ALIVE = 60.0, 0.1
# Seconds of a step of a ramp.
_STEP = 0.01


class ObservedController:
    """An emulator in this process, and the log of its amplifier: the device's word, not the rig's.

    `faults`: as `dehyst rig serve --fault`.
    """

    def __init__(self, *faults: str) -> None:
        self._bench = VirtualBench(PlayActuator(highest=200.0), limits=(0.0, 200.0))
        self._began = time.monotonic() - self._bench.now
        self._log: list[tuple[np.ndarray, np.ndarray]] = []
        self._lock = threading.Lock()
        self._controller = Controller(self._bench)
        self._rehearsal = Rehearsal(map(Fault.parse, faults), report=lambda _: self._struck())
        self._server = Server(self._controller, port=0, lock=self._lock, rehearsal=self._rehearsal)
        self.struck_at: float | None = None
        axis = self._bench.axis
        put_out = axis._put_out

        def logged(voltage: np.ndarray, at: np.ndarray) -> None:
            put_out(voltage, at)
            self._log.append((np.array(at), np.array(voltage)))

        axis._put_out = logged
        self._late: list[tuple[float, float]] = []
        self._probing = True
        threading.Thread(target=self._probe, daemon=True).start()

    def _probe(self) -> None:
        """Note by how much a sleep as long as a step of a ramp is late: what the machine takes from every process."""
        while self._probing:
            began = time.monotonic()
            time.sleep(_STEP)
            ended = time.monotonic()
            self._late.append((ended, ended - began - _STEP))

    def lateness(self, begin: float, end: float) -> float:
        """Return by how much the machine was late between two times, in all [s]."""
        return sum(late for at, late in self._late if begin <= at <= end)

    def _struck(self) -> None:
        self.struck_at = time.monotonic()

    def __enter__(self) -> "ObservedController":
        self._server.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._probing = False
        self._server.__exit__(None, None, None)

    @property
    def address(self) -> str:
        """The address of the controller."""
        return f"pi://127.0.0.1:{self._server.port}"

    @property
    def identity(self) -> str:
        """Its answer to the question who it is."""
        return self._controller.identity

    @property
    def told(self) -> int:
        """Number of samples that it has delivered."""
        return self._controller.rows_sent

    @property
    def voltage(self) -> float:
        """The present output [V]."""
        with self._lock:
            return self._bench.axis.voltage

    @property
    def steepest(self) -> float:
        """Largest change of the voltage over the time between the two voltages [V/s]."""
        return self._bench.axis.log.steepest

    def put_out(self) -> tuple[np.ndarray, np.ndarray]:
        """Return times (n,) [s of time.monotonic] and voltages (n,) [V] until now."""
        with self._lock:
            self._bench.advance()
            if not self._log:
                return np.array([self._began]), np.array([0.0])
            at, voltage = (np.concatenate(columns) for columns in zip(*self._log, strict=True))
        return self._began + at, voltage

    def forget(self) -> None:
        """Forget what was put out until now."""
        with self._lock:
            self._log.clear()
        self._late.clear()

    def wait_for(self, condition: Callable[[], bool], seconds: float = PATIENCE) -> bool:
        """Wait for a condition; return whether it came in time."""
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                return False
            time.sleep(0.005)
        return True

    def rises_through(self, level: float) -> bool:
        """Whether a wave is under way, and has just risen through this voltage [V]."""
        _, voltage = self.put_out()
        return voltage.size > 300 and voltage[-1] > level > voltage[-100] and voltage[-1] > voltage[-20]

    def rests(self, seconds: float = 0.5) -> bool:
        """Whether the voltage has been constant for this time."""
        times, voltage = self.put_out()
        recent = voltage[times > time.monotonic() - seconds]
        return bool(np.all(recent == voltage[-1]))

    def safe_at(self) -> float | None:
        """When the voltage became 0 V for good [s of time.monotonic]; None if it is not."""
        times, voltage = self.put_out()
        away = np.flatnonzero(np.abs(voltage) > 1e-9)
        if not away.size:
            return float(times[0])
        return None if away[-1] + 1 >= voltage.size else float(times[away[-1] + 1])


class RigHolder:
    """A rig process, and what it sends; `parent` puts a server's stand-in between, in a process group of its own."""

    def __init__(self, folder: Path, *, parent: bool = False) -> None:
        self.folder, self.messages, self.state = folder, [], {}
        self._arrived: queue.SimpleQueue = queue.SimpleQueue()
        self._alive, self._deaf, self._parent = threading.Event(), threading.Event(), parent
        module = (
            [str(Path(__file__).resolve().parents[1] / "tests" / "support" / "rig_parent.py")]
            if parent
            else ["-m", "dehyst.workbench.rig.process"]
        )
        options = {"process_group": 0} if parent else {"start_new_session": True}
        self.process = subprocess.Popen(
            [sys.executable, *module], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options
        )
        self.errors = b""
        self.pid, self.stop = self.process.pid, {"port": None, "key": secrets.token_urlsafe(32)}
        threading.Thread(target=self._drain, daemon=True).start()
        if not parent:
            self.send(stop_key=self.stop["key"], origins=[ORIGIN])
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self.until(lambda: self.stop["port"] is not None)
        threading.Thread(target=self._live, daemon=True).start()

    def send(self, **message: object) -> None:
        """Send a message."""
        self.raw(json.dumps(message).encode() + b"\n")

    def raw(self, data: bytes) -> None:
        """Send bytes."""
        with contextlib.suppress(OSError, ValueError):
            self.process.stdin.write(data)
            self.process.stdin.flush()

    def alive(self, on: bool) -> None:
        """Let signs of life come, or not."""
        (self._alive.set if on else self._alive.clear)()

    def deafen(self) -> None:
        """Read no more messages; the next one comes soon, if only as a sign of life."""
        self._deaf.set()
        self._reader.join()

    def until(self, condition: Callable[[], bool], seconds: float = PATIENCE) -> None:
        """Take messages until the condition holds; raise if it does not in time."""
        end = time.monotonic() + seconds
        while not condition():
            try:
                self._take(self._arrived.get(timeout=0.02))
            except queue.Empty:
                if time.monotonic() > end:
                    raise TimeoutError(f"{self.state}, {self.messages[-5:]}, {self.errors.decode()}") from None

    def settle(self) -> None:
        """Take what has arrived."""
        with contextlib.suppress(queue.Empty):
            while True:
                self._take(self._arrived.get_nowait())

    def errors_sent(self) -> list[str]:
        """Return the errors that were sent."""
        self.settle()
        return [one["error"] for one in self.messages if one["kind"] == "error"]

    def connect(self, address: str, slew: float = SLEW) -> None:
        """Connect a rig."""
        self.send(do="connect", address=address, limits=LIMITS, slew=slew)
        self.until(lambda: self.state.get("status") in ("connected", "none") and "limits" in self.state)

    def arm(self) -> None:
        """Let signs of life come, and arm."""
        self.alive(True)
        self.send(do="arm", **{name: self.state[name] for name in ("identity", "limits", "slew")})
        self.until(lambda: self.state["status"] == "armed")

    def play(self, name: str = "wave") -> None:
        """Play the triangle."""
        self.send(do="play", file=str(triangle(self.folder)), record=str(self.folder / f"{name}.h5"))
        self.until(lambda: self.state["status"] == "playing")

    def gone(self) -> bool:
        """Whether the rig's process has ended."""
        if not self._parent:
            return self.process.poll() is not None
        with contextlib.suppress(OSError):
            return Path(f"/proc/{self.pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
        return True

    def press(self, **change: str) -> int:
        """Press the emergency stop; return the status of the answer."""
        headers = {"Host": f"127.0.0.1:{self.stop['port']}", "Origin": ORIGIN, "X-Dehyst-Stop": self.stop["key"]}
        headers |= change
        return asked(self.stop["port"], "POST /stop HTTP/1.1", headers)[0]

    def end(self) -> None:
        """End all processes."""
        self.alive(False)
        for number in (signal.SIGCONT, signal.SIGKILL):
            with contextlib.suppress(ProcessLookupError):
                self.process.send_signal(number)
        if self._parent:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
        self.process.wait(PATIENCE)

    def _take(self, message: dict) -> None:
        if message["kind"] == "parent":
            self.pid, self.stop = message["pid"], message["stop"]
            return
        self.messages.append(message)
        if message["kind"] == "rig":
            if not self._parent and "stop" in message:
                self.stop["port"] = message["stop"]["port"]
            self.state.update(message)

    def _live(self) -> None:
        while self.process.poll() is None:
            time.sleep(ALIVE)
            if self._alive.is_set():
                self.send(alive=True)

    def _read(self) -> None:
        for line in self.process.stdout:
            self._arrived.put(json.loads(line))
            if self._deaf.is_set():
                return

    def _drain(self) -> None:
        for line in self.process.stderr:
            self.errors += line


@contextlib.contextmanager
def held(folder: Path, **options: bool) -> Iterator[RigHolder]:
    """Hold a rig process; end it whatever happens."""
    holder = RigHolder(folder, **options)
    try:
        yield holder
    finally:
        holder.end()


def triangle(folder: Path, seconds: float = SECONDS, highest: float = HIGHEST) -> Path:
    """Return the file of a triangle that lasts so long."""
    path = folder / f"triangle-{seconds:g}-{highest:g}.csv"
    if not path.exists():
        time_ = np.arange(round(seconds * RATE) + 1) / RATE
        period = 2 * (highest - LOWEST) / STEEPNESS
        phase = np.abs((time_ / period + 0.5) % 1.0 - 0.5) * 2
        write_columns(path, {"time_s": time_, "voltage_V": LOWEST + (highest - LOWEST) * phase})
    return path


def on_disk(folder: Path, name: str = "wave") -> int:
    """Count the samples of a record, complete or not, or in the journal of a killed process."""
    copy = folder / "looked-at"
    shutil.rmtree(copy, ignore_errors=True)
    copy.mkdir()
    for path in folder.glob(f"{name}.h5*"):
        shutil.copy(path, copy)
    salvage(copy)
    total = 0
    for path in copy.iterdir():
        with contextlib.suppress(DehystError):
            total += len(read(path))
    return total


def asked(port: int, first: str, headers: dict[str, str], seconds: float = 5.0) -> tuple[int, str]:
    """Send a request; return status and answer, 0 and nothing if there is none."""
    text = "\r\n".join([first, *(f"{name}: {value}" for name, value in headers.items()), "", ""])
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), seconds) as link:
        link.sendall(text.encode())
        answer = b""
        while data := link.recv(65536):
            answer += data
        return int(answer.split()[1]), answer.decode()
    return 0, ""


def children(parent: int, module: str) -> list[int]:
    """Return the processes that `parent` started and that run this Python module."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            begun = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            if begun == parent and module in (entry / "cmdline").read_bytes().decode("utf-8", "replace").split("\0"):
                found.append(int(entry.name))
    return found
