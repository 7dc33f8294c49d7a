"""Runs that are resumed or begun twice: rows exactly once, of the records as they are, whatever their names."""

import json
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest

import dehyst._io
import dehyst.fleet.run
from dehyst import FileFormatError
from dehyst.fleet import identify_fleet, load, open_dataset
from dehyst.fleet.dataset import text_of
from dehyst.fleet.table import Shards

pytest.importorskip("pyarrow")
from command_line import DEHYST
from fleet_records import kill, until, write_folder, write_parquet

from examples import NIGHTLY, at_night

pytestmark = pytest.mark.usefixtures("in_this_process")

# Names that a file system may hold. A backslash and its escape must stay different.
NAMES = (
    b"\xff\xfe.csv",
    b"\\udcff\\udcfe.csv",
    b"caf\xe9.csv",
    "caf\u00e9.csv".encode(),
    b"a\nb\t\x1b[1m.csv",
    b"\xed\xa0\x80.csv",
)


def started(dataset, output, *more, limit=""):
    """`dehyst fleet identify` as a process, with a limit of the shell."""
    words = [*DEHYST, "fleet", "identify", str(dataset), "-o", str(output), "--jobs", "1", *more]
    if limit:
        words = ["sh", "-c", f'ulimit {limit}; exec "$@"', "sh", *words]
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def rows_of(output):
    return list(Path(f"{output}.parts").glob("*/*.json"))


def drafts(folder):
    return list(folder.rglob(".dehyst-*.tmp"))


def computed(fleet, before):
    """Names of the rows that are not, seconds included, those of an earlier table."""
    known = [dict(row) for row in before.rows]
    return [fleet.name(row) for row in fleet.rows if dict(row) not in known]


@pytest.fixture
def dataset(tmp_path):
    return write_folder(tmp_path / "d", 4)


@pytest.mark.parametrize("more", [(), at_night(("--resume",))])
def test_a_run_beside_another_is_refused_and_the_table_is_that_of_the_first(dataset, tmp_path, more):
    output = tmp_path / "m.parquet"
    first = started(dataset, output)
    assert until(lambda: rows_of(output))
    # It stands still until the second one has looked, however slowly that starts.
    os.kill(first.pid, signal.SIGSTOP)
    second = started(dataset, output, *more)
    _, errors = second.communicate(timeout=60)
    os.kill(first.pid, signal.SIGCONT)
    assert second.returncode == 2 and f"process {first.pid} on" in errors
    assert first.wait(timeout=120) == 0
    assert [row["outcome"] for row in load(output).rows] == ["identified"] * 4
    assert not Path(f"{output}.parts").exists()


@pytest.mark.nightly
def test_a_killed_run_leaves_no_lock_and_no_draft(dataset, tmp_path, monkeypatch):
    # A limit of time ends the process that computes: not this one.
    monkeypatch.undo()
    output = tmp_path / "m.parquet"
    first = started(dataset, output)
    assert until(lambda: rows_of(output))
    kill(first.pid)
    first.communicate()
    for folder in (Path(f"{output}.parts"), rows_of(output)[0].parent):
        (folder / ".dehyst-0123abcd.tmp").write_text("half")
    # Also when a record is lost, and the folder stays.
    lost = identify_fleet(dataset, output, jobs=1, resume=True, time_limit=1e-3)
    assert not drafts(tmp_path)
    assert {row["outcome"] for row in lost.rows} <= {"identified", "lost"}
    assert len(identify_fleet(dataset, output, jobs=1, resume=True)) == 4
    assert not Path(f"{output}.parts").exists()


def test_a_draft_of_the_table_goes_with_the_next_run(dataset, tmp_path, monkeypatch):
    output, replaced = tmp_path / "m.parquet", []

    def cut(path):
        replaced.append(path)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(dehyst._io, "settle_file", cut)
        # As `kill -9`, nothing removes the draft.
        patch.setattr(Path, "unlink", lambda path, missing_ok=False: None)
        with pytest.raises(KeyboardInterrupt):
            identify_fleet(dataset, output, jobs=1)
    assert drafts(tmp_path) == replaced
    assert len(identify_fleet(dataset, output, jobs=1, resume=True)) == 4 and not drafts(tmp_path)


