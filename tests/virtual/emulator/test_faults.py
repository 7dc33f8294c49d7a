"""Every fault of a bench, with real processes: what is said, what is kept, and where the voltage is left.

The faults are those of `benchmarks/faults.py`; each test looks at one of them.
"""

import json
import re
import signal
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import faults
import pytest

# The emulated controller's limits [V], and the slew rate that a rig keeps which nobody gave one [V/s].
LIMITS, SLEW = (0.0, 200.0), 2000.0
GOES_ON = r"the records .*/records; the same command .*"
SAFE = r"The voltage was brought to 0 V\."
DENIED = r"0 V was sent, but the readback gave \S+ V where \S+ V had been sent; see to it"
LOST = r"The voltage could not be brought to 0 V.*: the device holds, or plays to its end, what it has; see to it"

# Exit status, and what is said, line by line.
SAID = {
    "nobody": (1, r"127.0.0.1:\d+: refused the connection; is the controller on, and \d+ its port"),
    "unknown": (1, r"no-such-host.invalid:50000: host 'no-such-host.invalid' is not known; check its name"),
    "web": (1, r"127.0.0.1:\d+: a web server answers \(.*\); PI's port is 50000"),
    "taken": (1, r"127.0.0.1:\d+: sent '\*IDN\?', got nothing: .*; is it a GCS controller, and no other client conn"),
    "drop": (1, r"127.0.0.1:\d+: sent '.*', got .*(closed the connection|the connection was lost)", SAFE, GOES_ON),
    "refuse": (1, r"127.0.0.1:\d+: sent '.*', got .*(closed|lost)", LOST, GOES_ON),
    "silence": (1, r"127.0.0.1:\d+: sent '.*', got nothing in 5 s, need an answer", LOST, GOES_ON),
    "garble": (1, r"127.0.0.1:\d+: sent '.*', got .*need", SAFE, GOES_ON),
    "truncate": (1, r"127.0.0.1:\d+: sent '.*', got .* in 5 s, need an answer", SAFE, GOES_ON),
    "error": (1, r".*127.0.0.1:\d+: error 215: the cable between controller and stage may be broken", SAFE, GOES_ON),
    "stall": (1, r".*: no new sample for [\d.]+ s, \d+ of 4291 came; check the data recorder", SAFE, GOES_ON),
    "narrow": (1, r".*: error 302: the voltage is out of its limits; .*request narrower limits", SAFE),
    "beyond": (2, r"beyond: 0 to 250 V, but .* may have 0 to 200 V; request less, .*; nothing was sent"),
    "wide": (0, r".*-50 to 300 V was given, 0 to 200 V is used"),
    "astray": (1, r".*: stands at 150 V, but 0 to 100 V is allowed; bring it there by hand, or widen the limits", LOST),
    "servo": (1, r".*: its servo was on and is switched off", r".*(closed|lost)", SAFE, GOES_ON),
    "playing": (130, r"stopped by Ctrl-C", SAFE, GOES_ON),
    "zero": (130, r"stopped by Ctrl-C", DENIED, GOES_ON),
    "shift": (130, r"stopped by Ctrl-C", DENIED, GOES_ON),
    "invert": (130, r"stopped by Ctrl-C", DENIED, GOES_ON),
    "blank": (130, r"stopped by Ctrl-C", r"0 V was sent, and the voltage could not be read\.", GOES_ON),
    **dict.fromkeys(
        ("saturate", "unplug", "dead"), (1, r"the sensor does not move: it stays at \S+ um", SAFE, GOES_ON)
    ),
    "interrupt": (130, r"stopped by Ctrl-C", SAFE, GOES_ON),
    "impatient": (130, r"stopped by Ctrl-C", SAFE, GOES_ON),
    "terminate": (143, r"stopped by SIGTERM", SAFE, GOES_ON),
    "hang-up": (129, r"stopped by SIGHUP", SAFE, GOES_ON),
    "deaf": (0,),
    "kill": (-signal.SIGKILL,),
    "full": (2, r"\S+/look.csv: cannot be written \(File too large\); make room there", SAFE, GOES_ON),
    "file": (2, r"\S+: cannot be made a folder .*give another name"),
}
# Nobody spoke to the controller, or nothing was sent; or it was not dehyst that left it where it is.
SILENT = ("taken", "beyond", "file", "narrow")
ELSEWHERE = {"astray": 150.0}
READBACKS = ("zero", "shift", "invert", "blank")
# Those who cannot count what came: some was under way, or had no room.
UNCOUNTED = ("kill", "full")


