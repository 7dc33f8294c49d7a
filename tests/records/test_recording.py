"""Records that are being taken: what `add` returned for is in the file, whatever happens to process, disk or folder."""

import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from dehyst._errors import FileFormatError, RecordError
from dehyst.records import Recording, about_of, read

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="signals and limits of POSIX")


def block(first, count):
    """Return samples whose decimals are long."""
    k = np.arange(first, first + count)
    return SimpleNamespace(time=k / 3, voltage=50 * np.sin(k / 7), displacement=1e-6 * np.cos(k / 11))


def assert_recorded(path, count):
    record, expected = read(path), block(0, count)
    assert record.time.tolist() == expected.time.tolist()
    assert record.voltage.tolist() == expected.voltage.tolist()
    np.testing.assert_allclose(record.displacement, expected.displacement, rtol=1e-15)


def child(path, body):
    """Run code in a process of its own, with `block` and a recording."""
    head = "import sys\nfrom test_recording import *\nrecording = Recording(sys.argv[1])\n"
    command = [sys.executable, "-c", head + textwrap.dedent(body), str(path)]
    folders = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, env={**os.environ, "PYTHONPATH": folders}, **pipes)


def test_a_recording_can_be_read_at_any_time(tmp_path):
    path = tmp_path / "tops.csv"
    with Recording(path, about={"rig": "E-709", "axis": 1}) as recording:
        recording.add(block(0, 10))
        assert_recorded(path, 10)
        recording.add(block(10, 1))
        recording.add(block(11, 0))
    assert recording.samples == 11
    assert_recorded(path, 11)
    assert about_of(path) == {"rig": "E-709", "axis": 1}
    assert path.read_text().splitlines()[1] == "time_s,voltage_V,displacement_um"
    assert [path.name for path in tmp_path.iterdir()] == ["tops.csv"]


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("a.h5", {}),
        ("no/a.csv", {}),
        ("mine.csv", {}),
        ("b.csv", {"about": {"rig": object()}}),
        ("c.csv", {"others": "T"}),
    ],
)
def test_impossible_arguments_of_a_recording_are_refused(name, options, tmp_path):
    (tmp_path / "mine.csv").write_text("mine")
    with pytest.raises(FileFormatError):
        Recording(tmp_path / name, **options)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("mine.csv", "mine")]


def test_a_closed_recording_takes_no_samples(tmp_path):
    recording = Recording(tmp_path / "c.csv")
    recording.close()
    recording.close()
    with pytest.raises(RecordError, match="closed"):
        recording.add(block(0, 2))


@POSIX
def test_a_killed_process_loses_no_added_samples(tmp_path):
    process = child(
        tmp_path / "a.csv",
        """
        while True:
            recording.add(block(recording.samples, 10))
            print(recording.samples, flush=True)
        """,
    )
    told = 0
    while told < 300:
        told = int(process.stdout.readline())
    process.send_signal(signal.SIGKILL)
    told = max([told, *map(int, process.communicate()[0].split())])
    count = len(read(tmp_path / "a.csv"))
    assert count >= told
    assert_recorded(tmp_path / "a.csv", count)


@pytest.mark.parametrize("cut", [1, 5, 20, 40, 100])
def test_a_line_that_was_cut_off_is_left_out(tmp_path, cut):
    path = tmp_path / "a.csv"
    with Recording(path) as recording:
        recording.add(block(0, 40))
    whole = path.read_bytes()
    path.write_bytes(whole[:-cut])
    assert_recorded(path, whole[:-cut].count(b"\n") - 2)


@POSIX
def test_a_full_disk_leaves_complete_lines_without_a_gap(tmp_path):
    process = child(
        tmp_path / "a.csv",
        """
        import resource
        resource.setrlimit(resource.RLIMIT_FSIZE, (6000, 6000))
        for _ in range(2):
            with pytest.raises(FileFormatError, match="make room"):
                while True:
                    recording.add(block(recording.samples, 10))
        print(recording.samples)
        """,
    )
    out, error = process.communicate()
    assert process.returncode == 0, error
    assert int(out) > 50
    assert_recorded(tmp_path / "a.csv", int(out))


def test_a_file_that_is_removed_while_recording_is_noticed(tmp_path):
    with Recording(tmp_path / "a.csv") as recording:
        recording.add(block(0, 5))
        (tmp_path / "a.csv").unlink()
        for _ in range(2):
            with pytest.raises(FileFormatError, match="removed"):
                recording.add(block(5, 5))
