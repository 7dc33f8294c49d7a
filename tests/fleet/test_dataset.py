"""The index of a dataset: where each record lies and its keys, from three kinds of storage."""

import shutil

import numpy as np
import pytest

from dehyst import FileFormatError
from dehyst.fleet import open_dataset
from dehyst.fleet.dataset import Reader, Task, sha256_of, stamp_of

pytest.importorskip("pyarrow")
pytest.importorskip("zarr")
from fleet_records import columns, write_folder, write_parquet, write_zarr

BY = ("serial", "session")
WRITERS = {"parquet": (write_parquet, "d.parquet"), "zarr": (write_zarr, "d.zarr"), "folder": (write_folder, "d")}


@pytest.mark.parametrize("kind", WRITERS)
def test_records_and_keys_of_each_kind(tmp_path, kind):
    write, name = WRITERS[kind]
    dataset = open_dataset(write(tmp_path / name, 5), BY)
    assert [str(v) for task in dataset.tasks for v in task.keys.values()] == [
        "S000",
        "0",
        "S000",
        "1",
        "S001",
        "0",
        "S001",
        "1",
        "S002",
        "0",
    ]
    reader = Reader({})
    for task in dataset.tasks:
        record = reader.record(task)
        expected = columns(task.position)
        assert record.name == task.name
        assert np.array_equal(record.time, expected[0]) and np.array_equal(record.voltage, expected[1])
        assert np.allclose(record.displacement, 1e-6 * expected[2], rtol=1e-12, atol=1e-20)


def test_without_keys_a_record_has_its_number_or_its_name(tmp_path):
    numbers = open_dataset(write_parquet(tmp_path / "d.parquet", 3))
    names = open_dataset(write_folder(tmp_path / "d", 3))
    assert [dict(task.keys) for task in numbers.tasks] == [{"record": k} for k in range(3)]
    assert [task.name for task in names.tasks] == ["S000/0", "S000/1", "S001/0"]


def test_names_of_files_give_keys_too(tmp_path):
    write_folder(tmp_path / "d", 2)
    (tmp_path / "d" / "S000" / "0.csv").rename(tmp_path / "d" / "A7_monday.csv")
    (tmp_path / "d" / "S000" / "1.csv").rename(tmp_path / "d" / "B8_friday.csv")
    tasks = open_dataset(tmp_path / "d", BY).tasks
    assert [dict(task.keys) for task in tasks] == [
        {"serial": "A7", "session": "monday"},
        {"serial": "B8", "session": "friday"},
    ]


def test_the_digest_is_that_of_the_name_and_of_those_of_the_keys(tmp_path):
    first = open_dataset(write_parquet(tmp_path / "a.parquet", 3), BY)
    (tmp_path / "b").mkdir()
    same = open_dataset(write_parquet(tmp_path / "b" / "a.parquet", 3), BY)
    more = open_dataset(write_parquet(tmp_path / "b" / "a.parquet", 4), BY)
    assert first.digest == same.digest == more.digest
    other = open_dataset(write_parquet(tmp_path / "c.parquet", 3), BY)
    assert len({first.digest, other.digest, open_dataset(tmp_path / "a.parquet").digest}) == 3
    # The files of a row do not depend on how many records there are.
    assert [task.code for task in more.tasks[:3]] == [task.code for task in first.tasks]
    assert len({task.code for task in more.tasks}) == 4


@pytest.mark.parametrize(
    ("by", "words"),
    [
        (("batch",), "has no column 'batch' for --by; it holds 'serial', 'session'"),
        (
            ("voltage_V",),
            "row group 0: column 'voltage_V' has the values .*, need one; write each record as a row group",
        ),
        (("serial", "serial"), "need different names of keys"),
    ],
)
def test_keys_that_a_dataset_does_not_have(tmp_path, by, words):
    path = write_parquet(tmp_path / "d.parquet", 2)
    with pytest.raises(FileFormatError, match=words):
        open_dataset(path, by)


def test_what_is_no_dataset(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "a.txt").write_text("x")
    for name, words in (("absent", "no such dataset"), ("empty", "holds no record"), ("a.txt", "is no dataset")):
        with pytest.raises(FileFormatError, match=words):
            open_dataset(tmp_path / name)
    write_folder(tmp_path / "d", 2)
    with pytest.raises(FileFormatError, match="has 2 parts, but --by names 3 keys"):
        open_dataset(tmp_path / "d", ("a", "b", "c"))


def test_records_with_the_same_keys_are_remarked(tmp_path):
    path = write_parquet(tmp_path / "d.parquet", 4)
    assert open_dataset(path, BY).remarks == ()
    (remark,) = open_dataset(path, ("serial",)).remarks
    assert remark.startswith("4 of 4 records share their keys (serial) with another, as S000 (2 records)")


@pytest.mark.parametrize("kind", WRITERS)
def test_a_row_is_current_until_its_samples_change(tmp_path, kind):
    write, name = WRITERS[kind]
    path = write(tmp_path / name, 3)
    task, reader = open_dataset(path, BY).tasks[1], Reader({})
    samples = sha256_of(reader.record(task))
    row = {"keys": dict(task.keys), "stamp": stamp_of(task.place), "sha256": samples}
    assert reader.is_current(row, task)
    # Other files with the same samples: the hash decides.
    assert reader.is_current(row | {"stamp": "other"}, task)
    assert not reader.is_current(row | {"stamp": "other", "sha256": None}, task)
    # The keys are a part of the row: another actuator with the same samples.
    assert not reader.is_current(row | {"keys": {"serial": "S999", "session": 1}}, task)
    other = write(tmp_path / f"other_{name}", 4)
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    moved = open_dataset(other, BY).tasks[3]
    changed = {"parquet": lambda: write_parquet(path, 3, lambda k: {"gain": 1.5})}.get(kind, lambda: other.rename(path))
    changed()
    task = task if kind == "parquet" else Task(1, task.keys, open_dataset(path, BY).tasks[moved.position].place)
    assert not reader.is_current(row, task)
