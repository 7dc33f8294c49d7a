"""Records from arrays in micrometres, as DataFrames; a unit for files that state none."""

import sys

import numpy as np
import pytest

from dehyst import FileFormatError, Record, RecordError
from dehyst._errors import MissingExtraError
from dehyst._units import per_metre
from dehyst.records import Table
from dehyst.records.formats.columns import Column

TIME, VOLTS, MICROMETRES = np.arange(5) / 4, np.array([0.0, 5.0, 10.0, 5.0, 0.0]), np.array([1.0, 2.0, 3.5, 2.5, 1.2])
RECORD = Record(TIME, VOLTS, MICROMETRES / 1e6, "stage")


def same(first, second):
    return all(np.array_equal(getattr(first, one), getattr(second, one)) for one in ("time", "voltage", "displacement"))


@pytest.mark.parametrize(("units", "factor"), [("m", 1.0), ("mm", 1e3), ("um", 1e6), ("µm", 1e6), ("nm", 1e9)])
def test_arrays_in_a_unit(units, factor):
    made = Record.from_arrays(TIME, VOLTS, RECORD.displacement * factor, units=units, name="stage")
    np.testing.assert_allclose(made.displacement, RECORD.displacement, rtol=1e-15)
    assert (made.name, per_metre(units)) == ("stage", factor)


def test_arrays_are_micrometres_unless_something_else_is_stated():
    assert same(Record.from_arrays(TIME, VOLTS, MICROMETRES, units="um"), RECORD)
    with pytest.raises(RecordError, match="units: got 'inch'"):
        Record.from_arrays(TIME, VOLTS, MICROMETRES, units="inch")
    with pytest.raises(RecordError, match="array of numbers"):
        Record.from_arrays(TIME, VOLTS, ["a"] * 5, units="um")


def test_a_dataframe_and_back():
    pytest.importorskip("pandas")
    frame = RECORD.to_dataframe()
    assert frame.attrs == {"name": "stage"}
    assert same(Record.from_arrays(frame["time_s"], frame["voltage_V"], frame["displacement_um"], units="um"), RECORD)


def test_micrometres_that_are_taken_for_metres_are_refused():
    with pytest.raises(RecordError, match='units "um"'):
        Record.from_arrays(TIME, VOLTS, MICROMETRES, units="m")
    assert Record.from_arrays(TIME, VOLTS, [0.0, 1.0, 2.0, 1.0, 0.0], units="mm").stroke == 2e-3
    with pytest.raises(RecordError, match='units "m"'):
        Record.from_arrays(TIME, VOLTS, RECORD.displacement, units="um")
    time = np.arange(400) / 100
    volts = 50 - 50 * np.cos(2 * np.pi * time)
    with pytest.raises(RecordError, match='units "um"'):
        Record(time, volts, 0.12 * volts).check_usable()
    Record(time, volts, 1.2e-7 * volts + 1e-9 * np.random.default_rng(1).normal(size=400)).check_usable()


def test_a_missing_library_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingExtraError, match=r"needs pandas.*pip install 'dehyst\[files\]'"):
        RECORD.to_dataframe()


@pytest.mark.parametrize("names", ["xyz", "xy", "yz"])
def test_several_axes_and_one_voltage_are_ambiguous(names):
    columns = tuple(Column(f"{name}_um", MICROMETRES) for name in names)
    table = Table("a.csv", "", columns)
    with pytest.raises(FileFormatError) as caught:
        table.select("displacement")
    assert all(f"'{name}_um'" in str(caught.value) for name in names)
    assert caught.value.change == ("columns",)
    assert table.select("displacement", "y_um").column is columns[names.index("y")]


def test_one_axis_is_the_displacement():
    columns = [Column("y_um", MICROMETRES), Column("x_V", VOLTS)]
    assert Table("a.csv", "", tuple(columns)).select("displacement").column is columns[0]
    named = Column("displacement_um", MICROMETRES)
    both = Table("a.csv", "", (named, Column("x_um", MICROMETRES)))
    assert both.select("displacement").column is named
