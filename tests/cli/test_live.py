"""What a calibration shows while it runs: on a terminal a picture, else lines."""

import io
import sys
from typing import NamedTuple

import numpy as np
import pytest
from rich.console import Console

from dehyst.cli.live import display, picture


class Lot(NamedTuple):
    time: np.ndarray
    voltage: np.ndarray
    displacement: np.ndarray


def lot(start, end, count):
    t = np.linspace(start, end, count)
    return Lot(t, 50 + 50 * np.sin(t), 5e-6 + 5e-6 * np.sin(t))


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


def terminal(**options):
    options = {"width": 80, "force_terminal": True, "color_system": None, "record": True, **options}
    return Console(file=io.StringIO(), **options)


def seen(live, **options):
    """Return the lines of the picture."""
    console = terminal()
    console.print(picture(live, **options))
    return [line.rstrip() for line in console.export_text().splitlines()]


def test_steps_bar_numbers_and_error(clock):
    with display(["look", "identify", "compensated"], console=terminal(), clock=clock) as live:
        assert seen(live) == ["· look", "· identify", "· compensated"]
        live.step("look", 24.0)
        assert seen(live)[0] == "▶ look        0 %, 24 s left"
        # The device's clock runs ten times as fast.
        clock.now += 1.0
        live.samples(lot(0.0, 12.0, 6000))
        assert seen(live)[0] == "▶ look        50 %, 1.0 s left"
        # Half of 60; what is to come is only a colour.
        assert seen(live)[3].count("━") == 30
        assert seen(live)[4:] == ["  6 000 samples on disk     23.171 V      2.3171 um"]
        live.step("identify")
        live.message("100 elements")
        clock.now += 65.0
        assert seen(live)[:2] == ["✓ look        1.0 s, 6 000 samples", "▶ identify    100 elements, 1 min 05 s"]
        live.step("compensated", 10.0)
        samples = lot(20.0, 25.0, 100)
        error = np.linspace(0, 5e-8, 100)
        error[50] = 1e-7
        clock.now += 5.0
        live.samples(samples, samples.displacement + error)
        assert seen(live)[2] == "▶ compensated 50 %, 5.0 s left"
        # Of the stroke so far, 10 um but for where the samples lie.
        assert seen(live)[-1] == "  off the path by 0.500 % of the stroke now, at most 1.000 %"
    assert seen(live)[:3] == [
        "✓ look        1.0 s, 6 000 samples",
        "✓ identify    1 min 05 s",
        "✓ compensated 5.0 s, 100 samples, off the path by at most 1.000 % of the stroke",
    ]


def test_the_error_is_told_of_the_stroke(clock):
    with display(stream=io.StringIO(), clock=clock) as live:
        live.step("path")
        live.samples(Lot([0, 1], [0, 100], [0.0, 4e-6]), [0.0, 4e-6])
        live.samples(Lot([2, 3], [50, 20], [2e-6, 1e-6]), [2.2e-6, 0.9e-6])
        assert live.present.error == pytest.approx(2.5)
        assert live.present.largest == pytest.approx(5.0)


def test_what_was_not_foreseen_comes_where_it_happens(clock):
    with display(["look", "others"], console=terminal(), clock=clock) as live:
        for name in ("look", "more-1", "identify", "identify", "others"):
            live.step(name)
    assert [line.split()[1] for line in seen(live)] == ["look", "more-1", "identify", "identify", "others"]


def test_a_picture_is_drawn_while_it_runs_and_stays(clock):
    console = terminal()
    with display(["look", "loops"], console=console, clock=clock) as live:
        live.step("look", 2.0)
        live.samples(lot(0, 2, 10))
        live.step("loops", 2.0)
        live.samples(lot(3, 4, 10))
    text = console.file.getvalue()
    assert "▶ look" in text
    # The last picture is drawn over the one before, and stays.
    assert [line.rstrip() for line in text.rpartition("\x1b[2K")[2].splitlines()[:3]] == [
        "✓ look  0.0 s, 10 samples",
        "✓ loops 0.0 s, 10 samples",
        "  20 samples on disk     12.160 V      1.2160 um",
    ]


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_a_step_that_fails(clock, error):
    stream = io.StringIO()
    with pytest.raises(error), display(console=terminal(), stream=stream, clock=clock) as live:
        live.step("look", 2.0)
        live.samples(lot(0, 1, 7))
        clock.now += 1
        raise error
    assert seen(live)[0] == "✗ look 1.0 s, 7 samples"
    assert seen(live, plain=True)[0] == "! look 1.0 s, 7 samples"


def test_without_a_terminal_a_line_where_a_step_begins_and_ends(clock):
    stream = io.StringIO()
    with pytest.raises(ValueError, match="lost"), display(["look", "more"], stream=stream, clock=clock) as live:
        live.step("look", 90.0)
        clock.now += 61
        live.samples(lot(0, 90, 12345), lot(0, 90, 12345).displacement + 1e-8)
        live.step("identify")
        clock.now += 3720
        live.step("loops", 1.0)
        raise ValueError("lost")
    assert stream.getvalue().splitlines() == [
        "dehyst: look: begins, 1 min 30 s",
        "dehyst: look: done in 1 min 01 s, 12 345 samples, off the path by at most 0.100 % of the stroke",
        "dehyst: identify: begins",
        "dehyst: identify: done in 1 h 02 min",
        "dehyst: loops: begins, 1.0 s",
        "dehyst: loops: failed after 0.0 s",
    ]


class Screen(io.StringIO):
    def isatty(self):
        return True


def test_lines_where_rich_is_missing(clock, monkeypatch):
    for module in [name for name in sys.modules if name.split(".")[0] == "rich"]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "rich", None)
    stream = Screen()
    with display(["look"], stream=stream, clock=clock) as live:
        live.step("look")
    assert stream.getvalue().splitlines() == ["dehyst: look: begins", "dehyst: look: done in 0.0 s"]


def test_a_terminal_without_unicode(clock):
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    console = Console(file=stream, force_terminal=True, width=80, color_system=None)
    with display(["look"], console=console, clock=clock) as live:
        live.step("look", 1.0)
        live.samples(lot(0, 1, 5))
    stream.flush()
    assert b"x look 0.0 s, 5 samples" in stream.buffer.getvalue()


def test_a_narrow_terminal_cuts_lines_and_breaks_none(clock):
    with display(["look", "compensated"], console=terminal(), clock=clock) as live:
        live.step("compensated", 10.0)
        live.samples(lot(0, 5, 50), lot(0, 5, 50).displacement)
        console = terminal(width=40)
        console.print(picture(live))
    lines = console.export_text().splitlines()
    assert len(lines) == 5
    assert all(len(line) <= 40 for line in lines)
