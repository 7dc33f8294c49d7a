"""Files that are easily read wrong: refused, read right or marked as a guess, also with the options of messages."""

import laboratory_files
import numpy as np
import pytest
from laboratory_files import T, V, Y, assert_measured

from dehyst.records import read, write_columns, write_record
from dehyst.records.tables import ColumnsError

# Guesses


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_a_guess_is_kept_by_record_files(suffix, tmp_path):
    np.save(tmp_path / "a.npy", np.array([T, V, Y * 1e6]))
    with pytest.raises(ColumnsError) as caught:
        read(tmp_path / "a.npy")
    assert caught.value.proposal == "time=1:s?, voltage=2:V?, displacement=3:um?"
    record = read(tmp_path / "a.npy", caught.value.proposal)
    assert record.meta["guesses"].keys() == {"time", "voltage", "displacement"}
    assert len([words for words in record.problems() if "guessed, verify" in words]) == 3
    path = tmp_path / f"b{suffix}"
    write_record(path, record)
    assert read(path).meta["guesses"] == record.meta["guesses"]
    assert np.array_equal(read(path).voltage, record.voltage)
    known = read(tmp_path / "a.npy", "time=1:s, voltage=2:V, displacement=3:um")
    assert_measured(known)
    assert "guesses" not in known.meta
    write_record(path, known)
    assert "guesses" not in read(path).meta


@pytest.mark.parametrize(
    "line", ["[1]", '{"guesses": {"voltage": 1}, "others": 3}', '{"guesses": [1]}', "{" * 3000, "\xff", ""]
)
def test_stated_guesses_that_are_none_are_ignored(line, tmp_path):
    rows = "".join(f"{k},{k % 5},{k % 7}\n" for k in range(40))
    table = f"# dehyst-record: {line}\ntime_s,voltage_V,displacement_um\n{rows}"
    (tmp_path / "a.csv").write_text(table, "latin-1")
    assert "guesses" not in read(tmp_path / "a.csv").meta


def test_guesses_of_several_axes_name_the_axis(tmp_path):
    write_columns(tmp_path / "a.csv", {"time_s": T, "vx_V": V, "vy_V": V[::-1], "x_um": Y * 1e6, "y_um": Y[::-1] * 1e6})
    record = read(tmp_path / "a.csv", "x=vx_V?:x_um, y=vy_V:y_um?")
    assert record.meta["guesses"].keys() == {"voltage of x", "displacement of y"}
    assert len([words for words in record.axis(0).problems() if "guessed, verify" in words]) == 2
    assert "guesses" not in read(tmp_path / "a.csv", "x=vx_V:x_um, y=vy_V:y_um").meta


def test_a_name_may_end_as_a_guess_does(tmp_path):
    (tmp_path / "a.csv").write_text("time_s,drive?_V,why?\n0,1,2\n1,2,3\n")
    record = read(tmp_path / "a.csv", "voltage=drive?_V, displacement=why?:um")
    assert record.displacement == pytest.approx([2e-6, 3e-6])
    assert "guesses" not in record.meta
    assert read(tmp_path / "a.csv", "voltage=drive?_V?, displacement=why?:um").meta["guesses"].keys() == {"voltage"}


def test_the_header_of_an_oscilloscope_states_the_step(tmp_path):
    rows = "".join(f"{k},{k % 7},{k % 5}\n" for k in range(60))
    for header, step in (
        ("XInc, 0.01, s\nXOrg, -0.3, s", 0.01),
        ("# Sample interval [ms] = 20", 0.02),
        ("dt: 5 us", 5e-6),
        ("Sample Rate,1 kS/s", 1e-3),
        ("X Increment,2\nX Units,ms", 2e-3),
    ):
        (tmp_path / "a.csv").write_text(f"{header}\nIndex,drive_V,y_um\n{rows}")
        record = read(tmp_path / "a.csv")
        assert record.time[0] == pytest.approx(-0.3 if "XOrg" in header else 0)
        assert record.sample_time == pytest.approx(step, rel=1e-9)
        assert "guesses" not in record.meta


def test_units_after_slashes_of_a_sheet(tmp_path):
    laboratory_files.write_xlsx(tmp_path / "b.xlsx", [["t/s", "U/V", "Position/nm"], *np.c_[T, V, Y * 1e9].tolist()])
    assert_measured(read(tmp_path / "b.xlsx"))
