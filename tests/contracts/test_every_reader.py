"""What every reader of a file format must do: a sound file of each suffix is read, and what is none is refused."""

import random
import shutil
from pathlib import Path

import numpy as np
import pytest
from laboratory_containers import write_sound
from laboratory_files import T, V, Y

from dehyst import DehystError, FileFormatError, Record, read
from dehyst.records import LOADERS, files, read_table
from dehyst.records.formats.column import Allowance

RECORD = Record(T, V, Y)
NAMES = ["scope.csv", "tabs.tsv", "units.txt", "spaces.dat", "packed.mat", "group.h5", "packed.hdf5", "order.npy"]
NAMES += ["packed.npz", "rows.xlsx", "daq.tdms"]
# Content that is no measurement in any format: nothing but zeros, lines and noise.
FOREIGN = {
    "empty": b"",
    "zeros": bytes(1000),
    "lines": b"\n" * 100,
    "noise": random.Random(1).randbytes(1000),
    "page": b"<!DOCTYPE html><html><body><p>moved</p></body></html>\n",
}


@pytest.fixture(scope="session")
def sound(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sound")
    write_sound(folder)
    return folder


@pytest.fixture(params=NAMES)
def path(request, sound, tmp_path):
    """A sound file of each suffix."""
    return shutil.copy(sound / request.param, tmp_path / request.param)


def test_every_suffix_has_a_test_file():
    assert {Path(name).suffix for name in NAMES} == set(LOADERS) - {".asc"}


def test_a_valid_file_is_read(path):
    first, second = read(path), read(path)
    for name in ("time", "voltage", "displacement"):
        got, expected = getattr(first, name), getattr(RECORD, name)
        assert got.shape == expected.shape, name
        assert np.abs(got - expected).max() <= 1e-6 * np.ptp(expected), name
    assert first.meta["sha256"] == second.meta["sha256"]
    assert np.array_equal(first.displacement, second.displacement)
    assert len(read(path.rename(path.with_suffix(path.suffix.upper())))) == len(RECORD)


def test_the_columns_of_a_file_are_numbers_with_names(path):
    columns = read_table(path).columns
    assert columns
    for column in columns:
        assert isinstance(column.name, str)
        assert (column.data.ndim, column.data.dtype) == (1, np.float64)
        assert column.data.size or column.fault


@pytest.mark.parametrize("content", FOREIGN)
def test_foreign_content_is_refused(path, content):
    path.write_bytes(FOREIGN[content])
    with pytest.raises(DehystError, match=path.name) as caught:
        read(path)
    # Its own words, and not the type of the library's error.
    cause = caught.value.__cause__
    if cause is not None and not isinstance(cause, DehystError):
        assert type(cause).__name__ not in str(caught.value)
        assert caught.value.got and caught.value.need and caught.value.hint


def test_a_file_with_too_many_bytes_is_refused(path, monkeypatch):
    monkeypatch.setattr(files, "MOST", path.stat().st_size - 1)
    with pytest.raises(FileFormatError, match="MB at most"):
        read(path)


def test_a_file_that_needs_too_much_memory_is_refused(path):
    """With memory for one column only, a file of several is refused: its reader takes the numbers first."""
    with path.open("rb") as stream, pytest.raises(FileFormatError):
        LOADERS[path.suffix](stream, Allowance(8 * len(RECORD), path.stem))
