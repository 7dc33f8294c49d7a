"""Every fault of a bench, rehearsed with real processes; writes `faults.json`, and prints each outcome.

Names on the command line select some of them; then nothing is written.
"""

import contextlib
import json
import re
import signal
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

from rehearsal import (
    HANG_UP,
    INTERRUPT,
    KILL,
    TERMINATE,
    Act,
    Outcome,
    Served,
    calibrate,
    client_of,
    closed_port,
    sent,
    spoken_to,
    web_server,
)

from dehyst._io import write_atomically

HERE = Path(__file__).resolve().parent
# Loops per second: slow loops are far from 0 V at Ctrl-C. At emulator speed 1, its place in a wave is known.
_OPTIONS, _SLOW = ("--frequency", "5"), ("--frequency", "0.2")
_HURRIED, _TRUE = ("--speed", "20"), ("--speed", "1")


@dataclass(frozen=True)
class Case:
    """A fault: its name, its description, and its rehearsal in an empty folder."""

    name: str
    words: str
    run: Callable[[Path], Outcome]


def struck(fault: str, *options: str) -> Callable[[Path], Outcome]:
    """Return a rehearsal of a fault of the emulator."""
    return lambda folder: against(folder, (*_TRUE, "--fault", fault), *options)


def against(folder: Path, serve: tuple[str, ...], *options: str, again: bool = False, **how: object) -> Outcome:
    """Run a command against an emulator; with `again` a second time."""
    asked = options if options[:1] == _OPTIONS[:1] else (*_OPTIONS, *options)
    with Served(*serve) as served:
        found = calibrate(served.address, folder / "out", *asked, served=served, **how)
        if again:
            found.again = calibrate(served.address, folder / "out", *asked)
        found.put_out = served.end()
    return found


def stopped_with(fault: str) -> Callable[[Path], Outcome]:
    return lambda folder: against(folder, (*_TRUE, "--fault", f"{fault}@20"), *_SLOW, act=sent(INTERRUPT))


def nobody(address: str, folder: Path) -> Outcome:
    return calibrate(address, folder / "out", *_OPTIONS)


def web(folder: Path) -> Outcome:
    with web_server() as address:
        return nobody(address, folder)


def taken(folder: Path) -> Outcome:
    with Served(*_TRUE) as served:
        with client_of(served.address):
            found = nobody(served.address, folder)
        found.put_out = served.end()
    return found


def left(*commands: str, options: tuple[str, ...] = (), act: Act | None = None) -> Callable[[Path], Outcome]:
    """Return a rehearsal with a controller in a state by `commands`; without an `act`, it drops the connection."""

    def run(folder: Path) -> Outcome:
        with Served(*_TRUE, *(() if act else ("--fault", "drop"))) as served:
            spoken_to(served.address, *commands)
            found = calibrate(served.address, folder / "out", *_OPTIONS, *options, served=served, act=act)
            found.put_out = served.end()
        return found

    return run


def not_a_folder(folder: Path) -> Outcome:
    (folder / "out").write_text("a file")
    return against(folder, _TRUE)


