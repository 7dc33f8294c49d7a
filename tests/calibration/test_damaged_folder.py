"""Damaged calibration folders: a clear refusal or a clean recovery, never a damaged record, no readable sample lost."""

import contextlib
import hashlib
import json
import os
import random
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

from dehyst import DehystError, FileFormatError, RecordError, read
from dehyst.calibration.plan import ExcitationPlan
from dehyst.calibration.session import NullProgress, Session
from dehyst.instruments.simulated import SimulatedRig
from dehyst.records import files
from dehyst.records.hdf5 import sha256_of
from dehyst.records.recording import salvage
from dehyst.virtual import PlayActuator

LOOK = ExcitationPlan(0, 200, 200.0, hold=0.5).look()
RECORD = "records/look.h5"
JOURNAL = "records/look.h5.part.csv"
HEAD = '# {"name": "look", "meta": {"rig": "x"}, "started": "2026-01-01"}\ntime_s,voltage_V,displacement_m\n'
ROWS = "0.0,0.0,0.0\n1.0,1.0,1e-07\n2.0,3.0,2e-07\n"
COLUMNS = ("time_s", "voltage_V", "displacement_m")
# A share of the flips runs by default; the rest of 2000 with DEHYST_FLIPS=2000.
FLIPS = int(os.environ.get("DEHYST_FLIPS", "60"))


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    folder = tmp_path_factory.mktemp("base") / "out"
    Session(folder, SimulatedRig(PlayActuator(plays=30)), NullProgress()).record(LOOK, "look")
    return folder


@pytest.fixture
def folder(base, tmp_path):
    return shutil.copytree(base, tmp_path / "out")


def go_on(folder, aside=None):
    """Go on in a folder; returns whether its record was kept. `aside`: files that must be reported as moved."""
    job = Session(folder, SimulatedRig(PlayActuator(plays=30)), NullProgress())
    record = job.record(LOOK, "look")
    assert len(record) == len(LOOK)
    assert read(folder / RECORD).meta["complete"] is True
    assert job.kept + job.played == ["look"]
    assert aside is None or job.aside == aside
    return bool(job.kept)


def samples(path):
    with h5py.File(path) as file:
        return np.array([file[name][()] for name in COLUMNS])


def salvaged(folder):
    """Rows of each record that a journal became, and the names of the journals that were kept as damaged."""
    found = []
    for path in [*(folder / "records").glob("look-*.h5"), *(folder / "records").glob("set-aside/*.h5")]:
        with contextlib.suppress(OSError, KeyError, ValueError, TypeError):
            found.append(samples(path).T.tolist())
    return found, [path.name for path in (folder / "records").glob("*.part.damaged.csv")]


def rows_of(text):
    return [[float(value) for value in line.split(",")] for line in text.splitlines()]


# The record


def edit(change, *, sign=False):
    """Change a file of HDF5; `sign` it as if its samples were those that were written."""

    def damage(folder):
        with h5py.File(folder / RECORD, "r+") as file:
            change(file)
            if sign:
                file.attrs["sha256"] = sha256_of(tuple(file[name][()] for name in COLUMNS))

    return damage


def put(name, value):
    def change(file):
        column = file[name][()]
        column[5] = value
        file[name][...] = column

    return change


def mark(text):
    return edit(lambda file: file.attrs.__setitem__("dehyst", text))


def meta_with(**values):
    def change(file):
        held = json.loads(file.attrs["dehyst"])
        held["meta"] |= values
        file.attrs["dehyst"] = json.dumps(held)

    return edit(change)


def replaced(content):
    def damage(folder):
        (folder / RECORD).write_bytes(content)

    return damage


def dataset(name, value):
    def change(file):
        del file[name]
        if value is not None:
            file[name] = value

    return edit(change)


def link(target):
    def damage(folder):
        (folder / RECORD).unlink()
        (folder / RECORD).symlink_to(folder / target)

    return damage


def become_a_folder(folder):
    (folder / RECORD).unlink()
    (folder / RECORD).mkdir()


