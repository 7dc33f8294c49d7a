"""Files as laboratories have them, and files that are easily read wrong, beside innocent twins."""

import json

import laboratory_files
import numpy as np
import places
import pytest
from laboratory_files import RATE, UM, N, T, V, assert_measured

from dehyst._errors import FileFormatError
from dehyst.records import Columns, read, read_table
from dehyst.records.tables import joined


def test_what_becomes_of_each_file_trap_and_twin(monkeypatch):
    monkeypatch.syspath_prepend(places.FUZZ)
    import verdicts

    found, known = verdicts.verdicts(), json.loads((places.TESTS / "golden" / "verdicts.json").read_text())
    for verdict in (*found.values(), *known.values()):
        # The words of proposals are those of another room.
        del verdict["proposed"]
    assert found == known


@pytest.mark.parametrize(
    "header", ["Zeit/s;U/V;Position/nm", "t/s;V/V;Weg/nm", "Time /s;Piezo Voltage/ V;Pos/nanometer"]
)
def test_a_unit_after_a_slash(tmp_path, header):
    assert_measured(read(text(tmp_path, f"{header}\n" + laboratory_files.rows(T, V, 1e3 * UM, sign=";"))))


def test_units_after_slashes_select_no_other_column(tmp_path):
    header = "t/s;U/V;Sensor A/nm;rate/V/s;speed um/s;meas/y_um"
    path = text(tmp_path, f"{header}\n" + laboratory_files.rows(T, V, 1e3 * UM, V, V, UM, sign=";"))
    assert_measured(read(path))
    assert_measured(read(path, "displacement=Sensor A/nm"))
    with pytest.raises(FileFormatError, match="'Sensor A/nm'"):
        read(path, "voltage=Sensor A/nm:V")


def test_a_workbook(tmp_path):
    rows = [["Run", 7.0], ["Time (s)", "Drive (V)", "Position (um)"], *np.c_[T, V, UM].tolist()]
    laboratory_files.write_xlsx(tmp_path / "a.xlsx", rows)
    pytest.importorskip("openpyxl")
    assert_measured(read(tmp_path / "a.xlsx"))


# Names and units


def text(tmp_path, content, name="a.csv"):
    (tmp_path / name).write_text(content)
    return tmp_path / name


# Rows


@pytest.mark.parametrize(
    "content",
    [
        "time_s,voltage_V,y_um\nOVER,OVER,1\n" + laboratory_files.rows(T, V, UM),
        "time_s,voltage_V,y_um\n0,1,x\n" + laboratory_files.rows(T, V, UM),
        "time_s,voltage_V,y_um\n0,1,2\nstart,of,test\n" + laboratory_files.rows(T, V, UM),
        "time_s,voltage_V,y_um\n1,2\n" + laboratory_files.rows(T, V, UM),
        "time_s,voltage_V,y_um\n" + laboratory_files.rows(T[:5], V[:5]) + laboratory_files.rows(T, V, UM),
    ],
)
def test_no_row_with_a_fault_is_taken_for_a_header(tmp_path, content):
    with pytest.raises(FileFormatError, match=r"line [23] "):
        read(text(tmp_path, content))


# Two files


def test_joined_by_time(tmp_path):
    drive = text(tmp_path, "time_s,voltage_V\n" + laboratory_files.rows(T, V))
    late = np.linspace(0.01, T[-1] - 0.01, 3000)
    text(tmp_path, "t_ms,y_um\n" + laboratory_files.rows(late * 1e3, 3 * late, number="%.15g"), "b.csv")
    record = read(drive, f"join={tmp_path / 'b.csv'}")
    assert record.time == pytest.approx(late)
    assert record.voltage == pytest.approx(np.interp(late, T, V), abs=1e-6)
    assert record.displacement == pytest.approx(3e-6 * late, rel=1e-9)
    assert record.meta["columns"]["displacement"] == "b/y_um"
    inside = (late[0] <= T) & (late[-1] >= T)
    turned = read(tmp_path / "b.csv", f"join={drive}")
    assert turned.voltage == pytest.approx(record.voltage)
    table = read_table(drive)
    found = joined(table, read_table(tmp_path / "b.csv"), Columns(displacement="voltage_V"))
    assert found.columns[1].data == pytest.approx(V[inside], abs=1e-6)

    # Where both have a displacement, the first file keeps its times.
    both = text(tmp_path, "time_s,voltage_V,y_um\n" + laboratory_files.rows(T, V, UM), "c.csv")
    found = joined(read_table(both), read_table(tmp_path / "b.csv"), Columns())
    assert found.columns[0].data == pytest.approx(T[inside], abs=1e-6)


def test_joined_by_sample(tmp_path):
    drive = text(tmp_path, "voltage_V\n" + laboratory_files.rows(V))
    sensor = text(tmp_path, "displacement_um\n" + laboratory_files.rows(UM), "b.csv")
    assert_measured(read(drive, f"rate={RATE}, join={sensor}"))
    short = text(tmp_path, "displacement_um\n1\n2\n", "c.csv")
    with pytest.raises(FileFormatError) as caught:
        read(drive, f"rate={RATE}, join={short}")
    assert (caught.value.argument, caught.value.got) == ("join", f"{N} samples in a.csv and 2 in c.csv")
    apart = text(tmp_path, "time_s,y_um\n100,1\n101,2\n", "d.csv")
    with pytest.raises(FileFormatError, match="common"):
        read(text(tmp_path, "time_s,voltage_V\n0,1\n1,2\n2,3\n"), f"join={apart}")


# Instruments


def test_a_gcs_array_has_its_names_and_its_clock(tmp_path):
    laboratory_files.gcs(tmp_path / "a.dat")
    table = read_table(tmp_path / "a.dat")
    assert table.names == ("time", "Current Position of axis 1", "Control Voltage of output chan 1")
    content = (tmp_path / "a.dat").read_text()
    # Without a step, the time is asked for.
    path = text(tmp_path, content.replace("SAMPLE_TIME = 0.00200", "SAMPLE_TIME = 0"), "b.dat")
    assert read_table(path).names == table.names[1:]


def test_segments_of_labview_are_not_mixed(tmp_path):
    laboratory_files.labview(tmp_path / "a.lvm")
    content = (tmp_path / "a.lvm").read_text()
    with pytest.raises(FileFormatError, match="got 2 segments of a LabVIEW measurement"):
        read(text(tmp_path, content + "Channels\t2\n***End_of_Header***\n" + "X_Value\tVoltage\n1\t2\n", "b.lvm"))


def test_the_fields_of_a_structure_are_second_to_plain_arrays(tmp_path):
    import scipy.io

    plain = {"time_s": T, "voltage_V": V, "displacement_um": UM}
    scipy.io.savemat(tmp_path / "a.mat", {**plain, "old": {"time_s": T + 1, "voltage_V": V}})
    assert_measured(read(tmp_path / "a.mat"))
    assert read(tmp_path / "a.mat", "voltage=old.voltage_V").voltage == pytest.approx(V)
