"""Text files that are easily read wrong: read right, refused or remarked, and their innocent twins are read."""

import numpy as np
import pandas as pd
import pytest
from laboratory_files import UM, T, V, Y
from text_traps import FAST, HEAD, NM, NOISE, NOISY, TRAPS, comma, drive, point, stamps, table

import dehyst
from dehyst._errors import DehystError, FileFormatError
from dehyst.records import Columns, read, read_table
from dehyst.records.formats.timestamps import clock_of, moment

# Of the range: what rounding, straight lines between samples and the noise of a sensor leave.
CLOSE = 0.003


def is_right(record, start=0.0):
    """Whether a record holds the voltage and the displacement of its times, and no short part of them."""
    times = record.time - record.time[0] + start
    offset_v, offset_y = record.voltage[0] - np.interp(start, T, V), record.displacement[0] - np.interp(start, T, Y)
    return (
        times[-1] == pytest.approx(T[-1], abs=0.02)
        and np.abs(record.voltage - offset_v - np.interp(times, T, V)).max() < CLOSE * np.ptp(V)
        and np.abs(record.displacement - offset_y - np.interp(times, T, Y)).max() < CLOSE * np.ptp(Y)
    )


def end_of(path, options, start):
    """What becomes of a file, and the words that say so."""
    try:
        record = read(path, options)
    except DehystError as error:
        return "refused", str(error)
    if is_right(record, start):
        return "right", ""
    remarks = " ".join(record.problems())
    return ("remarked" if record.meta.get("remarks") else "read wrong in silence"), remarks


