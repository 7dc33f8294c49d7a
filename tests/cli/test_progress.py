"""What a calibration shows while it runs, on standard error: on a terminal bars, else lines."""

import sys
from typing import NamedTuple

import numpy as np
import pytest

from dehyst.cli.progress import Progress


class Lot(NamedTuple):
    time: np.ndarray
    voltage: np.ndarray
    displacement: np.ndarray


def lot(start, end, count):
    t = np.linspace(start, end, count)
    return Lot(t, 50 + 50 * np.sin(t), 5e-6 + 5e-6 * np.sin(t))


def played(error=None):
    """Play two steps of a calibration, the first off its path by 1 % of the stroke."""
    with Progress() as progress:
        progress.step("look", 24.0)
        progress.samples(lot(0, 12, 6000))
        wanted = lot(12, 24, 6000).displacement
        wanted[0] = np.nan
        progress.samples(lot(12, 24, 6000), wanted + 1e-7, 1e-5)
        progress.step("identify")
        progress.message("100 [elements]")
        if error is not None:
            raise error


@pytest.mark.parametrize("missing", [False, True])
def test_without_a_terminal_or_rich_a_line_where_a_step_begins_and_ends(capsys, monkeypatch, missing):
    if missing:
        for module in [name for name in sys.modules if name.split(".")[0] == "rich"]:
            monkeypatch.delitem(sys.modules, module)
        monkeypatch.setitem(sys.modules, "rich", None)
        monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with pytest.raises(ValueError, match="lost"):
        played(ValueError("lost"))
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines() == [
        "dehyst: look: begins, 24.0 s",
        "dehyst: look: done in 0.0 s, 12000 samples, off the path by at most 1.000 % of the stroke",
        "dehyst: identify: begins",
        "dehyst: identify: failed after 0.0 s",
    ]


@pytest.mark.parametrize("error", [None, KeyboardInterrupt])
def test_on_a_terminal_a_bar_for_each_step(capsys, monkeypatch, error):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "150")
    progress = pytest.importorskip("rich.progress")
    shown, stop = [], progress.Progress.stop

    def stopped(bars):
        shown.extend(bars.tasks)
        stop(bars)

    monkeypatch.setattr(progress.Progress, "stop", stopped)
    if error is None:
        played()
    else:
        with pytest.raises(error):
            played(error)
    assert capsys.readouterr().out == ""
    assert [task.description for task in shown] == ["look", "identify"]
    assert shown[0].percentage == 100
    assert shown[0].fields["text"].startswith("12000 samples, off the path by at most 1.000 %")
    assert (shown[1].percentage == 100) == (error is None)
