"""Records being made: what `add` returned for is on disk, whatever happens to the process, the disk or the folder."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dehyst._errors import FileFormatError, MissingExtraError, RecordError
from dehyst.records import Record, Recording, read
from dehyst.records.recording import demand_disk_space, salvage, unused_path

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="signals, locks and limits of POSIX")


class Lot(NamedTuple):
    time: np.ndarray
    voltage: np.ndarray
    displacement: np.ndarray


def lot(first, count):
    """Return samples whose decimals are long."""
    k = np.arange(first, first + count)
    return Lot(k / 3, 50 * np.sin(k / 7), 1e-6 * np.cos(k / 11))


def same(record, count):
    return all(
        np.array_equal(getattr(record, column), getattr(lot(0, count), column))
        for column in ("time", "voltage", "displacement")
    )


def names(folder):
    return sorted(path.name for path in folder.iterdir())


# What a child process needs: lots as above, each told on its output once `add` has returned for it.
CHILD = """
import sys, h5py, numpy as np
from pathlib import Path
from typing import NamedTuple
from dehyst.records.recording import Recording, salvage
class Lot(NamedTuple):
    time: object
    voltage: object
    displacement: object
def lot(first, count):
    k = np.arange(first, first + count)
    return Lot(k / 3, 50 * np.sin(k / 7), 1e-6 * np.cos(k / 11))
folder = Path(sys.argv[1])
def go_on(recording, most=10**9, each=10):
    while recording.samples < most:
        recording.add(lot(recording.samples, each))
        print(recording.samples, flush=True)
