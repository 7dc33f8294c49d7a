"""The small parts of the rig process: lines, messages, live data, requests."""

import fcntl
import json
import os
import threading
import time

import numpy as np
import pytest

from dehyst._process import LONGEST, Outlet, lines_of
from dehyst.instruments import RigError, Samples
from dehyst.instruments.simulated import SimulatedRig
from dehyst.records import read, write_columns
from dehyst.virtual import AgeingActuator, AgeingCourse, PlayActuator
from dehyst.workbench.rig.messages import number, pair, path, text
from dehyst.workbench.rig.tasks import MOST, LiveFeed, playing, thinned


def received(data, pieces):
    """Return the lines of what comes through a pipe in pieces."""
    reading, writing = os.pipe()

    def write():
        for first in range(0, len(data), pieces):
            os.write(writing, data[first : first + pieces])
        os.close(writing)

    threading.Thread(target=write, daemon=True).start()
    lines = list(lines_of(reading))
    os.close(reading)
    return lines


@pytest.mark.parametrize("pieces", [1, 7, 10**6])
def test_lines_come_whole_in_whatever_pieces(pieces):
    assert received(b"one\n\n  \ntwo\nthree", pieces) == [b"one", b"two"]


@pytest.mark.parametrize("pieces", [1000, 10**6])
def test_a_line_that_is_too_long_is_one_refusal(pieces):
    long = b"x" * (3 * LONGEST)
    assert received(b"one\n" + long + b"\ntwo\n" + long, pieces) == [b"one", None, b"two"]
    assert received(b"x" * LONGEST + b"\n", pieces) == [b"x" * LONGEST]


def test_messages_are_written_in_order_and_changes_of_the_state_merged():
    reading, writing = os.pipe()
    outlet = Outlet(writing, "rig")
    outlet.state(status="armed", words=["a"])
    outlet.error("no")
    outlet.state(status="playing")
    outlet.state(voltage=float("nan"))
    assert outlet.flush(5.0)
    messages = [json.loads(line) for line in os.read(reading, 1 << 16).splitlines()]
    state = {}
    for message in messages:
        if message["kind"] == "rig":
            state |= message
    assert state == {"kind": "rig", "status": "playing", "words": ["a"], "voltage": None}
    assert {"kind": "error", "error": "no"} in messages


def test_if_nobody_reads_live_data_are_dropped_and_the_state_is_kept():
    reading, writing = os.pipe()
    fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 4096)
    outlet = Outlet(writing)
    began = time.monotonic()
    for count in range(5000):
        outlet.live({"kind": "live", "v": [0.0] * 200, "count": count})
        outlet.progress(voltage=count)
    outlet.state(status="connected", words=["why"])
    assert not outlet.flush(0.1)
    assert time.monotonic() - began < 5.0
    threading.Thread(target=outlet.flush, args=(5.0,), daemon=True).start()
    data = b""
    while b'"why"' not in data:
        data += os.read(reading, 1 << 16)
    assert data.count(b'"live"') < 200


def test_a_reader_that_is_gone_closes_it():
    reading, writing = os.pipe()
    os.close(reading)
    outlet = Outlet(writing)
    outlet.state(status="armed")
    assert not outlet.flush(5.0)
    assert outlet.closed


@pytest.mark.parametrize("size", [1, 2, 199, 200, 201, 1000, 100_003])
def test_thinned_samples_keep_the_extremes_and_the_last(size):
    voltage = np.sin(np.arange(size) / 7.3) * np.linspace(1, 2, size)
    rows = thinned(voltage)
    assert rows.size <= MOST
    assert (np.diff(rows) > 0).all()
    assert rows[-1] == size - 1
    assert voltage[rows].max() == voltage.max()
    assert voltage[rows].min() == voltage.min()


def batch(first, count=10):
    time_ = np.arange(first, first + count) / 100.0
    return Samples(time_, 10 * time_, 1e-6 * time_)


def test_the_feed_sends_micrometres_shares_and_what_is_wanted():
    live, states = [], []
    feed = LiveFeed(live.append, lambda **change: states.append(change), lambda: None)
    feed.step("loops", 1.0)
    feed.samples(batch(0), expected=np.array([np.nan] * 9 + [2e-6]))
    feed.samples(batch(10, 41))
    feed.end()
    assert [len(one["t"]) for one in live] == [10, 41]
    assert live[0]["expected"] == [None] * 9 + [2.0]
    assert live[1]["y"][-1] == 0.5
    assert live[1]["share"] == 0.5
    assert {one["step"] for one in live} == {"loops"}
    assert states[0] == {"step": "loops", "progress": 0.0, "words": []}
    assert states[-1] == {"step": None, "progress": None, "voltage": 5.0, "displacement_um": 0.5}


def test_the_feed_stops_after_a_batch_and_before_a_step():
    def stop():
        raise KeyboardInterrupt

    feed = LiveFeed(lambda _: None, lambda **_: None, stop)
    for call in (lambda: feed.samples(batch(0)), lambda: feed.step("look"), lambda: feed.message("x")):
        with pytest.raises(KeyboardInterrupt):
            call()
    assert feed.last.voltage == pytest.approx(0.9)


def test_the_record_of_a_stopped_wave_has_the_further_channels_of_the_rig(tmp_path):
    rig = SimulatedRig(AgeingActuator(PlayActuator(), AgeingCourse(kelvins=20, seconds=60)))
    time_ = 0.005 * np.arange(200)
    write_columns(tmp_path / "v.csv", {"time_s": time_, "voltage_V": 50 - 50 * np.cos(2 * np.pi * time_)})
    request = {"do": "play", "file": str(tmp_path / "v.csv"), "record": str(tmp_path / "v.h5")}

    def stop():
        if feed.count >= 100:
            raise KeyboardInterrupt

    feed = LiveFeed(lambda _: None, lambda **_: None, stop)
    with pytest.raises(KeyboardInterrupt):
        playing(rig, request, feed, first=False)()
    record = read(tmp_path / "v.h5")
    assert record.meta["complete"] is False
    assert 100 <= len(record) < 200
    assert record.temperature is not None and record.temperature.size == len(record)


@pytest.mark.parametrize("value", [None, "", 5, [], {}])
def test_a_text_is_a_text(value):
    with pytest.raises(RigError, match="need a text"):
        text({"do": "play", "file": value}, "file")


@pytest.mark.parametrize("value", [True, "1", [], float("inf"), float("nan")])
def test_a_number_is_finite(value):
    with pytest.raises(RigError, match="finite number"):
        number({"do": "arm", "slew": value}, "slew")


@pytest.mark.parametrize("value", [5, [1], [1, 2, 3], [None, 1], ["a", 1], "ab", {"a": 1, "b": 2}])
def test_a_pair_is_two_numbers(value):
    with pytest.raises(RigError):
        pair({"do": "arm", "limits": value}, "limits")


def test_a_path_has_no_zero_byte():
    with pytest.raises(RigError, match="not the name"):
        path({"do": "play", "file": "a\0b"}, "file")
