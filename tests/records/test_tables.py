"""Records from arrays in micrometres, DataFrames and Datasets, and back; a unit for files that state none."""

import sys

import numpy as np
import pytest

import dehyst
from dehyst import FileFormatError, MissingExtraError, ModelError, Record, RecordError
from dehyst._units import per_metre, plain
from dehyst.records.formats.columns import Column, Table

TIME, VOLTS, MICROMETRES = np.arange(5) / 4, np.array([0.0, 5.0, 10.0, 5.0, 0.0]), np.array([1.0, 2.0, 3.5, 2.5, 1.2])
RECORD = Record(TIME, VOLTS, MICROMETRES / 1e6, "stage")


class Labelled:
    """What an xarray DataArray offers: values, and a unit among its attributes."""

    def __init__(self, values, units=None):
        self.values = np.asarray(values)
        self.attrs = {} if units is None else {"units": units}
        if units is not None:
            self.units = units

    def __array__(self, dtype=None, copy=None):
        return np.asarray(self.values, dtype=dtype)


class Collection(dict):
    """What an xarray Dataset offers here."""

    @property
    def attrs(self):
        return {"name": "from a dataset"}

    @property
    def variables(self):
        return tuple(self)


def same(first, second):
    return all(np.array_equal(getattr(first, one), getattr(second, one)) for one in ("time", "voltage", "displacement"))


@pytest.mark.parametrize(("units", "factor"), [("m", 1.0), ("mm", 1e3), ("um", 1e6), ("µm", 1e6), ("nm", 1e9)])
def test_arrays_in_a_unit(units, factor):
    made = Record.from_arrays(TIME, VOLTS, RECORD.displacement * factor, units=units, name="stage")
    np.testing.assert_allclose(made.displacement, RECORD.displacement, rtol=1e-15)
    assert (made.name, per_metre(units)) == ("stage", factor)


def test_arrays_are_micrometres_unless_something_else_is_stated():
    assert same(Record.from_arrays(TIME, VOLTS, MICROMETRES), RECORD)
    pint = pytest.importorskip("pint")
    quantity = MICROMETRES * 1e3 * pint.UnitRegistry().nm
    np.testing.assert_allclose(Record.from_arrays(TIME, VOLTS, quantity).displacement, RECORD.displacement, rtol=1e-14)
    with pytest.raises(RecordError, match="units: got 'inch'"):
        Record.from_arrays(TIME, VOLTS, MICROMETRES, units="inch")
    with pytest.raises(RecordError, match="array of numbers"):
        Record.from_arrays(TIME, VOLTS, ["a"] * 5)


def test_a_dataframe_and_back():
    pytest.importorskip("pandas")
    frame = RECORD.to_dataframe()
    assert frame.attrs == {"name": "stage"}
    back = Record.from_dataframe(frame)
    assert same(back, RECORD)
    assert back.name == "stage"
    assert same(Record.from_dataframe(frame.set_index("time_s")), RECORD)


def test_columns_of_a_dataframe_are_found_as_those_of_a_file():
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({"t_ms": TIME * 1e3, "note": list("abcde"), "drive_V": VOLTS, "gauge": MICROMETRES * 1e3})
    assert same(Record.from_dataframe(frame, displacement="gauge:nm"), RECORD)
    slashes = pandas.DataFrame({"Zeit/ms": TIME * 1e3, "U/V": VOLTS, "Position/nm": MICROMETRES * 1e3})
    assert same(Record.from_dataframe(slashes), RECORD)
    with pytest.raises(FileFormatError, match=r"DataFrame: .*displacement"):
        Record.from_dataframe(frame)
    with pytest.raises(RecordError, match="frame: got list, need a DataFrame"):
        Record.from_dataframe([1, 2])


def test_dates_and_durations_become_seconds():
    pandas = pytest.importorskip("pandas")
    columns = {"voltage_V": VOLTS, "displacement_um": MICROMETRES}
    for time in (pandas.to_datetime("2024-05-01") + pandas.to_timedelta(TIME, "s"), pandas.to_timedelta(TIME, "s")):
        assert same(Record.from_dataframe(pandas.DataFrame({"time": time, **columns})), RECORD)


@pytest.mark.parametrize("zone", [None, "Europe/Berlin"])
def test_an_index_of_dates_is_the_time(zone):
    pandas = pytest.importorskip("pandas")
    columns = {"voltage_V": VOLTS, "displacement_um": MICROMETRES}
    dates = pandas.DatetimeIndex(pandas.to_datetime("2024-05-01") + pandas.to_timedelta(TIME, "s"))
    dates = dates.tz_localize(zone) if zone else dates
    assert same(Record.from_dataframe(pandas.DataFrame(columns, index=dates)), RECORD)
    assert same(Record.from_dataframe(pandas.DataFrame(columns, index=dates.rename("time"))), RECORD)
    assert same(Record.from_dataframe(pandas.DataFrame({"time_s": TIME, **columns}, index=dates[::-1])), RECORD)
    with pytest.raises(FileFormatError, match="time column"):
        Record.from_dataframe(pandas.DataFrame(columns))