"""


def child(folder, body, **options):
    command = [sys.executable, "-c", CHILD + textwrap.dedent(body), str(folder)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


def test_a_record_that_is_finished(tmp_path):
    path = tmp_path / "tops.h5"
    with Recording(path, meta={"rig": "E-709", "axis": 1}) as recording:
        recording.add(lot(0, 10))
        recording.add(lot(10, 1))
        recording.add(lot(11, 0))
        assert names(tmp_path) == ["tops.h5.part.csv"]
        assert same(read(recording.journal), 11)
        assert recording.finish() == path
    assert names(tmp_path) == ["tops.h5"]
    record = read(path)
    assert same(record, 11)
    meta = dict(record.meta)
    assert record.name == "tops"
    assert meta.pop("started") <= meta.pop("ended")
    with h5py.File(path) as file:
        assert meta.pop("sha256") == file.attrs["sha256"]
    assert meta == {
        "rig": "E-709",
        "axis": 1,
        "complete": True,
        "ended_because": None,
        "samples": 11,
        "source": "tops.h5",
    }


def test_leaving_the_block_finishes(tmp_path):
    with Recording(tmp_path / "a.h5") as recording:
        recording.add(lot(0, 5))
    assert read(tmp_path / "a.h5").meta["complete"] is True


def test_the_whole_record_comes_before_its_parts(tmp_path):
    with Recording(tmp_path / "a.h5", name="tops", meta={"rig": "old"}) as recording:
        recording.add(lot(0, 5))
        recording.finish(Record(*lot(0, 7), meta={"rig": "new"}))
    record = read(tmp_path / "a.h5")
    assert same(record, 7)
    assert (record.name, record.meta["rig"], record.meta["samples"]) == ("tops", "new", 7)


@pytest.mark.parametrize("error", [ValueError("the link is lost"), KeyboardInterrupt(), SystemExit(143)])
def test_an_exception_leaves_what_came(tmp_path, error):
    with pytest.raises(type(error)), Recording(tmp_path / "a.h5") as recording:
        recording.add(lot(0, 20))
        raise error
    assert names(tmp_path) == ["a.h5"]
    record = read(tmp_path / "a.h5")
    assert same(record, 20)
    assert record.meta["complete"] is False
    assert (
        record.meta["ended_because"]
        == {
            ValueError: "ValueError: the link is lost",
            KeyboardInterrupt: "KeyboardInterrupt",
            SystemExit: "SystemExit: 143",
        }[type(error)]
    )


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_samples_are_kept_but_are_no_record(tmp_path, count):
    recording = Recording(tmp_path / "a.h5")
    recording.add(lot(0, count))
    recording.close()
    recording.close()
    with pytest.raises(FileFormatError, match=rf"a\.h5: holds {count} samples? .*\(closed before it was finished\)"):
        read(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5") as file:
        assert file["time_s"].shape == (count,)


def test_refusals(tmp_path, monkeypatch):
    with pytest.raises(FileFormatError, match=r"the suffix \.h5"):
        Recording(tmp_path / "a.csv")
    with pytest.raises(FileFormatError, match=r"absent does not"):
        Recording(tmp_path / "absent" / "a.h5")
    with pytest.raises(FileFormatError, match="written as JSON"):
        Recording(tmp_path / "a.h5", meta={"x": np.nan})
    with Recording(tmp_path / "a.h5") as recording:
        with pytest.raises(FileFormatError, match="process records"):
            Recording(tmp_path / "a.h5")
        with pytest.raises(RecordError, match="got 2, 1, 2 values"):
            recording.add(Lot([0, 1], [0], [0, 1]))
        recording.add(lot(0, 3))
    for late in (lambda: recording.add(lot(3, 1)), recording.finish):
        with pytest.raises(RecordError, match="begin another"):
            late()
    with pytest.raises(FileFormatError, match="overwritten"):
        Recording(tmp_path / "a.h5")
    with pytest.raises(FileFormatError, match="such folder"):
        salvage(tmp_path / "absent")
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(MissingExtraError, match=r"dehyst\[bench\]"):
        Recording(tmp_path / "b.h5")
    assert names(tmp_path) == ["a.h5"]


def test_a_meta_learned_late_that_cannot_be_told_leaves_the_journal(tmp_path):
    recording = Recording(tmp_path / "a.h5")
    recording.add(lot(0, 4))
    with pytest.raises(FileFormatError, match="All 4 samples"):
        recording.finish(Record(*lot(0, 4), meta={"x": object()}))
    assert same(read(recording.journal), 4)


@POSIX
def test_a_killed_process_loses_nothing_that_add_returned_for(tmp_path):
    for attempt in range(5):
        process = child(tmp_path, f"go_on(Recording(folder / 'run-{attempt}.h5', name='tops', meta={{'a': [1]}}))")
        told = [int(process.stdout.readline()) for _ in range(20 + 7 * attempt)]
        assert salvage(tmp_path) == []  # it still lives
        process.send_signal(signal.SIGKILL)
        told += [int(line) for line in process.stdout.read().split("\n")[:-1]]
        process.wait()
        [path] = salvage(tmp_path)
        record = read(path)
        assert len(record) >= told[-1]
        assert same(record, len(record))
        assert (path.name, record.name, record.meta["a"]) == (f"run-{attempt}.h5", "tops", [1])
        assert record.meta["complete"] is False
        assert "ended before it could write it" in record.meta["ended_because"]
    assert names(tmp_path) == [f"run-{attempt}.h5" for attempt in range(5)]


@POSIX
def test_a_process_told_to_end_writes_its_file(tmp_path):
    process = child(
        tmp_path,
        """
        import signal
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
        with Recording(folder / "a.h5") as recording:
            go_on(recording)
        """,
    )
    told = [int(process.stdout.readline()) for _ in range(10)]
    process.terminate()
    assert process.wait(20) == 143
    record = read(tmp_path / "a.h5")
    assert same(record, len(record))
    assert len(record) >= told[-1]
    assert (names(tmp_path), record.meta["ended_because"]) == (["a.h5"], "SystemExit: 143")


def leave(folder, content, name="a.h5.part.csv"):
    (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())


HEAD = '# {"name": "tops", "meta": {"rig": "x"}, "started": "2026-01-01T00:00:00.000+00:00"}\n'
COLUMNS = "time_s,voltage_V,displacement_m\n"


@given(st.data())
def test_a_journal_cut_anywhere_keeps_its_whole_lines(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("cut")
    rows = [",".join(map(repr, row)) + "\n" for row in zip(*(c.tolist() for c in lot(0, 6)), strict=True)]
    whole = (HEAD + COLUMNS + "".join(rows)).encode()
    kept = whole[: data.draw(st.integers(0, len(whole)))]
    leave(folder, kept)
    [path] = salvage(folder)
    lines = max(0, kept.count(b"\n") - 2)
    assert names(folder) == ["a.h5"]
    with h5py.File(path) as file:
        columns = [file[name][()] for name in ("time_s", "voltage_V", "displacement_m")]
        meta = json.loads(file.attrs["dehyst"])["meta"]
    assert all(np.array_equal(column, expected) for column, expected in zip(columns, lot(0, lines), strict=True))
    rest = kept[kept.rfind(b"\n") + 1 :].decode()
    assert meta.get("cut_off", "") == rest
    assert (meta["complete"], meta["samples"]) == (False, lines)
    assert (meta.get("rig"), meta["started"] is None) == (("x", False) if kept.count(b"\n") else (None, True))


def test_unreadable_lines_are_left_out_said_and_kept(tmp_path):
    leave(tmp_path, HEAD.encode() + COLUMNS.encode() + b"0.0,1.0,2.0\n\0\0\0\xff\n1.0,2.0\n1.0,1.5,2.5\n")
    [path] = salvage(tmp_path)
    record = read(path)
    assert record.voltage.tolist() == [1.0, 1.5]
    assert record.meta["unreadable_lines"] == 2
    assert names(tmp_path) == ["a.h5", "a.h5.part.damaged.csv"]
    assert salvage(tmp_path) == []


def test_nothing_is_overwritten(tmp_path):
    for voltage in (1.0, 2.0, 3.0):
        leave(tmp_path, f"{HEAD}{COLUMNS}0.0,{voltage},0.0\n1.0,9.0,0.0\n")
        salvage(tmp_path)
    assert names(tmp_path) == ["a-2.h5", "a-3.h5", "a.h5"]
    assert [read(tmp_path / name).voltage[0] for name in ("a.h5", "a-2.h5", "a-3.h5")] == [1.0, 2.0, 3.0]
    assert unused_path(tmp_path / "a.h5").name == "a-4.h5"


def test_a_journal_beside_its_finished_file_only_goes(tmp_path):
    recording = Recording(tmp_path / "a.h5")
    recording.add(lot(0, 5))
    journal = recording.journal.read_bytes()
    recording.finish()
    leave(tmp_path, journal)
    assert salvage(tmp_path) == [tmp_path / "a.h5"]
    assert names(tmp_path) == ["a.h5"]
    assert read(tmp_path / "a.h5").meta["complete"] is True


FULL = """
    recording = Recording(folder / "a.h5")
    try:
        with recording:
            go_on(recording, each=100)
    except Exception as error:
        print("raised", type(error).__name__, error, *getattr(error, "__notes__", ()), sep="\\n")