CASES = (
    Case("nobody", "Nobody listens at the port", lambda folder: nobody(closed_port(), folder)),
    Case("unknown", "The host is not known", lambda folder: nobody("pi://no-such-host.invalid:50000", folder)),
    Case("web", "A web server listens", web),
    Case("taken", "Another client is connected", taken),
    Case("drop", "The connection is lost in mid-wave", struck("drop")),
    Case("refuse", "It is lost, and none taken any more", struck("refuse")),
    Case("silence", "No command is answered any more", struck("silence")),
    Case("garble", "An answer comes garbled", struck("garble")),
    Case("truncate", "An answer comes cut off", struck("truncate")),
    Case("error", "The controller stops, with an error", struck("error")),
    Case("stall", "Its wave generator hangs", struck("stall")),
    Case("narrow", "Its limits are narrower than it tells", struck("narrow")),
    Case("wide", "`--limits` wider than its own", lambda folder: against(folder, _HURRIED, "--limits", "-50", "300")),
    Case(
        "astray",
        "Somebody left it at 150 V, `--limits 0 100`",
        left("SVO 1 0", "SVA 1 150", options=("--limits", "0", "100")),
    ),
    Case("servo", "Its servo was left on, and then the link is lost", left("SVO 1 1")),
    Case(
        "playing",
        "Somebody's wave is still being played, later Ctrl-C",
        left(
            "WAV 1 X SIN_P 20000 150 0 20000 0 10000",
            "WSL 1 1",
            "WGC 1 1",
            "WTR 1 20 0",
            "WGO 1 1",
            act=sent(INTERRUPT),
        ),
    ),
    Case("zero", "The voltage that is read is 0 V, and then Ctrl-C", stopped_with("zero")),
    Case("shift", "The voltage that is read is 50 V too high, and then Ctrl-C", stopped_with("shift")),
    Case("invert", "The voltage that is read has the wrong sign, and then Ctrl-C", stopped_with("invert")),
    Case("blank", "The voltage that is read is no number, and then Ctrl-C", stopped_with("blank")),
    Case("saturate", "The sensor saturates", struck("saturate")),
    Case("unplug", "The sensor's cable comes off in mid-wave", struck("unplug")),
    Case("dead", "The sensor was never plugged in", struck("unplug@0s")),
    Case("interrupt", "Ctrl-C in mid-wave", lambda folder: against(folder, _TRUE, act=sent(INTERRUPT))),
    Case("impatient", "Ctrl-C three times", lambda folder: against(folder, _TRUE, act=sent(*3 * (INTERRUPT,)))),
    Case("terminate", "SIGTERM in mid-wave", lambda folder: against(folder, _TRUE, act=sent(TERMINATE))),
    Case("hang-up", "The terminal is closed", lambda folder: against(folder, _TRUE, act=sent(HANG_UP))),
    Case("deaf", "Nobody reads its messages any more", lambda folder: against(folder, _TRUE, deaf=True)),
    Case(
        "kill",
        "`kill -9` in mid-wave, then the same again",
        lambda folder: against(folder, _TRUE, act=sent(KILL), again=True),
    ),
    Case(
        "full",
        "The disk is full, and then is not",
        lambda folder: against(folder, _TRUE, largest_file=60_000, again=True),
    ),
    Case("file", "The output folder is a file", not_a_folder),
)


def rehearse(case: Case) -> Outcome:
    """Rehearse one in a folder of its own."""
    with tempfile.TemporaryDirectory() as folder:
        found = case.run(Path(folder))
    found.said = [line.replace(f"{folder}/", "") for line in found.said]
    return found


def line(case: Case, found: Outcome) -> str:
    put = found.put_out
    cells = [f"{case.name:10s} {found.status:4d} {found.seconds:5.1f} s", f"{found.came} came", f"{found.on_disk} kept"]
    if put is not None:
        cells.append(f"{put.told:5d} told; {put.lowest:g} to {put.highest:g} V, {put.steepest:.0f} V/s, {put.now:g} V")
    if found.again is not None:
        cells.append(f"again: {found.again.status}")
    return "\n    ".join([", ".join(cells), *found.said, *found.left])


def as_dict(case: Case, found: Outcome) -> dict:
    """Return the JSON values of one case, with the ports of a real controller."""
    said = [re.sub(r"(127\.0\.0\.1:)\d+", r"\g<1>50000", line) for line in found.said]
    said = [re.sub(r"and \d+ its port", "and 50000 its port", line) for line in said]
    return {"words": case.words, **asdict(found), "said": said}


def main() -> None:
    # A process in the background may ignore these signals, and so would its children.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    chosen = [case for case in CASES if len(sys.argv) == 1 or case.name in sys.argv[1:]]
    # The rehearsals mostly wait for answers that do not come.
    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(rehearse, chosen))
    for case, outcome in zip(chosen, found, strict=True):
        print(line(case, outcome))
    if len(chosen) == len(CASES):
        told = {case.name: as_dict(case, outcome) for case, outcome in zip(chosen, found, strict=True)}
        write_atomically(HERE / "faults.json", (json.dumps(told, indent=1) + "\n").encode())


if __name__ == "__main__":
    with contextlib.suppress(BrokenPipeError):
        main()
