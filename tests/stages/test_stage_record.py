"""Records of several axes, from arrays and files."""

import coupled_stage
import numpy as np
import pytest

import dehyst
from dehyst.records import write_columns
from dehyst.stages.read import axis_columns

RECORD, _ = coupled_stage.excited(steps=2, cycles=3)


def written(folder):
    path = folder / "stage.csv"
    columns = {f"v{a}_V": RECORD.voltage[:, j] for j, a in enumerate("xy")}
    columns |= {f"{a}_um": RECORD.displacement[:, j] * 1e6 for j, a in enumerate("xy")}
    write_columns(path, {"time_s": RECORD.time, **columns})
    return path


def test_a_file_is_read_as_its_axes_are(tmp_path):
    path = written(tmp_path)
    record = dehyst.read_stage(path, "vx_V:x_um vy_V:y_um")
    assert record.axes == ("x", "y")
    assert np.allclose(record.displacement, RECORD.displacement, rtol=0, atol=1e-20)
    for j, axis in enumerate("xy"):
        single = dehyst.read(path, voltage=f"v{axis}_V", displacement=f"{axis}_um")
        assert np.array_equal(record.axis(j).voltage, single.voltage)
        assert np.array_equal(record.axis(j).displacement, single.displacement)


def test_a_column_of_two_axes_is_named():
    with pytest.raises(dehyst.FileFormatError, match="got 'vx_V' twice"):
        axis_columns("vx_V:x_um vx_V:y_um")


def test_columns_without_units_are_to_be_named_in_their_order(tmp_path):
    path = written(tmp_path)
    text = path.read_text()
    path.write_text(text.replace("vx_V", "vx").replace("x_um", "x"))
    with pytest.raises(dehyst.FileFormatError, match=r"Axis x needs its columns .* as columns=\"time:s,vx_V,"):
        dehyst.read_stage(path, "vx_V:x_um vy_V:y_um")
    names = "time:s,vx_V,vy_V,x_um,y_um"
    assert dehyst.read_stage(path, "vx_V:x_um vy_V:y_um", columns=names).axes == ("x", "y")


@pytest.mark.parametrize("axes", ["vx_V:x_um", "vx_V vy_V", "vx_V:x_um vx_V:y_um", "a=vx_V:x_um a=vy_V:y_um", ":"])
def test_columns_that_are_no_axes_are_refused(axes):
    with pytest.raises(dehyst.FileFormatError, match="axes"):
        axis_columns(axes)


def test_a_column_that_is_missing_is_named(tmp_path):
    with pytest.raises(dehyst.FileFormatError, match="vz_V"):
        dehyst.read_stage(written(tmp_path), "vx_V:x_um vz_V:y_um")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"displacement": RECORD.displacement[:, :1]}, "one row a sample and one column an axis"),
        ({"displacement": RECORD.displacement * np.nan}, "not finite"),
        ({"axes": ("x",)}, "need 2 different names"),
        ({"axes": ("x", "x")}, "need 2 different names"),
        ({"time": RECORD.time[::-1]}, "time"),
    ],
)
def test_arrays_that_make_no_record_are_refused(change, words):
    arrays = {"time": RECORD.time, "voltage": RECORD.voltage, "displacement": RECORD.displacement}
    with pytest.raises(dehyst.RecordError, match=words):
        dehyst.StageRecord(**{**arrays, **change})