CASES = {case.name: case for case in faults.CASES}


class Rehearsals:
    """Outcomes of faults; some are rehearsed ahead of their tests, while others wait for answers that do not come."""

    AT_ONCE = 4

    def __init__(self, names, pool):
        self.names, self.pool, self.begun = names, pool, {}

    def __getitem__(self, name):
        at = self.names.index(name)
        for each in self.names[at : at + self.AT_ONCE]:
            if each not in self.begun:
                self.begun[each] = self.pool.submit(faults.rehearse, CASES[each])
        return self.begun[name].result()


@pytest.fixture(scope="module")
def rehearsed(request):
    asked = [
        item.callspec.params["name"]
        for item in request.session.items
        if item.path == request.path and "rehearsed" in item.fixturenames
    ]
    with ThreadPoolExecutor(Rehearsals.AT_ONCE) as pool:
        yield Rehearsals(asked, pool)


def test_these_faults_were_rehearsed():
    told = json.loads(Path(faults.__file__).with_name("faults.json").read_text())
    assert {name: fault["words"] for name, fault in told.items()} == {case.name: case.words for case in faults.CASES}
    assert {name: fault["status"] for name, fault in told.items()} == {name: said[0] for name, said in SAID.items()}


def test_each_fault_is_looked_at():
    assert set(CASES) == set(SAID)


# One of each kind on a push: the others are variants, or tested at the driver (`tests/instruments`) too.
PUSHED = ("drop", "astray", "interrupt", "zero")


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in PUSHED else pytest.mark.nightly) for name in SAID]
)
def test_a_fault(rehearsed, name):
    found = rehearsed[name]
    status, *said = SAID[name]
    told = "\n".join(found.said)
    if not found.on_disk and GOES_ON in said:
        # On a busy machine the fault may come before the first sample does: then there is nothing to go on from.
        said.remove(GOES_ON)
    assert "Traceback" not in told and 'File "' not in told
    assert found.status == status, told
    assert len(found.said) == len(said), told
    for line, pattern in zip(found.said, said, strict=True):
        assert re.match(pattern, line), told
    assert found.left == []
    if found.put_out is not None:
        _look_at_voltages(name, found.put_out)
        _look_at_samples(name, found)
    if found.again is not None:
        assert found.again.status == 0, found.again.said
        assert found.again.on_disk > found.again.came > 20_000


def _look_at_voltages(name, put):
    """Within the limits, as the emulator saw them; no steeper than allowed; left at a safe voltage."""
    assert LIMITS[0] <= put.lowest <= put.highest <= LIMITS[1]
    assert put.now == ELSEWHERE.get(name, 0.0)
    if name not in ELSEWHERE and name != "servo":
        assert put.steepest <= SLEW
    if name in READBACKS:
        # Of the wave and of a ramp; and of 10 ms in which the wave went on.
        assert put.step <= 3 * 0.01 * SLEW
    if name in SILENT:
        assert put.highest == 0
    assert put.refused == (name == "narrow")


def _look_at_samples(name, found):
    """All that the emulator told are on disk."""
    if name in UNCOUNTED:
        # On a busy machine the last count may have been told long before the end.
        assert found.came > 0
        assert found.on_disk >= max(found.came, 500)
        return
    # What came last was written before it was counted.
    assert found.came is None or found.came <= found.on_disk
    # None, where on a busy machine the fault came before the first sample did.
    assert found.on_disk == found.put_out.told
    assert found.on_disk == 0 or (name not in SILENT and name not in ELSEWHERE)
