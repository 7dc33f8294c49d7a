"""What a record holds is kept: by its parts, by its files, and while it is recorded."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dehyst import FileFormatError, RecordError
from dehyst.records import Record, Recording, read, write_record

T = np.arange(601) * 0.01
V = 50 - 50 * np.cos(np.pi * T)
Y = 1e-7 * V
EVENTS = np.arange(0.055, 6, 0.1)
OTHERS = {"temperature_C": 20 + T, "load_N": 3 - T, "humidity [%]": 40 + 2 * T}
LINES = Record.from_events(T, V, EVENTS, np.interp(EVENTS, T, 0.1 * V), units="um")
RECORDS = {
    "line": Record(T, V, Y),
    "sample": Record(T, V, Y, hold="sample"),
    "channels": Record(T, V, Y, others=OTHERS),
    "events": LINES,
    "more events than blank cells": Record(T, V, Y, measured=np.arange(T.size) % 3 > 0),
    "all of them": replace(LINES, hold="sample", others=OTHERS),
    "axes": Record(T, np.c_[V, V[::-1]], np.c_[Y, 2 * Y], hold="sample", others=OTHERS),
    "guesses": Record(T, V, Y, meta={"guesses": {"time": "column '1' in s", "displacement": "column '3' in um"}}),
}


def channels_of(record):
    return [(channel.name, channel.unit, channel.role, channel.axis) for channel in record.channels]


def assert_same(record, other, rows=slice(None), rounding=0.0):
    """A record holds what another one does at some rows; `rounding`: of its displacements."""
    assert (record.hold, record.axes, channels_of(record)) == (other.hold, other.axes, channels_of(other))
    assert (record.measured is None) == (other.measured is None)
    known = slice(None) if other.measured is None else other.measured[rows]
    assert other.measured is None or np.array_equal(record.measured, known)
    assert np.array_equal(record.time, other.time[rows])
    for channel, wanted in zip(record.channels, other.channels, strict=True):
        if channel.role == "displacement":
            assert np.abs(channel.values - wanted.values[rows])[known].max() <= rounding
        else:
            assert np.array_equal(channel.values, wanted.values[rows])
        assert not channel.values.flags.writeable


@pytest.mark.parametrize("kind", RECORDS)
@pytest.mark.parametrize(
    "rows", [slice(10, 200), slice(-300, None), T < 3, np.arange(0, T.size, 2)], ids=["slice", "end", "mask", "indices"]
)
def test_a_part_of_a_record_keeps_all_fields(kind, rows):
    record = replace(RECORDS[kind], name="whole")
    part = record[rows]
    assert_same(part, record, rows)
    assert (part.name, part.meta) == ("whole", record.meta)
    if record.axes:
        assert_same(part.axis("y"), record.axis(1), rows)
        assert part.axis(1).name == "whole (y)"


@pytest.mark.parametrize("suffix", [".csv", ".tsv", ".npz"])
@pytest.mark.parametrize("kind", RECORDS)
def test_a_file_keeps_all_fields_of_a_record(kind, suffix, tmp_path):
    record, path = RECORDS[kind], tmp_path / f"a{suffix}"
    write_record(path, record)
    unit = "m" if suffix == ".npz" else "um"
    again = read(path, f"x=vx_V:x_{unit}, y=vy_V:y_{unit}" if record.axes else None)
    assert_same(again, record, rounding=2 * np.spacing(np.abs(record.displacement).max()))
    assert again.meta.get("guesses") == record.meta.get("guesses")


@given(arrays(float, st.tuples(st.just(2), st.integers(2, 20)), elements=st.floats(-1e6, 1e6)))
def test_written_numbers_are_read_exactly(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("w") / "a.csv"
    record = Record(0.1 * np.arange(values.shape[1]) + 1 / 3, *values)
    write_record(path, record)
    assert_same(read(path), record, rounding=2 * np.spacing(np.abs(values[1]).max()))


@pytest.mark.parametrize("kind", ["line", "channels", "axes"])
def test_a_recording_keeps_all_fields(kind, tmp_path):
    record = replace(RECORDS[kind], hold="line")
    others = {channel.column: channel.values for channel in record.others}
    with Recording(tmp_path / "a.csv", others=others, axes=record.axes) as recording:
        for start in range(0, T.size, 40):
            rows = slice(start, start + 40)
            part = {name: getattr(record, name)[rows] for name in ("time", "voltage", "displacement")}
            recording.add(SimpleNamespace(**part, others={name: values[rows] for name, values in others.items()}))
        for wrong in ({"voltage": V[:5]}, {"displacement": np.c_[Y, Y, Y]}, {"others": {"load_N": T[:5]}}):
            if others or "others" not in wrong:
                with pytest.raises(RecordError):
                    recording.add(SimpleNamespace(**{**part, "others": others} | wrong))
    again = read(tmp_path / "a.csv", "x=vx_V:x_um, y=vy_V:y_um" if record.axes else None)
    assert_same(again, record, rounding=2 * np.spacing(np.abs(record.displacement).max()))
    with pytest.raises(FileFormatError, match=r"others: got .*unit"):
        Recording(tmp_path / "c.csv", others=["temperature"])
