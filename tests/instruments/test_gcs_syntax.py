"""The client's half of GCS as text: what is sent is read back as the same numbers, what is no answer is refused."""

import math
import string

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dehyst.instruments import LinkError, RigError, gcs_syntax

VOLTAGES = st.floats(-1e6, 1e6, allow_nan=False)
FINITE = st.floats(-1e15, 1e15, allow_nan=False)
LINE = st.text(st.sampled_from(string.printable[:95]), max_size=40)
NAMES = st.text(st.sampled_from(string.ascii_letters + string.digits + "_-"), min_size=1, max_size=8)


def array_text(columns, sample_time=5e-5, names=("Current Position of axis 1", "Voltage of output chan 1")):
    head = [
        "# REM a recorder",
        "#",
        "# VERSION = 1",
        "# TYPE = 1",
        "# SEPARATOR = 32",
        f"# DIM = {len(columns)}",
        f"# SAMPLE_TIME = {sample_time!r}",
        f"# NDATA = {len(columns[0])}",
        "#",
        *(f"# NAME{index} = {name}" for index, name in enumerate(names)),
        "#",
        "# END_HEADER",
    ]
    return head + [" ".join(map(repr, row)) for row in zip(*columns, strict=True)]


@given(VOLTAGES)
def test_a_voltage_is_written_to_a_microvolt(value):
    text = gcs_syntax.volts(value)
    assert abs(float(text) - value) <= 0.5000001e-6
    assert not set(text) - set("-.0123456789")
    assert gcs_syntax.real(text) == float(text)


@given(VOLTAGES, st.floats(0, 1e3), st.floats(0, 1e3))
def test_rounding_never_leaves_the_limits(value, below, above):
    low, high = value - below, value + above
    assert low <= float(gcs_syntax.volts(value, low, high)) <= high


@given(VOLTAGES)
def test_a_limit_is_written_exactly(limit):
    assert float(gcs_syntax.volts(limit, limit, limit)) == limit


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 100.0001, -0.1])
def test_a_voltage_outside_the_limits_cannot_be_written(value):
    with pytest.raises(RigError, match="nothing"):
        gcs_syntax.volts(value, 0.0, 100.0)


@given(st.lists(VOLTAGES, min_size=1, max_size=400), st.integers(60, 600))
def test_a_wave_is_complete_in_lines_of_allowed_length(wave, longest):
    texts = [gcs_syntax.volts(value) for value in wave]
    lines = list(gcs_syntax.wave_points(3, texts, longest))
    assert all(len(line) <= longest for line in lines)
    words = [line.split() for line in lines]
    assert all(word[:2] == ["WAV", "3"] and word[3:5] == ["PNT", "1"] for word in words)
    assert [word[2] for word in words] == ["X"] + ["&"] * (len(words) - 1)
    assert all(int(word[5]) == len(word) - 6 for word in words)
    assert [point for word in words for point in word[6:]] == texts


@pytest.mark.parametrize("argument", ["1\nSVA 1 9", "a b", "", "é", "1 "])
def test_an_argument_cannot_contain_a_command(argument):
    with pytest.raises(RigError, match="need one word"):
        gcs_syntax.command("SVA", argument)


@pytest.mark.parametrize("raw", [b"1=2", b"1=\x002\n", b"1=\xff\n", b"\x7f\n", b""])
def test_a_line_of_other_bytes_is_refused(raw):
    with pytest.raises(LinkError, match="printable"):
        gcs_syntax.line_of(raw)


NO_VALUES = ["1=nan", "1=inf", "1=1e999", "1=1_0", "1=", "=1", "1", "2=1", "1=0x10", "1=1,5", "1=١"]
REFUSED = {
    "values": (
        lambda lines: gcs_syntax.values(lines, ["1"]),
        [*([text] for text in (*NO_VALUES, "", "1=2 3")), [], ["1=2", "1=2"], ["1=2", "2=3"]],
    ),
    "parameter": (
        lambda lines: gcs_syntax.parameter(lines, "1", 0x0E000200),
        [["2 0x0E000200=1"], ["1 0x0E000201=1"], ["0x0E000200=1"], ["1 0xZ=1"], ["1 0x0E000200="], []],
    ),
    "names": (gcs_syntax.names, [["a b"], ["1", "1"], [""], []]),
    "commands": (gcs_syntax.commands, [["nothing here"]]),
}


@pytest.mark.parametrize(("read", "lines"), [(read, text) for read, every in REFUSED.values() for text in every])
def test_malformed_answers_are_refused(read, lines):
    with pytest.raises(LinkError, match="got"):
        read(lines)


def test_record_options_are_found_by_their_words():
    lines = [
        "#RecordOptions",
        "1=Target Position of axis",
        "2=Current Position of axis",
        "7=Control Voltage of output chan",
        "16=Voltage of output chan",
        "#TriggerOptions",
        "0=Voltage of output chan",
        "end of help",
    ]
    assert gcs_syntax.options(lines) == (2, 16)
    assert gcs_syntax.options([line for line in lines if not line.startswith("16")]) == (2, 7)
    assert gcs_syntax.options(lines[:3]) is None
    assert gcs_syntax.options([]) is None


@given(
    st.integers(1, 40).flatmap(lambda n: st.lists(st.lists(FINITE, min_size=n, max_size=n), min_size=1, max_size=4)),
    st.floats(1e-6, 10.0),
)
def test_an_array_is_read_exactly(columns, sample_time):
    found = gcs_syntax.table(array_text(columns, sample_time), len(columns[0]), len(columns))
    assert found[0] == sample_time
    assert np.array_equal(found[1], columns)


def test_an_array_cut_anywhere_is_refused():
    lines = array_text([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    for stop in range(len(lines)):
        with pytest.raises(LinkError, match="got"):
            gcs_syntax.table(lines[:stop], 3, 2)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("# NDATA = 3", "# NDATA = 4"),
        ("# DIM = 2", "# DIM = 3"),
        ("# TYPE = 1", "# TYPE = 2"),
        ("5e-05", "0"),
        ("5e-05", "nan"),
        ("= 32", "= 65"),
        ("# SEPARATOR = 32", "junk"),
        ("2.0 5.0", "2.0"),
        ("2.0 5.0", "2.0 nan"),
        ("2.0 5.0", "2.0 5.0 1"),
        ("2.0 5.0", "2.0 5.0e"),
    ],
)
def test_an_array_with_a_fault_is_refused(old, new):
    lines = array_text([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    assert any(old in line for line in lines)
    with pytest.raises(LinkError, match="got"):
        gcs_syntax.table([line.replace(old, new) for line in lines], 3, 2)


@given(st.lists(LINE, max_size=12), st.binary(max_size=60))
def test_random_bytes_raise_only_a_link_error(lines, raw):
    readers = [
        lambda: gcs_syntax.values(lines, ["1"]),
        lambda: gcs_syntax.names(lines),
        lambda: gcs_syntax.commands(lines),
        lambda: gcs_syntax.options(lines),
        lambda: gcs_syntax.pairs(lines),
        lambda: gcs_syntax.parameter(lines, "1", 7),
        lambda: gcs_syntax.single(lines),
        lambda: gcs_syntax.table(lines, 3, 2),
        lambda: gcs_syntax.line_of(raw),
        lambda: [gcs_syntax.integer(x) for x in lines],
    ]
    for read in readers:
        try:
            read()
        except LinkError as error:
            assert len(str(error)) < 300
