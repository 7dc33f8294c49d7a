"""One declaration of an operation: words of a command line and JSON mean the same, and what is wrong is refused."""

import json
import re
import shlex
from pathlib import Path
from typing import Annotated, Literal

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from dehyst.cli.commands import OperationCommand
from dehyst.operations.axes import Limit, Slew
from dehyst.operations.declaration import Input, OperationError, Output, beside, operation
from dehyst.operations.files import Columns
from dehyst.operations.paths import Zero
from dehyst.operations.registry import ENTRIES, find
from dehyst.operations.run import Result, Run, perform
from dehyst.operations.start import Start


def library(size, *, width: float = 1.5, kind: Literal["a", "b"] = "a"):
    """Do something.

    Parameters
    ----------
    size : int
        How large.
    width : float, optional
        How `wide` [m].
    kind : str
        Which.
    """


@operation(library, take=("width", "kind"), rare=("kind", "deep"))
def sample(
    run: Run,
    file: Input,
    *,
    output: Output | None = None,
    size: int = 2,
    pair: tuple[float, float] | None = None,
    names: tuple[str, ...] = (),
    limits: tuple[Limit, ...] = (),
    fast: bool = False,
    draw: bool = True,
    home: bool | None = None,
    deep: Annotated[float | None, beside("fast")] = None,
    **more,
) -> Result:
    """Show what an operation is.

    And more of it.

    Parameters
    ----------
    fast
        Be quick.
    """
    given = {"file": file, "output": output, "size": size, "pair": pair, "names": names, "limits": limits}
    given |= {"fast": fast, "draw": draw, "home": home, "deep": deep} | more
    return Result(json.loads(json.dumps(given, default=str)), [run.command], good=size < 5)


def test_a_declaration_is_made_of_signature_and_docstrings():
    known = {one.name: one for one in sample.parameters}
    assert list(known) == [
        "file",
        "output",
        "size",
        "pair",
        "names",
        "limits",
        "fast",
        "draw",
        "home",
        "deep",
        "width",
        "kind",
    ]
    assert (sample.summary, sample.help) == ("Show what an operation is.", "And more of it.")
    assert known["file"].positional and known["file"].required and not known["size"].required
    assert (known["width"].help, known["fast"].help, known["kind"].help) == ("How wide [m].", "Be quick.", "Which.")
    assert known["width"].whole_help == "How wide [m].  [default: 1.5]"
    assert (known["kind"].kind.choices, known["kind"].rare, known["draw"].flag) == (("a", "b"), True, "--no-draw")


WORDS = {
    "--size 3": {"size": 3},
    "--pair -1 2.5": {"pair": [-1, 2.5]},
    "--names x --names 'y z'": {"names": ["x", "y z"]},
    "--limits 0 100 --limits x=0 120": {"limits": [[0, 100], "x=0 120"]},
    "--fast --no-draw --no-home": {"fast": True, "draw": False, "home": False},
    "--home --width 2": {"home": True, "width": 2},
    """--fast --options '{"deep": 3, "kind": "b"}'""": {"fast": True, "deep": 3, "kind": "b"},
}


