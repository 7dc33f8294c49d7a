"""Records of several axes, from arrays and files."""

from dataclasses import replace

import coupled_stage
import numpy as np
import pytest

import dehyst
from dehyst.records import write_columns
from dehyst.records.tables import axis_columns, text_of

RECORD, _ = coupled_stage.excited(steps=2, cycles=3)


def written(folder):
    path = folder / "stage.csv"
    columns = {f"v{a}_V": RECORD.voltage[:, j] for j, a in enumerate("xy")}
    columns |= {f"{a}_um": RECORD.displacement[:, j] * 1e6 for j, a in enumerate("xy")}
    write_columns(path, {"time_s": RECORD.time, **columns})
    return path


def test_a_file_is_read_as_its_axes_are(tmp_path):
    path = written(tmp_path)
    record = dehyst.read(path, axes="vx_V:x_um vy_V:y_um")
    assert record.axes == ("x", "y")
    assert np.allclose(record.displacement, RECORD.displacement, rtol=0, atol=1e-20)
    for j, axis in enumerate("xy"):
        single = dehyst.read(path, voltage=f"v{axis}_V", displacement=f"{axis}_um")
        assert np.array_equal(record.axis(j).voltage, single.voltage)
        assert np.array_equal(record.axis(j).displacement, single.displacement)


def test_columns_without_units_are_to_be_named_in_their_order(tmp_path):
    path = written(tmp_path)
    text = path.read_text()
    path.write_text(text.replace("vx_V", "vx").replace("x_um", "x"))
    with pytest.raises(dehyst.FileFormatError, match=r"no column .vx_V."):
        dehyst.read(path, axes="vx_V:x_um vy_V:y_um")
    names = "time:s,vx_V,vy_V,x_um,y_um"
    named = dehyst.read(path, axes="vx_V:x_um vy_V:y_um", columns=names)
    given = dehyst.read(path, axes="vx:V:x:um vy_V:y_um")
    assert named.axes == given.axes == ("x", "y")
    assert np.array_equal(named.displacement, given.displacement)


HEADS = {
    "x=Vx [V]:x [um], y=Vy [V]:y [um]": "Time [s],Vx [V],Vy [V],x [um],y [um]",
    "Vx:x, Vy:y": "Time [s],Vx [V],Vy [V],x [um],y [um]",
    '"x=Vx, fast [V]:x [um]", y=Vy:y': 'time_s,"Vx, fast [V]",Vy [V],x [um],y [um]',
    "x=a b:V:first one:um, y=second:V:third:um?": "time_s,a b,second,first one,third",
}


@pytest.mark.parametrize("axes", HEADS)
def test_names_with_blanks_and_brackets_are_columns_of_axes(tmp_path, axes):
    path = written(tmp_path)
    plain = dehyst.read(path, axes="vx_V:x_um vy_V:y_um")
    path.write_text(path.read_text().replace("time_s,vx_V,vy_V,x_um,y_um", HEADS[axes]))
    record = dehyst.read(path, axes=axes)
    assert record.axes == ("x", "y")
    assert np.array_equal(record.voltage, plain.voltage)
    assert np.array_equal(record.displacement, plain.displacement)
    # What the record keeps is read again, as from a model file.
    kept = axis_columns(text_of(record.meta["axes"]))
    assert kept == axis_columns(axes)


def test_columns_of_a_file_without_names_are_axes_by_their_numbers(tmp_path):
    path = written(tmp_path)
    plain = dehyst.read(path, axes="vx_V:x_um vy_V:y_um")
    path.write_text(path.read_text().partition("\n")[2])
    record = dehyst.read(path, time="1:s", axes="x=2:V:4:um, y=3:V:5:um")
    assert np.array_equal(record.displacement, plain.displacement)


@pytest.mark.parametrize("common", [None, "-2 V/V"])
def test_each_column_of_an_axis_has_a_scale_of_its_own(tmp_path, common):
    path = written(tmp_path)
    plain = dehyst.read(path, axes="vx_V:x_um vy_V:y_um")
    axes = f"x=vx_V*0.5:x_um, y=vy_V{'*-2' if common is None else ''}:y_um*-1um/um"
    record = dehyst.read(path, axes=axes, voltage_scale=common)
    assert np.array_equal(record.voltage, plain.voltage * [0.5, -2.0])
    assert np.allclose(record.displacement, plain.displacement * [1.0, -1.0], rtol=1e-15, atol=0)
    scales = {"voltage of x": "0.5 V/V", "voltage of y": "-2 V/V", "displacement of y": "-1 um/um"}
    assert record.meta["scales"] == scales
    again = dehyst.read(path, axes=text_of(record.meta["axes"]))
    assert np.array_equal(again.voltage, record.voltage)
    assert np.array_equal(again.displacement, record.displacement)