def test_a_folder_that_vanishes_leaves_the_table_as_it_is(dataset, tmp_path, monkeypatch):
    output = tmp_path / "m.parquet"
    identify_fleet(dataset, output, jobs=1)
    before = output.read_bytes()

    def remove(head, *_, **__):
        shutil.rmtree(head["folder"])
        yield None

    monkeypatch.setattr(dehyst.fleet.run, "run_tasks", remove)
    with pytest.raises(FileFormatError):
        identify_fleet(dataset, output, jobs=1)
    assert output.read_bytes() == before


def test_a_lock_of_a_folder_that_was_removed_holds_nothing(tmp_path):
    first, second = (Shards(tmp_path / "m.parquet.parts", "digest") for _ in range(2))
    with first.held():
        first.prepare(1, {}, resume=False)
        with pytest.raises(FileFormatError), second.held():
            pass
        # Another process removes what this one holds: the next run makes a folder of its own.
        first.remove()
        with second.held():
            second.prepare(1, {}, resume=False)
            assert second.begun
    assert not first.folder.exists()


@pytest.mark.nightly
def test_names_of_arbitrary_bytes_are_rows_exactly_once(dataset, tmp_path):
    source = (dataset / "S000" / "0.csv").read_bytes()
    for name in NAMES:
        Path(os.fsdecode(os.fsencode(dataset / "S000") + b"/" + name)).write_bytes(source)
    output = tmp_path / "m.parquet"
    process = started(dataset, output, "--json")
    words, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    assert json.loads(words)["identified"] == 4 + len(NAMES)
    fleet = load(output)
    for column in ("record", "place"):
        assert len({row[column] for row in fleet.rows}) == 4 + len(NAMES)
    assert [one.name for one in fleet.actuators()] == [row["record"] for row in fleet.rows]
    before = output.stat().st_mtime_ns
    assert identify_fleet(dataset, output, jobs=1, resume=True).rows == fleet.rows
    assert output.stat().st_mtime_ns == before


def test_escapes_keep_texts_different_and_other_values_as_they_are():
    texts = ["\udcff", "\\udcff", "\\\\udcff", "\\\udcff", "a\\b", "\ud800", "plain", "\\ud8"]
    escaped = [text_of(text) for text in texts]
    assert len(set(escaped)) == len(texts) and all(text.encode() for text in escaped)
    assert text_of("a\\b") == "a\\b" and text_of(3) == 3 and text_of(True) is True


def test_keys_of_different_kinds_are_text(tmp_path):
    zarr = pytest.importorskip("zarr")
    from fleet_records import write_zarr

    path = write_zarr(tmp_path / "d.zarr", 3)
    root = zarr.open_group(str(path), mode="a")
    for group, serial in (("S000/0", 7), ("S000/1", "\ud800"), ("S001/0", 2**70)):
        root[group].attrs.update({"serial": serial, "session": 1})
    fleet = identify_fleet(path, tmp_path / "m.parquet", by=("serial", "session"), jobs=1)
    assert [row["serial"] for row in fleet.rows] == ["7", "\\ud800", str(2**70)]


def test_a_dataset_that_lost_and_gained_records_computes_only_these(dataset, tmp_path):
    output, remarks = tmp_path / "m.parquet", []
    before = identify_fleet(dataset, output, jobs=1)
    (dataset / "S000" / "1.csv").rename(dataset / "S000" / "1b.csv")
    after = identify_fleet(dataset, output, jobs=1, resume=True, remark=remarks.append)
    assert [after.name(row) for row in after.rows] == ["S000/0", "S000/1b", "S001/0", "S001/1"]
    assert computed(after, before) == ["S000/1b"]
    assert len(remarks) == 1 and remarks[0].startswith("1 record")


