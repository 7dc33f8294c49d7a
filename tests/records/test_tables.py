"""The cases of tables.toml: text tables and columns that are read, or refused with the fields of their error."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import dehyst
from dehyst import Columns, FileFormatError
from dehyst._errors import DehystError
from dehyst.records import read_table
from dehyst.records.formats.notation import clock_of, moment

CASES = tomllib.loads(Path(__file__).with_name("tables.toml").read_text("utf-8"))
MARKS = {
    "<HEAD>": "time_s,voltage_V,displacement_um\n",
    "<ROWS>": "".join(f"{k},{k % 9},{k % 7}\n" for k in range(10, 60)),
}


def written(folder, text):
    for mark, words in MARKS.items():
        text = text.replace(mark, words)
    (folder / "a.csv").write_text(text)
    return folder / "a.csv"


@pytest.mark.parametrize("name", CASES["read"])
def test_text_tables_are_read(name, tmp_path):
    case = CASES["read"][name]
    table = read_table(written(tmp_path, case["text"]), Columns(decimal=case.get("decimal")))
    found = {column.name: column.data for column in table.columns if not column.fault}
    assert found.keys() == case["values"].keys()
    for column, values in case["values"].items():
        assert found[column] == pytest.approx(values)


@pytest.mark.parametrize("name", CASES["refused"])
def test_tables_are_refused_with_what_is_wrong(name, tmp_path):
    case = CASES["refused"][name]
    header = case.get("header", "")
    rows = (",".join(str(k + j) for j in range(header.count(",") + 1)) for k in range(30))
    path = written(tmp_path, "\n".join([header, *rows, ""]) if header else case["text"])
    with pytest.raises(DehystError) as caught:
        dehyst.read(path, case.get("columns"))
    error, text = caught.value, str(caught.value)
    assert type(error).__name__ == case["error"]
    assert (error.argument, [*error.change]) == (case.get("argument", ""), case.get("change", []))
    assert [each.quantity for each in getattr(error, "problems", ())] == case.get("quantities", [])
    for row in case.get("rows", ()):
        assert re.search(rf"\brow {row}\b|\brows [\d, ]*\b{row}\b", text)
    width = [f"has {case['width']} cells"] if "width" in case else []
    for words in (*map("'{}'".format, case.get("cells", ())), *width, case.get("sample", ""), case.get("says", "")):
        assert words in text


@pytest.mark.parametrize("name", CASES["columns"])
def test_a_text_of_columns_gives_the_values(name, tmp_path):
    case = CASES["columns"][name]
    header, text, width = case["header"], case.get("columns", ""), len(re.sub('"[^"]*"', "", case["header"]).split(","))
    tail = "".join(f",{k}" for k in range(5, 2 + width))
    path = written(tmp_path, f"{header}\n0,1,2{tail}\n0.5,3,4{tail}\n")
    for columns in (text, Columns.parse(text), str(Columns.parse(text))):
        record = dehyst.read(path, columns)
        found = np.diff(record.time)[0], record.voltage[1], 1e6 * record.displacement[1]
        assert found == pytest.approx((5e-4 if "t_ms" in header else 0.5, *case["values"]), rel=1e-12)
        assert "guesses" not in record.meta


@pytest.mark.parametrize(
    ("text", "argument"), [*CASES["no_columns"].items(), (3, "columns"), (("voltage",), "columns")]
)
def test_a_malformed_text_of_columns_is_refused(text, argument, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileFormatError) as caught:
        Columns.of(text)
    assert caught.value.argument == argument


@pytest.mark.parametrize(("cells", "seconds"), CASES["stamps"].items())
def test_timestamps_become_seconds(cells, seconds):
    if isinstance(seconds, list):
        assert clock_of([moment(cell) for cell in cells.split(", ")]) == pytest.approx(seconds, abs=1e-9)
        return
    with pytest.raises(ValueError, match=seconds or None):
        clock_of([moment(cell) for cell in cells.split(", ")])
