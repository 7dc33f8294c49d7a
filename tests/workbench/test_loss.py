"""A wave plays while page, browser or server are lost, in a real browser: the device's own log."""

import pytest
from observed_rig import LIMITS, SLEW
from page_ways import PAGE_WAYS, rehearse_page
from rig_ways import BATCH, BUSY
from workbench_page import CHROMIUM

pytest.importorskip("playwright.sync_api", reason="needs playwright")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's chromium")]
# The others are repeated at night: what follows from them is tested at the process that holds the rig too.
ALWAYS = ("network",)


@pytest.mark.parametrize(
    "way",
    [pytest.param(way, marks=[] if way.name in ALWAYS else [pytest.mark.nightly], id=way.name) for way in PAGE_WAYS],
)
def test_the_voltage_becomes_safe_and_no_sample_is_lost(way, tmp_path):
    outcome = rehearse_page(way, tmp_path)
    assert LIMITS[0] <= outcome.lowest_volts <= outcome.highest_volts <= LIMITS[1]
    assert outcome.steepest_volts_a_second <= SLEW
    # A stop does not wait for a batch that a busy machine cannot read in time; the benchmark asks for all of them.
    assert 0 <= outcome.delivered - outcome.on_disk <= BATCH
    assert outcome.on_disk > 300
    assert outcome.safe_seconds is not None
    assert outcome.safe_seconds <= outcome.allowed_seconds + 2 * outcome.late_seconds + BUSY
