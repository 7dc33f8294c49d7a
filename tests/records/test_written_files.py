"""Files that are written: records, columns and JSON, wholly or not at all."""

import errno
import os
import stat
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from laboratory_files import text

from dehyst._errors import FileFormatError
from dehyst._io import draft_of, is_draft, read_json, write_atomically, write_json
from dehyst.records import write_columns


@pytest.mark.parametrize(
    "write",
    [
        lambda folder: write_columns(folder / "a.mat", {"time_s": [1]}),
        lambda folder: write_columns(folder / "a.csv", {"time_s": [1], "y_um": [1, 2]}),
        lambda folder: write_columns(folder / "a.csv", {}),
        lambda folder: write_columns(folder / "a.csv", {"time, s": [1]}),
        lambda folder: write_atomically(folder / "absent" / "a.csv", "x"),
        lambda folder: write_atomically(folder, "x"),
        lambda folder: write_json(folder / "absent" / "a.json", {}),
        lambda folder: read_json(folder / "absent.json"),
        read_json,
    ],
)
def test_a_failed_write_leaves_no_file(tmp_path, write):
    with pytest.raises(FileFormatError):
        write(tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("owner", "name"), [(Path, "replace"), (os, "fsync")])
def test_a_write_that_fails_keeps_the_old_file(tmp_path, monkeypatch, owner, name):
    def fail(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    path = text(tmp_path, "old", "a.txt")
    monkeypatch.setattr(owner, name, fail)
    with pytest.raises(FileFormatError):
        write_atomically(path, "new")
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("a.txt", "old")]


def test_a_file_is_synced_before_it_is_renamed(tmp_path, monkeypatch):
    """Else a power cut leaves an empty file where the old one was."""
    done, sync, replace = [], os.fsync, Path.replace

    def settle(descriptor):
        done.append("folder" if stat.S_ISDIR(os.fstat(descriptor).st_mode) else "file")
        assert done[-1] == "folder" or os.fstat(descriptor).st_size == 3
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", settle)
    monkeypatch.setattr(Path, "replace", lambda source, other: done.append("rename") or replace(source, other))
    write_atomically(tmp_path / "a.txt", "new")
    assert done == ["file", "rename", "folder"][: 3 if sys.platform != "win32" else 2]


@pytest.mark.skipif(sys.platform == "win32", reason="modes of POSIX")
def test_a_file_keeps_its_mode_and_a_new_one_has_the_usual(tmp_path):
    path = text(tmp_path, "old", "a.txt")
    path.chmod(0o640)
    before = os.umask(0o027)
    try:
        write_atomically(path, "new")
        write_atomically(tmp_path / "b.txt", "new")
    finally:
        os.umask(before)
    assert [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("a.txt", "b.txt")] == [0o640, 0o640]
    path.chmod(0o604)
    write_atomically(path, "newer")
    assert stat.S_IMODE(path.stat().st_mode) == 0o604


def test_the_name_of_a_draft_is_short_hidden_and_recognised(tmp_path):
    draft = draft_of(tmp_path / (255 * "x"))
    assert is_draft(draft.name) and draft.name.startswith(".") and len(draft.name) < 30
    assert not is_draft("a.tmp") and not is_draft(".dehyst-notes.tmp")


@pytest.mark.skipif(sys.platform == "win32", reason="links and devices of POSIX")
def test_write_atomically_keeps_links_and_pipes(tmp_path):
    path = text(tmp_path, "old", "a.txt")
    link = tmp_path / "link"
    link.symlink_to(path)
    write_atomically(link, "new")
    assert link.is_symlink()
    assert path.read_text() == "new"
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_atomically(pipe, "sent")
    assert os.read(reader, 10) == b"sent"
    os.close(reader)
    assert stat.S_ISFIFO(pipe.stat().st_mode)


# Text from few characters, the awkward ones: the first draw from all of Unicode takes seconds on a cold machine.
json_text = st.text(st.sampled_from('ab"\\/\n\0é\u2028\ud800\U0001f600'), max_size=6)
json_numbers = st.integers(-(10**300), 10**300) | st.floats(allow_nan=False, allow_infinity=False)
json_values = st.recursive(
    st.none() | st.booleans() | json_numbers | json_text,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(json_text, inner, max_size=4),
    max_leaves=12,
)


@given(st.dictionaries(json_text, json_values, max_size=5))
def test_written_json_is_read_exactly(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("j") / "a.json"
    write_json(path, data)
    back = read_json(path)
    assert back == data
    assert repr(back) == repr(data)  # types, signs of zeros and the order of keys too


def test_json_is_indented_ascii_with_its_keys_in_order(tmp_path):
    write_json(tmp_path / "a.json", {"b": [1.0, -0.0], "a": {"é": None}})
    assert (tmp_path / "a.json").read_bytes() == (
        b'{\n "b": [\n  1.0,\n  -0.0\n ],\n "a": {\n  "\\u00e9": null\n }\n}\n'
    )


def test_json_may_start_with_a_byte_order_mark_and_hold_utf8(tmp_path):
    assert read_json(text(tmp_path, '{"µ": 1}', "a.json", encoding="utf-8-sig")) == {"µ": 1}


BROKEN_JSON = {
    "empty": "",
    "table": "time_s,voltage_V\n0,1\n",
    "no JSON": '{"a": 1,\n "b": x}',
    "cut off": '{"a": [1,\n2',
    "comment": "{} // x",
    "single quotes": "{'a': 1}",
    "NaN": '{"a": [NaN]}',
    "infinity": '{"a": -Infinity}',
    "overflow": '{"a": 1e999}',
    "large integer": '{"a": ' + "9" * 310 + "}",
    "integer of more digits than Python reads": '{"a": ' + "9" * 9999 + "}",
    "twice": '{"a": 1, "b": 2, "b": 2}',
    "twice inside": '{"a": [{"b": {"c": 1, "c": 1}}]}',
    "list": "[{}]",
    "deep": '{"a":' + "[" * 100_000,
    "no UTF-8": '{"µ": 1}',
}


@pytest.mark.parametrize("case", BROKEN_JSON)
def test_broken_json_is_refused(tmp_path, case):
    with pytest.raises(FileFormatError):
        read_json(text(tmp_path, BROKEN_JSON[case], "a.json", "latin-1"))


CIRCLE: dict[str, object] = {}
CIRCLE["a"] = CIRCLE


@pytest.mark.parametrize(
    "value", [float("nan"), float("-inf"), np.float64("inf"), {1, 2}, np.arange(3), {"deep": [b"bytes"]}, CIRCLE]
)
def test_write_json_refuses_nan_and_other_types(tmp_path, value):
    path = text(tmp_path, "old", "a.json")
    with pytest.raises(FileFormatError):
        write_json(path, {"a": value})
    assert path.read_text() == "old"
