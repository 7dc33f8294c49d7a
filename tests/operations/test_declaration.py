"""One declaration of an operation: words of a command line and JSON mean the same, and what is wrong is refused."""

import json
import shlex
from pathlib import Path
from typing import Annotated, Literal

import pytest
from click.testing import CliRunner

from dehyst.cli.command import OperationCommand
from dehyst.operations.axes import Limit, Slew
from dehyst.operations.declaration import Input, OperationError, Output, beside, operation
from dehyst.operations.paths import Zero
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
