"""What someone meets first: `dehyst` alone, help in the order of the journey, suggestions, completion."""

import os
import re
import subprocess
import sys

import places
import pytest
from click.shell_completion import BashComplete
from command_line import commands, run

from dehyst.cli import main
from dehyst.operations.registry import ENTRIES


def test_dehyst_alone_is_its_help():
    assert run() == run("--help")


def test_help_has_every_command_once_under_a_heading_on_one_screen():
    status, out, _ = run("--help")
    assert status == 0 and len(out.splitlines()) <= 40
    listed = re.findall(r"^  ([a-z]+(?: [a-z]+)?)  +(\S.*)$", out, re.M)
    names = [name for entries in main.journey.values() for name in entries]
    assert [name for name, _ in listed] == names and {*ENTRIES} < {*names}
    assert names.index("excite") < names.index("identify") < names.index("compensate") < names.index("export")
    assert [heading for heading in main.journey if f"\n{heading}:\n" in out] == list(main.journey)


@pytest.mark.parametrize("name", dict(commands()))
def test_help_of_a_command_is_one_screen_with_its_options_alone(name):
    out = run(*name.split(), "--help")[1]
    listed = re.findall(r"^  (?:-\w, )?(--[\w-]+)", out, re.M)
    assert len(out.splitlines()) <= 40
    assert {*listed} == {
        "--help",
        *(each.opts[-1] for each in dict(commands())[name].params if each.opts[-1][0] == "-"),
    }


def test_help_loads_no_numpy():
    program = (
        "import sys; from dehyst.cli import main; main(['-h'], standalone_mode=False); print('numpy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert "numpy" not in done.stdout.splitlines()[-1].split()


@pytest.mark.parametrize(
    ("arguments", "suggestion"),
    [
        (["identfy", "loops.csv"], "identify"),
        (["simulation"], "simulate"),
        (["identify", "--outptu", "3", "loops.csv"], "--output"),
        (["identify", "--reports", "r.html", "loops.csv"], "--report"),
    ],
)
def test_a_slip_of_the_pen_gets_a_suggestion(arguments, suggestion):
    status, out, err = run(*arguments)
    assert (status, out) == (2, "")
    assert re.search(rf"[Dd]id you mean.*'{suggestion}'", err)


def test_what_resembles_nothing_gets_no_suggestion():
    status, _, err = run("zzz")
    assert status == 2
    assert "mean" not in err


def test_completion_offers_commands_and_options():
    complete = BashComplete(main, {}, "dehyst", "_DEHYST_COMPLETE")
    assert {item.value for item in complete.get_completions([], "i")} == {"identify", "insight"}
    assert "--structure" in {item.value for item in complete.get_completions(["identify"], "--st")}
    assert "staircase" in {item.value for item in complete.get_completions(["excite"], "st")}
    assert {item.type for item in complete.get_completions(["identify"], "lo")} == {"file"}


def test_the_documented_completion_script_is_printed():
    page = (places.DOCS / "how_to" / "command_line.md").read_text()
    variable = re.search(r"(_DEHYST_COMPLETE)=bash_source", page)[1]
    environment = {**os.environ, variable: "zsh_source"}
    command = [sys.executable, "-c", "from dehyst.cli import main; main(prog_name='dehyst')"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=60)
    assert "#compdef dehyst" in done.stdout