@pytest.mark.parametrize("name", TRAPS)
def test_no_trap_is_read_wrong_in_silence(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    trap = TRAPS[name]
    trap.trap(tmp_path / f"a{trap.suffix}")
    end, words = end_of(f"a{trap.suffix}", trap.options, trap.start)
    assert end == trap.end
    assert trap.words in words


@pytest.mark.parametrize("name", TRAPS)
def test_every_innocent_twin_is_read(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    trap = TRAPS[name]
    trap.twin(tmp_path / f"a{trap.suffix}")
    record = read(f"a{trap.suffix}", trap.twin_options)
    assert is_right(record)
    assert "remarks" not in record.meta


# The decimal sign


@pytest.mark.parametrize(
    ("name", "decimal"),
    [
        ("thousands beside decimal points, tabs", "."),
        ("thousands beside decimal points, semicolons", "."),
        ("thousands in a part of the values", "."),
        ("points for thousands beside decimal commas", ","),
        ("commas before three digits, nothing else", "."),
        ("points before three digits, nothing else", ","),
        ("thousands in quotes", "."),
        ("thousands as text in a workbook", "."),
        ("thousands in UTF-16", "."),
    ],
)
def test_a_stated_decimal_sign_resolves_it(name, decimal, tmp_path):
    trap = TRAPS[name]
    path = tmp_path / f"a{trap.suffix}"
    trap.trap(path)
    assert f'"{decimal}"' in end_of(path, None, 0)[1]
    assert is_right(read(path, Columns(decimal=decimal)))


@pytest.mark.parametrize(
    ("cells", "values"),
    [
        ("0,010;1,000;0,011", [0.010, 1.0, 0.011]),
        ("-0,5;1,234;12,345", [-0.5, 1.234, 12.345]),
        (",5;1,234;1", [0.5, 1.234, 1]),
        ("1234,567;1,234;1", [1234.567, 1.234, 1]),
        ("1,5E-3;1,234;1", [1.5e-3, 1.234, 1]),
        ("1,234E+3;1,234;1", [1234, 1.234, 1]),
        ("1.234,5;1.234;1", [1234.5, 1234, 1]),
        ("1,234.5;1,234;1", [1234.5, 1234, 1]),
        ("-1,234,567;1,234;1.234", [-1234567, 1234, 1.234]),
        ("1.234.567;-1.234;1,234", [1234567, -1234, 1.234]),
        ("1;2;3", [1, 2, 3]),
    ],
)
def test_one_cell_decides_for_the_others(tmp_path, cells, values):
    (tmp_path / "a.csv").write_text(f"a;b;c\n{cells}\n{cells}\n")
    found = read_table(tmp_path / "a.csv").columns
    assert [column.data[0] for column in found] == pytest.approx(values)


def test_decimal_commas_between_blanks_and_in_a_single_column(tmp_path):
    table("   ", HEAD.replace(",", " "), comma(T, 3), comma(V, 4), comma(UM, 4))(tmp_path / "a.txt")
    assert is_right(read(tmp_path / "a.txt"))
    table(";", "displacement_um", comma(UM, 4))(tmp_path / "b.csv")
    (column,) = read_table(tmp_path / "b.csv").columns
    assert column.data == pytest.approx(UM, abs=1e-4)
    (tmp_path / "c.csv").write_text("a,b\n1,2\n3,4\n")
    assert [one.data.tolist() for one in read_table(tmp_path / "c.csv").columns] == [[1, 3], [2, 4]]


@pytest.mark.parametrize(
    ("sign", "cells"),
    [
        (";", "1.5;1,5;1"),
        (";", "0,5;1.234;1"),
        (";", "0.5;1,234;1"),
        (";", "12,011;1;1"),
        ("\t", "12.011\t1\t1"),
        (";", "12,011;9.022;1"),
        (",", '"12,011",1,1'),
        (";", "1,234,567;1.234.567;1"),
    ],
)
def test_what_no_cell_decides_is_refused(tmp_path, sign, cells):
    (tmp_path / "a.csv").write_text(f"a{sign}b{sign}c\n{cells}\n{cells}\n")
    with pytest.raises(FileFormatError, match=r"line 2, column '[ab]' holds"):
        read_table(tmp_path / "a.csv")


def test_a_decimal_sign_that_the_file_contradicts(tmp_path):
    table(";", HEAD, point(T, 3), point(V, 4), point(UM, 5))(tmp_path / "a.csv")
    with pytest.raises(FileFormatError, match=r"line 2, column 'time_s' holds '0\.000'"):
        read(tmp_path / "a.csv", "decimal=comma")
    for nonsense in ("", ";", 5, True):
        with pytest.raises(FileFormatError, match="decimal: got"):
            Columns(decimal=nonsense)
    np.savez(tmp_path / "a.npz", time_s=T, voltage_V=V, displacement_um=UM)
    with pytest.raises(FileFormatError, match="decimal: got"):
        read(tmp_path / "a.npz", "decimal=point")


@pytest.mark.parametrize(
    ("header", "sign", "number", "step"),
    [
        ("Sample rate;10,000;Hz", ";", point, 1e-4),
        ("Sample rate (Hz)\t1,000", "\t", point, 1e-3),
        ('Sample rate,"10,000",Hz', ",", point, 1e-4),
        ("Sample rate,10,000,Hz", ",", point, 1e-4),
        ("Sample rate;1,000,000;Hz", ";", point, 1e-6),
        ("Sample rate;10.000;Hz", ";", comma, 1e-4),
        ("Sample rate;10,000;Hz", ";", comma, 0.1),
        ("Sample rate,1000,1000", ",", point, 1e-3),
        ("Sample interval [s];0,05", ";", point, 0.05),
        ("dt 0,01", ";", comma, 0.01),
    ],
)
def test_a_header_has_the_decimal_sign_of_its_table(tmp_path, header, sign, number, step):
    table(sign, "voltage_V,displacement_um", number(V, 2), number(UM, 2))(tmp_path / "a.csv")
    (tmp_path / "a.csv").write_text(f"{header}\n{(tmp_path / 'a.csv').read_text()}")
    assert read(tmp_path / "a.csv").time[1] == pytest.approx(step)


def test_a_header_that_can_be_read_in_two_ways_is_refused(tmp_path):
    table(";", "voltage_V,displacement_nm", point(V, 0), point(NM, 0))(tmp_path / "a.csv")
    (tmp_path / "a.csv").write_text(f"Sample rate;10,000;Hz\n{(tmp_path / 'a.csv').read_text()}")
    with pytest.raises(FileFormatError, match=r"'10,000'.*decimal"):
        read(tmp_path / "a.csv")
    steps = {sign: read(tmp_path / "a.csv", Columns(decimal=sign)).time[1] for sign in ".,"}
    assert steps == pytest.approx({".": 1e-4, ",": 0.1})
    assert read(tmp_path / "a.csv", "rate=50").time[1] == pytest.approx(0.02)
    table(";", "voltage_V,displacement_um", point(V, 2), point(UM, 2))(tmp_path / "b.csv")
    (tmp_path / "b.csv").write_text(f"Sample rate;10,000;Hz\nSample interval;0,05\n{(tmp_path / 'b.csv').read_text()}")
    with pytest.raises(FileFormatError, match="10,000"):
        read(tmp_path / "b.csv")


# Units, rows, files


@pytest.mark.parametrize(
    ("cells", "seconds"),
    [
        (["04/03/2026 10:00:00", "04/03/2026 10:00:01"], [0, 1]),
        (["31/12/2026 23:59:59", "01/01/2027 00:00:00"], [0, 1]),
        (["12/31/2026 23:59:59", "01/01/2027 00:00:00"], [0, 1]),
        (["09/12/2026 10:00:00", "10/01/2026 10:00:00"], [0, 19 * 86400]),
        (["23:59:59Z", "00:00:00Z"], [0, 1]),
        (["2026-03-29T01:59:59+01:00", "2026-03-29T03:00:00+02:00"], [0, 1]),
    ],
)
def test_the_order_of_days_and_months(cells, seconds):
    assert clock_of([moment(cell) for cell in cells]).seconds.tolist() == seconds


@pytest.mark.parametrize(
    "cells",
    [
        ["04/03/2026 23:59:59", "05/03/2026 00:00:00"],
        ["13/03/2026 10:00:00", "03/14/2026 10:00:00"],
        ["2026-03-04T10:00:00", "2026-03-04T10:00:01Z"],
        ["10:00:00", "2026-03-04T10:00:01"],
        [*(f"2026-03-29T01:59:{k:02d}" for k in range(60)), "2026-03-29T03:00:00"],
        [*(f"02:59:{k:02d}" for k in range(60)), "02:00:00"],
    ],
)
def test_timestamps_of_two_meanings(cells):
    with pytest.raises(ValueError, match="its"):
        clock_of([moment(cell) for cell in cells])


def test_a_unit_that_the_user_selects_ends_a_contradiction(tmp_path):
    TRAPS["a row of units against the names"].trap(tmp_path / "a.csv")
    names = "time=time_s:s, displacement=displacement_um:um"
    assert is_right(read(tmp_path / "a.csv", f"{names}, voltage=voltage_V:V"))
    assert np.ptp(read(tmp_path / "a.csv", f"{names}, voltage=voltage_V:mV").voltage) == pytest.approx(0.1)
    assert is_right(read(tmp_path / "a.csv", "time=1:s, voltage=2:V, displacement=3:um"))
    for columns in ("time=1, voltage=2:V, displacement=3:um", "time=1:s, voltage=2:V, displacement=3"):
        with pytest.raises(FileFormatError) as caught:
            read(tmp_path / "a.csv", columns)
        assert caught.value.change == ()


@pytest.mark.parametrize("name", ["days and months", "an hour of summer time"])
def test_a_sample_rate_replaces_timestamps_that_are_refused(name, tmp_path):
    TRAPS[name].trap(tmp_path / "a.csv")
    assert is_right(read(tmp_path / "a.csv", "rate=500.0"))


def test_a_number_is_not_cut_off_where_a_comment_may_begin(tmp_path):
    (tmp_path / "a.csv").write_text(f"{HEAD}\n0,1,2\n1,2,3#5\n")
    with pytest.raises(FileFormatError, match="line 3 holds '3#5'"):
        read(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_text(f"{HEAD}\n0,1,2\n1,2,3 # on\n")
    assert read(tmp_path / "b.csv").displacement == pytest.approx([2e-6, 3e-6])


def test_a_joined_sensor_keeps_its_noise(tmp_path):
    drive(point(T, 3), "time_s")(tmp_path / "a.csv")
    table(",", "time_s,displacement_um", point(FAST, 9), point(NOISY, 9))(tmp_path / "b.csv")
    for first, second in (("a.csv", "b.csv"), ("b.csv", "a.csv")):
        record = read(tmp_path / first, f"join={tmp_path / second}")
        assert record.noise == pytest.approx(NOISE * 1e-6, rel=0.1)
        assert record.sample_time == pytest.approx(1 / 1777)


@pytest.mark.parametrize("form", ["%d/%m/%Y %H:%M:%S.%f", "%m/%d/%Y %H:%M:%S.%f"])
@pytest.mark.parametrize("other", ["%Y-%m-%dT%H:%M:%S.%f", "%d.%m.%Y %H:%M:%S.%f", "same"])
def test_the_files_that_are_joined_decide_the_order_of_days_and_months(tmp_path, form, other):
    drive(stamps(T, "2026-04-03T12:00:00", form if other == "same" else other))(tmp_path / "a.csv")
    table(",", "timestamp,displacement_um", stamps(T[100:], "2026-04-03T12:00:00", form), point(UM[100:], 6))(
        tmp_path / "b.csv"
    )
    for first, second in (("a.csv", "b.csv"), ("b.csv", "a.csv")):
        record = read(tmp_path / first, f"join={tmp_path / second}")
        assert record.displacement == pytest.approx(1e-6 * UM[100:], abs=1e-10)
        assert record.voltage == pytest.approx(V[100:], abs=1e-3)


def test_dates_of_two_orders_that_both_overlap_are_refused(tmp_path):
    table(",", "timestamp,voltage_V", ["2026-03-01T00:00:00", "2026-05-01T00:00:00"], point(V[:2], 3))(
        tmp_path / "a.csv"
    )
    dates = stamps(T, "2026-04-03T12:00:00", "%d/%m/%Y %H:%M:%S.%f")
    table(",", "timestamp,displacement_um", dates, point(UM, 6))(tmp_path / "b.csv")
    with pytest.raises(FileFormatError, match="month/day/year"):
        read(tmp_path / "a.csv", f"join={tmp_path / 'b.csv'}")


def test_a_file_whose_time_cannot_be_read_is_not_joined_by_its_samples(tmp_path):
    drive(point(T, 3), "time_s")(tmp_path / "a.csv")
    table(",", "time_s,displacement_um", ["x", *point(T[1:], 3)], point(UM, 6))(tmp_path / "b.csv")
    with pytest.raises(FileFormatError, match="line 2 holds 'x'"):
        read(tmp_path / "a.csv", f"join={tmp_path / 'b.csv'}")


@pytest.mark.parametrize(
    ("use", "kind"), [(dehyst.read, pd.DataFrame), (dehyst.identify, pd.DataFrame), (read_table, np.array)]
)
def test_data_that_is_no_file_is_named_and_not_printed(use, kind):
    with pytest.raises(DehystError, match=r"dehyst\.Record\.from_arrays") as caught:
        use(kind({"time_s": T, "voltage_V": V, "displacement_um": UM} if kind is pd.DataFrame else T))
    assert len(str(caught.value)) < 200
