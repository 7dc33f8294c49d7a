"""Damaged calibration folders: a clear refusal or a clean recovery, and no record is continued that is not whole."""

import os
import shutil
from pathlib import Path

import pytest

from dehyst import FileFormatError, read
from dehyst.calibration.plan import Excitations
from dehyst.calibration.session import ProgressListener, Session
from dehyst.control import VoltageLimits
from dehyst.instruments.simulated import SimulatedRig
from dehyst.virtual import PlayActuator

LOOK = Excitations((VoltageLimits(0, 200),), 400.0).homing()
RECORD = "records/look.csv"


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    folder = tmp_path_factory.mktemp("base") / "out"
    with Session(folder, SimulatedRig(PlayActuator(plays=30)), ProgressListener()) as job:
        job.record(LOOK, "look")
    return folder


@pytest.fixture
def folder(base, tmp_path):
    return shutil.copytree(base, tmp_path / "out")


def go_on(folder, aside=None):
    """Go on in a folder; returns whether its record was kept. `aside`: files that must be reported as moved."""
    with Session(folder, SimulatedRig(PlayActuator(plays=30)), ProgressListener()) as job:
        record = job.record(LOOK, "look")
    assert len(record) == len(read(folder / RECORD)) == len(LOOK)
    assert job.kept + job.played == ["look"]
    assert aside is None or job.aside == aside
    return bool(job.kept)


# The record


def edited(change):
    """Change the lines of a record."""

    def damage(folder):
        lines = (folder / RECORD).read_text().splitlines(keepends=True)
        (folder / RECORD).write_text("".join(change(lines)))

    return damage


def replaced(content):
    return lambda folder: (folder / RECORD).write_bytes(content)


def row(number, text):
    """Replace a row of samples."""
    return edited(lambda lines: [*lines[: number + 2], f"{text}\n", *lines[number + 3 :]])


def link(target):
    def damage(folder):
        (folder / RECORD).unlink()
        (folder / RECORD).symlink_to(folder / target)

    return damage


def become_a_folder(folder):
    (folder / RECORD).unlink()
    (folder / RECORD).mkdir()


RECORDS = {
    "cut off": edited(lambda lines: lines[:500]),
    "cut off in a line": lambda folder: (folder / RECORD).write_bytes((folder / RECORD).read_bytes()[:20_000]),
    "empty": replaced(b""),
    "zeros": replaced(bytes(50_000)),
    "zeros behind it": edited(lambda lines: [*lines[:500], "\0" * 4096]),
    "text": replaced(b"no record"),
    "a folder": become_a_folder,
    "a dangling link": link("nowhere"),
    "a link to itself": link(RECORD),
    "no head": edited(lambda lines: lines[1:]),
    "head no JSON": edited(lambda lines: ["# dehyst-record: {bad\n", *lines[1:]]),
    "head a list": edited(lambda lines: ["# dehyst-record: [1]\n", *lines[1:]]),
    "key of another excitation": edited(lambda lines: ['# dehyst-record: {"key": "0"}\n', *lines[1:]]),
    "key a list": edited(lambda lines: ['# dehyst-record: {"key": [1]}\n', *lines[1:]]),
    "NaN": row(5, "0.02,nan,1.0"),
    "infinity": row(5, "0.02,1.0,inf"),
    "no number": row(5, "0.02,1.0,1.0x"),
    "time goes back": row(5, "-1.0,1.0,1.0"),
    "a line is missing": edited(lambda lines: [*lines[:700], *lines[701:]]),
    "no voltage": edited(lambda lines: [lines[0], lines[1].replace("voltage_V", "spare"), *lines[2:]]),
}


@pytest.mark.parametrize("name", RECORDS)
def test_a_damaged_record_is_set_aside_and_played_anew(folder, name):
    RECORDS[name](folder)
    aside = folder / "records" / "set-aside" / "look.csv"
    assert not go_on(folder, [aside])
    assert os.path.lexists(aside)
    if name.startswith("a dangling"):
        # Nothing was written to where the link leads.
        assert not (folder / "nowhere").exists()
    assert go_on(folder)


def test_nothing_that_was_set_aside_is_replaced(folder):
    aside = folder / "records" / "set-aside"
    aside.mkdir()
    (aside / "look.csv").write_text("first")
    (aside / "look-2.csv").symlink_to(folder / "nowhere")
    RECORDS["empty"](folder)
    assert not go_on(folder, [aside / "look-3.csv"])
    assert (aside / "look.csv").read_text() == "first" and not (folder / "nowhere").exists()


def test_no_right_to_read_is_no_record(folder, monkeypatch):
    """As another user than root: its file may not be read, but moved."""
    real = Path.open

    def refuse(path, mode="r", **options):
        if path == folder / RECORD and mode == "rb":
            raise PermissionError(13, "Permission denied")
        return real(path, mode, **options)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "open", refuse)
        with Session(folder, SimulatedRig(PlayActuator(plays=30)), ProgressListener()) as job:
            assert job.stored("look", LOOK) is None
    assert go_on(folder)


def test_an_undamaged_record_is_kept(folder, base):
    assert go_on(folder)
    assert (folder / RECORD).read_bytes() == (base / RECORD).read_bytes()


def test_a_record_of_another_name_copied_over_is_not_taken(folder):
    with Session(folder, SimulatedRig(PlayActuator(plays=30)), ProgressListener()) as job:
        job.record(Excitations((VoltageLimits(0, 200),), 200.0).homing(), "homing")
    shutil.copy(folder / "records" / "homing.csv", folder / RECORD)
    assert not go_on(folder)


def test_a_strangers_file_is_left_alone(folder):
    path = folder / "records" / "notes.txt"
    path.write_text("a,b\n1,2\n")
    assert go_on(folder)
    assert path.read_text() == "a,b\n1,2\n"


# The folder


def records_a_file(folder):
    shutil.rmtree(folder / "records")
    (folder / "records").write_text("x")


def aside_a_file(folder):
    (folder / "records" / "set-aside").write_text("x")
    (folder / RECORD).write_bytes(b"")


REFUSED = {
    "records a file": (records_a_file, r"records: is a file where a folder is needed"),
    "set-aside a file": (aside_a_file, r"set-aside: is a file where a folder is needed"),
    "records of another axis": (
        edited(lambda lines: ['# dehyst-record: {"rig": "x", "axis": "2"}\n', *lines[1:]]),
        "axis 2",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_folder_that_cannot_be_used_is_refused_in_a_sentence(folder, name):
    damage, message = REFUSED[name]
    damage(folder)
    before = sorted(folder.rglob("*"))
    with pytest.raises(FileFormatError, match=message):
        go_on(folder)
    assert sorted(folder.rglob("*")) == before