DEEP = '{"name": "look", "meta": {"a": ' + "[" * 100_000 + "]" * 100_000 + "}}"
RECORDS = {
    "cut off": lambda folder: (folder / RECORD).write_bytes((folder / RECORD).read_bytes()[:20_000]),
    "empty": replaced(b""),
    "zeros": replaced(bytes(50_000)),
    "text": replaced(b"no HDF5"),
    "a folder": become_a_folder,
    "a dangling link": link("nowhere"),
    "a link to itself": link(RECORD),
    "one sample edited": edit(put("voltage_V", 3.0)),
    "mark no JSON": mark("{bad"),
    "mark a list": mark("[1]"),
    "mark a number": edit(lambda file: file.attrs.__setitem__("dehyst", 5)),
    "mark of numbers": edit(lambda file: file.attrs.__setitem__("dehyst", [1.0, 2.0])),
    "mark of other bytes": edit(lambda file: file.attrs.__setitem__("dehyst", np.void(b"\xff\xfe{"))),
    "mark too deep": mark(DEEP),
    "meta a list": mark('{"name": "look", "meta": [1]}'),
    "meta null": mark('{"name": "look", "meta": null}'),
    "meta a text": mark('{"name": "look", "meta": "complete"}'),
    "no meta": mark('{"name": "look"}'),
    "name a number": mark('{"name": 5, "meta": {}}'),
    "no name": mark('{"meta": {}}'),
    "no mark": edit(lambda file: file.attrs.__delitem__("dehyst")),
    "no sha256": edit(lambda file: file.attrs.__delitem__("sha256")),
    "sha256 a number": edit(lambda file: file.attrs.__setitem__("sha256", 5)),
    "complete a text": meta_with(complete="yes"),
    "key a list": meta_with(key=[1]),
    "key of another excitation": meta_with(key="0" * 64),
    "NaN, signed": edit(put("displacement_m", np.nan), sign=True),
    "infinity, signed": edit(put("displacement_m", np.inf), sign=True),
    "time goes back, signed": edit(put("time_s", 0.0), sign=True),
    "another sample, signed": edit(put("displacement_m", 1e200), sign=True),
    "no voltage": dataset("voltage_V", None),
    "voltage a text": dataset("voltage_V", "abc"),
    "voltage a table": dataset("voltage_V", np.zeros((3, 4))),
    "voltage shorter": dataset("voltage_V", np.zeros(7)),
    "voltage a group": edit(lambda file: (file.__delitem__("voltage_V"), file.create_group("voltage_V"))),
}


@pytest.mark.parametrize("name", RECORDS)
def test_a_damaged_record_is_set_aside_and_played_anew(folder, base, name):
    RECORDS[name](folder)
    aside = folder / "records" / "set-aside" / "look.h5"
    assert not go_on(folder, [aside])
    assert os.path.lexists(aside)
    if name.startswith("a dangling"):
        # Nothing was written to where the link leads.
        assert not (folder / "nowhere").exists()
    assert go_on(folder)


@pytest.mark.parametrize("name", RECORDS)
def test_reading_a_damaged_record_raises_an_error_of_dehyst(folder, name):
    RECORDS[name](folder)
    try:
        read(folder / RECORD)
    except (FileFormatError, RecordError) as error:
        assert "look" in str(error)


@pytest.mark.parametrize("name", [name for name in RECORDS if name != "a folder"])
def test_a_good_journal_beside_a_damaged_record_is_salvaged(folder, name):
    RECORDS[name](folder)
    (folder / JOURNAL).write_text(HEAD + ROWS)
    assert not go_on(folder)
    found, damaged = salvaged(folder)
    assert rows_of(ROWS) in found
    assert damaged == []
    assert not (folder / JOURNAL).exists()


def test_no_right_to_read_is_no_record(folder, monkeypatch):
    """As another user than root: its file may not be read, but moved."""
    real = files.content_of

    def refuse(path, most):
        if path == folder / RECORD:
            raise PermissionError(13, "Permission denied")
        return real(path, most)

    with monkeypatch.context() as patched:
        patched.setattr(files, "content_of", refuse)
        job = Session(folder, SimulatedRig(PlayActuator(plays=30)), NullProgress())
        assert not job.is_complete(LOOK, "look")
    assert go_on(folder)


def test_an_undamaged_record_is_kept(folder, base):
    assert go_on(folder)
    np.testing.assert_array_equal(samples(folder / RECORD), samples(base / RECORD))


def test_a_record_of_another_name_copied_over_is_not_taken(folder):
    job = Session(folder, SimulatedRig(PlayActuator(plays=30)), NullProgress())
    job.record(ExcitationPlan(0, 200, 200.0).homing(), "homing")
    shutil.copy(folder / "records" / "homing.h5", folder / RECORD)
    assert not go_on(folder)


# The journal

