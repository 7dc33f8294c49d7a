"""Text files that are easily read wrong: read right, refused or remarked, and their innocent twins are read."""

import numpy as np
import pandas as pd
import pytest
from laboratory_files import UM, T, V, Y
from text_traps import FAST, HEAD, NOISE, NOISY, TRAPS, comma, drive, point, table

import dehyst
from dehyst._errors import DehystError, FileFormatError
from dehyst.records import Columns, read, read_table
from dehyst.records.formats.notation import clock_of, moment

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


# More whole numbers than are read at once, before a number with a sign.
MANY = "a;b\n" + "1;2\n" * 60_000 + "{};2\n"
# Text, the decimal sign that the user states, and the columns that are read; others have a fault.
READ = {
    **{f"a late sign, {cell}": (MANY.format(cell), "", {"b": [2] * 60_001}) for cell in ("1.234", "1.5", "1,5")},
    "a late sign that is stated": (MANY.format("1,5"), "comma", {"a": [1] * 60_000 + [1.5], "b": [2] * 60_001}),
    "a zero before": ("a;b;c;d\n0,010;1,000;-0,5;,5\n", "", {"a": [0.010], "b": [1.0], "c": [-0.5], "d": [0.5]}),
    "four digits before": ("a;b\n1234,567;1,234\n", "", {"a": [1234.567], "b": [1.234]}),
    "an exponent": ("a;b\n1,5E-3;1,234E+3\n", "", {"a": [1.5e-3], "b": [1234]}),
    "groups": ("a;b;c;d\n1,234.5;0.5;1,234,567;1.234.567\n", "", {"b": [0.5]}),
    "points that group": ("a;b;c\n1.234,5;0,5;1.234\n", "comma", {"b": [0.5]}),
    "a stated comma": ("a;b;c\n12,011;1;1.5\n", "comma", {"a": [12.011], "b": [1]}),
    "a stated point": ("a;b;c\n12.011;1;1,5\n", "point", {"a": [12.011], "b": [1]}),
    "quotes": ('a,b\n"0,5",1\n', "", {"a": [0.5], "b": [1]}),
    "whole numbers": ("a,b\n1,2\n3,4\n", "", {"a": [1, 3], "b": [2, 4]}),
    "one column": ("y_um\n0,5\n1,5\n", "comma", {"y_um": [0.5, 1.5]}),
    "blanks": ("t  v\n0,5   1,25\n0,6   1,5\n", "comma", {"t": [0.5, 0.6], "v": [1.25, 1.5]}),
    "a meter": (
        "n, Value, Unit\n1, 30,012, V\n2, 31,512, V\n3, 32,1, V\n",
        "comma",
        {"n": [1, 2, 3], "Value": [30.012, 31.512, 32.1]},
    ),
    "a meter with points": ("n, Value, Unit\n1, 30.012, V\n2, 30.5, V\n", "", {"n": [1, 2], "Value": [30.012, 30.5]}),
    "some blanks": ("a, b,c\n0, 1,2\n1, 2,3\n", "", {"a": [0, 1], "b": [1, 2], "c": [2, 3]}),
    "names in a comment": ("# n, a,b\n0, 1,2\n1, 2,4\n", "", {"n": [0, 1], "a": [1, 2], "b": [2, 4]}),
    # The last line of names is the header.
    "metadata": ("R,Ohm\tTemp,C\n5\t25\ntime_s\tv_V\n0\t2\n1\t4\n2\t3\n", "", {"time_s": [0, 1, 2], "v_V": [2, 4, 3]}),
    "a comment in the table": ("t v\n# on\n0 1\n1 2\n# on\n2 1\n3 2\n", "", {"t": [0, 1, 2, 3], "v": [1, 2, 1, 2]}),
    "a pause": ("t v\n0 1\n1 2\n\n2 1\n3 2\n", "", {"t": [0, 1, 2, 3], "v": [1, 2, 1, 2]}),
    "blank lines between rows": ("t v\n\n0 3\n\n1 2\n\n2 1\n", "", {"t": [0, 1, 2], "v": [3, 2, 1]}),
    "a row in a comment": ("t,v\n0,1\n# 1,2\n2,3\n", "", {"t": [0, 2], "v": [1, 3]}),
    "a count without a name": (",t,v\n0,0,1\n1,2,2\n", "", {"": [0, 1], "t": [0, 2], "v": [1, 2]}),
    # Oscilloscopes.
    "names that are numbers": (
        "x-axis,1,2\nsecond,Volt,Volt\n0,1,2\n1,2,3\n",
        "",
        {"x-axis": [0, 1], "1": [1, 2], "2": [2, 3]},
    ),
    **{
        f"rigol, {len(end)} commas": (
            "X,CH1,Start,Increment,\nSequence,Volt,-1,2e-2\n" + "".join(f"{k},{3 * k}{end}\n" for k in range(3)),
            "",
            {"time": [0, 0.02, 0.04], "CH1": [0, 3, 6]},
        )
        for end in ("", ",", ",,")
    },
    "sigrok": ("; Samplerate: 50 Hz\nA0,A1\n1,2\n3,4\n", "", {"time": [0, 0.02], "A0": [1, 3], "A1": [2, 4]}),
    "owon": (
        "# Sampling : 50 Sa/s\n# n, a, b\n0, 2.5,1\n1, 3,5\n",
        "",
        {"time": [0, 0.02], "a": [2.5, 3], "b": [1, 5]},
    ),
    "a step without a unit": ("# Sampling : 50\na,b\n1,2\n3,4\n", "", {"a": [1, 3], "b": [2, 4]}),
}


