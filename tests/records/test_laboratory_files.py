"""Files as laboratories have them, and files that are easily read wrong, beside innocent twins."""

import json

import laboratory_files
import numpy as np
import places
import pytest
from laboratory_files import RATE, UM, N, T, V, Y, assert_measured, text

from dehyst._errors import FileFormatError
from dehyst.records import Columns, read, read_table
from dehyst.records.tables import ColumnsError, joined


def test_each_laboratory_file_and_trap_has_its_stored_result(monkeypatch):
    monkeypatch.syspath_prepend(places.FUZZ)
    import verdicts

    assert verdicts.verdicts() == json.loads((places.TESTS / "golden" / "verdicts.json").read_text())


def test_units_after_slashes_select_no_other_column(tmp_path):
    header = "t/s;U/V;Sensor A/nm;rate/V/s;speed um/s"
    path = text(tmp_path, f"{header}\n" + laboratory_files.rows(T, V, 1e3 * UM, V, V, sign=";"))
    assert_measured(read(path, "displacement=Sensor A/nm"))
    with pytest.raises(FileFormatError, match="'Sensor A/nm'"):
        read(path, "voltage=Sensor A/nm:V")


def test_files_are_joined_by_time(tmp_path):
    drive = text(tmp_path, "time_s,voltage_V\n" + laboratory_files.rows(T, V))
    late = np.linspace(0.01, T[-1] - 0.01, 3000)
    sensor = text(tmp_path, "t_ms,y_um\n" + laboratory_files.rows(late * 1e3, 3 * late, number="%.15g"), "b.csv")
    for first, second in ((drive, sensor), (sensor, drive)):
        record = read(first, f"join={second}")
        assert record.time == pytest.approx(late)
        assert record.voltage == pytest.approx(np.interp(late, T, V), abs=1e-6)
        assert record.displacement == pytest.approx(3e-6 * late, rel=1e-9)
    assert read(drive, f"join={sensor}").meta["columns"]["displacement"] == "b/y_um"
    # If the first file has the displacement, or both have one, it keeps its times.
    both = text(tmp_path, "time_s,voltage_V,y_um\n" + laboratory_files.rows(T, V, UM), "c.csv")
    inside = (late[0] <= T) & (late[-1] >= T)
    for first, displacement in ((drive, "voltage_V"), (both, None)):
        found = joined(read_table(first), read_table(sensor), Columns(displacement=displacement))
        assert found.columns[0].data == pytest.approx(T[inside], abs=1e-6)
        assert found.columns[1].data == pytest.approx(V[inside], abs=1e-6)


def test_files_are_joined_by_sample(tmp_path):
    drive = text(tmp_path, "voltage_V\n" + laboratory_files.rows(V))
    sensor = text(tmp_path, "displacement_um\n" + laboratory_files.rows(UM), "b.csv")
    assert_measured(read(drive, f"rate={RATE}, join={sensor}"))
    short = text(tmp_path, "displacement_um\n1\n2\n", "c.csv")
    with pytest.raises(FileFormatError) as caught:
        read(drive, f"rate={RATE}, join={short}")
    assert (caught.value.argument, caught.value.got) == ("join", f"{N} rows in a.csv and 2 in c.csv")
    apart = text(tmp_path, "time_s,y_um\n100,1\n101,2\n", "d.csv")
    with pytest.raises(FileFormatError, match="common"):
        read(text(tmp_path, "time_s,voltage_V\n0,1\n1,2\n2,3\n"), f"join={apart}")


def test_a_gcs_array_has_its_names_and_its_clock(tmp_path):
    laboratory_files.gcs(tmp_path / "a.dat")
    table = read_table(tmp_path / "a.dat")
    assert table.names == ("time", "Current Position of axis 1", "Control Voltage of output chan 1")
    content = (tmp_path / "a.dat").read_text()
    # Without a step, the time is asked for.
    path = text(tmp_path, content.replace("SAMPLE_TIME = 0.00200", "SAMPLE_TIME = 0"), "b.dat")
    assert read_table(path).names == table.names[1:]


def test_fields_of_a_structure_and_plain_arrays_of_one_name_are_chosen_by_the_user(tmp_path):
    import scipy.io

    plain = {"time_s": T, "voltage_V": V, "displacement_um": UM}
    scipy.io.savemat(tmp_path / "a.mat", {**plain, "old": {"time_s": T + 1, "voltage_V": V}})
    with pytest.raises(FileFormatError):
        read(tmp_path / "a.mat")
    assert_measured(read(tmp_path / "a.mat", "time=time_s, voltage=voltage_V"))
    assert read(tmp_path / "a.mat", "time=time_s, voltage=old.voltage_V").voltage == pytest.approx(V)


def test_a_guess_is_kept_until_it_is_verified(tmp_path):
    np.save(tmp_path / "a.npy", np.array([T, V, Y * 1e6]))
    with pytest.raises(ColumnsError) as caught:
        read(tmp_path / "a.npy")
    record = read(tmp_path / "a.npy", caught.value.proposal)
    assert record.meta["guesses"].keys() == {"time", "voltage", "displacement"}
    assert len([words for words in record.problems() if "guessed, verify" in words]) == 3
    known = read(tmp_path / "a.npy", caught.value.proposal.replace("?", ""))
    assert_measured(known)
    assert "guesses" not in known.meta


@pytest.mark.parametrize(
    "line", ["[1]", '{"guesses": {"voltage": 1}, "others": 3}', '{"guesses": [1]}', "{" * 3000, "\xff", ""]
)
def test_wrong_stated_guesses_are_ignored(line, tmp_path):
    rows = "".join(f"{k},{k % 5},{k % 7}\n" for k in range(40))
    table = f"# dehyst-record: {line}\ntime_s,voltage_V,displacement_um\n{rows}"
    (tmp_path / "a.csv").write_text(table, "latin-1")
    assert "guesses" not in read(tmp_path / "a.csv").meta
