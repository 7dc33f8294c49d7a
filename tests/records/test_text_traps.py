"""Text files that are easily read wrong: read right, refused or remarked, and their innocent twins are read."""

import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from laboratory_files import UM, T, V, Y
from text_traps import FAST, HEAD, NOISE, NOISY, TRAPS, comma, drive, point, table

import dehyst
from dehyst._errors import DecimalSignError, DehystError, FileFormatError
from dehyst.records import Columns, read, read_table
from dehyst.records.columns import entries_of
from dehyst.records.tables import ColumnsError

STEPS = tomllib.loads(Path(__file__).with_name("tables.toml").read_text("utf-8"))["steps"]
# Part of the range that rounding, straight lines between samples and the noise of a sensor leave.
CLOSE = 0.003


def is_right(record):
    """Whether a record holds the voltage and the displacement of its times, and no short part of them."""
    times = record.time - record.time[0]
    offset_v, offset_y = record.voltage[0] - V[0], record.displacement[0] - Y[0]
    return (
        times[-1] == pytest.approx(T[-1], abs=0.02)
        and np.abs(record.voltage - offset_v - np.interp(times, T, V)).max() < CLOSE * np.ptp(V)
        and np.abs(record.displacement - offset_y - np.interp(times, T, Y)).max() < CLOSE * np.ptp(Y)
    )


# More whole numbers than are read at once, before a number with a sign; the value of this number, None if refused.
MANY = "a;b\n" + "1;2\n" * 60_000 + "{};2\n"
LATE = [("1.5", None, 1.5), ("1,5", None, 1.5), ("1,5", "comma", 1.5), ("1.234", "point", 1.234), ("1.234", None, None)]


@pytest.mark.parametrize(("cell", "decimal", "value"), LATE)
def test_a_late_decimal_sign_is_read_or_doubtful(tmp_path, cell, decimal, value):
    (tmp_path / "a.csv").write_text(MANY.format(cell))
    if value is None:
        with pytest.raises(DecimalSignError) as caught:
            read_table(tmp_path / "a.csv")
        assert caught.value.change == ("decimal",)
        return
    first, second = read_table(tmp_path / "a.csv", Columns(decimal=decimal)).columns
    assert (first.data[:-1].sum(), first.data[-1], second.data.sum()) == (60_000, value, 2 * 60_001)


def test_a_given_decimal_sign_that_the_file_contradicts_is_refused(tmp_path):
    table(";", HEAD, point(T, 3), point(V, 4), point(UM, 5))(tmp_path / "a.csv")
    with pytest.raises(FileFormatError, match=r"'time_s': row 2 holds '0\.000'"):
        read(tmp_path / "a.csv", "decimal=comma")
    np.savez(tmp_path / "a.npz", time_s=T, voltage_V=V, displacement_um=UM)
    with pytest.raises(FileFormatError, match="decimal: got"):
        read(tmp_path / "a.npz", "decimal=point")


@pytest.mark.parametrize("header", STEPS)
def test_a_header_states_the_step_in_the_notation_of_its_table(tmp_path, header):
    """And with its unit; else the rate is asked for."""
    number, step = {"point": point, "comma": comma}[STEPS[header]["decimal"]], STEPS[header]["step"]
    table(STEPS[header]["separator"], "voltage_V,displacement_um", number(V, 2), number(UM, 2))(tmp_path / "a.csv")
    (tmp_path / "a.csv").write_text(f"{header}\n{(tmp_path / 'a.csv').read_text()}")
    if step:
        record = read(tmp_path / "a.csv")
        assert record.time[:2] == pytest.approx([0, step])
        assert "guesses" not in record.meta
        return
    with pytest.raises(ColumnsError) as caught:
        read(tmp_path / "a.csv")
    assert entries_of(caught.value.proposal)["rate"] == "HZ"
    assert read(tmp_path / "a.csv", "rate=50").time[1] == pytest.approx(0.02)


def test_a_selected_unit_resolves_a_contradiction(tmp_path):
    TRAPS["a row of units against the names"].trap(tmp_path / "a.csv")
    names = "time=time_s:s, displacement=displacement_um:um"
    assert is_right(read(tmp_path / "a.csv", f"{names}, voltage=voltage_V:V"))
    assert np.ptp(read(tmp_path / "a.csv", f"{names}, voltage=voltage_V:mV").voltage) == pytest.approx(0.1)
    assert is_right(read(tmp_path / "a.csv", "time=1:s, voltage=2:V, displacement=3:um"))
    for columns in ("time=1, voltage=2:V, displacement=3:um", "time=1:s, voltage=2:V, displacement=3"):
        with pytest.raises(FileFormatError) as caught:
            read(tmp_path / "a.csv", columns)
        assert caught.value.change == ()


def test_a_sample_rate_replaces_timestamps_that_are_refused(tmp_path):
    for name in ("days and months", "an hour of summer time"):
        TRAPS[name].trap(tmp_path / "a.csv")
        with pytest.raises(FileFormatError):
            read(tmp_path / "a.csv")
        assert is_right(read(tmp_path / "a.csv", "rate=500.0"))


def test_joining_keeps_the_noise_of_a_sensor(tmp_path):
    drive(point(T, 3), "time_s")(tmp_path / "a.csv")
    table(",", "time_s,displacement_um", point(FAST, 9), point(NOISY, 9))(tmp_path / "b.csv")
    for first, second in (("a.csv", "b.csv"), ("b.csv", "a.csv")):
        record = read(tmp_path / first, f"join={tmp_path / second}")
        assert record.noise == pytest.approx(NOISE * 1e-6, rel=0.1)
        assert record.sample_time == pytest.approx(1 / 1777)


def test_a_file_whose_time_cannot_be_read_is_not_joined_by_its_samples(tmp_path):
    drive(point(T, 3), "time_s")(tmp_path / "a.csv")
    table(",", "time_s,displacement_um", ["x", *point(T[1:], 3)], point(UM, 6))(tmp_path / "b.csv")
    with pytest.raises(FileFormatError, match="row 2 holds 'x'"):
        read(tmp_path / "a.csv", f"join={tmp_path / 'b.csv'}")


@pytest.mark.parametrize(
    ("use", "kind"), [(dehyst.read, pd.DataFrame), (dehyst.identify, pd.DataFrame), (read_table, np.array)]
)
def test_data_in_place_of_a_file_name_is_not_printed(use, kind):
    with pytest.raises(DehystError, match=r"dehyst\.Record\.from_arrays") as caught:
        use(kind({"time_s": T, "voltage_V": V, "displacement_um": UM} if kind is pd.DataFrame else T))
    assert len(str(caught.value)) < 200