@pytest.mark.parametrize("scale", ["0", "GAIN", "15 um/V", "15 V/um"])
def test_a_wrong_scale_of_an_axis_is_refused(tmp_path, scale):
    with pytest.raises(dehyst.FileFormatError):
        dehyst.read(written(tmp_path), axes=f"x=vx_V*{scale}:x_um, y=vy_V:y_um")


@pytest.mark.parametrize(
    "axes",
    [
        "vx_V:x_um",
        "x=vx:um, y=vy:um",
        "x=a:V:b:um:c, y=d:e",
        "x=Vx [V]:x [um] y=Vy [V]:y [um]",
        "vx_V vy_V",
        "vx_V:x_um vx_V:y_um",
        "a=vx_V:x_um a=vy_V:y_um",
        ":",
    ],
)
def test_columns_that_are_no_axes_are_refused(axes):
    with pytest.raises(dehyst.FileFormatError, match="axes"):
        axis_columns(axes)


@pytest.mark.parametrize(
    "change",
    [
        {"displacement": RECORD.displacement[:, :1]},
        {"displacement": RECORD.displacement * np.nan},
        {"axes": ("x",)},
        {"axes": ("x", "x")},
        {"time": RECORD.time[::-1]},
    ],
)
def test_arrays_that_make_no_record_are_refused(change):
    arrays = {"time": RECORD.time, "voltage": RECORD.voltage, "displacement": RECORD.displacement}
    with pytest.raises(dehyst.RecordError):
        dehyst.Record(**{**arrays, **change})


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_a_record_of_several_axes_is_written_and_read(tmp_path, suffix):
    path = tmp_path / f"again{suffix}"
    guessed = replace(RECORD, meta={"guesses": {"voltage of x": "from the unit V"}})
    dehyst.write_record(path, guessed)
    again = dehyst.read(path, axes="vx_V:x_um vy_V:y_um" if suffix == ".csv" else "vx_V:x_m vy_V:y_m")
    assert again.meta["guesses"] == guessed.meta["guesses"]
    assert np.array_equal(again.voltage, RECORD.voltage)
    assert np.allclose(again.displacement, RECORD.displacement, rtol=0, atol=1e-20)
    assert again.axes == RECORD.axes


def test_the_channels_of_a_record_have_names_units_and_roles():
    assert [(c.name, c.unit, c.role, c.axis) for c in RECORD.channels] == [
        ("vx", "V", "drive", "x"),
        ("x", "m", "displacement", "x"),
        ("vy", "V", "drive", "y"),
        ("y", "m", "displacement", "y"),
    ]
    single = RECORD.axis("y")
    assert [(c.name, c.role) for c in single.channels] == [("voltage", "drive"), ("displacement", "displacement")]
    assert single.axes == ()
    assert single.axis(0) is single
    assert [*RECORD.columns()] == ["time_s", "vx_V", "x_um", "vy_V", "y_um"]


def test_a_part_of_a_record_keeps_its_axes():
    part = RECORD[10:200].with_name("part").resample(0.05)
    assert part.axes == RECORD.axes
    assert part.voltage.shape == part.displacement.shape == (len(part), 2)
    assert np.array_equal(part.axis(1).voltage, RECORD.axis(1)[10:200].resample(0.05).voltage)


@pytest.mark.parametrize(
    "ask",
    [
        dehyst.identify,
        lambda record: dehyst.check(dehyst.identify(RECORD.axis(0), structure="maxwell_slip").actuator, record),
        lambda record: record.stroke,
        lambda record: record.cycles(),
        lambda record: record.check_usable(),
        lambda record: record.problems(),
        lambda record: record.axis("z"),
        lambda record: dehyst.Record(record.time, record.voltage[:, 0], record.displacement[:, 0], axes=("x",)),
    ],
)
def test_what_one_axis_has_is_not_asked_of_several(ask):
    with pytest.raises(dehyst.RecordError, match=r"axis|axes"):
        ask(RECORD)
