"""Records of several axes: what they are, and what is asked of one axis only."""

from dataclasses import replace

import coupled_stage
import numpy as np
import pytest

import dehyst
from dehyst.records.record import columns_of

RECORD, _ = coupled_stage.excited(steps=2, cycles=3)


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
