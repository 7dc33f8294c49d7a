"""Errors are data: argument, got, need and hint; a command shows them with the names of its options."""

import json
import pickle

import click
import pytest
from click.testing import CliRunner

from dehyst._errors import FileFormatError, LinkError, ModelError, RecordError
from dehyst.cli import main
from dehyst.operations.command import error_text
from dehyst.operations.registry import find
from dehyst.records.columns import entries_of


@pytest.mark.parametrize("kind", [ModelError, RecordError, FileFormatError, LinkError])
def test_a_message_has_the_fields_of_its_error(kind):
    error = kind(argument="limits", got=(5, 2), need="the lower one first", hint="swap them", change=("limits",))
    assert str(error) == "limits: got (5, 2), need the lower one first; swap them"
    assert error.text(str.upper).startswith("LIMITS: got")
    again = pickle.loads(pickle.dumps(error)).as_dict()
    fields = {"argument": "limits", "got": "(5, 2)", "need": "the lower one first", "hint": "swap them"}
    assert again == error.as_dict() == {"kind": kind.__name__, "message": str(error), **fields, "change": ["limits"]}
    assert str(kind("a sentence")) == "a sentence"


@pytest.mark.parametrize(
    ("command", "error", "shown"),
    [
        ("identify", {"argument": "goal", "got": 2.0}, "--goal: got 2.0"),
        ("identify", {"argument": "delay, drift", "got": 3}, "--delay, --drift: got 3"),
        ("identify", {"argument": "voltage", "got": "no samples"}, "voltage: got no samples"),
        ("export", {"argument": "slew_rate", "got": -1.0}, "--slew-rate: got -1.0"),
        ("compensate", {"argument": "trajectory", "got": (0.0,)}, "TRAJECTORY: got (0.0,)"),
        ("insight", {"hint": "give limits", "change": ("limits",)}, "give limits (--limits [AXIS=]LOW HIGH)"),
        ("show", {"hint": "give", "change": ("sample_rate",)}, "give (--columns rate=HZ)"),
        ("simulate", {"argument": "slope_floor", "got": 1}, "slope_floor: got 1"),
    ],
)
def test_a_command_shows_its_options(command, error, shown):
    assert error_text(click.Context(find(command)), ModelError(**error)) == shown


def test_columns_are_suggested_as_data(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "units.csv").write_text("a,b,c\n" + "".join(f"{k},{k % 7},{k % 5}\n" for k in range(50)))
    done = CliRunner().invoke(main, ["show", "units.csv", "--json"])
    error = json.loads(done.stdout)["error"]
    assert done.exit_code == 2 and error["kind"] == "ColumnsError"
    assert entries_of(error["suggestion"]).keys() == {"time", "voltage", "displacement"}
    (command,) = error["commands"]
    assert command.startswith("dehyst show units.csv --columns ")
