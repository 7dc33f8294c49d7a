"""What every reader of a file format must do: a sound file of each suffix. The tests are those of `dehyst.testing`."""

import tempfile
from functools import cache
from pathlib import Path

import file_specimens
import pytest

from dehyst.records import LOADERS, Allowance, Record
from dehyst.testing import ReaderCandidate, ReaderContract

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


@cache
def specimens():
    with tempfile.TemporaryDirectory() as folder:
        return file_specimens.specimens(Path(folder))


def test_every_suffix_has_a_file_here():
    # LabVIEW's other suffix.
    assert {Path(name).suffix for name in NAMES} == set(LOADERS) - {".asc"}


class TestEveryReader(ReaderContract):
    @pytest.fixture(params=NAMES)
    def candidate(self, request):
        return ReaderCandidate(request.param, specimens()[request.param], RECORD, tolerance=1e-6)


def test_a_reader_that_takes_no_allowance_is_noticed(monkeypatch):
    rows = "".join(f"{t},{v},{y}\n" for t, v, y in zip(RECORD.time, RECORD.voltage, RECORD.displacement, strict=True))
    candidate = ReaderCandidate("greedy.csv", rows.encode(), RECORD)
    ReaderContract().test_the_allowance_of_memory_holds(candidate)
    monkeypatch.setattr(Allowance, "take", lambda *_: None)
    with pytest.raises(pytest.fail.Exception):
        ReaderContract().test_the_allowance_of_memory_holds(candidate)