@pytest.mark.parametrize("words", WORDS)
def test_words_and_json_mean_the_same_and_make_the_same_command(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(OperationCommand(sample), ["in.csv", *shlex.split(words), "--json"])
    assert done.exit_code == 0, done.stderr
    values = sample.of_json({"file": "in.csv", **WORDS[words]})
    found = perform(sample, values, Run())
    assert json.loads(done.stdout) == found.as_dict()
    (line,) = found.lines
    again = CliRunner().invoke(OperationCommand(sample), [*shlex.split(line)[2:], "--json"])
    assert again.exit_code == 0 and json.loads(again.stdout) == found.as_dict()


def test_status_and_json_of_a_result_that_is_not_good_enough():
    done = CliRunner().invoke(OperationCommand(sample), ["in.csv", "--size", "9"])
    assert (done.exit_code, done.stdout) == (1, "dehyst sample in.csv --size 9\n")


@pytest.mark.parametrize(
    ("given", "argument"),
    [
        ({}, "file"),
        ({"file": 3}, "file"),
        ({"file": "a\0b"}, "file"),
        ({"file": "x" * 2000}, "file"),
        ({"file": "a", "length": 3}, "sample"),
        ({"file": "a", "size": "3"}, "size"),
        ({"file": "a", "size": 3.5}, "size"),
        ({"file": "a", "size": True}, "size"),
        ({"file": "a", "width": "1; rm"}, "width"),
        ({"file": "a", "width": float("nan")}, "width"),
        ({"file": "a", "width": 10**400}, "width"),
        ({"file": "a", "pair": [1]}, "pair"),
        ({"file": "a", "pair": [1, "b"]}, "pair"),
        ({"file": "a", "names": "abc"}, "names"),
        ({"file": "a", "limits": [[0, "b"]]}, "limits"),
        ({"file": "a", "kind": "--force"}, "kind"),
        ({"file": "a", "fast": 1}, "fast"),
    ],
    ids=str,
)
def test_json_of_another_kind_is_refused_by_its_name(given, argument):
    with pytest.raises(OperationError) as refused:
        sample.of_json(given)
    assert refused.value.argument == argument


def test_options_are_read_from_json_toml_or_themselves_and_strictly(tmp_path):
    (tmp_path / "few.json").write_text('{"kind": "b"}')
    (tmp_path / "few.toml").write_text('kind = "b"\n')
    for text in (str(tmp_path / "few.json"), str(tmp_path / "few.toml"), '{"kind": "b"}'):
        assert sample.options_in(text) == {"kind": "b"}
    for wrong in ('{"size": 3}', '{"kind": "c"}', '{"kind": }', "[1]", '["kind"]', '"kind"'):
        with pytest.raises(OperationError):
            sample.options_in(wrong)


def test_what_has_no_effect_is_refused():
    with pytest.raises(OperationError) as refused:
        perform(sample, {"file": Path("a"), "deep": 1.0}, Run())
    assert refused.value.argument == "deep"
    with pytest.raises(OperationError) as refused:
        perform(sample, {"file": Path("a")}, Run(), force=True)
    assert refused.value.argument == "force"


@pytest.mark.parametrize("name", ENTRIES)
def test_every_option_is_documented(name):
    found = find(name)
    assert found.summary.endswith(".") and found.name == name
    assert [one.name for one in found.parameters if not one.help and not one.positional] == []
    helps = [one.help for one in found.parameters if one.help]
    assert len(set(helps)) == len(helps)
    # "minor-loop:  stage: ..." is an option without a text where several functions have it.
    assert [one for one in helps if re.search(r": +($|\[default|\w[\w, -]*: )", one)] == []
    numbers = [one for one in found.parameters if type(one.default) in (int, float) and not one.positional]
    assert [one.name for one in numbers if "default" not in one.whole_help] == []


NAMES = st.text(st.characters(codec="utf-8", exclude_characters="=?*\n\r\0", exclude_categories=["C", "Z"]), min_size=1)
COLUMNS = st.builds(
    Columns,
    time=st.none() | NAMES,
    voltage=NAMES,
    displacement=st.none() | NAMES.map(lambda name: f"{name}:um?"),
    voltage_scale=st.none() | st.sampled_from(["100 V/V", "-0.5 V/mV", "GAIN V/V"]),
    sample_rate=st.none() | st.floats(0.1, 1e6).map(lambda rate: float(f"{rate:.6g}")),
    join=st.none() | st.just(Path("other file.csv")),
    decimal=st.none() | st.sampled_from(",."),
    max_bytes=st.sampled_from([5e8, 1e9]),
    axes=st.dictionaries(
        st.sampled_from(["x", "y", "z"]), st.sampled_from(["v_V:y_um", "V [V]*15:y, up [um]*-1um/um"])
    ),
)


@given(COLUMNS)
def test_columns_are_a_text_and_back(columns):
    assert Columns.parse(str(columns)) == columns


def test_columns_take_what_an_error_suggests():
    before = Columns.parse("time=t:s, decimal=comma")
    found = Columns.of_options({"voltage": "CH1?", "voltage_scale": "GAIN V/V"}, before)
    assert str(found) == "time=t:s, voltage=CH1?*GAIN, decimal=comma"
    assert str(Columns.of_options({"columns": "time:s?,-,voltage:V"})) == "time=1:s?, voltage=3:V"


@pytest.mark.parametrize("text", ["voltage", "voltage=", "=V", "time=a, time=b", "rate=HZ", "decimal=.", "x=1, x=2"])
def test_columns_that_are_none_are_refused(text):
    with pytest.raises(ValueError, match=r"got|need"):
        Columns.parse(text)


@pytest.mark.parametrize(
    ("kind", "texts", "wrong"),
    [
        (Limit, ["0 100", "x=-5 120.5"], ["0", "x=", "a b"]),
        (Slew, ["200", "none", "x=1500"], ["fast", "x="]),
        (Zero, ["bottom", "-120", "1.5"], ["top", "inf", "nan"]),
        (Start, ["top", "homed"], ["middle", "as:absent.csv"]),
    ],
)
def test_values_are_texts_and_back(kind, texts, wrong):
    for text in texts:
        assert str(kind.parse(text)) == text
    for text in wrong:
        with pytest.raises(ValueError, match="need"):
            kind.parse(text)
