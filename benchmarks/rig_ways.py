"""The ways to lose page, server, network or driver while a wave plays: each rehearsed with real processes."""

import os
import resource
import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from observed_rig import HIGHEST, LIMITS, SLEW, STEEPNESS, ObservedController, RigHolder, held, on_disk

from dehyst.workbench.rig.watchdog import HEARTBEAT

_HANGING = """
import time
from dehyst.instruments.pi import PiRig

class HangingRig(PiRig):
    def _wave(self, voltage, rate):
        for count, samples in enumerate(super()._wave(voltage, rate)):
            yield samples
            while count == 5:
                try:
                    time.sleep(1000)
                except BaseException:
                    pass

def make(**options):
    return HangingRig.connect("{host}", {port}, **options)
"""
# Bytes that a file may have on a disk that is full.
_FULL = 60_000
# Most samples of a batch that a process may be reading.
BATCH = 250
# Seconds that tests allow beside, for what runs on the same processors; the benchmark allows none.
BUSY = 2.0
# Seconds after which a wave that was not stopped has risen.
_TO_THE_TOP = 20.0
# The base class ramps the whole range in a second at least.
GENTLE = 1.0


@dataclass
class Outcome:
    """What was observed at the device and on disk; seconds count from the loss.

    `allowed_seconds` is range / slew + 1 s, with at least a second for the range. `late_seconds`: by how much sleeps of
    10 ms were late meanwhile, in all, because other programs ran on the machine. `status`, `words` and `errors` are
    what the rig's process reported.
    """

    safe_seconds: float | None
    allowed_seconds: float
    late_seconds: float
    from_volts: float
    lowest_volts: float
    highest_volts: float
    steepest_volts_a_second: float
    delivered: int
    on_disk: int
    status: str
    words: list[str]
    ended: bool
    errors: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Way:
    """A way to lose something: its name, what happens in words, what does it, and what is needed for it.

    `lose(holder, controller)` may return the time of the loss [s of time.monotonic] if it is not its beginning.
    `ends`: whether the rig's process ends. `safe`: whether the device can still be brought to the safe voltage.
    `later`: time [s] from the loss to the stop, so that the voltage is the highest then. `hangs`: whether the driver
    hangs. `grace`: time [s] that is allowed beside. `in_flight`: samples that the killed process may have been reading.
    """

    name: str
    words: str
    lose: Callable[[RigHolder, ObservedController], float | None]
    parent: bool = False
    ends: bool = False
    safe: bool = True
    faults: tuple[str, ...] = ()
    slew: float = SLEW
    full_disk: bool = False
    hangs: bool = False
    grace: float = 0.0
    later: float = 0.0
    in_flight: int = 0


class Scene:
    """A wave that plays on an emulated controller, near its highest voltage."""

    def __init__(self, folder: Path, way: Way, stack: ExitStack) -> None:
        self.folder, self.way = folder, way
        self.controller = stack.enter_context(ObservedController(*way.faults))
        with full_disk(way.full_disk):
            self.holder = stack.enter_context(held(folder, parent=way.parent))
        address = self.controller.address
        self.holder.connect(hanging_driver(folder, address) if way.hangs else address, way.slew)
        self.holder.arm()
        self.holder.play()

    def _rise(self, level: float) -> None:
        """Wait until a wave rises through a level [V]; play it anew if the watchdog of a busy machine stopped it."""
        for again in ("wave-second", "wave-third", ""):
            if self.controller.wait_for(lambda: self.controller.rises_through(level), _TO_THE_TOP):
                return
            self.holder.settle()
            if again and self.holder.state["status"] != "playing":
                self.holder.arm()
                self.holder.play(again)
        raise TimeoutError(f"no wave rose through {level} V: {self.holder.state}")

    def outcome(self) -> Outcome:
        """Lose something, and observe what follows."""
        way, holder, controller = self.way, self.holder, self.controller
        if not (way.faults or way.full_disk):
            self._rise(HIGHEST - 5 - STEEPNESS * way.later)
        at, lost = controller.voltage, time.monotonic()
        lost = way.lose(holder, controller) or lost
        if way.ends:
            controller.wait_for(holder.gone)
        elif not way.parent:
            holder.until(lambda: holder.state["status"] in ("connected", "lost", "none"))
        controller.wait_for(controller.rests)
        ended = controller.wait_for(holder.gone, 1.0) if way.ends else holder.gone()
        time.sleep(0.1)
        holder.settle()
        safe = controller.safe_at()
        _, voltage = controller.put_out()
        allowed = max(GENTLE, (LIMITS[1] - LIMITS[0]) / way.slew) + 1.0 + way.grace
        return Outcome(
            None if safe is None else safe - lost,
            allowed,
            0.0 if safe is None else controller.lateness(lost, safe),
            at,
            float(voltage.min()),
            float(voltage.max()),
            controller.steepest,
            controller.told,
            on_disk(self.folder, "wave*"),
            holder.state["status"],
            holder.state.get("words", []),
            ended,
            holder.errors_sent(),
        )


def rehearse(way: Way, folder: Path) -> Outcome:
    """Rehearse one way in an empty folder."""
    with ExitStack() as stack:
        return Scene(folder, way, stack).outcome()


