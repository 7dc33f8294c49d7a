"""On the command line a message names options, not the arguments of the library."""

import ast
import re
from dataclasses import replace

import click
import places
import pytest
from click.testing import CliRunner
from summaries import anatomy

import dehyst
from dehyst._text import counted
from dehyst.cli import main
from dehyst.cli.output.option_words import in_words_of, options_of
from dehyst.cli.scans import in_options
from dehyst.cli.start import begin_within, start_words
from dehyst.control import PossibleStart
from dehyst.records import write_record
from dehyst.studies import demo
from dehyst.virtual import PlayActuator

SOURCES = places.SOURCES
ARGUMENT = re.compile(r"(?<![-\w&?+])([a-z][a-z_]+)=(?!=)")
# Arguments that no command has: their messages come from calls of the library alone.
LIBRARY_ONLY = {"load_stiffness", "names", "closed", "stiff_only", "period", "time", "extrapolate"}
# Texts that are no messages: the compiler's flags, addresses of instruments, HTML.
NO_MESSAGES = re.compile(r"^-[a-zW]|://|[<>]|^\\|\\\(|^[;&]?[\w-]+=$")


def messages():
    """Every text of the sources that is no docstring, with what is put in left open."""
    for path in sorted(SOURCES.rglob("*.py")):
        tree = ast.parse(path.read_text())
        inside = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
        inside |= {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for node in ast.walk(tree):
            if isinstance(node, ast.JoinedStr):
                yield path, "".join(part.value if isinstance(part, ast.Constant) else "7" for part in node.values)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inside:
                yield path, node.value


def commands(command=main, words=()):
    """All commands that can be run, with their words."""
    if isinstance(command, click.Group):
        for name, inner in command.commands.items():
            yield from commands(inner, (*words, name))
    else:
        yield " ".join(words), command


COMMANDS = dict(commands())


def test_every_message_that_names_an_argument_is_put_into_options():
    known, unknown, left = set().union(*(options_of(one) for one in COMMANDS.values())), set(), []
    seen = 0
    for path, text in messages():
        names = set() if NO_MESSAGES.search(text) else set(ARGUMENT.findall(text))
        unknown |= {(path.name, name) for name in names - known - LIBRARY_ONLY if " " in text}
        for command in COMMANDS.values() if names else ():
            mine = names & options_of(command).keys()
            (said,) = in_words_of(command, [text])
            left += [(command.name, said) for name in mine if re.search(rf"(?<![-\w]){name}=", said)]
            seen += len(mine)
    assert left == []
    assert unknown <= {("option_words.py", "cycles"), ("html.py", "class")}
    assert seen > 50


@pytest.mark.parametrize(
    ("command", "said", "expected"),
    [
        ("identify", "try a smaller slope_floor.", "try a smaller --slope-floor."),
        ("identify", "slope_floor: got 2.0, need 0 to 1", "--slope-floor: got 2.0, need 0 to 1"),
        ("identify", "elements, knots: got 3", "--elements, --knots: got 3"),
        ("identify", "use method='record'", "use --method record"),
        ("identify", 'Say which with displacement="NAME".', 'Say which with --displacement "NAME".'),
        ("identify", "Without one, give sample_rate= in Hz.", "Without one, give --sample-rate HZ."),
        ("identify", "got sample_rate= and the time column 't'", "got --sample-rate and the time column 't'"),
        ("identify", "time: got 1 s after 2 s at value 3", "time: got 1 s after 2 s at value 3"),
        ("identify", "no file '/data/slope_floor.csv'", "no file '/data/slope_floor.csv'"),
        ("insight", "none were given; give limits=(low, high)", "none were given; give --limits LOW HIGH"),
        ("export", "the time between steps; give period= [s]", "the time between steps; give --period S"),
        ("export", "slew_rate: got -1.0, need a positive number", "--slew: got -1.0, need a positive number"),
        (
            "compensate",
            "x; give time= [s], one a sample, or make the Compensator with period= [s]",
            "x; give a time column (--time NAME) or --sample-rate HZ",
        ),
        (
            "excite raised-cosine",
            "peaks: got (0.0,), need voltages above the base 0 V",
            "PEAKS: got (0.0,), need voltages above the base 0 V",
        ),
        ("excite homing", "make that one with present=12.5", "make that one with --present 12.5"),
        ("simulate", "slope_floor is no option here", "slope_floor is no option here"),
    ],
)
def test_a_sentence_in_options(command, said, expected):
    (worded,) = in_words_of(COMMANDS[command], [said])
    assert worded == expected
    assert in_words_of(COMMANDS[command], [worded]) == (worded,)


def test_words_of_scans_pass_through_unchanged():
    said = in_options("cycles: got 3; give cycles=8, or limits=(low, high)")
    assert in_words_of(COMMANDS["compensate"], [said]) == (said,)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Records and models that some command must refuse, or has something to say of."""
    place = tmp_path_factory.mktemp("words")
    write_record(place / "loops.csv", demo.record_loops(PlayActuator(plays=60))[0])
    (place / "units.csv").write_text("a,b,c\n" + "".join(f"{k},{k % 7},{k % 5}\n" for k in range(50)))
    (place / "path.csv").write_text("displacement_um\n" + "".join(f"{k / 10}\n" for k in range(50)))
    anatomy("creep").save(place / "creeps.json")
    anatomy("plain").save(place / "plain.json")
    return place


@pytest.mark.parametrize(
    ("line", "shown"),
    [
        ("identify units.csv", '--voltage "NAME"'),
        ("identify units.csv --voltage b", '--voltage "b:V"'),
        ("identify loops.csv --slope-floor 7", "--slope-floor: got 7"),
        ("identify loops.csv --structure paper --refine", "--refine: the paper's class"),
        ("identify loops.csv --sample-rate 5", "got --sample-rate and the time column"),
        ("identify loops.csv --delay 1e6", "--delay: got 1e+06 s"),
        ("compensate creeps.json path.csv -o out.csv", "give a time column (--time NAME) or --sample-rate HZ"),
        ("compensate plain.json path.csv -o out.csv --slew 9", "give a time column (--time NAME) or --sample-rate HZ"),
        ("compensate plain.json path.csv -o out.csv --slew -1 --sample-rate 10", "--slew: got -1"),
        ("compensate plain.json units.csv -o out.csv", '--displacement "NAME"'),
        ("insight plain.json loops.csv --trajectory units.csv", '--wanted "NAME"'),
        ("insight creeps.json loops.csv --trajectory path.csv", "path.csv: got no time column"),
        ("insight plain.json loops.csv --level 7", "--level: got 7"),
        ("export creeps.json firmware", "give --period S"),
        ("export plain.json firmware --period -1", "--period: got -1"),
        ("excite raised-cosine 0 -o out.csv", "PEAKS: got"),
        ("excite staircase 100 -o out.csv --sample-rate 0.01", "--sample-rate: got 0.01"),
    ],
)
def test_messages_of_commands_name_options(folder, monkeypatch, line, shown):
    monkeypatch.chdir(folder)
    done = CliRunner().invoke(main, line.split())
    assert done.exit_code == 2, done.stderr
    assert shown in done.stderr
    assert not re.search(r"\b[a-z]+_?[a-z]*=|slope_floor|sample_rate|slew_rate", done.stderr)


def test_the_help_of_knots_is_what_is_done():
    shown = CliRunner().invoke(main, ["identify", "--help"]).stdout
    assert "[default: N + 1, at most 41]" in " ".join(shown.split())
    record = demo.record_loops(PlayActuator(plays=60))[0]
    for elements, knots in ((20, 21), (50, 41)):
        fit = dehyst.identify(record, elements=elements, norm="l2", delay=0.0)
        assert fit.actuator.spring.displacement.size == knots


def test_the_start_is_said_alike_and_within_the_limits():
    """The state at the top of the spring is held by a little more than the highest voltage of the records."""
    actuator = replace(anatomy("plain"), limits=(0.0, 150.0))
    top = PossibleStart.named(actuator, "top")
    assert actuator.voltage(top.state) > 160
    begin = begin_within(actuator, top, None)
    assert start_words(actuator, top) == start_words(actuator, top, begin) == "(coming from the top, 150 V)"


def test_numbers_of_things_agree_with_them():
    assert [counted(k, "sample") for k in (0, 1, 2)] == ["0 samples", "1 sample", "2 samples"]
    plural = re.compile(r"\w\(s\)")
    columns = {"compare_page.py", "parameters.py"}  # Seconds, in the head of a column.
    assert [text for path, text in messages() if plural.search(text) and path.name not in columns] == []


@pytest.mark.parametrize("name", ["limits", "knots", "delay"])
def test_a_file_that_is_called_as_an_option_keeps_its_name(name, tmp_path, monkeypatch):
    (tmp_path / name).mkdir()
    (tmp_path / name / "x").touch()
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(main, ["demo", "-o", name, "--no-report"])
    assert done.exit_code == 2
    assert done.stderr.startswith(f"dehyst: {name}: holds other files (x)")