@pytest.mark.parametrize("name", READ)
def test_columns_of_text_tables_are_read(tmp_path, name):
    content, decimal, columns = READ[name]
    (tmp_path / "a.csv").write_text(content)
    table = read_table(tmp_path / "a.csv", Columns.parse(f"decimal={decimal}") if decimal else None)
    found = {column.name: column.data for column in table.columns if not column.fault}
    assert found.keys() == columns.keys()
    for column, values in columns.items():
        assert found[column] == pytest.approx(values)


HEADER = f"{HEAD}\n"
ROWS = "".join(f"{k},{k % 9},{k % 7}\n" for k in range(10, 60))
# Text, and words of the refusal.
REFUSED = {
    "two signs": ("a;b\n1.5;1,5\n", "row 2 holds '1.5'"),
    "a doubtful point": ("a;b\n0,5;1.234\n", "row 2 holds '1.234'"),
    "a doubtful comma": ("a;b\n0.5;1,234\n", "row 2 holds '1,234'"),
    "a comma alone": ("a;b\n12,011;1\n", "thousand times"),
    "a point alone": ("a\tb\n12.011\t1\n", "thousand times"),
    "both alone": ("a;b\n12,011;9.022\n", "one decimal sign"),
    "in quotes": ('a,b\n"12,011",1\n', "thousand times"),
    "a number cut off": ("a;b\n12,011;12,345\n13,011;12,3", "thousand times"),
    "a comma alone between commas": ("Type, DCV\nNo, Value\n1, 30,012\n2, 31,512\n", "decimal=comma"),
    "a comma between commas": ("No,Value,Unit\n1,30,012,V\n2,31,512,V\n", "decimal=comma"),
    "a comma, below metadata": ("Type,DCV\nNo,Value\n1,30,012\n2,31,512\n", "decimal=comma"),
    "a comma and a blank without names": ("0,5, 1,25\n0,6, 1,35\n", "decimal=comma"),
    "a comma in one column": ("y_um\n0,5\n1,5\n", "decimal=comma"),
    "numbers above the names": ("OVER,1,2\nt,v,w\n0,1,2\n1,2,3\n", "row 1"),
    "the header again": ("t,v\n0,1\n1,2\nt,v\n0,1\n", "rows 2, 5"),
    "names and units again": ("t,v\ns,V\n0,1\n1,2\n2,3\nt,v\ns,V\n0,1\n1,2\n", "rows 3, 7"),
    "a comment with the names again": ("# t v\n0 1\n1 2\n# t v\n0 1\n", "rows 2, 5"),
    "a bad cell": (HEADER + "0,1,2\n1,2x,3\n", "row 3 holds '2x'"),
    "a comment sign in a number": (HEADER + "0,1,2\n1,2,3#5\n", "row 3 holds '3#5'"),
    "a bad cell behind comments": ("# a\n\n" + HEADER + "0,1,2\n#\n1,?,3\n", "row 6 holds '?'"),
    "a short row": (HEADER + "0,1,2\n1,2\n", "row 3 has 2 cells"),
    "a long row": (HEADER + "0,1,2\n1,2,3,4\n", "row 3 has 4 cells"),
    "no rows": (HEADER + "# none\n\n", "no rows"),
    "no header": ("0,1,2\n1,2,3\n", "no names"),
    "few names in a comment": ("# time_s,voltage_V\n0,1,2\n1,2,3\n", "no names"),
    "only comments": ("# nothing\n\n% here\n", "comments"),
    "an empty file": ("", "empty"),
    "a binary file": ("time\0s", "NUL"),
    "an overload in the first row": (HEADER + "OVER,OVER,1\n" + ROWS, "row 2 "),
    "a word in the first row": (HEADER + "0,1,x\n" + ROWS, "row 2 "),
    "words in the table": (HEADER + "0,1,2\nstart,of,test\n" + ROWS, "row 3 "),
    "short first rows": (HEADER + "1,2\n" * 5 + ROWS, "row 2 "),
    "a missing cell": (HEADER + "0,1,2\n1,,3\n2,3,4\n", "voltage[1]"),
    "no number": (HEADER + "0,1,2\n1,NaN,3\n2,3,4\n", "voltage[1]"),
    "a time that does not rise": (HEADER + "0,1,2\n0,1,3\n", "time"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_ambiguous_and_broken_tables_are_refused(tmp_path, name):
    content, words = REFUSED[name]
    (tmp_path / "a.csv").write_text(content)
    with pytest.raises(DehystError) as caught:
        read(tmp_path / "a.csv")
    assert words in str(caught.value)


def test_a_given_decimal_sign_that_the_file_contradicts_is_refused(tmp_path):
    table(";", HEAD, point(T, 3), point(V, 4), point(UM, 5))(tmp_path / "a.csv")
    with pytest.raises(FileFormatError, match=r"'time_s': row 2 holds '0\.000'"):
        read(tmp_path / "a.csv", "decimal=comma")
    np.savez(tmp_path / "a.npz", time_s=T, voltage_V=V, displacement_um=UM)
    with pytest.raises(FileFormatError, match="decimal: got"):
        read(tmp_path / "a.npz", "decimal=point")


@pytest.mark.parametrize(
    ("header", "sign", "number", "step"),
    [
        ("Sample rate;10000;Hz", ";", point, 1e-4),
        ("Sample rate,1 kS/s", ",", point, 1e-3),
        ("Sample rate: 50 S/s", ",", point, 0.02),
        ("# Sample interval [ms] = 20", ",", point, 0.02),
        ("dt: 5 us", ",", point, 5e-6),
        ("dt 0,01 s", ";", comma, 0.01),
        ("XInc, 0.01, s\nXOrg, -0.3, s", ",", point, 0.01),
        ("Sample rate;10,000;Hz", ";", point, None),
        ('Sample rate,"10,000",Hz', ",", point, None),
        ("Sample rate;10.000;Hz", ";", comma, None),
        ("Sample rate: 0 Hz", ",", point, None),
        ("Sample rate\t1e3 Hz\nSample rate\t2e3 Hz", "\t", point, None),
        ("Sample interval [s];0,05", ";", point, None),
    ],
)
def test_a_header_states_the_step_in_the_notation_of_its_table(tmp_path, header, sign, number, step):
    """And with its unit; else the rate is asked for."""
    table(sign, "voltage_V,displacement_um", number(V, 2), number(UM, 2))(tmp_path / "a.csv")
    (tmp_path / "a.csv").write_text(f"{header}\n{(tmp_path / 'a.csv').read_text()}")
    if step is None:
        with pytest.raises(FileFormatError, match="rate=HZ"):
            read(tmp_path / "a.csv")
        assert read(tmp_path / "a.csv", "rate=50").time[1] == pytest.approx(0.02)
        return
    record = read(tmp_path / "a.csv")
    assert record.time[:2] == pytest.approx([0, step])
    assert "guesses" not in record.meta


# Timestamps, and the seconds since the first; or the words of their fault.
STAMPS: list[tuple[list[str], list[float] | str]] = [
    (["2026/03/04 10:00:00", "2026-03-04T10:00:01"], [0, 1]),
    (["23:59:59.5", "00:00:00.5"], [0, 1]),
    (["23:59:59Z", "00:00:00Z"], [0, 1]),
    (["12:00:00+02:00", "10:00:01Z"], [0, 1]),
    (["2026-03-29T01:59:59+01:00", "2026-03-29T03:00:00+02:00"], [0, 1]),
    (["11:59:59.500 AM", "12:00:00 PM", "1:00:00 pm"], [0, 0.5, 3600.5]),
    (["11:59:59 PM", "12:00:00 AM"], [0, 1]),
    (["2026/03/04 12:00:01 AM", "2026-03-04 12:00:01PM"], [0, 43_200]),
    (["2024-12-31 23:59:59.9999999", "2025-01-01T00:00:00,5"], [0, 0.5000001]),
    (["2026-03-04T10:00:00", "2026-03-04T10:00:01Z"], "UTC"),
    (["10:00:00", "2026-03-04T10:00:01"], "midnight"),
    # A clock that is put forward or back, against an hour's pause by the offset from UTC, and hourly samples.
    (["01:59:58", "01:59:59", "03:00:00", "03:00:01"], "an hour"),
    ([f"2026-10-25T0{cell}" for cell in ("2:59:57", "2:59:58", "2:59:59", "2:00:00")], "an hour"),
    (["01:59:58Z", "01:59:59Z", "03:00:00Z", "03:00:01Z"], [0, 1, 3602, 3603]),
    (["01:00:00", "02:00:00", "03:00:00"], [0, 3600, 7200]),
    *(
        ([cell], "")
        for cell in (
            "",
            "1.5",
            "12:00",
            "2024-01-01",
            "a12:00:00",
            "04/03/2026 10:00:00",
            "2026-3-4 10:00:00",
            "13:00:00 PM",
            "0:30:00 AM",
        )
    ),
]


@pytest.mark.parametrize(("cells", "seconds"), STAMPS)
def test_timestamps_become_seconds(cells, seconds):
    if isinstance(seconds, list):
        assert clock_of([moment(cell) for cell in cells]) == pytest.approx(seconds, abs=1e-9)
        return
    with pytest.raises(ValueError, match=seconds or None):
        clock_of([moment(cell) for cell in cells])


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
