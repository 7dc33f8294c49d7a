"""The ways to lose page, browser or server while a wave plays, with a real page in a real browser."""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from observed_rig import HIGHEST, LIMITS, SLEW, ObservedController, on_disk, triangle
from rig_ways import GENTLE, Outcome

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))

from workbench_client import Served, served
from workbench_page import Visitor, chromium

_ASK = """async ([what, body]) => {
    const headers = { "Content-Type": "application/json" };
    const answer = await fetch(`/api/rig/${what}`, { method: "POST", headers, body: JSON.stringify(body) });
    return answer.ok ? "" : await answer.text();
}"""
_HANG = "() => { const end = Date.now() + 20000; setTimeout(() => { while (Date.now() < end); }, 0); }"


@dataclass(frozen=True)
class PageWay:
    """A way to lose something: its name, what happens in words, and what does it.

    `stops`: whether somebody presses the stop after that.
    """

    name: str
    words: str
    lose: Callable[[Visitor, Served, int], None]
    stops: bool = False


def _server(number: signal.Signals) -> Callable[[Visitor, Served, int], None]:
    return lambda _, bench, __: bench.process.send_signal(number)


def _pressed(person: Visitor, bench: Served, _: int) -> None:
    bench.process.send_signal(signal.SIGSTOP)
    person.page.keyboard.press("Escape")


PAGE_WAYS = (
    PageWay("page-closed", "the tab is closed", lambda person, *_: person.page.close()),
    PageWay("page-left", "the tab goes to another page", lambda person, *_: person.page.goto("about:blank")),
    PageWay("page-hangs", "the page's script hangs", lambda person, *_: person.page.evaluate(_HANG)),
    PageWay("browser-killed", "the browser is killed", lambda _, __, browser: os.kill(browser, signal.SIGKILL)),
    PageWay("network", "page and server do not reach each other", lambda person, *_: person.context.set_offline(True)),
    PageWay("server-sigterm", "the server receives SIGTERM", _server(signal.SIGTERM)),
    PageWay("server-sigint", "Ctrl-C at the server", _server(signal.SIGINT)),
    PageWay("server-sighup", "the server's terminal is closed", _server(signal.SIGHUP)),
    PageWay("server-killed", "the server is killed", _server(signal.SIGKILL)),
    PageWay("server-stopped", "the server hangs", _server(signal.SIGSTOP)),
    PageWay("stop-while-hung", "the server hangs, and Escape is pressed", _pressed, stops=True),
    PageWay("stop", "Escape is pressed", lambda person, *_: person.page.keyboard.press("Escape"), stops=True),
)


def rehearse_page(way: PageWay, folder: Path) -> Outcome:
    """Rehearse one way in an empty folder, with a server and a browser of its own."""
    with ExitStack() as stack:
        controller = stack.enter_context(ObservedController())
        bench = stack.enter_context(_continued(folder))
        browser, number = stack.enter_context(_browser())
        person = Visitor(browser, bench)
        _play(person, bench, controller)
        controller.wait_for(lambda: controller.rises_through(HIGHEST - 5))
        at, lost = controller.voltage, time.monotonic()
        way.lose(person, bench, number)
        controller.wait_for(controller.rests)
        time.sleep(1.0)
        safe = controller.safe_at()
        _, voltage = controller.put_out()
        return Outcome(
            None if safe is None else safe - lost,
            max(GENTLE, (LIMITS[1] - LIMITS[0]) / SLEW) + 1.0,
            0.0 if safe is None else controller.lateness(lost, safe),
            at,
            float(voltage.min()),
            float(voltage.max()),
            controller.steepest,
            controller.told,
            on_disk(bench.folder / "records", "*-played"),
            "",
            [],
            False,
        )


def _play(person: Visitor, bench: Served, controller: ObservedController) -> None:
    """Connect, arm, and play a triangle."""
    person.connect(controller.address, LIMITS, SLEW)
    person.arm(LIMITS, SLEW)
    wave = triangle(bench.folder / "voltages")
    refused = person.page.evaluate(_ASK, ["play", {"file": f"voltages/{wave.name}"}])
    if refused:
        raise RuntimeError(refused)
    person.sees("^playing", within="#rig-bar")


@contextmanager
def _continued(folder: Path) -> Iterator[Served]:
    """Serve a workbench; let it go on at the end if it was stopped, so that it can end."""
    with served(folder / "bench") as bench:
        try:
            yield bench
        finally:
            bench.process.send_signal(signal.SIGCONT)


@contextmanager
def _browser() -> Iterator[tuple[Any, int]]:
    """Open a browser, which may be killed; yield it and the number of its process."""
    before = _browsers()
    with ExitStack() as stack:
        browser = stack.enter_context(chromium())
        try:
            yield browser, min(_browsers() - before)
        finally:
            # A browser that was killed cannot be closed.
            with suppress(Exception):
                stack.close()


def _browsers() -> set[int]:
    """Return the processes of the browsers that this process has started; others may run beside."""
    found = set()
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if (entry / "comm").read_text().startswith("chrom") and _descends(int(entry.name)):
                found.add(int(entry.name))
    return found


def _descends(pid: int) -> bool:
    """Return whether this process, or one that it has started, has started a process."""
    while pid > 1 and pid != os.getpid():
        pid = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
    return pid == os.getpid()