@contextmanager
def full_disk(full: bool) -> Iterator[None]:
    """Let processes that are started meanwhile write small files only."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    if full:
        resource.setrlimit(resource.RLIMIT_FSIZE, (_FULL, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def close_input(holder: RigHolder, _: ObservedController) -> None:
    holder.process.stdin.close()


def silent(holder: RigHolder, _: ObservedController) -> None:
    holder.alive(False)


def sent(number: int) -> Callable[[RigHolder, ObservedController], None]:
    return lambda holder, _: os.kill(holder.pid, number)


def to_parent(number: int) -> Callable[[RigHolder, ObservedController], None]:
    return lambda holder, _: holder.process.send_signal(number)


def to_group(number: int) -> Callable[[RigHolder, ObservedController], None]:
    return lambda holder, _: os.killpg(holder.process.pid, number)


def hung_and_pressed(holder: RigHolder, _: ObservedController) -> float:
    """Hang the server, and press the emergency stop before the watchdog knows."""
    holder.process.send_signal(signal.SIGSTOP)
    pressed = time.monotonic()
    assert holder.press() == 200
    return pressed


def besieged(holder: RigHolder, _: ObservedController) -> float:
    """Press the emergency stop beside a hundred connections that say nothing, or nonsense, slowly."""
    siege = [socket.create_connection(("127.0.0.1", holder.stop["port"])) for _ in range(100)]
    for link in siege[::2]:
        link.sendall(b"POST /stop HT")
    pressed = time.monotonic()
    assert holder.press() == 200
    for link in siege:
        link.close()
    return pressed


def asked_to(do: str) -> Callable[[RigHolder, ObservedController], None]:
    return lambda holder, _: holder.send(do=do)


def struck(holder: RigHolder, controller: ObservedController) -> float:
    """Wait for the fault of the emulator."""
    assert controller.wait_for(lambda: controller.struck_at is not None)
    return controller.struck_at


def filled(holder: RigHolder, controller: ObservedController) -> float:
    """Wait until no more samples are fetched; return when the last ones were."""
    told, since = 0, time.monotonic()
    while time.monotonic() < since + 0.5:
        if controller.told != told:
            told, since = controller.told, time.monotonic()
        time.sleep(0.002)
    return since


def hanging_driver(folder: Path, address: str) -> str:
    """Return the address of a driver that hangs in its first wave, and lets no exception out."""
    path = folder / "hanging_rig.py"
    host, port = address.removeprefix("pi://").split(":")
    path.write_text(_HANGING.format(host=host, port=port))
    return f"{path}:make"


def hung(holder: RigHolder, controller: ObservedController) -> float:
    """Take the page away while the driver hangs; return when the watchdog knew of it."""
    holder.alive(False)
    return time.monotonic()


def killed(holder: RigHolder, _: ObservedController) -> None:
    holder.send(do="kill the rig's process", signal=int(signal.SIGKILL))


WAYS = (
    Way("input", "The server's end of the pipe is closed", close_input, ends=True),
    Way("page", "The page gives no sign of life", silent, later=HEARTBEAT),
    Way("stop", "Stop is pressed on the page", asked_to("stop")),
    Way("disarm", "The rig is disarmed during a wave", asked_to("disarm")),
    Way("disconnect", "The rig is disconnected during a wave", asked_to("disconnect"), ends=False),
    Way("emergency", "The emergency stop is pressed", lambda holder, _: holder.press() and None),
    Way("besieged", "The same, beside 100 connections that hang", besieged),
    Way("terminate", "SIGTERM to the rig's process", sent(signal.SIGTERM), ends=True),
    Way("interrupt", "SIGINT to the rig's process", sent(signal.SIGINT), ends=True),
    Way("hang-up", "SIGHUP to the rig's process", sent(signal.SIGHUP), ends=True),
    Way("server-kill", "kill -9 of the server", to_parent(signal.SIGKILL), parent=True, ends=True),
    Way("server-terminate", "SIGTERM to the server", to_parent(signal.SIGTERM), parent=True, ends=True),
    Way("group-interrupt", "Ctrl-C in the server's terminal", to_group(signal.SIGINT), parent=True, ends=True),
    Way("group-kill", "kill -9 of the server's process group", to_group(signal.SIGKILL), parent=True, ends=True),
    Way("server-hung", "The server hangs (SIGSTOP)", to_parent(signal.SIGSTOP), parent=True, later=HEARTBEAT),
    Way("server-hung-stop", "The server hangs, the emergency stop is pressed", hung_and_pressed, parent=True),
    Way(
        "rig-kill", "kill -9 of the rig's process: the server retreats", killed, parent=True, ends=True, in_flight=BATCH
    ),
    Way("drop", "The controller's connection is lost", struck, faults=("drop@1500",)),
    Way("unplug", "The sensor's cable comes off", struck, faults=("unplug@1500",)),
    Way("error", "The controller stops, with an error", struck, faults=("error@1500",)),
    Way("garble", "An answer comes garbled", struck, faults=("garble@1500",)),
    Way("silence", "The controller answers no more", struck, faults=("silence@1500",), safe=False),
    Way("refuse", "The connection is lost, and none taken any more", struck, faults=("refuse@1500",), safe=False),
    Way("full", "The disk is full", filled, full_disk=True),
    # The watchdog waits for 3 s, and a fresh process needs a second to begin.
    Way("driver-hangs", "The driver hangs, then the page is lost", hung, ends=True, hangs=True, grace=5.0),
    Way("fast", "The page gives no sign of life, 1000 V/s allowed", silent, slew=1000.0, later=HEARTBEAT),
)