JOURNALS = {
    "whole": (HEAD + ROWS, ROWS, False),
    "time goes back": (HEAD + ROWS + "0.5,1.0,1.0\n3.0,4.0,3e-07\n", ROWS + "3.0,4.0,3e-07\n", True),
    "one time far ahead": (HEAD + ROWS + "1e99,1.0,1.0\n3.0,4.0,3e-07\n", ROWS + "3.0,4.0,3e-07\n", True),
    "a time twice": (HEAD + ROWS + "2.0,9.0,9.0\n3.0,4.0,3e-07\n", None, True),
    "NaN": (HEAD + ROWS + "3.0,nan,1.0\n4.0,4.0,3e-07\n", ROWS + "4.0,4.0,3e-07\n", True),
    "infinity": (HEAD + ROWS + "inf,1.0,1.0\n", ROWS, True),
    "1e999": (HEAD + ROWS + "3.0,1.0,1e999\n", ROWS, True),
    "zeros behind it": (HEAD + ROWS + "\0" * 4096, ROWS, False),
    "a row cut off, then zeros": (HEAD + ROWS + "3.0,4\0\0\0\0", ROWS, False),
    "zeros amid rows": (HEAD + "0.0,0.0,0.0\n\0\0\0\n1.0,1.0,1e-07\n2.0,3.0,2e-07\n", ROWS, True),
    "a long line without end": (HEAD + ROWS + "x" * 50_000, ROWS, True),
    "head of other types": ('# {"name": 1, "meta": "abc", "started": 5}\n' + ROWS, ROWS, True),
    "head's meta a list": ('# {"meta": [1, 2]}\n' + ROWS, ROWS, True),
    "head's meta null": ('# {"meta": null}\n' + ROWS, ROWS, True),
    "head's meta NaN": ('# {"meta": {"a": NaN}}\n' + ROWS, ROWS, True),
    "head too deep": ('# {"meta": {"a": ' + "[" * 100_000 + "]" * 100_000 + "}}\n" + ROWS, ROWS, True),
    "head no JSON": ("# {bad\n" + ROWS, ROWS, True),
    "no head": (ROWS, ROWS, False),
    "empty": ("", "", False),
    "only zeros": ("\0" * 4096, "", False),
    "only a head": (HEAD, "", False),
    "head cut off": ('# {"name": "lo', "", False),
    "bytes of chance": (random.Random(4).randbytes(5000), "", True),
    "somebody else's": ("a,b\n1,2\n", "", True),
}


@pytest.mark.parametrize("name", JOURNALS)
def test_a_journal_is_salvaged_as_far_as_it_can_be_read(folder, name):
    content, expected, damaged = JOURNALS[name]
    content = content.encode() if isinstance(content, str) else content
    (folder / RECORD).unlink()
    (folder / JOURNAL).write_bytes(content)
    assert not go_on(folder)
    found, kept = salvaged(folder)
    if expected is None:
        assert len(found[0]) == 4
    elif expected or found:
        assert found == [rows_of(expected)]
    assert kept == (["look.h5.part.damaged.csv"] if damaged else [])
    if damaged:
        assert (folder / "records" / kept[0]).read_bytes() == content
    for path in (folder / "records" / "set-aside").glob("*.h5"):
        if len(found[0]) >= 2:
            assert read(path).meta["complete"] is False


@pytest.mark.parametrize("name", ["foo.part.csv", ".part.csv", "notes.csv", ".h5.part.csv.bak"])
def test_a_strangers_file_is_left_alone(folder, name):
    path = folder / "records" / name
    path.write_text("a,b\n1,2\n")
    assert go_on(folder)
    assert path.read_text() == "a,b\n1,2\n"


@pytest.mark.parametrize("kind", ["folder", "dangling link", "fifo"])
def test_what_is_no_journal_is_refused_by_its_name(folder, kind):
    path = folder / JOURNAL
    if kind == "folder":
        path.mkdir()
    elif kind == "fifo":
        os.mkfifo(path)
    else:
        path.symlink_to(folder / "nowhere")
    with pytest.raises(FileFormatError, match="journal"):
        go_on(folder)


# The folder


def to_a_folder(path):
    path.unlink()
    path.mkdir()


def records_a_file(folder):
    shutil.rmtree(folder / "records")
    (folder / "records").write_text("x")


def aside_a_file(folder):
    (folder / "records" / "set-aside").write_text("x")
    (folder / RECORD).write_bytes(b"")


