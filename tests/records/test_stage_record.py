"""Records of several axes, from arrays and files."""

from dataclasses import replace

import coupled_stage
import numpy as np
import pytest

import dehyst
from dehyst.records import write_columns
from dehyst.records.record import columns_of

RECORD, _ = coupled_stage.excited(steps=2, cycles=3)


def written(folder):
    path = folder / "stage.csv"
    columns = {f"v{a}_V": RECORD.voltage[:, j] for j, a in enumerate("xy")}
    columns |= {f"{a}_um": RECORD.displacement[:, j] * 1e6 for j, a in enumerate("xy")}
    write_columns(path, {"time_s": RECORD.time, **columns})
    return path


def test_a_file_is_read_as_its_axes_are(tmp_path):
    path = written(tmp_path)
    record = dehyst.read(path, "x=vx_V:x_um, y=vy_V:y_um")
    assert record.axes == ("x", "y")
    assert np.allclose(record.displacement, RECORD.displacement, rtol=0, atol=1e-20)
    for j, axis in enumerate("xy"):
        single = dehyst.read(path, f"voltage=v{axis}_V, displacement={axis}_um")
        assert np.array_equal(record.axis(j).voltage, single.voltage)
        assert np.array_equal(record.axis(j).displacement, single.displacement)


@pytest.mark.parametrize(
    "change",
    [
        {"displacement": RECORD.displacement[:, :1]},
        {"displacement": RECORD.displacement * np.nan},
        {"axes": ("x",)},
        {"axes": ("x", "x")},
        {"time": RECORD.time[::-1]},
        {"measured": RECORD.time > 1},
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
    again = dehyst.read(path, "x=vx_V:x_{0}, y=vy_V:y_{0}".format("um" if suffix == ".csv" else "m"))
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
    assert [*columns_of(RECORD)] == ["time_s", "vx_V", "x_um", "vy_V", "y_um"]


def test_a_part_of_a_record_keeps_its_axes():
    part = replace(RECORD, hold="sample")[10:200]
    assert (part.axes, part.hold) == (RECORD.axes, part.axis(1).hold)
    assert part.voltage.shape == part.displacement.shape == (190, 2)
    assert np.array_equal(part.axis(1).voltage, RECORD.axis(1)[10:200].voltage)


@pytest.mark.parametrize(
    "ask",
    [
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
