"""The page of a history of checks."""

import json
import re
from datetime import UTC, datetime, timedelta

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
    write_check_history(tmp_path / "one.html", history)
    write_check_history(tmp_path / "two.html", history)
    text = (tmp_path / "one.html").read_text()
    assert text == (tmp_path / "two.html").read_text()
    stored = json.loads(re.search(r'id="chart-data">(.*?)</script>', text)[1])["charts"]
    titles = [one["title"].lower() for one in stored]
    assert titles == ["largest error", "gain", "width", "offset", "delay", "creep or drift"]
    days = [one["names"] for one in stored[0]["series"] if "names" in one]
    assert (len(days[0]), days[0][-1][-10:]) == (12, "2024-05-12")
    assert any(one["name"] == "beyond its limits" for one in stored[1]["series"])


def test_nothing_to_draw_is_an_error(tmp_path):
    with pytest.raises(IdentifyError, match="got no check"):
        write_check_history(tmp_path / "one.html", CheckHistory.read(tmp_path / "absent", "none"))