"""


@POSIX
@pytest.mark.parametrize("limit", [20_000, 6_000])
def test_a_file_that_may_grow_no_more(tmp_path, limit):
    """EFBIG: the journal has no room; the file, which is smaller, has in the first case, and then holds all."""
    script = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))\n" + textwrap.dedent(FULL)
    out, err = child(tmp_path, script).communicate(timeout=60)
    told, (kind, message, *notes) = out.split("raised\n")[0].splitlines(), out.split("raised\n")[1].splitlines()
    assert (err, kind) == ("", "FileFormatError")
    assert "a.h5.part.csv: " in message and "(File too large)" in message
    if notes:
        assert "a.h5: " in notes[0] and "(File too large)" in notes[0]
        assert "salvage() makes" in notes[0]
    paths = salvage(tmp_path) if notes else [tmp_path / "a.h5"]
    assert (names(tmp_path), len(notes)) == (["a.h5"], int(limit < 10_000))
    record = read(paths[0])
    # Each lot is of 100: whole lines of the one that failed are there too.
    assert int(told[-1]) < len(record) <= int(told[-1]) + 100
    assert notes or len(record) == int(told[-1]) + 100
    assert same(record, len(record))
    assert record.meta["complete"] is False


@contextlib.contextmanager
def disk(folder, size):
    """A disk of so many bytes, where one may be mounted."""
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "none", str(folder)]
    if sys.platform != "linux" or subprocess.run(command, check=False, capture_output=True).returncode:
        pytest.skip("no file system may be mounted here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def test_a_full_disk(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    with disk(tmp_path / "disk", 65536) as folder:
        recording = Recording(folder / "a.h5")
        refusal = pytest.raises(FileFormatError, match=r"a\.h5\.part\.csv: cannot .*No space left.*make room")
        with refusal as caught, recording:
            for first in range(0, 10_000, 100):
                recording.add(lot(first, 100))
        # Its own disk has no room for the file, another one has: not a sample is lost.
        assert re_note(caught) == f"All {recording.samples} samples are in {tmp_path / 'a.h5'}"
        record = read(tmp_path / "a.h5")
        assert same(record, recording.samples)
        assert record.meta["complete"] is False
        # The journal holds whole lines, also of the lot that failed.
        left = read(recording.journal)
        assert recording.samples - 100 <= len(left) < recording.samples
        assert same(left, len(left))
        with pytest.raises(FileFormatError, match=r"a\.h5: cannot be written \(No space left"):
            salvage(folder)
        assert names(folder) == ["a.h5.part.csv"]
        with pytest.raises(FileFormatError, match=r"1\.1 MB, but 0\.0 MB"):
            demand_disk_space(folder, 1000)


def test_no_lot_goes_behind_one_that_failed(tmp_path):
    with disk(tmp_path / "disk", 16384) as folder:
        recording = Recording(folder / "a.h5")
        with pytest.raises(FileFormatError):
            recording.add(lot(0, 1000))
        whole = recording.journal.read_bytes()
        assert whole.endswith(b"\n")
        with pytest.raises(FileFormatError, match="space left"):
            recording.add(lot(1000, 1))
        assert recording.journal.read_bytes() == whole


def re_note(caught):
    """The sentence on where the samples are."""
    return caught.value.__notes__[-1].rsplit(". ", 1)[-1]


@POSIX
def test_a_folder_that_goes_while_recording(tmp_path, monkeypatch):
    (tmp_path / "stick").mkdir()
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    recording = Recording(tmp_path / "stick" / "a.h5")
    refusal = pytest.raises(FileFormatError, match=r"a\.h5\.part\.csv: was removed")
    with refusal as caught, recording:
        recording.add(lot(0, 10))
        recording.journal.unlink()
        (tmp_path / "stick").rmdir()
        recording.add(lot(10, 10))
    assert re_note(caught) == f"All 20 samples are in {tmp_path / 'a.h5'}"
    assert same(read(tmp_path / "a.h5"), 20)
    assert names(tmp_path) == ["a.h5"]


@POSIX
def test_samples_that_are_lost_are_said_to_be(tmp_path, monkeypatch):
    (tmp_path / "stick").mkdir()
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path / "absent"))
    recording = Recording(tmp_path / "stick" / "a.h5")
    recording.add(lot(0, 10))
    recording.journal.unlink()
    (tmp_path / "stick").rmdir()
    with pytest.raises(FileFormatError, match="The 10 samples"):
        recording.close()


@POSIX
def test_a_folder_that_may_not_be_written_to(tmp_path):
    """As another user than root, who may write everywhere."""
    script = """
    import os
    (folder / "shut").mkdir()
    (folder / "open").mkdir()
    (folder / "shut").chmod(0o555)
    (folder / "open").chmod(0o777)
    folder.chmod(0o755)
    if os.geteuid() == 0:
        os.setuid(65534)
    try:
        Recording(folder / "shut" / "a.h5")
    except Exception as error:
        print(type(error).__name__, error)
    recording = Recording(folder / "open" / "a.h5")
    recording.add(lot(0, 10))
    print("ready", flush=True)
    input()
    try:
        recording.finish()
    except Exception as error:
        print(type(error).__name__, error)
    try:
        salvage(folder / "open")
    except Exception as error:
        print(type(error).__name__, error)
    """
    import tempfile

    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        process = child(folder, script, stdin=subprocess.PIPE)
        refused, ready = process.stdout.readline(), process.stdout.readline()
        (folder / "open").chmod(0o555)
        out, err = process.communicate("\n", timeout=60)
        (folder / "open").chmod(0o777)
        assert (ready, err) == ("ready\n", "")
        assert refused.startswith("FileFormatError ")
        assert "a.h5.part.csv: " in refused and "(Permission denied)" in refused
        finished, salvaged = out.splitlines()
        assert "a.h5: " in finished and "(Permission denied)" in finished and "All 10 samples" in finished
        assert "a.h5: " in salvaged and "(Permission denied)" in salvaged
        [path] = salvage(folder / "open")
        assert same(read(path), 10)


def test_room_is_what_is_needed_at_most(tmp_path):
    """The longest numbers there are."""
    n = 2000
    with Recording(tmp_path / "a.h5") as recording:
        recording.add(
            Lot(-(1 + np.arange(n)[::-1] / 3) * 1e300, np.full(n, -1.2345678901234567e-300), np.full(n, -1 / 3))
        )
        journal = recording.journal.stat().st_size
    assert journal + (tmp_path / "a.h5").stat().st_size <= 99 * n + 10_000
    demand_disk_space(tmp_path, n)
    with pytest.raises(FileFormatError, match=r"99000001\.0 MB"):
        demand_disk_space(tmp_path, 10**12)
    with pytest.raises(FileFormatError, match=r"written \(No such"):
        demand_disk_space(tmp_path / "absent", 1)


def test_a_lot_takes_little_time(tmp_path):
    """A hundred lots a second at most come from a rig."""
    with Recording(tmp_path / "a.h5") as recording:
        start = time.process_time()
        for first in range(0, 10_000, 100):
            recording.add(lot(first, 100))
        assert time.process_time() - start < 100 * 0.1
    assert os.fspath(recording.path) == str(tmp_path / "a.h5")


def test_a_discarded_recording_leaves_nothing(tmp_path):
    with Recording(tmp_path / "a.h5") as recording:
        recording.add(lot(0, 4))
        recording.add(lot(4, 3))
        assert [column.tolist() for column in recording.columns.values()] == [column.tolist() for column in lot(0, 7)]
        recording.discard()
        with pytest.raises(RecordError):
            recording.add(lot(7, 1))
    recording.close()
    recording.discard()
    assert names(tmp_path) == []
