"""Files: every format read back, every way of naming a column and a unit, every refusal with its message."""

import hashlib
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from laboratory_files import text

import dehyst
from dehyst._errors import FileFormatError
from dehyst._units import FACTORS
from dehyst.records import Record, read, read_table, write_columns, write_record

T = np.arange(30) * 0.01
V = 50 - 50 * np.cos(T * 20)
Y = 1e-5 * np.sin(T * 20)


WORDS = {"time": ["time", "Zeit", "t"], "voltage": ["Drive", "voltage"], "displacement": ["Position", "y", "Weg"]}
ENDS = ["\n", "\r\n", "\r"]


@st.composite
def dialects(draw):
    """Draw the bytes of a table in the notation of some program, and the factors of its units."""
    sign = draw(st.sampled_from([",", ";", "\t", " ", ", "]))
    comma = sign in (";", "\t") and draw(st.booleans())
    quote = draw(st.sampled_from(["", '"'])) if sign != " " else ""
    forms = ["{}_{}"] if sign == " " else ["{}_{}", "{} [{}]", "{} ({})", "{}/{}", "{} in {}"]
    names, factors = [], []
    for quantity, words in WORDS.items():
        unit = draw(st.sampled_from(sorted(FACTORS[quantity])))
        names.append(draw(st.sampled_from(forms)).format(draw(st.sampled_from(words)), unit))
        factors.append(FACTORS[quantity][unit])
    cells = [[f"{value:.9g}".replace(".", "," if comma else ".") for value in row] for row in ROW]
    trailing = sign if draw(st.booleans()) and sign not in (" ", ", ") else ""
    lines = [sign.join(f"{quote}{cell}{quote}" for cell in row) + trailing for row in (names, *cells)]
    above = draw(st.lists(st.sampled_from(["# made by", "% a rig", ""]), max_size=3))
    below = draw(st.lists(st.sampled_from(["# end", ""]), max_size=2))
    encodings = ["utf-8", "utf-8-sig", "utf-16"] + ["latin-1"] * all("μ" not in name for name in names)
    end = draw(st.sampled_from(ENDS))
    text = end.join([*above, *lines, *below]) + end * draw(st.booleans())
    return text.encode(draw(st.sampled_from(encodings))), factors


# Two decimals show the decimal sign.
ROW = [(12.25 * k, 1.5 * k, 2.75 - k) for k in range(20, 60)]


@given(dialects(), st.sampled_from(["a.csv", "a.tsv", "A.CSV", "a.dat", "a.txt"]))
def test_a_table_is_read_in_every_notation(dialect, name):
    content, factors = dialect
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / name).write_bytes(content)
        table = read_table(Path(folder) / name)
        assert (table.source, table.sha256) == (name, hashlib.sha256(content).hexdigest())
        for quantity, factor, values in zip(WORDS, factors, zip(*ROW, strict=True), strict=True):
            assert table.column(quantity) == pytest.approx(factor * np.array(values), rel=1e-14)


HEAD = "time_s,voltage_V,displacement_um\n"


def test_a_file_without_permission_to_read_is_refused(tmp_path, monkeypatch):
    def refuse(*_):
        raise PermissionError

    path = text(tmp_path, HEAD)
    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(FileFormatError, match="permission"):
        read(path)


@pytest.mark.nightly
def test_a_million_rows_cost_little_more_than_with_numpy(tmp_path):
    t = np.arange(1_000_000) * 1e-4
    columns = np.c_[t, 50 + 50 * np.sin(6 * t), 10 * np.sin(6 * t) + 1e-3 * np.sin(t * t)]
    np.savetxt(tmp_path / "a.csv", columns, "%.12g", ",", header=HEAD.strip(), comments="")
    cost = "import resource as r, time\nused = lambda: (time.process_time(), r.getrusage(r.RUSAGE_SELF).ru_maxrss)\n{}"
    cost += "a = used()\nkept = read('a.csv')\nb = used()\nprint(b[0] - a[0], b[1] - a[1])"
    readers = (
        "from numpy import loadtxt\nread = lambda path: loadtxt(path, delimiter=',', skiprows=1)\n",
        "from dehyst.records import read\n",
    )
    commands = [[sys.executable, "-c", cost.format(reader)] for reader in readers * 5]
    found = np.array([subprocess.check_output(command, cwd=tmp_path).split() for command in commands], dtype=float)
    (numpy_s, _), (seconds, kilobytes) = found[::2].min(0), found[1::2].min(0)
    assert seconds < 1.3 * numpy_s
    assert 1024 * kilobytes < 2 * columns.nbytes
    assert read(tmp_path / "a.csv").displacement == pytest.approx(1e-6 * columns[:, 2], abs=1e-16)


def test_rounded_columns_have_few_digits_and_keep_their_range(tmp_path):
    limit = 99.9876543219876
    voltage = [0.0050000000000000044, 33.33333333333333, -109.99999999999999, limit]
    write_columns(tmp_path / "a.csv", {"voltage_V": voltage, "empty": [float("nan")] * 4}, digits=12)
    lines = (tmp_path / "a.csv").read_text().splitlines()[-4:]
    # The least and the largest would grow by rounding.
    assert lines == ["0.005,", "33.3333333333,", "-109.999999999,", "99.9876543219,"]


OTHER_PATHS = {
    "absent": lambda folder: folder / "absent.csv",
    "folder": lambda folder: folder,
    "old workbook": lambda folder: text(folder, "a", "a.xls"),
    "no suffix": lambda folder: text(folder, "a", "plain"),
    "number": lambda folder: 5,
    "none": lambda folder: None,
    "bytes": lambda folder: b"a.csv",
}


@pytest.mark.parametrize("reader", [read, read_table, dehyst.Actuator.load])
@pytest.mark.parametrize("case", OTHER_PATHS)
def test_files_that_are_no_measurement_are_refused(tmp_path, reader, case):
    with pytest.raises(FileFormatError):
        reader(OTHER_PATHS[case](tmp_path))
    with pytest.raises(FileFormatError):
        write_record(Record(T, V, Y), str(tmp_path / "a.csv"))