REFUSED = {
    "campaign.json empty": (lambda folder: (folder / "campaign.json").write_text(""), r"campaign\.json"),
    "campaign.json a list": (lambda folder: (folder / "campaign.json").write_text("[]"), "object .* is needed"),
    "campaign.json of zeros": (lambda folder: (folder / "campaign.json").write_bytes(bytes(300)), "no valid JSON"),
    "campaign.json too deep": (lambda folder: (folder / "campaign.json").write_text("[" * 10**5), r"campaign\.json"),
    "campaign.json of others": (lambda folder: (folder / "campaign.json").write_text('{"rig": [1]}'), "give another"),
    "campaign.json a folder": (lambda folder: to_a_folder(folder / "campaign.json"), "this is a folder"),
    "records a file": (records_a_file, "cannot be made a folder"),
    "set-aside a file": (aside_a_file, r"set-aside: is a file where a folder is needed"),
    "comparisons a file": (lambda folder: (folder / "records/comparisons").write_text("x"), "comparisons: is a file"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_folder_that_cannot_be_used_is_refused_in_a_sentence(folder, name):
    damage, message = REFUSED[name]
    damage(folder)
    before = sorted(folder.rglob("*"))
    with pytest.raises(FileFormatError, match=message):
        go_on(folder)
    assert sorted(folder.rglob("*")) == before


def test_a_folder_without_its_claim_is_claimed_again(folder):
    (folder / "campaign.json").unlink()
    assert go_on(folder)


# What is on the disk before a journal goes


def test_a_journal_goes_only_after_its_file_is_on_the_disk(folder, monkeypatch):
    """After a process was killed between the two: its file may be in the memory of the computer alone."""
    content = samples(folder / RECORD).T
    text = HEAD + "".join(f"{t!r},{v!r},{y!r}\n" for t, v, y in content.tolist())
    (folder / JOURNAL).write_text(text)
    settled = []
    real = os.fsync

    def fsync(descriptor):
        settled.append(str(Path(f"/proc/self/fd/{descriptor}").readlink()))
        assert (folder / JOURNAL).exists()
        real(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    assert salvage(folder / "records") == [folder / RECORD]
    assert settled == [str(folder / RECORD), str(folder / "records")]
    assert not (folder / JOURNAL).exists()


def test_a_disk_that_fails_keeps_the_journal(folder, monkeypatch):
    (folder / JOURNAL).write_text(HEAD + ROWS)

    def fsync(descriptor):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(FileFormatError, match=r"written \(Input/output error\)"):
        salvage(folder / "records")
    assert (folder / JOURNAL).read_text() == HEAD + ROWS


# Seeded flips of bits


@pytest.mark.parametrize("seed", range(4))
def test_flipped_bits_are_never_kept(base, tmp_path, seed):
    rng = random.Random(seed)
    whole = (base / RECORD).read_bytes()
    original = samples(base / RECORD)
    # What describes the samples is at the ends of the file.
    ends = [*range(2400), *range(max(2400, len(whole) - 4000), len(whole))]
    rig = SimulatedRig(PlayActuator(plays=30))
    played = 0
    for number in range(FLIPS // 4):
        content = bytearray(whole)
        for _ in range(rng.choice([1, 1, 2, 5])):
            content[rng.choice(ends) if rng.random() < 0.8 else rng.randrange(len(whole))] ^= 1 << rng.randrange(8)
        folder = shutil.copytree(base, tmp_path / str(number))
        (folder / RECORD).write_bytes(content)
        beside = rng.random() < 0.5
        if beside:
            (folder / JOURNAL).write_text(HEAD + ROWS)
        try:
            job = Session(folder, rig, NullProgress())
            job.record(LOOK, "look")
        except DehystError as error:
            pytest.fail(f"flip {number} of seed {seed} ends it: {error}")
        if job.kept:
            np.testing.assert_array_equal(samples(folder / RECORD), original)
        if beside:
            assert rows_of(ROWS) in salvaged(folder)[0]
        played += len(job.played)
        shutil.rmtree(folder)
    assert played


def test_flipped_bits_in_a_journal_lose_no_other_line(tmp_path):
    """Every line that no flip has touched is in the record, or in the journal that is kept beside it."""
    rng = random.Random(9)
    lines = [f"{k / 7!r},{float(k)!r},{1e-9 * k!r}\n" for k in range(40)]
    whole = (HEAD + "".join(lines)).encode()
    for number in range(FLIPS * 2):
        content = bytearray(whole)
        for _ in range(rng.choice([1, 2, 5])):
            content[rng.randrange(len(whole))] ^= 1 << rng.randrange(8)
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "a.h5.part.csv").write_bytes(content)
        paths = salvage(folder)
        kept = list(folder.glob("*.part.damaged.csv"))
        if kept:
            assert hashlib.sha256(kept[0].read_bytes()).digest() == hashlib.sha256(content).digest()
        rows = samples(paths[0])
        assert np.isfinite(rows).all()
        assert (np.diff(rows[0]) > 0).all()
        # A flip that makes a line unreadable costs that line, one that joins two costs two.
        assert rows.shape[1] >= 40 - 10
        if rows.shape[1] < 40:
            assert kept or content.rstrip(b"\0")[-1:] != b"\n"
        shutil.rmtree(folder)
