"""The picture of a history of checks."""

from datetime import UTC, datetime, timedelta
from xml.etree import ElementTree

import checked_loops as loops
import pytest

import dehyst
from dehyst import IdentifyError
from dehyst.report import write_check_history
from dehyst.trust import CheckHistory

DAY = datetime(2024, 5, 1, 8, tzinfo=UTC)


def test_a_panel_for_the_error_and_for_each_change(tmp_path):
    for day in range(12):
        recheck = dehyst.check(loops.model(), loops.later(day, gain=1e-3 * max(day - 5, 0)))
        history = CheckHistory.keep(tmp_path / "checks", recheck, moment=DAY + timedelta(days=day))
    write_check_history(tmp_path / "one.svg", history)
    write_check_history(tmp_path / "two.svg", history)
    text = (tmp_path / "one.svg").read_text()
    assert text == (tmp_path / "two.svg").read_text()
    words = {"".join(node.itertext()) for node in ElementTree.fromstring(text).iter() if node.tag.endswith("text")}
    for word in ("gain", "width", "offset", "delay", "creep or drift", "05-01", "05-11"):
        assert any(word in one for one in words), word


def test_nothing_to_draw_is_an_error(tmp_path):
    with pytest.raises(IdentifyError, match="got no check of this model"):
        write_check_history(tmp_path / "one.svg", CheckHistory.read(tmp_path / "absent", "none"))
