"""A fault rehearsed: an emulated controller and `dehyst calibrate` as two real processes, and its outcome."""

import contextlib
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from dehyst import DehystError, read

SERVE = (sys.executable, str(Path(__file__).parents[1] / "tests" / "support" / "serve_emulator.py"))
DEHYST = (sys.executable, "-c", "from dehyst.cli import main; main(prog_name='dehyst')")
# Seconds after which a command counts as hanging, also on a busy machine.
_PATIENCE = 600.0
_PROGRESS = re.compile(r"dehyst: [a-z0-9-]+: (begins|done|failed)\b")
_COUNTED = re.compile(r", ([\d ]+) samples")
_TALLY = re.compile(
    r"put out (?P<lowest>\S+) to (?P<highest>\S+) V, largest step (?P<step>\S+) V, steepest (?P<steepest>\S+) V/s, "
    r"now at (?P<now>\S+) V(, (?P<refused>\d+) requests refused)?, (?P<told>\d+) samples reported"
)


@dataclass
class PutOut:
    """The emulator's own report: voltages put out and largest step [V], the steepest [V/s], and samples reported."""

    lowest: float
    highest: float
    step: float
    steepest: float
    now: float
    refused: int
    told: int


@dataclass
class Outcome:
    """The outcome of a command.

    `said`: its standard error without progress. `seconds`: time from the fault to its end, or from its start if there
    is no time of a fault. `came`: number of samples that it reports, or that a killed command had written; None if
    unknown. `on_disk`: number of samples in its folder; `left`: its other files.
    """

    said: list[str]
    status: int
    seconds: float
    came: int | None
    on_disk: int
    put_out: PutOut | None = None
    again: "Outcome | None" = None
    left: list[str] = field(default_factory=list)


class Served:
    """The emulator on any free port; at its end it reports its output."""

    def __init__(self, *options: str) -> None:
        command = [*SERVE, "--port", "0", *options]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        self.lines: list[tuple[float, str]] = []
        self._serving = threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        if not self._serving.wait(_PATIENCE) or "pi://" not in self.lines[0][1]:
            raise RuntimeError(f"no emulator: {self.lines}")
        self.address = re.search(r"pi://\S+", self.lines[0][1])[0]

    def __enter__(self) -> "Served":
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    @property
    def struck(self) -> float | None:
        """The time of the fault [s of time.monotonic]."""
        return next((at for at, line in self.lines if line.startswith("fault: ")), None)

    def end(self) -> PutOut:
        """End the emulator, and return its report."""
        if self._process.poll() is None:
            self._process.terminate()
        self._process.wait(_PATIENCE)
        self._reader.join(_PATIENCE)
        found = _TALLY.fullmatch(self.lines[-1][1])
        told = {key: float(value or 0) for key, value in found.groupdict().items()}
        return PutOut(**{**told, "refused": int(told["refused"]), "told": int(told["told"])})

    def _read(self) -> None:
        for line in self._process.stdout:
            self.lines.append((time.monotonic(), line.strip()))
            self._serving.set()
        self._serving.set()


@dataclass(frozen=True)
class Act:
    """An action on the command while it runs: `do(process)` as soon as `when(folder)` is true."""

    do: Callable[[subprocess.Popen], None]
    when: Callable[[Path], bool]


def recording(folder: Path, size: int = 40_000) -> bool:
    """Whether a record is being written, with its last voltage above 80 V."""
    with contextlib.suppress(OSError, IndexError, ValueError):
        begun = [path for path in (folder / "records").glob("*.csv") if path.stat().st_size > size]
        return any(float(path.read_bytes()[-200:].split(b"\n")[-2].split(b",")[1]) > 80 for path in begun)
    return False


def sent(*numbers: int) -> Act:
    """Signals, one right after the other, while a record is made."""

    def do(process: subprocess.Popen) -> None:
        for number in numbers:
            process.send_signal(number)
            time.sleep(0.02)

    return Act(do, recording)


def calibrate(
    address: str,
    folder: Path,
    *options: str,
    act: Act | None = None,
    largest_file: int | None = None,
    served: Served | None = None,
    deaf: bool = False,
) -> Outcome:
    """Run `dehyst calibrate` to its end.

    `largest_file` [bytes] imitates a full disk; `deaf` closes the pipe of its output after its start.
    """
    python, flag, program = DEHYST
    if largest_file is not None:
        program = f"import resource as r; r.setrlimit(r.RLIMIT_FSIZE, ({largest_file}, {largest_file})); {program}"
    command = [python, flag, program, "calibrate", address, "-o", str(folder), *options]
    began = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    since, recorded, lines = began, 0, []
    if deaf:
        lines.append(process.stderr.readline())
        process.stderr.close()
        process.wait(_PATIENCE)
    else:
        reader = threading.Thread(target=lambda: lines.extend(process.stderr), daemon=True)
        reader.start()
        if act is not None:
            while process.poll() is None and not act.when(folder):
                time.sleep(0.005)
            since, recorded = time.monotonic(), _recorded(folder)
            act.do(process)
        process.wait(_PATIENCE)
        reader.join(_PATIENCE)
    ended = time.monotonic()
    if served is not None and served.struck is not None:
        since = served.struck
    found = _outcome("".join(lines).splitlines(), process.returncode, ended - since, folder)
    if found.came is None and act is not None:
        found.came = recorded
    return found


def _recorded(folder: Path) -> int:
    """Return the number of complete lines of samples in the records of a folder."""
    return sum(path.read_bytes().count(b"\n") - 2 for path in (folder / "records").glob("*.csv"))


def _outcome(lines: list[str], status: int, seconds: float, folder: Path) -> Outcome:
    counted = [_COUNTED.search(line) for line in lines if _PROGRESS.match(line)]
    came = sum(int(found[1].replace(" ", "")) for found in counted if found)
    begun = sum(": begins" in line for line in lines) - sum(bool(re.search(": (done|failed) ", line)) for line in lines)
    said = [line.removeprefix("dehyst: ") for line in lines if not _PROGRESS.match(line)]
    on_disk, left = _on_disk(folder)
    return Outcome(said, status, seconds, None if begun else came, on_disk, left=left)


def _on_disk(folder: Path) -> tuple[int, list[str]]:
    """Count the readable samples in a folder, also in moved files and of killed processes; name files without any."""
    found, left = 0, []
    for path in sorted(path for path in (folder / "records").rglob("*") if path.is_file()):
        try:
            found += len(read(path))
        except DehystError:
            left.append(path.name)
    return found, left


@contextlib.contextmanager
def web_server() -> Iterator[str]:
    """Serve something that is no controller."""

    class Quiet(BaseHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Quiet)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"pi://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()


@contextlib.contextmanager
def client_of(address: str) -> Iterator[None]:
    """Another client, connected first."""
    host, port = address.removeprefix("pi://").split(":")
    with socket.create_connection((host, int(port))) as link:
        link.sendall(b"*IDN?\n")
        link.recv(1000)
        yield


def spoken_to(address: str, *commands: str) -> None:
    """Let another client leave the controller in another state."""
    host, port = address.removeprefix("pi://").split(":")
    with socket.create_connection((host, int(port))) as link:
        link.sendall("".join(f"{command}\n" for command in (*commands, "ERR?")).encode())
        link.recv(1000)


def closed_port() -> str:
    """Return an address without a listener."""
    with socket.socket() as link:
        link.bind(("127.0.0.1", 0))
        return f"pi://127.0.0.1:{link.getsockname()[1]}"


INTERRUPT, TERMINATE, HANG_UP, KILL = signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL
