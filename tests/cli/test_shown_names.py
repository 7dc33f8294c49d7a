"""Names that a terminal would obey: they are escaped wherever they are shown."""

import json
import os
import re
import sys
import zipfile
from xml.etree import ElementTree

import pytest
from command_line import run, run_as_process
from hypothesis import given
from hypothesis import strategies as st
from virtual_loops import record_loops

from dehyst import FileFormatError, write_record
from dehyst._io import write_json
from dehyst._text import digits, escaped
from dehyst.instruments import LinkError

NASTY = "a\x1b]0;owned\x07\r\nb\u202ec"
SAID = r"a\x1b]0;owned\x07\r\nb\u202ec"
UNSAFE = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2066-\u2069]")
posix = pytest.mark.skipif(sys.platform == "win32", reason="devices, pipes and names of POSIX")


def test_control_characters_are_escaped():
    assert escaped(NASTY) == escaped(SAID) == SAID
    plain = "Aktor Ä, µm, \u00a0пьезо, 圧電 100 %"
    assert escaped(plain) == plain
    assert escaped("\x9b31m \u2028 \udcff \ufeff") == r"\x9b31m \u2028 \udcff \ufeff"


# Not st.text(): its first draw takes seconds on a cold machine.
@given(st.lists(st.integers(0, 0x10FFFF) | st.integers(0, 0x2100)))
def test_escaped_text_has_no_control_characters(codes):
    text = "".join(map(chr, codes))
    assert not UNSAFE.search(escaped(text).encode().decode()) and "\n" not in escaped(text)


def test_errors_are_one_line():
    assert (str(FileFormatError(f"{NASTY}: wrong")), str(LinkError(NASTY))) == (f"{SAID}: wrong", SAID)


@given(st.floats(1e-3, 9e5), st.floats(-1e-3, 1e-3))
def test_a_number_in_a_sentence_has_no_power_of_ten_and_differs_from_the_goal_beside_it(value, more):
    goal = float(f"{value * (1 + more):.3g}")
    said = float(digits(value, 2, goal))
    assert "e" not in digits(value) and float(digits(value)) == pytest.approx(value, rel=0.05)
    assert said == pytest.approx(value, rel=0.05) and (abs(value / goal - 1) < 1e-7 or (said > goal) == (value > goal))


@pytest.fixture(scope="module")
def loops(tmp_path_factory):
    """The text of a record that a model can be identified from quickly."""
    path = tmp_path_factory.mktemp("loops") / "loops.csv"
    write_record(path, record_loops()[0])
    return path.read_text()


@posix
def test_a_name_with_control_characters_is_escaped_everywhere(tmp_path, loops):
    name = f"{NASTY}.csv"
    (tmp_path / name).write_text(loops)
    quick = ["--verbose", "--structure", "maxwell_slip"]
    status, out, err = run("identify", name, "-o", "m.json", "--report", "r.html", *quick, cwd=tmp_path)
    assert status == 0 and SAID in out and not UNSAFE.search(out + err)
    page = (tmp_path / "r.html").read_text()
    assert SAID in page and not UNSAFE.search(page)
    status, out, err = run("identify", f"{NASTY} absent.csv", cwd=tmp_path)
    assert status == 2 and err.count("\n") == 1 and not UNSAFE.search(err)
    status, out, err = run("identify", "--\x1b[31m", cwd=tmp_path)
    assert status == 2 and not UNSAFE.search(err)


@posix
def test_a_model_with_such_a_name_is_escaped_in_every_output(tmp_path, loops, model):
    given = json.loads(json.dumps(model.as_dict()))
    given["name"], given["provenance"] = NASTY, {"source": NASTY, "outcome": NASTY}
    write_json(tmp_path / "m.json", given)
    (tmp_path / "voltage.csv").write_text("time_s,voltage_V\n0,1\n0.1,2\n0.2,1\n")
    (tmp_path / "loops.csv").write_text(loops)
    for command in (
        ["simulate", "m.json", "voltage.csv", "-o", "s.csv"],
        ["insight", "m.json", "loops.csv", "--report", "i.html"],
        ["export", "m.json", "c", "--limits", "0", "100"],
        ["export", "m.json", "x.fmu", "--limits", "0", "100"],
    ):
        status, out, err = run(*command, cwd=tmp_path)
        assert status in (0, 1) and not UNSAFE.search(out + err), (command, err)
    for path in (*(tmp_path / "c").iterdir(), tmp_path / "i.html"):
        # A Makefile needs its tabs.
        assert not UNSAFE.search(path.read_text().replace("\t", " ")), path
    with zipfile.ZipFile(tmp_path / "x.fmu") as archive:
        text = archive.read("modelDescription.xml").decode()
    assert ElementTree.fromstring(text).get("modelName") and not UNSAFE.search(text)


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform != "linux", reason="names of any bytes")
def test_names_without_utf8_and_ascii_streams_are_possible(tmp_path, loops):
    name = os.fsdecode(b"caf\xe9 \xc2\xb5.csv")
    (tmp_path / name).write_text(loops)
    quick = ["--verbose", "--structure", "maxwell_slip", "-o", "m.json", "--report", "r.html", "--force"]
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "ascii"}
    for more in ({}, ascii_only):
        status, out, err = run_as_process("identify", name, *quick, cwd=tmp_path, env={**os.environ, **more})
        assert status == 0 and r"caf\udce9" in out, err
        assert r"caf\udce9" in (tmp_path / "r.html").read_text()
        assert out.isascii() or not more
        assert run_as_process("identify", f"absent {name}", cwd=tmp_path, env={**os.environ, **more})[0] == 2
