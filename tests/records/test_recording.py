"""Records that are being taken: what `add` returned for is in the file, whatever happens to process, disk or folder."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from typing import NamedTuple

import numpy as np
import pytest

from dehyst._errors import FileFormatError, RecordError
from dehyst.records import Recording, about_of, read
from dehyst.records.recording import demand_disk_space, unused_path

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="signals and limits of POSIX")


class Lot(NamedTuple):
    time: np.ndarray
    voltage: np.ndarray
    displacement: np.ndarray


def lot(first, count):
    """Return samples whose decimals are long."""
    k = np.arange(first, first + count)
    return Lot(k / 3, 50 * np.sin(k / 7), 1e-6 * np.cos(k / 11))


def same(record, count):
    expected = lot(0, count)
    return (
        np.array_equal(record.time, expected.time)
        and np.array_equal(record.voltage, expected.voltage)
        and np.allclose(record.displacement, expected.displacement, rtol=1e-15, atol=0)
    )


# What a child process needs: lots as above, each told on its output once `add` has returned for it.
CHILD = """
import sys, numpy as np
from pathlib import Path
from typing import NamedTuple
from dehyst.records import Recording
class Lot(NamedTuple):
    time: object
    voltage: object
    displacement: object
def lot(first, count):
    k = np.arange(first, first + count)
    return Lot(k / 3, 50 * np.sin(k / 7), 1e-6 * np.cos(k / 11))
recording = Recording(Path(sys.argv[1]) / "a.csv", about={"rig": "x"})
"""


def child(folder, body, **options):
    command = [sys.executable, "-c", CHILD + textwrap.dedent(body), str(folder)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


def test_a_recording_can_be_read_at_any_time(tmp_path):
    path = tmp_path / "tops.csv"
    with Recording(path, about={"rig": "E-709", "axis": 1}) as recording:
        recording.add(lot(0, 10))
        assert same(read(path), 10)
        recording.add(lot(10, 1))
        recording.add(lot(11, 0))
    assert recording.samples == 11
    assert same(read(path), 11)
    assert about_of(path) == {"rig": "E-709", "axis": 1}
    assert path.read_text().splitlines()[1] == "time_s,voltage_V,displacement_um"
    assert [one.name for one in tmp_path.iterdir()] == ["tops.csv"]


def test_refusals(tmp_path):
    for name, match in (("a.h5", "suffix .csv"), ("no/a.csv", "does not exist"), ("a.csv", "is there already")):
        (tmp_path / "a.csv").write_text("mine")
        with pytest.raises(FileFormatError, match=match):
            Recording(tmp_path / name)
    assert (tmp_path / "a.csv").read_text() == "mine"
    with pytest.raises(FileFormatError, match="JSON"):
        Recording(tmp_path / "b.csv", about={"rig": object()})
    assert not (tmp_path / "b.csv").exists()
    recording = Recording(tmp_path / "c.csv")
    with pytest.raises(RecordError, match="2, 2, 3 values"):
        recording.add(Lot(np.zeros(2), np.zeros(2), np.zeros(3)))
    recording.close()
    recording.close()
    with pytest.raises(RecordError, match="closed"):
        recording.add(lot(0, 2))


@POSIX
def test_a_killed_process_loses_nothing_that_add_returned_for(tmp_path):
    body = """
        while True:
            recording.add(lot(recording.samples, 10))
            print(recording.samples, flush=True)
    """
    process = child(tmp_path, body)
    told = 0
    while told < 300:
        told = int(process.stdout.readline())
    process.send_signal(signal.SIGKILL)
    told = max([told, *map(int, process.communicate()[0].split())])
    record = read(tmp_path / "a.csv")
    assert len(record) >= told
    assert same(record, len(record))


@pytest.mark.parametrize("cut", [1, 5, 20, 40, 100])
def test_a_line_that_was_cut_off_is_left_out(tmp_path, cut):
    path = tmp_path / "a.csv"
    with Recording(path) as recording:
        recording.add(lot(0, 40))
    whole = path.read_bytes()
    path.write_bytes(whole[:-cut])
    record = read(path)
    assert same(record, whole[:-cut].count(b"\n") - 2)


@POSIX
def test_a_full_disk_keeps_whole_lines_and_adds_none_behind_a_gap(tmp_path):
    body = """
        import resource
        resource.setrlimit(resource.RLIMIT_FSIZE, (6000, 6000))
        from dehyst import FileFormatError
        for _ in range(2):
            try:
                while True:
                    recording.add(lot(recording.samples, 10))
            except FileFormatError as error:
                assert "make room" in str(error), error
        print(recording.samples)
    """
    process = child(tmp_path, body)
    out, error = process.communicate()
    assert process.returncode == 0, error
    record = read(tmp_path / "a.csv")
    assert len(record) == int(out) > 50
    assert same(record, len(record))


def test_a_file_that_is_removed_while_recording_is_noticed(tmp_path):
    recording = Recording(tmp_path / "a.csv")
    recording.add(lot(0, 5))
    (tmp_path / "a.csv").unlink()
    for _ in range(2):
        with pytest.raises(FileFormatError, match="removed"):
            recording.add(lot(5, 5))
    recording.close()


def test_room_is_what_is_needed_at_most(tmp_path):
    demand_disk_space(tmp_path, 1000)
    with pytest.raises(FileFormatError, match="make room"):
        demand_disk_space(tmp_path, 10**15)
    with Recording(tmp_path / "a.csv") as recording:
        recording.add(Lot(*np.full((3, 100), -2.2250738585072014e-300)))
    assert (tmp_path / "a.csv").stat().st_size < 100 * 3 * 25 + 1000


def test_a_lot_takes_little_time(tmp_path):
    with Recording(tmp_path / "a.csv") as recording:
        began = time.process_time()
        recording.add(lot(0, 50_000))
        assert time.process_time() - began < 1.0


def test_a_path_that_is_in_use_gets_a_number(tmp_path):
    assert unused_path(tmp_path / "a.csv") == tmp_path / "a.csv"
    (tmp_path / "a.csv").touch()
    (tmp_path / "a-2.csv").symlink_to(tmp_path / "nowhere")
    assert unused_path(tmp_path / "a.csv") == tmp_path / "a-3.csv"
    assert os.path.lexists(tmp_path / "a-2.csv")
