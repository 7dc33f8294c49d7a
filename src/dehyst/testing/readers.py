"""What every reader of a file format must do: a suite of tests for authors, which dehyst's own formats pass too."""

from __future__ import annotations

import random
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from dehyst._errors import DehystError, FileFormatError
from dehyst.records import LOADERS, Allowance, Record, read, read_table

# Content that is no measurement in any format: nothing but zeros, lines and noise.
_FOREIGN = {
    "zeros": bytes(1000),
    "lines": b"\n" * 100,
    "noise": random.Random(1).randbytes(1000),
    "page": b"<!DOCTYPE html><html><body><p>moved</p></body></html>\n",
}
# Damaged copies of the sound file that are read.
_DAMAGED = 60


class ReaderCandidate(NamedTuple):
    """A reader under test.

    `file`: name of a sound file, whose suffix is that of the format. `content`: its bytes. `record`: what is in it.
    `options`: keyword arguments of `dehyst.read`, if names and units are not in the file. `tolerance`: how far its
    numbers may be from those of the record, relative to the range of each column: half of the last digit.
    """

    file: str
    content: bytes
    record: Record
    options: Mapping[str, Any] = {}
    tolerance: float = 1e-9


def _damaged(content: bytes, dice: random.Random) -> bytes:
    """Return a copy that is cut, or in which some bytes were changed, inserted, removed or repeated."""
    damaged = bytearray(content)
    for _ in range(dice.choice((1, 1, 2, 8))):
        start = dice.randrange(len(damaged) + 1)
        stop = min(len(damaged), start + dice.choice((1, 4, 50)))
        piece = (b"", dice.randbytes(stop - start), b"-", b"9" * 20, bytes(damaged[start:stop]) * 2)
        damaged[start:stop] = dice.choice(piece)
    return bytes(damaged[: dice.randrange(len(damaged) + 1)] if dice.random() < 0.2 else damaged)


class ReaderContract:
    """The tests of a reader: the record of a sound file, and dehyst's own errors for any other, within the limits.

    A subclass whose name begins with ``Test`` has a fixture `candidate` that returns a `ReaderCandidate`::

        class TestMyFormat(ReaderContract):
            @pytest.fixture
            def candidate(self):
                return ReaderCandidate("loops.daq", CONTENT, Record(TIME, VOLTAGE, DISPLACEMENT))
    """

    @pytest.fixture
    def path(self, candidate: ReaderCandidate, tmp_path: Path) -> Path:
        """Return the path of the sound file."""
        path = tmp_path / candidate.file
        path.write_bytes(candidate.content)
        return path

    def test_the_suffix_is_registered(self, candidate: ReaderCandidate) -> None:
        assert Path(candidate.file).suffix.lower() in LOADERS

    def test_a_sound_file_is_read(self, candidate: ReaderCandidate, path: Path) -> None:
        record = read(path, **candidate.options)
        for name in ("time", "voltage", "displacement"):
            got, expected = getattr(record, name), getattr(candidate.record, name)
            assert got.shape == expected.shape, name
            assert np.abs(got - expected).max() <= candidate.tolerance * np.ptp(expected), name

    def test_its_columns_are_numbers_with_names(self, path: Path) -> None:
        columns = read_table(path).columns
        assert columns
        for column in columns:
            assert isinstance(column.name, str)
            assert column.data.ndim == 1
            assert column.data.dtype == np.float64
            assert column.data.size

    def test_the_same_file_is_read_alike_twice(self, candidate: ReaderCandidate, path: Path) -> None:
        first, second = (read(path, **candidate.options) for _ in range(2))
        assert first.meta["sha256"] == second.meta["sha256"]
        assert np.array_equal(first.displacement, second.displacement)

    def test_a_capital_suffix_is_the_same(self, candidate: ReaderCandidate, path: Path) -> None:
        other = path.rename(path.with_suffix(path.suffix.upper()))
        assert len(read(other, **candidate.options)) == len(candidate.record)

    @pytest.mark.parametrize("content", _FOREIGN)
    def test_foreign_content_is_refused(self, candidate: ReaderCandidate, path: Path, content: str) -> None:
        path.write_bytes(_FOREIGN[content])
        with pytest.raises(DehystError, match=path.name):
            read(path, **candidate.options)

    def test_an_empty_file_is_refused(self, path: Path) -> None:
        path.write_bytes(b"")
        with pytest.raises(FileFormatError, match="empty"):
            read(path)

    def test_damaged_files_are_read_or_refused(self, candidate: ReaderCandidate, path: Path) -> None:
        """Anything but an error of dehyst is a bug of the reader; so is one that crashes, or does not end."""
        for number in range(_DAMAGED):
            content = _damaged(candidate.content, random.Random(number))
            path.write_bytes(content)
            try:
                record = read(path, **candidate.options)
            except DehystError as error:
                assert "crashed" not in str(error), (number, content)
                assert "did not finish" not in str(error), (number, content)
            else:
                assert np.isfinite(record.displacement).all(), (number, content)

    def test_the_limit_of_bytes_holds(self, candidate: ReaderCandidate, path: Path) -> None:
        with pytest.raises(FileFormatError, match="allow"):
            read(path, max_bytes=len(candidate.content) - 1, **candidate.options)

    def test_the_allowance_of_memory_holds(self, candidate: ReaderCandidate) -> None:
        """With memory for one column only, a file of several is refused: its reader takes the numbers first."""
        file = Path(candidate.file)
        with pytest.raises(FileFormatError):
            LOADERS[file.suffix.lower()].load(candidate.content, Allowance(8 * len(candidate.record), file.stem))
