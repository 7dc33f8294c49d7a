"""What every reader of a file format must do: a sound file of each suffix, and damaged copies of it."""

import io
import random
import tempfile
from functools import cache
from pathlib import Path

import file_specimens
import numpy as np
import pytest

from dehyst import DehystError, FileFormatError, Record, read
from dehyst.records import LOADERS, read_table
from dehyst.records.formats.file_content import Allowance

RECORD = Record(file_specimens.T, file_specimens.V, file_specimens.Y)
NAMES = [
    "plain.csv",
    "tabs.tsv",
    "comma.txt",
    "spaces.dat",
    "one.lvm",
    "packed.mat",
    "grouped.h5",
    "packed.hdf5",
    "plain.parquet",
    "named.npy",
    "plain.npz",
    "plain.xlsx",
    "plain.tdms",
]
# Content that is no measurement in any format: nothing but zeros, lines and noise.
FOREIGN = {
    "zeros": bytes(1000),
    "lines": b"\n" * 100,
    "noise": random.Random(1).randbytes(1000),
    "page": b"<!DOCTYPE html><html><body><p>moved</p></body></html>\n",
}
# Damaged copies of a sound file that are read.
DAMAGED = 60


@cache
def specimens():
    with tempfile.TemporaryDirectory() as folder:
        return file_specimens.specimens(Path(folder))


@pytest.fixture(params=NAMES)
def path(request, tmp_path):
    """A sound file of each suffix."""
    (tmp_path / request.param).write_bytes(specimens()[request.param])
    return tmp_path / request.param


def test_every_suffix_has_a_file_here():
    # LabVIEW's other suffix.
    assert {Path(name).suffix for name in NAMES} == set(LOADERS) - {".asc"}


def test_a_sound_file_is_read(path):
    first, second = read(path), read(path)
    for name in ("time", "voltage", "displacement"):
        got, expected = getattr(first, name), getattr(RECORD, name)
        assert got.shape == expected.shape, name
        assert np.abs(got - expected).max() <= 1e-6 * np.ptp(expected), name
    assert first.meta["sha256"] == second.meta["sha256"]
    assert np.array_equal(first.displacement, second.displacement)
    assert len(read(path.rename(path.with_suffix(path.suffix.upper())))) == len(RECORD)


def test_its_columns_are_numbers_with_names(path):
    columns = read_table(path).columns
    assert columns
    for column in columns:
        assert isinstance(column.name, str)
        assert (column.data.ndim, column.data.dtype) == (1, np.float64)
        assert column.data.size or column.fault


@pytest.mark.parametrize("content", FOREIGN)
def test_foreign_content_is_refused(path, content):
    path.write_bytes(FOREIGN[content])
    with pytest.raises(DehystError, match=path.name):
        read(path)


def test_an_empty_file_is_refused(path):
    path.write_bytes(b"")
    with pytest.raises(FileFormatError):
        read(path)


def damaged(content, dice):
    """Return a copy that is cut, or in which some bytes were changed, inserted, removed or repeated."""
    copy = bytearray(content)
    for _ in range(dice.choice((1, 1, 2, 8))):
        start = dice.randrange(len(copy) + 1)
        stop = min(len(copy), start + dice.choice((1, 4, 50)))
        piece = (b"", dice.randbytes(stop - start), b"-", b"9" * 20, bytes(copy[start:stop]) * 2)
        copy[start:stop] = dice.choice(piece)
    return bytes(copy[: dice.randrange(len(copy) + 1)] if dice.random() < 0.2 else copy)


def test_damaged_files_are_read_or_refused(path):
    """Anything but an error of dehyst is a bug of the reader; so is one that does not end."""
    sound = path.read_bytes()
    for number in range(DAMAGED):
        content = damaged(sound, random.Random(number))
        path.write_bytes(content)
        try:
            record = read(path)
        except DehystError:
            continue
        assert np.isfinite(record.displacement).all(), (number, content)


def test_the_limit_of_bytes_holds(path):
    with pytest.raises(FileFormatError, match="allow"):
        read(path, f"max_size={(path.stat().st_size - 1) / 1e6}")


def test_the_allowance_of_memory_holds(path):
    """With memory for one column only, a file of several is refused: its reader takes the numbers first."""
    content = path.read_bytes() if LOADERS[path.suffix] != LOADERS[".csv"] else io.BytesIO(path.read_bytes())
    with pytest.raises(FileFormatError):
        LOADERS[path.suffix](content, Allowance(8 * len(RECORD), path.stem))
