"""A wave plays on an emulated controller; page, server, network or driver are lost: the device's own log."""

import pytest
from observed_rig import LIMITS, RATE
from rig_ways import BATCH, BUSY, WAYS, rehearse

pytestmark = pytest.mark.slow


# What the device does wrong is tested at the driver too, and signals are handled alike: here for `make nightly`.
AT_NIGHT = {
    *("refuse", "garble", "unplug", "error", "drop", "full", "fast"),
    *("besieged", "disarm", "page", "input", "server-hung-stop"),
    *("interrupt", "group-interrupt", "terminate", "hang-up", "server-terminate"),
}


@pytest.mark.parametrize(
    "way",
    [pytest.param(way, marks=pytest.mark.nightly if way.name in AT_NIGHT else (), id=way.name) for way in WAYS],
)
def test_the_voltage_becomes_safe_and_no_sample_is_lost(way, tmp_path):
    outcome = rehearse(way, tmp_path)
    assert LIMITS[0] <= outcome.lowest_volts <= outcome.highest_volts <= LIMITS[1]
    assert outcome.steepest_volts_a_second <= way.slew
    # A stop does not wait for a batch that a busy machine cannot read in time, nor for those that wait behind it; the
    # benchmark asks for all of them.
    assert 0 <= outcome.delivered - outcome.on_disk <= BATCH + RATE * outcome.late_seconds
    assert outcome.on_disk > 300
    assert outcome.ended == way.ends
    if way.safe:
        assert outcome.safe_seconds is not None
        # Each step of the ramp waits for a process here and one there, on however busy a machine.
        assert outcome.safe_seconds <= outcome.allowed_seconds + 2 * outcome.late_seconds + BUSY
    else:
        assert outcome.status == "lost"
        assert "could not be brought to 0 V" in outcome.words[0]
        assert "last seen" in outcome.words[1]
    if way.safe and not (way.parent or way.faults or way.full_disk):
        assert outcome.words[0].startswith("Stopped: ")
        assert outcome.words[1].endswith("brought the voltage to 0 V." if way.hangs else "was brought to 0 V.")
