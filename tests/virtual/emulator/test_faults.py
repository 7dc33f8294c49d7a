"""Every fault of a bench, with real processes: its exit status, what is kept, and where the voltage is left.

The faults are those of `benchmarks/faults.py`; each test looks at one of them.
"""

import json
import re
import signal
from pathlib import Path

import faults
import pytest

# The emulated controller's limits [V], and the slew rate that a rig keeps which nobody gave one [V/s].
LIMITS, SLEW = (0.0, 200.0), 2000.0
# Place of the voltage by the note; none if nothing was sent or the command did not end by itself.
SAFE = r"The voltage was brought to 0 V\."
DENIED = r"0 V was sent, but the readback gave \S+ V where \S+ V had been sent"
UNREAD = r"0 V was sent, and the voltage could not be read\."
UNSEEN = r"0 V was sent and is read, but the sensor does not confirm it"
LOST = r"The voltage could not be brought to 0 V"
# Exit status and note of each fault.
SAID = {
    **dict.fromkeys(("nobody", "unknown", "web", "taken"), (1, None)),
    **dict.fromkeys(("drop", "garble", "truncate", "error", "stall", "narrow", "servo"), (1, SAFE)),
    **dict.fromkeys(("saturate", "unplug", "dead"), (1, UNSEEN)),
    **dict.fromkeys(("refuse", "silence", "astray"), (1, LOST)),
    **dict.fromkeys(("wide", "deaf"), (0, None)),
    **dict.fromkeys(("playing", "interrupt", "impatient"), (130, SAFE)),
    **dict.fromkeys(("zero", "shift", "invert"), (130, DENIED)),
    "blank": (130, UNREAD),
    "terminate": (143, SAFE),
    "hang-up": (129, SAFE),
    "file": (2, None),
    "kill": (-signal.SIGKILL, None),
    "full": (2, SAFE),
}
# Nobody spoke to the controller, or nothing was sent; or it was not dehyst that left it where it is.
SILENT = ("taken", "file", "narrow")
ELSEWHERE = {"astray": 150.0}
READBACKS = ("zero", "shift", "invert", "blank")
# Those who cannot count what came: some was under way, or had no room.
UNCOUNTED = ("kill", "full")


CASES = {case.name: case for case in faults.CASES}


def test_every_rehearsed_fault_is_tested():
    told = json.loads(Path(faults.__file__).with_name("faults.json").read_text())
    assert {name: fault["words"] for name, fault in told.items()} == {case.name: case.words for case in faults.CASES}
    assert {name: fault["status"] for name, fault in told.items()} == {name: said[0] for name, said in SAID.items()}


# One of each kind on a push: the others are variants, or tested at the driver (`tests/instruments`) too.
PUSHED = ("astray", "interrupt")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in PUSHED else pytest.mark.nightly) for name in SAID]
)
def test_after_a_fault_status_voltage_and_message_are_right(name):
    found, (status, note) = faults.rehearse(CASES[name]), SAID[name]
    told = "\n".join(found.said)
    assert "Traceback" not in told and 'File "' not in told
    assert found.status == status, told
    notes = [line for line in found.said if re.match("|".join((SAFE, DENIED, UNREAD, UNSEEN, LOST)), line)]
    assert [bool(re.match(note or "$", line)) for line in notes] == [True] * (note is not None), told
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
    # Nobody can stop the wave of a controller that takes no connection.
    assert name == "refuse" or put.now == ELSEWHERE.get(name, 0.0)
    if name not in ELSEWHERE and name != "servo":
        assert put.steepest <= SLEW
    if name in READBACKS:
        # Steps of the wave and of a ramp, and 10 ms in which the wave went on.
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
    # The last samples were written before they were counted.
    assert found.came is None or found.came <= found.on_disk
    # None, where on a busy machine the fault came before the first sample did.
    assert found.on_disk == found.put_out.told
    assert found.on_disk == 0 or (name not in SILENT and name not in ELSEWHERE)
