"""Commands as click declares them: words and values by name mean the same, and what has no effect is refused."""

import ast
import inspect
import json
import textwrap
from contextlib import suppress
from types import SimpleNamespace

import click
import numpy as np
import pytest
from click.testing import CliRunner
from command_line import commands, sample_words
from hypothesis import given
from hypothesis import strategies as st

from dehyst.cli.command import run_command
from dehyst.instruments import Samples
from dehyst.operations import registry
from dehyst.operations.axes import of_axes
from dehyst.operations.bench import Steps
from dehyst.operations.command import (
    HOUSE,
    INPUT,
    REPORT,
    OperationError,
    argument,
    beside,
    command,
    context_of,
    flag,
    number,
    option,
    output,
    pair,
)
from dehyst.operations.run import Result, Run, perform

_BESIDE = beside("names")


@command("sample")
def sample(
    run,
    file=argument(),
    output=output("", required=False),
    size=option("How large.", int, default=2),
    pair=pair(""),
    names=option("", multiple=True),
    others=option("", INPUT, multiple=True),
    fast=flag(""),
    home=option("", words="--home/--no-home", default=None),
    deep=number("", _BESIDE),
    report=REPORT,
):
    """Show what an operation is."""
    values = {key: value for key, value in locals().items() if key != "run"}
    return Result(json.loads(json.dumps(values, default=str)), [run.command], good=size < 5)


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    find = registry.find
    monkeypatch.setattr(registry, "find", lambda name: sample if name == "sample" else find(name))


def test_a_command_and_its_words_give_the_same_values(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["in.csv", "--pair", "-1", "2.5", "--names", "x", "--names", "y z", "--deep", "2", "--fast", "--no-home"]
    done = CliRunner().invoke(sample, [*words, "--json"], obj=run_command)
    assert done.exit_code == 0, done.stderr
    again = perform(context_of(["sample", *words]), Run())
    assert json.loads(done.stdout) == again.fields


def test_a_run_has_its_command_line_and_a_poor_result_has_status_1():
    done = CliRunner().invoke(sample, ["in.csv", "--size", "9"], obj=run_command)
    assert (done.exit_code, done.stdout) == (1, "sample in.csv --size 9\n")


@pytest.mark.parametrize(
    ("words", "argument"),
    [
        ("", "file"),
        ("a\0b", "file"),
        ("a --report a.png", "report"),
        ("a --length 3", "length"),
        ("a --size 3.5", "size"),
        ("a --size --force", "size"),
        ("a --pair 1", "pair"),
        ("a --pair 1 b", "pair"),
        ("a --deep 1;rm --names x", "deep"),
    ],
)
def test_words_of_a_wrong_type_are_refused_with_the_name_of_the_option(words, argument):
    with pytest.raises(OperationError) as refused:
        context_of(["sample", *words.split()])
    assert refused.value.argument in (argument, "sample")


@pytest.mark.parametrize(("words", "argument"), [(["--deep", "1"], "deep"), (["--force"], "force")])
def test_an_option_without_effect_is_refused(words, argument):
    with pytest.raises(OperationError, match="no effect") as refused:
        perform(context_of(["sample", "a", *words]), Run())
    assert refused.value.argument == argument


def test_options_hold_for_all_axes_or_for_one():
    words = ["--limits", "0", "100", "--limits", "x=-5", "120", "--slew-rate", "none", "--slew-rate", "y=5"]
    given = context_of(["export", "model.json", "c", *words]).params
    assert of_axes("limits", given["limits"], "xy") == [(-5, 120), (0, 100)]
    assert of_axes("slew_rate", given["slew_rate"], "xy") == [float("inf"), 5]


COMMANDS = dict(commands())


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_is_read_and_reaches_the_function(name):
    command = COMMANDS[name]
    signature = inspect.signature(command.callback)
    for each in command.params:
        context = click.Context(click.Group("dehyst", context_settings={}), info_name="dehyst")
        context = command.make_context(name, sample_words(command, each), parent=context)
        assert context.params[each.name] != each.get_default(context)
        own = {key: value for key, value in context.params.items() if key not in HOUSE}
        signature.bind(Run(), **own)


@pytest.mark.parametrize("name", COMMANDS)
def test_the_function_of_a_command_uses_each_parameter(name):
    (function,) = ast.parse(textwrap.dedent(inspect.getsource(COMMANDS[name].callback))).body
    names = [node for part in function.body for node in ast.walk(part) if isinstance(node, ast.Name)]
    used = {node.id for node in names if isinstance(node.ctx, ast.Load)}
    arguments = [each.arg for each in (*function.args.args, function.args.kwarg) if each is not None]
    assert [each for each in arguments if each not in used and each != "run"] == []


@pytest.mark.parametrize("fails", [False, True])
@given(steps=st.lists(st.lists(st.integers(1, 50), max_size=3), min_size=1, max_size=4))
def test_a_note_begins_and_ends_each_step_and_an_error_ends_the_last_one(fails, steps):
    notes, shown = [], [""]
    run = SimpleNamespace(note=lambda sentence: notes.append((sentence, shown[-1])), progress=shown.append)
    with suppress(KeyboardInterrupt), Steps(run) as listener:
        for k, blocks in enumerate(steps):
            listener.step(f"step {k}")
            for size in blocks:
                listener.samples(Samples(*np.zeros((3, size))))
                assert "samples" in shown[-1]
        if fails:
            raise KeyboardInterrupt
    sentences, beside = zip(*notes, strict=True)
    for k, (blocks, begin, end) in enumerate(zip(steps, sentences[::2], sentences[1::2], strict=True)):
        assert (begin, ("failed" in end)) == (f"step {k}: begins", fails and k == len(steps) - 1)
        assert (f"{sum(blocks)} samples" in end) is bool(blocks)
    # No note is on the line of the progress.
    assert set(beside) == {""}