def test_shards_of_a_dataset_that_lost_and_gained_records_are_kept(dataset, tmp_path):
    output, remarks = tmp_path / "m.parquet", []
    first = started(dataset, output)
    assert until(lambda: len(rows_of(output)) >= 2)
    kill(first.pid)
    first.communicate()
    done = {path.stem: path.read_text() for path in rows_of(output)}
    gone = next(task for task in open_dataset(dataset).tasks if task.code in done)
    Path(gone.place.path).rename(dataset / "new.csv")
    after = identify_fleet(dataset, output, jobs=1, resume=True, remark=remarks.append)
    assert sorted(row["place"] for row in after.rows) == sorted(task.within for task in open_dataset(dataset).tasks)
    seconds = {json.loads(text)["cpu_s"] for code, text in done.items() if code != gone.code}
    assert seconds <= {row["cpu_s"] for row in after.rows}
    assert len(remarks) == 1


def test_a_link_to_nowhere_and_a_pipe_are_rows(dataset, tmp_path):
    (dataset / "self.csv").symlink_to("self.csv")
    (dataset / "nowhere.csv").symlink_to(tmp_path / "absent.csv")
    os.mkfifo(dataset / "pipe.csv")
    output = tmp_path / "m.parquet"
    rows = {row["record"]: row for row in identify_fleet(dataset, output, jobs=1).rows}
    assert len(rows) == 7
    assert {name: rows[name]["outcome"] for name in ("self", "nowhere", "pipe")} == dict.fromkeys(
        ("self", "nowhere", "pipe"), "refused"
    )
    assert "link" in rows["self"]["reason"] and "link" in rows["nowhere"]["reason"] and "pipe" in rows["pipe"]["reason"]
    before = output.stat().st_mtime_ns
    identify_fleet(dataset, output, jobs=1, resume=True)
    assert output.stat().st_mtime_ns == before


@pytest.mark.parametrize("way", ["in place", "replaced"])
def test_content_changed_at_equal_size_and_time_is_computed_again(dataset, tmp_path, way):
    output, path = tmp_path / "m.parquet", dataset / "S000" / "1.csv"
    before = identify_fleet(dataset, output, jobs=1)
    state, text = path.stat(), path.read_text()
    head, *lines = text.splitlines()
    # Each displacement's last digit is another one: the size stays.
    changed = "\n".join([head, *(line[:-1] + str((int(line[-1]) + 5) % 10) for line in lines)]) + "\n"
    assert len(changed) == len(text) and changed != text
    if way == "replaced":
        path.with_name("other").write_text(changed)
        path.with_name("other").rename(path)
    else:
        path.write_text(changed)
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert (path.stat().st_size, path.stat().st_mtime_ns) == (state.st_size, state.st_mtime_ns)
    after = identify_fleet(dataset, output, jobs=1, resume=True)
    assert computed(after, before) == ["S000/1"]


@pytest.mark.nightly
def test_a_full_disk_ends_the_run_with_its_own_message_and_no_lost_record(dataset, tmp_path):
    output = tmp_path / "m.parquet"
    # The marker fits into this limit of a file's size, a row with its model does not.
    process = started(dataset, output, limit="-f 4")
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 2 and "make room" in errors and "lost" not in errors
    assert not output.exists()
    assert [row["outcome"] for row in identify_fleet(dataset, output, jobs=1, resume=True).rows] == ["identified"] * 4


@pytest.mark.nightly
def test_double_starts_at_any_moment_leave_one_whole_table(tmp_path):
    path = write_parquet(tmp_path / "d.parquet", 3)
    for k, gap in enumerate((0.0, 0.05, 0.8) if NIGHTLY else (0.05,)):
        output = tmp_path / f"m{k}.parquet"
        both = []
        for _ in range(2):
            both.append(started(path, output, "--resume"))
            time.sleep(gap)
        ends = [one.communicate(timeout=120) and one.returncode for one in both]
        assert 0 in ends and set(ends) <= {0, 2}
        assert [row["outcome"] for row in load(output).rows] == ["identified"] * 3
        assert not Path(f"{output}.parts").exists()