def test_scales_and_guesses_of_a_dataframe():
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({"time_s": TIME, "monitor_V": VOLTS / 10, "y_um": MICROMETRES})
    with pytest.raises(FileFormatError, match="monitor"):
        Record.from_dataframe(frame, voltage="monitor_V")
    assert same(Record.from_dataframe(frame, voltage="monitor_V", voltage_scale="10 V/V"), RECORD)
    made = Record.from_dataframe(frame, voltage="monitor_V?", voltage_scale="10 V/V")
    assert made.meta["guesses"].keys() == {"voltage"}


def test_micrometres_that_are_taken_for_metres_are_refused():
    with pytest.raises(RecordError, match='units "um"'):
        Record.from_arrays(TIME, VOLTS, MICROMETRES, units="m")
    assert Record.from_arrays(TIME, VOLTS, [0.0, 1.0, 2.0, 1.0, 0.0], units="mm").stroke == 2e-3
    time = np.arange(400) / 100
    volts = 50 - 50 * np.cos(2 * np.pi * time)
    with pytest.raises(RecordError, match='units "um"'):
        Record(time, volts, 0.12 * volts).check_usable()
    Record(time, volts, 1.2e-7 * volts).check_usable()


def test_a_dataset_and_back():
    pytest.importorskip("xarray")
    dataset = RECORD.to_xarray()
    assert dataset.displacement.attrs == {"units": "um"}
    np.testing.assert_allclose(dataset.displacement, MICROMETRES, rtol=1e-15)
    assert same(Record.from_xarray(dataset), RECORD)
    assert Record.from_xarray(RECORD.to_xarray("nm")).name == "stage"
    assert same(Record(dataset.time, dataset.voltage, dataset.displacement), RECORD)


def test_labelled_arrays_are_converted_by_the_unit_among_their_attributes():
    dataset = Collection(
        time=Labelled(TIME * 1e3, "ms"), voltage=Labelled(VOLTS / 1e3, "kV"), displacement=Labelled(MICROMETRES, "um")
    )
    made = Record.from_xarray(dataset)
    np.testing.assert_allclose(made.time, TIME, rtol=1e-15)
    np.testing.assert_allclose(made.voltage, VOLTS, rtol=1e-15)
    np.testing.assert_allclose(made.displacement, RECORD.displacement, rtol=1e-15)
    assert made.name == "from a dataset"
    dataset["time"] = Labelled(np.array(TIME * 1e9, dtype="timedelta64[ns]"))
    assert np.array_equal(Record.from_xarray(dataset).time, TIME)


def test_what_a_dataset_lacks_is_named():
    dataset = Collection(time=Labelled(TIME, "s"), voltage=Labelled(VOLTS, "V"), position=Labelled(MICROMETRES, "um"))
    with pytest.raises(RecordError, match=r"no variable 'displacement'.*'position'.*\.rename\(name='displacement'\)"):
        Record.from_xarray(dataset)
    dataset["displacement"] = Labelled(MICROMETRES, "inch")
    with pytest.raises(RecordError, match="quantity in inch"):
        Record.from_xarray(dataset)
    with pytest.raises(ModelError, match=r"\bV\b.*\bm\b"):
        plain(Labelled(VOLTS, "V"), "displacement")


@pytest.mark.parametrize(("package", "method"), [("pandas", "to_dataframe"), ("xarray", "to_xarray")])
def test_a_missing_library_says_what_to_install(monkeypatch, package, method):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingExtraError, match=rf"needs {package}.*pip install 'dehyst\[tables\]'"):
        getattr(RECORD, method)()


def test_a_file_without_a_unit_is_read_in_the_one_given(tmp_path):
    rows = "\n".join(f"{t},{v},{y}" for t, v, y in zip(TIME, VOLTS, MICROMETRES, strict=True))
    bare, stated = tmp_path / "bare.csv", tmp_path / "stated.csv"
    bare.write_text(f"time_s,voltage_V,displacement\n{rows}\n")
    stated.write_text(f"time_s,voltage_V,displacement_um\n{rows}\n")
    with pytest.raises(FileFormatError, match="no unit"):
        dehyst.read(bare)
    assert same(dehyst.read(bare, units="um"), RECORD)
    assert same(dehyst.read(bare, units="um", displacement="displacement"), RECORD)
    assert same(dehyst.read(stated, units="um"), RECORD)
    assert same(dehyst.read(stated, units="µm"), RECORD)
    with pytest.raises(FileFormatError, match="the unit 'nm'"):
        dehyst.read(stated, units="nm")
    with pytest.raises(FileFormatError, match="units: got 'V'"):
        dehyst.read(bare, units="V")


@pytest.mark.parametrize("names", ["xyz", "xy", "yz"])
def test_several_axes_and_one_voltage_are_ambiguous(names):
    columns = tuple(Column(f"{name}_um", MICROMETRES) for name in names)
    table = Table("a.csv", "", columns)
    with pytest.raises(FileFormatError) as caught:
        table.select("displacement")
    assert all(f"'{name}_um'" in str(caught.value) for name in names)
    assert caught.value.change == ("displacement",)
    assert table.select("displacement", "y_um").column is columns[names.index("y")]


def test_one_axis_is_the_displacement():
    columns = [Column("y_um", MICROMETRES), Column("x_V", VOLTS)]
    assert Table("a.csv", "", tuple(columns)).select("displacement").column is columns[0]
    named = Column("displacement_um", MICROMETRES)
    both = Table("a.csv", "", (named, Column("x_um", MICROMETRES)))
    assert both.select("displacement").column is named
