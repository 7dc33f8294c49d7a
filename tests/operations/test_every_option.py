"""Every option reaches the function of its command, which uses it; keys of --columns and options of a path show."""

import ast
import inspect
import textwrap
from dataclasses import replace

import numpy as np
import plain_records
import pytest
from click.testing import CliRunner
from command_line import run

from dehyst.cli.command import OperationCommand
from dehyst.operations.files import RECORD
from dehyst.operations.registry import ENTRIES, find
from dehyst.operations.run import Result
from dehyst.records import write_columns

# A text of each type that has texts of its own.
TEXTS = {
    "Columns": "time=2",
    "Limit": "x=0 50",
    "Numbers": "1,2",
    "Present": "20",
    "Slew": "x=70",
    "Start": "bottom",
    "Zero": "bottom",
}


def another(one):
    """Return a value of a parameter that is not its default, as JSON."""
    kind = one.kind
    if kind.type is bool:
        return not one.default
    if kind.choices:
        value = next(choice for choice in reversed(kind.choices) if choice != one.default)
    elif kind.type in (int, float):
        value = next(number for number in (7, 8) if number != one.default)
        value = [value, value + 1] if kind.count > 1 else value
    else:
        value = TEXTS.get(kind.type.__name__, f"{one.name}.x")
    return [value] if kind.several else value


@pytest.mark.parametrize("command", ENTRIES)
def test_each_option_reaches_the_function(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = []

    def function(_, **values):
        given.append(values)
        return Result({})

    declared = find(command)
    free = tuple(replace(one, conditions=()) for one in declared.parameters)
    caught = replace(declared, function=function, parameters=free)
    needed = {one.name: another(one) for one in free if one.required}
    for one in free:
        values = caught.of_json({**needed, one.name: another(one)})
        words = caught.command(values)[1 + len(command.split()) :]
        done = CliRunner().invoke(OperationCommand(caught), words)
        assert done.exit_code == 0, (words, done.output)
        assert given.pop() == values
        assert values[one.name] != one.default


@pytest.mark.parametrize("command", ENTRIES)
def test_the_function_of_a_command_uses_each_parameter(command):
    declared = find(command)
    (function,) = ast.parse(textwrap.dedent(inspect.getsource(declared.function))).body
    names = [node for part in function.body for node in ast.walk(part) if isinstance(node, ast.Name)]
    used = {node.id for node in names if isinstance(node.ctx, ast.Load)}
    own = {one.arg for one in (*function.args.args, *function.args.kwonlyargs)}
    rest = function.args.kwarg.arg if function.args.kwarg else None
    unused = [one.name for one in declared.parameters if (one.name if one.name in own else rest) not in used]
    assert unused == []


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory):
    """A folder with a model, a record with other columns, and a path."""
    folder = tmp_path_factory.mktemp("laboratory")
    model = replace(plain_records.plant(6), limits=(0.0, 100.0), delay=2e-3)
    time = np.arange(200) / 50
    voltage = 40 + 35 * np.sin(2 * np.pi * time)
    moved = 1e6 * model.simulate(voltage).displacement
    record = {"time_s": time, "voltage_V": voltage, "displacement_um": moved}
    more = {"bare": 0.1 * voltage, "monitor_V": 1.1 * voltage, "back_um": 1.2 * moved, "clock_s": 2 * time}
    write_columns(folder / "record.csv", record | more)
    write_columns(folder / "other.csv", {"time_s": time, "extra_um": 0.9 * moved})
    rows = zip(time + 1, voltage + 1, moved + 1, strict=True)
    lines = ["time_s\tvoltage_V\tdisplacement_um", *("\t".join(f"{cell:.3f}" for cell in row) for row in rows)]
    (folder / "commas.txt").write_text("\n".join(lines).replace(".", ","))
    write_columns(folder / "path.csv", {"time_s": time, "displacement_um": 2 + np.cos(time)})
    model.save(folder / "model.json")
    return folder


# Of each key of --columns: what is read without it, and with it.
KEYS = {
    "time": ("record.csv", "", "time=clock_s"),
    "voltage": ("record.csv", "", "voltage=monitor_V"),
    "voltage scale": ("record.csv", "", "voltage=voltage_V*1.1"),
    "displacement": ("record.csv", "", "displacement=back_um"),
    "displacement scale": ("record.csv", "displacement=monitor_V*0.09um/V", "displacement=monitor_V*0.08um/V"),
    "rate": ("record.csv", "", "rate=50"),
    "hold": ("record.csv", "", "hold=sample"),
    "temperature": ("record.csv", "", "temperature=bare:C"),
    "join": ("record.csv", "", "join=other.csv, displacement=extra_um"),
    "decimal": ("commas.txt", "", "decimal=comma"),
    "max_size": ("record.csv", "", "max_size=0.0001"),
    "axes": ("record.csv", "", "x=voltage_V:displacement_um, y=monitor_V:back_um"),
}


@pytest.mark.parametrize("key", KEYS)
def test_each_key_of_columns_changes_what_is_read(laboratory, monkeypatch, key):
    monkeypatch.chdir(laboratory)
    file, *columns = KEYS[key]
    before, after = (run("show", file, "--json", *(["--columns", text] if text else [])) for text in columns)
    assert before != after
    # A bound refuses what is larger.
    assert after[0] == (2 if key == "max_size" else 0), after


def test_every_key_of_columns_is_tried():
    assert {key.split()[0] for key in KEYS} == {*RECORD, "axes"}


OPTIONS = [
    "--limits 5 60",
    "--slew-rate 7",
    "--start bottom",
    "--no-home",
    "--home --present 20",
    "--zero 1.5",
    "--lag",
    "--table cycle.csv",
    "--columns displacement=time_s:um",
]


@pytest.mark.parametrize("option", OPTIONS)
def test_an_option_of_a_path_changes_the_voltage_or_is_refused(laboratory, tmp_path, monkeypatch, option):
    monkeypatch.chdir(laboratory)
    outputs = [tmp_path / name for name in ("before.csv", "after.csv")]
    before = run("compensate", "model.json", "path.csv", "-o", outputs[0], "--json")
    status, out, err = run("compensate", "model.json", "path.csv", "-o", outputs[1], "--json", *option.split())
    assert before[0] == 0, before
    if status == 2:
        assert option.split()[-2 if option.count(" ") else 0] in err + out
    else:
        assert outputs[0].read_bytes() != outputs[1].read_bytes()
